"""Claims about the Fournier-Forand phase function in closed form."""

import itertools
from pathlib import Path

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import quad

from amulor.optics.phase_functions import fournier_forand

TABLE = Path(__file__).parents[3] / "reference" / "fournier_forand_fractions.csv"

particles = st.fixed_dictionaries(
    {"relative_index": st.floats(1.01, 1.4), "slope": st.floats(3.3, 4.8)}
)


def with_80_digits(angle, *, relative_index, slope):
    """Return the value by the printed form, with its cancellations paid for."""
    with mpmath.workdps(80):
        nu = (3 - mpmath.mpf(slope)) / 2
        square = mpmath.sin(mpmath.mpf(angle) / 2) ** 2
        scale = 4 / (3 * (mpmath.mpf(relative_index) - 1) ** 2)
        delta = scale * square
        power, last = delta**nu, scale**nu
        bracket = nu * (1 - delta) - (1 - power)
        bracket += (delta * (1 - power) - nu * (1 - delta)) / square
        value = bracket / (4 * mpmath.pi * (1 - delta) ** 2 * power)
        smooth = (1 - last) / (16 * mpmath.pi * (scale - 1) * last)
        return float(value + smooth * (3 * mpmath.cos(angle) ** 2 - 1))


@pytest.mark.parametrize("row", np.loadtxt(TABLE, delimiter=",").tolist())
def test_backscatter_fraction_meets_the_published_table(row):
    index, slope, expected = row
    back = fournier_forand.fournier_forand_backscatter_fraction(
        relative_index=index, slope=slope
    )
    # Half a unit in the last digits of index and slope moves the first row by 5 %,
    # whose particles hardly differ from water, and the others by 2 % to 0.3 %.
    assert_allclose(back, expected, rtol=0.05 if index < 1.03 else 0.005)


@settings(deadline=None, max_examples=40)
@given(particles, st.floats(-6, 0))
def test_value_keeps_its_digits(parameters, decade):
    angle = np.pi * 10**decade
    value = fournier_forand.fournier_forand_phase(angle, **parameters)
    # The brackets lose a factor of 10 / 0.1 at the border of the series, the two terms
    # another of about 10 at large angles.
    assert_allclose(value, with_80_digits(angle, **parameters), rtol=1e-12)


@pytest.mark.parametrize("offset", [0.0, 1e-12, 1e-6, 1e-3, 0.04, 0.06, -0.02])
def test_value_keeps_its_digits_where_delta_is_1(offset):
    parameters = {"relative_index": 1.1, "slope": 3.6}
    # delta = 1 at sin(angle / 2) = sqrt(3) / 20; rounding keeps the check
    # from 0 / 0, by 1e-16 of which 80 digits can bear the square.
    angle = 2 * np.arcsin(np.sqrt(3) / 20) * (1 + offset)
    value = fournier_forand.fournier_forand_phase(angle, **parameters)
    expected = with_80_digits(angle, **parameters)
    assert_allclose(value, expected, rtol=1e-12)


def test_forward_peak_is_the_power_law_of_the_sizes():
    # For delta -> 0 and nu < 0: p -> -nu delta^(-nu) / (4 pi sin^2(angle / 2)).
    parameters = {"relative_index": 1.15, "slope": 4.0}
    angle = np.array([1e-10, 1e-9])
    delta = 4 * np.sin(angle / 2) ** 2 / (3 * 0.15**2)
    expected = 0.5 * np.sqrt(delta) / (4 * np.pi * np.sin(angle / 2) ** 2)
    value = fournier_forand.fournier_forand_phase(angle, **parameters)
    # The next term is 2 delta^(1/2), here 8e-9 at most.
    assert_allclose(value, expected, rtol=3e-8)
    share = fournier_forand.fournier_forand_cumulative(angle, **parameters)
    assert_allclose(share, np.sqrt(delta), rtol=3e-8)


@settings(deadline=None, max_examples=30)
@given(particles)
def test_the_integral_is_the_cumulative_and_1_in_the_end(parameters):
    def ring(log_angle):
        angle = min(np.exp(log_angle), np.pi)
        value = fournier_forand.fournier_forand_phase(angle, **parameters)
        return 2 * np.pi * value * np.sin(angle) * angle

    def share(angle):
        return fournier_forand.fournier_forand_cumulative(angle, **parameters)

    edges = [1e-8, 1e-4, 0.01, 0.3, np.pi / 2, np.pi]
    for low, high in itertools.pairwise(edges):
        part, _ = quad(ring, np.log(low), np.log(high), epsabs=1e-11, epsrel=1e-11)
        assert_allclose(share(high) - share(low), part, rtol=0, atol=1e-10)
    assert_allclose(share(np.pi), 1, rtol=1e-13)
    assert share(0.0) == 0


@settings(deadline=None, max_examples=40)
@given(particles)
def test_backscatter_fraction_is_the_integral_beyond_90_degrees(parameters):
    def ring(angle):
        value = fournier_forand.fournier_forand_phase(angle, **parameters)
        return 2 * np.pi * value * np.sin(angle)

    expected, _ = quad(ring, np.pi / 2, np.pi, epsabs=1e-13)
    back = fournier_forand.fournier_forand_backscatter_fraction(**parameters)
    assert_allclose(back, expected, rtol=0, atol=1e-12)
    assert 0 < back < 0.5


@pytest.mark.parametrize(
    ("index", "slope", "text"),
    [
        (1.0, 4.0, "relative_index must be above 1 and at most 1.5"),
        (1.6, 4.0, "relative_index must be above 1 and at most 1.5"),
        (1.1, 3.0, "slope must be above 3 and below 5"),
        (1.1, 5.0, "slope must be above 3 and below 5"),
    ],
)
def test_parameters_without_a_phase_function_are_refused(index, slope, text):
    with pytest.raises(ValueError, match=text):
        fournier_forand.fournier_forand_phase(1.0, relative_index=index, slope=slope)
    with pytest.raises(ValueError, match=text):
        fournier_forand.fournier_forand_backscatter_fraction(
            relative_index=index, slope=slope
        )


def test_the_infinite_value_at_0_is_refused():
    with pytest.raises(ValueError, match="infinite at 0"):
        fournier_forand.fournier_forand_phase(0.0, relative_index=1.1, slope=4.0)
