"""The journal of a scan: what has been committed to it survives a loss of power."""

from __future__ import annotations

import contextlib
import datetime
import os
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from amulor.acquisition.plan import Key
from amulor.errors import FormatError, InstrumentError, SurveyError

#: Raised when a journal of an older amulor can no longer be gone on with.
SCHEMA_VERSION = "1"
FILE_NAME = "journal.sqlite"
_LOCK_NAME = "writer.lock"

_KEY = (
    "kind TEXT NOT NULL, row INTEGER NOT NULL, column INTEGER NOT NULL, "
    "frequency REAL NOT NULL, polarization TEXT NOT NULL, repeat INTEGER NOT NULL"
)
_KEY_NAMES = ", ".join(Key._fields)


@dataclass(frozen=True)
class Record:
    """What one sample has brought, apart from its key."""

    in_phase: float
    """Mean of the readings [V]."""
    quadrature: float
    """Mean of the readings [V]."""
    mean: float | None
    """Mean output of the detector, None where it is not wired [V]."""
    readings: int
    """How many readings were averaged [1]."""
    full_scale: float
    """Largest peak amplitude of the setting [V]."""
    flags: int
    """Sum of `SampleFlag` [1]."""
    commanded_azimuth: float
    """Direction asked for [rad]."""
    commanded_elevation: float
    """Direction asked for [rad]."""
    azimuth: float
    """Direction read back [rad]."""
    elevation: float
    """Direction read back [rad]."""
    modulation_frequency: float
    """Frequency read back [Hz]."""
    elapsed: float
    """Time since the scan began, by the clock of the scan [s]."""
    segment: int
    """Which uninterrupted part of the scan it belongs to [1]."""


_RECORD_NAMES = tuple(field.name for field in fields(Record))


class Journal:
    """An open journal; one writer at a time, any number of readers.

    Use `create`, `resume` or `read`; close it, or use it in a `with` statement.
    """

    def __init__(self, folder: Path, connection: sqlite3.Connection) -> None:
        self.folder = folder
        self._connection = connection
        self._lock: sqlite3.Connection | None = None
        self._insert = (
            f"INSERT INTO samples ({_KEY_NAMES}, {', '.join(_RECORD_NAMES)}) VALUES "
            f"({', '.join('?' * (len(Key._fields) + len(_RECORD_NAMES)))})"
        )

    @classmethod
    def create(cls, folder: Path, *, meta: dict[str, str]) -> Journal:
        """Start the journal of a new scan.

        Parameters
        ----------
        folder : pathlib.Path
            An existing folder without a journal.
        meta : dict
            What the scan is of; see `resume` for the keys that are compared.

        Returns
        -------
        Journal
            Empty, on disk, and locked against other writers.

        Raises
        ------
        FormatError
            If there is a journal, or if it cannot be made.
        """
        path = folder / FILE_NAME
        if path.exists():
            raise FormatError(
                f"{folder} holds a scan already; go on with it by --resume, make its "
                f"cube with 'amulor recover {folder}', or name another folder"
            )
        lock = _locked(folder)
        # Built under another name: a journal that exists is whole.
        draft = path.with_name(f".{FILE_NAME}.new")
        with _explained(path):
            draft.unlink(missing_ok=True)
            connection = sqlite3.connect(draft, isolation_level=None)
            with contextlib.closing(connection):
                connection.execute("PRAGMA synchronous = FULL")
                connection.execute("BEGIN")
                connection.execute(
                    "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT)"
                )
                connection.execute(
                    f"CREATE TABLE samples (number INTEGER PRIMARY KEY, {_KEY}, "
                    + ", ".join(f"{name} {_column(name)}" for name in _RECORD_NAMES)
                    + f", UNIQUE ({_KEY_NAMES}))"
                )
                connection.execute(
                    "CREATE TABLE segments (number INTEGER PRIMARY KEY, started TEXT, "
                    "ended TEXT, reason TEXT)"
                )
                connection.executemany(
                    "INSERT INTO meta VALUES (?, ?)",
                    {"journal_schema": SCHEMA_VERSION, **meta}.items(),
                )
                connection.execute("COMMIT")
            os.replace(draft, path)
            _synchronise(folder)
            journal = cls(folder, _writer(path))
        journal._lock = lock
        return journal

    @classmethod
    def resume(cls, folder: Path, *, meta: dict[str, str]) -> Journal:
        """Open the journal of a scan that was broken off.

        Parameters
        ----------
        folder : pathlib.Path
            Folder of the scan.
        meta : dict
            What the scan is of now; `survey_digest` and `instrument_digest` must be
            those of the journal.

        Returns
        -------
        Journal
            Locked against other writers.

        Raises
        ------
        FormatError
            If there is no journal, if another program writes to it, if it is damaged
            or of another schema.
        SurveyError, InstrumentError
            If the survey or the instrument is another one than before.
        """
        path = folder / FILE_NAME
        if not path.is_file():
            raise FormatError(
                f"{folder} holds no scan to go on with; leave out --resume to begin one"
            )
        lock = _locked(folder)
        try:
            with _explained(path):
                journal = cls(folder, _writer(path))
            journal._lock = lock
            journal._refuse_another_scan(meta)
        except BaseException:
            lock.close()
            raise
        return journal

    @classmethod
    def read(cls, folder: Path) -> Journal:
        """Open a journal for reading, also while it is written to.

        Parameters
        ----------
        folder : pathlib.Path
            Folder of the scan.

        Returns
        -------
        Journal
            Every method that writes raises.

        Raises
        ------
        FormatError
            If there is no journal, or if it is damaged or of another schema.
        """
        path = folder / FILE_NAME
        if not path.is_file():
            raise FormatError(
                f"{folder} holds no journal of a scan ({FILE_NAME}); name the folder "
                "that 'amulor acquire' was given"
            )
        with _explained(path):
            connection = sqlite3.connect(path, isolation_level=None, timeout=10)
            connection.execute("PRAGMA query_only = ON")
            journal = cls(folder, connection)
            journal._refuse_another_schema()
        return journal

    def __enter__(self) -> Journal:
        """Return the journal."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Close the journal and let other writers in; it may be called twice."""
        with contextlib.suppress(sqlite3.Error):
            self._connection.close()
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def meta(self) -> dict[str, str]:
        """Return what the scan is of."""
        with _explained(self._path):
            return dict(self._connection.execute("SELECT key, value FROM meta"))

    def note(self, key: str, value: str) -> None:
        """Write one more thing about the scan, or change one."""
        with _explained(self._path):
            self._connection.execute(
                "INSERT INTO meta VALUES (?, ?) "
                "ON CONFLICT (key) DO UPDATE SET value = excluded.value",
                (key, value),
            )

    def commit(self, key: Key, record: Record) -> None:
        """Write one sample; when this returns, it survives a loss of power.

        Parameters
        ----------
        key : Key
            Must be new.
        record : Record
            What was measured.

        Raises
        ------
        FormatError
            If it could not be written, for example on a full disk; then it is not
            in the journal. Also if the key is there already.
        """
        with _explained(self._path):
            # Without an open transaction the statement is one of its own.
            self._connection.execute(
                self._insert, (*key, *(getattr(record, name) for name in _RECORD_NAMES))
            )

    def keys(self) -> set[Key]:
        """Return the keys of all samples."""
        with _explained(self._path):
            rows = self._connection.execute(f"SELECT {_KEY_NAMES} FROM samples")
            return {Key(*row) for row in rows}

    def samples(self, kind: str) -> Iterator[tuple[Key, Record]]:
        """Yield the samples of one kind in the order in which they were taken."""
        names = f"{_KEY_NAMES}, {', '.join(_RECORD_NAMES)}"
        split = len(Key._fields)
        with _explained(self._path):
            for row in self._connection.execute(
                f"SELECT {names} FROM samples WHERE kind = ? ORDER BY number", (kind,)
            ):
                yield Key(*row[:split]), Record(*row[split:])

    def count(self) -> int:
        """Return the number of samples [1]."""
        with _explained(self._path):
            (found,) = self._connection.execute("SELECT COUNT(*) FROM samples")
        return int(found[0])

    def last_elapsed(self) -> float:
        """Return the time of the last sample, 0 without one [s]."""
        with _explained(self._path):
            (found,) = self._connection.execute("SELECT MAX(elapsed) FROM samples")
        return float(found[0] or 0.0)

    def begin_segment(self) -> int:
        """Note that the scan goes on, and that a part without an end was broken off."""
        now = _now()
        with _explained(self._path):
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                self._connection.execute(
                    "UPDATE segments SET ended = ?, reason = ? WHERE ended IS NULL",
                    (now, "broken off without notice"),
                )
                cursor = self._connection.execute(
                    "INSERT INTO segments (started) VALUES (?)", (now,)
                )
                self._connection.execute("COMMIT")
            except BaseException:
                self._connection.execute("ROLLBACK")
                raise
        assert cursor.lastrowid is not None
        return cursor.lastrowid

    def end_segment(self, number: int, reason: str) -> None:
        """Note when and why a part of the scan ended."""
        with _explained(self._path):
            self._connection.execute(
                "UPDATE segments SET ended = ?, reason = ? WHERE number = ?",
                (_now(), reason, number),
            )

    def segments(self) -> list[dict[str, Any]]:
        """Return number, started, ended and reason of every part of the scan."""
        with _explained(self._path):
            rows = self._connection.execute(
                "SELECT number, started, ended, reason FROM segments ORDER BY number"
            )
            names = ("number", "started", "ended", "reason")
            return [dict(zip(names, row, strict=True)) for row in rows]

    @property
    def _path(self) -> Path:
        return self.folder / FILE_NAME

    def _refuse_another_schema(self) -> dict[str, str]:
        found = self.meta()
        version = found.get("journal_schema")
        if version != SCHEMA_VERSION:
            raise FormatError(
                f"{self._path}: the journal has schema {version!r}, this amulor knows "
                f"{SCHEMA_VERSION!r}; use the amulor that began the scan"
            )
        return found

    def _refuse_another_scan(self, meta: dict[str, str]) -> None:
        found = self._refuse_another_schema()
        if found["survey_digest"] != meta["survey_digest"]:
            raise SurveyError(
                f"{self.folder} holds a scan of another survey "
                f"({found['survey_digest'][:15]}..., now "
                f"{meta['survey_digest'][:15]}...); go on with the survey.toml in that "
                "folder, or name a new folder"
            )
        if found["instrument_digest"] != meta["instrument_digest"]:
            raise InstrumentError(
                f"{self.folder} holds a scan by other devices or another procedure: "
                f"{found['identities']}, now {meta['identities']}; go on with the "
                "devices.toml in that folder, or name a new folder"
            )


def _column(name: str) -> str:
    whole = name in ("readings", "flags", "segment")
    kind = "INTEGER" if whole else "REAL"
    return kind if name == "mean" else f"{kind} NOT NULL"


def _writer(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None, timeout=10)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    return connection


def _locked(folder: Path) -> sqlite3.Connection:
    # The lock of a program that was killed is gone with it.
    path = folder / _LOCK_NAME
    try:
        lock = sqlite3.connect(path, isolation_level=None, timeout=0)
        lock.execute("BEGIN EXCLUSIVE")
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            raise FormatError(
                f"{folder} is written to by another program; wait for it, or stop it"
            ) from None
        raise FormatError(
            f"{path} cannot be written: {error}; check the permissions of the folder "
            "and the space on its disk"
        ) from error
    return lock


@contextlib.contextmanager
def _explained(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.IntegrityError as error:
        raise FormatError(
            f"{path}: this sample is there already, or incomplete ({error}); nothing "
            "was changed"
        ) from error
    except (sqlite3.Error, OSError) as error:
        raise FormatError(
            f"{path} cannot be used: {error}; free some space, check permissions and "
            "disk; what was acknowledged before is kept"
        ) from error


def _synchronise(folder: Path) -> None:
    # A new name lasts when its folder is on disk; Windows cannot do this, nor needs it.
    with contextlib.suppress(PermissionError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
