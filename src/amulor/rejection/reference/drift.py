"""How the water changes from the first open-water shot to the last."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Drift:
    """Relative change of the water signal from the first to the last shot."""

    change: complex
    """Change, radial + 1j * tangential, per unit of the water signal [1]."""
    uncertainty: complex
    """Standard uncertainty of its two parts, likewise [1]."""
    chance: float
    """Probability that steady water shows as much [1]."""


#: What shots tell that cannot be compared with each other.
NO_DRIFT = Drift(0j, complex(np.inf, np.inf), 1.0)


def drift_of(shots: Complex, level: Complex, where: Floats) -> Drift:
    """Return how the shots of the same direction change with their order.

    A straight line over the order, each direction with a mean of its own: what the
    polynomial over the directions misses is no drift. Directions that are repeated
    first and last tell it well, repeats in a row badly, single shots not at all.
    """
    from scipy.special import stdtr

    _, group, size = np.unique(
        np.round(where, 9), axis=0, return_inverse=True, return_counts=True
    )
    group = group.ravel()

    def own_of(values: Floats) -> Floats:
        mean: Floats = np.bincount(group, values) / size
        return values - mean[group]

    freedom = len(shots) - len(size) - 1
    order = own_of(np.linspace(-0.5, 0.5, len(shots)))
    square = float(order @ order)
    if freedom < 1 or np.abs(level).min() == 0 or square < 1e-9 * len(shots):
        return NO_DRIFT
    relative = (shots - level) / level
    parts, errors, chances = [], [], []
    for values in (relative.real, relative.imag):
        slope = float(order @ values) / square
        rest = own_of(values) - slope * order
        error = float(np.sqrt(rest @ rest / freedom / square))
        parts.append(slope)
        errors.append(error)
        steady = 1.0 if slope == 0 else 0.0
        chances.append(
            2 * float(stdtr(freedom, -abs(slope) / error)) if error > 0 else steady
        )
    # Either part may show it: the smaller chance of two.
    chance = min(1.0, 2 * min(chances))
    return Drift(complex(*parts), complex(*errors), chance)
