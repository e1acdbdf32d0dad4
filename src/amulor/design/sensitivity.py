"""Sensitivity of the predicted error to uncertain inputs, as Sobol indices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

from amulor import _progress
from amulor.design.axes import PREDICTED
from amulor.design.candidates import (
    Parameters,
    spreads_of,
    survey_of,
    values_at,
    water_scale,
)
from amulor.design.evaluate import evaluate
from amulor.design.goal import Goal

__all__ = ["Sensitivity", "Uncertain", "sensitivity", "uncertain"]


Floats = NDArray[np.float64]

#: Range of assumed numbers without a stated range, as a factor up and down [1].
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
    """Uncertain input of a design, with its range of values."""

    axis: str
    """Axis of `evaluate`."""
    label: str
    """Readable label."""
    low: float
    """Lower end of the range, in the unit of the axis."""
    high: float
    """Upper end of the range, in the unit of the axis."""
    stated: bool
    """Whether the range is from the goal; otherwise a factor of two up and down."""


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """Sobol indices: fractions of the log error's variance, by uncertain input."""

    numbers: tuple[Uncertain, ...]
    """Uncertain inputs."""
    total: Floats
    """Total Sobol index of each input, interactions included, shape (number,) [1]."""
    total_error: Floats
    """Standard error of the total index, from resampling [1]."""
    first: Floats
    """First-order Sobol index of each input, without interactions [1]."""
    first_error: Floats
    """Standard error of the first-order index [1]."""
    spread: float
    """Standard deviation of the logarithm of the error, all inputs varied [1]."""

    @property
    def largest(self) -> Uncertain:
        """Uncertain input with the largest total index."""
        return self.numbers[int(np.argmax(self.total))]

    def to_dict(self) -> dict[str, Any]:
        """Return the results as plain numbers and texts, largest share first."""
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
    """Uncertain inputs of an instrument: water, target, losses, noise, assumptions."""
    numbers = [
        Uncertain(
            axis=name,
            label=_LABELS[name],
            low=spread.low,
            high=spread.high,
            stated=True,
        )
        for name, spread in spreads_of(goal).items()
        if spread.high > spread.low
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
            numbers.append(
                Uncertain(
                    axis=name,
                    label=_LABELS[name],
                    low=value / FACTOR,
                    high=high,
                    stated=False,
                )
            )
    return tuple(numbers)


def _assumptions(goal: Goal, method: str) -> dict[str, float]:
    """Assumptions of the goal with an effect on a rejection method."""
    names = PREDICTED[method].assumptions
    return {name: getattr(goal.assumptions, name) for name in names}


def sensitivity(
    goal: Goal, chosen: Parameters, *, samples: int = 256, seed: int = 7
) -> Sensitivity:
    r"""Estimate Sobol indices of an instrument's error, with standard errors.

    The indices are from `scipy.stats.sobol_indices`, after Saltelli 2010. Inputs are
    independent. Ranges of the goal have the distributions that it states, assumptions
    are log-uniform. The logarithm limits the influence of a few very bad cases. Total
    indices add up to more than 1 if inputs interact; negative values are chance.
    """
    numbers = uncertain(goal, chosen)
    if not numbers:
        raise ValueError("nothing is uncertain: the goal states no range")
    survey = survey_of(goal, chosen)
    scale = water_scale(goal, chosen)
    spreads = spreads_of(goal)

    def errors(shares: Floats) -> Floats:
        """Logarithm of the largest error at input quantiles, shape (input, sample)."""
        axes: dict[str, Any] = {}
        for variable, share in zip(numbers, shares, strict=True):
            if variable.stated:
                values = values_at(spreads[variable.axis], share) * scale.get(
                    variable.axis, 1.0
                )
            else:
                values = variable.low * (variable.high / variable.low) ** share
            axes[variable.axis] = xr.DataArray(values, dims="draw")
        total_errors = evaluate(
            survey,
            distance=np.array(goal.asked),
            method=chosen.method,
            interval=goal.limits,
            wrong_interval=goal.accuracy.wrong_interval,
            **{**goal.assumed, **axes},
        )["total_error"]
        worst = np.nan_to_num(total_errors.max("distance").values, nan=1e3)
        return np.asarray(np.log(np.clip(worst, 1e-9, 1e3)))

    rng = np.random.default_rng(seed)
    sobol = stats.qmc.Sobol(2 * len(numbers), scramble=True, seed=rng).random(samples).T
    first, second = sobol[: len(numbers)], sobol[len(numbers) :]
    samples_of = {"f_A": errors(first)[None], "f_B": errors(second)[None]}
    mixed = []
    for number, variable in enumerate(numbers):
        _progress.tell(
            f"what the error owes to: {variable.label}", number / len(numbers)
        )
        # All as in the first sample but this one, which is that of the second.
        swapped = first.copy()
        swapped[number] = second[number]
        mixed.append(errors(swapped))
    samples_of["f_AB"] = np.stack(mixed)[:, None]
    total, alone = _indices(samples_of, samples)
    resampled = [
        _indices(
            {name: values[..., chosen_samples] for name, values in samples_of.items()},
            samples,
        )
        for chosen_samples in rng.integers(0, samples, (_BOOTSTRAPS, samples))
    ]
    return Sensitivity(
        numbers=numbers,
        total=total,
        total_error=np.std([indices[0] for indices in resampled], axis=0, ddof=1),
        first=alone,
        first_error=np.std([indices[1] for indices in resampled], axis=0, ddof=1),
        spread=float(np.std(np.concatenate([samples_of["f_A"], samples_of["f_B"]]))),
    )


def _indices(samples_of: dict[str, Floats], samples: int) -> tuple[Floats, Floats]:
    """Total and first-order Sobol indices, from errors at random inputs."""
    result = stats.sobol_indices(func=samples_of, n=samples)
    return np.ravel(result.total_order), np.ravel(result.first_order)
