"""Counts what the pixels that a user would believe are worth."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.studies.trust.case import Case
from amulor.studies.trust.methods import Outcome

Floats = NDArray[np.float64]

#: Half widths of the intervals that hold 68 and 95 of 100 normal errors [1].
ONE, TWO = 1.0, 1.96
#: Beyond it lie 5 of 10,000 normal errors [1].
FAR = 3.5


@dataclass(frozen=True, kw_only=True)
class Score:
    """Figures of one method on one case; not a number where no pixel is trusted."""

    pixels: int
    """Judged pixels that see a surface."""
    empty: int
    """Judged pixels that see none."""
    trusted: float
    """Fraction of the former that is trusted [1]."""
    phantoms: float
    """Fraction of the latter that is trusted [1]."""
    inside_68: float
    """Fraction of the trusted whose 68 % interval holds the surface [1]."""
    inside_95: float
    """Fraction of the trusted whose 95 % interval does [1]."""
    echo_95: float
    """Fraction of the trusted whose 95 % interval holds the range of the echo [1]."""
    worst: float
    """Largest error over its standard uncertainty [1]."""
    far: float
    """Fraction of the trusted beyond 3.5 standard uncertainties [1]."""
    rms: float
    """Root mean square error of the trusted against the surface [m]."""
    stated: float
    """Median standard uncertainty of the trusted [m]."""
    note: str
    """Method that `auto` took, or why there is no image."""


def score(case: Case, outcome: Outcome) -> Score:
    """Judge an outcome by the truth.

    Parameters
    ----------
    case : Case
        Surfaces and judged pixels.
    outcome : Outcome
        Target signal and range image.

    Returns
    -------
    Score
        The interval of a pixel is `slant_range - slant_range_bias` plus or minus
        `slant_range_uncertainty`. Trusted is a pixel of the image without any flag;
        flags of the target signal go into it. Of several surfaces the nearest to the
        result counts.
    """
    met = np.isfinite(case.surfaces).any(axis=0) & case.judged
    empty = ~np.isfinite(case.surfaces).any(axis=0) & case.judged
    trusted = _trusted(outcome, met.shape)
    good = trusted & met
    nan = math.nan
    found = Score(
        pixels=int(met.sum()),
        empty=int(empty.sum()),
        trusted=_mean(trusted[met]),
        phantoms=_mean(trusted[empty]),
        inside_68=nan,
        inside_95=nan,
        echo_95=nan,
        worst=nan,
        far=nan,
        rms=nan,
        stated=nan,
        note=outcome.note,
    )
    if outcome.image is None or not good.any():
        return found
    distance = outcome.image["slant_range"].values
    if "slant_range_bias" in outcome.image:
        distance = distance - outcome.image["slant_range_bias"].values
    sigma = outcome.image["slant_range_uncertainty"].values[good]
    error = _nearest(distance - case.surfaces)[good]
    echo = _nearest(distance - case.surfaces - case.late)[good]
    off = np.abs(error) / sigma
    return replace(
        found,
        inside_68=_mean(off < ONE),
        inside_95=_mean(off < TWO),
        echo_95=_mean(np.abs(echo) / sigma < TWO),
        worst=float(off.max()),
        far=_mean(off > FAR),
        rms=float(np.sqrt(np.mean(error**2))),
        stated=float(np.median(sigma)),
    )


def _trusted(outcome: Outcome, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    if outcome.target is None or outcome.image is None:
        return np.zeros(shape, dtype=bool)
    good = outcome.image["quality_flag"].values == 0
    return np.asarray(good & np.isfinite(outcome.image["slant_range"].values))


def _nearest(error: Floats) -> Floats:
    """Return the error of the surface that is nearest, shape (row, column)."""
    size = np.where(np.isfinite(error), np.abs(error), np.inf)
    chosen = size.argmin(axis=0)
    nearest: Floats = np.take_along_axis(error, chosen[None], axis=0)[0]
    return nearest


def _mean(values: NDArray[np.bool_]) -> float:
    return float(values.mean()) if values.size else math.nan
