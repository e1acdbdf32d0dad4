"""Compiled loops of the joint estimation: light that was scattered on its way."""

from __future__ import annotations

import math

import numpy as np

from amulor._compiled import numba
from amulor.rejection.joint._kernels.bundles import Array
from amulor.rejection.joint._kernels.options import LANES, inner


@inner(forceinline=True)
def _lost(place: float, table: Array) -> float:
    """Return the logarithm of what is lost at a place among the nodes of its table.

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
    """Fill out, (depth, term), with the series of the scattered light over the offset.

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
    """Fill out, (direction, depth), with Chebyshev series at places from -1 to 1.

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
    """Fill out, (direction, place), with values between nodes, (direction, node).

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
