"""Compiled Hankel transform of a phase function over narrow intervals of angle.

Compiled, as tables of a phase function have thousands of panels, and each is met at
each of thousands of direction frequencies.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba
from amulor.optics._quadrature import j0

__all__ = ["NODES", "SLOW", "narrow_panels"]

Array = NDArray[np.float64]

NODES = 7  # of a narrow panel
SLOW = 1.5  # phase over half a panel [rad] below which the plain rule serves


@numba.njit(cache=True, error_model="numpy")
def narrow_panels(
    frequency: Array,
    angle: Array,
    fraction: Array,
    bessel: Array,
    legendre: Array,
    out: Array,
) -> None:
    """Add the Hankel transform over narrow angle intervals to `out`, per frequency.

    A row of angle holds the nodes of a panel no wider than a tenth of where it starts,
    bessel the table of J0, row l of legendre (2 l + 1) times the Legendre polynomial at
    the nodes from -1 to 1.
    """
    reach = legendre[1, NODES - 1] / 3.0  # of the last node, in half panels
    terms = np.empty(NODES)
    for p in range(angle.shape[0]):
        half = 0.5 * (angle[p, NODES - 1] - angle[p, 0]) / reach
        for i in range(frequency.size):
            k = frequency[i]
            if k * half < SLOW:
                for n in range(NODES):
                    out[i] += fraction[p, n] * j0(k * angle[p, n], bessel)
            else:
                _spherical_bessel(k * half, terms)
                out[i] += _fast_panel(k, angle[p], fraction[p], terms, legendre)


@numba.njit(cache=True, error_model="numpy")
def _spherical_bessel(x: float, out: Array) -> None:
    """Fill `out` with the spherical Bessel functions j_l(x), for l = 0, 1, 2, ...

    Upwards: rounding grows to 1e-11 for l = 6 at `SLOW`, a term that is small itself.
    """
    out[0] = math.sin(x) / x
    out[1] = (out[0] - math.cos(x)) / x
    for i in range(1, out.size - 1):
        out[i + 1] = (2 * i + 1) / x * out[i] - out[i - 1]


@numba.njit(cache=True, error_model="numpy")
def _fast_panel(
    k: float, angle: Array, fraction: Array, terms: Array, legendre: Array
) -> float:
    """Return the Hankel transform over an angle interval, for fast oscillations of J0.

    J0 is the real part of Hankel's function, by his expansion, as k angle is above 28;
    its slow factor becomes a Legendre series, and i^l P_l transforms into j_l.
    """
    real, imaginary = 0.0, 0.0
    for degree in range(NODES):
        a, b = 0.0, 0.0
        for n in range(NODES):
            x = k * angle[n]
            y = 1.0 / (x * x)
            size = fraction[n] / math.sqrt(x) * legendre[degree, n]
            a += size * (1.0 - y * (9 / 128 - y * (3675 / 32768)))
            b += size / x * (y * (75 / 1024 - y * (59535 / 262144)) - 1 / 8)
        a *= terms[degree]
        b *= terms[degree]
        turns = degree % 4  # a + i b times i to the degree
        if turns == 0:
            real, imaginary = real + a, imaginary + b
        elif turns == 1:
            real, imaginary = real - b, imaginary + a
        elif turns == 2:
            real, imaginary = real - a, imaginary - b
        else:
            real, imaginary = real + b, imaginary - a
    turn = 0.5 * k * (angle[0] + angle[NODES - 1]) - 0.25 * math.pi
    wave = real * math.cos(turn) - imaginary * math.sin(turn)
    return math.sqrt(2.0 / math.pi) * wave
