"""Detection of outlying pixels: particles in the beam, spikes of the electronics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import ndtr

from amulor import cube as cubes
from amulor._discoveries import largest_discovered
from amulor.cube import QualityFlag
from amulor.imaging.common import own_variance, with_flag

Floats = NDArray[np.float64]

#: Directions along which a pixel is compared with its neighbors: (rows, columns).
_WAYS = ((0, 1), (1, 0), (1, 1), (1, -1))
#: Extrapolations at a rim: distances of the next pixels and their weights [1].
_ONWARD = (((1, 1.0), (2, 0.5), (4, -0.5)), ((1, 2.0), (2, -1.0)))
_REACH = 4
#: Half width of the neighborhood in which the roughness is estimated [pixel].
_AROUND = 3
#: Least deviation of an outlier, divided by the roughness of its neighborhood [1].
ROUGHER = 3.0
#: False-discovery rate where many pixels are outliers [1].
BY_CHANCE = 0.1
#: Number of search rounds.
_ROUNDS = 2
#: Least deviation of an outlier, for any number of outliers, in standard errors [1].
LEAST = 2.5
#: Least deviation of an outlier in each direction, divided by the median deviation [1],
_ALIKE = 0.5
#: unless it differs from the median by fewer standard errors of its line [1].
_UNLIKE = 2.5
#: Variance of the median of four independent lines over that of a single line, from
#: 10^6 normal draws. It is an upper bound if a rim makes the lines unequal [1].
_OF_MEDIAN = 0.3
#: Median modulus of a standard normal deviate [1].
_HALF = 0.6745
#: Largest number of neighbors of an isolated pixel, none at a similar distance [1],
_FEW_AROUND = 2
#: and the limits of similar: standard errors, and slope as depth over width [1].
_AS_FAR, _STEEP = 4.0, 4.0


def outlying_pixels(
    image: xr.Dataset, *, significance: float = 3.0
) -> NDArray[np.bool_]:
    r"""Mask of pixels that deviate from all neighbors.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    significance : float
        Least deviation of an outlier from the line through its neighbors in each of
        four directions, in standard errors, above 0 [1].

    Returns
    -------
    ndarray of bool, shape (row, column)
        False where a pixel has no range. A pixel that can be compared in fewer than two
        directions is an outlier if it is isolated: at most two of the eight pixels
        around it have a range, and none a similar one.

    Raises
    ------
    ValueError
        If the significance is not above 0.

    Notes
    -----
    Along rows, columns and both diagonals the range is compared with the mean of its
    two neighbors, at the border with the straight continuation of the next two. A pixel
    is an outlier if it deviates to the same side in all these directions, by
    `significance` standard errors and by three times the roughness of the surface. The
    roughness is the median, over the pixels around it, of their mean deviation. Edges,
    ridges and ropes continue in one direction and are no outliers. Errors that
    neighbors share cancel and do not count.

    If more pixels deviate than chance explains, as with spikes and particles, smaller
    deviations are likely to be outliers as well. A pixel's median deviation over the
    directions is divided by its standard error, or by that around it if larger. Each
    direction must show at least half of this deviation, or differ from it by less than
    2.5 errors of its line. At the border, lines are continued through the next four
    pixels if at least one direction has neighbors on both sides. The limit is the
    smallest excess, from 2.5 standard errors on, beyond which chance causes at most a
    tenth of all outliers [1]_. Known outliers do not serve as neighbors, so the search
    runs twice. In data without outliers it flags one pixel in 10^4.

    Where there is no target, noise occasionally passes for one. Such a pixel has no
    neighbor at a similar range: within four standard errors plus the slope of a surface
    four times as deep as wide. The pixels of a rope one pixel wide have such neighbors.

    References
    ----------
    .. [1] Y. Benjamini and Y. Hochberg, J. R. Stat. Soc. B 57 (1995) 289-300,
       :doi:`10.1111/j.2517-6161.1995.tb02031.x`.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> image["slant_range"][20, 50] += 0.2
    >>> outlying = imaging.outlying_pixels(image)
    >>> int(outlying.sum()), int(outlying[20, 50])  # of 4000 pixels
    (14, 1)
    """
    return _outlying(cubes.checked(image, "range_image"), significance)[0]


def _outlying(
    image: xr.Dataset, significance: float, limits: tuple[float, ...] | None = None
) -> tuple[NDArray[np.bool_], tuple[float, ...]]:
    """Mask of outlying pixels, and the probability limit of each round [1]."""
    if not significance > 0:
        raise ValueError(f"significance must be above 0, got {significance:g}")
    distance = image["slant_range"].values
    variance = own_variance(image)
    stand = _standing(distance, variance, distance)
    above = (stand.directions >= 2) & (stand.score > significance)
    rough = _median_around(stand.average, above)
    above[above] = stand.least[above] > ROUGHER * rough
    flagged = (image["quality_flag"].values & QualityFlag.OUTLIER) != 0
    candidates = flagged | above
    used = []
    for number in range(_ROUNDS):  # one found no longer hides another beside it
        limit = None if limits is None else limits[number]
        more, limit = _more_than_chance(distance, variance, candidates, limit)
        candidates |= more
        used.append(limit)
    outlying = candidates & (above | ~flagged)
    return outlying | _alone(image, distance, variance), tuple(used)


def stand_off(image: xr.Dataset) -> Floats:
    """Deviation from neighboring pixels in standard errors; 0 without a common sign."""
    distance, variance = image["slant_range"].values, own_variance(image)
    outlying = (image["quality_flag"].values & QualityFlag.OUTLIER) != 0
    score = np.zeros(distance.shape)
    for neighbours in (distance, np.where(outlying, np.nan, distance)):
        stand = _standing(distance, variance, neighbours)
        middle = stand.middle / np.sqrt(variance + _OF_MEDIAN * stand.spread)
        score = np.fmax(score, np.where(stand.agreed, middle, 0.0))
    return score


def _alone(image: xr.Dataset, distance: Floats, variance: Floats) -> NDArray[np.bool_]:
    """Mask of isolated pixels: few neighbors, and none at a similar range."""
    angles = [image["azimuth"].values, image["elevation"].values]
    # Azimuth lines converge with elevation.
    angles[0] = angles[0] * np.cos(angles[1])
    fields = [distance, variance, *angles]
    padded = [np.pad(values, 1, constant_values=np.nan) for values in fields]
    rows, columns = distance.shape
    around = np.zeros(distance.shape, dtype=int)
    supported = np.zeros(distance.shape, dtype=bool)
    for down in range(3):
        for right in range(3):
            if (down, right) == (1, 1):
                continue
            place = (slice(down, down + rows), slice(right, right + columns))
            far, spread, azimuth, elevation = (values[place] for values in padded)
            width = distance * np.hypot(azimuth - fields[2], elevation - fields[3])
            allowed = _AS_FAR * np.sqrt(variance + spread) + _STEEP * width
            around += np.isfinite(far)
            with np.errstate(invalid="ignore"):
                supported |= np.abs(far - distance) <= allowed
    alone = np.isfinite(distance) & ~supported & (around <= _FEW_AROUND)
    # A single pixel has no neighbors for a comparison.
    return np.asarray(alone & (distance.size > 1))


def _more_than_chance(
    distance: Floats, variance: Floats, flagged: NDArray[np.bool_], limit: float | None
) -> tuple[NDArray[np.bool_], float]:
    """Mask of outliers at a limited false-discovery rate, and the probability limit."""
    stand = _standing(distance, variance, np.where(flagged, np.nan, distance))
    with np.errstate(invalid="ignore", divide="ignore"):
        score = stand.middle / np.sqrt(variance + _OF_MEDIAN * stand.spread)
    judged = (
        (stand.directions >= 3) & (stand.between > 0) & np.isfinite(score) & ~flagged
    )
    alike = (stand.least > _ALIKE * stand.middle) | (stand.unlike < _UNLIKE)
    alone = stand.agreed & alike
    score = np.where(judged & alone, score, 0.0)
    size = np.where(judged, stand.middle, np.nan)
    far = score > LEAST
    rough = _median_around(size, far) / _HALF
    with np.errstate(divide="ignore", invalid="ignore"):
        score[far] = np.fmin(score[far], stand.middle[far] / rough)
    far &= score > LEAST
    chance = np.where(far, 2 * ndtr(-score), np.nan)
    all_found = np.where(flagged, 0.0, chance)
    if limit is None:
        limit = largest_discovered(
            all_found, share=BY_CHANCE, tests=int((judged | flagged).sum())
        )
    with np.errstate(invalid="ignore"):
        return np.asarray(chance <= limit), limit


def _median_around(values: Floats, at: NDArray[np.bool_]) -> Floats:
    """Median of the values surrounding selected pixels, shape (n,)."""
    padded = np.pad(values, _AROUND, constant_values=np.nan)
    size = 2 * _AROUND + 1
    around = sliding_window_view(padded, (size, size))[at].reshape(-1, size**2).T
    return _median(around, np.isfinite(around).sum(axis=0))


def flag_outliers(image: xr.Dataset, *, significance: float = 3.0) -> xr.Dataset:
    """Range image with outlying pixels flagged `OUTLIER`.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    significance : float
        As in `outlying_pixels` [1].

    Returns
    -------
    xarray.Dataset
        The image with `OUTLIER` added to the flags of outlying pixels.

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
    >>> QualityFlag(int(flagged["quality_flag"][20, 50])).name
    'NO_OPEN_WATER|OUTLIER'
    """
    return fitted_outliers(image, significance=significance)[0]


def fitted_outliers(
    image: xr.Dataset,
    *,
    significance: float = 3.0,
    fit: tuple[float, ...] | None = None,
) -> tuple[xr.Dataset, tuple[float, ...]]:
    """Range image with outliers flagged, and the probability limits used [1]."""
    image = cubes.checked(image, "range_image")
    outlying, fit = _outlying(image, significance, fit)
    image = with_flag(image, QualityFlag.OUTLIER, outlying)
    return cubes.note(image, "outliers flagged"), fit


@dataclass(frozen=True, kw_only=True)
class _Standing:
    """Deviation of pixels from lines through their neighbors, in several directions."""

    least: Floats
    """Smallest magnitude of the deviations over the directions [m]."""
    middle: Floats
    """Magnitude of the median deviation [m]."""
    spread: Floats
    """Median variance of the fitted lines [m^2]."""
    average: Floats
    """Mean magnitude of the deviations, NaN without any [m]."""
    score: Floats
    """Smallest deviation in standard errors, 0 if the signs differ [1]."""
    unlike: Floats
    """Largest difference from the median deviation, in standard errors of the lines
    [1]."""
    agreed: NDArray[np.bool_]
    """Mask of pixels whose deviations all have the same sign."""
    directions: NDArray[np.intp]
    """Number of directions with a deviation [1]."""
    between: NDArray[np.intp]
    """Number of directions with neighbors on both sides [1]."""


def _standing(distance: Floats, variance: Floats, neighbours: Floats) -> _Standing:
    """Compare pixels with lines through their neighbors, in several directions."""
    padded = np.pad(neighbours, _REACH, constant_values=np.nan)
    errors = np.pad(variance, _REACH, constant_values=np.nan)
    rows, columns = distance.shape

    def at(values: Floats, axis: tuple[int, int], step: int) -> Floats:
        down, right = _REACH + step * axis[0], _REACH + step * axis[1]
        return values[down : down + rows, right : right + columns]

    deviation = np.full((len(_WAYS), *distance.shape), np.nan)
    between = np.zeros(deviation.shape, dtype=bool)
    scores, spreads = np.full((2, *deviation.shape), np.nan)
    for index, axis in enumerate(_WAYS):
        before, after = at(padded, axis, -1), at(padded, axis, 1)
        line = (before + after) / 2
        spread = (at(errors, axis, -1) + at(errors, axis, 1)) / 4
        between[index] = np.isfinite(line)
        for weights in _ONWARD:
            for side in (-1, 1):
                onward = sum(
                    weight * at(padded, axis, side * step) for step, weight in weights
                )
                wider = sum(
                    weight**2 * at(errors, axis, side * step)
                    for step, weight in weights
                )
                missing = ~np.isfinite(line)
                line = np.where(missing, onward, line)
                spread = np.where(missing, wider, spread)
        deviation[index] = distance - line
        spreads[index] = np.where(np.isfinite(deviation[index]), spread, np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            scores[index] = np.abs(deviation[index]) / np.sqrt(variance + spread)
    valid = np.isfinite(deviation)
    count = valid.sum(axis=0)
    sides = np.where(valid, np.sign(deviation), 0.0).sum(axis=0)
    agreed = (count > 0) & (np.abs(sides) == count)
    size = np.where(valid, np.abs(deviation), np.nan)
    least = np.fmin.reduce(size, initial=np.inf)
    middle = _median(deviation, count)
    with np.errstate(divide="ignore", invalid="ignore"):
        unlike = np.abs(deviation - middle) / np.sqrt(spreads)
    weakest = np.fmin.reduce(np.where(valid, scores, np.nan), initial=np.inf)
    return _Standing(
        least=least,
        middle=np.abs(middle),
        unlike=np.fmax.reduce(unlike, initial=0.0),
        spread=_median(spreads, count),
        average=np.where(
            count > 0, np.nansum(size, axis=0) / np.maximum(count, 1), np.nan
        ),
        score=np.where(agreed, weakest, 0.0),
        agreed=agreed,
        directions=count,
        between=between.sum(axis=0),
    )


def _median(values: Floats, count: NDArray[np.intp]) -> Floats:
    """Median of the finite values over the first axis."""
    ordered = np.sort(values, axis=0)  # NaN values are last
    last = np.maximum(count - 1, 0)
    two = [
        np.take_along_axis(ordered, half[None], axis=0)[0]
        for half in (last // 2, (last + 1) // 2)
    ]
    middle: Floats = (two[0] + two[1]) / 2
    return middle
