"""Motion of an instrument along a line, against its poses and its errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.imaging.moving import moving_frame
from amulor.imaging.observation import geometry_of
from amulor.platform import Mounting, Trajectory
from amulor.site.registration import line
from amulor.site.registration.line import Motion, straightened, track_in_frame

ROWS, COLUMNS = 10, 6
#: Seconds from row to row; the pixels of a row are measured at once.
STEP = 0.5
MOUNTING = Mounting.model_validate(
    {
        "pitch": "-90 deg", "lever_arm": ("0.1 m", "0.2 m", "0.3 m"),
        "lever_arm_uncertainties": (1e-3, 0.0, 2e-3),
        "boresight_uncertainties": (0.0, 4e-3, 0.0), "clock_uncertainty": 5e-3,
    }
)  # fmt: skip


def _image() -> xr.Dataset:
    """Range image of a plane 1.5 m ahead, row after row, with an interval of 1 s."""
    image = scenes.plane((0, 0, 1), 1.5, rows=ROWS, columns=COLUMNS, own=2e-3)
    time = 1.0 + STEP * np.arange(ROWS)[:, None] * np.ones((ROWS, COLUMNS))
    return image.assign_coords(
        time=(("row", "column"), time, {"units": "s", "long_name": "time of the pixel"})
    )


def _track(**errors: Any) -> Trajectory:
    """Trajectory to the north-east with 0.4 m/s, turning by 20 mrad/s."""
    time = np.arange(0.0, 8.0, 0.25)
    return Trajectory.of_angles(
        time=time, position=np.outer(time, [0.24, 0.32, 0]) + np.array([5, 6, -7]),
        heading=0.3 + 0.02 * time,
        **{"position_uncertainty": 0.03, "heading_uncertainty": 0.01,
           "level_uncertainty": 0.002, **errors},
    )  # fmt: skip


SCAN: Any = SimpleNamespace(name="line 1", instrument="lidar", epoch="one")


def _motion(
    *, position: float | None = None, attitude: float | None = None, **errors: Any
) -> Motion:
    frame = moving_frame(_image(), trajectory=_track(**errors), mounting=MOUNTING)
    stated: Any = SimpleNamespace(position_drift=position, attitude_drift=attitude)
    return line._motion(SCAN, stated, frame, _image())


def test_a_line_has_the_pose_in_its_middle_and_the_share_of_its_time() -> None:
    motion = _motion()
    rows = np.repeat(np.arange(ROWS) / (ROWS - 1), COLUMNS).reshape(ROWS, COLUMNS)
    assert_allclose(motion.course, rows)
    middle = (ROWS * COLUMNS) // 2
    poses = motion.poses
    assert_allclose(motion.start.position, poses.position[middle])
    assert_allclose(motion.start.rotation, poses.rotation[middle])
    # Errors of the vehicle's attitude move the instrument by its lever arm.
    arm = motion.start.position - poses.vehicle.position[middle]
    assert np.linalg.norm(arm) == pytest.approx(np.sqrt(0.14))
    sigma = np.diag([0.002, 0.002, 0.01])
    carried = np.cross(sigma, arm)
    expected = 0.03**2 * np.eye(3) + carried.T @ carried
    assert_allclose(motion.covariance[:3, :3], expected, atol=1e-12)
    assert_allclose(motion.covariance[3:, 3:], sigma**2, atol=1e-12)


def test_errors_of_a_mounting_and_of_drifts_are_counted() -> None:
    motion = _motion()
    assert motion.mounting.shape == (4, 8)
    assert_allclose(
        np.abs(motion.mounting).max(axis=0), [1e-3, 0, 2e-3, 0, 4e-3, 0, 5e-3, 0]
    )
    # Equal uncertainties do not state how errors change: all may change.
    assert motion.drift[0] == pytest.approx(0.03)
    attitude = np.sqrt((2 * 0.002**2 + 0.01**2) / 3)
    assert motion.drift[1] == pytest.approx(attitude)
    length = np.linalg.norm(motion.poses.position[-1] - motion.poses.position[0])
    assert motion.bend == pytest.approx(attitude * length / 2, rel=1e-6)
    assert motion.forms == (
        line._forms(0.03, 2e-3), line._forms(attitude * 1.5, 2e-3)
    )  # fmt: skip
    assert len(motion.keys) == 4 + 3 + 3 * sum(motion.forms)
    stated = _motion(position=0.004, attitude=0.003)
    assert stated.drift == pytest.approx((0.008, 0.006))
    # Uncertainties that grow from 10 to 50 mm have drifted by the difference.
    grown = _motion(position_uncertainty=np.linspace(0.01, 0.05, 32))
    first, last = 0.01 + 0.04 * np.array([1.0, 5.5]) / 7.75
    assert grown.drift[0] == pytest.approx(np.sqrt(last**2 - first**2), rel=1e-3)


def test_the_sum_of_the_shifts_is_the_shift() -> None:
    motion = _motion()
    pixel = np.array([0, 17, 33, 59])
    points = np.random.default_rng(2).normal((0, 0, 1.5), size=(4, 3))
    factors = np.random.default_rng(3).normal(size=len(motion.keys))
    shifts = motion.shifts(pixel, points)
    assert shifts.shape == (len(motion.keys), 4, 3)
    together = motion.shift(pixel, points, factors)
    assert_allclose(together, np.tensordot(factors, shifts, 1), atol=1e-12)


def test_shifts_are_those_of_moved_and_turned_poses() -> None:
    motion = _motion()
    pixel = np.array([0, 33])
    points = np.array([[0.1, 0.2, 1.5], [-0.3, 0.1, 1.4]])
    place = motion.start.place(points)
    shifts = motion.shifts(pixel, points) @ motion.start.rotation.T
    share = motion.course.ravel()[pixel]
    turn = 4
    for axis in range(3):
        # The track turns about its middle.
        expected = (motion.bend * (2 * share - 1))[:, None] * np.eye(3)[axis]
        assert_allclose(shifts[turn + axis], expected, atol=1e-12)
    size = motion.drift[0] * np.sqrt(2) / (2 * np.pi) * np.cos(2 * np.pi * share)
    at = motion.keys.index("drift 2 of position north: line 1")
    assert_allclose(shifts[at], np.outer(size, [0.0, 1.0, 0.0]), atol=1e-12)
    size = motion.drift[1] * np.sqrt(2) / np.pi * np.cos(np.pi * share)
    at = motion.keys.index("drift 1 of attitude east: line 1")
    away = place - motion.poses.vehicle.position[pixel]
    expected = np.cross(np.outer(size, [1.0, 0.0, 0.0]), away)
    assert_allclose(shifts[at], expected, atol=1e-12)
    # 1 mm to the right of the vehicle, whose heading is known.
    at = motion.keys.index("lever arm right: lidar, one")
    rotation = motion.poses.vehicle.rotation[pixel]
    sign = motion.mounting[np.abs(motion.mounting[:, 0]).argmax(), 0] / 1e-3
    assert_allclose(shifts[at], sign * 1e-3 * rotation[:, :, 0], atol=1e-9)


def test_forms_beyond_the_unknowns_are_the_rest_of_the_walk() -> None:
    motion = _motion(position=0.001, attitude=0.0005)
    pixel = np.arange(ROWS) * COLUMNS
    position, attitude = motion.rests(pixel)
    share = motion.course.ravel()[pixel]
    for rest, size, known in (
        (position, 0.002, motion.forms[0]), (attitude, 0.001, motion.forms[1])
    ):  # fmt: skip
        k = np.pi * (known + 1)
        assert_allclose(rest[0], size * np.sqrt(2) / k * np.cos(k * share))
        assert len(rest) == line._LAST - known


def test_a_range_changes_during_a_reading_by_the_motion_along_the_beam() -> None:
    frame = moving_frame(_image(), trajectory=_track(), mounting=MOUNTING)
    poses = frame.poses
    beam = np.broadcast_to(geometry_of(_image()).beam.direction, (ROWS, COLUMNS, 3))
    ahead = poses.turn(beam.reshape(-1, 3))
    rate = np.abs((poses.velocity * ahead).sum(axis=1))
    expected = rate * poses.duration / np.sqrt(12)
    found = line._smear(frame, _image())
    assert_allclose(found.ravel(), expected)


def test_a_straightened_image_has_the_points_of_the_moving_one() -> None:
    motion, image = _motion(), _image()
    made = straightened(image, motion)
    geometry = geometry_of(made)
    beam = geometry_of(image).beam
    here = geometry_of(image).position(image["slant_range"].values).reshape(-1, 3)
    assert beam.direction.shape[-1] == 3
    expected = motion.poses.place(here)
    found = motion.start.place(
        geometry.position(made["slant_range"].values).reshape(-1, 3)
    )
    assert_allclose(found, expected, atol=1e-9)
    assert_array_equal(made["quality_flag"], image["quality_flag"])
    assert made["origin_x"].attrs["units"] == "m"
    assert made["azimuth"].attrs["units"] == "rad"
    assert_allclose(made["geometry"].attrs["emitter_position"], 0.0)


def test_pixels_without_a_pose_have_no_range() -> None:
    motion = _motion()
    known = np.ones(ROWS * COLUMNS, dtype=bool)
    known[[3, 40]] = False
    poses = SimpleNamespace(
        known=known, place=motion.poses.place, turn=motion.poses.turn
    )
    stub: Any = SimpleNamespace(start=motion.start, poses=poses)
    made = straightened(_image(), stub)
    missing = np.isnan(made["slant_range"].values).ravel()
    assert_array_equal(np.flatnonzero(missing), [3, 40])
    flags = made["quality_flag"].values.ravel()
    assert_array_equal(flags != 0, ~known)
    assert flags[3] == int(QualityFlag.MISSING)
    assert made["origin_x"].values.ravel()[3] == 0.0
    azimuth = _image()["azimuth"].values.ravel()
    assert made["azimuth"].values.ravel()[40] == pytest.approx(azimuth[40])


@dataclass(frozen=True)
class _Vehicle:
    """Times and rates of a vehicle."""

    time: np.ndarray
    velocity: np.ndarray
    turn_rate: np.ndarray


@dataclass(frozen=True)
class _Poses:
    """Poses of which only the rates are used."""

    vehicle: _Vehicle


def test_velocities_lose_what_drifts_explain() -> None:
    """A slow swing of the velocity stays, and noise as large as the drift's goes."""
    rng = np.random.default_rng(5)
    time = np.linspace(0.0, 100.0, 2001)
    swing = 0.3 * np.cos(np.pi * 4 * time / 100)
    noise = 0.002 * rng.standard_normal(time.size)
    velocity = np.stack([swing + noise, 0 * time + 0.5, noise], axis=1)
    velocity[7] = np.nan
    rate = np.nan_to_num(0.1 * velocity)

    order = np.setdiff1d(np.arange(time.size), [7])
    poses: Any = _Poses(_Vehicle(time=time, velocity=velocity, turn_rate=rate))
    found = line._without_walk(poses, order, [0.05, 0.005])
    made = found.vehicle.velocity
    assert np.isnan(made[7]).all()
    assert_allclose(made[order, 0], swing[order], atol=2e-3)
    assert_allclose(made[order, 1], 0.5, atol=1e-6)
    assert_allclose(made[order, 2], 0.0, atol=1e-9)
    assert_allclose(found.vehicle.turn_rate[order, 0], 0.1 * swing[order], atol=2e-4)
    plain = line._without_walk(poses, order, [0.0, 0.0])
    assert_allclose(plain.vehicle.velocity[order, 2], noise[order], atol=2e-3)


def test_a_trajectory_is_shifted_into_the_frame_of_the_site() -> None:
    track = replace(_track(), crs="EPSG:32632", crs_offset=(500.0, 600.0, 0.0))

    def site(crs: str, offset: tuple[float, float, float]) -> Any:
        return SimpleNamespace(frame=SimpleNamespace(crs=crs, crs_offset=offset))

    moved = track_in_frame(track, site("EPSG:32632", (490.0, 630.0, 5.0)))
    assert_allclose(moved.position, track.position + np.array([10.0, -30.0, -5.0]))
    assert track_in_frame(track, site("", (1.0, 2.0, 3.0))) is track
    free = replace(track, crs="")
    assert track_in_frame(free, site("EPSG:32632", (1.0, 2.0, 3.0))) is free
    with pytest.raises(CubeError) as caught:
        track_in_frame(track, site("EPSG:25832", (0.0, 0.0, 0.0)))
    assert str(caught.value) == (
        "the trajectory has the reference system EPSG:32632, the site EPSG:25832; "
        "import the trajectory with --crs EPSG:25832"
    )


def test_a_line_without_uncertainties_is_one_line(monkeypatch) -> None:
    scan: Any = SimpleNamespace(
        name="line 1", trajectory=SimpleNamespace(file="a.csv", mounting=None)
    )
    site: Any = SimpleNamespace(frame=SimpleNamespace(crs="", crs_offset=(0, 0, 0)))
    still: Any = SimpleNamespace(trajectory=None)
    assert line.motion_of(site, still, _image()) is None
    monkeypatch.setattr(line, "read_trajectory", lambda _: _track())
    unknown = SimpleNamespace(unknown=("clock", "lever arm"))
    monkeypatch.setattr(line, "moving_frame", lambda *_, **__: unknown)
    with pytest.raises(CubeError) as caught:
        line.motion_of(site, scan, _image())
    assert str(caught.value) == (
        "scan 'line 1': nobody states the uncertainty of the clock, lever arm; state "
        "it in the columns of amulor import trajectory, or in the mounting"
    )

    def refused(*_: Any, **__: Any) -> None:
        raise CubeError("no pixel was measured")

    monkeypatch.setattr(line, "moving_frame", refused)
    with pytest.raises(CubeError, match=r"^scan 'line 1': no pixel was measured$"):
        line.motion_of(site, scan, _image())
