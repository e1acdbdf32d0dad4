"""Compiled loops that integrate exp(i w z) times a polynomial over a panel.

w is the phase that the modulation gains with the depth, 2 omega n_g / c, as in eq. (46)
of docs/theory/water-signal.md. Compiled, as a sweep adds each panel to each frequency,
and the sums over the terms of a series depend on each other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba

__all__ = ["ORDER", "SPLIT", "Panel", "add_panel", "expand", "sine_cosine"]

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
    """A piece of the depth, and what is integrated at its nodes."""

    half: float
    """Half its width [m]."""
    centre: float
    """Depth of its middle [m]."""
    even: Array
    """Sums of the values at the same distance right and left of the centre."""
    odd: Array
    """Their differences, right less left."""


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def sine_cosine(x: float) -> tuple[float, float]:
    """Return sine and cosine of abs(x) < 2e7, in a form that compiles to vectors."""
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
    """Fill out with the product of values and table."""
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
    """Add a panel for phase_per_depths that turn less than SPLIT over half of it."""
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
    """Add a panel for phase_per_depths that turn more than SPLIT over half of it."""
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
    """Fill out with phases over a distance, less whole turns if they are many."""
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
    """Add the integrals of exp(i w z) times a panel to sums, for rising w.

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
