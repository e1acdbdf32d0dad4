"""Search for the best instrument: grid, frequency exchange, refinement, lower price."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor._progress import tell
from amulor.design.candidates import (
    Parameters,
    box_values,
    cost_of,
    fits,
    frequency_grid,
    laser_of,
    longest_dwell,
    readings_of,
)
from amulor.design.goal import Box, Goal
from amulor.design.scores import Grid, Judge, Score, grid_of, merits

__all__ = [
    "Candidate",
    "SearchResult",
    "allowed",
    "candidate_of",
    "cheaper",
    "exchanged",
    "search",
]


#: Improvement of the logarithm of the error below which a step is none.
_GAIN = 1e-6
#: Most steps of the exchange.
_EXCHANGES = 12


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """Candidate instrument with its score."""

    parameters: Parameters
    """Parameters of the instrument."""
    score: Score
    """Score with arrays of one candidate."""
    merit: float
    """Figure of merit, smaller is better."""


def allowed(
    sets: tuple[tuple[float, ...], ...], top: float | None
) -> tuple[tuple[float, ...], ...]:
    """Return frequency sets within a laser's limit, else the set of lowest maximum."""
    good = tuple(members for members in sets if top is None or max(members) <= top)
    return good or (min(sets, key=max),)


def candidate_of(judge: Judge, chosen: Parameters) -> Candidate:
    """Score an instrument in the random waters and at the distances of a judge."""
    score = judge.of(chosen)
    return Candidate(
        parameters=chosen,
        score=score,
        merit=float(merits(judge.goal, score)[0]),
    )


def exchanged(goal: Goal, judge: Judge, start: Candidate) -> tuple[Candidate, int]:
    """Change single frequencies while merit improves; return best and trial count."""
    modulation = goal.components.modulation
    if modulation.sets:
        return start, 0
    frequencies = _single_frequencies(goal, start.parameters)
    joint = start.parameters.method == "joint"
    all_frequencies = replace(
        grid_of(start.parameters), sets=tuple((t,) for t in frequencies)
    )
    lighting = judge.lit(all_frequencies, joint=joint)
    best, tried = start, 0
    for _ in range(_EXCHANGES):
        sets = _neighbours(best.parameters.frequencies, frequencies, modulation.most)
        grid = replace(
            grid_of(best.parameters),
            dwell=_dwells(goal, best.parameters, sets),
            sets=sets,
        )
        score = judge.score(grid, best.parameters, lighting=lighting)
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
    now: tuple[float, ...], frequencies: tuple[float, ...], most: int
) -> tuple[tuple[float, ...], ...]:
    """Return a frequency set, and sets with one frequency added, changed or removed."""
    sets = [now]
    for frequency in frequencies:
        if frequency in now:
            continue
        if len(now) < most:
            sets.append(tuple(sorted((*now, frequency))))
        sets += [
            tuple(sorted((*now[:k], frequency, *now[k + 1 :]))) for k in range(len(now))
        ]
    if len(now) > 1:
        sets += [(*now[:k], *now[k + 1 :]) for k in range(len(now))]
    return tuple(dict.fromkeys(sets))


def _dwells(
    goal: Goal, like: Parameters, sets: tuple[tuple[float, ...], ...]
) -> tuple[float, ...]:
    """Available dwell times, and those that use the whole allowed scan time."""
    box = goal.components.dwell
    values = {like.dwell, *box_values(box)}
    if not box.values and box.low is not None and box.high is not None:
        for members in {len(members): members for members in sets}.values():
            fitting = longest_dwell(goal, replace(like, frequencies=members))
            if box.low <= fitting <= box.high:
                values.add(fitting)
    return tuple(sorted(values))


def cheaper(goal: Goal, judge: Judge, start: Candidate) -> tuple[Candidate, int]:
    """Exchange parts for cheaper ones while the goal is met; return best and trials."""
    best, tried = start, 0
    for _ in range(_EXCHANGES):
        candidates: list[Candidate] = []
        for grid in _cheaper_grids(goal, best.parameters):
            score = judge.score(grid, best.parameters)
            tried += len(score.time)
            merit = merits(goal, score)
            good = np.flatnonzero((merit <= 0) & (score.cost < best.score.cost[0]))
            if good.size:
                at = int(good[np.lexsort((merit[good], score.cost[good]))[0]])
                candidates.append(
                    Candidate(
                        parameters=grid.parameters(at, best.parameters),
                        score=score.part(np.array([at])),
                        merit=float(merit[at]),
                    )
                )
        if not candidates:
            break
        best = min(
            candidates,
            key=lambda candidate: (float(candidate.score.cost[0]), candidate.merit),
        )
    return best, tried


def _cheaper_grids(goal: Goal, chosen: Parameters) -> Iterator[Grid]:
    """Yield grids of cheaper candidates, with one component changed."""
    now = cost_of(goal, chosen)
    frequencies = _single_frequencies(goal, chosen)
    fixed = bool(goal.components.modulation.sets)
    same_size = tuple(
        members
        for members in _neighbours(
            chosen.frequencies, frequencies, len(chosen.frequencies)
        )
        if len(members) == len(chosen.frequencies)
    )
    laser = laser_of(goal, chosen.laser)
    choices = {"power": tuple(sorted(laser.powers))} | {
        name: box_values(getattr(goal.components, name))
        for name in ("baseline", "radius", "field_of_view", "dwell")
    }
    for name, values in choices.items():
        for value in values:
            change: dict[str, Any] = {name: value}
            changed = replace(chosen, **change)
            if cost_of(goal, changed) < now:
                yield _around(
                    goal, changed, (chosen.frequencies,) if fixed else same_size
                )
    fewer = len(chosen.frequencies) - 1
    if fixed or fewer < 1:
        return
    sets: tuple[tuple[float, ...], ...] = tuple(
        (frequency,) for frequency in frequencies
    )
    if fewer > 1:
        sets = tuple(itertools.combinations(chosen.frequencies, fewer))
    changed = replace(chosen, frequencies=sets[0])
    if cost_of(goal, changed) < now:
        yield _around(goal, changed, sets)


def _around(
    goal: Goal, chosen: Parameters, sets: tuple[tuple[float, ...], ...]
) -> Grid:
    """Grid around one instrument: frequency sets, dwell times and fields of view."""
    views = {chosen.field_of_view}
    if not goal.components.field_of_view.prices:
        views |= set(box_values(goal.components.field_of_view))
    return replace(
        grid_of(chosen),
        sets=sets,
        dwell=_dwells(goal, chosen, sets),
        field_of_view=tuple(sorted(views)),
    )


def _single_frequencies(goal: Goal, chosen: Parameters) -> tuple[float, ...]:
    """Single modulation frequencies within the laser's limit [Hz]."""
    top = laser_of(goal, chosen.laser).top_frequency
    return tuple(t for (t,) in allowed(tuple((f,) for f in frequency_grid(goal)), top))


Floats = NDArray[np.float64]

#: Draws and distances for judging the grid, before the best are judged with all.
_FEW_DRAWS, _FEW_DISTANCES = 8, 3
#: Number of best candidates of each laser, scheme and method whose frequencies are
#: exchanged.
_STARTS = 2
#: Steps of the refinement, and the number of random waters that it uses.
_STEPS, _REFINED_DRAWS = 70, 24


@dataclass(frozen=True, kw_only=True)
class SearchResult:
    """Result of a design search."""

    best: tuple[Candidate, ...]
    """Best distinct candidates, in order of merit."""
    count: int
    """Number of candidates evaluated."""

    def all_scores(self) -> Score:
        """Scores of the best candidates at their worst distance, concatenated."""
        return Score.joined([_worst(candidate.score) for candidate in self.best])


def search(goal: Goal) -> SearchResult:
    """Search for the best instruments of a goal.

    All combinations on a grid are evaluated in few random waters, with single
    frequencies or the stated sets. Starting from the best of each laser, scheme and
    method, frequencies are added, dropped or exchanged, with suitable dwell times, as
    long as the merit improves. The best are refined within their ranges by the method
    of Nelder and Mead.
    """
    lasers = [laser.name for laser in goal.components.lasers]
    judges = {name: Judge(goal, name) for name in lasers}
    begun: list[Candidate] = []
    count = 0
    for number, laser in enumerate(lasers):
        tell(f"all combinations with {laser}", 0.4 * number / len(lasers))
        for grid, score, like in _grids(goal, laser):
            count += len(score.time)
            starts = _starts(goal, grid, score, like)
            begun += [candidate_of(judges[laser], parameters) for parameters in starts]
    begun = _unique(begun)
    better_sets = []
    for number, candidate in enumerate(begun):
        tell("exchanging frequencies", 0.4 + 0.3 * number / len(begun))
        better, tried = exchanged(goal, judges[candidate.parameters.laser], candidate)
        better_sets.append(better)
        count += tried
    ranked = _ordered(goal, _unique([*better_sets, *begun]))
    refined = []
    chosen = ranked[: goal.effort.refined]
    for number, candidate in enumerate(chosen):
        tell("refining the best", 0.7 + 0.3 * number / len(chosen))
        judge = judges[candidate.parameters.laser]
        better, tried = _refined(goal, judge, candidate)
        refined.append(better)
        count += tried
        if _priced(goal) and better.merit <= 0:
            cheap, tried = cheaper(goal, judge, better)
            count += tried
            if cheap is not better:
                better, tried = _refined(goal, judge, cheap)
                refined.append(better)
                count += tried
    return SearchResult(
        best=tuple(_ordered(goal, _unique([*refined, *ranked]))),
        count=count,
    )


def _worst(score: Score) -> Score:
    """Score with each candidate's largest error and wrong-interval probability."""
    return replace(
        score,
        error=score.error.max(axis=1, keepdims=True),
        wrong=score.wrong.max(axis=1, keepdims=True),
    )


def _grids(goal: Goal, laser: str) -> Iterator[tuple[Grid, Score, Parameters]]:
    """Yield the scored grid of one laser: channels, method and order of readings."""
    distances = goal.asked
    indices = np.unique(np.linspace(0, len(distances) - 1, _FEW_DISTANCES).astype(int))
    judge = Judge(
        goal, laser, draws=_FEW_DRAWS, distances=[distances[k] for k in indices]
    )
    grid = _grid(goal, laser)
    combinations = list(dict.fromkeys(fits(goal)))
    lighting = judge.lit(grid, joint=any(m == "joint" for _, m in combinations))
    for (scheme, method), readings in itertools.product(
        combinations, readings_of(goal)
    ):
        like = replace(
            judge.start, polarization=scheme, method=method, readings=readings
        )
        yield grid, judge.score(grid, like, lighting=lighting), like


def _grid(goal: Goal, laser: str) -> Grid:
    """Parameter grid of one laser, with the goal's sets or single frequencies."""
    parts = goal.components
    source = laser_of(goal, laser)
    sets = parts.modulation.sets or tuple((f,) for f in frequency_grid(goal))
    return Grid(
        baseline=box_values(parts.baseline),
        radius=box_values(parts.radius),
        field_of_view=box_values(parts.field_of_view),
        power=tuple(sorted(source.powers)),
        dwell=box_values(parts.dwell),
        sets=allowed(sets, source.top_frequency),
    )


def _starts(goal: Goal, grid: Grid, score: Score, like: Parameters) -> list[Parameters]:
    """Choose starting candidates: the best, and the cheapest that meet the goal."""
    chosen: list[int] = []
    alone = not goal.components.modulation.sets and goal.components.modulation.most > 1
    for with_intervals in (True, False) if alone else (True,):
        merit = merits(goal, score, with_intervals=with_intervals)
        chosen += [int(k) for k in np.argsort(merit, kind="stable")[:_STARTS]]
        if _priced(goal):
            good = np.flatnonzero(merit <= 0)
            order = np.lexsort((merit[good], score.cost[good]))
            chosen += [int(k) for k in good[order[:_STARTS]]]
    return [grid.parameters(k, like) for k in dict.fromkeys(chosen)]


def _priced(goal: Goal) -> bool:
    """Whether the goal states any price."""
    parts = goal.components
    prices = [parts.price_per_channel, parts.modulation.price_each]
    prices += [laser.price + laser.price_per_watt for laser in parts.lasers]
    boxes = (parts.baseline, parts.radius, parts.field_of_view, parts.dwell)
    return any(prices) or any(box.prices for box in boxes)


def _unique(candidates: list[Candidate]) -> list[Candidate]:
    """List of candidates without duplicates."""
    return list({candidate.parameters: candidate for candidate in candidates}.values())


def _ordered(goal: Goal, candidates: list[Candidate]) -> list[Candidate]:
    """Sort candidates: by price if all requirements are met, the others by merit."""
    priced = _priced(goal)

    def key(candidate: Candidate) -> tuple[bool, float, float]:
        done = candidate.merit <= 0
        return (
            not done,
            float(candidate.score.cost[0]) if priced and done else 0.0,
            candidate.merit,
        )

    return sorted(candidates, key=key)


def _refined(goal: Goal, judge: Judge, start: Candidate) -> tuple[Candidate, int]:
    """Optimize a candidate's parameters; return the better one and trial count."""
    from scipy.optimize import minimize

    names, low, high = _ranges(goal, start.parameters)
    if not names:
        return start, 0
    lowest, widest = np.log(low), np.log(high) - np.log(low)
    quick = Judge(goal, start.parameters.laser, draws=_REFINED_DRAWS)

    def at(place: tuple[float, ...]) -> Parameters:
        values = np.exp(lowest + widest * np.clip(place, 0.0, 1.0))
        values = np.clip(values, low, high)  # against rounding at the ends
        return _with(start.parameters, names, tuple(map(float, values)))

    @cache
    def merit(place: tuple[float, ...]) -> float:
        chosen = at(place)
        if len(set(chosen.frequencies)) < len(chosen.frequencies):
            return 1e3
        return float(merits(goal, quick.of(chosen))[0])

    now = np.array([_value(start.parameters, name) for name in names])
    begin = np.clip((np.log(now) - lowest) / widest, 0.0, 1.0)
    # Steps lead away from the nearer edge.
    simplex = np.vstack([begin, begin + np.diag(np.where(begin < 0.5, 0.1, -0.1))])
    result = minimize(
        lambda place: merit(tuple(np.clip(place, 0.0, 1.0))),
        begin,
        method="Nelder-Mead",
        bounds=[(0.0, 1.0)] * len(names),
        options={
            "initial_simplex": simplex,
            "maxfev": _STEPS,
            "xatol": 3e-3,
            "fatol": 1e-3,
        },
    )
    better = candidate_of(judge, at(tuple(result.x)))
    return min(better, start, key=lambda candidate: candidate.merit), int(result.nfev)


def _ranges(goal: Goal, chosen: Parameters) -> tuple[list[str], Floats, Floats]:
    """Names, lower and upper limits of the parameters that refinement may change."""
    limits: list[tuple[str, float, float]] = []
    for name in ("baseline", "radius", "field_of_view", "dwell"):
        box: Box = getattr(goal.components, name)
        if box.low is not None and box.high is not None:
            limits.append((name, box.low, box.high))
    modulation = goal.components.modulation
    if modulation.lowest is not None and modulation.highest is not None:
        top = laser_of(goal, chosen.laser).top_frequency or modulation.highest
        # A laser that cannot be modulated so fast has been given the lowest frequency.
        highest = max(min(modulation.highest, top), chosen.frequencies[-1])
        limits += [
            (f"frequencies.{k}", modulation.lowest, highest)
            for k in range(len(chosen.frequencies))
        ]
    names, low, high = zip(*limits, strict=True) if limits else ((), (), ())
    return list(names), np.array(low), np.array(high)


def _value(chosen: Parameters, name: str) -> float:
    """Value of a parameter, or of one frequency, by its name."""
    field, _, number = name.partition(".")
    value = getattr(chosen, field)
    return float(value[int(number)]) if number else float(value)


def _with(
    chosen: Parameters, names: list[str], values: tuple[float, ...]
) -> Parameters:
    """Copy of the parameters with some values replaced."""
    changes: dict[str, Any] = {}
    frequencies = list(chosen.frequencies)
    for name, value in zip(names, values, strict=True):
        field, _, number = name.partition(".")
        if number:
            frequencies[int(number)] = value
        else:
            changes[field] = value
    return replace(chosen, **changes, frequencies=tuple(sorted(frequencies)))
