"""Times of the readings of a pixel from a vehicle, relative to each other."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.survey import Survey
from amulor.survey.course import range_rate

Floats = NDArray[np.float64]

#: Least standard uncertainty of the range rate of a vehicle, which also rolls [m/s].
LEAST_RATE = 0.02


def lag_of(cube: xr.Dataset, survey: Survey | None) -> Floats | None:
    """Return the times of readings after the first of their pixel, NaN if missing [s].

    None if the instrument stands still, or reads all frequencies and channels at once.
    """
    moves = survey is not None and survey.platform is not None
    if not moves or "reading_time" not in cube.coords:
        return None
    time = cube["reading_time"]
    channels = [name for name in time.dims if name not in ("row", "column")]
    lag: Floats = (time - time.min(channels)).values
    return lag if np.nan_to_num(lag).any() else None


def range_motion(lag: Floats, survey: Survey, weight: Floats) -> Floats:
    """Return the standard deviations of ranges at readings in turn, with a sign [m].

    Readings run over the first axis. The rate of a pixel's range is unknown; its
    standard uncertainty is that of the planned motion. Ranges are those at the mean
    time of the readings with given weights, as are the poses of their points.
    """
    assert survey.platform is not None
    rate = max(float(range_rate(survey.platform)[0]), LEAST_RATE)
    return rate * _since(lag, weight)


def range_bend(lag: Floats, survey: Survey, weight: Floats) -> Floats:
    """Return the standard deviations of ranges by a change of their rate [m]."""
    assert survey.platform is not None
    return range_rate(survey.platform)[1] / 2 * _since(lag, weight) ** 2


def _since(lag: Floats, weight: Floats) -> Floats:
    """Return the times of readings since their mean time, 0 if missing [s]."""
    share = weight.reshape(-1, *[1] * (lag.ndim - 1)) * np.isfinite(lag)
    times = np.nan_to_num(lag)
    with np.errstate(invalid="ignore"):
        middle = np.sum(share * times, axis=0) / np.sum(share, axis=0)
    return np.asarray(np.nan_to_num(lag - middle))


def reading_weight(frequency: Floats, channels: int = 1) -> Floats:
    """Return weights of readings with equal phase errors, channel by channel [1].

    Their mean time is the instant of the ranges of a joint estimation.
    """
    weight = np.tile(frequency**2, channels)
    return np.asarray(weight / weight.sum())
