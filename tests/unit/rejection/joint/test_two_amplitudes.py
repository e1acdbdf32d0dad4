"""Two amplitudes of least squares, neither below zero, against `nnls` of scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import nnls

from amulor.rejection.joint.search import _non_negative


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    return _non_negative(matrix.T @ matrix, matrix.T @ right)


@given(seed=st.integers(0, 2**32 - 1), lean=st.sampled_from([0.0, 0.5, 0.99]))
def test_they_are_those_of_the_library(seed: int, lean: float) -> None:
    rng = np.random.default_rng(seed)
    # Columns that lean on each other, in any scale, and a right side of any sign.
    matrix = rng.normal(size=(6, 2))
    matrix[:, 1] = lean * matrix[:, 0] + (1 - lean) * matrix[:, 1]
    matrix *= 10.0 ** rng.uniform(-6, 2, size=2)
    right = rng.normal(size=6)
    expected = nnls(matrix, right)[0]
    scale = 1 / np.linalg.norm(matrix, axis=0)
    assert_allclose(_solved(matrix, right) / scale, expected / scale, atol=1e-9)


@pytest.mark.parametrize(
    ("matrix", "right", "expected"),
    [
        # One surface is not seen at all.
        ([[0, 2], [0, 0]], [4, 0], [0, 2]),
        ([[2, 0], [0, 0]], [4, 0], [2, 0]),
        # Both look the same: one takes all.
        ([[1, 1], [1, 1]], [3, 3], [3, 0]),
        # Below zero alone, and together.
        ([[1, 0], [0, 1]], [-1, 2], [0, 2]),
        ([[1, 0], [0, 1]], [-1, -2], [0, 0]),
        ([[0, 0], [0, 0]], [1, 1], [0, 0]),
    ],
)
def test_what_cannot_be_told_apart_goes_to_one(
    matrix: list[list[float]], right: list[float], expected: list[float]
) -> None:
    found = _solved(np.array(matrix, dtype=float), np.array(right, dtype=float))
    assert_allclose(found, expected, atol=1e-12)
