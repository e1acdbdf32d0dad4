"""How well a sample is known: counting noise through a filter, averaged readings."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics import detection
from amulor.survey import Survey
from amulor.survey.counting import counting_variance


def reading_variance(
    survey: Survey, *, rate: ArrayLike, time_constant: float
) -> NDArray[np.float64]:
    """Return the counting variance of one settled reading of either output.

    Parameters
    ----------
    survey : Survey
        Its detector counts.
    rate : array_like
        Photoelectrons by light, not negative [1/s].
    time_constant : float
        Time constant of the one-pole output filter, above zero [s].

    Returns
    -------
    ndarray
        Variance of the peak amplitude [V^2].
    """
    time = detection.effective_integration_time(0.0, time_constant=time_constant)
    return counting_variance(survey, rate=rate, integration_time=float(time))


def variance_ratio(readings: ArrayLike, *, spacing: float) -> NDArray[np.float64]:
    r"""Return the variance of a mean of readings over that of one of them.

    Parameters
    ----------
    readings : array_like of int
        How many readings are averaged, at least 1 [1].
    spacing : float
        Time between them in time constants of the filter, above zero [1].

    Returns
    -------
    ndarray
        From 1 for one reading downwards [1].

    Raises
    ------
    ValueError
        If there is no reading, or no time between them.

    Notes
    -----
    White noise behind a one-pole filter keeps :math:`r = e^{-s}` of itself from one
    reading to the next, so that the mean of n has the fraction

    .. math:: \frac{1}{n} \left[ 1 + 2 \sum_{k=1}^{n-1} (1 - k / n) r^k \right]
        = \frac{1}{n} \left[ \frac{1 + r}{1 - r}
          - \frac{2 r (1 - r^n)}{n (1 - r)^2} \right].

    Examples
    --------
    >>> print(f"{variance_ratio(8, spacing=1.0):.4f}")
    0.2417
    """
    number = np.asarray(readings, dtype=float)
    if np.any(number < 1):
        raise ValueError(f"readings must be at least 1, got {np.min(number):g}")
    if not spacing > 0:
        raise ValueError(f"spacing must be above 0 time constants, got {spacing:g}")
    kept = np.exp(-spacing)
    left = -np.expm1(-spacing)
    slow = (1 + kept) / left
    ends = 2 * kept * (1 - kept**number) / (number * left**2)
    fraction: NDArray[np.float64] = np.asarray((slow - ends) / number)
    return fraction


def readings_of(survey: Survey, *, settling: float) -> int:
    """Return how many readings, one a time constant, fit into a dwell after settling.

    Parameters
    ----------
    survey : Survey
        Its dwell and its lock-in count.
    settling : float
        Wait before the first reading, in time constants [1].

    Returns
    -------
    int
        At least 1 [1].
    """
    constant = survey.instrument.lock_in.time_constant
    # A dwell of exactly so many time constants must not lose one to rounding.
    left = survey.scan.dwell / constant - settling
    return max(1, 1 + int(np.floor(left + 1e-9)))
