"""Compiled code on disk, shared by test processes: compiled once.

Two processes may compile the same function at the same moment, and one may read what
the other has written by half.
"""

from __future__ import annotations

import hashlib
import tempfile
from functools import cache
from pathlib import Path

SOURCES = Path(__file__).parents[2] / "src"


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
