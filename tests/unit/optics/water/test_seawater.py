"""Claims about the phase and the group index of pure fresh and sea water."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from amulor.optics.water import molecular_scattering, pure_water, seawater

REFERENCE = Path(__file__).parents[3] / "reference"

wavelengths = st.floats(401e-9, 699e-9)
temperatures = st.floats(0.0, 30.0)
salinities = st.floats(0.0, 43.0)


def read(name: str) -> np.ndarray:
    return np.loadtxt(REFERENCE / name, delimiter=",", unpack=True)


def test_refractive_index_matches_quan_and_fry_1995():
    wavelength_nm, temperature, salinity, expected = read("quan_fry_1995.csv")
    index = seawater.refractive_index(
        wavelength_nm * 1e-9, temperature=temperature, salinity=salinity
    )
    assert_allclose(index, expected, rtol=0, atol=5.1e-7)  # six decimals given


def test_refractive_index_matches_austin_halikas_1976():
    temperature, salinity, wavelength_nm, expected = read(
        "austin_halikas_1976_extremes.csv"
    )
    index = seawater.refractive_index(
        wavelength_nm * 1e-9, temperature=temperature, salinity=salinity
    )
    # The fit was made to this table and leaves 5.3e-5 at these corners.
    assert_allclose(index, expected, rtol=0, atol=1e-4)


def test_refractive_index_matches_millard_seaver_1990_beyond_salinity_35():
    wavelength_nm, temperature, salinity, expected = read("millard_seaver_1990.csv")
    index = seawater.refractive_index(
        wavelength_nm * 1e-9, temperature=temperature, salinity=salinity
    )
    # Another form, fitted to other data up to salinity 40. The two differ by 4.2e-5
    # at 35, within the range of both; 38 and 40 must do about as well.
    assert_allclose(index, expected, rtol=0, atol=5e-5)


def test_salt_raises_the_index_by_two_in_ten_thousand_per_unit():
    fresh, salt = seawater.refractive_index(589e-9, temperature=20, salinity=[0, 1])
    # A rule of thumb of refractometry; a lost sign or decimal would not meet it.
    assert_allclose(salt - fresh, 1.9e-4, rtol=0.1)


def test_index_in_vacuum_matches_iapws_and_daimon_for_fresh_water():
    wavelength_nm, expected, _ = read("daimon_masumura_2007_20degC.csv")
    index = seawater.refractive_index_vacuum(
        wavelength_nm * 1e-9, temperature=20, salinity=0
    )
    # Austin and Halikas lie this near; without the air all would be 3.8e-4 too low.
    assert_allclose(index, expected, rtol=0, atol=6e-5)


@pytest.mark.parametrize(
    ("salinity", "expected"),
    [(0, 1.380), (35, 1.388)],  # published to three decimals
)
def test_group_index_at_405_nm(salinity, expected):
    index = seawater.group_index(405e-9, temperature=20, salinity=salinity)
    assert_allclose(index, expected, rtol=0, atol=5.1e-4)


def test_group_index_matches_the_dispersion_that_daimon_measured():
    wavelength_nm, _, expected = read("daimon_masumura_2007_20degC.csv")
    index = seawater.group_index(wavelength_nm * 1e-9, temperature=20, salinity=0)
    # The slope of the fit is off by this much at 400 nm; the phase index is off from
    # the group index by 0.015 to 0.038.
    assert_allclose(index, expected, rtol=0, atol=6e-4)


def slope(function, wavelength, step=0.2e-9, **conditions):
    """Fourth-order central difference, error about 1e-10 here."""
    n = [function(wavelength + k * step, **conditions) for k in (-2, -1, 1, 2)]
    return (n[0] - 8 * n[1] + 8 * n[2] - n[3]) / (12 * step)


@settings(deadline=None)
@given(wavelengths, temperatures, salinities)
def test_group_index_is_the_slope_of_the_vacuum_index(wavelength, temperature, salt):
    conditions = {"temperature": temperature, "salinity": salt}
    expected = seawater.refractive_index_vacuum(
        wavelength, **conditions
    ) - wavelength * slope(seawater.refractive_index_vacuum, wavelength, **conditions)
    index = seawater.group_index(wavelength, **conditions)
    # Rounding 2e-16 over the step, times the wavelength, is 1e-12.
    assert_allclose(index, expected, rtol=0, atol=1e-10)


@settings(deadline=None)
@given(st.floats(0.21e-6, 1.09e-6), st.floats(0.0, 100.0), st.floats(900.0, 1050.0))
def test_iapws_group_index_is_the_slope_of_the_index(wavelength, temperature, density):
    conditions = {"temperature": temperature, "density": density}
    expected = seawater.iapws_refractive_index(
        wavelength, **conditions
    ) - wavelength * slope(seawater.iapws_refractive_index, wavelength, **conditions)
    index = seawater.iapws_group_index(wavelength, **conditions)
    # The ultraviolet resonance makes the fifth derivative large near 0.2 um.
    assert_allclose(index, expected, rtol=0, atol=1e-7)


def test_iapws_index_matches_the_verification_values_of_the_release():
    wavelength_nm, temperature, density, expected = read("iapws_r9_97.csv")
    index = seawater.iapws_refractive_index(
        wavelength_nm * 1e-9, temperature=temperature, density=density
    )
    # Eight decimals in the first two rows, six in the others.
    assert_allclose(index[:2], expected[:2], rtol=0, atol=5.1e-9)
    assert_allclose(index[2:], expected[2:], rtol=0, atol=6e-7)


def test_iapws_group_index_matches_the_dispersion_that_daimon_measured():
    wavelength_nm, _, expected = read("daimon_masumura_2007_20degC.csv")
    index = seawater.iapws_group_index(
        wavelength_nm * 1e-9, temperature=20, density=998.2067
    )
    # The two indices agree within 3e-6 between 400 and 700 nm, so their slopes times
    # the wavelength do within some 1e-5.
    assert_allclose(index, expected, rtol=0, atol=6e-5)


def test_iapws_index_tends_to_that_of_vacuum_in_thin_steam():
    index = seawater.iapws_refractive_index(
        405e-9, temperature=100, density=[1e-6, 2e-6]
    )
    # Refractivity is proportional to density where there is little of it.
    assert_allclose((index[1] - 1) / (index[0] - 1), 2, rtol=1e-6)
    assert index[0] - 1 < 1e-9


@settings(deadline=None)
@given(wavelengths, temperatures, salinities)
def test_group_index_exceeds_the_phase_index_and_both_grow_with_salt(
    wavelength, temperature, salinity
):
    fresh = {"temperature": temperature, "salinity": 0.0}
    salt = {"temperature": temperature, "salinity": salinity}
    phase = seawater.refractive_index_vacuum(wavelength, **salt)
    # Normal dispersion: 0.0147 at 700 nm and 0.038 at 400 nm in fresh water.
    assert 0.014 < seawater.group_index(wavelength, **salt) - phase < 0.042
    assert phase >= seawater.refractive_index_vacuum(wavelength, **fresh)


@settings(deadline=None)
@given(wavelengths, temperatures, salinities)
def test_index_is_linear_in_salinity(wavelength, temperature, salinity):
    def index(salinity):
        return seawater.refractive_index(
            wavelength, temperature=temperature, salinity=salinity
        )

    share = salinity / 43
    between = (1 - share) * index(0.0) + share * index(43.0)
    assert_allclose(index(salinity), between, rtol=1e-14)  # rounding only


def test_arguments_broadcast():
    index = seawater.group_index(
        np.array([405e-9, 532e-9]), temperature=np.ones((3, 1)), salinity=35.0
    )
    assert index.shape == (3, 2)


def test_a_wavelength_that_was_converted_from_nanometres_is_not_refused_for_rounding():
    assert 700 * 1e-9 > 700e-9
    options = {"temperature": 20, "salinity": 0}
    assert_array_equal(seawater.refractive_index(700 * 1e-9, **options) > 1.33, True)


@pytest.mark.parametrize(
    ("wavelength", "temperature", "salinity", "text"),
    [
        (399e-9, 20, 0, r"wavelength must be from 4e-07 to 7e-07 \[m\], got"),
        (701e-9, 20, 0, r"wavelength must be from 4e-07 to 7e-07 \[m\], got"),
        (405.0, 20, 0, "wavelength must be from"),
        (405e-9, 293.15, 0, r"temperature must be from 0 to 30 \[degC\], got"),
        (405e-9, -1, 0, r"temperature must be from 0 to 30 \[degC\], got"),
        (405e-9, 20, -1, "salinity must be from 0 to 43"),
        (405e-9, 20, 44, "salinity must be from 0 to 43"),
        (405e-9, np.nan, 0, "temperature must be from"),
    ],
)
@pytest.mark.parametrize(
    "function", [seawater.refractive_index_vacuum, seawater.group_index]
)
def test_indices_outside_of_the_range_are_refused(
    function, wavelength, temperature, salinity, text
):
    with pytest.raises(ValueError, match=text):
        function(wavelength, temperature=temperature, salinity=salinity)


@pytest.mark.parametrize(
    ("wavelength", "temperature", "density", "text"),
    [
        (199e-9, 20, 998, r"wavelength must be from 2e-07 to 1.1e-06 \[m\], got"),
        (405e-9, -13, 998, r"temperature must be from -12 to 500 \[degC\], got"),
        (405e-9, 20, 0.0, r"density must be above 0 and at most 1060 \[kg/m\^3\]"),
        (405e-9, 20, 1061, r"density must be above 0 and at most 1060 \[kg/m\^3\]"),
    ],
)
def test_iapws_arguments_outside_of_the_range_are_refused(
    wavelength, temperature, density, text
):
    with pytest.raises(ValueError, match=text):
        seawater.iapws_group_index(wavelength, temperature=temperature, density=density)


@pytest.mark.parametrize("module", [pure_water, molecular_scattering])
def test_the_other_constants_of_the_same_water_can_be_had_from_here(module):
    for name in module.__all__:
        if name.islower():
            assert getattr(seawater, name) is getattr(module, name)
            assert name in seawater.__all__


@settings(deadline=None)
@given(wavelengths, temperatures, salinities)
def test_index_in_vacuum_is_that_to_air_times_that_of_air(
    wavelength, temperature, salinity
):
    conditions = {"temperature": temperature, "salinity": salinity}
    in_air = seawater.refractive_index(wavelength, **conditions)
    in_vacuum = seawater.refractive_index_vacuum(wavelength, **conditions)
    # Ciddor (1996): 1.000283 at 400 nm and 1.000276 at 700 nm.
    assert_allclose(in_vacuum / in_air, 1.000283, rtol=0, atol=1e-12)
