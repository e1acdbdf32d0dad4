"""Polynomials in cells, and the Bessel function of order 0 from a table of them.

Compiled, as integrals over a spatial frequency look them up at each node.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy import special

from amulor._compiled import numba

__all__ = ["NO_WAVE", "bessel", "bessel_nodes", "j0", "monomials", "polynomial"]

Array = NDArray[np.float64]

NO_WAVE = 26  # argument up to which J0 comes from its table, in unit cells


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def polynomial(table: Array, cell: int, s: float) -> float:
    """Return the polynomial of degree 9 of a cell at s from -1 to 1."""
    j = np.uint64(cell)
    t = s * s
    even = table[j, 6] + t * table[j, 8]
    even = table[j, 0] + t * (table[j, 2] + t * (table[j, 4] + t * even))
    odd = table[j, 7] + t * table[j, 9]
    odd = table[j, 1] + t * (table[j, 3] + t * (table[j, 5] + t * odd))
    return float(even + s * odd)


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def j0(x: float, table: Array) -> float:
    """Return the Bessel function of order 0 at x >= 0."""
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
    """Return polynomials on -1..1 through values at Chebyshev nodes, in cells."""
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
    """Return the table of J0 in cells of width 1."""
    return monomials(special.j0(bessel_nodes()))


def bessel_nodes() -> Array:
    """Return the Chebyshev nodes of the cells of the tables of Bessel functions."""
    node = np.cos(np.pi * (np.arange(10) + 0.5) / 10)
    return np.arange(NO_WAVE)[:, None] + (node + 1) / 2
