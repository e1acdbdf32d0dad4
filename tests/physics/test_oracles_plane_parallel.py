"""The deterministic solver of slabs and half-spaces against tables and exact forms."""

from pathlib import Path

import numpy as np
import plane_parallel
import plane_parallel_vector as vector
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

pytestmark = pytest.mark.slow

TESTS = Path(__file__).parents[1]
NATURAL = [1.0, 0.0, 0.0, 0.0]
COSINE = st.floats(0.05, 1.0)


def table(name):
    """Return the rows of a table of reference numbers."""
    return np.loadtxt(TESTS / "reference" / f"{name}.csv", delimiter=",")


def polarizing(asymmetry):
    """Return spheres of a Henyey-Greenstein intensity that polarize as Rayleigh's do.

    The element m34 is made up, and realizable with the others.
    """

    def mueller(angle):
        cosine = np.cos(angle)
        m11 = (1 - asymmetry**2) / (1 + asymmetry**2 - 2 * asymmetry * cosine) ** 1.5
        share = m11 / (1 + cosine**2)
        # Straight ahead and back no plane is singled out, and m34 must vanish.
        sine = np.sin(angle)
        m33, m34 = (2 * cosine * share * f(sine**2) for f in (np.cos, np.sin))
        return vector.sphere_matrix(m11, -share * sine**2, m33, m34)

    return vector.MuellerScatterers(mueller, azimuths=48)


# ----------------------------------------------------------------------- tables, scalar


def test_slab_of_wang_jacques_zheng_and_its_modulated_forms():
    scatterers = plane_parallel.henyey_greenstein(0.75)
    for modulation, *parts in table("slab_henyey_greenstein_modulated"):
        field = plane_parallel.slab(
            scatterers, albedo=0.9, thickness=2.0, modulation=modulation
        )
        found = field.reflected_total[0, 0], field.transmitted_total[0, 0]
        # Half a unit of the last of seven printed decimals.
        expected = complex(*parts[:2]), complex(*parts[2:])
        assert_allclose(np.real(found), np.real(expected), rtol=0, atol=5.1e-8)
        assert_allclose(np.imag(found), np.imag(expected), rtol=0, atol=5.1e-8)


def test_mean_paths_through_that_slab_are_the_slopes_of_the_phase():
    step = 1e-3
    field = plane_parallel.slab(
        plane_parallel.henyey_greenstein(0.75),
        albedo=0.9,
        thickness=2.0,
        modulation=step,
    )
    paths = [
        np.angle(total[0, 0]) / step
        for total in (field.reflected_total, field.transmitted_total)
    ]
    # Published with the table, c times the mean path to five decimals; the phase is odd
    # in the modulation, so the step leaves about step^2 times the third cumulant.
    assert_allclose(paths, [3.63356, 2.46959], rtol=0, atol=2e-5)


def test_radiance_is_that_of_van_de_hulst():
    isotropic = plane_parallel.LegendreSeries([1.0])
    for incidence, reflection, transmission in table("van_de_hulst_1980_table_12"):
        field = plane_parallel.slab(
            isotropic, albedo=0.8, thickness=2.0, incidence=incidence, cosines=0.5
        )
        scale = np.pi / incidence
        found = (
            field.reflected_radiance(1.0, azimuth=0.0).item().real * scale,
            field.transmitted_radiance(1.0, azimuth=0.0).item().real * scale,
        )
        # Half a unit of the fifth decimal.
        assert_allclose(found, [reflection, transmission], rtol=0, atol=5.1e-6)


def test_h_functions_are_those_of_chandrasekhar():
    for albedo, *expected in table("chandrasekhar_h_isotropic"):
        found = plane_parallel.h_function([0.1, 0.5, 1.0], albedo=albedo)
        assert_allclose(found, expected, rtol=0, atol=5.1e-6)  # five decimals


@pytest.mark.parametrize("row", table("half_space_isotropic_modulated"))
def test_half_space_reflects_what_its_h_function_says(row):
    modulation, real, imaginary = row
    albedo = 0.9 / (1 - 1j * modulation)
    closed = plane_parallel.half_space_albedo(1.0, albedo=albedo).item()
    field = plane_parallel.slab(
        plane_parallel.LegendreSeries([1.0]),
        albedo=0.9,
        thickness=np.inf,
        modulation=modulation,
    )
    # Ten decimals are printed; the H function is good to about 1e-13, the doubled
    # layers to what 32 nodes leave.
    assert_allclose([closed.real, closed.imag], [real, imaginary], rtol=0, atol=6e-11)
    assert abs(field.reflected_total[0, 0] - closed) < 1e-8


# ----------------------------------------------------------------------- tables, vector


@pytest.mark.parametrize("ground", [0.0, 0.8])
def test_rayleigh_slab_is_that_of_natraj_li_yung_with_signs(ground):
    rows = table("natraj_2009_rayleigh")
    cosines = [0.02, 0.4, 0.92, 1.0]
    field = plane_parallel.slab(
        vector.rayleigh(),
        albedo=1.0,
        thickness=0.5,
        incidence=0.2,
        cosines=cosines,
        orders=3,
        ground=ground,
        nodes=24,
    )
    for _, cosine, degrees, *stokes in rows[rows[:, 0] == ground]:
        radiance = field.reflected_radiance(NATURAL, azimuth=np.radians(degrees))
        found = np.pi * radiance[cosines.index(cosine), 0]
        # Eight decimals, of which sasktran2 differed by 7e-7; 24 nodes leave 2e-8.
        # The print has its first axis across the meridian plane: -Q and -U.
        expected = [stokes[0], -stokes[1], -stokes[2], 0.0]
        assert_allclose(found, expected, rtol=0, atol=4e-8)


def test_rayleigh_slab_under_normal_light_has_the_known_radiance():
    rows = table("rayleigh_normal_radiance")
    for albedo, thickness in {(row[0], row[1]) for row in rows}:
        some = rows[rows[:, 0] == albedo]
        field = plane_parallel.slab(
            vector.rayleigh(),
            albedo=albedo,
            thickness=thickness,
            cosines=some[:, 2],
            orders=3,
            nodes=16,
        )
        # One radiance at any azimuth: the slab and natural light are round.
        for azimuth in (0.0, 1.3):
            found = np.pi * field.reflected_radiance(NATURAL, azimuth=azimuth)[:, 0]
            # Half a unit of the sixth or seventh decimal printed.
            half = 6e-7 if albedo == 1 else 6e-8
            assert_allclose(found[:, 0], some[:, 3], rtol=0, atol=half)
            assert_allclose(found[:, 1], -some[:, 4], rtol=0, atol=half)
            assert_allclose(found[:, 2:], 0, atol=1e-14)


def test_conservative_rayleigh_slabs_reflect_the_known_flux():
    for thickness, intensity, parallel in table("rayleigh_slab_flux"):
        field = plane_parallel.slab(
            vector.rayleigh(), albedo=1.0, thickness=thickness, nodes=16
        )
        found = field.reflected_total[:2, 0]
        # Half a unit of the sixth decimal.
        assert_allclose(found, [intensity, parallel], rtol=0, atol=5.1e-7)
        conserved = field.reflected_total[0, 0] + field.transmitted_total[0, 0]
        assert abs(conserved - 1) < 1e-12


def test_modulated_rayleigh_slab_has_the_known_fluxes():
    for modulation, *parts in table("rayleigh_slab_modulated"):
        field = plane_parallel.slab(
            vector.rayleigh(),
            albedo=0.9,
            thickness=1.0,
            modulation=modulation,
            nodes=24,
        )
        back, through = field.reflected_total, field.transmitted_total
        found = [
            back[0, 0],
            back[1, 0],
            back[3, 3],
            field.diffuse_total[0, 0],
            through[3, 3],
            field.direct,
        ]
        expected = np.array(parts[::2]) + 1j * np.array(parts[1::2])
        # Half a unit of the seventh decimal, in both parts.
        assert_allclose(found, expected, rtol=0, atol=8e-8)


# ------------------------------------------------------------------------- closed forms


def dipole(state_field, out, into, azimuth):
    """Return the Stokes vector of a dipole that a field in meridian axes drives."""
    _, *axes_in = vector.meridian_axes(np.array(into), np.array(0.0))
    ahead, *axes_out = vector.meridian_axes(np.array(out), np.array(azimuth))
    driving = state_field[0] * axes_in[0] + state_field[1] * axes_in[1]
    radiated = driving - (driving @ ahead) * ahead
    along, across = radiated @ axes_out[0], radiated @ axes_out[1]
    return stokes(along, across)


def stokes(along, across):
    """Return the Stokes vector of two amplitudes, time going as exp(-i omega t)."""
    product = along * np.conj(across)
    power = abs(along) ** 2, abs(across) ** 2
    return np.array(
        [power[0] + power[1], power[0] - power[1], 2 * product.real, 2 * product.imag]
    )


@given(
    out=st.floats(-1, 1),
    into=st.floats(-1, 1),
    azimuth=st.floats(-np.pi, np.pi),
    lag=st.floats(-np.pi, np.pi),
    share=st.floats(0, 1),
)
def test_rayleigh_phase_matrix_is_that_of_a_dipole(out, into, azimuth, lag, share):
    field = np.sqrt(share), np.sqrt(1 - share) * np.exp(1j * lag)
    matrix = vector.phase_matrix(
        vector.rayleigh_matrix, np.array(out), np.array(into), azimuth=np.array(azimuth)
    )
    # The power of a dipole, 2/3 of that radiated into all directions on average.
    expected = 1.5 * dipole(field, out, into, azimuth)
    # Angles near 0 and 180 degrees, where the plane is lost, cost digits.
    assert_allclose(matrix @ stokes(*field), expected, rtol=0, atol=1e-7)


@given(incidence=COSINE, view=COSINE, azimuth=st.floats(0, np.pi), x=st.floats(0, 3))
@settings(max_examples=8)
def test_faint_scatterers_send_back_their_phase_matrix(incidence, view, azimuth, x):
    albedo, thickness, scatterers = 1e-7, 0.7, polarizing(0.3)
    field = plane_parallel.slab(
        scatterers,
        albedo=albedo,
        thickness=thickness,
        modulation=x,
        incidence=incidence,
        cosines=view,
        orders=20,
        nodes=2,
    )
    launched = [1.0, 0.3, -0.5, 0.6]
    matrix = vector.phase_matrix(
        scatterers.mueller,
        np.array(-view),
        np.array(incidence),
        azimuth=np.array(azimuth),
    )
    slant = 1 / view + 1 / incidence
    depth = -np.expm1(-thickness * (1 - 1j * x) * slant) / (slant * (1 - 1j * x))
    expected = albedo / (4 * np.pi * view) * depth * (matrix @ launched)
    found = field.reflected_radiance(launched, azimuth=azimuth)[0, 0]
    # The second order is an albedo below the first; 20 modes leave about 0.3^20.
    assert_allclose(found, expected, rtol=0, atol=1e-6 * abs(expected[0]))


# -------------------------------------------------------------------------- invariances


@given(albedo=st.floats(0, 0.99), x=st.floats(0, 5), incidence=COSINE)
@settings(max_examples=10)
def test_half_space_by_doubling_is_that_of_the_h_function(albedo, x, incidence):
    field = plane_parallel.slab(
        plane_parallel.LegendreSeries([1.0]),
        albedo=albedo,
        thickness=np.inf,
        modulation=x,
        incidence=incidence,
    )
    expected = plane_parallel.half_space_albedo(incidence, albedo=albedo / (1 - 1j * x))
    # 32 nodes of a kernel that is not smooth at grazing cosines.
    assert abs(field.reflected_total[0, 0] - expected) < 1e-7


@given(asymmetry=st.floats(-0.6, 0.6), thickness=st.floats(0.01, 20), incidence=COSINE)
@settings(max_examples=4)
def test_no_light_is_lost_without_absorption(asymmetry, thickness, incidence):
    field = plane_parallel.slab(
        polarizing(asymmetry),
        albedo=1.0,
        thickness=thickness,
        incidence=incidence,
        nodes=12,
    )
    whole = field.reflected_total[0] + field.transmitted_total[0]
    # Whatever the state is. A rule of 24 nodes holds moments up to 0.6^48.
    assert_allclose(whole, [1, 0, 0, 0], rtol=0, atol=1e-6)


@given(first=COSINE, second=COSINE, x=st.floats(0, 2))
@settings(max_examples=3)
def test_swapped_ways_in_and_out_exchange_rows_and_columns(first, second, x):
    azimuth, kernels = 0.9, []
    for incidence, view, turn in ((first, second, azimuth), (second, first, -azimuth)):
        field = plane_parallel.slab(
            polarizing(0.4),
            albedo=0.9,
            thickness=1.5,
            modulation=x,
            incidence=incidence,
            cosines=view,
            orders=6,
            nodes=8,
        )
        columns = [
            field.reflected_radiance(state, azimuth=turn)[0, 0] for state in np.eye(4)
        ]
        kernels.append(np.array(columns).T * view)
    # J. W. Hovenier's reciprocity: the reversed light keeps its parallel axis and turns
    # the perpendicular one, which changes the sign of U and not that of V.
    reverse = np.diag([1.0, 1.0, -1.0, 1.0])
    assert_allclose(kernels[1], reverse @ kernels[0].T @ reverse, rtol=0, atol=1e-12)


def test_matrix_that_polarizes_nothing_is_the_scalar_problem():
    scatterers = plane_parallel.LegendreSeries([1.0, 0.3, 0.1])

    def mueller(angle):
        cosine = np.cos(angle)
        intensity = 1 + 0.9 * cosine + 0.25 * (3 * cosine**2 - 1)
        return vector.sphere_matrix(intensity, *[0 * cosine] * 3)

    case = {"albedo": 0.95, "thickness": 3.0, "modulation": 0.4, "incidence": 0.6}
    view = {"cosines": [0.3, 0.9], "orders": 3, "nodes": 8}
    scalar = plane_parallel.slab(scatterers, **case, **view)
    whole = plane_parallel.slab(
        vector.MuellerScatterers(mueller, azimuths=8), **case, **view
    )
    azimuth = [0.0, 1.0, 2.5]
    for name in ("reflected_radiance", "transmitted_radiance"):
        expected = getattr(scalar, name)(1.0, azimuth=azimuth)[..., 0]
        found = getattr(whole, name)(NATURAL, azimuth=azimuth)[..., 0]
        assert_allclose(found, expected, rtol=0, atol=1e-13)


def test_two_layers_on_each_other_are_one():
    mu, weight = np.polynomial.legendre.leggauss(6)
    mu, weight = (mu + 1) / 2, weight / 2
    scatterers = plane_parallel.henyey_greenstein(0.5)
    kernels = tuple(
        0.45 * scatterers.modes(out, into, 1)[0]
        for out, into in ((mu, mu), (-mu, mu), (mu, -mu), (-mu, -mu))
    )
    first, second, whole = (
        plane_parallel.homogeneous(
            kernels, mu=mu, weight=weight, thickness=thickness, factor=1 - 0.3j
        )
        for thickness in (0.3, 1.7, 2.0)
    )
    found = plane_parallel.add(first, second, weight=weight)
    for part, expected in zip(found, whole, strict=True):
        assert_allclose(part, expected, rtol=0, atol=1e-12)


def test_tabulated_matrices_give_the_field_of_the_function():
    angle = np.linspace(0, np.pi, 181)
    read = vector.tabulated(angle, 7 * vector.rayleigh_matrix(angle), azimuths=8)
    fields = [
        plane_parallel.slab(scatterers, albedo=0.9, thickness=1.0, nodes=8)
        for scatterers in (read, vector.rayleigh())
    ]
    # A cubic spline with steps of one degree leaves (pi / 180)^4 / 384 and less.
    assert_allclose(
        fields[0].reflected_total, fields[1].reflected_total, rtol=0, atol=1e-8
    )
