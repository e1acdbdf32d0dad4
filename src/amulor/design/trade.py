"""Trade-offs of an instrument: Pareto front, and decisive assumptions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor import _progress
from amulor.design.axes import PREDICTED
from amulor.design.candidates import (
    Parameters,
    box_values,
    cost_of,
    frequency_grid,
    laser_of,
    middle,
    scan_time,
)
from amulor.design.goal import Goal
from amulor.design.scores import Judge, grid_of, merits

__all__ = ["Trade", "Turn", "trade", "what_if"]


def front(cost: ArrayLike, error: ArrayLike) -> NDArray[np.intp]:
    """Return the indices of the Pareto-optimal candidates in cost and error."""
    cost, error = np.asarray(cost, dtype=float), np.asarray(error, dtype=float)
    if cost.ndim != 1 or cost.shape != error.shape:
        raise ValueError(
            f"cost and error must be 1-D and of one length; got shapes {cost.shape} "
            f"and {error.shape}"
        )
    finite = np.flatnonzero(np.isfinite(cost) & np.isfinite(error))
    order = finite[np.lexsort((error[finite], cost[finite]))]
    if not len(order):
        return order
    best = np.minimum.accumulate(error[order])
    better = np.concatenate([[True], error[order][1:] < best[:-1]])
    indices: NDArray[np.intp] = order[better]
    return indices


def knee(cost: ArrayLike, error: ArrayLike) -> int | None:
    """Return the index of a front's knee, beyond which cost buys little accuracy."""
    x, y = (np.log(np.asarray(values, dtype=float)) for values in (cost, error))
    if len(x) < 3 or x[-1] <= x[0] or y[0] <= y[-1]:
        return None
    below = 1 - (x - x[0]) / (x[-1] - x[0]) - (y - y[-1]) / (y[0] - y[-1])
    at = int(np.argmax(below))
    return at if below[at] > 1e-9 else None


Floats = NDArray[np.float64]

#: Number of dwell times to evaluate, and their factor beyond what the goal allows.
_DWELLS, _BEYOND = 13, 4.0


@dataclass(frozen=True, kw_only=True)
class Trade:
    """Errors of one instrument for several dwell times and frequency sets."""

    error: Floats
    """Total error at the worst required distance [m].

    Not exceeded in the required share of draws; infinite where intervals go wrong too
    often or the detector is overloaded.
    """
    scan_time: Floats
    """Time for all pixels or survey lines [s]."""
    top_frequency: Floats
    """Highest modulation frequency of the set [Hz]."""
    best: int
    """Index of the recommended combination."""


def trade(goal: Goal, chosen: Parameters, *, draws: int = 24) -> Trade:
    """Evaluate an instrument with other dwell times and frequency sets."""
    box = box_values(goal.components.dwell)
    dwells = np.geomspace(box[0] / _BEYOND, box[-1] * _BEYOND, _DWELLS)
    dwells = np.unique(np.append(dwells, chosen.dwell))
    top = laser_of(goal, chosen.laser).top_frequency or np.inf
    modulation = goal.components.modulation
    frequencies = [frequency for frequency in frequency_grid(goal) if frequency <= top]
    if modulation.sets:
        sets = {
            frequency_set
            for frequency_set in modulation.sets
            if frequency_set[-1] <= top
        }
    else:
        sets = {(frequency,) for frequency in frequencies}
        if modulation.most > 1:
            # Pairs of neighboring frequencies have long ambiguity intervals.
            sets |= set(itertools.pairwise(frequencies))
            low = chosen.frequencies[0]
            if len(chosen.frequencies) > 1:
                sets |= {
                    (low, frequency) for frequency in frequencies if frequency > low
                }
    sets.add(chosen.frequencies)
    listed = sorted(
        sets,
        key=lambda frequency_set: (
            frequency_set[-1],
            len(frequency_set),
            frequency_set,
        ),
    )
    grid = replace(grid_of(chosen), dwell=tuple(map(float, dwells)), sets=tuple(listed))
    judge = Judge(goal, chosen.laser, draws=draws)
    score = judge.score(grid, chosen)
    usable = (score.output <= 1) & (score.validity <= 1)
    usable &= score.wrong.max(axis=1) <= goal.accuracy.wrong_interval
    return Trade(
        error=np.where(usable, score.error.max(axis=1), np.inf),
        scan_time=np.array(
            [
                scan_time(goal, replace(chosen, dwell=dwell, frequencies=frequency_set))
                for dwell in grid.dwell
                for frequency_set in listed
            ]
        ),
        top_frequency=np.tile(
            [frequency_set[-1] for frequency_set in listed], len(grid.dwell)
        ),
        best=grid.dwell.index(chosen.dwell) * len(listed)
        + listed.index(chosen.frequencies),
    )


#: Factors up and down that are tried [1].
_MOST = 10.0
_STEPS = 4
#: Halvings of the step in which another instrument begins to win.
_HALVINGS = 5


@dataclass(frozen=True, kw_only=True)
class Turn:
    """Assumption, and its value at which the second-best design overtakes the best."""

    label: str
    """Readable name of the assumption."""
    value: float
    """Value in the goal, or the middle of its range, in SI units."""
    unit: str
    """SI unit."""
    turns_at: float | None
    """Nearest value at which the runner-up is better; None if beyond a factor of 10."""
    factor: float | None
    """Ratio of the nearest such value to the goal's value [1]."""


def what_if(
    goal: Goal, best: Parameters, other: Parameters, *, draws: int = 16
) -> tuple[Turn, ...]:
    """Return each assumption with its value at which the other instrument is better.

    Both instruments are ranked as in the search: first those that meet all
    requirements, then by cost if the goal states prices, then by error. One assumption
    is changed at a time, by up to a factor of ten up and down; ranges are scaled as a
    whole. Of several crossings the nearest is returned, to 5 %.
    """
    turns = []
    assumptions = _assumptions(goal, (best, other))
    for number, (label, value, unit, scaled) in enumerate(assumptions):
        _progress.tell(f"what if: {label}", number / len(assumptions))
        factor = _crossing(goal, best, other, scaled, draws)
        turns.append(
            Turn(
                label=label,
                value=value,
                unit=unit,
                turns_at=None if factor is None else value * factor,
                factor=factor,
            )
        )
    return tuple(
        sorted(
            turns,
            key=lambda turn: (
                math.inf if turn.factor is None else abs(math.log(turn.factor))
            ),
        )
    )


def _crossing(
    goal: Goal,
    best: Parameters,
    other: Parameters,
    scaled: Callable[[float], Goal | None],
    draws: int,
) -> float | None:
    """Smallest change, as a factor, that makes the other instrument better, or None."""

    def wins(logarithm: float) -> bool | None:
        changed = scaled(math.exp(logarithm))
        return None if changed is None else _wins(changed, best, other, draws)

    if wins(0.0):
        # With fewer draws the two may be as good; then nothing has to change.
        return 1.0
    step = math.log(_MOST) / _STEPS
    for number in range(1, _STEPS + 1):
        for side in (1, -1):
            far = side * number * step
            if not wins(far):
                continue
            near = side * (number - 1) * step
            for _ in range(_HALVINGS):
                middle = (near + far) / 2
                if wins(middle):
                    far = middle
                else:
                    near = middle
            return math.exp(far)
    return None


def _wins(goal: Goal, best: Parameters, other: Parameters, draws: int) -> bool:
    """Whether the other instrument is better than the recommended one."""
    return _key(goal, other, draws) < _key(goal, best, draws)


def _key(goal: Goal, chosen: Parameters, draws: int) -> tuple[bool, float, float]:
    score = Judge(goal, chosen.laser, draws=draws).of(chosen)
    merit = float(merits(goal, score)[0])
    done = merit <= 0
    priced = any(
        laser.price or laser.price_per_watt for laser in goal.components.lasers
    )
    return not done, cost_of(goal, chosen) if priced and done else 0.0, merit


def _assumptions(
    goal: Goal, chosen: tuple[Parameters, ...]
) -> list[tuple[str, float, str, Callable[[float], Goal | None]]]:
    """Label, value, unit and scaling function of each assumption in a goal."""
    rows: list[tuple[str, float, str, Callable[[float], Goal | None]]] = []

    def number(label: str, part: str, name: str, unit: str, most: float) -> None:
        holder = getattr(goal, part)
        value = 0.0 if holder is None else float(getattr(holder, name))
        if value <= 0:
            return

        def scaled(factor: float) -> Goal | None:
            if value * factor > most:
                return None
            changed = holder.model_copy(update={name: value * factor})
            return goal.model_copy(update={part: changed})

        rows.append((label, value, unit, scaled))

    def spread(label: str, part: str, name: str, unit: str, most: float) -> None:
        holder = getattr(goal, part)
        limits: Any = getattr(holder, name)
        if limits is None or limits.low <= 0:
            return

        def scaled(factor: float) -> Goal | None:
            if limits.high * factor > most:
                return None
            wider = limits.model_copy(
                update={"low": limits.low * factor, "high": limits.high * factor}
            )
            changed = holder.model_copy(update={name: wider})
            return goal.model_copy(update={part: changed})

        rows.append((label, middle(limits), unit, scaled))

    far = math.inf
    spread("attenuation of the water", "waters", "attenuation", "1/m", far)
    spread("absorption of the water", "waters", "absorption", "1/m", far)
    spread("scattering of the water", "waters", "scattering", "1/m", far)
    spread("fluctuation of the water signal", "waters", "fluctuation", "1", 1.0)
    spread("polarization kept by the water", "waters", "m22", "1", 1.0)
    spread("reflectance of the target", "targets", "reflectance", "1", 1.0)
    spread("polarization kept by the target", "targets", "m22", "1", 1.0)
    spread("texture of the target", "targets", "texture", "1", 1.0)
    number("light that passes the optics", "detector", "optical_transmission", "1", 1.0)
    number("phase floor", "lock_in", "phase_floor", "rad", 1.0)
    number("dark counts", "detector", "dark_rate", "1/s", far)
    number("daylight", "daylight", "radiance", "W/(m2 sr m)", far)
    part_name = "assumptions"
    methods = {method.method for method in chosen}
    # What neither method depends on turns nothing.
    used = {name for method in methods for name in PREDICTED[method].assumptions}
    for label, name in (
        ("change of the water since the shots", "water_change"),
        ("water behind the target", "column_uncertainty"),
        ("depolarization ratio of the water", "ratio_uncertainty"),
        ("departure of the water from its model", "departure"),
    ):
        if name in used:
            number(label, part_name, name, "1", 1.0)
    number("accuracy that is asked for", "accuracy", "total_error", "m", far)
    return rows
