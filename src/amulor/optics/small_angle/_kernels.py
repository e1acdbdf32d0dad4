"""Compiled loops of the small-angle model with any phase function."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from amulor.optics._quadrature.kernels import ORDER, add_panel

__all__ = ["add_panels", "j0", "lost", "polynomial", "scattered", "spread"]

Array = NDArray[np.float64]

NEAR = 26  # argument up to which J0 comes from its table, in unit cells
FAR = 400  # argument up to which the mean of J0 comes from its table, in unit cells
LINEAR = 48  # cells of equal width at the start of a table of spread
WIDTH = 2.0  # their width, times the split angle
PER_OCTAVE = 4  # cells of the rest of it, per doubling

_GAUSSIAN_END = 10.0  # in 1/e half-widths: exp(-25) is left beyond
_SCATTERED_END = 25.0  # exponent by which scattering ends the integral
_PHASE = 28.0  # turn of the oscillations over a panel [rad]
_SMOOTH = 5.0  # width of a panel in 1/e half-widths of the receiver
_SPLIT_END = 100.0  # phase up to which the edge of the forward part is followed [rad]

# A row of water holds, in this order: 2 k' [1/m], 2 b_f [1/m], aperture squared
# [m^2] and acceptance squared [1] of receiver and beam together, baseline [m], tilt,
# cross tilt [rad], standoff [m], split angle [rad].


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
    if x < NEAR:
        cell = int(x)
        return polynomial(table, cell, 2.0 * (x - cell) - 1.0)
    y = 1.0 / (x * x)
    p = 1.0 - y * (9 / 128 - y * (3675 / 32768 - y * (2401245 / 4194304)))
    q = 1 / 8 - y * (75 / 1024 - y * (59535 / 262144 - y * (57972915 / 33554432)))
    turn = x - 0.25 * math.pi
    wave = p * math.cos(turn) + q / x * math.sin(turn)
    return math.sqrt(2.0 / (math.pi * x)) * wave


@numba.njit(cache=True, error_model="numpy")
def spread(x: Array, angle: Array, weight: Array, table: Array, out: Array) -> None:
    """Fill out with sums of weight * angle^2 * (1 - mean of J0 to x angle) / x^2."""
    for i in range(x.size):
        total = 0.0
        for j in range(angle.size):
            y = x[i] * angle[j]
            if y < FAR:
                cell = int(y)
                value = polynomial(table, cell, 2.0 * (y - cell) - 1.0)
            else:
                value = (1.0 - 1.0 / y) / (y * y)
            total += weight[j] * angle[j] * angle[j] * value
        out[i] = total


@numba.njit(cache=True, error_model="numpy")
def lost(x: float, split: float, table: Array) -> float:
    """Return 1 less the mean of the transform of the phase function up to x."""
    t = x * split / WIDTH
    if t < LINEAR:
        cell = int(t)
        return x * x * polynomial(table, cell, 2.0 * (t - cell) - 1.0)
    t = PER_OCTAVE * math.log2(t / LINEAR)
    cell = int(t)
    if cell < table.shape[0] - LINEAR:
        return x * x * polynomial(table, LINEAR + cell, 2.0 * (t - cell) - 1.0)
    last = (WIDTH / split) * LINEAR * 2.0 ** ((table.shape[0] - LINEAR) / PER_OCTAVE)
    end = last * last * polynomial(table, table.shape[0] - 1, 1.0)
    beyond: float = 1.0 - (1.0 - end) * last / x
    return beyond


@numba.njit(cache=True, error_model="numpy")
def _scattering_end(depth: float, top: float, row: Array, table: Array) -> float:
    """Return the wavenumber at which scattering has ended the integral, or top."""
    thickness = row[1] * depth
    if thickness > _SCATTERED_END:
        while thickness * lost(0.8 * top * depth, row[8], table) > _SCATTERED_END:
            top *= 0.8
    return top


@numba.njit(cache=True, error_model="numpy")
def _offset(depth: float, row: Array) -> float:
    """Return the distance between beam and receiver axis."""
    path = depth + row[7]
    return math.hypot(row[4] - row[5] * path, row[6] * path)


@numba.njit(cache=True, error_model="numpy")
def scattered(
    depth: Array, row: Array, table: Array, bessel: Array, rule: Array, out: Array
) -> None:
    """Fill out with F(z) / pi R^2 gamma^2 of light scattered forward."""
    nodes = rule.shape[1]
    work = np.empty((3, nodes))
    for n in range(depth.size):
        z = depth[n]
        path = z + row[7]
        area = row[2] + row[3] * path * path
        offset = _offset(z, row)
        thickness = row[1] * z
        none = math.exp(-thickness)
        top = _scattering_end(z, _GAUSSIAN_END / math.sqrt(area), row, table)
        reach = z * row[8]
        first = min(top / 3.0, 6.0 / reach)
        widest = min(_SMOOTH / math.sqrt(area), top / 2.0)
        total = 0.0
        low = 0.0
        while low < top:
            turn = offset
            if low * reach < _SPLIT_END:
                turn += reach
            width = min(max(first, low), widest, _PHASE / turn)
            if low + 1.2 * width > top:
                width = top - low
            for i in range(nodes):
                kappa = low + width * rule[0, i]
                work[0, i] = -0.25 * area * kappa * kappa
                work[1, i] = -thickness * lost(kappa * z, row[8], table)
                work[2, i] = kappa * j0(kappa * offset, bessel)
            part = 0.0
            for i in range(nodes):
                value = math.exp(work[0, i]) * (math.exp(work[1, i]) - none)
                part += rule[1, i] * work[2, i] * value
            total += width * part
            low += width
        out[n] = 0.5 * total * math.exp(-row[0] * z)


@numba.njit(cache=True, error_model="numpy")
def add_panels(
    edge: Array, value: Array, wavenumber: Array, rule: Array, sums: Array
) -> None:
    """Add the integrals of exp(i w z) times the values of panels, for rising w.

    A row of value holds a panel at its Gauss-Legendre nodes, rising.
    """
    even = np.empty(ORDER)
    odd = np.empty(ORDER)
    work = np.empty((2, ORDER))
    turn = np.empty((2, wavenumber.size))
    for j in range(value.shape[0]):
        half = 0.5 * (edge[j, 1] - edge[j, 0])
        centre = edge[j, 0] + half
        for i in range(ORDER):
            right, left = value[j, ORDER + i], value[j, ORDER - 1 - i]
            even[i], odd[i] = right + left, right - left
        add_panel(half, centre, even, odd, wavenumber, rule, work, turn, sums)
