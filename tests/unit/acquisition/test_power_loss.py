"""A file layer that forgets unsynchronised writes, over every write of a journal.

SQLite is given a virtual file system whose writes, truncations and synchronisations
are logged. After each of them the power may go: then every file holds what was
synchronised, and of later writes none, some, or a torn one. Each such folder must hold
all samples that had been acknowledged, none that had not been begun, and be resumable.
"""

from __future__ import annotations

import _sqlite3
import ctypes
import ctypes.util
import random
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import SCAN, Key

META = {"survey_digest": "1", "instrument_digest": "2", "identities": "{}"}
RECORD = Record(
    in_phase=1e-3, quadrature=-2e-3, mean=None, readings=1, full_scale=1.0, flags=0,
    commanded_azimuth=0.0, commanded_elevation=0.0, azimuth=0.0, elevation=0.0,
    modulation_frequency=39e6, elapsed=0.0, segment=1,
)  # fmt: skip
SECTOR = 512
POINTER = ctypes.c_void_p
OPEN = ctypes.CFUNCTYPE(
    ctypes.c_int, POINTER, ctypes.c_char_p, POINTER, ctypes.c_int, POINTER
)
DELETE = ctypes.CFUNCTYPE(ctypes.c_int, POINTER, ctypes.c_char_p, ctypes.c_int)
WRITE = ctypes.CFUNCTYPE(ctypes.c_int, POINTER, POINTER, ctypes.c_int, ctypes.c_int64)
TRUNCATE = ctypes.CFUNCTYPE(ctypes.c_int, POINTER, ctypes.c_int64)
SYNC = ctypes.CFUNCTYPE(ctypes.c_int, POINTER, ctypes.c_int)


class Vfs(ctypes.Structure):
    """`sqlite3_vfs`, as far as it is changed here."""


Vfs._fields_ = [
    ("version", ctypes.c_int), ("file_size", ctypes.c_int),
    ("longest_path", ctypes.c_int), ("next", POINTER), ("name", ctypes.c_char_p),
    ("data", POINTER), ("open", POINTER), ("delete", POINTER),
    ("others", POINTER * 14),
]  # fmt: skip


class Methods(ctypes.Structure):
    """`sqlite3_io_methods`, as far as it is changed here."""

    _fields_ = (
        ("version", ctypes.c_int), ("close", POINTER), ("read", POINTER),
        ("write", POINTER), ("truncate", POINTER), ("sync", POINTER),
        ("others", POINTER * 13),
    )  # fmt: skip


def library() -> ctypes.CDLL | None:
    """Return the SQLite that Python itself uses, if it is a library of its own."""
    name = ctypes.util.find_library("sqlite3")
    if name is None:
        return None
    found = ctypes.CDLL(name)
    found.sqlite3_libversion.restype = ctypes.c_char_p
    same = found.sqlite3_libversion().decode() == sqlite3.sqlite_version
    return found if same and _sqlite3.__file__ else None


@contextmanager
def logged(sqlite: ctypes.CDLL) -> Iterator[list[tuple]]:
    """Log what SQLite does to its files."""
    log: list[tuple] = []
    names: dict[int, str] = {}
    kept: list[object] = []
    sqlite.sqlite3_vfs_find.restype = ctypes.POINTER(Vfs)
    original = sqlite.sqlite3_vfs_find(None)
    first = original.contents
    real_open, real_delete = OPEN(first.open), DELETE(first.delete)

    def opened(vfs, path, file, flags, out):
        code = real_open(ctypes.addressof(first), path, file, flags, out)
        place = POINTER.from_address(file)
        if code != 0 or not place.value:
            return code
        names[file] = Path(path.decode()).name if path else ""
        methods = Methods.from_buffer_copy(Methods.from_address(place.value))
        write, truncate = WRITE(methods.write), TRUNCATE(methods.truncate)
        sync = SYNC(methods.sync)

        def on_write(handle, data, size, offset):
            log.append(("write", names[handle], offset, ctypes.string_at(data, size)))
            return write(handle, data, size, offset)

        def on_truncate(handle, size):
            log.append(("truncate", names[handle], size))
            return truncate(handle, size)

        def on_sync(handle, flags):
            code = sync(handle, flags)
            log.append(("sync", names[handle]))
            return code

        callbacks = WRITE(on_write), TRUNCATE(on_truncate), SYNC(on_sync)
        for name, callback in zip(
            ("write", "truncate", "sync"), callbacks, strict=True
        ):
            setattr(methods, name, ctypes.cast(callback, POINTER).value)
        kept.extend([methods, callbacks, write, truncate, sync])
        place.value = ctypes.addressof(methods)
        return code

    def deleted(vfs, path, durable):
        log.append(("delete", Path(path.decode()).name))
        return real_delete(ctypes.addressof(first), path, durable)

    shim = Vfs.from_buffer_copy(first)
    shim.name, shim.next = b"logged", None
    callbacks = OPEN(opened), DELETE(deleted)
    shim.open = ctypes.cast(callbacks[0], POINTER).value
    shim.delete = ctypes.cast(callbacks[1], POINTER).value
    assert sqlite.sqlite3_vfs_register(ctypes.byref(shim), 1) == 0
    try:
        yield log
    finally:
        sqlite.sqlite3_vfs_unregister(ctypes.byref(shim))
        sqlite.sqlite3_vfs_register(original, 1)
        kept.append(callbacks)


class Disk:
    """Files as a loss of power leaves them: what is durable, and what is not yet."""

    def __init__(self, files: dict[str, bytes]) -> None:
        self.durable = {name: bytearray(content) for name, content in files.items()}
        self.pending: list[tuple] = []

    def take(self, entry: tuple) -> None:
        kind, name = entry[0], entry[1]
        if kind == "sync":
            for one in self.pending:
                if one[1] == name:
                    apply(self.durable, one)
            self.pending = [one for one in self.pending if one[1] != name]
        else:
            self.pending.append(entry)

    def left(self, survivors: list[tuple]) -> dict[str, bytes]:
        files = {name: bytearray(content) for name, content in self.durable.items()}
        for one in survivors:
            apply(files, one)
        return {name: bytes(content) for name, content in files.items()}


def apply(files: dict[str, bytearray], entry: tuple) -> None:
    kind, name = entry[0], entry[1]
    if kind == "delete":
        files.pop(name, None)
        return
    content = files.setdefault(name, bytearray())
    if kind == "truncate":
        del content[entry[2] :]
        return
    offset, data = entry[2], entry[3]
    content.extend(bytes(max(0, offset + len(data) - len(content))))
    content[offset : offset + len(data)] = data


def torn(entry: tuple) -> tuple:
    """Return a write of which the disk finished a part of its sectors only."""
    if entry[0] != "write" or len(entry[3]) <= SECTOR:
        return entry
    return (*entry[:3], entry[3][: len(entry[3]) // 2 // SECTOR * SECTOR or SECTOR])


def check(place: Path, files: dict[str, bytes], sure: int, begun: int) -> None:
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    for name, content in files.items():
        (place / name).write_bytes(content)
    with Journal.resume(place, meta=META) as journal:
        found = {key.column for key in journal.keys()}  # noqa: SIM118
        assert found in ({*range(sure)}, {*range(begun)}), (sure, begun, sorted(found))
        whole = journal._connection.execute("PRAGMA integrity_check").fetchone()
        assert whole == ("ok",)
        journal.commit(Key(SCAN, 1, 0, 39e6, "VV", 0), RECORD)


@pytest.mark.parametrize("together", [1, 3])
def test_an_acknowledged_sample_survives_a_loss_of_power_at_every_write(
    folder, together
) -> None:
    sqlite = library()
    if sqlite is None:
        pytest.skip(
            "Python has SQLite built in here, and none to be given a file layer"
        )
    home, place, total = folder / "scan", folder / "after", 24
    home.mkdir()
    Journal.create(home, meta=META).close()
    disk = Disk({FILE_NAME: (home / FILE_NAME).read_bytes()})
    with logged(sqlite) as log, Journal.resume(home, meta=META) as journal:
        # Every few samples the log is folded into the file: boundaries of each kind.
        journal._connection.execute("PRAGMA wal_autocheckpoint = 6")
        for number in range(0, total, together):
            # Those of one dwell are there together, or none of them is.
            log.append(("begin", number + together - 1))
            dwell = [
                (Key(SCAN, 0, number + more, 39e6, "VV", 0), RECORD)
                for more in range(together)
            ]
            journal.commit_together(dwell)
            log.append(("acknowledged", number + together - 1))
    of_the_scan = {FILE_NAME, f"{FILE_NAME}-wal"}
    entries = [
        entry
        for entry in log
        if entry[0] in ("begin", "acknowledged") or entry[1] in of_the_scan
    ]
    kinds = {(entry[0], entry[1]) for entry in entries}
    # The layer is in force: log and file were both written and synchronised.
    for name in of_the_scan:
        assert {("write", name), ("sync", name)} <= kinds
    rng = random.Random(1)
    sure = begun = boundaries = 0
    for entry in entries:
        if entry[0] == "begin":
            begun = entry[1] + 1
            continue
        if entry[0] == "acknowledged":
            sure = entry[1] + 1
        else:
            disk.take(entry)
        boundaries += 1
        some = [one for one in disk.pending if rng.random() < 0.5]
        check(place, disk.left([]), sure, begun)
        check(place, disk.left(some), sure, begun)
        if disk.pending:
            last = [*disk.pending[:-1], torn(disk.pending[-1])]
            check(place, disk.left(last), sure, begun)
    assert sure == begun == total
    assert boundaries > 4 * total // together
    shutil.rmtree(place)
