"""Makes amphora.ply: an amphora of 30 cm, 1.5 m before the instrument, by its profile.

Coordinates are right, down, forward in metres, as the instrument's axes; the survey
amphora.toml scans it. To make the file anew: python examples/amphora/make_amphora.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from scipy.interpolate import PchipInterpolator

#: Height above the toe and radius of the wall there [m].
PROFILE = (
    (0.000, 0.012),
    (0.020, 0.014),
    (0.060, 0.040),
    (0.110, 0.064),
    (0.160, 0.073),
    (0.195, 0.062),
    (0.220, 0.033),
    (0.250, 0.024),
    (0.280, 0.024),
    (0.290, 0.033),
    (0.300, 0.033),
)
DISTANCE, HEIGHT = 1.5, 0.30


def wall(rings: int = 61, around: int = 48) -> trimesh.Trimesh:
    """Return the turned body."""
    heights, radii = np.array(PROFILE).T
    place = np.linspace(0, HEIGHT, rings)
    radius = PchipInterpolator(heights, radii)(place)
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    body = np.stack(
        [
            radius[:, None] * np.cos(angle),
            np.broadcast_to(HEIGHT / 2 - place[:, None], (rings, around)),
            radius[:, None] * np.sin(angle),
        ],
        axis=-1,
    )
    return _skin(body)


def handle(side: int, steps: int = 17, around: int = 10) -> trimesh.Trimesh:
    """Return a handle from the neck to the shoulder."""
    turn = np.linspace(-0.45 * np.pi, 0.5 * np.pi, steps)
    right = side * (0.026 + 0.030 * np.cos(turn))
    up = 0.230 + 0.036 * np.sin(turn)
    along = np.stack([np.gradient(right), np.gradient(up)], axis=1)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    out = 0.007 * np.cos(angle)
    tube = np.stack(
        [
            right[:, None] + out * along[:, 1:],
            HEIGHT / 2 - up[:, None] + out * along[:, :1],
            np.broadcast_to(0.009 * np.sin(angle), (steps, around)),
        ],
        axis=-1,
    )
    return _skin(tube)


def _skin(rings: np.ndarray) -> trimesh.Trimesh:
    """Return the mesh over rings of points."""
    many, around = rings.shape[:2]
    number = np.arange(many * around).reshape(many, around)
    a, b = number[:-1], np.roll(number, -1, axis=1)[:-1]
    c, d = number[1:], np.roll(number, -1, axis=1)[1:]
    faces = np.concatenate([np.stack([a, c, b], -1), np.stack([b, c, d], -1)], axis=1)
    return trimesh.Trimesh(rings.reshape(-1, 3), faces.reshape(-1, 3), process=False)


if __name__ == "__main__":
    amphora = trimesh.util.concatenate([wall(), handle(-1), handle(1)])
    amphora.apply_translation([0, 0, DISTANCE])
    path = Path(__file__).with_name("amphora.ply")
    amphora.export(path, encoding="binary")
    print(f"{path}: {len(amphora.faces)} triangles")
