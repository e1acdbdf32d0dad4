"""Compiled: phase errors of the methods that work sample by sample."""

from __future__ import annotations

import cmath

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
    FLOOR,
    FLUCTUATION,
    KEPT,
    ONE_FREQUENCY,
    OPEN_WATER,
    R_DARK,
    R_FLOOR,
    R_FLUCTUATION,
    R_REFERENCE,
    R_SHOT,
    R_SKY,
    RATIO,
    REFERENCE,
    SHOT,
    UNMIX,
    Scratch,
)
from amulor.design._kernels.samples import across

__all__ = ["phase_errors"]

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
