"""What the pixels of a scan share: strength and shape of the water signal."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from amulor.rejection import _joint_search_kernels as search
from amulor.rejection.joint_pixels import (
    Estimates,
    Pixels,
    estimate,
    grid_of,
    parts,
    shape_changes,
    shares,
    water_at,
    weight,
)
from amulor.rejection.joint_priors import (
    Layout,
    Normal,
    Shared,
    inverse_of,
    prior_of,
    whitened,
    whitened_columns,
    widths_of,
)
from amulor.rejection.joint_water import COEFFICIENTS, Frame, Shape

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: A target is there when it explains this much more than water alone, in chi-square.
DETECTION = 25.0
#: Shares of the water signal that come from in front of the knots of the correction.
_KNOTS = np.array([0.002, 0.01, 0.03, 0.08, 0.18, 0.32, 0.5, 0.68, 0.82, 0.92, 0.975])
_GRID = (np.geomspace(0.06, 2.5, 7), np.geomspace(2e-3, 0.1, 3))
_FORWARD = 1.0
_STARTERS = 48
_AT_ONCE = 128
_PARAMETRIC_STEPS, _FREE_STEPS = 14, 10
_HALVINGS = 4
#: Pixels that misfit by less than this chance have no say in what all share [1].
_ODD = 1e-6
#: A step that promises less than this in chi-square is the last one.
_SETTLED = 0.02


def start(
    frame: Frame,
    targets: Pixels,
    shots: Pixels | None,
    *,
    transfer: Complex,
    longest: float,
) -> tuple[Shape, Floats]:
    """Find a shape and strengths of the water signal from which to start.

    Parameters
    ----------
    frame : Frame
        How the receiver looks at the scan.
    targets : Pixels
        Samples with or without a target.
    shots : Pixels, optional
        Samples that are known to be open water; they decide alone if given.
    transfer : ndarray of complex
        What the echo has beyond its delay [1].
    longest : float
        Depth beyond which no target stands [m].

    Returns
    -------
    tuple of Shape and ndarray
        The best of a grid, and the strength in each channel [V].
    """
    best, found = np.inf, None
    if shots is None:
        few = np.linspace(0, len(targets) - 1, min(_STARTERS, len(targets)))
        some = targets.part(few.astype(np.intp))
        grid = grid_of(some, frame.wavenumber)
    else:
        some, grid = shots, np.zeros(0)
    plain = weight(some)
    channels = some.signal.shape[1]
    nothing = np.zeros(0)
    for loss, spread in itertools.product(*_GRID):
        shape = Shape(float(loss), float(spread), _FORWARD, nothing, nothing)
        table = frame.table(shape, longest=longest)
        if shots is None:
            cost = np.empty(len(some))
            strength = np.zeros((len(some), channels))
            search.starting_costs(
                parts(some.signal), plain, shares(some, table), some.turned,
                parts(table.value), table.step, frame.wavenumber, parts(transfer),
                grid, some.shortest, some.longest, some.depths, cost, strength,
            )  # fmt: skip
            total = float(cost.sum())
            typical = np.median(strength, axis=0)
        else:
            open_path = np.full(len(some), np.inf)
            _, water, _ = water_at(some, open_path, table, frame.wavenumber)
            u, v = (
                whitened(plain, some.signal),
                whitened(plain, np.broadcast_to(water[:, None], some.signal.shape)),
            )
            square = np.einsum("ncx,ncx->c", v, v)
            along = np.einsum("ncx,ncx->c", u, v)
            typical = np.maximum(along, 0) / np.where(square > 0, square, 1)
            total = float(np.sum(u**2) - np.sum(typical * along))
        if total < best:
            best, found = total, (shape, typical)
    assert found is not None
    return found


def fit(
    frame: Frame,
    targets: Pixels,
    shots: Pixels | None,
    *,
    transfer: Complex,
    longest: float,
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
    longest : float
        Depth beyond which no target stands [m].

    Returns
    -------
    Shared
        Estimate with its covariance.

    Notes
    -----
    Gauss-Newton on the strengths, k' and b_f <theta^2> and then, with normal priors,
    on what the model does not know: a smooth factor on the overlap, and departures of
    water signal and echo at each frequency. The paths and amplitudes of the pixels
    are eliminated at every step (Schur complement). The widths of the priors maximise
    the evidence in Laplace's approximation, so they vanish where the model is right.
    """
    shape, strength = start(frame, targets, shots, transfer=transfer, longest=longest)
    channels, frequencies = targets.signal.shape[1:]
    state = Shared(
        shape,
        frame.table(shape, longest=longest),
        strength,
        np.zeros((channels, frequencies), dtype=complex),
        np.zeros(frequencies, dtype=complex),
        0.0,
        np.zeros((0, 0)),
        np.zeros((0, 0)),
        (0.0, 0.0, 0.0),
        0.0,
        np.nan,
    )
    problem = _Problem(frame, targets, shots, transfer, longest)
    state, paths = problem.descend(state, _PARAMETRIC_STEPS, free=False)
    kept = problem.ordinary(state, paths)
    if not kept.all():
        some = targets.part(np.flatnonzero(kept))
        problem = _Problem(frame, some, shots, transfer, longest)
        state, paths = problem.descend(
            state, _PARAMETRIC_STEPS, free=False, paths=paths[kept]
        )
    knots = frame.quantiles(state.shape, _KNOTS)
    free_shape = replace(state.shape, knots=knots, correction=np.zeros(len(knots)))
    state = replace(
        state, shape=free_shape, table=frame.table(free_shape, longest=longest)
    )
    state, paths = problem.descend(state, _FREE_STEPS, free=True, paths=paths)
    return state


class _Problem:
    """The samples of a fit, and its steps."""

    def __init__(
        self,
        frame: Frame,
        targets: Pixels,
        shots: Pixels | None,
        transfer: Complex,
        longest: float,
    ) -> None:
        self.frame = frame
        self.targets = targets
        self.shots = shots
        self.transfer = transfer
        self.longest = longest

    def descend(
        self, state: Shared, steps: int, *, free: bool, paths: Floats | None = None
    ) -> tuple[Shared, Floats]:
        """Take Gauss-Newton steps until they are small against their own errors."""
        channels, frequencies = state.departure.shape
        layout = Layout(channels, frequencies, len(state.shape.knots))
        used = layout.size if free else layout.parametric.stop
        estimates = self.local(state, paths)
        normal = self.normal(state, estimates, layout, used)
        for _ in range(steps):
            if free:
                level = self.fluctuation(state, estimates)
                if level != state.fluctuation:
                    state = replace(state, fluctuation=level)
                    estimates = self.local(state, estimates.path)
                    normal = self.normal(state, estimates, layout, used)
            tried, evidence = (
                widths_of(normal, state, layout) if free else ((0.0, 0.0, 0.0), 0.0)
            )
            prior, origin = prior_of(state, layout, tried)
            matrix = normal.matrix + np.diag(prior[:used])
            vector = normal.vector - (prior * origin)[:used]
            inverse = inverse_of(matrix)
            step = inverse @ vector
            expected = float(vector @ step)
            level = normal.square + float(prior @ origin**2)
            state = replace(state, tried=tried, evidence=evidence, covariance=inverse)
            best = (state, estimates, normal)
            for _ in range(_HALVINGS):
                moved = self.moved(state, step, layout)
                new_estimates = self.local(moved, estimates.path)
                new = self.normal(moved, new_estimates, layout, used)
                new_origin = prior_of(moved, layout, tried)[1]
                if new.square + float(prior @ new_origin**2) < level:
                    best = (moved, new_estimates, new)
                    break
                step = step / 2
            stuck = best[0] is state
            state, estimates, normal = best
            if stuck or expected < _SETTLED:
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
        channels, frequencies = state.departure.shape
        _, water, echo = layout.blocks
        water_step = full[water].reshape(2, channels, frequencies)
        echo_step = full[echo].reshape(2, frequencies)
        return replace(
            state,
            shape=shape,
            table=self.frame.table(shape, longest=self.longest),
            strength=np.maximum(state.strength + full[layout.strength], 0.0),
            departure=state.departure + water_step[0] + 1j * water_step[1],
            echo=state.echo + echo_step[0] + 1j * echo_step[1],
        )

    def local(self, state: Shared, paths: Floats | None) -> Estimates:
        """Return the pixels' own best paths and amplitudes."""
        start = None if paths is None else np.nan_to_num(paths, nan=0.0)
        return estimate(
            self.targets,
            weight(self.targets, self.stray(state, self.targets, paths)),
            state.table,
            gain=state.gain,
            transfer=self.transfer * (1 + state.echo),
            wavenumber=self.frame.wavenumber,
            known=start,
        )

    def stray(
        self, state: Shared, pixels: Pixels, paths: Floats | None
    ) -> Complex | None:
        """Return one standard deviation of the water signal's random change [V]."""
        if state.fluctuation == 0:
            return None
        at = np.full(len(pixels), np.inf) if paths is None else paths
        at = np.where(np.isfinite(at), at, np.inf)
        _, water, _ = water_at(pixels, at, state.table, self.frame.wavenumber)
        return state.fluctuation * state.gain * water[:, None]

    def batches(
        self, state: Shared, estimates: Estimates
    ) -> list[tuple[Pixels, Floats, Floats]]:
        """Return pixels, paths and amplitudes in batches; open water has no path."""
        seen = is_seen(estimates)
        path = np.where(seen, estimates.path, np.inf)
        amplitude = np.where(seen[:, None], estimates.amplitude, 0.0)
        groups = [(self.targets, path, amplitude)]
        if self.shots is not None:
            none = np.full(len(self.shots), np.inf)
            groups.append((self.shots, none, np.zeros((len(none), amplitude.shape[1]))))
        found = []
        for pixels, where, size in groups:
            # Sorted, so that a batch holds either targets or open water.
            order = np.argsort(~np.isfinite(where), kind="stable")
            border = int(np.isfinite(where).sum())
            for first, last in ((0, border), (border, len(where))):
                for begin in range(first, last, _AT_ONCE):
                    chosen = order[begin : min(begin + _AT_ONCE, last)]
                    found.append((pixels.part(chosen), where[chosen], size[chosen]))
        return found

    def normal(
        self, state: Shared, estimates: Estimates, layout: Layout, used: int
    ) -> Normal:
        """Return the normal equations of the first parameters about a state."""
        matrix = np.zeros((used, used))
        vector = np.zeros(used)
        square, rows = 0.0, 0
        for pixels, path, amplitude in self.batches(state, estimates):
            residual, shared, own, count = self.linearised(
                state, layout, used, pixels, path, amplitude
            )
            flat = shared.reshape(-1, used)
            matrix += flat.T @ flat
            vector += flat.T @ residual.ravel()
            square += float(np.sum(residual**2))
            rows += count
            if own is not None:
                # What the pixels' own parameters would take up.
                basis = np.linalg.qr(own)[0].transpose(0, 2, 1)
                along = (basis @ shared).reshape(-1, used)
                taken = (basis @ residual[..., None]).ravel()
                matrix -= along.T @ along
                vector -= along.T @ taken
                square -= float(np.sum(taken**2))
                rows -= taken.size
        return Normal(matrix, vector, square, rows)

    def linearised(
        self,
        state: Shared,
        layout: Layout,
        used: int,
        pixels: Pixels,
        path: Floats,
        amplitude: Floats,
    ) -> tuple[Floats, Floats, Floats | None, int]:
        """Return whitened residuals and derivatives of a batch of pixels."""
        wavenumber = self.frame.wavenumber
        depth, water, slope = water_at(pixels, path, state.table, wavenumber)
        is_target = bool(np.isfinite(path[0]))
        echo = np.zeros_like(water)
        if is_target:
            echo = np.exp(1j * path[:, None] * wavenumber) * self.transfer
        gain = state.gain
        model = gain * water[:, None] + (
            amplitude[..., None] * (echo * (1 + state.echo))[:, None]
        )
        stray = state.fluctuation * gain * water[:, None]
        weights = weight(pixels, stray if state.fluctuation > 0 else None)
        count, channels, frequencies = pixels.signal.shape
        jacobian = np.zeros((count, channels, frequencies, used), dtype=complex)
        _, free, echoes = layout.blocks
        changes = shape_changes(pixels, depth, state.table, wavenumber)
        number = np.arange(frequencies)
        for c in range(channels):
            jacobian[:, c, :, c] = (1 + state.departure[c]) * water
            jacobian[:, c, :, layout.shape] = gain[c][:, None] * np.swapaxes(
                changes, 1, 2
            )
            if used < layout.size:
                continue
            first = free.start + c * frequencies + number
            other = first + channels * frequencies
            jacobian[:, c, number, first] = state.strength[c] * water
            jacobian[:, c, number, other] = 1j * state.strength[c] * water
            if is_target:
                own_echo = amplitude[:, c, None] * echo
                jacobian[:, c, number, echoes.start + number] = own_echo
                jacobian[:, c, number, echoes.start + frequencies + number] = (
                    1j * own_echo
                )
        residual = whitened(weights, np.where(pixels.usable, pixels.signal - model, 0))
        shared = whitened_columns(weights, jacobian)
        own = None
        if is_target:
            columns = np.zeros(
                (count, channels, frequencies, channels + 1), dtype=complex
            )
            full = echo * (1 + state.echo)
            for c in range(channels):
                columns[:, c, :, c] = full
                columns[:, c, :, channels] = (
                    1j * wavenumber * amplitude[:, c, None] * full + gain[c] * slope
                )
            own = whitened_columns(weights, columns)
        return (
            residual.reshape(count, -1),
            shared,
            own,
            2 * int(pixels.usable.sum()),
        )

    def ordinary(self, state: Shared, paths: Floats) -> NDArray[np.bool_]:
        """Return which pixels are no odd ones among the others: edges, fish, bubbles.

        Their misfit is compared with the median, whatever that is: a model that is
        wrong for all pixels makes none of them odd.
        """
        from scipy.stats import chi2

        if not len(self.targets):
            return np.ones(0, dtype=bool)
        estimates = self.local(state, paths)
        level = self.fluctuation(state, estimates)
        estimates = self.local(replace(state, fluctuation=level), paths)
        seen = is_seen(estimates)
        cost = np.where(seen, estimates.cost, estimates.empty_cost)
        own = seen * (1 + state.strength.size)
        freedom = np.maximum(estimates.used - own, 1)
        typical = max(float(np.median(cost / chi2.median(freedom))), 1.0)
        kept: NDArray[np.bool_] = chi2.sf(cost / typical, freedom) > _ODD
        return kept

    def fluctuation(self, state: Shared, estimates: Estimates) -> float:
        """Return the relative change of the water signal that explains the scatter."""
        batches = []
        rows = 0
        for pixels, path, amplitude in self.batches(state, estimates):
            _, water, _ = water_at(pixels, path, state.table, self.frame.wavenumber)
            model = state.gain * water[:, None]
            rows += 2 * int(pixels.usable.sum())
            if np.isfinite(path[0]):
                echo = np.exp(1j * path[:, None] * self.frame.wavenumber)
                echo = echo * self.transfer * (1 + state.echo)
                rows -= len(pixels) * (1 + model.shape[1])
                left = pixels.signal - model - amplitude[..., None] * echo[:, None]
            else:
                left = pixels.signal - model
            batches.append((pixels, left, model))

        def excess(level: float) -> float:
            total = 0.0
            for pixels, left, model in batches:
                found = whitened(weight(pixels, level * model), left)
                total += float(np.sum(found**2))
            return total / rows - 1

        # Within what chance does, the stated errors explain the scatter alone.
        if excess(0.0) < 3 * np.sqrt(2 / rows):
            return 0.0
        low, high = 0.0, 1.0
        if excess(high) > 0:
            return high
        for _ in range(30):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if excess(middle) > 0 else (low, middle)
        return 0.5 * (low + high)


def is_seen(estimates: Estimates) -> NDArray[np.bool_]:
    """Return which pixels have a target rather than open water.

    Parameters
    ----------
    estimates : Estimates
        What was found for each pixel.

    Returns
    -------
    ndarray of bool
        True where a target explains the samples better by `DETECTION`.
    """
    better = estimates.empty_cost - estimates.cost >= DETECTION
    lit = (estimates.amplitude > 0).any(axis=1)
    return np.asarray(np.isfinite(estimates.path) & better & lit)
