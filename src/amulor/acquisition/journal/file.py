"""Journal file: metadata of the scan, checksums, locks and access."""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from amulor import cube
from amulor.errors import FormatError
from amulor.io.files import synchronise_folder

#: Entry with the checksums of all others.
CHECKSUMS = "checksums"
#: Copies beside a journal, by entry.
_COPIES = {"survey": "survey.toml", "devices": "devices.toml"}


def with_checksums(meta: Mapping[str, str]) -> dict[str, str]:
    """Return the metadata entries of a scan with their checksums added."""
    entries = {name: text for name, text in meta.items() if name != CHECKSUMS}
    sums = {name: _sum(text) for name, text in entries.items()}
    return {**entries, CHECKSUMS: json.dumps(sums, sort_keys=True)}


def _sum(text: str) -> int:
    return zlib.crc32(text.encode("utf-8", "replace"))


def checked(
    meta: Mapping[str, str], folder: Path, damaged: Callable[[str], None]
) -> dict[str, str]:
    """Verify the checksums of entries; replace damaged ones by copies in the folder."""
    sums = _sums(meta, damaged)
    result = dict(meta)
    for name in sorted({*sums, *_digests(meta)}):
        if name in meta and _as_written(name, meta[name], meta, sums):
            continue
        copy = _copy(folder, name)
        if copy is not None and _as_written(name, copy, meta, sums):
            damaged(f"{name} is damaged; that of {_COPIES[name]} was taken")
            result[name] = copy
            continue
        if name in _COPIES:
            raise FormatError(
                f"{folder}: the {name} in the journal is not what the scan was begun "
                f"with (its checksum or digest is another one), and there is no "
                f"{_COPIES[name]} that is; put a copy of that file there"
            )
        damaged(f"{name} of the description is damaged")
    return result


def _sums(meta: Mapping[str, str], damaged: Callable[[str], None]) -> dict[str, int]:
    if CHECKSUMS not in meta:
        return {}
    try:
        content = json.loads(meta[CHECKSUMS])
        return {str(name): int(value) for name, value in content.items()}
    except (ValueError, TypeError, AttributeError):
        damaged("the checksums of the description are damaged")
        return {}


def _digests(meta: Mapping[str, str]) -> tuple[str, ...]:
    return ("survey",) if {"survey", "survey_digest"} <= {*meta} else ()


def _as_written(
    name: str, text: str, meta: Mapping[str, str], sums: Mapping[str, int]
) -> bool:
    if name in sums and _sum(text) != sums[name]:
        return False
    return name not in _digests(meta) or cube.digest(text) == meta["survey_digest"]


def _copy(folder: Path, name: str) -> str | None:
    if name not in _COPIES:
        return None
    try:
        return (folder / _COPIES[name]).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None


FILE_NAME = "journal.sqlite"
_LOCK_NAME = "writer.lock"
#: Longest wait for the lock of another program [s].
_PATIENCE = 10.0
#: Longest wait between two programs that lock at the same moment [s].
_AT_ONCE = 0.25


def claimed(folder: Path) -> sqlite3.Connection:
    """Lock the journal of a folder for writing."""
    path = folder / _LOCK_NAME
    lock = None
    try:
        lock = sqlite3.connect(path, isolation_level=None, timeout=_AT_ONCE)
        lock.execute("BEGIN EXCLUSIVE")
    except sqlite3.Error as error:
        if lock is not None:
            lock.close()
        if "locked" in str(error):
            raise FormatError(
                f"{folder} is written to by another program; wait for it, or stop it"
            ) from None
        raise FormatError(
            f"{path} cannot be written: {error}; check the permissions of the folder "
            "and the space on its disk"
        ) from error
    return lock


def in_use(folder: Path) -> bool:
    """Return whether a program has locked the journal of a folder for writing."""
    path = folder / _LOCK_NAME
    if not path.exists():
        return False
    address = f"{path.resolve().as_uri()}?mode=ro"
    try:
        with contextlib.closing(sqlite3.connect(address, uri=True, timeout=0)) as lock:
            # An exclusive lock keeps readers out, too.
            lock.execute("SELECT 1 FROM sqlite_master").fetchall()
    except sqlite3.Error:
        return True
    return False


def make(path: Path, *, tables: Sequence[str], meta: Mapping[str, str]) -> None:
    """Create the journal file under a temporary name, then rename it."""
    draft = path.with_name(f".{path.name}.new")
    with explained(path):
        try:
            draft.unlink(missing_ok=True)
            connection = sqlite3.connect(draft, isolation_level=None)
            with contextlib.closing(connection):
                connection.execute("PRAGMA synchronous = FULL")
                connection.execute("BEGIN")
                for statement in tables:
                    connection.execute(statement)
                connection.executemany("INSERT INTO meta VALUES (?, ?)", meta.items())
                connection.execute("COMMIT")
            os.replace(draft, path)
        except BaseException:
            with contextlib.suppress(OSError):
                draft.unlink(missing_ok=True)
            raise
        # A new name survives a loss of power once its folder is flushed, and so does a
        # new folder.
        for folder in (path.parent, path.parent.resolve().parent):
            synchronise_folder(folder)


def writer(path: Path) -> sqlite3.Connection:
    """Open the journal file for writing; commits survive a loss of power."""
    with explained(path):
        # One thread at a time writes: the thread of the scan, or its commit thread.
        connection = sqlite3.connect(
            path, isolation_level=None, timeout=_PATIENCE, check_same_thread=False
        )
        try:
            (mode,) = connection.execute("PRAGMA journal_mode = WAL").fetchone()
            if mode != "wal":  # some file systems of networks cannot do it
                raise sqlite3.OperationalError(
                    "a reader would block the writer here; take a disk of this computer"
                )
            connection.execute("PRAGMA synchronous = FULL")
            connection.text_factory = text_of
        except BaseException:
            connection.close()
            raise
        return connection


def text_of(content: bytes) -> str:
    """Decode text from a journal; damaged bytes become replacement characters."""
    return content.decode("utf-8", "replace")


def reader(path: Path) -> sqlite3.Connection:
    """Open the journal file for reading, also while a scan writes to it."""
    with explained(path):
        # One thread at a time reads; a page continues with the connection of its
        # command.
        connection = sqlite3.connect(
            path, isolation_level=None, timeout=_PATIENCE, check_same_thread=False
        )
        connection.text_factory = text_of
        connection.execute("PRAGMA query_only = ON")
        return connection


@contextlib.contextmanager
def explained(path: Path) -> Iterator[None]:
    """Convert errors of SQLite and the operating system to FormatErrors with advice."""
    try:
        yield
    except sqlite3.IntegrityError as error:
        raise FormatError(
            f"{path}: this sample is there already, or incomplete ({error}); nothing "
            "was changed"
        ) from error
    except (sqlite3.Error, OSError, UnicodeDecodeError) as error:
        # SQLite quotes a damaged schema with its line breaks, or fails to decode it.
        words = " ".join(str(error).split())
        raise FormatError(
            f"{path} cannot be used: {words}; {_advice(error)}"
        ) from error


def _advice(error: Exception) -> str:
    if isinstance(error, sqlite3.ProgrammingError | sqlite3.InterfaceError):
        return "this is a mistake of amulor, the journal is not affected; report it"
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    damaged = isinstance(error, UnicodeDecodeError) or "no such" in str(error)
    if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return (
            "another program has it open and locks it; close that program and repeat "
            "the command, what was acknowledged before is kept"
        )
    if damaged or code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
        return "it is damaged, take a copy of the folder before anything else"
    if code in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM):
        return (
            "check permissions; what lies on a medium that cannot be written must be "
            "copied to one that can, as a whole folder"
        )
    return (
        "free some space, check permissions and disk; what was acknowledged before is "
        "kept"
    )
