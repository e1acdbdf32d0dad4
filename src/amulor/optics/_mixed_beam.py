"""Range spread within a beam, from amplitudes that fall with the modulation frequency.

Two surfaces in a beam weaken the modulation the more, the higher its frequency is. To
second order the logarithm of the amplitude falls by half of the squared phase per range
times the variance of the range within the beam. Neighbors show the fall that water and
instrument cause.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Least number of pixels from which the typical fall of the amplitudes is known.
_FEWEST = 30
#: Uncertainty of the gain of a frequency from pixel to pixel, in parts of the gain [1].
_GAIN = 3e-3
#: Least excess over the scatter and the errors of the pixels, in standard errors [1].
_SIGNIFICANT = 5.0
#: Least spread of the range in the beam, in standard uncertainties of the range [1].
_MATTERS = 2.0
#: Number of steps of the fit, and its largest deviation in standard errors [1].
_STEPS, _LARGEST = 10, 3.0
#: Scatter of a normal deviate below its median: distance of the 0.16 quantile [1].
_BELOW = 0.16


@dataclass(frozen=True, kw_only=True)
class SpreadFit:
    """Typical fall of the amplitudes of a scan."""

    terms: Floats
    """Coefficients of the logarithms of the amplitudes, by frequency; the sum is the
    apparent variance of the range in the beam [m^2]."""
    middle: float
    """Median slant range [m]."""
    typical: tuple[float, float]
    """Apparent variance at this range, and its change with the range [m^2, m]."""
    scale: float
    """Ratio of the observed scatter to the stated errors, at least 1 [1]."""


def mixed_beams(
    amplitude: Floats,
    relative_error: Floats,
    *,
    phase_per_range: Floats,
    slant_range: Floats,
    uncertainty: Floats,
    fit: SpreadFit | None = None,
) -> tuple[NDArray[np.bool_], Floats, SpreadFit | None]:
    """Mask of mixed beams, standard deviation of the range in them [m], and the fit.

    Arrays run over (frequency, row, column); the slant range is NaN in pixels that are
    not tested. A pixel with an infinite error at a frequency is not tested either.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithm = np.log(amplitude)
    valid = np.isfinite(slant_range) & np.isfinite(logarithm).all(axis=0)
    valid &= np.isfinite(relative_error).all(axis=0)
    error = np.hypot(np.where(valid, relative_error, 1.0), _GAIN)
    logarithm = np.where(valid, logarithm, 0.0)
    if fit is None:
        fit = _fit(logarithm, error, phase_per_range, slant_range, valid)
    if fit is None:
        return np.zeros(valid.shape, dtype=bool), np.zeros(valid.shape), None
    apparent = np.tensordot(fit.terms, logarithm, axes=1)
    deviation = np.sqrt(np.tensordot(fit.terms**2, error**2, axes=1))
    place = np.where(valid, slant_range, fit.middle) - fit.middle
    excess = apparent - fit.typical[0] - fit.typical[1] * place
    excess = np.where(valid, excess, 0.0)
    spread = np.sqrt(np.maximum(excess, 0.0))
    mixed = excess > _SIGNIFICANT * fit.scale * deviation
    with np.errstate(invalid="ignore"):
        mixed &= spread > _MATTERS * uncertainty
    return mixed, spread, fit


def _fit(
    logarithm: Floats,
    error: Floats,
    phase_per_range: Floats,
    slant_range: Floats,
    valid: NDArray[np.bool_],
) -> SpreadFit | None:
    """Typical fall of the amplitudes with frequency and range; None if unknown."""
    if phase_per_range.size < 2 or valid.sum() < _FEWEST:
        return None
    weight = 1 / np.median(error[:, valid], axis=1) ** 2
    fall = -0.5 * phase_per_range**2
    fall = fall - np.average(fall, weights=weight)
    terms = weight * fall / np.sum(weight * fall**2)
    apparent = np.tensordot(terms, logarithm[:, valid], axes=1)
    deviation = np.sqrt(np.tensordot(terms**2, error[:, valid] ** 2, axes=1))
    middle = float(np.median(slant_range[valid]))
    design = np.stack([np.ones(apparent.size), slant_range[valid] - middle], axis=1)
    typical = np.array([np.median(apparent), 0.0])
    scale = 1.0
    for _ in range(_STEPS):
        rest = (apparent - design @ typical) / deviation
        scale = max(1.0, float(np.median(rest) - np.quantile(rest, _BELOW)))
        use = np.abs(rest) < _LARGEST * scale
        scaled = design[use] / deviation[use, None]
        # A flat target does not determine the change with the range.
        ridge = np.diag([0.0, 1e-6 * np.sum(scaled[:, 0] ** 2)])
        typical = np.linalg.solve(
            scaled.T @ scaled + ridge, scaled.T @ (apparent[use] / deviation[use])
        )
    return SpreadFit(
        terms=terms,
        middle=middle,
        typical=(float(typical[0]), float(typical[1])),
        scale=scale,
    )
