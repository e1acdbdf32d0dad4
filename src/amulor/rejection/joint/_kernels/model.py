"""Compiled loops of the joint estimation: water signal, echo and misfit of a pixel."""

from __future__ import annotations

import math

import numpy as np

from amulor._compiled import numba
from amulor.rejection.joint._kernels.bundles import (
    Array,
    Echo,
    Limits,
    Model,
    Pixel,
    Places,
    Samples,
    Signals,
    WaterTable,
    Workspace,
)
from amulor.rejection.joint._kernels.compiled import LANES, inner

#: pi / 2 in parts of 33 bits, so that their products with fewer than 2^20 quarter turns
#: are exact (Cody and Waite).
_FIRST, _SECOND, _THIRD = (
    1.57079632673412561417,
    6.07710050630396597660e-11,
    2.02226624879595063154e-21,
)


@inner(forceinline=True, fastmath={"contract"})
def fill_turn(path: float, phase_per_path: Array, turn: Array) -> None:
    """Compute the phasor exp(i k p) of an optical path p in full precision.

    By polynomials on a quarter turn, without a branch, so that all frequencies are done
    in parallel lanes. Compiled because the cosine and sine of the mathematical library,
    one after the other, take four times as long and were a third of all work. Up to
    10^6 quarter turns.
    """
    for f in range(phase_per_path.size):
        phase = phase_per_path[f] * path
        quarters = np.floor(phase * (2 / np.pi) + 0.5)
        rest = (phase - quarters * _FIRST) - quarters * _SECOND - quarters * _THIRD
        z = rest * rest
        # Odd and even polynomials of least error between -pi/4 and pi/4.
        sine = 1.58969099521155010221e-10
        sine = -2.50507602534068634195e-08 + z * sine
        sine = 2.75573137070700676789e-06 + z * sine
        sine = -1.98412698298579493134e-04 + z * sine
        sine = 8.33333333332248946124e-03 + z * sine
        sine = -1.66666666666666324348e-01 + z * sine
        sine = rest + rest * z * sine
        cosine = -1.13596475577881948265e-11
        cosine = 2.08757232129817482790e-09 + z * cosine
        cosine = -2.75573143513906633035e-07 + z * cosine
        cosine = 2.48015872894767294178e-05 + z * cosine
        cosine = -1.38888888888741095749e-03 + z * cosine
        cosine = 4.16666666666666019037e-02 + z * cosine
        cosine = 1 - 0.5 * z + z * z * cosine
        halves = np.floor(0.5 * quarters)
        is_odd = quarters - 2 * halves > 0.5
        sign = 1 - 2 * (halves - 2 * np.floor(0.5 * halves))
        turn[0, f] = -sign * sine if is_odd else sign * cosine
        turn[1, f] = sign * cosine if is_odd else sign * sine


@inner(forceinline=True)
def depth_of(path: float, limits: Limits) -> tuple[float, float]:
    """Return depth z and slope dz/dp at a path p, from the pixel's depth table.

    Linear between the nodes at p_j = shortest + (longest - shortest) (j / (J - 1))^2.
    Compiled because every step of the search starts with it.
    """
    depths = limits.depths
    count = depths.size - 1
    fraction = (path - limits.shortest) / (limits.longest - limits.shortest)
    place = math.sqrt(fraction) * count if fraction > 0 else 0.0
    k = min(int(place), count - 1)
    width = (limits.longest - limits.shortest) / count**2
    before = limits.shortest + width * k**2
    step = width * (2 * k + 1)
    slope = (depths[k + 1] - depths[k]) / step
    return depths[k] + slope * (path - before), slope


@inner(fastmath=LANES, forceinline=True)
def water_to(
    depth: float, table: WaterTable, coefficient: Array, water: Array, change: Array
) -> None:
    """Compute the water signal W(z) and dW/dz by cubic Hermite interpolation.

    The integral (29) of docs/theory/water-signal.md up to z, in units of its strength.
    Compiled because every step of the search takes it, at all frequencies.
    """
    step, value, slope = table.step, table.value, table.slope
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
    for r in range(coefficient.size):
        c = coefficient[r]
        for part in range(2):
            for f in range(water.shape[1]):
                a, b = value[r, j, part, f], value[r, j + 1, part, f]
                da, db = slope[r, j, part, f], slope[r, j + 1, part, f]
                water[part, f] += c * (h00 * a + h10 * da + h01 * b + h11 * db)
                change[part, f] += c * (g0 * (a - b) + g10 * da + g11 * db)


@inner(fastmath=LANES, forceinline=True)
def turn_by(signal: Array, turn: Array) -> None:
    """Multiply signals by unit phasors in place, both as (real, imaginary) pairs."""
    for f in range(signal.shape[1]):
        a, b = signal[0, f], signal[1, f]
        signal[0, f] = a * turn[0, f] - b * turn[1, f]
        signal[1, f] = a * turn[1, f] + b * turn[0, f]


@inner(fastmath=LANES, forceinline=True)
def water_at_node(node: int, table: WaterTable, pixel: Pixel, water: Array) -> None:
    """Compute a pixel's water signal at a table node."""
    coefficient, value = pixel.coefficient, table.value
    water[:] = 0
    for r in range(coefficient.size):
        for f in range(water.shape[1]):
            water[0, f] += coefficient[r] * value[r, node, 0, f]
            water[1, f] += coefficient[r] * value[r, node, 1, f]
    turn_by(water, pixel.turn)


@inner(forceinline=True)
def nearest_node(depth: float, table: WaterTable) -> int:
    """Return the table node nearest to a depth."""
    node: int = min(max(int(depth / table.step + 0.5), 0), table.value.shape[1] - 2)
    return node


@inner(forceinline=True)
def fill_phasor(path: float, echo: Echo, out: Array) -> None:
    """Compute the echo H(f) exp(i k p) for a single path."""
    transfer = echo.transfer
    fill_turn(path, echo.phase_per_path, out)
    for f in range(transfer.shape[1]):
        c, s = out[0, f], out[1, f]
        out[0, f] = c * transfer[0, f] - s * transfer[1, f]
        out[1, f] = s * transfer[0, f] + c * transfer[1, f]


@numba.njit(cache=True, error_model="numpy")
def fill_phasors(path: Array, echo: Echo, out: Array) -> None:
    """Compute the echo H(f) exp(i k p) for many paths, (path, 2, frequency)."""
    for j in range(path.size):
        fill_phasor(path[j], echo, out[j])


@inner(forceinline=True)
def pixel_of(
    samples: Samples, places: Places, n: int, phase_per_path: Array, turn: Array
) -> Pixel:
    """Return the data of pixel n; `turn` is overwritten with the pixel's phasor."""
    fill_turn(places.offset[n], phase_per_path, turn)
    limits = Limits(places.shortest[n], places.longest[n], places.depths[n])
    return Pixel(
        samples.signal[n], samples.weight[n], places.coefficient[n], turn, limits
    )


@inner()
def workspace_of(channels: int, frequencies: int) -> Workspace:
    """Allocate the work arrays for the model of one pixel."""
    return Workspace(
        np.empty((2, frequencies)),
        np.empty((2, frequencies)),
        np.empty((2, frequencies)),
        np.empty(channels),
        np.empty((channels, 2, frequencies)),
        np.empty((channels, 3, frequencies)),
    )


@inner(fastmath=LANES, forceinline=True)
def misfit(
    signal: Array,
    weight: Array,
    gain: Array,
    water: Array,
    phasor: Array,
    amplitude: Array,
) -> float:
    """Fit the amplitudes A_c, write them to `amplitude`, and return chi-square.

    A_c >= 0 by linear least squares in each channel, so that chi-square depends on the
    path alone (profile likelihood). Compiled because it is half of all work.
    """
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


@inner(fastmath=LANES)
def misfit_at(
    path: float, pixel: Pixel, model: Model, work: Workspace
) -> tuple[float, float]:
    """Return chi-square at a path, and dz/dp; update the model and the amplitudes.

    Compiled because every step of the search and of the profile calls it.
    """
    water, change, phasor = work.water, work.change, work.phasor
    depth, rate = depth_of(path, pixel.limits)
    water_to(depth, model.table, pixel.coefficient, water, change)
    turn_by(water, pixel.turn)
    turn_by(change, pixel.turn)
    fill_phasor(path, model.echo, phasor)
    cost = misfit(pixel.signal, pixel.weight, model.gain, water, phasor, work.amplitude)
    return cost, rate


@inner(fastmath=LANES)
def descent(
    rate: float, pixel: Pixel, model: Model, work: Workspace
) -> tuple[float, float]:
    """Return minus half the path slope of chi-square, and the Fisher information.

    Gauss and Newton's curvature, the Hessian without second derivatives of the model,
    of which the amplitudes above zero are eliminated (Schur complement). `rate` is
    dz/dp; the workspace holds the model at p, and takes the influence: what the path
    moves by per unit of each output, times the curvature. Compiled because every step
    of the search calls it.
    """
    signal, weight, gain = pixel.signal, pixel.weight, model.gain
    water, change, phasor = work.water, work.change, work.phasor
    wavenumber, influence = model.echo.phase_per_path, work.influence
    downhill, curvature = 0.0, 0.0
    for c in range(signal.shape[0]):
        own, cross, fit = 0.0, 0.0, 0.0
        a = work.amplitude[c]
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
            ratio = cross / fit
            own -= ratio * cross
            for f in range(signal.shape[2]):
                xx, xy, yy = weight[c, 0, f], weight[c, 1, f], weight[c, 2, f]
                e, i = phasor[0, f], phasor[1, f]
                influence[c, 0, f] -= ratio * (xx * e + xy * i)
                influence[c, 1, f] -= ratio * (xy * e + yy * i)
        curvature += own
    return downhill, curvature


@numba.njit(cache=True, error_model="numpy", nogil=True)
def water_at(
    begin: int,
    end: int,
    path: Array,
    places: Places,
    table: WaterTable,
    phase_per_path: Array,
    signals: Signals,
) -> None:
    """Compute depth, water signal W and dW/dp at each pixel's path.

    An infinite path means open water. Compiled as the search is, so that both use the
    same table in the same way.
    """
    turn = np.empty((2, phase_per_path.size))
    for n in range(begin, end):
        water, change = signals.water[n], signals.change[n]
        depth, rate = np.inf, 0.0
        if path[n] < np.inf:
            limits = Limits(places.shortest[n], places.longest[n], places.depths[n])
            depth, rate = depth_of(path[n], limits)
        water_to(depth, table, places.coefficient[n], water, change)
        fill_turn(places.offset[n], phase_per_path, turn)
        turn_by(water, turn)
        turn_by(change, turn)
        for f in range(phase_per_path.size):
            change[0, f] *= rate
            change[1, f] *= rate
        signals.depth[n] = depth


@numba.njit(cache=True, error_model="numpy", nogil=True, fastmath=LANES)
def interpolate(
    begin: int,
    end: int,
    depth: Array,
    step: float,
    coefficient: Array,
    table: Array,
    out: Array,
) -> None:
    """Interpolate tabulated water columns linearly at given depths.

    `table` runs over (parameter, component, node, frequency), `out` over (pixel,
    parameter, frequency): the derivatives of W with respect to its shape, (real,
    imaginary) pairs along the last axis. Compiled because numpy would copy a node of
    the table for each pixel.
    """
    last = table.shape[2] - 2
    for n in range(begin, end):
        if depth[n] == np.inf:
            j, t = last, 1.0
        else:
            place = min(max(depth[n] / step, 0.0), float(last))
            j = min(int(place), last - 1)
            t = place - j
        for m in range(table.shape[0]):
            column = out[n, m]
            column[:] = 0
            for r in range(table.shape[1]):
                before, after = coefficient[n, r] * (1 - t), coefficient[n, r] * t
                near, far = table[m, r, j], table[m, r, j + 1]
                for f in range(column.size):
                    column[f] += before * near[f] + after * far[f]


@numba.njit(cache=True, error_model="numpy")
def integrate(
    profile: Array,
    phasor: Array,
    order: int,
    count: int,
    out: Array,
) -> None:
    """Compute running integrals of profile times phasor, at every `order`-th point.

    The integral (29) of docs/theory/water-signal.md up to every node of depth, by
    Gauss's rule; the node after number `count` contains the total. Compiled
    because numpy would store every term.
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


@inner(forceinline=True)
def _lost(place: float, table: Array) -> float:
    """Interpolate the logarithm of the scattered fraction from a table.

    Cubic through four nodes; a line beyond the first ones and the last.
    """
    last = table.size - 1
    if place < 1.0:
        return float(table[0] + place * (table[1] - table[0]))
    if place > last - 1.0:
        slope = table[last] - table[last - 1]
        return float(table[last] + (place - last) * slope)
    k = min(int(place), last - 2)
    t = place - k
    a, b, c, d = table[k - 1], table[k], table[k + 1], table[k + 2]
    bend = 0.5 * (d - a) + 1.5 * (b - c)
    turn = a - 2.5 * b + 2.0 * c - 0.5 * d
    return float(b + t * (0.5 * (c - a) + t * (turn + t * bend)))


@numba.njit(cache=True, error_model="numpy", nogil=True, fastmath=LANES)
def series(
    thickness: Array, place: Array, shift: float, lost: Array, rule: Array, out: Array
) -> None:
    """Compute Chebyshev series of scattered light over beam offset, (depth, term).

    The integral (29) of docs/theory/water-signal.md over the spatial frequency, whose
    J0 and weights are in `rule`, (depth, term, frequency). Compiled since every table
    of every step of the fit takes it for all depths.
    """
    frequencies = place.shape[1]
    light = np.empty(frequencies)
    for n in range(thickness.size):
        straight = math.exp(-thickness[n])
        for k in range(frequencies):
            gone = math.exp(min(_lost(place[n, k] + shift, lost), 0.0))
            light[k] = math.exp(-thickness[n] * gone) - straight
        for j in range(rule.shape[1]):
            total = 0.0
            for k in range(frequencies):
                total += rule[n, j, k] * light[k]
            out[n, j] = total


@numba.njit(cache=True, error_model="numpy", nogil=True, fastmath=LANES)
def along(place: Array, terms: Array, out: Array) -> None:
    """Evaluate Chebyshev series at positions from -1 to 1, (direction, depth).

    Clenshaw's recurrence. Compiled for the same reason.
    """
    count = terms.shape[1]
    for i in range(place.shape[0]):
        for n in range(place.shape[1]):
            x = 2.0 * place[i, n]
            a, b = 0.0, 0.0
            for j in range(count - 1, 0, -1):
                a, b = terms[n, j] + x * a - b, a
            out[i, n] = terms[n, 0] + 0.5 * x * a - b


@numba.njit(cache=True, error_model="numpy", nogil=True, fastmath=LANES)
def between(values: Array, place: Array, out: Array) -> None:
    """Interpolate values of shape (direction, node) between nodes, at given positions.

    Cubic through four nodes. Compiled for the same reason.
    """
    last = values.shape[1] - 1
    for n in range(place.size):
        at = min(place[n], float(last))
        k = min(max(int(at), 1), last - 2)
        t = at - k
        a = -t * (t - 1.0) * (t - 2.0) / 6.0
        b = (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0
        c = -(t + 1.0) * t * (t - 2.0) / 2.0
        d = (t + 1.0) * t * (t - 1.0) / 6.0
        for i in range(values.shape[0]):
            out[i, n] = (
                a * values[i, k - 1]
                + b * values[i, k]
                + c * values[i, k + 1]
                + d * values[i, k + 2]
            )
