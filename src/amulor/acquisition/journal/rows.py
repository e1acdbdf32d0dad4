"""Rows of a journal: columns, and checks of checksum, type and range."""

from __future__ import annotations

import contextlib
import functools
import json
import math
import operator
import sqlite3
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from amulor.acquisition.journal.record import OPTIONAL, QUANTITIES, WHOLE, Record
from amulor.acquisition.plan import DARK, OPEN_WATER, REFERENCE, SCAN, SHUTTER, Key
from amulor.errors import FormatError, InstrumentError, SurveyError
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
    """Return a row's layout: CRC of names, format, indices of numbers and of texts."""
    texts = [place for place, kind in enumerate(kinds) if kind is str]
    numbers = [
        place for place, kind in enumerate(kinds) if kind not in (str, type(None))
    ]
    start = zlib.crc32("\0".join([names[place] for place in numbers]).encode())
    return start, struct.Struct(f"<{len(numbers)}d"), numbers, texts


def checksum(names: Sequence[str], values: Sequence[Any]) -> int:
    """Return the CRC-32 of the names and values of a row."""
    kinds = tuple(map(type, values))
    start, packed, numbers, texts = _pattern(tuple(names), kinds)
    floats = [values[place] + 0.0 for place in numbers]
    if math.isnan(sum(floats)):
        nulled = [None if value != value else value for value in values]
        if nulled != [*values]:  # not the difference of two infinite ones
            return checksum(names, nulled)
    after = zlib.crc32(packed.pack(*floats), start)
    text = "\0".join([f"{values[place]}\0{names[place]}" for place in texts])
    return zlib.crc32(text.encode("utf-8", "replace"), after)


def refuse_impossible(key: Key, record: Record) -> None:
    """Raise if a quantity of a sample is infinite, or a required one is missing."""
    for name, value in (*key._asdict().items(), *vars(record).items()):
        if value in (math.inf, -math.inf):
            problem = "infinite"
        elif (value is None or value != value) and name not in OPTIONAL:
            problem = "not a number"
        else:
            continue
        raise FormatError(
            f"sample {tuple(key)}: {name} is {problem}; look at what the instrument "
            "answers. Nothing was written"
        )


class RowCheck:
    """Check of a journal's rows: checksum, type and range of each quantity."""

    def __init__(self, survey: Survey | None, columns: Sequence[str]) -> None:
        self._columns = tuple(columns)
        self._frequencies: tuple[float, ...] | None = None
        self._pairs: tuple[str, ...] = ()
        self._grids: dict[str, tuple[int, int]] = {DARK: (1, 1), SHUTTER: (1, 1)}
        if survey is not None:
            plan = survey.scan.open_water
            self._frequencies = tuple(survey.instrument.modulation_frequencies)
            self._pairs = tuple(survey.instrument.polarizations)
            self._grids[SCAN] = (survey.scan.rows, survey.scan.columns)
            # Rows before which it is read, and any number of rounds of shots.
            self._grids[REFERENCE] = (
                (0, 0) if survey.scan.reference is None else (2**31, 2)
            )
            self._grids[OPEN_WATER] = (
                (0, 0) if plan is None else (plan.rows, plan.columns)
            )

    def wrong_with(self, values: Sequence[Any], stored: Any) -> str | None:
        """Describe the damage to a row; None if the row is intact."""
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
        if row["kind"] not in (SCAN, OPEN_WATER, DARK, SHUTTER, REFERENCE):
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


#: Version of the schema; increased when an older amulor must not write to a journal.
SCHEMA_VERSION = "2"

_KEY_COLUMNS = (
    "kind TEXT NOT NULL, row INTEGER NOT NULL, column INTEGER NOT NULL, "
    "frequency REAL NOT NULL, polarization TEXT NOT NULL, repeat INTEGER NOT NULL"
)
KEY_NAMES = ", ".join(Key._fields)
RECORD_FIELDS = tuple(QUANTITIES)
_RECORD_NAMES = ", ".join(RECORD_FIELDS)


def _column(name: str) -> str:
    """Return the SQL declaration of the column of a recorded quantity."""
    kind = "INTEGER" if name in WHOLE else "REAL"
    return f"{name} {kind}" + ("" if name in OPTIONAL else " NOT NULL")


_RECORD_COLUMNS = ", ".join(map(_column, RECORD_FIELDS))
_VALUES = operator.attrgetter(*RECORD_FIELDS)
_NAMES = (*Key._fields, *RECORD_FIELDS)
_PLACES = ", ".join("?" * (len(_NAMES) + 1))
INSERT = (
    f"INSERT INTO samples ({KEY_NAMES}, {_RECORD_NAMES}, {CHECKSUM}) VALUES ({_PLACES})"
)
#: Messages of the vehicle's navigation, which older journals lack.
NAVIGATION = (
    "CREATE TABLE IF NOT EXISTS navigation (number INTEGER PRIMARY KEY, "
    f"elapsed REAL NOT NULL, line TEXT NOT NULL, {CHECKSUM} INTEGER NOT NULL)"
)
#: A journal is append-only: samples are inserted, never changed, never deleted.
TABLES = (
    "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT)",
    f"CREATE TABLE samples (number INTEGER PRIMARY KEY, {_KEY_COLUMNS}, "
    f"{_RECORD_COLUMNS}, {CHECKSUM} INTEGER, UNIQUE ({KEY_NAMES}))",
    "CREATE TABLE segments (number INTEGER PRIMARY KEY, started TEXT, ended TEXT, "
    "reason TEXT)",
    NAVIGATION,
)

_MESSAGE = ("elapsed", "line")
INSERT_MESSAGE = f"INSERT INTO navigation (elapsed, line, {CHECKSUM}) VALUES (?, ?, ?)"


def message_row(elapsed: float, line: str) -> tuple[Any, ...]:
    """Return the values of a navigation message for `INSERT_MESSAGE`."""
    if not math.isfinite(elapsed):
        raise FormatError(f"navigation: the arrival of {line[:40]!r} is {elapsed:g} s")
    return elapsed, line, checksum(_MESSAGE, (elapsed, line))


def wrong_with_message(elapsed: Any, line: Any, stored: Any) -> str | None:
    """Describe the damage to a navigation message; None if it is intact."""
    if not isinstance(elapsed, float) or not isinstance(line, str):
        return "no time and line of text"
    if stored != checksum(_MESSAGE, (elapsed, line)):
        return "its checksum is that of another message"
    return None


def row_of(key: Key, record: Record) -> tuple[Any, ...]:
    """Return the values of a sample for the SQL statement `INSERT`."""
    values = (*key, *_VALUES(record))
    if math.inf in values or -math.inf in values or any(v != v for v in values):
        refuse_impossible(key, record)
    return (*values, checksum(_NAMES, values))


def refuse_another(
    folder: Path, path: Path, result: Mapping[str, str], meta: Mapping[str, str]
) -> None:
    """Raise if the journal has another schema version, survey or instrument."""
    version = result.get("journal_schema")
    if version != SCHEMA_VERSION:
        raise FormatError(
            f"{path}: the journal has schema {version!r}, this amulor knows "
            f"{SCHEMA_VERSION!r}; use the amulor that began the scan"
        )
    expected = {"survey_digest": "", "instrument_digest": "", **result, **meta}
    if result.get("survey_digest", "") != expected["survey_digest"]:
        raise SurveyError(
            f"{folder} holds a scan of another survey "
            f"({result['survey_digest'][:15]}..., now "
            f"{meta['survey_digest'][:15]}...); go on with the survey.toml in that "
            "folder, or name a new folder"
        )
    if result.get("instrument_digest", "") != expected["instrument_digest"]:
        changes = _differences(result["identities"], meta["identities"])
        raise InstrumentError(
            f"{folder} holds a scan by other devices or another procedure: "
            f"{changes}; go on with the devices.toml in that folder, or name a new "
            "folder"
        )


def _differences(before: str, now: str) -> str:
    """Describe the devices whose identity changed since the scan began."""
    old, new = json.loads(before), json.loads(now)
    changed = [
        f"{name} was {old.get(name, 'not there')}, is {new.get(name, 'not there')}"
        for name in dict.fromkeys([*old, *new])
        if old.get(name) != new.get(name)
    ]
    return "; ".join(changed) or "each device is the same, what it is told is not"


#: Rows tried behind an unreadable page if their number is unknown.
SEARCHED = 100_000


def columns_of(connection: sqlite3.Connection) -> list[str]:
    """Return the column names of the table of samples."""
    rows = connection.execute("PRAGMA table_info(samples)")
    columns = [str(name) for _, name, *_ in rows]
    required = {"number", CHECKSUM, *Key._fields}
    required |= {name for name in RECORD_FIELDS if name not in OPTIONAL}
    if missing := sorted(required - {*columns}):
        _, _, path = next(iter(connection.execute("PRAGMA database_list")))
        lacking = f"the columns {', '.join(missing)} of" if columns else "the table of"
        raise FormatError(
            f"{path} lacks {lacking} its samples; it is damaged, take a copy of the "
            "folder before anything else"
        )
    return columns


class Rows:
    """Reader of a journal's rows, which checks each row."""

    def __init__(
        self, connection: sqlite3.Connection, damaged: Callable[[str], None]
    ) -> None:
        self._connection, self._damaged = connection, damaged
        #: Check of rows, with its survey and columns.
        self._check: tuple[str | None, list[str], RowCheck] | None = None

    def sound(
        self, entries: Mapping[str, str], condition: str, value: object
    ) -> Iterator[tuple[int, Key, Record]]:
        """Yield number, key and record of the undamaged rows."""
        columns, check = self._row_check(entries)
        places = {name: place for place, name in enumerate(columns)}
        keys = [places[name] for name in Key._fields]
        recorded = [(name, places[name]) for name in RECORD_FIELDS if name in places]
        for number, values, wrong in self._judged(
            entries, columns, check, condition, value
        ):
            if wrong is None:
                content = {name: values[place] for name, place in recorded}
                key = Key(*(values[place] for place in keys))
                yield number, key, Record(**content)

    def look_through(self, entries: Mapping[str, str]) -> None:
        """Check every row, and report damaged and missing ones."""
        columns, check = self._row_check(entries)
        unread: set[int] = set()
        before = 0

        def name_missing(end: int) -> None:
            # Rows are never deleted, so their numbers have no gaps.
            for absent in range(before + 1, min(end, before + SEARCHED)):
                if absent not in unread:
                    self._damaged(f"row {absent}: not there")

        # Another program may add rows from here on.
        count = self._count()
        for number, *_ in self._judged(
            entries, columns, check, "number > ?", 0, unread=unread
        ):
            if number <= before:
                self._damaged(f"row {number}: out of order, after row {before}")
                continue
            name_missing(number)
            before = number
        name_missing(count + 1)

    def _count(self) -> int:
        """Return the number of rows by the index of their keys; 0 if it is damaged."""
        with contextlib.suppress(sqlite3.DatabaseError):
            ((count,),) = self._connection.execute("SELECT COUNT(*) FROM samples")
            return int(count)
        return 0

    def _row_check(self, entries: Mapping[str, str]) -> tuple[list[str], RowCheck]:
        text = entries.get("survey")
        if self._check is None or self._check[0] != text:
            all_columns = columns_of(self._connection)
            columns = [name for name in all_columns if name not in ("number", CHECKSUM)]
            survey = None
            if text is not None:
                survey = Survey.from_text(text, name="the survey of the journal")
            self._check = (text, all_columns, RowCheck(survey, columns))
        _, all_columns, check = self._check
        return [name for name in all_columns if name not in ("number", CHECKSUM)], check

    def _judged(
        self,
        entries: Mapping[str, str],
        columns: list[str],
        check: RowCheck,
        condition: str,
        value: object,
        *,
        unread: set[int] | None = None,
    ) -> Iterator[tuple[int, list[Any], str | None]]:
        """Yield number, values and damage of each row; damage is None if intact."""
        names = ", ".join(["number", CHECKSUM, *columns])
        for number, stored, *values in self._read(names, condition, value, unread):
            wrong = check.wrong_with(values, stored)
            if wrong is not None:
                self._damaged(f"row {number}: {wrong}")
            yield number, values, wrong

    def _read(
        self, names: str, condition: str, value: object, unread: set[int] | None
    ) -> Iterator[Any]:
        """Yield rows in order; one at a time after an unreadable page of the file."""
        read = f"SELECT {names} FROM samples WHERE ({condition}) AND number"
        last = 0
        try:
            for row in self._connection.execute(
                f"{read} > 0 ORDER BY number", (value,)
            ):
                last = row[0]
                yield row
            return
        except sqlite3.DatabaseError as error:
            if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_CORRUPT:
                raise
        # The highest number may be damaged itself.
        most = self._count() or last + SEARCHED
        for number in range(last + 1, most + 1):
            try:
                yield from self._connection.execute(
                    f"{read} = ?", (value, number)
                ).fetchall()
            except sqlite3.DatabaseError:
                self._damaged(f"row {number}: cannot be read")
                if unread is not None:
                    unread.add(number)
