"""The phase between channels of a target, a witness of leakage and walk."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.stats import norm

from amulor import rejection
from amulor.cube import WaterResidualCause
from amulor.rejection import quality
from amulor.rejection.covariance import Covariance

Make = Callable[..., xr.Dataset]
TWO = {"VV": (1.0, 1.0), "VH": (0.25, 0.1)}


def _leaking(cube: xr.Dataset, leak: complex) -> xr.Dataset:
    """Samples with the same leakage in all channels."""
    leaking = cube.copy(deep=True)
    leaking["in_phase"].values[:] += leak.real
    leaking["quadrature"].values[:] += leak.imag
    return leaking


@pytest.mark.parametrize("share", [0.01, 0.03])
def test_leakage_shows_as_its_phase_between_the_channels(
    by_hand: Make, share: float
) -> None:
    frequency = np.array([20e6, 80e6])
    cube = by_hand(frequency=list(frequency), channels=TWO)
    target = rejection.open_water(_leaking(cube, share * 1j))
    clean = np.exp(4j * np.pi * frequency * 1.38 * 1.5 / 299792458.0)
    expected = np.angle((clean + share * 1j) / (0.25 * clean + share * 1j))
    # The estimated change of the water takes up to 2 mrad of it.
    found = target.attrs["channel_phase_rad"]
    assert_allclose(found, np.abs(expected), rtol=0.1, atol=2e-3)
    assert target.attrs["channel_phase_probability"] < 1e-6
    # More than 0.05 rad is no water: the whole scan is flagged.
    causes = target["water_residual_cause"].values
    large = bool(np.abs(expected).max() > 0.05)
    assert bool((causes & WaterResidualCause.INSTRUMENT).all()) == large


def test_channels_without_leakage_have_one_phase(by_hand: Make) -> None:
    for seed in range(40):
        cube = by_hand(seed, frequency=[20e6, 80e6], channels=TWO, shape=(4, 4))
        target = rejection.open_water(cube)
        assert target.attrs["channel_phase_probability"] > 1e-4
        assert "channel_phase_rad" not in target.attrs


def test_one_channel_has_nothing_to_compare(by_hand: Make) -> None:
    target = rejection.open_water(by_hand(frequency=[20e6], channels={"VV": (1, 1)}))
    assert "channel_phase_probability" not in target.attrs


def test_few_pixels_that_noise_has_chosen_are_no_witness() -> None:
    """Echoes below their noise: those that stand out have the phase of the rest."""
    rng = np.random.default_rng(3)
    shape = (1, 2, 40, 40)
    noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    # A residual of the water across the echo, which all pixels share.
    signal = 1.0 + np.array([0.0, 0.3j])[:, None, None] + 0.5 * noise
    variance = np.full(shape, 0.25)
    nothing = np.zeros(shape)
    phase = quality.channel_phase(
        signal,
        Covariance(variance, variance, nothing),
        Covariance(nothing + 1e-4, nothing + 1e-4, nothing),
        column=np.zeros(shape, dtype=complex),
        shown=np.ones(shape[2:], dtype=bool),
    )
    assert phase is None


def _phase_with_column(column: complex) -> quality.ChannelPhase | None:
    """Test of echoes with 30 mrad between the channels, and a column in the first."""
    rng = np.random.default_rng(4)
    shape = (1, 2, 20, 20)
    noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    signal = np.exp(1j * np.array([0.0, 0.03]))[:, None, None] + 1e-3 * noise
    variance = np.full(shape, 1e-6)
    behind = np.zeros(shape, dtype=complex)
    behind[:, 0] = column
    nothing = np.zeros(shape)
    return quality.channel_phase(
        signal,
        Covariance(variance, variance, nothing),
        Covariance(nothing, nothing, nothing),
        column=behind,
        shown=np.ones(shape[2:], dtype=bool),
    )


def test_a_phase_that_the_column_can_cause_is_no_witness() -> None:
    """A column of 40 mrad explains 30 mrad; one of 10 mrad does not."""
    strong, weak = _phase_with_column(0.04j), _phase_with_column(0.01j)
    assert strong is not None
    assert weak is not None
    assert strong.probability == 1
    # Median of 400 differences of 1.4 mrad: 0.09 mrad; 20 mrad are left.
    assert weak.probability < 1e-100
    assert_allclose(weak.phase, 0.03, atol=5e-4)


def test_without_a_distance_the_column_and_the_phase_are_unknown() -> None:
    assert _phase_with_column(complex("nan")) is None


@pytest.mark.parametrize(("frequencies", "channels"), [(1, 2), (3, 2), (1, 3), (2, 3)])
def test_the_chance_counts_all_pairs_and_frequencies(
    frequencies: int, channels: int
) -> None:
    shape = (frequencies, channels, 50)
    turn = np.array([0.0, 0.01, 0.0])[:channels, None]
    signal = np.exp(1j * turn) * np.ones(shape)
    variance = np.full(shape, 1e-4)
    result = quality.channel_phase(
        signal,
        Covariance(variance, variance, np.zeros(shape)),
        Covariance(variance, variance, np.zeros(shape)),
        column=np.zeros(shape, dtype=complex),
        shown=np.ones(50, dtype=bool),
    )
    assert result is not None
    assert_allclose(result.phase, 0.01)
    # Both channels have 10 mrad in common to all pixels, and 10 mrad of their own.
    error = np.sqrt(2) * 0.01 * np.hypot(1.0, 1.2533 / np.sqrt(50))
    assert_allclose(result.significance, 0.01 / error, rtol=1e-6)
    tests = frequencies * channels * (channels - 1) / 2
    chance = 2 * tests * norm.sf(0.01 / error)
    assert result.probability == pytest.approx(min(chance, 1.0))
