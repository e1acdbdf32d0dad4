r"""Reliability of all observations except surfaces, after W. Baarda.

With the residual v of an observation, its covariance K, :math:`P = K^{-1}`, the inverse
normal matrix N and the covariance C of the unknowns, the residuals have the covariance
:math:`Q = K - 2 J N J^T + J C J^T`. This is :math:`K - J C J^T` if N and C are equal.
Redundancy numbers are the diagonal of :math:`R = 1 - J N J^T P`. The standardized
residual is :math:`w_i = (P v)_i / \sqrt{(P Q P)_{ii}}`, and the minimal detectable
error is :math:`\delta_0 \sqrt{(P Q P)_{ii}} / (P R)_{ii}` (Baarda, A testing procedure
for use in geodetic networks, 1968). An error of that size changes the unknowns by
:math:`N J^T P e_i` times the size (external reliability).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from amulor.site.registration.network import Layout, State, Ties, centre_derivatives
from amulor.site.registration.pose import departure

Floats = NDArray[np.float64]


def non_centrality(chance: float) -> float:
    """Return the standardized error that a test detects with 80 % power [1]."""
    return float(norm.isf(chance / 2) + norm.isf(1 - 0.8))


#: Chance of a false alarm [1], and the non-centrality at this chance [1].
_CHANCE = 1e-3
_NON_CENTRALITY = non_centrality(_CHANCE)
#: Smallest redundancy of an observation that other observations check [1].
_UNCHECKED = 1e-3
_SHIFTS = ("east", "north", "up")
_TURNS = ("about east", "about north", "about up")


@dataclass(frozen=True, kw_only=True)
class Reliability:
    """Reliability of one coordinate or angle of an observation, after W. Baarda."""

    observation: str
    """Kind and name of the observation, such as "start a2", "control S1" or "bar S1
    S2"."""
    part: str
    """Name of the coordinate, or axis of the rotation."""
    residual: float
    """Adjusted minus stated value [m, rad, 1]."""
    uncertainty: float
    """Stated standard uncertainty [m, rad, 1]."""
    redundancy: float
    """Fraction of an error that appears in the residual, 0 to 1 [1]."""
    score: float
    """Standardized residual w; 0 if no other observation checks the value [1]."""
    detectable: float | None
    """Minimal detectable error; None if no other observation checks the value [m, rad,
    1]."""
    external: float | None = None
    """Largest change of a scan's position by an error of this size (external
    reliability); None if no other observation checks the value [m]."""
    external_scan: str = ""
    """Scan whose position changes most."""


@dataclass(frozen=True, kw_only=True)
class ObservationGroup:
    """Summary of the reliability of all observations of one kind."""

    group: str
    """Kind of the values, such as "start positions" or "scale bars"."""
    unit: str
    """Unit of the values: m, rad, or 1."""
    count: int
    """Number of values [1]."""
    unchecked: int
    """Number of values that no other observation checks [1]."""
    redundancy: float
    """Mean redundancy number, 0 to 1 [1]."""
    largest_score: float
    """Standardized residual with the largest amount [1]."""
    limit: float
    """Largest amount expected by chance in one of 1,000 networks [1]."""
    largest_of: str
    """Observation with this residual."""
    detectable: float | None
    """Largest minimal detectable error; None if no value is checked [m, rad, 1]."""
    external: float | None
    """Largest change of a scan's position by an undetected error; None if no value is
    checked [m]."""


#: Kinds of observations by the first word of their name: group, and group of angles.
_GROUPS = {
    "start": ("start positions", "start attitudes"),
    "target": ("targets in scans", ""),
    "control": ("control points", ""),
    "bar": ("scale bars", ""),
    "error": ("shared errors", ""),
}


def group_of(line: Reliability) -> tuple[str, str]:
    """Return the group of an observation and the unit of its values."""
    kind = line.observation.partition(" ")[0]
    lengths, angles = _GROUPS[kind]
    if line.part in _TURNS:
        return angles, "rad"
    return lengths, "1" if kind == "error" else "m"


def observation_groups(lines: Sequence[Reliability]) -> tuple[ObservationGroup, ...]:
    """Summarize the reliability of observations by kind, such as start positions.

    Examples
    --------
    >>> from amulor.site.registration.reliability import Reliability
    >>> bar = Reliability(
    ...     observation="bar A B", part="length", residual=1e-3, uncertainty=5e-4,
    ...     redundancy=0.8, score=2.2, detectable=2.3e-3, external=4e-4,
    ... )
    >>> group, = observation_groups([bar])
    >>> group.group, group.unchecked, group.largest_of
    ('scale bars', 0, 'bar A B, length')
    """
    groups: dict[tuple[str, str], list[Reliability]] = {}
    for line in lines:
        groups.setdefault(group_of(line), []).append(line)
    limit = float(norm.isf(_CHANCE / 2 / max(len(lines), 1)))
    summaries = []
    for (name, unit), members in groups.items():
        worst = max(members, key=lambda line: abs(line.score))
        checked = [line for line in members if line.detectable is not None]
        summaries.append(
            ObservationGroup(
                group=name,
                unit=unit,
                count=len(members),
                unchecked=len(members) - len(checked),
                redundancy=float(np.mean([line.redundancy for line in members])),
                largest_score=worst.score,
                limit=limit,
                largest_of=f"{worst.observation}, {worst.part}".rstrip(", "),
                detectable=max(
                    (
                        line.detectable
                        for line in checked
                        if line.detectable is not None
                    ),
                    default=None,
                ),
                external=max(
                    (line.external for line in checked if line.external is not None),
                    default=None,
                ),
            )
        )
    return tuple(summaries)


def reliabilities(
    state: State,
    covariance: Floats,
    layout: Layout,
    ties: Ties,
    *,
    inverse: Floats | None = None,
) -> tuple[Reliability, ...]:
    """Return the reliability of all observations except surfaces.

    `inverse` is that of the normal matrix. It differs from the covariance if surfaces
    contribute; without surfaces it is the covariance.
    """
    inverse = covariance if inverse is None else inverse
    lines: list[Reliability] = []
    for name, parts, residual, prior, columns, rows in _observations(
        state, layout, ties
    ):
        free = columns >= 0
        at, design = columns[free], rows[:, free]
        weight = np.linalg.inv(prior)
        # Part of an error that appears in the adjusted value.
        absorbed = design @ inverse[np.ix_(at, at)] @ design.T
        adjusted = design @ covariance[np.ix_(at, at)] @ design.T
        spread = prior - absorbed - absorbed.T + adjusted
        redundancy = np.clip(1 - np.diag(absorbed @ weight), 0.0, 1.0)
        information = np.diag(weight @ spread @ weight)
        effect = np.diag(weight - weight @ absorbed @ weight)
        for number, part in enumerate(parts):
            checked = redundancy[number] > _UNCHECKED and information[number] > 0
            root = float(np.sqrt(information[number])) if checked else np.inf
            detectable = None
            scan, external = "", None
            if checked:
                detectable = _NON_CENTRALITY * root / float(effect[number])
                change = inverse[:, at] @ design.T @ weight[:, number] * detectable
                scan, external = _largest_shift(change, layout)
            lines.append(
                Reliability(
                    observation=name,
                    part=part,
                    residual=float(residual[number]),
                    uncertainty=float(np.sqrt(prior[number, number])),
                    redundancy=float(redundancy[number]),
                    score=float((weight @ residual)[number]) / root,
                    detectable=detectable,
                    external=external,
                    external_scan=scan,
                )
            )
    return tuple(lines)


def _largest_shift(change: Floats, layout: Layout) -> tuple[str, float]:
    """Return the scan whose position changes most, and its shift [m]."""
    shifts = {
        name: float(np.linalg.norm(change[at][:3]))
        for (kind, name), at in layout.at.items()
        if kind == "pose"
    }
    scan = max(shifts, key=lambda name: shifts[name], default="")
    return scan, shifts.get(scan, 0.0)


def _observations(
    state: State, layout: Layout, ties: Ties
) -> Iterator[tuple[str, tuple[str, ...], Floats, Floats, NDArray[np.intp], Floats]]:
    """Yield name, parts, residual, covariance, indices, derivatives of observations."""
    for name, start in ties.start.items():
        residual = departure(state.poses[name], start.pose)
        columns = layout.columns("pose", [name], 6)
        parts = (*_SHIFTS, *_TURNS)
        yield f"start {name}", parts, residual, start.covariance, columns, np.eye(6)
    for key, value in state.errors.items():
        columns = layout.columns("error", [key], 1)
        yield f"error {key}", ("",), np.array([value]), np.eye(1), columns, np.eye(1)
    for centre in ties.centres:
        residual, rows, columns = centre_derivatives(centre, state, layout)
        rotation = state.poses[centre.scan].rotation
        prior = rotation @ centre.covariance @ rotation.T
        name = f"target {centre.target} in {centre.scan}"
        yield name, _SHIFTS, residual, prior, columns, rows
    for name, point in ties.control.items():
        residual = state.points[name] - point.position
        columns = layout.columns("point", [name], 3)
        prior = np.asarray(np.diag(point.sigma**2), dtype=float)
        yield f"control {name}", _SHIFTS, residual, prior, columns, np.eye(3)
    for bar in ties.bars:
        first, second = (state.points[end] for end in bar.ends)
        length = float(np.linalg.norm(first - second))
        unit = (first - second) / max(length, 1e-9)
        columns = layout.columns("point", bar.ends, 3)
        rows = np.concatenate([unit, -unit])[None]
        residual = np.array([length - bar.length])
        prior = np.array([[bar.sigma**2]])
        yield f"bar {' '.join(bar.ends)}", ("length",), residual, prior, columns, rows
