"""Cubes of given samples after the corrections of a calibration."""

from __future__ import annotations

import math

import numpy as np
import pytest
import xarray as xr
from exact_calibrations import (
    CHANNELS,
    DEGREES,
    LEAKAGE,
    OUTPUTS,
    REFERENCE,
    table,
    with_temperature,
)
from exact_samples import samples
from numpy.testing import assert_allclose

from amulor import cube as cubes
from amulor.acquisition import Calibration, calibrated
from amulor.errors import CubeError


def with_shots(cube: xr.Dataset, signal: complex, error: float = 1e-3) -> xr.Dataset:
    """Return a cube with two open-water shots of one signal in each channel."""
    shape = (2, 2, 2)
    shots = cubes.open_water(
        {
            "in_phase": np.full(shape, signal.real),
            "quadrature": np.full(shape, signal.imag),
            "in_phase_uncertainty": np.full(shape, error),
            "quadrature_uncertainty": np.full(shape, error),
        }
    )
    return cubes.attach(cube, shots, "open_water")


def test_leakage_is_subtracted_from_scan_and_references() -> None:
    cube = with_shots(samples(10.0), 20.0)
    result = calibrated(cube, Calibration(leakage=LEAKAGE))
    expected = 10 - np.array([[1 + 2j, 3 + 4j], [5 + 6j, 7 + 8j]])
    assert_allclose(result.amulor.signal[..., 0, 0], expected)
    shots = result.amulor.open_water.amulor.signal
    assert_allclose(shots[..., 1], 20 - np.array([[-1, -2], [-3, -4 + 1j]]))
    # The larger of both channels, and of scan and references together.
    assert_allclose(
        result.attrs["leakage_uncertainty_volt"],
        [math.hypot(0.2, 1.2), math.hypot(0.4, 1.4)],
    )
    alone = calibrated(samples(10.0), Calibration(leakage=LEAKAGE))
    assert_allclose(alone.attrs["leakage_uncertainty_volt"], [0.2, 0.4])
    assert_allclose(result["in_phase_uncertainty"], 1e-3)
    for name in ("calibration_phase_uncertainty_rad", "uncalibrated_share"):
        assert name not in result.attrs
    covariance = result["in_phase_quadrature_covariance"]
    assert covariance.attrs == {
        "units": "V2", "long_name": "covariance of the two outputs"
    }  # fmt: skip
    assert result["in_phase"].attrs == cube["in_phase"].attrs


def phased(**more: object) -> Calibration:
    return Calibration(
        frequencies=(
            table(0.1, 0.3, errors=(0.01, 0.03)),
            table(-0.2, -0.2, -0.2, errors=(0.02,) * 3, frequency=50e6),
        ),
        **more,
    )


def test_phases_are_those_of_the_table_and_its_ends() -> None:
    size = np.array([[[[1e-4, 1e-3, 10**-2.5]], [[1e-2, 1.0, np.nan]]]] * 2)
    cube = samples(size * np.exp(0.5j), error=1e-6 * np.ones((2, 2, 1, 3)))
    cube = cube.assign(
        user_sample_flag=cube["in_phase"]
        .copy(data=np.full(size.shape, 4))
        .astype(np.int16)
    )
    result = calibrated(cube, phased(delay_uncertainty=3e-12))
    phase = np.angle(result.amulor.signal)
    assert_allclose(phase[0, 0, 0], [0.4, 0.4, 0.3])
    assert_allclose(phase[0, 1, 0, :2], [0.2, 0.2])
    assert_allclose(phase[1, :, 0].ravel()[:5], 0.7)
    assert_allclose(np.abs(result.amulor.signal), size)
    # Beyond its ends errors of the outputs have the slope of 0.2 a decade.
    across = np.hypot(result["in_phase_uncertainty"], result["quadrature_uncertainty"])
    slope = math.hypot(0.2, math.hypot(0.01, 0.03))
    assert_allclose(across[0, 0, 0, 0], math.hypot(1e-4 * slope, 2**0.5 * 1e-6))
    assert_allclose(across[0, 1, 0, 1], 2 * slope, rtol=1e-6)
    assert_allclose(across[0, 0, 0, 1:], 2**0.5 * 1e-6)
    flags = result["user_sample_flag"]
    assert flags.dtype == np.int16
    beyond = [[[36, 4, 4]], [[4, 36, 4]]], [[[36, 4, 4]], [[4, 36, 4]]]
    # The third amplitude of 50 MHz is 0.1 V.
    assert flags.values.tolist() == [*beyond]
    assert result.attrs["uncalibrated_share"] == pytest.approx(4 / 10)
    # The median of 0.01, 0.01, 0.02, 0.03 and 0.03.
    assert_allclose(result.attrs["calibration_phase_uncertainty_rad"], [0.02, 0.02])
    assert result.attrs["calibration_delay_uncertainty_s"] == 3e-12
    assert Calibration.from_text(result.attrs["calibration"]) == phased(
        delay_uncertainty=3e-12
    )


def test_a_table_without_errors_states_none() -> None:
    known = Calibration(frequencies=(table(0.1), table(0.1, frequency=50e6)))
    result = calibrated(samples(1e-3), known)
    assert "calibration_phase_uncertainty_rad" not in result.attrs
    assert "calibration_delay_uncertainty_s" not in result.attrs
    assert result.attrs["uncalibrated_share"] == 0
    # With errors of one frequency of two, they are as unknown.
    some = Calibration(
        frequencies=(table(0.1, errors=(0.01,)), table(0.1, frequency=50e6))
    )
    assert (
        "calibration_phase_uncertainty_rad" not in calibrated(samples(1e-3), some).attrs
    )
    nothing = calibrated(samples(complex(np.nan, np.nan)), phased())
    assert nothing.attrs["uncalibrated_share"] == 0
    assert_allclose(nothing.attrs["calibration_phase_uncertainty_rad"], 0)


def test_parts_of_a_calibration_add_their_errors() -> None:
    known = phased(demodulator=OUTPUTS, channels=CHANNELS, reference=REFERENCE)
    cube = samples(1e-3).assign_attrs(
        reference_phase_rad=[0.1, 0.2, -3.0, 0.4],
        reference_phase_uncertainty_rad=np.zeros(2),
    )
    result = calibrated(cube, known)
    of_demodulator = math.sqrt(0.01**2 / 8 + 3 * 0.02**2 / 8)
    gains = (0.03, 0.05)
    # Both samples of 20 MHz are beyond the table of 1 and 10 mV, at 0.03 rad.
    assert_allclose(
        result.attrs["calibration_phase_uncertainty_rad"],
        [
            math.sqrt(of_demodulator**2 + 0.03**2 + gains[0] ** 2),
            math.hypot(0.02, gains[1]),
        ],
    )
    assert_allclose(result.attrs["offset_uncertainty_volt"], [0.1, 0.2])
    assert "demodulator_calibrated" not in result.attrs
    assert result.attrs["channel_crosstalk_uncertainty"] == 0.004
    assert result.attrs["reference_calibrated"] == 1
    both = OUTPUTS[1].model_copy(update={"quadrature_gain_uncertainty": 0.01})
    complete = calibrated(samples(1e-3), Calibration(demodulator=(OUTPUTS[0], both)))
    assert complete.attrs["demodulator_calibrated"] == 1
    assert "leakage_uncertainty_volt" not in complete.attrs
    assert "channel_gain_uncertainty" not in complete.attrs


def test_the_reference_contains_the_temperature(small) -> None:
    cube = with_temperature(small, instrument_temperature=17.0)
    cube = cube.assign(in_phase=1 + cube["in_phase"])
    warm = calibrated(cube, DEGREES)
    assert_allclose(np.angle(warm.amulor.signal)[..., 0, 0], [[0.09] * 2, [-0.06] * 2])
    assert warm.attrs["temperature_recorded"] == 1
    referenced = cube.assign_attrs(
        reference_phase_rad=[0.1, 0.2, -3.0, 0.4],
        reference_phase_uncertainty_rad=np.zeros(2),
    )
    both = DEGREES.model_copy(update={"reference": REFERENCE})
    result = calibrated(referenced, both)
    assert_allclose(np.angle(result.amulor.signal), 0, atol=1e-12)
    assert "temperature_recorded" not in result.attrs


def test_a_calibrated_cube_is_refused() -> None:
    cube = calibrated(samples(1.0), Calibration(leakage=LEAKAGE))
    with pytest.raises(CubeError) as caught:
        calibrated(cube, phased())
    assert str(caught.value) == (
        "the cube has a calibration already; make it again from its journal with "
        "another one (amulor recover --calibration --overwrite)"
    )
