"""Claims about the absorption of pure fresh and sea water."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from amulor.optics.water import pure_water

REFERENCE = Path(__file__).parents[3] / "reference"

wavelengths = st.floats(300e-9, 900e-9)
temperatures = st.floats(0.0, 30.0)
salinities = st.floats(0.0, 43.0)


def read(name: str) -> np.ndarray:
    return np.loadtxt(REFERENCE / name, delimiter=",", unpack=True)


def test_pope_fry_absorption_matches_the_published_table():
    wavelength_nm, expected = read("pure_water_absorption.csv")
    absorption = pure_water.pope_fry_absorption(wavelength_nm * 1e-9)
    assert_allclose(absorption, expected, rtol=1e-9)  # nodes, up to rounding


def test_pope_fry_absorption_is_least_near_418_nm():
    wavelength = np.arange(400, 500, 0.5) * 1e-9
    absorption = pure_water.pope_fry_absorption(wavelength)
    # Abstract: a minimum of 0.0044 +- 0.0006 1/m at 418 nm.
    assert_allclose(wavelength[absorption.argmin()], 418e-9, rtol=0, atol=1.5e-9)
    assert_allclose(absorption.min(), 0.0044, rtol=0, atol=0.0006)


def test_mason_absorption_is_least_near_344_nm():
    wavelength = np.arange(300, 500, 0.5) * 1e-9
    absorption = pure_water.mason_absorption(wavelength, temperature=20, salinity=0)
    # Mason, Cone and Fry (2016): the least absorption of water lies near 344 nm.
    assert_allclose(wavelength[absorption.argmin()], 344e-9, rtol=0, atol=1.5e-9)


def test_the_two_tables_differ_by_a_factor_of_two_at_405_nm():
    mason = pure_water.mason_absorption(405e-9, temperature=20, salinity=0)
    ratio = pure_water.pope_fry_absorption(405e-9) / mason
    assert_allclose(ratio, 0.00530 / 0.00253, rtol=0.005)  # three digits


def test_absorption_is_linear_between_two_nodes():
    ends = pure_water.pope_fry_absorption([440e-9, 442.5e-9])
    between = pure_water.pope_fry_absorption(441e-9)
    assert_allclose(between, 0.6 * ends[0] + 0.4 * ends[1], rtol=1e-12)
    # 0.00635 and 0.00696 are the table's neighbours.
    assert_allclose(between, 0.006594, rtol=1e-9)


def test_salt_lowers_absorption_at_700_nm_and_raises_it_at_750_nm():
    fresh, salt = pure_water.mason_absorption(
        [700e-9, 750e-9], temperature=20, salinity=[[0], [10]]
    )
    # Rows of WOPP v3: -1.69e-4 and +5.48e-4 1/m per unit, three digits; the
    # temperature derivatives in the next column are ten times larger.
    assert_allclose((salt - fresh) / 10, [-1.69e-4, 5.48e-4], rtol=0.005)


@settings(deadline=None)
@given(st.floats(300e-9, 900e-9), temperatures, salinities)
def test_mason_absorption_is_linear_in_temperature_and_salinity(
    wavelength, temperature, salinity
):
    def absorption(temperature, salinity):
        return pure_water.mason_absorption(
            wavelength, temperature=temperature, salinity=salinity
        )

    reference = absorption(20.0, 0.0)
    apart = (absorption(temperature, 0.0) - reference) + (
        absorption(20.0, salinity) - reference
    )
    together = absorption(temperature, salinity)
    assert together > 0
    assert_allclose(together, reference + apart, rtol=1e-12)  # rounding only


def test_pope_fry_absorption_agrees_with_another_compilation():
    wavelength_nm, expected = read("wasi_6_pure_water.csv")
    absorption = pure_water.pope_fry_absorption(wavelength_nm * 1e-9)
    # The other one smooths its joints: it was found to differ by up to 1.1 %.
    assert_allclose(absorption, expected, rtol=0.011)


def test_mason_uncertainty_is_that_of_the_table_at_20_degrees_in_fresh_water():
    uncertainty = pure_water.mason_absorption_uncertainty(
        [402e-9, 410e-9], temperature=20, salinity=0
    )
    # Rows of WOPP v3: 0.00027 and 0.00032 1/m.
    assert_allclose(uncertainty, [0.00027, 0.00032], rtol=1e-9)


def test_mason_uncertainty_grows_as_the_root_of_squares():
    uncertainty = pure_water.mason_absorption_uncertainty(
        410e-9, temperature=15, salinity=38
    )
    # Row of WOPP v3 at 410 nm: 3.2e-4 1/m, 4.7e-5 per degree, 2.8e-5 per unit of salt.
    expected = np.sqrt((3.2e-4) ** 2 + (5 * 4.7e-5) ** 2 + (38 * 2.8e-5) ** 2)
    assert_allclose(uncertainty, expected, rtol=1e-9)


@settings(deadline=None)
@given(wavelengths, temperatures, salinities)
def test_mason_uncertainty_is_least_at_the_state_that_was_measured(
    wavelength, temperature, salinity
):
    here = pure_water.mason_absorption_uncertainty(
        wavelength, temperature=temperature, salinity=salinity
    )
    mirrored = pure_water.mason_absorption_uncertainty(
        wavelength, temperature=20, salinity=salinity
    )
    reference = pure_water.mason_absorption_uncertainty(
        wavelength, temperature=20, salinity=0
    )
    assert here >= mirrored >= reference > 0


def test_arguments_broadcast():
    for function in (
        pure_water.mason_absorption,
        pure_water.mason_absorption_uncertainty,
    ):
        found = function(
            np.array([405e-9, 532e-9]), temperature=np.ones((3, 1)), salinity=35.0
        )
        assert found.shape == (3, 2)
    assert_array_equal(pure_water.pope_fry_absorption(np.full((2, 3), 440e-9)), 0.00635)


def test_absorption_outside_of_the_tables_is_refused():
    with pytest.raises(ValueError, match=r"from 3\.8e-07 to 7\.275e-07"):
        pure_water.pope_fry_absorption([405e-9, 379e-9])
    with pytest.raises(ValueError, match=r"from 3e-07 to 9e-07"):
        pure_water.mason_absorption(901e-9, temperature=20, salinity=0)
    with pytest.raises(ValueError, match=r"temperature must be from 0 to 30"):
        pure_water.mason_absorption(405e-9, temperature=31, salinity=0)
