"""Claims about the phase function of molecules."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.optics import rayleigh_scattering

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
