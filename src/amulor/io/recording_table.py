"""Columns of a recording that other software made: CSV or HDF5 as arrays by name."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import FormatError
from amulor.io.files import load_hdf5
from amulor.io.recording_map import RecordingMap, TableSettings

Texts = NDArray[np.str_]
Floats = NDArray[np.float64]
Line = tuple[int, str]


class Table:
    """Columns by name, all of one length."""

    def __init__(
        self,
        path: Path,
        columns: dict[str, NDArray[Any]],
        lines: Sequence[int] = (),
        *,
        first: int = 0,
    ) -> None:
        self._path, self._columns, self._lines = path, columns, lines
        self._first = first

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(next(iter(self._columns.values())))

    def texts(self, name: str) -> Texts:
        """Return a column as it is written."""
        return np.char.strip(self._columns[name].astype(str))

    def numbers(self, name: str, *, decimal: str = ".") -> Floats:
        """Return a column as numbers, not a number where it is empty."""
        values = self._columns[name]
        if values.dtype.kind in "fiub":
            return values.astype(float)
        texts = np.char.replace(self.texts(name), decimal, ".")
        result = np.full(len(texts), np.nan)
        for number, text in enumerate(texts):
            try:
                result[number] = float(text) if text else np.nan
            except ValueError:
                raise FormatError(
                    f"{self.place(number)}: column {name!r} holds {str(text)!r}, "
                    "needed is a number"
                ) from None
        return result

    def place(self, number: int) -> str:
        """Return how a message names a sample."""
        if len(self._lines):
            return f"{self._path}, line {self._lines[number]}"
        return f"{self._path}, sample {number + self._first}"


def read_table(path: Path, described: RecordingMap) -> Table:
    """Read the columns that a map names."""
    (table,) = table_parts(path, described, None)
    return table


def table_parts(
    path: Path, described: RecordingMap, count: int | None
) -> Iterator[Table]:
    """Read the columns that a map names, so many samples at a time."""
    wanted = [name for _, name in described.columns if name is not None]
    try:
        if described.table.format == "hdf5":
            yield from _whole_hdf5(path, wanted, count)
        else:
            yield from _csv(path, described, count)
    except OSError as error:
        raise FormatError(
            f"{path}: cannot be read ({error.strerror or error}); check name and format"
        ) from None
    except UnicodeDecodeError:
        raise FormatError(f"{path}: is no text; state table.format") from None


def _csv(path: Path, described: RecordingMap, count: int | None) -> Iterator[Table]:
    own = described.table
    wanted = [name for _, name in described.columns if name is not None]
    texts = {described.columns.polarization, described.columns.what}
    with path.open(encoding="utf-8-sig", newline="") as file:
        plain = map(_with_single_spaces, file) if own.delimiter == " " else file
        lines = itertools.islice(enumerate(plain, start=1), own.skip, None)
        names, first = _names(path, lines, own)
        _refuse_missing(path, wanted, names)
        places = {names.index(name): name for name in wanted}
        samples = _samples(path, itertools.chain(first, lines), own, len(names))
        begun = False
        while rows := list(itertools.islice(samples, count)):
            begun = True
            columns = _parsed("".join(line for _, line in rows), own, places, texts)
            yield Table(path, columns, [number for number, _ in rows])
    if not begun:
        raise FormatError(f"{path}: holds no sample below the names of its columns")


def _with_single_spaces(line: str) -> str:
    """Return a line with one space between columns and none at its ends."""
    return " ".join(filter(None, line.rstrip().split(" "))) + "\n"


def _names(
    path: Path, lines: Iterator[Line], own: TableSettings
) -> tuple[list[str], list[Line]]:
    """Return the names of the columns, and the first sample if it was read, too.

    They stand in a line of texts, or in the last comment before the first sample.
    """
    names: list[str] = []
    for number, line in lines:
        if line.isspace():
            continue
        cells = _cells(path, number, line, own)
        if own.comment and line.startswith(own.comment):
            names = [cells[0].lstrip(own.comment).strip(), *cells[1:]]
            if own.delimiter == " " and not names[0]:
                del names[0]  # the space behind the comment sign
        elif _is_number(cells[0], own.decimal):
            return names, [(number, line)]
        else:
            return cells, []
    return names, []


def _samples(
    path: Path, lines: Iterable[Line], own: TableSettings, columns: int
) -> Iterator[Line]:
    """Yield the lines that hold a sample; refuse those that lack columns."""
    for number, line in lines:
        if line.isspace() or (own.comment and line.startswith(own.comment)):
            continue
        # A delimiter between quotation marks separates nothing.
        if line.count(own.delimiter) + 1 < columns or '"' in line:
            cells = _cells(path, number, line, own)
            if len(cells) < columns:
                raise FormatError(
                    f"{path}, line {number}: has {len(cells)} columns, needed are "
                    f"{columns}; was the recording broken off?"
                )
        yield number, line


def _cells(path: Path, number: int, line: str, own: TableSettings) -> list[str]:
    rows = csv.reader(
        [line.strip("\r\n")],
        delimiter=own.delimiter,
        skipinitialspace=own.delimiter != " ",
        # Quotation marks in a comment may be those of prose.
        strict=not (own.comment and line.startswith(own.comment)),
    )
    try:
        (cells,) = rows
    except csv.Error as error:
        raise FormatError(
            f"{path}, line {number}: cannot be split into columns ({error}); close "
            "the quotation marks"
        ) from None
    return [cell.strip() for cell in cells]


def _parsed(
    content: str, own: TableSettings, places: dict[int, str], texts: set[str | None]
) -> dict[str, NDArray[Any]]:
    """Return columns by name: numbers, or cells as written where one is no number."""
    import pandas as pd

    read = partial(
        pd.read_csv, header=None, usecols=list(places), sep=own.delimiter,
        decimal=own.decimal, skipinitialspace=True, skip_blank_lines=False,
        keep_default_na=False,
    )  # fmt: skip
    numbers = [place for place, name in places.items() if name not in texts]
    try:
        table = read(
            io.StringIO(content),
            dtype={place: float if place in numbers else object for place in places},
            na_values={place: [""] for place in numbers},
        )
    except ValueError:
        table = read(io.StringIO(content), dtype=object)
    return {name: table[place].to_numpy() for place, name in places.items()}


def _is_number(text: str, decimal: str) -> bool:
    try:
        float(text.replace(decimal, "."))
    except ValueError:
        return False
    return True


def _whole_hdf5(path: Path, wanted: list[str], count: int | None) -> Iterator[Table]:
    load_hdf5()
    try:
        yield from _hdf5(path, wanted, count)
    except (FormatError, OSError):
        raise
    except Exception as error:  # h5py raises many kinds inside of a damaged file
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(
            f"{path}: is damaged, or no HDF5 file: {reason}; copy it again"
        ) from error


def _hdf5(path: Path, wanted: list[str], count: int | None) -> Iterator[Table]:
    import h5py

    with h5py.File(path, "r") as file:
        known: list[str] = []

        def note(name: str, thing: object) -> None:
            if isinstance(thing, h5py.Dataset):
                known.append(name)

        file.visititems(note)
        bare = [name.strip("/") for name in wanted]
        _refuse_missing(path, bare, known)
        places = dict(zip(wanted, bare, strict=True))
        sizes = {name: int(file[place].size) for name, place in places.items()}
        if len(set(sizes.values())) != 1 or 0 in sizes.values():
            listed = ", ".join(f"{name}: {size}" for name, size in sizes.items())
            raise FormatError(
                f"{path}: arrays differ in length, or are empty: {listed}"
            )
        (size,) = set(sizes.values())
        for begin in range(0, size, count or size):
            end = min(begin + (count or size), size)
            columns = {
                name: _flat(file[place], begin, end) for name, place in places.items()
            }
            yield Table(path, columns, first=begin)


def _flat(dataset: Any, begin: int, end: int) -> NDArray[Any]:
    """Return some values of an array, counted along its rows, texts decoded."""
    if dataset.ndim == 0:
        values = np.asarray(dataset[()]).ravel()
    else:
        # The axis along which whole slices are read is the first one with a length.
        axis = next((n for n, size in enumerate(dataset.shape) if size > 1), 0)
        inner = dataset.size // dataset.shape[axis]
        low = begin // inner
        head = (0,) * axis
        values = np.asarray(dataset[(*head, slice(low, -(-end // inner)))]).ravel()
        values = values[begin - low * inner : end - low * inner]
    if values.dtype.kind in "SO":
        values = np.array(
            [v.decode() if isinstance(v, bytes) else str(v) for v in values]
        )
    return values


def _refuse_missing(path: Path, wanted: list[str], there: list[str]) -> None:
    missing = [name for name in wanted if name not in there]
    if missing:
        listed = ", ".join(there[:30]) or "none"
        raise FormatError(
            f"{path}: has no column {missing[0]!r}; there are {listed}. Name them in "
            "[columns] of the map"
        )
