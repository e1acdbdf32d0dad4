"""Compiled loops of the small-angle model for a sharp aperture and field of view.

The integral over the spatial frequency kappa is eq. (29) of Ricci et al. 2010, as
rederived. Radius R and acceptance angle gamma are those of the receiver. A wave is a
Bessel function of large argument; the other factors are smooth. A panel is an interval
of kappa with quadrature nodes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba
from amulor.optics._quadrature import NO_WAVE, j0, polynomial
from amulor.optics.small_angle import _kernels

__all__ = ["Tables", "Water", "collected"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = tuple[bool, bool, bool]  # which of the three Bessel functions is a wave

NODES = 16  # of a panel of spatial frequencies
_NO_WAVE = float(NO_WAVE)  # argument up to which a Bessel function is no wave
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


class Water(NamedTuple):
    """Optical properties of the water, with beam and receiver size."""

    loss: float
    """Two-way attenuation 2 k', forward scattering excluded [1/m]."""
    forward: float
    """Two-way forward scattering 2 b_f [1/m]."""
    split_angle: float
    """Split angle, the end of the forward part of the phase function [rad]."""
    receiver_radius: float
    """Receiver radius R [m]."""
    acceptance_angle: float
    """Acceptance angle gamma [rad]."""
    beam_radius_squared: float
    """Squared beam radius w^2 [m^2]."""
    beam_divergence_squared: float
    """Squared beam divergence delta^2 [1]."""


class Tables(NamedTuple):
    """Precomputed functions and quadrature rules for the compiled loops."""

    lost: Array
    """1 minus the mean transform of the phase function, from `_columns.table`."""
    bessel: Array
    """Bessel function J0, from `_quadrature.bessel`."""
    disc: Array
    """Disc transform 2 J1(x) / x, from `_columns.disc`."""
    rule: Array
    """Nodes and weights on -1..1, in two rows."""
    series: Array
    """Matrix from node values to Legendre coefficients."""


class _Place(NamedTuple):
    """Parameters of the spatial-frequency integral, eq. (29), at one depth."""

    depth: float
    """Depth z [m]."""
    thickness: float
    """Optical thickness of two-way forward scattering, 2 b_f z [1]."""
    unscattered: float
    """Unscattered fraction exp(-2 b_f z) if it is subtracted, else 0 [1]."""
    beam: float
    """Squared beam radius at the depth, w^2 + delta^2 zeta^2 [m^2]."""
    split_angle: float
    """Split angle, the end of the forward part of the phase function [rad]."""
    reach: float
    """Oscillation rate due to the phase function's cut: z times the split angle [m]."""
    radius: tuple[float, float, float]
    """Arguments of J0 and of the two disc transforms, over kappa [m]."""


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _wave_0(x: float) -> complex:
    """Return the slow amplitude h of J0(x) = Re h exp(i x), for x above 26."""
    y = 1.0 / (x * x)
    p = 1.0 - y * (9 / 128 - y * (3675 / 32768 - y * (2401245 / 4194304)))
    q = 1 / 8 - y * (75 / 1024 - y * (59535 / 262144 - y * (57972915 / 33554432)))
    return complex(p - q / x, -p - q / x) * math.sqrt(1.0 / (math.pi * x))


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _wave_1(x: float) -> complex:
    """Return the slow amplitude h of 2 J1(x) / x = Re h exp(i x), for x above 26."""
    y = 1.0 / (x * x)
    p = 1.0 + y * (15 / 128 - y * (4725 / 32768 - y * (2837835 / 4194304)))
    q = 3 / 8 - y * (105 / 1024 - y * (72765 / 262144 - y * (66891825 / 33554432)))
    return complex(q / x - p, -p - q / x) * (2.0 / x * math.sqrt(1.0 / (math.pi * x)))


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _disc(x: float, table: Array) -> float:
    """Return the disc transform 2 J1(x) / x for x >= 0."""
    if x < _NO_WAVE:
        cell = int(x)
        return float(polynomial(table, cell, 2.0 * (x - cell) - 1.0))
    wave = _wave_1(x)
    return float(wave.real * math.cos(x) - wave.imag * math.sin(x))


@numba.njit(cache=True, error_model="numpy")
def _turned(
    half: float, centre: float, rate: float, value: Complex, rule: Array, series: Array
) -> float:
    """Integrate Re[value exp(i rate kappa)] over spatial frequency kappa in a panel."""
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
def _scattering_end(place: _Place, table: Array) -> float:
    """Return the spatial frequency above which scattered light is negligible [1/m]."""
    depth, thickness, split_angle = place.depth, place.thickness, place.split_angle
    if thickness <= _SCATTERED_END:
        return math.inf
    top: float = 1e-6 / (depth * split_angle)
    while thickness * _kernels.lost(top * depth, split_angle, table) < _SCATTERED_END:
        top *= 1.25
        if top * depth * split_angle > 1e12:
            return math.inf
    return top


@numba.njit(cache=True, error_model="numpy")
def _envelope(kappa: float, radius: tuple[float, float, float]) -> float:
    """Estimate the envelope of the product of the Bessel functions in eq. (29)."""
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
def _place(look: Array, water: Water) -> _Place:
    """Return the parameters of eq. (29) for a row of depth and receiver geometry."""
    z = look[0]
    path = z + look[4]
    offset = math.hypot(look[1] - look[2] * path, look[3] * path)
    radius = (offset, water.receiver_radius, water.acceptance_angle * path)
    beam = water.beam_radius_squared + water.beam_divergence_squared * path * path
    thickness = water.forward * z
    unscattered = math.exp(-thickness) if beam == 0.0 else 0.0
    reach = z * water.split_angle
    return _Place(z, thickness, unscattered, beam, water.split_angle, reach, radius)


@numba.njit(cache=True, error_model="numpy")
def _slowest(radius: tuple[float, float, float]) -> float:
    """Return the lowest oscillation rate of the product of the Bessel functions [m]."""
    slowest = math.inf
    for j in range(4):
        side = radius[1] if j % 2 == 0 else -radius[1]
        third = radius[2] if j < 2 else -radius[2]
        slowest = min(slowest, abs(radius[0] + side + third))
    return slowest


@numba.njit(cache=True, error_model="numpy")
def _widest_turn(low: float, place: _Place, wave: Flags) -> tuple[float, float]:
    """Return oscillation rate of the smooth factors [m], and largest phase [rad]."""
    turn = place.reach if low * place.reach < _SPLIT_END else 0.0
    waves = 0
    for j in range(3):
        if wave[j]:
            waves += 1
        else:
            turn += place.radius[j]
    return turn, _SERIES_PHASE if waves > 0 else _PHASE


@numba.njit(cache=True, error_model="numpy")
def _plain_factors(
    panel: tuple[float, float],
    place: _Place,
    wave: Flags,
    rule: Array,
    lost: Array,
    bessel: Array,
    disc: Array,
    value: Complex,
) -> float:
    """Fill `value[0]` with the smooth factors; return the last, Bessel terms excluded.

    Tables are separate arguments, as access to an array in a tuple costs a reference
    count.
    """
    half, centre = panel
    last = 0.0
    for i in range(NODES):
        kappa = centre + half * rule[0, i]
        spread = _kernels.lost(kappa * place.depth, place.split_angle, lost)
        last = math.exp(-place.thickness * spread)
        beam = math.exp(-0.25 * place.beam * kappa * kappa)
        last = kappa * beam * (last - place.unscattered)
        factor = last
        if not wave[0]:
            factor *= j0(kappa * place.radius[0], bessel)
        if not wave[1]:
            factor *= _disc(kappa * place.radius[1], disc)
        if not wave[2]:
            factor *= _disc(kappa * place.radius[2], disc)
        value[0, i] = factor
    return last


@numba.njit(cache=True, error_model="numpy")
def _multiply_waves(
    half: float,
    centre: float,
    place: _Place,
    wave: Flags,
    rule: Array,
    rate: Array,
    value: Complex,
) -> int:
    """Multiply `value[0]` by the oscillating factors; return the number of products.

    The real part of the product of two waves is half that of their product and half
    that of the product of one and the conjugate of the other. rate is how fast the
    phase of each product turns with kappa.
    """
    count = 0
    rate[0] = 0.0
    for j in range(3):
        if not wave[j]:
            continue
        radius = place.radius[j]
        for i in range(NODES):
            x = (centre + half * rule[0, i]) * radius
            h = _wave_0(x) if j == 0 else _wave_1(x)
            if count == 0:
                value[0, i] *= h
                continue
            h *= 0.5
            for p in range(count):
                value[count + p, i] = value[p, i] * h.conjugate()
                value[p, i] *= h
        if count == 0:
            rate[0] = radius
            count = 1
            continue
        for p in range(count):
            rate[count + p] = rate[p] - radius
            rate[p] += radius
        count *= 2
    return max(count, 1)


@numba.njit(cache=True, error_model="numpy")
def _transformed(place: _Place, tables: Tables, rate: Array, value: Complex) -> float:
    """Integrate the factors of eq. (29) over the spatial frequency kappa [1/m^2]."""
    radius, beam = place.radius, place.beam
    rule, series, lost = tables.rule, tables.series, tables.lost
    bessel, disc = tables.bessel, tables.disc
    top = _scattering_end(place, lost)
    if beam > 0.0:
        top = min(top, _GAUSSIAN_END / math.sqrt(beam))
    slowest = _slowest(radius)
    on_axis = 2.0 / max(radius[1], radius[2]) ** 2
    narrowest = min(top / 3.0, 6.0 / (radius[0] + radius[1] + radius[2] + place.reach))
    widest = top / 2.0
    if beam > 0.0:
        widest = min(widest, _SMOOTH / math.sqrt(beam))
    total = 0.0
    low = 0.0
    size = 0.0
    for _ in range(_PANELS):
        wave = (
            low * radius[0] >= _NO_WAVE,
            low * radius[1] >= _NO_WAVE,
            low * radius[2] >= _NO_WAVE,
        )
        turn, most = _widest_turn(low, place, wave)
        width = min(max(narrowest, low), widest)
        if width * turn > most:
            width = most / turn
        if low + 1.2 * width > top:
            width = top - low
        half = 0.5 * width
        centre = low + half
        panel = (half, centre)
        last = _plain_factors(panel, place, wave, rule, lost, bessel, disc, value)
        count = _multiply_waves(half, centre, place, wave, rule, rate, value)
        for p in range(count):
            total += _turned(half, centre, rate[p], value[p], rule, series)
        low += width
        if low >= top:
            break
        # What is left shrinks at least as fast as the spatial frequency grows.
        before, size = size, abs(last) * _envelope(low, radius)
        remainder = size * min(low, 1.0 / slowest if slowest > 0.0 else math.inf)
        if size <= before and remainder < max(_TAIL * abs(total), _ROUNDING * on_axis):
            break
    return total


@numba.njit(cache=True, error_model="numpy")
def collected(look: Array, water: Water, tables: Tables, out: Array) -> None:
    """Fill `out` with the scaled overlap, without unscattered light of a thin beam.

    A row of look is depth, baseline, tilt, cross tilt and standoff. Eq. (29)
    with the transform of two uniform discs, docs/theory/water-signal.md.
    Between two spatial frequencies kappa a Bessel function is either a plain factor
    or, far out, two waves with smooth factors; waves that turn fast are integrated by
    the Legendre series of their factors. Compiled, as the width of each panel follows
    from where the one before ended, for every depth anew.
    """
    rate = np.empty(4)
    value = np.empty((4, NODES), dtype=np.complex128)
    for n in range(look.shape[0]):
        place = _place(look[n], water)
        if place.thickness == 0.0 and place.beam == 0.0:
            out[n] = 0.0
            continue
        total = _transformed(place, tables, rate, value)
        out[n] = 0.5 * total * math.exp(-water.loss * place.depth)
