"""Claims about scattering by the molecules and ions of pure water."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.optics.water import molecular_scattering as molecular
from amulor.optics.water import seawater

REFERENCE = Path(__file__).parents[3] / "reference"

wavelengths = st.floats(300e-9, 700e-9)
temperatures = st.floats(0.0, 30.0)
salinities = st.floats(0.0, 43.0)
angles = st.floats(0.0, np.pi)


def read(name: str) -> np.ndarray:
    return np.loadtxt(REFERENCE / name, delimiter=",", unpack=True)


def test_scattering_matches_the_program_of_zhang_hu_and_he_2009():
    wavelength_nm, temperature, salinity, expected, at_90 = read("zhang_2009_grid.csv")
    state = {"temperature": temperature, "salinity": salinity}
    scattering = molecular.molecular_scattering(wavelength_nm * 1e-9, **state)
    vsf = molecular.molecular_vsf(np.pi / 2, wavelength=wavelength_nm * 1e-9, **state)
    # Seven digits given; the constants of nature have moved by 1e-6 since 2009.
    assert_allclose(scattering, expected, rtol=2e-6)
    assert_allclose(vsf, at_90, rtol=2e-6)


def test_scattering_matches_the_values_that_were_printed():
    for quantity, nm, temperature, salinity, value, tolerance in read(
        "zhang_hu_2009_published.csv"
    ).T:
        state = {"temperature": temperature, "salinity": salinity}
        found = (
            molecular.molecular_scattering(nm * 1e-9, **state)
            if quantity
            else molecular.molecular_vsf(np.pi / 2, wavelength=nm * 1e-9, **state)
        )
        assert_allclose(found, value, rtol=tolerance)  # two or three digits


@pytest.mark.parametrize(("salinity", "expected"), [(0, 24.64), (40, 27.49)])
def test_scattering_is_least_at_the_temperature_that_zhang_and_hu_2010_found(
    salinity, expected
):
    # Proc. SPIE 7678, 76780L: 24.64 degC for pure water, 27.49 degC at 40 psu.
    temperature = np.linspace(20, 30, 1001)
    for wavelength in (400e-9, 546e-9, 650e-9):
        scattering = molecular.molecular_scattering(
            wavelength, temperature=temperature, salinity=salinity
        )
        found = temperature[scattering.argmin()]
        # The minimum is flat; it moves by 0.1 degrees with the wavelength.
        assert_allclose(found, expected, rtol=0, atol=0.1)


def test_a_factor_linear_in_salinity_falls_short_by_about_2_percent():
    salinity = np.array([10.0, 20.0, 30.0])
    state = {"temperature": 20, "salinity": salinity}
    scattering = molecular.molecular_scattering(546e-9, **state)
    fresh = molecular.molecular_scattering(546e-9, temperature=20, salinity=0)
    # Abstract of Zhang, Hu and He (2009), on the usual 1 + 0.3 S/37: "an average of
    # 2 %" over wavelengths and salinities; no digits more.
    shortfall = np.mean(scattering / (fresh * (1 + 0.3 * salinity / 37)) - 1)
    assert_allclose(shortfall, 0.02, rtol=0, atol=0.006)


def test_density_of_sea_water_matches_the_check_values_of_unesco_44():
    t, s = np.array([5.0, 5.0, 25.0]), np.array([0.0, 35.0, 35.0])
    expected = [999.96675, 1027.67547, 1023.34306]  # five decimals
    assert_allclose(molecular._density(t, s), expected, rtol=0, atol=5.1e-6)


def test_compressibility_matches_the_check_values_of_unesco_44():
    t, s = np.array([5.0, 5.0]), np.array([0.0, 35.0])
    # Secant bulk modulus at atmospheric pressure [bar], five decimals.
    bulk_modulus = 1e-5 / molecular._compressibility(t, s)
    assert_allclose(bulk_modulus, [20337.80375, 22185.93358], rtol=0, atol=5.1e-6)


def test_fresh_water_scatters_as_einstein_and_smoluchowski_say():
    # Compressibility of the handbooks at 20 degC, and the slope of the squared index
    # by density from IAPWS R9-97, in place of EOS-80 and of a local-field formula.
    compressibility, density, step = 4.59e-10, 998.2, 0.5
    index = seawater.iapws_refractive_index(
        532e-9, temperature=20, density=[density - step, density + step]
    )
    slope = density * np.diff(index**2)[0] / (2 * step)
    thermal = 1.380649e-23 * 293.15
    fluctuation = np.pi**2 / (2 * 532e-9**4) * slope**2 * thermal * compressibility
    expected = fluctuation * (6 + 6 * 0.039) / (6 - 7 * 0.039)
    found = molecular.molecular_vsf(
        np.pi / 2, wavelength=532e-9, temperature=20, salinity=0
    )
    # The slope of R9-97 is 2 % above the one that Zhang and Hu chose for agreeing with
    # measured scattering, and is squared here; a lost factor would show.
    assert_allclose(found, expected, rtol=0.05)


def test_little_salt_adds_scattering_in_proportion():
    fresh, little, twice = molecular.molecular_scattering(
        405e-9, temperature=20, salinity=[0, 1e-6, 2e-6]
    )
    # The activity has a root of the salinity: 5 % of the slope at 1, 5e-5 at 1e-6.
    assert_allclose((twice - fresh) / (little - fresh), 2, rtol=1e-3)


def test_phase_function_integrates_to_one_half_of_it_backwards():
    nodes, weights = np.polynomial.legendre.leggauss(4)  # exact for a square
    cosine = 0.5 * (nodes + 1)
    for side in (1, -1):
        share = molecular.molecular_phase_function(np.arccos(side * cosine))
        assert_allclose(2 * np.pi * np.sum(0.5 * weights * share), 0.5, rtol=1e-13)


def test_phase_function_without_depolarisation_is_that_of_rayleigh(monkeypatch):
    monkeypatch.setattr(molecular, "DEPOLARIZATION_RATIO", 0.0)
    angle = np.linspace(0, np.pi, 7)
    expected = 3 / (16 * np.pi) * (1 + np.cos(angle) ** 2)
    found = molecular.molecular_phase_function(angle)
    assert_allclose(found, expected, rtol=1e-14)


@settings(deadline=None)
@given(angles, wavelengths, temperatures, salinities)
def test_vsf_is_scattering_times_phase_function_and_symmetric(
    angle, wavelength, temperature, salinity
):
    state = {"temperature": temperature, "salinity": salinity}
    vsf = molecular.molecular_vsf(angle, wavelength=wavelength, **state)
    scattering = molecular.molecular_scattering(wavelength, **state)
    share = molecular.molecular_phase_function(angle)
    assert_allclose(vsf, scattering * share, rtol=1e-13)
    back = molecular.molecular_vsf(np.pi - angle, wavelength=wavelength, **state)
    assert_allclose(back, vsf, rtol=1e-13)
    # Ratio of the directions 0 and 90 degrees, 2 / (1 + delta).
    at_90 = molecular.molecular_vsf(np.pi / 2, wavelength=wavelength, **state)
    assert 1 - 1e-13 <= vsf / at_90 <= 2 / 1.039 + 1e-13


@settings(deadline=None)
@given(wavelengths, temperatures, salinities)
def test_scattering_falls_a_little_faster_than_the_fourth_power(
    wavelength, temperature, salinity
):
    state = {"temperature": temperature, "salinity": salinity}
    ends = np.array([wavelength, min(1.02 * wavelength, 700e-9)])
    if ends[1] < 1.01 * ends[0]:
        ends = ends[1] / np.array([1.02, 1.0])
    near, far = molecular.molecular_scattering(ends, **state)
    exponent = -np.log(far / near) / np.log(ends[1] / ends[0])
    # Dispersion adds to 4: little in the red, most in the ultraviolet.
    assert 4.05 < exponent < 4.7


@settings(deadline=None)
@given(wavelengths, temperatures, salinities, salinities)
def test_salt_adds_scattering(wavelength, temperature, one, other):
    less, more = sorted((one, other))
    scattering = molecular.molecular_scattering(
        wavelength, temperature=temperature, salinity=[less, more]
    )
    assert scattering[1] >= scattering[0] > 0


def test_backscattering_is_half_of_the_scattering():
    state = {"temperature": 15, "salinity": 38}
    total = molecular.molecular_scattering(405e-9, **state)
    half = molecular.molecular_backscattering(405e-9, **state)
    assert_allclose(half, total / 2, rtol=1e-15)


def test_morel_scattering_matches_the_published_value():
    # Mobley (1994) after Morel (1974): 0.00758032 1/m at 400 nm.
    assert_allclose(molecular.morel_scattering(400e-9), 0.00758032, rtol=1e-9)


@settings(deadline=None)
@given(st.floats(350e-9, 600e-9), st.floats(350e-9, 600e-9))
def test_morel_scattering_is_a_power_law(one, other):
    ratio = molecular.morel_scattering(one) / molecular.morel_scattering(other)
    assert_allclose(ratio, (other / one) ** 4.32, rtol=1e-12)


def test_arguments_broadcast():
    vsf = molecular.molecular_vsf(
        np.zeros((4, 1, 1)),
        wavelength=np.array([405e-9, 532e-9]),
        temperature=np.ones((3, 1)),
        salinity=35.0,
    )
    assert vsf.shape == (4, 3, 2)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"wavelength": 299e-9}, "wavelength must be from 3e-07 to 7e-07"),
        ({"wavelength": 405.0}, "wavelength must be from"),
        ({"temperature": 30.1}, "temperature must be from 0 to 30"),
        ({"salinity": -0.1}, "salinity must be from 0 to 43"),
        ({"salinity": np.nan}, "salinity must be from"),
        ({"angle": -0.1}, "angle must be from 0 to pi"),
        ({"angle": 90.0}, "angle must be from 0 to pi"),
    ],
)
def test_arguments_outside_of_the_range_are_refused(change, text):
    given_ = {"angle": 1.0, "wavelength": 405e-9, "temperature": 20, "salinity": 0}
    with pytest.raises(ValueError, match=text):
        molecular.molecular_vsf(**(given_ | change))


def test_wavelengths_beyond_morels_are_refused():
    with pytest.raises(ValueError, match=r"from 3\.5e-07 to 6e-07"):
        molecular.morel_scattering(601e-9)
