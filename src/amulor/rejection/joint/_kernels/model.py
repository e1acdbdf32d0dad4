"""Compiled loops of the joint estimation: signal and misfit of one pixel."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

#: Sums may be taken in any order, so that they run in parallel lanes.
LANES = {"reassoc", "contract"}

# Where a loop runs in parallel it holds a call and no more: it compiles much faster.


@numba.njit(cache=True)
def depth_of(
    path: float,
    first: float,
    last: float,
    nodes: Array,
) -> tuple[float, float]:
    """Return the depth of a path, and its slope, from a table that is finer in front.

    The nodes lie at first + (last - first) * (k / (n - 1)) ** 2.
    """
    count = nodes.size - 1
    share = (path - first) / (last - first)
    place = math.sqrt(share) * count if share > 0 else 0.0
    k = min(int(place), count - 1)
    width = (last - first) / count**2
    start = first + width * k**2
    step = width * (2 * k + 1)
    slope = (nodes[k + 1] - nodes[k]) / step
    return nodes[k] + slope * (path - start), slope


@numba.njit(cache=True, fastmath=LANES)
def water_to(
    depth: float,
    step: float,
    share: Array,
    value: Array,
    slope: Array,
    water: Array,
    change: Array,
) -> None:
    """Fill in the water signal up to a depth and its derivative, cubic between nodes.

    The tables hold values and slopes, the axis before the last (real, imaginary).
    The last node is open water; the one before it serves all depths beyond.
    """
    last = value.shape[1] - 2
    if depth == np.inf:
        j, t = last, 1.0
    else:
        place = min(max(depth / step, 0.0), float(last))
        j = min(int(place), last - 1)
        t = place - j
    h00 = (1 + 2 * t) * (1 - t) ** 2
    h10 = t * (1 - t) ** 2 * step
    h01 = t * t * (3 - 2 * t)
    h11 = t * t * (t - 1) * step
    beyond = depth >= last * step or depth <= 0
    g0 = 6 * t * (t - 1) / step
    g10 = (1 - t) * (1 - 3 * t)
    g11 = t * (3 * t - 2)
    if beyond:
        g0, g10, g11 = 0.0, 0.0, 0.0
    water[:] = 0
    change[:] = 0
    for r in range(share.size):
        c = share[r]
        for part in range(2):
            for f in range(water.shape[1]):
                a, b = value[r, j, part, f], value[r, j + 1, part, f]
                da, db = slope[r, j, part, f], slope[r, j + 1, part, f]
                water[part, f] += c * (h00 * a + h10 * da + h01 * b + h11 * db)
                change[part, f] += c * (g0 * (a - b) + g10 * da + g11 * db)


@numba.njit(cache=True, fastmath=LANES)
def turn_by(
    signal: Array,
    turn: Array,
) -> None:
    """Multiply (real, imaginary) pairs by those of unit phasors, in place."""
    for f in range(signal.shape[1]):
        a, b = signal[0, f], signal[1, f]
        signal[0, f] = a * turn[0, f] - b * turn[1, f]
        signal[1, f] = a * turn[1, f] + b * turn[0, f]


@numba.njit(cache=True)
def fill_phasor(
    path: float,
    wavenumber: Array,
    transfer: Array,
    out: Array,
) -> None:
    for f in range(wavenumber.size):
        c, s = math.cos(wavenumber[f] * path), math.sin(wavenumber[f] * path)
        out[0, f] = c * transfer[0, f] - s * transfer[1, f]
        out[1, f] = s * transfer[0, f] + c * transfer[1, f]


@numba.njit(cache=True, fastmath=LANES)
def misfit(
    signal: Array,
    weight: Array,
    gain: Array,
    water: Array,
    phasor: Array,
    amplitude: Array,
) -> float:
    """Return the misfit with the best amplitudes, which are filled in."""
    total = 0.0
    for c in range(signal.shape[0]):
        square, along, fit = 0.0, 0.0, 0.0
        for f in range(signal.shape[2]):
            xx, xy, yy = weight[c, 0, f], weight[c, 1, f], weight[c, 2, f]
            g, h = gain[c, 0, f], gain[c, 1, f]
            u = signal[c, 0, f] - g * water[0, f] + h * water[1, f]
            v = signal[c, 1, f] - g * water[1, f] - h * water[0, f]
            wu = xx * u + xy * v
            wv = xy * u + yy * v
            e, i = phasor[0, f], phasor[1, f]
            square += u * wu + v * wv
            along += e * wu + i * wv
            fit += xx * e * e + 2 * xy * e * i + yy * i * i
        best = along / fit if along > 0 and fit > 0 else 0.0
        amplitude[c] = best
        total += square - best * along
    return total


@numba.njit(cache=True, fastmath=LANES)
def descent(
    signal: Array,
    weight: Array,
    gain: Array,
    water: Array,
    change: Array,
    rate: float,
    phasor: Array,
    wavenumber: Array,
    amplitude: Array,
    influence: Array,
) -> tuple[float, float]:
    """Return half the downhill slope of the misfit in the path, and its curvature.

    Gauss and Newton's curvature, the amplitudes that are above zero eliminated. The
    influence is what the path moves by per unit of each output, times the curvature.
    """
    downhill, curvature = 0.0, 0.0
    for c in range(signal.shape[0]):
        own, cross, fit = 0.0, 0.0, 0.0
        a = amplitude[c]
        for f in range(signal.shape[2]):
            xx, xy, yy = weight[c, 0, f], weight[c, 1, f], weight[c, 2, f]
            g, h = gain[c, 0, f], gain[c, 1, f]
            e, i = phasor[0, f], phasor[1, f]
            u = signal[c, 0, f] - g * water[0, f] + h * water[1, f] - a * e
            v = signal[c, 1, f] - g * water[1, f] - h * water[0, f] - a * i
            p = -a * wavenumber[f] * i + rate * (g * change[0, f] - h * change[1, f])
            q = a * wavenumber[f] * e + rate * (g * change[1, f] + h * change[0, f])
            wp = xx * p + xy * q
            wq = xy * p + yy * q
            we = xx * e + xy * i
            wi = xy * e + yy * i
            downhill += u * wp + v * wq
            own += p * wp + q * wq
            cross += p * we + q * wi
            fit += e * we + i * wi
            influence[c, 0, f] = wp
            influence[c, 1, f] = wq
        if a > 0 and fit > 0:
            share = cross / fit
            own -= share * cross
            for f in range(signal.shape[2]):
                xx, xy, yy = weight[c, 0, f], weight[c, 1, f], weight[c, 2, f]
                e, i = phasor[0, f], phasor[1, f]
                influence[c, 0, f] -= share * (xx * e + xy * i)
                influence[c, 1, f] -= share * (xy * e + yy * i)
        curvature += own
    return downhill, curvature


@numba.njit(cache=True, fastmath=LANES)
def misfit_at(
    path: float,
    first: float,
    last: float,
    nodes: Array,
    step: float,
    share: Array,
    value: Array,
    slope: Array,
    turn: Array,
    wavenumber: Array,
    transfer: Array,
    signal: Array,
    weight: Array,
    gain: Array,
    water: Array,
    change: Array,
    phasor: Array,
    amplitude: Array,
) -> tuple[float, float]:
    """Return misfit and slope of the depth at a path; fill in the model."""
    depth, rate = depth_of(path, first, last, nodes)
    water_to(depth, step, share, value, slope, water, change)
    turn_by(water, turn)
    turn_by(change, turn)
    fill_phasor(path, wavenumber, transfer, phasor)
    return misfit(signal, weight, gain, water, phasor, amplitude), rate


@numba.njit(cache=True, fastmath=LANES)
def _interpolate_one(
    depth: float,
    step: float,
    share: Array,
    table: Array,
    out: Array,
) -> None:
    """Fill in columns of water up to one depth, linear between the nodes."""
    last = table.shape[2] - 2
    if depth == np.inf:
        j, t = last, 1.0
    else:
        place = min(max(depth / step, 0.0), float(last))
        j = min(int(place), last - 1)
        t = place - j
    for m in range(table.shape[0]):
        for f in range(table.shape[3]):
            out[m, f] = 0
        for r in range(table.shape[1]):
            before, after = share[r] * (1 - t), share[r] * t
            for f in range(table.shape[3]):
                out[m, f] += before * table[m, r, j, f] + after * table[m, r, j + 1, f]


@numba.njit(cache=True, parallel=True)
def interpolate(
    depth: Array,
    step: float,
    share: Array,
    table: Array,
    out: Array,
) -> None:
    """Fill in columns of water up to given depths, linear between the nodes.

    `table` runs over (parameter, component, node, frequency), `out` over (pixel,
    parameter, frequency), both complex.
    """
    for n in numba.prange(depth.size):
        _interpolate_one(depth[n], step, share[n], table, out[n])


@numba.njit(cache=True)
def _water_at_one(
    path: float,
    start: float,
    longest: float,
    depths: Array,
    step: float,
    share: Array,
    value: Array,
    slope: Array,
    turned: float,
    wavenumber: Array,
    water: Array,
    change: Array,
) -> float:
    """Fill in water signal and its derivative at a path; return the depth."""
    turn = np.empty((2, wavenumber.size))
    depth, rate = np.inf, 0.0
    if path < np.inf:
        depth, rate = depth_of(path, start, longest, depths)
    water_to(depth, step, share, value, slope, water, change)
    for f in range(wavenumber.size):
        turn[0, f] = math.cos(wavenumber[f] * turned)
        turn[1, f] = math.sin(wavenumber[f] * turned)
    turn_by(water, turn)
    turn_by(change, turn)
    for f in range(wavenumber.size):
        change[0, f] *= rate
        change[1, f] *= rate
    return depth


@numba.njit(cache=True, parallel=True)
def water_at(
    path: Array,
    start: Array,
    longest: Array,
    depths: Array,
    step: float,
    share: Array,
    value: Array,
    slope: Array,
    turned: Array,
    wavenumber: Array,
    depth: Array,
    water: Array,
    change: Array,
) -> None:
    """Fill in depth, water signal and its derivative at one path for each pixel.

    A path that is infinite means open water.
    """
    for n in numba.prange(path.size):
        depth[n] = _water_at_one(
            path[n], start[n], longest[n], depths[n], step, share[n], value, slope,
            turned[n], wavenumber, water[n], change[n],
        )  # fmt: skip


@numba.njit(cache=True)
def integrate(
    profile: Array,
    phasor: Array,
    order: int,
    count: int,
    out: Array,
) -> None:
    """Fill in running sums of profile times phasor, a node every `order` points.

    The node after number `count` holds the sum of everything.
    """
    total = np.empty(phasor.shape[1], dtype=np.complex128)
    for m in range(profile.shape[0]):
        for r in range(profile.shape[1]):
            for f in range(phasor.shape[1]):
                total[f] = 0
                out[m, r, 0, f] = 0
            for k in range(phasor.shape[0]):
                for f in range(phasor.shape[1]):
                    total[f] += profile[m, r, k] * phasor[k, f]
                if (k + 1) % order == 0 and (k + 1) // order <= count:
                    for f in range(phasor.shape[1]):
                        out[m, r, (k + 1) // order, f] = total[f]
            for f in range(phasor.shape[1]):
                out[m, r, count + 1, f] = total[f]
