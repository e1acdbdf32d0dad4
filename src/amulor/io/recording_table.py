"""Columns of a recording that other software made: CSV or HDF5 as arrays by name."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import FormatError
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
    """

    def __init__(
        self, path: Path, columns: dict[str, NDArray[Any]], lines: Sequence[int] = ()
    ) -> None:
        self._path, self._columns, self._lines = path, columns, lines

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
        return f"{self._path}, sample {number}"


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
    wanted = [name for _, name in described.columns if name is not None]
    try:
        if described.table.format == "hdf5":
            return _whole_hdf5(path, wanted)
        return _csv(path, wanted, described.table)
    except OSError as error:
        raise FormatError(
            f"{path}: cannot be read ({error.strerror or error}); check name and format"
        ) from None
    except UnicodeDecodeError:
        raise FormatError(f"{path}: is no text; state table.format") from None


def _csv(path: Path, wanted: list[str], own: TableSettings) -> Table:
    with path.open(encoding="utf-8-sig", newline="") as file:
        names, rows = _rows(enumerate(file, start=1), own)
    _refuse_missing(path, wanted, names)
    places = [names.index(name) for name in wanted]
    if not rows:
        raise FormatError(f"{path}: holds no sample below the names of its columns")
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
    return Table(path, columns, [line for line, _ in rows])


def _rows(
    file: Iterable[tuple[int, str]], own: TableSettings
) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Return the names of the columns, and the cells of each line with its number."""
    names: list[str] = []
    comment: list[str] = []
    rows: list[tuple[int, list[str]]] = []
    for line, text in file:
        if line <= own.skip or not text.strip():
            continue
        (cells,) = csv.reader([text.strip("\r\n")], delimiter=own.delimiter)
        cells = [cell.strip() for cell in cells]
        if own.comment and text.startswith(own.comment):
            cells[0] = cells[0].lstrip(own.comment).strip()
            comment = cells if not rows else comment
        elif not names and not _is_number(cells[0], own.decimal):
            names = cells
        else:
            rows.append((line, cells))
    return names or comment, rows


def _is_number(text: str, decimal: str) -> bool:
    try:
        float(text.replace(decimal, "."))
    except ValueError:
        return False
    return True


def _whole_hdf5(path: Path, wanted: list[str]) -> Table:
    try:
        return _hdf5(path, wanted)
    except (FormatError, OSError):
        raise
    except Exception as error:  # h5py raises many kinds inside of a damaged file
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(
            f"{path}: is damaged, or no HDF5 file: {reason}; copy it again"
        ) from error


def _hdf5(path: Path, wanted: list[str]) -> Table:
    import h5py

    with h5py.File(path, "r") as file:
        known: list[str] = []

        def note(name: str, thing: object) -> None:
            if isinstance(thing, h5py.Dataset):
                known.append(name)

        file.visititems(note)
        bare = [name.strip("/") for name in wanted]
        _refuse_missing(path, bare, known)
        columns = {
            name: np.asarray(file[place][()]).ravel()
            for name, place in zip(wanted, bare, strict=True)
        }
    for name, values in columns.items():
        if values.dtype.kind in "SO":
            columns[name] = np.array(
                [v.decode() if isinstance(v, bytes) else str(v) for v in values]
            )
    sizes = {name: len(values) for name, values in columns.items()}
    if len(set(sizes.values())) != 1 or 0 in sizes.values():
        listed = ", ".join(f"{name}: {size}" for name, size in sizes.items())
        raise FormatError(f"{path}: arrays differ in length, or are empty: {listed}")
    return Table(path, columns)


def _refuse_missing(path: Path, wanted: list[str], there: list[str]) -> None:
    missing = [name for name in wanted if name not in there]
    if missing:
        listed = ", ".join(there[:30]) or "none"
        raise FormatError(
            f"{path}: has no column {missing[0]!r}; there are {listed}. Name them in "
            "[columns] of the map"
        )
