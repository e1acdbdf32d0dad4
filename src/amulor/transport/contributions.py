"""What groups of histories contribute, and whether one of them outweighs the error.

A run is an average of groups that are independent of each other. Its error is that of
their scatter, unless a few of them bring most of the light; then the next one of that
size would move the mean by more than the error that is stated.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amulor.optics.polarization import stokes as _stokes

__all__ = ["ANALYSERS", "LIGHT", "analyser_vector", "outweighs", "sums_of", "together"]

Array = NDArray[np.float64]

#: Kinds of light, in the order of the rows of the sums.
LIGHT = ("all", "water", "target")
#: Analysers, in the order of the columns; without Stokes vectors there is the first.
ANALYSERS = ("none", "H", "V", "P", "M", "R", "L")
#: Sum, sum of squares and largest of the contributions of the groups.
SUM, SQUARE, LARGEST = range(3)
#: Equal contributions that would scatter as much, fewest from which an error is known:
#: of fewer the large ones are likely to be missing yet, from sum and error alike.
_FEWEST = 30


def analyser_vector(name: str) -> Array:
    """Return what of I, Q, U and V an ideal analyser lets pass.

    Raises
    ------
    ValueError
        If there is no such state.
    """
    vector = _stokes.state(name)
    result: Array = vector if name == "none" else 0.5 * vector
    return result


def sums_of(weight: Array) -> Array:
    """Return sum, sum of squares and largest of contributions.

    Parameters
    ----------
    weight : ndarray
        Stokes vector or intensity of each group, from water and target, shape
        (groups, 2, components) [1].

    Returns
    -------
    ndarray
        Shape (kinds of light, analysers, 3) [1].
    """
    light = np.stack([weight.sum(axis=1), weight[:, 0], weight[:, 1]])
    if weight.shape[2] == 4:
        vectors = np.stack([analyser_vector(name) for name in ANALYSERS], axis=-1)
        passed = light @ vectors
    else:
        passed = light
    return np.stack(
        [
            passed.sum(axis=1),
            (passed**2).sum(axis=1),
            passed.max(axis=1, initial=0.0),
        ],
        axis=-1,
    )


def together(one: Array, other: Array) -> Array:
    """Return the sums of two sets of groups."""
    result = one + other
    result[..., LARGEST] = np.maximum(one[..., LARGEST], other[..., LARGEST])
    return result


def outweighs(sums: Array, *, groups: int, unseen: float = 0.0) -> bool:
    """Return whether one group moves the mean by more than a standard error.

    Parameters
    ----------
    sums : ndarray
        Sum, sum of squares and largest of the contributions, shape (3,) [1].
    groups : int
        Number of groups.
    unseen : float
        Contribution that a group could bring by one event, which may not have
        happened yet [1].

    Returns
    -------
    bool
        Whether the largest is further from the mean of all others than the error that
        these alone would state, or the unseen one than that of all, or the relative
        error is that of less than 30 equal contributions.
    """
    if groups < 2:
        return False
    total, square, largest = (float(value) for value in sums)
    if (square - total**2 / groups) * _FEWEST > total**2:
        return True
    others = groups - 1
    mean = (total - largest) / others
    spread = max(square - largest**2 - others * mean**2, 0.0)
    # What rounding leaves of equal contributions is no tail.
    if largest - mean > math.sqrt(spread) + 1e-6 * largest:
        return True
    return unseen > math.sqrt(max(square - total**2 / groups, 0.0))
