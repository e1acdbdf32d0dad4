"""Compiled loops of the joint estimation: normal equations, and shared errors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from amulor._compiled import numba
from amulor.rejection.joint._kernels.bundles import (
    Array,
    Covariances,
    Derivatives,
    Parameters,
    Sums,
    WaterModel,
)
from amulor.rejection.joint._kernels.compiled import LANES, inner


@inner(fastmath=LANES, forceinline=True)
def _fill_columns(
    n: int, c: int, f: int, model: WaterModel, real: Array, imaginary: Array
) -> None:
    """Compute the water-signal derivatives of one sample.

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
    """Compute the water-signal covariance from errors common to all pixels.

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


#: Relative residual below which a column depends linearly on the previous ones [1].
_DEPENDENT = 1e-12


class _Row(NamedTuple):
    """Nonzero derivatives of one sample with respect to shared parameters."""

    parameter: Array
    """Indices of the parameters."""
    values: Array
    """Derivatives, complex [V]."""
    real: Array
    """Whitened derivatives, in phase [1]."""
    imaginary: Array
    """Whitened derivatives, quadrature [1]."""


class _Own(NamedTuple):
    """Normal equations of one pixel's parameters: amplitudes, then path."""

    gram: Array
    """Information matrix of amplitudes and path, lower triangle, (own, own)."""
    mixed: Array
    """Cross information of pixel and shared parameters, (own, parameter)."""
    vector: Array
    """Negative half gradient of chi-square, (own,)."""


@inner(forceinline=True)
def _root(weight: Array, n: int, c: int, f: int) -> tuple[float, float, float]:
    """Return the three elements of the Cholesky factor of a sample's weight."""
    root = math.sqrt(weight[n, c, 0, f])
    slant = weight[n, c, 1, f] / root
    return root, slant, math.sqrt(max(weight[n, c, 2, f] - slant * slant, 0.0))


@inner(forceinline=True)
def _fill_row(
    n: int,
    c: int,
    f: int,
    derivatives: Derivatives,
    parameters: Parameters,
    row: _Row,
) -> None:
    """Compute a sample's row of the Jacobian.

    By the strength of its channel, the shape of the water signal and, where they are
    free, the departures of water and echo, real and imaginary; for open-water shots
    also by departures of their own and their strength over that of the scan.
    """
    parameter, values = row.parameter, row.values
    channels, frequencies = derivatives.base.shape[1], derivatives.base.shape[2]
    shapes = derivatives.changes.shape[1]
    parameter[0] = c
    values[0] = derivatives.base[n, c, f]
    for m in range(shapes):
        values[1 + m] = parameters.strength[c] * derivatives.changes[n, m, f]
    if parameters.is_free:
        at = 1 + shapes
        parameter[at] = parameters.first_departure + c * frequencies + f
        parameter[at + 1] = parameter[at] + channels * frequencies
        parameter[at + 2] = parameters.first_echo + f
        parameter[at + 3] = parameters.first_echo + frequencies + f
        values[at] = parameters.strength[c] * derivatives.foreground[n, f]
        values[at + 1] = 1j * values[at]
        values[at + 2] = derivatives.amplitude[n, c] * derivatives.echo[n, f]
        values[at + 3] = 1j * values[at + 2]
        if parameters.first_doubt >= 0:
            parameter[at + 4] = parameters.first_doubt + c * frequencies + f
            parameter[at + 5] = parameter[at + 4] + channels * frequencies
            parameter[at + 6] = parameters.first_doubt + 2 * channels * frequencies
            values[at + 4] = values[at]
            values[at + 5] = values[at + 1]
            values[at + 6] = parameters.strength[c] * values[0]


@inner(fastmath=LANES, forceinline=True)
def _add_row(u: float, v: float, row: _Row, matrix: Array, vector: Array) -> None:
    """Add a sample with whitened residual (u, v) to the normal equations."""
    parameter, real, imaginary = row.parameter, row.real, row.imaginary
    for k in range(parameter.size):
        at = parameter[k]
        a, b = real[k], imaginary[k]
        vector[at] += a * u + b * v
        for m in range(parameter.size):
            matrix[at, parameter[m]] += a * real[m] + b * imaginary[m]


@inner(fastmath=LANES, forceinline=True)
def _add_own(
    c: int,
    residual: tuple[float, float],
    by_amplitude: tuple[float, float],
    by_path: tuple[float, float],
    row: _Row,
    own: _Own,
) -> None:
    """Add a sample to the normal equations of its pixel's amplitudes and path.

    All in units of the errors, (in phase, quadrature).
    """
    u, v = residual
    a, b = by_amplitude
    d, e = by_path
    channels = own.vector.size - 1
    own.gram[c, c] += a * a + b * b
    own.gram[channels, c] += a * d + b * e
    own.gram[channels, channels] += d * d + e * e
    own.vector[c] += a * u + b * v
    own.vector[channels] += d * u + e * v
    parameter, mixed, real, imaginary = (
        row.parameter,
        own.mixed,
        row.real,
        row.imaginary,
    )
    for k in range(parameter.size):
        at = parameter[k]
        mixed[c, at] += a * real[k] + b * imaginary[k]
        mixed[channels, at] += d * real[k] + e * imaginary[k]


@inner(fastmath=LANES, forceinline=True)
def _add_pixel(
    n: int,
    derivatives: Derivatives,
    parameters: Parameters,
    row: _Row,
    own: _Own,
    matrix: Array,
    vector: Array,
) -> float:
    """Add the samples of one pixel to both normal equations; return chi-square."""
    residual, weight = derivatives.residual, derivatives.weight
    is_target = derivatives.is_target[n]
    square = 0.0
    for c in range(residual.shape[1]):
        for f in range(residual.shape[2]):
            if not weight[n, c, 0, f] > 0:
                continue
            root, slant, rest = _root(weight, n, c, f)
            left = residual[n, c, f]
            u = root * left.real + slant * left.imag
            v = rest * left.imag
            square += u * u + v * v
            if row.parameter.size > 0:
                _fill_row(n, c, f, derivatives, parameters, row)
            for k in range(row.parameter.size):
                value = row.values[k]
                row.real[k] = root * value.real + slant * value.imag
                row.imaginary[k] = rest * value.imag
            _add_row(u, v, row, matrix, vector)
            if not is_target:
                continue
            echo = derivatives.echo[n, f] * parameters.factor[f]
            along = (
                1j * parameters.phase_per_path[f] * derivatives.amplitude[n, c] * echo
                + parameters.strength[c] * derivatives.slope[n, f]
            )
            _add_own(
                c,
                (u, v),
                (root * echo.real + slant * echo.imag, rest * echo.imag),
                (root * along.real + slant * along.imag, rest * along.imag),
                row,
                own,
            )
    return square


@inner(fastmath=LANES, forceinline=True)
def _eliminate(own: _Own, matrix: Array, vector: Array) -> float:
    """Eliminate the parameters of one pixel; return the decrease of chi-square.

    Cholesky's steps towards the Schur complement; the amplitudes share no samples, so
    that only the path, which comes last, has something to subtract.
    """
    gram, mixed = own.gram, own.mixed
    last, used = own.vector.size - 1, vector.size
    gained = 0.0
    for c in range(last + 1):
        pivot = gram[c, c]
        if c == last:
            for k in range(last):
                if not gram[k, k] > 0:
                    continue
                ratio = gram[last, k] / gram[k, k]
                pivot -= ratio * gram[last, k]
                own.vector[last] -= ratio * own.vector[k]
                for m in range(used):
                    mixed[last, m] -= ratio * mixed[k, m]
        if not pivot > _DEPENDENT * gram[c, c]:
            mixed[c].fill(0)
            own.vector[c] = 0
            continue
        scale = 1 / pivot
        gained += scale * own.vector[c] * own.vector[c]
        for k in range(used):
            along = scale * mixed[c, k]
            if along == 0:
                continue
            vector[k] -= along * own.vector[c]
            for m in range(used):
                matrix[k, m] -= along * mixed[c, m]
    return gained


@numba.njit(cache=True, error_model="numpy", nogil=True)
def accumulate(
    begin: int, end: int, derivatives: Derivatives, parameters: Parameters, sums: Sums
) -> None:
    """Sum the normal equations of portions of pixels, eliminating pixel parameters.

    Gauss-Newton for strength, shape and departures, with path and amplitudes of every
    pixel eliminated (Schur complement). A portion is a fixed part of the pixels with a
    sum of its own, so that the result does not depend on the number of threads.
    Compiled because the Jacobian of a scan would not fit into memory.
    """
    count, portions = derivatives.residual.shape[0], sums.matrix.shape[0]
    channels, shapes = derivatives.residual.shape[1], derivatives.changes.shape[1]
    # Without parameters, for the sum of squares of a trial step.
    columns = 1 + shapes if sums.vector.shape[1] > 0 else 0
    if parameters.is_free:
        columns += 7 if parameters.first_doubt >= 0 else 4
    row = _Row(
        np.empty(columns, dtype=np.int64),
        np.zeros(columns, dtype=np.complex128),
        np.empty(columns),
        np.empty(columns),
    )
    own = _Own(
        np.empty((channels + 1, channels + 1)),
        np.empty((channels + 1, sums.vector.shape[1])),
        np.empty(channels + 1),
    )
    for m in range(shapes):
        row.parameter[1 + m] = channels + m
    for portion in range(begin, end):
        matrix, vector = sums.matrix[portion], sums.vector[portion]
        square = 0.0
        for n in range(count * portion // portions, count * (portion + 1) // portions):
            own.gram[:] = 0
            own.mixed[:] = 0
            own.vector[:] = 0
            square += _add_pixel(n, derivatives, parameters, row, own, matrix, vector)
            if derivatives.is_target[n]:
                square -= _eliminate(own, matrix, vector)
        sums.square[portion] += square
