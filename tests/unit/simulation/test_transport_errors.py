"""Errors of what is made of a photon run, against leaving out one batch at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from amulor.simulation import transport
from amulor.transport.tally import Tally

FREQUENCY = np.array([0.0, 10e6, 20e6, 30e6, 40e6])
BATCHES = 400


@pytest.fixture(scope="module")
def run() -> Tally:
    """Return a run whose frequencies have errors of their own, and shared ones."""
    rng = np.random.default_rng(5)
    mean = 1 / (1 - 1j * FREQUENCY / 24e6)
    size = np.array([0.05, 0.02, 0.03, 0.06, 0.01])
    own = rng.normal(size=(BATCHES, 5)) + 1j * rng.normal(size=(BATCHES, 5))
    shared = 1 + 0.08 * rng.normal(size=(BATCHES, 1))
    signal = mean * (shared + size * own)
    signal[:, 0] = signal[:, 0].real  # without modulation there is no phase
    return Tally(
        modulation_frequency=FREQUENCY, parts=("water 1",),
        batches=signal.reshape(BATCHES, 1, 1, 5),
        histories_of=np.full(BATCHES, 100), groups=BATCHES,
        contribution=(1.0, 1.0, 1.0), seed=1, next_batch=BATCHES, batch_size=100,
        problem="", seconds=1.0,
    )  # fmt: skip


def jackknife(run: Tally, value: Callable[[Tally], np.ndarray]) -> np.ndarray:
    found = np.array(
        [
            value(
                replace(
                    run,
                    batches=np.delete(run.batches, k, axis=0),
                    histories_of=np.delete(run.histories_of, k),
                )
            )
            for k in range(BATCHES)
        ]
    )
    return np.sqrt((BATCHES - 1) * np.mean((found - found.mean(axis=0)) ** 2, axis=0))


def test_relative_amplitudes_have_the_error_of_their_own_frequency(run: Tally) -> None:
    expected = jackknife(run, lambda one: np.abs(one.signal) / abs(one.signal[0]))
    found = transport.relative_amplitude_uncertainty(run)
    # Both are of first order in the errors of the means, here below a percent.
    np.testing.assert_allclose(found, expected, rtol=0.01, atol=1e-12)
    assert found[0] == pytest.approx(0, abs=1e-12)
    # Unlike each other, so that the error of a neighbour would be seen.
    assert np.all(np.abs(np.diff(found[1:])) > 0.03 * found[1:-1])


def test_the_cut_off_has_its_place_and_its_error(run: Tally) -> None:
    cut_off, error = transport.half_power(run)
    relative = np.abs(run.signal) / abs(run.signal[0])
    # As numpy puts a straight line between the two neighbours.
    expected = np.interp(-np.sqrt(0.5), -relative, FREQUENCY)
    assert cut_off == pytest.approx(expected, rel=1e-12)
    assert 20e6 < cut_off < 30e6
    scatter = jackknife(run, lambda one: np.array(transport.half_power(one)[0]))
    assert error == pytest.approx(float(scatter), rel=0.02)


def test_a_cut_off_at_the_first_step_and_none_at_all(run: Tally) -> None:
    few = run.batches.copy()
    few[..., 1:] *= 0.5
    cut_off, _ = transport.half_power(replace(run, batches=few))
    assert 0 < cut_off < 10e6
    flat = np.broadcast_to(run.batches[..., :1], run.batches.shape)
    assert np.isnan(transport.half_power(replace(run, batches=flat))[0])
    for wrong in (FREQUENCY + 1, FREQUENCY[::-1], FREQUENCY * 0):
        with pytest.raises(ValueError, match="rise from 0 Hz"):
            transport.half_power(replace(run, modulation_frequency=wrong))
