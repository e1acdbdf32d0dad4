"""A smooth function of the depth is a normal process at its knots."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from amulor.rejection.joint.overlap import hats


def test_knots_correlate_over_two_of_them() -> None:
    knots = np.linspace(0.5, 4.0, 8)
    at_knots = hats(knots, knots)
    apart = np.abs(np.subtract.outer(np.arange(8), np.arange(8)))
    assert_allclose(at_knots.T @ at_knots, np.exp(-(apart**2) / 8), atol=2e-6)
    # Between two knots the function is half of each.
    between = hats(np.array([0.75]), knots)[:, 0]
    assert_allclose(between, (at_knots[:, 0] + at_knots[:, 1]) / 2, atol=1e-12)
    assert hats(np.array([1.0]), np.empty(0)).shape == (0, 1)
