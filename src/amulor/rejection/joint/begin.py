"""Where the fit of what pixels share begins: a first state, and who has a say."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint.overlap.integral import table_of
from amulor.rejection.joint.priors import NONE, Shared, layout_of
from amulor.rejection.joint.problem import Problem
from amulor.rejection.joint.scatter import are_inliers
from amulor.rejection.joint.start import start

Floats = NDArray[np.float64]

_STEPS = 14
#: Pixels that settle the coefficients before edges, fish and bubbles are left out.
_FIRST = 256
#: Pixels and steps that tell whether a scan is mostly water, and the fraction of the
#: square of its samples that water must leave unexplained at most.
_LOOK, _LOOK_STEPS, _MOSTLY = 64, 3, 0.02


@dataclass(frozen=True)
class Begun:
    """A fit without departures."""

    problem: Problem
    """Pixels that are no outliers, and the shots."""
    state: Shared
    """Estimate without departures."""
    paths: Floats
    """Optical paths of the pixels [m]."""


def begin(whole: Problem, turn_width: float, *, by_shots: bool) -> Begun:
    """Return coefficients without departures, from who is no outlier.

    Parameters
    ----------
    whole : Problem
        All samples.
    turn_width : float
        Standard uncertainty of the direction of the receiver, each way [rad].
    by_shots : bool
        Whether the open-water shots count beside the samples.

    Returns
    -------
    Begun
        What the departures are looked for from.
    """
    state = first(whole, turn_width, by_shots=by_shots)
    every = np.arange(len(whole.targets))
    few = every[np.linspace(0, len(every) - 1, min(_FIRST, len(every))).astype(int)]
    state, _ = whole.part(few, shots=by_shots).descend(state, _STEPS, free=False)
    own = whole.part(every, shots=by_shots)
    _, estimates = own.scattered(state)
    kept = are_inliers(estimates)
    own = own.part(np.flatnonzero(kept), shots=by_shots)
    state, paths = own.descend(state, _STEPS, free=False, paths=estimates.path[kept])
    return Begun(whole.of(own.targets), state, paths)


def may_be_all(water: Problem, turn_width: float) -> bool:
    """Return whether shots, of which some are looked at, are mostly water.

    Parameters
    ----------
    water : Problem
        Without targets.
    turn_width : float
        Standard uncertainty of the direction of the receiver, each way [rad].

    Returns
    -------
    bool
        False where water leaves more than a fiftieth of the samples' square.
    """
    assert water.shots is not None
    count = len(water.shots)
    which = np.unique(np.linspace(0, count - 1, min(_LOOK, count)).astype(np.intp))
    few = water.with_shots(water.shots.part(which))
    state = first(few, turn_width, by_shots=True)
    layout = layout_of(state)
    dark = replace(state, strength=np.zeros_like(state.strength))
    power = few.normal(dark, few.local(dark, None), layout, layout.rigid).square
    state, paths = few.descend(state, _LOOK_STEPS, free=False)
    rest = few.normal(state, few.local(state, paths), layout, layout.rigid).square
    return rest < _MOSTLY * power


def first(problem: Problem, turn_width: float, *, by_shots: bool) -> Shared:
    """Return the first guess, without departures.

    Parameters
    ----------
    problem : Problem
        All samples.
    turn_width : float
        Standard uncertainty of the direction of the receiver, each way [rad].
    by_shots : bool
        Whether the open-water shots decide alone.

    Returns
    -------
    Shared
        The best of a coarse grid of shapes.
    """
    chosen = problem.shots if by_shots else None
    shape, strength = start(
        problem.frame, problem.targets, chosen, transfer=problem.transfer,
        deepest=problem.deepest,
    )  # fmt: skip
    channels, frequencies = problem.targets.signal.shape[1:]
    doubts = channels if problem.shots is not None and len(problem.targets) else 0
    if turn_width > 0:
        shape = replace(shape, turn=np.zeros(2))
    return Shared(
        shape=shape,
        table=table_of(problem.frame, shape, deepest=problem.deepest),
        strength=strength,
        departure=np.zeros((channels, frequencies), dtype=complex),
        echo=np.zeros(frequencies, dtype=complex),
        shot_change=0.0,
        shot_departure=np.zeros((doubts, frequencies), dtype=complex),
        trend=np.zeros(problem.targets.trends.shape[1] if len(problem.targets) else 0),
        fluctuation=0.0,
        noise_scale=1.0,
        judged=np.ones((channels, frequencies), dtype=bool),
        turn_width=turn_width,
        covariance=np.zeros((0, 0)),
        parametric=np.zeros((0, 0)),
        widths=NONE,
        evidence=0.0,
        misfit=np.nan,
    )
