"""Pose messages: late, repeated, missing, with stepping clocks, with jumps."""

import numpy as np
import pytest

from amulor.errors import FormatError
from amulor.platform import Trajectory
from amulor.platform.messages import Messages, trajectory_of

TIME = np.arange(0.0, 10.0, 0.1)


def _place(time):
    return np.stack([0.3 * time, 0.05 * np.sin(0.4 * time), -8 + 0 * time], axis=-1)


def _turn(time):
    half = 0.05 * np.sin(0.3 * time)
    return np.stack([0 * time, 0 * time, np.sin(half), np.cos(half)], axis=-1)


def _messages(stamps, true=None, **changes):
    """Messages whose poses are those of the true times."""
    true = stamps if true is None else true
    fields = {
        "time": np.asarray(stamps),
        "position": _place(np.asarray(true)),
        "attitude": _turn(np.asarray(true)),
        "covariance": np.tile(np.diag([1e-4] * 3 + [1e-6] * 3), (len(stamps), 1, 1)),
        "clock": "relative",
    }
    return Messages(**{**fields, **changes})


def _read(messages, **options):
    return trajectory_of(
        messages, source="log", place=lambda n: f"line {n + 1}", **options
    )


def test_late_messages_are_sorted_and_counted():
    order = np.arange(100)
    order[[20, 24]] = order[[24, 20]]
    track = _read(_messages(TIME[order]))
    assert track.time.tolist() == TIME.tolist()
    assert track.remarks == (
        "4 messages up to 0.4 s late, sorted by time stamp; the first is line 22",
    )


def test_repeated_messages_are_left_out():
    track = _read(_messages(np.insert(TIME, [5, 5, 60], TIME[[4, 4, 59]])))
    assert track.time.tolist() == TIME.tolist()
    assert track.remarks == ("3 repeated messages left out",)


def test_incomplete_messages_are_left_out_and_the_first_is_named():
    position = _place(TIME)
    position[[7, 9], 1] = np.nan
    track = _read(_messages(TIME, position=position))
    assert track.time.size == 98
    assert track.remarks[0] == (
        "2 messages without time, position or attitude left out; the first is line 8"
    )


def test_a_clock_that_steps_back_is_refused():
    stamps = np.where(TIME < 6, TIME, TIME - 4)
    with pytest.raises(FormatError, match=r"line 61: the clock steps back by 3\.9 s"):
        _read(_messages(stamps, TIME))


def test_late_messages_at_the_times_of_others_are_a_step_back():
    # Three messages, 0.04 of a second from three earlier ones: not merely late.
    stamps = TIME.copy()
    stamps[60:63] = TIME[20:23] + 0.04
    with pytest.raises(FormatError, match="line 61: the clock steps back"):
        _read(_messages(stamps, TIME))


@pytest.mark.parametrize("part", ["position", "attitude", "both"])
def test_two_poses_of_one_time_are_refused(part):
    stamps = np.insert(TIME, 50, TIME[49])
    # Message 51 has the pose, or a part of it, of another time.
    other, same = (np.insert(TIME, 50, time) for time in (5.0, TIME[49]))
    messages = _messages(
        stamps,
        position=_place(same if part == "attitude" else other),
        attitude=_turn(same if part == "position" else other),
    )
    with pytest.raises(FormatError, match="line 51: has the time stamp of line 50 but"):
        _read(messages)


def test_an_attitude_that_jumps_is_refused():
    attitude = _turn(TIME)
    # A product with the unit quaternion k: turned by 180 degrees about up.
    attitude[40:] = attitude[40:][:, [1, 0, 3, 2]] * [1, -1, 1, -1]
    with pytest.raises(
        FormatError, match=r"line 41: the attitude jumps by 1[78]\d deg"
    ):
        _read(_messages(TIME, attitude=attitude))


def test_quaternions_in_another_order_are_refused_by_their_norm():
    attitude = _turn(TIME)
    attitude[:, 0] = 0.5
    with pytest.raises(FormatError, match=r"line 1: .* norm 1\.12, needed is 1"):
        _read(_messages(TIME, attitude=attitude))


def test_a_gap_is_named_and_a_clock_that_steps_ahead_is_suspected():
    keep = (TIME < 4) | (TIME >= 6)
    track = _read(_messages(TIME[keep]))
    assert track.remarks == (
        "1 gap longer than 0.5 s without poses; the longest, 2.1 s, ends at line 41",
    )
    stamps = np.where(TIME < 4, TIME, TIME + 300)
    track = _read(_messages(stamps, TIME))
    assert track.remarks[1] == (
        "the speed changes in 1 long interval, first before line 41: did the clock "
        "step?"
    )


def test_two_poses_are_enough_and_an_interval_as_long_as_the_gap_is_none():
    track = _read(_messages([0.0, 0.5, 0.5]), longest_gap=0.5)
    assert track.time.tolist() == [0.0, 0.5]
    assert track.remarks == ("1 repeated message left out",)
    with pytest.raises(FormatError, match="holds one pose only, repeated"):
        _read(_messages([0.5, 0.5, 0.5]))


def test_a_clock_that_steps_by_less_than_a_gap_moves_positions():
    track = _read(_messages(np.where(TIME < 4, TIME, TIME + 0.35), TIME))
    assert track.remarks[0].startswith("the speed changes in 1 long interval, first")
    assert _read(_messages(TIME)).remarks == ()


def test_unstated_uncertainties_are_named():
    covariance = np.full((100, 6, 6), np.nan)
    assert _read(_messages(TIME, covariance=covariance)).remarks == (
        "the uncertainty of the poses is not stated, or in part only",
    )


@pytest.mark.parametrize("stamps", [[], [1.0], [1.0, 1.0]])
def test_fewer_than_two_poses_are_refused(stamps):
    with pytest.raises(FormatError, match="needed are 2 or more"):
        _read(_messages(np.array(stamps)))


def _with_faults(rng):
    """Stamps and true times of messages with one to three faults, in arrival order."""
    time = np.arange(0.0, 12.0, 0.1)
    stamps, true = time.copy(), time.copy()
    for kind in rng.choice(5, size=rng.integers(1, 4)):
        at = int(rng.integers(5, stamps.size - 5))
        if kind == 0:  # dropout
            keep = np.r_[
                :at, min(at + rng.integers(1, 30), stamps.size - 2) : stamps.size
            ]
            stamps, true = stamps[keep], true[keep]
        elif kind == 1:  # duplicates
            stamps, true = (np.insert(a, at, a[at - 1]) for a in (stamps, true))
        elif kind == 2:  # late packet
            order = np.delete(np.arange(stamps.size), at)
            order = np.insert(order, min(at + rng.integers(1, 12), order.size), at)
            stamps, true = stamps[order], true[order]
        elif kind == 3:  # the clock steps back
            stamps[at:] -= rng.uniform(0.05, 5.0)
        else:  # the clock steps ahead
            stamps[at:] += rng.uniform(2.0, 60.0)
    return stamps, true


def test_no_pose_is_wrong_in_silence_in_a_thousand_faulty_logs():
    """A log is refused, or a remark names the step, or each pose is right."""
    rng = np.random.default_rng(20261126)
    refused = silent = 0
    for _ in range(1000):
        stamps, true = _with_faults(rng)
        try:
            track = _read(_messages(stamps, true))
        except FormatError:
            refused += 1
            continue
        at = rng.uniform(0.0, 12.0, 40)
        poses = track.at(at)
        known = poses.known
        error = np.abs(poses.position - _place(at))[known]
        sigma = np.sqrt(np.einsum("nii->ni", poses.covariance)[known][:, :3])
        wrong = (error > 3.5 * sigma).any()
        silent += wrong and not any("clock" in text for text in track.remarks)
    assert silent == 0
    assert 100 < refused < 700


def test_trajectories_have_the_gap_that_is_asked_for():
    track = _read(_messages(TIME), longest_gap=3.0)
    assert isinstance(track, Trajectory)
    assert track.longest_gap == 3.0
