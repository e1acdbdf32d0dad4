"""Damages the journal of a finished scan, one thing at a time, by a seed."""

from __future__ import annotations

import contextlib
import random
import shutil
import sqlite3
import struct
from pathlib import Path

from amulor.acquisition.journal.file import FILE_NAME

NUMBERS = (
    "row", "column", "frequency", "repeat", "in_phase", "quadrature", "mean",
    "readings", "full_scale", "flags", "commanded_azimuth", "commanded_elevation",
    "azimuth", "elevation", "modulation_frequency", "elapsed", "segment", "interval",
)  # fmt: skip
VALUES = (
    -1, 0, 1, 2, 99, 30_000_000, 2**62, -(2**63), 1e308, -1e308, 5e-324, float("inf"),
    -float("inf"), 1e-3, "text", "", b"\x00\xff", None, 39e6,
)  # fmt: skip
KEYS = (
    "survey", "survey_digest", "devices", "identities", "instrument_digest",
    "journal_schema", "checksums",
)  # fmt: skip


def copied(whole: Path, place: Path) -> Path:
    """Return a copy of a folder, its journal in one file."""
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(whole, place)
    for name in ("cube.nc", f"{FILE_NAME}-wal", f"{FILE_NAME}-shm", "writer.lock"):
        (place / name).unlink(missing_ok=True)
    return place


def damage(place: Path, seed: int) -> str:
    """Damage the journal of a folder, and return what was done."""
    rng = random.Random(seed)
    ways = [_value, _value, _flipped_bit, _text, _row_gone, _row_twice, _meta, _bytes,
            _cut, _copies]  # fmt: skip
    return rng.choice(ways)(place, rng)


def _open(place: Path) -> sqlite3.Connection:
    return sqlite3.connect(place / FILE_NAME, isolation_level=None)


def _some(connection: sqlite3.Connection, rng: random.Random) -> int:
    ((count,),) = connection.execute("SELECT COUNT(*) FROM samples")
    return rng.randint(1, count)


def _value(place: Path, rng: random.Random) -> str:
    connection = _open(place)
    name, value, number = (
        rng.choice(NUMBERS),
        rng.choice(VALUES),
        _some(connection, rng),
    )
    with contextlib.suppress(sqlite3.IntegrityError):  # SQLite refuses it itself
        connection.execute(
            f"UPDATE samples SET {name} = ? WHERE number = ?", (value, number)
        )
    connection.close()
    return f"{name} = {value!r} in row {number}"


def _flipped_bit(place: Path, rng: random.Random) -> str:
    connection = _open(place)
    name, number = rng.choice(NUMBERS), _some(connection, rng)
    ((before,),) = connection.execute(
        f"SELECT {name} FROM samples WHERE number = ?", (number,)
    )
    if isinstance(before, float):
        (whole,) = struct.unpack("<q", struct.pack("<d", before))
        flipped = struct.pack("<q", whole ^ (1 << rng.randrange(63)))
        (after,) = struct.unpack("<d", flipped)
    else:
        after = (before or 0) ^ (1 << rng.randrange(31))
    with contextlib.suppress(sqlite3.IntegrityError):  # SQLite refuses it itself
        connection.execute(
            f"UPDATE samples SET {name} = ? WHERE number = ?", (after, number)
        )
    connection.close()
    return f"a bit of {name} in row {number}: {before!r} -> {after!r}"


def _text(place: Path, rng: random.Random) -> str:
    connection = _open(place)
    name, number = rng.choice(("kind", "polarization")), _some(connection, rng)
    raw = rng.choice(("'VX'", "'scan'", "CAST(x'ff56' AS TEXT)", "''", "x'00'", "7"))
    with contextlib.suppress(sqlite3.IntegrityError):  # SQLite refuses it itself
        connection.execute(f"UPDATE samples SET {name} = {raw} WHERE number = {number}")
    connection.close()
    return f"{name} = {raw} in row {number}"


def _row_gone(place: Path, rng: random.Random) -> str:
    connection = _open(place)
    number = _some(connection, rng)
    connection.execute("DELETE FROM samples WHERE number = ?", (number,))
    connection.close()
    return f"row {number} deleted"


def _row_twice(place: Path, rng: random.Random) -> str:
    connection = _open(place)
    first, second = _some(connection, rng), _some(connection, rng)
    names = ", ".join(NUMBERS[4:8])
    connection.execute(
        f"UPDATE samples SET ({names}) = (SELECT {names} FROM samples WHERE "
        f"number = {first}) WHERE number = {second}"
    )
    connection.close()
    return f"numbers of row {first} in row {second}"


def _meta(place: Path, rng: random.Random) -> str:
    connection = _open(place)
    name = rng.choice(KEYS)
    ((text,),) = connection.execute("SELECT value FROM meta WHERE key = ?", (name,))
    at = rng.randrange(len(text))
    new = rng.choice((text[:at], text[:at] + rng.choice("0159xé\n]") + text[at + 1 :],
                      "", None, b"\xff\xfe", "{}", "[]", text + text))  # fmt: skip
    connection.execute("UPDATE meta SET value = ? WHERE key = ?", (new, name))
    if rng.random() < 0.2:
        connection.execute("DELETE FROM meta WHERE key = ?", (name,))
    connection.close()
    return f"{name} of the description -> {str(new)[:30]!r}"


def _bytes(place: Path, rng: random.Random) -> str:
    path = place / FILE_NAME
    content = bytearray(path.read_bytes())
    many = rng.choice((1, 1, 4, 64, 4096))
    at = rng.randrange(max(len(content) - many, 1))
    for offset in range(many):
        content[at + offset] = rng.randrange(256)
    path.write_bytes(content)
    return f"{many} bytes at {at}"


def _cut(place: Path, rng: random.Random) -> str:
    path = place / FILE_NAME
    content = path.read_bytes()
    path.write_bytes(content[: rng.randrange(len(content))])
    return f"cut from {len(content)} bytes"


def _copies(place: Path, rng: random.Random) -> str:
    path = place / rng.choice(("survey.toml", "devices.toml"))
    path.write_bytes(path.read_bytes()[: rng.randrange(100)] + b"\xff")
    return f"{path.name} damaged, and {_meta(place, rng)}"
