"""On-disk cache of compiled loops, renewed when any of their sources changes.

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
#: Imports at any indentation, such as those for types or within functions.
_ANY_IMPORT = re.compile(rb"^[ \t]*" + _FORM, re.MULTILINE)
#: By file: object of its import, text and digest.
_read: dict[Path, tuple[object, bytes, bytes]] = {}
#: By file: object of its import, and digest of the file and all its imports.
_digests: dict[Path, tuple[object, str]] = {}


def keep_fresh(package: Path) -> None:
    """Make numba recompile a function when any source that it depends on changes.

    Call it before functions are decorated with `numba.njit(cache=True)`. Functions of
    other packages are cached as usual. Cached files of former sources are removed when
    the function is compiled again.
    """
    # Before version 0.61 of numba the class had a private name; a numba that has
    # neither stores as it does.
    cache: Any = getattr(caching, "CacheImpl", getattr(caching, "_CacheImpl", None))
    places = getattr(cache, "_locator_classes", None)
    if places:
        # Locator class for files on disk, under any name that numba gives it.
        by_file = [place for place in places if "UserWide" in place.__name__]
        last = [_last_resort(place) for place in by_file]
        fresh = (_fresh(place, package) for place in [*places, *last])
        cache._locator_classes = [*fresh, *places]


def _fresh(place: Any, package: Path) -> Any:
    """Return numba's cache locator, extended to check all sources of a function."""

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
                prefix = f"{path.stem}.{py_func.__qualname__}-"
                located._function = re.sub("[<>]", "", prefix)  # as numba does
            return located

        def get_disambiguator(self) -> str:
            return f"{super().get_disambiguator()}.{self._digest}"

        def ensure_cache_path(self) -> None:
            super().ensure_cache_path()
            if self._function:  # empty until numba saves
                former = Path(self.get_cache_path()).glob(f"{self._function}*.nb[ic]")
                for path in former:
                    if self._digest not in path.name:
                        with suppress(OSError):
                            path.unlink()

    return Fresh


def _last_resort(place: Any) -> Any:
    """Return numba's cache locator, changed to the user's temporary folder."""

    class LastResort(place):  # type: ignore[misc]
        def __init__(self, py_func: Any, py_file: str) -> None:
            super().__init__(py_func, py_file)
            folder = self.get_suitable_cache_subpath(py_file)
            self._cache_path = str(_temporary_folder() / folder)

    return LastResort


@cache
def _temporary_folder() -> Path:
    """Return the user's temporary folder for compiled code; report if it is new.

    Its content is executed, so no other user may have write access. If one has, or if
    this is unknown, a folder of this process is used instead.
    """
    user = getattr(os, "getuid", lambda: None)()
    above = Path(tempfile.gettempdir())
    if above == Path.cwd() and os.access("/dev/shm", os.W_OK):
        above = Path("/dev/shm")  # rather than among somebody's data
    path = above / f"amulor-compiled-{user}"
    why = "neither the package's folder nor one of the user can be written"
    with suppress(OSError):
        if user is not None:
            new = not os.path.lexists(path)
            path.mkdir(mode=0o700, exist_ok=True)
            if _only_written_by(user, path):
                if new:
                    _LOG.warning(_KEPT, why, path)
                return path
            why += f", and others can write in {path}"
    alone = Path(tempfile.mkdtemp(prefix="amulor-compiled-", dir=above))
    atexit.register(shutil.rmtree, alone, ignore_errors=True)
    _LOG.warning(_NOT_KEPT, why)
    return alone


def _only_written_by(user: int, folder: Path) -> bool:
    """Return whether only the user and root can change or replace a folder."""
    status, above = folder.lstat(), folder.parent.stat()
    sticky = bool(above.st_mode & stat.S_ISVTX)
    return (
        stat.S_ISDIR(status.st_mode)
        and status.st_uid == user
        and stat.S_IMODE(status.st_mode) == 0o700
        and above.st_uid in (0, user)
        and (sticky or not above.st_mode & 0o022)
    )


class _Compiling(event.Listener):
    """Progress report while a loop, and all loops that it calls, are compiled.

    numba compiles one function at a time, for all threads.
    """

    def __init__(self) -> None:
        self._inside = 0
        self._loops: list[Any] = []

    def on_start(self, event: Any) -> None:
        """Report the number of loops that remain to be compiled."""
        if self._inside == 0:
            self._loops = loops_behind(event.data["dispatcher"])
        self._inside += 1
        remaining = sum(not loop.overloads for loop in self._loops) or 1
        noun = "loop" if remaining == 1 else "loops"
        _progress.aside(f"{_progress.COMPILING}: {remaining} {noun} left")

    def on_end(self, event: Any) -> None:
        """End the report once the outermost loop is compiled."""
        self._inside -= 1
        if self._inside == 0:
            _progress.aside("")


def loops_behind(loop: Any) -> list[Any]:
    """Return a compiled loop, and all loops that it calls directly or indirectly."""
    loops = [loop]
    for compiled in loops:
        names = compiled.py_func.__globals__
        called = (names.get(name) for name in compiled.py_func.__code__.co_names)
        loops += [
            callee
            for callee in dict.fromkeys(callee for callee in called if _is_loop(callee))
            if callee not in loops
        ]
    return loops


def _is_loop(value: Any) -> bool:
    return isinstance(value, Dispatcher)


def digest_of(path: Path, package: Path) -> str:
    """Return a digest of a file and of the package files that it imports.

    Only imports without indentation are followed; others are for types, or come after
    the decorators. A lazily imported name is followed to the file that defines it.
    """
    imported = _import_of(path, package)
    if path in _digests and _digests[path][0] is imported:
        return _digests[path][1]
    files, waiting = {path: _source(path, package)}, [path]
    while waiting:
        for dependency in _imported(files[waiting.pop()][0], package):
            if dependency not in files:
                files[dependency] = _source(dependency, package)
                waiting.append(dependency)
    digest = hashlib.sha256()
    for file in sorted(files, key=str):
        digest.update(str(file.relative_to(package)).encode() + b"\0" + files[file][1])
    _digests[path] = imported, digest.hexdigest()[:16]
    return _digests[path][1]


def _source(path: Path, package: Path) -> tuple[bytes, bytes]:
    """Return the text of a module at the time of its import, and its digest."""
    imported = _import_of(path, package)
    if path not in _read or _read[path][0] is not imported:
        text = path.read_bytes()
        _read[path] = imported, text, hashlib.sha256(text).digest()
    return _read[path][1:]


def _import_of(path: Path, package: Path) -> object:
    """Return a module's import specification, a new object after each reload."""
    parts = path.relative_to(package.parent).with_suffix("").parts
    name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
    return getattr(sys.modules.get(name), "__spec__", None)


@cache
def _imported(text: bytes, package: Path) -> tuple[Path, ...]:
    """Return the files of a package that a module's text imports."""
    files: set[Path | None] = set()
    for origin, names, modules in _IMPORT.findall(text):
        module = (origin or modules).decode()
        if module.partition(".")[0] != package.name:
            continue
        file = _file(module, package)
        if names and (file is None or file.stem == "__init__"):
            for name in _names(names):
                files.update((file, _defined(module, name[0], package)))
        else:
            files.add(file)
    return tuple(path for path in files if path is not None)


def _names(imported: bytes) -> list[list[str]]:
    """Split each item of an import list into words: `name` or `name as other`."""
    words = re.sub(rb"#.*", b"", imported).decode().strip("() \n").split(",")
    return [name.split() for name in words if name.strip()]


def _defined(module: str, name: str, package: Path) -> Path | None:
    """Return the file in a package that defines an imported name."""
    file = _file(f"{module}.{name}", package) or _file(module, package)
    if file is None or file != _file(module, package) or file.stem != "__init__":
        return file
    for origin, names, _ in _ANY_IMPORT.findall(file.read_bytes()):
        for words in _names(names):
            is_same = (origin.decode(), words[0]) == (module, name)
            if words[-1] == name and not is_same:
                return _defined(origin.decode(), words[0], package)
    return file


@cache
def _file(module: str, package: Path) -> Path | None:
    """Return the file of a module in a package, if there is one."""
    place = package.parent.joinpath(*module.split("."))
    for path in (place.with_suffix(".py"), place / "__init__.py"):
        if path.is_file():
            return path
    return None


_register: Any = event.register
_register("numba:compile", _Compiling())
keep_fresh(Path(__file__).parent)
