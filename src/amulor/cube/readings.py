"""Times of the readings of a pixel from a vehicle, relative to each other."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.survey import Survey
from amulor.survey.course import planned_speed

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

    Readings run over the first axis. The rate of a pixel's range is unknown, with a
    standard uncertainty of the planned speed over sqrt(3). Ranges are those at the mean
    time of the readings with given weights, as are the poses of their points.
    """
    assert survey.platform is not None
    rate = max(planned_speed(survey.platform) / np.sqrt(3), LEAST_RATE)
    share = weight.reshape(-1, *[1] * (lag.ndim - 1)) * np.isfinite(lag)
    times = np.nan_to_num(lag)
    with np.errstate(invalid="ignore"):
        middle = np.sum(share * times, axis=0) / np.sum(share, axis=0)
    return np.asarray(np.nan_to_num(rate * (lag - middle)))
