"""Errors of a vehicle's sensors and mounting one by one, and its clocks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from amulor.errors import SurveyError
from amulor.simulation.scene import Hits
from amulor.simulation.vehicle import Placed, Standing, VehicleMotion
from amulor.survey import Survey

SPEED, INTERVAL = 0.3, 0.2
#: Pixels of 5 x 4, 20 ms for each of two channels: 0.8 s.
DURATION = 0.8


def motion(plate: Survey, seed: int = 4, **platform: Any) -> VehicleMotion:
    navigation = {"interval": INTERVAL} | platform.pop("navigation", {})
    course = {
        "kind": "line", "start": (0.0, 0.0, -8.0), "heading": 0.6, "speed": SPEED
    }  # fmt: skip
    survey = plate.with_(
        {
            "scan.columns": 5,
            "scan.rows": 4,
            "scan.dwell": 0.02,
            "instrument.lock_in.time_constant": 2e-3,
            "platform": {"course": course, "navigation": navigation, **platform},
        }
    )
    return VehicleMotion.of(survey, seed)


@pytest.fixture(scope="module")
def exact(plate: Survey) -> Any:
    return motion(plate).measured()


def errors(
    plate: Survey, exact: Any, seed: int = 4, **navigation: float
) -> tuple[Any, ...]:
    """Return errors of position and attitude, time and way so far, and covariance."""
    track = motion(plate, seed, navigation=navigation).measured()
    turn = Rotation.from_quat(track.attitude) * Rotation.from_quat(exact.attitude).inv()
    position = track.position - exact.position
    since = exact.time - exact.time[0]
    away = exact.position - exact.position[0]
    return position, turn.as_rotvec(), since, away, track.covariance


def test_messages_are_ten_before_and_after_the_scan(plate: Survey, exact: Any) -> None:
    found = motion(plate)
    assert found.planned_duration == pytest.approx(DURATION)
    assert_allclose(exact.time, INTERVAL * np.arange(-10, 15))
    # 1.1 s is five and a half intervals.
    later = found.measured(lead=1.1, duration=0.5)
    assert_allclose(later.time, INTERVAL * np.arange(-16, 14) + 1.1)
    assert_allclose(later.position[6:21], exact.position[:15])
    assert later.longest_gap == exact.longest_gap
    assert not exact.covariance.any()


def test_a_course_runs_by_its_speed_and_heading(exact: Any) -> None:
    expected = SPEED * exact.time[:, None] * [np.sin(0.6), np.cos(0.6), 0]
    assert_allclose(exact.position - [0, 0, -8], expected, atol=1e-12)


def test_a_constant_error_of_the_position_is_the_same_in_all_messages(
    plate: Survey, exact: Any
) -> None:
    position, turn, _, _, covariance = errors(plate, exact, position_uncertainty=0.02)
    assert_allclose(np.ptp(position, axis=0), 0, atol=1e-12)
    assert len(np.unique(position[0].round(12))) == 3
    assert np.all(np.abs(position[0]) < 0.08)
    assert_allclose(turn, 0, atol=1e-12)
    expected = np.diag([4e-4] * 3 + [0] * 3)
    assert_allclose(covariance, np.broadcast_to(expected, covariance.shape), atol=1e-18)


def test_an_error_of_the_velocity_grows_from_the_first_message(
    plate: Survey, exact: Any
) -> None:
    position, _, since, _, covariance = errors(plate, exact, velocity_uncertainty=0.05)
    assert_allclose(position, np.outer(since, position[-1] / since[-1]), atol=1e-12)
    assert np.all(np.abs(position[-1]) > 0)
    for axis in range(3):
        assert_allclose(covariance[:, axis, axis], (0.05 * since) ** 2)
    assert not covariance[:, 3:, 3:].any()
    assert covariance[-1, 0, 1] == 0


def test_an_error_of_the_scale_lies_along_the_way(plate: Survey, exact: Any) -> None:
    position, _, _, away, covariance = errors(plate, exact, scale_uncertainty=0.1)
    factor = position[-1] @ away[-1] / (away[-1] @ away[-1])
    assert factor != 0
    assert_allclose(position, factor * away, atol=1e-12)
    expected = 0.01 * away[:, :, None] * away[:, None, :]
    assert_allclose(covariance[:, :3, :3], expected, atol=1e-18)
    assert not covariance[:, 3:].any()


def test_an_error_of_the_heading_turns_the_course_about_its_start(
    plate: Survey, exact: Any
) -> None:
    position, turn, _, away, covariance = errors(plate, exact, heading_uncertainty=0.01)
    assert_allclose(turn[:, :2], 0, atol=1e-12)
    yaw = turn[0, 2]
    assert yaw != 0
    assert_allclose(turn[:, 2], yaw)
    assert_allclose(position, np.cross([0, 0, yaw], away), atol=1e-12)
    across = np.cross([0, 0, 1], away)
    assert_allclose(
        covariance[:, :3, :3], 1e-4 * across[:, :, None] * across[:, None], atol=1e-18
    )
    assert_allclose(covariance[:, :3, 5], 1e-4 * across, atol=1e-18)
    assert_allclose(covariance[:, 5, 5], 1e-4)


def test_an_error_of_the_level_leans_and_leaves_the_course(
    plate: Survey, exact: Any
) -> None:
    position, turn, _, _, covariance = errors(plate, exact, level_uncertainty=0.02)
    assert_allclose(position, 0, atol=1e-12)
    assert_allclose(np.ptp(turn, axis=0), 0, atol=1e-12)
    assert_allclose(turn[0, 2], 0, atol=1e-12)
    assert np.all(turn[0, :2] != 0)
    expected = np.diag([0, 0, 0, 4e-4, 4e-4, 0])
    assert_allclose(covariance, np.broadcast_to(expected, covariance.shape), atol=1e-18)


@pytest.mark.parametrize(("name", "first"), [("position", 0), ("attitude", 3)])
def test_walks_begin_at_nothing_and_reach_their_size_in_a_minute(
    plate: Survey, exact: Any, name: str, first: int
) -> None:
    part = slice(first, first + 3)
    position, turn, since, _, covariance = errors(
        plate, exact, **{f"{name}_walk": 0.03}
    )
    walked = position if first == 0 else turn
    assert_allclose(walked[0], 0, atol=1e-12)
    assert np.all(walked[1:] != 0)
    expected = 9e-4 * since / 60
    for axis in range(6):
        inside = part.start <= axis < part.stop
        assert_allclose(covariance[:, axis, axis], expected * inside, atol=1e-18)
    steps = []
    for seed in range(20):
        parts = errors(plate, exact, seed, **{f"{name}_walk": 0.03})
        steps.append(np.diff(parts[0 if first == 0 else 1], axis=0))
    # 1,440 steps tell their size to 2 %; angles of a step add up nearly.
    assert np.std(steps) == pytest.approx(0.03 * np.sqrt(INTERVAL / 60), rel=0.08)


@pytest.mark.parametrize(("name", "first"), [("position", 0), ("attitude", 3)])
def test_noise_is_that_of_each_message(
    plate: Survey, exact: Any, name: str, first: int
) -> None:
    position, turn, _, _, covariance = errors(plate, exact, **{f"{name}_noise": 0.004})
    noisy, still = (position, turn) if first == 0 else (turn, position)
    assert_allclose(still, 0, atol=1e-12)
    # 75 numbers: their size to 8 %.
    assert np.std(noisy) == pytest.approx(0.004, rel=0.3)
    assert np.all(np.diff(noisy, axis=0) != 0)
    expected = np.zeros(6)
    expected[first : first + 3] = 1.6e-5
    assert_allclose(
        covariance, np.broadcast_to(np.diag(expected), covariance.shape), atol=1e-18
    )


def test_the_clock_of_the_vehicle_has_an_offset_and_a_drift(
    plate: Survey, exact: Any
) -> None:
    clock = {"clock_offset": 0.7, "clock_drift": 1e-3}
    found = motion(plate, mounting=clock)
    assert_allclose(found.measured().time, exact.time * 1.001 + 0.7)
    later = found.measured(lead=2.0).time
    assert_allclose(later[10:], (exact.time + 2) * 1.001 + 0.7)


def test_the_true_mounting_errs_by_its_uncertainties(plate: Survey) -> None:
    stated = {
        "lever_arm": (0.1, 0.2, 0.3), "lever_arm_uncertainty": 0.01,
        "heading": 0.3, "pitch": 0.2, "roll": 0.1, "boresight_uncertainty": 0.005,
        "clock_offset": 0.5, "clock_uncertainty": 0.02, "clock_drift": 1e-4,
        "clock_drift_uncertainty": 2e-5,
    }  # fmt: skip
    first = motion(plate, mounting=stated)
    mounting = first.platform.mounting
    true = [motion(plate, seed, mounting=stated).mounting for seed in range(150)]
    arm = np.array([each.lever_arm for each in true]) - [0.1, 0.2, 0.3]
    inverse = Rotation.from_rotvec(mounting.boresight).inv()
    bend = np.array(
        [(inverse * Rotation.from_rotvec(each.boresight)).as_rotvec() for each in true]
    )
    offset = np.array([each.clock_offset for each in true]) - 0.5
    drift = np.array([each.clock_drift for each in true]) - 1e-4
    # 150 numbers tell their size to 6 %, and their mean to 8 % of it.
    for values, size in (
        (arm, 0.01), (bend, 0.005), (offset[:, None], 0.02), (drift[:, None], 2e-5)
    ):  # fmt: skip
        assert_allclose(values.std(axis=0), size, rtol=0.25)
        assert_allclose(values.mean(axis=0) / size, 0, atol=0.35)
    eight = np.hstack([arm, bend, offset[:, None], drift[:, None]])
    assert np.abs(np.corrcoef(eight.T) - np.eye(8)).max() < 0.35
    assert first.mounting.lever_arm == motion(plate, mounting=stated).mounting.lever_arm


def test_oscillations_have_periods_within_an_octave_of_theirs(plate: Survey) -> None:
    waves = {"position": 0.1, "heading": 0.2, "pitch": 0.3, "roll": 0.4, "period": 5.0}
    frequency, phase, amplitude = motion(plate, disturbance=waves)._tones
    assert frequency.shape == phase.shape == (6, 6)
    octaves = np.log2(frequency * 5.0 / (2 * np.pi))
    assert octaves.min() > -1
    assert octaves.max() < 1
    assert octaves.min() < -0.6
    assert octaves.max() > 0.6
    assert phase.min() >= 0
    assert 5 < phase.max() < 2 * np.pi
    rms = np.sqrt(6 * amplitude[:, 0] ** 2 / 2)
    assert_allclose(rms, [0.1, 0.1, 0.1, 0.2, 0.3, 0.4])


def test_a_course_needs_a_platform_and_a_seed(plate: Survey) -> None:
    with pytest.raises(SurveyError, match="platform: is missing; state the course"):
        VehicleMotion.of(plate, 1)
    with pytest.raises(SurveyError, match="needs a seed instead of a generator"):
        VehicleMotion.of(motion(plate).survey, np.random.default_rng(1))


def test_a_place_turns_and_shifts_what_its_instrument_sees() -> None:
    turns = Rotation.random(3, rng=1).as_matrix()
    position = np.arange(9.0).reshape(3, 3)
    place = Placed(position, turns)
    points = np.random.default_rng(2).normal(size=(3, 3))
    expected = [turn @ point for turn, point in zip(turns, points, strict=True)]
    assert_allclose(place.directions(points), expected)
    assert_allclose(place.points(points), position + np.array(expected))
    hits = Hits(
        target=np.zeros(3, int), distance=np.ones(3), point=place.points(points),
        normal=place.directions(points), triangle=np.zeros(3, int),
    )  # fmt: skip
    back = place.in_instrument(hits)
    assert_allclose(back.point, points)
    assert_allclose(back.normal, points)
    assert back.distance is hits.distance
    some = place.of(np.array([2, 0]))
    assert_allclose(some.points(points[[2, 0]]), place.points(points)[[2, 0]])
    still = Standing()
    assert still.points(points) is points
    assert still.directions(points) is points
    assert still.in_instrument(hits) is hits
    assert still.of(np.array([1])) is still


def test_a_site_has_the_axes_of_its_pose(plate: Survey) -> None:
    found = motion(plate)
    posed = VehicleMotion.of(
        found.survey.with_({"pose": {"position": (1.0, 2.0, 3.0), "heading": 0.4,
                                     "pitch": -0.3, "roll": 0.2}}), 4
    )  # fmt: skip
    points = np.random.default_rng(1).normal(size=(2, 4, 3))
    there = posed.in_site(points)
    assert there.shape == (2, 4, 3)
    time = np.array([0.0, 0.5])
    origin, turn = posed.instrument(time)
    scene_origin, scene_turn = posed.in_scene(time)
    assert_allclose(posed.in_site(scene_origin), origin, atol=1e-12)
    ahead = posed.in_site(scene_origin + scene_turn[:, :, 2]) - origin
    assert_allclose(ahead, turn[:, :, 2], atol=1e-12)
    lengths = np.linalg.norm(np.diff(there.reshape(-1, 3), axis=0), axis=1)
    assert_allclose(
        lengths, np.linalg.norm(np.diff(points.reshape(-1, 3), axis=0), axis=1)
    )
    assert_array_equal(posed.measured().position, found.measured().position)
