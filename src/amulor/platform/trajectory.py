"""Trajectory of a vehicle: poses over time, interpolated with their covariance."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from amulor._attitude import rotation_of
from amulor.platform.attitude import covariance_of, turn_between

Floats = NDArray[np.float64]

#: Poses on either side of a pose that predict it, to measure the interpolation error.
_REACH = 2
#: Width of the window over which departures from predictions are averaged [poses].
_WINDOW = 9
#: Interpolation error over departure of a pose from its neighbors' prediction [1]. The
#: prediction spans twice the interval, and the error falls at least with its square.
_SHARE = 0.25
#: Default of the longest interpolated interval, in median intervals [1].
_LONGEST = 5.0


@dataclass(frozen=True, kw_only=True)
class Poses:
    """Poses of a vehicle at given times, NaN where the trajectory has none.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor.platform import Trajectory
    >>> track = Trajectory.of_angles(
    ...     time=[0.0, 1.0, 2.0, 3.0],
    ...     position=[[0, 0, -8], [0, 0.2, -8], [0, 0.4, -8], [0, 0.6, -8]],
    ...     heading=0.0,
    ... )
    >>> poses = track.at([0.5, 4.0])
    >>> poses.known.tolist(), poses.velocity[0].round(3).tolist()
    ([True, False], [0.0, 0.2, 0.0])
    """

    time: Floats
    """Times, shape (n,) [s]."""
    position: Floats
    """East, north and up of the vehicle's reference point, shape (n, 3) [m]."""
    rotation: Floats
    """Rotations from vehicle axes (right, down, forward) to the site, shape (n, 3, 3)
    [1]."""
    velocity: Floats
    """Velocity in site axes, shape (n, 3) [m/s]."""
    turn_rate: Floats
    """Angular velocity in site axes, shape (n, 3) [rad/s]."""
    covariance: Floats
    """Covariance of position [m] and rotation about site axes [rad], shape (n, 6, 6);
    NaN where unknown."""

    @property
    def known(self) -> NDArray[np.bool_]:
        """Mask of the times at which the trajectory has a pose, shape (n,)."""
        return np.asarray(np.isfinite(self.position).all(axis=-1))


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    r"""Poses of a vehicle over time.

    Raises
    ------
    ValueError
        If shapes do not match, times do not increase, or a pose is not finite.

    Notes
    -----
    Positions and unit quaternions are interpolated by cubic splines; the quaternions
    are then normalized. Intervals longer than `longest_gap` are not interpolated, and
    nothing is extrapolated. The covariance is interpolated linearly, as errors of
    adjacent poses are nearly equal. The interpolation error is added: each pose is
    predicted by a cubic polynomial through the two poses before and the two after it. A
    quarter of the rms departure over nine poses is the standard uncertainty in the
    middle of an interval; at the poses it is zero. In intervals longer than the median
    it grows with the square of their length.

    Examples
    --------
    A vehicle on a circle with a radius of 10 m, one pose per second:

    >>> import numpy as np
    >>> from amulor.platform import Trajectory
    >>> time = np.arange(30.0)
    >>> turn = 0.02 * time
    >>> place = np.stack([10 * np.sin(turn), 10 * np.cos(turn), -8 + 0 * turn], axis=1)
    >>> track = Trajectory.of_angles(time=time, position=place, heading=turn)
    >>> error = np.hypot(*track.at([11.5]).position[0, :2]) - 10
    >>> bool(abs(error) < 1e-7)
    True
    """

    time: Floats
    """Times of the poses, increasing, shape (n,) [s]."""
    position: Floats
    """East, north and up of the vehicle's reference point, shape (n, 3) [m]."""
    attitude: Floats
    """Unit quaternions (x, y, z, w) from vehicle axes (right, down, forward) to
    (east, north, up), shape (n, 4) [1]."""
    covariance: Floats
    """Covariance of position [m] and rotation about site axes [rad], shape (n, 6, 6);
    NaN where unknown."""
    longest_gap: float
    """Longest interval between poses over which they are interpolated [s]."""
    clock: Literal["unix", "relative"] = "relative"
    """Origin of the times: 1970-01-01 UTC, or unknown."""
    crs: str = ""
    """Coordinate reference system of the local frame; none if empty."""
    crs_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Offset of the local frame in the reference system (east, north, up) [m]."""
    remarks: tuple[str, ...] = ()
    """Irregularities of the source, one sentence each."""

    def __post_init__(self) -> None:
        """Raise a ValueError for wrong shapes, unsorted times or infinite values."""
        count = self.time.size
        shapes = {"position": (3,), "attitude": (4,), "covariance": (6, 6)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != (count, *shape):
                raise ValueError(
                    f"{name} has shape {getattr(self, name).shape}; needed is "
                    f"{(count, *shape)}, a pose for each of {count} times"
                )
        if count < 2:
            raise ValueError(f"a trajectory of {count} poses; needed are 2 or more")
        if not (np.diff(self.time) > 0).all():
            number = int(np.argmin(np.diff(self.time) > 0)) + 1
            raise ValueError(
                f"time {number} is not after time {number - 1}; sort the poses"
            )
        for name in ("time", "position", "attitude"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"{name} has a value that is not finite; remove it")
        if not self.longest_gap > 0:
            raise ValueError(f"longest_gap {self.longest_gap:g}; needed is above 0 s")

    @classmethod
    def of_angles(
        cls,
        *,
        time: ArrayLike,
        position: ArrayLike,
        heading: ArrayLike,
        pitch: ArrayLike = 0.0,
        roll: ArrayLike = 0.0,
        position_uncertainty: ArrayLike = np.nan,
        heading_uncertainty: ArrayLike = np.nan,
        level_uncertainty: ArrayLike = np.nan,
        longest_gap: float | None = None,
    ) -> Self:
        """Return a trajectory from heading, pitch and roll.

        Parameters
        ----------
        time : array_like, shape (n,)
            Increasing times [s].
        position : array_like, shape (n, 3)
            East, north, up [m].
        heading, pitch, roll : array_like
            Attitude, see `rotation_of` [rad].
        position_uncertainty : array_like
            Standard uncertainty of each coordinate, shape (n, 3) or (3,) or a number;
            unknown by default [m].
        heading_uncertainty, level_uncertainty : array_like
            Standard uncertainty of heading, and of pitch and roll; unknown by default
            [rad].
        longest_gap : float, optional
            Longest interval to interpolate, by default five median intervals [s].

        Returns
        -------
        Trajectory
            The trajectory.

        Raises
        ------
        ValueError
            If shapes do not match, times do not increase, or a pose is not finite.

        Examples
        --------
        >>> from amulor.platform import Trajectory
        >>> track = Trajectory.of_angles(
        ...     time=[0.0, 1.0], position=[[0, 0, 0], [0, 1, 0]], heading=0.0
        ... )
        >>> track.duration
        1.0
        """
        instants = np.asarray(time, dtype=float)
        turns = np.broadcast_to(
            rotation_of(heading, pitch, roll), (*instants.shape, 3, 3)
        )
        return cls(
            time=instants,
            position=np.asarray(position, dtype=float),
            attitude=Rotation.from_matrix(turns).as_quat(),
            covariance=covariance_of(
                turns, position_uncertainty, heading_uncertainty, level_uncertainty
            ),
            longest_gap=longest_gap or usual_gap(instants),
        )

    @property
    def duration(self) -> float:
        """Time between the first and the last pose [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def gaps(self) -> Floats:
        """Start and end of intervals that are not interpolated, shape (n, 2) [s]."""
        (where,) = np.nonzero(np.diff(self.time) > self.longest_gap)
        return np.stack([self.time[where], self.time[where + 1]], axis=1)

    def at(self, time: ArrayLike) -> Poses:
        """Interpolate poses at given times; NaN in gaps and outside the trajectory.

        Parameters
        ----------
        time : array_like, shape (n,)
            Times on the trajectory's clock [s].

        Returns
        -------
        Poses
            Poses with velocities and covariance. They are NaN before the first pose,
            after the last, and in gaps longer than `longest_gap`.

        Examples
        --------
        >>> from amulor.platform import Trajectory
        >>> track = Trajectory.of_angles(
        ...     time=[0, 1, 2], position=[[0, 0, 0], [0, 1, 0], [0, 2, 0]], heading=0.0
        ... )
        >>> track.at([1.5]).position.round(6).tolist()
        [[0.0, 1.5, 0.0]]
        """
        instants = np.atleast_1d(np.asarray(time, dtype=float))
        count = instants.size
        position = np.full((count, 3), np.nan)
        rotation = np.full((count, 3, 3), np.nan)
        velocity, turn_rate = (
            np.full_like(position, np.nan),
            np.full_like(position, np.nan),
        )
        covariance = np.full((count, 6, 6), np.nan)
        for begin, end in self._pieces:
            (inside,) = np.nonzero(
                (instants >= self.time[begin]) & (instants <= self.time[end - 1])
            )
            if not inside.size:
                continue
            at = instants[inside]
            piece = slice(begin, end)
            path = CubicSpline(self.time[piece], self.position[piece])
            position[inside], velocity[inside] = path(at), path(at, 1)
            turns = CubicSpline(self.time[piece], _continuous(self.attitude[piece]))
            rotation[inside], turn_rate[inside] = _turned(turns(at), turns(at, 1))
            covariance[inside] = self._covariance_at(at, begin, end)
        return Poses(
            time=instants,
            position=position,
            rotation=rotation,
            velocity=velocity,
            turn_rate=turn_rate,
            covariance=covariance,
        )

    @cached_property
    def _pieces(self) -> list[tuple[int, int]]:
        """First and end index of the pieces without gaps, two poses or more each."""
        (breaks,) = np.nonzero(np.diff(self.time) > self.longest_gap)
        ends = [0, *(breaks + 1).tolist(), self.time.size]
        pairs = itertools.pairwise(ends)
        return [(begin, end) for begin, end in pairs if end - begin >= 2]

    @cached_property
    def departures(self) -> Floats:
        """Departures of poses from a cubic through their neighbors, shape (n, 6).

        Position [m] and rotation about site axes [rad]; two poses on each side predict
        a pose, and the departure is NaN where they do not exist.
        """
        result = np.full((self.time.size, 6), np.nan)
        for begin, end in self._pieces:
            if end - begin > 2 * _REACH:
                result[begin + _REACH : end - _REACH] = self._departures(begin, end)
        return result

    def _covariance_at(self, at: Floats, begin: int, end: int) -> Floats:
        """Covariance of interpolated poses within one piece, shape (n, 6, 6)."""
        times = self.time[begin:end]
        low = np.clip(np.searchsorted(times, at, side="right") - 1, 0, times.size - 2)
        share = (at - times[low]) / (times[low + 1] - times[low])
        stated = self.covariance[begin:end]
        weight = share[:, None, None]
        mixed = (1 - weight) * stated[low] + weight * stated[low + 1]
        # A pose without stated covariance is no part of a time at its neighbor.
        mixed = np.where(weight == 0, stated[low], mixed)
        mixed = np.where(weight == 1, stated[low + 1], mixed)
        error = self._interpolation_error(begin, end)
        middle = np.sqrt((error[low] ** 2 + error[low + 1] ** 2) / 2)
        steps = np.diff(times)
        # Errors are measured at the usual interval; in a longer one they are larger.
        longer = np.maximum(steps[low] / np.median(steps), 1.0) ** 2
        sigma = middle * (4 * share * (1 - share) * longer)[:, None]
        return np.asarray(mixed + sigma[:, :, None] ** 2 * np.eye(6))

    def _interpolation_error(self, begin: int, end: int) -> Floats:
        """Interpolation error in mid-interval at the poses of a piece, (pose, 6)."""
        count = end - begin
        if count < 2 * _REACH + 1:
            # Too few poses for a test: at most half of the change between two poses.
            turns = Rotation.from_quat(self.attitude[begin:end])
            change = np.hstack([
                np.diff(self.position[begin:end], axis=0),
                turn_between(turns[:-1], turns[1:]),
            ])  # fmt: skip
            return np.full((count, 6), np.abs(change).max(axis=0) / 2)
        departures = self.departures[begin + _REACH : end - _REACH]
        square = np.pad(departures**2, ((_REACH, _REACH), (0, 0)), mode="edge")
        mean = uniform_filter1d(square, _WINDOW, axis=0, mode="nearest")
        return np.asarray(_SHARE * np.sqrt(np.maximum(mean, 0.0)))

    def _departures(self, begin: int, end: int) -> Floats:
        """Departures of poses from a cubic through two poses on each side, (n, 6)."""
        times = self.time[begin:end]
        middle = np.arange(_REACH, times.size - _REACH)
        steps = [step for step in range(-_REACH, _REACH + 1) if step]
        turns = Rotation.from_quat(self.attitude[begin:end])
        here, departure = turns[middle], np.zeros((middle.size, 6))
        for step in steps:
            weight = np.ones(middle.size)
            for other in steps:
                if other != step:
                    weight *= (times[middle] - times[middle + other]) / (
                        times[middle + step] - times[middle + other]
                    )
            moved = self.position[begin:end][middle + step]
            moved = moved - self.position[begin:end][middle]
            turned = turn_between(here, turns[middle + step])
            departure += weight[:, None] * np.hstack([moved, turned])
        return departure


def _continuous(quaternions: Floats) -> Floats:
    """Quaternions with signs such that neighbors differ least."""
    same = np.einsum("ni,ni->n", quaternions[1:], quaternions[:-1]) >= 0
    signs = np.cumprod(np.where(same, 1.0, -1.0))
    return np.asarray(quaternions * np.concatenate([[1.0], signs])[:, None])


def _turned(quaternion: Floats, rate: Floats) -> tuple[Floats, Floats]:
    """Rotation matrices of quaternions, and angular velocities in site axes."""
    size = np.linalg.norm(quaternion, axis=1, keepdims=True)
    unit = quaternion / size
    slope = rate / size
    vector, real = unit[:, :3], unit[:, 3:]
    # The vector part of 2 dq/dt q*, in which a change of length drops out.
    spin = 2 * (
        real * slope[:, :3] - slope[:, 3:] * vector + np.cross(vector, slope[:, :3])
    )
    return Rotation.from_quat(unit).as_matrix(), spin


def usual_gap(time: Floats) -> float:
    """Return the default of the longest interpolated interval [s]."""
    return _LONGEST * float(np.median(np.diff(time))) if time.size > 1 else 1.0
