"""Platform of the instrument in a survey: course, motion, navigation, mounting."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AwareDatetime, Field, model_validator

from amulor.survey.quantity import (
    Angle,
    Description,
    Fraction,
    Length,
    Position,
    Speed,
    Time,
)

_Heading = Annotated[Angle, Field(ge=-2 * math.pi, le=2 * math.pi)]
_Moving = Annotated[Speed, Field(gt=0, le=20)]
_Drift = Annotated[Speed, Field(ge=-5, le=5)]
_LengthError = Annotated[Length, Field(ge=0, le=10)]
_AngleError = Annotated[Angle, Field(ge=0, le=1)]
_Turn = Annotated[Angle, Field(ge=-math.pi, le=math.pi)]
_ClockDrift = Annotated[Fraction, Field(ge=-0.01, le=0.01)]
_Correlation = Annotated[Fraction, Field(ge=-1, le=1)]


class Mounting(Description):
    """Position, attitude and clock offset of the instrument relative to its vehicle.

    Examples
    --------
    An instrument that looks straight down, 1.2 m in front of the inertial sensor:

    >>> from amulor.survey import Mounting
    >>> mounting = Mounting(
    ...     lever_arm=("0 m", "0.3 m", "1.2 m"),
    ...     pitch="-90 deg",
    ...     lever_arm_uncertainty="5 mm",
    ...     boresight_uncertainty="0.05 deg",
    ...     clock_uncertainty="1 ms",
    ... )
    >>> mounting.lever_arm
    (0.0, 0.3, 1.2)
    """

    lever_arm: Position = (0.0, 0.0, 0.0)
    """Origin of the instrument's axes (right, down, forward), from the reference point
    of the vehicle [m]."""
    heading: Annotated[Angle, Field(ge=-2 * math.pi, le=2 * math.pi)] = 0.0
    """Direction of the instrument's forward axis on a level vehicle, clockwise from the
    vehicle's forward axis [rad]."""
    pitch: Annotated[Angle, Field(ge=-math.pi / 2, le=math.pi / 2)] = 0.0
    """Elevation of the instrument's forward axis on a level vehicle [rad]."""
    roll: Annotated[Angle, Field(ge=-math.pi, le=math.pi)] = 0.0
    """Angle of the instrument's right axis below the horizontal on a level vehicle
    [rad]."""
    boresight: tuple[_Turn, _Turn, _Turn] = (0.0, 0.0, 0.0)
    """Rotation of the instrument away from heading, pitch and roll above: rotation
    vector about its right, down and forward axis [rad]."""
    clock_offset: Time = 0.0
    """Time to add to readings of the instrument's clock to obtain the clock of the
    trajectory [s]."""
    clock_drift: _ClockDrift = 0.0
    """Increase of the clock offset per time [1]."""
    clock_reference: AwareDatetime | None = None
    """Date and time at which `clock_offset` is exact; needed for a drift if the
    trajectory has dates. Otherwise the offset is exact at the start of a scan."""
    lever_arm_uncertainty: _LengthError | None = None
    """Standard uncertainty of each component of the lever arm; unknown by default
    [m]."""
    lever_arm_uncertainties: tuple[_LengthError, _LengthError, _LengthError] | None = (
        None
    )
    """Standard uncertainties of the lever arm (right, down, forward), if they differ
    [m]."""
    boresight_uncertainty: _AngleError | None = None
    """Standard uncertainty of the rotation about each axis of the instrument; unknown
    by default [rad]."""
    boresight_uncertainties: tuple[_AngleError, _AngleError, _AngleError] | None = None
    """Standard uncertainties of the rotation about the right, down and forward axis, if
    they differ [rad]."""
    clock_uncertainty: Annotated[Time, Field(ge=0, le=60)] | None = None
    """Standard uncertainty of the clock offset; unknown by default [s]."""
    clock_drift_uncertainty: Annotated[Fraction, Field(ge=0, le=0.01)] = 0.0
    """Standard uncertainty of the clock drift [1]."""
    correlation: tuple[tuple[_Correlation, ...], ...] | None = None
    """Correlation matrix of eight errors: lever arm (right, down, forward), boresight
    (right, down, forward), clock offset, clock drift. Without it, they are independent
    [1]."""

    @model_validator(mode="after")
    def _uncertainties_are_stated_once(self) -> Self:
        for name in ("lever_arm", "boresight"):
            both = (f"{name}_uncertainty", f"{name}_uncertainties")
            if all(getattr(self, field) is not None for field in both):
                raise ValueError(f"{both[0]} and {both[1]} are both stated; state one")
        return self

    @model_validator(mode="after")
    def _is_a_correlation_matrix(self) -> Self:
        if self.correlation is None:
            return self
        if [len(row) for row in self.correlation] != [8] * 8:
            raise ValueError("correlation needs eight rows of eight numbers")
        matrix = np.array(self.correlation)
        if (np.diag(matrix) != 1).any() or (matrix != matrix.T).any():
            raise ValueError("correlation must be symmetric, with 1 in its diagonal")
        least = float(np.linalg.eigvalsh(matrix)[0])
        if least < -1e-5:
            raise ValueError(
                f"correlation has the eigenvalue {least:.3g}; the matrix of real "
                "errors has none below 0"
            )
        return self


class LineCourse(Description):
    """Straight course at a constant speed and depth.

    Examples
    --------
    >>> from amulor.survey import LineCourse
    >>> LineCourse(kind="line", start=("0 m", "-1 m", "-8 m"), speed="0.2 m/s").speed
    0.2
    """

    kind: Literal["line"]
    """Kind of course."""
    start: Position
    """Reference point of the vehicle at the start of the scan (east, north, up) [m]."""
    heading: _Heading = 0.0
    """Direction of travel and of the bow, clockwise from grid north [rad]."""
    speed: _Moving
    """Speed along the course [m/s]."""


class LawnMowerCourse(Description):
    """Parallel lines at a constant speed and depth, joined by half circles.

    The bow points in the direction of the first line throughout.

    Examples
    --------
    >>> from amulor.survey import LawnMowerCourse
    >>> course = LawnMowerCourse(
    ...     kind="lawn-mower",
    ...     start=("0 m", "0 m", "-8 m"),
    ...     speed="0.2 m/s",
    ...     line_length="3 m",
    ...     line_spacing="0.5 m",
    ... )
    >>> course.line_spacing
    0.5
    """

    kind: Literal["lawn-mower"]
    """Kind of course."""
    start: Position
    """Reference point of the vehicle at the start of the scan (east, north, up) [m]."""
    heading: _Heading = 0.0
    """Direction of the first line and of the bow, clockwise from grid north [rad]."""
    speed: _Moving
    """Speed along the course [m/s]."""
    line_length: Annotated[Length, Field(gt=0, le=1e5)]
    """Length of each line [m]."""
    line_spacing: Annotated[Length, Field(gt=0, le=1e3)]
    """Distance between lines; each lies to the right of the last [m]."""


class OrbitCourse(Description):
    """Horizontal circle, clockwise from above, with the bow towards its center.

    Examples
    --------
    >>> from amulor.survey import OrbitCourse
    >>> OrbitCourse(
    ...     kind="orbit", center=("0 m", "0 m", "-8 m"), radius="2 m", speed="0.1 m/s"
    ... ).radius
    2.0
    """

    kind: Literal["orbit"]
    """Kind of course."""
    center: Position
    """Center of the circle, at the height of the vehicle (east, north, up) [m]."""
    radius: Annotated[Length, Field(gt=0, le=1e4)]
    """Radius of the circle [m]."""
    bearing: _Heading = 0.0
    """Direction from the center to the vehicle at the start of the scan, clockwise from
    grid north [rad]."""
    speed: _Moving
    """Speed along the circle [m/s]."""


class HoverCourse(Description):
    """Vehicle that keeps its place and heading, apart from current and waves.

    Examples
    --------
    >>> from amulor.survey import HoverCourse
    >>> HoverCourse(kind="hover", start=("0 m", "0 m", "-8 m")).heading
    0.0
    """

    kind: Literal["hover"]
    """Kind of course."""
    start: Position
    """Reference point of the vehicle at the start of the scan (east, north, up) [m]."""
    heading: _Heading = 0.0
    """Direction of the bow, clockwise from grid north [rad]."""


Course = Annotated[
    LineCourse | LawnMowerCourse | OrbitCourse | HoverCourse,
    Field(discriminator="kind"),
]


class Disturbance(Description):
    """Departures of the vehicle from its course, by current and waves.

    Examples
    --------
    >>> from amulor.survey import Disturbance
    >>> Disturbance(current=("1 cm/s", "0 m/s", "0 m/s"), roll="1 deg").current
    (0.01, 0.0, 0.0)
    """

    current: tuple[_Drift, _Drift, _Drift] = (0.0, 0.0, 0.0)
    """Velocity of a drift that the vehicle does not correct (east, north, up) [m/s]."""
    position: Annotated[Length, Field(ge=0, le=10)] = 0.0
    """Rms oscillation of each coordinate [m]."""
    heading: Annotated[Angle, Field(ge=0, le=0.5)] = 0.0
    """Rms oscillation of the heading [rad]."""
    pitch: Annotated[Angle, Field(ge=0, le=0.5)] = 0.0
    """Rms oscillation of the pitch [rad]."""
    roll: Annotated[Angle, Field(ge=0, le=0.5)] = 0.0
    """Rms oscillation of the roll [rad]."""
    period: Annotated[Time, Field(ge=0.5, le=600)] = 6.0
    """Mean period of the oscillations, between half and twice of it [s]."""


class Navigation(Description):
    """Errors of inertial navigation with a Doppler log, as standard deviations.

    Examples
    --------
    >>> from amulor.survey import Navigation
    >>> Navigation(
    ...     position_walk="5 mm", heading_uncertainty="0.1 deg", scale_uncertainty=0.002
    ... ).position_walk
    0.005
    """

    interval: Annotated[Time, Field(ge=1e-3, le=60)] = 0.1
    """Interval between messages [s]."""
    position_uncertainty: Annotated[Length, Field(ge=0, le=1000)] = 0.0
    """Constant error of each coordinate [m]."""
    position_walk: Annotated[Length, Field(ge=0, le=100)] = 0.0
    """Random walk of each coordinate after one minute [m]."""
    position_noise: Annotated[Length, Field(ge=0, le=10)] = 0.0
    """Independent error of each coordinate in each message [m]."""
    velocity_uncertainty: Annotated[Speed, Field(ge=0, le=1)] = 0.0
    """Constant error of each component of the velocity [m/s]."""
    scale_uncertainty: Annotated[Fraction, Field(ge=0, le=0.1)] = 0.0
    """Relative error of the distance from the start, by the Doppler log [1]."""
    heading_uncertainty: Annotated[Angle, Field(ge=0, le=0.5)] = 0.0
    """Constant error of the heading, which turns the course about its start [rad]."""
    level_uncertainty: Annotated[Angle, Field(ge=0, le=0.5)] = 0.0
    """Constant error of the rotation about each horizontal axis [rad]."""
    attitude_walk: Annotated[Angle, Field(ge=0, le=0.5)] = 0.0
    """Random walk of the rotation about each axis after one minute [rad]."""
    attitude_noise: Annotated[Angle, Field(ge=0, le=0.5)] = 0.0
    """Independent error of the rotation about each axis in each message [rad]."""


class Platform(Description):
    """Vehicle that carries the instrument during the scan.

    Examples
    --------
    >>> from amulor.survey import LineCourse, Platform
    >>> Platform(
    ...     course=LineCourse(
    ...         kind="line", start=("0 m", "-1 m", "-8 m"), speed="0.2 m/s"
    ...     ),
    ...     readings="at-once",
    ... ).readings
    'at-once'
    """

    course: Course
    """Planned course of the vehicle."""
    readings: Literal["in-turn", "at-once"] = "in-turn"
    """Readings of a pixel at its frequencies and channels: one after another, or all at
    once."""
    disturbance: Disturbance = Disturbance()
    """Departures from the course; none by default."""
    navigation: Navigation = Navigation()
    """Errors of the measured trajectory; none by default."""
    mounting: Mounting = Mounting()
    """Place and attitude of the instrument on the vehicle, and its clock."""
