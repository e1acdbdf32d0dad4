"""Compiled loop of the joint estimation: where the search of the shape begins."""

from __future__ import annotations

import numpy as np

from amulor._compiled import numba
from amulor.rejection.joint._kernels.bundles import (
    Array,
    Echo,
    Grid,
    Places,
    Samples,
    WaterTable,
)
from amulor.rejection.joint._kernels.model import (
    depth_of,
    nearest_node,
    pixel_of,
    water_at_node,
)
from amulor.rejection.joint._kernels.options import inner

#: Two columns that are this close to each other cannot be told apart [1].
_DEPENDENT = 1e-12


@inner()
def two_amplitudes(
    signal: Array, weight: Array, echo: Array, water: Array
) -> tuple[float, float]:
    """Return chi-square and the strength of the water in one channel.

    Linear least squares on echo and water, neither below zero. Arrays are (2,
    frequency), the weight (3, frequency).
    """
    ee, ew, ww, ye, yw, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for f in range(signal.shape[1]):
        a, b, d = weight[0, f], weight[1, f], weight[2, f]
        u, v = signal[0, f], signal[1, f]
        e, i = echo[0, f], echo[1, f]
        w, x = water[0, f], water[1, f]
        yy += a * u * u + 2 * b * u * v + d * v * v
        ye += e * (a * u + b * v) + i * (b * u + d * v)
        yw += w * (a * u + b * v) + x * (b * u + d * v)
        ee += a * e * e + 2 * b * e * i + d * i * i
        ew += e * (a * w + b * x) + i * (b * w + d * x)
        ww += a * w * w + 2 * b * w * x + d * x * x
    determinant = ee * ww - ew * ew
    s, t = 0.0, 0.0
    if determinant > _DEPENDENT * ee * ww:
        t = (ye * ww - yw * ew) / determinant
        s = (yw * ee - ye * ew) / determinant
    if t <= 0 or s <= 0:
        t, s = max(ye, 0.0) / ee if ee > 0 else 0.0, 0.0
        if ww > 0 and yw > 0 and yw * yw / ww > t * ye:
            t, s = 0.0, yw / ww
    return yy - t * ye - s * yw, s


@numba.njit(cache=True, error_model="numpy")
def starting_costs(
    samples: Samples,
    places: Places,
    table: WaterTable,
    echo: Echo,
    grid: Grid,
    best: Array,
    strength: Array,
) -> None:
    """Fill in chi-square of each pixel with a water signal of its own strength.

    For every path on the grid the amplitudes A_c of the target and s_c of the water are
    fitted channel by channel; `strength` holds s_c at the best path. Compiled because
    it is done for every shape of W that is tried.
    """
    channels, frequencies = samples.signal.shape[1], samples.signal.shape[3]
    water = np.empty((2, frequencies))
    turn = np.empty((2, frequencies))
    trial = np.empty(channels)
    for n in range(samples.signal.shape[0]):
        pixel = pixel_of(samples, places, n, echo.phase_per_path, turn)
        best[n] = np.inf
        for j in range(grid.path.size):
            if not pixel.limits.shortest <= grid.path[j] <= pixel.limits.longest:
                continue
            depth, _ = depth_of(grid.path[j], pixel.limits)
            water_at_node(nearest_node(depth, table), table, pixel, water)
            total = 0.0
            for c in range(channels):
                cost, trial[c] = two_amplitudes(
                    pixel.signal[c], pixel.weight[c], grid.phasor[j], water
                )
                total += cost
            if total < best[n]:
                best[n] = total
                strength[n] = trial
