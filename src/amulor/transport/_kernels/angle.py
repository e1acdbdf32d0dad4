"""Scattering angles in compiled loops: cells of an angle, drawn from and looked up.

The angle enters as height h = sin^2(angle / 2), which is even in solid angle. Cells
are even within each octave of h up to 1/2 and, from there, of 1 - h, so the cell of
a height follows from the bits of the number, without a search.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from amulor.transport._kernels.compiled import kernel
from amulor.transport._kernels.random import uniform
from amulor.transport._kernels.types import Array, States

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
    """Return the cell in which a height from 0 to 1 lies."""
    if height < 0.5:
        if height < _FORWARD_LOW:
            return 0
        return (np.float64(height).view(np.int64) >> _BITS) - _FORWARD_OFFSET
    rest = 1.0 - height
    if rest < _BACKWARD_LOW:
        return SIZE - 1
    if rest >= 0.5:  # a height of just 1/2
        return PER_OCTAVE * FORWARD_OCTAVES + 1
    return SIZE - 1 - ((np.float64(rest).view(np.int64) >> _BITS) - _BACKWARD_OFFSET)


@kernel
def draw_height(state: States, urn: Array, table: int) -> tuple[float, int]:
    """Draw a height: a cell by Walker's alias method, then evenly inside of it.

    A row of the urn holds a threshold, and lower end, width and number of two cells.
    """
    scaled = uniform(state) * urn.shape[1]
    row = int(scaled)
    first = 1 if scaled - row < urn[table, row, 0] else 4
    height = urn[table, row, first] + urn[table, row, first + 1] * uniform(state)
    return height, int(urn[table, row, first + 2])


@kernel
def height_between(cosine: float) -> float:
    """Return the height of the angle that has a cosine, within 0 to 1."""
    return min(max(0.5 * (1.0 - cosine), 0.0), 1.0)


@kernel
def disc_point(state: States, radius: float) -> tuple[float, float]:
    """Return a point drawn evenly from a disc around the origin."""
    distance = radius * math.sqrt(uniform(state))
    angle = 2.0 * math.pi * uniform(state)
    return distance * math.cos(angle), distance * math.sin(angle)
