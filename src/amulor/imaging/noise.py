"""Whether the stated noise of a cube is as large as its phases scatter."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube.schema import PHASE_PREFIX
from amulor.optics import ambiguity

Floats = NDArray[np.float64]

#: Pairs of neighbours that are enough to tell.
_FEWEST = 30
#: The scatter must stand out of chance by this many standard errors [1].
_SURE = 4.0
#: Median of chi-square with one degree of freedom, and the relative standard error of
#: such a median times the root of the number of values [1].
_MEDIAN, _OF_MEDIAN = 0.45494, 2.326
#: Terms of the error that are drawn anew for each sample.
_OWN_TERMS = ("counting", "fluctuation")


def noise_scale(
    path: ambiguity.Path,
    own: Floats,
    *,
    path_per_phase: Floats,
    refit: Callable[[float], ambiguity.Path],
) -> float:
    r"""Return by which factor the noise of the phases exceeds what is stated.

    Phases at n frequencies leave n - 1 residuals a pixel when the range is taken out.
    In the difference of two neighbours everything cancels that they share: water of
    another shape, late light, errors of the reference. What is left is noise, and the
    median of its chi-square over that of chance is the square of the factor (Birge
    ratio). Edges, outliers and mixed pixels do not move a median. With errors that are
    stated too small the tails of the noise are left out as outliers, so that what stays
    scatters less; the factor is looked at once more with errors that are about right.
    """
    factor, chance = _factor(path, own * path_per_phase)
    if not factor**2 > 1 + _SURE * chance:
        return 1.0
    again, _ = _factor(refit(factor), factor * own * path_per_phase)
    return max(factor * again, 1.0)


def _factor(path: ambiguity.Path, error: Floats) -> tuple[float, float]:
    """Return the factor of the noise, and the standard error of its square by chance.

    The factor is 1 where there is too little to tell it.
    """
    there = np.isfinite(path.length)
    there &= np.isfinite(error).all(axis=0) & (error > 0).all(axis=0)
    freedom = len(error) - 1
    if freedom < 1:
        return 1.0, 0.0
    scores = []
    for axis in (0, 1):
        one, other = _pairs(axis)
        both = there[one] & there[other]
        every = (slice(None), *one), (slice(None), *other)
        square = (path.residual[every[0]] - path.residual[every[1]])[:, both] ** 2
        first, second = (_expected(path.weight[e], error[e])[:, both] for e in every)
        left_out = (path.left_out[every[0]] | path.left_out[every[1]])[:, both]
        scores.append(np.where(left_out, np.nan, square / (first + second)))
    score = np.concatenate(scores, axis=1)
    known = np.isfinite(score).sum(axis=1) >= _FEWEST
    if not known.any():
        return 1.0, 0.0
    each = np.nanmedian(score[known], axis=1) / _MEDIAN
    # That of n - 1 residuals is known beside the others; pairs overlap two by two.
    chance = _OF_MEDIAN * np.sqrt(2 / score.shape[1] / freedom)
    return float(np.sqrt(np.mean(each))), float(chance)


def with_noise_scaled(one: xr.Dataset, factor: float) -> xr.Dataset:
    """Return a target signal whose samples have larger errors of their own."""
    if factor == 1:
        return one
    more = factor**2 - 1
    changed: dict[str, xr.DataArray] = {}
    for name in ("in_phase_uncertainty", "quadrature_uncertainty"):
        own = one[name] ** 2 - one.get(f"common_{name}", 0.0) ** 2
        changed[name] = (one[name] ** 2 + more * own.clip(min=0.0)) ** 0.5
    if "in_phase_quadrature_covariance" in one:
        cross = one["in_phase_quadrature_covariance"]
        own = cross - one.get("common_covariance", 0.0)
        changed["in_phase_quadrature_covariance"] = cross + more * own
    for name in _OWN_TERMS:
        if f"{PHASE_PREFIX}{name}" in one:
            changed[f"{PHASE_PREFIX}{name}"] = factor * one[f"{PHASE_PREFIX}{name}"]
    kept = {
        name: values.assign_attrs(one[name].attrs) for name, values in changed.items()
    }
    return one.assign(kept).assign_attrs(noise_scale=factor)


def _pairs(axis: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return where a pixel and its next one along an axis are."""
    first, second = [slice(None)] * 2, [slice(None)] * 2
    first[axis], second[axis] = slice(None, -1), slice(1, None)
    return (first[0], first[1]), (second[0], second[1])


def _expected(weight: Floats, error: Floats) -> Floats:
    """Return the variance of residuals about a weighted mean of independent errors."""
    of_mean = np.sum((weight * np.where(np.isfinite(error), error, 0.0)) ** 2, axis=0)
    return np.asarray((1 - 2 * weight) * error**2 + of_mean)
