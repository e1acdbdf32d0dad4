"""How much of the smallest of several histograms is echo that scenes have in common."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: An echo stands out of the smallest scene by this many standard errors [1].
_SURE = 5.0
#: Parts of a histogram over which its smallest values are smoothed.
_PARTS = 64


def overlap_of(sums: Floats) -> Floats:
    r"""Return what of the bin-wise minimum of scenes is likely to be their echoes.

    Parameters
    ----------
    sums : ndarray, shape (scenes, bins)
        Histograms of the scenes, all pixels together, at least two.

    Returns
    -------
    ndarray, shape (bins,)
        Counts, at least 0; zero where the echoes do not meet.

    Notes
    -----
    Scenes :math:`B + E_1`, :math:`B + E_2` have the minimum
    :math:`B + \min(E_1, E_2)`: where one echo has not ended when the other begins, the
    minimum has a bump. Between two echoes, in the order in which they stand out of
    the minimum, all of it counts that lies above the straight line from the lowest
    place of the one to the lowest place of the other. It assumes that the medium itself
    has no bump there: the light of a pulse that is over dies away.
    """
    smallest = sums.min(axis=0)
    apart = sums.max(axis=0) - smallest
    seen = np.flatnonzero(apart > _SURE * np.sqrt(sums.sum(axis=0) + 1))
    own = sums.argmax(axis=0)[seen]
    # Runs of bins in which the echo of one scene stands out.
    starts = np.flatnonzero(np.diff(own, prepend=-1) != 0)
    runs = np.split(seen, starts[1:])
    level = _smoothed(smallest)
    overlap = np.zeros(smallest.size)
    for before, after in pairwise(runs):
        first = before[0] + int(level[before[0] : before[-1] + 1].argmin())
        last = after[0] + int(level[after[0] : after[-1] + 1].argmin())
        place = np.arange(first, last + 1)
        line = np.interp(place, [first, last], [level[first], level[last]])
        overlap[place] = np.maximum(overlap[place], smallest[place] - line)
    return overlap


def _smoothed(values: Floats) -> Floats:
    """Return means over an odd number of bins, the rim repeated."""
    half = values.size // _PARTS // 2
    padded = np.pad(values, half, mode="edge")
    width = 2 * half + 1
    return np.asarray(np.convolve(padded, np.full(width, 1 / width), mode="valid"))
