"""Compiled loop of the joint estimation: cosines and sines of many phases at once."""

from __future__ import annotations

import numpy as np

from amulor.rejection.joint._kernels.bundles import Array
from amulor.rejection.joint._kernels.options import inner

#: pi / 2 in parts of 33 bits, so that their products with fewer than 2^20 quarter turns
#: are exact (Cody and Waite).
_FIRST, _SECOND, _THIRD = (
    1.57079632673412561417,
    6.07710050630396597660e-11,
    2.02226624879595063154e-21,
)


@inner(forceinline=True, fastmath={"contract"})
def fill_turn(path: float, phase_per_path: Array, turn: Array) -> None:
    """Fill in exp(i k p), (real and imaginary, frequency), to a unit in the last place.

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
