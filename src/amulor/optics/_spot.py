r"""Density of light around the axis of a Gaussian beam in scattering water.

The light of a beam at a distance r from its axis is the Hankel transform of eq. (20) of
Ricci et al. 2010, EURASIP J. Adv. Signal Process. 2010, 958360, with the paths of
`amulor.optics.late_echo`. By reciprocity, the sensitivity of a receiver is the light of
a beam that starts with the radius of its aperture and the semi-angle of its view.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0

from amulor.optics._delayed_light import at_places, gaussian_start
from amulor.optics.phase_functions.integrals import gauss_legendre
from amulor.optics.phase_functions.phase_function import PhaseFunction

Array = NDArray[np.float64]
Phasors = NDArray[np.complex128]

#: Distance from the axis over which the light is averaged, over that distance [1].
_SMOOTH = 0.1
#: Exponent at which a Gaussian ends [1], and nodes of an integral up to there.
_END, _NODES = 36.0, 128


@dataclass(frozen=True, kw_only=True)
class Spot:
    """Cross-sections of a Gaussian beam in water, one for each depth, shape (n,).

    Light counts by the factor exp(rate l) of the excess l of its path over the axis,
    and relative to light that is neither absorbed nor scattered backwards.
    """

    phase_function: PhaseFunction
    """Phase function of the water."""
    split_angle: float
    """Angle between the forward and the diffuse part [rad]."""
    scattering: float
    """Scattering coefficient [1/m]."""
    depth: Array
    """Path in the water [m]."""
    way: Array
    """Path, with that before the water as a depth of water [m]."""
    radius: float
    """1/e radius of the intensity at the start [m]."""
    semi_angle: float
    """1/e semi-angle of the directions at the start [rad]."""

    def unscattered(self, rate: complex) -> tuple[Phasors, Phasors]:
        """Return power [1] and squared 1/e radius [m^2] of the unscattered light."""
        fraction, _ = self.phase_function.forward_split(self.split_angle)
        turned = 1 - rate * self.semi_angle**2 * self.way / 2
        square = self.radius**2 + (self.semi_angle * self.way) ** 2 / turned
        power = np.exp(-self.scattering * fraction * self.depth) / turned
        return np.asarray(power, dtype=complex), np.asarray(square, dtype=complex)

    def scattered(self, distance: Array, rate: complex) -> Phasors:
        """Return the scattered light at distances from the axis [1/m^2].

        Distances and result have the shape (n, m).
        """
        power, square = self.unscattered(rate)
        width = np.hypot(self.radius, self.semi_angle * self.way)[:, None]
        end = 2 * _END**0.5 / np.maximum(_SMOOTH * distance, width)
        node, weight = gauss_legendre(_NODES)
        kappa = end[..., None] * (node + 1) / 2
        count = distance.shape[1]
        flat = kappa.reshape(-1, _NODES)
        fields = at_places(
            self.phase_function,
            self.split_angle,
            rate,
            flat,
            np.repeat(self.depth, count),
            float(end.max()),
        ).reshape(-1, *kappa.shape)
        b = self.scattering
        starts = (b * fields[3] + b**2 * fields[4], b * fields[5])
        start, _ = gaussian_start(
            rate,
            flat,
            np.full(len(flat), self.semi_angle),
            np.repeat(self.way, count),
            tuple(part.reshape(flat.shape) for part in starts),
        )
        exponent = b * fields[0] + b**2 * fields[1] + b**3 * fields[2]
        exponent += start.reshape(kappa.shape) - (self.radius * kappa) ** 2 / 4
        light = np.exp(exponent)
        light -= power[:, None, None] * np.exp(-square[:, None, None] * kappa**2 / 4)
        wave = j0(kappa * distance[..., None])
        wave *= np.exp(-((_SMOOTH * kappa * distance[..., None]) ** 2) / 4)
        total = np.sum(weight * kappa * wave * light, axis=-1) * end / 2
        return np.asarray(total / (2 * np.pi))
