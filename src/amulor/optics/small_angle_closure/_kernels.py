"""Compiled small-angle closure: squared width S, broadening B, exponent A, overlap.

F(z) is the overlap of beam and receiver at the depth z, R the receiver radius, gamma
the acceptance angle, and w the phase per depth [rad/m]. The closure approximates eq.
(29) of Ricci et al. 2010, as rederived. A panel is a depth interval with quadrature
nodes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba
from amulor.optics._quadrature import ORDER, Panel, add_panel, j0
from amulor.optics.small_angle._kernels import (
    LINEAR,
    PER_OCTAVE,
    WIDTH,
    Water,
    aimed,
)

__all__ = ["Layout", "collected", "departures", "water_column"]

Array = NDArray[np.float64]

_SETTLED = 1e-12  # relative change of S at which it is found
_STEPS = 300  # most steps to S
_SAME = 1e-9  # relative difference of S up to which two are one
_UNRESOLVED = 1e-10  # allowed interpolation error of a panel, relative to the integral
_ROUNDING = 1e-14  # rounding level, relative to the light on the axis
_NARROWEST = 1e-12  # width of a panel over its depth: F(z) has a step there
_CAPACITY = 256  # waiting panels
_DOUBLINGS = 200  # most groups of panels to the end of the water
_LOST = 3.0  # exponent A beyond which the light regarded as lost is not lost
_ASIDE = 30.0  # offset squared over S beyond which a Gaussian has no light


class Layout(NamedTuple):
    """Layout of depth panels: first width, closest approach of the axes, end."""

    step: float
    """Width of the first panel [m]."""
    nearest: float
    """Depth of the smallest distance between beam and receiver axis [m]."""
    narrow: float
    """Depth interval over which the axes stay close [m]."""
    end: float
    """Depth at which the water ends [m]."""


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _cell(table: Array, cell: int, s: float) -> tuple[float, float]:
    """Evaluate a table cell's polynomial and its derivative, at s from -1 to 1."""
    j = np.uint64(cell)
    value = table[j, 9]
    slope = 0.0
    for i in range(8, -1, -1):
        slope = slope * s + value
        value = value * s + table[j, i]
    return value, slope


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _lost(x: float, split: float, table: Array) -> tuple[float, float]:
    """Return 1 minus the mean Hankel transform up to x, and its slope divided by x."""
    t = x * split / WIDTH
    if t < LINEAR:
        cell = int(t)
        value, slope = _cell(table, cell, 2.0 * (t - cell) - 1.0)
        return x * x * value, 2.0 * value + x * slope * (2.0 * split / WIDTH)
    t = PER_OCTAVE * math.log2(t / LINEAR)
    cell = int(t)
    if cell < table.shape[0] - LINEAR:
        value, slope = _cell(table, LINEAR + cell, 2.0 * (t - cell) - 1.0)
        return x * x * value, 2.0 * value + slope * (2.0 * PER_OCTAVE / math.log(2))
    last = (WIDTH / split) * LINEAR * 2.0 ** ((table.shape[0] - LINEAR) / PER_OCTAVE)
    value, _ = _cell(table, table.shape[0] - 1, 1.0)
    mean = 1.0 - last * last * value
    return 1.0 - mean * last / x, mean * last / (x * x * x)


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _broadened(
    area: float, z: float, clear: float, water: Water, table: Array
) -> float:
    """Return the squared width clear + B(S) for a trial squared width S [m^2]."""
    x = 2.0 * z / math.sqrt(area)
    _, slope = _lost(x, water.split_angle, table)
    return clear + 2.0 * water.forward * z * z * z * slope


@numba.njit(cache=True, error_model="numpy")
def _solution(
    start: float, z: float, clear: float, water: Water, table: Array
) -> float:
    """Solve S = clear + B(S) for the squared width S, stepping from a starting value.

    The right side rises with S, so the steps go one way only; a longer one is taken
    along the two before it unless it passes the solution.
    """
    area = start
    following = _broadened(area, z, clear, water, table)
    for _ in range(_STEPS):
        change = following - area
        if abs(change) <= _SETTLED * area:
            return following
        after = _broadened(following, z, clear, water, table)
        next_change = after - following
        ratio = next_change / change
        area, following = following, after
        if 0.0 < ratio < 0.999:
            far = after + next_change * ratio / (1.0 - ratio)
            beyond = _broadened(far, z, clear, water, table)
            if (beyond - far) * change >= 0.0:
                area, following = far, beyond
    return following


@numba.njit(cache=True, error_model="numpy")
def _exponent(area: float, z: float, clear: float, water: Water, table: Array) -> float:
    """Return the loss exponent A of forward-scattered light for squared width S [1]."""
    value, _ = _lost(2.0 * z / math.sqrt(area), water.split_angle, table)
    return water.forward * z * value - (area - clear) / area


@numba.njit(cache=True, error_model="numpy")
def _line(z: float, water: Water, table: Array) -> tuple[float, float, float, float]:
    """Return the light's squared width S, exponent A, broadening B, offset^2 / S."""
    path = z + water.standoff
    clear = water.radius_squared + water.angle_squared * path * path
    offset = (water.baseline - water.tilt * path) ** 2 + (water.cross_tilt * path) ** 2
    area, lost = clear, 0.0
    if z > 0.0 and water.forward > 0.0:
        area = _solution(clear, z, clear, water, table)
        lost = _exponent(area, z, clear, water, table)
        _, widest = _lost(0.0, water.split_angle, table)
        widest = clear + 2.0 * water.forward * z * z * z * widest
        second_area = _solution(widest, z, clear, water, table)
        if second_area > area * (1.0 + _SAME):
            # Two solutions: each is a lower bound of the light on the axis.
            exponent = _exponent(second_area, z, clear, water, table)
            if exponent + math.log(second_area) < lost + math.log(area):
                area, lost = second_area, exponent
    return area, lost, area - clear, offset / area


@numba.njit(cache=True, error_model="numpy")
def _overlap(z: float, water: Water, table: Array) -> float:
    """Return the overlap F(z), divided by pi R^2 gamma^2 [1/m^2]."""
    area, lost, _, aside = _line(z, water, table)
    return math.exp(-water.loss * z - lost - aside) / area


@numba.njit(cache=True, error_model="numpy")
def departures(
    look: Array, water: Water, table: Array, bessel: Array, rule: Array, out: Array
) -> None:
    """Fill `out` with absolute and relative difference of eq. (29) from the closure.

    By Gauss-Laguerre nodes: rule has nodes and weights, a row of look is as in
    `collected`. Compiled, as S(z) is found step by step.
    """
    for n in range(look.shape[0]):
        z = look[n, 0]
        column = aimed(look[n], water)
        area, lost, spread, aside = _line(z, column, table)
        out[n, 0] = out[n, 1] = 0.0
        if z <= 0.0 or column.forward <= 0.0:
            continue
        total = 0.0
        for i in range(rule.shape[1]):
            t = rule[0, i]
            value, _ = _lost(2.0 * z * math.sqrt(t / area), column.split_angle, table)
            above = column.forward * z * value - lost - spread * t / area
            wave = j0(2.0 * math.sqrt(aside * t), bessel)
            total += rule[1, i] * wave * (math.exp(-above) - 1.0)
        out[n, 0] = total * math.exp(-column.loss * z - lost) / area
        out[n, 1] = math.inf
        if lost <= _LOST and aside <= _ASIDE:
            relative = total * math.exp(aside)
            if abs(relative) <= 1.0:  # the nodes resolve no more
                out[n, 1] = relative


@numba.njit(cache=True, error_model="numpy")
def collected(look: Array, water: Water, table: Array, out: Array) -> None:
    """Fill `out` with the overlap F(z), divided by pi R^2 gamma^2.

    A row of look is depth, baseline, tilt, cross tilt and standoff.
    Compiled, as S(z) is found step by step, docs/theory/water-signal.md.
    """
    for n in range(look.shape[0]):
        out[n] = _overlap(look[n, 0], aimed(look[n], water), table)


@numba.njit(cache=True, error_model="numpy")
def _bound(z: float, water: Water) -> float:
    """Return an upper limit of the overlap F(z), divided by pi R^2 gamma^2 [1/m^2]."""
    path = z + water.standoff
    area = water.radius_squared + water.angle_squared * path * path
    return math.exp(-water.loss * z) / area


@numba.njit(cache=True, error_model="numpy")
def _unresolved(value: Array, tail: Array) -> float:
    """Return the largest of the last Legendre coefficients of F(z) in a panel."""
    largest = 0.0
    for m in range(tail.shape[1]):
        total = 0.0
        for i in range(value.size):
            total += value[i] * tail[i, m]
        largest = max(largest, abs(total))
    return largest


@numba.njit(cache=True, error_model="numpy")
def _edges(start: float, stop: float, layout: Layout, waiting: Array) -> int:
    """Split a depth interval near the axes' closest approach; return the part count."""
    count = 0
    high = stop
    for factor in (9.0, 3.0, 1.0, 0.0, -1.0, -3.0, -9.0):
        place = layout.nearest + factor * layout.narrow
        if start < place < high:
            waiting[count, 0], waiting[count, 1] = place, high
            count += 1
            high = place
    waiting[count, 0], waiting[count, 1] = start, high
    return count + 1


@numba.njit(cache=True, error_model="numpy")
def _add_panels(
    span: tuple[float, float],
    before: float,
    water: Water,
    layout: Layout,
    table: Array,
    phases: Array,
    rules: tuple[Array, Array, Array, Array],
    sums: Array,
) -> float:
    """Add a depth interval to integrals of F(z) exp(i w z); return that of F(z) from 0.

    Rules are those of the quadrature, the nodes, the weights, and the tail.
    """
    rule, node, weight, tail = rules
    waiting = np.empty((_CAPACITY, 2))
    value = np.empty(node.size)
    even = np.empty(ORDER)
    odd = np.empty(ORDER)
    work = np.empty((2, ORDER))
    turn = np.empty((2, phases.size))
    pending = _edges(span[0], span[1], layout, waiting)
    total = before
    while pending > 0:
        pending -= 1
        low, high = waiting[pending, 0], waiting[pending, 1]
        half = 0.5 * (high - low)
        centre = low + half
        part = 0.0
        for i in range(node.size):
            value[i] = _overlap(centre + half * node[i], water, table)
            part += weight[i] * value[i]
        part *= half
        unresolved = 2.0 * half * _unresolved(value, tail)
        allowed = max(
            _UNRESOLVED * (total + part), _ROUNDING * half * _bound(low, water)
        )
        halved = half > _NARROWEST * centre and pending + 2 <= _CAPACITY
        if unresolved > allowed and halved:
            waiting[pending, 0], waiting[pending, 1] = centre, high
            waiting[pending + 1, 0], waiting[pending + 1, 1] = low, centre
            pending += 2
            continue
        for i in range(ORDER):
            right, behind = value[ORDER + i], value[ORDER - 1 - i]
            even[i], odd[i] = right + behind, right - behind
        add_panel(Panel(half, centre, even, odd), phases, rule, work, turn, sums)
        total += part
    return total


@numba.njit(cache=True, error_model="numpy")
def water_column(
    water: Water,
    layout: Layout,
    table: Array,
    phases: Array,
    rules: tuple[Array, Array, Array, Array],
    sums: Array,
) -> None:
    """Add depth integrals of exp(i w z) times F(z) / (pi R^2 gamma^2) to `sums`.

    Compiled, as panels are halved one by one where F(z) requires it.
    """
    length = math.sqrt(water.radius_squared / water.angle_squared) + water.standoff
    widest = 12.0 / water.loss if water.loss > 0.0 else math.inf
    total = 0.0
    start = 0.0
    stop = min(layout.step, layout.end)
    for _ in range(_DOUBLINGS):
        total = _add_panels(
            (start, stop), total, water, layout, table, phases, rules, sums
        )
        reach = stop + length
        if water.loss > 0.0:
            reach = min(reach, 1.0 / water.loss)
        if stop >= layout.end or _bound(stop, water) * reach < _UNRESOLVED * total:
            break
        if total == 0.0 and _bound(stop, water) < 1e-300:
            break
        start = stop
        stop = min(start + min(2.0 * start, widest), layout.end)
