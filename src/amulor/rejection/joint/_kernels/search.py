"""Compiled loops of joint estimation: maximum-likelihood path of each pixel."""

from __future__ import annotations

import math

import numpy as np

from amulor._compiled import numba
from amulor.rejection.joint._kernels.bundles import (
    Array,
    Candidates,
    Echo,
    Grid,
    Model,
    Pixel,
    Places,
    Samples,
    Solutions,
    WaterTable,
    Workspace,
)
from amulor.rejection.joint._kernels.compiled import LANES, inner
from amulor.rejection.joint._kernels.model import (
    depth_of,
    descent,
    misfit,
    misfit_at,
    nearest_node,
    pixel_of,
    turn_by,
    water_at_node,
    water_to,
    workspace_of,
)

#: Number of local minima of the coarse likelihood that are refined.
CANDIDATES = 6


@inner()
def _keep(path: float, level: float, candidates: Candidates) -> bool:
    """Replace the highest candidate by a lower minimum; False if it is not lower."""
    worst = 0
    for k in range(CANDIDATES):
        if candidates.level[k] > candidates.level[worst]:
            worst = k
    if not level < candidates.level[worst]:
        return False
    candidates.path[worst], candidates.level[worst] = path, level
    return True


@inner()
def _sort(candidates: Candidates) -> None:
    """Sort candidate minima by rising chi-square."""
    paths, levels = candidates.path, candidates.level
    for k in range(1, CANDIDATES):
        path, level = paths[k], levels[k]
        m = k
        while m > 0 and levels[m - 1] > level:
            paths[m], levels[m] = paths[m - 1], levels[m - 1]
            m -= 1
        paths[m], levels[m] = path, level


@inner(fastmath=LANES)
def start(
    pixel: Pixel, model: Model, grid: Grid, work: Workspace, candidates: Candidates
) -> int:
    """Find the lowest local minima of chi-square on a grid; return their number.

    On the grid the water ends at the nearest node of its table. A minimum is the vertex
    of the parabola through three points. Compiled because all phases of a period have
    to be tried in every ambiguity interval of the highest frequency.
    """
    spacing = grid.path[1] - grid.path[0]
    shortest = pixel.limits.shortest - spacing
    longest = pixel.limits.longest + spacing
    before, level = np.inf, np.inf
    filled = -1
    count = 0
    for j in range(grid.path.size + 1):
        after = np.inf
        if j < grid.path.size and shortest <= grid.path[j] <= longest:
            depth, _ = depth_of(grid.path[j], pixel.limits)
            node = nearest_node(depth, model.table)
            if node != filled:
                filled = node
                water_at_node(node, model.table, pixel, work.water)
            after = misfit(
                pixel.signal, pixel.weight, model.gain, work.water, grid.phasor[j],
                work.amplitude,
            )  # fmt: skip
        if level < np.inf and level <= before and level < after:
            place, height = grid.path[j - 1], level
            bend = before - 2 * level + after
            if before < np.inf and after < np.inf and bend > 0:
                shift = 0.5 * (before - after) / bend
                place += shift * spacing
                height -= 0.25 * (before - after) * shift
            if _keep(place, height, candidates):
                count = min(count + 1, CANDIDATES)
        before, level = level, after
    _sort(candidates)
    return count


@inner(fastmath=LANES)
def fill_weights(path: float, stated: Pixel, model: Model, work: Workspace) -> None:
    """Compute the inverse covariance of samples, water fluctuation included.

    (C + d d')^-1 by Sherman and Morrison, with the stated covariance C and the
    deviation d = phi (s W + s d V) of water that ends at a path. The water up to a
    target may be many times as strong as open water at high frequencies, where the
    ends of the column interfere. Compiled because every pixel needs it twice.
    """
    water, weight = work.water, work.weight
    depth = np.inf
    if path < np.inf:
        depth, _ = depth_of(path, stated.limits)
    water_to(depth, model.table, stated.coefficient, water, work.change)
    turn_by(water, stated.turn)
    level = 0.0
    for r in range(stated.coefficient.size):
        level += stated.coefficient[r] * model.level[r]
    size = model.fluctuation
    for c in range(weight.shape[0]):
        for f in range(weight.shape[2]):
            g, h = model.gain[c, 0, f], model.gain[c, 1, f]
            a, b = level * model.front[c, 0, f], level * model.front[c, 1, f]
            p, q = stated.turn[0, f], stated.turn[1, f]
            x = size * (g * water[0, f] - h * water[1, f] + a * p - b * q)
            y = size * (g * water[1, f] + h * water[0, f] + a * q + b * p)
            xx, xy, yy = (
                stated.weight[c, 0, f],
                stated.weight[c, 1, f],
                stated.weight[c, 2, f],
            )
            u = xx * x + xy * y
            v = xy * x + yy * y
            share = 1 / (1 + x * u + y * v)
            weight[c, 0, f] = xx - share * u * u
            weight[c, 1, f] = xy - share * u * v
            weight[c, 2, f] = yy - share * v * v


#: A sample that leaves less than this of its variance to its residual decides alone
#: what is fitted to it, and cannot be judged [1].
_LEAST_REST = 1e-3


@inner(fastmath=LANES)
def most_outlying(
    rate: float, information: float, pixel: Pixel, model: Model, work: Workspace
) -> tuple[float, float, int]:
    """Return chi-square drops of the two most outlying samples; index of the first.

    r' S^-1 r with the residual r of a sample and the covariance S = V - J C J' that
    remains of its covariance V when path and amplitude are fitted to it, too; exact
    where the model is linear in them. The workspace holds model and amplitudes at the
    path, `rate` is dz/dp. Compiled for speed.
    """
    signal, weight, gain = pixel.signal, pixel.weight, model.gain
    water, change, phasor = work.water, work.change, work.phasor
    wavenumber = model.echo.phase_per_path
    most, second, which = 0.0, 0.0, 0
    frequencies = signal.shape[2]
    by_path = work.influence
    for c in range(signal.shape[0]):
        cross, fit = 0.0, 0.0
        a = work.amplitude[c]
        for f in range(frequencies):
            xx, xy, yy = weight[c, 0, f], weight[c, 1, f], weight[c, 2, f]
            g, h = gain[c, 0, f], gain[c, 1, f]
            e, i = phasor[0, f], phasor[1, f]
            p = -a * wavenumber[f] * i + rate * (g * change[0, f] - h * change[1, f])
            q = a * wavenumber[f] * e + rate * (g * change[1, f] + h * change[0, f])
            by_path[c, 0, f], by_path[c, 1, f] = p, q
            cross += p * (xx * e + xy * i) + q * (xy * e + yy * i)
            fit += xx * e * e + 2 * xy * e * i + yy * i * i
        has_echo = a > 0 and fit > 0
        ratio = cross / fit if has_echo else 0.0
        variance = 1 / fit if has_echo else 0.0
        for f in range(frequencies):
            xx, xy, yy = weight[c, 0, f], weight[c, 1, f], weight[c, 2, f]
            determinant = xx * yy - xy * xy
            if not determinant > 0:
                continue
            g, h = gain[c, 0, f], gain[c, 1, f]
            e, i = phasor[0, f], phasor[1, f]
            u = signal[c, 0, f] - g * water[0, f] + h * water[1, f] - a * e
            v = signal[c, 1, f] - g * water[1, f] - h * water[0, f] - a * i
            p = by_path[c, 0, f] - ratio * e
            q = by_path[c, 1, f] - ratio * i
            sxx = yy / determinant - variance * e * e - p * p / information
            sxy = -xy / determinant - variance * e * i - p * q / information
            syy = xx / determinant - variance * i * i - q * q / information
            left = sxx * syy - sxy * sxy
            if not (sxx > 0 and left * determinant > _LEAST_REST):
                continue
            gain_in_fit = (syy * u * u - 2 * sxy * u * v + sxx * v * v) / left
            if gain_in_fit > most:
                second, most = most, gain_in_fit
                which = c * frequencies + f
            elif gain_in_fit > second:
                second = gain_in_fit
    return most, second, which


#: Relative determinant below which two columns are linearly dependent [1].
_DEPENDENT = 1e-12


@inner()
def two_amplitudes(
    signal: Array, weight: Array, echo: Array, water: Array
) -> tuple[float, float]:
    """Fit target and water in one channel; return chi-square and water strength.

    Linear least squares on echo and water, neither below zero. Arrays are (2,
    frequency), the weight (3, frequency).
    """
    ee, ew, ww, ye, yw, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for f in range(signal.shape[1]):
        a, b, d = weight[0, f], weight[1, f], weight[2, f]
        u, v = signal[0, f], signal[1, f]
        e, i = echo[0, f], echo[1, f]
        w, x = water[0, f], water[1, f]
        yy += a * u * u + 2 * b * u * v + d * v * v
        ye += e * (a * u + b * v) + i * (b * u + d * v)
        yw += w * (a * u + b * v) + x * (b * u + d * v)
        ee += a * e * e + 2 * b * e * i + d * i * i
        ew += e * (a * w + b * x) + i * (b * w + d * x)
        ww += a * w * w + 2 * b * w * x + d * x * x
    determinant = ee * ww - ew * ew
    s, t = 0.0, 0.0
    if determinant > _DEPENDENT * ee * ww:
        t = (ye * ww - yw * ew) / determinant
        s = (yw * ee - ye * ew) / determinant
    if t <= 0 or s <= 0:
        t, s = max(ye, 0.0) / ee if ee > 0 else 0.0, 0.0
        if ww > 0 and yw > 0 and yw * yw / ww > t * ye:
            t, s = 0.0, yw / ww
    return yy - t * ye - s * yw, s


@numba.njit(cache=True, error_model="numpy")
def starting_costs(
    samples: Samples,
    places: Places,
    table: WaterTable,
    echo: Echo,
    grid: Grid,
    best: Array,
    strength: Array,
) -> None:
    """Compute each pixel's least chi-square on the path grid, and water strengths.

    For every path on the grid the amplitudes A_c of the target and s_c of the water are
    fitted channel by channel; `strength` holds s_c at the best path. Compiled because
    it is done for every shape of W that is tried.
    """
    channels, frequencies = samples.signal.shape[1], samples.signal.shape[3]
    water = np.empty((2, frequencies))
    turn = np.empty((2, frequencies))
    trial = np.empty(channels)
    for n in range(samples.signal.shape[0]):
        pixel = pixel_of(samples, places, n, echo.phase_per_path, turn)
        best[n] = np.inf
        for j in range(grid.path.size):
            if not pixel.limits.shortest <= grid.path[j] <= pixel.limits.longest:
                continue
            depth, _ = depth_of(grid.path[j], pixel.limits)
            water_at_node(nearest_node(depth, table), table, pixel, water)
            total = 0.0
            for c in range(channels):
                cost, trial[c] = two_amplitudes(
                    pixel.signal[c], pixel.weight[c], grid.phasor[j], water
                )
                total += cost
            if total < best[n]:
                best[n] = total
                strength[n] = trial


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
    """Return path, chi-square and information at the nearest minimum of chi-square.

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
        # Candidates worse by more than the error of the coarse grid are skipped.
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
    """Return the probability of a wrong minimum, by Laplace's approximation."""
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
    """Return the offset from the best path, to one side, that raises chi-square by 1.

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
    """Return the number of usable lock-in outputs, two per usable sample."""
    used = 0
    for c in range(weight.shape[0]):
        for f in range(weight.shape[2]):
            if weight[c, 0, f] > 0:
                used += 2
    return used


@inner()
def _fill_nothing(n: int, solutions: Solutions) -> None:
    """Set the results of a pixel without a solution."""
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
    """Set the results of a pixel at its path; False if the path is undetermined.

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
    """Estimate the most likely path of one pixel, with amplitudes and uncertainty.

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
    """Estimate the most likely path of each pixel from `begin` to `end`.

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
