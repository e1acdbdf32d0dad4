"""Chebyshev series over a box: closed forms, independence, what is left out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from amulor._chebyshev import BoxSeries

LOW, HIGH = np.array([-0.2, 0.1, 0.5]), np.array([0.3, 0.4, 4.0])


def _inside(count: int) -> np.ndarray:
    return np.random.default_rng(5).uniform(LOW[:, None], HIGH[:, None], (3, count))


def _polynomials(places: np.ndarray) -> np.ndarray:
    x, y, z = places
    return np.stack([x**3 * y - 2j * z**2 * x, 1 + y**2 * z**4 + 0j])


def test_polynomials_within_the_degree_are_exact() -> None:
    series = BoxSeries(LOW, HIGH, (4, 3, 5))
    assert series.size == 60
    series.fill(_polynomials(series.places()))
    places = _inside(200)
    expected = _polynomials(places)
    found = series.at(places)
    assert found.shape == (2, 200)
    assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_one_node_too_few_is_seen() -> None:
    series = BoxSeries(LOW, HIGH, (4, 3, 4))
    series.fill(_polynomials(series.places()))
    places = _inside(200)
    assert np.abs(series.at(places) - _polynomials(places)).max() > 1e-3


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_an_exponential_converges_whatever_is_left_out(axes: int) -> None:
    low, high = LOW[:axes], HIGH[:axes]
    series = BoxSeries(low, high, (24,) * axes)

    def wave(places: np.ndarray) -> np.ndarray:
        return np.exp((0.5 + 2j) * places.sum(axis=0))[None]

    series.fill(wave(series.places()))
    places = _inside(300)[:axes]
    exact = wave(places)
    # Left out are 1e-9 of the largest coefficient, which is below the largest value.
    assert_allclose(series.at(places), exact, rtol=0, atol=2e-9 * np.abs(exact).max())


@given(
    first=st.integers(0, 260), size=st.integers(1, 40), seed=st.integers(0, 2**32 - 1)
)
def test_a_value_does_not_depend_on_its_company(
    first: int, size: int, seed: int
) -> None:
    series = BoxSeries(LOW, HIGH, (5, 5, 9))
    rng = np.random.default_rng(seed)
    series.fill(rng.normal(size=(3, series.size)) + 1j)
    places = _inside(300)
    part = slice(first, first + size)
    assert_array_equal(series.at(places[:, part]), series.at(places)[:, part])


def test_an_axis_without_extent_takes_one_node() -> None:
    flat = HIGH.copy()
    flat[1] = LOW[1]
    series = BoxSeries(LOW, flat, (4, 9, 5))
    assert series.size == 20
    assert np.all(series.places()[1] == LOW[1])
    series.fill(_polynomials(series.places()))
    places = _inside(50)
    places[1] = LOW[1]
    expected = _polynomials(places)
    assert_allclose(
        series.at(places), expected, rtol=0, atol=1e-12 * np.abs(expected).max()
    )


def test_nothing_is_the_sum_of_nothing() -> None:
    series = BoxSeries(LOW, HIGH, (2, 2, 2))
    series.fill(np.zeros((4, 8), dtype=complex))
    assert_array_equal(series.at(_inside(3)), np.zeros((4, 3)))


def test_coefficients_of_a_billionth_of_the_largest_are_omitted() -> None:
    low, high = np.array([-1.0]), np.array([1.0])
    nodes = BoxSeries(low, high, (4,)).places()[0]
    # In orders 1 and 3 as parts of the constant; the smaller one goes first.
    for first, third, expected in (
        (0.9e-9, 0, [0]), (1.1e-9, 0, [0, 1]), (0.6e-9, 0.7e-9, [0, 3]),
        (0.4e-9, 0.5e-9, [0]), (0.7e-9, 0.6e-9, [0, 1]), (0.9e-9, 2.0, [0, 3]),
    ):  # fmt: skip
        series = BoxSeries(low, high, (4,))
        cubic = 4 * nodes**3 - 3 * nodes
        series.fill((1 + first * nodes + third * cubic)[None].astype(complex))
        assert series._orders[:, 0].tolist() == expected


def test_a_coefficient_that_one_function_needs_is_kept_for_all() -> None:
    low, high = np.array([2.0]), np.array([6.0])
    series = BoxSeries(low, high, (3,))
    places = series.places()[0]
    series.fill(np.stack([1e3 + 0 * places, 1j * (places - 4)]).astype(complex))
    assert series._orders[:, 0].tolist() == [0, 1]
    found = series.at(np.array([[2.0, 4.0, 5.0, 6.0]]))
    assert_allclose(found, [[1e3] * 4, [-2j, 0, 1j, 2j]], atol=1e-9)


def test_nodes_are_those_of_chebyshev_polynomials() -> None:
    series = BoxSeries(np.array([0.0, 5.0]), np.array([2.0, 5.0]), (2, 3))
    # Zeros of the second polynomial are 1 / sqrt(2) from the middle.
    root = 0.5**0.5
    assert_allclose(series.places(), [[1 + root, 1 - root], [5, 5]])
    assert series.size == 2
