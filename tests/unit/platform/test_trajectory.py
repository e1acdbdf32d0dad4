"""Trajectories: interpolation against closed forms, gaps, errors and their coverage."""

import dataclasses

import moving_pass
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from amulor._attitude import rotation_by
from amulor.errors import SurveyError
from amulor.platform import (
    Mounting,
    Trajectory,
    instrument_poses,
    mean_instrument_poses,
    read_mounting,
    rotation_of,
)
from amulor.platform.mounting import error_factors, mounting_text, with_covariance

TIME = np.linspace(0.0, 20.0, 201)
#: A shift to the east of 2 mm that comes with a turn about up of 1 mrad.
COVARIANCE = np.outer([2e-3, 0, 0, 0, 0, 1e-3], [2e-3, 0, 0, 0, 0, 1e-3])


def _course(time):
    """A course with changing speed, heading, pitch and roll, in closed form."""
    place = np.stack(
        [3 * np.sin(0.1 * time), 0.2 * time, -8 + 0.1 * np.sin(0.5 * time)], axis=-1
    )
    return place, 0.05 * time, 0.03 * np.sin(0.8 * time), 0.05 * np.cos(0.6 * time)


@pytest.mark.parametrize("size", [0.0, 1e-9, 0.3, 2.0, 3.1])
def test_a_rotation_vector_turns_as_scipy_does(size):
    vector = np.random.default_rng(7).normal(size=3)
    vector *= size / np.linalg.norm(vector)
    expected = Rotation.from_rotvec(vector).as_matrix()
    np.testing.assert_allclose(rotation_by(vector), expected, rtol=0, atol=1e-14)


def _track(time=TIME, **options):
    place, heading, pitch, roll = _course(time)
    return Trajectory.of_angles(
        time=time, position=place, heading=heading, pitch=pitch, roll=roll, **options
    )


@pytest.mark.parametrize("angles", [(0, 0, 0), (1.1, 0.3, -0.4), (-2.5, -1.5, 2.0)])
def test_attitudes_are_those_of_elementary_rotations(angles):
    np.testing.assert_allclose(
        rotation_of(*angles), moving_pass.attitude(*angles), atol=1e-15
    )


def test_poses_between_messages_follow_a_smooth_course():
    at = np.linspace(1.0, 19.0, 333)
    place, *angles = _course(at)
    poses = _track().at(at)
    np.testing.assert_allclose(poses.position, place, atol=1e-8)
    expected = np.array([moving_pass.attitude(*row) for row in np.transpose(angles)])
    np.testing.assert_allclose(poses.rotation, expected, atol=1e-7)


def test_velocities_are_the_derivatives_of_the_course():
    at = np.linspace(1.0, 19.0, 50)
    poses = _track().at(at)
    speed = np.stack(
        [0.3 * np.cos(0.1 * at), np.full(50, 0.2), 0.05 * np.cos(0.5 * at)], axis=-1
    )
    np.testing.assert_allclose(poses.velocity, speed, atol=1e-6)
    step = 1e-4
    rotations = [
        np.array(
            [
                moving_pass.attitude(*row[1:])
                for row in zip(*_course(at + d), strict=True)
            ]
        )
        for d in (-step, step)
    ]
    slope = (rotations[1] - rotations[0]) / (2 * step)
    spin = slope @ np.swapaxes((rotations[0] + rotations[1]) / 2, 1, 2)
    expected = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=-1)
    np.testing.assert_allclose(poses.turn_rate, expected, atol=1e-5)


def test_headings_across_north_take_the_short_way():
    track = Trajectory.of_angles(
        time=[0.0, 1.0, 2.0, 3.0],
        position=np.zeros((4, 3)),
        heading=np.radians([358.0, 359.0, 0.0, 1.0]),
    )
    forward = track.at([1.5]).rotation[0, :, 2]
    assert np.degrees(np.arctan2(forward[0], forward[1])) == pytest.approx(-0.5)


def test_nothing_is_extrapolated_or_taken_from_gaps():
    time = np.concatenate([np.arange(0, 5, 0.5), np.arange(12, 17, 0.5)])
    track = _track(time)
    poses = track.at([-0.1, 0.0, 4.5, 4.6, 11.9, 12.0, 16.5, 16.6])
    assert poses.known.tolist() == [False, True, True, False, False, True, True, False]
    assert track.gaps.tolist() == [[4.5, 12.0]]
    assert np.isnan(poses.covariance[~poses.known]).all()


def test_a_single_pose_between_gaps_is_no_trajectory():
    time = np.array([0.0, 0.5, 1.0, 10.0, 20.0, 20.5, 21.0])
    assert not _track(time).at([10.0]).known[0]


def test_covariances_are_those_of_the_messages_and_linear_between_them():
    sigma = np.linspace(0.01, 0.03, 201)
    track = _track(
        position_uncertainty=sigma, heading_uncertainty=2e-3, level_uncertainty=1e-3
    )
    at = np.array([TIME[50], (TIME[50] + TIME[51]) / 2])
    found = track.at(at).covariance
    expected = [sigma[50] ** 2, (sigma[50] ** 2 + sigma[51] ** 2) / 2]
    np.testing.assert_allclose(found[:, 0, 0], expected, rtol=1e-9)
    # The heading turns about up; pitch and roll together about any level axis.
    turned = found[0, 3:, 3:]
    assert np.sqrt(turned[2, 2]) == pytest.approx(2e-3, rel=2e-3)
    assert np.sqrt(turned[0, 0]) == pytest.approx(1e-3, rel=3e-2)


@pytest.mark.parametrize("interval", [0.5, 1.0, 2.0])
def test_the_interpolation_error_covers_a_course_sampled_too_rarely(interval):
    rng = np.random.default_rng(11)
    pulls = []
    for _ in range(40):
        rate, phase = rng.uniform(0.3, 1.5), rng.uniform(0, 6, 3)
        time = np.arange(0, 30, interval)
        at = rng.uniform(0, time[-1], 60)

        def place(t, rate=rate, phase=phase):
            return 0.3 * np.sin(rate * t[:, None] + phase)

        track = Trajectory.of_angles(
            time=time, position=place(time), heading=0.0, position_uncertainty=0.0,
            heading_uncertainty=0.0, level_uncertainty=0.0,
        )  # fmt: skip
        poses = track.at(at)
        sigma = np.sqrt(np.einsum("nii->ni", poses.covariance)[:, :3])
        pulls.append((poses.position - place(at)) / sigma)
    assert np.mean(np.abs(np.concatenate(pulls)) < 1.96) > 0.93


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"time": np.zeros(3)}, "not after time 0; sort"),
        ({"position": np.zeros((2, 3))}, r"position has shape \(2, 3\); needed is \(3"),
        ({"position": np.full((3, 3), np.nan)}, "position has a value"),
        ({"longest_gap": 0.0}, "longest_gap 0; needed is above"),
    ],
)
def test_impossible_trajectories_are_refused(change, words):
    fields = {
        "time": np.arange(3.0),
        "position": np.zeros((3, 3)),
        "attitude": np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)),
        "covariance": np.zeros((3, 6, 6)),
        "longest_gap": 5.0,
    }
    with pytest.raises(ValueError, match=words):
        Trajectory(**{**fields, **change})


def test_beams_of_a_vehicle_that_heads_east_and_looks_down() -> None:
    track = Trajectory.of_angles(
        time=[0.0, 1.0],
        position=[[1, 2, -5], [1, 2, -5]],
        heading=np.pi / 2,
        position_uncertainty=0.01,
        heading_uncertainty=1e-3,
        level_uncertainty=1e-3,
    )
    poses = instrument_poses(track, Mounting(pitch="-90 deg"), [0.25, 0.75])
    # Forward is down, and right is south.
    beams = poses.turn([[0, 0, 1], [1, 0, 0]])
    np.testing.assert_allclose(beams, [[0, 0, -1], [0, -1, 0]], atol=1e-12)
    places = poses.place([[0, 0, 3], [3, 0, 0]])
    np.testing.assert_allclose(places, [[1, 2, -8], [1, -1, -5]], atol=1e-12)


def test_errors_of_the_mounting_shift_points_by_lever_arm_angle_and_clock() -> None:
    # North at 0.2 m/s and turning left by 0.1 rad/s; forward is north at 0.5 s.
    time = np.linspace(0.0, 1.0, 11)
    track = Trajectory.of_angles(
        time=time,
        position=np.stack([0 * time, 0.2 * time, 0 * time], axis=1),
        heading=-0.1 * (time - 0.5),
    )
    mounting = Mounting(
        lever_arm_uncertainty="2 mm", boresight_uncertainty="1 mrad",
        clock_uncertainty="5 ms",
    )  # fmt: skip
    poses = instrument_poses(track, mounting, [0.5])
    point = poses.place([[0, 0, 3]])
    expected = np.zeros((8, 3))  # the last for a clock without a drift
    # Right is east, down is down and forward is north.
    expected[0] = [0.002, 0, 0]
    expected[1] = [0, 0, -0.002]
    expected[2] = [0, 0.002, 0]
    # A turn of 1 mrad moves a point 3 m ahead by 3 mm: up about the axis to the right,
    # right about the axis that points down, and not about its own.
    expected[3] = [0, 0, 0.003]
    expected[4] = [0.003, 0, 0]
    # The vehicle's way, and the swing of a point 3 m ahead to the left.
    expected[6] = 0.005 * np.array([-0.1 * 3, 0.2, 0])
    found = poses.shared_errors(point)
    assert found.shape == (8, 1, 3)
    np.testing.assert_allclose(found[:, 0], expected, atol=2e-6)
    np.testing.assert_allclose(poses.velocity, [[0, 0.2, 0]], atol=1e-4)


def test_a_reading_without_time_has_no_share_in_the_mean_pose() -> None:
    track = Trajectory.of_angles(
        time=[10.0, 11.0], position=[[0, 0, 0], [0.4, 0, 0]], heading=0.0
    )
    mean = mean_instrument_poses(
        track, Mounting(), [[10.25, np.nan], [10.75, 10.75]], weight=[0.25, 0.75]
    )
    np.testing.assert_allclose(mean.position[:, 0], [0.4 * 0.625, 0.4 * 0.75])


def test_uncertainties_of_a_level_vehicle_are_those_of_its_axes() -> None:
    # Heading east: pitch turns about south, roll about east.
    track = Trajectory.of_angles(
        time=[0.0, 1.0], position=np.zeros((2, 3)), heading=np.pi / 2,
        position_uncertainty=[0.01, 0.02, 0.03], heading_uncertainty=3e-3,
        level_uncertainty=1e-3,
    )  # fmt: skip
    for covariance in track.covariance:
        expected = np.square([0.01, 0.02, 0.03, 1e-3, 1e-3, 3e-3])
        np.testing.assert_allclose(covariance, np.diag(expected), atol=1e-18)


def test_directions_turn_with_the_vehicle_and_the_boresight():
    # East, with the instrument looking down: its forward is down, its down is west.
    track = Trajectory.of_angles(
        time=[0.0, 1.0], position=np.full((2, 3), 7.0), heading=np.pi / 2
    )
    poses = instrument_poses(track, Mounting(pitch="-90 deg"), [0.2, 0.5, 0.8])
    right, down, forward = [0, -1, 0], [-1, 0, 0], [0, 0, -1]
    np.testing.assert_allclose(
        poses.turn(np.eye(3)), [right, down, forward], atol=1e-15
    )


def test_noise_of_the_poses_makes_long_intervals_uncertain():
    """A vehicle at rest, whose positions alternate, without two of them."""
    time = np.delete(np.arange(0.0, 10.0, 0.1), [50, 51])
    place = np.zeros((time.size, 3))
    place[:, 0] = 0.005 * (-1.0) ** np.arange(time.size)
    track = Trajectory.of_angles(
        time=time,
        position=place,
        heading=0.0,
        position_uncertainty=0.005,
        heading_uncertainty=0.0,
        level_uncertainty=0.0,
    )
    poses = track.at([2.05, 5.05])
    sigma = np.sqrt(poses.covariance[:, 0, 0] - 0.005**2)
    # The interval is three times as long; departures near it are larger, too.
    assert sigma[1] >= 9 * sigma[0] > 0


def test_the_instrument_is_carried_by_its_lever_arm_and_boresight():
    time = np.arange(0.0, 4.0, 0.05)
    track = Trajectory.of_angles(
        time=time,
        position=np.stack([0.2 * time, 0.1 * time, -5 + 0 * time], axis=1),
        heading=0.3 * time,
    )
    mounting = Mounting(lever_arm=(0.3, 0.1, -0.2), pitch=-np.pi / 2)
    at = np.array([1.0, 2.0])
    poses = instrument_poses(track, mounting, at)
    vehicle = track.at(at)
    # Vehicle axes are right, down, forward: heading 0 is north, clockwise to the east.
    for k, angle in enumerate(0.3 * at):
        forward = np.array([np.sin(angle), np.cos(angle), 0.0])
        right = np.array([np.cos(angle), -np.sin(angle), 0.0])
        arm = 0.3 * right + 0.1 * np.array([0, 0, -1.0]) - 0.2 * forward
        np.testing.assert_allclose(
            poses.position[k] - vehicle.position[k], arm, atol=1e-6
        )
        # Pitched down by a right angle, the instrument looks down.
        looks = poses.turn(np.tile([0.0, 0.0, 1.0], (2, 1)))[k]
        np.testing.assert_allclose(looks, [0, 0, -1], atol=1e-6)
    ahead = poses.place(np.tile([0.0, 0.0, 2.0], (2, 1)))
    np.testing.assert_allclose(ahead - poses.position, [[0, 0, -2]] * 2, atol=1e-6)
    later, before = (
        instrument_poses(track, mounting, at + step).position for step in (1e-3, -1e-3)
    )
    np.testing.assert_allclose(poses.velocity, (later - before) / 2e-3, atol=1e-3)


def test_a_cubic_course_at_uneven_times_has_no_departures():
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.05, 0.2, 60))
    smooth = np.stack([time**3, 2 - time**2, 0.3 * time], axis=1) / 30
    still = np.tile([0.0, 0.0, 0.0, 1.0], (60, 1))
    track = Trajectory(
        time=time, position=smooth, attitude=still,
        covariance=np.tile(1e-6 * np.eye(6), (60, 1, 1)), longest_gap=1.0,
    )  # fmt: skip
    np.testing.assert_allclose(track._departures(0, 60), 0, atol=1e-9)
    # One pose that is off stands out by itself, and a quarter less beside it.
    off = smooth.copy()
    off[30, 1] += 0.01
    moved = dataclasses.replace(track, position=off)._departures(0, 60)
    row = int(np.argmax(np.abs(moved[:, 1])))
    np.testing.assert_allclose(np.abs(moved[row, 1]), 0.01, rtol=0.3)
    np.testing.assert_allclose(moved[:, [0, 2]], 0, atol=1e-9)
    assert np.count_nonzero(np.abs(moved[:, 1]) > 1e-9) == 5


def test_a_mounting_is_written_to_a_thousandth_of_its_uncertainties(tmp_path):
    path = tmp_path / "rov.toml"
    mounting = Mounting(
        lever_arm=(0.123456789, -1.23456789, 12.3456789),
        lever_arm_uncertainties=(0.002, 0.02, 0.3),
        heading=0.123456789, clock_offset=0.123456789, clock_uncertainty=0.004,
    )  # fmt: skip
    path.write_text(mounting_text(mounting))
    assert read_mounting(path) == mounting.model_copy(
        update={
            "lever_arm": (0.123457, -1.23457, 12.3457),
            "clock_offset": 0.123457,
        }
    )


def test_a_mounting_has_the_covariance_that_is_given_to_it():
    rng = np.random.default_rng(3)
    scale = np.array([1e-3, 2e-3, 3e-3, 1e-4, 2e-4, 3e-4, 1e-3, 1e-6])
    factors = scale[:, None] * rng.normal(size=(8, 20))
    covariance = factors @ factors.T / 20
    mounting = with_covariance(Mounting(lever_arm_uncertainty=1.0), covariance)
    sigma = np.sqrt(np.diag(covariance))
    assert mounting.lever_arm_uncertainty is None
    np.testing.assert_allclose(mounting.lever_arm_uncertainties, sigma[:3])
    np.testing.assert_allclose(mounting.boresight_uncertainties, sigma[3:6])
    assert mounting.clock_uncertainty == pytest.approx(sigma[6])
    assert mounting.clock_drift_uncertainty == pytest.approx(sigma[7])
    found = sigma[:, None] * np.array(mounting.correlation) * sigma
    np.testing.assert_allclose(found, covariance, rtol=0, atol=1e-8 * scale.max() ** 2)
    # The errors of poses multiply by factors of the same covariance.
    again = error_factors(mounting)
    np.testing.assert_allclose(
        again.T @ again / np.outer(sigma, sigma),
        covariance / np.outer(sigma, sigma), atol=1e-7,
    )  # fmt: skip


def test_errors_of_a_heading_move_points_with_the_position():
    # North is forward; the heading errs together with the position towards the east.
    track = Trajectory.of_angles(
        time=[0.0, 1.0], position=[[0.0, 0, 0], [0, 0, 0]], heading=[0.0, 0.0],
    )  # fmt: skip
    track = dataclasses.replace(track, covariance=np.tile(COVARIANCE, (2, 1, 1)))
    poses = instrument_poses(track, Mounting(), [0.5])
    # A turn to the left, about up, by 1 mrad carries a point 3 m ahead 3 mm west. It
    # comes with a shift of 2 mm east: 1 mm is left.
    (found,) = poses.covariance([[0.0, 3.0, 0.0]])
    np.testing.assert_allclose(found, np.diag([1e-6, 0, 0]), atol=1e-15)
    (behind,) = poses.covariance([[0.0, -3.0, 0.0]])
    np.testing.assert_allclose(behind, np.diag([25e-6, 0, 0]), atol=1e-15)


def test_a_date_that_is_none_is_named_with_its_field(tmp_path):
    path = tmp_path / "rov.toml"
    path.write_text('[mounting]\nclock_reference = "yesterday"\n')
    words = 'rov.toml: mounting.clock_reference: found "yesterday"; input should be'
    with pytest.raises(SurveyError, match=words):
        read_mounting(path)
