"""Table of recorded samples in CSV or HDF5, and the map of columns to quantities."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, StringConstraints, model_validator

from amulor._hdf5 import check_heaps_of, check_size
from amulor.errors import FormatError
from amulor.io.files import load_hdf5
from amulor.survey import toml_file
from amulor.survey.quantity import Description, Frequency, Voltage

Texts = NDArray[np.str_]
Floats = NDArray[np.float64]
Line = tuple[int, str]
Column = Annotated[str, Field(min_length=1, max_length=500)]
#: Radians per unit of an angle.
ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": 0.017453292519943295}


class TableSettings(Description):
    """File format of the table of a recording."""

    format: Literal["csv", "hdf5"] = "csv"
    """Format of the file. "csv": a line of names and a line per sample; "hdf5": an
    array per column, of one or two dimensions."""
    delimiter: Annotated[
        str, StringConstraints(strip_whitespace=False, min_length=1, max_length=1)
    ] = ","
    """Column separator: ";" for LabOne, "\\t" for a tab, " " for one or more spaces."""
    comment: Annotated[str, Field(max_length=1)] = "#"
    """Start of a line without data; "%" for LabOne. The last comment before the data
    names the columns if no other line does."""
    skip: Annotated[int, Field(ge=0, le=10**9)] = 0
    """Number of lines before the line of column names [1]."""
    decimal: Literal[".", ","] = "."
    """Decimal separator."""

    @model_validator(mode="after")
    def _columns_can_be_told_apart(self) -> Self:
        if self.delimiter in ('"', "\r", "\n"):
            raise ValueError(
                f"delimiter {self.delimiter!r} ends a text or a line; state what "
                'separates columns, such as ",", ";", "\\t" or " "'
            )
        return self


class ColumnSettings(Description):
    """Column name of each quantity; for "hdf5" the path of its array."""

    in_phase: Column | None = None
    """In-phase output X of the lock-in amplifier."""
    quadrature: Column | None = None
    """Quadrature output Y of the lock-in amplifier."""
    amplitude: Column | None = None
    """Amplitude R of the lock-in amplifier, instead of X and Y."""
    phase: Column | None = None
    """Phase theta of the lock-in amplifier, instead of X and Y."""
    phases: tuple[Annotated[tuple[Column, ...], Field(min_length=3)], ...] | None = None
    """Raw frames of a time-of-flight camera, instead of X and Y: for each modulation
    frequency a list of three or more columns, one for each phase of the reference."""
    frequency: Column | None = None
    """Modulation frequency of each sample [Hz]."""
    polarization: Column | None = None
    """Launched and analyzed polarization of each sample, such as VH."""
    azimuth: Column | None = None
    """Azimuth of the beam, positive to the right."""
    elevation: Column | None = None
    """Elevation of the beam, positive upwards."""
    row: Column | None = None
    """Row of the scan, counted from 0 on top."""
    column: Column | None = None
    """Column of the scan, counted from 0 at the left."""
    mean: Column | None = None
    """Mean output of the detector [V]."""
    temperature: Column | None = None
    """Temperature of the water [degC]."""
    what: Column | None = None
    """Kind of each sample, target or open water: see `constants.open_water`."""

    @property
    def texts(self) -> set[str]:
        """Names of the columns that hold text."""
        return {name for name in (self.polarization, self.what) if name is not None}

    @model_validator(mode="after")
    def _a_signal_and_a_place_are_stated(self) -> Self:
        pairs = [
            ("in_phase", "quadrature"),
            ("amplitude", "phase"),
            ("azimuth", "elevation"),
            ("row", "column"),
        ]
        for first, second in pairs:
            if (getattr(self, first) is None) != (getattr(self, second) is None):
                raise ValueError(f"{first} and {second} belong together; state both")
        signals = (self.in_phase, self.amplitude, self.phases)
        if sum(signal is not None for signal in signals) != 1:
            raise ValueError(
                "needed are in_phase and quadrature, or amplitude and phase, or phases"
            )
        if self.phases is not None and self.frequency is not None:
            raise ValueError(
                "columns.phases has a list for each frequency, so columns.frequency is "
                "too much; state constants.frequencies"
            )
        return self


class ConstantSettings(Description):
    """Constants that apply to all samples."""

    frequency: Annotated[Frequency, Field(gt=0)] | None = None
    """Modulation frequency if no column has it [Hz]."""
    polarization: str | None = None
    """Launched and analyzed polarization if no column has it."""
    scale: Annotated[float, Field(gt=0)] = 1.0
    """Volts per unit of the output columns [V]."""
    root_mean_square: bool = True
    """Whether voltages are rms values, as of most lock-in amplifiers; otherwise they
    are peak values."""
    phase_falls_with_delay: bool = True
    """Whether a larger delay gives a smaller phase, as with lock-in amplifiers."""
    frequencies: tuple[Annotated[Frequency, Field(gt=0)], ...] | None = None
    """Modulation frequencies of the lists of `columns.phases` [Hz]."""
    phase_steps: tuple[Annotated[float, Field(allow_inf_nan=False)], ...] | None = None
    """Phase of the reference in each column of a list of `columns.phases`, in
    `phase_unit`; by default evenly spread over a turn, such as 0, 90, 180 and 270
    degrees. A delay acts as a larger phase; state negative steps if it does not."""
    phase_unit: Literal["rad", "mrad", "deg"] = "deg"
    """Unit of the column `phase`, and of `phase_steps`."""
    angle_unit: Literal["rad", "mrad", "deg"] = "deg"
    """Unit of the columns `azimuth` and `elevation`."""
    uncertainty: Annotated[Voltage, Field(gt=0)] | None = None
    """Standard uncertainty of either output, as a peak amplitude; by default from
    counting noise and the phase floor of the survey [V]."""
    open_water: str = "open_water"
    """Entry of the column `what` for open-water shots; all other samples are of the
    target."""

    def radians(self, unit: str) -> float:
        """Factor that converts a unit of angle to radians [rad]."""
        return ANGLES[unit]


class RecordingMap(Description):
    """Assignment of the columns of a recording to quantities."""

    table: TableSettings = TableSettings()
    """File format of the table."""
    columns: ColumnSettings
    """Names of columns."""
    constants: ConstantSettings = ConstantSettings()
    """Constants of all samples."""

    @model_validator(mode="after")
    def _channels_are_stated(self) -> Self:
        for name in ("frequency", "polarization"):
            column, constant = (
                getattr(self.columns, name),
                getattr(self.constants, name),
            )
            if column is not None and constant is not None:
                raise ValueError(
                    f"columns.{name} and constants.{name} say it twice; keep one"
                )
        return self

    @model_validator(mode="after")
    def _frames_are_described(self) -> Self:
        phases, steps = self.columns.phases, self.constants.phase_steps
        frequencies = self.constants.frequencies
        if phases is None:
            return self
        if frequencies is None or len(frequencies) != len(phases):
            raise ValueError(
                f"columns.phases has {len(phases)} lists; state as many "
                "constants.frequencies"
            )
        counts = {len(names) for names in phases}
        if steps is not None and counts != {len(steps)}:
            raise ValueError(
                f"constants.phase_steps has {len(steps)} phases, but the lists of "
                f"columns.phases have {', '.join(map(str, sorted(counts)))}"
            )
        return self

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a map of columns from a TOML file."""
        return toml_file.read(path, cls, what="a column map", error=FormatError)


class Table:
    """Columns of a recording by name, all of equal length."""

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
        """Entries of a column as text."""
        return np.char.strip(self._columns[name].astype(str))

    def numbers(self, name: str, *, decimal: str = ".") -> Floats:
        """Entries of a column as numbers; NaN for empty cells."""
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
        """Location of a sample in the file as text, for messages."""
        if len(self._lines):
            return f"{self._path}, line {self._lines[number]}"
        return f"{self._path}, sample {number + self._first}"


class Columns(Protocol):
    """Interface of the assignment of columns to quantities."""

    @property
    def texts(self) -> set[str]:
        """Names of the columns that hold text."""
        ...

    def __iter__(self) -> Iterator[tuple[str, Any]]:
        """Yield each quantity with the name of its column, or None."""
        ...


class ColumnMap(Protocol):
    """Interface of a map of columns: file format, and the column of each quantity."""

    @property
    def table(self) -> TableSettings:
        """File format of the table."""
        ...

    @property
    def columns(self) -> Columns:
        """Names of columns."""
        ...


def _assigned(columns: Columns) -> list[str]:
    """Names of all columns of a map, each once."""
    names: list[str] = []
    for _, value in columns:
        lists = value if isinstance(value, tuple) else ((value,),)
        names += [name for some in lists for name in some if name is not None]
    return list(dict.fromkeys(names))


def read_table(path: Path, described: ColumnMap) -> Table:
    """Read the columns of a recording to which its map assigns quantities."""
    (table,) = table_parts(path, described, None)
    return table


def table_parts(path: Path, described: ColumnMap, count: int | None) -> Iterator[Table]:
    """Read the mapped columns of a recording, in blocks of a number of samples."""
    names = _assigned(described.columns)
    try:
        if described.table.format == "hdf5":
            yield from _whole_hdf5(path, names, count)
        else:
            yield from _csv(path, described, count)
    except OSError as error:
        raise FormatError(
            f"{path}: cannot be read ({error.strerror or error}); check name and format"
        ) from None
    except UnicodeDecodeError:
        raise FormatError(f"{path}: is no text; state table.format") from None


def _csv(path: Path, described: ColumnMap, count: int | None) -> Iterator[Table]:
    settings = described.table
    needed = _assigned(described.columns)
    texts = described.columns.texts
    with path.open(encoding="utf-8-sig", newline="") as file:
        plain = map(_with_single_spaces, file) if settings.delimiter == " " else file
        lines = itertools.islice(enumerate(plain, start=1), settings.skip, None)
        names, first = _names(path, lines, settings)
        _refuse_missing(path, needed, names)
        places = {names.index(name): name for name in needed}
        samples = _samples(path, itertools.chain(first, lines), settings, len(names))
        begun = False
        while rows := list(itertools.islice(samples, count)):
            begun = True
            columns = _parsed(
                "".join(line for _, line in rows), settings, places, texts
            )
            yield Table(path, columns, [number for number, _ in rows])
    if not begun:
        raise FormatError(f"{path}: holds no sample below the names of its columns")


def _with_single_spaces(line: str) -> str:
    """Line with single spaces between its columns and none at the ends."""
    return " ".join(filter(None, line.rstrip().split(" "))) + "\n"


def _names(
    path: Path, lines: Iterator[Line], settings: TableSettings
) -> tuple[list[str], list[Line]]:
    """Column names, and the first sample's line if it was read to find the names.

    Names are in a line of texts, or in the last comment before the first sample.
    """
    names: list[str] = []
    for number, line in lines:
        if line.isspace():
            continue
        cells = _cells(path, number, line, settings)
        if settings.comment and line.startswith(settings.comment):
            names = [cells[0].lstrip(settings.comment).strip(), *cells[1:]]
            if settings.delimiter == " " and not names[0]:
                del names[0]  # the space behind the comment sign
        elif _is_number(cells[0], settings.decimal):
            return names, [(number, line)]
        else:
            return cells, []
    return names, []


def _samples(
    path: Path, lines: Iterable[Line], settings: TableSettings, columns: int
) -> Iterator[Line]:
    """Yield the lines of samples; raise at lines with too few columns."""
    for number, line in lines:
        if line.isspace() or (settings.comment and line.startswith(settings.comment)):
            continue
        # A delimiter between quotation marks separates nothing.
        if line.count(settings.delimiter) + 1 < columns or '"' in line:
            cells = _cells(path, number, line, settings)
            if len(cells) < columns:
                raise FormatError(
                    f"{path}, line {number}: has {len(cells)} columns, needed are "
                    f"{columns}; was the recording broken off?"
                )
        yield number, line


def _cells(path: Path, number: int, line: str, settings: TableSettings) -> list[str]:
    rows = csv.reader(
        [line.strip("\r\n")],
        delimiter=settings.delimiter,
        skipinitialspace=settings.delimiter != " ",
        # Quotation marks in a comment may be those of prose.
        strict=not (settings.comment and line.startswith(settings.comment)),
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
    content: str,
    settings: TableSettings,
    places: dict[int, str],
    texts: set[str],
) -> dict[str, NDArray[Any]]:
    """Columns by name: numbers, or all as text if a cell is not a number."""
    import pandas as pd

    read = partial(
        pd.read_csv, header=None, usecols=list(places), sep=settings.delimiter,
        decimal=settings.decimal, skipinitialspace=True, skip_blank_lines=False,
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


def _whole_hdf5(path: Path, names: list[str], count: int | None) -> Iterator[Table]:
    load_hdf5()
    try:
        check_heaps_of(path)
        yield from _hdf5(path, names, count)
    except (FormatError, OSError):
        raise
    except Exception as error:  # h5py raises many kinds inside of a damaged file
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(
            f"{path}: is damaged, or no HDF5 file: {reason}; copy it again"
        ) from error


def _hdf5(path: Path, names: list[str], count: int | None) -> Iterator[Table]:
    import h5py

    with h5py.File(path, "r") as file:
        check_size(file, path)
        datasets: list[str] = []

        def note(name: str, node: object) -> None:
            if isinstance(node, h5py.Dataset):
                datasets.append(name)

        file.visititems(note)
        bare = [name.strip("/") for name in names]
        _refuse_missing(path, bare, datasets)
        places = dict(zip(names, bare, strict=True))
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
    """Elements of a flattened array from `begin` to before `end`, texts decoded."""
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


def _refuse_missing(path: Path, names: list[str], present: list[str]) -> None:
    missing = [name for name in names if name not in present]
    if missing:
        listed = ", ".join(present[:30]) or "none"
        raise FormatError(
            f"{path}: has no column {missing[0]!r}; there are {listed}. Name them in "
            "[columns] of the map"
        )
