"""Compiled loop of the joint estimation: how much the samples of one pixel count."""

from __future__ import annotations

import numpy as np

from amulor.rejection.joint._kernels.bundles import Model, Pixel, Workspace
from amulor.rejection.joint._kernels.model import depth_of, turn_by, water_to
from amulor.rejection.joint._kernels.options import LANES, inner


@inner(fastmath=LANES)
def fill_weights(path: float, stated: Pixel, model: Model, work: Workspace) -> None:
    """Fill in the inverse covariance of samples whose water fluctuates.

    (C + d d')^-1 by Sherman and Morrison, with the stated covariance C and the
    deviation d = phi (s W + s d V) of water that ends at a path. The water up to a
    target may be many times as strong as open water at high frequencies, where the
    ends of the column interfere. Compiled because every pixel needs it twice.
    """
    water, weight = work.water, work.weight
    depth = np.inf
    if path < np.inf:
        depth, _ = depth_of(path, stated.limits)
    water_to(depth, model.table, stated.coefficient, water, work.change)
    turn_by(water, stated.turn)
    level = 0.0
    for r in range(stated.coefficient.size):
        level += stated.coefficient[r] * model.level[r]
    size = model.fluctuation
    for c in range(weight.shape[0]):
        for f in range(weight.shape[2]):
            g, h = model.gain[c, 0, f], model.gain[c, 1, f]
            a, b = level * model.front[c, 0, f], level * model.front[c, 1, f]
            p, q = stated.turn[0, f], stated.turn[1, f]
            x = size * (g * water[0, f] - h * water[1, f] + a * p - b * q)
            y = size * (g * water[1, f] + h * water[0, f] + a * q + b * p)
            xx, xy, yy = (
                stated.weight[c, 0, f],
                stated.weight[c, 1, f],
                stated.weight[c, 2, f],
            )
            u = xx * x + xy * y
            v = xy * x + yy * y
            share = 1 / (1 + x * u + y * v)
            weight[c, 0, f] = xx - share * u * u
            weight[c, 1, f] = xy - share * u * v
            weight[c, 2, f] = yy - share * v * v
