"""The loops of the closure as compiled and as written."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from amulor.optics._quadrature import RULE, bessel
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.small_angle._columns import depth_rule, table
from amulor.optics.small_angle._kernels import Water
from amulor.optics.small_angle_closure import _kernels

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
