"""Range images too large to be drawn: some of the pixels, and what is said of all."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from amulor import cube as cubes
from amulor._progress import tell
from amulor.cube import tiles
from amulor.errors import CubeError
from amulor.imaging.measure import Check, Checked, compared

__all__ = ["LARGEST", "SHOWN", "Whole", "thinned"]

#: Pixels up to which an image is shown as it is [1].
LARGEST = 250_000
#: Pixels that are left of a larger one, at most [1].
SHOWN = 250_000


@dataclass(frozen=True, kw_only=True)
class Whole:
    """What is known of all pixels of an image of which some are shown."""

    rows: int
    """Rows [1]."""
    columns: int
    """Columns [1]."""
    step: int
    """Every such row and column is shown; 1 where all are [1]."""
    usable: int
    """Pixels that hold a range [1]."""
    flags: dict[str, int]
    """How many have which flag [1]."""
    checks: tuple[Checked, ...] = ()
    """Known lengths, measured in the pixels that they name."""


def thinned(
    source: tiles.Source, *, rows: int | None = None, checks: Sequence[Check] = ()
) -> tuple[xr.Dataset, Whole]:
    """Return pixels of a range image that stand for all, and what is said of all.

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
    shown = tiles.Whole(
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
            shown.put(part, done)
            done += part.sizes["row"]
    return shown.made(), Whole(
        rows=source.rows,
        columns=source.columns,
        step=step,
        usable=usable,
        flags={name: flags[name] for name in meanings if flags[name]},
        checks=tuple(_compared(source, check) for check in checks),
    )


def _compared(source: tiles.Source, check: Check) -> Checked:
    """Measure a known length in the rows about its ends."""
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
    whole = tiles.Whole(sum(end - begin for begin, end in bands), source.columns)
    numbers: list[int] = []
    for begin, end in bands:
        whole.put(source.tile(begin, end), len(numbers))
        numbers += range(begin, end)
    place = {number: here for here, number in enumerate(numbers)}
    ends = {
        name: (place[pixel[0]], pixel[1])
        for name, pixel in (("first", check.first), ("second", check.second))
    }
    moved = check.model_copy(update=ends)
    return replace(compared(whole.made(), moved), check=check)
