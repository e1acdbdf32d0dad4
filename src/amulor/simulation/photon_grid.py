"""A function of beam and depth, known at a few places with errors, everywhere else."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Axis", "Grid", "grid_of"]

Complex = NDArray[np.complex128]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Axis:
    """Nodes along one quantity."""

    nodes: Floats

    def weights(self, value: Floats) -> Floats:
        """Return the Lagrange polynomials of the nodes at values, shape (n, nodes)."""
        apart = self.nodes[:, None] - self.nodes
        out = np.ones((value.size, self.nodes.size))
        for i, j in itertools.permutations(range(self.nodes.size), 2):
            out[:, i] *= (value - self.nodes[j]) / apart[i, j]
        return out


@dataclass(frozen=True)
class Grid:
    """All combinations of the nodes of some axes."""

    axes: tuple[Axis, ...]

    @property
    def places(self) -> Floats:
        """The combinations, shape (places, axes)."""
        each = np.meshgrid(*(axis.nodes for axis in self.axes), indexing="ij")
        return np.stack([values.ravel() for values in each], axis=1)

    def weights(self, where: Floats) -> Floats:
        """Return how the places make up others.

        Parameters
        ----------
        where : ndarray, shape (n, axes)
            Places between the nodes.

        Returns
        -------
        ndarray, shape (n, places)
            Products of Lagrange polynomials [1].
        """
        out = np.ones((len(where), 1))
        for axis, values in zip(self.axes, where.T, strict=True):
            part = axis.weights(np.ascontiguousarray(values))
            out = (out[:, :, None] * part[:, None, :]).reshape(len(where), -1)
        return out

    def between(self, count: int) -> Floats:
        """Return places far from the nodes, for a check, shape (count, axes)."""
        places = []
        for number in range(count):
            place = []
            for position, axis in enumerate(self.axes):
                if axis.nodes.size == 1:
                    place.append(axis.nodes[0])
                    continue
                # Half way between two nodes, other ones for each axis and number.
                left = (number + position) % (axis.nodes.size - 1)
                place.append((axis.nodes[left] + axis.nodes[left + 1]) / 2)
            places.append(place)
        return np.array(places)


def grid_of(values: Floats, *, least: Floats, most: NDArray[np.intp]) -> Grid:
    """Return a grid that spans given places.

    Parameters
    ----------
    values : ndarray, shape (n, axes)
        Places.
    least : ndarray, shape (axes,)
        Range of an axis up to which one node stands for it; for each further node its
        range is about three times as wide.
    most : ndarray, shape (axes,)
        Most nodes of an axis.

    Returns
    -------
    Grid
        Chebyshev-Lobatto nodes, the ends of each range among them.
    """
    axes = []
    for low, high, small, limit in zip(
        values.min(axis=0), values.max(axis=0), least, most, strict=True
    ):
        span = high - low
        if span <= small:
            axes.append(Axis(np.array([(low + high) / 2])))
            continue
        count = int(np.clip(1 + np.ceil(np.log(span / small) / np.log(3)), 2, limit))
        turn = np.cos(np.pi * np.arange(count) / (count - 1))
        axes.append(Axis((low + high) / 2 - span / 2 * turn))
    return Grid(tuple(axes))
