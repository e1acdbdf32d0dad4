"""Files of a scan that a cluster computes in row ranges and then joins."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import xarray as xr

from amulor.cube import schema, tiles
from amulor.errors import CubeError
from amulor.io.netcdf import open_rows, row_writer, tile_rows
from amulor.pipeline import (
    Made,
    Prepared,
    TiledStep,
    cloud_file,
    steps_from,
    window,
)
from amulor.scale.tasks import Record, Task
from amulor.simulation.by_rows import SimulatedRows
from amulor.site.load import check_level
from amulor.survey import Survey

__all__ = [
    "Step",
    "chain",
    "forget_parts",
    "make_part",
    "parts_of",
    "splits",
    "whole",
]

#: Folder of the parts, in that of a scan.
FOLDER = "parts"
#: Name of the file of a part.
ROWS = "rows.nc"


@dataclass(frozen=True, kw_only=True)
class Step:
    """Processing step of a scan, which makes one file."""

    task: Task
    """Task of the scan that the step belongs to."""
    name: str
    """Name of the output file."""
    of: Path
    """Input file."""
    how: dict[str, Any]
    """Name and arguments of the step, for the record."""
    tiled: TiledStep | None = None
    """Step on rows; None for a simulation and for a cloud."""

    @property
    def folder(self) -> Path:
        """Folder for the row ranges of the file, before they are joined."""
        return Path(self.task.folder) / FOLDER / Path(self.name).stem


def chain(task: Task) -> tuple[Step, ...]:
    """Return the processing steps of a scan, from its input to the point cloud."""
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
    for name, tiled in steps_of_scan.items():
        current = add(f"{name}.nc", tiled.how, tiled)
    if not task.moves:
        add("cloud.ply", {"step": "cloud"})
    return tuple(steps)


def _level_of(path: Path) -> str:
    with open_rows(path, check_digest=False) as rows:
        return str(rows.head.attrs.get("level"))


class _Rows:
    """Source of an output file's rows, which are computed tile by tile."""

    def __init__(
        self, source: tiles.Source, step: Step, of: Callable[[int, int], xr.Dataset]
    ) -> None:
        self.rows, self.columns, self.of = source.rows, source.columns, of
        self.size = _size(step, source)

    def tiles(self, begin: int, end: int) -> Iterator[tuple[int, xr.Dataset]]:
        """Yield first row and content of each tile between two rows."""
        for first in range(begin, end, self.size):
            yield first, self.of(first, min(first + self.size, end))


@contextmanager
def _opened(step: Step, *, check_digest: bool) -> Iterator[_Rows]:
    """Open the input of a step, from which the rows of its file are computed."""
    if step.tiled is None:
        source = _simulated(step.of.read_text("utf-8"), step.of, step.task.seed)
        yield _Rows(source, step, source.tile)
        return
    identity = Record(Path(step.task.folder)).identity(step.of)
    with open_rows(step.of, check_digest=check_digest) as cube:
        prepared = _prepared(_Known(f"{step.how}, {step.of}, {identity}", step, cube))
        yield _Rows(cube, step, Made(prepared, cube).tile)


@lru_cache(maxsize=1)
def _simulated(text: str, path: Path, seed: int) -> SimulatedRows:
    """Return the simulated rows of a survey; cached for further parts of the scan."""
    del text  # distinguishes a changed survey from its old version
    return SimulatedRows(Survey.from_toml(path), rng=seed)


@dataclass(frozen=True)
class _Known:
    """Cache key of a step fitted to a cube: step, path and identity of the file."""

    key: str
    step: Step
    source: tiles.Source

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Known) and other.key == self.key

    def __hash__(self) -> int:
        return hash(self.key)


@lru_cache(maxsize=1)
def _prepared(scan: _Known) -> Prepared:
    """Return a step fitted to its scan; cached for further row ranges of the scan."""
    step, source = scan.step, scan.source
    assert step.tiled is not None
    return Prepared(step.tiled, source, step.task.tile_rows or tile_rows(source))


def splits(task: Task) -> tuple[str, ...]:
    """Return the files of a scan that are large enough for work by row ranges."""
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
    """Return row count, column count and channels of a step's input file."""
    if step.how["step"] == "simulate":
        survey = Survey.from_toml(step.of)
        instrument = survey.instrument
        sizes = {
            "modulation_frequency": len(instrument.modulation_frequencies),
            "polarization": len(instrument.polarizations),
        }
        scan = survey.scan
        lengths: Any = SimpleNamespace(
            head=SimpleNamespace(sizes=sizes), rows=scan.rows, columns=scan.columns
        )
        return cast(tiles.Source, lengths)
    with open_rows(step.of, check_digest=False) as cube:
        return cube


def parts_of(task: Task, name: str) -> list[tuple[int, int]]:
    """Return first row and end row of each range in which a file is computed."""
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
    """Return the number of rows in a tile of a step's file."""
    if step.tiled is None:
        return step.task.tile_rows or tile_rows(source)
    return window(step.tiled, source, step.task.tile_rows)


def _step(task: Task, name: str) -> Step:
    return next(step for step in chain(task) if step.name == name)


def make_part(task: Task, name: str, begin: int, end: int) -> None:
    """Compute a range of rows of a file, unless its result exists."""
    step = _step(task, name)
    folder = step.folder / f"{begin:08d}"
    folder.mkdir(parents=True, exist_ok=True)

    def make(path: Path) -> None:
        # The digest of the whole source is not checked again for each part; its blocks
        # have checksums.
        with (
            _opened(step, check_digest=False) as rows,
            row_writer(path, end - begin, overwrite=True) as writer,
        ):
            for first, tile in rows.tiles(begin, end):
                writer.put(tile, first - begin)

    identity = Record(Path(task.folder)).identity(step.of)
    arguments = {**step.how, "rows": [begin, end], "tile_rows": task.tile_rows}
    Record(folder).made(ROWS, of=identity, how=arguments, make=make)


def whole(step: Step, path: Path) -> None:
    """Write a file: join its row ranges if all exist, else compute all rows."""
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
    """Copy a range of rows into the joined file, tile by tile."""
    size = step.task.tile_rows or tile_rows(_sizes(step))
    with open_rows(file) as cube:
        names = _in_order(file)
        for begin in range(0, cube.rows, size):
            tile = cube.tile(begin, min(begin + size, cube.rows))
            writer.put(tile[[n for n in names if n in tile.variables]], first + begin)


def _in_order(file: Path) -> list[str]:
    """Return all variable names of a cube file, in the order of the file."""
    import h5py

    with h5py.File(file, "r") as storage:
        names = list(storage)
        for group in schema.GROUPS:
            names += [f"{group}_{name}" for name in storage.get(group, ())]
    return names


def forget_parts(step: Step) -> None:
    """Remove the row-range files of a finished file."""
    shutil.rmtree(step.folder, ignore_errors=True)
    folder = step.folder.parent
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
