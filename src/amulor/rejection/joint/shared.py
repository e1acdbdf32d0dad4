"""Where the joint estimation starts: a shape of the water signal from a coarse grid."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint._kernels import search as kernels
from amulor.rejection.joint.normal import water_at
from amulor.rejection.joint.overlap import Frame, Shape
from amulor.rejection.joint.priors import DECISIVE, NONE, Shared, layout_of, whitened
from amulor.rejection.joint.problem import Problem
from amulor.rejection.joint.samples import (
    Pixels,
    echo_of,
    grid_of,
    phasors,
    places,
    samples,
    weight,
)
from amulor.rejection.joint.scatter import (
    are_inliers,
    may_be_left_out,
    typical_misfit,
    without_outliers,
)
from amulor.rejection.joint.search import Estimates
from amulor.rejection.joint.tables import table_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Values of k' [1/m] and of b_f <theta^2> [rad^2/m] that are tried, with one b_f [1/m].
_GRID = (np.geomspace(0.06, 2.5, 7), np.geomspace(2e-3, 0.1, 3))
_FORWARD = 1.0
#: Pixels that decide.
_STARTERS = 48


def start(
    frame: Frame,
    targets: Pixels,
    shots: Pixels | None,
    *,
    transfer: Complex,
    deepest: float,
) -> tuple[Shape, Floats]:
    """Find a shape and strengths of the water signal from which to start."""
    lowest, best = np.inf, None
    if shots is None:
        few = np.linspace(0, len(targets) - 1, min(_STARTERS, len(targets)))
        some = targets.part(few.astype(np.intp))
        path = grid_of(some, frame.phase_per_path)
    else:
        some, path = shots, np.zeros(0)
    plain = weight(some)
    given = samples(some, plain)
    echo = echo_of(transfer, frame.phase_per_path)
    grid = phasors(path, echo)
    channels = some.signal.shape[1]
    nothing = np.zeros(0)
    for loss, spread in itertools.product(*_GRID):
        shape = Shape(float(loss), float(spread), _FORWARD, nothing, nothing)
        table = table_of(frame, shape, deepest=deepest, derivatives=False)
        if shots is None:
            cost = np.empty(len(some))
            strength = np.zeros((len(some), channels))
            kernels.starting_costs(
                given, places(some, table), table.arrays, echo, grid, cost, strength
            )
            total = float(cost.sum())
            typical = np.median(strength, axis=0)
        else:
            open_path = np.full(len(some), np.inf)
            _, water, _ = water_at(some, open_path, table, frame.phase_per_path)
            u, v = (
                whitened(plain, some.signal),
                whitened(plain, np.broadcast_to(water[:, None], some.signal.shape)),
            )
            square = np.einsum("ncx,ncx->c", v, v)
            along = np.einsum("ncx,ncx->c", u, v)
            typical = np.maximum(along, 0) / np.where(square > 0, square, 1)
            total = float(np.sum(u**2) - np.sum(typical * along))
        if total < lowest:
            lowest, best = total, (shape, typical)
    assert best is not None
    return best


_FIRST_STEPS = 14
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
    """Return coefficients without departures, from who is no outlier."""
    state = first(whole, turn_width, by_shots=by_shots)
    every = np.arange(len(whole.targets))
    few = every[np.linspace(0, len(every) - 1, min(_FIRST, len(every))).astype(int)]
    state, _ = whole.part(few, shots=by_shots).descend(state, _FIRST_STEPS, free=False)
    own = whole.part(every, shots=by_shots)
    _, estimates = own.scattered(state)
    kept = are_inliers(estimates)
    own = own.part(np.flatnonzero(kept), shots=by_shots)
    state, paths = own.descend(
        state, _FIRST_STEPS, free=False, paths=estimates.path[kept]
    )
    return Begun(whole.of(own.targets), state, paths)


def may_be_all(water: Problem, turn_width: float) -> bool:
    """Return whether shots, of which some are looked at, are mostly water."""
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
    """Return the first guess, without departures."""
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


#: Fractions of the water signal that come from in front of the knots of the correction.
_KNOTS = np.array([0.002, 0.01, 0.03, 0.08, 0.18, 0.32, 0.5, 0.68, 0.82, 0.92, 0.975])
_STEPS = 10
#: How often the fluctuation is estimated anew, unless it changes by less than this [1].
_ROUNDS, _STEADY = 4, 0.02
#: How often samples that disagree are looked for with the scatter of the rest.
_CLEANINGS = 4
#: A model whose chi-square over its degrees of freedom is below this fits [1].
_FITS = 1.2


def fit(
    frame: Frame,
    targets: Pixels,
    shots: Pixels | None,
    *,
    transfer: Complex,
    deepest: float,
    turn_width: float = 0.0,
) -> Shared:
    """Estimate what the pixels share, by maximum likelihood over all of them.

    Damped Gauss-Newton on the strengths, k', b_f <theta^2> and b_f and then, with
    normal priors, on what the model does not know: a smooth factor on the overlap,
    light from in front of all targets at each frequency, and departures of the echo,
    which are the same in all pixels. The paths and amplitudes of the pixels
    are eliminated at every step (Schur complement). The widths of the priors maximise
    the evidence in Laplace's approximation, so they vanish where the model is right.
    """
    problem = Problem(frame, targets, shots, transfer, deepest)
    by_shots = shots is not None
    if not by_shots:
        # Is there a target at all? Not where water alone explains every sample.
        nothing = targets.part(slice(0, 0))
        water = Problem(frame, nothing, targets, transfer, deepest)
        if may_be_all(water, turn_width):
            empty = _followed(begin(water, turn_width, by_shots=True)).state
            if empty.evidence <= DECISIVE and empty.misfit < _FITS:
                return empty
    begun = begin(problem, turn_width, by_shots=by_shots)
    found = _followed(begun)
    if not len(targets) or found.state.evidence <= DECISIVE:
        return found.state
    # A drift that follows the distance looks like a model that is wrong.
    other = _followed(replace(begun, problem=found.problem), neighbours=False)
    return min((found.state, other.state), key=found.problem.cost)


def _followed(begun: Begun, *, neighbours: bool = True) -> Begun:
    """Return where the search ends: departures, and what is random in the samples."""
    problem, state, paths = begun.problem, begun.state, begun.paths
    frame, deepest = problem.frame, problem.deepest
    knots = frame.quantiles(state.shape, _KNOTS)
    free_shape = replace(state.shape, knots=knots, correction=np.zeros(len(knots)))
    state = replace(
        state,
        shape=free_shape,
        table=table_of(frame, free_shape, deepest=deepest),
    )
    for number in range(_ROUNDS):
        before = state.fluctuation, state.noise_scale
        state, estimates = problem.scattered(state, paths, neighbours=neighbours)
        changed = False
        # Samples stay those that both were made to: only so can they be compared.
        if number and neighbours:
            cleaner, state = _cleaned(problem, state, estimates)
            changed = cleaner is not problem
            problem = cleaner
        now = state.fluctuation, state.noise_scale
        if (
            number
            and not changed
            and all(abs(a - b) <= _STEADY * a for a, b in zip(now, before, strict=True))
        ):
            # What was estimated with them stays as it is.
            state = replace(state, fluctuation=before[0], noise_scale=before[1])
            break
        state = replace(state, widths=NONE)
        state, paths = problem.descend(state, _STEPS, free=True, paths=paths)
    return Begun(problem, state, paths)


def _cleaned(
    problem: Problem, state: Shared, estimates: Estimates
) -> tuple[Problem, Shared]:
    """Return the problem without samples that disagree, and what scatter is left."""
    for _ in range(_CLEANINGS):
        typical = typical_misfit(estimates)
        allowed = state.judged & may_be_left_out(estimates, state.judged.shape, typical)
        found = without_outliers(
            problem.targets,
            estimates,
            partial(problem.local, state, None),
            allowed,
            typical,
        )
        if found.pixels is problem.targets:
            break
        problem = problem.of(found.pixels)
        state, estimates = problem.scattered(
            replace(state, judged=allowed), found.estimates.path
        )
    return problem, state
