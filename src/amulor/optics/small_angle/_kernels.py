"""Compiled loops of the small-angle model for a Gaussian receiver.

Radius R and acceptance angle gamma are those of the receiver, F(z) is the overlap of
beam and receiver at the depth z, and w the phase per depth [rad/m]. A panel is an
interval of depth or spatial frequency with quadrature nodes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba
from amulor.optics._quadrature import ORDER, Panel, add_panel, j0, polynomial

__all__ = [
    "Water",
    "add_columns",
    "add_panels",
    "aimed",
    "lost",
    "scattered",
    "separation",
    "spread",
]


Array = NDArray[np.float64]

FAR = 400  # argument up to which the mean of J0 comes from its table, in unit cells
LINEAR = 48  # cells of equal width at the start of a table of spread
WIDTH = 2.0  # their width, times the split angle
PER_OCTAVE = 4  # cells of the rest of it, per doubling

_GAUSSIAN_END = 10.0  # in 1/e half-widths: exp(-25) is left beyond
_SCATTERED_END = 25.0  # exponent by which scattering ends the integral
_PHASE = 28.0  # turn of the oscillations over a panel [rad]
_SMOOTH = 5.0  # width of a panel in 1/e half-widths of the receiver
_SPLIT_END = 100.0  # phase up to which the edge of the forward part is followed [rad]


class Water(NamedTuple):
    """Water column, with beam and receiver combined into one Gaussian.

    Where each depth is looked at in its own way, baseline, tilts and standoff here do
    not count.
    """

    loss: float
    """Two-way attenuation 2 k', forward scattering excluded [1/m]."""
    forward: float
    """Two-way forward scattering 2 b_f [1/m]."""
    split_angle: float
    """Split angle, the end of the forward part of the phase function [rad]."""
    baseline: float
    """Distance rho_0 between beam and receiver [m]."""
    tilt: float
    """Beam inclination n_0 along the baseline [rad]."""
    cross_tilt: float
    """Beam inclination n_0 across the baseline [rad]."""
    standoff: float
    """Equivalent water depth zeta - z of air and glass before the water [m]."""
    radius_squared: float
    """Combined squared radius of receiver and beam, R^2 + w^2 [m^2]."""
    angle_squared: float
    """Combined squared angle of receiver and beam, gamma^2 + delta^2 [1]."""


@numba.njit(cache=True, error_model="numpy")
def spread(x: Array, angle: Array, weight: Array, table: Array, out: Array) -> None:
    """Fill `out` with (1 - mean Hankel transform up to x) / x^2, summed over angles."""
    for i in range(x.size):
        total = 0.0
        for j in range(angle.size):
            y = x[i] * angle[j]
            if y < FAR:
                cell = int(y)
                value = polynomial(table, cell, 2.0 * (y - cell) - 1.0)
            else:
                value = (1.0 - 1.0 / y) / (y * y)
            total += weight[j] * angle[j] * angle[j] * value
        out[i] = total


@numba.njit(cache=True, error_model="numpy")
def lost(x: float, split: float, table: Array) -> float:
    """Return 1 minus the mean Hankel transform of the phase function from 0 to x."""
    t = x * split / WIDTH
    if t < LINEAR:
        cell = int(t)
        return x * x * polynomial(table, cell, 2.0 * (t - cell) - 1.0)
    t = PER_OCTAVE * math.log2(t / LINEAR)
    cell = int(t)
    if cell < table.shape[0] - LINEAR:
        return x * x * polynomial(table, LINEAR + cell, 2.0 * (t - cell) - 1.0)
    last = (WIDTH / split) * LINEAR * 2.0 ** ((table.shape[0] - LINEAR) / PER_OCTAVE)
    end = last * last * polynomial(table, table.shape[0] - 1, 1.0)
    beyond: float = 1.0 - (1.0 - end) * last / x
    return beyond


@numba.njit(cache=True, error_model="numpy")
def _scattering_end(depth: float, top: float, water: Water, table: Array) -> float:
    """Return the spatial frequency above which light is negligible, at most `top`."""
    thickness = water.forward * depth
    if thickness > _SCATTERED_END:
        while (
            thickness * lost(0.8 * top * depth, water.split_angle, table)
            > _SCATTERED_END
        ):
            top *= 0.8
    return top


@numba.njit(cache=True, error_model="numpy")
def _offset(depth: float, water: Water) -> float:
    """Return the distance between beam axis and receiver axis at a depth [m]."""
    path = depth + water.standoff
    return math.hypot(water.baseline - water.tilt * path, water.cross_tilt * path)


@numba.njit(cache=True, error_model="numpy")
def _scattered_at(
    z: float,
    offset: float,
    water: Water,
    table: Array,
    bessel: Array,
    rule: Array,
    work: Array,
) -> float:
    """Return the overlap of forward-scattered light at a depth / (pi R^2 gamma^2)."""
    nodes = rule.shape[1]
    path = z + water.standoff
    area = water.radius_squared + water.angle_squared * path * path
    thickness = water.forward * z
    unscattered = math.exp(-thickness)
    top = _scattering_end(z, _GAUSSIAN_END / math.sqrt(area), water, table)
    reach = z * water.split_angle
    narrowest = min(top / 3.0, 6.0 / reach)
    widest = min(_SMOOTH / math.sqrt(area), top / 2.0)
    total = 0.0
    low = 0.0
    while low < top:
        turn = offset
        if low * reach < _SPLIT_END:
            turn += reach
        width = min(max(narrowest, low), widest, _PHASE / turn)
        if low + 1.2 * width > top:
            width = top - low
        for i in range(nodes):
            kappa = low + width * rule[0, i]
            work[0, i] = -0.25 * area * kappa * kappa
            work[1, i] = -thickness * lost(kappa * z, water.split_angle, table)
            work[2, i] = kappa * j0(kappa * offset, bessel)
        part = 0.0
        for i in range(nodes):
            value = math.exp(work[0, i]) * (math.exp(work[1, i]) - unscattered)
            part += rule[1, i] * work[2, i] * value
        total += width * part
        low += width
    return 0.5 * total * math.exp(-water.loss * z)


@numba.njit(cache=True, error_model="numpy")
def aimed(look: Array, water: Water) -> Water:
    """Copy a water column with baseline, tilts and standoff from a row of values."""
    return Water(
        water.loss,
        water.forward,
        water.split_angle,
        look[1],
        look[2],
        look[3],
        look[4],
        water.radius_squared,
        water.angle_squared,
    )


@numba.njit(cache=True, error_model="numpy")
def scattered(
    look: Array, water: Water, table: Array, bessel: Array, rule: Array, out: Array
) -> None:
    """Fill `out` with the overlap of forward-scattered light / (pi R^2 gamma^2).

    A row of look is depth, baseline, tilt, cross tilt and standoff. Eq. (29)
    less its unscattered part, docs/theory/water-signal.md: an integral over the spatial
    frequency kappa of J0(kappa offset), the Gaussian of receiver and beam and
    exp[2 b_f z P(kappa z) / kappa z]. Compiled, as the panels of kappa follow from what
    oscillates at each depth, and tables are looked up for each node.
    """
    work = np.empty((3, rule.shape[1]))
    for n in range(look.shape[0]):
        z = look[n, 0]
        if z <= 0.0:  # nothing is scattered before the water begins
            out[n] = 0.0
            continue
        column = aimed(look[n], water)
        offset = _offset(z, column)
        out[n] = _scattered_at(z, offset, column, table, bessel, rule, work)


@numba.njit(cache=True, error_model="numpy")
def add_panels(
    edge: Array, value: Array, phase_per_depth: Array, rule: Array, sums: Array
) -> None:
    """Add depth integrals of exp(i w z) times the overlap F(z) in panels to `sums`.

    A row of value holds a panel at its Gauss-Legendre nodes, rising.
    """
    even = np.empty(ORDER)
    odd = np.empty(ORDER)
    work = np.empty((2, ORDER))
    turn = np.empty((2, phase_per_depth.size))
    for j in range(value.shape[0]):
        half = 0.5 * (edge[j, 1] - edge[j, 0])
        centre = edge[j, 0] + half
        for i in range(ORDER):
            right, left = value[j, ORDER + i], value[j, ORDER - 1 - i]
            even[i], odd[i] = right + left, right - left
        panel = Panel(half, centre, even, odd)
        add_panel(panel, phase_per_depth, rule, work, turn, sums)


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def separation(z: float, view: Array, water: Water) -> float:
    """Return ln(1 + q), q: squared axis distance over squared beam-receiver width.

    A view is baseline, tilt and cross tilt.
    """
    path = z + water.standoff
    area = water.radius_squared + water.angle_squared * path * path
    along, across = view[0] - view[1] * path, view[2] * path
    return math.log1p((along * along + across * across) / area)


@numba.njit(cache=True, error_model="numpy")
def _shortened(value: Array, part: float, rules: tuple[Array, Array, Array]) -> None:
    """Interpolate a panel's node values to the nodes of its first part, in place."""
    _, node, series = rules
    size = node.size
    term = np.zeros(size)
    for i in range(size):
        for m in range(size):
            term[m] += value[i] * series[i, m]
    for i in range(size):
        x = part * (node[i] + 1.0) - 1.0
        before, now = 1.0, x
        total = term[0] + term[1] * x
        for m in range(2, size):
            before, now = now, ((2 * m - 1) * x * now - (m - 1) * before) / m
            total += term[m] * now
        value[i] = total


@numba.njit(cache=True, error_model="numpy")
def add_columns(
    view: Array,
    edge: Array,
    span: Array,
    cells: Array,
    water: Water,
    phases: Array,
    rules: tuple[Array, Array, Array],
    sums: Array,
) -> None:
    """Add depth integrals of exp(i w z) times the tabulated overlap to `sums`.

    A row of view is baseline, tilt, cross tilt and end of a column; edge has the
    panels, rising; span the start and the width of the cells of each node of them in
    ln(1 + q), and cells their polynomials, shape (node, cell, 10). Compiled, as each
    column of a scan looks up all of its nodes and ends where its target stands.
    """
    rule, node, _ = rules
    size = node.size
    value = np.empty(size)
    even, odd = np.empty(ORDER), np.empty(ORDER)
    work, turn = np.empty((2, ORDER)), np.empty((2, phases.size))
    for n in range(view.shape[0]):
        end = view[n, 3]
        for j in range(edge.shape[0]):
            low, high = edge[j, 0], edge[j, 1]
            if low >= end:
                break
            half = 0.5 * (high - low)
            for i in range(size):
                k = j * size + i
                z = low + half * (node[i] + 1.0)
                t = (separation(z, view[n], water) - span[k, 0]) / span[k, 1]
                cell = min(max(int(t), 0), cells.shape[1] - 1)
                value[i] = polynomial(cells[k], cell, 2.0 * (t - cell) - 1.0)
            if end < high:
                _shortened(value, (end - low) / (high - low), rules)
                half = 0.5 * (end - low)
            for i in range(ORDER):
                right, behind = value[ORDER + i], value[ORDER - 1 - i]
                even[i], odd[i] = right + behind, right - behind
            panel = Panel(half, low + half, even, odd)
            add_panel(panel, phases, rule, work, turn, sums[n])
