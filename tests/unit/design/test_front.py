"""Fronts hold what no other candidate beats; the knee is where they bend."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulor.design.trade import front, knee

numbers = st.lists(
    st.tuples(st.integers(1, 8), st.integers(1, 8)), min_size=1, max_size=12
)


@given(numbers)
def test_the_front_is_what_brute_force_leaves(pairs: list[tuple[int, int]]) -> None:
    cost, error = (np.array(values, dtype=float) for values in zip(*pairs, strict=True))
    found = {(cost[k], error[k]) for k in front(cost, error)}
    left = {
        (a, b)
        for a, b in pairs
        if not any((c <= a and d <= b) and (c, d) != (a, b) for c, d in pairs)
    }
    assert found == left


def test_what_is_not_finite_is_no_candidate() -> None:
    assert front([1, 2, np.nan, 4], [np.inf, 3, 1, 2]).tolist() == [1, 3]
    assert front([], []).tolist() == []
    with pytest.raises(ValueError, match="one length"):
        front([1, 2], [1])


def test_the_knee_is_the_corner() -> None:
    # 1 / cost until 10, nothing more after that: the corner in logarithms.
    cost = np.geomspace(1, 100, 21)
    assert cost[knee(cost, np.maximum(1 / cost, 0.1) - 1e-6 * cost)] == pytest.approx(
        10
    )
    assert knee([1, 2], [2, 1]) is None
    # A straight line in logarithms bends nowhere.
    assert knee([1, 10, 100], [1, 0.1, 0.01]) is None
    # Above that line cost buys more and more.
    assert knee([1, 10, 100], [1, 0.5, 0.01]) is None
    assert knee([1, 10, 100], [1, 0.05, 0.01]) == 1
    # Neither cost nor error without a span has a knee.
    assert knee([1, 1, 1], [1, 0.1, 0.01]) is None
    assert knee([1, 2, 3], [1, 0.1, 1]) is None
