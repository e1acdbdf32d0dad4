"""A smooth function of the depth is a normal process at its knots."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.rejection.joint.overlap import Scattered, hats


def test_knots_correlate_over_two_of_them() -> None:
    knots = np.linspace(0.5, 4.0, 8)
    at_knots = hats(knots, knots)
    apart = np.abs(np.subtract.outer(np.arange(8), np.arange(8)))
    assert_allclose(at_knots.T @ at_knots, np.exp(-(apart**2) / 8), atol=2e-6)
    # Between two knots the function is half of each.
    between = hats(np.array([0.75]), knots)[:, 0]
    assert_allclose(between, (at_knots[:, 0] + at_knots[:, 1]) / 2, atol=1e-12)
    assert hats(np.array([1.0]), np.empty(0)).shape == (0, 1)


def test_a_receiver_before_the_water_sees_a_wider_part_of_it() -> None:
    function = henyey_greenstein_function(asymmetry=0.95)
    in_air, in_water = (
        Scattered(function, 0.2, radius=0.02, angle=0.05, standoff=standoff)
        for standoff in (0.7, 0.0)
    )
    # Aperture and field of view add in squares, at the distance from the receiver.
    for one, path in ((in_air, in_air.depth + 0.7), (in_water, in_water.depth)):
        assert_allclose(one._area, 0.02**2 + (0.05 * path) ** 2, rtol=1e-12)
