"""Random numbers inside of compiled loops: the generator xoshiro256++.

Blackman and Vigna, ACM Trans. Math. Softw. 47, 36 (2021), doi:10.1145/3460772. A
`numpy.random.Generator` can be called from compiled code too, at several times the
cost (docs/decisions/0006). Each batch of histories has a state of its own, drawn from a
`numpy.random.SeedSequence`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from amulor.transport._kernels.compiled import kernel
from amulor.transport._kernels.types import Array, States

_PER_UNIT = 2.0**-53


@kernel
def next_integer(state: States) -> Any:
    """Return 64 random bits, and move the state of four such words on."""
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
    """Return a number from 0 to 1, 1 left out."""
    return float(next_integer(state) >> np.uint64(11)) * _PER_UNIT


@kernel
def exponential(state: States) -> float:
    """Return a number above or at 0, distributed as exp(-x)."""
    return -math.log(1.0 - uniform(state))


@kernel
def fill_uniform(state: States, out: Array) -> None:
    """Fill out with numbers from 0 to 1."""
    for k in range(out.size):
        out[k] = uniform(state)
