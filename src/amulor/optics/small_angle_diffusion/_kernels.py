"""Compiled depth integrals of the overlap F(z) in the small-angle diffusion model.

Radius R and acceptance angle gamma are those of the receiver, w is the phase per depth
[rad/m]. Eqs. (43) and (46) are those of Ricci et al. 2010, as rederived. A panel is a
depth interval with quadrature nodes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba
from amulor.optics._quadrature import ORDER, Panel, add_panel, expand

__all__ = ["water_column"]

Array = NDArray[np.float64]

_UNRESOLVED = 3e-14  # allowed interpolation error of a panel, relative to the integral
_ROUNDING = 3e-14  # of the largest value in a panel: rests below it are rounding
_NEGLIGIBLE = 1e-17  # of the whole integral: panels below it are left out
_DARK = -700.0  # exponent below which a column counts as dark
_CAPACITY = 512  # break points, and waiting panels
_HALVINGS = 14  # that find a maximum of F(z)

# ln 2 in pieces; the leading one is so short that its products with the whole
# numbers met here (below 2^12) are exact.
_LN2_1 = float.fromhex("0x1.62e42fefap-1")
_LN2_2 = float.fromhex("0x1.cf79abc9e3b3ap-40")
_WHOLE = 1.5 * 2.0**52  # added to a whole number, leaves it in the low bits
_EXP = tuple(1.0 / math.factorial(i) for i in range(14))


class Geometry(NamedTuple):
    """Water column and receiver geometry; fields in the order of a table row.

    The row has the values in the order of these fields, here and in `_columns`.
    """

    reduced_attenuation: float
    """Reduced one-way attenuation k' = a + b_d [1/m]."""
    spreading: float
    """Factor (2/3) b_f <theta^2> of z^3 in S(z) [1/m]."""
    baseline: float
    """Distance rho_0 between beam and receiver [m]."""
    receiver_radius: float
    """Receiver radius R [m]."""
    acceptance_angle: float
    """Acceptance angle gamma [rad]."""
    tilt: float
    """Beam inclination n_0 along the baseline [rad]."""
    cross_tilt: float
    """Beam inclination n_0 across the baseline [rad]."""
    standoff: float
    """Equivalent water depth zeta - z of air and glass before the water [m]."""
    start: float
    """Depth at which the integral starts [m]."""
    end: float
    """Depth at which the integral ends [m]."""


class Column(NamedTuple):
    """Precomputed terms of the integrand, eq. (46), with zeta = z + standoff.

    S(z) = aperture + acceptance zeta^2 + spreading z^3, and the squared distance of
    beam and receiver axis is closest + slant (z - nearest)^2.
    """

    loss: float
    """Two-way attenuation 2 k' [1/m]."""
    spreading: float
    """Factor (2/3) b_f <theta^2> of z^3 in S(z) [1/m]."""
    aperture: float
    """Squared receiver radius R^2 [m^2]."""
    acceptance: float
    """Squared acceptance angle gamma^2 [1]."""
    slant: float
    """Squared beam inclination |n_0|^2 [1]."""
    nearest: float
    """Depth z of the smallest distance between beam and receiver axis [m]."""
    closest: float
    """Squared smallest distance of the axes [m^2]."""
    standoff: float
    """Equivalent water depth zeta - z of air and glass before the water [m]."""
    start: float
    """Depth at which the integral starts [m]."""
    end: float
    """Depth beyond which the integrand is negligible [m]."""


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _exponential(x: float) -> tuple[float, float]:
    """Return mantissa m and integer exponent n of exp(x) = m 2^n."""
    power = np.floor(x * (1 / math.log(2)) + 0.5)
    r = (x - power * _LN2_1) - power * _LN2_2
    r2 = r * r
    r4 = r2 * r2
    c = _EXP
    low = (1.0 + r + r2 * (c[2] + r * c[3])) + r4 * (
        c[4] + r * c[5] + r2 * (c[6] + r * c[7])
    )
    high = (c[8] + r * c[9] + r2 * (c[10] + r * c[11])) + r4 * (c[12] + r * c[13])
    return low + r4 * r4 * high, power


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _area(z: float, column: Column) -> float:
    """Return the squared width S(z) of beam and receiver, eq. (43) [m^2]."""
    u = z + column.standoff
    return float(
        column.aperture + column.acceptance * u * u + column.spreading * z * z * z
    )


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _offset(z: float, column: Column) -> float:
    """Return the squared distance between beam axis and receiver axis [m^2]."""
    u = z - column.nearest
    return float(column.closest + column.slant * u * u)


@numba.njit(cache=True, error_model="numpy")
def _level(z: float, column: Column) -> float:
    """Return the logarithm of the overlap F(z), without its constant factor."""
    area = _area(z, column)
    return float(-column.loss * z - _offset(z, column) / area - np.log(area))


@numba.njit(cache=True, error_model="numpy")
def _slope(z: float, column: Column) -> float:
    """Return the depth derivative of the logarithm of the overlap F(z) [1/m]."""
    area = _area(z, column)
    growth = (
        2.0 * column.acceptance * (z + column.standoff) + 3.0 * column.spreading * z * z
    ) / area
    turn = 2.0 * column.slant * (z - column.nearest)
    return float(-column.loss - growth - (turn - _offset(z, column) * growth) / area)


@numba.njit(cache=True, error_model="numpy")
def _scale(area: float, column: Column) -> float:
    """Return the depth interval over which the squared width S(z) about doubles [m]."""
    scale = np.sqrt(area / column.acceptance)
    if column.spreading > 0.0:
        scale = min(scale, np.cbrt(area / column.spreading))
    return float(scale)


@numba.njit(cache=True, error_model="numpy")
def _bound(a: float, b: float, column: Column) -> float:
    """Return an upper limit of the exponent of the overlap F(z), from depth a to b."""
    offset = column.closest
    if not a < column.nearest < b:
        offset = min(_offset(a, column), _offset(b, column))
    return float(-column.loss * a - offset / _area(b, column))


@numba.njit(cache=True, error_model="numpy")
def _geometry(row: Array) -> Geometry:
    """Convert a table row to a `Geometry`."""
    return Geometry(
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9]
    )


@numba.njit(cache=True, error_model="numpy")
def _prepare(geometry: Geometry) -> Column:
    """Return the terms of the integrand, ended where the light is negligible."""
    column = Column(
        2.0 * geometry.reduced_attenuation,
        geometry.spreading,
        geometry.receiver_radius**2,
        geometry.acceptance_angle**2,
        geometry.tilt**2 + geometry.cross_tilt**2,
        0.0,
        0.0,
        geometry.standoff,
        geometry.start,
        geometry.end,
    )
    loss, spreading, slant = column.loss, column.spreading, column.slant
    reach = _scale(_area(0.0, column), column) + column.standoff + column.start
    if slant > 1e-200:
        nearest = geometry.baseline * (geometry.tilt / slant) - column.standoff
        closest = (geometry.baseline * geometry.cross_tilt) ** 2 / slant
        reach += abs(nearest)
        if spreading > 0.0:
            reach += slant / spreading
    else:
        slant = 0.0
        nearest = 0.0
        closest = geometry.baseline**2
    # Beyond these depths the rest is below rounding, or below the smallest number.
    end = min(column.end, 1e17 * reach)
    if loss > 0.0:
        end = min(end, 800.0 / loss)
    return Column(
        loss,
        spreading,
        column.aperture,
        column.acceptance,
        slant,
        nearest,
        closest,
        column.standoff,
        column.start,
        end,
    )


@numba.njit(cache=True, error_model="numpy")
def _break_points(column: Column, z_break: Array) -> tuple[int, float, float]:
    """Fill `z_break` with panel edges; return count, and peak depth and width of F(z).

    The count is -1 if the array is too short.
    """
    limit, loss, nearest = column.end, column.loss, column.nearest
    z, before, slope_before = column.start, column.start, -1.0
    peak, width, highest = z, 0.0, -np.inf
    count = 0
    while z <= limit and count < z_break.size - 5:
        area = _area(z, column)
        scale = _scale(area, column)
        slope = _slope(z, column)
        level = _level(z, column)
        if level > highest:
            peak, highest = z, level
            width = min(scale, 1.0 / (abs(slope) + 1e-300))
        if slope_before > 0.0 and slope < 0.0:
            low, high, rise, fall = before, z, slope_before, slope
            for _ in range(_HALVINGS):
                middle = 0.5 * (low + high)
                change = _slope(middle, column)
                if change > 0.0:
                    low, rise = middle, change
                else:
                    high, fall = middle, change
            top = 0.5 * (low + high)
            sigma = np.sqrt((high - low) / (rise - fall))
            level = _level(top, column)
            if level > highest:
                peak, highest, width = top, level, min(2.5 * sigma, scale)
            for factor in (-9.0, -4.0, 4.0, 9.0):
                x = top + factor * sigma
                if x - before > 0.3 * (top - before) and z - x > 0.3 * (z - top):
                    z_break[count] = x
                    count += 1
        z_break[count] = z
        count += 1
        # All that follows is at most this: the offset left out, S and depth growing.
        remainder = np.log(min(1.6 * scale, 1.0 / (loss + 1e-300)) / area) - loss * z
        if z >= limit or loss * z > 745.0 or remainder < highest + np.log(width) - 40.0:
            break
        step = scale
        if loss > 0.0:
            step = min(step, 30.0 / loss)
        before, slope_before = z, slope
        z += step
        # A beam that crosses the axis quickly is not stepped over.
        narrow = _area(nearest, column) < 0.25 * column.slant * step * step
        if before < nearest <= z and narrow:
            z = nearest
        if z > limit - 0.1 * step:
            z = limit
    if count >= z_break.size - 5:
        return -1, peak, width
    above = min(width, limit - peak)
    while _level(peak + above, column) < highest - 1.0:
        above *= 0.5
    below = min(width, peak - column.start)
    while _level(peak - below, column) < highest - 1.0:
        below *= 0.5
    return count, peak, below + above


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _sample(
    centre: float,
    half: float,
    peak: float,
    column: Column,
    rule: Array,
    work: Array,
    bits: NDArray[np.int64],
) -> None:
    """Fill `work` with even and odd part of F(z) in a panel, relative to peak F(z)."""
    loss, spreading, slant = column.loss, column.spreading, column.slant
    aperture, acceptance = column.aperture, column.acceptance
    closest, standoff = column.closest, column.standoff
    area_peak = _area(peak, column)
    tilted = _offset(peak, column) / area_peak
    from_peak, from_nearest = centre - peak, centre - column.nearest
    for side in range(2):
        for i in range(ORDER):
            x = half * rule[4, side, i]
            z = centre + x
            u = z + standoff
            area = aperture + acceptance * u * u + spreading * z * z * z
            d = from_nearest + x
            exponent = (
                tilted - (closest + slant * d * d) / area - loss * (from_peak + x)
            )
            value, power = _exponential(min(max(exponent, -708.0), 700.0))
            work[2, i] = value * (area_peak / area)
            work[3, i] = power + _WHOLE
        for i in range(ORDER):
            bits[3, i] = (bits[3, i] + 1023) << 52
        for i in range(ORDER):
            work[side, i] = work[2, i] * work[3, i]
    for i in range(ORDER):
        right, left = work[0, i], work[1, i]
        work[0, i] = right + left
        work[1, i] = right - left


@numba.njit(cache=True, error_model="numpy")
def _unresolved(
    a: float, b: float, peak: float, column: Column, rule: Array, work: Array
) -> float:
    """Return the interpolation error of F(z) in a panel, relative to peak F(z)."""
    n = ORDER - 1
    error = abs(work[4, n]) + abs(work[5, n])
    error += 0.25 * (abs(work[4, n - 1]) + abs(work[5, n - 1]))
    even = odd = 0.0
    for i in range(ORDER):
        even += work[0, i] * rule[4, 2, i]
        odd += work[1, i] * rule[4, 3, i]
    top = _level(peak, column)
    at_a = abs(even - odd - np.exp(_level(a, column) - top))
    at_b = abs(even + odd - np.exp(_level(b, column) - top))
    # The ends lie outside the nodes, where the polynomials miss by much more.
    return float(max(error, max(at_a, at_b) / 30.0))


@numba.njit(cache=True, error_model="numpy")
def _add_column(
    column: Column,
    phase_per_depth: Array,
    rule: Array,
    work: Array,
    turn: Array,
    sums: Array,
) -> float:
    """Add depth integrals of exp(i w z) times the overlap, relative to its peak value.

    Return max F over pi R^2 gamma^2, or NaN if the integral cannot be resolved.
    """
    z_break = np.empty(_CAPACITY)
    waiting = np.empty((_CAPACITY, 2))
    bits = work.view(np.int64)
    count, peak, width = _break_points(column, z_break)
    if count < 0:
        return np.nan
    if count < 2:
        return 0.0
    top = _level(peak, column)
    dip = _offset(peak, column) / _area(peak, column)
    if -column.loss * peak - dip < _DARK:
        return 0.0
    rounding = _ROUNDING * (1.0 + 0.1 * dip)
    for j in range(count - 1):
        waiting[0, 0], waiting[0, 1] = z_break[j], z_break[j + 1]
        pending = 1
        while pending > 0:
            pending -= 1
            a, b = waiting[pending, 0], waiting[pending, 1]
            half = 0.5 * (b - a)
            centre = a + half
            most = np.exp(_bound(a, b, column) - np.log(_area(a, column)) - top)
            if most * (b - a) < _NEGLIGIBLE * width:
                continue
            _sample(centre, half, peak, column, rule, work, bits)
            expand(work[0], rule[0], work[4])
            expand(work[1], rule[1], work[5])
            largest = 0.0
            for i in range(ORDER):
                largest = max(largest, work[0, i])
            if largest > 1e9:
                return np.nan  # a maximum was missed, and with it the scale
            allowed = max(_UNRESOLVED * width / half, rounding * largest)
            if not _unresolved(a, b, peak, column, rule, work) <= allowed:
                if pending + 2 > _CAPACITY or half < 1e-12 * centre:
                    return np.nan
                waiting[pending, 0], waiting[pending, 1] = centre, b
                waiting[pending + 1, 0], waiting[pending + 1, 1] = a, centre
                pending += 2
                continue
            panel = Panel(half, centre, work[0], work[1])
            add_panel(panel, phase_per_depth, rule, work[4:], turn, sums)
    return float(np.exp(top))


@numba.njit(cache=True, error_model="numpy")
def water_column(
    geometry: Array, phase_per_depth: Array, rule: Array, out: NDArray[np.complex128]
) -> int:
    """Fill `out` with depth integrals of exp(i w z) times F(z) / (pi R^2 gamma^2).

    A row of geometry holds the fields of `Geometry` in their order; phase_per_depth,
    w = 2 omega n_g / c [rad/m], has one row for all of them or one for each. Returns
    how many could not be resolved, or -1 if there is a row of w that falls.

    Eq. (46) without its constant factor, docs/theory/water-signal.md: F(z) is written
    as Legendre series in panels, each integrated with exp(i w z) in closed form.
    Compiled, as panels are halved one by one where F(z) requires it, and a scan or
    a design has thousands of columns.
    """
    size = phase_per_depth.shape[1]
    for g in range(phase_per_depth.shape[0]):
        for f in range(1, size):
            if phase_per_depth[g, f] < phase_per_depth[g, f - 1]:
                return -1
    sums = np.empty((2, size))
    turn = np.empty((2, size))
    work = np.empty((6, ORDER))
    unresolved = 0
    for g in range(geometry.shape[0]):
        for f in range(size):
            sums[0, f] = sums[1, f] = 0.0
        rising = phase_per_depth[min(g, phase_per_depth.shape[0] - 1)]
        column = _prepare(_geometry(geometry[g]))
        factor = _add_column(column, rising, rule, work, turn, sums)
        for f in range(size):
            out[g, f] = complex(factor * sums[0, f], factor * sums[1, f])
        if math.isnan(factor):
            unresolved += 1
    return unresolved
