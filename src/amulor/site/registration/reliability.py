r"""Reliability of start poses, targets, control points and scale bars (W. Baarda).

With the residual v of an observation, its covariance K, :math:`P = K^{-1}` and the
covariance of residuals :math:`Q = K - J C J^T` of an adjustment with the covariance C:
redundancy numbers are the diagonal of :math:`Q P`, the standardized residual is
:math:`w_i = (P v)_i / \sqrt{(P Q P)_{ii}}`, and the minimal detectable error is
:math:`\delta_0 / \sqrt{(P Q P)_{ii}}` (Baarda, A testing procedure for use in geodetic
networks, 1968).
"""

from __future__ import annotations

from collections.abc import Iterator
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


#: Non-centrality at a chance of 1e-3 of a false alarm [1].
_NON_CENTRALITY = non_centrality(1e-3)
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


def reliabilities(
    state: State, covariance: Floats, layout: Layout, ties: Ties
) -> tuple[Reliability, ...]:
    """Return the reliability of start poses, targets, control points and scale bars."""
    lines: list[Reliability] = []
    for name, parts, residual, prior, columns, rows in _observations(
        state, layout, ties
    ):
        free = columns >= 0
        at, design = columns[free], rows[:, free]
        spread = prior - design @ covariance[np.ix_(at, at)] @ design.T
        weight = np.linalg.inv(prior)
        redundancy = np.clip(np.diag(spread @ weight), 0.0, 1.0)
        information = np.diag(weight @ spread @ weight)
        for number, part in enumerate(parts):
            checked = redundancy[number] > _UNCHECKED and information[number] > 0
            root = float(np.sqrt(information[number])) if checked else np.inf
            lines.append(
                Reliability(
                    observation=name,
                    part=part,
                    residual=float(residual[number]),
                    uncertainty=float(np.sqrt(prior[number, number])),
                    redundancy=float(redundancy[number]),
                    score=float((weight @ residual)[number]) / root,
                    detectable=_NON_CENTRALITY / root if checked else None,
                )
            )
    return tuple(lines)


def _observations(
    state: State, layout: Layout, ties: Ties
) -> Iterator[tuple[str, tuple[str, ...], Floats, Floats, NDArray[np.intp], Floats]]:
    """Yield name, components, residual, covariance and derivatives by observation."""
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
