"""Where the beams of a scan run, as few numbers as keep its points in their place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.imaging.geometry import beams_of

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]

#: A point may lie this far from where its own beam would put it [m].
TOLERANCE = 2e-6
#: Values of a node: place at range zero (3), direction (3), azimuth, elevation.
VALUES = 8
_FIRST_STEP = 64
_CHECKED = 30_000


class BeamReader(Protocol):
    """Beams of some rows and columns of a scan."""

    def __call__(self, rows: Numbers, columns: Numbers, /) -> Floats:
        """Return an array over (row, column, value)."""


@dataclass(frozen=True)
class Nodes:
    """Beams at the nodes of a coarse grid; those between follow by interpolation."""

    rows: Numbers
    """Rows of the nodes, the first and the last row among them [1]."""
    columns: Numbers
    """Columns of the nodes [1]."""
    values: NDArray[np.float32]
    """Place where the slant range is zero [m], direction [1], azimuth and elevation
    [rad]; shape (node rows, node columns, 8)."""


def reader_of(image: xr.Dataset) -> BeamReader:
    """Return what reads the beams of a range image in memory.

    Parameters
    ----------
    image : xarray.Dataset
        With azimuth, elevation and geometry.

    Returns
    -------
    callable
        Takes rows and columns, returns an array of shape (row, column, 8).
    """

    def read(rows: Numbers, columns: Numbers) -> Floats:
        part = image.isel(row=rows, column=columns)
        return values_of(part)

    return read


def values_of(part: xr.Dataset) -> Floats:
    """Return the beams of a range image.

    Parameters
    ----------
    part : xarray.Dataset
        With azimuth, elevation and geometry.

    Returns
    -------
    ndarray, shape (row, column, 8)
        Place where the slant range is zero [m], direction [1], angles [rad].
    """
    beam = beams_of(part)
    base = beam.entry - beam.length_before[..., None] * beam.direction
    angles = np.stack([part["azimuth"].values, part["elevation"].values], axis=-1)
    return np.concatenate([base, beam.direction, angles], axis=-1)


def nodes_of(
    read: BeamReader, shape: tuple[int, int], *, farthest: float, stride: int = 1
) -> Nodes:
    """Choose the coarsest grid of beams that keeps every point within a tolerance.

    Parameters
    ----------
    read : callable
        Reads beams, see `reader_of`.
    shape : tuple of int
        Rows and columns of the scan.
    farthest : float
        Largest slant range that is drawn [m].
    stride : int
        Only every so many rows and columns are drawn.

    Returns
    -------
    Nodes
        Points that are interpolated in it lie within `TOLERANCE` of their own beam,
        unless the grid is as fine as the scan.
    """
    step = _FIRST_STEP
    while step > stride:
        nodes = _grid(read, shape, step)
        if _error(read, shape, nodes, farthest) <= TOLERANCE:
            return nodes
        step //= 2
    return _grid(read, shape, max(stride, 1))


def interpolated(nodes: Nodes, rows: Numbers, columns: Numbers) -> Floats:
    """Return beams between nodes, as the page works them out.

    Parameters
    ----------
    nodes : Nodes
        The coarse grid.
    rows, columns : ndarray of int
        Pixels.

    Returns
    -------
    ndarray, shape (row, column, 8)
        Place, direction and angles of each.
    """
    up, low = _between(nodes.rows, rows), _between(nodes.columns, columns)
    values = nodes.values.astype(float)
    top = values[up[0]][:, low[0]], values[up[0]][:, low[1]]
    bottom = values[up[1]][:, low[0]], values[up[1]][:, low[1]]
    across, along = low[2][None, :, None], up[2][:, None, None]
    first = top[0] * (1 - across) + top[1] * across
    second = bottom[0] * (1 - across) + bottom[1] * across
    result: Floats = first * (1 - along) + second * along
    return result


def _between(nodes: Numbers, at: Numbers) -> tuple[Numbers, Numbers, Floats]:
    """Return the node before, the node after, and the share of the second."""
    before = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 1)
    after = np.minimum(before + 1, len(nodes) - 1)
    width = np.maximum(nodes[after] - nodes[before], 1)
    return before, after, (at - nodes[before]) / width


def _grid(read: BeamReader, shape: tuple[int, int], step: int) -> Nodes:
    rows, columns = (_places(size, step) for size in shape)
    return Nodes(rows, columns, read(rows, columns).astype(np.float32))


def _places(size: int, step: int) -> Numbers:
    return np.unique(np.append(np.arange(0, size, step), size - 1))


def _error(
    read: BeamReader, shape: tuple[int, int], nodes: Nodes, farthest: float
) -> float:
    """Return the largest shift of a point, at the nearest and the farthest range."""
    rows, columns = (np.arange(size) for size in shape)
    thin = max(1, int(np.ceil(np.sqrt(rows.size * columns.size / _CHECKED))))
    rows, columns = rows[::thin], columns[::thin]
    shift = interpolated(nodes, rows, columns) - read(rows, columns)
    far = shift[..., :3] + farthest * shift[..., 3:6]
    return float(max(np.abs(far).max(), np.abs(shift[..., :3]).max()))
