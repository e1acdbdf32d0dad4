"""What the pixels of a scan share: strength and shape of the water signal."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint.frame import Frame
from amulor.rejection.joint.integral import table_of
from amulor.rejection.joint.model import foreground, water_at
from amulor.rejection.joint.normal import Fitted, Normal, normal_equations
from amulor.rejection.joint.pixels import Pixels, weight
from amulor.rejection.joint.priors import (
    DECISIVE,
    NONE,
    Layout,
    Shared,
    Widths,
    cost_of,
    inverse_of,
    layout_of,
    prior_of,
    widths_of,
)
from amulor.rejection.joint.scatter import (
    Scatter,
    are_inliers,
    is_detected,
    scatter_of,
)
from amulor.rejection.joint.search import Estimates, estimate, without_foreground
from amulor.rejection.joint.shape import COEFFICIENTS
from amulor.rejection.joint.start import start

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Fractions of the water signal that come from in front of the knots of the correction.
_KNOTS = np.array([0.002, 0.01, 0.03, 0.08, 0.18, 0.32, 0.5, 0.68, 0.82, 0.92, 0.975])
_PARAMETRIC_STEPS, _FREE_STEPS = 14, 10
#: Dampings tried for a step, each ten times the one before, and the least of them [1].
_TRIALS, _LEAST_DAMPING = 6, 1e-3
#: A step that promises or brings less than this in chi-square is the last one, and
#: one that promises less than 1 is worth a few trials only.
_SETTLED = 0.02
_FEW_TRIALS = 3
#: How often the fluctuation is estimated anew, unless it changes by less than this [1].
_ROUNDS, _STEADY = 4, 0.02
#: Prior standard deviations that the receiver may be turned by: further off, it is the
#: water that is not as the model has it [1].
_FURTHEST = 3.0
#: A model whose chi-square over its degrees of freedom is below this fits [1].
_FITS = 1.2
#: Pixels that settle the coefficients before the departures are looked for.
_FIRST = 256
#: Pixels and steps that tell whether a scan is mostly water, and the fraction of the
#: square of its samples that water must leave unexplained at most.
_LOOK, _LOOK_STEPS, _MOSTLY = 64, 3, 0.02


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
    problem = _Problem(frame, targets, shots, transfer, deepest)
    by_shots = shots is not None
    if not by_shots:
        # Is there a target at all? Not where water alone explains every sample.
        nothing = targets.part(slice(0, 0))
        water = _Problem(frame, nothing, targets, transfer, deepest)
        if water.may_be_all(turn_width):
            empty = _followed(water, turn_width, by_shots=True).state
            if empty.evidence <= DECISIVE and empty.misfit < _FITS:
                return empty
    found = _followed(problem, turn_width, by_shots=by_shots)
    if not len(targets) or found.state.evidence <= DECISIVE:
        return found.state
    # A drift that follows the distance looks like a model that is wrong.
    other = _followed(problem, turn_width, by_shots=by_shots, neighbours=False)
    judge = problem.part(np.flatnonzero(found.kept & other.kept))
    return min((found.state, other.state), key=judge.cost)


@dataclass(frozen=True)
class _Found:
    """Where a search has ended."""

    state: Shared
    """What the pixels share."""
    kept: NDArray[np.bool_]
    """Pixels that had a say."""


def _followed(
    whole: _Problem, turn_width: float, *, by_shots: bool, neighbours: bool = True
) -> _Found:
    """Return where the search ends: departures, and what is random in the samples."""
    state, paths, kept = whole.begin(turn_width, by_shots=by_shots)
    problem = whole.part(np.flatnonzero(kept))
    frame, deepest = problem.frame, problem.deepest
    knots = frame.quantiles(state.shape, _KNOTS)
    free_shape = replace(state.shape, knots=knots, correction=np.zeros(len(knots)))
    state = replace(
        state,
        shape=free_shape,
        table=table_of(frame, free_shape, deepest=deepest),
    )
    for number in range(_ROUNDS):
        scatter = problem.scatter(
            state, problem.local(state, paths), neighbours=neighbours
        )
        level, scale = scatter.fluctuation, scatter.noise_scale
        if (
            number
            and abs(level - state.fluctuation) <= _STEADY * level
            and abs(scale - state.noise_scale) <= _STEADY * scale
        ):
            break
        state = replace(state, fluctuation=level, noise_scale=scale, widths=NONE)
        state, paths = problem.descend(state, _FREE_STEPS, free=True, paths=paths)
    return _Found(state, kept)


class _Problem:
    """The samples of a fit, and its steps."""

    def __init__(
        self,
        frame: Frame,
        targets: Pixels,
        shots: Pixels | None,
        transfer: Complex,
        deepest: float,
    ) -> None:
        self.frame = frame
        self.targets = targets
        self.shots = shots
        self.transfer = transfer
        self.deepest = deepest

    def part(self, which: NDArray[np.intp], *, shots: bool = True) -> _Problem:
        """Return the problem with some of the pixels, with or without the shots."""
        some = self.targets.part(which)
        chosen = self.shots if shots else None
        return _Problem(self.frame, some, chosen, self.transfer, self.deepest)

    def begin(
        self, turn_width: float, *, by_shots: bool
    ) -> tuple[Shared, Floats, NDArray[np.bool_]]:
        """Return coefficients without departures, paths, and who is no outlier.

        From the open-water shots and the samples, or from the samples alone.
        """
        state = self.first(turn_width, by_shots=by_shots)
        every = np.arange(len(self.targets))
        few = every[np.linspace(0, len(every) - 1, min(_FIRST, len(every))).astype(int)]
        problem = self.part(few, shots=by_shots)
        state, _ = problem.descend(state, _PARAMETRIC_STEPS, free=False)
        kept, paths = self.part(every, shots=by_shots).inliers(state)
        problem = self.part(np.flatnonzero(kept), shots=by_shots)
        state, paths = problem.descend(
            state, _PARAMETRIC_STEPS, free=False, paths=paths[kept]
        )
        return state, paths, kept

    def may_be_all(self, turn_width: float) -> bool:
        """Return whether shots, of which some are looked at, are mostly water."""
        assert self.shots is not None
        count = len(self.shots)
        which = np.unique(np.linspace(0, count - 1, min(_LOOK, count)).astype(np.intp))
        some = self.shots.part(which)
        few = _Problem(self.frame, self.targets, some, self.transfer, self.deepest)
        state = few.first(turn_width, by_shots=True)
        layout = layout_of(state)
        dark = replace(state, strength=np.zeros_like(state.strength))
        power = few.normal(dark, few.local(dark, None), layout, layout.rigid).square
        state, paths = few.descend(state, _LOOK_STEPS, free=False)
        rest = few.normal(state, few.local(state, paths), layout, layout.rigid).square
        return rest < _MOSTLY * power

    def first(self, turn_width: float, *, by_shots: bool) -> Shared:
        """Return the first guess, without departures."""
        chosen = self.shots if by_shots else None
        shape, strength = start(
            self.frame, self.targets, chosen, transfer=self.transfer,
            deepest=self.deepest,
        )  # fmt: skip
        channels, frequencies = self.targets.signal.shape[1:]
        doubts = channels if self.shots is not None and len(self.targets) else 0
        if turn_width > 0:
            shape = replace(shape, turn=np.zeros(2))
        return Shared(
            shape=shape,
            table=table_of(self.frame, shape, deepest=self.deepest),
            strength=strength,
            departure=np.zeros((channels, frequencies), dtype=complex),
            echo=np.zeros(frequencies, dtype=complex),
            shot_change=0.0,
            shot_departure=np.zeros((doubts, frequencies), dtype=complex),
            fluctuation=0.0,
            noise_scale=1.0,
            turn_width=turn_width,
            covariance=np.zeros((0, 0)),
            parametric=np.zeros((0, 0)),
            widths=NONE,
            evidence=0.0,
            misfit=np.nan,
        )

    def cost(self, state: Shared) -> float:
        """Return minus twice the logarithm of the evidence, but for a constant."""
        layout = layout_of(state)
        estimates = self.local(state, None)
        normal = self.normal(state, estimates, layout, layout.size)
        own = cost_of(normal.matrix, normal.vector, state, layout, state.widths)
        volume = 0.0
        for group in self.groups(estimates):
            deviation = self.deviation(state, group.pixels, group.path)
            inverse = weight(group.pixels, deviation, state.noise_scale)
            square = inverse[:, :, 0] * inverse[:, :, 2] - inverse[:, :, 1] ** 2
            volume -= float(np.sum(np.log(square[square > 0])))
        return normal.square + own + volume

    def descend(
        self, state: Shared, steps: int, *, free: bool, paths: Floats | None = None
    ) -> tuple[Shared, Floats]:
        """Take Gauss-Newton steps until they are small against their own errors."""
        layout = layout_of(state)
        used = layout.size if free else layout.rigid
        estimates = self.local(state, paths)
        normal = self.normal(state, estimates, layout, used)
        damping = 0.0
        for _ in range(steps):
            widths, evidence = NONE, 0.0
            if free:
                widths, evidence = widths_of(
                    normal.matrix, normal.vector, state, layout
                )
            prior, origin = prior_of(state, layout, widths)
            matrix = normal.matrix + np.diag(prior[:used])
            vector = normal.vector - (prior * origin)[:used]
            level = _objective(normal, state, layout, widths)
            state = replace(
                state, widths=widths, evidence=evidence, covariance=inverse_of(matrix)
            )
            expected = float(vector @ state.covariance @ vector)
            best = (state, estimates, normal)
            for _ in range(_TRIALS if expected > 1 else _FEW_TRIALS):
                # Levenberg's and Marquardt's way between Newton and steepest descent.
                damped = matrix + damping * np.diag(np.diag(matrix))
                step = inverse_of(damped) @ vector
                moved = self.moved(state, step, layout)
                new_estimates = self.local(moved, estimates.path)
                new = self.normal(moved, new_estimates, layout, used)
                if _objective(new, moved, layout, widths) < level:
                    best = (moved, new_estimates, new)
                    damping = damping / 10 if damping > _LEAST_DAMPING else 0.0
                    break
                damping = max(10 * damping, _LEAST_DAMPING)
            gained = level - _objective(best[2], best[0], layout, widths)
            state, estimates, normal = best
            if min(gained, expected) < _SETTLED:
                break
        basic = layout.parametric
        return (
            replace(
                state,
                parametric=inverse_of(normal.matrix[basic, basic]),
                misfit=normal.square / max(normal.freedom, 1),
            ),
            estimates.path,
        )

    def moved(self, state: Shared, step: Floats, layout: Layout) -> Shared:
        """Return the state after a step, its table made anew."""
        full = np.zeros(layout.size)
        full[: len(step)] = step
        bounded = full[layout.shape].copy()
        # Logarithms of coefficients: no more than a factor of e at once.
        bounded[:COEFFICIENTS] = np.clip(bounded[:COEFFICIENTS], -1, 1)
        shape = state.shape.moved(bounded)
        limit = _FURTHEST * state.turn_width
        shape = replace(shape, turn=np.clip(shape.turn, -limit, limit))
        channels, frequencies = state.departure.shape
        _, water, echo = layout.blocks
        water_step = full[water].reshape(2, channels, frequencies)
        echo_step = full[echo].reshape(2, frequencies)
        shot_change, shot_departure = state.shot_change, state.shot_departure
        if layout.doubts:
            own = full[layout.doubt]
            parts = own[:-1].reshape(2, channels, frequencies)
            shot_change = shot_change + float(np.clip(own[-1], -1, 1))
            shot_departure = shot_departure + parts[0] + 1j * parts[1]
        return replace(
            state,
            shape=shape,
            shot_change=shot_change,
            shot_departure=shot_departure,
            table=table_of(self.frame, shape, deepest=self.deepest),
            strength=np.maximum(state.strength + full[layout.strength], 0.0),
            departure=state.departure + water_step[0] + 1j * water_step[1],
            echo=state.echo + echo_step[0] + 1j * echo_step[1],
        )

    def local(self, state: Shared, paths: Floats | None) -> Estimates:
        """Return the pixels' own best paths and amplitudes."""
        start = None if paths is None else np.nan_to_num(paths, nan=0.0)
        return estimate(
            without_foreground(
                self.targets,
                state.table,
                strength=state.foreground,
                phase_per_path=self.frame.phase_per_path,
            ),
            weight(self.targets, None, state.noise_scale),
            state.table,
            gain=state.gain,
            transfer=self.transfer * (1 + state.echo),
            phase_per_path=self.frame.phase_per_path,
            fluctuation=state.fluctuation,
            front=state.foreground,
            known=start,
        )

    def deviation(
        self, state: Shared, pixels: Pixels, paths: Floats | None
    ) -> Complex | None:
        """Return one standard deviation of the water signal's random change [V]."""
        if state.fluctuation == 0:
            return None
        at = np.full(len(pixels), np.inf) if paths is None else paths
        at = np.where(np.isfinite(at), at, np.inf)
        _, water, _ = water_at(pixels, at, state.table, self.frame.phase_per_path)
        front = foreground(pixels, state.table, self.frame.phase_per_path)
        return state.fluctuation * state.water_signal(water, front)

    def groups(self, estimates: Estimates) -> list[Fitted]:
        """Return pixels and shots with their paths and amplitudes."""
        detected = is_detected(estimates)
        amplitude = np.where(detected[:, None], estimates.amplitude, 0.0)
        path = np.where(detected, estimates.path, np.inf)
        groups = [Fitted(self.targets, path, amplitude)]
        if self.shots is not None:
            count = len(self.shots)
            none = np.zeros((count, amplitude.shape[1]))
            groups.append(Fitted(self.shots, np.full(count, np.inf), none, True))
        return [group for group in groups if len(group.pixels)]

    def normal(
        self, state: Shared, estimates: Estimates, layout: Layout, used: int
    ) -> Normal:
        """Return the normal equations of the first parameters about a state."""
        total = Normal.zero(used)
        for group in self.groups(estimates):
            total = total + normal_equations(
                state,
                group,
                layout,
                used,
                transfer=self.transfer,
                phase_per_path=self.frame.phase_per_path,
            )
        return total

    def scatter(
        self, state: Shared, estimates: Estimates, *, neighbours: bool = True
    ) -> Scatter:
        """Return what explains the scatter from pixel to pixel."""
        return scatter_of(
            state,
            self.groups(estimates),
            transfer=self.transfer,
            phase_per_path=self.frame.phase_per_path,
            neighbours=neighbours,
        )

    def inliers(self, state: Shared) -> tuple[NDArray[np.bool_], Floats]:
        """Return which pixels are no outliers, and the paths of all.

        The fluctuation of the water is allowed for.
        """
        estimates = self.local(state, None)
        found = self.scatter(state, estimates)
        state = replace(
            state, fluctuation=found.fluctuation, noise_scale=found.noise_scale
        )
        estimates = self.local(state, estimates.path)
        return are_inliers(estimates), estimates.path


def _objective(normal: Normal, state: Shared, layout: Layout, widths: Widths) -> float:
    """Return minus twice the logarithm of the posterior, but for a constant."""
    prior, origin = prior_of(state, layout, widths)
    return normal.square + float(prior @ origin**2)
