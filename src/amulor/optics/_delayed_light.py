"""Transforms of scattered light whose paths are longer than the straight one.

The logarithm of the light at a surface, over spatial frequency and distance, is
expanded in the number of scatterings on one path; `late_echo` has the equations. The
rate is that of the logarithm of the light with its path, i k - a [1/m].
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0, j1

from amulor.optics.phase_functions.integrals import gauss_legendre
from amulor.optics.phase_functions.phase_function import PhaseFunction

Array = NDArray[np.float64]
Phasors = NDArray[np.complex128]

#: Nodes of a panel of angles, and phase over it that they still resolve [rad].
_NODES, _OSCILLATIONS = 16, 20.0
#: Grid points per factor of two, of spatial frequency and distance.
_PER_OCTAVE = 7
#: Least kappa times the depth, and least distance times the largest kappa [1].
_SMALLEST, _NEAREST = 0.05, 2.0
#: Least angle at which the plane of small angles is corrected, widest panel, and the
#: angle to the axis from which light is lost [rad].
_STRAIGHT, _PANEL, _GRAZING = 1e-5, 0.03, 1.5


def gaussian_start(
    rate: complex,
    kappa: Array,
    spread: Array,
    way: Array,
    starts: tuple[Phasors, Phasors],
) -> tuple[Phasors, Phasors]:
    """Return the exponent of a Gaussian spread of directions, and its factor of a tilt.

    `spread` is the 1/e semi-angle. Starts are the terms of `_exponents` that are linear
    and quadratic in the shift of a start.
    """
    square, path = spread[:, None] ** 2, way[:, None]
    turned = 1 - rate * square * path / 2
    slope = rate * square * path * kappa / 2 / turned
    linear, quadratic = starts
    exponent = slope * (linear + slope * quadratic)
    exponent = exponent - square * (path * kappa) ** 2 / 4 / turned - np.log(turned)
    return exponent, linear + 2 * slope * quadratic - slope * path / rate


def at_places(
    phase_function: PhaseFunction,
    split_angle: float,
    rate: complex,
    kappa: Array,
    depth: Array,
    largest: float,
) -> Phasors:
    """Interpolate the exponents of the light to spatial frequencies and depths."""
    from scipy.interpolate import CubicSpline

    shortest, longest = float(np.min(depth)), float(np.max(depth))
    grid = (
        _step(_SMALLEST / longest, up=False),
        _step(largest, up=True),
        _step(min(_NEAREST / largest, shortest / 10), up=False),
        _step(longest, up=True),
    )
    table = exponents(phase_function, split_angle, rate, grid)
    column = np.log2(kappa) * _PER_OCTAVE
    low, high, near, far = grid
    places, which = np.unique(depth, return_inverse=True)
    at_depth = CubicSpline(np.arange(near, far + 1), table, axis=2)(
        np.log2(places) * _PER_OCTAVE
    )
    fields = np.empty((table.shape[0], *kappa.shape), dtype=complex)
    steps = np.arange(low, high + 1)
    for number in range(len(places)):
        here = which == number
        spline = CubicSpline(steps, at_depth[:, :, number], axis=1)
        # Below the lowest frequency nothing changes any more.
        fields[:, here] = spline(np.maximum(column[here], low))
    return fields


def _step(value: float, *, up: bool) -> int:
    """Return the step of the logarithmic grid next to a value, above or below."""
    step = np.log2(value) * _PER_OCTAVE
    return int(np.ceil(step) if up else np.floor(step))


@lru_cache(maxsize=32)
def exponents(
    phase_function: PhaseFunction,
    split_angle: float,
    rate: complex,
    grid: tuple[int, int, int, int],
) -> Phasors:
    """Tabulate exponents of one way, per power of b, over kappa and the distance x.

    Grids are logarithmic, so that kappa x has few values. The fields are: single
    scatterings; pairs (b^2) and triples (b^3) of scatterings on one path; and the
    factors of a start with the shift s x, s (b [3] + b^2 [4]) + s^2 b [5].
    """
    _, _, near, far = grid
    x = 2.0 ** (np.arange(near, far + 1) / _PER_OCTAVE)
    value, slope, curl, bend = _damped(phase_function, split_angle, rate, grid)

    def sum_over(integrand: Phasors) -> Phasors:
        """Integrate over the distance from the surface, from 0."""
        return _integral(x, integrand)

    distance = x[:, None]
    # Shift of the direction's frequency by all scatterings up to the far end z.
    moment, total = sum_over(distance * slope), sum_over(slope)
    shift = moment - distance * total
    straight = sum_over(bend * distance**2)
    bent = sum_over(bend * distance * shift)
    pairs = -rate * sum_over(slope * moment)
    for second in (bend, curl):
        repeated = sum_over(distance**2 * second)
        pairs = pairs + rate**2 / 2 * sum_over(second * repeated)
    triples = sum_over(bend * shift**2) + 2 * total * bent + total**2 * straight
    fields = (
        sum_over(value),
        pairs,
        rate**2 / 2 * triples,
        moment,
        -rate * (bent + total * straight),
        straight / 2,
    )
    return np.asarray(np.swapaxes(fields, 1, 2))


def _integral(x: Array, integrand: Phasors) -> Phasors:
    """Integrate over a logarithmic grid from 0, where the integrand is 0."""
    from scipy.interpolate import CubicSpline

    parts = CubicSpline(np.log(x), integrand * x[:, None], axis=0).antiderivative()
    integral: Phasors = parts(np.log(x)) + integrand[0] * x[0] / 2
    return integral


def _damped(
    phase_function: PhaseFunction,
    split_angle: float,
    rate: complex,
    grid: tuple[int, int, int, int],
) -> tuple[Phasors, Phasors, Phasors, Phasors]:
    """Return transform, slope, slope over frequency, and curvature of delayed light.

    Each over distance and kappa: of the scattering into each angle, with the phase
    and loss of the longer path from there to the surface.
    """
    low, high, near, far = grid
    fraction, _ = phase_function.forward_split(split_angle)
    angle, share, flat, straight, value, gradient = _single(
        phase_function, split_angle, low + near, high + far
    )
    steps = np.arange(near, far + 1)
    excess = 1 / np.cos(angle) - 1
    light = share * np.exp(
        np.multiply.outer(rate * 2.0 ** (steps / _PER_OCTAVE), excess)
    )
    # Rows of the transforms, over distance and kappa: both steps count.
    rows = np.arange(len(steps))[:, None] + np.arange(high - low + 1)
    y = 2.0 ** ((low + near + rows) / _PER_OCTAVE)

    def summed(transform: Array, light: Phasors) -> Phasors:
        """Sum the light of all angles; one product of matrices has all sums needed."""
        every = transform @ light.real.T + 1j * (transform @ light.imag.T)
        return np.asarray(every[rows, np.arange(len(steps))[:, None]])

    first = summed(gradient, angle * light)
    return (
        flat[rows] - fraction + (summed(value, light) - straight[rows]),
        -first,
        -first / y,
        first / y - summed(value, angle**2 * light),
    )


@lru_cache(maxsize=8)
def _single(
    phase_function: PhaseFunction, split_angle: float, low: int, high: int
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return angles with their share of the light, and transforms of single scattering.

    These are the transform of small angles, its part by these angles, and J0 and J1 of
    kappa x times the tangent, over kappa x and angle.
    """
    angle, share, width = _angles(phase_function, split_angle)
    y = 2.0 ** (np.arange(low, high + 1) / _PER_OCTAVE)
    fraction, _ = phase_function.forward_split(split_angle)
    flat = fraction * phase_function.hankel(y, split_angle=split_angle)
    resolved = _resolved(np.outer(y, width))
    straight = (j0(np.outer(y, angle)) * resolved) @ share
    passed = angle < _GRAZING
    angle, share, width = angle[passed], share[passed], width[passed]
    place = np.outer(y, np.tan(angle))
    resolved = _resolved(np.outer(y, width / np.cos(angle) ** 2))
    return angle, share, flat, straight, j0(place) * resolved, j1(place) * resolved


def _resolved(phase: Array) -> Array:
    """Return 1 where a panel has few oscillations, and 0 where they cancel out."""
    return np.asarray(np.exp(-((phase / _OSCILLATIONS) ** 6)))


def _angles(
    phase_function: PhaseFunction, split_angle: float
) -> tuple[Array, Array, Array]:
    """Return scattering angles up to a right angle, shares of light, panel widths.

    The width is that of a panel with `_NODES` nodes as dense as those of the angle.
    """
    top = min(split_angle, np.pi / 2)
    bottom = min(_STRAIGHT, top / 1000)
    inner = phase_function.panels.edges
    inner = inner[(inner > bottom) & (inner < top)]
    edges = np.concatenate([[bottom], inner, [top]])
    pieces = [edges[:1]]
    for low, high in pairwise(edges):
        count = int(np.ceil((high - low) / _PANEL))
        pieces.append(np.linspace(low, high, count + 1)[1:])
    edges = np.concatenate(pieces)
    # Narrow panels, as of tables, are smooth: four nodes have all of their light.
    low, high = edges[:-1], edges[1:]
    narrow = high < 1.02 * low
    angles, shares, widths = [], [], []
    for nodes, chosen in ((4, narrow), (_NODES, ~narrow)):
        node, weight = gauss_legendre(nodes)
        half = (high - low)[chosen, None] / 2
        angle = low[chosen, None] + half * (node + 1)
        share = 2 * np.pi * phase_function.panels.value(angle) * np.sin(angle)
        angles.append(angle.ravel())
        shares.append((share * half * weight).ravel())
        widths.append(np.repeat(2 * half * (_NODES / nodes), nodes))
    return np.concatenate(angles), np.concatenate(shares), np.concatenate(widths)
