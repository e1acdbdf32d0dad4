"""Damaged journals: each damaged row is named, and the rest is in the cube."""

from __future__ import annotations

import os
import resource
import shutil
import sqlite3
import struct
import tempfile
import time
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fuzzing import MOST_MEMORY
from journal_damage import copied, damage
from shared_light import scene_light
from trials import keep

from amulor import acquisition
from amulor.acquisition.journal import file as journal_file
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.rows import checksum
from amulor.acquisition.plan import SCAN
from amulor.acquisition.settings import Settings
from amulor.errors import AmulorError, CubeError, FormatError
from amulor.survey import Survey

#: What a sample consists of in the cube, and what all of them make together.
OWN = ("in_phase", "quadrature", "user_mean_output", "user_full_scale",
       "user_modulation_frequency")  # fmt: skip


@pytest.fixture(scope="module")
def whole(plate: Survey) -> Iterator[Path]:
    """Return the folder of a small finished scan."""
    survey = plate.with_(
        {
            "scan.columns": 5,
            "scan.rows": 3,
            "scan.dwell": "50 ms",
            "scan.open_water": {"columns": 3, "rows": 2, "repeats": 2},
            "instrument.polarizations": ["VH"],
        }
    )
    memory = Path("/dev/shm")
    place = Path(tempfile.mkdtemp(dir=memory if memory.is_dir() else None))
    # No dark output to take off: what is left out of it would change every sample.
    settings = Settings.model_validate({"procedure": {"dark_readings": 2}})
    acquisition.acquire(survey, place / "whole", settings=settings, scene=scene_light)
    yield place / "whole"
    shutil.rmtree(place)


def edited(whole: Path, folder: Path, statement: str, *values: object) -> Path:
    """Return a copy in which something was changed."""
    place = copied(whole, folder / "scan")
    connection = sqlite3.connect(place / FILE_NAME, isolation_level=None)
    assert connection.execute(statement, values).rowcount == 1
    connection.close()
    return place


def recovered(place: Path):
    """Return the cube of a journal, and what is told about it."""
    with Journal.read(place) as journal:
        return acquisition.build(journal), journal.damage()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("row = -1", "row = -1 is not within 0"),
        ("row = 99", "the survey has 3 rows and 5 columns"),
        ("in_phase = 9e999", "in_phase = inf is not within"),
        ("readings = 0", "readings = 0 is not within 1"),
        ("readings = 9", "checksum is that of other numbers"),
        ("polarization = 'XX'", "no polarization 'XX'"),
        ("polarization = CAST(x'ff' AS TEXT)", "polarization is no readable text"),
        ("repeat = 30000000", "checksum is that of other numbers"),
        ("frequency = 40e6", "no frequency of 40000000 Hz"),
        ("quadrature = 'a'", "quadrature is no number"),
        ("flags = 2.5", "flags = 2.5 is no whole number"),
        ("kind = 'scam'", "no kind of sample 'scam'"),
        ("crc = NULL", "checksum is that of other numbers"),
        ("interval = 0.01", "checksum is that of other numbers"),
        ("azimuth = azimuth + 1e-9", "checksum is that of other numbers"),
    ],
)
def test_each_damaged_row_is_named_and_the_rest_is_recovered(
    whole, folder, change, words
) -> None:
    with Journal.read(whole) as journal:
        number = min(n for n, key, _ in journal.newer(0) if key.kind == SCAN) + 6
        (key,) = [key for n, key, _ in journal.newer(0) if n == number]
    place = edited(
        whole, folder, f"UPDATE samples SET {change} WHERE number = ?", number
    )
    sound, _ = recovered(whole)
    cube, told = recovered(place)
    (line,) = told
    assert line.startswith(f"row {number}: ")
    assert words in line
    assert "\n" not in line
    expected = sound["in_phase"].values.copy()
    expected[0, 0, key.row, key.column] = np.nan
    np.testing.assert_array_equal(cube["in_phase"].values, expected)
    # Somebody who looks on is given the rest, too; nobody goes on in it.
    with Journal.read(place) as journal:
        assert len(journal.newer(0)) == journal.count() - 1
    meta = {"survey_digest": "", "instrument_digest": "", "identities": "{}"}
    with Journal.read(place) as journal:
        meta |= journal.meta()
    with pytest.raises(FormatError, match=r"row \d+: .*cannot be gone on with"):
        Journal.resume(place, meta=meta)


def test_a_changed_survey_is_taken_from_its_copy_or_refused(whole, folder) -> None:
    change = "UPDATE meta SET value = replace(value, '1.5', '1.6') WHERE key = 'survey'"
    place = edited(whole, folder, change)
    sound, _ = recovered(whole)
    cube, told = recovered(place)
    assert told == ["survey is damaged; that of survey.toml was taken"]
    assert cube.attrs["survey"] == sound.attrs["survey"]
    (place / "survey.toml").unlink()
    with pytest.raises(FormatError, match="not what the scan was begun with"):
        acquisition.recover(place)


def test_a_row_that_is_gone_is_told(whole, folder) -> None:
    place = edited(whole, folder, "DELETE FROM samples WHERE number = 20")
    told: list[str] = []
    acquisition.recover(place, told=told.append)
    assert told == [f"{place}: row 20: not there"]


def test_a_high_number_of_a_dark_reading_takes_no_memory(whole, folder) -> None:
    place = copied(whole, folder / "scan")
    connection = sqlite3.connect(place / FILE_NAME, isolation_level=None)
    connection.row_factory = sqlite3.Row
    row = dict(
        connection.execute("SELECT * FROM samples WHERE kind = 'dark'").fetchone()
    )
    # As of a plan with many readings, its checksum right.
    row["repeat"] = 30_000_000
    names = [name for name in row if name not in ("number", "crc")]
    crc = checksum(names, [row[name] for name in names])
    connection.execute(
        "UPDATE samples SET repeat = ?, crc = ? WHERE number = ?",
        (row["repeat"], crc, row["number"]),
    )
    connection.close()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    _, told = recovered(place)
    assert told == []
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000


def test_the_checksum_is_that_of_names_and_values() -> None:
    # By hand: numbers by their names, then texts with theirs.
    packed = bytes.fromhex("000000000000f03f000000000000e0bf")
    expected = zlib.crc32(
        b"scan\0kind", zlib.crc32(packed, zlib.crc32(b"row\0azimuth"))
    )
    names = ("kind", "row", "azimuth", "mean")
    assert checksum(names, ("scan", 1, -0.5, None)) == expected
    # As the journal gives it back: 1 as 1.0, what is not a number as nothing.
    assert checksum(names, ("scan", 1.0, -0.5, float("nan"))) == expected
    assert checksum((*names, "later"), ("scan", 1, -0.5, None, None)) == expected
    assert checksum(names, ("scan", 1, 0.0, None)) == checksum(
        names, ("scan", 1, -0.0, None)
    )
    assert checksum(names, ("scan", 2, -0.5, None)) != expected
    assert checksum(names, ("scan", -0.5, 1, None)) != expected


def test_nothing_infinite_is_written(whole, folder) -> None:
    with Journal.read(whole) as journal:
        _, key, record = journal.newer(0)[-1]
        meta = journal.meta()
    place = folder / "new"
    place.mkdir()
    with Journal.create(place, meta=meta) as journal:
        bad = type(record)(**{**vars(record), "quadrature": float("-inf")})
        with pytest.raises(FormatError, match="quadrature is infinite"):
            journal.commit(key, bad)
        assert journal.count() == 0


def table_of(place: Path) -> tuple[bytearray, int, int, int]:
    """Return the file, the place of the table of samples, page size, and rows."""
    connection = sqlite3.connect(place / FILE_NAME)
    ((root,),) = connection.execute(
        "SELECT rootpage FROM sqlite_master WHERE name = 'samples'"
    )
    ((size,),) = connection.execute("PRAGMA page_size")
    ((count,),) = connection.execute("SELECT COUNT(*) FROM samples")
    connection.close()
    raw = bytearray((place / FILE_NAME).read_bytes())
    return raw, (root - 1) * size, size, count


def test_rows_of_a_first_page_that_is_broken_are_named_from_the_first_one(
    whole, folder
) -> None:
    place = copied(whole, folder / "scan")
    raw, begin, _, _ = table_of(place)
    # The kind of the page, which is none that there is.
    raw[begin] = 0xFF
    (place / FILE_NAME).write_bytes(raw)
    with Journal.read(place) as journal:
        told = " ".join(journal.damage())
    assert "row 1: cannot be read" in told


def test_rows_of_an_unreadable_page_are_named_once_each(whole, folder) -> None:
    place = copied(whole, folder / "scan")
    raw, begin, size, count = table_of(place)
    # An interior page has kind 5; each of its cells begins with the number of a page.
    assert raw[begin] == 5
    (cell,) = struct.unpack_from(">H", raw, begin + 12)
    (first,) = struct.unpack_from(">I", raw, begin + cell)
    raw[(first - 1) * size] = 0xFF
    (place / FILE_NAME).write_bytes(raw)
    with Journal.read(place) as journal:
        told = [line.partition(": ") for line in journal.damage()]
    rows = [int(name.removeprefix("row ")) for name, _, _ in told]
    assert {reason for _, _, reason in told} == {"cannot be read"}
    assert rows == [*range(1, len(rows) + 1)]
    assert 1 < len(rows) < count


def last_leaf(place: Path) -> tuple[bytearray, int, int]:
    """Return the file, the start of the last page of samples, and their number."""
    raw, begin, size, count = table_of(place)
    # An interior page ends with the number of its last page.
    (last,) = struct.unpack_from(">I", raw, begin + 8)
    return raw, (last - 1) * size, count


def test_rows_lost_at_the_end_are_named(whole, folder) -> None:
    place = copied(whole, folder / "scan")
    raw, begin, count = last_leaf(place)
    (cells,) = struct.unpack_from(">H", raw, begin + 3)
    struct.pack_into(">H", raw, begin + 3, cells - 2)
    (place / FILE_NAME).write_bytes(raw)
    with Journal.read(place) as journal:
        told = journal.damage()
    assert told == [f"row {number}: not there" for number in (count - 1, count)]


def test_a_row_out_of_order_is_named(whole, folder) -> None:
    place = copied(whole, folder / "scan")
    raw, begin, count = last_leaf(place)
    (cells,) = struct.unpack_from(">H", raw, begin + 3)
    (cell,) = struct.unpack_from(">H", raw, begin + 8 + 2 * (cells - 1))
    # A cell begins with its length (two bytes here) and the number of the row.
    assert raw[begin + cell] & 0x80
    assert raw[begin + cell + 2] == count
    raw[begin + cell + 2] = count - 5
    (place / FILE_NAME).write_bytes(raw)
    with Journal.read(place) as journal:
        told = journal.damage()
    assert told == [
        f"row {count - 5}: out of order, after row {count - 1}",
        f"row {count}: not there",
    ]


# -- many of them ----------------------------------------------------------------------


def _values(cube) -> dict[str, np.ndarray]:
    return {name: cube[name].values for name in OWN}


def campaign(whole: Path, folder: Path, seeds: range) -> dict[str, float]:
    """Damage a journal many times; return how often it ended in which way.

    Also the processor time of the slowest [s], and the memory that was added [bytes].
    """
    with Journal.read(whole) as journal:
        reference = _values(acquisition.build(journal))
        dark = dict(journal.samples("dark"))
    counts = {"sound": 0, "named": 0}
    refusals: list[tuple[int, str, str]] = []
    slowest, before = 0.0, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for seed in seeds:
        place = copied(whole, folder / "scan")
        done = damage(place, seed)
        begun = time.process_time()
        try:
            with Journal.read(place) as journal:
                cube = acquisition.build(journal)
                lines = journal.damage()
                found = dict(journal.samples("dark"))
        except AmulorError as error:
            refusals.append((seed, done, str(error)))
            continue
        finally:
            slowest = max(slowest, time.process_time() - begun)
        assert all("\n" not in line for line in lines), (seed, done)
        for name, values in _values(cube).items():
            there = np.isfinite(values)
            # Nothing is another number than it was; what is not there is named.
            same = values[there] == reference[name][there]
            if found == dark:
                assert same.all(), (seed, done, name)
            assert there.all() or lines, (seed, done, name)
        assert all(dark.get(key) == record for key, record in found.items()), seed
        assert lines or found == dark, (seed, done)
        counts["named" if lines else "sound"] += 1
    assert not [one for one in refusals if "\n" in one[2]]
    # No hang: of the processor, since others may use it as well.
    assert slowest < 5.0
    grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    assert grown < MOST_MEMORY
    return {**counts, "refused": len(refusals), "slowest": slowest, "memory": grown}


def test_damage_is_named_or_refused_in_one_line(whole, folder) -> None:
    counts = campaign(whole, folder, range(40))
    assert counts["named"] > 8
    assert counts["refused"] > 3


@pytest.mark.study
def test_many_damaged_journals_change_no_number(whole, folder) -> None:
    many = int(os.environ.get("AMULOR_FUZZ", "10000"))
    begun, before = time.monotonic(), time.process_time()
    counts = campaign(whole, folder, range(10_000, 10_000 + many))
    print(counts)
    keep(
        "fuzzing", reader="journal", way="by format", cases=many,
        refused=counts["refused"], tracebacks=0, hangs=0, slowest_s=counts["slowest"],
        highest_mb=counts["memory"] / 1e6, minutes=(time.monotonic() - begun) / 60,
        processor_minutes=(time.process_time() - before) / 60,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("statements", "text"),
    [
        (["DROP TABLE samples"], r"lacks the table of its samples; it is damaged"),
        (["DROP TABLE meta"], "no such table: meta; it is damaged"),
        (["DROP TABLE segments"], "no such table: segments; it is damaged"),
        (
            ["DROP TABLE samples", "CREATE TABLE samples (number INTEGER, row TEXT)"],
            "lacks the columns analyser|lacks the columns azimuth, column",
        ),
    ],
)
def test_a_journal_without_its_tables_is_refused(
    whole, folder, statements, text
) -> None:
    place = copied(whole, folder / "scan")
    connection = sqlite3.connect(place / FILE_NAME, isolation_level=None)
    for statement in statements:
        connection.execute(statement)
    connection.close()
    with pytest.raises(FormatError, match=text) as raised:
        acquisition.recover(place)
    assert "\n" not in str(raised.value)
    assert "take a copy of the folder" in str(raised.value)


def test_of_many_damaged_rows_some_are_named_and_all_are_counted(whole, folder) -> None:
    place = copied(whole, folder / "scan")
    connection = sqlite3.connect(place / FILE_NAME, isolation_level=None)
    (count,) = connection.execute("SELECT COUNT(*) FROM samples").fetchone()
    connection.execute("UPDATE samples SET quadrature = 1 WHERE number > 10")
    connection.close()
    lines: list[str] = []
    acquisition.recover(place, told=lines.append)
    assert len(lines) == 21
    assert lines[0].endswith("row 11: its checksum is that of other numbers")
    assert lines[-1] == f"{place}: and {count - 30} more rows like these"


def test_a_journal_of_damaged_rows_only_is_not_called_empty(whole, folder) -> None:
    place = copied(whole, folder / "scan")
    connection = sqlite3.connect(place / FILE_NAME, isolation_level=None)
    connection.execute("UPDATE samples SET quadrature = 1")
    (count,) = connection.execute("SELECT COUNT(*) FROM samples").fetchone()
    connection.close()
    expected = f"the first of {count} errors is: row 1: its checksum"
    with pytest.raises(CubeError, match=expected) as raised:
        acquisition.recover(place)
    assert "take a copy" in str(raised.value)
    assert "--resume" not in str(raised.value)


def test_a_locked_journal_names_the_program_and_not_the_disk(
    whole, folder, monkeypatch
) -> None:
    place = copied(whole, folder / "scan")
    monkeypatch.setattr(journal_file, "_PATIENCE", 0.01)
    other = sqlite3.connect(place / FILE_NAME, isolation_level=None)
    with Journal.read(place) as journal:
        key, record = next(journal.samples(SCAN))
        meta = journal.meta()
    with Journal.resume(place, meta=meta) as journal:
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(FormatError, match="another program has it open") as raised:
            journal.commit(key._replace(repeat=1), record)
        other.execute("ROLLBACK")
    other.close()
    assert "space" not in str(raised.value)


@pytest.mark.parametrize("count", [1, 3, 4, 12])
def test_a_scan_on_a_damaged_journal_names_three_places(
    whole, folder, monkeypatch, count
) -> None:
    place = copied(whole, folder / "scan")
    damage = tuple(f"row {number}" for number in range(count))
    with Journal.read(place) as journal:
        monkeypatch.setattr(Journal, "damage", lambda _: damage)
        with pytest.raises(FormatError) as raised:
            journal._refuse_damaged()
    named = "; ".join(damage[:3])
    more = f", and {count - 3} more" if count > 3 else ""
    assert f"is damaged ({named}{more}) and cannot be gone on with" in str(raised.value)
