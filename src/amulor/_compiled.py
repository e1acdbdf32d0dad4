"""numba for the loops of this package: compiled code on disk is never stale.

Files with compiled loops take numba from here. On disk numba keeps a compiled function
until its own file changes, and does not see a change in another file whose functions,
or constants, were compiled into it. Here the name under which a function is stored
holds a digest of its file and of all that the file imports from the package::

    from amulor._compiled import numba

Where numba finds no folder for its files they go into a temporary one of the user.
"""

from __future__ import annotations

import atexit
import hashlib
import logging
import os
import re
import shutil
import stat
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import caching, event
from numba.core.dispatcher import Dispatcher

from amulor import _progress

__all__ = ["keep_fresh", "numba"]

#: Without a handler Python writes warnings to standard error, one line each.
_LOG = logging.getLogger("amulor")
_KEPT = (
    "amulor: %s: compiled code is kept in %s until that is emptied; set "
    "NUMBA_CACHE_DIR to a folder that lasts"
)
_NOT_KEPT = (
    "amulor: %s: compiled code is not kept, each command compiles anew; set "
    "NUMBA_CACHE_DIR to a folder that lasts"
)
_FORM = rb"(?:from ([\w.]+) import (\([^)]*\)|[^\n]*)|import ([\w.]+))"
_IMPORT = re.compile(rb"^" + _FORM, re.MULTILINE)
#: Those that a package makes for types, too, and when it is asked for a name.
_ANY_IMPORT = re.compile(rb"^[ \t]*" + _FORM, re.MULTILINE)
#: What was read of each file and its digest, and the import at which it was.
_read: dict[Path, tuple[object, bytes, bytes]] = {}
#: The digest of a file and of all behind it, and the import at which it was taken.
_digests: dict[Path, tuple[object, str]] = {}


def keep_fresh(package: Path) -> None:
    """Let numba look at all sources that a function of a package is compiled from.

    To be called before the functions are decorated with `numba.njit(cache=True)`.
    Functions of other packages are stored as numba does it. What is stored of former
    sources is removed when the function is compiled anew.
    """
    # Before version 0.61 of numba the class had a private name; a numba that has
    # neither stores as it does.
    kept: Any = getattr(caching, "CacheImpl", getattr(caching, "_CacheImpl", None))
    places = getattr(kept, "_locator_classes", None)
    if places:
        # One that goes by files on disk, whatever a version of numba calls it.
        by_file = [place for place in places if "UserWide" in place.__name__]
        last = [_last_resort(place) for place in by_file]
        fresh = (_fresh(place, package) for place in [*places, *last])
        kept._locator_classes = [*fresh, *places]


def _fresh(place: Any, package: Path) -> Any:
    """Return a locator of numba that knows of all files behind a function."""

    class Fresh(place):  # type: ignore[misc]
        _digest = ""
        _function = ""

        @classmethod
        def from_function(cls, py_func: Any, py_file: str) -> Any:
            path = Path(py_file)
            if not path.is_relative_to(package) or not path.is_file():
                return None
            located = super().from_function(py_func, py_file)
            if located is not None:
                located._digest = digest_of(path, package)
                named = f"{path.stem}.{py_func.__qualname__}-"
                located._function = re.sub("[<>]", "", named)  # as numba does
            return located

        def get_disambiguator(self) -> str:
            return f"{super().get_disambiguator()}.{self._digest}"

        def ensure_cache_path(self) -> None:
            super().ensure_cache_path()
            if self._function:  # empty while numba looks for a place, set when it saves
                former = Path(self.get_cache_path()).glob(f"{self._function}*.nb[ic]")
                for path in former:
                    if self._digest not in path.name:
                        with suppress(OSError):
                            path.unlink()

    return Fresh


def _last_resort(place: Any) -> Any:
    """Return a locator of numba whose files are in a temporary folder of the user."""

    class LastResort(place):  # type: ignore[misc]
        def __init__(self, py_func: Any, py_file: str) -> None:
            super().__init__(py_func, py_file)
            folder = self.get_suitable_cache_subpath(py_file)
            self._cache_path = str(_temporary_folder() / folder)

    return LastResort


@cache
def _temporary_folder() -> Path:
    """Return the user's temporary folder for compiled code, and say so when it is new.

    What lies in it is run, so no other user may be able to write there. If somebody
    can, or it cannot be told, a folder of this process alone takes its place.
    """
    user = getattr(os, "getuid", lambda: None)()
    above = Path(tempfile.gettempdir())
    if above == Path.cwd() and os.access("/dev/shm", os.W_OK):
        above = Path("/dev/shm")  # rather than among somebody's data
    kept = above / f"amulor-compiled-{user}"
    why = "neither the package's folder nor one of the user can be written"
    with suppress(OSError):
        if user is not None:
            new = not os.path.lexists(kept)
            kept.mkdir(mode=0o700, exist_ok=True)
            if _only_written_by(user, kept):
                if new:
                    _LOG.warning(_KEPT, why, kept)
                return kept
            why += f", and others can write in {kept}"
    alone = Path(tempfile.mkdtemp(prefix="amulor-compiled-", dir=above))
    atexit.register(shutil.rmtree, alone, ignore_errors=True)
    _LOG.warning(_NOT_KEPT, why)
    return alone


def _only_written_by(user: int, folder: Path) -> bool:
    """Return whether nobody else but root can write into a folder or replace it."""
    own, above = folder.lstat(), folder.parent.stat()
    sticky = bool(above.st_mode & stat.S_ISVTX)
    return (
        stat.S_ISDIR(own.st_mode)
        and own.st_uid == user
        and stat.S_IMODE(own.st_mode) == 0o700
        and above.st_uid in (0, user)
        and (sticky or not above.st_mode & 0o022)
    )


class _Compiling(event.Listener):
    """Reports that a loop is being compiled, and how many it needs.

    numba compiles one at a time, whichever threads ask for it.
    """

    def __init__(self) -> None:
        self._inside = 0
        self._loops: list[Any] = []

    def on_start(self, event: Any) -> None:
        """Count the loops behind the outermost one that have no code yet."""
        if self._inside == 0:
            self._loops = loops_behind(event.data["dispatcher"])
        self._inside += 1
        left = sum(not loop.overloads for loop in self._loops) or 1
        noun = "loop" if left == 1 else "loops"
        _progress.aside(f"{_progress.COMPILING}: {left} {noun} left")

    def on_end(self, event: Any) -> None:
        """Return to the step that waited, once the outermost loop is compiled."""
        self._inside -= 1
        if self._inside == 0:
            _progress.aside("")


def loops_behind(loop: Any) -> list[Any]:
    """Return a compiled loop and all that it calls."""
    found = [loop]
    for one in found:
        names = one.py_func.__globals__
        called = (names.get(name) for name in one.py_func.__code__.co_names)
        found += [
            other
            for other in dict.fromkeys(each for each in called if _is_loop(each))
            if other not in found
        ]
    return found


def _is_loop(value: Any) -> bool:
    return isinstance(value, Dispatcher)


def digest_of(path: Path, package: Path) -> str:
    """Return a digest of a file and of all that it imports from its package.

    Only imports at the left margin count: others are for types, or come after the
    decorators. A name of a package that imports lazily is followed to where it is from.
    """
    imported = _import_of(path, package)
    if path in _digests and _digests[path][0] is imported:
        return _digests[path][1]
    files, waiting = {path: _source(path, package)}, [path]
    while waiting:
        for found in _imported(files[waiting.pop()][0], package):
            if found not in files:
                files[found] = _source(found, package)
                waiting.append(found)
    digest = hashlib.sha256()
    for file in sorted(files, key=str):
        digest.update(str(file.relative_to(package)).encode() + b"\0" + files[file][1])
    _digests[path] = imported, digest.hexdigest()[:16]
    return _digests[path][1]


def _source(path: Path, package: Path) -> tuple[bytes, bytes]:
    """Return a source, as it was when it was imported, and its digest."""
    imported = _import_of(path, package)
    if path not in _read or _read[path][0] is not imported:
        text = path.read_bytes()
        _read[path] = imported, text, hashlib.sha256(text).digest()
    return _read[path][1:]


def _import_of(path: Path, package: Path) -> object:
    """Return what is another one for each import, `importlib.reload` included."""
    parts = path.relative_to(package.parent).with_suffix("").parts
    name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
    return getattr(sys.modules.get(name), "__spec__", None)


@cache
def _imported(text: bytes, package: Path) -> tuple[Path, ...]:
    """Return the files of a package that a source imports."""
    found: set[Path | None] = set()
    for origin, names, whole in _IMPORT.findall(text):
        module = (origin or whole).decode()
        if module.partition(".")[0] != package.name:
            continue
        file = _file(module, package)
        if names and (file is None or file.stem == "__init__"):
            for name in _names(names):
                found.update((file, _defined(module, name[0], package)))
        else:
            found.add(file)
    return tuple(path for path in found if path is not None)


def _names(imported: bytes) -> list[list[str]]:
    """Return the words of each name of an import: `name` or `name as other`."""
    words = re.sub(rb"#.*", b"", imported).decode().strip("() \n").split(",")
    return [name.split() for name in words if name.strip()]


def _defined(module: str, name: str, package: Path) -> Path | None:
    """Return the file that a name of a package is from."""
    file = _file(f"{module}.{name}", package) or _file(module, package)
    if file is None or file != _file(module, package) or file.stem != "__init__":
        return file
    for origin, names, _ in _ANY_IMPORT.findall(file.read_bytes()):
        for words in _names(names):
            same = (origin.decode(), words[0]) == (module, name)
            if words[-1] == name and not same:
                return _defined(origin.decode(), words[0], package)
    return file


@cache
def _file(module: str, package: Path) -> Path | None:
    """Return the file of a module, if it has one."""
    place = package.parent.joinpath(*module.split("."))
    for path in (place.with_suffix(".py"), place / "__init__.py"):
        if path.is_file():
            return path
    return None


_register: Any = event.register
_register("numba:compile", _Compiling())
keep_fresh(Path(__file__).parent)
