"""Compiled loops of the joint estimation: minima of the likelihood on a grid."""

from __future__ import annotations

import numpy as np

from amulor.rejection.joint._kernels.bundles import (
    Candidates,
    Grid,
    Model,
    Pixel,
    Workspace,
)
from amulor.rejection.joint._kernels.model import (
    depth_of,
    misfit,
    nearest_node,
    water_at_node,
)
from amulor.rejection.joint._kernels.options import LANES, inner

#: Local minima of the coarse likelihood that are looked at closely.
CANDIDATES = 6


@inner()
def _keep(path: float, level: float, candidates: Candidates) -> bool:
    """Put a minimum in the place of the highest one, if it is lower."""
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
    """Sort minima by their level, the lowest first."""
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
    """Fill in the lowest local minima of chi-square on a grid; return their number.

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
