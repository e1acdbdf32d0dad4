"""Finds pixels whose beam meets two surfaces at once, at the edges of objects."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import QualityFlag

Floats = NDArray[np.float64]

#: Name of the map that `flag_mixed` adds.
MIXED = "user_mixed"


def mixed_pixels(
    image: xr.Dataset, *, significance: float = 5.0, reach: int = 2
) -> NDArray[np.bool_]:
    r"""Return which pixels lie between two surfaces, where nothing is.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    significance : float
        How many standard errors a pixel must stand off both surfaces, above 0 [1].
    reach : int
        Over how many pixels an edge may be smeared to either side, at least 1: the
        beam's width over the spacing of the pixels, rounded up [1].

    Returns
    -------
    ndarray of bool, shape (row, column)
        False where a neighbour that is needed has no range.

    Raises
    ------
    ValueError
        If the significance is not above 0, or the reach is below 1.

    Notes
    -----
    A beam that meets two surfaces returns the sum of two phasors, whose phase lies
    between theirs as long as they are less than half an ambiguity interval apart. A
    pixel counts as mixed if its range lies between the straight continuations of the
    surfaces to its left and right, or above and below, and clear of both; noise alone
    counts, since what neighbours share cancels. Several frequencies see mixed pixels by
    themselves: their phases disagree, and `range_image` flags them `AMBIGUOUS`.
    """
    image = cubes.checked(image, "range_image")
    if not significance > 0:
        raise ValueError(f"significance must be above 0, got {significance:g}")
    if reach < 1:
        raise ValueError(f"reach must be at least 1 pixel, got {reach}")
    distance = image["slant_range"].values
    variance = image["slant_range_uncertainty"].values ** 2
    if "slant_range_common_uncertainty" in image:
        shared = image["slant_range_common_uncertainty"].values ** 2
        variance = np.maximum(variance - shared, 0.0)
    mixed = np.zeros(distance.shape, dtype=bool)
    for axis in (0, 1):
        for step in range(1, reach + 1):
            mixed |= _between(distance, variance, axis, step, significance)
    return mixed


def flag_mixed(
    image: xr.Dataset, *, significance: float = 5.0, reach: int = 2
) -> xr.Dataset:
    """Return a range image with a map of the pixels whose beam meets two surfaces.

    Parameters
    ----------
    image, significance, reach
        As in `mixed_pixels`.

    Returns
    -------
    xarray.Dataset
        The image with the variable `user_mixed`, 1 where a pixel is mixed; there its
        `quality_flag` says `MIXED` as well.

    Raises
    ------
    ValueError
        As `mixed_pixels`.
    """
    image = cubes.checked(image, "range_image")
    mixed = mixed_pixels(image, significance=significance, reach=reach)
    variable = xr.Variable(
        ("row", "column"),
        mixed.astype(np.int8),
        {"long_name": "1 where a beam meets two surfaces at once", "units": "1"},
    )
    flag = image["quality_flag"]
    marked = np.where(mixed, flag.values | QualityFlag.MIXED, flag.values)
    image = image.assign(
        {MIXED: variable, "quality_flag": flag.copy(data=marked.astype(np.int16))}
    )
    return cubes.note(image, "mixed pixels marked")


def _between(
    distance: Floats, variance: Floats, axis: int, step: int, significance: float
) -> NDArray[np.bool_]:
    """Return pixels between the continuations of the surfaces on both sides."""

    def neighbour(values: Floats, shift: int) -> Floats:
        moved = np.full(values.shape, np.nan)
        source = [slice(None), slice(None)]
        target = [slice(None), slice(None)]
        size = values.shape[axis]
        if abs(shift) >= size:
            return moved
        source[axis] = slice(max(shift, 0), size + min(shift, 0))
        target[axis] = slice(max(-shift, 0), size + min(-shift, 0))
        moved[tuple(target)] = values[tuple(source)]
        return moved

    off, error = [], []
    for side in (-1, 1):
        first, second = side * step, side * (step + 1)
        line = (1 + step) * neighbour(distance, first) - step * neighbour(
            distance, second
        )
        spread = (1 + step) ** 2 * neighbour(variance, first) + step**2 * neighbour(
            variance, second
        )
        off.append(distance - line)
        error.append(np.sqrt(variance + spread))
    clear = [
        np.abs(gap) > significance * sigma
        for gap, sigma in zip(off, error, strict=True)
    ]
    return np.asarray(clear[0] & clear[1] & (off[0] * off[1] < 0))
