"""Functions shared by imaging steps: noise variance, flags, phase differences."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import QualityFlag
from amulor.cube.schema import ALIKE_TERMS, RANGE_PREFIX, SHARED_TERMS, TERMS
from amulor.optics import ranging

Floats = NDArray[np.float64]

#: What the difference of a variance and a part of it is rounded by, at most [1].
_ROUNDED = 4 * np.finfo(float).eps


def own_variance(image: xr.Dataset) -> Floats:
    """Variance of slant ranges, without errors common to all pixels."""
    variance: Floats = image["slant_range_uncertainty"].values ** 2
    if "slant_range_common_uncertainty" in image:
        shared = image["slant_range_common_uncertainty"].values ** 2
        variance = np.maximum(variance - shared, _ROUNDED * variance)
    unknown = np.isnan(variance)
    if unknown.any():
        # The joint estimation states errors common to all pixels as water-model errors.
        joint = ("water_model",) if "slant_range_bound" in image else ()
        parts = [
            image[f"{RANGE_PREFIX}{name}"].values ** 2
            for name in TERMS
            if name not in (*SHARED_TERMS, *ALIKE_TERMS, *joint)
            and f"{RANGE_PREFIX}{name}" in image
        ]
        if parts:
            variance = np.where(unknown, np.sum(parts, axis=0), variance)
    return variance


def with_flag(
    image: xr.Dataset, flag: QualityFlag, pixels: NDArray[np.bool_] | bool
) -> xr.Dataset:
    """Range image with a flag added to selected pixels."""
    old = image["quality_flag"]
    new = np.where(pixels, old.values | flag, old.values).astype(np.int16)
    return image.assign(quality_flag=old.copy(data=new))


def phase_cosines(image: xr.Dataset, distance: Floats) -> Floats:
    """Cosines of the phase differences of distance pairs, mean over frequencies."""
    group_index = float(image["geometry"].attrs["group_index"])
    frequency = np.atleast_1d(image.attrs["modulation_frequencies"])
    turn = np.zeros((len(distance), len(distance)))
    for modulation_frequency in frequency:
        to_phase = ranging.phase_per_range(
            modulation_frequency, group_index=group_index
        )
        turn += np.cos(to_phase * (distance[:, None] - distance)) / len(frequency)
    return turn
