"""Quadrature of oscillating integrands, as written and compiled, in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.polynomial import chebyshev, legendre
from numpy.testing import assert_allclose
from scipy import special

from amulor.optics import _quadrature as quadrature
from amulor.optics._quadrature import ORDER, RULE, SPLIT, Panel


def panel_of(function, half: float, centre: float) -> Panel:
    """Return a panel of a function of the place from -1 to 1."""
    right, left = function(RULE[4, 0]), function(RULE[4, 1])
    return Panel(half, centre, right + left, right - left)


def added(panel: Panel, phases: np.ndarray, *, start: complex = 0j) -> np.ndarray:
    """Return sums of a panel, over phases per depth."""
    work, turn = np.full((2, ORDER), np.nan), np.full((2, phases.size), np.nan)
    sums = np.array(
        [np.full(phases.size, start.real), np.full(phases.size, start.imag)]
    )
    quadrature.add_panel.py_func(panel, phases, RULE, work, turn, sums)
    return sums[0] + 1j * sums[1]


def moment(degree: int, phase: np.ndarray) -> np.ndarray:
    """Return the integral of a Legendre polynomial times a wave from -1 to 1."""
    return 2 * 1j**degree * special.spherical_jn(degree, phase)


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 7, 12, 15])
def test_panels_of_legendre_polynomials_are_spherical_bessel_functions(
    degree: int,
) -> None:
    # Slow and fast turns, on both sides of the limit, and far beyond it.
    half, centre = 0.5, 3.7
    phases = np.array([0.0, 0.3, 4.0, 15.9, 16.1, 40.0, 1000.0])
    polynomial = legendre.Legendre.basis(degree)
    found = added(panel_of(polynomial, half, centre), phases, start=0.25 - 0.5j)
    expected = half * moment(degree, half * phases) * np.exp(1j * phases * centre)
    assert_allclose(found, 0.25 - 0.5j + expected, atol=1e-14)


@pytest.mark.parametrize("phases", [[0.1, 0.2], [50.0, 60.0], []])
def test_panels_of_slow_or_of_fast_turns_alone(phases: list[float]) -> None:
    rates = np.array(phases)
    found = added(panel_of(np.ones_like, 0.4, 2.0), rates)
    expected = 2 * np.sin(0.4 * rates) / np.where(rates > 0, rates, 1)
    assert_allclose(found, expected * np.exp(2j * rates), atol=1e-15)


def test_compiled_panels_are_those_as_written() -> None:
    phases = np.array([0.5, 3.0, 20.0, 90.0])
    panel = panel_of(lambda s: np.exp(s) * (2 - s), 0.7, 1.3)
    sums = np.zeros((2, 4))
    quadrature.add_panel(
        panel, phases, RULE, np.zeros((2, ORDER)), np.zeros((2, 4)), sums
    )
    # The integral of exp(a s) (2 - s), with a = 1 + i w h.
    a = 1 + 0.7j * phases
    shape = (np.exp(a) * (2 * a - a + 1) - np.exp(-a) * (2 * a + a + 1)) / a**2
    expected = 0.7 * np.exp(1.3j * phases) * shape
    assert_allclose(sums[0] + 1j * sums[1], expected, atol=1e-14)
    assert_allclose(added(panel, phases), expected, atol=1e-14)


def test_slow_and_fast_panels_agree_where_they_meet() -> None:
    panel = panel_of(lambda s: 1 / (2 + s), 1.0, 0.4)
    rates = SPLIT * np.array([1 - 1e-12, 1.0])
    slow, fast = added(panel, rates)
    assert_allclose(slow, fast, rtol=1e-11)


def test_phases_beyond_ten_million_are_taken_modulo_whole_turns() -> None:
    rates = np.array([2e9, 2e9 + 1.5])
    out = np.empty(2)
    quadrature._turns.py_func(rates, 1.0, out)
    assert_allclose(out, [math.fmod(rate, 2 * math.pi) for rate in rates], atol=1e-12)
    quadrature._turns.py_func(rates, 2.5e-3, out)
    assert_allclose(out, rates * 2.5e-3, rtol=1e-15)
    quadrature._turns.py_func(rates[:0], 1.0, out[:0])


@pytest.mark.parametrize("start", [0.0, 1e3, 1.99e7])
def test_sine_and_cosine_of_large_phases_are_those_of_the_library(start: float) -> None:
    x = start + np.linspace(-3.3, 3.3, 67)
    for number in x:
        sine, cosine = quadrature.sine_cosine.py_func(number)
        assert abs(sine - math.sin(number)) < 4e-16
        assert abs(cosine - math.cos(number)) < 4e-16


def test_a_vector_times_a_matrix_replaces_the_last_product() -> None:
    rng = np.random.default_rng(1)
    vector, matrix = rng.normal(size=ORDER), rng.normal(size=(ORDER, ORDER))
    out = np.full(ORDER, 7.0)
    quadrature.expand.py_func(vector, matrix, out)
    assert_allclose(out, vector @ matrix, rtol=1e-12)


def test_sums_and_differences_continue_a_panel_to_its_end() -> None:
    for function in (np.ones_like, np.exp, lambda s: s**9 - 3 * s**4):
        panel = panel_of(function, 1.0, 0.0)
        end = panel.even @ RULE[4, 2] + panel.odd @ RULE[4, 3]
        assert_allclose(end, function(np.ones(1))[0], rtol=1e-11)


def test_nodes_of_a_panel_are_those_of_gauss_by_distance_from_the_middle() -> None:
    node, _ = legendre.leggauss(2 * ORDER)
    assert_allclose(RULE[4, 0], node[ORDER:], rtol=1e-15)
    assert_allclose(RULE[4, 1], -node[ORDER:], rtol=1e-15)
    assert np.all(RULE[4, 4:] == 0)


def test_values_at_the_nodes_of_chebyshev_become_power_series() -> None:
    size = 6
    node = np.cos(np.pi * (np.arange(size) + 0.5) / size)
    powers = np.array([[1.0, -2, 3, 0.5, -1, 4], [0, 0, 0, 0, 0, 1.0]])
    values = np.polynomial.polynomial.polyval(node, powers.T)
    assert_allclose(quadrature.monomials(values), powers, atol=1e-13)
    assert_allclose(chebyshev.chebpts1(size), np.sort(node), atol=1e-15)


def test_polynomials_of_a_cell_have_ten_terms() -> None:
    table = np.arange(1.0, 31).reshape(3, 10)
    for cell, s in ((0, 0.3), (2, -0.7)):
        found = quadrature.polynomial.py_func(table, cell, s)
        expected = np.polynomial.polynomial.polyval(s, table[cell])
        assert_allclose(found, expected, rtol=1e-14)


def test_tables_of_bessel_functions_reach_to_26_in_cells_of_one() -> None:
    nodes = quadrature.bessel_nodes()
    assert nodes.shape == (26, 10)
    assert np.all(
        (nodes > np.arange(26)[:, None]) & (nodes < np.arange(1, 27)[:, None])
    )
    ends = np.arange(26)[:, None] + (1 + np.cos(np.pi / 20) * np.array([1, -1])) / 2
    assert_allclose(nodes[:, [0, -1]], ends, rtol=1e-14)
    for x in (0.0, 0.4, 1.0, 25.9, 26.0, 26.1, 31.0, 400.0):
        found = quadrature.j0.py_func(x, quadrature.bessel())
        assert_allclose(found, special.j0(x), atol=2e-13)
