"""Times of the readings of a pixel from a vehicle, relative to each other."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.survey import Survey


def lag_of(cube: xr.Dataset, survey: Survey | None) -> NDArray[np.float64] | None:
    """Return the times of readings after the first of their pixel [s].

    None if the instrument stands still, or reads all frequencies and channels at once.
    """
    moves = survey is not None and survey.platform is not None
    if not moves or "reading_time" not in cube.coords:
        return None
    time = cube["reading_time"]
    channels = [name for name in time.dims if name not in ("row", "column")]
    lag = np.nan_to_num((time - time.min(channels)).values)
    return lag if lag.any() else None
