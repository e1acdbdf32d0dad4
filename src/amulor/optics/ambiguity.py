"""Settles which ambiguity interval a phase lies in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

Floats = NDArray[np.float64]

#: The runner-up must fit worse by this much in chi-square, or the choice is open.
_MARGIN = 16.0
#: A path may lie this many standard errors outside its limits: it was measured.
_SLACK = 4.0
#: Frequencies that disagree with the best path by more than this chance say so.
_DISAGREEMENT = 1e-4
_MOST_CANDIDATES = 10_000
#: Phases stated to be without any error still need weights [rad].
_SMALLEST_PHASE_ERROR = 1e-9


@dataclass(frozen=True, kw_only=True)
class Path:
    """Two-way optical path of each pixel, arrays of one shape."""

    length: Floats
    """Group index times length, out and back [m]."""
    uncertainty: Floats
    """Standard uncertainty [m]."""
    weight: Floats
    """Weight of each frequency in the result, first axis the frequencies [1]."""
    settled: NDArray[np.bool_]
    """False where another interval fits about as well, or none fits."""
    wrong: Floats
    """Probability of another interval within the limits, for normal errors [1]."""


def optical_path(
    phase: Floats,
    uncertainty: Floats,
    *,
    modulation_frequency: Floats,
    shortest: Floats,
    longest: Floats,
    doubt: Floats | float = 0.0,
) -> Path:
    """Return the optical path that fits the phases at all frequencies best.

    Parameters
    ----------
    phase, uncertainty : ndarray, shape (frequencies, ...)
        Wrapped phase of the target and its standard uncertainty [rad].
    modulation_frequency : ndarray, shape (frequencies,)
        Modulation frequencies [Hz].
    shortest, longest : ndarray, shape (...)
        Limits between which the optical path must lie, but for its error [m].
    doubt : ndarray or float
        Phase errors that the frequencies may have beyond their uncertainty, such as
        water signal left in; they excuse disagreement and change nothing else [rad].

    Returns
    -------
    Path
        Arrays of the shape of one frequency's phase.

    Raises
    ------
    ValueError
        If the limits hold so many ambiguity intervals that no phase can choose.

    Notes
    -----
    Each candidate is the path of the most precise frequency plus whole wavelengths of
    the modulation. It is refined by the weighted mean of all frequencies, unwrapped
    about it, and judged by the sum of squared phase errors: maximum likelihood for
    normal errors. The same sums give the probability that another candidate is the
    right one, all of them alike beforehand. At the ends of a full ambiguity interval
    both ends are candidates, so a path within a few standard errors of them is not
    settled.
    """
    wavelength = speed_of_light / modulation_frequency
    each = wavelength.reshape(-1, *[1] * (phase.ndim - 1))
    sigma = np.maximum(uncertainty, _SMALLEST_PHASE_ERROR) * each / (2 * np.pi)
    measured = np.mod(phase, 2 * np.pi) * each / (2 * np.pi)
    precision = sigma**-2
    best = int(np.argmin(np.nanmedian(sigma.reshape(len(sigma), -1), axis=1)))
    step = wavelength[best]
    span = float(np.nanmax(longest - shortest)) / step
    if span > _MOST_CANDIDATES:
        raise ValueError(
            f"the interval holds {span:.3g} ambiguity intervals of "
            f"{modulation_frequency[best] / 1e6:g} MHz; narrow it"
        )
    slack = np.minimum(_SLACK * sigma[best], step / 2)
    nearest = shortest - slack + np.mod(measured[best] - shortest + slack, step)
    weight = precision / precision.sum(axis=0)
    length = np.full(nearest.shape, np.nan)
    lowest = np.full(nearest.shape, np.inf)
    second = np.full(nearest.shape, np.inf)
    strain = np.full(nearest.shape, np.inf)
    # Likelihoods of all candidates over that of the best one so far.
    total = np.zeros(nearest.shape)
    excused = 1 / (sigma**2 + (doubt * each / (2 * np.pi)) ** 2)
    for count in range(int(np.ceil(span + 1)) + 1):
        candidate = nearest + count * step
        turns = np.round((candidate - measured) / each)
        unwrapped = measured + turns * each
        refined = np.sum(weight * unwrapped, axis=0)
        error = (unwrapped - refined) ** 2
        misfit = np.sum(error * precision, axis=0)
        misfit = np.where(candidate <= longest + slack, misfit, np.inf)
        better = misfit < lowest
        with np.errstate(invalid="ignore"):
            ratio = np.exp(-np.abs(misfit - lowest) / 2)
        ratio = np.where(np.isfinite(misfit) & np.isfinite(lowest), ratio, 0.0)
        total = np.where(better, 1 + ratio * total, total + ratio)
        second = np.where(better, lowest, np.minimum(second, misfit))
        length = np.where(better, refined, length)
        strain = np.where(better, np.sum(error * excused, axis=0), strain)
        lowest = np.where(better, misfit, lowest)
    freedom = len(modulation_frequency) - 1
    with np.errstate(invalid="ignore"):
        settled = np.isfinite(lowest) & (second - lowest > _MARGIN)
        if freedom:
            settled &= strain < _chi_square_limit(freedom)
    return Path(
        length=length,
        uncertainty=precision.sum(axis=0) ** -0.5,
        weight=weight,
        settled=settled,
        wrong=np.where(total > 0, 1 - 1 / np.maximum(total, 1.0), 1.0),
    )


def _chi_square_limit(freedom: int) -> float:
    from scipy.stats import chi2

    return float(chi2.isf(_DISAGREEMENT, freedom))
