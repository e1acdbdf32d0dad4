"""Compiled: errors of the range of many candidates, one after the other."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba
from amulor.design._kernels.intervals import astray
from amulor.design._kernels.joint import range_information
from amulor.design._kernels.linear import phase_errors
from amulor.design._kernels.points import (
    DISTANCE,
    FAR,
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
    R_DARK,
    R_SHOT,
    R_SKY,
    Light,
    Points,
    Scratch,
)
from amulor.design._kernels.samples import see

__all__ = ["assess"]

Floats = NDArray[np.float64]

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
    channels, tones = points.target_fraction.shape[1], points.tone.shape[1]
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
                first, last = 0, tones
            for only in range(first, last):
                error = _combine(only, x, scratch, row)
                if error < least or (c == 0 and only == first):
                    least = min(error, least)
                    out[p] = row
                    out[p, O_CHANNEL] = c
                    out[p, O_TONE] = only
        out[p, O_OUTPUT] = output
