"""Which directions of a motion surfaces hold, and which they do not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Directions count as held if what holds them stands out of noise so many times [1].
_HELD = 6.0


def mean_lever(lever: Floats, weight: Floats) -> float:
    """Return how far points stand from a place, as a root mean square.

    Parameters
    ----------
    lever : ndarray, shape (n, 3)
        Points less the place [m].
    weight : ndarray, shape (n,)
        Of the points.

    Returns
    -------
    float
        Distance [m].
    """
    return float(np.sqrt(np.average((lever**2).sum(axis=1), weights=weight + 1e-300)))


def held_directions(
    matrix: Floats, *, unsure: float, length: float
) -> tuple[Floats, tuple[Floats, ...]]:
    """Return a projection on what surfaces hold, and the directions they do not.

    Parameters
    ----------
    matrix : ndarray, shape (6, 6)
        Sum of the products of derivatives by shift and turn, weighted.
    unsure : float
        What noise of normals puts into such a sum, turns counted at `length` [1/m^2].
    length : float
        Mean distance of the points from where the turn is about [m].

    Returns
    -------
    projection : ndarray, shape (6, 6)
        To be multiplied with derivatives from the right.
    loose : tuple of ndarray
        Directions (shift [m], turn [rad]).

    Notes
    -----
    Noise of normals in both scans makes products whose mean is zero; a direction is
    held if its sum stands out of their scatter.
    """
    scale = np.array([1.0, 1.0, 1.0, length, length, length])
    scaled = matrix / np.outer(scale, scale)
    values, axes = np.linalg.eigh((scaled + scaled.T) / 2)
    projection = np.eye(6)
    loose = []
    for value, axis in zip(values, axes.T, strict=True):
        if value < _HELD * unsure:
            projection -= np.outer(axis, axis)
            direction = axis / scale
            size = (
                np.linalg.norm(axis[:3]) if np.linalg.norm(axis[:3]) > 0.5 else length
            )
            loose.append(np.asarray(direction / max(float(size), 1e-12)))
    # Back from scaled to plain coordinates, where rows are multiplied from the right.
    return np.diag(1 / scale) @ projection @ np.diag(scale), tuple(loose)
