"""Compiled: Fisher information on the range with the water as nuisance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba
from amulor.design._kernels.points import (
    B_COLUMN,
    DARK,
    DEPARTURE,
    FLOOR,
    FLUCTUATION,
    PIXELS,
    R_DARK,
    R_FLOOR,
    R_FLUCTUATION,
    R_REFERENCE,
    R_SHOT,
    R_SKY,
    SHOT,
    SHOTS,
    Scratch,
)

__all__ = ["range_information"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Standard deviation of the logarithms of absorption and scattering beforehand [1].
_UNKNOWN = 2.0


@numba.njit(cache=True, error_model="numpy")
def _inverse(
    counting: float, along: complex, floor: float, water: complex, part: float
) -> tuple[float, float, float]:
    """Return the inverse covariance of one sample: in phase, quadrature, mixed."""
    turned = 1j * along * floor
    moved = water * part
    a = counting + turned.real**2 + moved.real**2
    b = counting + turned.imag**2 + moved.imag**2
    c = turned.real * turned.imag + moved.real * moved.imag
    determinant = a * b - c * c
    return b / determinant, a / determinant, -c / determinant


@numba.njit(cache=True, error_model="numpy")
def _add(slope: Complex, inverse: tuple[float, float, float], out: Floats) -> None:
    """Add the information of one sample on parameters with these slopes."""
    for i in range(slope.size):
        re = inverse[0] * slope[i].real + inverse[2] * slope[i].imag
        im = inverse[2] * slope[i].real + inverse[1] * slope[i].imag
        for j in range(slope.size):
            out[i, j] += re * slope[j].real + im * slope[j].imag


@numba.njit(cache=True, error_model="numpy")
def range_information(x: Floats, scratch: Scratch, out: Floats, bias: Floats) -> None:
    """Fill the variance of the range by its random terms [m^2], and the bias [m].

    Parameters are the range, the logarithm of the echo of each channel, and, shared by
    the pixels, those of the strength of the water in each channel, of absorption and of
    scattering. The shared ones are known from the open-water shots and from all pixels
    and are eliminated by a Schur complement, with the error that they keep.
    """
    channels = scratch.laser_rate.size
    own = 1 + channels
    size = own + channels + 2
    information = np.zeros((size, size))
    shared = np.zeros((size, size))
    slope = np.zeros(size, dtype=np.complex128)
    for k in range(scratch.to_range.size):
        if scratch.to_range[k] == 0.0:
            continue
        for c in range(channels):
            slope[:] = 0.0
            target, water = scratch.target[k, c], scratch.water[k, c]
            rate = scratch.laser_rate[c] + scratch.sky_rate[c] + x[DARK]
            noise = _inverse(
                x[SHOT] * rate, target + water, x[FLOOR], water, x[FLUCTUATION]
            )
            slope[0] = 1j * target / scratch.to_range[k]
            slope[1 + c] = target
            slope[own + c] = water
            slope[own + channels :] = scratch.change[k, c, :2]
            _add(slope, noise, information)
            column = scratch.open_water[k, c]
            rate = scratch.open_rate[c] + scratch.sky_rate[c] + x[DARK]
            noise = _inverse(x[SHOT] * rate, column, x[FLOOR], column, x[FLUCTUATION])
            slope[: 1 + channels] = 0.0
            slope[own + c] = column
            slope[own + channels :] = scratch.change[k, c, 2:]
            _add(slope, noise, shared)
    # The echo of a channel without light says nothing of the range.
    for i in range(own):
        information[i, i] = max(information[i, i], 1e-200)
    inner = np.linalg.inv(_scaled(information[:own, :own])).astype(np.float64)
    scale = 1.0 / np.sqrt(np.diag(information)[:own])
    for i in range(own):
        for j in range(own):
            inner[i, j] *= scale[i] * scale[j]
    mixed = inner @ np.ascontiguousarray(information[:own, own:])
    known = x[SHOTS] * shared[own:, own:] + x[PIXELS] * (
        information[own:, own:] - np.ascontiguousarray(information[own:, :own]) @ mixed
    )
    for i in range(size - own):
        known[i, i] += _UNKNOWN**-2
    left = mixed[0] @ np.linalg.inv(known) @ mixed[0]
    out[:] = 0.0
    out[R_REFERENCE] = max(left, 0.0)
    _terms(x, scratch, inner, out, bias)


@numba.njit(cache=True, error_model="numpy")
def _scaled(matrix: Floats) -> Floats:
    """Return a matrix with ones on its diagonal, a little more than that."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    out = np.empty(matrix.shape)
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[0]):
            out[i, j] = matrix[i, j] * scale[i] * scale[j]
        out[i, i] += 1e-12
    return out


@numba.njit(cache=True, error_model="numpy")
def _terms(
    x: Floats, scratch: Scratch, inner: Floats, out: Floats, bias: Floats
) -> None:
    """Divide the variance at a known water into its terms, sample by sample."""
    departed = 0.0
    for k in range(scratch.to_range.size):
        if scratch.to_range[k] == 0.0:
            continue
        for c in range(scratch.laser_rate.size):
            target, water = scratch.target[k, c], scratch.water[k, c]
            rate = scratch.laser_rate[c] + scratch.sky_rate[c] + x[DARK]
            noise = _inverse(
                x[SHOT] * rate, target + water, x[FLOOR], water, x[FLUCTUATION]
            )
            pull = inner[0, 0] * 1j * target / scratch.to_range[k]
            pull += inner[0, 1 + c] * target
            re = noise[0] * pull.real + noise[2] * pull.imag
            im = noise[2] * pull.real + noise[1] * pull.imag
            square = re * re + im * im
            out[R_SHOT] += square * x[SHOT] * scratch.laser_rate[c]
            out[R_DARK] += square * x[SHOT] * x[DARK]
            out[R_SKY] += square * x[SHOT] * scratch.sky_rate[c]
            turned = 1j * (target + water)
            out[R_FLOOR] += (x[FLOOR] * (re * turned.real + im * turned.imag)) ** 2
            moved = re * water.real + im * water.imag
            out[R_FLUCTUATION] += (x[FLUCTUATION] * moved) ** 2
            departed += square * abs(water) ** 2 / 2
    bias[:] = 0.0
    bias[B_COLUMN] = x[DEPARTURE] * np.sqrt(departed)
