"""Tables that turn the values at the nodes of a panel into its integral."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.special import jv

from amulor.optics._quadrature.kernels import ORDER, SPLIT

__all__ = ["RULE"]


def _rule() -> NDArray[np.float64]:
    """Return the tables that turn values at the nodes of a panel into its terms.

    [0] and [1] give the factors of the spherical Bessel functions of even and odd
    order in the moment of exp(i k s), [2] and [3] those of the Chebyshev
    polynomials in k / SPLIT (Jacobi-Anger series), from the sums and differences
    of the values right and left of the centre. [4] holds the right and the left
    nodes, and the factors that continue the even and odd part to the end.
    """
    half = ORDER
    node, weight = (part[half:] for part in legendre.leggauss(2 * half))
    order = np.arange(2 * half)
    sign = (-1.0) ** np.arange(half)
    series = (2 * order + 1) * legendre.legvander(node, 2 * half - 1) * weight[:, None]
    anger = 2 * jv(order, SPLIT * node[:, None]) * weight[:, None]
    anger[:, 0] /= 2
    rule = np.zeros((5, half, half))
    rule[0], rule[1] = series[:, ::2] * sign, series[:, 1::2] * sign
    rule[2], rule[3] = anger[:, ::2] * sign, anger[:, 1::2] * sign
    rule[4, :2] = node, -node
    rule[4, 2:4] = series[:, ::2].sum(axis=1) / 2, series[:, 1::2].sum(axis=1) / 2
    return rule


RULE = _rule()
