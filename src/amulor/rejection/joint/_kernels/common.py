"""Compiled loop of the joint estimation: errors of the water that pixels share."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint._kernels.model import LANES

Array = NDArray[Any]


@numba.njit(cache=True, fastmath=LANES)
def _common_one(
    strength: Array,
    gain: Array,
    departure: Array,
    near: Array,
    water: Array,
    changes: Array,
    matrix: Array,
    in_phase: Array,
    quadrature: Array,
    cross: Array,
) -> None:
    """Fill in the covariance of the estimated water signal of one pixel."""
    count = changes.shape[0] + 3
    real, imaginary = np.empty(count), np.empty(count)
    for c in range(gain.shape[0]):
        for f in range(gain.shape[1]):
            own = water[f] + departure[c, f] * near[f]
            real[0], imaginary[0] = own.real, own.imag
            for m in range(changes.shape[0]):
                change = gain[c, f] * changes[m, f]
                real[1 + m], imaginary[1 + m] = change.real, change.imag
            own = strength[c] * near[f]
            real[count - 2], imaginary[count - 2] = own.real, own.imag
            real[count - 1], imaginary[count - 1] = -own.imag, own.real
            xx, yy, xy = 0.0, 0.0, 0.0
            for i in range(count):
                u, v = 0.0, 0.0
                for j in range(count):
                    u += matrix[c, f, i, j] * real[j]
                    v += matrix[c, f, i, j] * imaginary[j]
                xx += real[i] * u
                yy += imaginary[i] * v
                xy += real[i] * v
            in_phase[c, f], quadrature[c, f], cross[c, f] = xx, yy, xy


@numba.njit(cache=True, parallel=True)
def common(
    strength: Array,
    gain: Array,
    departure: Array,
    near: Array,
    water: Array,
    changes: Array,
    matrix: Array,
    in_phase: Array,
    quadrature: Array,
    cross: Array,
) -> None:
    """Fill in the covariance of the estimated water signal, which pixels share.

    `matrix` holds, for each channel and frequency, the covariance of the strength, of
    the shape and of the departure there, real and imaginary.
    """
    for n in numba.prange(near.shape[0]):
        _common_one(
            strength, gain, departure, near[n], water[n], changes[n], matrix,
            in_phase[n], quadrature[n], cross[n],
        )  # fmt: skip
