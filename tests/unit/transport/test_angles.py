"""Cells of scattering angles: edges, look-up, shares, and what is drawn."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from amulor.optics.phase_functions.models import (
    fournier_forand,
    henyey_greenstein_function,
    isotropic,
    rayleigh_phase,
)
from amulor.optics.phase_functions.tables import petzold
from amulor.transport._kernels import sampling as kernels
from amulor.transport._kernels.batch import launch
from amulor.transport._kernels.types import Beam
from amulor.transport._runs import random_state
from amulor.transport.scattering import AngleCells, alias_table, cell_edges

EDGES = cell_edges()
FUNCTIONS = {
    "isotropic": isotropic(),
    "peaked": henyey_greenstein_function(asymmetry=0.99),
    "backward": henyey_greenstein_function(asymmetry=-0.9),
    "Rayleigh": rayleigh_phase(),
    "ocean": fournier_forand(relative_index=1.1, slope=3.5835),
    "measured": petzold("NUC 2200"),
}


def test_edges_rise_from_0_to_1_by_at_most_one_part_in_128():
    assert EDGES.size == kernels.SIZE + 1
    assert EDGES[0] == 0
    assert EDGES[-1] == 1
    assert np.all(np.diff(EDGES) > 0)
    # Each octave is divided into 128 even cells, the first of 1/128 of its low end.
    low = EDGES[1:-1]
    share = np.diff(EDGES)[1:] / np.minimum(low, 1 - low)
    assert share[EDGES[2:] < 0.5].max() == pytest.approx(1 / 128, rel=1e-12)
    assert np.any(EDGES == 0.5)


def test_each_cell_holds_its_lower_edge_and_its_middle():
    middle = 0.5 * (EDGES[:-1] + EDGES[1:])
    assert [kernels.cell_of(h) for h in middle] == list(range(kernels.SIZE))
    assert [kernels.cell_of(h) for h in EDGES[:-1] if h <= 0.5] == list(
        range(int(np.sum(EDGES <= 0.5)))
    )
    assert kernels.cell_of(1.0) == kernels.SIZE - 1


@given(st.floats(0, 1))
def test_a_height_lies_between_the_edges_of_its_cell(height):
    cell = kernels.cell_of(height)
    # From 1/2 up it is 1 - height that is looked up, so an edge may count below.
    assert EDGES[cell] <= height <= EDGES[cell + 1]
    assert kernels.cell_of.py_func(height) == cell


@given(st.floats(-300, 0), st.booleans())
def test_heights_near_either_end_are_found(exponent, backward):
    height = 10.0**exponent
    height = 1 - height if backward else height
    cell = kernels.cell_of(height)
    assert EDGES[cell] <= height <= EDGES[cell + 1]


def test_height_between_stays_within_0_and_1():
    assert kernels.height_between(1 + 1e-15) == 0
    assert kernels.height_between(-1 - 1e-15) == 1
    assert kernels.height_between(0.2) == pytest.approx(0.4, abs=1e-16)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_shares_are_steps_of_the_cumulative(name):
    function = FUNCTIONS[name]
    share = AngleCells(function).probability
    angle = 2 * np.arctan2(np.sqrt(EDGES), np.sqrt(1 - EDGES))
    assert share.sum() == pytest.approx(1, abs=1e-12)
    # Simpson's rule over a cell of 1/128 of its height: (1/128)^4 times the fourth
    # derivative, which is a few hundred for a power law; tables have kinks.
    tolerance = 2e-4 if name == "measured" else 2e-6
    np.testing.assert_allclose(
        np.cumsum(share), function.cumulative(angle[1:]), rtol=0, atol=tolerance
    )


@pytest.mark.parametrize("name", ["peaked", "ocean"])
def test_value_times_solid_angle_is_the_share(name):
    cells = AngleCells(FUNCTIONS[name])
    solid_angle = 4 * np.pi * np.diff(EDGES)
    np.testing.assert_allclose(cells.value * solid_angle, cells.probability, rtol=1e-14)
    inside = slice(1, None)
    # Even in a cell with the true mean: off by half the change over a cell, 1/256
    # times an exponent of about 2.
    np.testing.assert_allclose(
        cells.value[inside], FUNCTIONS[name](cells.middle[inside]), rtol=1e-3
    )


@given(
    st.lists(st.one_of(st.just(0.0), st.floats(1e-12, 1e3)), min_size=1, max_size=60)
    .map(np.array)
    .filter(lambda share: share.sum() > 0)
)
def test_the_alias_table_gives_each_cell_its_share(weights):
    share = weights / weights.sum()
    threshold, partner = alias_table(share)
    assert np.all((threshold >= 0) & (threshold <= 1))
    drawn = threshold / share.size
    np.add.at(drawn, partner, (1 - threshold) / share.size)
    np.testing.assert_allclose(drawn, share, rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", ["peaked", "Rayleigh", "ocean"])
def test_drawn_heights_have_the_distribution_of_the_function(name):
    function = FUNCTIONS[name]
    urn = AngleCells(function).urn[np.newaxis]
    state = random_state(11, 0)
    drawn = [kernels.draw_height(state, urn, 0) for _ in range(30_000)]
    height = np.array([h for h, _ in drawn])
    assert all(kernels.cell_of(h) == cell for h, cell in drawn[:2000])
    # Thirty angles with equal shares, found from the function's own cumulative.
    grid = np.linspace(0, np.pi, 200_001)
    bounds = np.interp(np.linspace(0, 1, 31)[1:-1], function.cumulative(grid), grid)
    bounds = np.sin(bounds / 2) ** 2
    count = np.bincount(np.searchsorted(bounds, height), minlength=30)
    _, p_value = stats.chisquare(count)
    assert p_value > 1e-4  # one right generator in 10,000 is refused


def test_drawing_uncompiled_is_the_same():
    urn = AngleCells(FUNCTIONS["peaked"]).urn[np.newaxis]
    one, other = random_state(1, 0), random_state(1, 0)
    for _ in range(50):
        assert kernels.draw_height(one, urn, 0) == kernels.draw_height.py_func(
            other, urn, 0
        )


def test_points_of_a_disc_are_even_in_area():
    state = random_state(3, 0)
    points = np.array([kernels.disc_point(state, 2.0) for _ in range(20_000)])
    radius_squared = (points**2).sum(axis=1) / 4
    assert radius_squared.max() <= 1
    assert stats.kstest(radius_squared, "uniform").pvalue > 1e-4
    azimuth = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) % 1
    assert stats.kstest(azimuth, "uniform").pvalue > 1e-4


def test_a_beam_spreads_evenly_in_solid_angle_under_its_gaussian():
    # Means over sin(theta) exp(-theta^2 / delta^2); over theta instead of sin(theta)
    # the first would be delta^2 = 0.25, 4 % more.
    delta = 0.5
    source = Beam(
        centre=np.zeros(3), axis=np.array([0.0, 0.6, 0.8]),
        across=np.array([1.0, 0.0, 0.0]), radius=0.0, divergence=delta,
        stokes=np.array([1.0, 0, 0, 0]),
    )  # fmt: skip
    state = random_state(6, 0)
    rays = [launch.py_func(state, source) for _ in range(40_000)]
    axis = np.array([ray.axis for ray in rays])
    direction = np.array([ray.direction for ray in rays])
    np.testing.assert_allclose(np.sum(axis * direction, axis=1), 0, atol=1e-12)
    angle = np.arccos(np.clip(direction @ source.axis, -1, 1))
    theta = np.linspace(0, np.pi, 100_001)
    density = np.sin(theta) * np.exp(-((theta / delta) ** 2))
    for power in (2, 4):
        expected = np.trapezoid(theta**power * density, theta) / np.trapezoid(
            density, theta
        )
        error = (angle**power).std() / np.sqrt(angle.size)
        assert abs((angle**power).mean() - expected) < 4 * error
    assert (angle**2).std() / np.sqrt(angle.size) < 0.01 * 0.25
