"""The recommendation: what to build, why, what stands at an edge, what must give."""

from __future__ import annotations

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
from amulor.design.candidates import (
    Parameters,
    box_values,
    cost_of,
    frequency_grid,
    laser_of,
    scan_time,
    survey_of,
)
from amulor.design.evaluate import TERMS, evaluate
from amulor.design.goal import Goal
from amulor.design.requirements import Requirement, Shortfall
from amulor.design.scores import draws_at
from amulor.design.search import Candidate, Found, search
from amulor.design.shares import Shares, dwell_shares
from amulor.survey import Survey

__all__ = ["Between", "Bound", "Choice", "Recommendation", "recommend"]

Floats = NDArray[np.float64]

#: Relative distance to an edge up to which a value counts as the edge [1].
_EDGE = 2e-3
#: Candidates that a recommendation lists.
_LISTED = 50
#: Distances that are looked at between the first and the last asked one.
_BETWEEN = 41


@dataclass(frozen=True, kw_only=True)
class Between:
    """Where the error is largest from the nearest to the farthest asked distance.

    The phase of the water against that of the target turns with distance, so an
    instrument can be good at each asked distance and not between them.

    Examples
    --------
    >>> worst = recommend(goal).best.between  # doctest: +SKIP
    >>> print(f"{1e3 * worst.error:.1f} mm at {worst.distance:.1f} m")  # doctest: +SKIP
    """

    distance: float
    """Slant range [m]."""
    error: float
    """Total error there, as the asked share of draws reaches it [m]."""


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One instrument that is proposed, with all that speaks for and against it.

    Examples
    --------
    >>> best = recommend(goal).best  # doctest: +SKIP
    >>> [one.name for one in best.requirements if not one.met]  # doctest: +SKIP
    """

    parameters: Parameters
    """What it is made of."""
    survey: str
    """Survey of it (TOML) that `amulor simulate` takes: a plate in median water."""
    requirements: tuple[Requirement, ...]
    """Each requirement, met or not."""
    terms: dict[str, float]
    """Median of each term of the error at the worst distance [m]."""
    binding: str
    """The largest of them, or what makes the range unusable."""
    error: float
    """Total error at the worst asked distance, as the asked share of draws reaches it
    [m]."""
    worst_distance: float
    """That distance [m]."""
    share: float
    """Share of the draws in which the accuracy is met at all distances [1]."""
    scan_time: float
    """Time of all pixels [s]."""
    cost: float
    """Sum of prices [currency]."""
    shares: Shares | None = None
    """How the time would best be shared between the frequencies; None for one."""
    between: Between
    """Where the error is largest between the asked distances."""

    @property
    def met(self) -> bool:
        """Whether all requirements are met."""
        return all(one.met for one in self.requirements)

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, texts and lists; None for what has no limit."""
        plain: dict[str, Any] = finite(
            {
                "parameters": self.parameters.to_dict(),
                "met": self.met,
                "requirements": [asdict(one) for one in self.requirements],
                "terms": self.terms,
                "binding": self.binding,
                "error": self.error,
                "worst_distance": self.worst_distance,
                "share": self.share,
                "scan_time": self.scan_time,
                "cost": self.cost,
                "shares": None if self.shares is None else asdict(self.shares),
                "between": asdict(self.between),
                "survey": self.survey,
            }
        )
        return plain


@dataclass(frozen=True, kw_only=True)
class Bound:
    """A parameter whose best value is the last one that the goal allows.

    It is no recommendation: what lies beyond was not looked at.

    Examples
    --------
    >>> for bound in recommend(goal).bounds:  # doctest: +SKIP
    ...     print(bound.text)
    """

    parameter: str
    """Which one."""
    value: float
    """The edge, in SI units."""
    side: str
    """Whether it is the "low" or the "high" one."""
    text: str
    """The same as a sentence."""


@dataclass(frozen=True, kw_only=True)
class Recommendation:
    """What to build for a goal.

    Examples
    --------
    >>> found = recommend(goal)  # doctest: +SKIP
    >>> Path("wall.toml").write_text(found.best.survey)  # doctest: +SKIP
    """

    goal: Goal
    """What was asked."""
    best: Choice
    """The best instrument; if the goal is impossible the one that comes nearest."""
    runner_up: Choice | None
    """The best one with another laser, scheme, method or number of frequencies; None
    if there is none to choose."""
    bounds: tuple[Bound, ...]
    """Parameters of the best one at an edge of what may be chosen."""
    impossible: tuple[Shortfall, ...]
    """What must give, if no candidate meets all; each line alone would do, or all
    together where that is said."""
    candidates: xr.Dataset
    """The best candidates, over `candidate`."""
    looked_at: int
    """How many candidates were judged."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, texts and lists, as for JSON."""
        return {
            "goal": self.goal.name,
            "possible": not self.impossible,
            "best": self.best.to_dict(),
            "runner_up": None if self.runner_up is None else self.runner_up.to_dict(),
            "bounds": [asdict(one) for one in self.bounds],
            "impossible": [asdict(one) for one in self.impossible],
            "candidates": [
                _plain_row(self.candidates.isel(candidate=number))
                for number in range(self.candidates.sizes["candidate"])
            ],
            "looked_at": self.looked_at,
        }


def finite(value: Any) -> Any:
    """Return tables and lists with None for numbers that are not finite, as JSON."""
    if isinstance(value, dict):
        return {name: finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _plain_row(row: xr.Dataset) -> dict[str, Any]:
    """Return one row of the table of candidates, its frequencies as a list."""
    frequencies = row["modulation_frequency"].values
    plain = {
        str(name): row[name].item() for name in row if name != "modulation_frequency"
    }
    found: dict[str, Any] = finite(plain)
    return {**found, "frequencies": frequencies[np.isfinite(frequencies)].tolist()}


def recommend(
    goal: Goal, *, progress: Callable[[str, float], None] | None = None
) -> Recommendation:
    r"""Recommend an instrument for a goal.

    Parameters
    ----------
    goal : Goal
        What is asked, in which waters, and what the instrument may be made of.
    progress : callable, optional
        Takes what is done now and the share of the work done before it [1].

    Returns
    -------
    Recommendation
        Best instrument and runner-up with the reasons; the same each time.

    Raises
    ------
    SurveyError
        If no scheme fits a method, or the water is not known at a wavelength.

    Notes
    -----
    The criterion is :math:`\sqrt{\sigma^2 + \beta^2}` of one pixel, standard
    uncertainty and residual bias of `evaluate`, at the worst asked distance: the value
    that the asked share of drawn waters and targets reaches. Wrong intervals,
    saturation, the limits of the model, time and budget are requirements; each that is
    missed counts ten times. Where the goal states prices, the cheapest instrument that
    meets all is the best one.

    Examples
    --------
    >>> goal = Goal.from_toml("examples/goals/harbour_wall.toml")  # doctest: +SKIP
    >>> found = recommend(goal)  # doctest: +SKIP
    >>> found.best.parameters.frequencies  # doctest: +SKIP
    """
    with nullcontext() if progress is None else listening(progress):
        found = search(goal)
        tell("reasons", 0.98)
        best = found.best[0]
        runner_up = _runner_up(found)
        return Recommendation(
            goal=goal,
            best=_choice(goal, best),
            runner_up=None if runner_up is None else _choice(goal, runner_up),
            bounds=_bounds(goal, best.parameters),
            impossible=(
                ()
                if best.merit <= 0
                else requirements.shortfalls(goal, best, found.all_scores())
            ),
            candidates=_table(goal, found),
            looked_at=found.count,
        )


def _kind(chosen: Parameters) -> tuple[str, str, str, int]:
    """Return what makes two instruments different in kind."""
    return (
        chosen.laser,
        chosen.polarization,
        chosen.method,
        len(chosen.frequencies),
    )


def _runner_up(found: Found) -> Candidate | None:
    """Return the best candidate of another kind; of the same kind if there is none."""
    best, *rest = found.best
    others = [one for one in rest if _kind(one.parameters) != _kind(best.parameters)]
    return next(iter([*others, *rest]), None)


def _choice(goal: Goal, found: Candidate) -> Choice:
    """Return a candidate with its reasons."""
    chosen = found.parameters
    survey = survey_of(goal, chosen)
    every = _errors(goal, chosen, survey)
    errors = every.sel(distance=list(goal.asked))
    worst = int(np.argmax(found.score.error[0]))
    there = errors.isel(distance=worst)
    terms = {
        name: float(there[name].median()) for name in TERMS if name != "saturation"
    }
    met = (
        (errors["total_error"] <= goal.accuracy.total_error)
        & (errors["ambiguous"] == 0)
        & (errors["saturated"] == 0)
        & (errors["model_not_valid"] == 0)
    )
    codes = np.bincount(there["binding_term"].values.ravel(), minlength=len(TERMS))
    return Choice(
        parameters=chosen,
        survey=survey.to_toml(),
        requirements=requirements.table(goal, found, errors),
        terms=terms,
        binding=TERMS[int(np.argmax(codes))],
        error=float(found.score.error.max()),
        worst_distance=goal.asked[worst],
        share=float(met.all("distance").mean()),
        scan_time=scan_time(goal, chosen),
        cost=cost_of(goal, chosen),
        shares=dwell_shares(goal, chosen),
        between=_between(goal, every["total_error"]),
    )


def _errors(goal: Goal, chosen: Parameters, survey: Survey) -> xr.Dataset:
    """Return the errors at the asked distances and between them, over the draws."""
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


def _between(goal: Goal, every: xr.DataArray) -> Between:
    """Return where the error is largest from the first to the last asked distance."""
    # The value that the asked share of the draws stays below, as in the search.
    error = every.quantile(goal.accuracy.share, "draw", method="inverted_cdf")
    worst = error.isel(distance=int(error.argmax("distance")))
    return Between(distance=float(worst["distance"]), error=float(worst))


def _bounds(goal: Goal, chosen: Parameters) -> tuple[Bound, ...]:
    """Return the parameters at an edge of what may be chosen."""
    parts = goal.components
    laser = laser_of(goal, chosen.laser)
    stated: list[tuple[str, float, tuple[float, ...]]] = [
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
        stated += [
            ("lowest frequency", chosen.frequencies[0], allowed),
            ("highest frequency", chosen.frequencies[-1], allowed),
        ]
    bounds = []
    for name, value, values in stated:
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


def _table(goal: Goal, found: Found) -> xr.Dataset:
    """Return the best candidates as a table."""
    listed = found.best[:_LISTED]
    most = max(len(one.parameters.frequencies) for one in listed)
    frequencies = np.full((len(listed), most), np.nan)
    for number, one in enumerate(listed):
        frequencies[number, : len(one.parameters.frequencies)] = (
            one.parameters.frequencies
        )
    names = ("laser", "polarization", "method")
    units = {
        "power": "W",
        "baseline": "m",
        "radius": "m",
        "field_of_view": "rad",
        "dwell": "s",
    }
    variables: dict[str, Any] = {
        name: ("candidate", [getattr(one.parameters, name) for one in listed])
        for name in names
    }
    for name, unit in units.items():
        values = [getattr(one.parameters, name) for one in listed]
        variables[name] = ("candidate", values, {"units": unit})
    figures = {
        "error": ("m", [float(one.score.error.max()) for one in listed]),
        "wrong_interval": ("1", [float(one.score.wrong.max()) for one in listed]),
        "scan_time": ("s", [float(one.score.time[0]) for one in listed]),
        "cost": ("1", [float(one.score.cost[0]) for one in listed]),
        "merit": ("1", [one.merit for one in listed]),
    }
    for name, (unit, values) in figures.items():
        variables[name] = ("candidate", values, {"units": unit})
    variables["modulation_frequency"] = (
        ("candidate", "frequency_number"),
        frequencies,
        {"units": "Hz"},
    )
    return xr.Dataset(variables, attrs={"title": goal.name})
