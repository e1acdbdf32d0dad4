"""Detection of edges: range steps, and mixed pixels whose beam hits two surfaces."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import QualityFlag
from amulor.imaging.common import own_variance, with_flag

Floats = NDArray[np.float64]

#: Name of the map that `flag_mixed` adds.
MIXED = "user_mixed"
#: Largest chi-square of four pixels on a straight line, for two degrees of freedom and
#: a p-value of 0.001 [1].
_STRAIGHT = 13.8
#: Number of pixels along an edge that are averaged, and their largest chi-square, for
#: three degrees of freedom [1].
_ALONG = 5
_STRAIGHT_ALONG = 16.3
#: Fitted pixels to either side of a step, and along it. Least height of a step in
#: standard errors, and distance in pixels within which it is the largest [1].
_SIDE, _BESIDE, _STEP, _NEAR = 4, (3, 10), 4.0, 3
#: Least height of a step as a fraction of the range; smooth curves are below it [1].
_SMOOTH = 1e-6
#: Number of neighbors on each side on which the steps of a pixel depend [1].
STEP_MARGIN = max(_SIDE, *_BESIDE) + _NEAR
#: Variance of ranges with a stated error of zero: a picometer squared [m^2].
_TINY = 1e-24


def mixed_pixels(
    image: xr.Dataset, *, significance: float = 3.5, reach: int = 2
) -> NDArray[np.bool_]:
    r"""Mask of mixed pixels, whose range lies between two surfaces.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    significance : float
        Least distance of a mixed pixel from both surfaces, in standard errors, above 0
        [1].
    reach : int
        Number of pixels over which an edge may be blurred to either side, at least 1:
        beam width over pixel spacing, rounded up [1].

    Returns
    -------
    ndarray of bool, shape (row, column)
        False where a neighbor that is needed has no range.

    Raises
    ------
    ValueError
        If the significance is not above 0, or the reach is below 1.

    Notes
    -----
    A beam that meets two surfaces returns the sum of two phasors. Its phase lies
    between theirs as long as they are less than half an ambiguity interval apart. A
    pixel counts as mixed if its range lies between the surfaces to its left and right,
    or above and below, and away from both. It must be away from their nearest pixels
    and from straight lines through the next two or four pixels. Only noise counts as
    error, since errors that neighbors share cancel. An edge along rows or columns is
    examined in means of five pixels along it as well, if these lie on a straight line
    within their noise. Such means reveal steps of a few times the noise. With several
    frequencies the phases of a mixed pixel disagree, and `range_image` flags it
    `AMBIGUOUS`.

    Examples
    --------
    Half of the beam on a surface at 1.5 m, half on one at 1.6 m: the column between.

    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> image["slant_range"][:] = 1.5
    >>> image["slant_range"][:, 50] = 1.55
    >>> image["slant_range"][:, 51:] = 1.6
    >>> image["slant_range_uncertainty"][:] = 1e-3
    >>> np.flatnonzero(imaging.mixed_pixels(image)[20])
    array([50])
    """
    image = cubes.checked(image, "range_image")
    if not significance > 0:
        raise ValueError(f"significance must be above 0, got {significance:g}")
    if reach < 1:
        raise ValueError(f"reach must be at least 1 pixel, got {reach}")
    return np.asarray(clear_of_both(image, reach=reach) > significance)


def clear_of_both(image: xr.Dataset, *, reach: int = 2) -> Floats:
    """Distance to the nearer of two surfaces in standard errors; 0 if not between them.

    Zero where they lie between none.
    """
    distance = image["slant_range"].values
    variance = np.maximum(own_variance(image), _TINY)
    clear = np.zeros(distance.shape)
    for axis in (0, 1):
        along = _along_edge(distance, variance, 1 - axis)
        for step in range(1, reach + 1):
            clear = np.maximum(clear, _between(distance, variance, axis, step))
            if along is not None:
                clear = np.maximum(clear, _between(*along, axis, step))
    return clear


def flag_mixed(
    image: xr.Dataset, *, significance: float = 3.5, reach: int = 2
) -> xr.Dataset:
    """Range image with mixed pixels flagged `MIXED`.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    significance : float
        As in `mixed_pixels` [1].
    reach : int
        As in `mixed_pixels` [1].

    Returns
    -------
    xarray.Dataset
        The image with the variable `user_mixed`, 1 where a pixel is mixed. Mixed pixels
        have the flag `MIXED` in `quality_flag`, too.

    Raises
    ------
    ValueError
        As `mixed_pixels`.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> flagged = imaging.flag_mixed(image)
    >>> int(flagged["user_mixed"].sum()), flagged["user_mixed"].size
    (550, 4000)
    """
    image = cubes.checked(image, "range_image")
    mixed = mixed_pixels(image, significance=significance, reach=reach)
    variable = xr.Variable(
        ("row", "column"),
        mixed.astype(np.int8),
        {"long_name": "1 where a beam meets two surfaces at once", "units": "1"},
    )
    image = with_flag(image.assign({MIXED: variable}), QualityFlag.MIXED, mixed)
    return cubes.note(image, "mixed pixels marked")


def steps(
    distance: Floats, variance: Floats
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Masks of range steps to the next column and to the next row.

    A line with a step in it, one slope for both sides, is fitted to four pixels of each
    side, means of 7 or 21 along the edge. Slopes, curves and gaps are no steps by
    themselves; a crease sharper than the noise may be one. True where the step has
    four standard errors, and more than those within three pixels.
    """
    floor = (_SMOOTH * distance) ** 2
    variance = np.maximum(np.maximum(variance, floor), _TINY)
    return _steps(distance, variance), _steps(distance.T, variance.T).T


def _steps(distance: Floats, variance: Floats) -> NDArray[np.bool_]:
    """Mask of range steps between neighboring columns."""
    score = np.maximum(
        *(_step_scores(distance, variance, offset) for offset in _BESIDE)
    )
    beside = np.pad(score, ((0, 0), (_NEAR, _NEAR)))
    size = distance.shape[1]
    largest = np.max([beside[:, k : k + size] for k in range(2 * _NEAR + 1)], axis=0)
    is_step: NDArray[np.bool_] = (score > _STEP) & (score >= largest)
    return is_step


def _step_scores(distance: Floats, variance: Floats, rows: int) -> Floats:
    """Size of range steps to the next column in standard errors, 0 if unknown."""
    valid = np.isfinite(distance) & np.isfinite(variance)

    def summed(values: Floats) -> Floats:
        total = np.cumsum(np.pad(values, ((rows + 1, rows), (0, 0))), axis=0)
        return np.asarray(total[2 * rows + 1 :] - total[: -2 * rows - 1])

    count = summed(valid.astype(float))
    middle = float(np.mean(distance, where=valid)) if valid.any() else 0.0
    mean = summed(np.where(valid, distance - middle, 0.0)) / np.maximum(count, 1)
    spread = np.maximum(summed(np.where(valid, variance, 0.0)), _TINY)
    weight = np.where(count > 0, count**2 / spread, 0.0)
    padding = ((0, 0), (_SIDE, _SIDE))
    places, weights = np.pad(mean, padding), np.pad(weight, padding)
    size = distance.shape[1]
    # Sums over the left and the right side of weights times powers of the place.
    sums = np.zeros((2, 7, *distance.shape))
    for k in range(1 - _SIDE, _SIDE + 1):
        w = weights[:, _SIDE + k : _SIDE + k + size]
        y = w * (places[:, _SIDE + k : _SIDE + k + size] - mean)
        x = k - 0.5
        side = sums[int(k > 0)]
        for at, part in enumerate(
            (w, w * x, w * x * x, y, y * x, y * y / np.maximum(w, _TINY), w > 0)
        ):
            side[at] += part
    weight_sum, x, xx, y, xy, yy, columns = sums.sum(axis=0)
    half, xh, _, hy, *_ = (sums[1] - sums[0]) / 2
    weight_sum = np.maximum(weight_sum, _TINY)
    xy, hy = xy - x * y / weight_sum, hy - half * y / weight_sum
    xx, xh, hh = (
        xx - x**2 / weight_sum,
        xh - x * half / weight_sum,
        weight_sum / 4 - half**2 / weight_sum,
    )
    determinant = hh * xx - xh**2
    settled = determinant > 1e-6 * hh * xx
    safe = np.where(settled, determinant, 1.0)
    step, slope = (hy * xx - xy * xh) / safe, (xy * hh - hy * xh) / safe
    # Understated noise appears in the residuals of the fit.
    residual = yy - y**2 / weight_sum - step * hy - slope * xy
    excess = np.maximum(residual / np.maximum(columns - 3, 1), 1.0)
    error = np.sqrt(excess * np.maximum(xx, _TINY) / safe)
    return np.asarray(np.where(settled, np.abs(step) / error, 0.0))


def reached(
    across: NDArray[np.bool_],
    down: NDArray[np.bool_],
    pixel: tuple[int, int],
    reach: int,
) -> NDArray[np.bool_]:
    """Mask of pixels near a given pixel and connected to it without a range step.

    The way goes along the column, then along the row, as on the page.
    """
    row, column = pixel
    out = np.zeros(across.shape, dtype=bool)
    rows = _walked(down[:, column], row, reach)
    for reached_row in rows:
        out[reached_row, _walked(across[reached_row], column, reach)] = True
    return out


def _walked(step: NDArray[np.bool_], start: int, reach: int) -> list[int]:
    """Return indices within reach of a start pixel, with no range step in between."""
    low = high = start
    while low > max(start - reach, 0) and not step[low - 1]:
        low -= 1
    while high < min(start + reach, len(step) - 1) and not step[high]:
        high += 1
    return list(range(low, high + 1))


def _along_edge(
    distance: Floats, variance: Floats, axis: int
) -> tuple[Floats, Floats] | None:
    """Range from a straight-line fit to five pixels along an axis, and its variance.

    Each line is taken at the pixel itself, in the middle of the five but at the rim;
    not a number where one is missing or the five are not on a line.
    """
    size = distance.shape[axis]
    if size < _ALONG:
        return None
    begin = np.clip(np.arange(size) - _ALONG // 2, 0, size - _ALONG)
    place = np.arange(_ALONG) - (_ALONG - 1) / 2
    centred = place / (place @ place)
    values, errors = (
        np.stack(
            [np.take(values_of, begin + k, axis=axis) for k in range(_ALONG)], axis=-1
        )
        for values_of in (distance, variance)
    )
    mean, slope = values.mean(axis=-1), values @ centred
    residual = values - mean[..., None] - slope[..., None] * place
    straight = np.sum(residual**2 / errors, axis=-1) < _STRAIGHT_ALONG
    offset = np.arange(size) - begin - (_ALONG - 1) / 2
    if axis == 0:
        offset = offset[:, None]
    gain = 1 / _ALONG + np.asarray(offset)[..., None] * centred
    spread = np.sum(gain**2 * errors, axis=-1)
    line = np.where(straight, mean + slope * offset, np.nan)
    return np.asarray(line), np.asarray(spread)


def _between(distance: Floats, variance: Floats, axis: int, step: int) -> Floats:
    """Distance to the nearer of the surfaces on both sides; 0 if not between them.

    In standard errors, 0 where they lie between none.
    """
    sides = []
    for side in (-1, 1):
        near, error = (
            _shifted(values, axis, side * step) for values in (distance, variance)
        )
        # Off the surface's nearest pixel, and off its continuation, to the same side.
        from_pixel = (distance - near) / np.sqrt(variance + error)
        sides.append(
            [
                np.where(from_pixel * line > 0, _smaller(from_pixel, line), 0.0)
                for line in _off_lines(distance, variance, axis, side * step)
            ]
        )
    clear = np.zeros(distance.shape)
    for left in sides[0]:
        for right in sides[1]:
            with np.errstate(invalid="ignore"):
                either = np.minimum(np.abs(left), np.abs(right))
                clear = np.fmax(clear, np.where(left * right < 0, either, 0.0))
    return clear


def _off_lines(
    distance: Floats, variance: Floats, axis: int, first: int
) -> list[Floats]:
    """Deviations in standard errors from lines through 2 and 4 pixels on one side.

    In standard errors; not a number where a pixel is missing, or four are not straight.
    """
    side = 1 if first > 0 else -1
    off = []
    for count in (2, 4):
        place = np.abs(first) + np.arange(count)
        centred = place - place.mean()
        # The line at the pixel itself, where the place is 0.
        gain = 1 / count - place.mean() * centred / (centred @ centred)
        along = [_shifted(distance, axis, side * int(k)) for k in place]
        errors = [_shifted(variance, axis, side * int(k)) for k in place]
        line = sum(g * value for g, value in zip(gain, along, strict=True))
        spread = sum(g**2 * value for g, value in zip(gain, errors, strict=True))
        score = (distance - line) / np.sqrt(variance + spread)
        if count > 2:
            mean = sum(along) / count
            slope = sum(c * value for c, value in zip(centred, along, strict=True)) / (
                centred @ centred
            )
            misfit = sum(
                (value - mean - c * slope) ** 2 / error
                for c, value, error in zip(centred, along, errors, strict=True)
            )
            score = np.where(misfit < _STRAIGHT, score, np.nan)
        off.append(np.asarray(score))
    return off


def _shifted(values: Floats, axis: int, shift: int) -> Floats:
    """Values shifted by a number of rows or columns, NaN beyond the border."""
    moved = np.full(values.shape, np.nan)
    size = values.shape[axis]
    if abs(shift) >= size:
        return moved
    source, target = [slice(None)] * 2, [slice(None)] * 2
    source[axis] = slice(max(shift, 0), size + min(shift, 0))
    target[axis] = slice(max(-shift, 0), size + min(-shift, 0))
    moved[tuple(target)] = values[tuple(source)]
    return moved


def _smaller(first: Floats, second: Floats) -> Floats:
    """Value of smaller magnitude of two arrays, element by element."""
    return np.where(np.abs(first) < np.abs(second), first, second)
