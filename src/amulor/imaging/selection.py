"""Pixel selection in range images: doubtful pixels removed, or thinned for drawing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor._progress import tell
from amulor.cube import UNUSABLE, QualityFlag, tiles
from amulor.errors import CubeError
from amulor.imaging.common import with_flag
from amulor.imaging.measure import Check, Checked, compared


def leave_out(
    image: xr.Dataset,
    *,
    good_only: bool = False,
    largest_uncertainty: float | None = None,
    mixed: bool = False,
) -> xr.Dataset:
    """Range image without doubtful, uncertain or mixed pixels, as selected.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    good_only : bool
        Whether to discard all pixels with any flag.
    largest_uncertainty : float, optional
        Largest combined standard uncertainty; pixels above it are discarded [m].
    mixed : bool
        Whether to discard mixed pixels and outliers, whose points lie off any surface.

    Returns
    -------
    xarray.Dataset
        The image with these pixels flagged `MISSING`; its history states their number
        by reason.

    Raises
    ------
    ValueError
        If the largest uncertainty is not above 0 m.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.polarization(
    ...     samples.cube("ladder"),
    ...     target_ratio=0.242, water_ratio=0.099, water_fluctuation=0.137,
    ... )
    >>> image = imaging.range_image(target)
    >>> kept = imaging.leave_out(image, largest_uncertainty=7e-3)
    >>> largest = float(kept["slant_range_uncertainty"].max())
    >>> print(f"largest uncertainty {1e3 * largest:.1f} mm")
    largest uncertainty 7.0 mm
    """
    image = cubes.checked(image, "range_image")
    gone, counts = to_leave_out(
        image,
        good_only=good_only,
        largest_uncertainty=largest_uncertainty,
        mixed=mixed,
    )
    return without(image, gone, counts)


def to_leave_out(
    image: xr.Dataset,
    *,
    good_only: bool,
    largest_uncertainty: float | None,
    mixed: bool,
) -> tuple[NDArray[np.bool_], dict[str, int]]:
    """Mask of pixels to discard, and their number by reason."""
    if largest_uncertainty is not None and not largest_uncertainty > 0:
        raise ValueError(
            f"largest uncertainty must be above 0 m, got {largest_uncertainty:g} m"
        )
    flag = image["quality_flag"].values
    usable = (flag & UNUSABLE) == 0
    reasons = {}
    if good_only:
        reasons["doubtful"] = flag != 0
    if mixed:
        between = QualityFlag.MIXED | QualityFlag.OUTLIER
        reasons["mixed or outlying"] = (flag & between) != 0
    if largest_uncertainty is not None:
        limit = f"more uncertain than {largest_uncertainty * 1e3:g} mm"
        sigma = image["slant_range_uncertainty"].values
        reasons[limit] = ~(sigma <= largest_uncertainty)
    gone = np.zeros(flag.shape, dtype=bool)
    counts = {}
    for reason, pixels in reasons.items():
        new = pixels & usable & ~gone
        gone |= new
        counts[reason] = int(new.sum())
    return gone, counts


def without(
    image: xr.Dataset, gone: NDArray[np.bool_], counts: dict[str, int]
) -> xr.Dataset:
    """Range image with selected pixels flagged as missing."""
    if not any(counts.values()):
        return image
    ranges = {
        str(name): values.where(~gone)
        for name, values in image.data_vars.items()
        if str(name).startswith("slant_range") and values.dims == ("row", "column")
    }
    image = with_flag(image.assign(ranges), QualityFlag.MISSING, gone)
    listed = ", ".join(f"{count} {reason}" for reason, count in counts.items())
    return cubes.note(image, f"left out: {listed}")


#: Pixels up to which an image is shown as it is [1].
LARGEST = 250_000
#: Largest number of pixels after thinning [1].
SHOWN = 250_000


@dataclass(frozen=True, kw_only=True)
class Whole:
    """Statistics of all pixels of a range image that is thinned for drawing."""

    rows: int
    """Number of rows [1]."""
    columns: int
    """Number of columns [1]."""
    step: int
    """Stride of the drawn rows and columns; 1 if all are drawn [1]."""
    usable: int
    """Number of pixels with a range [1]."""
    flags: dict[str, int]
    """Number of pixels by flag [1]."""
    checks: tuple[Checked, ...] = ()
    """Reference lengths, measured at full resolution."""


def thinned(
    source: tiles.Source, *, rows: int | None = None, checks: Sequence[Check] = ()
) -> tuple[xr.Dataset, Whole]:
    """Evenly thinned range image, and statistics of all its pixels.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> from amulor.cube.tiles import InMemory
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image, whole = thinned(InMemory(imaging.range_image(target)))
    >>> whole.step, whole.flags
    (1, {'no_open_water': 4000})
    """
    count = source.rows * source.columns
    step = 1 if count <= LARGEST else math.ceil(math.sqrt(count / SHOWN))
    first = min(step // 2, source.rows - 1), min(step // 2, source.columns - 1)
    assembled = tiles.Whole(
        len(range(first[0], source.rows, step)),
        len(range(first[1], source.columns, step)),
    )
    flags: Counter[str] = Counter()
    meanings: list[str] = []
    usable = done = 0
    for begin, end in tiles.bands(source, rows):
        tell(f"row {begin:,} of {source.rows:,}", begin / source.rows)
        tile = cubes.checked(source.tile(begin, end), "range_image")
        usable += int(np.isfinite(tile["slant_range"].values).sum())
        flags.update(cubes.flag_counts(tile))
        meanings = str(tile["quality_flag"].attrs["flag_meanings"]).split()
        start = first[0] + step * math.ceil(max(begin - first[0], 0) / step) - begin
        part = tile.isel(
            row=slice(start, None, step), column=slice(first[1], None, step)
        )
        if part.sizes["row"]:
            assembled.put(part, done)
            done += part.sizes["row"]
    return assembled.made(), Whole(
        rows=source.rows,
        columns=source.columns,
        step=step,
        usable=usable,
        flags={name: flags[name] for name in meanings if flags[name]},
        checks=tuple(_compared(source, check) for check in checks),
    )


def _compared(source: tiles.Source, check: Check) -> Checked:
    """Measure a reference length from the rows around its ends."""
    for row, column in (check.first, check.second):
        if row >= source.rows or column >= source.columns:
            raise CubeError(
                f"check {check.name!r}: pixel ({row}, {column}) is outside of the "
                f"image of {source.rows} rows and {source.columns} columns"
            )
    bands = sorted(
        (max(row - check.reach, 0), min(row + check.reach + 1, source.rows))
        for row in (check.first[0], check.second[0])
    )
    if bands[1][0] <= bands[0][1]:
        bands = [(bands[0][0], max(bands[0][1], bands[1][1]))]
    assembled = tiles.Whole(sum(end - begin for begin, end in bands), source.columns)
    numbers: list[int] = []
    for begin, end in bands:
        assembled.put(source.tile(begin, end), len(numbers))
        numbers += range(begin, end)
    place = {number: index for index, number in enumerate(numbers)}
    ends = {
        name: (place[pixel[0]], pixel[1])
        for name, pixel in (("first", check.first), ("second", check.second))
    }
    moved = check.model_copy(update=ends)
    return replace(compared(assembled.made(), moved), check=check)
