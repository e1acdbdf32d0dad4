"""Outputs of the signal chain: amplifiers, cables, demodulator, and noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from signal_chains import FREQUENCIES, chain

from amulor.survey import Survey

#: Four readings of 0.125 s in each pixel.
STEP = 0.5


TIME = np.array([[0.0, 5.3, 26.5]])
SIGNAL = np.array([3e-3 + 4e-3j, -1e-3, 0.0]) * np.ones((2, 2, 1, 1))
TURN = 2j * np.pi * FREQUENCIES[:, None, None, None]


def received(survey: Survey, part: Any = "scan", **errors: Any) -> np.ndarray:
    return np.asarray(chain(survey, **errors)._received(SIGNAL, TIME, part=part))


def test_signals_pass_amplifiers_and_cables_unchanged_without_errors(
    survey: Survey,
) -> None:
    assert_array_equal(received(survey), SIGNAL)
    steps = chain(survey)._demodulated(SIGNAL, TIME, lambda: np.ones(1))
    assert_array_equal(steps, SIGNAL)


def test_compression_takes_no_more_than_all(survey: Survey) -> None:
    found = received(survey, compression={"fraction": 0.5, "amplitude": 2e-3})
    # 5 mV would lose 1.25 of itself, 1 mV a quarter.
    assert_allclose(found, [0.0, -0.75e-3, 0.0] * np.ones((2, 2, 1, 1)))


def test_walk_turns_signals_by_their_decades(survey: Survey) -> None:
    found = received(survey, walk={"phase_per_decade": 0.1, "amplitude": 1e-2})
    turn = np.exp(0.1j * np.log10([0.5, 0.1, 1.0]))
    assert_allclose(found, SIGNAL * turn)


def test_a_reflection_comes_with_its_delay(survey: Survey) -> None:
    found = received(survey, reflection={"coefficient": -0.2, "delay": 4e-9})
    assert_allclose(found, SIGNAL * (1 - 0.2 * np.exp(TURN * 4e-9)))


def test_crosstalk_of_each_frequency_changes_over_the_scan(survey: Survey) -> None:
    stray = {"amplitude": [1e-3, 2e-3], "phase": 0.3, "delay": 1e-9, "change": 0.5,
             "part": "open_water"}  # fmt: skip
    found = received(survey, "open_water", crosstalk=stray)
    size = np.array([1e-3, 2e-3])[:, None, None, None] * (1 + 0.5 * TIME / 26.5)
    expected = size * np.exp(0.3j + TURN * 1e-9)
    assert_allclose(found - SIGNAL, expected + 0 * SIGNAL)
    assert_array_equal(received(survey, "scan", crosstalk=stray), SIGNAL)
    same = received(survey, crosstalk={"amplitude": 1e-3})
    assert_allclose(same - SIGNAL, 1e-3, rtol=1e-12)


def test_drift_and_warmth_turn_the_phase(survey: Survey) -> None:
    found = received(survey, drift={"phase": 0.2, "delay": 1e-10})
    assert_allclose(found, SIGNAL * np.exp((0.2j + TURN * 1e-10) * TIME / 26.5))
    warm = {"temperature": 26.0, "phase_per_degree": 0.02, "delay_per_degree": -2e-11}
    found = received(survey, temperature=warm)
    assert_allclose(found, SIGNAL * np.exp(6 * (0.02j - TURN * 2e-11)))


def test_the_demodulator_scales_turns_and_rounds(survey: Survey) -> None:
    found = chain(
        survey,
        scale_change={"above": 2e-3, "phase": 0.1, "gain": -0.5},
        demodulator={"in_phase_offset": 1e-4, "quadrature_offset": -3e-4,
                     "quadrature_gain": 0.1, "quadrature_phase": 0.2},
    )._demodulated(SIGNAL, TIME, lambda: np.ones(1))  # fmt: skip
    scaled = SIGNAL * [0.5 * np.exp(0.1j), 1, 1]
    tilted = scaled.imag * np.cos(0.2) + scaled.real * np.sin(0.2)
    assert_allclose(found.real, scaled.real + 1e-4)
    assert_allclose(found.imag, 1.1 * tilted - 3e-4)
    steps = chain(survey, demodulator={"resolution": 2e-3})
    rounded = steps._demodulated(SIGNAL, TIME, lambda: np.ones(1))
    assert_allclose(rounded, [4e-3 + 4e-3j, 0, 0] * np.ones((2, 2, 1, 1)), atol=1e-12)


def test_white_noise_is_that_of_its_draws(survey: Survey) -> None:
    white = np.stack([np.full(SIGNAL.shape, 1.0), np.full(SIGNAL.shape, -2.0)])
    found = chain(survey, noise={"white": 1e-3})._demodulated(
        SIGNAL, TIME, lambda: white
    )
    assert_allclose(found - SIGNAL, 1e-3 - 2e-3j, rtol=1e-9)
    pink = chain(survey, noise={"pink": 1e-3})
    found = pink._demodulated(SIGNAL, TIME, lambda: 0 * white)
    tones = pink._pink(TIME)
    assert_allclose(found - SIGNAL, 1e-3 * (tones[0] + 1j * tones[1]))


def test_pink_noise_has_as_much_power_in_each_octave(survey: Survey) -> None:
    long = survey.with_({"scan.columns": 64, "scan.rows": 64})
    found = chain(long, noise={"pink": 1.0})
    time = 0.5 * STEP * np.arange(8192)
    noise = found._pink(time)
    assert noise.shape == (2, 2, 2, 8192)
    assert noise.std() == pytest.approx(1, rel=0.05)
    power = np.mean(np.abs(np.fft.rfft(noise)) ** 2, axis=(0, 1, 2))
    frequency = np.fft.rfftfreq(8192, 0.5 * STEP)
    # From once in 4,125 steps up to half a sample rate: eleven octaves.
    lowest, highest = 1 / found._duration, 0.5 / STEP
    middle = np.sqrt(lowest * highest)
    share = power / power.sum()
    assert share[frequency > 1.02 * highest].sum() < 0.01
    assert share[frequency > middle].sum() == pytest.approx(0.5, abs=0.03)
    upper = frequency > highest / 2
    assert share[upper].sum() == pytest.approx(1 / np.log2(highest / lowest), abs=0.02)
    # Independent in each output, frequency and channel.
    rows = noise.reshape(8, -1)
    assert np.abs(np.corrcoef(rows) - np.eye(8)).max() < 0.3
    two = survey.with_({"scan.columns": 2, "scan.rows": 1, "scan.open_water": None})
    tone = chain(two, noise={"pink": 1.0})._pink(np.array([0.1, 0.1 + STEP]))
    assert_allclose(tone[..., 0], tone[..., 1], atol=1e-9)
