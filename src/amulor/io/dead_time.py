"""Counting loss of photon counters by their dead time, corrected with its error."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import FormatError

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Counter:
    """Photon counter behind histograms, as stated in their file."""

    cycles: NDArray[Any]
    """Laser pulses of each histogram, dimensions (scene, row, column) [1]."""
    dead_time: float
    """Time after a photon in which no other is counted [s]; infinite until the next
    pulse."""
    dead_time_uncertainty: float = 0.0
    """Standard uncertainty of the dead time [s]."""


@dataclass(frozen=True)
class Light:
    """Photons that reach the counter, with the variances of their estimates."""

    mean: Floats
    """Mean number of photons in each bin [1]."""
    variance: Floats
    """Variance of the estimate [1]."""


def without_loss(
    counts: NDArray[Any],
    cycles: NDArray[Any],
    *,
    dead_bins: float,
    period_bins: float | None,
    path: Path,
) -> Light:
    r"""Correct the loss of photons, which a counter does not detect while it is dead.

    Notes
    -----
    Of N pulses, the counter is ready in bin k in :math:`L_k = N - \sum_j n_j`, the sum
    over the bins of the dead time before it. A bin counts the first photon. Its mean
    number of photons is :math:`-N \ln(1 - n_k / L_k)`, for a dead time until the next
    pulse that of Coates (1968). Given the earlier bins, :math:`n_k` is binomial, so
    errors of bins are uncorrelated, with variances
    :math:`N^2 n_k / L_k (L_k - n_k)`.
    """
    pulses = cycles[..., None].astype(float)
    number = counts.astype(float)
    ready = ready_pulses(
        counts, cycles, dead_bins=dead_bins, period_bins=period_bins, path=path
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.divide(number, ready, out=np.zeros_like(number), where=ready > 0)
        mean = -pulses * np.log1p(-share)
        variance = np.where(
            number > 0, pulses**2 * number / (ready * (ready - number)), 0.0
        )
    # A bin in which every ready pulse has a photon has no upper limit.
    certain = (share >= 1).any(axis=-1, keepdims=True)
    return Light(np.where(certain, np.nan, mean), np.where(certain, np.nan, variance))


def ready_pulses(
    counts: NDArray[Any],
    cycles: NDArray[Any],
    *,
    dead_bins: float,
    period_bins: float | None,
    path: Path,
) -> Floats:
    """Return the number of pulses for which the counter was ready, for each bin."""
    pulses = cycles[..., None].astype(float)
    number = counts.astype(float)
    total: Floats = np.zeros((*number.shape[:-1], number.shape[-1] + 1))
    np.cumsum(number, axis=-1, out=total[..., 1:])
    bins = np.arange(number.shape[-1], dtype=float)
    blocked: Floats = total[..., :-1] - _at(total, bins - dead_bins)
    if period_bins is not None and np.isfinite(dead_bins):
        # Photons of earlier pulses.
        for back in range(1, int(dead_bins / period_bins) + 2):
            first = bins + back * period_bins - dead_bins
            blocked = blocked + total[..., -1:] - _at(total, first)
    ready = pulses - blocked
    if np.any(ready < number):
        raise FormatError(
            f"{path}: field 'counts' has more photons than a counter with this dead "
            f"time detects in {int(cycles.max())} pulses; check 'cycles' and "
            "'dead_time_s'"
        )
    return ready


def _at(total: Floats, place: Floats) -> Floats:
    """Return cumulative counts at places between bins, linear in each bin."""
    clipped = np.clip(place, 0, total.shape[-1] - 1)
    low = np.minimum(np.floor(clipped).astype(int), total.shape[-1] - 2)
    part = clipped - low
    return np.asarray((1 - part) * total[..., low] + part * total[..., low + 1])
