"""Water response in small-angle form by plain quadrature, to check the fast one.

Nothing is shared with the package but the formula, eqs. (26) and (29) of Ricci et al.
2010, as rebuilt and conjugated. The light that was not scattered stays in the
integrand, the depth is cut into equal steps much shorter than a wavelength of the
modulation, and the transform of the phase function is summed over angles for a fine
even grid of wavenumbers and integrated by Simpson's rule. Only the aperture and
acceptance of the receiver limit the integral over the wavenumber.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from scipy.constants import speed_of_light
from scipy.interpolate import CubicHermiteSpline
from scipy.special import j0

STEP = 0.04  # of the table of the transform, times the split angle


def gauss(edges, count):
    """Return nodes and weights of a Gauss rule in each panel, as flat arrays."""
    node, weight = np.polynomial.legendre.leggauss(count)
    half = np.diff(edges)[:, None] / 2
    return (edges[:-1, None] + half * (node + 1)).ravel(), (half * weight).ravel()


def transform(phase_function, split_angle, wavenumber):
    """Return the forward fraction and the renormalised transform of the forward part.

    The phase function must be smooth but for its peak at 0.
    """
    highest = float(np.max(wavenumber))
    even = np.linspace(0, split_angle, 4 + int(highest * split_angle / 12))
    edges = np.unique(np.append(even, np.geomspace(1e-7, split_angle, 40)[:-1]))
    theta, weight = gauss(edges, 14)
    weight = weight * 2 * np.pi * np.sin(theta) * phase_function(theta)
    fraction = weight.sum()
    chunks = np.array_split(wavenumber, 1 + wavenumber.size * theta.size // 4_000_000)
    sums = [j0(np.multiply.outer(chunk, theta)) @ weight for chunk in chunks]
    return fraction, np.concatenate(sums) / fraction


def integrated_transform(phase_function, split_angle, highest):
    """Return the forward fraction and P(x), the integral of the transform to x."""
    step = STEP / split_angle
    count = math.ceil(highest / step) + 2
    fraction, value = transform(
        phase_function, split_angle, np.arange(2 * count + 1) * (step / 2)
    )
    simpson = step / 6 * (value[:-2:2] + 4 * value[1:-1:2] + value[2::2])
    grid = np.arange(count + 1) * step
    total = np.append(0.0, np.cumsum(simpson))
    return fraction, CubicHermiteSpline(grid, total, value[::2])


def _soft(kappa, path, radius, angle):
    """Return the transform of a Gaussian receiver."""
    return np.exp(-(radius**2 + (angle * path) ** 2) * kappa**2 / 4)


def overlap(depth, integrated, *, fraction, **column):
    """Return F(z) over pi R^2 gamma^2 for depths of about the same size."""
    radius = math.hypot(column["receiver_radius"], column.get("beam_radius", 0.0))
    angle = math.hypot(column["acceptance_angle"], column.get("beam_divergence", 0.0))
    z = np.asarray(depth)[:, None]
    path = z + column.get("standoff", 0.0)
    along = column["baseline"] - column.get("tilt", 0.0) * path
    offset = np.hypot(along, column.get("cross_tilt", 0.0) * path)
    narrow = math.sqrt(radius**2 + (angle * path.min()) ** 2)
    highest = 11.5 / narrow
    turn = highest * (offset.max() + z.max())
    count = 12 + int(turn / 4)
    node, weight = gauss(np.linspace(0, 1, count + 1), 12)
    kappa, weight = highest * node**2, highest * 2 * node * weight
    forward = column["scattering"] * fraction
    loss = 2 * (column["absorption"] + column["scattering"])
    mean = integrated(kappa * z) / kappa
    window = _soft(kappa, path, radius, angle)
    value = window * np.exp(2 * forward * mean - loss * z)
    return 0.5 * (kappa * j0(kappa * offset) * value) @ weight


def water_response(frequencies, *, phase_function, split_angle, end=math.inf, **column):
    """Return the response for one column and backscatter_vsf 1."""
    radius, angle = column["receiver_radius"], column["acceptance_angle"]
    fraction, integrated = integrated_transform(phase_function, split_angle, 12 / angle)
    reduced = column["absorption"] + column["scattering"] * (1 - fraction)
    stop = min(end, 11 / reduced)
    fine = np.geomspace(2e-3, stop, 5 + int(7 * math.log2(stop / 2e-3)))
    coarse = np.arange(0, stop, 0.4)
    edges = np.unique(np.concatenate([[0.0], fine, coarse, [stop]]))
    wavenumber = 4 * np.pi * np.asarray(frequencies) * column["group_index"]
    result = np.zeros(len(wavenumber), dtype=complex)
    for low, high in pairwise(edges):
        z, weight = gauss(np.array([low, high]), 12)
        value = weight * overlap(z, integrated, fraction=fraction, **column)
        result += np.exp(1j * np.multiply.outer(wavenumber / speed_of_light, z)) @ value
    return math.pi * (radius * angle) ** 2 * result
