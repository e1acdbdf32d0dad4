"""Mixed beams by their amplitudes: closed form of two surfaces, noise, invariances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.constants import speed_of_light

from amulor.optics._mixed_beam import SpreadFit, mixed_beams

FREQUENCY = np.array([10e6, 35e6, 80e6, 146e6])
WAVE = 4 * np.pi * FREQUENCY * 1.38 / speed_of_light
SHAPE = (20, 30)
NOISE = 1e-3


def signal_of(distance: float, behind: float, share: np.ndarray) -> np.ndarray:
    """Return echoes whose share of the light meets a surface nearer by `behind`."""
    wave = WAVE[:, None, None]
    far, near = (np.exp(1j * wave * z) for z in (distance, distance - behind))
    return share * near + (1 - share) * far


def run(signal: np.ndarray, distance: np.ndarray, *, seed: int = 1, **options: object):
    """Test noisy amplitudes."""
    rng = np.random.default_rng(seed)
    amplitude = np.abs(signal) * (1 + NOISE * rng.standard_normal(signal.shape))
    return mixed_beams(
        amplitude,
        np.full(signal.shape, NOISE),
        phase_per_range=WAVE[: len(signal)],
        slant_range=distance,
        uncertainty=np.full(SHAPE, 1e-3),
        **options,
    )


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_two_surfaces_have_the_spread_of_two_masses(share: float) -> None:
    part = np.zeros(SHAPE)
    part[::4] = share
    mixed, spread, _ = run(signal_of(2.0, 0.08, part), np.full(SHAPE, 2.0))
    np.testing.assert_array_equal(mixed, part > 0)
    # Variance of two masses. The next order of the logarithm is below 5 % here.
    expected = 0.08 * np.sqrt(share * (1 - share))
    assert np.median(spread[mixed]) == pytest.approx(expected, rel=0.05)


def test_noise_water_and_gains_make_no_mixed_beam() -> None:
    rng = np.random.default_rng(2)
    distance = 2.0 + 0.4 * rng.random(SHAPE)
    # Spots, a gain for each frequency, and a low pass that grows with the distance.
    reflectance = np.where(rng.random(SHAPE) < 0.5, 0.1, 0.3)
    gains = np.array([1.0, 0.8, 1.3, 0.5])[:, None, None]
    fall = np.exp(-1e-3 * WAVE[:, None, None] ** 2 * distance)
    for seed in range(5):
        mixed, _, fit = run(reflectance * gains * fall + 0j, distance, seed=seed)
        assert fit is not None
        assert not mixed.any()


def test_rows_are_tested_with_the_fit_of_the_scan() -> None:
    part = np.zeros(SHAPE)
    part[5] = 0.5
    signal, distance = signal_of(2.0, 0.1, part), np.full(SHAPE, 2.0)
    mixed, _, fit = run(signal, distance)
    again, _, _ = mixed_beams(
        np.abs(signal[:, 5:6]),
        np.full((4, 1, SHAPE[1]), NOISE),
        phase_per_range=WAVE,
        slant_range=distance[5:6],
        uncertainty=np.full((1, SHAPE[1]), 1e-3),
        fit=fit,
    )
    assert mixed[5].all()
    assert again.all()


def test_untested_pixels_are_not_mixed() -> None:
    part = np.full(SHAPE, 0.0)
    part[5] = 0.5
    distance = np.full(SHAPE, 2.0)
    distance[5, :10] = np.nan
    mixed, _, _ = run(signal_of(2.0, 0.1, part), distance)
    assert mixed.sum() == SHAPE[1] - 10
    nothing, _, fit = run(signal_of(2.0, 0.1, part)[:1], distance)
    assert fit is None
    assert not nothing.any()


def spread_fit(scale: float = 1.0) -> SpreadFit:
    """Return a fit of two frequencies, whose terms are 2 and -2."""
    return SpreadFit(
        terms=np.array([2.0, -2.0]), middle=1.5, typical=(0.1, 0.4), scale=scale
    )


@pytest.mark.parametrize("scale", [1.0, 3.0])
@pytest.mark.parametrize(("share", "expected"), [(0.98, False), (1.02, True)])
def test_a_mixed_beam_exceeds_five_standard_errors(
    scale: float, share: float, expected: bool
) -> None:
    # Of both terms and errors, with 0.3 % of gain each: sqrt(8) times the error.
    deviation = np.sqrt(8) * np.hypot(0.04, 3e-3)
    place = 2.0
    typical = 0.1 + 0.4 * (place - 1.5)
    excess = share * 5 * scale * deviation
    amplitude = np.exp([(typical + excess) / 2, 0.0])[:, None, None]
    mixed, spread, _ = mixed_beams(
        amplitude,
        np.full((2, 1, 1), 0.04),
        phase_per_range=np.array([1.0, 2.0]),
        slant_range=np.array([[place]]),
        uncertainty=np.array([[1e-3]]),
        fit=spread_fit(scale),
    )
    assert mixed.item() is expected
    assert spread.item() == pytest.approx(np.sqrt(excess))


@pytest.mark.parametrize(("uncertainty", "expected"), [(0.49, True), (0.51, False)])
def test_a_spread_below_two_uncertainties_does_not_matter(
    uncertainty: float, expected: bool
) -> None:
    amplitude = np.exp([(0.1 + 1.0) / 2, 0.0])[:, None, None]
    mixed, _, _ = mixed_beams(
        amplitude,
        np.full((2, 1, 1), 1e-3),
        phase_per_range=np.array([1.0, 2.0]),
        slant_range=np.array([[1.5]]),
        uncertainty=np.array([[uncertainty]]),
        fit=spread_fit(),
    )
    assert mixed.item() is expected


def test_the_typical_fall_is_that_of_the_amplitudes() -> None:
    rng = np.random.default_rng(4)
    distance = 2.0 + 0.4 * rng.random((6, 5))
    variance = 2e-3 + 5e-3 * (distance - np.median(distance))
    amplitude = np.exp(-(WAVE[:, None, None] ** 2) * variance / 2)
    error = np.broadcast_to(
        np.array([1e-3, 2e-3, 4e-3, 1e-3])[:, None, None], amplitude.shape
    )
    options = {"phase_per_range": WAVE, "uncertainty": np.full((6, 5), 1e-3)}
    mixed, spread, fit = mixed_beams(amplitude, error, slant_range=distance, **options)
    assert fit is not None
    assert fit.middle == np.median(distance)
    np.testing.assert_allclose(fit.typical, (2e-3, 5e-3), rtol=1e-3)
    np.testing.assert_allclose(fit.terms.sum(), 0, atol=1e-12)
    np.testing.assert_allclose(fit.terms @ (-(WAVE**2) / 2), 1, rtol=1e-12)
    # The weights are those of the errors: noise has the least variance.
    precision = 1 / (np.array([1e-3, 2e-3, 4e-3, 1e-3]) ** 2 + 3e-3**2)
    fall = -(WAVE**2) / 2 - np.average(-(WAVE**2) / 2, weights=precision)
    np.testing.assert_allclose(fit.terms, precision * fall / (precision @ fall**2))
    assert fit.scale == 1.0
    assert not mixed.any()
    np.testing.assert_allclose(spread, 0, atol=1e-3)
    # One pixel less is too few.
    distance[0, 0] = np.nan
    assert mixed_beams(amplitude, error, slant_range=distance, **options)[2] is None


def test_scatter_beyond_the_stated_errors_widens_the_limit() -> None:
    rng = np.random.default_rng(5)
    noise = 0.05 * rng.standard_normal((4, 40, 40))
    _, _, fit = mixed_beams(
        np.exp(noise),
        np.full(noise.shape, 0.01),
        phase_per_range=WAVE,
        slant_range=np.full((40, 40), 2.0),
        uncertainty=np.full((40, 40), 1e-3),
    )
    assert fit is not None
    # The 0.16 quantile is 0.994 standard deviations below the median.
    assert fit.scale == pytest.approx(0.994 * 0.05 / np.hypot(0.01, 3e-3), rel=0.15)
