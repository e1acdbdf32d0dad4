"""Intersection of rays with triangle meshes, for photons and simulated scenes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulor.transport._kernels import mesh as _kernels
from amulor.transport._kernels.mesh import EDGE_ONE, EDGE_TWO, NORMAL
from amulor.transport._kernels.types import Mesh

__all__ = ["RayCaster", "hierarchy"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Padding of boxes, and least distance of a hit to a ray that starts on a triangle,
#: over the largest coordinate: far above rounding (1e-16), far below relevant lengths.
RELATIVE_GAP = 1e-9


class RayCaster:
    """Triangle mesh with two-sided triangles, prepared for ray intersection.

    Examples
    --------
    >>> corners = np.array([[[0, 0, 1], [1, 0, 1], [0, 1, 1]]], dtype=float)
    >>> caster = RayCaster(corners)
    >>> start = np.array([[0.2, 0.2, 0.0], [0.2, 0.2, 2.0]])
    >>> caster.first(start, np.array([[0.0, 0.0, 1.0]] * 2)).tolist()
    [0, -1]
    """

    def __init__(self, corners: Array) -> None:
        self._mesh, self._number = hierarchy(np.asarray(corners, dtype=float))
        self._place = np.argsort(self._number)

    @property
    def gap(self) -> float:
        """Least hit distance of a ray that starts on a triangle [m]."""
        return self._mesh.least

    def first(self, start: Array, direction: Array) -> Integers:
        """Return the index of the first triangle on each ray; -1 for none."""
        met = np.full(len(start), -1, dtype=np.int64)
        _kernels.first_triangles(
            np.ascontiguousarray(start, dtype=float),
            np.ascontiguousarray(direction, dtype=float),
            self._mesh,
            met,
        )
        hit = met >= 0
        met[hit] = self._number[met[hit]]
        return met

    def free(self, start: Array, end: Array, triangle: Integers) -> NDArray[np.bool_]:
        """Return whether lines between pairs of points meet no triangle."""
        free = np.empty(len(start), dtype=np.bool_)
        _kernels.free_ways(
            np.ascontiguousarray(start, dtype=float),
            np.ascontiguousarray(end, dtype=float),
            self._place[triangle],
            self._mesh,
            free,
        )
        return free


def hierarchy(corner: Array) -> tuple[Mesh, Integers]:
    """Build the box hierarchy of a triangle mesh; return it and the triangle order.

    A box is split at the median of the triangles' centres along the axis on which
    those spread the most.
    """
    if len(corner) == 0:
        none = np.empty((0, 6)), np.empty((0, 3), np.int64), np.empty((0, 12))
        return Mesh(*none, np.empty(0), 0.0), np.empty(0, dtype=np.int64)
    low, high = corner.min(axis=1), corner.max(axis=1)
    centre = 0.5 * (low + high)
    least = RELATIVE_GAP * float(np.abs(corner).max())
    number = np.arange(len(corner))
    # Boxes without boxes hold two triangles at least, so there are fewer than this.
    link = np.empty((len(corner) + 1, 3), dtype=np.int64)
    sibling = np.empty(len(corner) + 1, dtype=np.int64)
    count = _kernels.split(centre, number, link, sibling)
    box, link = np.empty((count, 6)), link[:count].copy()
    _kernels.enclose(low[number], high[number], least, link, sibling, box)
    sorted_corner = corner[number]
    triangle = np.empty((len(corner), 12))
    first_edge = sorted_corner[:, 1] - sorted_corner[:, 0]
    second_edge = sorted_corner[:, 2] - sorted_corner[:, 0]
    normal = np.cross(first_edge, second_edge)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    triangle[:, :EDGE_ONE] = sorted_corner[:, 0]
    triangle[:, EDGE_ONE:EDGE_TWO] = first_edge
    triangle[:, EDGE_TWO:NORMAL] = second_edge
    triangle[:, NORMAL:] = np.divide(
        normal, length, out=np.zeros_like(normal), where=length > 0
    )
    return Mesh(box, link, triangle, np.ones(len(corner)), least), number
