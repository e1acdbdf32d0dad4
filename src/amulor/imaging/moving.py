"""Frame of products of a scan that was measured from a moving vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.errors import CubeError
from amulor.imaging.observation import readable_survey
from amulor.platform import (
    InstrumentPoses,
    Mounting,
    Trajectory,
    mean_instrument_poses,
)

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class MovingFrame:
    """Site axes, and the pose of a moving instrument at each pixel.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> from amulor.platform import Mounting, Trajectory
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> track = Trajectory.of_angles(
    ...     time=np.arange(0.0, 2000.0, 10.0),
    ...     position=np.zeros((200, 3)) + [0, 0, -8],
    ...     heading=0.0,
    ... )
    >>> frame = imaging.moving_frame(image, trajectory=track, mounting=Mounting())
    >>> cloud = imaging.point_cloud(image, frame=frame)
    >>> bool(cloud["z"].max() < -7.5)  # the ladder hangs 8 m below the surface
    True
    """

    poses: InstrumentPoses
    """Poses of the instrument, one per pixel, row by row."""
    shape: tuple[int, int]
    """Rows and columns of the scan."""
    window: Floats
    """Time from the first to the last instant of the readings of each pixel, shape
    (row, column) [s]."""
    clock: Literal["unix", "relative"]
    """Clock of the trajectory: since 1970-01-01 UTC, or of unknown origin."""
    crs: str
    """Coordinate reference system; none if empty."""
    crs_offset: tuple[float, float, float]
    """Offset to add to coordinates to obtain those of the reference system [m]."""
    name: Literal["trajectory"] = "trajectory"
    """Kind of axes."""

    axes = (
        "right-handed: x east, y north, z up, in the local frame of the trajectory [m]"
    )
    meanings = ("position to the east", "position to the north", "position upwards")

    @property
    def known(self) -> NDArray[np.bool_]:
        """Mask of the pixels at which the trajectory has a pose, (row, column)."""
        return self.poses.known.reshape(self.shape)

    @property
    def matrix(self) -> Floats:
        """Pose of the instrument in the middle of the scan, homogeneous, (4, 4)."""
        index = np.flatnonzero(self.poses.known)
        order = np.argsort(self.poses.vehicle.time[index])
        middle = index[order[len(order) // 2]]
        matrix = np.eye(4)
        matrix[:3, :3] = self.poses.rotation[middle]
        matrix[:3, 3] = self.poses.position[middle]
        return matrix

    @property
    def spread(self) -> Floats:
        """Distance moved during the readings of each pixel, (row, column) [m]."""
        speed = np.linalg.norm(self.poses.velocity, axis=-1)
        return np.asarray(speed.reshape(self.shape) * self.window)

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names of the quantities without a stated uncertainty."""
        return self.poses.unknown

    def at(self, row: NDArray[np.intp], column: NDArray[np.intp]) -> InstrumentPoses:
        """Return the poses of the instrument at selected pixels.

        Parameters
        ----------
        row, column : ndarray of int, shape (n,)
            Pixels of the scan.

        Returns
        -------
        InstrumentPoses
            Their poses.
        """
        return self.poses.part(row * self.shape[1] + column)


def moving_frame(
    image: xr.Dataset, *, trajectory: Trajectory, mounting: Mounting | None = None
) -> MovingFrame:
    """Return the frame of a scan that was measured from a moving vehicle.

    Parameters
    ----------
    image : xarray.Dataset
        Range image with the time of each pixel, or of each reading.
    trajectory : Trajectory
        Trajectory of the vehicle. Times since 1970 (clock "unix") are compared with the
        start of the scan, others with the time since this start.
    mounting : Mounting, optional
        Place and attitude of the instrument on the vehicle, and its clock; by default
        from the image's survey.

    Returns
    -------
    MovingFrame
        The pose at each pixel: the mean over the readings of its range, with their
        weights. Without times of the readings, it is the pose in the middle of the
        pixel's measuring time.

    Raises
    ------
    CubeError
        If the image has no times, no pixel was measured during the trajectory, or
        neither argument nor survey states the mounting.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> from amulor.platform import Mounting, Trajectory
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> track = Trajectory.of_angles(
    ...     time=[0.0, 60.0], position=[[0, 0, -8], [0, 6, -8]], heading=0.0
    ... )
    >>> frame = imaging.moving_frame(image, trajectory=track, mounting=Mounting())
    >>> bool(frame.known.any()), frame.unknown
    (True, ('trajectory', 'lever arm', 'boresight', 'clock offset'))
    """
    mounting = mounting or surveyed_mounting(image)
    times, duration, weight = _readings(image)
    if trajectory.clock == "unix":
        times = times + _start_of(image)
    shape = times.shape[1:]
    window = float(np.nanmedian(duration)) if np.isfinite(duration).any() else 0.0
    poses = mean_instrument_poses(
        trajectory,
        mounting,
        times.reshape(len(times), -1),
        weight=weight,
        duration=window,
    )
    if not poses.known.any():
        begin, end = trajectory.time[[0, -1]]
        instants = times[np.isfinite(times)] + mounting.clock_offset
        first, last = instants.min(initial=np.inf), instants.max(initial=-np.inf)
        raise CubeError(
            f"no pixel was measured during the trajectory: it lasts from {begin:.3f} "
            f"to {end:.3f} s, the scan from {first:.3f} to {last:.3f} s on its clock; "
            "check mounting.clock_offset"
        )
    return MovingFrame(
        poses=poses,
        shape=(shape[0], shape[1]),
        window=_window(times, duration),
        clock=trajectory.clock,
        crs=trajectory.crs,
        crs_offset=trajectory.crs_offset,
    )


def surveyed_mounting(image: xr.Dataset) -> Mounting:
    """Return the mounting from the survey in an image."""
    survey = readable_survey(image)
    if survey is None or survey.platform is None:
        raise CubeError(
            "the survey of the image states no mounting; write a section [mounting] "
            "into a TOML file (lever_arm, heading, pitch, roll, clock_offset) and give "
            "it with --mounting"
        )
    return survey.platform.mounting


def _readings(image: xr.Dataset) -> tuple[Floats, Floats, Floats]:
    """Middle and length of the windows of the readings [s], and their weights [1]."""
    if "reading_time" in image.coords:
        return (
            np.asarray(image["reading_time"].values, dtype=float),
            np.asarray(image["reading_duration"].values, dtype=float),
            np.asarray(image["reading_weight"].values, dtype=float),
        )
    if "time" not in image.coords:
        raise CubeError(
            "the range image has no time of each pixel; a scan from a vehicle needs "
            "them: acquire it with amulor, or import them with the recording"
        )
    time = np.asarray(image["time"].values, dtype=float)
    duration = np.full((1, *time.shape), _duration(image, time))
    return time + duration / 2, duration, np.ones(1)


def _window(times: Floats, duration: Floats) -> Floats:
    """Time from the first to the last instant of each pixel's readings [s]."""
    begin = np.fmin.reduce(times - duration / 2, axis=0)
    return np.asarray(np.fmax.reduce(times + duration / 2, axis=0) - begin)


def _duration(image: xr.Dataset, time: Floats) -> float:
    """Acquisition time of a pixel: planned time, at most that between pixels [s]."""
    steps = np.abs(np.diff(time, axis=1)).ravel()
    between = float(np.median(steps)) if steps.size else np.inf
    survey = readable_survey(image)
    planned = np.inf
    if survey is not None:
        count = len(survey.instrument.modulation_frequencies)
        planned = survey.scan.dwell * count * len(survey.instrument.polarizations)
    shortest = min(between, planned)
    return shortest if np.isfinite(shortest) else 0.0


def _start_of(image: xr.Dataset) -> float:
    """Start of a scan as Unix time [s]."""
    text = str(image.attrs.get("time_coverage_start", ""))
    if not text:
        raise CubeError(
            "the range image has no date of its start, but the trajectory has dates; "
            'import the trajectory with constants.clock = "relative", and state the '
            "difference as mounting.clock_offset"
        )
    moment = datetime.fromisoformat(text)
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
