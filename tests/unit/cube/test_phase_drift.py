"""A phase drift by noisy readings: its estimate, and how often its interval holds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from amulor.cube.phase_drift import _WALKS, PhaseDrift, _filled, _smoothed

NOISE = 1e-3


def readings(drift: np.ndarray, seed: int, *, zero: float = 0.3) -> PhaseDrift:
    """Return the estimate from readings of 1 V with a given phase [rad]."""
    rng = np.random.default_rng(seed)
    noise = NOISE * (
        rng.standard_normal(drift.size) + 1j * rng.standard_normal(drift.size)
    )
    signal = np.exp(1j * (zero + drift)) + noise
    return PhaseDrift.of(
        signal[None, None], variance=NOISE**2, time=np.arange(drift.size)
    )


SHAPES = {
    "none": lambda t: np.zeros(t.size),
    "line": lambda t: t,
    "exponential": lambda t: 1 - np.exp(-5 * t),
    "step": lambda t: (t > 0.5).astype(float),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("size", [0.3, 3.0, 30.0])
def test_the_interval_holds_for_drifts_of_every_shape(shape: str, size: float) -> None:
    drift = size * NOISE * SHAPES[shape](np.linspace(0, 1, 20))
    inside = []
    for seed in range(60):
        result = readings(drift, seed)
        off = result.phase[0, 0] + result.zero[0, 0] - 0.3 - drift
        inside.append(np.abs(off) < 1.96 * result.uncertainty[0, 0])
    # Errors within a scan are correlated: 60 scans have about 120 independent ones, so
    # that 95 % has a standard error of 2 %. The interval may be too wide.
    assert np.mean(inside) > 0.90


def test_many_readings_of_a_steady_phase_average() -> None:
    result = readings(np.zeros(100), 1)
    # Between the error of the mean, a tenth, and that of one reading.
    assert np.all(result.uncertainty < 0.4 * NOISE)
    assert np.all(result.uncertainty > 0.1 * NOISE)


def test_samples_lose_the_drift_at_their_own_time() -> None:
    drift = 0.2 * np.linspace(0, 1, 50)
    result = readings(drift, 2)
    time = np.array([[[0.0, 24.5, 49.0]]])
    signal = np.exp(1j * 0.2 * time / 49)
    corrected = result.corrected(signal, time)
    # All at the phase in the middle of the drift, within five errors of a reading.
    assert_allclose(np.angle(corrected), 0.1, atol=5 * NOISE)
    assert_allclose(result.zero, 0.3 + 0.1, atol=5 * NOISE)
    # Half of the range on both sides, an even distribution.
    attributes = result.attributes(np.array([50e6]))
    expected = 0.2 / np.sqrt(12) / (2 * np.pi * 50e6)
    assert_allclose(attributes["instrument_drift_uncertainty_s"], expected, rtol=0.05)


def test_a_phase_goes_on_beyond_half_a_turn_and_a_gap() -> None:
    drift = np.linspace(0, 9, 60)
    signal = np.exp(1j * drift)[None, None].copy()
    signal[..., 20] = complex(np.nan, np.nan)
    result = PhaseDrift.of(signal, variance=NOISE**2, time=np.arange(60))
    assert_allclose(np.ptp(result.phase), 9, rtol=0.01)
    gap, before = result.uncertainty[0, 0, [20, 10]]
    assert gap > before


def test_one_reading_is_a_constant() -> None:
    result = readings(np.zeros(1), 4)
    assert_allclose(result.phase, 0)
    assert_allclose(result.zero, 0.3, atol=5 * NOISE)
    assert result.uncertainty[0, 0, 0] >= NOISE


def test_a_drift_is_the_average_of_random_walks_by_their_likelihood() -> None:
    # Each walk by dense covariances of its states, without a filter.
    rng = np.random.default_rng(4)
    noise = np.full(9, 2e-3) * (1 + rng.random(9))
    gap = np.array([1.0, 2, 1, 1, 5, 1, 1, 1])
    phase = 4e-3 * rng.standard_normal(9).cumsum()
    noise[4] = np.inf  # a missing reading
    seen = np.array([1, 2, 3, 5, 6, 7, 8])
    elapsed = np.concatenate([[0], gap.cumsum()])
    rates = _WALKS / 9 * np.median(np.delete(noise, 4))
    states, variances, chances = [], [], []
    for rate in rates:
        prior = noise[0] + rate * np.minimum.outer(elapsed, elapsed)
        read = prior[np.ix_(seen, seen)] + np.diag(noise[seen])
        gain = np.linalg.solve(read, prior[seen]).T
        states.append(phase[0] + gain @ (phase[seen] - phase[0]))
        variances.append(np.diag(prior - gain @ prior[seen]) + rate / 6)
        chances.append(
            multivariate_normal(np.full(7, phase[0]), read).logpdf(phase[seen])
        )
    weight = np.exp(np.array(chances) - max(chances))
    weight /= weight.sum()
    mean = weight @ np.array(states)
    variance = weight @ (np.array(variances) + (np.array(states) - mean) ** 2)
    result = _smoothed(phase, noise, elapsed)
    # The states differ between likely walks, or this would not test the last term.
    assert np.max(weight) < 0.9
    assert_allclose(result[0], mean, rtol=1e-9, atol=1e-12)
    assert_allclose(result[1], variance, rtol=1e-9)


def test_the_phase_of_the_first_reading_is_kept() -> None:
    result = readings(np.linspace(0, 0.2, 30), 3, zero=0.3)
    # A correction turns samples to `zero`; drift and zero together are the phase.
    corrected = result.corrected(
        np.exp(1j * (0.3 + np.linspace(0, 0.2, 30)))[None, None],
        np.arange(30.0)[None, None],
    )
    assert_allclose(np.angle(corrected), result.zero[0, 0], atol=4 * NOISE)
    assert_allclose(np.abs(corrected), 1.0, rtol=1e-12)
    assert_allclose(result.zero[0, 0], 0.3 + 0.1, atol=3 * NOISE)


def test_the_error_of_the_reference_is_the_root_mean_square_of_its_readings() -> None:
    # Two frequencies, two channels, two readings; 3 and 4 in squares are 5 / sqrt(2).
    errors = np.array([[[3.0, 4.0], [1.0, 1.0]], [[0.2, 0.2], [6.0, 8.0]]]) * NOISE
    drift = PhaseDrift(
        time=np.broadcast_to([0.0, 1.0], (2, 2, 2)),
        phase=np.zeros((2, 2, 2)),
        uncertainty=errors,
        zero=np.zeros((2, 2)),
    )
    attributes = drift.attributes(np.array([40e6, 50e6]))
    expected = np.array([5.0, 10.0]) * NOISE / np.sqrt(2)
    assert_allclose(attributes["reference_phase_uncertainty_rad"], expected)


def test_missing_readings_repeat_the_one_before_and_begin_with_0() -> None:
    values = np.array([[np.nan, 5.0, np.nan, 7.0], [1.0, np.nan, np.nan, 2.0]])
    filled = _filled(values, np.isnan(values))
    assert filled.tolist() == [[0.0, 5.0, 5.0, 7.0], [1.0, 1.0, 1.0, 2.0]]


@pytest.mark.parametrize("scale", [1e-3, 60.0])
def test_the_unit_of_time_does_not_matter(scale: float) -> None:
    rng = np.random.default_rng(7)
    time = np.cumsum(rng.uniform(0.5, 2.0, 30))[None]
    phase = 0.01 * rng.standard_normal((1, 30)).cumsum(axis=1)
    noise = np.full((1, 30), 1e-4)
    first, second = _smoothed(phase, noise, time), _smoothed(phase, noise, scale * time)
    assert_allclose(second, first, rtol=1e-9)
    # Channels without times have equal intervals.
    even = _smoothed(phase, noise, np.arange(30.0)[None])
    assert_allclose(_smoothed(phase, noise, np.zeros((1, 30))), even, rtol=1e-9)
