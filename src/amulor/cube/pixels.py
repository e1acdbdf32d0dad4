"""Flags of pixels from those of their samples: some samples can be left out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulor.cube.schema import QualityFlag
from amulor.optics.ambiguity import BREAKDOWN

__all__ = ["JOINT_OUTLIERS", "flags_of_pixels"]

#: A target that so many of the frequencies do not show is still there [1].
_HALF = 0.5
#: Joint estimation has left its outliers out itself, any fraction of them but all [1].
JOINT_OUTLIERS = 1 - 1e-9


def flags_of_pixels(
    flag: NDArray[np.int16], *, most_outliers: float = BREAKDOWN
) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
    """Return the flags of pixels, all frequencies together.

    Parameters
    ----------
    flag : ndarray of int16, shape (modulation_frequency, row, column)
        Those of the samples of one channel.
    most_outliers : float
        Fraction of the frequencies that outliers may have and are left out; where
        there are more, the pixel is one [1].

    Returns
    -------
    tuple of ndarrays
        Flags over (row, column), and which samples are left out.
    """
    unseen = (flag & QualityFlag.NO_TARGET) != 0
    # A target that half of the frequencies show is there: the others are left out.
    unseen &= unseen.mean(axis=0) <= _HALF
    outlying = (flag & QualityFlag.OUTLIER) != 0
    # The rest of the frequencies tells the range without a few that disagree.
    outlying &= outlying.mean(axis=0) <= most_outliers
    each = np.where(unseen, flag & ~QualityFlag.NO_TARGET, flag)
    each = np.where(outlying, each & ~QualityFlag.OUTLIER, each)
    return np.bitwise_or.reduce(each, axis=0).astype(np.int16), unseen | outlying
