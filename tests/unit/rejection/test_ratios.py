"""Ratios of several frequencies are weighted by their errors, and by their spread."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

from amulor import rejection
from amulor.rejection.ratios import _line, _weighted_mean

Make = Callable[..., xr.Dataset]
TWO = {"VV": (1.0, 1.0), "VH": (0.25, 0.1)}


def _leaking(cube: xr.Dataset, prefix: str, leak: Any) -> xr.Dataset:
    """Samples or shots with the same leakage in all channels."""
    leaking = cube.copy(deep=True)
    leaking[f"{prefix}in_phase"].values[:] += leak.real
    leaking[f"{prefix}quadrature"].values[:] += leak.imag
    return leaking


def test_the_mean_is_weighted_by_variances_and_its_error_grows_with_the_spread() -> (
    None
):
    errors = np.array([0.1, 0.2])  # weights 100 and 25
    # By hand: (100 + 50) / 125; spread 100 x 0.04 + 25 x 0.64 = 20 for one degree.
    mean, error = _weighted_mean(np.array([1.0, 2.0]), errors)
    assert mean == pytest.approx(1.2)
    assert error == pytest.approx(np.sqrt(20 / 125))
    # These agree, so that their error is that of the weights alone.
    mean, error = _weighted_mean(np.array([1.0, 1.1]), errors)
    assert mean == pytest.approx(1.02)
    assert error == pytest.approx(np.sqrt(1 / 125))


def test_leakage_is_in_the_error_of_the_ratio_of_targets(by_hand: Make) -> None:
    frequency = np.array([20e6, 80e6])
    cube = by_hand(frequency=list(frequency), channels=TWO)
    clean = rejection.target_ratio(cube, interval=(0.5, 3.0))
    echo = np.exp(4j * np.pi * frequency * 1.38 * 1.5 / 299792458.0)
    leak = 0.03 * np.exp(0.25j * np.pi)
    found = rejection.target_ratio(
        _leaking(cube, "", leak * echo[:, None, None, None]), interval=(0.5, 3.0)
    )
    # Channels of 1 and 0.25 with the same leakage; the part across is stated. The
    # estimated change of the water takes some of it.
    across = abs(((0.25 + leak) / (1 + leak)).imag)
    assert clean.uncertainty < across / 3
    assert 0.5 * across < found.uncertainty < 1.5 * across
    assert abs(found.value - 0.25) < 2 * found.uncertainty


def test_leakage_is_in_the_error_of_the_ratio_of_the_water(by_hand: Make) -> None:
    cube = by_hand(frequency=[20e6], channels=TWO, cut_off=1e12)
    clean = rejection.water_ratio(cube)
    # Water of 0.2 V and of 0.02 V, both of the phase 0.
    found = rejection.water_ratio(_leaking(cube, "open_water_", 0.004 + 0.004j))
    expected = (0.02 + 0.004 + 0.004j) / (0.2 + 0.004 + 0.004j)
    assert found.uncertainty == pytest.approx(abs(expected.imag), rel=0.1)
    assert clean.uncertainty < abs(expected.imag) / 3


def test_the_slope_of_a_channel_against_another() -> None:
    # Along the phase of the first channel 2.5 for 10 with a scatter of 0.01, across it
    # 0.2: the error is 0.02, and that of the mean of four pixels 0.01 / sqrt(4) / 10.
    first = np.full(4, 10.0) * np.exp(0.7j)
    off = np.array([1, -1, 1, -1]) * 0.01
    for across, error in ((0.2, 0.02), (0.0, 0.01 * np.sqrt(4 / 3) / 2 / 10)):
        second = (2.5 + off + 1j * across) * np.exp(0.7j)
        value, uncertainty, _ = _line(first, second)
        assert value == pytest.approx(0.25, rel=1e-12)
        assert uncertainty == pytest.approx(
            np.hypot(error, 0.01 * np.sqrt(4 / 3) / 20 if across else 0), rel=1e-9
        )
