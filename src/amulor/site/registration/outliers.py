"""Which points of two scans count: none of another surface, none of what moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from amulor.site.registration.bodies import Points, moved_bodies

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Numbers = NDArray[np.intp]

#: A distance is another surface if it stands off by so many standard errors [1].
_FAR = 4.0
#: Neighbours that stand off together, by so many standard errors of their mean [1].
_MOVED = 5.0


@dataclass(frozen=True, kw_only=True)
class Counted:
    """What counts."""

    weight: Floats
    """One over the variance, 0 where left out, shape (n,) [1/m^2]."""
    misfit: float
    """Scatter of the distances over what is stated; at least 1 [1]."""
    moved: Numbers
    """Pixels of the source that moved against the rest."""


def counted(points: Points, good: Flags, gate: float | None) -> Counted:
    """Return weights without points of other surfaces, and the scatter over noise.

    Parameters
    ----------
    points : Points
        All that met a patch.
    good : ndarray of bool, shape (n,)
        Those seen well enough from both places.
    gate : float or None
        None where distances are as small as their noise, and tell of what moved.

    Returns
    -------
    Counted
        Weights, scatter, and what moved.
    """
    sigma = np.sqrt(points.variance.sum(axis=0))
    score = points.distance / sigma
    middle = np.median(score[good])
    scatter = 1.4826 * np.median(np.abs(score[good] - middle))
    # A sample of n has a scatter of 1 +- 1.17 / sqrt(n) by chance; neighbours share
    # a fifth of their noise.
    sure = 1 + 3 * 1.17 / np.sqrt(max(int(good.sum()) / 2, 1.0))
    misfit = float(scatter) if scatter > sure else 1.0
    moved = np.zeros(len(score), dtype=bool)
    whole = 1 / (sigma * misfit) ** 2
    if gate is None:
        moved = good & _stand_off(points, score, good, misfit)
        kept = good & ~moved & (np.abs(score) < _FAR * misfit)
        bodies = moved_bodies(points, np.where(good, whole, 0.0), kept, misfit=misfit)
        moved |= good & bodies
        good = kept & ~bodies
    weight = np.where(good, whole, 0.0)
    return Counted(weight=weight, misfit=misfit, moved=points.pixel[moved])


def _stand_off(points: Points, score: Floats, good: Flags, misfit: float) -> Flags:
    """Return points whose neighbours stand off with them: moved things."""
    variance = points.variance
    row, column = np.divmod(points.pixel, points.smooth.shape[1])
    steps = [
        max(int(np.min(np.diff(np.unique(one)), initial=99)), 1)
        for one in (row, column)
    ]
    grid = (row // steps[0], column // steps[1])
    size = tuple(int(one.max()) + 1 for one in grid)
    total, count, patches = (np.zeros(size) for _ in range(3))
    clipped = np.clip(score, -20, 20)
    total[grid] = np.where(good, clipped, 0.0)
    count[grid] = good
    patches[grid] = np.where(good, variance[1] / variance.sum(axis=0), 0.0)
    total, count, patches = (
        25 * ndimage.uniform_filter(one, 5, mode="constant")
        for one in (total, count, patches)
    )
    number = np.maximum(count, 1.0)
    # Noise of the patches is the same in neighbours, at worst.
    error = misfit * np.sqrt(1 / number + patches / number)
    off = (np.abs(total / number) > _MOVED * error) & (count >= 5)
    off = ndimage.binary_dilation(off, iterations=2)
    return np.asarray(off[grid])
