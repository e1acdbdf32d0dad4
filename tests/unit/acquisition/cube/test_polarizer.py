"""Gains and cross-talk of two channels are measured with a turned polarizer."""

from __future__ import annotations

import math

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor.acquisition import Calibration, calibrated, from_polarizer
from amulor.errors import CubeError, FormatError
from amulor.simulation import simulate
from amulor.survey import Survey

ANGLES = np.radians([0, 25, 50, 80, 105, 130, 155])
#: Zero of the polarizer's scale, axis of the second analyzer off the right angle, and
#: what both pass of orthogonal light.
ZERO, TURN, PASSED = 0.4, math.radians(4.0), (0.003, 0.012)
GAIN = np.array([1.1 * np.exp(0.02j), 0.95 * np.exp(-0.05j)])


@pytest.fixture(scope="module")
def cube(plate: Survey) -> xr.Dataset:
    return simulate(
        plate.with_(
            {
                "instrument.modulation_frequencies": ["20 MHz", "50 MHz"],
                "scan.rows": 6,
                "scan.columns": 6,
                "scan.open_water": None,
            }
        ),
        rng=1,
    )


def response(angle: float) -> np.ndarray:
    """Return the transmission of both channels for linear light, by Malus' law."""
    first = math.cos(angle - ZERO) ** 2
    second = math.sin(angle - ZERO - TURN) ** 2
    passed = [first + PASSED[0] * (1 - first), second + PASSED[1] * (1 - second)]
    return np.array([[passed[0] * 1, passed[1] * gain] for gain in GAIN])


def outputs(cube: xr.Dataset, signal: np.ndarray, noise: float, seed: int):
    rng = np.random.default_rng(seed)
    normal = noise * rng.standard_normal((2, *signal.shape))
    stated = cube["in_phase"].copy(data=np.full(signal.shape, noise))
    return cube.assign(
        in_phase=cube["in_phase"].copy(data=signal.real + normal[0]),
        quadrature=cube["quadrature"].copy(data=signal.imag + normal[1]),
        in_phase_uncertainty=stated,
        quadrature_uncertainty=stated,
    ).drop_vars("in_phase_quadrature_covariance", errors="ignore")


def through(cube: xr.Dataset, angle: float, seed: int, *, noise: float = 1e-5):
    """Return samples behind the polarizer: light of another strength in each pixel."""
    rng = np.random.default_rng(seed + 50)
    shape = cube["in_phase"].shape
    light = 0.01 * (1 + rng.random(shape[2:])) * np.exp(1j * rng.random(shape[2:]))
    return outputs(cube, response(angle)[:, :, None, None] * light, noise, seed)


def measured(cube: xr.Dataset, seed: int = 1) -> Calibration:
    recordings = [through(cube, a, seed + k) for k, a in enumerate(ANGLES)]
    return from_polarizer(recordings, angles=ANGLES)


def crosstalk(turn: float, passed: float) -> float:
    """Return the response to light along the other axis over that to its own."""
    other = math.sin(turn) ** 2 + passed * math.cos(turn) ** 2
    return other / (math.cos(turn) ** 2 + passed * math.sin(turn) ** 2)


def test_gain_and_crosstalk_are_those_of_the_analyzers(cube: xr.Dataset) -> None:
    pulls = []
    expected = PASSED[0], crosstalk(TURN, PASSED[1])
    for seed in range(0, 200, 10):
        entries = measured(cube, seed).channels
        assert [e.polarization for e in entries] == ["VV", "VH", "VV", "VH"]
        for entry, true in zip(entries[:2], expected, strict=True):
            assert entry.crosstalk_uncertainty < 2e-3
            pulls.append((entry.crosstalk - true) / entry.crosstalk_uncertainty)
        own = math.cos(TURN) ** 2 + PASSED[1] * math.sin(TURN) ** 2
        for entry, gain in zip(entries[1::2], GAIN * own, strict=True):
            off = complex(*entry.gain) - gain
            pulls += [off.real / entry.gain_uncertainty]
            pulls += [off.imag / entry.gain_uncertainty]
    assert np.max(np.abs(pulls)) < 4.5
    # The larger error of the two components of the gain is stated for both.
    assert 0.6 < np.std(pulls) < 1.3


@pytest.mark.slow
def test_noise_of_a_tenth_of_the_light_is_no_crosstalk(cube: xr.Dataset) -> None:
    true = PASSED[0], crosstalk(TURN, PASSED[1])
    pulls = []
    for seed in range(0, 250, 10):
        entries = from_polarizer(
            [through(cube, a, seed + k, noise=1e-3) for k, a in enumerate(ANGLES)],
            angles=ANGLES,
        ).channels
        pulls += [
            [
                (e.crosstalk - t) / e.crosstalk_uncertainty
                for e, t in zip(entries[:2], true, strict=True)
            ]
        ]
    # Squares of the noise, if they counted as light, would add 1.5 to each mean.
    assert np.abs(np.mean(pulls, axis=0)).max() < 4.5 / math.sqrt(len(pulls))
    assert 0.6 < np.std(pulls) < 1.4


@pytest.mark.slow
@pytest.mark.parametrize("noise", [5e-3, 2e-2])
def test_light_that_is_lost_in_noise_is_refused_or_uncertain(
    cube: xr.Dataset, noise: float
) -> None:
    true = PASSED[0], crosstalk(TURN, PASSED[1])
    refusals: list[str] = []
    for seed in range(0, 100, 10):
        recordings = [
            through(cube, a, seed + k, noise=noise) for k, a in enumerate(ANGLES)
        ]
        try:
            entries = from_polarizer(recordings, angles=ANGLES).channels
        except CubeError as error:
            refusals.append(str(error))
        else:
            for entry, t in zip(entries[:2], true, strict=True):
                assert abs(entry.crosstalk - t) < 4.5 * entry.crosstalk_uncertainty
    assert all("angles, or record stronger light" in one for one in refusals)
    assert noise < 2e-2 or refusals


def test_a_scan_has_the_light_of_both_polarizations(cube: xr.Dataset) -> None:
    calibration = measured(cube)
    own = math.cos(TURN) ** 2 + PASSED[1] * math.sin(TURN) ** 2
    share = crosstalk(TURN, PASSED[1])
    light = np.array([0.03 * np.exp(0.3j), 0.005 * np.exp(1.2j)])
    mixed = np.array(
        [
            [
                light[0] + PASSED[0] * light[1],
                gain * own * (light[1] + share * light[0]),
            ]
            for gain in GAIN
        ]
    )
    scan = outputs(cube, mixed[:, :, None, None] * np.ones((6, 6)), 1e-9, 3)
    result = calibrated(scan, calibration)
    signal = (result["in_phase"] + 1j * result["quadrature"]).values
    u = result.attrs["channel_crosstalk_uncertainty"]
    error = math.hypot(u * 0.03, 0.005 * calibration.channels[1].gain_uncertainty)
    assert_allclose(signal[:, 1].mean(axis=(1, 2)), light[1], rtol=0, atol=4 * error)
    # Without the calibration the second channel has 1.7 % of the first one.
    assert np.abs(mixed[1, 1] - light[1]) > 50 * error
    # The error of a channel follows its gain, and that of the other its cross-talk.
    sigma, stated = (
        np.hypot(part["in_phase_uncertainty"], part["quadrature_uncertainty"]).values[1]
        for part in (scan, result)
    )
    about = np.hypot(sigma[1] / abs(GAIN[1] * own), share * sigma[0])
    assert_allclose(stated[1], about, rtol=2e-3)


def test_the_phase_error_of_the_gain_is_stated(cube: xr.Dataset) -> None:
    calibration = measured(cube)
    result = calibrated(through(cube, 0.1, 90), calibration)
    of_gain = [entry.gain_uncertainty for entry in calibration.channels[1::2]]
    assert_allclose(result.attrs["calibration_phase_uncertainty_rad"], of_gain)
    assert Calibration.from_text(result.attrs["calibration"]) == calibration


def test_wrong_angles_enlarge_the_uncertainties(cube: xr.Dataset) -> None:
    recordings = [through(cube, a, k) for k, a in enumerate(ANGLES)]
    right = from_polarizer(recordings, angles=ANGLES)
    off = np.radians(1.0) * np.array([1, -1, 1, 0, -1, 1, -1])
    wrong = from_polarizer(recordings, angles=ANGLES + off)
    for a, b in zip(right.channels[:2], wrong.channels[:2], strict=True):
        assert b.crosstalk_uncertainty > 5 * a.crosstalk_uncertainty
        assert abs(b.crosstalk - a.crosstalk) < 3.5 * b.crosstalk_uncertainty


def test_wrong_recordings_are_refused(cube: xr.Dataset, plate: Survey) -> None:
    recordings = [through(cube, a, k) for k, a in enumerate(ANGLES)]
    with pytest.raises(ValueError, match="3 angles for 7 cubes"):
        from_polarizer(recordings, angles=[0, 1, 2])
    # A half turn is the same polarizer.
    with pytest.raises(
        CubeError, match="4 angles in half a turn, with gaps of up to 9"
    ):
        from_polarizer(recordings[:5], angles=np.radians([0, 30, 60, 90, 180]))
    alone = [part.isel(polarization=[0]) for part in recordings]
    with pytest.raises(CubeError, match="have the channels VV; needed are two"):
        from_polarizer(alone, angles=ANGLES)
    calibration = from_polarizer(recordings, angles=ANGLES)
    with pytest.raises(FormatError, match="no channel VH beside VV"):
        calibrated(alone[0], calibration)
