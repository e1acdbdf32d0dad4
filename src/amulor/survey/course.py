"""Planned course of a vehicle: position and heading over time."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor._attitude import rotation_by, rotation_of
from amulor.survey.directions import readings_in_turn
from amulor.survey.platform import (
    Course,
    HoverCourse,
    LawnMowerCourse,
    LineCourse,
    Mounting,
    OrbitCourse,
    Platform,
)
from amulor.survey.scan import Pose
from amulor.survey.survey import Survey

Floats = NDArray[np.float64]

#: Rotation from (right, down, forward) of a level vehicle heading north to the site.
LEVEL = rotation_of(0.0, 0.0, 0.0)


def planned(course: Course, time: ArrayLike) -> tuple[Floats, Floats]:
    """Return position (east, north, up), shape (n, 3) [m], and heading (n,) [rad].

    Time counts from the start of the scan. Before it, the vehicle arrives on the same
    course; a lawn mower arrives along its first line.
    """
    at = np.asarray(time, dtype=float)
    if isinstance(course, OrbitCourse):
        bearing = course.bearing + course.speed * at / course.radius
        around = np.stack([np.sin(bearing), np.cos(bearing), 0 * at], axis=-1)
        return np.array(course.center) + course.radius * around, bearing + np.pi
    across, along = _flat(course, at)
    sine, cosine = np.sin(course.heading), np.cos(course.heading)
    east = cosine * across + sine * along
    north = cosine * along - sine * across
    away = np.stack([east, north, 0 * at], axis=-1)
    return np.array(course.start) + away, np.full(at.shape, course.heading)


def _flat(
    course: LineCourse | LawnMowerCourse | HoverCourse, time: Floats
) -> tuple[Floats, Floats]:
    """Return the way to the right of the heading and along it [m]."""
    if isinstance(course, HoverCourse):
        return 0 * time, 0 * time
    way = course.speed * time
    if isinstance(course, LineCourse):
        return 0 * way, way
    length, radius = course.line_length, course.line_spacing / 2
    period = length + np.pi * radius
    line = np.maximum(np.floor(way / period), 0.0)
    rest = way - line * period
    turn = np.maximum(rest - length, 0.0) / radius
    across = line * course.line_spacing + radius * (1 - np.cos(turn))
    forth = np.minimum(rest, length) + radius * np.sin(turn)
    return across, np.where(line % 2 == 0, forth, length - forth)


def planned_track(survey: Survey) -> tuple[float, float]:
    """Return length [m] and duration [s] of the planned course during a scan."""
    platform, scan = survey.platform, survey.scan
    assert platform is not None
    duration = scan.rows * scan.columns * scan.dwell * readings_in_turn(survey)
    time = np.linspace(0.0, duration, 2000)
    position, _ = planned(platform.course, time)
    position = position + time[:, None] * np.array(platform.disturbance.current)
    track = np.linalg.norm(np.diff(position, axis=0), axis=1).sum()
    return float(track), float(duration)


def planned_spacing(survey: Survey, slant_range: float) -> tuple[float, float]:
    """Return planned distances between rows and between columns of points [m]."""
    scan = survey.scan
    pitch = scan.azimuth_span / max(scan.columns - 1, 1)
    return planned_track(survey)[0] / scan.rows, pitch * slant_range


def course_speed(course: Course) -> float:
    """Return the speed along a course [m/s]; 0 if it keeps its place."""
    return 0.0 if isinstance(course, HoverCourse) else course.speed


def planned_speed(platform: Platform) -> float:
    """Return the planned speed of a vehicle, with current and oscillation [m/s]."""
    wave = platform.disturbance
    along = course_speed(platform.course)
    swell = 2 * np.pi / wave.period * wave.position
    return float(along + np.linalg.norm(wave.current) + swell)


#: Rms frequency and rms square of the frequency of oscillations, whose periods lie
#: between half and twice the mean, times the mean period over 2 pi [1].
_QUICKER, _BENT = 1.16, 1.69
#: Change of a range by the turn of a beam: at this distance on a slope of 45 deg [m].
_ARM = 1.0


def range_rate(
    platform: Platform, speed: ArrayLike | None = None
) -> tuple[Floats, float]:
    """Return the rms rate of ranges [m/s], and the rms change of the rate [m/s^2].

    The direction of the course relative to surface and beam is unknown. Oscillations
    are those of each coordinate, and of the angles for a beam on a slope. `speed`
    replaces that of the course.
    """
    wave = platform.disturbance
    along = course_speed(platform.course) if speed is None else speed
    steady = (np.asarray(along) + np.linalg.norm(wave.current)) / np.sqrt(3)
    turn = np.linalg.norm([wave.heading, wave.pitch, wave.roll])
    frequency = 2 * np.pi / wave.period
    swell = np.hypot(wave.position, _ARM * turn)
    rate = np.hypot(steady, _QUICKER * frequency * swell)
    return np.asarray(rate), float(_BENT * frequency**2 * swell)


def boresight_of(mounting: Mounting) -> Floats:
    """Return the rotation from instrument axes to vehicle axes, shape (3, 3) [1]."""
    turn = rotation_of(mounting.heading, mounting.pitch, mounting.roll)
    return np.asarray(LEVEL.T @ turn @ rotation_by(mounting.boresight))


def scene_axes(survey: Survey) -> tuple[Floats, Floats]:
    """Return origin [m] and rotation of the targets' axes in the site."""
    pose = survey.pose or Pose()
    return np.array(pose.position), rotation_of(pose.heading, pose.pitch, pose.roll)


def planned_instrument(survey: Survey, time: ArrayLike) -> tuple[Floats, Floats]:
    """Return origin and rotation of the instrument in the targets' axes, (n, 3, 3)."""
    platform = survey.platform
    assert platform is not None
    position, heading = planned(platform.course, time)
    turn = rotation_of(heading, 0.0, 0.0)
    mounting = platform.mounting
    return in_scene(
        survey,
        position + turn @ np.array(mounting.lever_arm),
        turn @ boresight_of(mounting),
    )


def in_scene(
    survey: Survey, position: Floats, rotation: Floats
) -> tuple[Floats, Floats]:
    """Transform poses of the instrument from the site to the targets' axes."""
    origin, axes = scene_axes(survey)
    return (position - origin) @ axes, axes.T @ rotation
