"""Claims about the Henyey-Greenstein function and the forward-diffuse split."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import quad

from amulor.optics import phase_functions

TABLE = Path(__file__).parents[3] / "reference" / "henyey_greenstein_moments.csv"

asymmetries = st.floats(-0.95, 0.999)
angles = st.floats(1e-3, np.pi)
CATALAN = 0.915965594177219015
COSINE, WEIGHT = np.polynomial.legendre.leggauss(200)


def reference() -> np.ndarray:
    return np.loadtxt(TABLE, delimiter=",", unpack=True)


def test_second_moment_of_the_forward_half_matches_the_published_table():
    g = [0.90, 0.95, 0.96, 0.97, 0.98, 0.99]
    moment = phase_functions.henyey_greenstein_second_moment(
        asymmetry=g, split_angle=np.pi / 2
    )
    # Three decimals are given.
    assert_allclose(
        moment, [0.149, 0.075, 0.060, 0.045, 0.030, 0.015], rtol=0, atol=5.1e-4
    )


def test_second_moment_of_the_whole_sphere_matches_the_published_table():
    g = [0.90, 0.95, 0.96, 0.97, 0.98, 0.99]
    moment = phase_functions.henyey_greenstein_second_moment(
        asymmetry=g, split_angle=np.pi
    )
    assert_allclose(
        moment, [0.243, 0.121, 0.096, 0.072, 0.048, 0.024], rtol=0, atol=5.1e-4
    )


def test_second_moment_matches_quadrature_with_30_digits():
    g, split, _, expected = reference()
    moment = phase_functions.henyey_greenstein_second_moment(
        asymmetry=g, split_angle=split
    )
    # Promised: 1e-12, and what the rounding of g does to 1 - g.
    tolerance = 1e-12 + 1e-16 / (1 - np.abs(g))
    assert np.all(np.abs(moment / expected - 1) <= tolerance)


def test_forward_fraction_matches_quadrature_with_30_digits():
    g, split, expected, _ = reference()
    fraction = phase_functions.henyey_greenstein_forward_fraction(
        asymmetry=g, split_angle=split
    )
    # Close to g = 1 the input g = 0.99999 itself is rounded: 1e-16 / 1e-5.
    assert_allclose(fraction, expected, rtol=2e-11)


def test_second_moment_tends_to_8_catalan_less_half_pi_squared_times_1_minus_g():
    # For g -> 1, p -> (1 - g) / (16 pi sin^3(theta/2)), whose moment integrates to
    # 8 G - pi^2 / 2 = 2.3929 with Catalan's constant G.
    moment = phase_functions.henyey_greenstein_second_moment(
        asymmetry=1 - 1e-6, split_angle=np.pi
    )
    # The next term is of order (1 - g)^2, here 1e-6 of the first.
    assert_allclose(moment / 1e-6, 8 * CATALAN - np.pi**2 / 2, rtol=1e-5)


def test_second_moment_of_isotropic_scattering_is_pi_less_2_for_half_a_sphere():
    # int theta^2 sin / int sin from 0 to pi/2 and from 0 to pi.
    moment = phase_functions.henyey_greenstein_second_moment(
        asymmetry=0.0, split_angle=[np.pi / 2, np.pi]
    )
    assert_allclose(moment, [np.pi - 2, (np.pi**2 - 4) / 2], rtol=1e-13)


@settings(deadline=None, max_examples=50)
@given(asymmetries, angles)
def test_second_moment_lies_between_zero_and_the_split_squared(g, split):
    moment = phase_functions.henyey_greenstein_second_moment(
        asymmetry=g, split_angle=split
    )
    assert 0 < moment < split**2


@settings(deadline=None, max_examples=50)
@given(asymmetries, st.floats(0.05, np.pi))
def test_second_moment_grows_with_the_split_by_what_is_added(g, split):
    def part(angle):
        options = {"asymmetry": g, "split_angle": angle}
        return phase_functions.henyey_greenstein_second_moment(
            **options
        ) * phase_functions.henyey_greenstein_forward_fraction(**options)

    inner = 0.7 * split
    added, _ = quad(
        lambda t: (
            2
            * np.pi
            * t**2
            * np.sin(t)
            * phase_functions.henyey_greenstein(t, asymmetry=g)
        ),
        inner,
        split,
    )
    # quad promises 1.5e-8; it does far better on such a smooth piece.
    assert_allclose(part(split) - part(inner), added, rtol=1e-8, atol=1e-14)


def test_henyey_greenstein_at_180_degrees_is_closed():
    # (1 - g^2) / (4 pi (1 + g)^3) = (1 - g) / (4 pi (1 + g)^2).
    for g in (0.5, 0.97, 0.999):
        p = phase_functions.henyey_greenstein(np.pi, asymmetry=g)
        assert_allclose(p, (1 - g) / (4 * np.pi * (1 + g) ** 2), rtol=1e-13)


def test_henyey_greenstein_at_0_degrees_keeps_its_digits():
    # (1 + g) / (4 pi (1 - g)^2); 1 - g = 2^-20 is exact in binary.
    g = 1 - 2.0**-20
    p = phase_functions.henyey_greenstein(0.0, asymmetry=g)
    assert_allclose(p, (1 + g) / (4 * np.pi * 2.0**-40), rtol=1e-15)


def test_henyey_greenstein_of_zero_asymmetry_is_isotropic():
    angle = np.linspace(0, np.pi, 7)
    p = phase_functions.henyey_greenstein(angle, asymmetry=0.0)
    assert_allclose(p, 1 / (4 * np.pi), rtol=1e-15)


@settings(deadline=None, max_examples=50)
@given(st.floats(-0.9, 0.9))
def test_asymmetry_is_the_mean_cosine_and_the_integral_is_1(g):
    p = phase_functions.henyey_greenstein(np.arccos(COSINE), asymmetry=g)
    share = 2 * np.pi * WEIGHT * p
    # The rule converges like g^400; arccos near the ends costs a few digits.
    assert_allclose(share.sum(), 1, rtol=1e-11)
    assert_allclose((share * COSINE).sum(), g, rtol=0, atol=1e-11)


@settings(deadline=None, max_examples=50)
@given(asymmetries, angles)
def test_turning_the_asymmetry_round_mirrors_the_function(g, angle):
    p = phase_functions.henyey_greenstein(np.pi - angle, asymmetry=-g)
    # pi - angle is rounded, which the peak of width 1e-3 amplifies.
    assert_allclose(
        p, phase_functions.henyey_greenstein(angle, asymmetry=g), rtol=1e-11
    )
    below = phase_functions.henyey_greenstein_cumulative(angle, asymmetry=g)
    beyond = phase_functions.henyey_greenstein_cumulative(np.pi - angle, asymmetry=-g)
    assert_allclose(below + beyond, 1, rtol=0, atol=1e-12)


@settings(deadline=None, max_examples=50)
@given(asymmetries)
def test_backscatter_fraction_is_what_is_not_forward(g):
    back = phase_functions.henyey_greenstein_backscatter_fraction(asymmetry=g)
    forward = phase_functions.henyey_greenstein_forward_fraction(
        asymmetry=g, split_angle=np.pi / 2
    )
    assert_allclose(back + forward, 1, rtol=0, atol=1e-14)


def test_backscatter_fraction_of_extreme_asymmetries_is_closed():
    # g = 0: 1/2. g -> 1: (1 - g) (sqrt 2 - 1) / 2, the product of s = sqrt 2, 2 + s.
    back = phase_functions.henyey_greenstein_backscatter_fraction(
        asymmetry=[0.0, 1 - 1e-9]
    )
    assert back[0] == 0.5
    # 1 - g is rounded to 1e-16 / 1e-9.
    assert_allclose(back[1], 1e-9 * (np.sqrt(2) - 1) / 2, rtol=2e-7)


def test_forward_fraction_of_the_whole_sphere_is_1():
    fraction = phase_functions.henyey_greenstein_forward_fraction(
        asymmetry=[-0.9, 0.0, 0.5, 0.9999], split_angle=np.pi
    )
    assert_allclose(fraction, 1, rtol=1e-15)


def test_similarity_moment_is_a_third_above_that_of_the_forward_half():
    g = np.array([0.90, 0.95, 0.96, 0.97, 0.98, 0.99])
    similar = phase_functions.similarity_second_moment(asymmetry=g)
    assert_allclose(similar, [0.2, 0.1, 0.08, 0.06, 0.04, 0.02], rtol=1e-14)
    forward = phase_functions.henyey_greenstein_second_moment(
        asymmetry=g, split_angle=np.pi / 2
    )
    # Published to three digits: 0.200/0.149 = 1.342 to 0.020/0.015 = 1.33.
    assert_allclose(similar / forward, 4 / 3, rtol=0.01)


def test_similarity_moment_is_twice_1_less_the_mean_cosine():
    p = phase_functions.henyey_greenstein(np.arccos(COSINE), asymmetry=0.8)
    mean = (2 * np.pi * WEIGHT * p * 2 * (1 - COSINE)).sum()
    moment = phase_functions.similarity_second_moment(asymmetry=0.8)
    assert_allclose(moment, mean, rtol=1e-11)  # the rule converges like 0.8^400


@settings(deadline=None, max_examples=20)
@given(asymmetries, st.floats(0.05, np.pi))
def test_forward_split_of_henyey_greenstein_is_its_closed_form(g, split):
    fraction, moment = phase_functions.forward_split(
        lambda angle: phase_functions.henyey_greenstein(angle, asymmetry=g),
        split_angle=split,
    )
    options = {"asymmetry": g, "split_angle": split}
    expected = phase_functions.henyey_greenstein_forward_fraction(**options)
    assert_allclose(fraction, expected, rtol=1e-9)  # promised
    expected = phase_functions.henyey_greenstein_second_moment(**options)
    assert_allclose(moment, expected, rtol=1e-9)


def test_forward_split_of_a_sharp_cone_is_exact():
    edge = 0.1

    def cone(angle):
        return np.where(angle < edge, 1 / (2 * np.pi * (1 - np.cos(edge))), 0.0)

    fraction, moment = phase_functions.forward_split(cone, split_angle=0.5)
    # int theta^2 sin from 0 to 0.1, with its series for the moment.
    expected = (2 * edge * np.sin(edge) - (edge**2 - 2) * np.cos(edge) - 2) / (
        1 - np.cos(edge)
    )
    assert_allclose(fraction, 1, rtol=1e-9)
    # The closed form loses 2 / 2.5e-5 in digits.
    assert_allclose(moment, expected, rtol=1e-9)


def test_forward_split_of_a_power_law_peak_is_exact():
    # p sin = A theta^-0.6, as in measured sea water: shares (s/pi)^0.4 and the
    # moment s^2 0.4/2.4.
    scale = 0.4 / (2 * np.pi * np.pi**0.4)

    def peak(angle):
        sine = np.where(angle < np.pi, np.sin(angle), np.sin(np.nextafter(np.pi, 0)))
        return scale * angle**-0.6 / sine

    fraction, moment = phase_functions.forward_split(peak, split_angle=1.2)
    # What lies below 1e-18 rad is 4e-8 of the whole.
    assert_allclose(fraction, (1.2 / np.pi) ** 0.4, rtol=1e-7)
    assert_allclose(moment, 1.2**2 / 6, rtol=1e-7)


def test_forward_split_of_a_table_with_kinks_is_exact():
    # Linear between nodes: exact integrals by parts are those of quad, node by node.
    node = np.array([0.0, 0.05, 0.3, 1.0, 2.0, np.pi])
    value = np.array([30.0, 8.0, 0.6, 0.03, 0.01, 0.012])

    def integral(power, low, high):
        edges = np.unique(np.concatenate([[low, high], node]))
        edges = edges[(edges >= low) & (edges <= high)]
        return sum(
            quad(lambda t: t**power * np.sin(t) * np.interp(t, node, value), a, b)[0]
            for a, b in itertools.pairwise(edges)
        )

    whole = 2 * np.pi * integral(0, 0, np.pi)
    fraction, moment = phase_functions.forward_split(
        lambda angle: np.interp(angle, node, value / whole), split_angle=1.5
    )
    forward = integral(0, 0, 1.5)
    assert_allclose(fraction, 2 * np.pi * forward / whole, rtol=1e-9)  # promised
    assert_allclose(moment, integral(2, 0, 1.5) / forward, rtol=1e-9)


def test_forward_split_of_a_table_that_integrates_to_0_985_gives_shares_of_it():
    fraction, moment = phase_functions.forward_split(
        lambda angle: np.full_like(angle, 0.985 / (4 * np.pi)), split_angle=np.pi / 2
    )
    assert_allclose(fraction, 0.5, rtol=1e-9)
    assert_allclose(moment, np.pi - 2, rtol=1e-9)


@pytest.mark.parametrize(
    ("function", "text"),
    [
        (lambda angle: np.ones_like(angle), "integrate to 1 .* got 12.56"),
        (lambda angle: np.cos(angle), "finite and not negative"),
        (lambda angle: np.full_like(angle, np.nan), "finite and not negative"),
        (lambda angle: 1 / (4 * np.pi), "one value per angle"),
        (lambda angle: np.where(angle < 2, 0.0, 0.27), "scatter something below 1 rad"),
    ],
)
def test_what_is_no_phase_function_is_refused(function, text):
    with pytest.raises(ValueError, match=text):
        phase_functions.forward_split(function, split_angle=1.0)


@pytest.mark.parametrize("g", [-1.0, 1.0, 1.5, np.nan])
def test_an_asymmetry_of_1_and_more_is_refused(g):
    with pytest.raises(ValueError, match="asymmetry must be above -1 and below 1"):
        phase_functions.henyey_greenstein(0.1, asymmetry=g)
    with pytest.raises(ValueError, match="asymmetry must be above -1 and below 1"):
        phase_functions.similarity_second_moment(asymmetry=g)


def test_angles_outside_of_half_a_turn_are_refused():
    with pytest.raises(ValueError, match="angle must be from 0 to pi"):
        phase_functions.henyey_greenstein_cumulative(-0.1, asymmetry=0.9)
    with pytest.raises(ValueError, match="split_angle must be above 0 and at most pi"):
        phase_functions.henyey_greenstein_second_moment(asymmetry=0.9, split_angle=90.0)
    with pytest.raises(ValueError, match="split_angle must be above 0 and at most pi"):
        phase_functions.henyey_greenstein_forward_fraction(
            asymmetry=0.9, split_angle=0.0
        )


def test_arguments_broadcast():
    options = {"asymmetry": np.array([[0.9], [0.95], [-0.2]]), "split_angle": [1.0, 2]}
    moment = phase_functions.henyey_greenstein_second_moment(**options)
    assert moment.shape == (3, 2)
    alone = phase_functions.henyey_greenstein_second_moment(
        asymmetry=0.95, split_angle=2.0
    )
    assert_allclose(moment[1, 1], alone, rtol=1e-14)
    angle = np.linspace(0, np.pi, 5)
    p = phase_functions.henyey_greenstein(angle, asymmetry=[[0.9], [0.5]])
    assert p.shape == (2, 5)
