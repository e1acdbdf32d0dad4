"""Monte Carlo of light that two walls of a corner reflect, without amulor.

The beam lights one point of a Lambertian wall. A ray leaves it at random, with a
density in proportion to the cosine, and may meet the other wall, which is a rectangle.
What that returns to the instrument is compared with the light of the first point.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

Floats = NDArray[np.float64]


def _frame(normal: Floats) -> Floats:
    """Two unit vectors across a normal, and the normal."""
    start = np.array([0.0, 1.0, 0.0])
    first = np.cross(start, normal)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first), normal])


def double_over_single(
    point: Floats,
    normal: Floats,
    *,
    wall_corner: Floats,
    wall_sides: tuple[Floats, Floats],
    reflectance: float,
    instrument: Floats,
    modulation_frequency: float,
    group_index: float,
    attenuation: float = 0.0,
    rays: int,
    rng: np.random.Generator,
) -> tuple[complex, float]:
    """Return the ratio of light reflected twice to once, and its standard error.

    The wall has a corner and two sides that are perpendicular to each other [m].
    """
    radius, turn = np.sqrt(rng.random(rays)), 2 * np.pi * rng.random(rays)
    local = np.stack(
        [radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius**2)], axis=1
    )
    direction = local @ _frame(normal)
    across = np.cross(*wall_sides)
    across /= np.linalg.norm(across)
    with np.errstate(divide="ignore", invalid="ignore"):
        length = ((wall_corner - point) @ across) / (direction @ across)
    hit = point + np.where(length > 0, length, 0.0)[:, None] * direction
    inside = length > 0
    for side in wall_sides:
        along = (hit - wall_corner) @ side / (side @ side)
        inside &= (along >= 0) & (along <= 1)
    back, direct = instrument - hit, instrument - point
    back_length, direct_length = np.linalg.norm(back, axis=1), np.linalg.norm(direct)
    cosine = np.abs(back @ across) / back_length
    facing = direct @ normal / direct_length
    longer = length + back_length - direct_length
    value = np.where(
        inside,
        reflectance * cosine / facing * (direct_length / back_length) ** 2
        * np.exp(-attenuation * np.where(inside, longer, 0.0)),
        0.0,
    )  # fmt: skip
    rate = 2 * np.pi * modulation_frequency * group_index / speed_of_light
    ratio = value * np.exp(1j * rate * np.where(inside, longer, 0.0))
    return complex(ratio.mean()), float(np.abs(ratio).std() / np.sqrt(rays))
