"""Journals of an older amulor are read and gone on with, as they are."""

from __future__ import annotations

import dataclasses
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from amulor import acquisition
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import SCAN, Key
from amulor.acquisition.settings import Settings
from amulor.errors import InstrumentError
from amulor.simulation import scene_light

#: The tables of the first version, as it made them.
OLD = (
    "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT)",
    "CREATE TABLE samples (number INTEGER PRIMARY KEY, kind TEXT NOT NULL, row INTEGER "
    "NOT NULL, column INTEGER NOT NULL, frequency REAL NOT NULL, polarization TEXT NOT "
    "NULL, repeat INTEGER NOT NULL, in_phase REAL NOT NULL, quadrature REAL NOT NULL, "
    "mean REAL, readings INTEGER NOT NULL, full_scale REAL NOT NULL, flags INTEGER NOT "
    "NULL, commanded_azimuth REAL NOT NULL, commanded_elevation REAL NOT NULL, azimuth "
    "REAL NOT NULL, elevation REAL NOT NULL, modulation_frequency REAL NOT NULL, "
    "elapsed REAL NOT NULL, segment INTEGER NOT NULL, UNIQUE (kind, row, column, "
    "frequency, polarization, repeat))",
    "CREATE TABLE segments (number INTEGER PRIMARY KEY, started TEXT, ended TEXT, "
    "reason TEXT)",
)
VALUES = (
    "scan", 0, 1, 39e6, "VH", 0, 1e-3, -2e-3, None, 8, 1.0, 0, 0.1, -0.1, 0.1000001,
    -0.1000001, 39e6, 1.5, 1,
)  # fmt: skip


def older(folder: Path, meta: dict[str, str], rows: list[tuple]) -> Path:
    """Write a journal as the first version did."""
    connection = sqlite3.connect(folder / FILE_NAME)
    for statement in OLD:
        connection.execute(statement)
    content = {**meta, "journal_schema": "1"}
    content.pop("checksums", None)
    connection.executemany("INSERT INTO meta VALUES (?, ?)", content.items())
    connection.execute("INSERT INTO segments (started) VALUES ('2026-01-01')")
    places = ", ".join("?" * (len(VALUES) + 1))
    connection.executemany(
        f"INSERT INTO samples VALUES ({places})",
        [(number, *row) for number, row in enumerate(rows, start=1)],
    )
    connection.commit()
    connection.close()
    return folder


def test_an_older_journal_is_read_as_it_is(folder) -> None:
    older(folder, {}, [VALUES])
    before = (folder / FILE_NAME).read_bytes()
    with Journal.read(folder) as journal:
        ((key, record),) = journal.samples(SCAN)
    assert key == Key("scan", 0, 1, 39e6, "VH", 0)
    assert (record.in_phase, record.elapsed) == (1e-3, 1.5)
    assert record.launch is record.analyser is record.target is None
    assert (folder / FILE_NAME).read_bytes() == before


def test_an_older_journal_is_gone_on_with(folder) -> None:
    older(folder, {}, [VALUES])
    record = Record(**dict(zip(
        [field.name for field in dataclasses.fields(Record)], VALUES[6:], strict=False
    )))  # fmt: skip
    with Journal.resume(folder, meta={}) as journal:
        journal.commit(
            Key("scan", 0, 2, 39e6, "VH", 0),
            dataclasses.replace(record, analyser=0.5, target=0.2),
        )
    with Journal.resume(folder, meta={}) as journal:  # the columns are there now
        first, second = [*journal.samples(SCAN)]
    assert first[1] == record
    assert (second[1].analyser, second[1].target) == (0.5, 0.2)
    assert second[1].launch is None
    # The older amulor names its columns, and can go on with it in turn.
    connection = sqlite3.connect(folder / FILE_NAME)
    names = [row[1] for row in connection.execute("PRAGMA table_info(samples)")][1:20]
    connection.execute(
        f"INSERT INTO samples ({', '.join(names)}) VALUES "
        f"({', '.join('?' * len(names))})",
        ("scan", 0, 3, *VALUES[3:]),
    )
    connection.close()


def test_a_scan_that_an_older_amulor_began_is_finished(small, folder) -> None:
    settings = Settings.model_validate({"procedure": {"dark_readings": 2}})
    now = folder / "now"
    acquisition.acquire(small, now, settings=settings, scene=scene_light)
    names = ", ".join(
        [*Key._fields, *[field.name for field in dataclasses.fields(Record)][:13]]
    )
    with Journal.read(now) as journal:
        meta = journal.meta()
        rows = journal._connection.execute(f"SELECT {names} FROM samples").fetchall()
    meta.pop("journal_schema")
    begun = folder / "then"
    begun.mkdir()
    older(begun, meta, rows[:20])
    outcome = acquisition.acquire(
        small, begun, settings=settings, scene=scene_light, resume=True
    )
    assert outcome.finished
    with Journal.read(begun) as journal:
        cube = acquisition.build(journal)
        scan = [*journal.samples(SCAN)]
    known = [record for _, record in scan if record.analyser is not None]
    assert 0 < len(known) < len(scan)
    # What was taken since says how the mounts stood.
    assert np.nanmax(np.abs(cube["user_analyser_angle"].sel(polarization="VH"))) == (
        pytest.approx(np.pi / 2)
    )


def test_where_mounts_and_target_stand_is_in_the_cube(small, folder, cube_of) -> None:
    acquisition.acquire(small, folder, scene=scene_light)
    with Journal.read(folder) as journal:
        out = {record.target for _, record in journal.samples("open_water")}
        within = {record.target for _, record in journal.samples(SCAN)}
    assert out == {0.2}
    assert within == {0.0}
    cube = cube_of(folder)
    assert (cube["user_target_position"] == 0).all()
    angles = cube["user_analyser_angle"].max(("modulation_frequency", "row", "column"))
    assert angles.values.tolist() == [0.0, pytest.approx(np.pi / 2)]
    assert cube["user_launch_angle"].attrs["units"] == "rad"


def test_a_mount_that_stands_elsewhere_ends_the_scan(
    small, folder, monkeypatch
) -> None:
    monkeypatch.setattr(
        "amulor.acquisition.simulated.devices.SimulatedMount.rotate",
        lambda self, angle, *, timeout: angle + 0.01,
    )
    with pytest.raises(InstrumentError, match=r"stands at .* degrees and was sent to"):
        acquisition.acquire(small, folder, scene=scene_light)
