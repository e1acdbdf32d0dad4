"""Errors of ranges whose readings come in turn, by times written out."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor.cube import readings


def test_a_range_changes_by_2_cm_a_second_at_least(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    survey: Any = SimpleNamespace(platform=object())
    lag, weight = np.array([[0.0], [1.0]]), np.array([1.0, 1.0])
    for rate, expected in ((0.01, 0.02), (0.0, 0.02), (0.03, 0.03)):
        monkeypatch.setattr(
            readings, "range_rate", lambda platform, rate=rate: (rate, 0.0)
        )
        found = readings.range_motion(lag, survey, weight)
        assert_allclose(found, [[-expected / 2], [expected / 2]])


def test_pixels_have_mean_times_of_their_own() -> None:
    # Two readings of a row of three pixels; the last pixel has none.
    nan = np.nan
    lag = np.array([[[0.0, 0.0, nan]], [[2.0, nan, nan]]])
    since = readings._since(lag, np.array([3.0, 1.0]))
    assert_allclose(since, [[[-0.5, 0, 0]], [[1.5, 0, 0]]])


def test_readings_have_weights_by_the_squares_of_frequencies() -> None:
    frequency = np.array([1e6, 3e6])
    assert_allclose(readings.reading_weight(frequency), [0.1, 0.9])
    found = readings.reading_weight(frequency, channels=2)
    assert_allclose(found, [0.05, 0.45, 0.05, 0.45])


def test_lags_are_those_of_readings_that_are_there() -> None:
    survey: Any = SimpleNamespace(platform=object())
    time = np.array([[[1.0, np.nan, 4.0]], [[3.0, 5.0, 4.5]]])
    dimensions = ("modulation_frequency", "row", "column")
    cube = xr.Dataset(coords={"reading_time": (dimensions, time)})
    found = readings.lag_of(cube, survey)
    assert found is not None
    assert_allclose(found, [[[0, np.nan, 0]], [[2, 0, 0.5]]])


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
