"""Errors of ranges whose readings come in turn, by times written out."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.cube import readings


def test_a_range_bends_by_half_of_its_change_of_rate_times_the_square_of_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(readings, "range_rate", lambda platform: (0.2, 0.6))
    survey: Any = SimpleNamespace(platform=object())
    # Three readings at 0, 1 and 3 s with weights of 1, 2 and 1: the mean is 1.25 s.
    lag, weight = np.array([[0.0], [1.0], [3.0]]), np.array([1.0, 2.0, 1.0])
    since = np.array([[-1.25], [-0.25], [1.75]])
    assert_allclose(readings.range_motion(lag, survey, weight), 0.2 * since)
    assert_allclose(readings.range_bend(lag, survey, weight), 0.3 * since**2)
    # A missing reading has no part in it.
    lag[2] = np.nan
    since = np.array([[-2 / 3], [1 / 3], [0.0]])
    assert_allclose(readings.range_motion(lag, survey, weight), 0.2 * since)
