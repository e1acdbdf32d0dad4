"""Claims about modulated light in time, and its complex attenuation."""

from pathlib import Path

import numpy as np
import plane_parallel
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor.optics import modulated_light, small_angle_diffusion

TESTS = Path(__file__).parents[2]
REFERENCE = TESTS / "reference"
depths = st.floats(0, 1)
frequencies = st.floats(1e5, 1e9)
phases = st.floats(-np.pi, np.pi)


def test_the_laser_of_the_paper_swings_about_its_mean():
    # 20 mW, depth 0.8: 36 mW, 20 mW, 4 mW, 20 mW at quarters of the period.
    quarter = np.arange(4) / 4 / 39e6
    power = modulated_light.launched_power(
        quarter, mean_power=20e-3, modulation_depth=0.8, modulation_frequency=39e6
    )
    assert_allclose(power, [36e-3, 20e-3, 4e-3, 20e-3], rtol=1e-13)


@settings(deadline=None)
@given(depths, frequencies, phases, st.floats(0, 1))
def test_a_lock_in_finds_the_response_again(depth, frequency, phase, amplitude):
    # Sums over 16 samples of a period are exact for the mean and the first harmonic.
    time = np.arange(16) / 16 / frequency
    response = amplitude * np.exp(1j * phase)
    power = modulated_light.received_power(
        time,
        mean_response=1.0,
        response=response,
        mean_power=2.0,
        modulation_depth=depth,
        modulation_frequency=frequency,
    )
    found = 2 * np.mean(power * np.exp(2j * np.pi * frequency * time))
    assert_allclose(np.mean(power), 2.0, rtol=1e-13)
    assert_allclose(found, 2.0 * depth * response, rtol=0, atol=1e-13)
    assert np.all(power >= 0)


def test_an_echo_of_a_mirror_is_what_was_launched_a_while_ago():
    delay, frequency = 3.3e-9, 50e6
    options = {"mean_power": 1.0, "modulation_depth": 0.7}
    time = np.linspace(0, 40e-9, 50)
    echo = modulated_light.received_power(
        time,
        mean_response=0.25,
        response=0.25 * np.exp(2j * np.pi * frequency * delay),
        modulation_frequency=frequency,
        **options,
    )
    launched = modulated_light.launched_power(
        time - delay, modulation_frequency=frequency, **options
    )
    assert_allclose(echo, 0.25 * launched, rtol=1e-13)


def test_power_from_the_water_is_never_negative():
    water = {
        "absorption": 0.15,
        "forward_scattering": 0.35,
        "diffuse_scattering": 0.0,
        "second_moment": 0.05,
        "backscatter_vsf": 3.5e-4,
        "group_index": 1.38,
        "baseline": 0.2,
        "receiver_radius": 0.02,
        "acceptance_angle": 0.08,
    }
    mean, response = small_angle_diffusion.water_response([0.0, 1.0], **water)
    power = modulated_light.received_power(
        np.linspace(0, 1, 101),
        mean_response=mean.real,
        response=response,
        mean_power=20e-3,
        modulation_depth=1.0,
        modulation_frequency=1.0,
    )
    assert np.all(power >= 0)
    assert_allclose(power.max(), 2 * 20e-3 * mean.real, rtol=1e-9)


@pytest.mark.parametrize(
    "row",
    np.loadtxt(
        REFERENCE / "half_space_isotropic_modulated.csv", delimiter=","
    ).tolist(),
)
def test_a_half_space_reflects_modulated_light_by_its_complex_albedo(row):
    x, real, imaginary = row
    attenuation, index = 2.5, 1.38
    frequency = x * attenuation * speed_of_light / index / (2 * np.pi)
    k = modulated_light.complex_attenuation(
        attenuation, modulation_frequency=frequency, group_index=index
    )
    albedo = 0.9 * attenuation / k
    reflected = plane_parallel.half_space_albedo(1.0, albedo=complex(albedo))
    # Ten digits are given.
    assert_allclose(reflected, complex(real, imaginary), rtol=0, atol=1e-10)


def test_unmodulated_light_has_the_plain_attenuation():
    k = modulated_light.complex_attenuation(
        0.3, modulation_frequency=0.0, group_index=1.38
    )
    assert k == 0.3


@settings(deadline=None)
@given(st.floats(0, 5), frequencies, st.floats(1, 2), st.floats(0, 20))
def test_the_phase_over_a_path_is_its_delay(attenuation, frequency, index, path):
    k = modulated_light.complex_attenuation(
        attenuation, modulation_frequency=frequency, group_index=index
    )
    signal = np.exp(-k * path)
    delay = path * index / speed_of_light
    expected = np.exp(-attenuation * path + 2j * np.pi * frequency * delay)
    # Phases up to 800 rad, each rounded to 1e-16.
    assert_allclose(signal, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"mean_power": -1.0}, "mean_power must be finite and not negative"),
        ({"modulation_depth": 1.5}, "modulation_depth must be from 0 to 1"),
        ({"modulation_frequency": -1.0}, "modulation_frequency must be finite"),
        ({"mean_response": -1.0}, "mean_response must be finite and not negative"),
        ({"response": 1.5j}, r"at most mean_response in modulus, got 1\.5"),
    ],
)
def test_powers_that_cannot_be_are_refused(change, text):
    arguments = {
        "mean_response": 1.0,
        "response": 0.5,
        "mean_power": 1.0,
        "modulation_depth": 0.5,
        "modulation_frequency": 1e6,
    } | change
    with pytest.raises(ValueError, match=text):
        modulated_light.received_power(0.0, **arguments)


def test_attenuation_that_cannot_be_is_refused():
    with pytest.raises(ValueError, match="attenuation must be finite and not negative"):
        modulated_light.complex_attenuation(
            -0.1, modulation_frequency=1e6, group_index=1.38
        )
    with pytest.raises(ValueError, match="group_index must be finite and at least 1"):
        modulated_light.complex_attenuation(
            0.1, modulation_frequency=1e6, group_index=0.9
        )
