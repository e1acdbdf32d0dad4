"""Pose messages of a journal by hand: order, steady clock, gaps, and speed of lines."""

from __future__ import annotations

import math

import numpy as np
import pytest
from given_journals import journal_of
from numpy.testing import assert_allclose

from amulor.acquisition import navigation
from amulor.acquisition.navigation import (
    RecordedTrajectory,
    line_steps,
    middle_times,
    recorded_trajectory,
    speed_advice,
)
from amulor.platform import Mounting, Trajectory, pose_line
from amulor.survey import Survey

#: Vehicle axes (right, down, forward) of a level vehicle that heads north.
LEVEL = (-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))


def pose(time: float, north: float) -> str:
    return pose_line(
        time=time,
        position=[1.0, north, -8.0],
        attitude=LEVEL,
        covariance=np.diag([1e-4] * 3 + [1e-6] * 3),
    )


@pytest.fixture
def moving(small: Survey) -> Survey:
    """Return a survey of three lines on a course of 0.5 m/s, without lever arm."""
    return small.with_(
        {
            "scan.open_water": None,
            "scan.columns": 3,
            "scan.elevation_span": 0.0,
            "scan.rows": 3,
            "platform": {
                "course": {"kind": "line", "start": [0, 0, -8], "speed": 0.5},
                "mounting": {"lever_arm": [0.0, 0.0, 0.0]},
            },
        }
    )


def journal(folder, survey: Survey, lines: list[tuple[float, str]], **more: object):
    found = journal_of(
        folder, survey, [], identities={"navigation": "a receiver"}, **more
    )
    found.commit_together([], lines)
    return found


def test_poses_make_a_trajectory_in_the_order_of_their_stamps(moving, folder) -> None:
    times = [0.0, 1.0, 3.0, 2.0, 4.0, 5.0, 6.0, 7.0]
    # The link delays one message behind the next.
    lines = [(k + 0.01, pose(time, 0.5 * time)) for k, time in enumerate(times)]
    with journal(folder, moving, lines) as kept:
        found = recorded_trajectory(kept, moving)
    assert found is not None
    assert found.origin == 0.0
    assert found.mounting == moving.platform.mounting
    track = found.trajectory
    assert track is not None
    assert_allclose(track.time, np.arange(8))
    assert_allclose(track.position[:, 1], 0.5 * np.arange(8), atol=1e-12)
    known = found.known(np.array([[-0.5, 0.5, np.nan], [3.5, 6.9, 7.5]]))
    assert known.tolist() == [[False, True, False], [True, True, False]]
    assert found.known(np.array([np.nan])).tolist() == [False]


def test_a_scan_without_navigation_has_no_trajectory(moving, small, folder) -> None:
    with journal_of(folder / "a", moving, []) as kept:
        assert recorded_trajectory(kept, moving) is None
    with journal(folder / "b", small, []) as kept:
        assert recorded_trajectory(kept, small) is None


def test_messages_that_make_no_trajectory_say_why(moving, folder) -> None:
    with journal(folder, moving, [(0.0, pose(0.0, 0.0))]) as kept:
        found = recorded_trajectory(kept, moving)
    assert found is not None
    assert found.trajectory is None
    assert found.lines[-1].startswith("navigation: no trajectory: ")
    assert found.known(np.zeros((2, 3))).tolist() == [[False] * 3] * 2
    assert line_steps(found, np.zeros(4)).tolist() == pytest.approx(
        [math.nan] * 3, nan_ok=True
    )
    assert line_steps(found, np.zeros(0)).size == 0


def test_stamps_of_a_unix_clock_count_from_the_first_segment(moving, folder) -> None:
    devices = (
        '[navigation]\ndriver = "of no package"\nclock = "unix"\n'
        'crs = "EPSG:32632"\ncrs_offset = ["1 m", "2 m", "3 m"]'
    )
    with journal(folder, moving, [], devices=devices) as kept:
        number = kept.begin_segment()
        kept.end_segment(number, "paused")
        kept.begin_segment()
        begun = np.datetime64(kept.segments()[0]["started"][:-1]).astype(float) / 1e6
        lines = [(float(k), pose(begun + k, 0.5 * k)) for k in range(6)]
        kept.commit_together([], lines)
        found = recorded_trajectory(kept, moving)
    assert found is not None
    assert found.origin == pytest.approx(begun, abs=1e-5)
    assert found.trajectory is not None
    assert found.trajectory.crs == "EPSG:32632"
    assert found.trajectory.crs_offset == (1.0, 2.0, 3.0)
    assert found.known(np.array([-0.5, 2.5, 5.5])).tolist() == [False, True, False]


def test_a_simulated_vehicle_has_the_frame_of_its_survey(moving, folder) -> None:
    placed = moving.with_(
        {"pose": {"crs": "EPSG:32632", "crs_offset": [500e3, 4.8e6, 0.0]}}
    )
    with journal(folder / "a", placed, []) as kept:
        driver, frame = navigation._source(kept, placed)
    assert driver == "simulated"
    assert (frame.clock, frame.crs) == ("relative", "EPSG:32632")
    assert frame.crs_offset == (500e3, 4.8e6, 0.0)
    with journal(folder / "b", moving, []) as kept:
        _, frame = navigation._source(kept, moving)
    assert (frame.crs, frame.crs_offset) == ("", (0.0, 0.0, 0.0))


def test_stamps_are_those_of_poses_with_a_number() -> None:
    messages = [(4, 0.5, pose(7.0, 0.0)), (5, 0.6, "noise"), (8, 0.9, pose(7.5, 0.0))]
    found = navigation._stamps(messages, "simulated")
    assert found == [(0, 7.0, 0.5), (2, 7.5, 0.9)]
    assert navigation._time_of("2.5,1,2") == 2.5
    assert navigation._time_of("noise,1") == math.inf
    assert navigation._time_of("nan,1") == math.inf


def test_sentences_between_steady_stamps_are_kept() -> None:
    messages = [(10 + k, float(k), f"line {k}") for k in range(7)]
    # Stamps at the second, fourth and sixth message.
    numbers = [1, 3, 5]
    for steady, kept in (
        ([True, True, True], [0, 1, 2, 3, 4, 5, 6]),
        ([True, False, True], [0, 1, 5, 6]),
        ([False, True, True], [3, 4, 5, 6]),
        ([True, True, False], [0, 1, 2, 3]),
        ([False, False, False], []),
    ):
        found = navigation._within(messages, numbers, np.array(steady))
        assert found == [(10 + k, f"line {k}") for k in kept]
    every = navigation._within(messages, [], np.zeros(0, dtype=bool))
    assert every == [(10 + k, f"line {k}") for k in range(7)]


def track(speed: float) -> RecordedTrajectory:
    time = np.arange(10.0)
    place = np.stack([0 * time, speed * time, 0 * time], axis=1)
    return RecordedTrajectory(
        trajectory=Trajectory.of_angles(
            time=time + 100, position=place, heading=0 * time
        ),
        mounting=Mounting(),
        origin=100.0,
        lines=(),
    )


def test_lines_have_the_distances_that_the_vehicle_goes() -> None:
    steps = line_steps(track(0.5), np.array([1.0, 2.0, 4.0, 20.0]))
    assert_allclose(steps, [0.5, 1.0, np.nan])


def test_a_vehicle_is_too_fast_at_more_than_1_2_times_its_spacing(moving) -> None:
    # A dwell of 50 ms and three columns of two channels at 0.5 m/s, and settling.
    wanted = navigation.planned_spacing(moving, 0.0)[0]
    near, far = (np.array([1.0, factor, 2.0, np.nan]) for factor in (1.19, 1.21))
    assert speed_advice(wanted * near, moving) == []
    slower = wanted * far
    assert speed_advice(slower, moving) == [
        f"too fast: {1e3 * slower[1]:.3g} mm between lines, {1e3 * wanted:.3g} wanted; "
        "drive 1.2 times slower, or plan shorter rows"
    ]
    assert speed_advice(np.array([np.nan]), moving) == []
    still = moving.with_({"platform.course": {"kind": "hover", "start": [0, 0, -8]}})
    assert speed_advice(slower, still) == []


def test_the_middle_of_a_line_is_that_of_its_readings() -> None:
    time = np.full((2, 1, 3, 2), np.nan)
    time[0, 0, 0] = [1.0, 2.0]
    time[1, 0, 0] = [3.0, 4.0]
    time[0, 0, 2, 0] = 7.0
    assert_allclose(middle_times(time), [2.5, 7.0])
