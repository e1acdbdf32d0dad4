"""Range profile of a sweep, and number and ranges of surfaces along a beam."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor.optics import range_profile

INDEX = 1.38
SWEEP = np.arange(100e6, 1e9 + 1, 20e6)
WAVE = 4 * np.pi * SWEEP * INDEX / speed_of_light


def samples(
    place: list[float], amplitude: list[float], *, noise: float, seed: int
) -> np.ndarray:
    """Return samples of surfaces with noise of both outputs."""
    draws = np.random.default_rng(seed).normal(0, noise, (2, SWEEP.size))
    echoes = np.exp(1j * np.outer(WAVE, place)) @ np.array(amplitude, complex)
    return np.asarray(echoes + draws[0] + 1j * draws[1])


def estimate(signal: np.ndarray, noise: float, **options: object):
    """Fit surfaces between 0.5 and 4 m."""
    return range_profile.surfaces(
        signal,
        standard_uncertainty=np.full(SWEEP.size, noise),
        modulation_frequency=SWEEP,
        group_index=INDEX,
        **{"interval": (0.5, 4.0), **options},
    )


def test_resolution_and_span_of_a_radar_text_book() -> None:
    # v / 2 B and v / 2 df, with v = c / 1.38, B = 900 MHz and df = 20 MHz.
    of = {"modulation_frequency": SWEEP, "group_index": INDEX}
    assert range_profile.resolution(**of) == pytest.approx(0.12069, rel=1e-4)
    assert range_profile.unambiguous_span(**of) == pytest.approx(5.4310, rel=1e-4)


def test_the_profile_of_one_surface_is_a_dirichlet_kernel() -> None:
    place = np.linspace(1.5, 2.5, 201)
    profile, error = range_profile.range_profile(
        samples([2.0], [0.7], noise=0.0, seed=1),
        standard_uncertainty=np.full(SWEEP.size, 0.1),
        modulation_frequency=SWEEP,
        group_index=INDEX,
        slant_range=place,
    )
    count, half = SWEEP.size, (WAVE[1] - WAVE[0]) * (2.0 - place) / 2
    kernel = np.divide(
        np.sin(count * half), count * np.sin(half), out=np.ones(201), where=half != 0
    )
    assert_allclose(np.abs(profile), 0.7 * np.abs(kernel), atol=1e-12)
    assert_allclose(profile[100], 0.7, atol=1e-12)
    assert_allclose(error, 0.1 / np.sqrt(count))


def test_weights_and_irregular_sweeps_keep_the_amplitude() -> None:
    rng = np.random.default_rng(3)
    sweep = np.sort(rng.uniform(100e6, 1e9, 40))
    signal = 0.4 * np.exp(1.7j * 4 * np.pi * sweep * INDEX / speed_of_light)
    weight, error = np.hanning(42)[1:-1], rng.uniform(0.1, 0.2, (40, 5))
    profile, stated = range_profile.range_profile(
        np.repeat(signal[:, None], 5, axis=1),
        standard_uncertainty=error,
        modulation_frequency=sweep,
        group_index=INDEX,
        slant_range=[1.7],
        weight=weight,
    )
    assert_allclose(profile, np.full((1, 5), 0.4), atol=1e-12)
    draws = rng.normal(size=(4000, 40, 1)) * error
    scatter = np.tensordot(weight / weight.sum(), draws, axes=(0, 1)).std(axis=0)
    # The deviation of 4,000 draws has an error of 1.1 %.
    assert_allclose(stated, scatter, rtol=0.06)


def test_the_error_of_a_single_range_is_the_cramer_rao_bound() -> None:
    fitted = estimate(samples([2.0], [0.5], noise=0.02, seed=2), 0.02)
    # For a known phase: sigma / (a sqrt(sum k^2)).
    bound = 0.02 / (0.5 * np.sqrt((WAVE**2).sum()))
    assert fitted.uncertainty == pytest.approx([bound], rel=0.05)
    assert abs(fitted.slant_range[0] - 2.0) < 4 * bound


def test_three_surfaces_12_cm_apart_are_resolved_with_their_errors() -> None:
    place, amplitude = np.array([1.76, 1.88, 2.0]), [0.5, 0.6, 1.0]
    scores, counts = [], []
    for seed in range(20):
        fitted = estimate(samples(list(place), amplitude, noise=0.05, seed=seed), 0.05)
        counts.append(fitted.slant_range.size)
        if counts[-1] == 3:
            scores.append((fitted.slant_range - place) / fitted.uncertainty)
    assert np.sum(np.array(counts) == 3) >= 18
    # At most 60 scores: 95 +- 2.8 %.
    assert np.mean(np.abs(scores) < 1.96) > 0.86
    assert 0.75 < np.sqrt(np.mean(np.square(scores))) < 1.25


def test_noise_makes_a_surface_as_rarely_as_stated() -> None:
    false = [
        estimate(samples([2.0], [1.0], noise=0.1, seed=seed), 0.1, error_rate=0.1)
        for seed in range(150)
    ]
    share = np.mean([fitted.slant_range.size > 1 for fitted in false])
    # 10 % of 150 with three deviations of a binomial count; a bound, so less is fine.
    assert 0.01 < share < 0.1 + 3 * np.sqrt(0.1 * 0.9 / 150)


def test_a_water_signal_of_unknown_strength_is_no_surface() -> None:
    water = 1.0 / (1 - 1j * SWEEP / 30e6)
    signal = samples([2.0], [0.2], noise=0.01, seed=5) + 0.8 * water
    fitted = estimate(signal, 0.01, water_signal=water)
    assert_allclose(fitted.slant_range, [2.0], atol=4 * fitted.uncertainty[0])
    assert estimate(signal, 0.01).slant_range.size > 1


def test_no_surface_in_noise() -> None:
    fitted = estimate(samples([2.0], [0.0], noise=0.1, seed=4), 0.1)
    assert fitted.slant_range.size == 0
    assert fitted.covariance.shape == (0, 0)
    # 2 x 46 outputs.
    assert abs(fitted.misfit - 92) < 4 * np.sqrt(2 * 92)
    assert fitted.probability[0] > 0.01


def test_wrong_arguments_are_refused() -> None:
    signal = samples([2.0], [1.0], noise=0.1, seed=1)
    with pytest.raises(ValueError, match="at least two different"):
        range_profile.resolution(modulation_frequency=[1e8, 1e8], group_index=INDEX)
    with pytest.raises(ValueError, match="one row for each of the 46"):
        estimate(signal[:3], 0.1)
    with pytest.raises(ValueError, match="two increasing"):
        estimate(signal, 0.1, interval=(2.0, 1.0))
    with pytest.raises(ValueError, match="positive sum"):
        range_profile.range_profile(
            signal,
            standard_uncertainty=np.ones(SWEEP.size),
            modulation_frequency=SWEEP,
            group_index=INDEX,
            slant_range=[2.0],
            weight=np.zeros(SWEEP.size),
        )
