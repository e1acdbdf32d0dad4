"""Filon quadrature of f(z) exp(i w z) over depth z, and the Bessel function J0.

The function f is the integrand without its oscillation, w the phase per depth [rad/m].
A panel is a depth interval with quadrature nodes.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev, legendre
from numpy.typing import NDArray
from scipy import special
from scipy.special import jv

from amulor._compiled import numba

__all__ = [
    "NO_WAVE",
    "ORDER",
    "RULE",
    "SPLIT",
    "Panel",
    "add_panel",
    "bessel",
    "bessel_nodes",
    "expand",
    "j0",
    "monomials",
    "polynomial",
    "sine_cosine",
]


Array = NDArray[np.float64]

ORDER = 16  # even, and as many odd, polynomials in a panel of 2 * ORDER nodes
SPLIT = 8.0  # phase over half a panel [rad] from which spherical Bessel functions serve

_FAR = 1e7  # phase [rad] beyond which whole turns are taken off first

# Pi in pieces; the leading ones are so short that their products with the whole
# numbers met here (below 2^23) are exact.
_PI_1 = float.fromhex("0x1.921fb54p+1")
_PI_2 = float.fromhex("0x1.10b46118p-29")
_PI_3 = float.fromhex("0x1.313198a2e037p-60")
_SINE = tuple((-1.0) ** i / math.factorial(2 * i + 1) for i in range(11))
_COSINE = tuple((-1.0) ** i / math.factorial(2 * i) for i in range(12))


class Panel(NamedTuple):
    """Depth interval with even and odd parts of the integrand at quadrature nodes."""

    half: float
    """Half width [m]."""
    centre: float
    """Depth of the center [m]."""
    even: Array
    """Sums of the values at equal distances from the center."""
    odd: Array
    """Differences of the values at equal distances, deeper minus shallower."""


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def sine_cosine(x: float) -> tuple[float, float]:
    """Return sine and cosine for abs(x) < 2e7, computed without branches."""
    turns = np.floor(x * (1 / math.pi) + 0.5)
    r = ((x - turns * _PI_1) - turns * _PI_2) - turns * _PI_3
    sign = 1.0 - 2.0 * (turns - 2.0 * np.floor(0.5 * turns))
    y = r * r
    y2 = y * y
    y4 = y2 * y2
    s = _SINE
    c = _COSINE
    sine = (s[1] + y * s[2] + y2 * (s[3] + y * s[4])) + y4 * (
        (s[5] + y * s[6] + y2 * (s[7] + y * s[8])) + y4 * (s[9] + y * s[10])
    )
    cosine = (c[1] + y * c[2] + y2 * (c[3] + y * c[4])) + y4 * (
        (c[5] + y * c[6] + y2 * (c[7] + y * c[8]))
        + y4 * (c[9] + y * c[10] + y2 * c[11])
    )
    return sign * (r + r * y * sine), sign * (1.0 + y * cosine)


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def expand(values: Array, table: Array, out: Array) -> None:
    """Fill `out` with the product of a vector of node values and a matrix."""
    for m in range(ORDER):
        out[m] = 0.0
    for i in range(ORDER):
        for m in range(ORDER):
            out[m] += values[i] * table[i, m]


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _add_slow(
    half: float,
    phase_per_depth: Array,
    even: Array,
    odd: Array,
    turn: Array,
    real: Array,
    imaginary: Array,
) -> None:
    """Add a panel's integrals of f(z) exp(i w z) for small w, by Chebyshev series."""
    for f in range(phase_per_depth.size):
        u = phase_per_depth[f] * (half / SPLIT)
        t = 4.0 * u * u - 2.0
        e1 = e2 = o1 = o2 = 0.0
        for m in range(ORDER):
            e0 = even[ORDER - 1 - m] - e2 + t * e1
            o0 = odd[ORDER - 1 - m] - o2 + t * o1
            e2, e1, o2, o1 = e1, e0, o1, o0
        in_step = half * (e1 - 0.5 * t * e2)
        across = half * u * (o1 - o2)
        sine, cosine = sine_cosine(turn[f])
        real[f] += in_step * cosine - across * sine
        imaginary[f] += in_step * sine + across * cosine


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _add_fast(
    half: float,
    phase_per_depth: Array,
    even: Array,
    odd: Array,
    turn: Array,
    half_turn: Array,
    real: Array,
    imaginary: Array,
) -> None:
    """Add a panel's integrals of f(z) exp(i w z) for large w, by Bessel functions."""
    for f in range(phase_per_depth.size):
        sine, cosine = sine_cosine(half_turn[f])
        v = 1.0 / (phase_per_depth[f] * half)
        p = sine * v
        q = (p - cosine) * v
        in_step = across = 0.0
        for m in range(ORDER):
            in_step += even[m] * p
            across += odd[m] * q
            p = (4.0 * m + 3.0) * v * q - p
            q = (4.0 * m + 5.0) * v * p - q
        sine, cosine = sine_cosine(turn[f])
        real[f] += half * (in_step * cosine - across * sine)
        imaginary[f] += half * (in_step * sine + across * cosine)


@numba.njit(cache=True, error_model="numpy")
def _turns(phase_per_depth: Array, distance: float, out: Array) -> None:
    """Fill `out` with phases over a distance, modulo 2 pi if any is large [rad]."""
    for f in range(phase_per_depth.size):
        out[f] = phase_per_depth[f] * distance
    if phase_per_depth.size > 0 and out[phase_per_depth.size - 1] > _FAR:
        for f in range(phase_per_depth.size):
            out[f] = out[f] % (2.0 * math.pi)


@numba.njit(cache=True, error_model="numpy")
def add_panel(
    panel: Panel,
    phase_per_depth: Array,
    rule: Array,
    work: Array,
    turn: Array,
    sums: Array,
) -> None:
    """Add a panel's integrals of f(z) exp(i w z) to `sums`, for rising w.

    Two rows of work and of turn are overwritten. Below SPLIT of phase over half a panel
    exp(i w z) is a Chebyshev series (Jacobi-Anger), above it the moments of the
    Legendre polynomials are spherical Bessel functions.
    """
    half, even, odd = panel.half, panel.even, panel.odd
    size = phase_per_depth.size
    slow = 0
    while slow < size and phase_per_depth[slow] * half < SPLIT:
        slow += 1
    _turns(phase_per_depth, panel.centre, turn[0])
    if slow < size:
        expand(even, rule[0], work[0])
        expand(odd, rule[1], work[1])
        _turns(phase_per_depth[slow:], half, turn[1, slow:])
        _add_fast(
            half,
            phase_per_depth[slow:],
            work[0],
            work[1],
            turn[0, slow:],
            turn[1, slow:],
            sums[0, slow:],
            sums[1, slow:],
        )
    if slow > 0:
        expand(even, rule[2], work[0])
        expand(odd, rule[3], work[1])
        _add_slow(
            half,
            phase_per_depth[:slow],
            work[0],
            work[1],
            turn[0],
            sums[0],
            sums[1],
        )


NO_WAVE = 26  # argument up to which J0 comes from its table, in unit cells


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def polynomial(table: Array, cell: int, s: float) -> float:
    """Evaluate a table cell's polynomial of degree 9, at s from -1 to 1."""
    j = np.uint64(cell)
    t = s * s
    even = table[j, 6] + t * table[j, 8]
    even = table[j, 0] + t * (table[j, 2] + t * (table[j, 4] + t * even))
    odd = table[j, 7] + t * table[j, 9]
    odd = table[j, 1] + t * (table[j, 3] + t * (table[j, 5] + t * odd))
    return float(even + s * odd)


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def j0(x: float, table: Array) -> float:
    """Return the Bessel function J0 for x >= 0, from a table below x = 26."""
    if x < NO_WAVE:
        cell = int(x)
        return polynomial(table, cell, 2.0 * (x - cell) - 1.0)
    y = 1.0 / (x * x)
    p = 1.0 - y * (9 / 128 - y * (3675 / 32768 - y * (2401245 / 4194304)))
    q = 1 / 8 - y * (75 / 1024 - y * (59535 / 262144 - y * (57972915 / 33554432)))
    turn = x - 0.25 * math.pi
    wave = p * math.cos(turn) + q / x * math.sin(turn)
    return math.sqrt(2.0 / (math.pi * x)) * wave


def monomials(values: Array) -> Array:
    """Convert values at Chebyshev nodes to power-series coefficients, cell by cell."""
    size = values.shape[1]
    node = np.cos(np.pi * (np.arange(size) + 0.5) / size)
    order = np.arange(size)
    series = chebyshev.chebvander(node, size - 1) * (np.where(order, 2, 1) / size)
    to_powers = np.zeros((size, size))
    for i in order:
        power = chebyshev.cheb2poly(np.eye(size)[i, : i + 1])
        to_powers[i, : power.size] = power
    return np.ascontiguousarray(values @ series @ to_powers)


@cache
def bessel() -> Array:
    """Return polynomials for the Bessel function J0, in cells of width 1."""
    return monomials(special.j0(bessel_nodes()))


def bessel_nodes() -> Array:
    """Return the Chebyshev nodes of each cell of the Bessel-function tables, by row."""
    node = np.cos(np.pi * (np.arange(10) + 0.5) / 10)
    return np.arange(NO_WAVE)[:, None] + (node + 1) / 2


def _rule() -> NDArray[np.float64]:
    """Return matrices from node values to series coefficients, and the nodes.

    [0] and [1] give the factors of the spherical Bessel functions of even and odd
    order in the moment of exp(i k s), [2] and [3] those of the Chebyshev
    polynomials in k / SPLIT (Jacobi-Anger series), from the sums and differences
    of the values right and left of the centre. [4] holds the right and the left
    nodes, and the factors that continue the even and odd part to the end.
    """
    half = ORDER
    node, weight = (part[half:] for part in legendre.leggauss(2 * half))
    order = np.arange(2 * half)
    sign = (-1.0) ** np.arange(half)
    series = (2 * order + 1) * legendre.legvander(node, 2 * half - 1) * weight[:, None]
    anger = 2 * jv(order, SPLIT * node[:, None]) * weight[:, None]
    anger[:, 0] /= 2
    rule = np.zeros((5, half, half))
    rule[0], rule[1] = series[:, ::2] * sign, series[:, 1::2] * sign
    rule[2], rule[3] = anger[:, ::2] * sign, anger[:, 1::2] * sign
    rule[4, :2] = node, -node
    rule[4, 2:4] = series[:, ::2].sum(axis=1) / 2, series[:, 1::2].sum(axis=1) / 2
    return rule


RULE = _rule()
