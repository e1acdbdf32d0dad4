"""Checks of a journal's rows: each type, range, place and checksum, in words."""

from __future__ import annotations

import math
import sqlite3
import struct
import zlib
from pathlib import Path

import pytest
from given_journals import journal_of, key, record

from amulor.acquisition.journal import file as journal_file
from amulor.acquisition.journal import rows
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import OPTIONAL, QUANTITIES
from amulor.acquisition.plan import DARK, OPEN_WATER, REFERENCE, SCAN, SHUTTER, Key
from amulor.errors import FormatError, InstrumentError, SurveyError
from amulor.survey import Survey

NAMES = (*Key._fields, *rows.RECORD_FIELDS)


def row(**changes: object) -> list[object]:
    values = dict(zip(NAMES, rows.row_of(key(), record(mean=0.5)), strict=False))
    return [*{**values, **changes}.values()]


def wrong(survey: Survey | None, **changes: object) -> str | None:
    values = row(**changes)
    check = rows.RowCheck(survey, NAMES)
    return check.wrong_with(values, rows.checksum(NAMES, values))


def test_a_checksum_is_that_of_names_and_values() -> None:
    names, values = ("kind", "row", "mean"), ("scan", 3, 0.5)
    start = zlib.crc32(b"row\0mean")
    expected = zlib.crc32(b"scan\0kind", zlib.crc32(struct.pack("<2d", 3, 0.5), start))
    assert rows.checksum(names, values) == expected
    # Missing and undefined numbers count as none; two texts are told apart.
    assert rows.checksum(("a", "b"), (1.0, None)) == rows.checksum(("a",), (1.0,))
    assert rows.checksum(("a", "b"), (1.0, math.nan)) == rows.checksum(("a",), (1.0,))
    assert rows.checksum(("a",), (math.inf,)) != rows.checksum(("a",), (-math.inf,))
    both = rows.checksum(("a", "b"), (math.inf, -math.inf))
    assert both != rows.checksum(("a", "b"), (-math.inf, math.inf))
    assert rows.checksum(("a", "b"), ("x", "y")) != rows.checksum(
        ("a", "b"), ("xy", "")
    )


@pytest.mark.parametrize("survey", [True, False])
def test_intact_rows_are_intact(small: Survey, survey) -> None:
    plan = small if survey else None
    assert wrong(plan) is None
    assert wrong(plan, mean=None) is None
    values = row()
    other = rows.RowCheck(plan, NAMES).wrong_with(values, 7)
    assert other == "its checksum is that of other numbers"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"kind": 5}, "kind is no readable text"),
        ({"polarization": "V\ufffd"}, "polarization is no readable text"),
        ({"in_phase": None}, "in_phase is missing"),
        ({"in_phase": "1"}, "in_phase is no number"),
        ({"in_phase": True}, "in_phase is no number"),
        ({"row": 1.0}, "row = 1 is no whole number"),
        ({"flags": 2.0}, "flags = 2 is no whole number"),
        ({"row": -1}, "row = -1 is not within 0 to 20000"),
        ({"column": 20_001}, "column = 20001 is not within 0 to 20000"),
        ({"frequency": 0.0}, "frequency = 0 is not within 1e-06 to 1e+15"),
        ({"repeat": -1}, "repeat = -1 is not within 0 to 4.61169e+18"),
        ({"readings": 0}, "readings = 0 is not within 1 to 2.14748e+09"),
        ({"mean": math.inf}, "mean = inf is not within -1e+06 to 1e+06"),
        ({"kind": "rain"}, "there is no kind of sample 'rain'"),
        (
            {"row": 3},
            "row = 3, column = 0 of scan: the survey has 3 rows and 5 columns of it",
        ),
        (
            {"column": 5},
            "row = 0, column = 5 of scan: the survey has 3 rows and 5 columns of it",
        ),
        (
            {"kind": OPEN_WATER, "row": 2},
            "row = 2, column = 0 of open_water: the survey has 2 rows and 3 columns of "
            "it",
        ),
        (
            {"kind": REFERENCE},
            "row = 0, column = 0 of reference: the survey has 0 rows and 0 columns of "
            "it",
        ),
        (
            {"kind": DARK, "column": 1},
            "row = 0, column = 1 of dark: the survey has 1 rows and 1 columns of it",
        ),
        ({"frequency": 40e6}, "the survey has no frequency of 40000000 Hz"),
        ({"polarization": "PP"}, "the survey has no polarization 'PP'"),
    ],
)
def test_each_damage_of_a_row_is_named(small: Survey, changes, text) -> None:
    assert wrong(small, **changes) == text


def test_places_of_a_survey_end_with_its_grids(small: Survey) -> None:
    for kind, last in (
        (SCAN, (2, 4)), (OPEN_WATER, (1, 2)), (DARK, (0, 0)), (SHUTTER, (0, 0))
    ):  # fmt: skip
        assert wrong(small, kind=kind, row=last[0], column=last[1]) is None
    reference = {"azimuth": 0.1, "elevation": 0.0, "amplitude": 0.02}
    referenced = small.with_({"scan.reference": reference, "scan.open_water": None})
    assert wrong(referenced, kind=REFERENCE, row=20_000, column=1) is None
    assert wrong(referenced, kind=REFERENCE, column=2) is not None
    assert wrong(referenced, kind=OPEN_WATER) is not None
    # Without a survey any place and channel is possible.
    assert wrong(None, row=20_000, polarization="PP", frequency=1.0) is None


def test_limits_of_quantities_are_possible_values(small: Survey) -> None:
    for name, quantity in QUANTITIES.items():
        for value in quantity.within:
            assert wrong(small, **{name: value}) is None
    extra = [*row(), math.inf]
    check = rows.RowCheck(None, (*NAMES, "newer"))
    assert check.wrong_with(extra, 0) == "newer is infinite"


def test_an_impossible_sample_is_refused_by_name() -> None:
    for changes, text in (
        ({"in_phase": math.inf}, "in_phase is infinite"),
        ({"edge": -math.inf}, "edge is infinite"),
        ({"quadrature": math.nan}, "quadrature is not a number"),
        ({"elapsed": None}, "elapsed is not a number"),
    ):
        bad = record(**changes) if "in_phase" not in changes else record(math.inf)
        if changes.get("quadrature") is not None:
            bad = record(complex(0, math.nan))
        with pytest.raises(FormatError) as caught:
            rows.refuse_impossible(key(), bad)
        assert str(caught.value) == (
            f"sample {tuple(key())}: {text}; look at what the instrument answers. "
            "Nothing was written"
        )
    for name in OPTIONAL:
        rows.refuse_impossible(key(), record(**{name: None}))
        rows.row_of(key(), record(**{name: math.nan}))


def test_messages_of_the_navigation_have_a_time_and_a_checksum() -> None:
    elapsed, line, stored = rows.message_row(1.5, "a pose")
    assert rows.wrong_with_message(elapsed, line, stored) is None
    other = "its checksum is that of another message"
    assert rows.wrong_with_message(1.6, line, stored) == other
    assert rows.wrong_with_message(elapsed, "b", stored) == other
    for values in ((2, "a"), (1.5, b"a")):
        text = rows.wrong_with_message(*values, stored)
        assert text == "no time and line of text"
    with pytest.raises(FormatError) as caught:
        rows.message_row(math.nan, "x" * 50)
    assert str(caught.value) == (f"navigation: the arrival of {'x' * 40!r} is nan s")


def test_another_scan_is_refused_by_what_differs() -> None:
    folder, path = Path("a"), Path("a/journal.sqlite")
    before = {
        "journal_schema": "2", "survey_digest": "sha256:11112222333",
        "instrument_digest": "x", "identities": '{"laser": "A", "scanner": "B"}',
    }  # fmt: skip
    rows.refuse_another(folder, path, before, {})
    rows.refuse_another(folder, path, before, dict(before))
    for meta, error, text in (
        (
            {"survey_digest": "sha256:99998888777"}, SurveyError,
            "a holds a scan of another survey (sha256:11112222..., now "
            "sha256:99998888...); go on with the survey.toml in that folder, or name a "
            "new folder",
        ),
        (
            {"instrument_digest": "y", "identities": '{"laser": "C", "stage": "D"}'},
            InstrumentError,
            "a holds a scan by other devices or another procedure: laser was A, is C; "
            "scanner was B, is not there; stage was not there, is D; go on with the "
            "devices.toml in that folder, or name a new folder",
        ),
        (
            {"instrument_digest": "y", "identities": before["identities"]},
            InstrumentError,
            "a holds a scan by other devices or another procedure: each device is the "
            "same, what it is told is not; go on with the devices.toml in that folder, "
            "or name a new folder",
        ),
    ):  # fmt: skip
        with pytest.raises(error) as caught:
            rows.refuse_another(folder, path, before, meta)
        assert str(caught.value) == text
    with pytest.raises(FormatError) as caught:
        rows.refuse_another(folder, path, {"journal_schema": "1"}, {})
    assert str(caught.value) == (
        "a/journal.sqlite: the journal has schema '1', this amulor knows '2'; use the "
        "amulor that began the scan"
    )


def test_gaps_and_the_order_of_rows_are_told(small: Survey, folder) -> None:
    entries = [(key(column=k), record()) for k in range(4)]
    with journal_of(folder, small, entries):
        pass
    connection = sqlite3.connect(folder / "journal.sqlite")
    connection.execute("DELETE FROM samples WHERE number IN (1, 3)")
    connection.execute("UPDATE samples SET number = 7 WHERE number = 4")
    connection.commit()
    connection.close()
    with Journal.read(folder) as journal:
        assert journal.damage() == [
            f"row {number}: not there" for number in (1, 3, 4, 5, 6)
        ]
        found = [(number, at.column) for number, at, _ in journal.newer(0)]
        assert found == [(2, 1), (7, 3)]
        assert [number for number, *_ in journal.newer(2)] == [7]
        assert journal.count() == 2


def test_missing_messages_are_told(small: Survey, folder) -> None:
    with journal_of(folder, small, []) as journal:
        journal.commit_together([], [(float(k), f"line {k}") for k in range(4)])
        assert journal.messages() == [(k + 1, float(k), f"line {k}") for k in range(4)]
    connection = sqlite3.connect(folder / "journal.sqlite")
    connection.execute("DELETE FROM navigation WHERE number IN (1, 3)")
    connection.execute("UPDATE navigation SET line = 'other' WHERE number = 4")
    connection.commit()
    connection.close()
    with Journal.read(folder) as journal:
        assert journal.messages() == [(2, 1.0, "line 1")]
        assert journal.damage() == [
            "navigation message 1: not there", "navigation message 3: not there",
            "navigation message 4: its checksum is that of another message",
        ]  # fmt: skip


def test_notes_and_segments_of_a_journal(small: Survey, folder) -> None:
    with journal_of(folder, small, []) as journal:
        assert journal.last_elapsed() == 0.0
        journal.note("weather", "rain")
        journal.note("weather", "snow")
        assert journal.meta()["weather"] == "snow"
        first = journal.begin_segment()
        second = journal.begin_segment()
        assert (first, second) == (1, 2)
        journal.end_segment(second, "paused")
        one, two = journal.segments()
        assert (one["number"], one["reason"]) == (1, "broken off without notice")
        assert one["ended"] == two["started"]
        assert two["reason"] == "paused"
        assert two["ended"].endswith("Z")
        journal.commit(key(), record(elapsed=3.0))
        journal.commit_together([(key(column=1), record(elapsed=2.0))])
        assert journal.last_elapsed() == 3.0
        assert journal.damage() == []
        assert journal.keys() == {key(), key(column=1)}


def test_advice_is_that_of_the_error() -> None:
    advice = journal_file._advice
    damaged = "it is damaged, take a copy of the folder before anything else"

    def of(code: int) -> sqlite3.OperationalError:
        error = sqlite3.OperationalError("words")
        error.sqlite_errorcode = code
        return error

    assert advice(sqlite3.ProgrammingError("closed")) == (
        "this is a mistake of amulor, the journal is not affected; report it"
    )
    for code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_BUSY | 256):
        assert advice(of(code)) == (
            "another program has it open and locks it; close that program and repeat "
            "the command, what was acknowledged before is kept"
        )
    for code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
        assert advice(of(code)) == damaged
    assert advice(sqlite3.OperationalError("no such table: meta")) == damaged
    assert advice(UnicodeDecodeError("utf-8", b"", 0, 1, "why")) == damaged
    for code in (
        sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM
    ):  # fmt: skip
        assert advice(of(code)) == (
            "check permissions; what lies on a medium that cannot be written must be "
            "copied to one that can, as a whole folder"
        )
    for error in (of(sqlite3.SQLITE_FULL), OSError("full")):
        assert advice(error) == (
            "free some space, check permissions and disk; what was acknowledged before "
            "is kept"
        )
