"""Interpolation between the places where photons are followed."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.simulation.photons import grid_of

LEAST = np.array([0.1, 0.1, 0.1])
MOST = np.array([2, 3, 4])


@given(
    seed=st.integers(0, 1000),
    span=st.tuples(*[st.floats(1.0, 50.0)] * 3),
)
def test_polynomials_below_the_number_of_nodes_are_exact(seed, span):
    rng = np.random.default_rng(seed)
    where = rng.uniform(0, 1, (30, 3)) * span
    grid = grid_of(where, smallest=LEAST, largest_count=MOST)
    degrees = [len(axis.nodes) - 1 for axis in grid.axes]
    assert all(degree >= 1 for degree in degrees)
    factors = rng.uniform(-1, 1, 3)

    def function(places):
        return np.prod(1 + factors * (places / span) ** degrees, axis=1)

    weight = grid.weights(where)
    assert_allclose(weight.sum(axis=1), 1, rtol=1e-12)
    assert_allclose(
        weight @ function(grid.places), function(where), rtol=1e-9, atol=1e-9
    )


def test_a_narrow_axis_has_one_node_in_its_middle():
    where = np.array([[1.0, 0.0, 3.0], [1.05, 10.0, 3.2]])
    grid = grid_of(where, smallest=LEAST, largest_count=MOST)
    assert [len(axis.nodes) for axis in grid.axes] == [1, 3, 2]
    assert_allclose(grid.axes[0].nodes, 1.025)
    # The ends of each range are nodes, so nothing is continued beyond them.
    assert_allclose(grid.axes[1].nodes[[0, -1]], [0.0, 10.0])


def test_places_for_checks_are_no_nodes():
    where = np.random.default_rng(1).uniform(0, 9, (20, 3))
    grid = grid_of(where, smallest=LEAST, largest_count=MOST)
    checks = grid.between(4)
    for axis, values in zip(grid.axes, checks.T, strict=True):
        span = np.ptp(axis.nodes)
        assert np.all(values > axis.nodes.min())
        assert np.all(values < axis.nodes.max())
        apart = abs(values[:, None] - axis.nodes)
        assert np.all(apart.min(axis=1) > 0.1 * span)
