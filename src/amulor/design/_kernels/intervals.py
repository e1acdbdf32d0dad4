"""Compiled: how probable it is that noise picks another ambiguity interval."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba

__all__ = ["astray"]

Floats = NDArray[np.float64]

#: Most intervals on either side that are looked at.
_MOST = 400


@numba.njit(cache=True, error_model="numpy")
def astray(
    to_range: Floats, variance: Floats, distance: float, near: float, far: float
) -> tuple[float, float]:
    """Return the probability of a wrong interval and the mean square error by it.

    Phases of the given variances [rad^2] and ranges per phase [m/rad], 0 for those that
    are not there. Candidates are the ranges that differ by whole intervals of the most
    precise frequency; each is taken with the chance Q(D / 2) that normal errors move
    the phases past the middle, D its distance in standard errors. Their sum is an upper
    limit, and nearly the probability where it is small.
    """
    best = -1
    total = 0.0
    for k in range(to_range.size):
        if to_range[k] <= 0.0 or not variance[k] < np.inf:
            continue
        precision = 1.0 / (to_range[k] ** 2 * max(variance[k], 1e-18))
        total += precision
        if best < 0 or precision > 1.0 / (
            to_range[best] ** 2 * max(variance[best], 1e-18)
        ):
            best = k
    if best < 0:
        return 1.0, (far - near) ** 2 / 12
    step = 2 * math.pi * to_range[best]
    chance, square = 0.0, 0.0
    for sign in (-1.0, 1.0):
        room = (far - distance) if sign > 0 else (distance - near)
        count = min(math.floor(max(room, 0.0) / step * (1 + 1e-9)), _MOST)
        for m in range(1, count + 1):
            offset = sign * m * step
            first, second = 0.0, 0.0
            for k in range(to_range.size):
                if k == best or to_range[k] <= 0.0 or not variance[k] < np.inf:
                    continue
                own = 2 * math.pi * to_range[k]
                rest = offset - own * round(offset / own)
                precision = 1.0 / (to_range[k] ** 2 * max(variance[k], 1e-18))
                first += precision * rest
                second += precision * rest * rest
            misfit = max(second - first * first / total, 0.0)
            each = 0.5 * math.erfc(0.5 * math.sqrt(misfit) / math.sqrt(2.0))
            chance += each
            square += each * offset * offset
    return min(chance, 1.0), square
