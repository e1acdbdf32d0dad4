"""Offset, gain and angle of the demodulator are measured and corrected."""

from __future__ import annotations

import math

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor.acquisition import Calibration, calibrated, from_terminated
from amulor.acquisition.cube import demodulator
from amulor.cube.error import instrument_phase, leakage_volt
from amulor.errors import CubeError
from amulor.simulation import simulate
from amulor.survey import Survey

#: Errors of the simulated demodulator; those of analog mixers are about as large.
OFFSET, GAIN, ANGLE = 3e-4 - 2e-4j, 0.03, math.radians(1.5)
NOISE = 1e-5


@pytest.fixture(scope="module")
def blank(plate: Survey) -> xr.Dataset:
    cube = simulate(
        plate.with_(
            {
                "instrument.modulation_frequencies": ["20 MHz", "50 MHz"],
                "scan.rows": 4,
                "scan.columns": 4,
                "scan.open_water": None,
            }
        ),
        rng=1,
    )
    return cube.assign_attrs(shutter="closed")


def outputs(blank: xr.Dataset, signal: complex, seed: int) -> xr.Dataset:
    """Return the outputs for a constant input, by the formulas of the theory page."""
    rng = np.random.default_rng(seed)
    shape = blank["in_phase"].shape
    noise = NOISE * rng.standard_normal((2, *shape))
    turned = signal.imag * math.cos(ANGLE) + signal.real * math.sin(ANGLE)
    constant = blank["in_phase_uncertainty"].copy(data=np.full(shape, NOISE))
    return blank.drop_vars("in_phase_quadrature_covariance", errors="ignore").assign(
        in_phase=blank["in_phase"].copy(data=signal.real + OFFSET.real + noise[0]),
        quadrature=blank["quadrature"].copy(
            data=(1 + GAIN) * turned + OFFSET.imag + noise[1]
        ),
        in_phase_uncertainty=constant,
        quadrature_uncertainty=constant,
    )


def measured(blank: xr.Dataset, seed: int = 1, count: int = 8) -> Calibration:
    phases = 0.3 + 2 * np.pi * np.arange(count) / count
    return from_terminated(
        outputs(blank, 0j, seed),
        [
            outputs(blank, 0.01 * np.exp(1j * phase), seed + 1 + k)
            for k, phase in enumerate(phases)
        ],
    )


def test_gain_and_angle_are_those_of_the_demodulator(blank: xr.Dataset) -> None:
    pulls = []
    for seed in range(0, 200, 10):
        for entry in measured(blank, seed).demodulator:
            off = complex(*entry.offset) - OFFSET
            pulls += [
                off.real / entry.offset_uncertainty,
                off.imag / entry.offset_uncertainty,
                (entry.quadrature_gain - GAIN) / entry.quadrature_gain_uncertainty,
                (entry.quadrature_phase - ANGLE) / entry.quadrature_phase_uncertainty,
            ]
    # The scatter of 32 samples of 10 uV leaves 2 uV of 10 mV.
    assert entry.quadrature_gain_uncertainty < 5e-4
    assert np.max(np.abs(pulls)) < 4.5
    # Both outputs of two frequencies share the scatter of eight signals.
    assert 0.6 < np.std(pulls) < 1.3


def test_a_scan_has_the_phases_of_its_light(blank: xr.Dataset) -> None:
    calibration = measured(blank)
    for phase in (0.1, 1.9, 4.4):
        light = 0.02 * np.exp(1j * phase)
        scan = outputs(blank, light, 90).assign_attrs(shutter="open")
        result = calibrated(scan, calibration)
        signal = result["in_phase"].values + 1j * result["quadrature"].values
        # 50 ohm and eight signals leave 3 uV; noise of 16 samples another 3 uV.
        assert_allclose(signal.mean(axis=(2, 3)), light, rtol=0, atol=2e-5)
        # Variances follow the correction, which divides the quadrature by 1.03.
        ratio = result["quadrature_uncertainty"] / scan["quadrature_uncertainty"]
        expected = math.hypot(1 / 1.03, math.sin(ANGLE)) / math.cos(ANGLE)
        assert_allclose(ratio, expected, rtol=1e-3)
        assert_allclose(
            result["in_phase_quadrature_covariance"],
            -math.tan(ANGLE) * NOISE**2,
            rtol=0.02,
        )


def test_errors_of_the_calibration_are_stated(blank: xr.Dataset) -> None:
    calibration = measured(blank)
    scan = outputs(blank, 0.02j, 90).assign_attrs(shutter="open")
    result = calibrated(scan, calibration)
    entry = calibration.demodulator[0]
    # Root mean square of g sin cos + e cos^2 over a turn, by 360 phases.
    phase = np.radians(np.arange(360))
    square = (entry.quadrature_gain_uncertainty * np.sin(phase) * np.cos(phase)) ** 2
    square += (entry.quadrature_phase_uncertainty * np.cos(phase) ** 2) ** 2
    stated = result.attrs["calibration_phase_uncertainty_rad"][0]
    assert_allclose(stated, math.sqrt(square.mean()), rtol=1e-9)
    assert_allclose(leakage_volt(result)[0], entry.offset_uncertainty, rtol=1e-12)
    assert "leakage_uncertainty_volt" not in result.attrs


def test_an_analog_demodulator_has_a_typical_error_until_it_is_measured(
    blank: xr.Dataset, plate: Survey
) -> None:
    survey = plate.with_(
        {
            "instrument.modulation_frequencies": ["20 MHz", "50 MHz"],
            "instrument.phase_uncertainty": None,
        }
    )
    analog = survey.with_({"instrument.lock_in.demodulator": "analog"})
    scan = outputs(blank, 0.02j, 90).isel(polarization=0)
    # 1 % and 1 degree: 0.64 degrees, root mean square over a turn; three times as much
    # without any calibration.
    sizes = [instrument_phase(scan, which)[0] for which in (survey, analog)]
    assert_allclose(np.degrees(sizes), [1.5, 3 * math.hypot(0.5, 0.645)], rtol=1e-3)
    result = calibrated(
        outputs(blank, 0.02j, 90).assign_attrs(shutter="open"), measured(blank)
    ).isel(polarization=0)
    assert_allclose(np.degrees(instrument_phase(result, analog)), 1.5, rtol=2e-3)
    alone = from_terminated(outputs(blank, 0j, 1))
    result = calibrated(outputs(blank, 0.02j, 90), alone).isel(polarization=0)
    assert_allclose(instrument_phase(result, analog)[0], sizes[1], rtol=1e-9)


def test_dark_readings_contain_the_offset(blank: xr.Dataset) -> None:
    dark = {
        "dark_in_phase": np.full(4, OFFSET.real),
        "dark_quadrature": np.full(4, OFFSET.imag),
    }
    without = outputs(blank, 0j, 1)
    subtracted = without.assign(
        in_phase=without["in_phase"] - OFFSET.real,
        quadrature=without["quadrature"] - OFFSET.imag,
    ).assign_attrs(dark)
    alone = from_terminated(subtracted).demodulator[0]
    # The scatter of 32 samples of 10 uV leaves 2 uV.
    assert_allclose(complex(*alone.offset), OFFSET, rtol=0, atol=1e-5)
    assert alone.quadrature_gain_uncertainty is None
    # The error of the dark output adds in squares: two channels of 30 uV.
    uncertain = subtracted.assign_attrs(dark_uncertainty=np.full(4, 3e-5))
    stated = from_terminated(uncertain).demodulator[0].offset_uncertainty
    assert_allclose(
        stated, np.hypot(alone.offset_uncertainty, 3e-5 / np.sqrt(2)), rtol=1e-9
    )
    scan = subtracted.assign_attrs(shutter="open")
    result = calibrated(scan, from_terminated(subtracted))
    assert_allclose(result["in_phase"], scan["in_phase"], rtol=0, atol=1e-15)
    assert_allclose(leakage_volt(result), 0)


def test_wrong_recordings_are_refused(blank: xr.Dataset) -> None:
    silent = outputs(blank, 0j, 1)
    near = [outputs(blank, 0.01 * np.exp(0.1j * k), k) for k in range(6)]
    with pytest.raises(CubeError, match="6 signals with gaps of up to 331 degrees"):
        from_terminated(silent, near)
    around = [outputs(blank, 0.01 * np.exp(1j * k), k) for k in range(7)]
    with pytest.raises(CubeError, match="50 ohm at the input first"):
        from_terminated(around[0], [*around[1:], silent])
    with pytest.raises(CubeError, match="--shutter-closed"):
        from_terminated(silent.assign_attrs(shutter="open"))


def test_the_error_of_dark_readings_adds_to_that_of_the_offset(
    blank: xr.Dataset,
) -> None:
    cube = outputs(blank, 0j, 3)
    mean, error = demodulator._outputs(cube, cube)
    dark = {"dark_in_phase": 2e-4, "dark_quadrature": -1e-4, "dark_uncertainty": 5e-6}
    shifted, larger = demodulator._outputs(cube.assign_attrs(**dark), cube)
    assert_allclose(shifted - mean, 2e-4 - 1e-4j, rtol=1e-9)
    # Two channels of equal errors: the mean has half of their sum of squares.
    assert_allclose(larger**2 - error**2, (5e-6) ** 2 / 2, rtol=1e-9)
