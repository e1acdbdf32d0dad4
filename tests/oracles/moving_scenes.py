"""Scenes of lines from a vehicle, by distance functions: amphora, wall, ladder.

Nothing here uses the product. A scene is the distance from a point to the nearest
surface [m]; rays are followed by steps of this distance (sphere tracing). The vehicle
drives near z = -9 and looks down; a wall or a ladder is the same scene turned upright.
"""

from __future__ import annotations

import numpy as np


def _waves(point, height):
    x, y = point[:, 0], point[:, 1]
    return height * (np.sin(3.1 * x + 0.4) * np.cos(2.3 * y + 1.0))


def _cylinder(point, start, end, radius):
    """Distance from a capped round bar."""
    a, b = np.array(start), np.array(end)
    along = np.clip(((point - a) @ (b - a)) / ((b - a) @ (b - a)), 0.0, 1.0)
    return np.linalg.norm(point - a - along[:, None] * (b - a), axis=1) - radius


def _ball(point, middle, radius):
    return np.linalg.norm(point - np.array(middle), axis=1) - radius


def amphora(point):
    """Sea bed with ripples of 2 cm, and a jar of three balls and a neck."""
    bed = 0.9 * (point[:, 2] + 11.0 - _waves(point, 0.02))
    body = np.minimum(
        _cylinder(point, (-0.15, 0.1, -10.9), (0.25, -0.05, -10.88), 0.14),
        _ball(point, (0.05, 0.03, -10.87), 0.18),
    )
    neck = _cylinder(point, (0.25, -0.05, -10.88), (0.45, -0.12, -10.9), 0.05)
    stone = _ball(point, (-0.45, -0.5, -11.0), 0.2)
    return np.minimum.reduce([bed, body, neck, stone])


def wall(point):
    """Wall with bulges of 1 cm, three struts across and one along."""
    plane = 0.9 * (point[:, 2] + 11.0 - _waves(point, 0.01))
    struts = [
        _cylinder(point, (-2, y, -10.93), (2, y + 0.1, -10.93), 0.08)
        for y in (-0.75, -0.05, 0.8)
    ]
    along = _cylinder(point, (0.32, -3, -10.92), (0.27, 3, -10.92), 0.06)
    return np.minimum.reduce([plane, *struts, along])


def ladder(point):
    """Ladder of two rails and seven rungs, half a meter before a rough wall."""
    back = 0.85 * (point[:, 2] + 11.3 - _waves(point, 0.05))
    rails = [
        _cylinder(point, (x, -3, -10.8), (x, 3, -10.8), 0.05) for x in (-0.22, 0.22)
    ]
    rungs = [
        _cylinder(point, (-0.22, y, -10.8), (0.22, y, -10.8), 0.04)
        for y in np.arange(-1.05, 1.2, 0.35)
    ]
    return np.minimum.reduce([back, *rails, *rungs])


def distances(start, beam, scene):
    """Distances along rays to the first surface of a scene [m]."""
    reach = np.full(len(start), 0.3)
    active = np.ones(len(start), dtype=bool)
    for _ in range(400):
        step = scene(start[active] + reach[active, None] * beam[active])
        reach[active] += step
        active[active] = np.abs(step) > 1e-10
        if not active.any():
            break
    reach[active | (reach > 12.0)] = np.nan
    return reach
