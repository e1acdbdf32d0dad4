"""Published tables of constants, row by row and to the digits that are printed."""

import csv
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import special
from scipy.constants import speed_of_light

from amulor.optics import (
    extrema,
    interference,
    low_pass,
    ranging,
    small_angle_diffusion,
)
from amulor.optics.phase_functions import mie
from amulor.optics.phase_functions.tables import STATIONS, petzold
from amulor.optics.polarization import mueller
from amulor.optics.water import pure_water, seawater
from amulor.optics.water import types as water_types

REFERENCE = Path(__file__).parents[1] / "reference"
HARBOUR = ("NUC 2200", "NUC 2040", "NUC 2240")
needs_mie = pytest.mark.usefixtures("miepython")


@pytest.fixture(scope="module")
def miepython():
    return pytest.importorskip("miepython")


def numbers(name):
    return np.loadtxt(REFERENCE / name, delimiter=",").tolist()


def shipped(name):
    """Return the rows of a table of the package, read without the package."""
    source = resources.files("amulor.optics").joinpath("data", name)
    lines = source.read_text(encoding="utf-8").splitlines()
    return list(csv.reader(line for line in lines if not line.startswith("#")))


def running_integrals(station):
    """Return angles [rad], scattering function and shares that Petzold prints."""
    table = REFERENCE / "petzold_1972_running_integrals.csv"
    lines = table.read_text(encoding="utf-8").splitlines()
    rows = csv.reader(line for line in lines if not line.startswith("#"))
    degrees, *others = np.array([row[1:] for row in rows if row[0] == station], float).T
    return np.minimum(np.radians(degrees), np.pi), *others


# ------------------------------------------------------------- Mie


def conductor(size_parameter, index):
    """Return scattering and asymmetry of a metal sphere, extrapolated to no depth.

    A perfect conductor has no index. Departures go with the depth of the skin, as
    1 / index; twice the value at twice the index less the value leaves second order.
    """
    one, two = (
        mie.sphere(size_parameter, relative_index=factor * index * (1 + 1j))
        for factor in (1, 2)
    )
    return 2 * two.scattering - one.scattering, 2 * two.asymmetry - one.asymmetry


def exact_conductor(x):
    """Return scattering and asymmetry of a perfect conductor, from its own series."""
    order = np.arange(1, int(x + 4 * x ** (1 / 3)) + 12)
    j, y = special.spherical_jn(order, x), special.spherical_yn(order, x)
    psi, chi = x * j, x * y
    d_psi = j + x * special.spherical_jn(order, x, derivative=True)
    d_chi = y + x * special.spherical_yn(order, x, derivative=True)
    a, b = d_psi / (d_psi + 1j * d_chi), psi / (psi + 1j * chi)
    scattering = 2 / x**2 * np.sum((2 * order + 1) * (abs(a) ** 2 + abs(b) ** 2))
    n, an, bn = order[:-1], a[:-1], b[:-1]
    pairs = np.conj(a[1:]) * an + np.conj(b[1:]) * bn
    both = n * (n + 2) / (n + 1) * pairs.real
    both += (2 * n + 1) / (n * (n + 1)) * (an * np.conj(bn)).real
    return scattering, 4 / x**2 * np.sum(both) / scattering


@needs_mie
@pytest.mark.parametrize("row", numbers("mie_conductors.csv"))
def test_very_good_conductors_tend_to_the_perfect_ones_of_wiscombe(row):
    x, scattering, digit, asymmetry = row
    # Where the sphere is small the index has to be large for its skin to be thin.
    found = conductor(x, max(1e4, 1e6 / x) if x < 1e4 else 1e4)
    assert_allclose(found[0], scattering, rtol=0, atol=1.1 * digit)
    if x == 0.099:
        # Printed from the series for small spheres, which is 1.2e-5 off here.
        assert_allclose(found[1], exact_conductor(x)[1], rtol=0, atol=1.1e-6)
        assert_allclose(found[1], asymmetry, rtol=0, atol=1.3e-5)
    elif not np.isnan(asymmetry):
        assert_allclose(found[1], asymmetry, rtol=0, atol=1.1e-6)


@pytest.mark.parametrize("row", numbers("mie_conductors.csv")[2:4])
def test_the_series_of_a_perfect_conductor_gives_the_printed_digits(row):
    # What the limit above is measured against, checked by itself.
    x, scattering, _, asymmetry = row
    assert_allclose(exact_conductor(x), (scattering, asymmetry), rtol=0, atol=6e-7)


@needs_mie
@pytest.mark.parametrize("row", numbers("mie_backward_amplitudes.csv"))
def test_amplitudes_straight_back_match_wiscombe(row):
    n, x, real, imaginary, digit, scattering, last = row
    if not np.isnan(real):
        s1, _ = mie.amplitudes(np.pi, size_parameter=x, relative_index=n)
        # exp(+i omega t) there; one unit of the last digit printed.
        assert_allclose(s1.conjugate(), complex(real, imaginary), rtol=0, atol=digit)
    found = mie.sphere(x, relative_index=n)
    if not np.isnan(scattering):
        assert_allclose(found.scattering, scattering, rtol=0, atol=1.1 * last)
        assert_allclose(found.extinction, found.scattering, rtol=1e-9)
    if not np.isnan(real):
        # Two routes: Q_back = |2 S1 / x|^2.
        assert_allclose(found.backscattering, abs(2 * s1 / x) ** 2, rtol=1e-5)


@needs_mie
@pytest.mark.parametrize("row", numbers("calibration_spheres.csv"))
def test_calibration_spheres_have_the_efficiencies_that_were_worked_out(row):
    diameter, wavelength, particle, water, x, relative, *expected = row
    size = np.pi * diameter * 1e3 * water / wavelength
    assert_allclose(size, x, rtol=0, atol=6e-7)
    assert_allclose(particle / water, relative, rtol=0, atol=6e-7)
    found = mie.sphere(size, relative_index=particle / water)
    values = found.scattering, found.backscattering, found.asymmetry
    # Seven, seven and six decimals.
    assert_allclose(values[:2], expected[:2], rtol=0, atol=6e-8)
    assert_allclose(values[2], expected[2], rtol=0, atol=6e-7)


# ------------------------------------------------------------- closed forms


@pytest.mark.parametrize(
    ("reduced_attenuation", "megahertz"), [(0.1, 3.56), (0.5, 17.80), (1.0, 35.61)]
)
def test_half_power_of_a_narrow_receiver_lies_where_it_is_printed(
    reduced_attenuation, megahertz
):
    found = low_pass.cut_off(
        lambda f: small_angle_diffusion.narrow_receiver_response(
            f,
            absorption=0.2 * reduced_attenuation,
            diffuse_scattering=0.8 * reduced_attenuation,
            backscatter_vsf=1e-3,
            group_index=1.34,
            acceptance_angle=0.01,
        )
    )
    assert_allclose(found / 1e6, megahertz, rtol=0, atol=0.0051)  # two decimals


def test_a_slab_of_water_has_its_closed_form():
    # [exp(-2 q z1) - exp(-2 q z2)] / 2 q with q = k' - i omega / v.
    frequency, index, loss = np.array([0.0, 10e6, 100e6]), 1.34, 0.5
    water = {
        "absorption": 0.1,
        "forward_scattering": 0.0,
        "diffuse_scattering": 0.4,
        "second_moment": 0.0,
        "backscatter_vsf": 1e-3,
        "group_index": index,
        "baseline": 0.0,
        "receiver_radius": 100.0,
        "acceptance_angle": 1e-3,
    }
    near, far = (
        small_angle_diffusion.water_response(frequency, end=end, **water)
        for end in (1.0, 4.0)
    )
    q = loss - 2j * np.pi * frequency * index / speed_of_light
    slab = (np.exp(-2 * q * 1.0) - np.exp(-2 * q * 4.0)) / (2 * q)
    # The receiver widens by 4 mm in 100 m, 2e-9 of its area.
    assert_allclose(far - near, 1e-3 * np.pi * 1e-6 * slab, rtol=1e-8)


@pytest.mark.parametrize(
    ("separation", "distance"), [(25e6, 4.34), (33.5e6, 3.24), (43.4e6, 2.50)]
)
def test_maxima_are_as_far_apart_as_the_target_is_behind_the_water(
    separation, distance
):
    # v / 2 (z_t - z_w), group index 1.380; distances are given to two decimals.
    gap = ranging.ambiguity_interval(separation, group_index=1.380)
    assert_allclose(gap, distance, rtol=0, atol=0.0051)
    frequency = np.linspace(0, 4 * separation, 2001)
    delay = 4 * np.pi * frequency * 1.380 * float(gap) / speed_of_light
    total = interference.total_signal(np.exp(1j * delay), np.full(2001, 0.3))
    found = extrema.find(frequency, np.abs(total))
    # Parabolas through three of 500 samples a period.
    assert_allclose(found.separations, separation, rtol=1e-5)


def test_phase_error_of_target_and_water_is_the_closed_form():
    target, water = 2.0 * np.exp(0.7j), 0.5 * np.exp(0.7j - 1.3j)
    error = interference.phase_error(target, water)
    # arg(1 + 0.25 exp(-1.3 i)), worked out in real numbers, and its bound asin(0.25).
    expected = np.arctan(-0.25 * np.sin(1.3) / (1 + 0.25 * np.cos(1.3)))
    assert_allclose(error, expected, rtol=1e-13)
    assert abs(error) <= np.arcsin(0.25)


def test_rayleigh_backscatter_without_depolarization_is_diagonal():
    assert_allclose(
        mueller.rayleigh(np.pi), np.diag([1, 1, -1, -1]), rtol=0, atol=1e-15
    )


# ------------------------------------------------------------- tables of water


@pytest.mark.parametrize(("nm", "expected"), [(488, 1.337395), (589.3, 1.333349)])
def test_two_formulas_for_the_index_of_fresh_water_agree(nm, expected):
    # Daimon and Masumura, Appl. Opt. 46, 3811 (2007), at 20 degC, against that of IAPWS
    # at 998.207 kg/m^3. They were compared at other wavelengths within 5e-6.
    found = seawater.iapws_refractive_index(nm * 1e-9, temperature=20, density=998.207)
    assert_allclose(found, expected, rtol=0, atol=5e-6)


@pytest.mark.parametrize("station", STATIONS)
def test_petzold_goes_through_all_55_printed_values(station):
    angle, printed, share = running_integrals(station)
    water = petzold(station)
    assert angle.size == 55
    assert_allclose(water.integral * water(angle), printed, rtol=1e-12)
    # The report integrates by another rule, straight lines on its plot: 0.13 %.
    assert_allclose(water.cumulative(angle), share, rtol=0, atol=1.3e-3)


def test_the_mean_of_the_harbour_stations_is_that_of_another_program():
    middle, expected = np.array(numbers("petzold_harbor_mean.csv")).T
    angle, _, _ = running_integrals("NUC 2040")
    # That table gives the middle of each step beside the share up to its end.
    degrees = np.degrees(np.concatenate([[0.0], angle]))
    assert_allclose((degrees[1:] + degrees[:-1]) / 2, middle, rtol=1e-3)
    found = np.mean([petzold(name).cumulative(angle) for name in HARBOUR], axis=0)
    # Each integrates by a rule of its own, as does the report itself, by 0.13 %.
    assert_allclose(found, expected, rtol=0, atol=1e-3)


def test_pope_and_fry_is_met_in_every_row():
    nm, expected = np.array(shipped("pope_fry_1997.csv"), float).T
    assert nm.size == 140
    found = pure_water.pope_fry_absorption(nm * 1e-9)
    assert_allclose(found, expected, rtol=1e-9)  # nodes, up to rounding


def test_mason_is_met_in_every_row_and_column():
    columns = np.array(shipped("wopp_v3_mason_2016.csv"), float).T
    nm, cold, per_salinity, per_degree, sigma, salinity_sigma, degree_sigma = columns
    assert nm.size == 301

    def absorption(temperature, salinity):
        return pure_water.mason_absorption(
            nm * 1e-9, temperature=temperature, salinity=salinity
        )

    def uncertainty(temperature, salinity):
        return pure_water.mason_absorption_uncertainty(
            nm * 1e-9, temperature=temperature, salinity=salinity
        )

    assert_allclose(absorption(20, 0), cold, rtol=1e-9)
    # Differences of absorptions up to 7 1/m, each rounded to 1e-16.
    warm = (absorption(30, 0) - cold) / 10
    salt = (absorption(20, 40) - cold) / 40
    assert_allclose(warm, per_degree, rtol=1e-9, atol=1e-13)
    assert_allclose(salt, per_salinity, rtol=1e-9, atol=1e-13)
    assert_allclose(uncertainty(20, 0), sigma, rtol=1e-9)
    expected = np.sqrt(sigma**2 + (10 * degree_sigma) ** 2 + (40 * salinity_sigma) ** 2)
    assert_allclose(uncertainty(30, 40), expected, rtol=1e-9)


@pytest.mark.parametrize("source", water_types.JERLOV_SOURCES)
def test_jerlov_types_are_met_in_every_row(source):
    _, *rows = shipped(water_types.JERLOV_SOURCES[source])
    types = list(dict.fromkeys(row[0] for row in rows))
    for water_type in types:
        nm, absorption, scattering = np.array(
            [row[1:4] for row in rows if row[0] == water_type], float
        ).T
        water = water_types.jerlov(water_type, nm * 1e-9, source=source)
        assert_allclose(water.absorption, absorption, rtol=1e-9, atol=1e-15)
        assert_allclose(water.scattering, scattering, rtol=1e-9)
    assert len(types) == {"solonenko-mobley-2015": 10}.get(source, 6)


def test_deviations_of_the_campaigns_are_met_in_every_row():
    header, *rows = shipped("williamson_hollins_2022_measured.csv")
    spread = [
        header.index(f"{name}_deviation_per_m") for name in ("absorption", "scattering")
    ]
    assert len(rows) > 40
    for row in rows:
        water = water_types.jerlov(
            row[0], float(row[1]) * 1e-9, source="williamson-hollins-2022"
        )
        found = float(water.absorption_deviation), float(water.scattering_deviation)
        assert_allclose(found, [float(row[i]) for i in spread], rtol=1e-9)
        assert water.status == "measured"
