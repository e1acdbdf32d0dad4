"""Fit of the shared parameters, started from a grid of water-signal shapes."""

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
    outlier_candidates,
    typical_misfit,
    without_outliers,
)
from amulor.rejection.joint.search import Estimates
from amulor.rejection.joint.tables import table_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Grid of k' [1/m] and of b_f <theta^2> [rad^2/m], with a single b_f [1/m].
_GRID = (np.geomspace(0.06, 2.5, 7), np.geomspace(2e-3, 0.1, 3))
_FORWARD = 1.0
#: Pixels of the coarse grid search.
_STARTERS = 48


def start(
    frame: Frame,
    targets: Pixels,
    shots: Pixels | None,
    *,
    transfer: Complex,
    deepest: float,
) -> tuple[Shape, Floats]:
    """Find starting values of the fit: shape and strengths of the water signal."""
    lowest, best = np.inf, None
    if shots is None:
        index = np.linspace(0, len(targets) - 1, min(_STARTERS, len(targets)))
        pixels = targets.part(index.astype(np.intp))
        path = grid_of(pixels, frame.phase_per_path)
    else:
        pixels, path = shots, np.zeros(0)
    plain = weight(pixels)
    given_samples = samples(pixels, plain)
    echo = echo_of(transfer, frame.phase_per_path)
    grid = phasors(path, echo)
    channels = pixels.signal.shape[1]
    nothing = np.zeros(0)
    for loss, spread in itertools.product(*_GRID):
        shape = Shape(float(loss), float(spread), _FORWARD, nothing, nothing)
        table = table_of(frame, shape, deepest=deepest)
        if shots is None:
            cost = np.empty(len(pixels))
            strength = np.zeros((len(pixels), channels))
            kernels.starting_costs(
                given_samples,
                places(pixels, table),
                table.arrays,
                echo,
                grid,
                cost,
                strength,
            )
            total = float(cost.sum())
            typical = np.median(strength, axis=0)
        else:
            open_path = np.full(len(pixels), np.inf)
            _, water, _ = water_at(pixels, open_path, table, frame.phase_per_path)
            u, v = (
                whitened(plain, pixels.signal),
                whitened(plain, np.broadcast_to(water[:, None], pixels.signal.shape)),
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
#: Pixels of the fit before edges, fish and bubbles are excluded.
_FIRST = 256
#: Pixels and steps of the test for a scan of mostly water, and the largest fraction of
#: the power that may remain unexplained.
_LOOK, _LOOK_STEPS, _MOSTLY = 64, 3, 0.02


@dataclass(frozen=True)
class InitialFit:
    """Fit of the shared parameters, without departures from the model."""

    problem: Problem
    """Fit problem with inlying pixels and open-water shots."""
    state: Shared
    """Estimate without departures."""
    paths: Floats
    """Optical paths of the pixels [m]."""


def begin(problem: Problem, turn_width: float, *, by_shots: bool) -> InitialFit:
    """Fit the shared parameters without model departures, excluding outliers."""
    state = first(problem, turn_width, by_shots=by_shots)
    index = np.arange(len(problem.targets))
    sample = index[np.linspace(0, len(index) - 1, min(_FIRST, len(index))).astype(int)]
    still = problem.at_rest()
    state, _ = still.part(sample, shots=by_shots).descend(
        state, _FIRST_STEPS, free=False
    )
    cleaned = still.part(index, shots=by_shots)
    _, estimates = cleaned.scattered(state)
    inlier = are_inliers(estimates)
    cleaned = cleaned.part(np.flatnonzero(inlier), shots=by_shots)
    state, paths = cleaned.descend(
        state, _FIRST_STEPS, free=False, paths=estimates.path[inlier]
    )
    return InitialFit(problem.of(cleaned.targets), state, paths)


def is_mostly_water(water: Problem, turn_width: float) -> bool:
    """Return whether a water-only fit explains most of the samples' power."""
    assert water.shots is not None
    count = len(water.shots)
    index = np.unique(np.linspace(0, count - 1, min(_LOOK, count)).astype(np.intp))
    sample = water.with_shots(water.shots.part(index))
    state = first(sample, turn_width, by_shots=True)
    layout = layout_of(state)
    dark = replace(state, strength=np.zeros_like(state.strength))
    power = sample.normal(dark, sample.local(dark, None), layout, 0).square
    state, paths = sample.descend(state, _LOOK_STEPS, free=False)
    unexplained = sample.normal(state, sample.local(state, paths), layout, 0).square
    return unexplained < _MOSTLY * power


def first(problem: Problem, turn_width: float, *, by_shots: bool) -> Shared:
    """Return the starting values of all shared parameters, without departures."""
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


#: Fractions of the water signal in front of the knots of the correction.
_KNOTS = np.array([0.002, 0.01, 0.03, 0.08, 0.18, 0.32, 0.5, 0.68, 0.82, 0.92, 0.975])
_STEPS = 10
#: Most rounds of the fluctuation, and the change below which they end [1].
_ROUNDS, _STEADY = 4, 0.02
#: Most rounds of the search for outlying samples.
_CLEANINGS = 4
#: Chi-square over its degrees of freedom below which a model fits [1].
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
    """Estimate the shared parameters from target pixels and open-water references.

    Damped Gauss-Newton on the strengths, k', b_f <theta^2> and b_f and then, with
    normal priors, on departures from the model: a smooth factor on the overlap,
    light from in front of all targets at each frequency, and departures of the echo,
    which are the same in all pixels. The paths and amplitudes of the pixels
    are eliminated at every step (Schur complement). The widths of the priors maximise
    the evidence in Laplace's approximation, so they vanish where the model is right.
    """
    problem = Problem(frame, targets, shots, transfer, deepest)
    by_shots = shots is not None
    if not by_shots:
        # Without any target, water alone explains every sample.
        nothing = targets.part(slice(0, 0))
        water = Problem(frame, nothing, targets, transfer, deepest)
        if is_mostly_water(water, turn_width):
            empty = _with_departures(begin(water, turn_width, by_shots=True)).state
            if empty.evidence <= DECISIVE and empty.misfit < _FITS:
                return empty
    initial = begin(problem, turn_width, by_shots=by_shots)
    result = _with_departures(initial)
    if not len(targets) or result.state.evidence <= DECISIVE:
        return result.state
    # A drift that follows the distance looks like a model that is wrong.
    with_drift = _with_departures(
        replace(initial, problem=result.problem), neighbors=False
    )
    return min((result.state, with_drift.state), key=result.problem.cost)


def _with_departures(initial: InitialFit, *, neighbors: bool = True) -> InitialFit:
    """Continue a fit with departures, noise scale and fluctuation."""
    problem, state, paths = initial.problem, initial.state, initial.paths
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
        current = problem if number else problem.at_rest()
        state, estimates = current.scattered(state, paths, neighbors=neighbors)
        changed = False
        # Both fits use the same samples: only so are they comparable.
        if number and neighbors:
            cleaner, state = _cleaned(problem, state, estimates)
            changed = cleaner is not problem
            problem = cleaner
        now = state.fluctuation, state.noise_scale
        if (
            number
            and not changed
            and all(abs(a - b) <= _STEADY * a for a, b in zip(now, before, strict=True))
        ):
            # The estimates belong to the values before.
            state = replace(state, fluctuation=before[0], noise_scale=before[1])
            break
        state = replace(state, widths=NONE)
        state, paths = problem.descend(state, _STEPS, free=True, paths=paths)
    return InitialFit(problem, state, paths)


def _cleaned(
    problem: Problem, state: Shared, estimates: Estimates
) -> tuple[Problem, Shared]:
    """Return the problem without outlying samples, and the state with its scatter."""
    for _ in range(_CLEANINGS):
        typical = typical_misfit(estimates)
        allowed = state.judged & outlier_candidates(
            estimates, state.judged.shape, typical
        )
        cleaned = without_outliers(
            problem.targets,
            estimates,
            partial(problem.local, state, None),
            allowed,
            typical,
        )
        if cleaned.pixels is problem.targets:
            break
        problem = problem.of(cleaned.pixels)
        state, estimates = problem.scattered(
            replace(state, judged=allowed), cleaned.estimates.path
        )
    return problem, state
