"""Chebyshev series of complex functions over a box, summed in a compiled loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from amulor._compiled import numba

__all__ = ["BoxSeries"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Coefficients are omitted, the smallest first, while their sum is below this fraction
#: of the largest coefficient [1].
_LEFT_OUT = 1e-9
#: Number of points per loop block: their sums stay in the nearest cache.
_TOGETHER = 64


class BoxSeries:
    """Chebyshev interpolation of several complex functions over a box.

    A value does not depend on the places that are asked for with it. A smooth function
    has few coefficients that count: of a product of 17, 17 and 65 polynomials mostly
    less than a tenth.
    """

    def __init__(self, low: Floats, high: Floats, nodes: Sequence[int]) -> None:
        self._low, self._high = low, high
        self._centre = (low + high) / 2
        self._half = np.where(high > low, (high - low) / 2, 1.0)
        self._count = [
            n if extent > 0 else 1 for n, extent in zip(nodes, high - low, strict=True)
        ]
        self._axes = [np.cos(np.pi * (np.arange(n) + 0.5) / n) for n in self._count]
        self.size = int(np.prod(self._count))
        """Number of nodes."""
        self._orders = np.zeros((0, 3), dtype=np.int64)
        self._terms = np.zeros((0, 0))

    def places(self) -> Floats:
        """Return the interpolation nodes within the box, shape (dimension, node)."""
        mesh = np.stack(np.meshgrid(*self._axes, indexing="ij"))
        mesh = mesh.reshape(len(self._axes), -1)
        nodes = self._centre[:, None] + self._half[:, None] * mesh
        # Rounding must not move a point out of the box.
        inside: Floats = np.clip(nodes, self._low[:, None], self._high[:, None])
        return inside

    def fill(self, values: Complex) -> None:
        """Compute the Chebyshev coefficients from function values at the nodes."""
        table = values.reshape(-1, *self._count)
        for axis, node in enumerate(self._axes, start=1):
            inverse = np.linalg.inv(chebyshev.chebvander(node, len(node) - 1))
            table = np.moveaxis(np.tensordot(table, inverse, (axis, 1)), -1, axis)
        coefficients = table.reshape(len(values), -1)
        height = np.abs(coefficients).max(axis=0)
        rising = np.argsort(height, kind="stable")
        small = np.cumsum(height[rising]) <= _LEFT_OUT * height.max()
        order = np.sort(rising[~small])
        orders = np.zeros((len(order), 3), dtype=np.int64)
        orders[:, : len(self._count)] = np.stack(
            np.unravel_index(order, self._count), axis=1
        )
        chosen = coefficients[:, order].T
        self._orders = orders
        self._terms = np.ascontiguousarray(np.hstack([chosen.real, chosen.imag]))

    def at(self, places: Floats) -> Complex:
        """Return the functions interpolated at points of the box, (function, point)."""
        scaled = np.zeros((3, places.shape[1]))
        scaled[: len(places)] = (places - self._centre[:, None]) / self._half[:, None]
        sums = np.empty((self._terms.shape[1] // 2, places.shape[1]), dtype=complex)
        _sum_up(scaled, self._orders, self._terms, sums)
        return sums


@numba.njit(cache=True, nogil=True)
def _sum_up(scaled: Any, orders: Any, terms: Any, out: Any) -> None:
    """Compute sums of Chebyshev polynomial products into `out`, (function, point).

    Compiled because products of matrices, which numpy has for this, cannot leave out
    what is zero, and make threads of their own.
    """
    count, functions = scaled.shape[1], terms.shape[1]
    highest = 2
    for t in range(orders.shape[0]):
        for axis in range(3):
            highest = max(highest, orders[t, axis] + 1)
    power = np.empty((3, highest, _TOGETHER))
    total = np.empty((functions, _TOGETHER))
    product = np.empty(_TOGETHER)
    place = np.zeros((3, _TOGETHER))
    for begin in range(0, count, _TOGETHER):
        size = min(_TOGETHER, count - begin)
        for axis in range(3):
            for p in range(size):
                place[axis, p] = scaled[axis, begin + p]
            for p in range(_TOGETHER):
                power[axis, 0, p] = 1.0
                power[axis, 1, p] = place[axis, p]
            for order in range(2, highest):
                for p in range(_TOGETHER):
                    power[axis, order, p] = (
                        2 * place[axis, p] * power[axis, order - 1, p]
                        - power[axis, order - 2, p]
                    )
        total[:] = 0.0
        for t in range(orders.shape[0]):
            first, second, third = orders[t, 0], orders[t, 1], orders[t, 2]
            for p in range(_TOGETHER):
                product[p] = power[0, first, p] * power[1, second, p]
                product[p] *= power[2, third, p]
            for f in range(functions):
                term = terms[t, f]
                for p in range(_TOGETHER):
                    total[f, p] += term * product[p]
        for f in range(functions // 2):
            for p in range(size):
                out[f, begin + p] = total[f, p] + 1j * total[functions // 2 + f, p]
