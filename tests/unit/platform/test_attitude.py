"""Attitudes, and trajectories of a few poses, by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from amulor.platform import Trajectory, rotation_of
from amulor.platform.attitude import covariance_of, cross_matrix, turn_between
from amulor.platform.trajectory import _continuous, _turned, usual_gap

STILL = [0.0, 0.0, 0.0, 1.0]


def track_of(
    time: Any, position: Any, heading: Any = 0.0, variance: Any = 0.0, **options: Any
) -> Trajectory:
    """Return a trajectory with a variance of each element of its poses."""
    time = np.asarray(time, dtype=float)
    variance = np.broadcast_to(variance, time.shape)
    turns = rotation_of(np.broadcast_to(heading, time.shape), 0.0, 0.0)
    return Trajectory(
        time=time,
        position=np.asarray(position, dtype=float),
        attitude=Rotation.from_matrix(turns).as_quat(),
        covariance=variance[:, None, None] * np.eye(6),
        longest_gap=options.pop("longest_gap", 100.0),
        **options,
    )


def test_a_turn_leads_from_the_first_attitude_to_the_second_in_site_axes() -> None:
    first = Rotation.from_rotvec([[0.0, 0.0, 0.5], [np.pi / 2, 0.0, 0.0]])
    second = Rotation.from_rotvec([[0.0, 0.0, 0.2], [np.pi / 2, 0.0, 0.0]])
    turn = Rotation.from_rotvec([0.0, 0.1, 0.0])
    found = turn_between(first, turn * second)
    assert_allclose(turn_between(first, second), [[0, 0, -0.3], [0, 0, 0]], atol=1e-15)
    assert_allclose(found[1], [0, 0.1, 0], atol=1e-15)


def test_a_cross_matrix_multiplies_as_a_cross_product() -> None:
    vectors = np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, 6.0]])
    other = np.array([7.0, -8.0, 9.0])
    assert_allclose(cross_matrix(vectors) @ other, np.cross(vectors, other))
    assert cross_matrix(np.ones((2, 5, 3))).shape == (2, 5, 3, 3)


def test_uncertainties_of_poses_may_differ_by_pose_or_by_axis() -> None:
    turns = rotation_of(np.array([0.0, np.pi / 2]), 0.0, 0.0)
    # One number a pose: of each coordinate, and of heading and level.
    found = covariance_of(turns, [0.1, 0.2], [0.01, 0.02], [0.03, 0.05])
    for pose, diagonal in enumerate(
        ([0.1, 0.1, 0.1, 0.03, 0.03, 0.01], [0.2, 0.2, 0.2, 0.05, 0.05, 0.02])
    ):
        assert_allclose(found[pose], np.diag(np.square(diagonal)), atol=1e-18)
    each = covariance_of(turns, [[1, 2, 3], [4, 5, 6]], 0.0, 0.0)
    assert_allclose(each[1], np.diag([16, 25, 36, 0, 0, 0]))
    axes = covariance_of(turns, [1.0, 2.0, 3.0], 0.0, 0.0)
    assert_allclose(axes[1], np.diag([1, 4, 9, 0, 0, 0]))


def test_uncertainties_of_a_pitched_vehicle_are_about_its_own_axes() -> None:
    # North and down by 45 degrees: its forward axis is (0, 1, -1) / sqrt(2).
    turns = rotation_of(np.array([0.0]), np.array([-np.pi / 4]), np.array([0.0]))
    (found,) = covariance_of(turns, 0.0, 0.3, 0.2)
    forward = np.array([0, 1, -1]) / 2**0.5
    expected = np.diag([0.04, 0, 0.09]) + 0.04 * np.outer(forward, forward)
    assert_allclose(found[3:, 3:], expected, atol=1e-15)


def test_covariances_change_linearly_and_interpolation_adds_its_error() -> None:
    # Half of the largest change between two poses is the error in the middle.
    track = track_of(
        [0.0, 1.0, 3.0],
        [[0, 0, 0], [0.2, -0.4, 0], [0.8, 0, 0]],
        heading=[0.0, 0.1, 0.4],
        variance=[0.01, 0.03, 0.02],
    )
    error = np.array([0.3, 0.2, 0, 0, 0, 0.15])
    # The second interval is 4/3 of the median.
    for time, stated, factor in (
        (0.0, 0.01, 0.0),
        (0.25, 0.015, 0.75),
        (0.5, 0.02, 1.0),
        (1.0, 0.03, 0.0),
        (2.0, 0.025, 16 / 9),
        (2.5, 0.0225, 0.75 * 16 / 9),
        (3.0, 0.02, 0.0),
    ):
        (found,) = track.at([time]).covariance
        expected = stated * np.eye(6) + np.diag((factor * error) ** 2)
        assert_allclose(found, expected, atol=1e-12)


def test_five_poses_show_that_a_straight_course_has_no_interpolation_error() -> None:
    for count, expected in ((4, 0.25), (5, 0.0), (6, 0.0)):
        time = np.arange(float(count))
        track = track_of(time, time[:, None] * [1.0, 0, 0])
        found = track.at([0.5]).covariance[0, 0, 0]
        assert found == pytest.approx(expected, abs=1e-15)


def test_a_pose_of_unknown_error_has_no_part_at_the_times_of_others() -> None:
    place = [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    track = track_of([0, 1, 2], place, variance=[0.01, np.nan, 0.02])
    found = track.at([0, 0.5, 1, 1.5, 2]).covariance[:, 0, 0]
    assert_allclose(found, [0.01, np.nan, np.nan, np.nan, 0.02])


def test_the_interpolation_error_is_a_quarter_of_the_departures_around() -> None:
    departures = np.full((9, 6), np.nan)
    departures[3:6, 0] = [3.0, 0.0, 6.0]
    departures[3:6, 1:] = 1.0
    stand_in: Any = SimpleNamespace(departures=departures)
    found = Trajectory._interpolation_error(stand_in, 1, 8)
    # Squares 9, 9, 9, 0, 36, 36, 36, of which nine are averaged at each pose.
    expected = np.sqrt(np.array([99, 126, 153, 180, 207, 234, 261]) / 9) / 4
    assert_allclose(found[:, 0], expected)
    assert_allclose(found[:, 1:], 0.25)


def test_departures_are_those_from_the_cubic_of_two_poses_on_each_side() -> None:
    place, heading = np.zeros((7, 3)), np.zeros(7)
    place[3, 1], heading[3] = 0.6, 0.03
    track = track_of(np.arange(7.0), place, heading)
    # Lagrange weights of even times: -1/6, 2/3, 2/3, -1/6.
    expected = np.full((7, 6), np.nan)
    expected[2:5] = 0
    expected[2:5, 1] = [0.4, -0.6, 0.4]
    expected[2:5, 5] = [-0.02, 0.03, -0.02]
    assert_allclose(track.departures, expected, atol=1e-12)


def test_pieces_between_gaps_have_departures_of_their_own() -> None:
    time = np.array([0.0, 1, 2, 3, 10, 11, 12, 13, 14, 30, 40, 41])
    place = np.zeros((12, 3))
    place[6, 0] = 0.3
    track = track_of(time, place, longest_gap=6.0)
    assert track._pieces == [(0, 4), (4, 9), (10, 12)]
    assert track.gaps.tolist() == [[3, 10], [14, 30], [30, 40]]
    assert np.flatnonzero(np.isfinite(track.departures[:, 0])).tolist() == [6]
    assert_allclose(track.departures[6], [-0.3, 0, 0, 0, 0, 0], atol=1e-12)
    # An interval as long as the longest gap is interpolated.
    whole = track_of(time, place, longest_gap=16.0)
    assert whole._pieces == [(0, 12)]
    found = track.at([3, 3.5, 10, 14, 30, 40, 41, 41.5])
    assert found.known.tolist() == [True, False, True, True, False, True, True, False]
    assert found.time.tolist() == [3, 3.5, 10, 14, 30, 40, 41, 41.5]
    for name in ("position", "rotation", "velocity", "turn_rate", "covariance"):
        values = getattr(found, name).reshape(8, -1)
        assert (np.isfinite(values).all(axis=1) == found.known).all()


def test_quaternions_have_the_signs_of_their_neighbors() -> None:
    one, other = np.array([0.6, 0, 0, 0.8]), np.array([0, 0.6, 0, 0.8])
    signs = np.array([1.0, -1.0, -1.0, 1.0])[:, None]
    found = _continuous(signs * np.array([one, other, one, other]))
    assert_allclose(found, [one, other, one, other])
    # A right angle in the space of quaternions is no change of sign.
    edge = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0]])
    assert_allclose(_continuous(edge), edge)


def test_angular_velocities_do_not_depend_on_the_length_of_quaternions() -> None:
    rate = np.array([0.2, -0.3, 0.5])
    turn = Rotation.from_rotvec([0.4, 0.1, -0.7])
    step = 1e-6
    before, after = (
        (Rotation.from_rotvec(sign * step * rate) * turn).as_quat() for sign in (-1, 1)
    )
    slope = (after - before) / (2 * step)
    quaternion = turn.as_quat()
    stretched = 3 * quaternion
    # Its length grows by 7 a second as well.
    growth = 3 * slope + 7 * quaternion
    matrix, spin = _turned(stretched[None], growth[None])
    assert_allclose(spin, [rate], atol=1e-9)
    assert_allclose(matrix, [turn.as_matrix()], atol=1e-12)


def test_the_usual_gap_is_five_median_intervals() -> None:
    assert usual_gap(np.array([0.0, 1.0, 3.0, 6.0])) == 10.0
    assert usual_gap(np.array([0.0, 0.5])) == 2.5
    assert usual_gap(np.array([4.0])) == 1.0


def test_a_trajectory_from_angles_has_unknown_errors_by_default() -> None:
    track = Trajectory.of_angles(
        time=[0, 1, 3], position=np.zeros((3, 3)), heading=0.3, pitch=[0.1, 0.2, 0.3]
    )
    assert np.isnan(track.covariance[:, [0, 1, 2], [0, 1, 2]]).all()
    assert np.isnan(track.covariance[:, 3:, 3:]).all()
    assert (track.longest_gap, track.duration) == (7.5, 3.0)
    assert (track.clock, track.crs, track.crs_offset) == ("relative", "", (0, 0, 0))
    assert track.remarks == ()
    stated = Trajectory.of_angles(
        time=[0, 1], position=np.zeros((2, 3)), heading=0.3, longest_gap=0.7
    )
    assert stated.longest_gap == 0.7
    angles = rotation_of(0.3, np.array([0.1, 0.2, 0.3]), 0.0)
    found = Rotation.from_quat(track.attitude).as_matrix()
    assert_allclose(found, angles, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"attitude": np.zeros((3, 3))},
         "attitude has shape (3, 3); needed is (3, 4), a pose for each of 3 times"),
        ({"covariance": np.zeros((3, 6))},
         "covariance has shape (3, 6); needed is (3, 6, 6), a pose for each of 3 "
         "times"),
        ({"time": np.array([0.0, 2.0, 1.0])},
         "time 2 is not after time 1; sort the poses"),
        ({"time": np.array([0.0, 0.0, 1.0])},
         "time 1 is not after time 0; sort the poses"),
        ({"time": np.array([0.0, 1.0, np.inf])},
         "time has a value that is not finite; remove it"),
        ({"attitude": np.full((3, 4), np.nan)},
         "attitude has a value that is not finite; remove it"),
        ({"longest_gap": -1.0}, "longest_gap -1; needed is above 0 s"),
        ({"longest_gap": np.nan}, "longest_gap nan; needed is above 0 s"),
    ],
)  # fmt: skip
def test_an_impossible_trajectory_is_described(
    change: dict[str, Any], words: str
) -> None:
    parts = {
        "time": np.arange(3.0), "position": np.zeros((3, 3)),
        "attitude": np.tile(STILL, (3, 1)), "covariance": np.zeros((3, 6, 6)),
        "longest_gap": 5.0,
    }  # fmt: skip
    with pytest.raises(ValueError, match=r".") as caught:
        Trajectory(**{**parts, **change})
    assert str(caught.value) == words


def test_a_trajectory_has_two_poses_at_least() -> None:
    with pytest.raises(ValueError, match=r"^a trajectory of 1 poses; needed are 2 or"):
        track_of([0.0], [[0, 0, 0]])
    assert track_of([0.0, 1.0], [[0, 0, 0], [1, 0, 0]]).at([0.5]).known.all()
