"""Compiled loop over many columns of one water that share a table of their light."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba
from amulor.optics._quadrature.bessel import polynomial
from amulor.optics._quadrature.kernels import ORDER, Panel, add_panel
from amulor.optics.small_angle._kernels import Water

__all__ = ["add_columns", "separation"]

Array = NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def separation(z: float, view: Array, water: Water) -> float:
    """Return ln(1 + q), q the squared distance of beam and axis over that they blur.

    A view is baseline, tilt and cross tilt.
    """
    path = z + water.standoff
    area = water.radius_squared + water.angle_squared * path * path
    along, across = view[0] - view[1] * path, view[2] * path
    return math.log1p((along * along + across * across) / area)


@numba.njit(cache=True, error_model="numpy")
def _shortened(value: Array, part: float, rules: tuple[Array, Array, Array]) -> None:
    """Replace the values of a panel by those of the first part of it."""
    _, node, series = rules
    size = node.size
    term = np.zeros(size)
    for i in range(size):
        for m in range(size):
            term[m] += value[i] * series[i, m]
    for i in range(size):
        x = part * (node[i] + 1.0) - 1.0
        before, now = 1.0, x
        total = term[0] + term[1] * x
        for m in range(2, size):
            before, now = now, ((2 * m - 1) * x * now - (m - 1) * before) / m
            total += term[m] * now
        value[i] = total


@numba.njit(cache=True, error_model="numpy")
def add_columns(
    view: Array,
    edge: Array,
    span: Array,
    cells: Array,
    water: Water,
    phases: Array,
    rules: tuple[Array, Array, Array],
    sums: Array,
) -> None:
    """Add the integrals of exp(i w z) F(z) over columns to sums, for rising w.

    A row of view is baseline, tilt, cross tilt and end of a column; edge has the
    panels, rising; span the start and the width of the cells of each node of them in
    ln(1 + q), and cells their polynomials, shape (node, cell, 10). Compiled, as each
    column of a scan looks up all of its nodes and ends where its target stands.
    """
    rule, node, _ = rules
    size = node.size
    value = np.empty(size)
    even, odd = np.empty(ORDER), np.empty(ORDER)
    work, turn = np.empty((2, ORDER)), np.empty((2, phases.size))
    for n in range(view.shape[0]):
        end = view[n, 3]
        for j in range(edge.shape[0]):
            low, high = edge[j, 0], edge[j, 1]
            if low >= end:
                break
            half = 0.5 * (high - low)
            for i in range(size):
                k = j * size + i
                z = low + half * (node[i] + 1.0)
                t = (separation(z, view[n], water) - span[k, 0]) / span[k, 1]
                cell = min(max(int(t), 0), cells.shape[1] - 1)
                value[i] = polynomial(cells[k], cell, 2.0 * (t - cell) - 1.0)
            if end < high:
                _shortened(value, (end - low) / (high - low), rules)
                half = 0.5 * (end - low)
            for i in range(ORDER):
                right, behind = value[ORDER + i], value[ORDER - 1 - i]
                even[i], odd[i] = right + behind, right - behind
            panel = Panel(half, low + half, even, odd)
            add_panel(panel, phases, rule, work, turn, sums[n])
