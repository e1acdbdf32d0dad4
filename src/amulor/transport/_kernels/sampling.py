"""Compiled generator of random numbers and random scattering angles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from amulor.transport._kernels.types import Array, States, kernel

_PER_UNIT = 2.0**-53


@kernel
def next_integer(state: States) -> Any:
    """Return 64 random bits (xoshiro256++), and advance the generator's state."""
    total = state[0] + state[3]
    value = ((total << np.uint64(23)) | (total >> np.uint64(41))) + state[0]
    shifted = state[1] << np.uint64(17)
    state[2] ^= state[0]
    state[3] ^= state[1]
    state[1] ^= state[2]
    state[0] ^= state[3]
    state[2] ^= shifted
    state[3] = (state[3] << np.uint64(45)) | (state[3] >> np.uint64(19))
    return value


@kernel
def uniform(state: States) -> float:
    """Return a uniformly distributed random number in [0, 1)."""
    return float(next_integer(state) >> np.uint64(11)) * _PER_UNIT


@kernel
def exponential(state: States) -> float:
    """Return an exponentially distributed random number with a mean of 1."""
    return -math.log(1.0 - uniform(state))


@kernel
def fill_uniform(state: States, out: Array) -> None:
    """Fill `out` with uniformly distributed random numbers in [0, 1)."""
    for k in range(out.size):
        out[k] = uniform(state)


#: Cells in an octave, and octaves of h below 1/2 and of 1 - h below 1/2.
PER_OCTAVE = 128
FORWARD_OCTAVES = 39
BACKWARD_OCTAVES = 27
SIZE = PER_OCTAVE * (FORWARD_OCTAVES + BACKWARD_OCTAVES) + 2

_BITS = 52 - 7  # 2**7 cells in an octave
_FORWARD_LOW = 2.0 ** -(FORWARD_OCTAVES + 1)
_BACKWARD_LOW = 2.0 ** -(BACKWARD_OCTAVES + 1)
_FORWARD_OFFSET = (1023 - FORWARD_OCTAVES - 1) * PER_OCTAVE - 1
_BACKWARD_OFFSET = (1023 - BACKWARD_OCTAVES - 1) * PER_OCTAVE - 1


@kernel
def cell_of(height: float) -> Any:
    """Return the index of the angle cell that contains a given sin^2(angle / 2)."""
    if height < 0.5:
        if height < _FORWARD_LOW:
            return 0
        return (np.float64(height).view(np.int64) >> _BITS) - _FORWARD_OFFSET
    above = 1.0 - height
    if above < _BACKWARD_LOW:
        return SIZE - 1
    if above >= 0.5:  # a height of just 1/2
        return PER_OCTAVE * FORWARD_OCTAVES + 1
    return SIZE - 1 - ((np.float64(above).view(np.int64) >> _BITS) - _BACKWARD_OFFSET)


@kernel
def draw_height(state: States, urn: Array, table: int) -> tuple[float, int]:
    """Draw sin^2(angle / 2) of a random scattering angle; return it with its cell.

    A row of the urn holds a threshold, and lower end, width and number of two cells.
    """
    scaled = uniform(state) * urn.shape[1]
    row = int(scaled)
    first = 1 if scaled - row < urn[table, row, 0] else 4
    height = urn[table, row, first] + urn[table, row, first + 1] * uniform(state)
    return height, int(urn[table, row, first + 2])


@kernel
def height_between(cosine: float) -> float:
    """Return sin^2(angle / 2) for a given cos(angle), limited to 0..1."""
    return min(max(0.5 * (1.0 - cosine), 0.0), 1.0)


@kernel
def disc_point(state: States, radius: float) -> tuple[float, float]:
    """Draw a uniformly distributed random point in a disc around the origin."""
    distance = radius * math.sqrt(uniform(state))
    angle = 2.0 * math.pi * uniform(state)
    return distance * math.cos(angle), distance * math.sin(angle)
