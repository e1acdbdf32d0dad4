"""Compiled loop of the joint estimation: errors of the water that pixels share."""

from __future__ import annotations

import numpy as np

from amulor._compiled import numba
from amulor.rejection.joint._kernels.bundles import Array, Covariances, WaterModel
from amulor.rejection.joint._kernels.options import LANES, inner


@inner(fastmath=LANES, forceinline=True)
def _fill_columns(
    n: int, c: int, f: int, model: WaterModel, real: Array, imaginary: Array
) -> None:
    """Fill in the derivatives of the water signal of one sample.

    By the strength, the shape and the departure, real and imaginary.
    """
    count = real.size
    foreground = model.foreground[n, f]
    value = model.water[n, f] + model.departure[c, f] * foreground
    real[0], imaginary[0] = value.real, value.imag
    for m in range(count - 3):
        value = model.gain[c, f] * model.changes[n, m, f]
        real[1 + m], imaginary[1 + m] = value.real, value.imag
    value = model.strength[c] * foreground
    real[count - 2], imaginary[count - 2] = value.real, value.imag
    real[count - 1], imaginary[count - 1] = -value.imag, value.real


@numba.njit(cache=True, error_model="numpy", nogil=True, fastmath=LANES)
def common(begin: int, end: int, model: WaterModel, out: Covariances) -> None:
    """Fill in the covariance of the estimated water signal, which pixels share.

    J C J' of each sample, with the derivatives J of s W + s d V and the covariance C of
    their parameters. Compiled because numpy would keep J of all samples.
    """
    covariance = model.covariance
    count = covariance.shape[2]
    real, imaginary = np.empty(count), np.empty(count)
    for n in range(begin, end):
        for c in range(covariance.shape[0]):
            for f in range(covariance.shape[1]):
                _fill_columns(n, c, f, model, real, imaginary)
                xx, yy, xy = 0.0, 0.0, 0.0
                for i in range(count):
                    u, v = 0.0, 0.0
                    for j in range(count):
                        u += covariance[c, f, i, j] * real[j]
                        v += covariance[c, f, i, j] * imaginary[j]
                    xx += real[i] * u
                    yy += imaginary[i] * v
                    xy += real[i] * v
                out.in_phase[n, c, f] = xx
                out.quadrature[n, c, f] = yy
                out.cross[n, c, f] = xy
