"""The loops of the closure as compiled and as written, and parts around them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.optics._quadrature import RULE, bessel
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.small_angle._columns import Column, Table, depth_rule, table
from amulor.optics.small_angle._kernels import Water
from amulor.optics.small_angle_closure import _kernels, response

SPREAD = table(henyey_greenstein_function(asymmetry=0.95), np.pi / 2)
WATER = Water(
    loss=0.3,
    forward=0.7,
    split_angle=SPREAD.split,
    baseline=0.1,
    tilt=0.02,
    cross_tilt=0.01,
    standoff=0.1,
    radius_squared=4e-4,
    angle_squared=6.4e-3,
)


def test_compiled_and_plain_overlaps_are_the_same():
    depth = np.array([0.0, 0.2, 1.5, 6.0])
    look = np.column_stack([depth, *np.tile([0.1, 0.02, 0.01, 0.1], (4, 1)).T])
    compiled, plain = np.empty(4), np.empty(4)
    _kernels.collected(look, WATER, SPREAD.cells, compiled)
    _kernels.collected.py_func(look, WATER, SPREAD.cells, plain)
    assert_allclose(compiled, plain, rtol=1e-12)


def test_compiled_and_plain_columns_are_the_same():
    layout = _kernels.Layout(step=0.1, nearest=4.0, narrow=0.5, end=2.0)
    phases = np.array([0.0, 1.0, 5.0])
    compiled, plain = np.zeros((2, 3)), np.zeros((2, 3))
    rules = (RULE, *depth_rule())
    _kernels.water_column(WATER, layout, SPREAD.cells, phases, rules, compiled)
    _kernels.water_column.py_func(WATER, layout, SPREAD.cells, phases, rules, plain)
    assert_allclose(compiled, plain, rtol=1e-12)


def test_the_spread_and_its_slope_come_from_the_same_table():
    # Cells of equal width, cells that grow, and beyond the last of them.
    for x in (0.3, 40.0, 900.0, 1e6, 1e9):
        value, over_x = _kernels._lost(x, SPREAD.split, SPREAD.cells)
        step = 1e-4 * x
        low, _ = _kernels._lost(x - step, SPREAD.split, SPREAD.cells)
        high, _ = _kernels._lost(x + step, SPREAD.split, SPREAD.cells)
        # Where little is left to lose, the difference of two numbers near 1 is rough.
        rough = 1e-15 / step
        assert_allclose(over_x * x, (high - low) / (2 * step), rtol=1e-5, atol=rough)
        assert 0 < value < 1


def test_compiled_and_plain_departures_are_the_same():
    # Before the water, near, off the axis and beyond all light of a Gaussian.
    depth = np.array([0.0, 0.2, 1.5, 6.0, 1.5, 1.0])
    look = np.column_stack([depth, *np.tile([0.1, 0.02, 0.01, 0.1], (6, 1)).T])
    look[4, 1], look[5, 1] = 0.4, 2.0
    rule = np.stack(np.polynomial.laguerre.laggauss(16))
    compiled, plain = np.empty((6, 2)), np.empty((6, 2))
    arguments = look, WATER, SPREAD.cells, bessel(), rule
    _kernels.departures(*arguments, compiled)
    _kernels.departures.py_func(*arguments, plain)
    assert_allclose(compiled, plain, rtol=1e-10)
    # Near, and off the axis, the estimate is beyond 1 or there is no light to compare.
    assert np.array_equal(np.isinf(plain[:, 1]), [0, 1, 0, 0, 1, 1])


WATER_COLUMN = Column(
    absorption=0.1, scattering=0.4, baseline=0.2, receiver_radius=0.02,
    acceptance_angle=0.08, beam_radius=0.03, beam_divergence=0.06, tilt=0.1,
    cross_tilt=0.0, standoff=0.3, end=9.0,
)  # fmt: skip


def test_views_meet_the_beam_where_their_axes_cross():
    spread = table(henyey_greenstein_function(asymmetry=0.9), 1.5)
    water = response._water(WATER_COLUMN, spread)
    assert_allclose(water.radius_squared, 0.02**2 + 0.03**2)
    assert_allclose(water.angle_squared, 0.1**2)
    found = response._meeting(water)
    # 0.2 m aside at 0.1 rad, seen from 0.3 m before the water.
    width = np.sqrt(0.0013 + 0.01 * 4) / 0.1
    assert_allclose([found["nearest"], found["narrow"]], [2 - 0.3, width])
    turned = response._meeting(water._replace(cross_tilt=0.2))
    path = 0.2 * 0.1 / 0.05
    width = np.sqrt((0.0013 + 0.01 * path**2) / 0.05)
    assert_allclose([turned["nearest"], turned["narrow"]], [path - 0.3, width])
    straight = response._meeting(water._replace(tilt=0.0))
    assert straight == {"nearest": -1.0, "narrow": 0.0}


@pytest.mark.parametrize(
    ("change", "end"),
    [
        ({}, 9.0),
        ({"end": 500.0}, 7 / (0.1 + 0.4 * 0.25)),
        ({"end": 500.0, "absorption": 0.0, "scattering": 0.0}, 275.0),
        ({"end": 50.0, "absorption": 0.0, "scattering": 0.0, "baseline": 0.0}, 25.0),
        ({"end": 50.0, "absorption": 0.0, "scattering": 0.0, "baseline": 0.0,
          "acceptance_angle": 0.5}, 10.0),
    ],
)  # fmt: skip
def test_what_a_column_lacks_is_a_mean_over_its_depths(monkeypatch, change, end):
    column, depths = WATER_COLUMN._replace(**change), []
    spread = Table(1.5, 0.75, np.ones((1, 10)))
    peak = np.pi * (column.receiver_radius * column.acceptance_angle) ** 2
    light, lacking = 2.0, -0.5

    def lacking_at(depth, *_):
        depths.append(depth)
        return np.stack([lacking * depth, 9 + 0 * depth], axis=1)

    monkeypatch.setattr(response, "_light", lambda depth, *_: peak * light * depth)
    monkeypatch.setattr(response, "_lacking", lacking_at)
    assert_allclose(response._lacked(column, spread), 0.25, rtol=1e-12)
    assert_allclose(depths[0], np.geomspace(1e-3 * end, end, 48), rtol=1e-9)
    light = 0.0
    assert response._lacked(column, spread) == np.inf
    lacking = 0.0
    assert response._lacked(column, spread) == 0
