"""How the dwell would best be shared between the frequencies of a set."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.design._kernels.points import astray
from amulor.design.candidates import Parameters, survey_of
from amulor.design.evaluate import evaluate
from amulor.design.goal import Goal
from amulor.design.methods import PREDICTED
from amulor.design.scores import draws_at
from amulor.optics import ranging
from amulor.survey import water_properties

__all__ = ["Shares", "dwell_shares"]

Floats = NDArray[np.float64]

#: Parts that the dwell is divided into.
_PARTS = 20
#: Draws that shares are judged by.
_DRAWS = 16


@dataclass(frozen=True, kw_only=True)
class Shares:
    """The best division of the time of a pixel between its frequencies."""

    share: tuple[float, ...]
    """Share of each frequency, 1 in all [1]."""
    error: float
    """Total error with these shares [m]."""
    even: float
    """The same with the time evenly shared, as a survey does [m]."""


def dwell_shares(goal: Goal, chosen: Parameters) -> Shares | None:
    """Return how the time of a pixel would best be shared between its frequencies.

    Every division into twentieths is judged by the error at the worst distance that
    the asked share of 16 draws reaches, among those with a probability of a wrong
    interval below the limit. Biases of the frequencies count as one sign, so that the
    error is an upper limit. A survey has one dwell for all frequencies: this says what
    an instrument with several would gain.
    """
    count = len(chosen.frequencies)
    if not 2 <= count <= 3 or not PREDICTED[chosen.method].separate_frequencies:
        return None
    parts = [
        division
        for division in itertools.product(range(1, _PARTS), repeat=count)
        if sum(division) == _PARTS
    ]
    each = np.arange(1, _PARTS) / _PARTS * count * chosen.dwell
    # The filter of the shortest time serves all: a lock-in must settle anew each time.
    found = evaluate(
        survey_of(goal, chosen),
        frequency=np.array(chosen.frequencies),
        dwell=np.append(each, chosen.dwell),
        distance=np.array(goal.asked),
        method=chosen.method,
        **{**goal.assumed, **_draws(goal, chosen)},
    )
    if "draw" not in found.dims:
        found = found.expand_dims("draw")
    order = ("frequency", "dwell", "distance", "draw")
    variance = (found["standard_uncertainty"] ** 2).transpose(*order).values
    bias = found["residual_bias"].transpose(*order).values
    index = water_properties(survey_of(goal, chosen)).group_index
    errors = [
        _error(goal, chosen, index, variance, bias, tuple(p - 1 for p in division))
        for division in parts
    ]
    even = _error(goal, chosen, index, variance, bias, (len(each),) * count)
    best = int(np.argmin(errors))
    if not errors[best] < even:
        return Shares(share=(1 / count,) * count, error=even, even=even)
    return Shares(
        share=tuple(p / _PARTS for p in parts[best]), error=errors[best], even=even
    )


def _draws(goal: Goal, chosen: Parameters) -> dict[str, xr.DataArray]:
    found = draws_at(goal, chosen, _DRAWS)
    return {name: xr.DataArray(values, dims="draw") for name, values in found.items()}


def _error(
    goal: Goal,
    chosen: Parameters,
    group_index: float,
    variance: Floats,
    bias: Floats,
    dwell: tuple[int, ...],
) -> float:
    """Return the error at the worst distance, infinite with wrong intervals [m]."""
    own = np.stack([variance[k, number] for k, number in enumerate(dwell)])
    left = np.stack([bias[k, number] for k, number in enumerate(dwell)])
    weight = 1 / np.maximum(own, 1e-30)
    total = weight.sum(axis=0)
    error = np.sqrt(1 / total + (np.sum(weight * left, axis=0) / total) ** 2)
    rank = max(math.ceil(goal.accuracy.share * error.shape[-1] - 1e-9), 1) - 1
    to_range = np.asarray(
        ranging.range_per_phase(np.array(chosen.frequencies), group_index=group_index)
    )
    near, far = goal.limits
    phase = (own + left**2) / to_range[:, None, None] ** 2
    for number, distance in enumerate(goal.asked):
        wrong = [
            astray(
                to_range, np.ascontiguousarray(phase[:, number, k]), distance, near, far
            )
            for k in range(error.shape[-1])
        ]
        if sorted(chance for chance, _ in wrong)[rank] > goal.accuracy.wrong_interval:
            return math.inf
    return float(np.sort(error, axis=-1)[:, rank].max())
