"""Mixed beams by their amplitudes: closed form of two surfaces, noise, invariances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.constants import speed_of_light

from amulor.optics._mixed_beam import mixed_beams

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
