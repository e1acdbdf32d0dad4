"""Compiled: what one candidate sees of target and water, frequency by frequency."""

from __future__ import annotations

import math

import numpy as np

from amulor._compiled import numba
from amulor.design._kernels.points import (
    DARK,
    DEPTH,
    ECHO,
    PASSED,
    RATE,
    SATURATION,
    SKY,
    Light,
    Points,
    Scratch,
)

__all__ = ["see"]

_LIGHT_SPEED = 299792458.0


@numba.njit(cache=True, error_model="numpy")
def see(p: int, points: Points, light: Light, scratch: Scratch) -> float:
    """Fill what a point sees, and return its mean output over the largest linear one.

    Signals are rates of photoelectrons; the phase is that of the delay.
    """
    x = points.number[p]
    look, reach, place = points.look[p], points.reach[p], points.place[p]
    end = light.mean.shape[1] - 1
    echo = x[ECHO] * light.overlap[look, reach]
    still = x[PASSED] * light.mean[look, reach]
    whole = x[PASSED] * light.mean[look, end]
    loudest = 0.0
    for c in range(points.target_fraction.shape[1]):
        of_target, of_water = points.target_fraction[p, c], points.water_fraction[p, c]
        scratch.laser_rate[c] = x[RATE] * (of_target * echo + of_water * still)
        scratch.open_rate[c] = x[RATE] * of_water * whole
        scratch.sky_rate[c] = x[SKY] * (0.5 if points.has_analyser[c] else 1.0)
        rate = scratch.laser_rate[c] + scratch.sky_rate[c] + x[DARK]
        loudest = max(loudest, rate)
    for k in range(points.tone.shape[1]):
        tone = points.tone[p, k]
        scratch.to_range[k] = 0.0
        if tone < 0:
            continue
        wave = 2 * math.pi * light.frequency[tone] / _LIGHT_SPEED
        scratch.to_range[k] = light.slope[place, reach] / wave
        phase = wave * light.path[place, reach]
        turn = complex(math.cos(phase), math.sin(phase))
        phase = wave * light.offset[place]
        before = complex(math.cos(phase), math.sin(phase)) * x[PASSED]
        for c in range(points.target_fraction.shape[1]):
            unit = x[RATE] * x[DEPTH]
            scratch.target[k, c] = unit * points.target_fraction[p, c] * echo * turn
            unit = unit * points.water_fraction[p, c]
            water = unit * before * light.water[0, look, reach, tone]
            column = unit * before * light.water[0, look, end, tone]
            scratch.water[k, c], scratch.open_water[k, c] = water, column
            for v in range(1, light.water.shape[0]):
                other = unit * before * light.water[v, look, reach, tone]
                scratch.change[k, c, v - 1] = (other - water) / light.step
                other = unit * before * light.water[v, look, end, tone]
                scratch.change[k, c, v + 1] = (other - column) / light.step
    return float(loudest * x[SATURATION])


@numba.njit(cache=True, error_model="numpy")
def across(value: complex, along: complex) -> float:
    """Return by what phase a small signal turns another one [rad]."""
    square = along.real * along.real + along.imag * along.imag
    if square == 0.0:
        return np.inf
    return (value.imag * along.real - value.real * along.imag) / square
