"""Coordinate frames of products: instrument, instrument with z upward, or world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from amulor.errors import CubeError
from amulor.imaging.observation import readable_survey
from amulor.platform import rotation_of
from amulor.platform.attitude import PAIRS
from amulor.survey import Pose

Floats = NDArray[np.float64]
Axes = Literal["instrument", "z-up", "pose"]

_TEXTS: dict[str, tuple[str, tuple[str, str, str]]] = {
    "instrument": (
        "right-handed: x right, y down, z forward, in the instrument's axes [m]",
        ("position to the right", "position downwards", "position forwards"),
    ),
    "z-up": (
        "right-handed: x right, y forward, z up, from the instrument's origin [m]",
        ("position to the right", "position forwards", "position upwards"),
    ),
    "pose": (
        "right-handed: x east, y north, z up, in the local frame of the pose [m]",
        ("position to the east", "position to the north", "position upwards"),
    ),
}


@dataclass(frozen=True, kw_only=True)
class Frame:
    """Coordinate frame of a product: axes, and transformation from the instrument.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor.imaging import Frame
    >>> turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    >>> frame = Frame(name="z-up", rotation=turn, position=np.zeros(3))
    >>> frame.place([0.1, 0.2, 3.0])  # right, down, forward
    array([ 0.1,  3. , -0.2])
    """

    name: Axes
    """Kind of axes: "instrument", "z-up" or "pose"."""
    rotation: Floats
    """Rotation from right, down, forward into the frame, shape (3, 3) [1]."""
    position: Floats
    """Origin of the instrument's axes in the frame, shape (3,) [m]."""
    crs: str = ""
    """Coordinate reference system; none if empty."""
    crs_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Offset to add to coordinates to obtain those of the reference system [m]."""
    pose: Pose | None = None
    """Pose of the instrument that defines the frame; None without a pose."""

    @property
    def axes(self) -> str:
        """Meaning of the axes in one sentence."""
        return _TEXTS[self.name][0]

    @property
    def meanings(self) -> tuple[str, str, str]:
        """Meaning of each of the three coordinates."""
        return _TEXTS[self.name][1]

    @property
    def matrix(self) -> Floats:
        """Transformation from the instrument's axes, homogeneous, shape (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.position
        return matrix

    @property
    def up(self) -> Floats:
        """Upward direction, shape (3,) [1]."""
        axis = (0.0, -1.0, 0.0) if self.name == "instrument" else (0.0, 0.0, 1.0)
        return np.array(axis)

    def place(self, points: ArrayLike) -> Floats:
        """Transform points from the instrument's axes into the frame.

        Parameters
        ----------
        points : array_like, last axis (3,)
            Right, down, forward [m].

        Returns
        -------
        ndarray
            Of the same shape [m].
        """
        return np.asarray(points, dtype=float) @ self.rotation.T + self.position

    def turn(self, directions: ArrayLike) -> Floats:
        """Rotate directions from the instrument's axes into the frame.

        Parameters
        ----------
        directions : array_like, last axis (3,)
            Right, down, forward [1].

        Returns
        -------
        ndarray
            Of the same shape [1].
        """
        return np.asarray(directions, dtype=float) @ self.rotation.T

    def shared_errors(self, points: ArrayLike) -> Floats:
        r"""Displacement of points by each uncertain quantity of the pose.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            In this frame [m].

        Returns
        -------
        ndarray, shape (6, n, 3)
            Shift by one standard uncertainty of east, north, up, heading, pitch and
            roll; 0 for quantities without stated uncertainty, see `unknown`. The six
            errors are independent of each other; each is common to all points [m].

        Notes
        -----
        First order: a rotation by a small angle u about the unit axis w shifts p by
        :math:`u\, w \times (p - p_0)`.
        """
        at = np.asarray(points, dtype=float)
        shifts = np.zeros((6, *at.shape))
        if self.pose is None:
            return shifts
        away = at - self.position
        for axis in range(3):
            shifts[axis, :, axis] = self.pose.position_uncertainty or 0.0
        heading = self.pose.heading_uncertainty or 0.0
        level = self.pose.level_uncertainty or 0.0
        shifts[3] = heading * np.cross(-self.up, away)
        shifts[4] = level * np.cross(self.rotation[:, 0], away)
        shifts[5] = level * np.cross(self.rotation[:, 2], away)
        return shifts

    def at(self, row: NDArray[np.intp], column: NDArray[np.intp]) -> Frame:
        """Return the frame itself: the instrument stands still for all pixels.

        Parameters
        ----------
        row, column : ndarray of int, shape (n,)
            Pixels of the scan.

        Returns
        -------
        Frame
            This frame.
        """
        return self

    def variance(self, points: ArrayLike, along: ArrayLike) -> Floats:
        """Return the variance of coordinates due to the pose.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            In this frame [m].
        along : array_like, shape (n, 3)
            Unit vectors of the beams, not used by an instrument that stands still [1].

        Returns
        -------
        ndarray, shape (n, 3)
            Variances of the coordinates [m^2].
        """
        return np.asarray((self.shared_errors(points) ** 2).sum(axis=0))

    def cross_covariance(self, points: ArrayLike, along: ArrayLike) -> Floats:
        """Return covariances of different coordinates due to the pose.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            In this frame [m].
        along : array_like, shape (n, 3)
            Unit vectors of the beams, not used by an instrument that stands still [1].

        Returns
        -------
        ndarray, shape (n, 3)
            Covariances of x and y, x and z, y and z [m^2].
        """
        shifts = self.shared_errors(points)
        return np.stack(
            [(shifts[..., i] * shifts[..., j]).sum(axis=0) for i, j in PAIRS], axis=1
        )

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names of the pose quantities without a stated uncertainty."""
        if self.pose is None:
            return ()
        uncertainties = {
            "position": self.pose.position_uncertainty,
            "heading": self.pose.heading_uncertainty,
            "level": self.pose.level_uncertainty,
        }
        return tuple(name for name, value in uncertainties.items() if value is None)


def frame_of(
    image: xr.Dataset, *, axes: Axes = "instrument", pose: Pose | None = None
) -> Frame:
    """Frame for the points of a range image.

    Parameters
    ----------
    image : xarray.Dataset
        Range image, with its survey if the pose is read from it.
    axes : str
        "instrument": x right, y down, z forward. "z-up": x right, y forward, z up, for
        an instrument that stands level. "pose": x east, y north, z up.
    pose : amulor.survey.Pose, optional
        Pose of the instrument, by default from the image's survey.

    Returns
    -------
    Frame
        The frame.

    Raises
    ------
    CubeError
        If a pose is needed and neither argument nor survey states it.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> imaging.frame_of(image, axes="z-up").place([0.1, 0.2, 3.0])
    array([ 0.1,  3. , -0.2])
    """
    if axes == "instrument":
        return Frame(name=axes, rotation=np.eye(3), position=np.zeros(3))
    if axes == "z-up":
        turned = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        return Frame(name=axes, rotation=turned, position=np.zeros(3))
    pose = pose or _surveyed_pose(image)
    if pose is None:
        raise CubeError(
            "the survey of the image states no pose; write a section [pose] into a "
            "TOML file (heading, pitch, roll, position) and give it with --pose, or "
            "take the axes z-up"
        )
    return Frame(
        name=axes,
        rotation=rotation_of(pose.heading, pose.pitch, pose.roll),
        position=np.array(pose.position),
        crs=pose.crs,
        crs_offset=pose.crs_offset,
        pose=pose,
    )


def _surveyed_pose(image: xr.Dataset) -> Pose | None:
    """Pose from the survey in an image, None without one."""
    survey = readable_survey(image)
    return None if survey is None else survey.pose
