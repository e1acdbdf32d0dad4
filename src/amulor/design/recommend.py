"""Recommendation of an instrument for a goal, with reasons and limits."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor._progress import listening, tell
from amulor.design import requirements
from amulor.design._kernels import astray
from amulor.design.axes import PREDICTED
from amulor.design.candidates import (
    Parameters,
    box_values,
    cost_of,
    frequency_grid,
    laser_of,
    lines_of,
    scan_time,
    survey_of,
)
from amulor.design.evaluate import TERMS, evaluate
from amulor.design.goal import Goal
from amulor.design.requirements import Requirement, Shortfall
from amulor.design.scores import draws_at
from amulor.design.search import Candidate, SearchResult, search
from amulor.design.vehicle import Lines
from amulor.optics import ranging
from amulor.survey import Survey, water_properties

__all__ = [
    "Between",
    "Bound",
    "Choice",
    "Recommendation",
    "Shares",
    "dwell_shares",
    "recommend",
]


Floats = NDArray[np.float64]

#: Parts that the dwell is divided into.
_PARTS = 20
#: Draws that shares are judged by.
_DRAWS = 16


@dataclass(frozen=True, kw_only=True)
class Shares:
    """Best division of a pixel's dwell time between the frequencies."""

    share: tuple[float, ...]
    """Fraction of the time for each frequency, sum 1 [1]."""
    error: float
    """Total error with the optimum fractions [m]."""
    even: float
    """Total error with equal fractions, as in a survey [m]."""


def dwell_shares(goal: Goal, chosen: Parameters) -> Shares | None:
    """Return the best division of dwell time over 2 or 3 frequencies; None otherwise.

    A vehicle has none, as its frequencies share the time of a pixel or their light.
    Every division into twentieths is evaluated by its error at the worst distance, at
    the required quantile of 16 random waters. Divisions in which a wrong interval is
    too likely are excluded. All biases are assumed to have one sign, so that the error
    is an upper limit. A survey has one dwell for all frequencies; the result shows the
    gain of an instrument with several.
    """
    count = len(chosen.frequencies)
    shared = goal.vehicle is not None
    if shared or not 2 <= count <= 3:
        return None
    if not PREDICTED[chosen.method].separate_frequencies:
        return None
    parts = [
        division
        for division in itertools.product(range(1, _PARTS), repeat=count)
        if sum(division) == _PARTS
    ]
    dwells = np.arange(1, _PARTS) / _PARTS * count * chosen.dwell
    # The filter of the shortest time serves all: a lock-in must settle anew each time.
    errors_of_dwells = evaluate(
        survey_of(goal, chosen),
        frequency=np.array(chosen.frequencies),
        dwell=np.append(dwells, chosen.dwell),
        distance=np.array(goal.asked),
        method=chosen.method,
        **{**goal.assumed, **_draws(goal, chosen)},
    )
    if "draw" not in errors_of_dwells.dims:
        errors_of_dwells = errors_of_dwells.expand_dims("draw")
    order = ("frequency", "dwell", "distance", "draw")
    variance = (errors_of_dwells["standard_uncertainty"] ** 2).transpose(*order).values
    bias = errors_of_dwells["residual_bias"].transpose(*order).values
    index = water_properties(survey_of(goal, chosen)).group_index
    errors = [
        _error(goal, chosen, index, variance, bias, tuple(p - 1 for p in division))
        for division in parts
    ]
    even = _error(goal, chosen, index, variance, bias, (len(dwells),) * count)
    best = int(np.argmin(errors))
    if not errors[best] < even:
        return Shares(share=(1 / count,) * count, error=even, even=even)
    return Shares(
        share=tuple(p / _PARTS for p in parts[best]), error=errors[best], even=even
    )


def _draws(goal: Goal, chosen: Parameters) -> dict[str, xr.DataArray]:
    values_of_draws = draws_at(goal, chosen, _DRAWS)
    return {
        name: xr.DataArray(values, dims="draw")
        for name, values in values_of_draws.items()
    }


def _error(
    goal: Goal,
    chosen: Parameters,
    group_index: float,
    variance: Floats,
    bias: Floats,
    dwell: tuple[int, ...],
) -> float:
    """Range error at the worst distance and required quantile [m]; inf if ambiguous."""
    variances = np.stack([variance[k, number] for k, number in enumerate(dwell)])
    biases = np.stack([bias[k, number] for k, number in enumerate(dwell)])
    weight = 1 / np.maximum(variances, 1e-30)
    total = weight.sum(axis=0)
    error = np.sqrt(1 / total + (np.sum(weight * biases, axis=0) / total) ** 2)
    rank = max(math.ceil(goal.accuracy.share * error.shape[-1] - 1e-9), 1) - 1
    to_range = np.asarray(
        ranging.range_per_phase(np.array(chosen.frequencies), group_index=group_index)
    )
    near, far = goal.limits
    phase = (variances + biases**2) / to_range[:, None, None] ** 2
    for number, distance in enumerate(goal.asked):
        wrong = [
            astray(
                to_range,
                np.ascontiguousarray(phase[:, number, k]),
                0.0,
                distance,
                near,
                far,
            )
            for k in range(error.shape[-1])
        ]
        if sorted(chance for chance, _ in wrong)[rank] > goal.accuracy.wrong_interval:
            return math.inf
    return float(np.sort(error, axis=-1)[:, rank].max())


#: Relative distance within which a value counts as a limit [1].
_EDGE = 2e-3
#: Candidates that a recommendation lists.
_LISTED = 50
#: Number of distances evaluated between the first and the last required one.
_BETWEEN = 41


@dataclass(frozen=True, kw_only=True)
class Between:
    """Largest error over all distances from the nearest to the farthest required.

    The phase between water signal and echo changes with distance. An instrument may
    therefore be accurate at each required distance and inaccurate between them.

    Examples
    --------
    >>> worst = recommend(goal).best.between  # doctest: +SKIP
    >>> print(f"{1e3 * worst.error:.1f} mm at {worst.distance:.1f} m")  # doctest: +SKIP
    """

    distance: float
    """Slant range of the largest error [m]."""
    error: float
    """Total error at the distance, at the required quantile of draws [m]."""


@dataclass(frozen=True, kw_only=True)
class Choice:
    """Proposed instrument, with its requirements and predicted errors.

    Examples
    --------
    >>> best = recommend(goal).best  # doctest: +SKIP
    >>> [one.name for item in best.requirements if not one.met]  # doctest: +SKIP
    """

    parameters: Parameters
    """Parameters of the instrument."""
    survey: str
    """Survey text (TOML) for `amulor simulate`: a plate in median water."""
    requirements: tuple[Requirement, ...]
    """Requirements of the goal, met or missed."""
    terms: dict[str, float]
    """Median of each error term at the worst distance [m]."""
    binding: str
    """Largest error term, or the reason for an unusable range."""
    error: float
    """Total error at the worst required distance, at the required quantile of draws
    [m].
    """
    worst_distance: float
    """Required distance with the largest error [m]."""
    share: float
    """Fraction of draws in which the accuracy is met at all distances [1]."""
    scan_time: float
    """Time for all pixels, or for all survey lines of a vehicle [s]."""
    lines: Lines | None
    """Survey lines of a vehicle; None without a vehicle."""
    cost: float
    """Total price [currency]."""
    shares: Shares | None = None
    """Optimum time per frequency; None for a single frequency."""
    between: Between
    """Largest error between the required distances."""

    @property
    def met(self) -> bool:
        """Whether the instrument meets all requirements."""
        return all(requirement.met for requirement in self.requirements)

    def to_dict(self) -> dict[str, Any]:
        """Return the results as plain numbers, texts and lists, None for infinity."""
        plain: dict[str, Any] = finite(
            {
                "parameters": self.parameters.to_dict(),
                "met": self.met,
                "requirements": [asdict(row) for row in self.requirements],
                "terms": self.terms,
                "binding": self.binding,
                "error": self.error,
                "worst_distance": self.worst_distance,
                "share": self.share,
                "scan_time": self.scan_time,
                "lines": None if self.lines is None else asdict(self.lines),
                "cost": self.cost,
                "shares": None if self.shares is None else asdict(self.shares),
                "between": asdict(self.between),
                "survey": self.survey,
            }
        )
        return plain


@dataclass(frozen=True, kw_only=True)
class Bound:
    """Parameter whose best value lies at a limit set by the goal.

    A value beyond the limit may be better, but was not evaluated.

    Examples
    --------
    >>> for bound in recommend(goal).bounds:  # doctest: +SKIP
    ...     print(bound.text)
    """

    parameter: str
    """Name of the parameter."""
    value: float
    """Value at the limit, in SI units."""
    side: str
    """Side of the limit, "low" or "high"."""
    text: str
    """Message that states the limit."""


@dataclass(frozen=True, kw_only=True)
class Recommendation:
    """Recommended instrument for a goal, with alternatives.

    Examples
    --------
    >>> found = recommend(goal)  # doctest: +SKIP
    >>> Path("wall.toml").write_text(found.best.survey)  # doctest: +SKIP
    """

    goal: Goal
    """Goal of the design."""
    best: Choice
    """Best instrument, or the nearest miss if the goal is impossible."""
    runner_up: Choice | None
    """Best instrument with another laser, scheme, method or number of frequencies; None
    without alternatives.
    """
    bounds: tuple[Bound, ...]
    """Parameters of the best instrument that lie at a limit of the goal."""
    impossible: tuple[Shortfall, ...]
    """Requirements to be relaxed if no candidate meets all.

    Each line alone suffices, unless it says otherwise.
    """
    candidates: xr.Dataset
    """Table of the best candidates, over `candidate`."""
    looked_at: int
    """Number of candidates evaluated."""

    def to_dict(self) -> dict[str, Any]:
        """Return the results as plain numbers, texts and lists, for JSON."""
        return {
            "goal": self.goal.name,
            "possible": not self.impossible,
            "best": self.best.to_dict(),
            "runner_up": None if self.runner_up is None else self.runner_up.to_dict(),
            "bounds": [asdict(item) for item in self.bounds],
            "impossible": [asdict(item) for item in self.impossible],
            "candidates": [
                _plain_row(self.candidates.isel(candidate=number))
                for number in range(self.candidates.sizes["candidate"])
            ],
            "looked_at": self.looked_at,
        }


def finite(value: Any) -> Any:
    """Replace infinite numbers and NaN by None, for JSON."""
    if isinstance(value, dict):
        return {name: finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _plain_row(row: xr.Dataset) -> dict[str, Any]:
    """Row of the candidate table as plain values, with frequencies as a list."""
    frequencies = row["modulation_frequency"].values
    plain = {
        str(name): row[name].item() for name in row if name != "modulation_frequency"
    }
    numbers: dict[str, Any] = finite(plain)
    return {**numbers, "frequencies": frequencies[np.isfinite(frequencies)].tolist()}


def recommend(
    goal: Goal, *, progress: Callable[[str, float], None] | None = None
) -> Recommendation:
    r"""Recommend an instrument for a goal.

    Parameters
    ----------
    goal : Goal
        Required performance, waters, and available components.
    progress : callable, optional
        Function that takes the present step and the completed fraction [1].

    Returns
    -------
    Recommendation
        Best instrument and runner-up, with reasons. Repeated calls give equal results.

    Raises
    ------
    SurveyError
        If no scheme fits a method, or the water is not known at a wavelength.

    Notes
    -----
    The criterion is :math:`\sqrt{\sigma^2 + \beta^2}` of one pixel, with the standard
    uncertainty and the residual bias of `evaluate`. It is taken at the worst required
    distance, at the required quantile of random waters and targets. Wrong intervals,
    saturation, validity of the model, time and budget are requirements; a missed one
    has tenfold weight. If the goal states prices, the cheapest instrument that meets
    all requirements is the best.

    Examples
    --------
    >>> goal = Goal.from_toml("examples/goals/harbour_wall.toml")  # doctest: +SKIP
    >>> found = recommend(goal)  # doctest: +SKIP
    >>> found.best.parameters.frequencies  # doctest: +SKIP
    """
    with nullcontext() if progress is None else listening(progress):
        result = search(goal)
        tell("reasons", 0.98)
        best = result.best[0]
        runner_up = _runner_up(result)
        return Recommendation(
            goal=goal,
            best=_choice(goal, best),
            runner_up=None if runner_up is None else _choice(goal, runner_up),
            bounds=_bounds(goal, best.parameters),
            impossible=(
                ()
                if best.merit <= 0
                else requirements.shortfalls(goal, best, result.all_scores())
            ),
            candidates=_table(goal, result),
            looked_at=result.count,
        )


def _kind(chosen: Parameters) -> tuple[str | int, ...]:
    """Kind of an instrument: laser, channels, method, frequencies, readings in turn."""
    return (
        chosen.laser,
        chosen.polarization,
        chosen.method,
        len(chosen.frequencies),
        chosen.in_turn,
    )


def _runner_up(result: SearchResult) -> Candidate | None:
    """Best candidate of a different kind, else the second best; None if only one."""
    best, *following = result.best
    others = [
        candidate
        for candidate in following
        if _kind(candidate.parameters) != _kind(best.parameters)
    ]
    return next(iter([*others, *following]), None)


def _choice(goal: Goal, candidate: Candidate) -> Choice:
    """Evaluate a candidate: requirements, error terms, optimum dwell times."""
    chosen = candidate.parameters
    survey = survey_of(goal, chosen)
    all_errors = _errors(goal, chosen, survey)
    errors = all_errors.sel(distance=list(goal.asked))
    worst = int(np.argmax(candidate.score.error[0]))
    worst_errors = errors.isel(distance=worst)
    terms = {
        name: float(worst_errors[name].median())
        for name in TERMS
        if name != "saturation"
    }
    met = (
        (errors["total_error"] <= goal.accuracy.total_error)
        & (errors["ambiguous"] == 0)
        & (errors["saturated"] == 0)
        & (errors["model_not_valid"] == 0)
    )
    codes = np.bincount(
        worst_errors["binding_term"].values.ravel(), minlength=len(TERMS)
    )
    return Choice(
        parameters=chosen,
        survey=survey.to_toml(),
        requirements=requirements.table(goal, candidate, errors),
        terms=terms,
        binding=TERMS[int(np.argmax(codes))],
        error=float(candidate.score.error.max()),
        worst_distance=goal.asked[worst],
        share=float(met.all("distance").mean()),
        scan_time=scan_time(goal, chosen),
        lines=lines_of(goal, chosen),
        cost=cost_of(goal, chosen),
        shares=dwell_shares(goal, chosen),
        between=_between(goal, all_errors["total_error"]),
    )


def _errors(goal: Goal, chosen: Parameters, survey: Survey) -> xr.Dataset:
    """Errors of an instrument in random waters, at required distances and between."""
    distance = np.unique(
        [*goal.asked, *np.linspace(goal.asked[0], goal.asked[-1], _BETWEEN)]
    )
    draws = {
        name: xr.DataArray(values, dims="draw")
        for name, values in draws_at(goal, chosen).items()
    }
    errors = evaluate(
        survey,
        distance=distance,
        method=chosen.method,
        interval=goal.limits,
        wrong_interval=goal.accuracy.wrong_interval,
        **{**goal.assumed, **draws},
    )
    return errors if "draw" in errors.dims else errors.expand_dims("draw")


def _between(goal: Goal, errors: xr.DataArray) -> Between:
    """Largest error over all distances, at the required quantile of random waters."""
    # The value not exceeded in the required share of draws, as in the search.
    error = errors.quantile(goal.accuracy.share, "draw", method="inverted_cdf")
    worst = error.isel(distance=int(error.argmax("distance")))
    return Between(distance=float(worst["distance"]), error=float(worst))


def _bounds(goal: Goal, chosen: Parameters) -> tuple[Bound, ...]:
    """Parameters of an instrument that lie at a limit of the goal."""
    parts = goal.components
    laser = laser_of(goal, chosen.laser)
    edges: list[tuple[str, float, tuple[float, ...]]] = [
        ("power", chosen.power, tuple(sorted(laser.powers))),
        *(
            (name, getattr(chosen, name), box_values(getattr(parts, name)))
            for name in ("baseline", "radius", "field_of_view", "dwell")
        ),
    ]
    if not parts.modulation.sets:
        frequencies = frequency_grid(goal)
        top = min(frequencies[-1], laser.top_frequency or math.inf)
        allowed = (*(t for t in frequencies if t < top), top)
        edges += [
            ("lowest frequency", chosen.frequencies[0], allowed),
            ("highest frequency", chosen.frequencies[-1], allowed),
        ]
    bounds = []
    for name, value, values in edges:
        if len(values) < 2:
            continue
        for side, edge in (("low", values[0]), ("high", values[-1])):
            if abs(value - edge) > _EDGE * edge:
                continue
            if (name, side) in (("lowest frequency", "high"),) and len(
                chosen.frequencies
            ) > 1:
                continue
            bounds.append(
                Bound(
                    parameter=name,
                    value=value,
                    side=side,
                    text=f"{name} is the {'lowest' if side == 'low' else 'highest'} "
                    f"that the goal allows ({requirements.written(name, value)}): a "
                    "bound, not a recommendation; the best value may lie beyond",
                )
            )
    return tuple(bounds)


def _table(goal: Goal, result: SearchResult) -> xr.Dataset:
    """Best candidates as a table in a Dataset."""
    listed = result.best[:_LISTED]
    most = max(len(candidate.parameters.frequencies) for candidate in listed)
    frequencies = np.full((len(listed), most), np.nan)
    for number, candidate in enumerate(listed):
        frequencies[number, : len(candidate.parameters.frequencies)] = (
            candidate.parameters.frequencies
        )
    names = ("laser", "polarization", "method", "readings")
    units = {
        "power": "W",
        "baseline": "m",
        "radius": "m",
        "field_of_view": "rad",
        "dwell": "s",
    }
    variables: dict[str, Any] = {
        name: (
            "candidate",
            [getattr(candidate.parameters, name) for candidate in listed],
        )
        for name in names
    }
    for name, unit in units.items():
        values = [getattr(candidate.parameters, name) for candidate in listed]
        variables[name] = ("candidate", values, {"units": unit})
    figures = {
        "error": ("m", [float(candidate.score.error.max()) for candidate in listed]),
        "wrong_interval": (
            "1",
            [float(candidate.score.wrong.max()) for candidate in listed],
        ),
        "scan_time": ("s", [float(candidate.score.time[0]) for candidate in listed]),
        "cost": ("1", [float(candidate.score.cost[0]) for candidate in listed]),
        "merit": ("1", [candidate.merit for candidate in listed]),
    }
    for name, (unit, values) in figures.items():
        variables[name] = ("candidate", values, {"units": unit})
    variables["modulation_frequency"] = (
        ("candidate", "frequency_number"),
        frequencies,
        {"units": "Hz"},
    )
    return xr.Dataset(variables, attrs={"title": goal.name})
