"""Light that two surfaces of the targets reflect, one after the other."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.simulation.scene import Hits, Scene
from amulor.survey import Survey, WaterProperties
from amulor.survey.view import angle_of_view

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Rays from each lit point.
_RAYS = 512
#: Rays that are traced at once.
_AT_ONCE = 500_000
#: Rays start at this height above a surface, so that they do not meet it [m].
_HEIGHT = 1e-6


def second_reflection(
    survey: Survey,
    scene: Scene,
    hits: Hits,
    receiver: Floats,
    *,
    water: WaterProperties,
    group_index: float,
) -> Complex:
    r"""Return the doubly reflected light of each hit, over that of a facing surface.

    The ratio is to the light that a white Lambertian surface at the lit point P returns
    if it faces the receiver. Rays leave P with a density proportional to the cosine. A
    ray that meets the surface Q contributes

    .. math:: \varrho_P \varrho_Q \cos\theta_Q \left(\frac{z_P}{z_Q}\right)^2
        \exp (i \omega / v - k) (r + z_Q - z_P) .

    Both surfaces are Lambertian, and the lines are straight. `receiver` is one point
    for all hits or one for each [m]. Shape (frequency, hit), with 0 Hz first.
    """
    frequency = np.array([0.0, *survey.instrument.modulation_frequencies])
    reflectance = np.array([target.reflectance for target in survey.targets])
    ratio = np.zeros((frequency.size, hits.target.size), dtype=complex)
    met = np.flatnonzero(hits.target >= 0)
    places = np.broadcast_to(receiver, hits.point.shape)
    lit = np.zeros(hits.target.size)
    lit[met] = (scene.texture(hits) * reflectance[hits.target])[met]
    per_path = 2 * math.pi * frequency * group_index / speed_of_light
    acceptance = angle_of_view(survey)
    for first in range(0, met.size, _AT_ONCE // _RAYS):
        part = met[first : first + _AT_ONCE // _RAYS]
        point, end = hits.point[part], places[part]
        way = _directions(hits.normal[part]).reshape(-1, 3)
        start = point + _HEIGHT * hits.normal[part]
        second = scene.cast(np.repeat(start, _RAYS, axis=0), way)
        ray = np.flatnonzero(second.target >= 0)
        owner = ray // _RAYS
        ends = np.repeat(end, _RAYS, axis=0)
        seen = scene.visible_fraction(second, ends[None], np.ones(1))[ray]
        back, direct = end[owner] - second.point[ray], end[owner] - point[owner]
        back_length, direct_length = (
            np.linalg.norm(line, axis=1) for line in (back, direct)
        )
        facing = np.einsum("ri,ri->r", back, second.normal[ray]) / back_length
        longer = second.distance[ray] + back_length - direct_length
        bright = scene.texture(second)[ray] * reflectance[second.target[ray]]
        size = lit[part][owner] * seen * bright * np.maximum(facing, 0.0)
        size *= (direct_length / back_length) ** 2
        size *= np.exp(-water.reduced_attenuation * longer) / _RAYS
        if math.isfinite(acceptance):
            aside = np.einsum("ri,ri->r", back, direct) / (back_length * direct_length)
            size *= np.exp(-((np.arccos(np.clip(aside, -1, 1)) / acceptance) ** 2))
        for number, k in enumerate(per_path):
            np.add.at(ratio[number], part[owner], size * np.exp(1j * k * longer))
    return ratio


def _directions(normal: Floats) -> Floats:
    """Return rays about each normal with a density of the cosine, (hit, ray, 3)."""
    number = np.arange(_RAYS)
    share = (number + 0.5) / _RAYS
    # Steps of the golden ratio cover the circle evenly.
    angle = math.pi * (1 + math.sqrt(5)) * number
    across = np.sqrt(share)
    local = across * np.cos(angle), across * np.sin(angle), np.sqrt(1 - share)
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    first = np.cross(normal, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normal, first)
    sides = zip(local, (first, second, normal), strict=True)
    return np.asarray(sum(a[None, :, None] * side[:, None, :] for a, side in sides))
