"""Compiled: phase errors of the methods that work sample by sample."""

from __future__ import annotations

import cmath
import math

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba
from amulor.design._kernels.points import (
    B_COLUMN,
    B_DRIFT,
    B_RATIO,
    B_SHIFT,
    CHANGE,
    COLUMN,
    COMBINED,
    DARK,
    DEPARTURE,
    DISTANCE,
    FAR,
    FLOOR,
    FLUCTUATION,
    JOINT,
    KEPT,
    NEAR,
    O_ASTRAY,
    O_CHANNEL,
    O_OUTPUT,
    O_SIGNAL,
    O_TONE,
    O_UNSEEN,
    O_WRONG,
    ONE_FREQUENCY,
    OPEN_WATER,
    PIXELS,
    R_DARK,
    R_FLOOR,
    R_FLUCTUATION,
    R_REFERENCE,
    R_SHOT,
    R_SKY,
    RATIO,
    REFERENCE,
    SHOT,
    SHOTS,
    UNMIX,
    Light,
    Points,
    Scratch,
    across,
    astray,
    see,
)

__all__ = ["assess", "phase_errors", "range_information"]


Floats = NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
def phase_errors(
    method: int, channel: int, x: Floats, passed: Floats, scratch: Scratch
) -> None:
    """Fill variance, bias and size of the phases by which a method finds the range.

    `passed` holds the shares of target and water that the channels pass, (2, channel).
    The signal that the range is taken of is a sum of channels with real weights.
    """
    count = passed.shape[1]
    weight = np.zeros(count)
    for k in range(scratch.to_range.size):
        scratch.variance[k] = np.inf
        scratch.bias[k] = 0.0
        scratch.size[k] = 0.0
        if scratch.to_range[k] == 0.0:
            continue
        weight[:] = 0.0
        aim = scratch.target[k, channel]
        if method in (KEPT, ONE_FREQUENCY):
            aim = aim + scratch.water[k, channel]
            weight[channel] = 1.0
        elif method == OPEN_WATER:
            weight[channel] = 1.0
        else:
            aim = scratch.target[k, 0]
            _mix(method, k, x, passed, scratch, weight)
        scratch.size[k] = abs(aim)
        scratch.variance[k] = 0.0
        _add_noise(method, k, x, weight, aim, scratch)
        _add_bias(method, k, x, weight, aim, scratch)


@numba.njit(cache=True, error_model="numpy")
def _mix(
    method: int, k: int, x: Floats, passed: Floats, scratch: Scratch, weight: Floats
) -> None:
    """Fill the weights that make the first channel's target of two channels."""
    of_target = passed[0, 1] / max(passed[0, 0], 1e-12)
    of_water = passed[1, 1] / max(passed[1, 0], 1e-12)
    if method == UNMIX:
        contrast = of_target - of_water
        if abs(contrast) < 1e-6:
            contrast = 1e-6
        weight[0], weight[1] = -of_water / contrast, 1.0 / contrast
        return
    # Subtracted channels, by the inverse of their variances.
    total = 0.0
    share = np.array([1.0, of_target])
    aim = scratch.target[k, 0]
    for c in range(2):
        signal = scratch.target[k, c] + scratch.water[k, c]
        square = max(abs(aim), 1e-300) ** 2
        rate = scratch.laser_rate[c] + scratch.sky_rate[c] + x[DARK]
        own = x[SHOT] * rate / square
        own += (x[FLOOR] * across(1j * signal, aim)) ** 2
        own += (x[FLUCTUATION] * across(scratch.water[k, c], aim)) ** 2
        weight[c] = share[c] / own
        total += share[c] * weight[c]
    weight[:2] /= total


@numba.njit(cache=True, error_model="numpy")
def _add_noise(
    method: int, k: int, x: Floats, weight: Floats, aim: complex, scratch: Scratch
) -> None:
    """Add the random terms of one frequency."""
    square = max(abs(aim), 1e-300) ** 2
    variance = scratch.variance[k]
    for c in range(weight.size):
        each = weight[c] ** 2
        if each == 0.0:
            continue
        water = scratch.water[k, c]
        counted = each * x[SHOT] / square
        variance[R_SHOT] += counted * scratch.laser_rate[c]
        variance[R_DARK] += counted * x[DARK]
        variance[R_SKY] += counted * scratch.sky_rate[c]
        turned = across(1j * (scratch.target[k, c] + water), aim)
        variance[R_FLOOR] += each * (x[FLOOR] * turned) ** 2
        moved = each * (x[FLUCTUATION] * across(water, aim)) ** 2
        variance[R_FLUCTUATION] += moved
        if method in (OPEN_WATER, COMBINED):
            rate = scratch.open_rate[c] + scratch.sky_rate[c] + x[DARK]
            variance[R_REFERENCE] += x[REFERENCE] * (counted * rate + moved)


@numba.njit(cache=True, error_model="numpy")
def _add_bias(
    method: int, k: int, x: Floats, weight: Floats, aim: complex, scratch: Scratch
) -> None:
    """Add the systematic terms of one frequency."""
    bias = scratch.bias[k]
    if method in (KEPT, ONE_FREQUENCY):
        for c in range(weight.size):
            if weight[c] != 0.0 and scratch.target[k, c] != 0.0:
                bias[B_SHIFT] = cmath.phase(aim * np.conj(scratch.target[k, c]))
        return
    if method == UNMIX:
        contrast = 1.0 / weight[1]
        bias[B_RATIO] = x[RATIO] / contrast * across(scratch.water[k, 0], aim)
        return
    for c in range(weight.size):
        water = scratch.water[k, c]
        behind = scratch.open_water[k, c] - water
        bias[B_DRIFT] += x[CHANGE] * weight[c] * across(water, aim)
        bias[B_COLUMN] += x[COLUMN] * weight[c] * across(behind, aim)


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


#: Errors of a phase beyond which it is lost: counting noise, all together [rad].
_COUNTING, _LOST = 0.2, 0.3


@numba.njit(cache=True, error_model="numpy")
def _phase_variance(k: int, scratch: Scratch) -> float:
    """Return the variance of the phase of one frequency [rad^2]."""
    total = 0.0
    for j in range(scratch.variance.shape[1]):
        total += scratch.variance[k, j]
    return total


@numba.njit(cache=True, error_model="numpy")
def _combine(only: int, x: Floats, scratch: Scratch, row: Floats) -> float:
    """Fill a result from phases, weighted by their precision; return its error.

    `only` is the one frequency that counts, -1 for all.
    """
    row[:] = 0.0
    count = scratch.to_range.size
    weight, phase = np.zeros(count), np.empty(count)
    there = np.zeros(count)
    total, unseen, known = 0.0, 0.0, 0.0
    for k in range(count):
        phase[k] = np.inf
        if scratch.to_range[k] == 0.0 or (only >= 0 and k != only):
            continue
        known += 1.0
        variance = _phase_variance(k, scratch)
        counted = scratch.variance[k, R_SHOT] + scratch.variance[k, R_DARK]
        counted += scratch.variance[k, R_SKY]
        if not (variance < _LOST**2 and counted < _COUNTING**2):
            unseen += 1.0
        if not variance < np.inf:
            continue
        there[k] = scratch.to_range[k]
        phase[k] = variance
        weight[k] = 1.0 / (there[k] ** 2 * max(variance, 1e-30))
        total += weight[k]
        row[O_SIGNAL] = max(row[O_SIGNAL], scratch.size[k])
    row[O_UNSEEN] = unseen / max(known, 1.0)
    if total == 0.0:
        row[:O_WRONG] = np.inf
        row[O_WRONG] = 1.0
        return np.inf
    error = 0.0
    for k in range(count):
        pull = weight[k] / total * there[k]
        if pull == 0.0:
            continue
        for j in range(scratch.variance.shape[1]):
            row[j] += pull**2 * scratch.variance[k, j]
        offset = scratch.variance.shape[1]
        shifted = 0.0
        for j in range(scratch.bias.shape[1]):
            row[offset + j] += pull * scratch.bias[k, j]
            shifted += scratch.bias[k, j] ** 2
        phase[k] += shifted
    for j in range(scratch.variance.shape[1]):
        error += row[j]
    for j in range(scratch.bias.shape[1]):
        error += row[scratch.variance.shape[1] + j] ** 2
    row[O_WRONG], row[O_ASTRAY] = astray(there, phase, x[DISTANCE], x[NEAR], x[FAR])
    return error


@numba.njit(cache=True, error_model="numpy")
def _jointly(x: Floats, passed: Floats, scratch: Scratch, row: Floats) -> None:
    """Fill the result of the joint estimation."""
    # Which interval it is follows from the phases, channel by channel together.
    best = 0
    for c in range(passed.shape[1]):
        if passed[0, c] > passed[0, best]:
            best = c
    phase_errors(OPEN_WATER, best, x, passed, scratch)
    _combine(-1, x, scratch, row)
    variance = np.zeros(scratch.variance.shape[1])
    bias = np.zeros(scratch.bias.shape[1])
    range_information(x, scratch, variance, bias)
    row[: variance.size] = variance
    row[variance.size : variance.size + bias.size] = bias
    row[O_CHANNEL] = -1.0


@numba.njit(cache=True, error_model="numpy")
def assess(
    method: int, points: Points, light: Light, scratch: Scratch, out: Floats
) -> None:
    """Fill a row of results for each point, see `points.RESULTS`.

    Compiled, as a point has few numbers and there are hundreds of thousands.
    """
    channels = points.target_fraction.shape[1]
    frequency_count = points.frequency_index.shape[1]
    passed = np.empty((2, channels))
    row = np.empty(out.shape[1])
    for p in range(points.look.size):
        x = points.number[p]
        output = see(p, points, light, scratch)
        passed[0], passed[1] = points.target_fraction[p], points.water_fraction[p]
        if method == JOINT:
            _jointly(x, passed, scratch, row)
            out[p] = row
            out[p, O_TONE] = -1.0
            out[p, O_OUTPUT] = output
            continue
        least = math.inf
        out[p] = np.inf
        each = channels if method in (KEPT, ONE_FREQUENCY, OPEN_WATER) else 1
        for c in range(each):
            phase_errors(method, c, x, passed, scratch)
            first, last = -1, 0
            if method == ONE_FREQUENCY:
                first, last = 0, frequency_count
            for only in range(first, last):
                error = _combine(only, x, scratch, row)
                if error < least or (c == 0 and only == first):
                    least = min(error, least)
                    out[p] = row
                    out[p, O_CHANNEL] = c
                    out[p, O_TONE] = only
        out[p, O_OUTPUT] = output
