"""Lines of a vehicle over a rough sea bed, with errors of mounting and navigation.

Nothing here uses the product. A vehicle drives straight lines and oscillates about its
course. A beam that swings across the course is followed to the bed by bisection, from
the true pose at each instant. The recorded poses have errors: a constant shift of each
line, random walks of position and attitude, and the time stamps of another clock.
"""

from __future__ import annotations

import numpy as np
from moving_pass import LEVEL, attitude


def turns_of(axis: int, angle: np.ndarray) -> np.ndarray:
    """Matrices of rotations by angles about a coordinate axis, shape (n, 3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrices = np.zeros((*np.shape(angle), 3, 3))
    matrices[..., axis, axis] = 1.0
    matrices[..., i, i] = matrices[..., j, j] = c
    matrices[..., i, j], matrices[..., j, i] = -s, s
    return matrices


def small_turns(vectors: np.ndarray) -> np.ndarray:
    """Matrices of rotation vectors by the power series of the exponential."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    cross = np.zeros((*vectors.shape, 3))
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -z, y, -x
    cross[..., 1, 0], cross[..., 2, 0], cross[..., 2, 1] = z, -y, x
    total, term = np.broadcast_to(np.eye(3), cross.shape).copy(), np.eye(3)
    for order in range(1, 12):
        term = term @ cross / order
        total += term
    return total


def rough_bed(east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """Height of a sea bed with waves of sand and flat stones [m]."""
    sand = 0.10 * np.sin(3.1 * east + 0.4) * np.cos(2.3 * north + 1.0)
    stones = 0.08 * np.sin(4.7 * north - 2.9 * east) + 0.05 * np.cos(5.9 * east)
    return -11.0 + sand + stones


def distances(start: np.ndarray, beam: np.ndarray, bed=rough_bed) -> np.ndarray:
    """Distances along rays to the bed, by steps and then by bisection [m]."""
    low, high = np.zeros(len(start)), np.full(len(start), np.nan)
    for step in np.arange(0.1, 12.0, 0.05):
        point = start + step * beam
        below = point[:, 2] < bed(point[:, 0], point[:, 1])
        high = np.where(below & np.isnan(high), step, high)
        low = np.where(np.isnan(high), step, low)
    for _ in range(45):
        middle = (low + high) / 2
        point = start + middle[:, None] * beam
        above = point[:, 2] > bed(point[:, 0], point[:, 1])
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return (low + high) / 2


class Vehicle:
    """True motion along a line: middle of the track, heading, speed, oscillations."""

    def __init__(self, rng, *, middle, heading, speed, duration, wave, rocking):
        self.middle, self.heading, self.speed = np.array(middle), heading, speed
        self.duration = duration
        # Three tones for each of three coordinates and three angles.
        rms = np.array([*[wave] * 3, *rocking])
        self.amplitude = rms[:, None] * np.sqrt(2 / 3) * np.ones((6, 3))
        self.rate = 2 * np.pi / rng.uniform(2.5, 6.0, (6, 3))
        self.phase = rng.uniform(0, 2 * np.pi, (6, 3))

    def at(self, time):
        """Positions and rotations from right, down, forward to east, north, up."""
        way = self.speed * (time - self.duration / 2)
        course = np.array([np.sin(self.heading), np.cos(self.heading), 0.0])
        waves = self.amplitude * np.sin(self.rate * time[:, None, None] + self.phase)
        off = waves.sum(axis=-1)
        turn = turns_of(2, -(self.heading + off[:, 3]))
        turn = turn @ turns_of(0, off[:, 4]) @ turns_of(1, off[:, 5]) @ LEVEL
        return self.middle + way[:, None] * course + off[:, :3], turn


def line_of(
    rng,
    vehicle,
    *,
    arm,
    angles,
    bend,
    offset,
    drift,
    rows,
    columns,
    fan,
    noise,
    errors,
    interval=0.05,
    emitter=(0.0, 0.0, 0.0),
    bed=rough_bed,
    trace=distances,
) -> dict:
    """Ranges of a line scanner, and the recorded track of its vehicle.

    `angles` and `bend` are nominal heading, pitch and roll of the instrument, and its
    rotation away from them. `errors` has the standard deviations: `shift` [m],
    `position_walk` [m per root second], `attitude_walk` [rad per root second]. `trace`
    follows rays to the bed.
    """
    duration = vehicle.duration
    time = duration * (np.arange(rows * columns) + 0.5) / (rows * columns)
    azimuth = np.linspace(-fan / 2, fan / 2, columns)
    # The mirror swings back and forth.
    swing = np.where(np.arange(rows)[:, None] % 2, azimuth[::-1], azimuth)
    away = np.stack([np.sin(swing), 0 * swing, np.cos(swing)], axis=-1).reshape(-1, 3)
    place, turn = vehicle.at(time)
    sight = turn @ (LEVEL.T @ attitude(*angles) @ small_turns(np.array(bend)))
    start = place + turn @ np.array(arm) + sight @ np.array(emitter)
    beam = np.einsum("nij,nj->ni", sight, away)
    true = trace(start, beam, bed)
    # Poses before and after the line, so that the clock may be off.
    stamps = np.arange(-1.0, duration + 1.0, interval)
    position, rotation = vehicle.at(stamps)
    step = np.sqrt(interval)
    walk = rng.normal(0, 1, (len(stamps), 6)).cumsum(axis=0) * step
    walk *= np.repeat([errors["position_walk"], errors["attitude_walk"]], 3)
    shift = rng.normal(0, errors["shift"], 3)
    return {
        "time": time.reshape(rows, columns),
        "azimuth": swing,
        "slant_range": (true + rng.normal(0, noise, true.size)).reshape(rows, columns),
        "point": (start + true[:, None] * beam).reshape(rows, columns, 3),
        "stamps": stamps * (1 + drift) + offset,
        "position": position + shift + walk[:, :3],
        "rotation": small_turns(walk[:, 3:]) @ rotation,
    }
