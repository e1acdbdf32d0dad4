"""Finds pixels that stand alone: a particle in the beam, a spike in the electronics."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import QualityFlag
from amulor.imaging.common import own_variance, with_flag

Floats = NDArray[np.float64]

#: Ways through a pixel along which its neighbours are compared: (rows, columns).
_WAYS = ((0, 1), (1, 0), (1, 1), (1, -1))
#: Half width of the surroundings whose roughness counts [pixel].
_AROUND = 3
#: How much farther than the roughness around it a pixel must stand off [1].
_ROUGHER = 3.0


def outlying_pixels(
    image: xr.Dataset, *, significance: float = 3.0
) -> NDArray[np.bool_]:
    r"""Return which pixels stand off all their neighbours.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    significance : float
        How many standard errors a pixel must stand off the line through its neighbours
        in each of four ways, above 0 [1].

    Returns
    -------
    ndarray of bool, shape (row, column)
        False where a pixel has no range, or fewer than two ways to compare.

    Raises
    ------
    ValueError
        If the significance is not above 0.

    Notes
    -----
    Along rows, columns and both diagonals the range is compared with the mean of its
    two neighbours, at the rim with the straight continuation of the next two. A pixel
    is an outlier if it stands off to the same side in all of these ways, by
    `significance` standard errors and by three times as much as pixels around it do on
    average over their ways, in the median: so rough is the surface. Edges, ridges and
    ropes go on in one of the ways and are none. What neighbours share cancels and does
    not count.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> image["slant_range"][20, 50] += 0.2
    >>> bool(imaging.outlying_pixels(image)[20, 50])
    True
    """
    image = cubes.checked(image, "range_image")
    if not significance > 0:
        raise ValueError(f"significance must be above 0, got {significance:g}")
    distance = image["slant_range"].values
    variance = own_variance(image)
    off, average, score, ways = _standing(distance, variance)
    above = (ways >= 2) & (score > significance)
    for place in np.argwhere(above):
        rows, columns = (slice(max(k - _AROUND, 0), k + _AROUND + 1) for k in place)
        around = average[rows, columns]
        rough = np.median(around[np.isfinite(around)])
        above[tuple(place)] = off[tuple(place)] > _ROUGHER * rough
    return above


def flag_outliers(image: xr.Dataset, *, significance: float = 3.0) -> xr.Dataset:
    """Return a range image whose outlying pixels are flagged `OUTLIER`.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    significance : float
        As in `outlying_pixels` [1].

    Returns
    -------
    xarray.Dataset
        The image with other flags.

    Raises
    ------
    ValueError
        As `outlying_pixels`.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> image["slant_range"][20, 50] += 0.2
    >>> flagged = imaging.flag_outliers(image)
    >>> from amulor.cube import QualityFlag
    >>> QualityFlag.OUTLIER in QualityFlag(int(flagged["quality_flag"][20, 50]))
    True
    """
    image = cubes.checked(image, "range_image")
    outlying = outlying_pixels(image, significance=significance)
    image = with_flag(image, QualityFlag.OUTLIER, outlying)
    return cubes.note(image, "outliers flagged")


def _standing(
    distance: Floats, variance: Floats
) -> tuple[Floats, Floats, Floats, NDArray[np.intp]]:
    """Return how far pixels stand off the lines through them, way by way.

    The least and the average of all ways [m], the least in standard errors, 0 where the
    ways disagree about the side, and the number of ways.
    """
    padded = np.pad(distance, 2, constant_values=np.nan)
    errors = np.pad(variance, 2, constant_values=np.nan)
    rows, columns = distance.shape

    def at(values: Floats, way: tuple[int, int], step: int) -> Floats:
        down, right = 2 + step * way[0], 2 + step * way[1]
        return values[down : down + rows, right : right + columns]

    smallest = np.full(distance.shape, np.inf)
    weakest = np.full(distance.shape, np.inf)
    total = np.zeros(distance.shape)
    sides = np.zeros(distance.shape)
    ways = np.zeros(distance.shape, dtype=np.intp)
    for way in _WAYS:
        one, other = at(padded, way, -1), at(padded, way, 1)
        line = (one + other) / 2
        spread = (at(errors, way, -1) + at(errors, way, 1)) / 4
        for side in (-1, 1):
            onward = 2 * at(padded, way, side) - at(padded, way, 2 * side)
            wider = 4 * at(errors, way, side) + at(errors, way, 2 * side)
            missing = ~np.isfinite(line)
            line = np.where(missing, onward, line)
            spread = np.where(missing, wider, spread)
        off = distance - line
        there = np.isfinite(off)
        with np.errstate(divide="ignore", invalid="ignore"):
            score = np.abs(off) / np.sqrt(variance + spread)
        smallest = np.where(there, np.fmin(smallest, np.abs(off)), smallest)
        weakest = np.where(there, np.fmin(weakest, score), weakest)
        total += np.where(there, np.abs(off), 0.0)
        sides += np.where(there, np.sign(off), 0.0)
        ways += there
    none = ways == 0
    agreed = np.abs(sides) == ways
    weakest = np.where(agreed & ~none, weakest, 0.0)
    average = np.where(none, np.nan, total / np.maximum(ways, 1))
    return smallest, average, weakest, ways
