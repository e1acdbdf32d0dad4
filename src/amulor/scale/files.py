"""Files larger than memory: a step from one file to the next, tile by tile."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from amulor import cube as cubes
from amulor import io, rejection
from amulor._progress import tell
from amulor.cube import tiles
from amulor.io.netcdf import is_large, open_rows, row_writer
from amulor.scale.steps import image_step
from amulor.scale.tiled import TiledStep, run_step

__all__ = ["Summary", "image_file", "is_large", "reject_file", "run_file"]


@dataclass(frozen=True, kw_only=True)
class Summary:
    """What a step by rows has made, without the rows themselves."""

    head: xr.Dataset
    """All that does not run over the rows, attributes included."""
    count: int
    """Samples of a target signal, pixels of a range image."""
    usable: int
    """Those that are numbers."""
    flagged: int
    """Those with a flag."""
    doubtful: int
    """Those that are numbers and have a flag."""
    flags: dict[str, int]
    """How many have which flag."""
    comparison: rejection.Comparison | None = None
    """Of all methods, where one was to be chosen."""


def run_file(
    step: TiledStep,
    source: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    rows: int | None = None,
    overwrite: bool = False,
) -> Summary:
    """Run a step from a file to another one, tile by tile."""
    with open_rows(Path(source)) as cube:
        return _run(step, cube, output, rows, overwrite=overwrite)


def _run(
    step: TiledStep,
    cube: tiles.Source,
    output: str | os.PathLike[str],
    rows: int | None,
    *,
    overwrite: bool,
) -> Summary:
    """Run a step on the rows of a cube, and count what it makes."""
    flags: Counter[str] = Counter()
    count = usable = flagged = doubtful = 0
    head: xr.Dataset | None = None
    with row_writer(output, cube.rows, overwrite=overwrite) as writer:
        for begin, tile in run_step(step, cube, rows=rows):
            writer.put(tile, begin)
            signal = "in_phase" if "in_phase" in tile else "slant_range"
            number = np.isfinite(tile[signal].values)
            flag = tile["quality_flag"].values != 0
            count, usable = count + number.size, usable + int(number.sum())
            flagged += int(flag.sum())
            doubtful += int((flag & number).sum())
            flags.update(cubes.flag_counts(tile))
            if head is None:
                over = [k for k, v in tile.variables.items() if "row" in v.dims]
                head = tile.drop_vars(over)
    assert head is not None
    return Summary(
        head=head,
        count=count,
        usable=usable,
        flagged=flagged,
        doubtful=doubtful,
        flags=dict(flags),
    )


def reject_file(
    source: str | os.PathLike[str],
    output: str | os.PathLike[str],
    method: str,
    *,
    open_water: str | os.PathLike[str] | None = None,
    rows: int | None = None,
    overwrite: bool = False,
    **options: Any,
) -> Summary:
    """Take the water signal out of a file of samples, tile by tile."""
    chosen = rejection.load(method)
    with open_rows(Path(source)) as samples:
        cube: tiles.Source = samples
        if open_water is not None:
            shots = io.read_cube(open_water)
            cube = tiles.Changed(
                samples, lambda tile: rejection.with_open_water(tile, shots)
            )
        tell("scan-wide statistics", 0.0)
        of = chosen.fit(cube, **options)
        step = TiledStep(prepare=lambda _: of)
        made = _run(step, cube, output, rows, overwrite=overwrite)
        return replace(made, comparison=getattr(of, "comparison", None))


def image_file(
    source: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    rows: int | None = None,
    overwrite: bool = False,
    **options: Any,
) -> Summary:
    """Turn a file with a target signal into a range image, tile by tile."""
    step = image_step(**options)
    return run_file(step, source, output, rows=rows, overwrite=overwrite)
