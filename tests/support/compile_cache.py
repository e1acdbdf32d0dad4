"""Compiled code on disk, shared by test processes: never stale, compiled once.

numba keeps what it compiles beside the sources. Two things it leaves to its users:

- A stored function is thrown away when its own file changes, but not when a file
  changes whose functions were compiled into it.
- Two processes may compile the same function at the same moment, and one may read what
  the other has written by half.
"""

from __future__ import annotations

import ast
import hashlib
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

SOURCES = Path(__file__).parents[2] / "src"


def _file_of(module: str) -> Path | None:
    """Return the file of a module of this repository."""
    place = SOURCES.joinpath(*module.split("."))
    for path in (place.with_suffix(".py"), place / "__init__.py"):
        if path.exists():
            return path
    return None


@cache
def _imported(path: Path) -> frozenset[Path]:
    """Return the files of this repository that a file names in its imports."""
    found: set[Path | None] = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found.update(_file_of(name.name) for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for name in node.names:
                module = _file_of(f"{node.module}.{name.name}")
                found.add(module or _file_of(node.module))
    return frozenset(path for path in found if path is not None)


def _needed(path: Path) -> set[Path]:
    """Return a file and all files that it imports, directly or not."""
    needed, waiting = {path}, [path]
    while waiting:
        new = _imported(waiting.pop()) - needed
        needed |= new
        waiting += new
    return needed


def _stored() -> Iterator[tuple[Path, Path]]:
    """Yield the index file of each stored function, and the source of its module."""
    for index in SOURCES.glob("**/__pycache__/*.nbi"):
        module = index.name.partition(".")[0]
        yield index, index.parent.parent / f"{module}.py"


def discard_stale() -> list[Path]:
    """Remove stored functions that are older than a file they were compiled from.

    Returns
    -------
    list of pathlib.Path
        The index files that were removed; without its index a function is unknown.
    """
    removed = []
    for index, source in list(_stored()):
        files = [index, *index.parent.glob(f"{index.stem}.*.nbc")]
        stored = min(path.stat().st_mtime for path in files)
        if not source.exists() or any(
            path.stat().st_mtime > stored for path in _needed(source)
        ):
            for path in files:
                path.unlink(missing_ok=True)
            removed.append(index)
    return removed


def compile_one_at_a_time() -> None:
    """Let one process compile, or load, a function while the others wait for it."""
    from filelock import FileLock
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.dispatcher import Dispatcher

    folder = Path(tempfile.gettempdir(), f"amulor-compile-{_digest(str(SOURCES))}")
    folder.mkdir(exist_ok=True)
    compile_alone = Dispatcher.compile

    @cache
    def lock_of(function: object) -> FileLock:
        code = function.__code__
        return FileLock(folder / _digest(f"{code.co_filename}:{code.co_firstlineno}"))

    def compile_in_turn(self, sig):  # type: ignore[no-untyped-def]
        # The lock of the threads first, always: two locks in two orders would block.
        with global_compiler_lock, lock_of(self.py_func):
            return compile_alone(self, sig)

    Dispatcher.compile = compile_in_turn


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]
