"""The drift of the instrument that references around a scan show."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor import imaging, rejection
from amulor.rejection.reference.instrument import (
    _halves,
    drift_of_references,
    without_drift,
)

Make = Callable[..., xr.Dataset]
TWO = {"VV": (1.0, 1.0), "VH": (0.25, 0.1)}
FREQUENCIES = np.array([20e6, 80e6])


def _turn(cube: xr.Dataset, prefix: str, phase: np.ndarray) -> None:
    """Turn outputs of a cube in place."""
    real, imaginary = (cube[f"{prefix}{part}"] for part in ("in_phase", "quadrature"))
    signal = (real.values + 1j * imaginary.values) * np.exp(1j * phase)
    real.values[:], imaginary.values[:] = signal.real, signal.imag


def _drifted(cube: xr.Dataset, phase: np.ndarray) -> xr.Dataset:
    """Samples half way of a drift, the first half of the shots before it."""
    drifted = cube.copy(deep=True)
    shots = drifted.sizes["shot"]
    late = np.arange(shots) >= shots // 2
    _turn(drifted, "", phase[:, None, None, None] / 2)
    _turn(drifted, "open_water_", phase[:, None, None] * late)
    return drifted


@pytest.mark.parametrize(
    "phase",
    [2 * np.pi * FREQUENCIES * 200e-12, np.radians([2.0, 2.0])],
    ids=["delay", "phase"],
)
def test_a_rotation_of_all_channels_is_removed(
    by_hand: Make, phase: np.ndarray
) -> None:
    cube = by_hand(frequency=list(FREQUENCIES), channels=TWO, water=1.0)
    corrected = without_drift(_drifted(cube, phase))
    drift = drift_of_references(_drifted(cube, phase))
    assert drift is not None
    assert np.all(np.abs(drift.phase - phase) < 4 * drift.uncertainty)
    off = np.angle(corrected.amulor.signal.values / cube.amulor.signal.values)
    assert_allclose(off.mean(axis=(1, 2, 3)), (phase - drift.phase) / 2, atol=1e-9)
    # Even over the drift, and half of the error of the drift.
    expected = np.hypot(drift.phase / 12**0.5, drift.uncertainty / 2)
    assert_allclose(
        2 * np.pi * FREQUENCIES * corrected.attrs["instrument_drift_uncertainty_s"],
        expected,
    )
    assert drift_of_references(corrected) is None
    assert without_drift(corrected) is corrected


def test_lost_shots_do_not_hide_a_drift(by_hand: Make) -> None:
    phase = np.full(FREQUENCIES.size, 0.02)
    cube = by_hand(frequency=list(FREQUENCIES), channels=TWO, water=1.0)
    drifted = _drifted(cube, phase)
    for part in ("in_phase", "quadrature"):
        drifted[f"open_water_{part}"][0, 1, [0, -1]] = np.nan
    drift = drift_of_references(drifted)
    assert drift is not None
    assert np.all(np.abs(drift.phase - phase) < 4 * drift.uncertainty)


def test_water_that_becomes_stronger_is_no_drift_of_the_instrument(
    by_hand: Make,
) -> None:
    cube = by_hand(frequency=list(FREQUENCIES), channels=TWO, water=1.0, drift=0.1)
    assert drift_of_references(cube) is None
    assert without_drift(cube) is cube


def test_a_rotation_of_one_channel_is_no_drift_of_the_instrument(
    by_hand: Make,
) -> None:
    cube = by_hand(frequency=list(FREQUENCIES), channels=TWO, water=1.0)
    shots = cube.sizes["shot"]
    late = np.arange(shots) >= shots // 2
    phase = np.radians(5.0) * late * np.array([1.0, 0.0])[:, None] * np.ones((2, 1, 1))
    _turn(cube, "open_water_", phase)
    assert drift_of_references(cube) is None


def test_steady_instruments_are_left_alone(by_hand: Make) -> None:
    cube = by_hand(frequency=list(FREQUENCIES), channels=TWO, water=1.0, noise=0.0)
    rng = np.random.default_rng(1)
    shape = cube["open_water_in_phase"].shape
    alarms = 0
    for _ in range(300):
        noisy = cube.copy()
        for part in ("in_phase", "quadrature"):
            name = f"open_water_{part}"
            noise = 0.02 * rng.standard_normal(shape)
            noisy[name] = cube[name].copy(data=cube[name].values + noise)
        alarms += drift_of_references(noisy) is not None
    assert alarms == 0


def test_what_is_left_of_a_drift_is_in_the_range(by_hand: Make) -> None:
    delay = 1e-9
    cube = by_hand(frequency=[20e6], channels=TWO, water=1.0)
    phase = 2 * np.pi * np.array([20e6]) * delay
    image = imaging.range_image(
        rejection.open_water(_drifted(cube, phase)),
        polarization="VV",
        interval=(0.5, 3.0),
    )
    term = image["slant_range_uncertainty_instrument"].values
    expected = speed_of_light / (2 * 1.38) * delay / 12**0.5
    assert_allclose(term, expected, rtol=0.02)
    common = image["slant_range_common_uncertainty"].values
    assert np.all(common >= term)
    steady = imaging.range_image(
        rejection.open_water(cube), polarization="VV", interval=(0.5, 3.0)
    )
    assert "slant_range_uncertainty_instrument" not in steady
    off = image["slant_range"].values - steady["slant_range"].values
    assert abs(np.mean(off)) < 0.1 * expected


def test_the_halves_of_references_differ_by_their_change_and_its_error() -> None:
    # Two groups of 3 + 3 and 2 + 4 references, and a missing one; (frequency, channel).
    early = np.array([1, 1, 1, 2, 2, 2], complex)
    late = np.array([1.1, 1.1, 1.1, 2.2, 2.2, 2.2], complex)
    group = np.array([0, 0, 0, 1, 1, 1, 0, 0, 0, 1, 1, 1])
    noise = 1j * 1e-3 * np.array([1, -1, 0, 2, -2, 0] * 2)
    signal = (np.concatenate([early, late]) + noise).reshape(1, 1, 12)
    change, error = _halves(signal, group)
    # Over the mean of both levels: 0.1 / 1.05 in each group.
    assert_allclose(change, 0.1 / 1.05)
    # Squares of phases: 4 x 1e-6 / 1.05^2 and 4 x 4e-6 / 2.1^2, equal; 8 degrees of
    # freedom are left, and two groups of 3 x 3 / 6 references.
    square = 4e-6 / 1.05**2 * 2
    assert_allclose(error, np.sqrt(square / 8 / 3.0))
    missing = signal.copy()
    missing[..., 11] = np.nan
    assert_allclose(_halves(missing, group)[0], 0.1 / 1.05, rtol=1e-3)
    # Fewer than four degrees of freedom, no error, or no light tell nothing.
    assert _halves(signal[..., [0, 1, 2, 6, 7]], group[[0, 1, 2, 6, 7]]) == (None, None)
    assert _halves(signal.real + 0j, group) == (None, None)
    assert _halves(0 * signal, group) == (None, None)
