"""Description of a scan in its journal: checksums, copies, locks, documents, clocks."""

from __future__ import annotations

import datetime
import json
import sqlite3
import time

import pytest
from given_journals import journal_of, key, record

from amulor import cube
from amulor.acquisition import clock as clocks
from amulor.acquisition.clock import Deadline, RealClock, VirtualClock
from amulor.acquisition.journal import file as journal_file
from amulor.acquisition.journal.documents import data_keys, data_of, documents
from amulor.acquisition.journal.file import CHECKSUMS, checked, with_checksums
from amulor.acquisition.plan import DARK, SCAN
from amulor.errors import FormatError
from amulor.survey import Survey


def description(**changes: str) -> dict[str, str]:
    entries = {"survey": "one", "devices": "two", "weather": "rain"}
    return {
        **with_checksums({**entries, "survey_digest": cube.digest("one")}), **changes
    }  # fmt: skip


def test_checksums_are_those_of_all_entries() -> None:
    again = with_checksums(description())
    assert again == description()
    assert sorted(json.loads(again[CHECKSUMS])) == [
        "devices", "survey", "survey_digest", "weather"
    ]  # fmt: skip


def test_a_damaged_entry_is_replaced_by_its_copy(tmp_path) -> None:
    told: list[str] = []
    assert checked(description(), tmp_path, told.append) == description()
    assert told == []
    (tmp_path / "devices.toml").write_text("two")
    (tmp_path / "survey.toml").write_text("one")
    found = checked(description(devices="x", survey="y"), tmp_path, told.append)
    assert found == description()
    assert told == [
        "devices is damaged; that of devices.toml was taken",
        "survey is damaged; that of survey.toml was taken",
    ]
    del told[:]
    found = checked(description(weather="snow"), tmp_path, told.append)
    assert found["weather"] == "snow"
    assert told == ["weather of the description is damaged"]
    for name in ("survey", "devices"):
        (tmp_path / f"{name}.toml").write_text("other")
        with pytest.raises(FormatError) as caught:
            checked(description(**{name: "x"}), tmp_path, told.append)
        assert str(caught.value) == (
            f"{tmp_path}: the {name} in the journal is not what the scan was begun "
            "with (its checksum or digest is another one), and there is no "
            f"{name}.toml that is; put a copy of that file there"
        )
        (tmp_path / f"{name}.toml").write_bytes(b"\xff")
        with pytest.raises(FormatError, match="there is no"):
            checked(description(**{name: "x"}), tmp_path, told.append)


def test_a_survey_is_also_known_by_its_digest(tmp_path) -> None:
    told: list[str] = []
    old = {"survey": "one", "survey_digest": cube.digest("one")}
    assert checked(old, tmp_path, told.append) == old
    with pytest.raises(FormatError, match="the survey in the journal is not"):
        checked({**old, "survey": "two"}, tmp_path, told.append)
    assert checked({"survey": "two"}, tmp_path, told.append) == {"survey": "two"}
    assert told == []
    for text in ("nonsense", "[1]", '{"survey": "x"}', '{"survey": null}'):
        del told[:]
        assert checked({**old, CHECKSUMS: text}, tmp_path, told.append)
        assert told == ["the checksums of the description are damaged"]
    # An entry that was there is missing.
    entries = description()
    del entries["weather"]
    del told[:]
    checked(entries, tmp_path, told.append)
    assert told == ["weather of the description is damaged"]


def test_a_folder_is_locked_once(tmp_path) -> None:
    assert not journal_file.in_use(tmp_path)
    lock = journal_file.claimed(tmp_path)
    assert journal_file.in_use(tmp_path)
    with pytest.raises(FormatError) as caught:
        journal_file.claimed(tmp_path)
    assert str(caught.value) == (
        f"{tmp_path} is written to by another program; wait for it, or stop it"
    )
    lock.close()
    assert not journal_file.in_use(tmp_path)
    nowhere = tmp_path / "missing"
    with pytest.raises(FormatError) as caught:
        journal_file.claimed(nowhere)
    assert str(caught.value) == (
        f"{nowhere / 'writer.lock'} cannot be written: unable to open database file; "
        "check the permissions of the folder and the space on its disk"
    )


def test_a_draft_that_fails_is_removed(tmp_path) -> None:
    path = tmp_path / "journal.sqlite"
    with pytest.raises(FormatError, match="syntax error"):
        journal_file.make(path, tables=["NONSENSE"], meta={})
    assert [*tmp_path.iterdir()] == []
    journal_file.make(path, tables=["CREATE TABLE meta (a, b)"], meta={"x": "y"})
    assert [one.name for one in tmp_path.iterdir()] == ["journal.sqlite"]
    reader = journal_file.reader(path)
    assert reader.execute("SELECT * FROM meta").fetchall() == [("x", "y")]
    with pytest.raises(sqlite3.OperationalError):
        reader.execute("DELETE FROM meta")
    reader.close()
    writer = journal_file.writer(path)
    assert writer.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    assert writer.execute("PRAGMA synchronous").fetchone() == (2,)
    writer.close()
    assert journal_file.text_of(b"a\xff") == "a\ufffd"


def moment(text: str) -> float:
    return datetime.datetime.fromisoformat(text).timestamp()


def test_events_have_the_time_of_their_segment(small: Survey, folder) -> None:
    entries = [
        (key(DARK), record(1, elapsed=5.0)),
        (key(SCAN), record(2, elapsed=7.5)),
        (key(SCAN, 0, 1), record(3, elapsed=100.0, segment=2)),
        (key(DARK, repeat=1), record(4, elapsed=99.0, segment=2)),
    ]
    with journal_of(folder, small, entries) as journal:
        first = journal.begin_segment()
        journal.end_segment(first, "paused")
        journal.end_segment(journal.begin_segment(), "finished")
        parts = [moment(part["started"]) for part in journal.segments()]
        found = [*documents(journal)]
    start, stop = found[0][1], found[-1][1]
    assert start["time"] == parts[0]
    assert start["identities"] == {"lock_in": "a lock-in"}
    names = [name for name, _ in found]
    assert names == [
        "start", "descriptor", "event", "event", "descriptor", "event", "event", "stop"
    ]  # fmt: skip
    times = [document["time"] for name, document in found if name == "event"]
    # Each segment begins with its first sample, whatever its kind.
    expected = [parts[0], parts[1], parts[0] + 2.5, parts[1] + 1.0]
    assert times == pytest.approx(expected)
    numbers = [document["seq_num"] for name, document in found if name == "event"]
    assert numbers == [1, 2, 1, 2]
    dark = found[1][1]
    assert (dark["name"], dark["time"]) == (DARK, pytest.approx(parts[0]))
    assert dark["object_keys"] == {"amulor": [*data_keys()]}
    assert (dark["configuration"], dark["hints"]) == ({}, {})
    assert stop["time"] == pytest.approx(max(parts[1] + 1.0, *parts))
    assert stop["num_events"] == {DARK: 2, SCAN: 2}
    assert (stop["exit_status"], stop["reason"]) == ("success", "finished")
    assert stop["run_start"] == start["uid"]


def test_a_scan_that_was_broken_off_is_aborted(small: Survey, folder) -> None:
    with journal_of(folder, small, []) as journal:
        number = journal.begin_segment()
        ((_, start), (_, stop)) = documents(journal)
        assert stop["time"] == start["time"]
        assert (stop["exit_status"], stop["num_events"]) == ("abort", {})
        assert stop["reason"] == "broken off without notice"
        journal.end_segment(number, "paused")
        assert [*documents(journal)][-1][1]["reason"] == "paused"


def test_quantities_have_units_and_numbers() -> None:
    keys = data_keys()
    assert keys["frequency"] == {
        "source": "amulor:frequency", "dtype": "number", "shape": [], "units": "Hz"
    }  # fmt: skip
    assert keys["polarization"]["dtype"] == "string"
    assert "units" not in keys["readings"]
    assert keys["in_phase"]["units"] == "V"
    found = data_of(key(), record(1j))
    assert found.keys() == keys.keys()
    assert found["mean"] != found["mean"]
    assert found["quadrature"] == 1.0


def test_a_timeout_passes_by_the_clock_and_the_wall(monkeypatch) -> None:
    wall = [10.0]
    monkeypatch.setattr(time, "monotonic", lambda: wall[0])
    virtual = VirtualClock()
    deadline = Deadline(virtual, 3.0)
    virtual.sleep(3.0)
    assert not deadline.passed()
    virtual.sleep(1e-9)
    assert deadline.passed()
    virtual.sleep(-5.0)
    assert virtual.now() == pytest.approx(3.0)
    fast = RealClock(100.0)
    assert fast.now() == 1000.0
    deadlines = [Deadline(fast, 30.0), Deadline(fast, 1.0)]
    for passed, expected in ((0.5, [False, False]), (1.1, [False, True]),
                             (1.9, [False, True]), (2.1, [True, True])):  # fmt: skip
        wall[0] = 10.0 + passed
        assert [one.passed() for one in deadlines] == expected
    slept: list[float] = []
    monkeypatch.setattr(clocks.time, "sleep", slept.append)
    fast.sleep(5.0)
    fast.sleep(0.0)
    fast.sleep(-1.0)
    assert slept == [0.05]
    assert RealClock().now() == wall[0]
    for speed in (1e-3, 1e6):
        RealClock(speed)
    for speed in (0.9e-3, 1.1e6):
        with pytest.raises(ValueError, match="speed must be above 0") as caught:
            RealClock(speed)
        assert str(caught.value) == (
            "speed must be above 0, from 0.001 to 1e+06 times that of the wall, got "
            f"{speed:g}: at less a scan would seem to hang"
        )
