"""Tests of the instrument by the phases of a scan, and their words."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy.constants import speed_of_light
from scipy.stats import chi2

from amulor import cube as cubes
from amulor import imaging
from amulor.imaging.instrument_tests import instrument_tests

FREQUENCY = np.array([10e6, 35e6, 80e6, 146e6])
SHAPE = (8, 10)


def _target(
    turn: np.ndarray, *, noise: float = 1e-3, shared: float = 0.0, seed: int = 1
) -> xr.Dataset:
    """Target signal of a wall at 1.2 m in air, each frequency turned by an angle."""
    rng = np.random.default_rng(seed)
    phase = 4 * np.pi * FREQUENCY * 1.2 / speed_of_light + turn
    shape = (4, 1, *SHAPE)
    signal = np.exp(1j * phase)[:, None, None, None] + noise * (
        rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    )
    total = np.full(shape, np.hypot(noise, shared))
    return cubes.build(
        "target_signal",
        {
            "in_phase": signal.real,
            "quadrature": signal.imag,
            "in_phase_uncertainty": total,
            "quadrature_uncertainty": total,
            "common_in_phase_uncertainty": np.full(shape, shared),
            "common_quadrature_uncertainty": np.full(shape, shared),
            "common_covariance": np.zeros(shape),
            "water_in_phase": np.zeros(shape),
            "water_quadrature": np.zeros(shape),
            "quality_flag": np.zeros(shape, dtype=np.int16),
        },
        {
            "modulation_frequency": FREQUENCY,
            "polarization": ["none"],
            "azimuth": np.zeros(SHAPE),
            "elevation": np.zeros(SHAPE),
        },
        geometry={
            "group_index": 1.0,
            "refractive_index": 1.0,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes("target_signal", title="wall", source="by hand"),
    )


def _image(turn: np.ndarray, **options: float) -> xr.Dataset:
    return imaging.range_image(_target(turn, **options), interval=(0.5, 2.0))


def test_the_chance_is_that_of_the_chi_square_about_one_delay() -> None:
    turn = np.array([0.004, -0.003, 0.002, 0.005])
    # Errors of 2 mrad that all pixels share; their noise has averaged out nearly.
    image = _image(turn, noise=1e-6, shared=2e-3)
    weight = FREQUENCY**2
    delay = np.sum(weight * turn / FREQUENCY) / np.sum(weight)
    rest = turn - FREQUENCY * delay
    expected = chi2.sf(np.sum((rest / 2e-3) ** 2), df=3)
    assert image.attrs["frequency_phase_probability"] == pytest.approx(
        expected, rel=0.02
    )


def test_a_delay_is_no_contradiction_and_a_constant_phase_is() -> None:
    delay = _image(2 * np.pi * FREQUENCY * 20e-12)
    assert delay.attrs["frequency_phase_probability"] > 1e-3
    assert instrument_tests(delay) == ()
    constant = _image(np.full(4, 0.005))
    assert constant.attrs["frequency_phase_probability"] < 1e-4
    (failed,) = instrument_tests(constant)
    assert "frequencies differ" in failed.result
    assert "leakage" in failed.cause
    assert "plate" in failed.measurement


def test_chance_is_uniform_for_phases_that_agree() -> None:
    chances = [
        _image(np.zeros(4), seed=seed).attrs["frequency_phase_probability"]
        for seed in range(40)
    ]
    assert min(chances) > 1e-4
    # 40 values: the mean of a uniform distribution is known to 0.046.
    assert np.mean(chances) == pytest.approx(0.5, abs=0.2)


def test_two_frequencies_have_no_such_test() -> None:
    target = _target(np.zeros(4)).isel(modulation_frequency=[1, 2])
    image = imaging.range_image(target, interval=(0.5, 2.0))
    assert "frequency_phase_probability" not in image.attrs


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        (
            {"channel_phase_rad": 0.0305, "channel_phase_probability": 1e-9},
            "30.5 mrad",
        ),
        ({"instrument_drift_delay_s": [3e-12, -3e-11]}, "-30 ps"),
        ({"method_disagreement_m": 0.0046}, "4.6 mm"),
    ],
)
def test_failed_tests_of_rejection_have_cause_and_measurement(
    attributes: dict[str, float], words: str
) -> None:
    (failed,) = instrument_tests(xr.Dataset(attrs=attributes))
    assert words in failed.result
    assert failed.probability < 1e-4
    assert failed.cause
    assert failed.measurement
