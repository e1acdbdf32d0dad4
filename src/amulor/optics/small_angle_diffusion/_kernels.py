"""Compiled loops of the water signal in diffusion form, and nothing else."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from amulor.optics._quadrature.kernels import ORDER, add_panel, expand

__all__ = ["water_column"]

Array = NDArray[np.float64]

_UNRESOLVED = 3e-14  # of the whole integral: what a panel may leave unresolved
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

# A row of water holds, in this order: 2 k' [1/m], (2/3) b_f <theta^2> [1/m], radius
# squared [m^2], acceptance squared [1], tilt squared [1], depth where beam and axis
# are nearest [m], their distance there squared [m^2], standoff, start, limit [m].


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _exponential(x: float) -> tuple[float, float]:
    """Return m and the whole number n of exp(x) = m 2^n."""
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
def _area(z: float, row: Array) -> float:
    """Return S(z) of eq. (43)."""
    u = z + row[7]
    return float(row[2] + row[3] * u * u + row[1] * z * z * z)


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _offset(z: float, row: Array) -> float:
    """Return the squared distance between beam and receiver axis."""
    u = z - row[5]
    return float(row[6] + row[4] * u * u)


@numba.njit(cache=True, error_model="numpy")
def _level(z: float, row: Array) -> float:
    """Return the logarithm of F(z), without its constant factor."""
    area = _area(z, row)
    return float(-row[0] * z - _offset(z, row) / area - np.log(area))


@numba.njit(cache=True, error_model="numpy")
def _slope(z: float, row: Array) -> float:
    """Return the derivative of the logarithm of F(z)."""
    area = _area(z, row)
    growth = (2.0 * row[3] * (z + row[7]) + 3.0 * row[1] * z * z) / area
    turn = 2.0 * row[4] * (z - row[5])
    return float(-row[0] - growth - (turn - _offset(z, row) * growth) / area)


@numba.njit(cache=True, error_model="numpy")
def _scale(area: float, row: Array) -> float:
    """Return about the distance over which S(z) doubles."""
    scale = np.sqrt(area / row[3])
    if row[1] > 0.0:
        scale = min(scale, np.cbrt(area / row[1]))
    return float(scale)


@numba.njit(cache=True, error_model="numpy")
def _bound(a: float, b: float, row: Array) -> float:
    """Return the most that the exponent of F(z) can be between a and b."""
    offset = row[6]
    if not a < row[5] < b:
        offset = min(_offset(a, row), _offset(b, row))
    return float(-row[0] * a - offset / _area(b, row))


@numba.njit(cache=True, error_model="numpy")
def _prepare(geometry: Array, row: Array) -> None:
    """Fill a row of water from a row of k', spread and the lengths and angles."""
    row[0] = 2.0 * geometry[0]
    row[1] = geometry[1]
    row[2] = geometry[3] ** 2
    row[3] = geometry[4] ** 2
    row[4] = geometry[5] ** 2 + geometry[6] ** 2
    row[7] = geometry[7]
    row[8] = geometry[8]
    reach = _scale(_area(0.0, row), row) + row[7] + row[8]
    if row[4] > 1e-200:
        row[5] = geometry[2] * (geometry[5] / row[4]) - row[7]
        row[6] = (geometry[2] * geometry[6]) ** 2 / row[4]
        reach += abs(row[5])
        if row[1] > 0.0:
            reach += row[4] / row[1]
    else:
        row[4] = 0.0
        row[5] = 0.0
        row[6] = geometry[2] ** 2
    # Beyond these depths the rest is below rounding, or below the smallest number.
    row[9] = min(geometry[9], 1e17 * reach)
    if row[0] > 0.0:
        row[9] = min(row[9], 800.0 / row[0])


@numba.njit(cache=True, error_model="numpy")
def _break_points(row: Array, z_break: Array) -> tuple[int, float, float]:
    """Fill z_break; return how many, where F(z) is largest and about how broad.

    Return -1 for how many if there is no room for them.
    """
    limit = row[9]
    z, before, slope_before = row[8], row[8], -1.0
    peak, width, highest = z, 0.0, -np.inf
    count = 0
    while z <= limit and count < z_break.size - 5:
        area = _area(z, row)
        scale = _scale(area, row)
        slope = _slope(z, row)
        level = _level(z, row)
        if level > highest:
            peak, highest = z, level
            width = min(scale, 1.0 / (abs(slope) + 1e-300))
        if slope_before > 0.0 and slope < 0.0:
            low, high, rise, fall = before, z, slope_before, slope
            for _ in range(_HALVINGS):
                middle = 0.5 * (low + high)
                change = _slope(middle, row)
                if change > 0.0:
                    low, rise = middle, change
                else:
                    high, fall = middle, change
            top = 0.5 * (low + high)
            sigma = np.sqrt((high - low) / (rise - fall))
            level = _level(top, row)
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
        rest = np.log(min(1.6 * scale, 1.0 / (row[0] + 1e-300)) / area) - row[0] * z
        if z >= limit or row[0] * z > 745.0 or rest < highest + np.log(width) - 40.0:
            break
        step = scale
        if row[0] > 0.0:
            step = min(step, 30.0 / row[0])
        before, slope_before = z, slope
        z += step
        nearest = row[5]
        if before < nearest <= z and _area(nearest, row) < 0.25 * row[4] * step * step:
            z = nearest
        if z > limit - 0.1 * step:
            z = limit
    if count >= z_break.size - 5:
        return -1, peak, width
    above = min(width, limit - peak)
    while _level(peak + above, row) < highest - 1.0:
        above *= 0.5
    below = min(width, peak - row[8])
    while _level(peak - below, row) < highest - 1.0:
        below *= 0.5
    return count, peak, below + above


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _sample(
    centre: float,
    half: float,
    peak: float,
    row: Array,
    rule: Array,
    work: Array,
    bits: NDArray[np.int64],
) -> None:
    """Fill work[0], work[1] with the even and odd part of F(z) over its peak."""
    rate, spread, radius, acceptance = row[0], row[1], row[2], row[3]
    turn, least, standoff = row[4], row[6], row[7]
    area_peak = _area(peak, row)
    tilted = _offset(peak, row) / area_peak
    from_peak, from_nearest = centre - peak, centre - row[5]
    for side in range(2):
        for i in range(ORDER):
            x = half * rule[4, side, i]
            z = centre + x
            u = z + standoff
            area = radius + acceptance * u * u + spread * z * z * z
            d = from_nearest + x
            exponent = tilted - (least + turn * d * d) / area - rate * (from_peak + x)
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
    a: float, b: float, peak: float, row: Array, rule: Array, work: Array
) -> float:
    """Return how far the polynomials in work[4:6] miss F(z) between a and b."""
    n = ORDER - 1
    rest = abs(work[4, n]) + abs(work[5, n])
    rest += 0.25 * (abs(work[4, n - 1]) + abs(work[5, n - 1]))
    even = odd = 0.0
    for i in range(ORDER):
        even += work[0, i] * rule[4, 2, i]
        odd += work[1, i] * rule[4, 3, i]
    top = _level(peak, row)
    at_a = abs(even - odd - np.exp(_level(a, row) - top))
    at_b = abs(even + odd - np.exp(_level(b, row) - top))
    # The ends lie outside the nodes, where the polynomials miss by much more.
    return float(max(rest, max(at_a, at_b) / 30.0))


@numba.njit(cache=True, error_model="numpy")
def _add_column(
    row: Array, wavenumber: Array, rule: Array, work: Array, turn: Array, sums: Array
) -> float:
    """Add the integral of exp(i w z) F(z) / max F to sums, for rising w.

    Return max F over pi R^2 gamma^2, or NaN if the integral cannot be resolved.
    """
    z_break = np.empty(_CAPACITY)
    waiting = np.empty((_CAPACITY, 2))
    bits = work.view(np.int64)
    count, peak, width = _break_points(row, z_break)
    if count < 0:
        return np.nan
    if count < 2:
        return 0.0
    top = _level(peak, row)
    dip = _offset(peak, row) / _area(peak, row)
    if -row[0] * peak - dip < _DARK:
        return 0.0
    rounding = _ROUNDING * (1.0 + 0.1 * dip)
    for j in range(count - 1):
        waiting[0, 0], waiting[0, 1] = z_break[j], z_break[j + 1]
        left = 1
        while left > 0:
            left -= 1
            a, b = waiting[left, 0], waiting[left, 1]
            half = 0.5 * (b - a)
            centre = a + half
            most = np.exp(_bound(a, b, row) - np.log(_area(a, row)) - top)
            if most * (b - a) < _NEGLIGIBLE * width:
                continue
            _sample(centre, half, peak, row, rule, work, bits)
            expand(work[0], rule[0], work[4])
            expand(work[1], rule[1], work[5])
            largest = 0.0
            for i in range(ORDER):
                largest = max(largest, work[0, i])
            if largest > 1e9:
                return np.nan  # a maximum was missed, and with it the scale
            allowed = max(_UNRESOLVED * width / half, rounding * largest)
            if not _unresolved(a, b, peak, row, rule, work) <= allowed:
                if left + 2 > _CAPACITY or half < 1e-12 * centre:
                    return np.nan
                waiting[left, 0], waiting[left, 1] = centre, b
                waiting[left + 1, 0], waiting[left + 1, 1] = a, centre
                left += 2
                continue
            add_panel(
                half,
                centre,
                work[0],
                work[1],
                wavenumber,
                rule,
                work[4:],
                turn,
                sums,
            )
    return float(np.exp(top))


@numba.njit(cache=True, error_model="numpy")
def water_column(
    geometry: Array, wavenumber: Array, rule: Array, out: NDArray[np.complex128]
) -> int:
    """Fill out[g, f] with the integral of exp(i w z) F(z) / (pi R^2 gamma^2).

    A row of geometry holds k', (2/3) b_f <theta^2>, baseline, radius, acceptance,
    tilt, cross tilt, standoff, start and end; wavenumber has one row for all of
    them or one for each. Returns how many could not be resolved, or -1 if there is
    a row of wavenumbers that falls.
    """
    size = wavenumber.shape[1]
    for g in range(wavenumber.shape[0]):
        for f in range(1, size):
            if wavenumber[g, f] < wavenumber[g, f - 1]:
                return -1
    sums = np.empty((2, size))
    turn = np.empty((2, size))
    work = np.empty((6, ORDER))
    row = np.empty(10)
    unresolved = 0
    for g in range(geometry.shape[0]):
        for f in range(size):
            sums[0, f] = sums[1, f] = 0.0
        rising = wavenumber[min(g, wavenumber.shape[0] - 1)]
        _prepare(geometry[g], row)
        factor = _add_column(row, rising, rule, work, turn, sums)
        for f in range(size):
            out[g, f] = complex(factor * sums[0, f], factor * sums[1, f])
        if math.isnan(factor):
            unresolved += 1
    return unresolved
