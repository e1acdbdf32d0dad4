"""What the pixels of a scan share: strength and shape of the water signal."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint.begin import Begun, begin, may_be_all
from amulor.rejection.joint.outliers import may_be_left_out, without_outliers
from amulor.rejection.joint.overlap.frame import Frame
from amulor.rejection.joint.overlap.integral import table_of
from amulor.rejection.joint.pixels import Pixels
from amulor.rejection.joint.priors import DECISIVE, NONE, Shared
from amulor.rejection.joint.problem import Problem
from amulor.rejection.joint.scatter import typical_misfit
from amulor.rejection.joint.search import Estimates

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

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

    Parameters
    ----------
    frame : Frame
        How the receiver looks at the scan.
    targets : Pixels
        Samples with or without a target; a thousand or two say all there is to say.
    shots : Pixels, optional
        Samples that are known to be open water.
    transfer : ndarray of complex
        What the echo has beyond its delay, as known [1].
    deepest : float
        Depth beyond which no target stands [m].
    turn_width : float, optional
        Standard uncertainty of the direction of the receiver, each way; 0 takes that
        of the survey as exact [rad].

    Returns
    -------
    Shared
        Estimate with its covariance.

    Notes
    -----
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
