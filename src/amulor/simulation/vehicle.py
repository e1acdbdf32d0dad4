"""Simulated vehicle: its true motion and places, and what its sensors record."""

from __future__ import annotations

import numbers
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from amulor._attitude import rotation_of
from amulor.errors import SurveyError
from amulor.platform import Trajectory
from amulor.platform.mounting import error_factors
from amulor.platform.trajectory import usual_gap
from amulor.simulation.scene import Hits
from amulor.survey import Mounting, Platform, Survey
from amulor.survey.course import boresight_of, in_scene, planned, scene_axes
from amulor.survey.directions import readings_in_turn
from amulor.survey.scan import Pose

Floats = NDArray[np.float64]

#: Purposes of random numbers, each with a separate generator.
_MOTION, _MOUNTING, _SENSORS = range(3)
#: Number of tones of each oscillation.
_TONES = 6
#: Messages before and after the scan.
_MARGIN = 10
#: Time after which random walks have their stated standard deviation [s].
_WALK = 60.0
_UP = np.array([0.0, 0.0, 1.0])


def measured_trajectory(survey: Survey, *, rng: int) -> Trajectory:
    """Return the trajectory that the vehicle of a simulated survey measures.

    Parameters
    ----------
    survey : Survey
        Survey with a section [platform].
    rng : int
        Seed, as of `amulor.simulate`.

    Returns
    -------
    Trajectory
        Poses with errors drawn from `platform.navigation`, and their covariance. The
        clock is that of the vehicle: the time of the scan and the true clock offset.

    Raises
    ------
    SurveyError
        If the survey has no section [platform].

    Notes
    -----
    Constant errors, random walks and independent errors of each message add up. A
    constant error of the heading turns the course about its first pose. Errors of level
    and random walks of the attitude do not change the position.

    Examples
    --------
    >>> from amulor import Survey, simulation
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {
    ...         "scan.columns": 3,
    ...         "scan.rows": 2,
    ...         "platform": {
    ...             "course": {
    ...                 "kind": "line", "start": ["0 m", "0 m", "-8 m"],
    ...                 "speed": "0.2 m/s",
    ...             },
    ...             "navigation": {"position_uncertainty": "2 cm"},
    ...         },
    ...     }
    ... )
    >>> track = simulation.measured_trajectory(survey, rng=1)
    >>> print(f"{track.covariance[0, 0, 0] ** 0.5:.3f} m")
    0.020 m
    """
    return VehicleMotion.of(survey, rng).measured()


@dataclass(frozen=True)
class VehicleMotion:
    """True motion of the vehicle of a survey, and its true mounting."""

    survey: Survey
    """Survey with a section [platform]."""
    platform: Platform
    """Vehicle of the survey."""
    seed: int
    """Seed of the random motion and errors."""

    @classmethod
    def of(cls, survey: Survey, rng: np.random.Generator | int) -> VehicleMotion:
        """Return the motion for a seed; raise without a seed or a platform."""
        if survey.platform is None:
            raise SurveyError(
                "platform: is missing; state the course of the vehicle in [platform]"
            )
        if not isinstance(rng, numbers.Integral):
            raise SurveyError(
                "a moving platform needs a seed instead of a generator (rng=1), as its "
                "measured trajectory is drawn from the same seed"
            )
        return cls(survey, survey.platform, int(rng))

    def _draws(self, purpose: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, 42, purpose])

    @cached_property
    def _tones(self) -> tuple[Floats, Floats, Floats]:
        """Angular frequency [rad/s], phase [rad] and amplitude of each oscillation."""
        wave, rng = self.platform.disturbance, self._draws(_MOTION)
        rms = np.array([*[wave.position] * 3, wave.heading, wave.pitch, wave.roll])
        octave = rng.uniform(-1, 1, (6, _TONES))
        phase = rng.uniform(0, 2 * np.pi, (6, _TONES))
        amplitude = rms[:, None] * np.sqrt(2 / _TONES)
        return 2 * np.pi / wave.period * 2**octave, phase, amplitude

    def vehicle(self, time: ArrayLike) -> tuple[Floats, Floats]:
        """Return true positions (n, 3) [m] and rotations (n, 3, 3) at scan times."""
        at = np.asarray(time, dtype=float)
        position, heading = planned(self.platform.course, at)
        position = position + at[:, None] * self.platform.disturbance.current
        frequency, phase, amplitude = self._tones
        wave = amplitude * np.sin(frequency * at[:, None, None] + phase)
        off = wave.sum(axis=-1)
        turn = rotation_of(heading + off[:, 3], off[:, 4], off[:, 5])
        return position + off[:, :3], turn

    @cached_property
    def mounting(self) -> Mounting:
        """True lever arm, boresight and clock."""
        stated, draws = self.platform.mounting, self._draws(_MOUNTING)
        error = draws.standard_normal(8) @ error_factors(stated)
        turn = Rotation.from_rotvec(stated.boresight) * Rotation.from_rotvec(error[3:6])
        return stated.model_copy(
            update={
                "lever_arm": tuple(stated.lever_arm + error[:3]),
                "boresight": tuple(turn.as_rotvec()),
                "clock_offset": stated.clock_offset + error[6],
                "clock_drift": stated.clock_drift + error[7],
            }
        )

    def instrument(self, time: ArrayLike) -> tuple[Floats, Floats]:
        """Return true origins and rotations of the instrument in the site."""
        position, turn = self.vehicle(time)
        arm = np.array(self.mounting.lever_arm)
        return position + turn @ arm, turn @ boresight_of(self.mounting)

    def in_scene(self, time: ArrayLike) -> tuple[Floats, Floats]:
        """Return true origins and rotations of the instrument in the targets' axes."""
        return in_scene(self.survey, *self.instrument(time))

    def in_site(self, points: Floats) -> Floats:
        """Transform points from the targets' axes to the site, last axis (3,) [m]."""
        origin, axes = scene_axes(self.survey)
        return np.asarray(points @ axes.T + origin)

    @property
    def planned_duration(self) -> float:
        """Planned time from the first pixel to the end of the last [s]."""
        scan = self.survey.scan
        return scan.rows * scan.columns * scan.dwell * readings_in_turn(self.survey)

    def measured(
        self, *, lead: float = 0.0, duration: float | None = None
    ) -> Trajectory:
        """Return the measured trajectory; see `measured_trajectory`.

        The clock counts from a time `lead` before the start of the course; the
        trajectory lasts for a duration after it, by default the planned one [s].
        """
        sensors = self.platform.navigation
        length = self.planned_duration if duration is None else duration
        before = _MARGIN + int(np.ceil(lead / sensors.interval))
        count = before + _MARGIN + int(np.ceil(length / sensors.interval)) + 1
        time = np.arange(-before, count - before, dtype=np.float64)
        time *= sensors.interval
        position, turn = self.vehicle(time)
        since, away = time - time[0], position - position[0]
        # Shift and rotation by a standard error: shape (error, message, 6).
        constant = np.zeros((10, count, 6))
        axes = np.eye(3)
        for axis in range(3):
            constant[axis, :, axis] = sensors.position_uncertainty
            constant[3 + axis, :, axis] = sensors.velocity_uncertainty * since
        constant[6, :, :3] = sensors.scale_uncertainty * away
        constant[7, :, :3] = sensors.heading_uncertainty * np.cross(_UP, away)
        constant[7, :, 3:] = sensors.heading_uncertainty * _UP
        for number in range(2):
            constant[8 + number, :, 3:] = sensors.level_uncertainty * axes[number]
        walk = np.repeat([sensors.position_walk, sensors.attitude_walk], 3)
        noise = np.repeat([sensors.position_noise, sensors.attitude_noise], 3)
        rng = self._draws(_SENSORS)
        error = np.einsum("e,eni->ni", rng.standard_normal(len(constant)), constant)
        steps = rng.standard_normal((count, 6)) * np.sqrt(sensors.interval / _WALK)
        steps[0] = 0.0
        error += walk * steps.cumsum(axis=0) + noise * rng.standard_normal((count, 6))
        covariance = np.einsum("eni,enj->nij", constant, constant)
        own = walk**2 * (since / _WALK)[:, None] + noise**2
        covariance += own[:, :, None] * np.eye(6)
        rotation = Rotation.from_rotvec(error[:, 3:]) * Rotation.from_matrix(turn)
        pose = self.survey.pose or Pose()
        return Trajectory(
            time=(time + lead) * (1 + self.mounting.clock_drift)
            + self.mounting.clock_offset,
            position=position + error[:, :3],
            attitude=rotation.as_quat(),
            covariance=covariance,
            longest_gap=usual_gap(time),
            crs=pose.crs,
            crs_offset=pose.crs_offset,
        )


class Standing:
    """Place of an instrument whose axes are those of the targets."""

    def points(self, points: Floats) -> Floats:
        """Return points of the instrument's axes in the targets' axes [m]."""
        return points

    def directions(self, directions: Floats) -> Floats:
        """Return directions of the instrument's axes in the targets' axes [1]."""
        return directions

    def in_instrument(self, hits: Hits) -> Hits:
        """Return hits in the instrument's axes."""
        return hits

    def of(self, index: NDArray[np.intp]) -> Standing:
        """Return the place of some of the beams."""
        return self


@dataclass(frozen=True)
class Placed(Standing):
    """Place of a moving instrument in the targets' axes, for each beam."""

    position: Floats
    rotation: Floats

    def points(self, points: Floats) -> Floats:
        """Return points of the instrument's axes in the targets' axes [m]."""
        return self.position + self.directions(points)

    def directions(self, directions: Floats) -> Floats:
        """Return directions of the instrument's axes in the targets' axes [1]."""
        return np.asarray((self.rotation @ directions[..., None])[..., 0])

    def in_instrument(self, hits: Hits) -> Hits:
        """Return hits in the instrument's axes."""
        back = np.swapaxes(self.rotation, 1, 2)
        away = (hits.point - self.position)[..., None]
        return replace(
            hits,
            point=(back @ away)[..., 0],
            normal=(back @ hits.normal[..., None])[..., 0],
        )

    def of(self, index: NDArray[np.intp]) -> Standing:
        """Return the place of some of the beams."""
        return Placed(self.position[index], self.rotation[index])
