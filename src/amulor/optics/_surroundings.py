"""Light of a beam, and sensitivity of a receiver, on the surface beside the beam."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.optics._spot import Spot

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


class Surroundings:
    """Places beside beams, arrays over the beams; positions have the shape (n, 3)."""

    def __init__(
        self,
        start: Floats,
        ahead: Floats,
        depth: Floats,
        *,
        sight_start: Floats,
        sight: Floats,
    ) -> None:
        self.start, self.ahead, self.depth = start, ahead, depth
        self.sight = sight
        # Two directions across the beam.
        other = np.eye(3)[np.argmin(np.abs(self.ahead), axis=1)]
        first = np.cross(self.ahead, other)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        self.across = np.stack([first, np.cross(self.ahead, first)])
        # Where the receiver's axis meets the plane across the beam, from the beam.
        way = self.start + self.depth[:, None] * self.ahead - sight_start
        along = np.sum(way * self.ahead, axis=1) / np.sum(self.sight * self.ahead, 1)
        self.axis = along[:, None] * self.sight - way

    def weights(
        self, arguments: dict[str, Any], wavenumber: Floats
    ) -> tuple[Complex, Iterator[tuple[Floats, Complex]]]:
        """Return weights of light and view at the beams and beside them.

        The former have the shape (frequency, beam). Each ring has places as vectors
        from the beam, shape (place, beam, 3), and their weights, (frequency, place,
        beam).
        """
        light = [_Light(self, arguments, k) for k in wavenumber]
        return np.array([each.middle() for each in light]), self._rings(light)

    def ways(self, aside: Floats) -> tuple[Floats, Floats]:
        """Return lengths [m] and directions of the ways to places beside the beam."""
        way = self.depth[:, None] * self.ahead + aside
        length = np.linalg.norm(way, axis=-1)
        return length, way / length[..., None]

    def _rings(self, light: list[_Light]) -> Iterator[tuple[Floats, Complex]]:
        angle = 2 * math.pi * np.arange(_PLACES) / _PLACES
        for ring, radius in enumerate(_radii()):
            turn = (angle + _TURN * ring)[:, None, None]
            aside = np.cos(turn) * self.across[0] + np.sin(turn) * self.across[1]
            aside = radius * self.depth[:, None] * aside
            yield aside, np.array([each.ring(ring, aside) for each in light])


class _Light:
    """Light of the beam and view of the receiver at one frequency."""

    def __init__(
        self, pixels: Surroundings, arguments: dict[str, Any], wavenumber: float
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
