"""Track, coverage and advice on speed of a running scan from a vehicle."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from amulor import acquisition, simulation
from amulor.acquisition import plan
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.navigation import RecordedTrajectory
from amulor.acquisition.plan import Key
from amulor.acquisition.settings import Settings
from amulor.platform import Trajectory
from amulor.survey import Survey
from amulor.view import page
from amulor.view.page.coverage import Coverage

TOKEN = "a-token-for-tests"
light = functools.partial(simulation.scene_light, model=simulation.ClosureModel())
SPEED, SPAN, COLUMNS, DISTANCE = 0.5, 0.1, 15, 2.0


@pytest.fixture(scope="module")
def survey(plate: Survey) -> Survey:
    """Return a scan from a vehicle that drives north, 2 m above a flat bed."""
    return plate.with_(
        {
            "targets": [
                {
                    "kind": "plate", "position": [0.0, 0.0, DISTANCE],
                    "reflectance": 0.5, "width": 30.0, "height": 30.0,
                }
            ],
            "water.signal_fluctuation": 0.0,
            "instrument.power": 0.02,
            "instrument.polarizations": ["VV"],
            "instrument.modulation_frequencies": [39e6],
            "instrument.lock_in.time_constant": 4e-3,
            "scan.columns": COLUMNS,
            "scan.rows": 6,
            "scan.azimuth_span": SPAN,
            "scan.elevation_span": 0.0,
            "scan.dwell": 0.02,
            "scan.open_water": {"columns": 2, "rows": 1, "repeats": 3},
            "pose": {"position": [0.0, 0.0, -8.0], "pitch": -np.pi / 2},
            "platform": {
                "readings": "at-once",
                "course": {
                    "kind": "line", "start": [0.0, 0.0, -8.0], "heading": 0.0,
                    "speed": SPEED,
                },
                "navigation": {"interval": 0.05},
                "mounting": {"pitch": -np.pi / 2},
            },
        }
    )  # fmt: skip


def scan(
    survey: Survey, folder: Path, acknowledged: Callable[[Key], None] = lambda key: None
) -> None:
    acquisition.acquire(
        survey, folder, settings=Settings.model_validate({"procedure": PROCEDURE}),
        scene=light, acknowledged=acknowledged,
    )  # fmt: skip


#: Each pixel in one stop of 20 ms and a way to the next.
PROCEDURE = {"dark_readings": 2}


@pytest.mark.slow
def test_lines_and_their_density_are_those_of_the_course(
    survey: Survey, folder: Path, served: Callable[..., Any]
) -> None:
    scan(survey, folder)
    live = page.Live(folder)
    live.look()
    assert live.coverage is not None
    live.look()  # once more, with the ranges of all pixels
    live.coverage._next = -np.inf
    live.look()
    live.stop()
    state = live.coverage.state
    client = served(live)
    assert client.get(f"/{TOKEN}/scene").json()["moves"]
    assert client.get(f"/{TOKEN}/coverage").json() == state
    with Journal.read(folder) as journal:
        middle = np.array(
            [r.begin + r.duration / 2 for _, r in journal.samples(plan.SCAN)]
        )
    row = np.diff(middle.reshape(6, COLUMNS).mean(axis=1)).mean()
    assert state["lines"] == 6
    assert state["without_pose"] == 0
    assert state["plan"]
    assert state["between"] == pytest.approx(SPEED * row, rel=1e-3)
    assert state["speed"] == pytest.approx(SPEED, rel=1e-3)
    pitch = DISTANCE * SPAN / (COLUMNS - 1)
    assert state["density"] == pytest.approx(1 / (SPEED * row * pitch), rel=0.01)
    assert state["area"] == pytest.approx(5 * SPEED * row * DISTANCE * SPAN, rel=0.01)
    # The plan counts only the dwells of a row.
    assert state["wanted"] == pytest.approx(SPEED * COLUMNS * 0.02)
    wanted = 1 / (SPEED * COLUMNS * 0.02 * pitch)
    assert state["wanted_density"] == pytest.approx(wanted, rel=0.01)
    np.testing.assert_allclose(
        state["share"], state["density"] / state["wanted_density"], rtol=0.05
    )
    first, last = (np.array(state["footprint"][k]) for k in (0, -1))
    assert np.ptp(first[:, 0]) == pytest.approx(DISTANCE * SPAN, rel=0.01)
    # A vehicle on a straight course to the north.
    assert np.abs(np.array(state["track"])[:, 0]).max() < 1e-6
    assert last[:, 1].mean() - first[:, 1].mean() == pytest.approx(
        5 * SPEED * row, rel=0.01
    )


@pytest.mark.slow
def test_a_vehicle_that_is_too_fast_is_told_so_while_it_drives(
    survey: Survey, folder: Path
) -> None:
    """And no longer after the scan, whose cube states it."""
    found: list[dict[str, Any]] = []
    live: list[page.Live] = []

    def looked(key: Key) -> None:
        if key.kind != plan.SCAN or (key.row, key.column) != (4, 3):
            return
        live.append(page.Live(folder))
        live[0].look()
        found.append(live[0].status)

    scan(survey.with_({"scan.columns": 4}), folder, looked)
    (status,) = found
    assert status["state"] == "running"
    assert status["advice"][0].startswith("too fast: ")
    assert " mm between lines, 40 wanted; drive " in status["advice"][0]
    live[0].coverage._next = -np.inf
    live[0].look()
    live[0].stop()
    assert live[0].status["state"] == "finished"
    assert not any("too fast" in line for line in live[0].status["advice"])


def test_slower_lines_end_the_advice(survey: Survey) -> None:
    """The newest ten lines count, not the median of the scan."""
    wanted = SPEED * COLUMNS * 0.02
    many = survey.with_({"scan.rows": 60})
    north = np.cumsum([0.0, *[2.8 * wanted] * 45, *[wanted] * 15])
    position = np.stack([0 * north, north, -8.0 + 0 * north], axis=-1)
    recorded = RecordedTrajectory(
        trajectory=Trajectory.of_angles(
            time=np.arange(north.size, dtype=float), position=position, heading=0.0
        ),
        mounting=many.platform.mounting, origin=0.0, lines=("navigation: a gap",),
    )  # fmt: skip
    ranges = np.full((60, COLUMNS), DISTANCE)
    coverage = Coverage(many)
    for rows, advice in ((40, True), (59, False)):
        coverage._sum[:rows] = np.arange(rows)[:, None]
        coverage._count[:rows] = 1
        coverage._take_stock(recorded, ranges)
        assert bool(coverage.advice) == advice
        assert coverage.state["lines"] == rows
    assert coverage.state["remarks"] == ["navigation: a gap"]
    # Poses beyond the end have not arrived yet; those before the start are missing.
    coverage._sum[59], coverage._count[59] = 1000.0, 1
    coverage._sum[0] = -5.0
    coverage._take_stock(recorded, ranges)
    assert coverage.state["without_pose"] == COLUMNS


def test_a_side_view_has_up_as_its_axis(survey: Survey) -> None:
    """A vehicle that drives along a wall: the instrument looks to the right."""
    steps = np.arange(8, dtype=float)
    mounting = survey.platform.mounting.model_copy(
        update={"heading": np.pi / 2, "pitch": 0.0}
    )
    recorded = RecordedTrajectory(
        trajectory=Trajectory.of_angles(
            time=steps, position=np.stack([0 * steps, 0.1 * steps, 0 * steps], axis=-1),
            heading=0.0,
        ),
        mounting=mounting, origin=0.0, lines=(),
    )  # fmt: skip
    coverage = Coverage(survey)
    coverage._sum[:] = np.arange(6)[:, None]
    coverage._count[:] = 1
    coverage._take_stock(recorded, np.full((6, COLUMNS), DISTANCE))
    assert not coverage.state["plan"]
    # Seen along the beams (to the east), north is on the left.
    track = np.array(coverage.state["track"])
    np.testing.assert_allclose(track[-1] - track[0], [-0.5, 0.0], atol=1e-3)


def test_a_fixed_instrument_has_no_coverage(
    recording: page.Recording, served: Callable[..., Any]
) -> None:
    client = served(recording)
    assert not client.get(f"/{TOKEN}/scene").json()["moves"]
    answer = client.get(f"/{TOKEN}/coverage")
    assert answer.status_code == 422
    assert "those of a scan from a vehicle" in answer.json()["error"]
