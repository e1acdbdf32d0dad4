"""Compiled loop of the joint estimation: where the search of the shape begins."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint._kernels.model import depth_of, fill_phasor, turn_by

Array = NDArray[Any]


@numba.njit(cache=True)
def starting_costs(
    signal: Array,
    weight: Array,
    share: Array,
    turned: Array,
    value: Array,
    step: float,
    wavenumber: Array,
    transfer: Array,
    grid: Array,
    start: Array,
    longest: Array,
    depths: Array,
    best: Array,
    strength: Array,
) -> None:
    """Fill in the misfit of each pixel with a water signal of its own strength.

    For every path on the grid the amplitudes of target and water are fitted channel by
    channel, neither below zero; `strength` holds those of the water at the best.
    """
    channels, frequencies = signal.shape[1], signal.shape[3]
    coarse = np.empty((grid.size, 2, frequencies))
    for j in range(grid.size):
        fill_phasor(grid[j], wavenumber, transfer, coarse[j])
    water = np.empty((2, frequencies))
    turn = np.empty((2, frequencies))
    trial = np.empty(channels)
    for n in range(signal.shape[0]):
        best[n] = np.inf
        for f in range(frequencies):
            turn[0, f] = math.cos(wavenumber[f] * turned[n])
            turn[1, f] = math.sin(wavenumber[f] * turned[n])
        for j in range(grid.size):
            if not start[n] <= grid[j] <= longest[n]:
                continue
            depth, _ = depth_of(grid[j], start[n], longest[n], depths[n])
            node = min(max(int(depth / step + 0.5), 0), value.shape[1] - 2)
            water[:] = 0
            for r in range(share.shape[1]):
                for f in range(frequencies):
                    water[0, f] += share[n, r] * value[r, node, 0, f]
                    water[1, f] += share[n, r] * value[r, node, 1, f]
            turn_by(water, turn)
            total = 0.0
            for c in range(channels):
                ee, ew, ww, ye, yw, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                for f in range(frequencies):
                    a, b, d = weight[n, c, 0, f], weight[n, c, 1, f], weight[n, c, 2, f]
                    u, v = signal[n, c, 0, f], signal[n, c, 1, f]
                    e, i = coarse[j, 0, f], coarse[j, 1, f]
                    w, x = water[0, f], water[1, f]
                    yy += a * u * u + 2 * b * u * v + d * v * v
                    ye += e * (a * u + b * v) + i * (b * u + d * v)
                    yw += w * (a * u + b * v) + x * (b * u + d * v)
                    ee += a * e * e + 2 * b * e * i + d * i * i
                    ew += e * (a * w + b * x) + i * (b * w + d * x)
                    ww += a * w * w + 2 * b * w * x + d * x * x
                determinant = ee * ww - ew * ew
                s, t = 0.0, 0.0
                if determinant > 1e-12 * ee * ww:
                    t = (ye * ww - yw * ew) / determinant
                    s = (yw * ee - ye * ew) / determinant
                if t <= 0 or s <= 0:
                    t, s = max(ye, 0.0) / ee if ee > 0 else 0.0, 0.0
                    if ww > 0 and yw > 0 and yw * yw / ww > t * ye:
                        t, s = 0.0, yw / ww
                trial[c] = s
                total += yy - t * ye - s * yw
            if total < best[n]:
                best[n] = total
                for c in range(channels):
                    strength[n, c] = trial[c]
