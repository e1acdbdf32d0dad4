"""Texture of a mesh as a beam and a receiver see it through scattering water."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.optics import rays
from amulor.optics._spot import Spot
from amulor.simulation.scene import Hits, Scene
from amulor.survey import Survey, WaterProperties
from amulor.survey.view import View, has_sharp_receiver
from amulor.survey.waters.whole_function import whole_function_arguments

if TYPE_CHECKING:
    from amulor.simulation.geometry import Standing

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Rings around the beam: smallest and largest radius over the depth [1], and number.
_INNER, _OUTER, _RINGS = 2e-3, 1.0, 20
#: Places on each ring, and turn of a ring against the one before, a part of the golden
#: angle, so that no edge follows places of many rings [rad].
_PLACES, _TURN = 16, math.pi * (3 - math.sqrt(5)) / 16
#: Radii at which the view of the receiver is tabulated.
_RADII = 96
#: Logarithm of the ratio of depths that share a cross-section [1].
_DEPTH = 0.02
#: Wavenumber of the modulation in place of zero [rad/m].
_SLOW = 1e-4
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
    textures = [getattr(target, "texture", None) for target in survey.targets]
    has_texture = np.array([bool(texture) for texture in textures], dtype=bool)
    met = np.flatnonzero(hits.target >= 0)
    met = met[has_texture[hits.target[met]]]
    if not met.size:
        return None
    frequency = np.array([0.0, *survey.instrument.modulation_frequencies])
    change = np.zeros((frequency.size, hits.target.size), dtype=complex)
    arguments = whole_function_arguments(survey, water, view)
    if has_sharp_receiver(survey):
        # Gaussians with the mean square radius and angle of sharp edges.
        for name in ("receiver_radius", "acceptance_angle"):
            arguments[name] = arguments[name] / math.sqrt(2)
    wavenumber = 2 * math.pi * frequency * water.group_index / speed_of_light
    for first in range(0, met.size, _AT_ONCE):
        part = met[first : first + _AT_ONCE]
        pixels = _Pixels(part, hits, texture, beam, sight, place)
        change[:, part] = pixels.change(scene, arguments, wavenumber)
    return change


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
        self.depth = hits.distance[index]
        self.start, self.ahead = chosen(beam.entry), chosen(beam.direction)
        self.sight = chosen(sight.direction)
        # Two directions across the beam.
        other = np.eye(3)[np.argmin(np.abs(self.ahead), axis=1)]
        first = np.cross(self.ahead, other)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        self.across = np.stack([first, np.cross(self.ahead, first)])
        # Where the receiver's axis meets the plane across the beam, from the beam.
        way = self.start + self.depth[:, None] * self.ahead - chosen(sight.entry)
        along = np.sum(way * self.ahead, axis=1) / np.sum(self.sight * self.ahead, 1)
        self.axis = along[:, None] * self.sight - way

    def change(
        self, scene: Scene, arguments: dict[str, Any], wavenumber: Floats
    ) -> Complex:
        """Return the change of the texture, shape (frequency, pixel) [1]."""
        light = [_Light(self, arguments, k) for k in wavenumber]
        differences = np.zeros((wavenumber.size, self.index.size), dtype=complex)
        total = np.array([each.middle() for each in light])
        angle = 2 * math.pi * np.arange(_PLACES) / _PLACES
        for ring, radius in enumerate(_radii()):
            turn = (angle + _TURN * ring)[:, None, None]
            aside = np.cos(turn) * self.across[0] + np.sin(turn) * self.across[1]
            aside = radius * self.depth[:, None] * aside
            bright, farther = self._texture(scene, aside)
            for number, (each, k) in enumerate(zip(light, wavenumber, strict=True)):
                weight = each.ring(ring, aside)
                total[number] += weight.sum(axis=0)
                weight = weight * np.exp(2j * k * farther)
                differences[number] += np.sum(weight * (bright - self.texture), axis=0)
        nothing = np.zeros_like(total)
        changed: Complex = np.divide(differences, total, out=nothing, where=total != 0)
        return changed

    def _texture(self, scene: Scene, aside: Floats) -> tuple[Floats, Floats]:
        """Return texture and distance beyond the plane [m] at places (place, pixel)."""
        way = self.depth[:, None] * self.ahead + aside
        length = np.linalg.norm(way, axis=-1)
        start = np.broadcast_to(self.place.points(self.start), way.shape)
        direction = self.place.directions(way / length[..., None])
        hits = scene.cast(start.reshape(-1, 3), direction.reshape(-1, 3))
        same = hits.target.reshape(length.shape) == self.target
        bright = scene.texture(hits).reshape(length.shape)
        farther = np.where(same, hits.distance.reshape(length.shape) - length, 0.0)
        return np.where(same, bright, self.texture), farther


class _Light:
    """Light of the beam and view of the receiver at one frequency."""

    def __init__(
        self, pixels: _Pixels, arguments: dict[str, Any], wavenumber: float
    ) -> None:
        self.pixels = pixels
        step = np.round(np.log(pixels.depth) / _DEPTH)
        steps, self.group = np.unique(step, return_inverse=True)
        depth = np.exp(steps * _DEPTH)
        common = {
            name: arguments[name]
            for name in ("phase_function", "split_angle", "scattering")
        }
        beam = Spot(
            **common,
            depth=depth,
            way=depth,
            radius=arguments.get("beam_radius", 0.0),
            semi_angle=arguments.get("beam_divergence", 0.0),
        )
        view = replace(
            beam,
            way=depth + np.mean(arguments["standoff"]),
            radius=arguments["receiver_radius"],
            semi_angle=arguments["acceptance_angle"],
        )
        self.rate = 1j * max(wavenumber, _SLOW) - arguments["absorption"]
        self._tabulate_beam(beam)
        self._tabulate_view(view)

    def _tabulate_beam(self, beam: Spot) -> None:
        """Tabulate the power of each ring, and within the first, by group."""
        rate = self.rate
        radius = _radii() * beam.depth[:, None]
        half = math.log(_OUTER / _INNER) / (_RINGS - 1) / 2
        light: Complex = np.zeros(radius.shape, dtype=complex)
        if beam.scattering > 0:
            light = beam.scattered(radius, rate)
        self.rings: Complex = np.asarray(
            light * 2 * np.pi * radius**2 * math.sinh(2 * half)
        )
        inner = radius[:, 0] * math.exp(-half)
        # Scattered light falls with the distance near the axis.
        self.inner: Complex = np.asarray(2 * np.pi * radius[:, 0] * inner * light[:, 0])
        power, square = beam.unscattered(rate)
        if not np.any(square):
            self.inner = self.inner + power
            return
        edge = np.concatenate([inner[:, None], radius * math.exp(half)], axis=1)
        outside = np.exp(-(edge**2) / square[:, None]) * power[:, None]
        self.inner = self.inner + power - outside[:, 0]
        self.rings = self.rings - np.diff(outside, axis=1)

    def _tabulate_view(self, view: Spot) -> None:
        """Tabulate the sensitivity over the distance from the receiver's axis."""
        far = 2.5 * _OUTER * view.way + np.linalg.norm(self.pixels.axis, axis=1).max()
        self.scale = far
        distance = far[:, None] * (np.arange(_RADII) / (_RADII - 1)) ** 2
        power, square = view.unscattered(self.rate)
        self.view = np.exp(-(distance**2) / square[:, None])
        self.view *= (power / square / np.pi)[:, None]
        if view.scattering > 0:
            self.view = self.view + view.scattered(distance, self.rate)

    def middle(self) -> Complex:
        """Return the weight of the pixel itself."""
        aside = np.zeros((1, *self.pixels.start.shape))
        return np.asarray(self.inner[self.group] * self._sensitivity(aside)[0])

    def ring(self, ring: int, aside: Floats) -> Complex:
        """Return the weight of places on a ring, shape (place, pixel)."""
        power = self.rings[self.group, ring] / _PLACES
        return np.asarray(power * self._sensitivity(aside))

    def _sensitivity(self, aside: Floats) -> Complex:
        """Return the sensitivity at places, with the path along the receiver's axis."""
        off = aside - self.pixels.axis
        along = np.sum(off * self.pixels.sight, axis=-1)
        distance = np.sqrt(np.maximum(np.sum(off**2, axis=-1) - along**2, 0.0))
        place = np.sqrt(distance / self.scale[self.group]) * (_RADII - 1)
        low = np.minimum(place.astype(int), _RADII - 2)
        share = place - low
        near, far = self.view[self.group, low], self.view[self.group, low + 1]
        value = (1 - share) * near + share * far
        return np.asarray(value * np.exp(self.rate * along))


def _radii() -> Floats:
    """Return the radii of the rings over the depth [1]."""
    return np.geomspace(_INNER, _OUTER, _RINGS)
