"""Compiled loop of the joint estimation: normal equations of what the pixels share."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint._kernels.model import LANES

Array = NDArray[Any]

#: A column that is this close to those before it says nothing of its own [1].
_DEPENDENT = 1e-12


@numba.njit(cache=True, fastmath=LANES)
def _accumulate_some(
    begin: int,
    end: int,
    residual: Array,
    weight: Array,
    base: Array,
    changes: Array,
    near: Array,
    strength: Array,
    echo: Array,
    factor: Array,
    amplitude: Array,
    slope: Array,
    wavenumber: Array,
    is_target: Array,
    first_departure: int,
    first_echo: int,
    is_free: bool,
    matrix: Array,
    vector: Array,
) -> float:
    """Add up the normal equations of some pixels; return their misfit."""
    channels, frequencies = residual.shape[1], residual.shape[2]
    parameters = changes.shape[1]
    used = vector.size
    columns = 1 + parameters + (4 if is_free else 0)
    square = 0.0
    index = np.empty(columns, dtype=np.int64)
    real, imaginary = np.empty(columns), np.empty(columns)
    values = np.zeros(columns, dtype=np.complex128)
    gram = np.empty((channels + 1, channels + 1))
    mixed = np.empty((channels + 1, used))
    own = np.empty(channels + 1)
    for m in range(parameters):
        index[1 + m] = channels + m
    for n in range(begin, end):
        gram.fill(0)
        mixed.fill(0)
        own.fill(0)
        for c in range(channels):
            for f in range(frequencies):
                xx, xy, yy = (
                    weight[n, c, 0, f],
                    weight[n, c, 1, f],
                    weight[n, c, 2, f],
                )
                if not xx > 0:
                    continue
                root = math.sqrt(xx)
                slant = xy / root
                rest = math.sqrt(max(yy - slant * slant, 0.0))
                left = residual[n, c, f]
                u = root * left.real + slant * left.imag
                v = rest * left.imag
                square += u * u + v * v
                index[0] = c
                values[0] = base[n, c, f]
                for m in range(parameters):
                    values[1 + m] = strength[c] * changes[n, m, f]
                if is_free:
                    at = 1 + parameters
                    index[at] = first_departure + c * frequencies + f
                    index[at + 1] = index[at] + channels * frequencies
                    index[at + 2] = first_echo + f
                    index[at + 3] = first_echo + frequencies + f
                    values[at] = strength[c] * near[n, f]
                    values[at + 1] = 1j * values[at]
                    values[at + 2] = amplitude[n, c] * echo[n, f]
                    values[at + 3] = 1j * values[at + 2]
                for k in range(columns):
                    real[k] = root * values[k].real + slant * values[k].imag
                    imaginary[k] = rest * values[k].imag
                for k in range(columns):
                    row = index[k]
                    a, b = real[k], imaginary[k]
                    vector[row] += a * u + b * v
                    for m in range(columns):
                        matrix[row, index[m]] += a * real[m] + b * imaginary[m]
                if not is_target[n]:
                    continue
                # The pixel's own: amplitude in this channel, and path.
                full = echo[n, f] * factor[f]
                way = (
                    1j * wavenumber[f] * amplitude[n, c] * full
                    + strength[c] * slope[n, f]
                )
                a, b = root * full.real + slant * full.imag, rest * full.imag
                d, e = root * way.real + slant * way.imag, rest * way.imag
                gram[c, c] += a * a + b * b
                gram[channels, c] += a * d + b * e
                gram[channels, channels] += d * d + e * e
                own[c] += a * u + b * v
                own[channels] += d * u + e * v
                for k in range(columns):
                    row = index[k]
                    mixed[c, row] += a * real[k] + b * imaginary[k]
                    mixed[channels, row] += d * real[k] + e * imaginary[k]
        if not is_target[n]:
            continue
        # Cholesky's steps: the amplitudes do not share samples.
        for c in range(channels + 1):
            pivot = gram[c, c]
            if c == channels:
                for k in range(channels):
                    if not gram[k, k] > 0:
                        continue
                    share = gram[channels, k] / gram[k, k]
                    pivot -= share * gram[channels, k]
                    own[channels] -= share * own[k]
                    for m in range(used):
                        mixed[channels, m] -= share * mixed[k, m]
            if not pivot > _DEPENDENT * gram[c, c]:
                mixed[c].fill(0)
                own[c] = 0
                continue
            scale = 1 / pivot
            square -= scale * own[c] * own[c]
            for k in range(used):
                along = scale * mixed[c, k]
                if along == 0:
                    continue
                vector[k] -= along * own[c]
                for m in range(used):
                    matrix[k, m] -= along * mixed[c, m]
    return square


@numba.njit(cache=True, parallel=True)
def accumulate(
    residual: Array,
    weight: Array,
    base: Array,
    changes: Array,
    near: Array,
    strength: Array,
    echo: Array,
    factor: Array,
    amplitude: Array,
    slope: Array,
    wavenumber: Array,
    is_target: Array,
    first_departure: int,
    first_echo: int,
    is_free: bool,
    matrix: Array,
    vector: Array,
    square: Array,
) -> None:
    """Add up the normal equations of all pixels, their own parameters eliminated.

    Complex arrays run over (pixel, channel, frequency) or (pixel, frequency), and
    `changes` over (pixel, parameter, frequency). The last three hold a sum for each
    part of the pixels, so that the result does not depend on the number of threads.
    Where not `is_free`, departures of water and echo are left out.
    """
    count, portions = residual.shape[0], matrix.shape[0]
    for portion in numba.prange(portions):
        square[portion] += _accumulate_some(
            count * portion // portions, count * (portion + 1) // portions,
            residual, weight, base, changes, near, strength, echo, factor, amplitude,
            slope, wavenumber, is_target, first_departure, first_echo, is_free,
            matrix[portion], vector[portion],
        )  # fmt: skip
