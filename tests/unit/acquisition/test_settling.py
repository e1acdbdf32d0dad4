"""Settling is judged from the samples: short where nothing changes, long at edges."""

from __future__ import annotations

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.connect import connect
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Settings
from amulor.errors import InstrumentError
from amulor.simulation import simulate
from amulor.survey import Survey

JUDGED = {"settled_by": "samples", "dark_readings": 2}
KNOWN = {**JUDGED, "output_filter": "known", "readings": "buffer"}
TAU = 10e-3


@pytest.fixture
def edges(small: Survey) -> Survey:
    """Return a narrow plate in water; each step is far above the noise."""
    return small.with_(
        {
            "scan.columns": 20,
            "scan.rows": 5,
            "scan.dwell": "120 ms",
            "instrument.polarizations": ["VH"],
            "instrument.lock_in.time_constant": "10 ms",
            "instrument.lock_in.phase_floor": "0 rad",
            "instrument.power": "0.2 W",
            "water.signal_fluctuation": "0 %",
            "targets": [
                {"kind": "plate", "position": ["0 m", "0 m", "1.5 m"],
                 "width": "3 cm", "height": "30 cm", "reflectance": 0.5},
            ],
        }
    )  # fmt: skip


def made(procedure: dict, **parts: dict) -> Settings:
    return Settings.model_validate({"procedure": procedure, **parts})


def pulls(survey: Survey, cube) -> np.ndarray:
    """Return departures from what is there, in standard errors, part by part."""
    truth = simulate(survey, rng=1)
    found = []
    for name in ("in_phase", "quadrature"):
        there = truth[f"truth_target_{name}"] + truth[f"truth_water_{name}"]
        found.append(((cube[name] - there) / cube[f"{name}_uncertainty"]).values[0, 0])
    return np.stack(found)


def taken(survey, folder, settings, **more):
    """Return the times that pixels took by the clock of the devices, and records."""
    devices = connect(survey, settings, scene=scene_light)
    if "scanner" in more:
        devices = type(devices)(
            **{**vars(devices), "scanner": more["scanner"](devices)}
        )
    told: list[float] = []
    acquisition.acquire(
        survey, folder, settings=settings, devices=devices,
        acknowledged=lambda key: (
            told.append(devices.clock.now()) if key.kind == SCAN else None
        ),
    )  # fmt: skip
    with Journal.read(folder) as journal:
        return np.diff(told), [record for _, record in journal.samples(SCAN)]


@pytest.mark.slow
def test_steps_are_waited_for_as_long_as_they_are_high(edges, folder, cube_of) -> None:
    found = {}
    for name, procedure in (("judged", JUDGED), ("fixed", {"dark_readings": 2})):
        taken(edges, folder / name, made(procedure))
        found[name] = pulls(edges, cube_of(folder / name))
    # The step at the edge leaves its e^-5 after five time constants.
    assert np.abs(found["fixed"]).max() > 100
    judged = found["judged"]
    assert np.abs(judged).max() < 5
    assert abs(judged.mean()) < 5 / np.sqrt(judged.size)
    assert abs(judged.std() - 1) < 5 / np.sqrt(2 * judged.size)


def test_nothing_is_waited_for_where_neighbours_are_alike(edges, folder) -> None:
    # Neighbours in the water differ by less than the noise, those at the edges by more.
    weak = edges.with_({"instrument.power": "20 uW"})
    times, records = taken(weak, folder, made(JUDGED))
    level = np.abs([complex(one.in_phase, one.quadrature) for one in records])
    step = np.abs(np.diff(level)) > 0.3 * level.max()
    assert 8 <= step.sum() <= 12
    # A dwell is seven time constants after five that are waited: here after three.
    assert np.median(times[~step]) < 10.5 * TAU
    assert times[step].min() > np.median(times[~step]) + 2 * TAU
    flagged = sum(bool(one.flags & SampleFlag.UNSETTLED) for one in records)
    assert flagged == 0


class _Early:
    """A scanner that says that it is there long before it is."""

    def __init__(self, devices) -> None:
        self._own, self._bench = devices.scanner, devices.lock_in.bench

    def __getattr__(self, name: str):
        return getattr(self._own, name)

    def move(self, azimuth: float, elevation: float, *, timeout: float):
        bench = self._bench
        goals = {"azimuth": azimuth, "elevation": elevation}
        way = max(abs(goal - bench.place(name)) for name, goal in goals.items())
        # 22 ms of 120, whatever the way.
        bench.send(goals, speed=max(way, 1e-9) / 22e-3)
        return azimuth, elevation


@pytest.mark.slow
def test_a_stage_that_is_late_is_left_out_where_the_filter_is_known(
    edges, folder, cube_of
) -> None:
    departures = {}
    for name, procedure in (
        ("judged", KNOWN),
        ("trusted", {**KNOWN, "settled_by": None}),
    ):
        _, records = taken(edges, folder / name, made(procedure), scanner=_Early)
        departures[name] = pulls(edges, cube_of(folder / name))
        counts = [record.readings for record in records]
        if name == "judged":
            assert min(counts) <= 100 < max(counts)
            assert not any(one.flags & SampleFlag.UNSETTLED for one in records)
    # A tenth of the dwell sees the last direction: hundreds of standard errors.
    assert np.abs(departures["trusted"]).max() > 50
    assert np.abs(departures["judged"]).max() < 6


@pytest.mark.parametrize("procedure", [JUDGED, KNOWN])
def test_what_never_settles_is_flagged_and_can_be_taken_again(
    edges, folder, procedure
) -> None:
    # The phase turns by half a radian in a dwell, on and on.
    settings = made(procedure, simulation={"phase_drift": "4 rad"})
    times, records = taken(edges, folder, settings)
    level = np.abs([complex(one.in_phase, one.quadrature) for one in records])
    bright = level > 0.5 * level.max()
    flagged = np.array([bool(one.flags & SampleFlag.UNSETTLED) for one in records])
    assert flagged[bright].all()
    assert not flagged[level < 1e-3 * level.max()].any()
    # Four times the longest wait, and the dwell: it ends in any case.
    assert np.quantile(times, 0.95) < (4 * 5 + 10) * TAU
    outcome = acquisition.acquire(
        edges, folder, settings=made(procedure), scene=scene_light, resume=True,
        retake_flagged=True,
    )  # fmt: skip
    assert outcome.finished
    assert outcome.done >= 100 + flagged.sum()


def test_water_that_moves_is_no_filter_that_has_not_settled(edges, folder) -> None:
    settings = made(JUDGED)
    devices = connect(edges, settings, scene=scene_light)
    rng = np.random.default_rng(4)
    read = devices.lock_in.read

    def moving():
        reading = read()
        noise = 3e-6 * complex(*rng.standard_normal(2))
        return type(reading)(**{**vars(reading), "signal": reading.signal + noise})

    devices.lock_in.read = moving
    acquisition.acquire(edges, folder, settings=settings, devices=devices)
    with Journal.read(folder) as journal:
        flags = [record.flags for _, record in journal.samples(SCAN)]
    late = flags[20:]
    assert not any(flag & SampleFlag.UNSETTLED for flag in late)


def test_judging_needs_something_that_settles(edges, folder) -> None:
    with pytest.raises(ValueError, match="nothing settles"):
        made({**KNOWN, "mode": "continuous"})
    devices = connect(edges, made(JUDGED), scene=scene_light)
    devices.lock_in.records = True
    with pytest.raises(InstrumentError, match="nothing to settle"):
        acquisition.acquire(edges, folder, settings=made(JUDGED), devices=devices)
