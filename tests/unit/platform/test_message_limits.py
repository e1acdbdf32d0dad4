"""Limits and whole remarks of pose messages, on both sides of each limit."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from amulor.errors import FormatError
from amulor.platform import Trajectory, pose_line
from amulor.platform import messages as poses
from amulor.platform.messages import Messages, messages_of, trajectory_of


def place(number: int) -> str:
    return f"line {number + 1}"


def messages_at(time: Any, **changes: Any) -> Messages:
    """Return messages of a vehicle that moves east at 1 m/s, by its true time."""
    stamps = np.asarray(time, dtype=float)
    parts: dict[str, Any] = {
        "time": stamps,
        "position": stamps[:, None] * [1.0, 0, 0],
        "attitude": np.tile([0.0, 0, 0, 1], (stamps.size, 1)),
        "covariance": np.tile(1e-4 * np.eye(6), (stamps.size, 1, 1)),
        "clock": "relative",
    }
    return Messages(**{**parts, **changes})


def track_of(messages: Messages, **options: Any) -> Trajectory:
    return trajectory_of(messages, source="dive.csv", place=place, **options)


def refusal(messages: Messages, **options: Any) -> str:
    """Return why messages are refused; empty if they are not."""
    try:
        track_of(messages, **options)
    except FormatError as error:
        return str(error)
    return ""


def test_a_pose_is_a_line_of_numbers_that_is_read_back() -> None:
    covariance = np.arange(36.0).reshape(6, 6) / 7
    covariance = covariance + covariance.T
    line = pose_line(
        time=1700000000.123456, position=[0.1, -2, 3e-9],
        attitude=[0.5, 0.5, -0.5, 0.5],
        covariance=covariance,
    )  # fmt: skip
    words = line.split(",")
    assert len(words) == 29
    assert words[:8] == [
        "1700000000.123456", "0.10000000000000001", "-2", "3e-09",
        "0.5", "0.5", "-0.5", "0.5",
    ]  # fmt: skip
    # The upper triangle, row by row.
    upper = [covariance[row, column] for row in range(6) for column in range(row, 6)]
    assert [float(word) for word in words[8:]] == upper
    wrong = ["", "1,2", line + ",1", line.replace("0.5", "a", 1)]
    found = messages_of(
        [line, *wrong], clock="unix", crs="EPSG:1", crs_offset=(1, 2, 3)
    )
    assert found.time[0] == 1700000000.123456
    assert found.position[0].tolist() == [0.1, -2, 3e-9]
    assert found.attitude[0].tolist() == [0.5, 0.5, -0.5, 0.5]
    assert found.covariance[0].tolist() == covariance.tolist()
    for values in (found.time, found.position, found.attitude, found.covariance):
        assert np.isnan(values[1:]).all()
    assert (found.clock, found.crs, found.crs_offset) == ("unix", "EPSG:1", (1, 2, 3))
    assert found.remarks == ()


def test_a_trajectory_has_the_frame_and_the_remarks_of_its_messages() -> None:
    quaternion = np.tile([0.0, 0.0, 0.6, 0.8], (3, 1)) * [[1.01], [0.99], [1.0]]
    found = track_of(
        messages_at(
            [0.0, 1.0, 3.0], attitude=quaternion, clock="unix", crs="EPSG:32633",
            crs_offset=(4e5, 5e6, 1.0), remarks=("of the reader",),
            covariance=np.full((3, 6, 6), np.nan),
        )
    )  # fmt: skip
    assert (found.clock, found.crs) == ("unix", "EPSG:32633")
    assert found.crs_offset == (4e5, 5e6, 1.0)
    np.testing.assert_allclose(found.attitude, np.tile([0, 0, 0.6, 0.8], (3, 1)))
    assert found.longest_gap == 7.5
    assert found.remarks == (
        "of the reader",
        "the uncertainty of the poses is not stated, or in part only",
    )
    defaults = messages_at([0.0, 1.0])
    assert (defaults.crs, defaults.crs_offset) == ("", (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("time", "words"),
    [
        ([], "dive.csv: holds 0 complete poses; needed are 2 or more; check the "
             "columns or the topic"),
        ([1.0, np.nan], "dive.csv: holds 1 complete pose; needed are 2 or more; check "
                        "the columns or the topic"),
        ([1.0, 1.0], "dive.csv: holds one pose only, repeated; needed are 2 or more"),
        ([1.0, 2.0], ""),
    ],
)  # fmt: skip
def test_a_trajectory_needs_two_poses(time: list[float], words: str) -> None:
    assert refusal(messages_at(time)) == words


@pytest.mark.parametrize("part", ["time", "position", "attitude"])
def test_a_message_without_a_number_is_left_out(part: str) -> None:
    messages = messages_at(np.arange(5.0))
    values = getattr(messages, part).copy()
    # Element 2 of times, and the first of three or four elements of pose 2.
    values.reshape(5, -1)[2, 0] = np.inf
    found = track_of(replace(messages, **{part: values}), longest_gap=9.0)
    assert found.time.tolist() == [0, 1, 3, 4]
    assert found.remarks[0] == (
        "1 message without time, position or attitude left out; the first is line 3"
    )


def test_the_norm_of_a_quaternion_is_1_within_a_fiftieth() -> None:
    for size in (0.981, 1.019):
        quaternions = np.tile([0, 0, 0, size], (2, 1))
        assert refusal(messages_at([0.0, 1.0], attitude=quaternions)) == ""
    for size in (0.979, 1.021):
        quaternions = np.array([[0.0, 0, 0, 1], [0, size, 0, 0]])
        assert refusal(messages_at([0.0, 1.0], attitude=quaternions)) == (
            f"line 2: the attitude is a quaternion with norm {size:.3g}, needed is 1; "
            "check the order of its columns"
        )


def test_no_vehicle_turns_by_more_than_2_rad_between_poses() -> None:
    time = np.arange(4) / 10
    for angle, words in (
        (1.99, ""),
        (2.01, "line 3: the attitude jumps by 115 deg within 0.1 s; correct the axes "
               "of the sensor, or leave these messages out"),
    ):  # fmt: skip
        turns = Rotation.from_rotvec(np.outer([0, 0, 1, 1], [0, 0, angle]))
        assert refusal(messages_at(time, attitude=turns.as_quat())) == words
    # Over a gap, any turn is possible.
    turned = messages_at([0, 0.1, 2, 2.1], attitude=turns.as_quat())
    assert refusal(turned, longest_gap=1.8) == ""
    assert refusal(turned, longest_gap=1.9).startswith("line 3: the attitude jumps")


def arrived(count: int, delayed: slice, after: int) -> np.ndarray:
    """Return the times of messages, some of which arrive only after a later one."""
    time = np.arange(float(count))
    held = time[delayed]
    rest = np.delete(time, np.arange(count)[delayed])
    return np.insert(rest, int(np.searchsorted(rest, after)) + 1, held)


def test_twenty_late_messages_in_a_row_are_a_delay_and_more_are_a_step() -> None:
    found = track_of(messages_at(arrived(60, slice(20, 40), 40)))
    assert found.time.tolist() == list(range(60))
    assert found.remarks == (
        "20 messages up to 20 s late, sorted by time stamp; the first is line 22",
    )
    assert refusal(messages_at(arrived(60, slice(20, 41), 41))) == (
        "line 22: the clock steps back by 21 s; split the file there, or correct its "
        "time stamps"
    )


@pytest.mark.parametrize(
    ("late", "refused"),
    [
        # Times of late messages; whole seconds from 0 to 9 are those of others.
        ([4.4], False),
        ([4.4, 5.4], True),
        ([4.6, 5.6], True),
        ([4.4, 11.5], False),
        ([4.4, 5.4, 11.5], True),
        ([4.4, 5.4, 11.5, 12.5], False),
        ([4.4, 5.4, 6.4, 11.5, 12.5], True),
    ],
)
def test_late_messages_at_times_of_others_are_a_step(
    late: list[float], refused: bool
) -> None:
    time = np.array([*range(10), 14.0, *late, 15, 16, 17, 18, 19, 20])
    words = refusal(messages_at(time), longest_gap=9.0)
    step = (
        f"line 12: the clock steps back by {14 - late[0]:.4g} s; split the file there"
    )
    assert words.startswith(step) if refused else words == ""


@pytest.mark.parametrize("late", [[0.1, 0.2], [3.8, 3.9]])
def test_the_first_and_the_last_message_count_as_others(late: list[float]) -> None:
    time = np.array([0.0, 1, 2, 3, 4, *late])
    assert refusal(messages_at(time), longest_gap=9.0) == (
        f"line 6: the clock steps back by {4 - late[0]:.4g} s; split the file there, "
        "or correct its time stamps"
    )


def test_two_messages_in_time_state_the_usual_interval() -> None:
    assert refusal(messages_at([0.0, 1.0, 0.4, 0.6])) == (
        "line 3: the clock steps back by 0.6 s; split the file there, or correct its "
        "time stamps"
    )
    found = track_of(messages_at([5.0, 1.0, 2.0]), longest_gap=9.0)
    assert found.time.tolist() == [1, 2, 5]
    assert found.remarks[0] == (
        "2 messages up to 4 s late, sorted by time stamp; the first is line 2"
    )


def test_a_repeated_message_has_the_pose_of_the_first() -> None:
    time = np.array([0.0, 1.0, 1.0, 2.0])
    found = track_of(messages_at(time))
    assert found.time.tolist() == [0, 1, 2]
    assert found.remarks == ("1 repeated message left out",)
    for part, change in (("position", [0, 0, 1e-9]), ("attitude", [0, 0, 0, 1e-9])):
        values = getattr(messages_at(time), part).copy()
        values[2] += change
        assert refusal(messages_at(time, **{part: values})) == (
            "line 3: has the time stamp of line 2 but another pose; are these the "
            "poses of two vehicles?"
        )


def test_gaps_are_counted_and_the_longest_is_named() -> None:
    track: Any = SimpleNamespace(
        time=np.array([0.0, 1.0, 4.0, 5.0, 9.0, 12.5]), longest_gap=3.0
    )
    order = np.array([0, 1, 2, 3, 7, 8])
    assert poses._remarks_on_gaps(track, order, place) == [
        "2 gaps longer than 3 s without poses; the longest, 4 s, ends at line 8"
    ]
    track.longest_gap = 4.0
    assert poses._remarks_on_gaps(track, order, place) == []


@pytest.mark.parametrize(
    ("length", "moved", "unlike"),
    [
        (2.0, 1.39, True), (2.0, 1.41, False), (2.0, 2.85, False), (2.0, 2.87, True),
        (1.49, 0.1, False), (1.51, 0.1, True),
    ],
)  # fmt: skip
def test_the_speed_of_a_long_interval_is_compared_with_that_beside_it(
    length: float, moved: float, unlike: bool
) -> None:
    # All other intervals have 5 m/s.
    steps, way = np.ones(24), np.full(24, 5.0)
    steps[12], way[12] = length, 5 * moved
    time, east = (np.append(0, np.cumsum(each)) for each in (steps, way))
    track: Any = SimpleNamespace(time=time, position=east[:, None] * [0.6, 0.8, 0])
    found = poses._remarks_on_speed(track, np.arange(25) + 10, place)
    words = (
        "the speed changes in 1 long interval, first before line 24: did the clock "
        "step?"
    )
    assert found == ([words] if unlike else [])


def test_eleven_intervals_state_the_speed_beside_an_interval() -> None:
    # Six of eleven have 1 m/s, among them the long one; all others have 3 m/s.
    way, steps = np.full(24, 3.0), np.ones(24)
    way[7:13] = 1.0
    steps[12], way[12] = 2.0, 2.0
    time, east = (np.append(0, np.cumsum(each)) for each in (steps, way))
    track: Any = SimpleNamespace(time=time, position=east[:, None] * [1, 0, 0])
    assert poses._remarks_on_speed(track, np.arange(25), place) == []
    way[7] = 3.0
    east = np.append(0, np.cumsum(way))
    track.position = east[:, None] * [1, 0, 0]
    assert len(poses._remarks_on_speed(track, np.arange(25), place)) == 1


@pytest.mark.parametrize(
    ("typical", "jump", "sigma", "named"),
    [
        (1.0, 7.9, 0.0, False), (1.0, 8.1, 0.0, True), (1.0, 9.4, 0.5, False),
        (1.0, 9.6, 0.5, True), (1.0, 8.1, np.nan, True), (0.0, 0.9e-6, 0.0, False),
        (0.0, 1.1e-6, 0.0, True),
    ],
)  # fmt: skip
def test_a_position_departs_by_eight_typical_departures_and_three_errors(
    typical: float, jump: float, sigma: float, named: bool
) -> None:
    departures = np.full((7, 6), np.nan)
    departures[2:6] = [0, 0.6 * typical, -0.8 * typical, 99, 99, 99]
    departures[4, :3] = [0, 0.8 * jump, 0.6 * jump]
    covariance = np.zeros((7, 6, 6))
    covariance[:, 1, 1], covariance[:, 0, 0] = sigma**2, sigma**2 / 4
    covariance[:, 3, 3] = 1e6
    track: Any = SimpleNamespace(departures=departures, covariance=covariance)
    words = (
        f"positions depart from their neighbors in 1 pose, by up to {jump:.3g} m at "
        "line 15: is it an outlier, or did the clock step?"
    )
    found = poses._remarks_on_jumps(track, np.arange(7) + 10, place)
    assert found == ([words] if named else [])


def test_remarks_on_gaps_speed_and_positions_follow_each_other() -> None:
    time = np.append(np.arange(40.0), [43.0, 44.0, 60.0, 61.0])
    position = time[:, None] * [1.0, 0, 0]
    position[40:, 0] -= 2.5  # a clock that steps forward
    position[20, 1] = 0.5
    found = track_of(messages_at(time, position=position))
    assert found.remarks == (
        "1 gap longer than 5 s without poses; the longest, 16 s, ends at line 43",
        "the speed changes in 1 long interval, first before line 41: did the clock "
        "step?",
        "positions depart from their neighbors in 6 poses, by up to 0.5 m at line 21: "
        "is it an outlier, or did the clock step?",
    )


def test_the_largest_of_several_departures_is_named() -> None:
    departures = np.zeros((9, 6))
    departures[[3, 6], 0] = [0.2, -0.3]
    track: Any = SimpleNamespace(departures=departures, covariance=np.zeros((9, 6, 6)))
    (found,) = poses._remarks_on_jumps(track, np.arange(9), place)
    assert found.startswith(
        "positions depart from their neighbors in 2 poses, by up to 0.3 m at line 7:"
    )
    track.departures = np.full((9, 6), np.nan)
    assert poses._remarks_on_jumps(track, np.arange(9), place) == []
