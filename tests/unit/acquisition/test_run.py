"""A scan takes what is missing once, in order, and says what was in the way."""

from __future__ import annotations

import dataclasses
import importlib
from pathlib import Path

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition import plan, run
from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.connect import connect
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Settings
from amulor.errors import AmulorError, FormatError, InstrumentError, SurveyError
from amulor.survey import Survey


def test_a_scan_takes_every_planned_sample_once_in_order(
    small, settings, folder
) -> None:
    told: list[plan.Key] = []
    progress: list[acquisition.Progress] = []
    outcome = acquisition.acquire(
        small, folder, settings=settings, acknowledged=told.append,
        progress=progress.append,
        scene=scene_light,
    )  # fmt: skip
    planned = [step.key for step in plan.steps(small, settings.procedure)]
    assert told == planned
    assert outcome.finished
    assert (outcome.done, outcome.total) == (len(planned), len(planned))
    assert [now.done for now in progress] == [*range(1, len(planned) + 1)]
    assert progress[-1].left == 0
    assert {now.kind for now in progress} == {"scan", "open_water", "dark"}
    with Journal.read(folder) as journal:
        assert [part["reason"] for part in journal.segments()] == ["finished"]


def test_light_is_off_for_dark_readings_and_the_target_out_for_water(
    small, settings, folder, safe
) -> None:
    devices = connect(small, settings, scene=scene_light)
    seen: dict[str, set] = {}
    commit = Journal.commit

    def note(journal, key, record):
        bench = devices.lock_in.bench
        seen.setdefault(key.kind, set()).add(
            (bench.laser_on, bench.place("target") > 0)
        )
        commit(journal, key, record)

    Journal.commit = note
    try:
        acquisition.acquire(small, folder, settings=settings, devices=devices)
    finally:
        Journal.commit = commit
    assert {on for on, _ in seen["dark"]} == {False}
    assert seen["open_water"] == {(True, True)}
    assert seen["scan"] == {(True, False)}
    assert safe(devices)


@pytest.mark.parametrize(
    "at",
    [
        *(0, 30, 60),
        *(pytest.param(n, marks=pytest.mark.slow) for n in range(5, 60, 5) if n != 30),
    ],
)
def test_a_scan_stopped_at_any_sample_resumes_to_the_whole(
    small, settings, folder, at, safe, Stop
) -> None:
    devices = connect(small, settings, scene=scene_light)
    control = Stop(at, go_on=False)
    first = acquisition.acquire(
        small, folder, settings=settings, devices=devices, control=control
    )
    assert (first.finished, first.done, control.asked) == (False, at, 1)
    assert safe(devices)
    told: list[plan.Key] = []
    second = acquisition.acquire(
        small,
        folder,
        settings=settings,
        resume=True,
        acknowledged=told.append,
        scene=scene_light,
    )
    assert second.finished
    planned = [step.key for step in plan.steps(small, settings.procedure)]
    missing = planned[at:]
    broken_in_the_scan = any(key.kind == SCAN for key in planned[:at])
    extra = [
        step.key for step in plan.extra_reference(small, settings.procedure, number=0)
    ]
    # The first missing sample is next, after the reference if the scan had begun.
    assert told == (extra if broken_in_the_scan else []) + missing
    with Journal.read(folder) as journal:
        assert journal.keys() == {*planned, *told}
        reasons = [part["reason"] for part in journal.segments()]
    assert reasons == ["paused", "finished"]


def test_a_pause_that_goes_on_repeats_the_reference_and_is_recorded(
    small, settings, folder, Stop
) -> None:
    devices = connect(small, settings, scene=scene_light)
    control = Stop(30, go_on=True)
    outcome = acquisition.acquire(
        small, folder, settings=settings, devices=devices, control=control
    )
    planned = plan.count(small, settings.procedure)
    assert outcome.finished
    assert outcome.done == planned + 2 * (2 + 6)
    assert devices.laser.log.count("off") >= 2
    with Journal.read(folder) as journal:
        assert [part["reason"] for part in journal.segments()] == ["paused", "finished"]


def test_the_rate_does_not_count_the_time_of_a_question(
    small, settings, folder, monkeypatch, Stop
) -> None:
    wall = [0.0]

    class Slow(Stop):
        def go_on(self) -> bool:
            wall[0] += 1000.0
            return super().go_on()

    def note(_: plan.Key) -> None:
        wall[0] += 0.1

    monkeypatch.setattr(run.time, "monotonic", lambda: wall[0])
    seen: list[acquisition.Progress] = []
    acquisition.acquire(
        small, folder, settings=settings, control=Slow(30, go_on=True),
        acknowledged=note, progress=seen.append,
        scene=scene_light,
    )  # fmt: skip
    assert [now.rate for now in seen] == pytest.approx([10.0] * len(seen))
    left = (seen[40].total - seen[40].done) / 10
    assert seen[40].left == pytest.approx(left)


def test_resuming_a_finished_scan_takes_nothing(small, settings, folder, safe) -> None:
    acquisition.acquire(small, folder, settings=settings, scene=scene_light)
    told: list[plan.Key] = []
    devices = connect(small, settings, scene=scene_light)
    again = acquisition.acquire(
        small, folder, settings=settings, resume=True, acknowledged=told.append,
        devices=devices,
    )  # fmt: skip
    assert again.finished
    assert told == []
    assert safe(devices)


def test_a_resumed_scan_is_an_uninterrupted_one_within_noise(
    small, settings, folder, Stop, cube_of
) -> None:
    whole, broken = folder / "whole", folder / "broken"
    acquisition.acquire(small, whole, settings=settings, scene=scene_light)
    for number, at in enumerate((25, 40, 30)):
        acquisition.acquire(
            small, broken, settings=settings, resume=number > 0,
            control=Stop(at, go_on=False),
            scene=scene_light,
        )  # fmt: skip
    acquisition.acquire(
        small, broken, settings=settings, resume=True, scene=scene_light
    )
    first, second = (cube_of(place) for place in (whole, broken))
    # Water fluctuates by 5 % of its signal beside the stated error.
    shots = first.amulor.open_water
    fluctuation = 0.05 * float(np.hypot(shots["in_phase"], shots["quadrature"]).max())
    for name in ("in_phase", "quadrature"):
        error = np.hypot(first[f"{name}_uncertainty"], second[f"{name}_uncertainty"])
        pull = (first[name] - second[name]) / np.hypot(error, 1.5 * fluctuation)
        # 30 pulls of a normal distribution, narrower since 1.5 sigma is an upper limit.
        assert np.abs(pull).max() < 4
    assert len({*second["user_segment"].values.ravel()}) > 1
    assert second.sizes["shot"] > first.sizes["shot"]


def test_survey_and_devices_files_that_were_lost_come_back(
    small, settings, folder, Stop
) -> None:
    acquisition.acquire(
        small,
        folder,
        settings=settings,
        control=Stop(9, go_on=False),
        scene=scene_light,
    )
    for name in ("survey.toml", "devices.toml"):
        (folder / name).unlink()
    acquisition.acquire(
        small, folder, settings=settings, resume=True, scene=scene_light
    )
    assert Survey.from_toml(folder / "survey.toml") == small
    assert Settings.from_toml(folder / "devices.toml") == settings


def test_the_output_without_light_is_taken_off_the_cube_and_not_off_the_journal(
    small, settings, folder, made, cube_of
) -> None:
    cubes, raw = [], []
    for pickup in (0.0, 1e-4):
        place = folder / f"{pickup:g}"
        own = made(settings, simulation={"pickup": pickup})
        acquisition.acquire(small, place, settings=own, scene=scene_light)
        cubes.append(cube_of(place))
        with Journal.read(place) as journal:
            raw.append([record.in_phase for _, record in journal.samples(SCAN)])
    # The same seed makes the same noise. What is left is what the filter still lacks of
    # the pickup in the first reading of all, less than 1e-4 of it.
    np.testing.assert_allclose(np.subtract(*raw), -1e-4, rtol=1e-4)
    np.testing.assert_allclose(
        *(cube["in_phase"].values for cube in cubes), rtol=0, atol=1e-8
    )
    dark = [cube.attrs["dark_in_phase"] for cube in cubes]
    np.testing.assert_allclose(dark[1] - dark[0], 1e-4, rtol=1e-4)


def test_a_lost_reference_is_waited_out_and_noted(
    small, settings, folder, made, cube_of
) -> None:
    own = made(settings, simulation={"faults": ["unlock@30x2"]})
    acquisition.acquire(small, folder, settings=own, scene=scene_light)
    cube = cube_of(folder)
    flags = cube["user_sample_flag"].values
    assert np.count_nonzero(flags & SampleFlag.REPEATED) == 1
    assert np.isfinite(cube["in_phase"]).all()
    assert not cube["saturated"].any()


def test_room_is_made_for_an_overload_that_stays(small, settings, folder) -> None:
    devices = connect(small, settings, scene=scene_light)
    lock_in = devices.lock_in
    lock_in._scale = 0  # far too fine
    outcome = acquisition.acquire(small, folder, settings=settings, devices=devices)
    assert outcome.flagged > 0
    with Journal.read(folder) as journal:
        dark = [record for _, record in journal.samples("dark")]
        scan = [record for _, record in journal.samples("scan")]
    assert not any(record.flags & SampleFlag.OVERLOAD for record in dark + scan)
    assert all(
        abs(complex(record.in_phase, record.quadrature)) <= record.full_scale
        for record in scan
    )


def test_a_detector_beyond_its_range_is_flagged_pixel_by_pixel(
    small, settings, folder, made, cube_of
) -> None:
    own = made(settings, simulation={"faults": ["saturation@30x3"]})
    acquisition.acquire(small, folder, settings=own, scene=scene_light)
    cube = cube_of(folder)
    assert int(cube["saturated"].sum()) == 3
    from amulor import rejection
    from amulor.cube import QualityFlag

    flags = rejection.open_water(cube)["quality_flag"].values
    assert np.count_nonzero(flags & QualityFlag.SATURATED) == 3


def test_a_beam_off_its_place_is_flagged_and_where_it_was_is_kept(
    small, settings, folder, made, cube_of
) -> None:
    own = made(settings, simulation={"position_error": 1e-3})
    acquisition.acquire(small, folder, settings=own, scene=scene_light)
    cube = cube_of(folder)
    off = cube["azimuth"] - cube["user_commanded_azimuth"]
    # The mean of two channels of errors of 1 mrad.
    assert 0.3e-3 < float(off.std()) < 1.2e-3
    flagged = cube["user_sample_flag"].values & SampleFlag.OFF_POSITION
    assert np.count_nonzero(flagged) > 0.8 * flagged.size


def test_a_changed_survey_or_instrument_is_refused(
    small, settings, folder, made, Stop
) -> None:
    acquisition.acquire(
        small,
        folder,
        settings=settings,
        control=Stop(30, go_on=False),
        scene=scene_light,
    )
    other = small.model_copy(update={"name": "Another one"})
    with pytest.raises(SurveyError, match="another survey"):
        acquisition.acquire(
            other, folder, settings=settings, resume=True, scene=scene_light
        )
    changed = made(settings, procedure={"settling": 7.0})
    with pytest.raises(InstrumentError, match="another procedure"):
        acquisition.acquire(
            small, folder, settings=changed, resume=True, scene=scene_light
        )
    # Where a device is reached is no part of what it is.
    moved = made(settings, lock_in={"timeout": 9.0}, simulation={"seed": 5})
    assert acquisition.acquire(
        small, folder, settings=moved, resume=True, scene=scene_light
    ).finished


def test_a_state_without_an_angle_is_told(small, settings, folder) -> None:
    instrument = small.instrument.model_copy(update={"polarizations": ("RL",)})
    survey = small.model_copy(update={"instrument": instrument})
    with pytest.raises(InstrumentError, match=r"add launch\.angles\.R"):
        acquisition.acquire(survey, folder, settings=settings, scene=scene_light)


def test_recovering_nothing_is_told(small, settings, folder: Path, Stop) -> None:
    with pytest.raises(AmulorError, match="no journal"):
        acquisition.recover(folder)
    acquisition.acquire(
        small,
        folder,
        settings=settings,
        control=Stop(2, go_on=False),
        scene=scene_light,
    )
    with pytest.raises(AmulorError, match="no sample of the scan yet"):
        acquisition.recover(folder)


@pytest.mark.parametrize(
    "name",
    [
        "in_phase",
        pytest.param("open_water_quadrature", marks=pytest.mark.slow),
        pytest.param("user_segment", marks=pytest.mark.slow),
    ],
)
def test_a_cube_that_a_disk_has_changed_is_told(
    small, settings, folder, monkeypatch, name
) -> None:
    acquisition.acquire(small, folder, settings=settings, scene=scene_light)
    # The function of this name hides the module in its package.
    module = importlib.import_module("amulor.acquisition.cube.build")
    write = module.write_cube

    def write_badly(cube, path, **options) -> None:
        changed = cube.copy(deep=True)
        changed[name].values.flat[3] += 1
        write(changed, path, **options)

    monkeypatch.setattr(module, "write_cube", write_badly)
    with pytest.raises(FormatError, match=rf"not hold what was written to it \({name}"):
        acquisition.recover(folder)
    monkeypatch.undo()
    # The journal is what it was.
    acquisition.recover(folder, overwrite=True)


def test_the_clock_of_the_scan_counts_settling_and_dwell(
    small, settings, folder
) -> None:
    devices = connect(small, settings, scene=scene_light)
    assert isinstance(devices.clock, VirtualClock)
    acquisition.acquire(small, folder, settings=settings, devices=devices)
    samples = plan.count(small, settings.procedure)
    # Five time constants of 10 ms for each sample, and the moves of target and mounts.
    assert samples * 0.05 < devices.clock.now() < samples * 0.05 + 15


def test_surveys_without_open_water_are_scanned_too(
    small: Survey, settings, folder, cube_of
) -> None:
    scan = small.scan.model_copy(update={"open_water": None})
    survey = small.model_copy(update={"scan": scan})
    assert acquisition.acquire(
        survey, folder, settings=settings, scene=scene_light
    ).finished
    cube = cube_of(folder)
    assert cube.amulor.open_water is None


def test_what_was_not_taken_yet_is_no_number_in_either_part(
    small, settings, folder, Stop, cube_of
) -> None:
    acquisition.acquire(
        small,
        folder,
        settings=settings,
        control=Stop(30, go_on=False),
        scene=scene_light,
    )
    cube = cube_of(folder)
    missing = np.isnan(cube["in_phase"].values)
    assert 0 < missing.sum() < missing.size
    np.testing.assert_array_equal(np.isnan(cube["quadrature"].values), missing)


def test_a_channel_without_dark_readings_is_left_as_it_is(small, folder) -> None:
    """One of two channels has none: its output stays, and gets no error for it."""
    changes = {"scan.columns": 2, "scan.rows": 1, "scan.open_water": None}
    # Dark counts make noise in darkness.
    survey = small.with_({**changes, "instrument.detector.dark_rate": "1e8 1/s"})
    settings = Settings.model_validate(
        {"procedure": {"dark_readings": 1, "references": 1},
         "simulation": {"pickup": "1 mV"}},
    )  # fmt: skip
    acquisition.acquire(survey, folder, settings=settings, scene=scene_light)
    with Journal.read(folder) as journal:
        whole, meta = acquisition.build(journal), journal.meta()
        taken = [(key, record) for _, key, record in journal.newer(0)]
    place = folder / "less"
    place.mkdir()
    with Journal.create(place, meta=meta) as journal:
        journal.begin_segment()
        for key, record in taken:
            if (key.kind, key.polarization) != ("dark", "VH"):
                journal.commit(key, record)
        less = acquisition.build(journal)
        # One that overloaded is none, whatever it says.
        for key, record in taken:
            if (key.kind, key.polarization) == ("dark", "VH"):
                wild = dataclasses.replace(
                    record, in_phase=0.5, flags=int(SampleFlag.OVERLOAD)
                )
                journal.commit(key, wild)
        spoiled = acquisition.build(journal)
    for name in ("in_phase", "in_phase_uncertainty"):
        np.testing.assert_array_equal(spoiled[name], less[name])
    pairs = survey.instrument.polarizations
    there, gone = pairs.index("VV"), pairs.index("VH")
    for name in ("in_phase", "in_phase_uncertainty"):
        np.testing.assert_array_equal(less[name][:, there], whole[name][:, there])
    # The dark reading was the pickup of 1 mV, and little else.
    raw = np.array(
        [record.in_phase for key, record in taken
         if key.kind == "scan" and key.polarization == "VH"]
    )  # fmt: skip
    np.testing.assert_array_equal(less["in_phase"].values[0, gone].ravel(), raw)
    np.testing.assert_allclose(whole["in_phase"].values[0, gone].ravel(), raw - 1e-3,
                               rtol=0, atol=2e-6)  # fmt: skip
    errors = [cube["in_phase_uncertainty"].values[0, gone] for cube in (less, whole)]
    assert (errors[0] < errors[1]).all()
    np.testing.assert_array_equal(
        np.ravel(less.attrs["dark_in_phase"])[gone], 0.0
    )  # fmt: skip


@pytest.mark.parametrize("name", ["survey.toml", "devices.toml"])
def test_nothing_is_written_through_a_link_to_nowhere(
    small, settings, folder, name
) -> None:
    outside = folder / "outside.toml"
    scan = folder / "scan"
    scan.mkdir()
    (scan / name).symlink_to(outside)
    with pytest.raises(FormatError, match=f"{name} is a link to .*outside.toml, which"):
        acquisition.acquire(small, scan, settings=settings, scene=scene_light)
    assert not outside.exists()
