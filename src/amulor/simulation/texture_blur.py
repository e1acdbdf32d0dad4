"""Texture of a mesh as a beam and a receiver see it through scattering water."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.optics import rays
from amulor.optics._surroundings import Surroundings
from amulor.simulation.scene import Hits, Scene
from amulor.simulation.vehicle import Standing
from amulor.survey import Survey, WaterProperties
from amulor.survey.view import View
from amulor.survey.waters.whole_function import gaussian_arguments

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Pixels at a time, for the memory.
_AT_ONCE = 20_000


def texture_change(
    survey: Survey,
    water: WaterProperties,
    scene: Scene,
    hits: Hits,
    texture: Floats,
    *,
    beam: rays.Beam,
    sight: rays.Beam,
    view: View,
    place: Standing,
) -> Complex | None:
    r"""Return the change of the texture by scattered light at each hit [1].

    Light reaches the surface beside the beam, too, and the receiver sees it there. The
    texture :math:`t` of a pixel becomes

    .. math:: t_0 + \sum_j (t_j - t_0) W_j \Big/ \sum_j W_j, \quad
        W_j = E(x_j) V(x_j) e^{i k l_j},

    with the light E of the beam and the sensitivity V of the receiver at the places
    :math:`x_j`, both complex since scattered light is late. :math:`l_j` is the path by
    which the surface is farther than a plane across the beam. Places that the beam
    would not meet on the same target count as the pixel itself. A uniform texture is
    unchanged. Shape (frequency, hit), with 0 Hz first; None without a texture.
    """
    met = np.flatnonzero(hits.target >= 0)
    met = met[has_texture(survey)[hits.target[met]]]
    if not met.size:
        return None
    frequency = np.array([0.0, *survey.instrument.modulation_frequencies])
    change = np.zeros((frequency.size, hits.target.size), dtype=complex)
    arguments = gaussian_arguments(survey, water, view)
    wavenumber = 2 * math.pi * frequency * water.group_index / speed_of_light
    for first in range(0, met.size, _AT_ONCE):
        part = met[first : first + _AT_ONCE]
        pixels = _Pixels(part, hits, texture, beam, sight, place)
        change[:, part] = pixels.change(scene, arguments, wavenumber)
    return change


def has_texture(survey: Survey) -> NDArray[np.bool_]:
    """Return a mask of the targets with a texture."""
    return np.array([bool(getattr(t, "texture", None)) for t in survey.targets], bool)


class _Pixels:
    """Pixels on targets with textures, arrays over the pixels."""

    def __init__(
        self,
        index: NDArray[np.intp],
        hits: Hits,
        texture: Floats,
        beam: rays.Beam,
        sight: rays.Beam,
        place: Standing,
    ) -> None:
        def chosen(values: Floats) -> Floats:
            return values.reshape(-1, 3)[index]

        self.index, self.place = index, place.of(index)
        self.target, self.texture = hits.target[index], texture[index]
        self.surroundings = Surroundings(
            chosen(beam.entry),
            chosen(beam.direction),
            hits.distance[index],
            sight_start=chosen(sight.entry),
            sight=chosen(sight.direction),
        )

    def change(
        self, scene: Scene, arguments: dict[str, Any], wavenumber: Floats
    ) -> Complex:
        """Return the change of the texture, shape (frequency, pixel) [1]."""
        differences = np.zeros((wavenumber.size, self.index.size), dtype=complex)
        total, rings = self.surroundings.weights(arguments, wavenumber)
        for aside, weight in rings:
            bright, farther = self._texture(scene, aside)
            total += weight.sum(axis=1)
            weight = weight * np.exp(2j * wavenumber[:, None, None] * farther)
            differences += np.sum(weight * (bright - self.texture), axis=1)
        nothing = np.zeros_like(total)
        changed: Complex = np.divide(differences, total, out=nothing, where=total != 0)
        return changed

    def _texture(self, scene: Scene, aside: Floats) -> tuple[Floats, Floats]:
        """Return texture and distance beyond the plane [m] at places (place, pixel)."""
        length, way = self.surroundings.ways(aside)
        start = np.broadcast_to(self.place.points(self.surroundings.start), way.shape)
        direction = self.place.directions(way)
        hits = scene.cast(start.reshape(-1, 3), direction.reshape(-1, 3))
        same = hits.target.reshape(length.shape) == self.target
        bright = scene.texture(hits).reshape(length.shape)
        farther = np.where(same, hits.distance.reshape(length.shape) - length, 0.0)
        return np.where(same, bright, self.texture), farther
