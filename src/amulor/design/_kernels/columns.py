"""Compiled integral of the water in front of many distances, many frequencies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba

__all__ = ["Nodes", "fill_columns"]

Array = NDArray[np.float64]


class Nodes(NamedTuple):
    """Depths at which the light of a column is summed up."""

    segment: NDArray[np.intp]
    """Piece of the spline that each one lies in, shape (node,)."""
    within: Array
    """Place in that piece, in logarithms of the depth, shape (node,)."""
    weight: Array
    """Width that each one stands for, shape (node,) [m]."""
    turn: NDArray[np.complex128]
    """Phase factor, shape (node, frequency) [1]."""
    stop: NDArray[np.intp]
    """Number of nodes in front of each distance, increasing, shape (distance,)."""


@numba.njit(cache=True, error_model="numpy")
def fill_columns(
    piece: Array,
    nodes: Nodes,
    mean: Array,
    water: NDArray[np.complex128],
) -> None:
    """Fill the light of columns up to each distance, and to the end as the last one.

    `piece` is that of the logarithm of the overlap, (4, segment, look); `mean` has the
    shape (look, distance + 1), `water` (look, distance + 1, frequency).
    """
    count = nodes.stop.size
    sums = np.zeros(water.shape[2], dtype=np.complex128)
    for look in range(water.shape[0]):
        sums[:] = 0.0
        total = 0.0
        reached = 0
        for m in range(nodes.segment.size + 1):
            while reached < count and nodes.stop[reached] <= m:
                mean[look, reached] = total
                water[look, reached] = sums
                reached += 1
            if m == nodes.segment.size:
                break
            i, x = nodes.segment[m], nodes.within[m]
            value = piece[0, i, look] * x + piece[1, i, look]
            value = (value * x + piece[2, i, look]) * x + piece[3, i, look]
            light = nodes.weight[m] * np.exp(value)
            total += light
            for k in range(sums.size):
                sums[k] += light * nodes.turn[m, k]
        mean[look, count] = total
        water[look, count] = sums
