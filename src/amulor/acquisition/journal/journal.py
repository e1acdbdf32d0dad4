"""The journal of a scan, whose committed samples survive a loss of power."""

from __future__ import annotations

import contextlib
import datetime
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from amulor.acquisition.journal import file as journal_file
from amulor.acquisition.journal.file import (
    FILE_NAME,
    checked,
    explained,
    with_checksums,
)
from amulor.acquisition.journal.record import EXTRA, Record
from amulor.acquisition.journal.rows import (
    INSERT,
    INSERT_MESSAGE,
    KEY_NAMES,
    NAVIGATION,
    SCHEMA_VERSION,
    SEARCHED,
    TABLES,
    Rows,
    columns_of,
    message_row,
    refuse_another,
    row_of,
    wrong_with_message,
)
from amulor.acquisition.plan import Key
from amulor.errors import FormatError


class Journal:
    """Open journal of a scan, with one writer at a time and any number of readers.

    Use `create`, `resume` or `read`; close it, or use it in a `with` statement.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from amulor.acquisition import Journal
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with Journal.create(Path(folder), meta={"survey": "none"}) as journal:
    ...         sorted(path.name for path in journal.folder.iterdir())[0]
    'journal.sqlite'
    """

    def __init__(
        self,
        folder: Path,
        connection: sqlite3.Connection,
        claim: sqlite3.Connection | None = None,
    ) -> None:
        self.folder = folder
        self._connection = connection
        self._claim = claim
        self._rows = Rows(connection, self._damaged)
        #: Lines about damage, in the order of detection.
        self._damage: dict[str, None] = {}

    @staticmethod
    def claim(folder: Path) -> sqlite3.Connection:
        """Lock a folder for a new scan, before any device receives a command.

        Parameters
        ----------
        folder : pathlib.Path
            An existing folder without a journal.

        Returns
        -------
        sqlite3.Connection
            Lock for `create`; closing it releases the folder.

        Raises
        ------
        FormatError
            If there is a journal or a part of one, or if another program starts one.
        """
        claim = journal_file.claimed(folder)
        # Checked under the lock, so that no other program creates a journal in between.
        path = folder / FILE_NAME
        if path.exists():
            claim.close()
            raise FormatError(
                f"{folder} holds a scan already; go on with it by --resume, make its "
                f"cube with 'amulor recover {folder}', or name another folder"
            )
        wal = path.with_name(f"{FILE_NAME}-wal")
        if wal.exists():
            claim.close()
            raise FormatError(
                f"{folder} holds {wal.name}, the newest samples of a journal, and no "
                f"{FILE_NAME}; put that back beside it, or name another folder"
            )
        return claim

    @classmethod
    def create(
        cls,
        folder: Path,
        *,
        meta: Mapping[str, str],
        claim: sqlite3.Connection | None = None,
    ) -> Journal:
        """Start the journal of a new scan.

        Parameters
        ----------
        folder : pathlib.Path
            An existing folder without a journal.
        meta : mapping
            Metadata of the scan; `refuse_another` lists the keys that it compares.
        claim : sqlite3.Connection, optional
            Lock from `claim`; by default it is taken now.

        Returns
        -------
        Journal
            Empty journal on disk, locked against other writers.

        Raises
        ------
        FormatError
            If there is a journal, or if it cannot be created.
        """
        claim = claim or cls.claim(folder)
        path = folder / FILE_NAME
        try:
            journal_file.make(
                path,
                tables=TABLES,
                meta=with_checksums({"journal_schema": SCHEMA_VERSION, **meta}),
            )
            return cls(folder, journal_file.writer(path), claim)
        except BaseException:
            claim.close()
            raise

    @classmethod
    def resume(cls, folder: Path, *, meta: Mapping[str, str]) -> Journal:
        """Open the journal of an interrupted scan for writing.

        Parameters
        ----------
        folder : pathlib.Path
            Folder of the scan.
        meta : mapping
            Present metadata of the scan, as for `refuse_another`.

        Returns
        -------
        Journal
            Journal, locked against other writers.

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
        claim = journal_file.claimed(folder)
        try:
            journal = cls(folder, journal_file.writer(path), claim)
        except BaseException:
            claim.close()
            raise
        try:
            journal.refuse_another(meta)
            journal._refuse_damaged()
            journal._add_columns()
        except BaseException:
            journal.close()
            raise
        return journal

    @classmethod
    def read(cls, folder: Path) -> Journal:
        """Open a journal for reading, also while a scan writes to it.

        Parameters
        ----------
        folder : pathlib.Path
            Folder of the scan.

        Returns
        -------
        Journal
            Journal, of which every method that writes raises.

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
        journal = cls(folder, journal_file.reader(path))
        try:
            journal.refuse_another({})
        except BaseException:
            journal.close()
            raise
        return journal

    def __enter__(self) -> Journal:
        """Return the journal; it is closed at the end of the block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the journal."""
        self.close()

    def close(self) -> None:
        """Close the journal and release its write lock; it may be called twice."""
        with contextlib.suppress(sqlite3.Error):
            self._connection.close()
        if self._claim is not None:
            self._claim.close()
            self._claim = None

    def meta(self) -> dict[str, str]:
        """Return the metadata of the scan, with verified checksums.

        Raises
        ------
        FormatError
            If the survey or the devices in it are damaged, and there is no copy.
        """
        return checked(self._entries(), self.folder, self._damaged)

    def _entries(self) -> dict[str, str]:
        with explained(self._path):
            rows = self._connection.execute("SELECT key, value FROM meta")
            return {str(name): str(text) for name, text in rows}

    def note(self, key: str, value: str) -> None:
        """Add or replace a metadata entry of the scan."""
        entries = {**self._entries(), key: value}
        with explained(self._path):
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                self._connection.executemany(
                    "INSERT INTO meta VALUES (?, ?) "
                    "ON CONFLICT (key) DO UPDATE SET value = excluded.value",
                    with_checksums(entries).items(),
                )
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    def damage(self) -> list[str]:
        """Return a line of text per damaged record; empty if the journal is intact.

        All rows are checked: checksum, range of each number, and whether the survey
        plans such a sample. The description of the scan is checked, too.
        """
        self._damage.clear()
        entries = self.meta()
        with explained(self._path):
            self._rows.look_through(entries)
        self.messages()
        return [*self._damage]

    def _damaged(self, line: str) -> None:
        self._damage[line] = None

    def commit(self, key: Key, record: Record) -> None:
        """Write one sample; after the call it survives a loss of power.

        Parameters
        ----------
        key : Key
            New key of the sample.
        record : Record
            Measured quantities.

        Raises
        ------
        FormatError
            If it cannot be written, for example on a full disk; then it is not in the
            journal. Also if the key exists already.
        """
        with explained(self._path):
            # Without an open transaction, the statement is its own transaction.
            self._connection.execute(INSERT, row_of(key, record))

    def commit_together(
        self,
        samples: Sequence[tuple[Key, Record]],
        messages: Sequence[tuple[float, str]] = (),
    ) -> None:
        """Write the samples of one dwell in one transaction.

        Parameters
        ----------
        samples : sequence of (Key, Record)
            Each key must be new.
        messages : sequence of (float, str)
            Messages of the navigation: arrival since the start of the scan [s], line.

        Raises
        ------
        FormatError
            As for `commit`; then none of them is in the journal.
        """
        if len(samples) == 1 and not messages:
            self.commit(*samples[0])
            return
        rows = [row_of(key, record) for key, record in samples]
        lines = [message_row(elapsed, line) for elapsed, line in messages]
        with explained(self._path):
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                self._connection.executemany(INSERT, rows)
                self._connection.executemany(INSERT_MESSAGE, lines)
                self._connection.execute("COMMIT")
            except BaseException:
                # On a full disk, SQLite may have rolled back already.
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    def messages(self) -> list[tuple[int, float, str]]:
        """Return number, arrival [s] and line of the undamaged navigation messages.

        Arrivals count from the start of the scan; older journals have no messages.
        """
        result, before = [], 0
        with explained(self._path):
            tables = self._connection.execute(
                "SELECT name FROM sqlite_master WHERE name = 'navigation'"
            )
            if tables.fetchone() is None:
                return []
            rows = self._connection.execute(
                "SELECT number, elapsed, line, crc FROM navigation ORDER BY number"
            )
            for number, elapsed, line, stored in rows:
                for absent in range(before + 1, min(number, before + SEARCHED)):
                    self._damaged(f"navigation message {absent}: not there")
                before = number
                wrong = wrong_with_message(elapsed, line, stored)
                if wrong is None:
                    result.append((number, elapsed, line))
                else:
                    self._damaged(f"navigation message {number}: {wrong}")
        return result

    def keys(self) -> set[Key]:
        """Return the keys of all samples."""
        with explained(self._path):
            rows = self._connection.execute(f"SELECT {KEY_NAMES} FROM samples")
            return {Key(*row) for row in rows}

    def samples(self, kind: str) -> Iterator[tuple[Key, Record]]:
        """Yield the samples of one kind in the order of acquisition."""
        entries = self.meta()
        with explained(self._path):
            # The unary plus prevents the use of an index, which may be damaged, too.
            for _, key, record in self._rows.sound(entries, "+kind = ?", kind):
                yield key, record

    def newer(self, than: int) -> list[tuple[int, Key, Record]]:
        """Return number, key and record of all samples with a number above `than`.

        Parameters
        ----------
        than : int
            Number of the last known sample, 0 for none [1].

        Returns
        -------
        list of tuple
            Number, key and record in the order of acquisition. They are read at once,
            so that no reader blocks the writer.
        """
        entries = self.meta()
        with explained(self._path):
            return [*self._rows.sound(entries, "number > ?", than)]

    def _add_columns(self) -> None:
        """Add the columns and the table that a journal of an older version lacks."""
        with explained(self._path):
            self._connection.execute(NAVIGATION)
            columns = columns_of(self._connection)
            for name in EXTRA:
                if name not in columns:
                    self._connection.execute(
                        f"ALTER TABLE samples ADD COLUMN {name} REAL"
                    )

    def count(self) -> int:
        """Return the number of samples [1]."""
        with explained(self._path):
            (result,) = self._connection.execute("SELECT COUNT(*) FROM samples")
        return int(result[0])

    def last_elapsed(self) -> float:
        """Return the largest elapsed time of all samples; 0 without samples [s]."""
        with explained(self._path):
            (result,) = self._connection.execute("SELECT MAX(elapsed) FROM samples")
        return float(result[0] or 0.0)

    def begin_segment(self) -> int:
        """Begin a segment; mark open segments as interrupted; return the new number."""
        now = _now()
        with explained(self._path):
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
        """Record the end of a segment and its reason."""
        with explained(self._path):
            self._connection.execute(
                "UPDATE segments SET ended = ?, reason = ? WHERE number = ?",
                (_now(), reason, number),
            )

    def segments(self) -> list[dict[str, Any]]:
        """Return number, start, end and reason of every segment."""
        with explained(self._path):
            rows = self._connection.execute(
                "SELECT number, started, ended, reason FROM segments ORDER BY number"
            )
            names = ("number", "started", "ended", "reason")
            return [
                {
                    name: value if value is None or name == "number" else str(value)
                    for name, value in zip(names, row, strict=True)
                }
                for row in rows
            ]

    @property
    def _path(self) -> Path:
        return self.folder / FILE_NAME

    def refuse_another(self, meta: Mapping[str, str]) -> None:
        """Raise if the journal has another schema version, survey or instrument.

        Parameters
        ----------
        meta : mapping
            `survey_digest`, and `instrument_digest` with `identities`; missing keys are
            not compared.

        Raises
        ------
        FormatError
            If the schema differs.
        SurveyError, InstrumentError
            If the survey or the instrument is.
        """
        refuse_another(self.folder, self._path, self.meta(), meta)

    def _refuse_damaged(self) -> None:
        """Raise if the journal is damaged, as a scan cannot repair it."""
        damage = self.damage()
        if damage:
            more = f", and {len(damage) - 3} more" if len(damage) > 3 else ""
            raise FormatError(
                f"{self._path} is damaged ({'; '.join(damage[:3])}{more}) and cannot "
                f"be gone on with; make the cube of the rest with 'amulor recover "
                f"{self.folder}', and scan into a new folder"
            )


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
