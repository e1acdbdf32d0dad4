"""A beam that never stops: rows come out unbiased, within their errors, and in time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from driven_devices import wired_sr865a
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.bluesky import ScanDevice
from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.connect import connect, simulated_bench
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN, steps, strips
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Settings
from amulor.errors import InstrumentError, SurveyError
from amulor.survey import Survey

CONTINUOUS = {
    "output_filter": "known", "readings": "buffer", "mode": "continuous",
    "dark_readings": 1, "references": 1,
}  # fmt: skip
#: Parts of a pixel that the scene is known by.
PARTS = 7


def finer(survey: Survey):
    """Return the light of a survey, its pixels divided into parts along a row."""
    scan = survey.scan
    pitch = scan.azimuth_span / (scan.columns - 1)
    span = scan.azimuth_span + pitch * (PARTS - 1) / PARTS
    return scene_light(
        survey.with_({"scan.columns": scan.columns * PARTS, "scan.azimuth_span": span})
    )


def mean_light(survey: Survey, cube, wide: float = 1.0) -> np.ndarray:
    """Return what pixels so many columns wide see, from the scene alone [V]."""
    azimuth, elevation = cube["azimuth"].values, cube["elevation"].values
    light = finer(survey).with_target
    level = (light.target + light.water)[0, 0]
    pitch = survey.scan.azimuth_span / (survey.scan.columns - 1)
    found = np.empty(azimuth.shape, dtype=complex)
    rows = np.unique(light.elevation)
    for at in np.ndindex(azimuth.shape):
        row = rows[np.argmin(np.abs(rows - elevation[at]))]
        there = np.flatnonzero(light.elevation == row)
        there = there[np.argsort(light.azimuth[there])]
        middle = light.azimuth[there]
        borders = np.concatenate([[-9.0], (middle[1:] + middle[:-1]) / 2, [9.0]])
        low, high = (azimuth[at] + way * wide * pitch / 2 for way in (-1, 1))
        share = np.minimum(borders[1:], high) - np.maximum(borders[:-1], low)
        found[at] = np.clip(share, 0, 9) / (wide * pitch) @ level[there]
    return found


@pytest.fixture
def edges(small: Survey) -> Survey:
    """Return a narrow bright plate in front of calm water, pixels with its edges."""
    return small.with_(
        {
            "scan.columns": 24,
            "scan.rows": 4,
            "scan.order": "serpentine",
            "scan.dwell": "50 ms",
            "instrument.polarizations": ["VH"],
            "instrument.modulation_frequencies": ["3.9 MHz"],
            "instrument.lock_in.time_constant": "10 ms",
            "instrument.lock_in.phase_floor": "0 rad",
            "water.signal_fluctuation": "0 %",
            "targets": [
                {"kind": "plate", "position": ["0 m", "0 m", "1.5 m"],
                 "width": "3.1 cm", "height": "30 cm", "reflectance": 0.5},
            ],
        }
    )  # fmt: skip


def made(**parts: dict) -> Settings:
    return Settings.model_validate({"procedure": CONTINUOUS, **parts})


def taken(survey: Survey, folder: Path, **devices) -> list:
    """Return key and record of a scan that was finished."""
    settings = devices.pop("settings", made())
    outcome = acquisition.acquire(survey, folder, settings=settings, **devices)
    assert outcome.finished
    with Journal.read(folder) as journal:
        return [*journal.samples(SCAN)]


def pulls(survey: Survey, cube, samples) -> np.ndarray:
    """Return departures of in phase and quadrature in standard errors."""
    # By the interval that was recorded: so long was each pixel looked at.
    (long,) = {round(one.readings * one.interval, 6) for _, one in samples}
    truth = mean_light(survey, cube, long / survey.scan.dwell)
    found = (cube["in_phase"] + 1j * cube["quadrature"]).values[0, 0]
    return np.stack(
        [
            (found - truth).real / cube["in_phase_uncertainty"].values[0, 0],
            (found - truth).imag / cube["quadrature_uncertainty"].values[0, 0],
        ]
    )


def test_rows_without_stops_are_unbiased_at_edges_within_stated_errors(
    edges, folder, cube_of
) -> None:
    found = []
    for seed in range(2):
        place = folder / str(seed)
        settings = made(simulation={"seed": seed})
        samples = taken(edges, place, settings=settings, scene=finer)
        cube = cube_of(place)
        found.append(pulls(edges, cube, samples))
    values = np.stack(found)
    truth = mean_light(edges, cube)
    # Where neighbours differ by more than a hundred standard errors.
    steps_there = np.abs(np.diff(truth, axis=1)) > 100 * float(
        cube["in_phase_uncertainty"].mean()
    )
    at_edge = np.zeros(truth.shape, dtype=bool)
    at_edge[:, 1:] |= steps_there
    at_edge[:, :-1] |= steps_there
    assert at_edge.sum() >= 8
    edge = values[:, :, at_edge]
    for some in (values, edge):
        # Five standard errors of a mean and of a deviation of so many normal numbers.
        assert abs(some.mean()) < 5 / np.sqrt(some.size)
        assert abs(some.std() - 1) < 5 / np.sqrt(2 * some.size)
    assert np.abs(values).max() < 5


@pytest.mark.slow
@pytest.mark.parametrize("late", [1e-4, 1e-3])
def test_the_buffer_of_an_sr865a_and_stages_give_the_same(
    edges, folder, cube_of, late
) -> None:
    devices, _ = wired_sr865a(edges, made(), scene=finer, late=late)
    samples = taken(edges, folder, devices=devices)
    cube = cube_of(folder)
    values = pulls(edges, cube, samples)
    assert abs(values.mean()) < 5 / np.sqrt(values.size)
    assert abs(values.std() - 1) < 5 / np.sqrt(2 * values.size)
    assert np.abs(values).max() < 5
    assert not cube["user_sample_flag"].values.any() & ~int(SampleFlag.RESCALED)
    asked = cube["user_commanded_azimuth"].values
    pitch = edges.scan.azimuth_span / (edges.scan.columns - 1)
    assert np.abs(cube["azimuth"].values - asked).max() < 0.1 * pitch


@pytest.mark.slow
@pytest.mark.parametrize("late", [1e-4, 1e-3])
@pytest.mark.parametrize(
    ("dwell", "constant"), [("10 ms", "1 ms"), ("100 ms", "10 ms")]
)
def test_a_wire_of_any_length_leaves_85_percent_of_the_time(
    edges, folder, late, dwell, constant
) -> None:
    survey = edges.with_(
        {
            "scan.columns": 20,
            "scan.dwell": dwell,
            "instrument.lock_in.time_constant": constant,
        }
    )
    devices, _ = wired_sr865a(survey, made(), scene=scene_light, late=late)
    told: list[float] = []
    taken(
        survey, folder, devices=devices,
        acknowledged=lambda key: (
            told.append(devices.clock.now()) if key.kind == SCAN else None
        ),
    )  # fmt: skip
    # From the end of the first row to that of the last one.
    rows = survey.scan.rows - 1
    part = rows * 20 * survey.scan.dwell / (told[-1] - told[19])
    print(f"{dwell}, {late * 1e3:g} ms each way: {part:.1%}")
    # White noise behind intervals of a quarter of a time constant counts for 99.5 %.
    assert part * 0.995 > 0.85


def test_what_the_beam_passes_stays_in_the_filter(edges) -> None:
    clock = VirtualClock()
    settings = made(simulation={"position_error": "0 rad"})
    survey = edges.with_({"instrument.power": "20 kW"})
    survey = survey.with_({"instrument.detector.volt_per_photoelectron_rate": 8e-18})
    bench = simulated_bench(survey, settings, scene=scene_light, clock=clock)
    bench.set_laser(True)
    bench.send({"azimuth": -0.04, "elevation": 0.0, "analyser": np.pi / 2}, speed=9.0)
    clock.sleep(1.0)
    (before,), _ = bench.outputs()
    # Across the plate to the water on its other side, in half a time constant.
    bench.send({"azimuth": 0.04}, speed=0.08 / 5e-3)
    clock.sleep(2.5e-3)
    assert bench.place("azimuth") == pytest.approx(0.0, abs=1e-12)
    clock.sleep(2.5e-3)
    (after,), _ = bench.outputs()
    clock.sleep(1.0)
    (far,), _ = bench.outputs()
    # The plate has been seen for a part of the way, and most of that is kept.
    assert abs(after - before) > 10 * abs(far - before)


def test_the_way_is_divided_where_the_nearest_place_changes(edges) -> None:
    light = scene_light(edges)
    from amulor.acquisition.simulated.scene import Places

    places = Places(light.with_target)
    start, end = complex(-0.03, 0.011), complex(0.035, -0.004)
    passed = places.passed(start, end)
    rng = np.random.default_rng(2)
    borders = [part for part, _ in passed]
    assert borders == sorted(borders)
    for part in rng.uniform(0, 1, 300):
        where = start + part * (end - start)
        nearest = int(np.argmin(np.abs(places._direction - where)))
        seen = [number for border, number in passed if border <= part]
        first = int(np.argmin(np.abs(places._direction - start)))
        assert abs(places._direction[seen[-1] if seen else first] - where) <= (
            abs(places._direction[nearest] - where) + 1e-12
        )


@pytest.mark.parametrize(
    ("fault", "flag"),
    [("unlock@30x2", SampleFlag.REPEATED), ("overload@30", SampleFlag.OVERLOAD)],
)
def test_a_spoiled_row_is_taken_again_or_flagged(edges, folder, fault, flag) -> None:
    settings = made(simulation={"faults": (fault,)})
    found = taken(edges, folder, settings=settings, scene=scene_light)
    flagged = [key for key, record in found if record.flags & flag]
    rows = {key.row for key in flagged}
    assert len(rows) == 1
    # A lost reference spoils the row, an overload the pixels that it was in.
    assert len(flagged) == 24 if flag == SampleFlag.REPEATED else len(flagged) < 5


def test_a_reference_that_does_not_come_back_ends_the_scan(edges, folder) -> None:
    settings = made(simulation={"faults": ("unlock@30x99999",)})
    with pytest.raises(InstrumentError, match="lost its reference in 4 samples"):
        acquisition.acquire(edges, folder, settings=settings, scene=scene_light)


def test_an_interlock_that_opens_ends_the_row_and_nothing_of_it_is_kept(
    edges, folder
) -> None:
    settings = made(simulation={"faults": ("interlock@60x9999",)})
    devices = connect(edges, settings, scene=scene_light)
    with pytest.raises(InstrumentError, match="interlock"):
        acquisition.acquire(edges, folder, settings=settings, devices=devices)
    assert devices.laser.log[-1] == "off"
    with Journal.read(folder) as journal:
        whole = [key for key, _ in journal.samples(SCAN)]
    assert len(whole) % 24 == 0
    assert len(whole) < 96
    settings = made()
    with pytest.raises(InstrumentError, match="not come"):
        acquisition.acquire(
            edges, folder / "stuck", scene=scene_light,
            settings=made(
                simulation={"faults": ("stuck@40x99999",)},
                scanner={"move_timeout": "1 s"},
            ),
        )  # fmt: skip


def test_a_pause_between_rows_is_gone_on_with(edges, folder, Stop) -> None:
    outcome = acquisition.acquire(
        edges, folder, settings=made(), scene=scene_light, control=Stop(9, go_on=False)
    )
    assert not outcome.finished
    assert acquisition.acquire(
        edges, folder, settings=made(), scene=scene_light, resume=True
    ).finished
    with Journal.read(folder) as journal:
        assert len({key for key, _ in journal.samples(SCAN)}) == 24 * 4


def test_rows_are_put_together_from_neighbours(edges) -> None:
    settings = made()
    planned = [*steps(edges, settings.procedure)]
    rows = [one for one in strips(planned, longest=99) if len(one) > 1]
    assert [len(row) for row in rows] == [24] * 4
    assert rows[1][0].key.column == 23
    # Two that are missing in the middle divide a row.
    left = [step for step in planned if step.key.column not in (7, 8)]
    parts = [one for one in strips(left, longest=99) if one[0].key.kind == SCAN]
    assert [len(part) for part in parts] == [7, 15, 15, 7] * 2
    assert {len(part) for part in strips(planned, longest=10)} == {1, 10, 4}


def test_what_cannot_move_along_a_row_is_refused(edges, folder) -> None:
    with pytest.raises(ValueError, match="output_filter"):
        Settings.model_validate({"procedure": {"mode": "continuous"}})
    with pytest.raises(ValueError, match="run_up is that of"):
        Settings.model_validate({"procedure": {"run_up": "1 ms"}})
    one = edges.with_({"scan.columns": 1})
    with pytest.raises(SurveyError, match="no way to move along a row"):
        acquisition.acquire(one, folder / "one", settings=made(), scene=scene_light)
    with pytest.raises(InstrumentError, match="waits for each sample"):
        ScanDevice(edges, folder / "plan", settings=made())
    devices = connect(edges, made(), scene=scene_light)
    words = ("begin_sweep", "where")

    class Still:
        def __getattr__(self, name: str) -> Callable:
            if name in words:
                raise AttributeError(name)
            return getattr(devices.scanner, name)

    still = type(devices)(**{**vars(devices), "scanner": Still()})
    with pytest.raises(InstrumentError, match="has no begin_sweep, where"):
        acquisition.acquire(edges, folder / "still", settings=made(), devices=still)
