"""Claims about spheres, their suspensions and the matrix that goes with them."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from amulor.errors import MissingExtraError
from amulor.optics.phase_functions import mie
from amulor.optics.polarization import mueller

pytest.importorskip("miepython")

REFERENCE = Path(__file__).parents[3] / "reference"
sizes = st.floats(0.1, 30.0)
indices = st.builds(complex, st.floats(1.02, 1.6), st.sampled_from([0.0, 1e-4, 0.3]))


def read(name: str) -> np.ndarray:
    return np.loadtxt(REFERENCE / name, delimiter=",")


def radians(degrees: np.ndarray) -> np.ndarray:
    return np.minimum(np.radians(degrees), np.pi)


@pytest.mark.parametrize("row", read("mie_wiscombe.csv").tolist())
def test_efficiencies_match_the_cases_of_wiscombe(row):
    n, k, x, *expected = row
    found = mie.sphere(x, relative_index=complex(n, k))
    for name, printed in zip(
        ("extinction", "scattering", "asymmetry"), expected, strict=True
    ):
        if not np.isnan(printed):
            # Six decimals are printed, and computed on single-precision machines.
            assert_allclose(getattr(found, name), printed, rtol=0, atol=1.1e-6)


@pytest.mark.parametrize("row", read("mie_other_codes.csv").tolist())
def test_efficiencies_match_other_programs(row):
    n, k, x, *expected, tolerance = row
    found = mie.sphere(x, relative_index=complex(n, k))
    assert_allclose(found, expected, rtol=tolerance)


def test_amplitudes_match_wiscombe_conjugated():
    degrees, *parts = read("mie_amplitudes.csv").T
    s1, s2 = mie.amplitudes(
        radians(degrees), size_parameter=1.0, relative_index=1.5 + 1j
    )
    # Six decimals, the last of them in doubt by one; exp(+i omega t) there.
    assert_allclose(s1, parts[0] - 1j * parts[1], rtol=0, atol=1.1e-6)
    assert_allclose(s2, parts[2] - 1j * parts[3], rtol=0, atol=1.1e-6)


def test_amplitudes_straight_back_match_wiscombe():
    for x, expected in ((10, -1.07857 - 3.60881e-2j), (1000, 17.0578 + 484.251j)):
        s1, _ = mie.amplitudes(np.pi, size_parameter=x, relative_index=0.75)
        assert_allclose(s1, np.conj(expected), rtol=3e-6)  # six figures


def test_matrix_matches_the_sample_of_bohren_and_huffman():
    degrees, s11, polarization, s33, s34 = read("bohren_huffman_sphere.csv").T
    wavelength = 0.6328e-6
    one = mie.size_distribution(
        2 * 0.525e-6,
        number=1.0,
        wavelength=wavelength,
        particle_index=1.55,
        medium_index=1.0,
        angle=radians(degrees),
    )
    # Six figures. Their perpendicular axis points the other way: m34 = -S34.
    assert_allclose(one.value / one.value[0], s11, rtol=4e-6)
    assert_allclose(one.m12, -polarization, rtol=0, atol=6e-7)
    assert_allclose(one.m33, s33, rtol=0, atol=6e-7)
    assert_allclose(one.m34, -s34, rtol=0, atol=6e-7)


def test_sign_of_m34_is_that_of_the_fields_in_the_stokes_convention():
    # Light at +45 degrees, E = (1, 1) / sqrt 2, leaves as (S2, S1) / sqrt 2, so that
    # U + iV = 2 E_par conj(E_perp) = S2 conj(S1).
    angle = np.array([0.0, 1.0, np.pi])
    one = mie.size_distribution(
        1e-6,
        number=1.0,
        wavelength=532e-9,
        particle_index=1.6 + 0.01j,
        medium_index=1.33,
        angle=angle,
    )
    s1, s2 = mie.amplitudes(
        1.0,
        size_parameter=np.pi * 1e-6 * 1.33 / 532e-9,
        relative_index=(1.6 + 0.01j) / 1.33,
    )
    out = mueller.apply(one.mueller(1.0), [1.0, 0.0, 1.0, 0.0])
    expected = 2 * s2 * np.conj(s1) / (abs(s1) ** 2 + abs(s2) ** 2)
    assert_allclose(out[2] + 1j * out[3], expected, rtol=1e-12)
    assert abs(expected.imag) > 0.01  # or the sign would not be seen


def test_straight_back_a_sphere_keeps_the_polarization():
    beads = mie.size_distribution(
        np.array([0.3e-6, 1e-6, 3e-6]),
        number=np.array([1e14, 1e12, 1e11]),
        wavelength=405e-9,
        particle_index=1.6 + 0.001j,
        medium_index=1.34,
    )
    assert_allclose(
        beads.mueller(np.pi), mueller.ideal_backscatter(), rtol=0, atol=1e-12
    )
    assert_allclose(beads.mueller(0.0), np.eye(4), rtol=0, atol=1e-12)


def test_small_spheres_are_rayleigh_scatterers():
    x, m = 1e-3, 1.2
    found = mie.sphere(x, relative_index=m)
    polarizability = (m**2 - 1) / (m**2 + 2)
    # Corrections are of order x^2.
    assert_allclose(found.scattering, 8 / 3 * x**4 * polarizability**2, rtol=1e-5)
    assert_allclose(found.backscattering, 4 * x**4 * polarizability**2, rtol=1e-5)
    angle = np.linspace(0, np.pi, 19)
    dust = mie.size_distribution(
        x * 532e-9 / np.pi,
        number=1e12,
        wavelength=532e-9,
        particle_index=m,
        medium_index=1.0,
        angle=angle,
    )
    assert_allclose(dust.mueller(angle), mueller.rayleigh(angle), rtol=0, atol=1e-6)
    expected = 3 / (16 * np.pi) * (1 + np.cos(angle) ** 2)
    assert_allclose(dust.value, expected, rtol=1e-5)


def test_large_spheres_take_twice_their_shadow():
    # Extinction tends to 2 as 2 + 2 x^(-2/3), 2 % at x = 1000.
    found = mie.sphere(1000.0, relative_index=1.5 + 1j)
    assert_allclose(found.extinction, 2, rtol=0.02)


@settings(deadline=None, max_examples=30)
@given(sizes, indices)
def test_extinction_is_the_forward_amplitude(x, m):
    s1, s2 = mie.amplitudes(0.0, size_parameter=x, relative_index=m)
    found = mie.sphere(x, relative_index=m)
    # Two routes through the package; efficiencies below x = 0.1 and amplitudes end
    # their series at different terms.
    assert_allclose(4 / x**2 * s1.real, found.extinction, rtol=1e-7)
    assert_allclose(s1, s2, rtol=1e-13)
    assert found.scattering <= found.extinction * (1 + 1e-7)


@settings(deadline=None, max_examples=20)
@given(sizes, indices)
def test_one_sphere_does_not_depolarize(x, m):
    one = mie.size_distribution(
        x * 1e-6 / np.pi,
        number=1.0,
        wavelength=1e-6,
        particle_index=m,
        medium_index=1.0,
    )
    assert_allclose(one.m12**2 + one.m33**2 + one.m34**2, 1, rtol=0, atol=1e-10)


@settings(deadline=None, max_examples=10)
@given(sizes, indices)
def test_the_table_holds_the_scattering_and_the_asymmetry_of_the_series(x, m):
    one = mie.size_distribution(
        x * 1e-6 / np.pi,
        number=1.0,
        wavelength=1e-6,
        particle_index=m,
        medium_index=1.0,
    )
    # Promised: 2e-3, from straight lines across 32 steps a lobe.
    assert_allclose(one.phase_function.integral, 1, rtol=0, atol=2e-3)
    assert_allclose(one.phase_function.asymmetry, one.asymmetry, rtol=0, atol=1e-3)


def test_two_sizes_add_up():
    options = {"wavelength": 532e-9, "particle_index": 1.6, "medium_index": 1.34}
    angle = np.linspace(0, np.pi, 50)
    small = mie.size_distribution(0.2e-6, number=3e15, angle=angle, **options)
    large = mie.size_distribution(2e-6, number=1e12, angle=angle, **options)
    both = mie.size_distribution(
        [0.2e-6, 2e-6], number=[3e15, 1e12], angle=angle, **options
    )
    assert_allclose(both.scattering, small.scattering + large.scattering, rtol=1e-12)
    assert_allclose(
        both.scattering * both.value,
        small.scattering * small.value + large.scattering * large.value,
        rtol=1e-12,
    )
    for name in ("m12", "m33", "m34"):
        parts = [s.scattering * s.value * getattr(s, name) for s in (small, large)]
        assert_allclose(
            both.scattering * both.value * getattr(both, name),
            parts[0] + parts[1],
            rtol=0,
            atol=1e-12 * both.scattering * both.value.max(),
        )
    assert_allclose(
        both.asymmetry * both.scattering,
        small.asymmetry * small.scattering + large.asymmetry * large.scattering,
        rtol=1e-12,
    )


def test_calibration_spheres_scatter_their_cross_section_times_their_number():
    beads = mie.size_distribution(
        0.1e-6,
        number=1e15,
        wavelength=405e-9,
        particle_index=1.6194,
        medium_index=1.3427,
    )
    # 0.0415327 is worked out independently for x = 1.041535, m = 1.206077.
    assert_allclose(
        beads.scattering, 1e15 * 0.0415327 * np.pi * (0.05e-6) ** 2, rtol=2e-6
    )
    assert_allclose(beads.asymmetry, 0.192092, rtol=0, atol=1e-6)
    assert_allclose(beads.extinction, beads.scattering, rtol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"particle_index": 1.5 - 0.1j}, "conjugate an index"),
        ({"diameter": -1e-6}, "diameter must be finite and above 0"),
        ({"diameter": 1.0}, "size_parameter must be above 0 and at most 20000"),
        ({"number": -1.0}, "number must be finite and not negative"),
        ({"number": 0.0}, "the largest number must be above 0"),
        ({"number": [1.0, 1.0]}, "of one shape"),
        ({"wavelength": 0.0}, "wavelength must be finite and above 0"),
        ({"medium_index": 0.0}, "medium_index must be finite and above 0"),
        ({"angle": [0.0, 1.0, 2.0]}, "rise from 0 to pi"),
        ({"angle": [0.0, 2.0, 1.0, np.pi]}, "rise from 0 to pi"),
    ],
)
def test_what_is_no_suspension_is_refused(arguments, text):
    options = {
        "diameter": 1e-6,
        "number": 1.0,
        "wavelength": 532e-9,
        "particle_index": 1.5,
        "medium_index": 1.33,
        **arguments,
    }
    diameter = options.pop("diameter")
    with pytest.raises(ValueError, match=text):
        mie.size_distribution(diameter, **options)


def test_without_the_package_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "miepython", None)
    with pytest.raises(MissingExtraError, match=r"amulor\[mie\]"):
        mie.sphere(1.0, relative_index=1.5)


def test_rounding_of_an_element_past_one_is_no_error():
    # Straight ahead m33 is a ratio of two equal sums, here one bit above 1.
    angle = np.array([0.0, 0.5, np.pi])
    bit = np.array([1 + 2e-16, 0.5, -1 - 2e-16])
    assert np.any(np.abs(bit) > 1)
    beads = mie.Suspension(
        scattering=1.0,
        extinction=1.0,
        asymmetry=0.0,
        angle=angle,
        value=np.ones(3),
        m12=np.zeros(3),
        m33=bit,
        m34=np.zeros(3),
    )
    matrix = beads.mueller(angle)
    assert_array_equal(matrix[:, 2, 2], [1.0, 0.5, -1.0])
    assert_array_equal(matrix[:, 3, 3], matrix[:, 2, 2])
