"""Compiled sums over narrow panels against dense rules that know no asymptotics."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import special

from amulor.optics._quadrature import bessel
from amulor.optics.phase_functions import _kernels
from amulor.optics.phase_functions.integrals import Panels, gauss_legendre


def falling(angle):
    """Fall as the scattering of the sea does."""
    return angle**-1.5 / (1 + (angle / 0.02) ** 2)


@pytest.mark.parametrize("start", [1e-5, 0.003, 1.4])
# Half a panel holds 0.02 to 5,000 rad, and both sides of where the rule changes.
@pytest.mark.parametrize("stretch", [0.02, 1.49, 1.51, 6.0, 90.0, 5e3])
def test_a_panel_is_the_integral_by_a_dense_rule(start, stretch):
    end = 1.08 * start
    k = 2 * stretch / (end - start)
    panels = Panels(falling, np.array([start, end]))
    angle, fraction = panels._rule(*panels.edges[:, None], order=_kernels.NODES)
    degree, (node, _) = np.arange(_kernels.NODES)[:, None], gauss_legendre(7)
    out = np.zeros(2)
    _kernels.narrow_panels(
        np.array([k, 0.0]),
        angle,
        fraction,
        bessel(),
        (2 * degree + 1) * special.eval_legendre(degree, node),
        out,
    )
    # At least 20 points of a rule of the fourth order in an oscillation.
    count = 2 * int(20 + 20 * stretch) + 1
    dense = np.linspace(start, end, count)
    weight = np.full(count, 2.0)
    weight[1::2], weight[[0, -1]] = 4.0, 1.0
    weight *= (dense[1] - dense[0]) / 3
    every = weight * 2 * np.pi * falling(dense) * np.sin(dense)
    whole = every.sum()
    assert_allclose(out[0], every @ special.j0(k * dense), atol=2e-6 * whole, rtol=2e-5)
    assert_allclose(out[1], whole, rtol=1e-7)
