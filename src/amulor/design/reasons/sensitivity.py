"""Which number to measure before buying: total Sobol indices of the error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

from amulor import _progress
from amulor.design.candidates import Parameters, survey_of, water_scale
from amulor.design.draws import spreads_of, values_at
from amulor.design.evaluate import evaluate
from amulor.design.goal import Goal
from amulor.design.methods import PREDICTED

__all__ = ["Sensitivity", "Uncertain", "sensitivity", "uncertain"]

Floats = NDArray[np.float64]

#: Factor up and down within which a number lies that is assumed without a range [1].
FACTOR = 2.0
_LABELS = {
    "attenuation": "attenuation of the water",
    "absorption": "absorption of the water",
    "scattering": "scattering of the water",
    "fluctuation": "fluctuation of the water signal",
    "water_m22": "polarization kept by the water",
    "reflectance": "reflectance of the target",
    "target_m22": "polarization kept by the target",
    "slope": "slope of the target",
    "texture": "texture of the target",
    "power": "light lost in the optics",
    "phase_floor": "phase floor",
    "dark_rate": "dark counts",
    "radiance": "daylight",
    "water_change": "change of the water since the shots",
    "column_uncertainty": "water behind the target",
    "ratio_uncertainty": "depolarization ratio of the water",
    "departure": "departure of the water from its model",
}
_BOOTSTRAPS = 200


@dataclass(frozen=True, kw_only=True)
class Uncertain:
    """One number that is not known for sure."""

    axis: str
    """Axis of `evaluate` that it is."""
    label: str
    """What people call it."""
    low: float
    """Lower end of its range, in the unit of the axis."""
    high: float
    """Upper end."""
    stated: bool
    """Whether the goal states the range; else it is a factor of two up and down."""


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """Shares of the variance of the logarithm of the error."""

    numbers: tuple[Uncertain, ...]
    """What was varied."""
    total: Floats
    """Total Sobol index of each: alone, and with others, shape (number,) [1]."""
    total_error: Floats
    """Standard error of it, from resampling [1]."""
    first: Floats
    """First-order index: alone [1]."""
    first_error: Floats
    """Standard error of it [1]."""
    spread: float
    """Standard deviation of the logarithm of the error by all together [1]."""

    @property
    def largest(self) -> Uncertain:
        """The number to measure first."""
        return self.numbers[int(np.argmax(self.total))]

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers and texts, the largest share first."""
        order = np.argsort(-self.total)
        return {
            "spread_of_logarithm": self.spread,
            "numbers": [
                {
                    **vars(self.numbers[k]),
                    "total": float(self.total[k]),
                    "total_error": float(self.total_error[k]),
                    "first": float(self.first[k]),
                    "first_error": float(self.first_error[k]),
                }
                for k in order
            ],
        }


def uncertain(goal: Goal, chosen: Parameters) -> tuple[Uncertain, ...]:
    """Return what is not known for sure about an instrument at work."""
    found = [
        Uncertain(
            axis=name, label=_LABELS[name], low=each.low, high=each.high, stated=True
        )
        for name, each in spreads_of(goal).items()
        if each.high > each.low
    ]
    assumed = {
        "power": chosen.power,
        "phase_floor": goal.lock_in.phase_floor,
        "dark_rate": goal.detector.dark_rate,
        "radiance": 0.0 if goal.daylight is None else goal.daylight.radiance,
        **_assumptions(goal, chosen.method),
    }
    for name, value in assumed.items():
        if value > 0:
            high = value * FACTOR
            if name not in ("power", "phase_floor", "dark_rate", "radiance"):
                high = min(high, 1.0)
            found.append(
                Uncertain(
                    axis=name,
                    label=_LABELS[name],
                    low=value / FACTOR,
                    high=high,
                    stated=False,
                )
            )
    return tuple(found)


def _assumptions(goal: Goal, method: str) -> dict[str, float]:
    """Return the assumptions that a method depends on."""
    used = PREDICTED[method].assumptions
    return {name: getattr(goal.assumptions, name) for name in used}


def sensitivity(
    goal: Goal, chosen: Parameters, *, samples: int = 256, seed: int = 7
) -> Sensitivity:
    r"""Return on which numbers the error of an instrument depends, and how surely.

    `scipy.stats.sobol_indices` after Saltelli 2010; numbers are independent, ranges of
    the goal as it states their distributions, assumed numbers log-uniform. The
    logarithm keeps a few very bad draws from standing for all. Total indices add up to
    more than 1 where numbers act together; negative values are chance.
    """
    numbers = uncertain(goal, chosen)
    if not numbers:
        raise ValueError("nothing is uncertain: the goal states no range")
    survey = survey_of(goal, chosen)
    scale = water_scale(goal, chosen)
    spreads = spreads_of(goal)

    def errors(shares: Floats) -> Floats:
        """Return the logarithm of the error for shares of all ranges, (number, n)."""
        axes: dict[str, Any] = {}
        for one, share in zip(numbers, shares, strict=True):
            if one.stated:
                values = values_at(spreads[one.axis], share) * scale.get(one.axis, 1.0)
            else:
                values = one.low * (one.high / one.low) ** share
            axes[one.axis] = xr.DataArray(values, dims="draw")
        found = evaluate(
            survey,
            distance=np.array(goal.asked),
            method=chosen.method,
            interval=goal.limits,
            wrong_interval=goal.accuracy.wrong_interval,
            **{**goal.assumed, **axes},
        )["total_error"]
        worst = np.nan_to_num(found.max("distance").values, nan=1e3)
        return np.asarray(np.log(np.clip(worst, 1e-9, 1e3)))

    rng = np.random.default_rng(seed)
    both = stats.qmc.Sobol(2 * len(numbers), scramble=True, seed=rng).random(samples).T
    first, second = both[: len(numbers)], both[len(numbers) :]
    known = {"f_A": errors(first)[None], "f_B": errors(second)[None]}
    mixed = []
    for number, one in enumerate(numbers):
        _progress.tell(f"what the error owes to: {one.label}", number / len(numbers))
        # All as in the first sample but this one, which is that of the second.
        swapped = first.copy()
        swapped[number] = second[number]
        mixed.append(errors(swapped))
    known["f_AB"] = np.stack(mixed)[:, None]
    total, alone = _indices(known, samples)
    again = [
        _indices({name: each[..., some] for name, each in known.items()}, samples)
        for some in rng.integers(0, samples, (_BOOTSTRAPS, samples))
    ]
    return Sensitivity(
        numbers=numbers,
        total=total,
        total_error=np.std([one[0] for one in again], axis=0, ddof=1),
        first=alone,
        first_error=np.std([one[1] for one in again], axis=0, ddof=1),
        spread=float(np.std(np.concatenate([known["f_A"], known["f_B"]]))),
    )


def _indices(known: dict[str, Floats], samples: int) -> tuple[Floats, Floats]:
    """Return total and first-order indices of values that are known."""
    found = stats.sobol_indices(func=known, n=samples)
    return np.ravel(found.total_order), np.ravel(found.first_order)
