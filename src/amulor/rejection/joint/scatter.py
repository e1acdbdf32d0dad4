"""What the scatter says: where targets are, outliers, a water that fluctuates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint.normal import Fitted, modelled
from amulor.rejection.joint.pixels import weight
from amulor.rejection.joint.priors import Shared, whitened
from amulor.rejection.joint.search import Estimates

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: A target is there when it explains this much more than water alone, in chi-square.
DETECTION = 25.0
#: Pixels whose p-value is below this have no say in what all share [1].
_OUTLIER = 1e-6
_BISECTIONS = 30


def is_detected(estimates: Estimates) -> NDArray[np.bool_]:
    """Return which pixels have a target rather than open water.

    Parameters
    ----------
    estimates : Estimates
        Solutions of all pixels.

    Returns
    -------
    ndarray of bool
        True where a target explains the samples better by `DETECTION`.
    """
    better = estimates.empty_cost - estimates.cost >= DETECTION
    is_positive = (estimates.amplitude > 0).any(axis=1)
    return np.asarray(np.isfinite(estimates.path) & better & is_positive)


def are_inliers(estimates: Estimates) -> NDArray[np.bool_]:
    """Return which pixels are no outliers, as edges, fish and bubbles are.

    Their misfit is compared with the median, whatever that is: a model that is wrong
    for all pixels makes none of them an outlier.

    Parameters
    ----------
    estimates : Estimates
        Solutions of all pixels.

    Returns
    -------
    ndarray of bool
        False where a pixel misfits far more than the others.
    """
    from scipy.stats import chi2

    if not len(estimates.path):
        return np.ones(0, dtype=bool)
    detected = is_detected(estimates)
    cost = np.where(detected, estimates.cost, estimates.empty_cost)
    own = detected * (1 + estimates.amplitude.shape[1])
    freedom = np.maximum(estimates.used - own, 1)
    typical = max(float(np.median(cost / chi2.median(freedom))), 1.0)
    kept: NDArray[np.bool_] = chi2.sf(cost / typical, freedom) > _OUTLIER
    return kept


def fluctuation_of(
    state: Shared, groups: list[Fitted], *, transfer: Complex, phase_per_path: Floats
) -> float:
    """Return the relative change of the water signal that explains the scatter.

    Parameters
    ----------
    state : Shared
        What the pixels share.
    groups : list of Fitted
        All samples with paths and amplitudes.
    transfer : ndarray of complex
        What the echo has beyond its delay, as known [1].
    phase_per_path : ndarray
        2 pi f / c_0 of each frequency [rad/m].

    Returns
    -------
    float
        0 where the stated errors explain the scatter alone; 1 at most [1].
    """
    parts, rows = [], 0
    for group in groups:
        model = modelled(state, group, transfer=transfer, phase_per_path=phase_per_path)
        parts.append((group.pixels, model.residual, model.water_signal))
        own = 1 + group.amplitude.shape[1]
        rows += 2 * int(group.pixels.usable.sum())
        rows -= own * int(np.isfinite(group.path).sum())

    def excess(level: float) -> float:
        total = 0.0
        for pixels, residual, water_signal in parts:
            deviation = level * water_signal if level > 0 else None
            weights = weight(pixels, deviation)
            total += float(np.sum(whitened(weights, residual) ** 2))
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
