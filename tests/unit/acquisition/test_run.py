"""A scan takes what is missing, survives what goes wrong, and leaves devices safe."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from amulor import acquisition, io
from amulor.acquisition import plan
from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.connect import connect
from amulor.acquisition.devices import Devices
from amulor.acquisition.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Settings
from amulor.errors import AmulorError, FormatError, InstrumentError, SurveyError
from amulor.survey import Survey


def made(settings: Settings, **parts: dict) -> Settings:
    content = settings.model_dump(exclude_unset=True)
    for name, part in parts.items():
        content[name] = {**content.get(name, {}), **part}
    return Settings.model_validate(content)


def safe(devices: Devices) -> bool:
    """Return whether the last thing that each device was told was to be safe."""
    last = {name: device.log[-1] for name, device in devices.all()}
    return last.pop("laser") == "off" and {*last.values()} == {"safe"}


class Stop:
    """Pauses once before a sample, and then goes on or not."""

    def __init__(self, at: int, *, go_on: bool) -> None:
        self.left, self._go_on, self.asked = at, go_on, 0

    def pause_wanted(self) -> bool:
        self.left -= 1
        return self.left == -1

    def go_on(self) -> bool:
        self.asked += 1
        return self._go_on


def test_a_scan_takes_every_planned_sample_once_in_order(
    small, settings, folder
) -> None:
    told: list[plan.Key] = []
    progress: list[acquisition.Progress] = []
    outcome = acquisition.acquire(
        small, folder, settings=settings, acknowledged=told.append,
        progress=progress.append,
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
    small, settings, folder
) -> None:
    devices = connect(small, settings)
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


@pytest.mark.parametrize("at", range(0, 62, 5))
def test_a_scan_stopped_at_any_sample_resumes_to_the_whole(
    small, settings, folder, at
) -> None:
    devices = connect(small, settings)
    control = Stop(at, go_on=False)
    first = acquisition.acquire(
        small, folder, settings=settings, devices=devices, control=control
    )
    assert (first.finished, first.done, control.asked) == (False, at, 1)
    assert safe(devices)
    told: list[plan.Key] = []
    second = acquisition.acquire(
        small, folder, settings=settings, resume=True, acknowledged=told.append
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
    small, settings, folder
) -> None:
    devices = connect(small, settings)
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


def test_resuming_a_finished_scan_takes_nothing(small, settings, folder) -> None:
    acquisition.acquire(small, folder, settings=settings)
    told: list[plan.Key] = []
    devices = connect(small, settings)
    again = acquisition.acquire(
        small, folder, settings=settings, resume=True, acknowledged=told.append,
        devices=devices,
    )  # fmt: skip
    assert again.finished
    assert told == []
    assert safe(devices)


def test_a_resumed_scan_is_an_uninterrupted_one_within_noise(
    small, settings, folder
) -> None:
    whole, broken = folder / "whole", folder / "broken"
    acquisition.acquire(small, whole, settings=settings)
    for number, at in enumerate((25, 40, 30)):
        acquisition.acquire(
            small, broken, settings=settings, resume=number > 0,
            control=Stop(at, go_on=False),
        )  # fmt: skip
    acquisition.acquire(small, broken, settings=settings, resume=True)
    first, second = (
        io.read_cube(acquisition.recover(place)) for place in (whole, broken)
    )
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


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        ("lost-link@30", "link is lost"),
        ("timeout@30", "does not answer in time"),
        ("unlock@30x99", "lost its reference in 4 samples"),
        ("stuck@30x99999", "has not come to where it was sent"),
        ("saturation@30x99", "6 samples in a row are overloaded"),
        ("overload@30x99", "6 samples in a row are overloaded"),
    ],
)
def test_a_fault_pauses_keeps_the_data_and_tells_the_next_step(
    small, settings, folder, fault, text
) -> None:
    own = made(
        settings, simulation={"faults": [fault]}, procedure={"patience": 5},
    )  # fmt: skip
    devices = connect(small, own)
    told: list[plan.Key] = []
    with pytest.raises(InstrumentError, match=text) as caught:
        acquisition.acquire(
            small, folder, settings=own, devices=devices, acknowledged=told.append
        )
    assert safe(devices)
    assert f"{len(told)} samples are kept in {folder}" in str(caught.value)
    assert "--resume" in str(caught.value)
    assert "\n" not in str(caught.value)
    with Journal.read(folder) as journal:
        assert journal.keys() == {*told}
        (part,) = journal.segments()
    assert text in part["reason"]
    # The fault was in the simulated devices, not in what makes up the instrument.
    whole = acquisition.acquire(
        small, folder, settings=made(own, simulation={"faults": []}), resume=True
    )
    assert whole.finished


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, MemoryError])
def test_devices_are_safe_after_any_exception(small, settings, folder, error) -> None:
    devices = connect(small, settings)

    def fail(key: plan.Key) -> None:
        if key.kind == SCAN:
            raise error

    with pytest.raises(error):
        acquisition.acquire(
            small, folder, settings=settings, devices=devices, acknowledged=fail
        )
    assert safe(devices)
    with Journal.read(folder) as journal:
        assert error.__name__ in journal.segments()[0]["reason"]


def test_one_device_that_cannot_be_made_safe_does_not_keep_the_others(
    small, settings, folder, monkeypatch
) -> None:
    devices = connect(small, settings)

    def refuse() -> None:
        raise InstrumentError("it does not listen")

    monkeypatch.setattr(devices.scanner, "make_safe", refuse)
    outcome = acquisition.acquire(small, folder, settings=settings, devices=devices)
    assert outcome.unsafe == ["scanner could not be made safe: it does not listen"]
    assert not devices.lock_in.bench.laser_on
    assert devices.lock_in.log[-1] == "safe"


def test_a_lost_reference_is_waited_out_and_noted(small, settings, folder) -> None:
    own = made(settings, simulation={"faults": ["unlock@30x2"]})
    acquisition.acquire(small, folder, settings=own)
    cube = io.read_cube(acquisition.recover(folder))
    flags = cube["user_sample_flag"].values
    assert np.count_nonzero(flags & SampleFlag.REPEATED) == 1
    assert np.isfinite(cube["in_phase"]).all()
    assert not cube["saturated"].any()


def test_room_is_made_for_an_overload_that_stays(small, settings, folder) -> None:
    devices = connect(small, settings)
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
    small, settings, folder
) -> None:
    own = made(settings, simulation={"faults": ["saturation@30x3"]})
    acquisition.acquire(small, folder, settings=own)
    cube = io.read_cube(acquisition.recover(folder))
    assert int(cube["saturated"].sum()) == 3
    from amulor import rejection
    from amulor.cube import QualityFlag

    flags = rejection.open_water(cube)["quality_flag"].values
    assert np.count_nonzero(flags & QualityFlag.SATURATED) == 3


def test_a_beam_off_its_place_is_flagged_and_where_it_was_is_kept(
    small, settings, folder
) -> None:
    own = made(settings, simulation={"position_error": 1e-3})
    acquisition.acquire(small, folder, settings=own)
    cube = io.read_cube(acquisition.recover(folder))
    off = cube["azimuth"] - cube["user_commanded_azimuth"]
    # The mean of two channels of errors of 1 mrad.
    assert 0.3e-3 < float(off.std()) < 1.2e-3
    flagged = cube["user_sample_flag"].values & SampleFlag.OFF_POSITION
    assert np.count_nonzero(flagged) > 0.8 * flagged.size


def test_a_changed_survey_or_instrument_is_refused(small, settings, folder) -> None:
    acquisition.acquire(small, folder, settings=settings, control=Stop(30, go_on=False))
    other = small.model_copy(update={"name": "Another one"})
    with pytest.raises(SurveyError, match="another survey"):
        acquisition.acquire(other, folder, settings=settings, resume=True)
    changed = made(settings, procedure={"settling": 7.0})
    with pytest.raises(InstrumentError, match="another procedure"):
        acquisition.acquire(small, folder, settings=changed, resume=True)
    # Where a device is reached is no part of what it is.
    moved = made(settings, lock_in={"timeout": 9.0}, simulation={"seed": 5})
    assert acquisition.acquire(small, folder, settings=moved, resume=True).finished


def test_a_state_without_an_angle_is_told(small, settings, folder) -> None:
    instrument = small.instrument.model_copy(update={"polarizations": ("RL",)})
    survey = small.model_copy(update={"instrument": instrument})
    with pytest.raises(InstrumentError, match=r"add launch\.angles\.R"):
        acquisition.acquire(survey, folder, settings=settings)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="permissions of another kind")
def test_a_folder_that_cannot_be_written_is_told_before_light_goes_on(
    small, settings, folder
) -> None:
    blocked = folder / "file"
    blocked.write_text("no folder")
    devices = connect(small, settings)
    with pytest.raises(FormatError, match="cannot be made"):
        acquisition.acquire(small, blocked, settings=settings, devices=devices)
    assert "on" not in devices.laser.log


def test_a_journal_that_can_no_longer_be_written_ends_the_scan_safely(
    small, settings, folder, monkeypatch
) -> None:
    devices = connect(small, settings)
    commit = Journal.commit

    def full(journal: Journal, key, record) -> None:
        if journal.count() >= 20:
            journal._connection.execute("PRAGMA query_only = ON")
        commit(journal, key, record)

    monkeypatch.setattr(Journal, "commit", full)
    with pytest.raises(FormatError, match=r"20 samples are kept .* --resume"):
        acquisition.acquire(small, folder, settings=settings, devices=devices)
    assert safe(devices)
    monkeypatch.undo()
    assert acquisition.acquire(small, folder, settings=settings, resume=True).finished


def test_recovering_nothing_is_told(small, settings, folder: Path) -> None:
    with pytest.raises(AmulorError, match="no journal"):
        acquisition.recover(folder)
    acquisition.acquire(small, folder, settings=settings, control=Stop(2, go_on=False))
    with pytest.raises(AmulorError, match="no sample of the scan yet"):
        acquisition.recover(folder)


def test_the_clock_of_the_scan_counts_settling_and_dwell(
    small, settings, folder
) -> None:
    devices = connect(small, settings)
    assert isinstance(devices.clock, VirtualClock)
    acquisition.acquire(small, folder, settings=settings, devices=devices)
    samples = plan.count(small, settings.procedure)
    # Five time constants of 10 ms for each sample, and the moves of target and mounts.
    assert samples * 0.05 < devices.clock.now() < samples * 0.05 + 15


def test_surveys_without_open_water_are_scanned_too(
    small: Survey, settings, folder
) -> None:
    scan = small.scan.model_copy(update={"open_water": None})
    survey = small.model_copy(update={"scan": scan})
    assert acquisition.acquire(survey, folder, settings=settings).finished
    cube = io.read_cube(acquisition.recover(folder))
    assert cube.amulor.open_water is None
