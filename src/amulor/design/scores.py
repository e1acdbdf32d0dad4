"""Errors, scan times and costs of candidates, evaluated over random waters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.design import _kernels as kernel
from amulor.design.candidates import (
    Parameters,
    box_values,
    cost_of,
    depth_of,
    drawn,
    first_choice,
    laser_of,
    lines_of,
    readings_of,
    scan_time,
    survey_of,
    water_scale,
)
from amulor.design.goal import Goal
from amulor.design.light import Case, Lit, case_of, lit
from amulor.design.numbers import MOST_BENT, Assessed, assessed
from amulor.survey import water_properties

__all__ = [
    "Grid",
    "Judge",
    "Score",
    "achieved",
    "draws_at",
    "limits_of",
    "merits",
    "required",
]

Floats = NDArray[np.float64]

#: Share of the frequencies of which the phase may be lost in noise [1].
_UNSEEN = 0.5
#: Weight of a missed requirement relative to the accuracy.
_MISSED = 10.0
#: Logarithms of ratios are limited to this, so that all are finite.
_WORST = 40.0
#: Number of points that are processed at once, which limits the memory.
_AT_ONCE = 200_000
#: Axes of a grid, its frequencies, distances and draws.
_DIMENSIONS = 8
#: That of the frequency sets.
_SETS = 5


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Grid of candidate instruments, all combinations of the listed values."""

    baseline: tuple[float, ...]
    """Distances between emitter and receiver [m]."""
    radius: tuple[float, ...]
    """Receiver aperture half-widths [m]."""
    field_of_view: tuple[float, ...]
    """Half-widths of the field of view [rad]."""
    power: tuple[float, ...]
    """Mean launched powers [W]."""
    dwell: tuple[float, ...]
    """Dwell times [s]."""
    sets: tuple[tuple[float, ...], ...]
    """Sets of modulation frequencies [Hz]."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each parameter."""
        return (
            len(self.baseline),
            len(self.radius),
            len(self.field_of_view),
            len(self.power),
            len(self.dwell),
            len(self.sets),
        )

    def parameters(self, number: int, like: Parameters) -> Parameters:
        """Parameters of one candidate, with laser, channels and method of `like`."""
        b, r, f, p, t, s = np.unravel_index(number, self.shape)
        return replace(
            like,
            baseline=self.baseline[b],
            radius=self.radius[r],
            field_of_view=self.field_of_view[f],
            power=self.power[p],
            dwell=self.dwell[t],
            frequencies=self.sets[s],
        )


@dataclass(frozen=True, kw_only=True)
class Score:
    """Errors of candidates at the required quantile of waters; scan times and costs."""

    error: Floats
    """Total error, shape (candidate, distance) [m]."""
    wrong: Floats
    """Probability of a wrong ambiguity interval, shape (candidate, distance) [1]."""
    output: Floats
    """Ratio of detector output to linear limit, shape (candidate,) [1]."""
    validity: Floats
    """Validity measure, above 1 outside the error model, shape (candidate,) [1]."""
    time: Floats
    """Time for all pixels or survey lines, shape (candidate,) [s]."""
    rows: Floats
    """Distance between rows along a line; 0 without a vehicle, shape (candidate,) [m].
    """
    smear: Floats
    """Way of a vehicle during the readings of a pixel, shape (candidate,) [m]."""
    cost: Floats
    """Total price, shape (candidate,) [currency]."""

    def part(self, which: NDArray[np.intp]) -> Score:
        """Return the scores of selected candidates."""
        return Score(**{name: value[which] for name, value in vars(self).items()})

    @staticmethod
    def joined(scores: Sequence[Score]) -> Score:
        """Concatenate the scores of several sets of candidates."""
        return Score(
            **{
                name: np.concatenate([getattr(score, name) for score in scores])
                for name in vars(scores[0])
            }
        )


def merits(goal: Goal, score: Score, *, with_intervals: bool = True) -> Floats:
    """Figure of merit of candidates, smaller for better ones."""
    ratios = required(goal, score)
    merit = _log(ratios.pop("total error"))
    if not with_intervals:
        del ratios["wrong interval"]
    for ratio in ratios.values():
        # Rounding of a time that was made to fit is no miss.
        merit = merit + _MISSED * np.maximum(_log(ratio / (1 + 1e-9)), 0.0)
    return np.asarray(merit)


def limits_of(goal: Goal) -> dict[str, float]:
    """Largest allowed value of each requirement of a goal, in SI units."""
    vehicle = goal.vehicle
    limits = {
        "total error": goal.accuracy.total_error,
        "wrong interval": goal.accuracy.wrong_interval,
        "detector output": 1.0,
        "validity of the model": 1.0,
        "scan time": goal.scan.longest,
        "row spacing": None if vehicle is None else vehicle.row_spacing,
        "smear": None if vehicle is None else vehicle.smear,
        "budget": goal.components.budget,
    }
    return {name: limit for name, limit in limits.items() if limit is not None}


def achieved(score: Score) -> dict[str, Floats]:
    """Achieved value of each requirement, at the worst distance, (candidate,)."""
    return {
        "total error": score.error.max(axis=1),
        "wrong interval": score.wrong.max(axis=1),
        "detector output": score.output,
        "validity of the model": score.validity,
        "scan time": score.time,
        "row spacing": score.rows,
        "smear": score.smear,
        "budget": score.cost,
    }


def required(goal: Goal, score: Score) -> dict[str, Floats]:
    """Ratio of achieved to allowed value, for each requirement of a goal."""
    values = achieved(score)
    return {name: values[name] / (it or 1e-9) for name, it in limits_of(goal).items()}


def _log(ratio: Floats) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.log(np.nan_to_num(ratio, nan=np.inf))
    return np.asarray(np.clip(value, -_WORST, _WORST))


def draws_at(
    goal: Goal, chosen: Parameters, count: int | None = None
) -> dict[str, Floats]:
    """Random water and target properties, at the wavelength of an instrument."""
    draws = drawn(goal, count)
    scale = water_scale(goal, chosen) if draws else {}
    return {name: values * scale.get(name, 1.0) for name, values in draws.items()}


class Judge:
    """Evaluator that scores candidate instruments with one laser."""

    def __init__(
        self,
        goal: Goal,
        laser: str,
        *,
        draws: int | None = None,
        distances: Sequence[float] | None = None,
    ) -> None:
        self.goal = goal
        parts = laser_of(goal, laser)
        # For the longest dwell, with the stated time constant.
        self.start = replace(
            first_choice(goal),
            laser=laser,
            power=parts.powers[0],
            dwell=box_values(goal.components.dwell)[-1],
        )
        survey = survey_of(goal, self.start)
        water = water_properties(survey)
        self._cases: dict[str, Case] = {}
        for readings in readings_of(goal):
            of_readings = survey_of(goal, replace(self.start, readings=readings))
            self._cases[readings] = case_of(of_readings, water)
            self._cases[readings].survey_values.update(goal.assumed)
        self.case = self._cases[self.start.readings]
        values_of_draws = draws_at(goal, self.start, draws)
        self.count = max(
            (len(values) for values in values_of_draws.values()), default=1
        )
        self._draws = {
            n: _along(v, _DIMENSIONS - 1) for n, v in values_of_draws.items()
        }
        asked_distances = goal.asked if distances is None else tuple(distances)
        self._distance = _along(np.array(asked_distances), _DIMENSIONS - 2)

    def lit(self, grid: Grid, *, joint: bool) -> Lit:
        """Compute the signals of a grid, shared by methods and polarization schemes."""
        all_frequencies = np.unique(
            np.concatenate([np.array(members) for members in grid.sets])
        )
        return lit(self.case, self._values(grid), all_frequencies, joint=joint)

    def score(
        self, grid: Grid, like: Parameters, *, lighting: Lit | None = None
    ) -> Score:
        """Score a grid in its order, with channels, method and readings of `like`."""
        if lighting is None:
            lighting = self.lit(grid, joint=like.method == "joint")
        paces = self._paces(grid, like)
        speed = paces.pop("speed")
        values = self._values(grid)
        if like.readings == "at-once":
            laser = laser_of(self.goal, like.laser)
            depths = [depth_of(laser, len(one), "at-once") for one in grid.sets]
            values["modulation_depth"] = _along(np.array(depths), _SETS)
        if self.goal.vehicle is not None:
            values["speed"] = speed[..., None, None]
        most = max(len(members) for members in grid.sets)
        frequencies = np.full((most, len(grid.sets)), np.nan)
        for number, members in enumerate(grid.sets):
            frequencies[: len(members), number] = members
        frequencies = frequencies.reshape(most, *[1] * 5, -1, 1, 1)
        pairs = tuple(like.polarization.split("+"))
        parts = []
        per_column = int(np.prod(grid.shape[3:])) * self._distance.size * self.count
        step = max(1, _AT_ONCE // max(per_column, 1))
        place = [slice(None)] * _DIMENSIONS
        for b in range(grid.shape[0]):
            for r in range(grid.shape[1]):
                for first in range(0, grid.shape[2], step):
                    place[:3] = (
                        slice(b, b + 1),
                        slice(r, r + 1),
                        slice(first, first + step),
                    )
                    index = tuple(place)
                    errors = assessed(
                        self._cases[like.readings],
                        {name: _part(value, index) for name, value in values.items()},
                        frequencies=frequencies,
                        method=like.method,
                        pairs=pairs,
                        interval=self.goal.limits,
                        lighting=replace(
                            lighting,
                            look=_part(lighting.look, index),
                            place=_part(lighting.place, index),
                            reach=_part(lighting.reach, index),
                        ),
                    )
                    parts.append(self._figures(errors))
        error, wrong, output, validity = (
            np.concatenate([members[k] for members in parts]) for k in range(4)
        )
        return Score(
            error=error,
            wrong=wrong,
            output=output,
            validity=validity,
            cost=self._prices(grid, like),
            **{
                name: np.broadcast_to(value, grid.shape).ravel()
                for name, value in paces.items()
            },
        )

    def of(self, chosen: Parameters) -> Score:
        """Score one candidate instrument."""
        return self.score(grid_of(chosen), chosen)

    def _values(self, grid: Grid) -> dict[str, Floats]:
        """Values of all parameters, as arrays along the grid dimensions."""
        names = ("baseline", "radius", "field_of_view", "power", "dwell")
        values = {
            name: _along(np.array(getattr(grid, name)), k)
            for k, name in enumerate(names)
        }
        aim = np.full([1] * _DIMENSIONS, self.case.survey.targets[0].position[2])
        return {**values, "aim": aim, "distance": self._distance, **self._draws}

    def _figures(self, errors: Assessed) -> tuple[Floats, Floats, Floats, Floats]:
        """Error, wrong-interval chance, output, validity at the required quantile."""
        column = {name: errors.result[..., k] for k, name in enumerate(kernel.RESULTS)}
        square = errors.late**2 + errors.footprint**2
        for name in kernel.RANDOM:
            square = square + column[name]
        for name in kernel.SYSTEMATIC:
            square = square + column[name] ** 2
        valid = np.maximum(errors.bent / MOST_BENT, column["unseen"] / _UNSEEN)
        rank = max(math.ceil(self.goal.accuracy.share * self.count - 1e-9), 1) - 1
        reached = [
            np.partition(np.nan_to_num(value, nan=np.inf), rank, axis=-1)[..., rank]
            for value in (square, column["wrong"], column["output"], valid)
        ]
        flat = [value.reshape(-1, value.shape[-1]) for value in reached]
        return np.sqrt(flat[0]), flat[1], flat[2].max(axis=1), flat[3].max(axis=1)

    def _paces(self, grid: Grid, like: Parameters) -> dict[str, Floats]:
        """Scan time, and speed and distances of a vehicle, by dwell and set."""
        shape = 1, 1, 1, 1, len(grid.dwell), len(grid.sets)
        paces = {n: np.zeros(shape) for n in ("time", "rows", "smear", "speed")}
        for t, dwell in enumerate(grid.dwell):
            for s, members in enumerate(grid.sets):
                sample = replace(like, dwell=dwell, frequencies=members)
                lines = lines_of(self.goal, sample)
                if lines is None:
                    paces["time"][..., t, s] = scan_time(self.goal, sample)
                    continue
                paces["time"][..., t, s] = lines.time
                paces["rows"][..., t, s] = lines.between_rows
                paces["smear"][..., t, s] = lines.along_readings
                paces["speed"][..., t, s] = lines.speed
        return paces

    def _prices(self, grid: Grid, like: Parameters) -> Floats:
        """Total price of all candidates of a grid."""
        goal, shape = self.goal, grid.shape
        # Prices add up, so each value is priced alone.
        base = grid.parameters(0, like)
        start = cost_of(goal, base)
        cost = np.full(shape, start)
        names = ("baseline", "radius", "field_of_view", "power", "dwell", "frequencies")
        values_by_name = (*(getattr(grid, name) for name in names[:-1]), grid.sets)
        for axis, (name, choices) in enumerate(zip(names, values_by_name, strict=True)):
            extra = [cost_of(goal, replace(base, **{name: v})) - start for v in choices]
            cost = cost + np.array(extra).reshape(
                [-1 if k == axis else 1 for k in range(len(shape))]
            )
        return np.asarray(cost.ravel())


def grid_of(chosen: Parameters) -> Grid:
    """Grid that contains one candidate."""
    return Grid(
        baseline=(chosen.baseline,),
        radius=(chosen.radius,),
        field_of_view=(chosen.field_of_view,),
        power=(chosen.power,),
        dwell=(chosen.dwell,),
        sets=(chosen.frequencies,),
    )


def _along(values: Floats, dimension: int) -> Floats:
    """Values reshaped to vary along one dimension of the grid."""
    return values.reshape([-1 if k == dimension else 1 for k in range(_DIMENSIONS)])


def _part(value: NDArray, index: tuple[slice, ...]) -> NDArray:  # type: ignore[type-arg]
    """Block of an array by index; dimensions of length 1 stay whole."""
    if value.ndim != _DIMENSIONS:
        return value
    return value[
        tuple(
            part if size > 1 else slice(None)
            for part, size in zip(index, value.shape, strict=True)
        )
    ]
