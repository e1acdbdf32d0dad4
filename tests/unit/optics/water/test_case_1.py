"""Claims about case-1 water: absorption and scattering from chlorophyll."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.optics.water import case_1, seawater

pigments = st.floats(0.02, 30.0)
wavelengths = st.floats(400e-9, 700e-9)


def test_absorption_of_phytoplankton_is_the_law_that_its_authors_quote():
    # A. Bricaud, A. M. Ciotti and B. Gentili, Global Biogeochem. Cycles 26, GB1010
    # (2012): 0.0375 Chl^0.620 at 443 nm. The table has 442 and 444 nm.
    pigment = np.array([0.05, 1.0, 10.0])
    found = case_1.phytoplankton_absorption(443e-9, chlorophyll=pigment)
    assert_allclose(found, 0.0375 * pigment**0.620, rtol=0.03)


def test_scattering_is_the_published_one_at_two_wavelengths():
    # H. Loisel and A. Morel 1998: 0.416 at 550 nm, 0.347 at 660 nm.
    for wavelength, published in ((550e-9, 0.416), (660e-9, 0.347)):
        found = case_1.particle_scattering(wavelength, chlorophyll=1.0)
        assert_allclose(found, published, rtol=1e-3)


@pytest.mark.parametrize("pigment", [0.03, 0.1, 0.3, 1.0, 3.0, 10.0])
def test_diffuse_attenuation_is_that_measured_in_case_1_water(pigment):
    # Morel and Maritorena 2001: K_d(490) = 0.0166 + 0.0773 Chl^0.6715. From a and b it
    # follows by J. T. O. Kirk, Limnol. Oceanogr. 29, 350 (1984), for a sun 43 degrees
    # off the zenith, whose mean cosine in water is 0.86.
    state = {"temperature": 20.0, "salinity": 35.0}
    own = {"chlorophyll": pigment}
    dissolved = case_1.CDOM_FRACTION * case_1.particle_absorption(440e-9, **own)
    a = (
        seawater.mason_absorption(490e-9, **state)
        + case_1.particle_absorption(490e-9, **own)
        + case_1.cdom_absorption(490e-9, absorption_at_440=dissolved)
    )
    b = seawater.molecular_scattering(490e-9, **state)
    b = b + case_1.particle_scattering(490e-9, **own)
    cosine = 0.86
    found = np.sqrt(a**2 + (0.425 * cosine - 0.19) * a * b) / cosine
    assert_allclose(found, 0.0166 + 0.0773 * pigment**0.6715, rtol=0.1)


@given(wavelength=wavelengths, pigment=st.floats(0.1, 6.0), step=st.floats(1.0, 5.0))
def test_absorption_and_scattering_are_power_laws_of_chlorophyll(
    wavelength, pigment, step
):
    for law in (
        case_1.phytoplankton_absorption,
        case_1.particle_absorption,
        case_1.particle_scattering,
    ):
        low, middle, high = law(
            wavelength, chlorophyll=[pigment / step, pigment, pigment * step]
        )
        assert_allclose(low * high, middle**2, rtol=1e-9)


@given(wavelength=wavelengths, pigment=pigments)
def test_living_matter_is_a_part_of_all_particles_and_backscatter_of_scatter(
    wavelength, pigment
):
    own = {"chlorophyll": pigment}
    particles = case_1.particle_absorption(wavelength, **own)
    # The two laws were fitted apart: at the ends of the data they may just cross.
    assert case_1.phytoplankton_absorption(wavelength, **own) < 1.15 * particles
    share = case_1.particle_backscattering(
        wavelength, **own
    ) / case_1.particle_scattering(wavelength, **own)
    # Twardowski et al. 2001: 0.003 to 0.03 in the sea.
    assert 0.001 < share < 0.03


def test_dissolved_matter_falls_by_e_over_an_inverse_slope():
    found = case_1.cdom_absorption(
        [440e-9, 490e-9], absorption_at_440=0.02, cdom_slope=0.02e9
    )
    assert_allclose(found, [0.02, 0.02 / np.e], rtol=1e-12)


@pytest.mark.parametrize(
    ("wavelength", "pigment"), [(390e-9, 1.0), (440e-9, 0.001), (440e-9, np.nan)]
)
def test_what_no_data_cover_is_refused(wavelength, pigment):
    with pytest.raises(ValueError, match=r"wavelength|chlorophyll"):
        case_1.particle_absorption(wavelength, chlorophyll=pigment)
