"""Photons between rectangles in water: each is followed until it ends by chance.

The water scatters evenly in all directions. A rectangle reflects by Lambert's law, and
by facets that mirror. A facet is drawn from the slopes alone; its projected area and
Smith's shadowing become a weight of the photon. A receiver in the plane z = 0 takes
light that comes from z above 0. Nothing is shared with the package.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light
from scipy.special import erf


def _shadowing(cosine, slope):
    """Return Smith's Lambda."""
    a = cosine / np.sqrt(1 - np.minimum(cosine**2, 1 - 1e-15)) / np.sqrt(2) / slope
    return (erf(a) - 1) / 2 + np.exp(-(a**2)) / (2 * a * np.sqrt(np.pi))


def _mirrored(rng, way, wall, slope):
    """Return ways behind random facets of walls with normals `wall`, and weights."""
    side = np.cross(wall, way + 0.01)  # any direction along the wall
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(wall, side)
    x, y = rng.normal(scale=slope, size=(2, len(wall), 1))
    facet = wall - x * side - y * other
    area = np.linalg.norm(facet, axis=1)
    facet /= area[:, None]
    towards = -np.sum(way * facet, axis=1)
    after = way + 2 * towards[:, None] * facet
    arriving, leaving = -np.sum(way * wall, axis=1), np.sum(after * wall, axis=1)
    good = (towards > 0) & (leaving > 0)
    safe = np.where(good, leaving, 1.0)
    shadow = 1 + _shadowing(arriving, slope) + _shadowing(safe, slope)
    return after, np.where(good, area * towards / arriving / shadow, 0.0)


def chance_hits(
    rectangles: ArrayLike,
    frequency: NDArray[np.float64],
    *,
    reflectance: ArrayLike,
    absorption: float,
    scattering: float,
    index: float,
    case: dict,
    histories: int,
    gloss: float = 0.0,
    slope: float = 0.1,
) -> NDArray[np.complex128]:
    """Return per history the light that meets the receiver.

    A rectangle is its center and two half sides; each has a reflectance, or all have
    one. Shape (2, histories, frequencies): light without and with a touch.
    """
    rng = np.random.default_rng(case["seed"])
    wave = 2j * np.pi * frequency * index / speed_of_light
    rectangles = np.array(rectangles, dtype=float)
    each = np.broadcast_to(np.asarray(reflectance, dtype=float), len(rectangles))
    place = np.tile(np.array(case["position"], dtype=float), (histories, 1))
    way = np.array(case["direction"], dtype=float)
    way = np.tile(way / np.linalg.norm(way), (histories, 1))
    length, number = np.zeros(histories), np.arange(histories)
    weight = np.ones(histories)
    touched = np.zeros(histories, dtype=np.int64)
    light = np.zeros((2, histories, frequency.size), dtype=complex)
    while number.size > 0:
        step = rng.exponential(1 / (absorption + scattering), number.size)
        wall, diffuse = np.zeros((number.size, 3)), np.zeros(number.size)
        for (centre, one, two), bright in zip(rectangles, each, strict=True):
            normal = np.cross(one, two) / np.linalg.norm(np.cross(one, two))
            with np.errstate(divide="ignore", invalid="ignore"):
                to_wall = ((centre - place) @ normal) / (way @ normal)
                offset = place + to_wall[:, None] * way - centre
                nearer = (
                    (to_wall > 1e-9)
                    & (to_wall < step)
                    & (np.abs(offset @ one) < one @ one)
                    & (np.abs(offset @ two) < two @ two)
                )
            step[nearer] = to_wall[nearer]
            wall[nearer] = -normal * np.sign(way[nearer] @ normal)[:, None]
            diffuse[nearer] = bright
        with np.errstate(divide="ignore"):
            to_face = -place[:, 2] / way[:, 2]
        crossed = (place[:, 2] > 0) & (way[:, 2] < 0) & (to_face < step)
        where = place + np.where(crossed, to_face, 0.0)[:, None] * way
        offset = where[:, :2] - np.array(case["receiver"])
        crossed &= np.hypot(*offset.T) < case["radius"]
        crossed &= -way[:, 2] > np.cos(case["acceptance"])
        total = (length + to_face)[crossed]
        light[touched[crossed], number[crossed]] += weight[crossed, None] * np.exp(
            wave * total[:, None]
        )
        at_wall = np.any(wall != 0, axis=1)
        drawn = rng.uniform(size=number.size)
        albedo = scattering / (absorption + scattering)
        mirror = at_wall & (drawn >= diffuse) & (drawn < diffuse + gloss)
        going = mirror | (drawn < np.where(at_wall, diffuse, albedo))
        place = place + step[:, None] * way
        length, touched = length + step, touched | at_wall
        # Even in all directions; with the normal added, Lambert's law about it.
        after = rng.normal(size=wall.shape)
        after = after / np.linalg.norm(after, axis=1, keepdims=True) + wall
        after /= np.linalg.norm(after, axis=1, keepdims=True)
        if mirror.any():
            after[mirror], factor = _mirrored(rng, way[mirror], wall[mirror], slope)
            weight[mirror] *= factor
            going &= weight > 0
        place, way, length = place[going], after[going], length[going]
        touched, number, weight = touched[going], number[going], weight[going]
    return light
