"""Poses of the instrument on a moving vehicle, and resulting errors of points."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.errors import SurveyError
from amulor.platform.attitude import PAIRS, cross_matrix
from amulor.platform.mounting import deviations, error_factors
from amulor.platform.trajectory import Poses, Trajectory
from amulor.survey.course import boresight_of
from amulor.survey.platform import Mounting

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class InstrumentPoses:
    r"""Poses of the instrument at the times of its readings.

    Notes
    -----
    A point y in instrument axes lies at :math:`p + R (l + B y)`. Here p and R are the
    pose of the vehicle, l is the lever arm and B the attitude of the instrument on the
    vehicle. Errors of the pose differ from reading to reading. Errors of lever arm,
    boresight and clock are common to all readings.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor.platform import Mounting, Trajectory, instrument_poses
    >>> track = Trajectory.of_angles(
    ...     time=[0.0, 1.0, 2.0],
    ...     position=[[0, 0, -5], [0, 0.2, -5], [0, 0.4, -5]],
    ...     heading=0.0,
    ...     position_uncertainty=0.01,
    ...     heading_uncertainty=1e-3,
    ...     level_uncertainty=1e-3,
    ... )
    >>> down = Mounting(
    ...     pitch="-90 deg", lever_arm_uncertainty="2 mm",
    ...     boresight_uncertainty="1 mrad", clock_uncertainty="5 ms",
    ... )
    >>> poses = instrument_poses(track, down, [0.5, 1.5])
    >>> sea_bed = poses.place([[0, 0, 3], [0, 0, 3]])
    >>> print(sea_bed.round(3) + 0.0)
    [[ 0.   0.1 -8. ]
     [ 0.   0.3 -8. ]]
    >>> print(np.sqrt((poses.shared_errors(sea_bed) ** 2).sum(axis=0))[0].round(4))
    [0.0036 0.0037 0.002 ]
    """

    vehicle: Poses
    """Poses of the vehicle."""
    mounting: Mounting
    """Place and attitude of the instrument on the vehicle, and its clock."""
    duration: float = 0.0
    """Integration window of each reading; its time is the middle [s]."""

    def part(self, index: NDArray[np.intp]) -> InstrumentPoses:
        """Return the poses of selected readings."""
        vehicle = {
            entry.name: getattr(self.vehicle, entry.name)[index]
            for entry in fields(Poses)
        }
        return replace(self, vehicle=Poses(**vehicle))

    @property
    def known(self) -> NDArray[np.bool_]:
        """Mask of the readings at whose times the trajectory has a pose, shape (n,)."""
        return self.vehicle.known

    @property
    def lever_arm(self) -> Floats:
        """Origin of the instrument in vehicle axes, shape (3,) [m]."""
        return np.array(self.mounting.lever_arm)

    @property
    def boresight(self) -> Floats:
        """Rotation from instrument axes to vehicle axes, shape (3, 3) [1]."""
        return boresight_of(self.mounting)

    @property
    def rotation(self) -> Floats:
        """Rotations from instrument axes to the site, shape (n, 3, 3) [1]."""
        return self.vehicle.rotation @ self.boresight

    @property
    def position(self) -> Floats:
        """Origin of the instrument's axes in the site, shape (n, 3) [m]."""
        return self.vehicle.position + self.vehicle.rotation @ self.lever_arm

    @property
    def velocity(self) -> Floats:
        """Velocity of the instrument's origin in site axes, shape (n, 3) [m/s]."""
        return self._velocity_of(self.position)

    def _velocity_of(self, points: Floats) -> Floats:
        """Velocity of points that move with the vehicle, shape (n, 3) [m/s]."""
        turn = np.cross(self.vehicle.turn_rate, points - self.vehicle.position)
        return np.asarray(self.vehicle.velocity + turn)

    def place(self, points: ArrayLike) -> Floats:
        """Transform one point per reading from instrument axes to the site.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            Right, down, forward at each reading [m].

        Returns
        -------
        ndarray, shape (n, 3)
            East, north, up [m].
        """
        away = np.asarray(points, dtype=float)
        return np.asarray(self.position + np.einsum("nij,nj->ni", self.rotation, away))

    def turn(self, directions: ArrayLike) -> Floats:
        """Rotate one direction per reading from instrument axes to the site.

        Parameters
        ----------
        directions : array_like, shape (n, 3)
            Right, down, forward at each reading [1].

        Returns
        -------
        ndarray, shape (n, 3)
            East, north, up [1].
        """
        away = np.asarray(directions, dtype=float)
        return np.asarray(np.einsum("nij,nj->ni", self.rotation, away))

    def covariance(self, points: ArrayLike) -> Floats:
        """Return the covariance of points due to errors of the trajectory.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            One point per reading, in site axes [m].

        Returns
        -------
        ndarray, shape (n, 3, 3)
            Covariance of the coordinates; NaN where that of the pose is unknown [m^2].
        """
        away = np.asarray(points, dtype=float) - self.vehicle.position
        jacobian = np.zeros((away.shape[0], 3, 6))
        jacobian[:, :, :3] = np.eye(3)
        jacobian[:, :, 3:] = -cross_matrix(away)
        stated = self.vehicle.covariance
        return np.asarray(jacobian @ stated @ np.swapaxes(jacobian, 1, 2))

    def variance(self, points: ArrayLike, along: ArrayLike) -> Floats:
        r"""Return coordinate variances by trajectory, mounting, clock and motion.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            One point per reading, in site axes [m].
        along : array_like, shape (n, 3)
            Unit vectors of the beams, in site axes [1].

        Returns
        -------
        ndarray, shape (n, 3)
            Variances of east, north and up; NaN where that of the pose is unknown
            [m^2].

        Notes
        -----
        A reading lasts for the time T, in which the range changes by
        :math:`v_r T`. Its mean is uncertain by :math:`|v_r| T / \sqrt{12}` along the
        beam, with the range rate :math:`v_r`.
        """
        beams = np.asarray(along, dtype=float)
        own = np.einsum("nii->ni", self.covariance(points))
        rate = np.einsum("ni,ni->n", self.velocity, beams)
        smear = (rate * self.duration)[:, None] * beams / np.sqrt(12)
        shared = (self.shared_errors(points) ** 2).sum(axis=0)
        return np.asarray(own + shared + smear**2)

    def cross_covariance(self, points: ArrayLike, along: ArrayLike) -> Floats:
        """Return covariances of different coordinates, with the parts of `variance`.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            One point per reading, in site axes [m].
        along : array_like, shape (n, 3)
            Unit vectors of the beams, in site axes [1].

        Returns
        -------
        ndarray, shape (n, 3)
            Covariances of east and north, east and up, north and up [m^2].
        """
        beams = np.asarray(along, dtype=float)
        rate = np.einsum("ni,ni->n", self.velocity, beams)
        smear = (rate * self.duration)[:, None] * beams / np.sqrt(12)
        by_pose, shared = self.covariance(points), self.shared_errors(points)
        return np.stack(
            [
                by_pose[:, i, j]
                + (shared[..., i] * shared[..., j]).sum(axis=0)
                + smear[:, i] * smear[:, j]
                for i, j in PAIRS
            ],
            axis=1,
        )

    def shared_errors(self, points: ArrayLike) -> Floats:
        """Return the shift of points by one sigma of each error common to all readings.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            One point per reading, in site axes [m].

        Returns
        -------
        ndarray, shape (8, n, 3)
            Shift by one standard uncertainty of the lever arm (right, down, forward),
            of the boresight (about the instrument's right, down and forward axis), of
            the clock offset and of the clock drift [m]. With correlated errors, each
            shift belongs to a combination of them that is independent of the others.
            Unknown uncertainties count as 0, see `unknown`.
        """
        factors = error_factors(self.mounting)
        return np.asarray(np.einsum("ek,kni->eni", factors, self.derivatives(points)))

    @property
    def since_reference(self) -> Floats:
        """Time of each pose since that at which the clock offset is exact [s]."""
        elapsed = self.vehicle.time - self.mounting.clock_offset
        return np.asarray(elapsed - reference_time(self.mounting))

    def derivatives(self, points: ArrayLike) -> Floats:
        """Return derivatives of points by the eight quantities of the mounting.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            One point per reading, in site axes [m].

        Returns
        -------
        ndarray, shape (8, n, 3)
            Derivatives by the lever arm (right, down, forward) [1], the rotation about
            the instrument's right, down and forward axis [m/rad], the clock offset
            [m/s] and the clock drift [m].
        """
        at = np.asarray(points, dtype=float)
        shifts = np.zeros((8, *at.shape))
        turns, away = self.rotation, at - self.position
        for axis in range(3):
            shifts[axis] = self.vehicle.rotation[:, :, axis]
            shifts[3 + axis] = np.cross(turns[:, :, axis], away)
        shifts[6] = self._velocity_of(at)
        shifts[7] = shifts[6] * self.since_reference[:, None]
        return shifts

    @property
    def unknown(self) -> tuple[str, ...]:
        """Quantities without a stated uncertainty, by name."""
        missing = np.isnan(deviations(self.mounting))
        # The uncertainties of a vector are all known, or none.
        first = {"lever arm": 0, "boresight": 3, "clock offset": 6}
        names = [name for name, number in first.items() if missing[number]]
        covariance = self.vehicle.covariance[self.known]
        if not np.isfinite(covariance).all():
            names.insert(0, "trajectory")
        return tuple(names)


def mean_instrument_poses(
    trajectory: Trajectory,
    mounting: Mounting,
    times: ArrayLike,
    *,
    weight: ArrayLike,
    duration: float = 0.0,
) -> InstrumentPoses:
    r"""Return the mean poses of an instrument over several readings per point.

    Parameters
    ----------
    trajectory : Trajectory
        Poses of the vehicle.
    mounting : Mounting
        Place and attitude of the instrument on the vehicle, and its clock.
    times : array_like, shape (readings, n)
        Times of the middle of the readings on the instrument's clock; NaN for missing
        readings [s].
    weight : array_like, shape (readings,)
        Weights of the readings in the result that is placed [1].
    duration : float
        Integration window of each reading [s].

    Returns
    -------
    InstrumentPoses
        One pose per point. It is NaN where the trajectory lacks a pose for any reading.

    Notes
    -----
    Rotation matrices are averaged and projected to the nearest rotation. If the range
    is the mean over its readings with the same weights, a change of range at a constant
    rate causes no error of the point. The covariance is the mean, as errors of adjacent
    poses are nearly equal.

    Examples
    --------
    >>> from amulor.platform import Mounting, Trajectory, mean_instrument_poses
    >>> track = Trajectory.of_angles(
    ...     time=[0.0, 1.0], position=[[0, 0, 0], [0.3, 0, 0]], heading=0.0
    ... )
    >>> poses = mean_instrument_poses(
    ...     track, Mounting(), [[0.2], [0.6]], weight=[0.25, 0.75]
    ... )
    >>> poses.position.round(6).tolist()
    [[0.15, 0.0, 0.0]]
    """
    instants = np.asarray(times, dtype=float)
    weights = np.asarray(weight, dtype=float)[:, None] * np.isfinite(instants)
    with np.errstate(invalid="ignore"):
        weights = weights / weights.sum(axis=0)
    total: InstrumentPoses | None = None
    sums: dict[str, Floats] = {}
    for moment, share in zip(instants, weights, strict=True):
        used = np.isfinite(moment)
        poses = instrument_poses(trajectory, mounting, moment, duration=duration)
        for entry in fields(Poses):
            values = getattr(poses.vehicle, entry.name)
            factor, there = (
                array.reshape(-1, *[1] * (values.ndim - 1)) for array in (share, used)
            )
            # A missing reading has no pose. Without any reading, the share is NaN.
            part = np.where(there | np.isnan(factor), factor * values, 0.0)
            sums[entry.name] = part + sums.get(entry.name, 0.0)
        total = total or poses
    assert total is not None
    if len(instants) == 1:
        return replace(total, vehicle=Poses(**sums))
    left, _, right = np.linalg.svd(np.nan_to_num(sums["rotation"]))
    missing = ~np.isfinite(sums["rotation"]).all(axis=(1, 2), keepdims=True)
    # Means of adjacent rotations have a positive determinant.
    sums["rotation"] = np.where(missing, np.nan, left @ right)
    return replace(total, vehicle=Poses(**sums))


def instrument_poses(
    trajectory: Trajectory,
    mounting: Mounting,
    time: ArrayLike,
    *,
    duration: float = 0.0,
) -> InstrumentPoses:
    """Return the poses of an instrument on a moving vehicle.

    Parameters
    ----------
    trajectory : Trajectory
        Poses of the vehicle.
    mounting : Mounting
        Place and attitude of the instrument on the vehicle, and its clock.
    time : array_like, shape (n,)
        Times of the middle of the readings on the instrument's clock [s].
    duration : float
        Measuring time of each reading [s].

    Returns
    -------
    InstrumentPoses
        Poses with their errors, NaN where the trajectory has none.

    Raises
    ------
    SurveyError
        If the mounting states a clock drift without a reference of its time.

    Examples
    --------
    >>> from amulor.platform import Mounting, Trajectory, instrument_poses
    >>> track = Trajectory.of_angles(
    ...     time=[10.0, 11.0], position=[[0, 0, 0], [0.3, 0, 0]], heading=0.0
    ... )
    >>> poses = instrument_poses(track, Mounting(clock_offset="10 s"), [0.5])
    >>> poses.position.round(6).tolist()
    [[0.15, 0.0, 0.0]]
    """
    _refuse_drift_without_reference(trajectory, mounting)
    instants = np.atleast_1d(np.asarray(time, dtype=float))
    drift = mounting.clock_drift * (instants - reference_time(mounting))
    return InstrumentPoses(
        vehicle=trajectory.at(instants + mounting.clock_offset + drift),
        mounting=mounting,
        duration=duration,
    )


def reference_time(mounting: Mounting) -> float:
    """Return the time at which the clock offset of a mounting is exact [s]."""
    reference = mounting.clock_reference
    return 0.0 if reference is None else reference.timestamp()


def _refuse_drift_without_reference(trajectory: Trajectory, mounting: Mounting) -> None:
    """Raise if a drift counts from a time that the clock does not have."""
    dated = trajectory.clock == "unix"
    drifts = bool(mounting.clock_drift or mounting.clock_drift_uncertainty)
    if drifts and dated and mounting.clock_reference is None:
        raise SurveyError(
            "mounting.clock_drift needs mounting.clock_reference, the date and time at "
            "which clock_offset is exact, as the trajectory has dates"
        )
    if mounting.clock_reference is not None and not dated:
        raise SurveyError(
            "mounting.clock_reference is a date, but the times of the trajectory have "
            "no origin; leave it out"
        )
