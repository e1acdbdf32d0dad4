"""Phase matrices of the whole Stokes vector, for the oracle plane_parallel.

Frames. The axes of a direction are those of its meridian plane: parallel is
d(direction) / d(polar angle to +z), perpendicular is d(direction) / d(azimuth), and
parallel x perpendicular is the direction, as in `amulor.optics.polarization.stokes`; +z
points into the water. For light along +z at azimuth 0 parallel is x and perpendicular
y. A Mueller matrix leads from axes to axes that both have parallel in the scattering
plane and a common perpendicular, as in `amulor.optics.polarization.mueller`.

The phase matrix is made by turning the axes of the two directions themselves, on an
even grid of azimuths, with no series and no symmetry put in; its Fourier modes are sums
over the grid. These are exact for Rayleigh scatterers with five azimuths or more, and
as good as the matrix is smooth for others.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

Array = NDArray[Any]


class MuellerScatterers:
    """Scatterers of a Mueller matrix of the scattering angle, mean of m11 being 1."""

    components = 4

    def __init__(self, mueller: Callable[[Array], Array], *, azimuths: int) -> None:
        self.mueller = mueller
        self.azimuths = azimuths

    def modes(self, out: Array, into: Array, count: int) -> Array:
        if 2 * count > self.azimuths:
            raise ValueError(
                f"{count} modes need {2 * count} azimuths or more, got {self.azimuths}"
            )
        phi = 2 * np.pi * np.arange(self.azimuths) / self.azimuths
        matrix = phase_matrix(
            self.mueller, out[:, None], into, azimuth=phi[:, None, None]
        )
        wave = np.exp(-1j * np.outer(np.arange(count), phi)) / self.azimuths
        total = np.tensordot(wave, matrix, 1).transpose(0, 1, 3, 2, 4)
        return total.reshape(count, 4 * out.size, 4 * into.size)


def rayleigh() -> MuellerScatterers:
    """Return Rayleigh scatterers without molecular depolarization."""
    return MuellerScatterers(rayleigh_matrix, azimuths=8)


def rayleigh_matrix(angle: ArrayLike) -> Array:
    """Return the Rayleigh matrix, eqs. (63) and (64) of Ricci et al. 2010, as rebuilt.

    R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
    doi:10.1155/2010/958360; here m11 is 1 on average over all directions.
    """
    cosine = np.cos(np.asarray(angle, dtype=float))
    even, odd = 0.75 * (1 + cosine**2), -0.75 * (1 - cosine**2)
    return sphere_matrix(even, odd, 1.5 * cosine, 0 * cosine)


def sphere_matrix(m11: Array, m12: Array, m33: Array, m34: Array) -> Array:
    """Return matrices of the form that spheres have."""
    zero = np.zeros_like(m11)
    rows = [
        [m11, m12, zero, zero],
        [m12, m11, zero, zero],
        [zero, zero, m33, m34],
        [zero, zero, -m34, m33],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def tabulated(
    angle: ArrayLike, mueller: ArrayLike, *, azimuths: int
) -> MuellerScatterers:
    """Return scatterers of matrices on rising angles from 0 to pi, by cubic splines.

    The first element is scaled to 1 on average over all directions.
    """
    nodes = np.asarray(angle, dtype=float)
    spline = CubicSpline(nodes, np.asarray(mueller, dtype=float))
    cosine, weight = np.polynomial.legendre.leggauss(max(256, 4 * nodes.size))
    mean = weight @ spline(np.arccos(cosine))[:, 0, 0] / 2
    return MuellerScatterers(lambda theta: spline(theta) / mean, azimuths=azimuths)


def phase_matrix(
    mueller: Callable[[Array], Array], out: Array, into: Array, *, azimuth: Array
) -> Array:
    """Return the matrix from meridian frame to meridian frame, broadcast shape (4, 4).

    `out` and `into` are cosines to +z, `azimuth` is that of out less that of in.
    """
    out, into, azimuth = np.broadcast_arrays(out, into, azimuth)
    ahead_in, *axes_in = meridian_axes(into, np.zeros_like(azimuth))
    ahead_out, *axes_out = meridian_axes(out, azimuth)
    normal = np.cross(ahead_in, ahead_out)
    sine = np.linalg.norm(normal, axis=-1)
    straight = sine < 1e-12  # forward or back: any plane is a scattering plane
    normal = np.where(straight[..., None], axes_in[1], normal)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    angle = np.arctan2(sine, np.sum(ahead_in * ahead_out, axis=-1))
    turn_in = _turn(np.cross(normal, ahead_in), axes_in)
    turn_out = _turn(np.cross(normal, ahead_out), axes_out)
    return np.swapaxes(turn_out, -1, -2) @ mueller(angle) @ turn_in


def meridian_axes(cosine: Array, azimuth: Array) -> tuple[Array, Array, Array]:
    """Return direction, parallel and perpendicular axis, last axis x, y, z."""
    sine = np.sqrt(1 - cosine**2)
    east, north = np.cos(azimuth), np.sin(azimuth)
    zero = np.zeros_like(cosine)
    return (
        np.stack([sine * east, sine * north, cosine], axis=-1),
        np.stack([cosine * east, cosine * north, -sine], axis=-1),
        np.stack([-north, east, zero], axis=-1),
    )


def _turn(parallel: Array, axes: list[Array]) -> Array:
    """Return what refers Stokes vectors of the axes to a new parallel axis."""
    along = np.sum(parallel * axes[0], axis=-1)
    across = np.sum(parallel * axes[1], axis=-1)
    double_cosine, double_sine = along**2 - across**2, 2 * along * across
    turn = np.zeros((*along.shape, 4, 4))
    turn[..., 0, 0] = turn[..., 3, 3] = 1
    turn[..., 1, 1] = turn[..., 2, 2] = double_cosine
    turn[..., 1, 2] = double_sine
    turn[..., 2, 1] = -double_sine
    return turn
