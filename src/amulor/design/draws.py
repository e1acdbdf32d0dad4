"""Waters and targets drawn from the ranges of a goal, the same ones each time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, qmc

from amulor.design.goal import Goal
from amulor.design.goal.spread import FractionSpread, Spread

__all__ = ["drawn", "spreads_of", "values_at"]

Floats = NDArray[np.float64]

#: Standard errors that hold 95 % of a normal distribution on either side, and to which
#: it is cut off.
_NINETY_FIVE, _CUT = 1.959964, 2 * 1.959964


def spreads_of(goal: Goal) -> dict[str, Spread]:
    """Return the ranges of a goal by the names of axes."""
    waters, targets = goal.waters, goal.targets
    stated = {
        "attenuation": waters.attenuation,
        "absorption": waters.absorption,
        "scattering": waters.scattering,
        "fluctuation": waters.fluctuation,
        "water_m22": waters.m22,
        "reflectance": targets.reflectance,
        "target_m22": targets.m22,
        "slope": targets.slope,
        "texture": targets.texture,
    }
    return {name: each for name, each in stated.items() if each is not None}


def drawn(goal: Goal, count: int | None = None) -> dict[str, Floats]:
    """Return waters and targets drawn from the ranges of a goal.

    A scrambled Sobol' sequence with a fixed seed, through the inverse distributions:
    the same draws for the same ranges, and evenly spread over them.
    """
    spreads = spreads_of(goal)
    most = goal.effort.draws
    power = int(np.ceil(np.log2(most)))
    sampler = qmc.Sobol(len(spreads), scramble=True, seed=20)
    share = sampler.random_base2(power)[: most if count is None else min(count, most)]
    return {
        name: values_at(spread, share[:, k])
        for k, (name, spread) in enumerate(spreads.items())
    }


def values_at(spread: Spread, share: Floats) -> Floats:
    """Return the values of a range at shares of its distribution."""
    low, high = spread.low, spread.high
    logarithm = spread.distribution.startswith("log")
    if logarithm:
        low, high = float(np.log(low)), float(np.log(high))
    place = np.asarray(share, dtype=float)
    if spread.distribution.endswith("normal"):
        cut = norm.cdf(-_CUT)
        deviation = norm.ppf(cut + (1 - 2 * cut) * place) / _NINETY_FIVE
        place = 0.5 + deviation / 2
    values = low + (high - low) * place
    if logarithm:
        return np.asarray(np.exp(values))
    # A normal distribution may reach out of what a fraction or a coefficient can be.
    floor = 1e-6 if spread.low > 0 else 0.0
    most = 1.0 if isinstance(spread, FractionSpread) else np.inf
    return np.asarray(np.clip(values, floor, most))
