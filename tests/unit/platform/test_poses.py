"""Poses of an instrument on a vehicle and its mounting, term by term."""

from __future__ import annotations

import dataclasses
import datetime
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from amulor.errors import SurveyError
from amulor.platform import (
    Mounting,
    Trajectory,
    instrument_poses,
    mean_instrument_poses,
)
from amulor.platform.mounting import (
    _rounded,
    changed,
    deviations,
    error_factors,
    mounting_text,
    with_covariance,
)
from amulor.platform.poses import InstrumentPoses, reference_time

WHEN = datetime.datetime(1970, 1, 1, 0, 1, 40, tzinfo=datetime.UTC)
#: East at 2 m/s and north at 1 m/s, heading north, from 100 s on.
TRACK = Trajectory.of_angles(
    time=[100.0, 110.0], position=[[0, 0, 0], [20, 10, 0]], heading=0.0,
    position_uncertainty=0.0, heading_uncertainty=0.0, level_uncertainty=0.0,
)  # fmt: skip


def with_errors(poses: InstrumentPoses, covariance: np.ndarray) -> InstrumentPoses:
    """Return the poses with an error of the trajectory."""
    stated = np.broadcast_to(covariance, (poses.vehicle.time.size, 6, 6))
    vehicle = dataclasses.replace(poses.vehicle, covariance=stated)
    return dataclasses.replace(poses, vehicle=vehicle)


def test_poses_are_at_the_time_of_the_clock_of_the_trajectory() -> None:
    found = instrument_poses(TRACK, Mounting(clock_offset="101 s"), [0.0, 4.0])
    assert_allclose(found.position, [[2, 1, 0], [10, 5, 0]])
    assert found.duration == 0
    assert_allclose(found.since_reference, [0, 4])
    drifting = Mounting(clock_offset="101 s", clock_drift=0.01)
    found = instrument_poses(TRACK, drifting, [0.0, 4.0], duration=0.2)
    assert_allclose(found.vehicle.time, [101, 105.04])
    assert found.duration == 0.2
    assert_allclose(found.since_reference, [0, 4.04])
    dated = dataclasses.replace(TRACK, clock="unix")
    later = Mounting(clock_offset="1 s", clock_drift=0.01, clock_reference=WHEN)
    found = instrument_poses(dated, later, 104.0)
    assert_allclose(found.vehicle.time, [104 + 1 + 0.01 * 4])
    assert_allclose(found.since_reference, [4.04])
    assert reference_time(later) == 100.0
    assert reference_time(Mounting()) == 0.0


@pytest.mark.parametrize(
    ("clock", "mounting", "words"),
    [
        ("unix", {"clock_drift": 1e-6},
         "mounting.clock_drift needs mounting.clock_reference, the date and time at "
         "which clock_offset is exact, as the trajectory has dates"),
        ("unix", {"clock_drift_uncertainty": 1e-6},
         "mounting.clock_drift needs mounting.clock_reference, the date and time at "
         "which clock_offset is exact, as the trajectory has dates"),
        ("relative", {"clock_reference": WHEN},
         "mounting.clock_reference is a date, but the times of the trajectory have no "
         "origin; leave it out"),
        ("relative", {"clock_drift": 1e-6}, ""),
        ("unix", {}, ""),
        ("unix", {"clock_reference": WHEN, "clock_drift": 1e-6}, ""),
        ("unix", {"clock_reference": WHEN}, ""),
    ],
)  # fmt: skip
def test_a_drift_counts_from_a_date_if_times_are_dates(
    clock: Any, mounting: dict[str, Any], words: str
) -> None:
    track = dataclasses.replace(TRACK, clock=clock)
    if not words:
        instrument_poses(track, Mounting(**mounting), [1.0])
        return
    with pytest.raises(SurveyError) as caught:
        instrument_poses(track, Mounting(**mounting), [1.0])
    assert str(caught.value) == words


def test_errors_of_a_point_add_in_squares() -> None:
    mounting = Mounting(
        clock_offset="101 s", lever_arm_uncertainties=(0.1, 0.2, 0.3),
        clock_uncertainty=0.05,
    )  # fmt: skip
    poses = instrument_poses(TRACK, mounting, [0.0, 4.0], duration=0.6)
    pose = np.outer([0.3, 0.5, 0, 0, 0, 0.01], [0.3, 0.5, 0, 0, 0, 0.01])
    poses = with_errors(poses, pose)
    points = poses.position + np.array([[0, 2.0, 0], [4.0, 0, 0]])
    along = np.array([[0.0, 1.0, 0.0], [0.6, 0.0, -0.8]])
    # A turn about up moves a point to the north to the west, one to the east north.
    by_pose = np.array([[0.3 - 0.02, 0.5, 0], [0.3, 0.5 + 0.04, 0]])
    # Right is east, down is down, forward is north; the clock moves along the way.
    shared = [np.diag([0.1, 0.3, 0.2]), 0.05 * np.array([[2.0, 1.0, 0.0]])]
    rate = np.array([1.0, 1.2])
    smear = (0.6 * rate / 12**0.5)[:, None] * along
    for number in range(2):
        total = sum(
            np.outer(row, row)
            for row in (by_pose[number], smear[number], *np.concatenate(shared))
        )
        variance = poses.variance(points, along)[number]
        assert_allclose(variance, np.diag(total), rtol=1e-9)
        cross = poses.cross_covariance(points, along)[number]
        assert_allclose(cross, total[[0, 0, 1], [1, 2, 2]], rtol=1e-9, atol=1e-15)
    assert_allclose(poses.covariance(points)[0], np.outer(by_pose[0], by_pose[0]),
                    atol=1e-12)  # fmt: skip


def test_derivatives_are_differences_of_placed_points() -> None:
    time = np.linspace(0, 4, 41)
    track = Trajectory.of_angles(
        time=time, position=np.stack([time**2 / 5, time, -time / 3], axis=1),
        heading=0.3 * time, pitch=0.1 * time, roll=-0.2 * time,
    )  # fmt: skip
    mounting = Mounting(
        lever_arm=(0.3, -0.2, 0.5), boresight=(0.1, 0.2, -0.3), pitch=-1.0,
        clock_offset=0.5, clock_drift=0.01,
    )  # fmt: skip
    away, at = np.array([[0.5, -1.0, 2.0], [1.0, 0.3, -0.7]]), np.array([1.0, 2.0])
    poses = instrument_poses(track, mounting, at)
    found = poses.derivatives(poses.place(away))
    assert found.shape == (8, 2, 3)
    step = 1e-5
    for number in range(7):
        low, high = (
            instrument_poses(track, changed(mounting, sign * step), at).place(away)
            for sign in (-np.eye(8)[number], np.eye(8)[number])
        )
        expected = (high - low) / (2 * step)
        assert_allclose(found[number], expected, rtol=0, atol=2e-4)
    # A drift counts from the reference of the offset, by the vehicle's clock.
    assert_allclose(found[7], found[6] * (1.01 * at)[:, None])


def test_correlated_errors_shift_points_together() -> None:
    correlation = np.eye(8)
    correlation[0, 6] = correlation[6, 0] = 1.0
    mounting = Mounting(
        clock_offset="101 s", lever_arm_uncertainties=(0.1, 0, 0),
        clock_uncertainty=0.05, boresight_uncertainty=0.0, clock_drift_uncertainty=0.0,
        correlation=tuple(map(tuple, correlation)),
    )  # fmt: skip
    poses = instrument_poses(TRACK, mounting, [0.0])
    shifts = poses.shared_errors(poses.position)[:, 0]
    # One error of the lever arm to the east, and of the clock, add up.
    assert_allclose(shifts.T @ shifts, np.outer([0.2, 0.05, 0], [0.2, 0.05, 0]),
                    atol=1e-12)  # fmt: skip


@pytest.mark.parametrize(
    ("mounting", "unknown"),
    [
        ({}, ("lever arm", "boresight", "clock offset")),
        ({"lever_arm_uncertainty": 0.1}, ("boresight", "clock offset")),
        ({"boresight_uncertainty": 0.1, "clock_uncertainty": 0.0}, ("lever arm",)),
        ({"boresight_uncertainty": 0.1, "lever_arm_uncertainty": 0.1,
          "clock_uncertainty": 0.1}, ()),
    ],
)  # fmt: skip
def test_uncertainties_that_are_not_stated_are_named(
    mounting: dict[str, Any], unknown: tuple[str, ...]
) -> None:
    poses = instrument_poses(TRACK, Mounting(**mounting), [101.0, 200.0])
    assert poses.known.tolist() == [True, False]
    assert poses.unknown == unknown
    covariance = np.zeros((6, 6))
    covariance[2, 2] = np.nan
    assert with_errors(poses, covariance).unknown == ("trajectory", *unknown)


def test_a_part_of_the_poses_has_all_that_belongs_to_it() -> None:
    poses = instrument_poses(TRACK, Mounting(), [101.0, 102.0, 103.0], duration=0.3)
    part = poses.part(np.array([2, 0]))
    for entry in dataclasses.fields(poses.vehicle):
        values = getattr(poses.vehicle, entry.name)
        assert_allclose(getattr(part.vehicle, entry.name), values[[2, 0]])
    assert (part.duration, part.mounting) == (0.3, poses.mounting)
    instant = InstrumentPoses(vehicle=poses.vehicle, mounting=poses.mounting)
    assert instant.duration == 0


def test_a_mean_pose_is_that_of_the_weights_of_readings() -> None:
    track = Trajectory.of_angles(
        time=[0.0, 1.0, 2.0], position=[[0, 0, 0], [1, 0, 0], [2, 0, 0]],
        heading=[0.0, 0.2, 0.4], position_uncertainty=[0.1, 0.2, 0.3],
        heading_uncertainty=0.0, level_uncertainty=0.0,
    )  # fmt: skip
    times = [[0.0, 1.0], [2.0, np.nan]]
    found = mean_instrument_poses(
        track, Mounting(), times, weight=[3.0, 1.0], duration=0.4
    )
    assert found.duration == 0.4
    assert_allclose(found.vehicle.time, [0.5, 1.0])
    assert_allclose(found.position, [[0.5, 0, 0], [1, 0, 0]], atol=1e-12)
    assert_allclose(found.velocity, [[1, 0, 0], [1, 0, 0]], atol=1e-12)
    variance = found.vehicle.covariance[:, 0, 0]
    assert_allclose(variance, [(3 * 0.01 + 0.09) / 4, 0.04], rtol=1e-9)
    # The mean direction of three headings of 0 and one of 0.4, as a rotation.
    forward = found.rotation[0, :, 2]
    angle = np.arctan2(np.sin(0.4), 3 + np.cos(0.4))
    assert_allclose(forward, [np.sin(angle), np.cos(angle), 0], atol=1e-12)
    assert_allclose(np.linalg.det(found.rotation), 1)
    assert found.rotation[1, 0, 2] == pytest.approx(np.sin(0.2))


def test_a_mean_pose_needs_a_pose_at_each_reading() -> None:
    times = [[101.0, 101.0, np.nan], [200.0, 102.0, np.nan]]
    found = mean_instrument_poses(TRACK, Mounting(), times, weight=[1, 1])
    assert found.known.tolist() == [False, True, False]
    assert np.isnan(found.rotation[[0, 2]]).all()
    assert found.duration == 0
    one = mean_instrument_poses(TRACK, Mounting(), times[1:], weight=[2.0])
    assert one.known.tolist() == [False, True, False]
    assert_allclose(one.position[1], [4, 2, 0])
    assert_allclose(one.rotation[1], instrument_poses(
        TRACK, Mounting(), [102.0]).rotation[0])  # fmt: skip


def test_uncertainties_of_a_mounting_are_eight_in_order() -> None:
    nan = np.nan
    assert_allclose(deviations(Mounting()), [*[nan] * 7, 0])
    common = Mounting(
        lever_arm_uncertainty=0.1, boresight_uncertainty=0.2, clock_uncertainty=0.3,
        clock_drift_uncertainty=4e-3,
    )  # fmt: skip
    expected = [0.1, 0.1, 0.1, 0.2, 0.2, 0.2, 0.3, 4e-3]
    assert_allclose(deviations(common), expected)
    assert_allclose(error_factors(common), np.diag(expected))
    each = Mounting(
        lever_arm_uncertainties=(1, 2, 3), boresight_uncertainties=(0.4, 0.5, 0.6)
    )
    assert_allclose(deviations(each), [1, 2, 3, 0.4, 0.5, 0.6, nan, 0])
    assert_allclose(error_factors(each), np.diag([1, 2, 3, 0.4, 0.5, 0.6, 0, 0]))


def test_a_changed_mounting_is_turned_about_its_own_axes() -> None:
    mounting = Mounting(
        lever_arm=(1, 2, 3),
        boresight=(0.3, -0.2, 0.1),
        clock_offset=5,
        clock_drift=1e-3,
    )
    step = np.array([0.1, 0.2, 0.3, 0.01, -0.02, 0.03, 0.4, 2e-3])
    found = changed(mounting, step)
    assert_allclose(found.lever_arm, [1.1, 2.2, 3.3])
    turn = Rotation.from_rotvec(mounting.boresight).as_matrix()
    turn = turn @ Rotation.from_rotvec(step[3:6]).as_matrix()
    assert_allclose(Rotation.from_rotvec(found.boresight).as_matrix(), turn)
    assert (found.clock_offset, found.clock_drift) == (5.4, 3e-3)


def test_quantities_without_error_have_no_correlation() -> None:
    covariance = np.zeros((8, 8))
    covariance[0, 0], covariance[6, 6], covariance[0, 6] = 4.0, 9.0, 1.5
    covariance[6, 0] = 1.5
    found = with_covariance(Mounting(boresight_uncertainty=0.1), covariance)
    assert found.lever_arm_uncertainties == (2, 0, 0)
    assert found.boresight_uncertainties == (0, 0, 0)
    assert found.boresight_uncertainty is None
    assert (found.clock_uncertainty, found.clock_drift_uncertainty) == (3, 0)
    expected = np.eye(8)
    expected[0, 6] = expected[6, 0] = 0.25
    assert_allclose(np.array(found.correlation), expected)


def test_a_mounting_file_has_the_fields_that_are_stated() -> None:
    assert mounting_text(Mounting()) == "[mounting]\n"
    correlation = np.eye(8)
    correlation[0, 6] = correlation[6, 0] = 0.12345678
    mounting = Mounting(
        lever_arm=(0.123456789, 0, 0), lever_arm_uncertainties=(0.002, 0.002, 0.03),
        boresight=(0.0123456, 0, 0), boresight_uncertainty=0.0123456,
        clock_offset=0.123456789, clock_uncertainty=0.0456789,
        clock_drift=1.23456789e-6, clock_drift_uncertainty=2e-9,
        correlation=tuple(map(tuple, correlation)),
    )  # fmt: skip
    *lines, end = mounting_text(mounting).split("\n")
    assert lines[:10] == [
        "[mounting]",
        'lever_arm = ["0.123457 m", "0.0 m", "0.0 m"]',
        'boresight = ["0.01235 rad", "0.0 rad", "0.0 rad"]',
        'clock_offset = "0.12346 s"',
        "clock_drift = 1.234568e-06",
        'lever_arm_uncertainties = ["0.002 m", "0.002 m", "0.03 m"]',
        'boresight_uncertainty = "0.0123456 rad"',
        'clock_uncertainty = "0.04568 s"',
        "clock_drift_uncertainty = 2e-09",
        "correlation = [",
    ]
    assert lines[10] == "    [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.123457, 0.0],"
    assert (len(lines), lines[-1], end) == (19, "]", "")


@pytest.mark.parametrize(
    ("value", "spread", "expected"),
    [
        (1.23456789, 0.02, 1.23457),
        (1.23456789, 0.1, 1.2346),
        (1.23456789, 1.0, 1.235),
        (1234.56789, 2000.0, 1235.0),
        (1.23456789, 0.0, 1.23456789),
        (1.23456789, np.nan, 1.23456789),
        ((1.23456789, 2.3456789), (0.02, 0.2), (1.23457, 2.3457)),
    ],
)
def test_numbers_are_rounded_to_a_thousandth_of_their_uncertainty(
    value: Any, spread: Any, expected: Any
) -> None:
    assert _rounded(value, spread) == expected
