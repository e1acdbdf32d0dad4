"""Many columns of one water at once, such as the pixels of a scan, by one table.

What a depth sends depends on the column through nothing but the distance of its beam
and the axis of the receiver there. So the light of each depth is tabulated over that
distance once, and the columns look it up.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from amulor.optics._quadrature.bessel import bessel, monomials
from amulor.optics._quadrature.kernels import ORDER
from amulor.optics._quadrature.rule import RULE
from amulor.optics.small_angle import _kernels, _many_kernels

__all__ = ["FEWEST", "Light", "Shared", "integrals", "light_of"]

Array = NDArray[np.float64]

#: Columns from which on a table is less work than one after the other.
FEWEST = 64
_CELL = 0.5  # width of a cell in ln(1 + q)
_MOST_CELLS = 40
_DEGREE = 10


class Shared(NamedTuple):
    """What all columns have in common."""

    water: _kernels.Water
    """Water and receiver; its baseline and tilts do not count."""
    cells: Array
    """Table of the phase function."""
    rule: Array
    """Nodes and weights of a panel of spatial frequencies."""


class Light(NamedTuple):
    """The scattered light of one water at any depth and distance from the axis."""

    edge: Array
    """Panels of the depth in which it is smooth, shape (panel, 2) [m]."""
    span: Array
    """Start and width of the cells of ln(1 + q) at each node, shape (node, 2)."""
    cells: Array
    """Their polynomials, shape (node, cell, 10)."""


def light_of(view: Array, shared: Shared, panels_of: Callable[[Array], Array]) -> Light:
    """Return the light that columns look up.

    A row of view is baseline, tilt, cross tilt and end of a column; `panels_of` gives
    the edges of panels in which the light of one such row is smooth.
    """
    edge = _common(np.concatenate([panels_of(view[i]) for i in _spread(view)]))
    node, _ = legendre.leggauss(2 * ORDER)
    depth = (edge[:, :1] + np.diff(edge) * (node + 1) / 2).ravel()
    return Light(edge, *_tables(depth, view, shared))


def integrals(
    phase_per_depth: Array, view: Array, shared: Shared, light: Light
) -> NDArray[np.complex128]:
    """Return the integrals of exp(i w z) times the scattered light, column by column.

    A column is the same whatever others come with it.
    """
    edge, span, cells = light
    size = 2 * ORDER
    node, weight = legendre.leggauss(size)
    order = np.argsort(phase_per_depth)
    sums = np.zeros((len(view), 2, phase_per_depth.size))
    degree = np.arange(size)
    series = (degree + 0.5) * legendre.legvander(node, size - 1) * weight[:, None]
    _many_kernels.add_columns(
        np.ascontiguousarray(view),
        edge,
        span,
        cells,
        shared.water,
        phase_per_depth[order],
        (RULE, node, np.ascontiguousarray(series)),
        sums,
    )
    result = np.empty((len(view), phase_per_depth.size), dtype=complex)
    result[:, order] = sums[:, 0] + 1j * sums[:, 1]
    return result


def _spread(view: Array) -> NDArray[np.intp]:
    """Return columns that stand for all: the extremes, and some between."""
    extremes = np.concatenate([view.argmin(axis=0), view.argmax(axis=0)])
    even = np.linspace(0, len(view) - 1, 3).astype(np.intp)
    return np.unique(np.concatenate([extremes, even]))


def _common(edges: Array) -> Array:
    """Return panels none of which reaches over an edge of another, rising."""
    each = np.unique(edges)
    # Edges that are the same but for rounding, and slivers between two columns.
    keep = np.append(True, np.diff(each) > 1e-6 * each[1:])
    each = each[keep]
    return np.stack([each[:-1], each[1:]], axis=1)


def _tables(depth: Array, view: Array, shared: Shared) -> tuple[Array, Array]:
    """Return the span of ln(1 + q) at each depth, and polynomials in cells of it."""
    water = shared.water
    path = depth[:, None] + water.standoff
    area = water.radius_squared + water.angle_squared * path**2
    low, high = np.full(depth.size, np.inf), np.full(depth.size, -np.inf)
    # Not all columns at once, for the memory.
    for first in range(0, len(view), 512):
        baseline, tilt, cross, _ = view[first : first + 512].T
        apart = (baseline - tilt * path) ** 2 + (cross * path) ** 2
        found = np.log1p(apart / area)
        low = np.minimum(low, found.min(axis=1))
        high = np.maximum(high, found.max(axis=1))
    count = int(np.clip(np.ceil(np.max(high - low) / _CELL), 1, _MOST_CELLS))
    width = np.maximum((high - low) / count, 1e-9)
    node = np.cos(np.pi * (np.arange(_DEGREE) + 0.5) / _DEGREE)
    place = np.arange(count)[:, None] + (node + 1) / 2
    apart = low[:, None, None] + width[:, None, None] * place
    offset = np.sqrt(np.maximum(np.expm1(apart), 0.0) * area[:, :, None])
    # Depth, baseline, tilts and standoff of receivers that look straight ahead.
    look = np.zeros((offset.size, 5))
    look[:, 0] = np.broadcast_to(depth[:, None, None], offset.shape).ravel()
    look[:, 1] = offset.ravel()
    look[:, 4] = water.standoff
    out = np.empty(len(look))
    _kernels.scattered(
        look,
        water,
        shared.cells,
        bessel(),
        shared.rule,
        out,
    )
    values = out.reshape(-1, _DEGREE)
    cells = monomials(values).reshape(depth.size, count, _DEGREE)
    return np.stack([low, width], axis=1), cells
