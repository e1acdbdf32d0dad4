"""Claims about the phase function of molecules, and about how small they are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.optics.phase_functions import rayleigh as rayleigh_scattering

COSINE, WEIGHT = np.polynomial.legendre.leggauss(8)


def test_without_depolarization_it_is_three_quarters_of_1_plus_cosine_squared():
    angle = np.linspace(0, np.pi, 9)
    value = rayleigh_scattering.rayleigh_phase_value(angle, depolarization=0.0)
    expected = 0.75 * (1 + np.cos(angle) ** 2) / (4 * np.pi)
    assert_allclose(value, expected, rtol=1e-14)


def test_depolarization_of_1_is_isotropic():
    value = rayleigh_scattering.rayleigh_phase_value([0.0, 1.0], depolarization=1.0)
    assert_allclose(value, 1 / (4 * np.pi), rtol=1e-14)


def test_water_scatters_at_90_degrees_half_and_a_little_of_what_goes_forward():
    # Ratio (1 + delta) / 2 with 0.039 of F. J. Farinato and R. L. Rowell (1976).
    side, ahead = rayleigh_scattering.rayleigh_phase_value(
        [np.pi / 2, 0.0], depolarization=0.039
    )
    assert_allclose(side / ahead, 0.5195, rtol=1e-12)


@given(st.floats(0, 1), st.floats(0.01, np.pi))
def test_cumulative_is_the_integral(depolarization, angle):
    # p is a quadratic of the cosine: the rule is exact.
    cosine = 1 - (1 - np.cos(angle)) * (COSINE + 1) / 2
    value = rayleigh_scattering.rayleigh_phase_value(
        np.arccos(cosine), depolarization=depolarization
    )
    expected = np.pi * (1 - np.cos(angle)) * np.sum(WEIGHT * value)
    share = rayleigh_scattering.rayleigh_phase_cumulative(
        angle, depolarization=depolarization
    )
    # 1 - cos loses 2 / 5e-5 in digits.
    assert_allclose(share, expected, rtol=1e-10)
    back = rayleigh_scattering.rayleigh_phase_cumulative(
        np.pi - angle, depolarization=depolarization
    )
    assert_allclose(share + back, 1, rtol=0, atol=1e-14)


@pytest.mark.parametrize("ratio", [-0.1, 1.1, np.nan])
def test_a_depolarization_ratio_outside_of_0_to_1_is_refused(ratio):
    with pytest.raises(ValueError, match="depolarization must be from 0 to 1"):
        rayleigh_scattering.rayleigh_phase_value(1.0, depolarization=ratio)


def test_milk_particles_have_the_size_parameters_of_the_deduced_range():
    # Diameters of 0.15 to 0.3 um at 405 nm in water of 1.34: 1.6 to 3.1.
    x = rayleigh_scattering.size_parameter(
        np.array([0.15e-6, 0.3e-6]) / 2, wavelength=405e-9, refractive_index=1.34
    )
    assert_allclose(x, [1.6, 3.1], rtol=0, atol=0.05)  # two digits


def test_calibration_spheres_have_the_size_parameters_that_were_worked_out():
    # 0.1 um in 1.3427 at 405 nm, and 1 um in 1.3349 at 532 nm.
    x = rayleigh_scattering.size_parameter(
        [0.05e-6, 0.5e-6],
        wavelength=[405e-9, 532e-9],
        refractive_index=[1.3427, 1.3349],
    )
    assert_allclose(x, [1.041535, 7.882917], rtol=0, atol=6e-7)  # six decimals


def test_a_sphere_of_one_wavelength_around_has_size_parameter_1():
    x = rayleigh_scattering.size_parameter(
        1 / (2 * np.pi), wavelength=1.33, refractive_index=1.33
    )
    assert_allclose(x, 1, rtol=1e-15)


@settings(deadline=None)
@given(st.floats(1e-9, 1e-3), st.floats(1e-7, 1e-5), st.floats(1, 2), st.floats(1, 9))
def test_size_parameter_knows_no_unit_of_length(radius, wavelength, index, unit):
    one = rayleigh_scattering.size_parameter(
        radius, wavelength=wavelength, refractive_index=index
    )
    other = rayleigh_scattering.size_parameter(
        unit * radius, wavelength=unit * wavelength, refractive_index=index
    )
    assert_allclose(other, one, rtol=1e-14)


@settings(deadline=None)
@given(st.floats(1e-6, 1e6), st.floats(1e-6, 1e6))
def test_regimes_are_in_the_order_of_the_size(one, other):
    order = ["rayleigh", "intermediate", "mie"]
    small, large = rayleigh_scattering.scattering_regime(sorted([one, other]))
    assert order.index(small) <= order.index(large)


def test_limits_of_the_regimes_are_arguments_and_belong_to_the_middle():
    found = rayleigh_scattering.scattering_regime([0.099, 0.1, 10.0, 10.1])
    assert found.tolist() == ["rayleigh", "intermediate", "intermediate", "mie"]
    found = rayleigh_scattering.scattering_regime(
        [0.5, 3.0], rayleigh_below=1.0, mie_above=2.0
    )
    assert found.tolist() == ["rayleigh", "mie"]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"radius": 0.0}, "radius must be finite and above 0"),
        ({"wavelength": -1.0}, "wavelength must be finite and above 0"),
        (
            {"refractive_index": 0.9},
            r"refractive_index must be finite and at least 1, got 0\.9",
        ),
    ],
)
def test_what_has_no_size_parameter_is_refused(change, text):
    sphere = {"radius": 1e-6, "wavelength": 5e-7, "refractive_index": 1.3} | change
    with pytest.raises(ValueError, match=text):
        rayleigh_scattering.size_parameter(sphere.pop("radius"), **sphere)


def test_regimes_without_order_are_refused():
    with pytest.raises(ValueError, match="size_parameter must be finite and above 0"):
        rayleigh_scattering.scattering_regime(0.0)
    with pytest.raises(ValueError, match="rayleigh_below must be above 0"):
        rayleigh_scattering.scattering_regime(1.0, rayleigh_below=5.0, mie_above=2.0)
