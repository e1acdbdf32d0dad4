"""Fit of depolarization ratios: errors by dense least squares, spikes and patches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from amulor import rejection
from amulor.errors import CubeError
from amulor.rejection.channel_ratios import (
    Pair,
    Prior,
    TargetRatio,
    fit_ratio,
    fitted,
    misfit_of,
)

FREQUENCY = np.array([20e6, 50e6, 80e6])
WAVE = 2 * np.pi * FREQUENCY * 1.38 / 299792458.0
RAMP = FREQUENCY / FREQUENCY.max()
#: Water signal of the co-polarized channel [V].
HAZE: Any = 0.5 / (1 - 1j * FREQUENCY / 30e6)
PATH = (1.0, 5.0)


def pair_of(
    seed: int,
    count: int,
    *,
    water: Any = 0.1,
    target: Any = 0.3,
    noise: float = 0.0,
    stated: float = 1e-3,
) -> tuple[Pair, np.ndarray, np.ndarray]:
    """Return both channels of spots before even water; amplitudes and paths, too."""
    rng = np.random.default_rng(seed)
    path = rng.uniform(1.5, 4.5, count)
    amplitude = np.where(rng.random(count) < 0.5, 0.3, 1.0)
    echo = amplitude[:, None] * np.exp(1j * np.outer(path, WAVE))
    draws = rng.standard_normal((4, count, 3))
    co = echo + HAZE + noise * (draws[0] + 1j * draws[1])
    cross = target * echo + water * HAZE + noise * (draws[2] + 1j * draws[3])
    errors = np.full((count, 3), stated**2)
    return Pair(co, cross, errors, 4 * errors), amplitude, path


def prior_of(**changed: Any) -> Prior:
    values: dict[str, Any] = {
        "water": np.full(3, 0.1 + 0j),
        "uncertainty": 0.02,
        "spread": 0.05,
        "gain": 0.01,
        "fluctuation": 0.0,
    }
    return Prior(**values | changed)


TARGET = TargetRatio(real=0.3, imaginary=0.04, uncertainty=(0.02, 0.03), tested=True)


def fit(pair: Pair, prior: Prior, patch: Any = None, target: Any = TARGET) -> Any:
    patch = np.zeros(len(pair.co), dtype=int) if patch is None else patch
    return fit_ratio(pair, WAVE, FREQUENCY, PATH, prior, target, patch)


def test_errors_of_ratios_are_those_of_dense_least_squares() -> None:
    ratio = TARGET.at(FREQUENCY)
    pair, amplitude, path = pair_of(1, 12, target=ratio)
    prior = prior_of(fluctuation=0.004)
    found = fit(pair, prior, np.arange(12) // 3)
    # The truth is the expected state, so that the fit stays there.
    assert_allclose(found.water, 0.1, atol=1e-9)
    assert_allclose(found.gain, 1.0, atol=1e-9)
    assert found.target.real == pytest.approx(0.3)
    assert found.target.imaginary == pytest.approx(0.04)
    assert found.scale == 1.0
    assert found.fluctuation == 0.004
    assert_allclose(found.unsteady, 0.004 * np.abs(HAZE), rtol=1e-6)

    def residuals(values: np.ndarray) -> np.ndarray:
        water, gain = (values[k : k + 3] + 1j * values[k + 3 : k + 6] for k in (0, 6))
        of_target = values[12] + 1j * RAMP * values[13]
        own = values[14:].reshape(2, -1)
        echo = own[0][:, None] * np.exp(1j * np.outer(own[1], WAVE))
        rest = pair.cross - water * pair.co - gain * (of_target - water) * echo
        variance = pair.of_cross + 0.01 * (pair.of_co + (0.004 * np.abs(HAZE)) ** 2)
        whole = (rest / np.sqrt(variance)).ravel()
        return np.concatenate([whole.real, whole.imag])

    start = np.concatenate(
        [np.full(3, 0.1), np.zeros(3), np.ones(3), np.zeros(3), [0.3, 0.04]]
    )
    start = np.concatenate([start, amplitude, path])
    slopes = np.stack(
        [
            (residuals(start + unit) - residuals(start - unit)) / 2e-6
            for unit in 1e-6 * np.eye(start.size)
        ],
        axis=1,
    )
    information = slopes.T @ slopes
    # Relative to the strongest water signal, of the water's ratio there.
    expected = prior.covariance(np.full(3, 0.1), np.abs(HAZE), FREQUENCY, TARGET)
    information[:14, :14] += np.linalg.inv(expected)
    covariance = np.linalg.inv(information)
    chosen = [0, 1, 2, 3, 4, 5, 12, 13]
    assert_allclose(
        found.covariance, covariance[np.ix_(chosen, chosen)], rtol=1e-4, atol=1e-12
    )
    assert_allclose(
        found.target.uncertainty, np.sqrt(np.diag(covariance)[12:14]), rtol=1e-4
    )


@pytest.mark.parametrize("water", [0.0, 0.42, 0.94])
def test_the_ratio_of_the_water_is_found_without_an_expectation(water: float) -> None:
    pair, _, _ = pair_of(2, 60, water=water, target=0.3)
    target = TargetRatio(real=0.3, uncertainty=(0.01, 0.01), tested=True)
    found = fit(pair, prior_of(water=None, uncertainty=0.05), target=target)
    assert_allclose(found.water, water, atol=1e-3)
    assert found.target.real == pytest.approx(0.3, abs=1e-3)


def test_an_expected_ratio_is_corrected_by_the_pixels() -> None:
    pair, _, _ = pair_of(3, 60, water=0.13 + 0.01j * RAMP)
    target = TargetRatio(real=0.3, uncertainty=(1e-3, 1e-3), tested=True)
    found = fit(pair, prior_of(gain=1e-4), target=target)
    assert_allclose(found.water, 0.13 + 0.01j * RAMP, atol=2e-3)
    # A certain expectation is left as it is.
    certain = prior_of(uncertainty=1e-5, spread=1e-4, gain=1e-4)
    assert_allclose(fit(pair, certain, target=target).water.real, 0.1, atol=1e-3)


def test_noise_beyond_the_stated_enlarges_the_errors_by_its_median() -> None:
    pair, _, _ = pair_of(4, 600, noise=4e-3)
    quiet, _, _ = pair_of(4, 600)
    target = TargetRatio(real=0.3, uncertainty=(0.02, 0.03), tested=True)
    noisy, plain = (fit(part, prior_of(), target=target) for part in (pair, quiet))
    # Variances are 16 times those of both channels, 4 and 0.01 times 1e-6, over 4.01.
    factor = 16 * 1.01 / 4.01 * chi2.median(4) / 4
    assert noisy.scale == pytest.approx(factor, rel=0.1)
    assert plain.scale == 1.0
    ratio = np.diag(noisy.covariance)[:3] / np.diag(plain.covariance)[:3]
    assert (ratio > 0.6 * factor).all()
    # Spikes of some pixels are left out.
    pair.cross[::100] += 0.3
    spiked = fit(pair, prior_of(), target=target)
    assert spiked.scale == pytest.approx(noisy.scale, rel=0.05)
    assert_allclose(spiked.water, noisy.water, atol=1e-3)


def test_departures_that_a_patch_shares_enlarge_the_errors() -> None:
    target = TargetRatio(real=0.3, uncertainty=(1e-3, 1e-3), tested=True)
    patch = np.arange(320) // 20
    scores: list[float] = []
    alone: list[float] = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        departure = 0.02 * rng.standard_normal(16)[patch, None]
        # The stated errors are those of the noise in both channels.
        pair, _, _ = pair_of(seed, 320, water=0.1 + departure, noise=0.01, stated=0.007)
        prior = prior_of(uncertainty=0.1, gain=1e-5)
        for numbers, values in ((patch, scores), (np.arange(320), alone)):
            found = fit(pair, prior, numbers, target)
            error = np.sqrt(np.diag(found.covariance)[:3])
            values.append(((found.water - 0.1).real / error).mean())
    assert 0.4 < np.sqrt(np.mean(np.square(scores))) < 1.7
    assert np.mean(np.square(alone)) > 1.5 * np.mean(np.square(scores))


def test_a_path_is_searched_in_the_whole_interval() -> None:
    gain = np.array([0.3, 0.2 + 0.1j, 0.25])
    paths = np.array([0.4, 1.7, 6.2])
    difference = gain * np.exp(1j * np.outer(paths, WAVE))
    variance = np.full((3, 3), 1e-4)
    found = fitted(difference, variance, WAVE, (0.4, 6.2), gain)
    assert_allclose(found.model, difference, atol=1e-9)
    assert_allclose(found.misfit, 0.0, atol=1e-9)
    # An interval of one path is searched, too.
    single = fitted(difference[1:2], variance[1:2], WAVE, (1.7, 1.7), gain)
    assert_allclose(single.model, difference[1:2], atol=1e-9)


def test_a_scan_without_any_water_is_refused_in_words(
    by_hand: Callable[..., xr.Dataset],
) -> None:
    # 0.3 is a ratio that is tried for the water; it cancels the echo of the target.
    channels = {"VV": (1.0, 1.0), "VH": (0.3, 0.1)}
    cube = by_hand(
        frequency=list(FREQUENCY), channels=channels, shape=(8, 12), shots=0, water=0.0
    )
    with pytest.raises(CubeError, match=r"target, 0.3, and water, .* cannot separate"):
        rejection.polarization_difference(
            cube, target_ratio=0.3, target_ratio_uncertainty=0.02
        )


def test_misfits_are_squares_over_the_errors_of_the_difference() -> None:
    pair, _, _ = pair_of(5, 4)
    ratio, unsteady = 0.2, np.array([1e-3, 2e-3, 3e-3])
    gain: Any = np.full(3, 0.3 - ratio)
    found = misfit_of(pair, ratio, WAVE, PATH, gain, unsteady)
    difference = pair.cross - ratio * pair.co
    variance = 4e-6 + 0.04 * (1e-6 + unsteady**2)
    rest = fitted(difference, np.tile(variance, (4, 1)), WAVE, PATH, gain)
    expected = np.sum(np.abs(difference - rest.model) ** 2 / variance, axis=1)
    assert_allclose(found, expected)
    assert_array_equal(found > 1, True)


def test_a_certain_target_ratio_keeps_a_variance() -> None:
    certain = TargetRatio(real=0.3, uncertainty=(0.0, 0.0), tested=False)
    found = prior_of().covariance(np.full(3, 0.1), np.ones(3), FREQUENCY, certain)
    assert (np.diag(found)[-2:] > 0).all()
    assert_allclose(np.diag(found)[-2:], 0.0, atol=1e-11)
