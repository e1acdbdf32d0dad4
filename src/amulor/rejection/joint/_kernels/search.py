"""Compiled loops of the joint estimation: the search for the most likely path."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint._kernels.model import (
    LANES,
    depth_of,
    descent,
    fill_phasor,
    misfit,
    misfit_at,
    turn_by,
    water_to,
)

Array = NDArray[Any]


#: Local minima of the coarse likelihood that are looked at closely.
CANDIDATES = 6
#: Columns of what `estimate` fills in.
PATH, COST, INFORMATION, LOWER, UPPER, WRONG, EMPTY_COST, USED = range(8)
COLUMNS = 8

#: A minimum is out of the race when it is this much higher [1], and by this share of
#: what the target explains, which the coarse grid may miss.
_NEAR, _GRID_ERROR = 60.0, 0.05
_MOST_STEPS = 20
_HALVINGS = 6
_BISECTIONS = 24


@numba.njit(cache=True)
def _half_width(
    side: float,
    path: float,
    sigma: float,
    lowest: float,
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
) -> float:
    """Return how far the path may go to one side until the misfit has risen by 1."""
    near, far = 0.0, sigma
    rise = 0.0
    for attempt in range(6):
        cost, _ = misfit_at(
            path + side * far, first, last, nodes, step, share, value, slope, turn,
            wavenumber, transfer, signal, weight, gain, water, change, phasor,
            amplitude,
        )  # fmt: skip
        rise = cost - lowest
        # A parabola to a tenth: its own width serves.
        if attempt == 0 and abs(rise - 1) < 0.1:
            return far / math.sqrt(rise)
        if rise >= 1:
            break
        near, far = far, 1.5 * far
    if rise < 1:
        return far
    for _ in range(_BISECTIONS):
        middle = 0.5 * (near + far)
        cost, _ = misfit_at(
            path + side * middle, first, last, nodes, step, share, value, slope, turn,
            wavenumber, transfer, signal, weight, gain, water, change, phasor,
            amplitude,
        )  # fmt: skip
        if cost - lowest < 1:
            near = middle
        else:
            far = middle
    return 0.5 * (near + far)


@numba.njit(cache=True, fastmath=LANES)
def _coarse(
    grid: Array,
    coarse: Array,
    shortest: float,
    longest: float,
    first: float,
    last: float,
    depths: Array,
    step: float,
    share: Array,
    value: Array,
    turn: Array,
    signal: Array,
    weight: Array,
    gain: Array,
    water: Array,
    amplitude: Array,
    minima: Array,
    levels: Array,
) -> int:
    """Fill in the lowest local minima of the likelihood on a grid of paths."""
    nodes, frequencies = value.shape[1], value.shape[3]
    before, level = np.inf, np.inf
    settled = -1
    found = 0
    for j in range(grid.size + 1):
        after = np.inf
        if j < grid.size and shortest <= grid[j] <= longest:
            depth, _ = depth_of(grid[j], first, last, depths)
            node = min(max(int(depth / step + 0.5), 0), nodes - 2)
            if node != settled:
                settled = node
                water[:] = 0
                for r in range(share.size):
                    for f in range(frequencies):
                        water[0, f] += share[r] * value[r, node, 0, f]
                        water[1, f] += share[r] * value[r, node, 1, f]
                turn_by(water, turn)
            after = misfit(signal, weight, gain, water, coarse[j], amplitude)
        if level < np.inf and level <= before and level < after:
            # The vertex of the parabola through three points.
            place, height = grid[j - 1], level
            bend = before - 2 * level + after
            if before < np.inf and after < np.inf and bend > 0:
                shift = 0.5 * (before - after) / bend
                place += shift * (grid[1] - grid[0])
                height -= 0.25 * (before - after) * shift
            worst = 0
            for k in range(CANDIDATES):
                if levels[k] > levels[worst]:
                    worst = k
            if height < levels[worst]:
                minima[worst], levels[worst] = place, height
                found = min(found + 1, CANDIDATES)
        before, level = level, after
    for k in range(1, CANDIDATES):
        place, height = minima[k], levels[k]
        m = k
        while m > 0 and levels[m - 1] > height:
            minima[m], levels[m] = minima[m - 1], levels[m - 1]
            m -= 1
        minima[m], levels[m] = place, height
    return found


@numba.njit(cache=True)
def _estimate_one(
    signal: Array,
    weight: Array,
    gain: Array,
    share: Array,
    turned: float,
    value: Array,
    slope: Array,
    step: float,
    wavenumber: Array,
    transfer: Array,
    grid: Array,
    coarse: Array,
    first: float,
    last: float,
    depths: Array,
    known: float,
    is_known: bool,
    out: Array,
    amplitudes: Array,
    influences: Array,
) -> None:
    """Fill in the most likely path of one pixel."""
    channels, frequencies = signal.shape[0], signal.shape[2]
    spacing = grid[1] - grid[0]
    water = np.empty((2, frequencies))
    change = np.empty((2, frequencies))
    phasor = np.empty((2, frequencies))
    turn = np.empty((2, frequencies))
    amplitude = np.empty(channels)
    influence = np.empty((channels, 2, frequencies))
    minima = np.empty(CANDIDATES)
    levels = np.full(CANDIDATES, np.inf)
    for f in range(frequencies):
        turn[0, f] = math.cos(wavenumber[f] * turned)
        turn[1, f] = math.sin(wavenumber[f] * turned)
    used = 0
    for c in range(channels):
        for f in range(frequencies):
            if weight[c, 0, f] > 0:
                used += 2
    # Water alone, open to its end.
    water_to(np.inf, step, share, value, slope, water, change)
    turn_by(water, turn)
    for f in range(frequencies):
        phasor[0, f] = phasor[1, f] = 0
    empty = misfit(signal, weight, gain, water, phasor, amplitude)
    found = 0
    if is_known:
        minima[0], levels[0], found = known, 0.0, 1
    else:
        found = _coarse(
            grid, coarse, first - spacing, last + spacing, first, last, depths,
            step, share, value, turn, signal, weight, gain, water,
            amplitude, minima, levels,
        )  # fmt: skip
    best, best_path, best_information = np.inf, np.nan, 0.0
    mass = np.zeros(CANDIDATES)
    costs = np.full(CANDIDATES, np.inf)
    for k in range(found):
        # What is worse by more than the coarse grid can err is not looked at.
        if levels[k] > best + _NEAR + _GRID_ERROR * empty:
            break
        path = minima[k]
        cost, rate = misfit_at(
            path, first, last, depths, step, share, value, slope, turn,
            wavenumber, transfer, signal, weight, gain, water, change, phasor,
            amplitude,
        )  # fmt: skip
        information = 0.0
        for _ in range(_MOST_STEPS):
            downhill, information = descent(
                signal, weight, gain, water, change, rate, phasor, wavenumber,
                amplitude, influence,
            )  # fmt: skip
            if not information > 0:
                break
            move = downhill / information
            move = min(max(move, -0.5 * spacing), 0.5 * spacing)
            moved, new = path, cost
            for _ in range(_HALVINGS):
                moved = path + move
                new, rate = misfit_at(
                    moved, first, last, depths, step, share, value, slope,
                    turn, wavenumber, transfer, signal, weight, gain, water,
                    change, phasor, amplitude,
                )  # fmt: skip
                if new <= cost:
                    break
                move *= 0.5
            if not new <= cost:
                break
            path, cost = moved, new
            if abs(move) < 1e-3 / math.sqrt(information) or abs(move) < 1e-10:
                break
        if not information > 0:
            continue
        # The error may carry a path a little beyond its limits.
        slack = min(4 / math.sqrt(information), spacing)
        if path < first - slack or path > last + slack:
            continue
        same = False
        for m in range(k):
            if costs[m] < np.inf and abs(minima[m] - path) < 0.25 * spacing:
                same = True
        if same:
            continue
        minima[k], costs[k] = path, cost
        mass[k] = 1 / math.sqrt(information)
        if cost < best:
            best, best_path, best_information = cost, path, information
    if not best_information > 0:
        out[PATH] = np.nan
        out[COST] = np.inf
        out[INFORMATION] = 0.0
        out[LOWER], out[UPPER], out[WRONG] = np.nan, np.nan, 1.0
        out[EMPTY_COST], out[USED] = empty, used
        for c in range(channels):
            amplitudes[c] = 0
            for f in range(frequencies):
                influences[c, 0, f] = influences[c, 1, f] = 0
        return
    total, own = 0.0, 0.0
    for k in range(found):
        if costs[k] < np.inf:
            likely = mass[k] * math.exp(-0.5 * min(costs[k] - best, 1400.0))
            total += likely
            if minima[k] == best_path:
                own = likely
    sigma = 1 / math.sqrt(best_information)
    lower, upper = sigma, sigma
    if not is_known:
        lower = _half_width(
            -1.0, best_path, sigma, best, first, last, depths, step, share,
            value, slope, turn, wavenumber, transfer, signal, weight, gain,
            water, change, phasor, amplitude,
        )  # fmt: skip
        upper = _half_width(
            1.0, best_path, sigma, best, first, last, depths, step, share,
            value, slope, turn, wavenumber, transfer, signal, weight, gain,
            water, change, phasor, amplitude,
        )  # fmt: skip
    cost, rate = misfit_at(
        best_path, first, last, depths, step, share, value, slope, turn,
        wavenumber, transfer, signal, weight, gain, water, change, phasor,
        amplitude,
    )  # fmt: skip
    _, information = descent(
        signal, weight, gain, water, change, rate, phasor, wavenumber,
        amplitude, influence,
    )  # fmt: skip
    out[PATH], out[COST], out[INFORMATION] = best_path, best, information
    out[LOWER], out[UPPER] = lower, upper
    out[WRONG] = 1 - own / total
    out[EMPTY_COST], out[USED] = empty, used
    for c in range(channels):
        amplitudes[c] = amplitude[c]
        for f in range(frequencies):
            influences[c, 0, f] = influence[c, 0, f] / information
            influences[c, 1, f] = influence[c, 1, f] / information


@numba.njit(cache=True, parallel=True)
def estimate(
    signal: Array,
    weight: Array,
    gain: Array,
    share: Array,
    turned: Array,
    value: Array,
    slope: Array,
    step: float,
    wavenumber: Array,
    transfer: Array,
    grid: Array,
    start: Array,
    longest: Array,
    depths: Array,
    known: Array,
    is_known: bool,
    out: Array,
    amplitudes: Array,
    influences: Array,
) -> None:
    """Fill in the most likely path of every pixel.

    Arrays run over (pixel, channel, part, frequency), the parts real and imaginary.
    `grid` holds the paths of the coarse likelihood; where `is_known`, the search starts
    at the path `known` instead.
    """
    frequencies = signal.shape[3]
    coarse = np.empty((grid.size, 2, frequencies))
    for j in range(grid.size):
        fill_phasor(grid[j], wavenumber, transfer, coarse[j])
    for n in numba.prange(signal.shape[0]):
        _estimate_one(
            signal[n], weight[n], gain, share[n], turned[n], value, slope, step,
            wavenumber, transfer, grid, coarse, start[n], longest[n], depths[n],
            known[n], is_known, out[n], amplitudes[n], influences[n],
        )  # fmt: skip
