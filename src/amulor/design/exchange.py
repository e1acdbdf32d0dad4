"""Exchange of modulation frequencies, and of parts for cheaper ones."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from amulor.design.candidates import (
    Parameters,
    box_values,
    cost_of,
    frequency_grid,
    laser_of,
)
from amulor.design.goal import Goal
from amulor.design.scores import Grid, Judge, Score, grid_of, merits

__all__ = ["Candidate", "allowed", "candidate_of", "cheaper", "exchanged"]

#: Improvement of the logarithm of the error below which a step is none.
_GAIN = 1e-6
#: Most steps of the exchange.
_EXCHANGES = 12


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """One instrument with its figures in all draws at all distances."""

    parameters: Parameters
    """What it is made of."""
    score: Score
    """Its figures; arrays of one candidate."""
    merit: float
    """What it is ordered by."""


def allowed(
    sets: tuple[tuple[float, ...], ...], top: float | None
) -> tuple[tuple[float, ...], ...]:
    """Return the sets that a laser can be modulated with; the lowest if none is.

    Parameters
    ----------
    sets : tuple of tuples of float
        Sets of frequencies [Hz].
    top : float or None
        Highest frequency of the laser [Hz].

    Returns
    -------
    tuple of tuples of float
        One at least.
    """
    good = tuple(one for one in sets if top is None or max(one) <= top)
    return good or (min(sets, key=max),)


def candidate_of(judge: Judge, chosen: Parameters) -> Candidate:
    """Return a candidate, judged in all draws at all distances.

    Parameters
    ----------
    judge : Judge
        Of its laser.
    chosen : Parameters
        The instrument.

    Returns
    -------
    Candidate
        With its figures.
    """
    score = judge.of(chosen)
    return Candidate(
        parameters=chosen,
        score=score,
        merit=float(merits(judge.goal, score)[0]),
    )


def exchanged(goal: Goal, judge: Judge, start: Candidate) -> tuple[Candidate, int]:
    """Return what exchanging frequencies makes of a candidate.

    Parameters
    ----------
    goal : Goal
        Frequencies and dwell times to choose from.
    judge : Judge
        Of the laser of the candidate.
    start : Candidate
        Where the exchange begins.

    Returns
    -------
    candidate : Candidate
        The start, if no exchange makes it better.
    count : int
        How many were looked at.
    """
    modulation = goal.components.modulation
    if modulation.sets:
        return start, 0
    tones = _tones(goal, start.parameters)
    joint = start.parameters.method == "joint"
    whole = replace(grid_of(start.parameters), sets=tuple((t,) for t in tones))
    known = judge.lit(whole, joint=joint)
    best, tried = start, 0
    for _ in range(_EXCHANGES):
        sets = _neighbours(best.parameters.frequencies, tones, modulation.most)
        grid = replace(
            grid_of(best.parameters),
            dwell=_dwells(goal, best.parameters, sets),
            sets=sets,
        )
        score = judge.score(
            grid,
            scheme=best.parameters.polarization,
            method=best.parameters.method,
            known=known,
        )
        tried += len(score.time)
        merit = merits(goal, score)
        at = int(np.argmin(merit))
        if not merit[at] < best.merit - _GAIN:
            break
        best = Candidate(
            parameters=grid.parameters(at, best.parameters),
            score=score.part(np.array([at])),
            merit=float(merit[at]),
        )
    return best, tried


def _neighbours(
    now: tuple[float, ...], tones: tuple[float, ...], most: int
) -> tuple[tuple[float, ...], ...]:
    """Return sets with one frequency added, dropped or exchanged, and this one."""
    found = [now]
    for tone in tones:
        if tone in now:
            continue
        if len(now) < most:
            found.append(tuple(sorted((*now, tone))))
        found += [
            tuple(sorted((*now[:k], tone, *now[k + 1 :]))) for k in range(len(now))
        ]
    if len(now) > 1:
        found += [(*now[:k], *now[k + 1 :]) for k in range(len(now))]
    return tuple(dict.fromkeys(found))


def _dwells(
    goal: Goal, like: Parameters, sets: tuple[tuple[float, ...], ...]
) -> tuple[float, ...]:
    """Return dwell times to choose from, those that just fit the time among them."""
    box = goal.components.dwell
    values = {like.dwell, *box_values(box)}
    if not box.values and box.low is not None and box.high is not None:
        pixels = goal.scan.rows * goal.scan.columns
        channels = len(like.polarization.split("+"))
        for count in {len(one) for one in sets}:
            fitting = goal.scan.longest / (pixels * channels * count)
            if box.low <= fitting <= box.high:
                values.add(fitting)
    return tuple(sorted(values))


def cheaper(goal: Goal, judge: Judge, start: Candidate) -> tuple[Candidate, int]:
    """Return the cheapest candidate that meets all, a part exchanged at a time.

    Parameters
    ----------
    goal : Goal
        Its prices count.
    judge : Judge
        Of the laser of the candidate.
    start : Candidate
        One that meets all requirements.

    Returns
    -------
    candidate : Candidate
        The start, if nothing cheaper meets all.
    count : int
        How many were looked at.
    """
    best, tried = start, 0
    for _ in range(_EXCHANGES):
        found: list[Candidate] = []
        for grid in _cheaper_grids(goal, best.parameters):
            score = judge.score(
                grid,
                scheme=best.parameters.polarization,
                method=best.parameters.method,
            )
            tried += len(score.time)
            merit = merits(goal, score)
            good = np.flatnonzero((merit <= 0) & (score.cost < best.score.cost[0]))
            if good.size:
                at = int(good[np.lexsort((merit[good], score.cost[good]))[0]])
                found.append(
                    Candidate(
                        parameters=grid.parameters(at, best.parameters),
                        score=score.part(np.array([at])),
                        merit=float(merit[at]),
                    )
                )
        if not found:
            break
        best = min(found, key=lambda one: (float(one.score.cost[0]), one.merit))
    return best, tried


def _cheaper_grids(goal: Goal, chosen: Parameters) -> Iterator[Grid]:
    """Yield candidates that cost less: one part changed, other frequencies, dwells."""
    now = cost_of(goal, chosen)
    tones = _tones(goal, chosen)
    fixed = bool(goal.components.modulation.sets)
    same = tuple(
        one
        for one in _neighbours(chosen.frequencies, tones, len(chosen.frequencies))
        if len(one) == len(chosen.frequencies)
    )
    laser = laser_of(goal, chosen.laser)
    choices = {"power": tuple(sorted(laser.powers))} | {
        name: box_values(getattr(goal.components, name))
        for name in ("baseline", "radius", "field_of_view", "dwell")
    }
    for name, values in choices.items():
        for value in values:
            change: dict[str, Any] = {name: value}
            other = replace(chosen, **change)
            if cost_of(goal, other) < now:
                yield _around(goal, other, (chosen.frequencies,) if fixed else same)
    fewer = len(chosen.frequencies) - 1
    if fixed or fewer < 1:
        return
    sets: tuple[tuple[float, ...], ...] = tuple((tone,) for tone in tones)
    if fewer > 1:
        sets = tuple(itertools.combinations(chosen.frequencies, fewer))
    other = replace(chosen, frequencies=sets[0])
    if cost_of(goal, other) < now:
        yield _around(goal, other, sets)


def _around(
    goal: Goal, chosen: Parameters, sets: tuple[tuple[float, ...], ...]
) -> Grid:
    """Return a grid of one instrument with several sets, dwells and fields of view."""
    views = {chosen.field_of_view}
    if not goal.components.field_of_view.prices:
        views |= set(box_values(goal.components.field_of_view))
    return replace(
        grid_of(chosen),
        sets=sets,
        dwell=_dwells(goal, chosen, sets),
        field_of_view=tuple(sorted(views)),
    )


def _tones(goal: Goal, chosen: Parameters) -> tuple[float, ...]:
    """Return the single frequencies that a laser can be modulated with [Hz]."""
    top = laser_of(goal, chosen.laser).top_frequency
    return tuple(t for (t,) in allowed(tuple((f,) for f in frequency_grid(goal)), top))
