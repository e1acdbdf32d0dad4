"""Claims about the attenuation of a collimated beam."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from amulor.optics.water import attenuation

TABLE = Path(__file__).parents[3] / "reference" / "petzold_1972_stations.csv"

lengths = st.floats(0.0, 100.0)
coefficients = st.floats(0.0, 5.0)


def test_albedo_of_petzolds_waters_is_scattering_over_attenuation():
    attenuation_, scattering, absorption = np.loadtxt(TABLE, delimiter=",", unpack=True)
    albedo = attenuation.single_scattering_albedo(
        absorption=absorption, scattering=scattering
    )
    # Attenuation is printed on its own, to 0.0005 in 0.151 at the clearest station.
    assert_allclose(albedo, scattering / attenuation_, rtol=0.0035)


def test_half_of_a_beam_is_left_after_a_half_value_length():
    left = attenuation.transmission(2.0, attenuation=np.log(2) / 2.0)
    assert_allclose(left, 0.5, rtol=1e-15)


def test_optical_thickness_of_the_section_8_example_is_1_95():
    # Ricci et al. 2010 as rebuilt: 3.9 m at 0.5 1/m, one way.
    thickness = attenuation.optical_thickness(3.9, attenuation=0.5)
    assert_allclose(thickness, 1.95, rtol=1e-15)


def test_a_thin_layer_takes_its_optical_thickness():
    left = attenuation.transmission(1e-6, attenuation=0.5)
    # The next term of the series is 1.3e-13.
    assert_allclose(1 - left, 5e-7, rtol=0, atol=2e-13)


@settings(deadline=None)
@given(lengths, lengths, coefficients)
def test_two_layers_multiply(first, second, coefficient):
    both = attenuation.transmission(first + second, attenuation=coefficient)
    one, other = attenuation.transmission([first, second], attenuation=coefficient)
    # Rounding of the exponent, at most 1000, counts in full.
    assert_allclose(both, one * other, rtol=1e-12, atol=1e-300)


@settings(deadline=None)
@given(st.floats(1e-6, 5.0), coefficients, st.floats(1e-3, 1e3))
def test_albedo_depends_on_the_ratio_of_the_coefficients(a, b, factor):
    albedo = attenuation.single_scattering_albedo(absorption=a, scattering=b)
    same = attenuation.single_scattering_albedo(
        absorption=factor * a, scattering=factor * b
    )
    assert 0 <= albedo <= 1
    assert_allclose(same, albedo, rtol=1e-14, atol=1e-300)  # rounding, underflow


def test_albedo_is_1_without_absorption_and_0_without_scattering():
    albedo = attenuation.single_scattering_albedo(
        absorption=[0.0, 0.3], scattering=[0.2, 0.0]
    )
    assert_array_equal(albedo, [1.0, 0.0])


def test_arguments_broadcast():
    left = attenuation.transmission(np.ones((3, 1)), attenuation=[0.1, 0.2])
    assert left.shape == (3, 2)


@pytest.mark.parametrize("value", [-0.1, np.nan])
def test_negative_coefficients_are_refused(value):
    with pytest.raises(ValueError, match="attenuation must be finite and not negative"):
        attenuation.optical_thickness(1.0, attenuation=value)
    with pytest.raises(ValueError, match="scattering must be finite and not negative"):
        attenuation.single_scattering_albedo(absorption=0.1, scattering=value)


def test_a_negative_distance_is_refused_and_a_missing_one_stays_missing():
    with pytest.raises(ValueError, match=r"distance must be not negative, .* got -1"):
        attenuation.transmission([2.0, -1.0], attenuation=0.5)
    left = attenuation.transmission([2.0, np.nan], attenuation=0.5)
    assert_array_equal(np.isnan(left), [False, True])


def test_the_albedo_of_a_water_without_attenuation_is_refused():
    with pytest.raises(
        ValueError, match=r"absorption \+ scattering must be above 0 \[1/m\], got 0 at"
    ):
        attenuation.single_scattering_albedo(absorption=[0.1, 0.0], scattering=0.0)
