"""Requirements of a goal: margins, and relaxations if no candidate meets all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.design.candidates import Parameters
from amulor.design.evaluate import TERMS
from amulor.design.goal import Goal
from amulor.design.scores import Score, achieved, limits_of, required
from amulor.design.search import Candidate
from amulor.design.vehicle import Lines

__all__ = [
    "Requirement",
    "Shortfall",
    "lines_texts",
    "parameters_text",
    "quantity_text",
    "shortfalls",
    "table",
    "written",
]

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Requirement:
    """Requirement of a goal, with the achieved value and its margin.

    Examples
    --------
    >>> first = recommend(goal).best.requirements[0]  # doctest: +SKIP
    >>> first.met, first.value, first.limit  # doctest: +SKIP
    (True, 0.00098, 0.001)
    """

    name: str
    """Name of the requirement, such as "total error at 2 m"."""
    met: bool
    """Whether the requirement is met."""
    value: float
    """Achieved value, in SI units."""
    limit: float
    """Largest allowed value, in SI units."""
    margin: float
    """Ratio of limit to value; below 1 if missed [1]."""
    unit: str
    """Unit of value and limit."""
    binding: str
    """Largest error term in this requirement, or empty."""


@dataclass(frozen=True, kw_only=True)
class Shortfall:
    """Requirement to relax if no candidate meets all, with a limit that suffices.

    Examples
    --------
    >>> for shortfall in recommend(goal).impossible:  # doctest: +SKIP
    ...     print(shortfall.text)
    """

    requirement: str
    """Name of the requirement."""
    value: float
    """Relaxed limit that would be sufficient, in SI units."""
    limit: float
    """Limit in the goal, in SI units."""
    factor: float
    """Ratio of relaxed limit to limit in the goal [1]."""
    unit: str
    """Unit of both limits."""
    alone: bool
    """Whether relaxing this requirement alone suffices."""
    text: str
    """Message that states the relaxed limit."""


#: Unit and factor in which people read a quantity.
_READ = {
    "power": ("mW", 1e3),
    "baseline": ("cm", 1e2),
    "radius": ("mm", 1e3),
    "field_of_view": ("deg", 180 / np.pi),
    "dwell": ("ms", 1e3),
    "lowest frequency": ("MHz", 1e-6),
    "highest frequency": ("MHz", 1e-6),
    "total error": ("mm", 1e3),
    "wrong interval": ("%", 1e2),
    "scan time": ("min", 1 / 60),
    "row spacing": ("mm", 1e3),
    "smear": ("mm", 1e3),
    "budget": ("", 1.0),
    "detector output": ("%", 1e2),
    "validity of the model": ("%", 1e2),
}
_UNITS = {"total error": "m", "scan time": "s", "row spacing": "m", "smear": "m"}
#: Smaller probabilities are reported as below this.
_SELDOM = 1e-8


def written(name: str, value: float) -> str:
    """Format the value of a quantity with its unit."""
    unit, factor = _READ[name]
    if name == "wrong interval" and 0 < value < _SELDOM:
        return f"below {_SELDOM * factor:g} {unit}"
    return f"{value * factor:.4g} {unit}".strip()


def table(
    goal: Goal, candidate: Candidate, errors: xr.Dataset
) -> tuple[Requirement, ...]:
    """Return the requirements with their margins and largest error sources."""
    score, accuracy = candidate.score, goal.accuracy
    rows = []
    for number, distance in enumerate(goal.asked):
        codes = errors["binding_term"].isel(distance=number).values.ravel()
        binding = TERMS[int(np.argmax(np.bincount(codes, minlength=len(TERMS))))]
        at = f"at {distance:.4g} m"
        rows.append(
            _row(
                f"total error {at}",
                float(score.error[0, number]),
                accuracy.total_error,
                "m",
                binding,
            )
        )
        wrong = float(score.wrong[0, number])
        rows.append(
            _row(
                f"wrong interval {at}", wrong, accuracy.wrong_interval, "1", "ambiguity"
            )
        )
    values = achieved(score)
    for name, limit in limits_of(goal).items():
        if name not in ("total error", "wrong interval"):
            binding = "saturation" if name == "detector output" else ""
            unit = _UNITS.get(name, "1")
            rows.append(_row(name, float(values[name][0]), limit, unit, binding))
    return tuple(rows)


def _row(name: str, value: float, limit: float, unit: str, binding: str) -> Requirement:
    margin = limit / value if value > 0 else np.inf
    return Requirement(
        name=name,
        met=bool(value <= limit * (1 + 1e-9)),
        value=value,
        limit=limit,
        margin=margin,
        unit=unit,
        binding=binding,
    )


def shortfalls(goal: Goal, best: Candidate, scores: Score) -> tuple[Shortfall, ...]:
    """Return each requirement whose relaxation alone suffices, else all missed ones."""
    ratios = required(goal, scores)
    names = list(ratios)
    all_ratios = np.stack([ratios[name] for name in names])
    met = all_ratios <= 1 + 1e-9
    relaxed = []
    for number, name in enumerate(names):
        others_met = np.delete(met, number, axis=0).all(axis=0)
        if others_met.any():
            relaxed.append((float(all_ratios[number][others_met].min()), name))
    alone = [(factor, name) for factor, name in relaxed if np.isfinite(factor)]
    if alone:
        return tuple(
            _shortfall(goal, name, factor, alone=True) for factor, name in sorted(alone)
        )
    best_ratios = required(goal, best.score)
    return tuple(
        _shortfall(goal, name, float(value[0]), alone=False)
        for name, value in best_ratios.items()
        if value[0] > 1
    )


def _shortfall(goal: Goal, name: str, factor: float, *, alone: bool) -> Shortfall:
    limit = limits_of(goal)[name]
    value = factor * limit
    would = "would do alone" if alone else "is missed, and others with it"
    return Shortfall(
        requirement=name,
        value=value,
        limit=limit,
        factor=factor,
        unit=_UNITS.get(name, "1"),
        alone=alone,
        text=f"{name}: {written(name, value)} in place of {written(name, limit)} "
        f"({factor:.3g} times) {would}",
    )


def quantity_text(name: str, value: float) -> str:
    """Format the value of a requirement with its unit."""
    return written(name.partition(" at ")[0], value)


def parameters_text(chosen: Parameters) -> str:
    """Format the parameters of an instrument as one line of text."""
    megahertz = ", ".join(f"{f * 1e-6:.4g}" for f in chosen.frequencies)
    return (
        f"{chosen.laser}, {written('power', chosen.power)}; {megahertz} MHz; baseline "
        f"{written('baseline', chosen.baseline)}, aperture "
        f"{written('radius', chosen.radius)}, field "
        f"{written('field_of_view', chosen.field_of_view)}; {chosen.polarization} by "
        f"{chosen.method}; dwell {written('dwell', chosen.dwell)}"
    )


def lines_texts(lines: Lines, chosen: Parameters) -> dict[str, str]:
    """Format survey lines and the distances between their points, by label."""

    def millimeters(length: float) -> str:
        return f"{1e3 * length:.3g} mm"

    apart = f", {lines.spacing:.3g} m apart" if lines.count > 1 else ""
    texts = {
        "speed": f"{lines.speed:.3g} m/s",
        "readings": chosen.readings.replace("-", " "),
        "survey lines": f"{lines.count} of {lines.length:g} m{apart}",
        "between rows": millimeters(lines.between_rows),
        "between points of a row": millimeters(lines.between_columns),
        "way during a pixel": millimeters(lines.along_readings),
    }
    return texts | ({"laser spot": millimeters(lines.spot)} if lines.spot > 0 else {})
