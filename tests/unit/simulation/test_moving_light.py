"""Light from a simulated vehicle by the time of its scan, and what is remembered."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.simulation import ClosureModel, expectation, scene_light
from amulor.simulation.geometry import Setup, trace
from amulor.simulation.vehicle import VehicleMotion
from amulor.survey import Survey

MODEL = ClosureModel()
#: A vehicle that hardly moves.
STILL = {
    "platform.course": {"kind": "hover", "start": (0.0, 0.0, 0.0)},
    "platform.disturbance": {"period": 600.0},
}


@pytest.fixture(scope="module")
def survey(plate: Survey) -> Survey:
    """Return a plate that a vehicle passes at 0.2 m/s, in 0.8 s."""
    return plate.with_(
        {
            "scan.columns": 5,
            "scan.rows": 4,
            "scan.dwell": 0.02,
            "instrument.lock_in.time_constant": 2e-3,
            "targets.0.width": 9.0,
            "targets.0.height": 9.0,
            "pose": {"pitch": -np.pi / 2},
            "platform": {
                "course": {"kind": "line", "start": (0.0, 0.0, 0.0), "speed": 0.2},
                "mounting": {"pitch": -np.pi / 2, "clock_offset": 0.5,
                             "clock_drift": 1e-3},
                "navigation": {"interval": 0.1},
            },
        }
    )  # fmt: skip


@pytest.fixture(scope="module")
def moving(survey: Survey) -> Any:
    light = scene_light(survey, model=MODEL)
    assert light.vehicle is not None
    return light.vehicle(3, 2.0)


def test_light_is_computed_every_three_millimeters(survey: Survey, moving: Any) -> None:
    assert moving._step == pytest.approx(3e-3 / 0.2)
    for changes, step in (
        # A period of 2 s allows 10 ms; 0.15 m/s of current 3 mm in 8.6 ms.
        ({"platform.disturbance": {"period": 2.0}}, 0.01),
        ({"platform.disturbance": {"current": (0.15, 0.0, 0.0)}}, 3e-3 / 0.35),
        (STILL, 0.2),
        ({**STILL, "scan.rows": 1, "scan.columns": 1}, 0.04),
    ):  # fmt: skip
        found = scene_light(survey.with_(changes), model=MODEL).vehicle
        assert found is not None
        assert found(3, 0.0)._step == pytest.approx(step)


def test_light_lies_between_that_of_two_times(survey: Survey, moving: Any) -> None:
    step = moving._step
    setup = Setup(survey, VehicleMotion.of(survey, 3))
    azimuth, elevation = (angle[1:2] for angle in moving._directions)
    # 2 s before the start of the course, plus ten steps and a quarter.
    found = moving.light(10.25 * step, 5 + 3)
    assert_allclose(found.azimuth, azimuth[0, 3:4])
    assert_allclose(found.elevation, elevation[0, 3:4])
    assert found.target.shape == found.water.shape == (1, 2, 1)
    rows = []
    for number in (10, 11):
        time = np.full(azimuth.shape, number * step - 2.0)
        depth = trace(setup, directions=(azimuth, elevation, time))
        rows.append(depth.slant_range[0, 3])
    assert abs(rows[1] - rows[0]) < 3e-3
    parts = [moving._row(1, number)[..., 3] for number in (10, 11)]
    expected = 0.75 * parts[0] + 0.25 * parts[1]
    assert_allclose(found.target[..., 0], expected[0])
    assert_allclose(found.water[..., 0], expected[1])
    assert_allclose(found.target_rate[..., 0], expected[2].real)
    assert_allclose(found.water_rate[..., 0], expected[3].real)
    assert np.all(found.target_rate > 0)


def test_rows_are_computed_once_and_the_oldest_is_forgotten(
    survey: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = importlib.import_module("amulor.simulation.scene_light")
    light = scene_light(survey, model=MODEL).vehicle
    assert light is not None
    fresh = light(3, 2.0)
    calls: list[Any] = []
    real = module._with_target

    def counted(*arguments: Any) -> Any:
        calls.append(arguments)
        return real(*arguments)

    monkeypatch.setattr(module, "_with_target", counted)
    monkeypatch.setattr(module, "_MOST_ROWS", 2)
    first = fresh._row(0, 5)
    assert fresh._row(0, 5) is first
    assert len(calls) == 1
    fresh._row(1, 5)
    assert list(fresh._rows) == [(0, 5), (1, 5)]
    fresh._row(0, 6)
    assert list(fresh._rows) == [(1, 5), (0, 6)]
    assert len(calls) == 3


def test_messages_arrive_by_the_clock_of_the_scan(survey: Survey, moving: Any) -> None:
    # Messages every 0.1 s, from ten before the start; the scan begins 2 s earlier.
    found = moving.messages(2.05, 2.35)
    assert [time for time, _ in found] == pytest.approx([2.1, 2.2, 2.3])
    track = VehicleMotion.of(survey, 3).measured(lead=2.0)
    for (_, text), time in zip(found, (2.1, 2.2, 2.3), strict=True):
        stamp = time * 1.001 + 0.5
        near = int(np.argmin(np.abs(track.time - stamp)))
        assert track.time[near] == pytest.approx(stamp)
        assert f"{track.time[near]:.3f}"[:5] in text
    assert moving.messages(2.05, 2.05) == []
    at = moving.messages(2.1 - 1e-6, 2.2 - 1e-6)
    assert len(at) == 1
    # Four times the planned 0.8 s and ten minutes, with ten messages beyond.
    last = moving.messages(0.0, 1e9)[-1][0]
    assert last == pytest.approx(2 + 4 * 0.8 + 600 + 1.0, abs=0.11)


def test_a_vehicle_has_the_directions_of_the_scan_and_no_light_of_its_own(
    survey: Survey,
) -> None:
    found = scene_light(survey, model=MODEL)
    standing = trace(Setup(survey.with_({"platform": None})))
    azimuth, elevation = standing.azimuth.ravel(), standing.elevation.ravel()
    assert_array_equal(found.with_target.azimuth, azimuth)
    assert_array_equal(found.with_target.elevation, elevation)
    assert found.with_target.water is found.open_water.water


def test_an_expectation_uses_25_beams_along_each_side(plate: Survey) -> None:
    # 5 cm at 1.5 m are 33 of 66 mrad: 13 of 25 columns.
    narrow = {"targets.0.width": 0.05, "targets.0.height": 9.0}
    wide = plate.with_({**narrow, "scan.columns": 60, "scan.rows": 2})
    found = expectation(wide, model=MODEL)
    few = expectation(wide.with_({"scan.columns": 25}), model=MODEL)
    assert_allclose(found.signal_to_noise, few.signal_to_noise)
    assert found.hit == few.hit == pytest.approx(13 / 25)
    assert found.hit_each == (found.hit,)
    assert found.saturated == 0
    # 2 cm at 1.5 m are 13.3 mrad, twelve steps of 1.11 mrad: 11 of 25 rows.
    low = {"targets.0.width": 9.0, "targets.0.height": 0.02}
    tall = plate.with_({**low, "scan.columns": 2, "scan.rows": 60})
    assert expectation(tall, model=MODEL).hit == pytest.approx(11 / 25)
    wall = {"kind": "plate", "position": (0.0, 0.0, 2.0), "width": 9.0, "height": 9.0,
            "reflectance": 0.1}  # fmt: skip
    targets = [*(target.model_dump() for target in wide.targets), wall]
    both = expectation(wide.with_({"targets": targets}), model=MODEL)
    assert both.hit == 1
    assert both.hit_each == pytest.approx((13 / 25, 12 / 25))
    none = expectation(
        plate.with_({"targets": [], "scan.columns": 2, "scan.rows": 1}), model=MODEL
    )
    assert (none.hit, none.hit_each) == (0, ())
    assert np.isnan(none.signal_to_noise).all()
    assert np.isnan(none.water_to_echo).all()
    assert none.signal_to_noise.shape == (1, 2)
