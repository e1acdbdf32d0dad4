"""Phase errors of an instrument after the combination of two channels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor import Survey, imaging, rejection
from amulor import cube as cubes

Make = Callable[..., xr.Dataset]
FREQUENCY = np.array([20e6, 80e6])
TWO = {"VV": (1.0, 1.0), "VH": (0.25, 0.1)}
#: The same echo at each pixel, in units of the co-polarized one.
ECHO = np.exp(4j * np.pi * FREQUENCY * 1.38 * 1.5 / speed_of_light)
RATIOS = {"target_ratio": 0.25, "water_ratio": 0.1, "water_fluctuation": 0.0}


def _leaking(cube: xr.Dataset, leak: np.ndarray) -> xr.Dataset:
    """Samples with leakage, of shape (frequency, channel), across the echo."""
    leaking = cube.copy(deep=True)
    added = (1j * ECHO)[:, None, None, None] * leak[:, :, None, None]
    leaking["in_phase"].values[:] += added.real
    leaking["quadrature"].values[:] += added.imag
    return leaking


def _turned(
    method: Callable[[xr.Dataset], xr.Dataset], cube: xr.Dataset, leak: np.ndarray
) -> np.ndarray:
    """Measured turn of the target signal by leakage, at each frequency [rad]."""
    before, after = (method(one).amulor.signal.values[:, 0] for one in (
        cube, _leaking(cube, leak),
    ))  # fmt: skip
    return np.angle(np.mean(after / before, axis=(1, 2)))


def _by_polarization(cube: xr.Dataset) -> xr.Dataset:
    return rejection.polarization(cube, **RATIOS)


def _by_both(cube: xr.Dataset) -> xr.Dataset:
    return rejection.combined(cube, target_ratio=0.25)


@pytest.mark.parametrize("method", [_by_polarization, _by_both])
def test_the_gain_is_the_turn_by_leakage_in_each_channel(
    by_hand: Make, method: Callable[[xr.Dataset], xr.Dataset]
) -> None:
    cube = by_hand(frequency=list(FREQUENCY), channels=TWO)
    size = 1e-4
    turns = []
    for channel in (0, 1):
        leak = np.zeros((2, 2))
        leak[:, channel] = size
        turns.append(_turned(method, cube, leak) / size)
    gain = np.atleast_1d(method(cube).attrs["phase_error_gain_VV"])
    # An error that both channels share is not reduced: the gain is at least 1.
    expected = np.maximum(np.hypot(*turns), 1.0)
    assert_allclose(np.broadcast_to(gain, (2,)), expected, rtol=0.02)


def test_polarization_multiplies_leakage_by_its_contrast(by_hand: Make) -> None:
    cube = by_hand(frequency=list(FREQUENCY), channels=TWO)
    # Equal leakage of 0.001 in both channels: 0.001 (1 - 0.1) / (0.25 - 0.1).
    turn = _turned(_by_polarization, cube, np.full((2, 2), 1e-3))
    # Noise of the samples moves the second order by some thousandths.
    assert_allclose(turn, 6e-3, rtol=5e-3)
    # Independent leakage: the root of 1 + 0.1^2 instead of 1 - 0.1.
    gain = _by_polarization(cube).attrs["phase_error_gain_VV"]
    assert gain == pytest.approx(np.sqrt(1.01) / 0.15, rel=1e-9)


def test_leakage_turns_the_darker_channel_more(by_hand: Make) -> None:
    cube = by_hand(frequency=list(FREQUENCY), channels=TWO)
    target = rejection.open_water(cube)
    assert_allclose(target.attrs["phase_error_gain_VV"], 1.0, rtol=1e-9)
    # The crossed channel has a quarter of the echo.
    assert_allclose(target.attrs["phase_error_gain_VH"], 4.0, rtol=0.01)


@pytest.mark.parametrize("degrees", [0.0, 0.5])
def test_an_image_has_the_instrument_error_times_the_gain(
    by_hand: Make, degrees: float
) -> None:
    cube = by_hand(frequency=[50e6], channels=TWO)
    survey = Survey.preset("green-2021").with_(
        {
            "instrument.polarizations": ["VV", "VH"],
            "instrument.modulation_frequencies": ["50 MHz"],
            "instrument.phase_uncertainty": f"{degrees} deg",
        }
    )
    cube = cube.assign_attrs(survey=survey.to_toml())
    image = imaging.range_image(_by_polarization(cube), interval=(1.0, 2.0))
    if not degrees:
        assert "slant_range_uncertainty_instrument" not in image
        return
    # One frequency: Student's quantile for two degrees of freedom over the normal one.
    gain = 4.30265 / 1.95996 * np.sqrt(1.01) / 0.15
    expected = np.radians(degrees) * gain * speed_of_light / (4 * np.pi * 50e6 * 1.38)
    term = image["slant_range_uncertainty_instrument"].values
    assert_allclose(term, expected, rtol=0.02)


def test_phases_that_contradict_each_other_within_the_error_are_trusted(
    by_hand: Make,
) -> None:
    cube = by_hand(frequency=list(FREQUENCY), channels=TWO, noise=2e-4)
    # 5 milliradians in the crossed channel turn the signal by 2 degrees: beyond the
    # noise, within 6.7 times 0.5 degrees.
    turned = _leaking(cube, np.array([[0.0, 0.005], [0.0, -0.005]]))
    ambiguous = {}
    for degrees in (0.0, 0.5):
        survey = Survey.preset("green-2021").with_(
            {
                "instrument.polarizations": ["VV", "VH"],
                "instrument.modulation_frequencies": ["20 MHz", "80 MHz"],
                "instrument.phase_uncertainty": f"{degrees} deg",
            }
        )
        target = _by_polarization(turned.assign_attrs(survey=survey.to_toml()))
        image = imaging.range_image(target, interval=(1.0, 2.0))
        flag = image["quality_flag"].values
        ambiguous[degrees] = (flag & cubes.QualityFlag.AMBIGUOUS) != 0
    assert ambiguous[0.0].mean() > 0.9
    assert not ambiguous[0.5].any()
