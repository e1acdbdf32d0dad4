"""Clouds from a moving vehicle: against an independent renderer, and their errors."""

import moving_pass
import numpy as np
import pytest

from amulor import imaging, rejection, samples
from amulor.errors import CubeError
from amulor.optics import rays
from amulor.platform import (
    Mounting,
    Trajectory,
    instrument_poses,
    mean_instrument_poses,
)

SPEED = np.array([0.15, 0.1, 0.02])
START = np.array([2.0, -1.0, -8.0])
ANGLES = (0.8, 0.05, -0.03)
MOUNTING = {
    "lever_arm": ("0.2 m", "0.35 m", "1.1 m"),
    "heading": "0.03 rad",
    "pitch": "-1.5 rad",
    "roll": "0.02 rad",
}


@pytest.fixture(scope="module")
def ladder():
    """A range image with times of its pixels."""
    return imaging.range_image(rejection.cross_polarized(samples.cube("ladder")))


def _track(end, **options):
    time = np.linspace(-5.0, end + 5.0, 60)
    return Trajectory.of_angles(
        time=time,
        position=START + time[:, None] * SPEED,
        heading=ANGLES[0],
        pitch=ANGLES[1],
        roll=ANGLES[2],
        **options,
    )


def _level_inverse(matrix):
    return moving_pass.LEVEL.T @ matrix


@pytest.fixture(scope="module")
def passed(ladder):
    """The image of a pass over the sea bed, and the true points, from the oracle."""
    image = ladder.copy(deep=True)
    vehicle = moving_pass.attitude(*ANGLES)
    boresight = _level_inverse(moving_pass.attitude(0.03, -1.5, 0.02))
    time = image["time"].values
    duration = float(np.median(np.diff(time, axis=1)))
    azimuth, elevation = image["azimuth"].values, image["elevation"].values
    emitter = np.asarray(image["geometry"].attrs["emitter_position"])
    ranges = np.full(time.shape, np.nan)
    points = np.full((*time.shape, 3), np.nan)
    for row in range(0, time.shape[0], 4):
        for column in range(0, time.shape[1], 4):
            middle = time[row, column] + duration / 2
            place = START + middle * SPEED
            turn = vehicle @ boresight
            start = place + vehicle @ np.array([0.2, 0.35, 1.1]) + turn @ emitter
            beam = turn @ moving_pass.beam_of(
                azimuth[row, column], elevation[row, column]
            )
            ranges[row, column] = moving_pass.distance_to_bed(start, beam)
            points[row, column] = start + ranges[row, column] * beam
    image["slant_range"].values = np.where(np.isfinite(ranges), ranges, 1.0)
    image["quality_flag"].values[:] = np.where(np.isfinite(ranges), 0, 1)
    return image, points


def test_points_of_a_straight_pass_are_those_of_an_independent_renderer(passed):
    image, points = passed
    frame = imaging.moving_frame(
        image,
        trajectory=_track(float(image["time"].max())),
        mounting=Mounting(**MOUNTING),
    )
    cloud = imaging.point_cloud(image, frame=frame)
    found = np.stack([cloud[axis].values for axis in "xyz"], axis=-1)
    expected = points[cloud["row"].values, cloud["column"].values]
    assert found.shape[0] > 100
    np.testing.assert_allclose(found, expected, atol=1e-9)
    on_bed = [moving_pass.sea_bed(x, y) for x, y in found[:, :2]]
    np.testing.assert_allclose(found[:, 2], on_bed, atol=1e-9)


@pytest.mark.parametrize("missing", [False, True])
def test_points_of_readings_in_turn_are_means_of_those_rendered_one_by_one(
    ladder, missing
):
    """Three readings in turn, each rendered from where the instrument was then."""
    weight = np.array([0.2, 0.3, 0.5])
    offsets = np.array([0.05, 0.25, 0.6])
    pixels = [(0, 0), (0, 7), (20, 3), (36, 11)]
    emitter = np.asarray(ladder["geometry"].attrs["emitter_position"])
    image = ladder.copy(deep=True)
    time = image["time"].values
    times = time + offsets[:, None, None]
    image["quality_flag"].values[:] = 1
    expected = []
    for place in pixels:
        beam = moving_pass.beam_of(
            float(image["azimuth"].values[place]),
            float(image["elevation"].values[place]),
        )
        rendered = [
            moving_pass.reading_of(
                time[place] + offset, beam, start=START, speed=SPEED, angles=ANGLES,
                mounting={"lever_arm": (0.2, 0.35, 1.1), "angles": (0.03, -1.5, 0.02)},
                emitter=emitter,
            )
            for offset in offsets
        ]  # fmt: skip
        share = weight * [not missing, True, True]
        share = share / share.sum()
        ranges = np.array([distance for distance, _ in rendered])
        image["slant_range"].values[place] = share @ ranges
        image["quality_flag"].values[place] = 0
        expected.append(share @ np.array([point for _, point in rendered]))
    if missing:
        times[0] = np.nan
    image = image.assign_coords(
        reading_time=(("reading", "row", "column"), times, {"units": "s"}),
        reading_duration=(
            ("reading", "row", "column"), np.full(times.shape, 0.1), {"units": "s"},
        ),
        reading_weight=("reading", weight, {"units": "1"}),
    )  # fmt: skip
    for name in ("reading_time", "reading_duration", "reading_weight"):
        image[name].attrs["long_name"] = "window"
    frame = imaging.moving_frame(
        image, trajectory=_track(float(time.max())), mounting=Mounting(**MOUNTING)
    )
    cloud = imaging.point_cloud(image, frame=frame)
    found = np.stack([cloud[axis].values for axis in "xyz"], axis=-1)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    # From the begin of the first window to the end of the last, at the speed.
    length = 0.45 if missing else 0.65
    spread = np.linalg.norm(SPEED) * length
    np.testing.assert_allclose(frame.spread[0, 0], spread, rtol=1e-9)


def test_the_mean_pose_of_a_turn_is_its_middle():
    """A vehicle that turns by 30 degrees at a constant rate, read at both ends."""
    time = np.linspace(0.0, 1.0, 101)
    track = Trajectory.of_angles(
        time=time, position=np.zeros((101, 3)), heading=np.radians(30) * time
    )
    poses = mean_instrument_poses(
        track, Mounting(), [[0.1, 0.2], [0.9, 0.6]], weight=[1, 1]
    )
    expected = [moving_pass.attitude(np.radians(angle), 0, 0) for angle in (15, 12)]
    np.testing.assert_allclose(poses.rotation, expected, atol=1e-9)


def test_the_sample_has_no_window(ladder):
    """The renderer follows straight beams, so the image must have straight beams."""
    assert "window_distance" not in ladder["geometry"].attrs
    np.testing.assert_allclose(
        rays.direction(0.1, 0.2), moving_pass.beam_of(0.1, 0.2), atol=1e-15
    )


def test_pixels_without_a_pose_are_left_out(passed):
    image, _ = passed
    half = float(image["time"].max()) / 2
    time = np.linspace(-1.0, half, 40)
    track = Trajectory.of_angles(
        time=time, position=START + time[:, None] * SPEED, heading=0.0
    )
    frame = imaging.moving_frame(image, trajectory=track, mounting=Mounting())
    cloud = imaging.point_cloud(image, frame=frame)
    taken = image["time"].values[cloud["row"].values, cloud["column"].values]
    assert taken.max() < half
    assert frame.unknown == ("trajectory", "lever arm", "boresight", "clock offset")
    assert "frame_matrix" not in cloud.attrs


def test_a_trajectory_of_another_time_is_refused(ladder):
    time = np.arange(1e4, 1e4 + 9)
    track = Trajectory.of_angles(time=time, position=np.zeros((9, 3)), heading=0.0)
    with pytest.raises(CubeError, match=r"no pixel .* from 10000\.000 to 10008\.000 s"):
        imaging.moving_frame(ladder, trajectory=track, mounting=Mounting())


def test_an_image_without_times_is_refused(ladder):
    with pytest.raises(CubeError, match="has no time of each pixel"):
        imaging.moving_frame(
            ladder.drop_vars("time"), trajectory=_track(9.0), mounting=Mounting()
        )


def test_range_changes_during_a_pixel_enter_the_uncertainty():
    """A vehicle that sinks at 0.2 m/s, looks down and takes 0.5 s for a pixel."""
    time = np.arange(0.0, 5.0)
    track = Trajectory.of_angles(
        time=time, position=time[:, None] * [0, 0, -0.2], heading=0.0,
        position_uncertainty=0.0, heading_uncertainty=0.0, level_uncertainty=0.0,
    )  # fmt: skip
    down = Mounting(
        pitch="-90 deg", lever_arm_uncertainty="0 m", boresight_uncertainty="0 rad",
        clock_uncertainty="0 s",
    )  # fmt: skip
    poses = instrument_poses(track, down, [2.0], duration=0.5)
    variance = poses.variance(poses.place([[0, 0, 3.0]]), poses.turn([[0, 0, 1.0]]))
    np.testing.assert_allclose(
        np.sqrt(variance[0]), [0, 0, 0.1 / np.sqrt(12)], atol=1e-12
    )


def test_points_and_distances_lie_in_their_intervals_at_the_stated_rate():
    """Poses, lever arm, boresight and clock drawn from their uncertainties, 400 times.

    The errors of poses are common to all poses of a run, which is how the errors of an
    inertial system look within a short pass. The true points come from the renderer's
    attitudes.
    """
    rng = np.random.default_rng(5)
    time = np.linspace(0.0, 20.0, 41)
    at = np.linspace(1.0, 19.0, 25)
    sigma = {"place": 0.02, "turn": 2e-3, "arm": 4e-3, "bend": 1e-3, "clock": 0.03}
    vehicle = moving_pass.attitude(*ANGLES)
    boresight = _level_inverse(moving_pass.attitude(0.03, -1.5, 0.02))
    arm = np.array([0.2, 0.35, 1.1])
    away = np.column_stack([np.linspace(-1, 1, 25), np.zeros(25), np.full(25, 4.0)])
    mounting = Mounting(
        **MOUNTING, lever_arm_uncertainty="4 mm", boresight_uncertainty="1 mrad",
        clock_uncertainty="30 ms",
    )  # fmt: skip
    stated = np.diag([sigma["place"] ** 2] * 3 + [sigma["turn"] ** 2] * 3)

    def small(vector):
        angle = np.linalg.norm(vector)
        x, y, z = vector / angle
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross

    course = _track(20.0)
    pulls = []
    for _ in range(400):
        shift, turn = rng.normal(0, sigma["place"], 3), rng.normal(0, sigma["turn"], 3)
        stated_track = Trajectory(
            time=time,
            position=START + time[:, None] * SPEED,
            attitude=np.tile(course.attitude[0], (41, 1)),
            covariance=np.tile(stated, (41, 1, 1)),
            longest_gap=5.0,
        )
        poses = instrument_poses(stated_track, mounting, at)
        found = poses.place(away)
        true_vehicle = small(turn) @ vehicle
        true_arm = arm + rng.normal(0, sigma["arm"], 3)
        true_sight = boresight @ small(rng.normal(0, sigma["bend"], 3))
        instants = at + rng.normal(0, sigma["clock"])
        true = (
            START + shift + instants[:, None] * SPEED
            + (true_arm + away @ true_sight.T) @ true_vehicle.T
        )  # fmt: skip
        variance = poses.variance(found, poses.turn(away / 4))
        pulls.append((found - true) / np.sqrt(variance))
    inside = [np.abs(np.concatenate(pulls)) < limit for limit in (1.0, 1.96)]
    # All points of a run share their errors: 400 runs of three coordinates.
    assert np.mean(inside[0]) == pytest.approx(0.683, abs=0.04)
    assert np.mean(inside[1]) == pytest.approx(0.95, abs=0.02)
