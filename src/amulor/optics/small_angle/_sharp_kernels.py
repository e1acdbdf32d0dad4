"""Compiled loops of the small-angle model for a receiver with sharp edges."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from amulor.optics.small_angle import _kernels

__all__ = ["collected"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

NODES = 16  # of a panel of wavenumbers
_NEAR = float(_kernels.NEAR)  # argument up to which a Bessel function is no wave
_GAUSSIAN_END = 10.0  # in 1/e half-widths: exp(-25) is left beyond
_SCATTERED_END = 25.0  # exponent by which scattering ends the integral
_PHASE = 24.0  # turn over a panel that its nodes integrate [rad]
_SERIES_PHASE = 7.0  # turn over a panel that its Legendre series follows [rad]
_DIRECT = 8.0  # turn over half a panel up to which its nodes serve [rad]
_SMOOTH = 5.0  # width of a panel in 1/e half-widths of the beam
_SPLIT_END = 300.0  # phase up to which the edge of the forward part is followed [rad]
_TAIL = 1e-10  # of the integral that may be cut off
_ROUNDING = 1e-14  # of the light on the axis that may be cut off
_PANELS = 4000  # after which an integral counts as cut off

# A row of water holds, in this order: 2 k' [1/m], 2 b_f [1/m], baseline [m], tilt,
# cross tilt [rad], standoff [m], split angle [rad], receiver radius [m], acceptance
# [rad], squared 1/e radius [m^2] and semi-angle of the beam [1].


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _wave_0(x: float) -> complex:
    """Return h of J0(x) = Re h exp(i x), for x above 26."""
    y = 1.0 / (x * x)
    p = 1.0 - y * (9 / 128 - y * (3675 / 32768 - y * (2401245 / 4194304)))
    q = 1 / 8 - y * (75 / 1024 - y * (59535 / 262144 - y * (57972915 / 33554432)))
    return complex(p - q / x, -p - q / x) * math.sqrt(1.0 / (math.pi * x))


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _wave_1(x: float) -> complex:
    """Return h of 2 J1(x) / x = Re h exp(i x), for x above 26."""
    y = 1.0 / (x * x)
    p = 1.0 + y * (15 / 128 - y * (4725 / 32768 - y * (2837835 / 4194304)))
    q = 3 / 8 - y * (105 / 1024 - y * (72765 / 262144 - y * (66891825 / 33554432)))
    return complex(q / x - p, -p - q / x) * (2.0 / x * math.sqrt(1.0 / (math.pi * x)))


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _disc(x: float, table: Array) -> float:
    """Return the transform 2 J1(x) / x of a disc at x >= 0."""
    if x < _NEAR:
        cell = int(x)
        return float(_kernels.polynomial(table, cell, 2.0 * (x - cell) - 1.0))
    wave = _wave_1(x)
    return float(wave.real * math.cos(x) - wave.imag * math.sin(x))


@numba.njit(cache=True, error_model="numpy")
def _turned(
    half: float, centre: float, rate: float, value: Complex, rule: Array, series: Array
) -> float:
    """Return the integral over a panel of Re value * exp(i rate kappa).

    A row of rule holds nodes or weights on -1..1, series what gives the Legendre
    terms from the values at the nodes.
    """
    turn = rate * half
    total = 0.0
    if abs(turn) < _DIRECT:
        for i in range(NODES):
            phase = rate * (centre + half * rule[0, i])
            wave = value[i].real * math.cos(phase) - value[i].imag * math.sin(phase)
            total += rule[1, i] * wave
        return float(half * total)
    # 2 i^m j_m(turn) is the integral of P_m(s) exp(i turn s).
    before = math.sin(turn) / turn
    now = (before - math.cos(turn)) / turn
    result = 0.0 + 0.0j
    factor = 1.0 + 0.0j
    for m in range(NODES):
        term = 0.0 + 0.0j
        for i in range(NODES):
            term += series[m, i] * value[i]
        result += factor * before * term
        factor *= 1.0j
        before, now = now, (2 * m + 3) / turn * now - before
    phase = rate * centre
    return float(
        2.0 * half * (result.real * math.cos(phase) - result.imag * math.sin(phase))
    )


@numba.njit(cache=True, error_model="numpy")
def _scattering_end(depth: float, row: Array, table: Array) -> float:
    """Return the wavenumber at which scattering has ended the integral."""
    thickness = row[1] * depth
    if thickness <= _SCATTERED_END:
        return math.inf
    top: float = 1e-6 / (depth * row[6])
    while thickness * _kernels.lost(top * depth, row[6], table) < _SCATTERED_END:
        top *= 1.25
        if top * depth * row[6] > 1e12:
            return math.inf
    return top


@numba.njit(cache=True, error_model="numpy")
def _envelope(kappa: float, radius: Array) -> float:
    """Return about the most that the product of the three Bessel functions can be."""
    bound: float = 1.0
    x: float = kappa * radius[0]
    if x > 0.64:
        bound = 0.8 / math.sqrt(x)
    for j in range(1, 3):
        x = kappa * radius[j]
        if x > 1.37:
            bound *= 1.6 / (x * math.sqrt(x))
    return bound


@numba.njit(cache=True, error_model="numpy")
def collected(
    depth: Array,
    row: Array,
    table: Array,
    bessel: Array,
    disc: Array,
    rule: Array,
    series: Array,
    out: Array,
) -> None:
    """Fill out with F(z) / pi R^2 gamma^2, less the unscattered light of a thin beam.

    Between two wavenumbers a Bessel function is either a plain factor or, far out,
    two waves with smooth factors; waves that turn fast are integrated by the
    Legendre series of their factors.
    """
    radius = np.empty(3)
    rate = np.empty(4)
    value = np.empty((4, NODES), dtype=np.complex128)
    wave = np.empty(3, dtype=np.bool_)
    for n in range(depth.size):
        z = depth[n]
        path = z + row[5]
        radius[0] = math.hypot(row[2] - row[3] * path, row[4] * path)
        radius[1], radius[2] = row[7], row[8] * path
        beam = row[9] + row[10] * path * path
        thickness = row[1] * z
        if thickness == 0.0 and beam == 0.0:
            out[n] = 0.0
            continue
        none = math.exp(-thickness) if beam == 0.0 else 0.0
        reach = z * row[6]
        top = _scattering_end(z, row, table)
        if beam > 0.0:
            top = min(top, _GAUSSIAN_END / math.sqrt(beam))
        slowest = math.inf
        for j in range(4):
            side = radius[1] if j % 2 == 0 else -radius[1]
            other = radius[2] if j < 2 else -radius[2]
            slowest = min(slowest, abs(radius[0] + side + other))
        on_axis = 2.0 / max(radius[1], radius[2]) ** 2
        first = min(top / 3.0, 6.0 / (radius[0] + radius[1] + radius[2] + reach))
        widest = top / 2.0
        if beam > 0.0:
            widest = min(widest, _SMOOTH / math.sqrt(beam))
        total = 0.0
        low = 0.0
        size = 0.0
        for _ in range(_PANELS):
            turn = reach if low * reach < _SPLIT_END else 0.0
            waves = 0
            for j in range(3):
                wave[j] = low * radius[j] >= _NEAR
                if wave[j]:
                    waves += 1
                else:
                    turn += radius[j]
            width = min(max(first, low), widest)
            most = _SERIES_PHASE if waves > 0 else _PHASE
            if width * turn > most:
                width = most / turn
            if low + 1.2 * width > top:
                width = top - low
            half = 0.5 * width
            centre = low + half
            count = 1
            rate[0] = 0.0
            last = 0.0
            for i in range(NODES):
                kappa = centre + half * rule[0, i]
                last = math.exp(-thickness * _kernels.lost(kappa * z, row[6], table))
                last = kappa * math.exp(-0.25 * beam * kappa * kappa) * (last - none)
                factor = last
                if not wave[0]:
                    factor *= _kernels.j0(kappa * radius[0], bessel)
                for j in range(1, 3):
                    if not wave[j]:
                        factor *= _disc(kappa * radius[j], disc)
                value[0, i] = factor
            found = 0
            for j in range(3):
                if not wave[j]:
                    continue
                found += 1
                for i in range(NODES):
                    x = (centre + half * rule[0, i]) * radius[j]
                    h = _wave_0(x) if j == 0 else _wave_1(x)
                    if found == 1:
                        value[0, i] *= h
                        continue
                    h *= 0.5
                    for p in range(count):
                        value[count + p, i] = value[p, i] * h.conjugate()
                        value[p, i] *= h
                if found == 1:
                    rate[0] = radius[j]
                    continue
                for p in range(count):
                    rate[count + p] = rate[p] - radius[j]
                    rate[p] += radius[j]
                count *= 2
            for p in range(count):
                total += _turned(half, centre, rate[p], value[p], rule, series)
            low += width
            if low >= top:
                break
            # What is left shrinks at least as fast as the wavenumber grows.
            before, size = size, abs(last) * _envelope(low, radius)
            rest = size * min(low, 1.0 / slowest if slowest > 0.0 else math.inf)
            if size <= before and rest < max(_TAIL * abs(total), _ROUNDING * on_axis):
                break
        out[n] = 0.5 * total * math.exp(-row[0] * z)
