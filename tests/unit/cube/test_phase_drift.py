"""A phase drift by noisy readings: its estimate, and how often its interval holds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.cube.phase_drift import PhaseDrift

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
