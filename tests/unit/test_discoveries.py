"""The largest p-value that counts is that of another implementation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import false_discovery_control

from amulor._discoveries import largest_discovered


@given(
    seed=st.integers(0, 2**32 - 1),
    effects=st.integers(0, 20),
    share=st.sampled_from([0.05, 0.1, 0.5]),
)
def test_discoveries_are_those_of_scipy(seed: int, effects: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    chance = rng.random(60)
    chance[:effects] **= 8
    found = chance <= largest_discovered(chance, share=share)
    assert (found == (false_discovery_control(chance) <= share)).all()


def test_tests_that_are_not_handed_over_count() -> None:
    chance = np.array([0.001, 0.012, np.nan, 0.03])
    assert largest_discovered(chance, share=0.05) == 0.03
    # 0.001 < 0.05 / 20, and 0.012 > 0.05 * 2 / 20.
    assert largest_discovered(chance, share=0.05, tests=20) == 0.001
    assert largest_discovered(chance, share=0.05, tests=100) < 0


@pytest.mark.parametrize("chance", [np.array([]), np.array([np.nan]), np.ones(5)])
def test_nothing_is_discovered_where_there_is_nothing(chance: np.ndarray) -> None:
    assert not (np.zeros(3) <= largest_discovered(chance, share=0.1)).any()


def test_a_chance_of_just_its_share_is_a_discovery() -> None:
    # 0.25 of 2 tests: 0.125 and 0.25 are exact.
    assert largest_discovered(np.array([0.125, 0.75]), share=0.25) == 0.125
    assert largest_discovered(np.array([0.1251, 0.75]), share=0.25) == -1.0
    assert largest_discovered(np.array([0.2, 0.25]), share=0.25) == 0.25
