"""Fit of the shared parameters: its samples, cost and Gauss-Newton steps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint.motion import at_instant, estimates_of
from amulor.rejection.joint.normal import (
    Fitted,
    Normal,
    foreground,
    normal_equations,
    water_at,
)
from amulor.rejection.joint.overlap import COEFFICIENTS, Frame
from amulor.rejection.joint.priors import (
    NONE,
    Layout,
    Shared,
    Widths,
    cost_of,
    drifted,
    inverse_of,
    layout_of,
    prior_of,
    widths_of,
)
from amulor.rejection.joint.samples import Pixels, weight
from amulor.rejection.joint.scatter import Scatter, is_detected, scatter_of
from amulor.rejection.joint.search import Estimates
from amulor.rejection.joint.tables import table_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Dampings tried for a step, each ten times the one before, and the least of them [1].
_TRIALS, _LEAST_DAMPING = 6, 1e-3
#: Gain in chi-square below which a step is the last one, and the number of trials of a
#: step whose expected gain is below 1 [1].
_SETTLED = 0.02
_FEW_TRIALS = 3
#: Largest drift coefficient: with three, the strength stays above zero [1].
_LARGEST = 0.3
#: Largest turn of the receiver in prior standard deviations; beyond it, the model of
#: the water is wrong [1].
_FURTHEST = 3.0


class Problem:
    """Fit problem of the shared parameters: samples, cost and Gauss-Newton steps."""

    def __init__(
        self,
        frame: Frame,
        targets: Pixels,
        shots: Pixels | None,
        transfer: Complex,
        deepest: float,
        *,
        still: bool = False,
    ) -> None:
        if shots is not None:
            # The strength of shots does not depend on their time.
            count = targets.trends.shape[1] if len(targets) else 0
            shots = replace(shots, trends=np.zeros((len(shots), count)))
        self.frame = frame
        self.targets = targets
        self.shots = shots
        self.transfer = transfer
        self.deepest = deepest
        #: Whether path rates are errors, as long as the scatter of samples is unknown.
        self.still = still

    def _with(self, **changes: Any) -> Problem:
        """Return a copy with changed targets, shots or rates."""
        kept: dict[str, Any] = {
            "targets": self.targets, "shots": self.shots, "still": self.still
        }  # fmt: skip
        return Problem(
            self.frame, transfer=self.transfer, deepest=self.deepest, **kept | changes
        )

    def part(self, index: NDArray[np.intp], *, shots: bool = True) -> Problem:
        """Return a copy with selected pixels, with or without open-water references."""
        chosen = self.shots if shots else None
        return self._with(targets=self.targets.part(index), shots=chosen)

    def of(self, targets: Pixels) -> Problem:
        """Return a copy with replaced target pixels."""
        return self._with(targets=targets)

    def at_rest(self) -> Problem:
        """Return a copy that takes the path rates of readings in turn as errors."""
        return self._with(still=True)

    def with_shots(self, shots: Pixels) -> Problem:
        """Return a copy with replaced open-water references."""
        return self._with(shots=shots)

    def cost(self, state: Shared) -> float:
        """Return minus twice the logarithm of the evidence, up to a constant."""
        layout = layout_of(state)
        estimates = self.local(state, None)
        normal = self.normal(state, estimates, layout, layout.size)
        prior_cost = cost_of(normal.matrix, normal.vector, state, layout, state.widths)
        volume = 0.0
        for group in self.groups(state, estimates):
            deviation = self.deviation(state, group.pixels, group.path)
            inverse = weight(group.pixels, deviation, state.noise_scale)
            square = inverse[:, :, 0] * inverse[:, :, 2] - inverse[:, :, 1] ** 2
            volume -= float(np.sum(np.log(square[square > 0])))
        return normal.square + prior_cost + volume

    def descend(
        self, state: Shared, steps: int, *, free: bool, paths: Floats | None = None
    ) -> tuple[Shared, Floats]:
        """Iterate Gauss-Newton steps; return shared parameters and pixel paths."""
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
                # Levenberg and Marquardt, between Newton and steepest descent.
                damped = matrix + damping * np.diag(np.diag(matrix))
                step = inverse_of(damped) @ vector
                moved = self.moved(state, step, layout)
                new_estimates = self.local(moved, estimates.path)
                new = self.normal(moved, new_estimates, layout, 0)
                if _objective(new, moved, layout, widths) < level:
                    # Derivatives only for steps that are taken.
                    new = self.normal(moved, new_estimates, layout, used)
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
        """Return the parameters after a step, with a new water-signal table."""
        full = np.zeros(layout.size)
        full[: len(step)] = step
        bounded = full[layout.shape].copy()
        # Logarithms of coefficients: no more than a factor of e at once.
        bounded[:COEFFICIENTS] = np.clip(bounded[:COEFFICIENTS], -1, 1)
        shape = state.shape.moved(
            bounded[: layout.blocks[0].stop - len(state.strength)]
        )
        limit = _FURTHEST * state.turn_width
        shape = replace(shape, turn=np.clip(shape.turn, -limit, limit))
        channels, frequencies = state.departure.shape
        _, water, echo = layout.blocks
        water_step = full[water].reshape(2, channels, frequencies)
        echo_step = full[echo].reshape(2, frequencies)
        shot_change, shot_departure = state.shot_change, state.shot_departure
        if layout.doubts:
            shot_step = full[layout.doubt]
            parts = shot_step[:-1].reshape(2, channels, frequencies)
            shot_change = shot_change + float(np.clip(shot_step[-1], -1, 1))
            shot_departure = shot_departure + parts[0] + 1j * parts[1]
        return replace(
            state,
            shape=shape,
            shot_change=shot_change,
            shot_departure=shot_departure,
            table=table_of(self.frame, shape, deepest=self.deepest),
            trend=np.clip(state.trend + full[layout.trend], -_LARGEST, _LARGEST),
            strength=np.maximum(state.strength + full[layout.strength], 0.0),
            departure=state.departure + water_step[0] + 1j * water_step[1],
            echo=state.echo + echo_step[0] + 1j * echo_step[1],
        )

    def local(
        self, state: Shared, paths: Floats | None, pixels: Pixels | None = None
    ) -> Estimates:
        """Estimate paths and amplitudes of `pixels`, by default of all targets."""
        pixels = drifted(self.targets if pixels is None else pixels, state.trend)
        return estimates_of(
            pixels,
            state,
            transfer=self.transfer,
            phase_per_path=self.frame.phase_per_path,
            start=None if paths is None else np.nan_to_num(paths, nan=0.0),
            still=self.still,
        )

    def deviation(
        self, state: Shared, pixels: Pixels, paths: Floats | None
    ) -> Complex | None:
        """Return the complex 1-sigma water fluctuation [V]; None if zero."""
        if state.fluctuation == 0:
            return None
        at = np.full(len(pixels), np.inf) if paths is None else paths
        at = np.where(np.isfinite(at), at, np.inf)
        _, water, _ = water_at(pixels, at, state.table, self.frame.phase_per_path)
        front = foreground(pixels, state.table, self.frame.phase_per_path)
        return state.fluctuation * state.water_signal(water, front)

    def groups(self, state: Shared, estimates: Estimates) -> list[Fitted]:
        """Return pixels with echo paths and amplitudes, and references without echo."""
        detected = is_detected(estimates)
        amplitude = np.where(detected[:, None], estimates.amplitude, 0.0)
        path = np.where(detected, estimates.path, np.inf)
        targets = at_instant(
            drifted(self.targets, state.trend),
            estimates.path,
            None if self.still else estimates.rate,
            state,
            self.frame.phase_per_path,
        )
        groups = [Fitted(targets, path, amplitude)]
        if self.shots is not None:
            count = len(self.shots)
            none = np.zeros((count, amplitude.shape[1]))
            groups.append(Fitted(self.shots, np.full(count, np.inf), none, True))
        return [group for group in groups if len(group.pixels)]

    def normal(
        self, state: Shared, estimates: Estimates, layout: Layout, used: int
    ) -> Normal:
        """Return the normal equations of the first `used` parameters at a state."""
        total = Normal.zero(used)
        for group in self.groups(state, estimates):
            total = total + normal_equations(
                state,
                group,
                layout,
                used,
                transfer=self.transfer,
                phase_per_path=self.frame.phase_per_path,
            )
        # The prior of the rates of targets.
        rates = estimates.rate[is_detected(estimates)]
        return replace(total, square=total.square + float(rates @ rates))

    def scatter(
        self, state: Shared, estimates: Estimates, *, neighbors: bool = True
    ) -> Scatter:
        """Estimate noise scale and fluctuation from the scatter between pixels."""
        return scatter_of(
            state,
            self.groups(state, estimates),
            transfer=self.transfer,
            phase_per_path=self.frame.phase_per_path,
            neighbors=neighbors,
        )

    def scattered(
        self, state: Shared, paths: Floats | None = None, *, neighbors: bool = True
    ) -> tuple[Shared, Estimates]:
        """Re-estimate noise scale and fluctuation; return parameters and estimates.

        `paths` are the start of the search; by default all paths are searched.
        """
        estimates = self.local(state, paths)
        scatter = self.scatter(state, estimates, neighbors=neighbors)
        state = replace(
            state, fluctuation=scatter.fluctuation, noise_scale=scatter.noise_scale
        )
        return state, self.local(state, estimates.path)


def _objective(normal: Normal, state: Shared, layout: Layout, widths: Widths) -> float:
    """Return minus twice the logarithm of the posterior, up to a constant."""
    prior, origin = prior_of(state, layout, widths)
    return normal.square + float(prior @ origin**2)
