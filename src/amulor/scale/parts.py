"""Point clouds of range images larger than memory: rows counted first, then written."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import _progress, imaging
from amulor import cube as cubes
from amulor._progress import tell
from amulor.cube import DOUBTFUL, UNUSABLE, schema, tiles
from amulor.errors import CubeError, FormatError
from amulor.imaging.frame import Frame
from amulor.imaging.selection import to_leave_out, without
from amulor.io._cloud import checked_parts
from amulor.io.e57 import write_e57_parts
from amulor.io.laz import write_laz_parts
from amulor.io.netcdf import open_rows, row_writer, tile_rows
from amulor.io.ply import write_ply_parts
from amulor.io.text_cloud import write_text_parts
from amulor.pipeline import Made, Prepared, TiledStep, steps_from, window
from amulor.scale.tasks import Record, Task
from amulor.simulation.by_rows import SimulatedRows
from amulor.site.load import check_level
from amulor.survey import Survey

__all__ = [
    "BY_ROWS",
    "CloudSummary",
    "Selection",
    "Step",
    "chain",
    "cloud_file",
    "forget_parts",
    "make_part",
    "parts_of",
    "splits",
    "whole",
]


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
    """Write the point cloud of a range image, tile by tile."""
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


#: Folder of the parts, in that of a scan.
FOLDER = "parts"
#: Name of the file of a part.
ROWS = "rows.nc"


@dataclass(frozen=True, kw_only=True)
class Step:
    """One file of a scan, and how it is made."""

    task: Task
    """The scan."""
    name: str
    """Of the file."""
    of: Path
    """What it is made of."""
    how: dict[str, Any]
    """Step and arguments, for the record."""
    tiled: TiledStep | None = None
    """What is done to rows; None of a survey and of a cloud."""

    @property
    def folder(self) -> Path:
        """Where the parts of the file are."""
        return Path(self.task.folder) / FOLDER / Path(self.name).stem


def chain(task: Task) -> tuple[Step, ...]:
    """Return the steps of a scan: samples, target signal, range image, cloud."""
    steps: list[Step] = []
    folder, current = Path(task.folder), Path(task.file)

    def add(name: str, how: dict[str, Any], tiled: TiledStep | None = None) -> Path:
        steps.append(Step(task=task, name=name, of=current, how=how, tiled=tiled))
        return folder / name

    if task.simulated_from is not None:
        current = Path(task.simulated_from)
        current = add("samples.nc", {"step": "simulate", "seed": task.seed})
        level = "samples"
    else:
        level = _level_of(current)
    check_level(level, processed=task.method is not None, name=task.name)
    steps_of_scan = steps_from(
        level,
        method=task.method,
        polarization=task.polarization,
        interval=task.interval,
    )
    for made, tiled in steps_of_scan.items():
        current = add(f"{made}.nc", tiled.how, tiled)
    add("cloud.ply", {"step": "cloud"})
    return tuple(steps)


def _level_of(path: Path) -> str:
    with open_rows(path, check_digest=False) as rows:
        return str(rows.head.attrs.get("level"))


class _Rows:
    """The rows of a file that is to be made, in tiles."""

    def __init__(
        self, source: tiles.Source, step: Step, of: Callable[[int, int], xr.Dataset]
    ) -> None:
        self.rows, self.columns, self.of = source.rows, source.columns, of
        self.size = _size(step, source)

    def tiles(self, begin: int, end: int) -> Iterator[tuple[int, xr.Dataset]]:
        """Yield the tiles between two rows, the first of which begins one."""
        for first in range(begin, end, self.size):
            yield first, self.of(first, min(first + self.size, end))


@contextmanager
def _opened(step: Step, *, check_digest: bool) -> Iterator[_Rows]:
    """Open what the rows of a file are made of."""
    if step.tiled is None:
        source = _simulated(step.of.read_text("utf-8"), step.of, step.task.seed)
        yield _Rows(source, step, source.tile)
        return
    identity = Record(Path(step.task.folder)).identity(step.of)
    with open_rows(step.of, check_digest=check_digest) as cube:
        made = _prepared(_Known(f"{step.how}, {step.of}, {identity}", step, cube))
        yield _Rows(cube, step, Made(made, cube).tile)


@lru_cache(maxsize=1)
def _simulated(text: str, path: Path, seed: int) -> SimulatedRows:
    """Return the rows of a survey; kept, since a worker makes many parts of a scan."""
    del text  # tells a survey that was changed from the one before
    return SimulatedRows(Survey.from_toml(path), rng=seed)


@dataclass(frozen=True)
class _Known:
    """What all parts of a file share, told from others by a text."""

    key: str
    step: Step
    source: tiles.Source

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Known) and other.key == self.key

    def __hash__(self) -> int:
        return hash(self.key)


@lru_cache(maxsize=1)
def _prepared(known: _Known) -> Prepared:
    """Return what treats rows; kept, as the simulation is."""
    step, source = known.step, known.source
    assert step.tiled is not None
    return Prepared(step.tiled, source, step.task.tile_rows or tile_rows(source))


def splits(task: Task) -> tuple[str, ...]:
    """Return which files of a scan are worth being made in parts."""
    try:
        steps = chain(task)
        sizes = _sizes(steps[0])
    except (CubeError, OSError, ValueError):
        return ()
    large = tiles.is_large(8 * sizes.rows * tiles.samples_of_row(sizes))
    if task.tile_rows is not None:
        large = sizes.rows > task.tile_rows
    return tuple(step.name for step in steps if large and step.name != "cloud.ply")


def _sizes(step: Step) -> tiles.Source:
    """Return rows, columns and planes of what a file is made of."""
    if step.how["step"] == "simulate":
        survey = Survey.from_toml(step.of)
        instrument = survey.instrument
        sizes = {
            "modulation_frequency": len(instrument.modulation_frequencies),
            "polarization": len(instrument.polarizations),
        }
        scan = survey.scan
        found: Any = SimpleNamespace(
            head=SimpleNamespace(sizes=sizes), rows=scan.rows, columns=scan.columns
        )
        return cast(tiles.Source, found)
    with open_rows(step.of, check_digest=False) as cube:
        return cube


def parts_of(task: Task, name: str) -> list[tuple[int, int]]:
    """Return in which rows a file of a scan is made."""
    step = _step(task, name)
    source = _sizes(step)
    size = _size(step, source)
    part = 8 * size * tiles.samples_of_row(source)
    few = 1 if task.tile_rows else max(1, round(tiles.LARGE / part))
    rows = size * few
    return [
        (begin, min(begin + rows, source.rows)) for begin in range(0, source.rows, rows)
    ]


def _size(step: Step, source: tiles.Source) -> int:
    """Return how many rows of a file are made at once."""
    if step.tiled is None:
        return step.task.tile_rows or tile_rows(source)
    return window(step.tiled, source, step.task.tile_rows)


def _step(task: Task, name: str) -> Step:
    return next(step for step in chain(task) if step.name == name)


def make_part(task: Task, name: str, begin: int, end: int) -> None:
    """Make some rows of a file of a scan, unless they are there."""
    step = _step(task, name)
    folder = step.folder / f"{begin:08d}"
    folder.mkdir(parents=True, exist_ok=True)

    def make(path: Path) -> None:
        # Not all of the source for each part of it; its blocks have checksums.
        with (
            _opened(step, check_digest=False) as rows,
            row_writer(path, end - begin, overwrite=True) as writer,
        ):
            for first, tile in rows.tiles(begin, end):
                writer.put(tile, first - begin)

    identity = Record(Path(task.folder)).identity(step.of)
    how = {**step.how, "rows": [begin, end], "tile_rows": task.tile_rows}
    Record(folder).made(ROWS, of=identity, how=how, make=make)


def whole(step: Step, path: Path) -> None:
    """Make a file: of its parts if all are there, from the beginning if not."""
    if step.name == "cloud.ply":
        cloud_file(step.of, path, rows=step.task.tile_rows, overwrite=True)
        return
    parts = parts_of(step.task, step.name)
    files = [step.folder / f"{begin:08d}" / ROWS for begin, _ in parts]
    rows = parts[-1][1]
    with row_writer(path, rows, overwrite=True) as writer:
        if all(file.is_file() for file in files):
            for (first, _), file in zip(parts, files, strict=True):
                _put(writer, first, file, step)
            return
        with _opened(step, check_digest=True) as source:
            for begin, tile in source.tiles(0, rows):
                writer.put(tile, begin)


def _put(writer: Any, first: int, file: Path, step: Step) -> None:
    """Copy the rows of a part, in the tiles in which they were made."""
    size = step.task.tile_rows or tile_rows(_sizes(step))
    with open_rows(file) as cube:
        names = _in_order(file)
        for begin in range(0, cube.rows, size):
            tile = cube.tile(begin, min(begin + size, cube.rows))
            writer.put(tile[[n for n in names if n in tile.variables]], first + begin)


def _in_order(file: Path) -> list[str]:
    """Return the variables of a file in the order in which they were made."""
    import h5py

    with h5py.File(file, "r") as storage:
        names = list(storage)
        for group in schema.GROUPS:
            names += [f"{group}_{name}" for name in storage.get(group, ())]
    return names


def forget_parts(step: Step) -> None:
    """Remove the parts of a file that is there."""
    shutil.rmtree(step.folder, ignore_errors=True)
    folder = step.folder.parent
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
