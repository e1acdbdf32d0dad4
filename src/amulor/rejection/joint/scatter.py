"""What the scatter says: where targets are, odd pixels, a water that fluctuates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint.normal import Seen, modelled
from amulor.rejection.joint.pixels import weight
from amulor.rejection.joint.priors import Shared, whitened
from amulor.rejection.joint.search import Estimates

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: A target is there when it explains this much more than water alone, in chi-square.
DETECTION = 25.0
#: Pixels that misfit by less than this chance have no say in what all share [1].
_ODD = 1e-6
_BISECTIONS = 30


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


def are_ordinary(estimates: Estimates) -> NDArray[np.bool_]:
    """Return which pixels are no odd ones among the others: edges, fish, bubbles.

    Their misfit is compared with the median, whatever that is: a model that is wrong
    for all pixels makes none of them odd.

    Parameters
    ----------
    estimates : Estimates
        What was found for each pixel.

    Returns
    -------
    ndarray of bool
        False where a pixel misfits far more than the others.
    """
    from scipy.stats import chi2

    if not len(estimates.path):
        return np.ones(0, dtype=bool)
    seen = is_seen(estimates)
    cost = np.where(seen, estimates.cost, estimates.empty_cost)
    own = seen * (1 + estimates.amplitude.shape[1])
    freedom = np.maximum(estimates.used - own, 1)
    typical = max(float(np.median(cost / chi2.median(freedom))), 1.0)
    kept: NDArray[np.bool_] = chi2.sf(cost / typical, freedom) > _ODD
    return kept


def fluctuation_of(
    state: Shared, groups: list[Seen], *, transfer: Complex, wavenumber: Floats
) -> float:
    """Return the relative change of the water signal that explains the scatter.

    Parameters
    ----------
    state : Shared
        What the pixels share.
    groups : list of Seen
        All samples with paths and amplitudes.
    transfer : ndarray of complex
        What the echo has beyond its delay, as known [1].
    wavenumber : ndarray
        Phase per path of each frequency [1/m].

    Returns
    -------
    float
        0 where the stated errors explain the scatter alone; 1 at most [1].
    """
    parts, rows = [], 0
    for seen in groups:
        found = modelled(state, seen, transfer=transfer, wavenumber=wavenumber)
        parts.append((seen.pixels, found.left, found.light))
        own = 1 + seen.amplitude.shape[1]
        rows += 2 * int(seen.pixels.usable.sum())
        rows -= own * int(np.isfinite(seen.path).sum())

    def excess(level: float) -> float:
        total = 0.0
        for pixels, left, light in parts:
            stray = level * light if level > 0 else None
            total += float(np.sum(whitened(weight(pixels, stray), left) ** 2))
        return total / rows - 1

    # Within what chance does, the stated errors explain the scatter alone.
    if excess(0.0) < 3 * np.sqrt(2 / rows):
        return 0.0
    low, high = 0.0, 1.0
    if excess(high) > 0:
        return high
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return 0.5 * (low + high)
