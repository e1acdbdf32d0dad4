"""Columns of a recording that other software made: CSV or HDF5 as arrays by name."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import FormatError
from amulor.io.files import load_hdf5
from amulor.io.recording_map import RecordingMap, TableSettings

Texts = NDArray[np.str_]
Floats = NDArray[np.float64]


class Table:
    """Columns by name, all of one length.

    Parameters
    ----------
    path : pathlib.Path
        Where they come from, for messages.
    columns : dict
        Name to array of one dimension.
    lines : sequence of int
        Line of the file that each sample stands in; empty where there are none.
    first : int
        Samples of the file before the first one.
    """

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
        """Return a column as numbers, not a number where it is empty.

        Raises
        ------
        FormatError
            If something else stands in it.
        """
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
    """Read the columns that a map names.

    Parameters
    ----------
    path : pathlib.Path
        CSV or HDF5.
    described : RecordingMap
        Its columns are read, no others.

    Returns
    -------
    Table
        With at least one sample.

    Raises
    ------
    FormatError
        If the file cannot be read, a column is missing, or they differ in length.
    """
    (table,) = table_parts(path, described, None)
    return table


def table_parts(
    path: Path, described: RecordingMap, count: int | None
) -> Iterator[Table]:
    """Read the columns that a map names, so many samples at a time.

    Parameters
    ----------
    path, described
        As in `read_table`.
    count : int or None
        Most samples of a part; None for all in one.

    Yields
    ------
    Table
        At least one, and at least one sample each.

    Raises
    ------
    FormatError
        As `read_table`, when the part is reached.
    """
    wanted = [name for _, name in described.columns if name is not None]
    try:
        if described.table.format == "hdf5":
            yield from _whole_hdf5(path, wanted, count)
        else:
            yield from _csv(path, wanted, described.table, count)
    except OSError as error:
        raise FormatError(
            f"{path}: cannot be read ({error.strerror or error}); check name and format"
        ) from None
    except UnicodeDecodeError:
        raise FormatError(f"{path}: is no text; state table.format") from None


def _csv(
    path: Path, wanted: list[str], own: TableSettings, count: int | None
) -> Iterator[Table]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        names = _names(file, own)
    _refuse_missing(path, wanted, names)
    places = [names.index(name) for name in wanted]
    with path.open(encoding="utf-8-sig", newline="") as file:
        samples = _samples(file, own)
        begun = False
        while rows := list(itertools.islice(samples, count)):
            begun = True
            for line, row in rows:
                if len(row) < len(names):
                    raise FormatError(
                        f"{path}, line {line}: has {len(row)} columns, needed are "
                        f"{len(names)}; was the recording broken off?"
                    )
            columns = {
                name: np.array([row[place] for _, row in rows])
                for name, place in zip(wanted, places, strict=True)
            }
            yield Table(path, columns, [line for line, _ in rows])
    if not begun:
        raise FormatError(f"{path}: holds no sample below the names of its columns")


def _cells(
    file: Iterable[str], own: TableSettings
) -> Iterator[tuple[int, list[str], bool]]:
    """Yield number and cells of each line, and whether it is a comment."""
    for line, text in enumerate(file, start=1):
        if line <= own.skip or not text.strip():
            continue
        (cells,) = csv.reader([text.strip("\r\n")], delimiter=own.delimiter)
        cells = [cell.strip() for cell in cells]
        remark = bool(own.comment) and text.startswith(own.comment)
        if remark:
            cells[0] = cells[0].lstrip(own.comment).strip()
        yield line, cells, remark


def _names(file: Iterable[str], own: TableSettings) -> list[str]:
    """Return the names of the columns: a line of texts, or the last comment above."""
    comment: list[str] = []
    begun = False
    for _, cells, remark in _cells(file, own):
        if remark:
            comment = comment if begun else cells
        elif not _is_number(cells[0], own.decimal):
            return cells
        else:
            begun = True
    return comment


def _samples(
    file: Iterable[str], own: TableSettings
) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each line with a sample."""
    named = False
    for line, cells, remark in _cells(file, own):
        if remark:
            continue
        if not named and not _is_number(cells[0], own.decimal):
            named = True
        else:
            yield line, cells


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
