"""The random numbers are those that their authors publish."""

from __future__ import annotations

import numpy as np
import pytest

from amulor.transport._kernels import sampling as kernels
from amulor.transport._runs import random_state

# First outputs of the authors' C program xoshiro256plusplus.c (Blackman, Vigna,
# doi:10.1145/3460772) from the state 1, 2, 3, 4. The first two follow by hand:
# 5 x 2^23 + 1 and 7 x 2^23 + 103.
PUBLISHED = (
    41943041, 58720359, 3588806011781223, 3591011842654386, 9228616714210784205,
    9973669472204895162, 14011001112246962877, 12406186145184390807,
    15849039046786891736, 10450023813501588000,
)  # fmt: skip


@pytest.fixture
def state():
    return np.array([1, 2, 3, 4], dtype=np.uint64)


def test_the_generator_gives_the_published_numbers(state):
    found = [int(kernels.next_integer(state)) for _ in PUBLISHED]
    assert found == list(PUBLISHED)


def test_the_uncompiled_generator_gives_them_too(state):
    with np.errstate(over="ignore"):  # words of 64 bits wrap round on purpose
        found = [int(kernels.next_integer.py_func(state)) for _ in PUBLISHED]
    assert found == list(PUBLISHED)


def test_uniform_numbers_are_the_upper_53_bits(state):
    expected = np.array([(value >> 11) / 2**53 for value in PUBLISHED])
    out = np.empty(len(PUBLISHED))
    kernels.fill_uniform(state, out)
    np.testing.assert_array_equal(out, expected)


def test_uniform_and_exponential_numbers_have_their_moments():
    state = random_state(5, 0)
    out = np.empty(400_000)
    kernels.fill_uniform(state, out)
    assert out.min() >= 0
    assert out.max() < 1
    # Mean 1/2 and variance 1/12, with errors of sqrt(1/12) and sqrt(1/180) per draw.
    assert abs(out.mean() - 1 / 2) < 4 * np.sqrt(1 / 12 / out.size)
    assert abs(out.var() - 1 / 12) < 4 * np.sqrt(1 / 180 / out.size)
    drawn = np.array([kernels.exponential(state) for _ in range(20_000)])
    assert drawn.min() >= 0
    assert abs(drawn.mean() - 1) < 4 / np.sqrt(drawn.size)


def test_batches_and_seeds_have_states_of_their_own():
    states = {random_state(s, n).tobytes() for s in range(20) for n in range(20)}
    assert len(states) == 400
    assert random_state(3, 7).tobytes() == random_state(3, 7).tobytes()
