"""Points of a pulsed-like scan from a moving vehicle, by elementary rotations.

Nothing here uses the product. A vehicle moves along a straight line; its attitude is a
product of three elementary rotations; the beam is followed to a wavy sea bed by
bisection. Axes of the instrument and of the vehicle are right, down, forward; those of
the site are east, north, up.
"""

from __future__ import annotations

import numpy as np


def elementary(axis: int, angle: float) -> np.ndarray:
    """Matrix of a rotation by an angle about a coordinate axis, right-handed."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i], matrix[j, j], matrix[i, j], matrix[j, i] = c, c, -s, s
    return matrix


#: East, north, up of the axes right, down, forward of a level vehicle heading north.
LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def attitude(heading: float, pitch: float, roll: float) -> np.ndarray:
    """Rotation from right, down, forward to east, north, up.

    The vehicle, level and heading north, rolls about its forward axis (north), then
    pitches about the right axis (east), then turns clockwise about up.
    """
    rolled = elementary(1, roll)  # about north: the right (east) side goes down
    pitched = elementary(0, pitch)  # about east: the bow (north) goes up
    turned = elementary(2, -heading)  # about up, clockwise
    return turned @ pitched @ rolled @ LEVEL


def sea_bed(east: float, north: float) -> float:
    """Height of a wavy sea bed [m]."""
    return -11.0 + 0.15 * np.sin(1.3 * east + 0.4) * np.cos(0.9 * north)


def distance_to_bed(start: np.ndarray, direction: np.ndarray) -> float:
    """Distance along a ray to the sea bed, by bisection to the last bit [m]."""
    low, high = 0.0, 2000.0
    for _ in range(200):
        middle = (low + high) / 2
        point = start + middle * direction
        if point[2] > sea_bed(point[0], point[1]):
            low = middle
        else:
            high = middle
    return (low + high) / 2


def reading_of(
    time: float,
    beam: np.ndarray,
    *,
    start: np.ndarray,
    speed: np.ndarray,
    angles: tuple[float, float, float],
    mounting: dict[str, tuple[float, float, float]],
    emitter: np.ndarray,
) -> tuple[float, np.ndarray]:
    """Range [m] and point of a reading at a time, along a beam of the instrument.

    The vehicle moves at a constant velocity and attitude. `mounting` has the lever arm
    (right, down, forward) and the angles of the instrument on the vehicle.
    """
    vehicle = attitude(*angles)
    turn = vehicle @ LEVEL.T @ attitude(*mounting["angles"])
    place = start + time * speed + vehicle @ np.array(mounting["lever_arm"])
    origin, direction = place + turn @ emitter, turn @ beam
    distance = distance_to_bed(origin, direction)
    return distance, origin + distance * direction


def beam_of(azimuth: float, elevation: float) -> np.ndarray:
    """Unit vector of a beam: right, down, forward."""
    return np.array(
        [
            np.cos(elevation) * np.sin(azimuth),
            -np.sin(elevation),
            np.cos(elevation) * np.cos(azimuth),
        ]
    )


def course_at(course: dict, time: float) -> tuple[np.ndarray, float]:
    """Place and heading of a vehicle on a course, followed piece by piece.

    Lines and half circles of a lawn mower are subtracted one after another; a circle is
    the center plus a radius that an elementary rotation about up has turned.
    """
    start = np.array(course["start"])
    kind = course["kind"]
    if kind == "hover":
        return start, course["heading"]
    if kind == "orbit":
        bearing = course["bearing"] + course["speed"] * time / course["radius"]
        arm = elementary(2, -bearing) @ np.array([0.0, course["radius"], 0.0])
        return start + arm, bearing + np.pi
    way, place, forth = course["speed"] * time, np.zeros(2), 1.0
    if kind == "line":
        place[1] = way
    else:
        while True:
            step = min(way, course["line_length"])
            place[1] += forth * step
            way -= step
            if way <= 0:
                break
            radius = course["line_spacing"] / 2
            angle = min(way / radius, np.pi)
            place += radius * np.array([1 - np.cos(angle), forth * np.sin(angle)])
            way -= angle * radius
            if way <= 0:
                break
            forth = -forth
    turn = elementary(2, -course["heading"])
    return start + turn @ np.array([*place, 0.0]), course["heading"]


def instrument_at(
    course: dict, mounting: dict, current: np.ndarray, time: float
) -> tuple[np.ndarray, np.ndarray]:
    """Origin and rotation of the instrument in the site at a time."""
    place, heading = course_at(course, time)
    vehicle = attitude(heading, 0.0, 0.0)
    turn = vehicle @ LEVEL.T @ attitude(*mounting["angles"])
    return place + current * time + vehicle @ np.array(mounting["lever_arm"]), turn


def plane_of(position: np.ndarray, angles: tuple[float, float, float]) -> np.ndarray:
    """Rotation of a plate about right, then down, then forward; its normal is last."""
    first, second, third = (elementary(axis, angles[axis]) for axis in range(3))
    return third @ second @ first


def distance_to_plane(
    origin: np.ndarray, direction: np.ndarray, point: np.ndarray, normal: np.ndarray
) -> float:
    """Distance along a ray to a plane [m]."""
    return float(normal @ (point - origin) / (normal @ direction))


def echo_in_turn(
    frequency: np.ndarray,
    distance: np.ndarray,
    beam: np.ndarray,
    receiver: np.ndarray,
    group_index: float,
) -> np.ndarray:
    """Phasors of echoes of amplitude 1, each of a distance from the emitter [m].

    The light goes from the origin along the beam, and from there to the receiver. The
    frequencies are along the first axis of the distances, the beams along the others.
    """
    back = np.linalg.norm(distance[..., None] * beam - receiver, axis=-1)
    turns = (
        frequency.reshape(-1, *[1] * (distance.ndim - 1)) * group_index / 299792458.0
    )
    return np.exp(2j * np.pi * turns * (distance + back))
