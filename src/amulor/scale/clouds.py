"""Point clouds of range images larger than memory: rows counted first, then written."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import _progress, imaging
from amulor import cube as cubes
from amulor._progress import tell
from amulor.cube import DOUBTFUL, UNUSABLE, tiles
from amulor.errors import FormatError
from amulor.imaging.frame import Frame
from amulor.imaging.selection import to_leave_out, without
from amulor.io._cloud import checked_parts
from amulor.io.e57 import write_e57_parts
from amulor.io.laz import write_laz_parts
from amulor.io.netcdf import open_rows, row_writer, tile_rows
from amulor.io.ply import write_ply_parts
from amulor.io.text_cloud import write_text_parts

__all__ = ["BY_ROWS", "CloudSummary", "Selection", "cloud_file"]

#: Gives the parts of a cloud, the same ones each time.
Parts = Callable[[], Iterator[xr.Dataset]]
#: Rows and columns of the image that a cloud comes from.
Shape = tuple[int, int]


def _ply(parts: Parts, count: int, shape: Shape, path: Path, overwrite: bool) -> None:
    write_ply_parts(parts(), count, path, overwrite=overwrite)


def _text(parts: Parts, count: int, shape: Shape, path: Path, overwrite: bool) -> None:
    write_text_parts(parts(), count, path, overwrite=overwrite)


def _laz(parts: Parts, count: int, shape: Shape, path: Path, overwrite: bool) -> None:
    write_laz_parts(parts, count, path, overwrite=overwrite)


def _e57(parts: Parts, count: int, shape: Shape, path: Path, overwrite: bool) -> None:
    write_e57_parts(parts, count, path, shape=shape, overwrite=overwrite)


def _netcdf(
    parts: Parts, count: int, shape: Shape, path: Path, overwrite: bool
) -> None:
    done = 0
    with row_writer(path, count, overwrite=overwrite, over="point") as writer:
        for part in checked_parts(parts(), count, name=f"the cloud for {path}"):
            whole = np.array(shape, dtype=np.int32)
            writer.put(part.assign_attrs(scan_shape=whole), done)
            done += part.sizes["point"]


_WRITERS = {
    ".ply": _ply,
    ".xyz": _text,
    ".csv": _text,
    ".laz": _laz,
    ".las": _laz,
    ".e57": _e57,
    ".nc": _netcdf,
}
#: Pixels that are made into points at once, unless somebody says otherwise.
_PIXELS = 2**17
#: Endings of clouds that are written by rows.
BY_ROWS = tuple(_WRITERS)


@dataclass(frozen=True)
class Selection:
    """Which pixels `amulor.imaging.leave_out` takes."""

    good_only: bool = False
    """All that carry a flag."""
    largest_uncertainty: float | None = None
    """Those that are less certain [m]."""
    mixed: bool = False
    """Mixed pixels and outliers."""

    def of(self, image: xr.Dataset) -> tuple[NDArray[np.bool_], dict[str, int]]:
        """Return the pixels, and how many for which reason."""
        return to_leave_out(
            image,
            good_only=self.good_only,
            largest_uncertainty=self.largest_uncertainty,
            mixed=self.mixed,
        )


@dataclass(frozen=True)
class CloudSummary:
    """What a cloud by rows holds."""

    points: int
    """Points."""
    doubtful: int
    """Those whose range is doubtful."""
    error_unknown: str = ""
    """Why they state no error; empty if they do."""


def cloud_file(
    source: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    frame: Frame | None = None,
    selection: Selection | None = None,
    rows: int | None = None,
    overwrite: bool = False,
) -> CloudSummary:
    """Write the point cloud of a range image, tile by tile.

    Parameters
    ----------
    source, output : path-like
        Range image (netCDF), and a file with an ending of `BY_ROWS`.
    frame : Frame, optional
        Axes of the points; the instrument's by default.
    selection : Selection, optional
        Pixels that are left out; none by default.
    rows : int, optional
        Rows of a tile; by default 131,072 pixels.
    overwrite : bool
        Whether an existing file is replaced.

    Returns
    -------
    CloudSummary
        Of the file, which is that of `amulor.imaging.point_cloud` of the whole image.

    Raises
    ------
    CubeError
        If the image holds no point, or is none.
    FormatError
        If a file cannot be read or written, or the ending is another one.
    """
    ending = Path(output).suffix.lower()
    if ending not in _WRITERS:
        raise FormatError(
            f"{output}: by rows are written {', '.join(BY_ROWS)}; choose one of them, "
            "or export the whole in memory"
        )
    chosen = selection or Selection()
    with open_rows(Path(source)) as image:
        cubes.checked(image.tile(0, 1), "range_image")
        few = max(1, _PIXELS // image.columns)
        size = min(tile_rows(image), few) if rows is None else rows
        with _progress.part(0.0, 0.2):
            summary, counts = _counted(image, chosen, size)

        def parts() -> Iterator[xr.Dataset]:
            for begin, end in tiles.bands(image, size):
                tell(f"row {begin:,} of {image.rows:,}", 0.2 + 0.8 * begin / image.rows)
                tile = image.tile(begin, end)
                tile = without(tile, chosen.of(tile)[0], counts)
                cloud = imaging.point_cloud(tile, frame=frame)
                row = cloud["row"]
                yield cloud.assign(row=row.copy(data=row.values + np.int32(begin)))

        shape = image.rows, image.columns
        _WRITERS[ending](parts, summary.points, shape, Path(output), overwrite)
    return summary


def _counted(
    image: tiles.Source, selection: Selection, size: int
) -> tuple[CloudSummary, dict[str, int]]:
    """Return how many points there will be, and how many are left out for what."""
    counts: Counter[str] = Counter()
    points = doubtful = 0
    words = ""
    for begin, end in tiles.bands(image, size):
        tell(f"counting, row {begin:,} of {image.rows:,}", begin / image.rows)
        tile = image.tile(begin, end)
        words = words or cubes.error_unknown(tile)
        gone, found = selection.of(tile)
        # Reasons without a pixel stay in the list.
        for reason, number in found.items():
            counts[reason] += number
        flag = tile["quality_flag"].values
        there = ((flag & UNUSABLE) == 0) & ~gone
        points += int(there.sum())
        doubtful += int((there & ((flag & int(DOUBTFUL)) != 0)).sum())
    return CloudSummary(points, doubtful, words), dict(counts)
