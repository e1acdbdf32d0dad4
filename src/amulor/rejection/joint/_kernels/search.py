"""Compiled loops of the joint estimation: the search for the most likely path.

Refine (Gauss-Newton steps from the minima on a grid of paths), profile (where the
likelihood has fallen on either side).
"""

from __future__ import annotations

import math

import numpy as np

from amulor._compiled import numba
from amulor.rejection.joint._kernels.bundles import (
    Array,
    Candidates,
    Grid,
    Model,
    Pixel,
    Places,
    Samples,
    Solutions,
    Workspace,
)
from amulor.rejection.joint._kernels.grid import CANDIDATES, start
from amulor.rejection.joint._kernels.model import (
    descent,
    misfit,
    misfit_at,
    pixel_of,
    turn_by,
    water_to,
    workspace_of,
)
from amulor.rejection.joint._kernels.options import inner
from amulor.rejection.joint._kernels.outlying import most_outlying
from amulor.rejection.joint._kernels.weights import fill_weights

#: A minimum is out of the race when it is this much higher [1], and by this fraction of
#: what the target explains, which the coarse grid may miss.
_MARGIN, _GRID_ERROR = 60.0, 0.05
_MOST_STEPS = 20
_HALVINGS = 6
_WIDENINGS = 6
_BISECTIONS = 24


@inner()
def refine(
    path: float, spacing: float, pixel: Pixel, model: Model, work: Workspace
) -> tuple[float, float, float]:
    """Return path, chi-square and information at the minimum near a path.

    Gauss-Newton steps of half the spacing of the grid at most, halved while they lead
    uphill, until they are small against the standard deviation. The information is 0
    where there is no minimum. Compiled because each pixel takes some dozens of steps.
    """
    cost, rate = misfit_at(path, pixel, model, work)
    information = 0.0
    for _ in range(_MOST_STEPS):
        downhill, information = descent(rate, pixel, model, work)
        if not information > 0:
            break
        move = downhill / information
        move = min(max(move, -0.5 * spacing), 0.5 * spacing)
        moved, new = path, cost
        for _ in range(_HALVINGS):
            moved = path + move
            new, rate = misfit_at(moved, pixel, model, work)
            if new <= cost:
                break
            move *= 0.5
        if not new <= cost:
            break
        path, cost = moved, new
        if abs(move) < 1e-3 / math.sqrt(information) or abs(move) < 1e-10:
            break
    return path, cost, information


@inner()
def _lowest(
    count: int,
    empty: float,
    spacing: float,
    pixel: Pixel,
    model: Model,
    work: Workspace,
    candidates: Candidates,
) -> tuple[float, float, float]:
    """Refine the candidates; return path, chi-square and information of the best."""
    paths, costs = candidates.path, candidates.cost
    best, best_path, best_information = np.inf, np.nan, 0.0
    for k in range(count):
        # What is worse by more than the coarse grid can err is not looked at.
        if candidates.level[k] > best + _MARGIN + _GRID_ERROR * empty:
            break
        path, cost, information = refine(paths[k], spacing, pixel, model, work)
        if not information > 0:
            continue
        # The error may carry a path a little beyond its limits.
        slack = min(4 / math.sqrt(information), spacing)
        limits = pixel.limits
        if path < limits.shortest - slack or path > limits.longest + slack:
            continue
        is_known = False
        for m in range(k):
            if costs[m] < np.inf and abs(paths[m] - path) < 0.25 * spacing:
                is_known = True
        if is_known:
            continue
        paths[k], costs[k] = path, cost
        candidates.width[k] = 1 / math.sqrt(information)
        if cost < best:
            best, best_path, best_information = cost, path, information
    return best_path, best, best_information


@inner()
def _wrong(count: int, path: float, cost: float, candidates: Candidates) -> float:
    """Return the probability that the path lies in another minimum (Laplace)."""
    total, own = 0.0, 0.0
    for k in range(count):
        if candidates.cost[k] < np.inf:
            above = min(candidates.cost[k] - cost, 1400.0)
            mass = candidates.width[k] * math.exp(-0.5 * above)
            total += mass
            if candidates.path[k] == path:
                own = mass
    return 1 - own / total


@inner()
def profile(
    side: float,
    path: float,
    cost: float,
    sigma: float,
    pixel: Pixel,
    model: Model,
    work: Workspace,
) -> float:
    """Return how far the path may go to one side until chi-square has risen by 1.

    The amplitudes are fitted anew at every path (profile likelihood). Compiled because
    each pixel takes some dozens of paths.
    """
    inner, outer = 0.0, sigma
    rise = 0.0
    for attempt in range(_WIDENINGS):
        there, _ = misfit_at(path + side * outer, pixel, model, work)
        rise = there - cost
        # A parabola to a tenth: its own width serves.
        if attempt == 0 and abs(rise - 1) < 0.1:
            return outer / math.sqrt(rise)
        if rise >= 1:
            break
        inner, outer = outer, 1.5 * outer
    if rise < 1:
        return outer
    for _ in range(_BISECTIONS):
        middle = 0.5 * (inner + outer)
        there, _ = misfit_at(path + side * middle, pixel, model, work)
        if there - cost < 1:
            inner = middle
        else:
            outer = middle
    return 0.5 * (inner + outer)


@inner()
def _empty_misfit(pixel: Pixel, model: Model, work: Workspace) -> float:
    """Return chi-square of open water without a target."""
    water_to(np.inf, model.table, pixel.coefficient, work.water, work.change)
    turn_by(work.water, pixel.turn)
    work.phasor[:] = 0
    return misfit(
        pixel.signal, pixel.weight, model.gain, work.water, work.phasor, work.amplitude
    )


@inner()
def _outputs(weight: Array) -> int:
    """Return the number of outputs that count, two for each sample."""
    used = 0
    for c in range(weight.shape[0]):
        for f in range(weight.shape[2]):
            if weight[c, 0, f] > 0:
                used += 2
    return used


@inner()
def _fill_nothing(n: int, solutions: Solutions) -> None:
    """Say that a pixel has no possible path."""
    solutions.path[n], solutions.cost[n] = np.nan, np.inf
    solutions.information[n] = 0.0
    solutions.lower[n], solutions.upper[n] = np.nan, np.nan
    solutions.wrong[n] = 1.0
    solutions.explained[n] = 0.0
    solutions.outlying[n], solutions.next_outlying[n] = 0.0, 0.0
    solutions.which[n] = 0
    solutions.amplitude[n] = 0
    solutions.influence[n] = 0


@inner()
def _fill_model(
    n: int,
    path: float,
    pixel: Pixel,
    model: Model,
    work: Workspace,
    solutions: Solutions,
) -> bool:
    """Fill in information, amplitudes, influence and outlying sample of a pixel.

    Return false, and fill in nothing, where the last step has led to a path at which no
    sample depends on the path any more.
    """
    _, rate = misfit_at(path, pixel, model, work)
    _, information = descent(rate, pixel, model, work)
    if not information > 0:
        return False
    solutions.information[n] = information
    amplitude, influence = solutions.amplitude[n], solutions.influence[n]
    for c in range(amplitude.size):
        amplitude[c] = work.amplitude[c]
        for f in range(influence.shape[2]):
            influence[c, 0, f] = work.influence[c, 0, f] / information
            influence[c, 1, f] = work.influence[c, 1, f] / information
    most, second, which = most_outlying(rate, information, pixel, model, work)
    solutions.outlying[n], solutions.next_outlying[n] = most, second
    solutions.which[n] = which
    return True


@inner()
def _estimate_one(
    n: int,
    known: float,
    stated: Pixel,
    model: Model,
    grid: Grid,
    work: Workspace,
    candidates: Candidates,
    solutions: Solutions,
) -> None:
    """Fill in the most likely path of one pixel: start, refine, profile.

    The search takes the fluctuation of open water, or of water up to the path that is
    known; the result that of water up to the path that was found.
    """
    spacing = grid.path[1] - grid.path[0]
    candidates.level[:] = np.inf
    candidates.cost[:] = np.inf
    pixel = stated
    if model.fluctuation > 0:
        fill_weights(known if known > 0 else np.inf, stated, model, work)
        pixel = Pixel(
            stated.signal, work.weight, stated.coefficient, stated.turn, stated.limits
        )
    empty = _empty_misfit(pixel, model, work)
    solutions.empty_cost[n] = empty
    solutions.used[n] = _outputs(pixel.weight)
    is_known = not math.isnan(known)
    if is_known:
        candidates.path[0], candidates.level[0] = known, 0.0
        count = 1
    else:
        count = start(pixel, model, grid, work, candidates)
    path, cost, information = _lowest(
        count, empty, spacing, pixel, model, work, candidates
    )
    if not information > 0:
        _fill_nothing(n, solutions)
        return
    solutions.explained[n] = empty - cost
    solutions.wrong[n] = _wrong(count, path, cost, candidates)
    if model.fluctuation > 0 and not is_known:
        fill_weights(path, stated, model, work)
        path, cost, information = refine(path, spacing, pixel, model, work)
        if not information > 0:
            _fill_nothing(n, solutions)
            return
    solutions.path[n], solutions.cost[n] = path, cost
    sigma = 1 / math.sqrt(information)
    solutions.lower[n], solutions.upper[n] = sigma, sigma
    if not is_known:
        for side in (-1.0, 1.0):
            width = profile(side, path, cost, sigma, pixel, model, work)
            if side < 0:
                solutions.lower[n] = width
            else:
                solutions.upper[n] = width
    if not _fill_model(n, path, pixel, model, work, solutions):
        _fill_nothing(n, solutions)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def estimate(
    begin: int,
    end: int,
    samples: Samples,
    places: Places,
    model: Model,
    grid: Grid,
    known: Array,
    solutions: Solutions,
) -> None:
    """Fill in the most likely path of some pixels, each by itself.

    Maximum likelihood of A_c H(f) exp(i k p) + s_c W(f, z(p)) over p and A_c >= 0, the
    formula under Notes of `amulor.rejection.joint`. Where `known` holds a path, the
    search starts there, and limits of the profile and other intervals are left alone.
    Compiled because a scan has 10^5 to 10^6 pixels with dozens of steps each.
    """
    channels, frequencies = samples.signal.shape[1], samples.signal.shape[3]
    work = workspace_of(channels, frequencies)
    turn = np.empty((2, frequencies))
    candidates = Candidates(
        np.full(CANDIDATES, np.nan),
        np.full(CANDIDATES, np.inf),
        np.full(CANDIDATES, np.inf),
        np.zeros(CANDIDATES),
    )
    for n in range(begin, end):
        pixel = pixel_of(samples, places, n, model.echo.phase_per_path, turn)
        _estimate_one(n, known[n], pixel, model, grid, work, candidates, solutions)
