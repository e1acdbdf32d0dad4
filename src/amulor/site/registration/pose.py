"""Pose of a scan: rotation and position, and small changes of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from amulor.errors import MissingExtraError
from amulor.imaging import Frame, frame_of
from amulor.platform.attitude import covariance_of
from amulor.site.description import SiteFrame, StartPose

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ScanPose:
    """Transformation from the axes of an instrument to the frame of the site."""

    rotation: Floats
    """Rotation from right, down, forward to east, north, up, shape (3, 3) [1]."""
    position: Floats
    """Origin of the instrument's axes in the site, shape (3,) [m]."""

    def place(self, points: ArrayLike) -> Floats:
        """Transform points from instrument axes to the frame of the site [m]."""
        return np.asarray(points, dtype=float) @ self.rotation.T + self.position

    def frame(self, site: SiteFrame) -> Frame:
        """Return the frame for points of the scan in the frame of the site."""
        return Frame(
            name="pose",
            rotation=self.rotation,
            position=self.position,
            crs=site.crs,
            crs_offset=site.crs_offset,
        )

    def back(self, points: ArrayLike) -> Floats:
        """Transform points from the frame of the site to instrument axes [m]."""
        away = np.asarray(points, dtype=float) - self.position
        return np.asarray(away @ self.rotation)

    def turn(self, directions: ArrayLike) -> Floats:
        """Rotate directions from instrument axes to the frame of the site [1]."""
        return np.asarray(np.asarray(directions, dtype=float) @ self.rotation.T)

    def changed(self, step: Floats) -> ScanPose:
        """Return the pose after a translation [m] and rotation [rad] about site axes.

        `step` has six numbers: east, north and up of the translation, then of the
        rotation about `position`.
        """
        turn = Rotation.from_rotvec(step[3:]).as_matrix()
        return ScanPose(turn @ self.rotation, self.position + step[:3])

    @property
    def matrix(self) -> Floats:
        """Matrix from homogeneous instrument coordinates to the site, shape (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.position
        return matrix


def departure(pose: ScanPose, start: ScanPose) -> Floats:
    """Return translation [m] and rotation [rad] from the start pose, in site axes."""
    turn = Rotation.from_matrix(pose.rotation @ start.rotation.T).as_rotvec()
    return np.concatenate([pose.position - start.position, turn])


def start_pose(start: StartPose) -> ScanPose:
    """Convert a start pose of a site file to a transformation to the site frame."""
    frame = frame_of(xr.Dataset(), axes="pose", pose=start.as_pose())
    return ScanPose(frame.rotation, frame.position)


def start_covariance(start: StartPose, pose: ScanPose) -> Floats:
    """Return the covariance of a start pose, from the site file's uncertainties."""
    covariance: Floats = covariance_of(
        pose.rotation[None],
        start.position_uncertainty,
        start.heading_uncertainty,
        start.level_uncertainty,
    )[0]
    # Three axes may lie nearly in a plane; no direction may count as known.
    least = 0.25 * min(start.level_uncertainty, start.heading_uncertainty) ** 2
    covariance[3:, 3:] += least * np.eye(3)
    return covariance


def best_pose(from_points: Floats, to_points: Floats) -> ScanPose:
    """Return the least-squares pose that maps points onto their counterparts."""
    middle, other_middle = from_points.mean(axis=0), to_points.mean(axis=0)
    turn, _ = Rotation.align_vectors(to_points - other_middle, from_points - middle)
    rotation = turn.as_matrix()
    return ScanPose(rotation, other_middle - rotation @ middle)


#: small_gicp stops when a step is smaller [m, rad]; its own default leaves millimeters.
_STOP, _TURN = 1e-6, 1e-7
#: Factors by which voxels are coarser, and fractions of the reach in which points are
#: matched, step by step [1].
_STEPS = ((3.0, 1.0), (2.0, 0.5), (1.0, 0.25), (1.0, 0.1))


def aligned(
    points: Floats,
    others: Floats,
    start: ScanPose,
    *,
    voxel: float,
    reach: float,
) -> ScanPose:
    """Align points with other points, from a start pose; return the new pose.

    Planes are matched with planes, from coarse to fine voxels. Only the pose is used:
    errors from this sum of squares would be 40 to 85 times too small.
    """
    try:
        import small_gicp
    except ImportError as error:
        raise MissingExtraError(
            "small-gicp", extra="site", purpose="aligning scans"
        ) from error
    # Near the origin, because the numbering of voxels starts there.
    middle = others.mean(axis=0)
    matrix = start.matrix
    matrix[:3, 3] -= middle
    for coarse, near in _STEPS:
        step = coarse * voxel
        outcome = small_gicp.align(
            others - middle,
            points,
            init_T_target_source=matrix,
            registration_type="GICP",
            downsampling_resolution=step,
            max_correspondence_distance=max(near * reach, 2 * step),
            num_threads=1,
            max_iterations=60,
            translation_epsilon=_STOP,
            rotation_epsilon=_TURN,
        )
        matrix = np.asarray(outcome.T_target_source, dtype=float)
    u, _, v = np.linalg.svd(matrix[:3, :3])
    return ScanPose(u @ v, matrix[:3, 3] + middle)
