"""Whether a row of a journal is what was written: its checksum, types and ranges."""

from __future__ import annotations

import functools
import math
import struct
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

from amulor.acquisition.journal.record import OPTIONAL, QUANTITIES, WHOLE, Record
from amulor.acquisition.plan import DARK, OPEN_WATER, SCAN, Key
from amulor.errors import FormatError
from amulor.survey import Survey

#: The column of the checksum.
CHECKSUM = "crc"
_TEXTS = ("kind", "polarization")
_WHOLE = WHOLE | {"row", "column", "repeat"}
#: Smallest and largest value of each number of a row, both included.
_RANGES: dict[str, tuple[float, float]] = {
    "row": (0, 20_000),
    "column": (0, 20_000),
    "frequency": (1e-6, 1e15),
    "repeat": (0, 2**62),
    **{name: quantity.within for name, quantity in QUANTITIES.items()},
}


@functools.lru_cache(maxsize=256)
def _pattern(
    names: tuple[str, ...], kinds: tuple[type, ...]
) -> tuple[int, struct.Struct, list[int], list[int]]:
    """Return the checksum of the names of numbers, what packs them, and places."""
    texts = [place for place, kind in enumerate(kinds) if kind is str]
    numbers = [
        place for place, kind in enumerate(kinds) if kind not in (str, type(None))
    ]
    start = zlib.crc32("\0".join([names[place] for place in numbers]).encode())
    return start, struct.Struct(f"<{len(numbers)}d"), numbers, texts


def checksum(names: Sequence[str], values: Sequence[Any]) -> int:
    """Return the CRC-32 of a row.

    Parameters
    ----------
    names : sequence of str
        Columns, without number and checksum.
    values : sequence
        Texts, numbers, and None for what is not there; in the same order.

    Returns
    -------
    int
        Of the names and values of what is there, so that columns that another version
        has beside them change nothing. Not a number counts as not there, and -0 as 0:
        so they come back from the journal.
    """
    kinds = tuple(map(type, values))
    start, packed, numbers, texts = _pattern(tuple(names), kinds)
    found = [values[place] + 0.0 for place in numbers]
    if math.isnan(sum(found)):
        there = [None if value != value else value for value in values]
        if there != [*values]:  # not the difference of two infinite ones
            return checksum(names, there)
    after = zlib.crc32(packed.pack(*found), start)
    text = "\0".join([f"{values[place]}\0{names[place]}" for place in texts])
    return zlib.crc32(text.encode("utf-8", "replace"), after)


def refuse_infinite(key: Key, record: Record) -> None:
    """Raise if something infinite is to be written, which no instrument measures."""
    for name, value in (*key._asdict().items(), *vars(record).items()):
        if value in (math.inf, -math.inf):
            raise FormatError(
                f"sample {tuple(key)}: {name} is infinite; look at what the instrument "
                "answers. Nothing was written"
            )


class RowCheck:
    """Says what is wrong with rows of one journal.

    Parameters
    ----------
    survey : Survey or None
        Of the scan, None where the journal has none.
    columns : sequence of str
        Of the table, without number and checksum.
    """

    def __init__(self, survey: Survey | None, columns: Sequence[str]) -> None:
        self._columns = tuple(columns)
        self._frequencies: tuple[float, ...] | None = None
        self._pairs: tuple[str, ...] = ()
        self._grids: dict[str, tuple[int, int]] = {DARK: (1, 1)}
        if survey is not None:
            plan = survey.scan.open_water
            self._frequencies = tuple(survey.instrument.modulation_frequencies)
            self._pairs = tuple(survey.instrument.polarizations)
            self._grids[SCAN] = (survey.scan.rows, survey.scan.columns)
            self._grids[OPEN_WATER] = (
                (0, 0) if plan is None else (plan.rows, plan.columns)
            )

    def wrong_with(self, values: Sequence[Any], stored: Any) -> str | None:
        """Describe the damage of a row with a stored checksum; None if it is sound."""
        row = dict(zip(self._columns, values, strict=True))
        wrong = (
            self._wrong_type(row) or self._wrong_value(row) or self._not_planned(row)
        )
        if wrong is not None:
            return wrong
        if stored != checksum(self._columns, values):
            return "its checksum is that of other numbers"
        return None

    def _wrong_type(self, row: Mapping[str, Any]) -> str | None:
        for name, value in row.items():
            if name in _TEXTS:
                if not isinstance(value, str) or "\ufffd" in value:
                    return f"{name} is no readable text"
            elif value is None:
                if name in _RANGES and name not in OPTIONAL:
                    return f"{name} is missing"
            elif type(value) not in (int, float):
                return f"{name} is no number"
            elif name in _WHOLE and type(value) is not int:
                return f"{name} = {value:.6g} is no whole number"
        return None

    def _wrong_value(self, row: Mapping[str, Any]) -> str | None:
        for name, value in row.items():
            if name in _RANGES and value is not None:
                low, high = _RANGES[name]
                if not low <= value <= high:
                    return f"{name} = {value:.6g} is not within {low:.6g} to {high:.6g}"
            elif isinstance(value, float) and not math.isfinite(value):
                return f"{name} is infinite"
        return None

    def _not_planned(self, row: Mapping[str, Any]) -> str | None:
        if row["kind"] not in (SCAN, OPEN_WATER, DARK):
            return f"there is no kind of sample {row['kind']!r}"
        if self._frequencies is None:
            return None
        rows, columns = self._grids[row["kind"]]
        if not (row["row"] < rows and row["column"] < columns):
            return (
                f"row = {row['row']}, column = {row['column']} of {row['kind']}: the "
                f"survey has {rows} rows and {columns} columns of it"
            )
        if row["frequency"] not in self._frequencies:
            return f"the survey has no frequency of {row['frequency']:.9g} Hz"
        if row["polarization"] not in self._pairs:
            return f"the survey has no polarization {row['polarization']!r}"
        return None
