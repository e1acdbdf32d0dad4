"""What a journal looks like inside, and whether it is that of a scan that is meant."""

from __future__ import annotations

import json
import math
import operator
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from amulor.acquisition.journal.checks import CHECKSUM, checksum, refuse_infinite
from amulor.acquisition.journal.record import OPTIONAL, QUANTITIES, WHOLE, Record
from amulor.acquisition.plan import Key
from amulor.errors import FormatError, InstrumentError, SurveyError

#: Raised when an older amulor must not write to a journal.
SCHEMA_VERSION = "2"

_KEY_COLUMNS = (
    "kind TEXT NOT NULL, row INTEGER NOT NULL, column INTEGER NOT NULL, "
    "frequency REAL NOT NULL, polarization TEXT NOT NULL, repeat INTEGER NOT NULL"
)
KEY_NAMES = ", ".join(Key._fields)
RECORD_FIELDS = tuple(QUANTITIES)
_RECORD_NAMES = ", ".join(RECORD_FIELDS)


def _column(name: str) -> str:
    """Declare the column of a recorded quantity in SQL."""
    kind = "INTEGER" if name in WHOLE else "REAL"
    return f"{name} {kind}" + ("" if name in OPTIONAL else " NOT NULL")


_RECORD_COLUMNS = ", ".join(map(_column, RECORD_FIELDS))
_VALUES = operator.attrgetter(*RECORD_FIELDS)
_NAMES = (*Key._fields, *RECORD_FIELDS)
_PLACES = ", ".join("?" * (len(_NAMES) + 1))
INSERT = (
    f"INSERT INTO samples ({KEY_NAMES}, {_RECORD_NAMES}, {CHECKSUM}) VALUES ({_PLACES})"
)
#: A journal is append-only: samples are inserted, never changed, never deleted.
TABLES = (
    "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT)",
    f"CREATE TABLE samples (number INTEGER PRIMARY KEY, {_KEY_COLUMNS}, "
    f"{_RECORD_COLUMNS}, {CHECKSUM} INTEGER, UNIQUE ({KEY_NAMES}))",
    "CREATE TABLE segments (number INTEGER PRIMARY KEY, started TEXT, ended TEXT, "
    "reason TEXT)",
)


def row_of(key: Key, record: Record) -> tuple[Any, ...]:
    """Return what `INSERT` takes."""
    values = (*key, *_VALUES(record))
    if math.inf in values or -math.inf in values:
        refuse_infinite(key, record)
    return (*values, checksum(_NAMES, values))


def refuse_another(
    folder: Path, path: Path, result: Mapping[str, str], meta: Mapping[str, str]
) -> None:
    """Raise unless a journal is of this schema, and of the scan that is meant.

    Parameters
    ----------
    folder, path : pathlib.Path
        Of the scan and of its journal, for messages.
    result : mapping
        What the journal says.
    meta : mapping
        What is known now; what is left out is not compared.

    Raises
    ------
    FormatError
        If the schema is another one.
    SurveyError, InstrumentError
        If the survey or the instrument is.
    """
    version = result.get("journal_schema")
    if version != SCHEMA_VERSION:
        raise FormatError(
            f"{path}: the journal has schema {version!r}, this amulor knows "
            f"{SCHEMA_VERSION!r}; use the amulor that began the scan"
        )
    same = {"survey_digest": "", "instrument_digest": "", **result, **meta}
    if result.get("survey_digest", "") != same["survey_digest"]:
        raise SurveyError(
            f"{folder} holds a scan of another survey "
            f"({result['survey_digest'][:15]}..., now "
            f"{meta['survey_digest'][:15]}...); go on with the survey.toml in that "
            "folder, or name a new folder"
        )
    if result.get("instrument_digest", "") != same["instrument_digest"]:
        other = _differences(result["identities"], meta["identities"])
        raise InstrumentError(
            f"{folder} holds a scan by other devices or another procedure: "
            f"{other}; go on with the devices.toml in that folder, or name a new "
            "folder"
        )


def _differences(before: str, now: str) -> str:
    """Say which device of a scan is another one than before."""
    old, new = json.loads(before), json.loads(now)
    changed = [
        f"{name} was {old.get(name, 'not there')}, is {new.get(name, 'not there')}"
        for name in dict.fromkeys([*old, *new])
        if old.get(name) != new.get(name)
    ]
    return "; ".join(changed) or "each device is the same, what it is told is not"
