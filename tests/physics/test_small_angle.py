"""Small-angle form against plain quadrature, closed limits and the diffusion form."""

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
import water_response_2d as oracle
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light
from scipy.integrate import quad
from scipy.special import erf, j0

from amulor.optics import small_angle, small_angle_diffusion
from amulor.optics.phase_functions import (
    forward_split,
    henyey_greenstein,
    henyey_greenstein_forward_fraction,
)

FREQUENCIES = np.array([0.0, 5e6, 40e6, 150e6, 500e6])
INSTRUMENT = {"baseline": 0.2, "receiver_radius": 0.02, "acceptance_angle": 0.08}
PEAKED = partial(henyey_greenstein, asymmetry=0.97)


def gaussians(*terms):
    """Return a phase function of Gaussians, each (share, width), integral 1."""

    def shape(angle):
        return sum(
            share / (np.pi * width**2) * np.exp(-((angle / width) ** 2))
            for share, width in terms
        )

    def density(angle):
        return 2 * np.pi * np.sin(angle) * shape(angle)

    points = [0.0, *(s * w for _, w in terms for s in (1, 3, 8) if s * w < 3), np.pi]
    points = sorted(points)
    whole = sum(
        quad(density, low, high, epsabs=0, epsrel=1e-12)[0]
        for low, high in pairwise(points)
    )
    return lambda angle: shape(angle) / whole


# ------------------------------------------------------------- plain quadrature


def drawn_columns():
    """Return seeded columns with their phase functions."""
    rng = np.random.default_rng(958360)
    cases = []
    for number in range(8):
        if number % 4 < 3:
            phase_function = partial(
                henyey_greenstein, asymmetry=rng.uniform(0.9, 0.99)
            )
        else:
            share = rng.uniform(0.3, 0.9)
            phase_function = gaussians(
                (share, rng.uniform(0.02, 0.05)), (1 - share, rng.uniform(0.15, 0.4))
            )
        attenuation = np.exp(rng.uniform(np.log(0.1), np.log(2.0)))
        albedo = rng.uniform(0.3, 0.95)
        cases.append(
            {
                "phase_function": phase_function,
                "split_angle": [np.pi / 2, np.pi / 3][number // 4],
                "absorption": attenuation * (1 - albedo),
                "scattering": attenuation * albedo,
                "group_index": rng.uniform(1.33, 1.40),
                "baseline": [0.07, 0.2][number % 2],
                "receiver_radius": np.exp(rng.uniform(np.log(0.008), np.log(0.05))),
                "acceptance_angle": np.exp(rng.uniform(np.log(0.03), np.log(0.15))),
                "beam_radius": [0.0, 0.01][number % 2],
                "beam_divergence": [0.0, 0.005][number // 2 % 2],
                "tilt": [0.0, 0.05][number // 4],
                "cross_tilt": [0.02, 0.0, 0.0][number % 3],
                "standoff": [0.0, 0.0, 0.3][number % 3],
                "end": [1.5, 4.0, np.inf][number % 3],
            }
        )
    return cases


@pytest.mark.parametrize(
    "number",
    # Each value of each argument is in one of the first five.
    [*(1, 3, 4, 5, 7), *(pytest.param(k, marks=pytest.mark.slow) for k in (0, 2, 6))],
)
def test_response_agrees_with_plain_quadrature(number):
    column = drawn_columns()[number]
    expected = oracle.water_response(FREQUENCIES, **column)
    found = small_angle.water_response(FREQUENCIES, **column, backscatter_vsf=1.0)
    # The promise of the docstring, for losses, fields and ends of all sizes.
    assert_allclose(found, expected, rtol=0, atol=1e-7 * expected[0].real)


def test_overlap_agrees_with_plain_quadrature():
    column = {"absorption": 0.1, "scattering": 0.6, **INSTRUMENT}
    fraction, integrated = oracle.integrated_transform(PEAKED, np.pi / 2, 200.0)
    depth = np.array([1.0, 2.0, 4.0])
    expected = [
        oracle.overlap(np.array([z]), integrated, fraction=fraction, **column)[0]
        for z in depth
    ]
    found = small_angle.overlap(
        depth, phase_function=PEAKED, split_angle=np.pi / 2, **column
    )
    assert_allclose(found, np.pi * (0.02 * 0.08) ** 2 * np.array(expected), rtol=1e-8)


class WithTransform:
    """Stand-in with a Gaussian transform, whose integral is the error function."""

    def __call__(self, angle):
        return henyey_greenstein(angle, asymmetry=0.97)

    def hankel(self, direction_frequency, *, split_angle):
        return np.exp(-((0.05 * direction_frequency) ** 2))


@pytest.mark.parametrize("depth", [0.5, 1.5, 5.0])
def test_overlap_is_the_integral_for_a_gaussian_transform(depth):
    share = float(
        henyey_greenstein_forward_fraction(asymmetry=0.97, split_angle=np.pi / 2)
    )
    area = 0.02**2 + (0.08 * depth) ** 2

    def integrand(kappa):
        mean = np.sqrt(np.pi) / (0.1 * kappa) * erf(0.05 * kappa * depth)
        exponent = 2 * 0.7 * share * mean - 2 * 0.8 * depth - area * kappa**2 / 4
        return kappa * j0(0.2 * kappa) * np.exp(exponent)

    top = 14 / np.sqrt(area)
    value = quad(integrand, 1e-12, top, epsabs=1e-11 / area, epsrel=1e-11, limit=500)[0]
    found = small_angle.overlap(
        depth,
        absorption=0.1,
        scattering=0.7,
        phase_function=WithTransform(),
        split_angle=np.pi / 2,
        **INSTRUMENT,
    )
    # At 0.5 m only exp(-20) of the light on the axis is left at 0.2 m.
    axis = np.pi * (0.02 * 0.08) ** 2 / area * np.exp(-1.6 * depth)
    expected = np.pi * (0.02 * 0.08) ** 2 / 2 * value
    assert_allclose(found, expected, rtol=1e-8, atol=1e-9 * axis)


# ------------------------------------------------------------- closed limits


def test_wide_aperture_keeps_all_light_scattered_forward():
    column = {"absorption": 0.15, "scattering": 0.85, "group_index": 1.34}
    share = float(
        henyey_greenstein_forward_fraction(asymmetry=0.97, split_angle=np.pi / 2)
    )
    reduced = 0.15 + 0.85 * (1 - share)
    rate = reduced - 2j * np.pi * FREQUENCIES * 1.34 / speed_of_light
    expected = 2e-3 * np.pi / 2 * 1e-3**2 / rate
    found = small_angle.water_response(
        FREQUENCIES,
        phase_function=PEAKED,
        split_angle=np.pi / 2,
        backscatter_vsf=2e-3,
        baseline=0.2,
        receiver_radius=1e5,
        acceptance_angle=1e-3,
        **column,
    )
    # Eq. (49) with k'. Light spreads by metres, 1e-5 of the aperture.
    assert_allclose(found, expected, rtol=0, atol=1e-8 * expected[0].real)


@pytest.mark.parametrize("scattering", [0.0, 1e-9, 1e-5])
def test_without_scattering_it_is_the_closed_form(scattering):
    expected = small_angle_diffusion.water_response(
        FREQUENCIES,
        absorption=0.5,
        forward_scattering=0.0,
        diffuse_scattering=0.0,
        second_moment=0.0,
        backscatter_vsf=1e-3,
        group_index=1.34,
        **INSTRUMENT,
    )
    found = small_angle.water_response(
        FREQUENCIES,
        absorption=0.5,
        scattering=scattering,
        phase_function=PEAKED,
        split_angle=np.pi / 2,
        backscatter_vsf=1e-3,
        group_index=1.34,
        **INSTRUMENT,
    )
    # Twice the optical thickness of the 5 m or so from where light returns.
    atol = (10 * scattering + 1e-12) * expected[0].real
    assert_allclose(found, expected, rtol=0, atol=atol)


def test_first_order_in_scattering_is_single_scattering():
    # Scattered once by p on its way: 2 b int ds of p_hat, the rest as in clear water.
    split = np.pi / 2
    depth, b = 2.0, 1e-4
    area = 0.02**2 + (0.08 * depth) ** 2
    share = float(henyey_greenstein_forward_fraction(asymmetry=0.97, split_angle=split))
    kappa, weight = oracle.gauss(np.linspace(0, 12 / np.sqrt(area), 40), 12)
    s, step = oracle.gauss(np.linspace(0, depth, 30), 8)
    products = np.multiply.outer(kappa, s)
    _, value = oracle.transform(PEAKED, split, products.ravel())
    mean = value.reshape(products.shape) @ step
    window = kappa * j0(0.2 * kappa) * np.exp(-area * kappa**2 / 4)
    once = np.pi / 2 * (0.02 * 0.08) ** 2 * 2 * b * share * (weight * window) @ mean
    none = np.pi * (0.02 * 0.08) ** 2 / area * np.exp(-(0.2**2) / area)
    found = small_angle.overlap(
        depth,
        absorption=0.0,
        scattering=b,
        phase_function=PEAKED,
        split_angle=split,
        **INSTRUMENT,
    )
    scattered = found * np.exp(2 * b * depth) - none
    # The second order is b z, 2e-4, of the first.
    assert_allclose(scattered, once, rtol=4e-4)


# ------------------------------------------------------------- diffusion form


def both_forms(width):
    """Return the two responses for D fixed and scattering by this width [rad]."""
    scattering = 0.05 / width**2
    phase_function = gaussians((1.0, width))
    share, moment = forward_split(phase_function, split_angle=np.pi / 2)
    frequency = np.array([0.0, 20e6, 60e6])
    common = {"absorption": 0.3, "backscatter_vsf": 1e-3, "group_index": 1.34}
    exact = small_angle.water_response(
        frequency,
        scattering=scattering,
        phase_function=phase_function,
        split_angle=np.pi / 2,
        **common,
        **INSTRUMENT,
    )
    diffusion = small_angle_diffusion.water_response(
        frequency,
        forward_scattering=scattering * share,
        diffuse_scattering=0.0,
        second_moment=moment,
        **common,
        **INSTRUMENT,
    )
    return exact, diffusion


def test_it_goes_over_into_the_diffusion_form_with_the_square_of_the_width():
    errors = []
    for width in (0.02, 0.01, 0.005):
        exact, diffusion = both_forms(width)
        errors.append(np.max(np.abs(exact - diffusion)) / exact[0].real)
    # The fourth moment is the first term left out: with b <theta^2> fixed it falls
    # with the width squared, so each halving divides the error by 4.
    assert errors[-1] < 1e-3
    assert_allclose(np.divide(errors[:-1], errors[1:]), 4, rtol=0.1)


def test_diffusion_form_is_off_by_what_the_physics_note_states():
    # A Gaussian forward part at 1 to 6 scatterings, seen on the axis and off it.
    width = 0.1
    phase_function = gaussians((1.0, width))
    share, moment = forward_split(phase_function, split_angle=np.pi / 2)
    scattering = np.linspace(1, 6, 11) / 3.0
    ratios = []
    for baseline in (0.0, 0.2):
        instrument = INSTRUMENT | {"baseline": baseline}
        exact = small_angle.overlap(
            3.0,
            absorption=0.0,
            scattering=scattering,
            phase_function=phase_function,
            split_angle=np.pi / 2,
            **instrument,
        )
        diffusion = small_angle_diffusion.overlap(
            3.0,
            absorption=0.0,
            forward_scattering=share * scattering,
            diffuse_scattering=0.0,
            second_moment=moment,
            **instrument,
        )
        ratios.append(diffusion / exact)
    # 0.42 to 1.12 over the cases of the rebuilt derivation.
    assert np.min(ratios) > 0.42
    # The diffusion form spreads the light that was not scattered with the rest.
    assert np.max(ratios) < 0.95


# ------------------------------------------------------------- drawn columns

columns = st.fixed_dictionaries(
    {
        "absorption": st.floats(0.01, 1.0),
        "scattering": st.floats(0.0, 3.0),
        "baseline": st.floats(0.0, 0.3),
        "receiver_radius": st.floats(0.005, 0.05),
        "acceptance_angle": st.floats(0.02, 0.15),
        "beam_radius": st.floats(0.001, 0.03),
        "beam_divergence": st.floats(0.001, 0.05),
        "tilt": st.floats(-0.1, 0.1),
        "cross_tilt": st.floats(-0.05, 0.05),
        "standoff": st.floats(0.0, 0.5),
        "end": st.one_of(st.just(np.inf), st.floats(0.5, 10.0)),
    }
)
COMMON = {
    "phase_function": PEAKED,
    "split_angle": np.pi / 2,
    "backscatter_vsf": 1e-3,
    "group_index": 1.34,
}


@settings(max_examples=25)
@given(column=columns, frequency=st.floats(0, 1e9))
def test_response_is_at_most_that_at_zero_frequency(column, frequency):
    at_zero, found = small_angle.water_response([0.0, frequency], **column, **COMMON)
    assert at_zero.imag == 0
    assert abs(found) <= at_zero.real * (1 + 1e-7) + 1e-25  # its stated error


@settings(max_examples=25)
@given(column=columns, frequency=st.floats(0, 3e8))
def test_beam_and_receiver_may_change_places(column, frequency):
    swapped = column | {
        "receiver_radius": column["beam_radius"],
        "acceptance_angle": column["beam_divergence"],
        "beam_radius": column["receiver_radius"],
        "beam_divergence": column["acceptance_angle"],
        "cross_tilt": -column["cross_tilt"],
    }
    first = small_angle.water_response([0.0, frequency], **column, **COMMON)
    second = small_angle.water_response([0.0, frequency], **swapped, **COMMON)
    first /= (column["receiver_radius"] * column["acceptance_angle"]) ** 2
    second /= (column["beam_radius"] * column["beam_divergence"]) ** 2
    assert_allclose(first, second, rtol=0, atol=1e-10 * abs(second[0]) + 1e-20)


@settings(max_examples=15)
@given(column=columns, end=st.floats(1.0, 8.0))
def test_response_is_the_integral_of_the_overlap(column, end):
    column = column | {"end": end}
    node, weight = np.polynomial.legendre.leggauss(24)
    edges = np.concatenate([[0.0], np.geomspace(0.01, end, 24)])
    half = np.diff(edges)[:, None] / 2
    depth = edges[:-1, None] + half * (node + 1)
    arguments = {name: column[name] for name in column if name != "end"}
    values = small_angle.overlap(
        depth, phase_function=PEAKED, split_angle=np.pi / 2, **arguments
    )
    wavenumber = 4 * np.pi * 30e6 * 1.34 / speed_of_light
    turning = values * np.exp(1j * wavenumber * depth)
    expected = 1e-3 * np.sum(half * weight * turning)
    at_zero = 1e-3 * np.sum(half * weight * values)
    found = small_angle.water_response(30e6, **column, **COMMON)
    assert_allclose(found, expected, rtol=0, atol=1e-7 * at_zero + 1e-25)
