"""Rows of a journal as they were written; damaged ones are told and left out."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from amulor.acquisition.journal.checks import CHECKSUM, RowCheck
from amulor.acquisition.journal.record import Record
from amulor.acquisition.journal.schema import RECORD_FIELDS
from amulor.acquisition.plan import Key
from amulor.survey import Survey

#: Rows that are tried behind a page that cannot be read, if nobody knows how many are.
_SEARCHED = 100_000


def columns_of(connection: sqlite3.Connection) -> list[str]:
    """Return the columns of the samples.

    Parameters
    ----------
    connection : sqlite3.Connection
        To the journal.

    Returns
    -------
    list of str
        In the order of the table.
    """
    rows = connection.execute("PRAGMA table_info(samples)")
    return [str(name) for _, name, *_ in rows]


class Rows:
    """Reads rows of one journal.

    Parameters
    ----------
    connection : sqlite3.Connection
        To the journal.
    damaged : callable
        Told in a line about each row that is not as it was written.
    """

    def __init__(
        self, connection: sqlite3.Connection, damaged: Callable[[str], None]
    ) -> None:
        self._connection, self._damaged = connection, damaged
        #: What says whether rows are sound, and by which survey and columns.
        self._check: tuple[str | None, list[str], RowCheck] | None = None

    def sound(
        self, entries: Mapping[str, str], which: str, value: object
    ) -> Iterator[tuple[int, Key, Record]]:
        """Yield number, key and record of sound rows.

        Parameters
        ----------
        entries : mapping
            What the journal says about the scan.
        which : str
            Condition with one place for a value. One by which rows are looked up in an
            index would trust that.
        value : object
            For that place.

        Yields
        ------
        tuple of (int, Key, Record)
            In the order in which they were taken.
        """
        columns, check = self._checked_by(entries)
        places = {name: place for place, name in enumerate(columns)}
        keys = [places[name] for name in Key._fields]
        known = [(name, places[name]) for name in RECORD_FIELDS if name in places]
        for number, values, wrong in self._judged(
            entries, columns, check, which, value
        ):
            if wrong is None:
                content = {name: values[place] for name, place in known}
                key = Key(*(values[place] for place in keys))
                yield number, key, Record(**content)

    def look_through(self, entries: Mapping[str, str]) -> None:
        """Look at every row, and tell what is damaged or gone.

        Parameters
        ----------
        entries : mapping
            What the journal says about the scan.
        """
        columns, check = self._checked_by(entries)
        unread: set[int] = set()
        before = 0
        for number, *_ in self._judged(
            entries, columns, check, "number > ?", 0, unread=unread
        ):
            gone = [*range(before + 1, min(number, before + _SEARCHED))]
            for one in gone:
                # Rows are inserted and never deleted: their numbers leave none out.
                if one not in unread:
                    self._damaged(f"row {one}: not there")
            before = number

    def _checked_by(self, entries: Mapping[str, str]) -> tuple[list[str], RowCheck]:
        text = entries.get("survey")
        if self._check is None or self._check[0] != text:
            there = columns_of(self._connection)
            columns = [name for name in there if name not in ("number", CHECKSUM)]
            survey = None
            if text is not None:
                survey = Survey.from_text(text, name="the survey of the journal")
            self._check = (text, there, RowCheck(survey, columns))
        _, there, check = self._check
        return [name for name in there if name not in ("number", CHECKSUM)], check

    def _judged(
        self,
        entries: Mapping[str, str],
        columns: list[str],
        check: RowCheck,
        which: str,
        value: object,
        *,
        unread: set[int] | None = None,
    ) -> Iterator[tuple[int, list[Any], str | None]]:
        """Yield number, values and what is wrong with them, if anything is."""
        names = ", ".join(["number", CHECKSUM, *columns])
        for number, stored, *values in self._read(names, which, value, unread):
            wrong = check.wrong_with(values, stored)
            if wrong is not None:
                self._damaged(f"row {number}: {wrong}")
            yield number, values, wrong

    def _read(
        self, names: str, which: str, value: object, unread: set[int] | None
    ) -> Iterator[Any]:
        """Yield rows in order, one by one behind a page that cannot be read."""
        read = f"SELECT {names} FROM samples WHERE ({which}) AND number"
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
        most = last + _SEARCHED
        with contextlib.suppress(sqlite3.DatabaseError):
            ((found,),) = self._connection.execute("SELECT MAX(number) FROM samples")
            most = min(int(found or 0), most)
        for number in range(last + 1, most + 1):
            try:
                yield from self._connection.execute(
                    f"{read} = ?", (value, number)
                ).fetchall()
            except sqlite3.DatabaseError:
                self._damaged(f"row {number}: cannot be read")
                if unread is not None:
                    unread.add(number)
