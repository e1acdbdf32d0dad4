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


def test_two_readings_have_one_interval_in_any_unit_of_time() -> None:
    phase, noise = np.array([[0.0, 3e-3]]), np.full((1, 2), 1e-6)
    first = _smoothed(phase, noise, np.array([[5.0, 6.0]]))
    for gap in (0.0, 1e-3, 60.0):
        found = _smoothed(phase, noise, np.array([[5.0, 5.0 + gap]]))
        assert_allclose(found, first, rtol=1e-9)


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


def test_readings_may_come_in_any_order_with_errors_of_their_own() -> None:
    rng = np.random.default_rng(11)
    time = np.array([0.0, 1.0, 1.5, 4.0, 7.0])
    signal = rng.uniform(1, 2, 5) * np.exp(0.1j * rng.standard_normal(5))
    variance = rng.uniform(1e-4, 4e-3, 5)
    order = np.array([3, 0, 4, 2, 1])
    sorted_one, mixed = (
        PhaseDrift.of(signal[None, None, n], variance=variance[n], time=time[n])
        for n in (np.arange(5), order)
    )
    assert mixed.time.tolist() == [[time.tolist()]]
    for name in ("phase", "uncertainty", "zero"):
        assert_allclose(getattr(mixed, name), getattr(sorted_one, name), rtol=1e-12)
    # The same ratios of noise to signal are the same errors of the phase.
    louder = PhaseDrift.of(3 * signal[None, None], variance=9 * variance, time=time)
    assert_allclose(louder.uncertainty, sorted_one.uncertainty, rtol=1e-12)
    # Errors of the phase are those of the signal over its amplitude.
    noise = variance / np.abs(signal) ** 2
    mean = np.angle(signal.sum())
    phase, square = _smoothed(np.angle(signal) - mean, noise, time)
    level = (phase.min() + phase.max()) / 2
    assert_allclose(sorted_one.phase[0, 0], phase - level, atol=1e-12)
    assert_allclose(sorted_one.uncertainty[0, 0], np.sqrt(square), rtol=1e-12)
    assert_allclose(sorted_one.zero, mean + level, rtol=1e-12)


@pytest.mark.parametrize("gap", [0, np.nan, complex(np.nan, 1)])
def test_a_reading_of_zero_is_missing(gap: complex) -> None:
    time = np.arange(5.0)
    signal = np.exp(1j * np.array([0.1, 0.2, 0.0, 0.2, 0.3]))
    with_gap = signal.copy()
    with_gap[2] = gap
    found = PhaseDrift.of(with_gap[None, None], variance=1e-6, time=time)
    noise = np.array([1e-6, 1e-6, np.inf, 1e-6, 1e-6])
    mean = np.angle(np.delete(signal, 2).sum())
    read = np.array([0.1, 0.2, 0.2, 0.2, 0.3]) - mean
    phase, square = _smoothed(read, noise, time)
    assert_allclose(found.phase[0, 0] - found.phase[0, 0, 0], phase - phase[0],
                    atol=1e-12)  # fmt: skip
    assert_allclose(found.uncertainty[0, 0], np.sqrt(square), rtol=1e-9)


def test_an_unknown_first_phase_has_a_standard_error_of_ten() -> None:
    # Readings with errors as large as that, of which the first is missing.
    noise = np.array([np.inf, 40.0, 60.0])
    phase, time = np.array([0.0, 5.0, -3.0]), np.array([0.0, 1.0, 3.0])
    elapsed = np.array([0.0, 1.0, 3.0]) / 1.5
    states, variances, chances = [], [], []
    for rate in _WALKS / 3 * 50:
        prior = 100 + rate * np.minimum.outer(elapsed, elapsed)
        read = prior[1:, 1:] + np.diag(noise[1:])
        gain = np.linalg.solve(read, prior[1:]).T
        states.append(gain @ phase[1:])
        variances.append(np.diag(prior - gain @ prior[1:]) + rate / 6)
        chances.append(multivariate_normal(np.zeros(2), read).logpdf(phase[1:]))
    weight = np.exp(np.array(chances) - max(chances))
    weight /= weight.sum()
    mean = weight @ np.array(states)
    variance = weight @ (np.array(variances) + (np.array(states) - mean) ** 2)
    found = _smoothed(phase, noise, time)
    assert_allclose(found[0], mean, rtol=1e-9)
    assert_allclose(found[1], variance, rtol=1e-9)


def test_walks_reach_from_less_than_a_reading_to_all_turns() -> None:
    assert_allclose(_WALKS[[0, -1]], [0.0316228, 1e7], rtol=1e-6)
    assert _WALKS.size == 25
    assert_allclose(np.diff(np.log(_WALKS)), np.log(_WALKS[1] / _WALKS[0]))


def test_channels_are_corrected_by_their_own_drift() -> None:
    time = np.broadcast_to([0.0, 2.0, 4.0], (2, 1, 3))
    phase = np.array([[[-0.1, 0.0, 0.1]], [[0.3, -0.3, 0.1]]])
    drift = PhaseDrift(
        time=time, phase=phase, uncertainty=np.zeros((2, 1, 3)), zero=np.zeros((2, 1))
    )
    at = np.array([[[1.0, 9.0, np.nan]], [[3.0, -1.0, 2.0]]])
    signal = np.array([[[2.0, 1j, 3.0]], [[1.0, 1.0, 5.0]]])
    turn = np.array([[[-0.05, 0.1, 0.0]], [[-0.1, 0.3, -0.3]]])
    assert_allclose(drift.corrected(signal, at), signal * np.exp(-1j * turn))
    # One time for all channels.
    same = drift.corrected(signal, np.full(3, 1.0))
    turn = np.array([[3 * [-0.05]], [3 * [0.0]]])
    assert_allclose(same, signal * np.exp(-1j * turn))


def test_attributes_have_the_points_of_all_channels() -> None:
    time = np.array([[[0.0, 1.0, 5.0], [2.0, 3.0, 4.0]]])
    phase = np.array([[[-0.1, 0.0, 0.1], [0.2, -0.2, 0.0]]])
    drift = PhaseDrift(
        time=time, phase=phase, uncertainty=np.ones((1, 2, 3)),
        zero=np.array([[0.5, -0.5]]),
    )  # fmt: skip
    found = drift.attributes(np.array([1e6]))
    assert list(found) == [
        "reference_phase_rad", "reference_phase_uncertainty_rad",
        "instrument_drift_uncertainty_s", "reference_time_s", "reference_drift_rad",
    ]  # fmt: skip
    assert found["reference_phase_rad"].tolist() == [0.5, -0.5]
    assert found["reference_phase_uncertainty_rad"].tolist() == [1.0]
    # The larger range of the two channels, 0.4 rad.
    expected = 0.4 / (2e6 * np.pi * 12**0.5)
    assert_allclose(found["instrument_drift_uncertainty_s"], [expected])
    assert found["reference_time_s"].tolist() == [0, 1, 5, 2, 3, 4]
    assert found["reference_drift_rad"].tolist() == [-0.1, 0, 0.1, 0.2, -0.2, 0]


def test_of_many_readings_a_hundred_are_in_the_attributes() -> None:
    time = np.arange(199.0)[None, None]
    drift = PhaseDrift(
        time=time, phase=time / 1e3, uncertainty=time, zero=np.zeros((1, 1))
    )
    found = drift.attributes(np.array([1e6]))
    assert found["reference_time_s"].tolist() == list(range(0, 199, 2))
    assert_allclose(found["reference_drift_rad"], np.arange(0, 199, 2) / 1e3)
