"""Progress of a computation, for a bar, a log, or no listener.

Work that may take seconds says so with `tell`, whoever called it; a command listens.
Nothing has to be handed down through the functions between.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace

__all__ = ["COMPILING", "Listener", "aside", "listening", "part", "tell"]

#: Begin of the step that waits for the compiler.
COMPILING = "compiling for this computer, once"
#: Function of the present step and the completed fraction of the work [1].
Listener = Callable[[str, float], None]


@dataclass(frozen=True)
class _Ear:
    """Progress listener, with the start and end fraction of the current work."""

    listener: Listener
    begin: float = 0.0
    end: float = 1.0
    steps: list[str] = field(default_factory=list)


_ear: ContextVar[_Ear | None] = ContextVar("_ear", default=None)
#: All listeners, for work in threads that a listener waits for.
_ears: list[_Ear] = []


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Send progress reports from within the block to a listener function."""
    reached = 0.0

    def rising(step: str, share: float) -> None:
        # Progress does not decrease when work is repeated, as by two methods in turn.
        nonlocal reached
        reached = max(reached, share)
        listener(step, reached)

    ear = _Ear(rising)
    before = _ear.set(ear)
    _ears.append(ear)
    try:
        yield
    finally:
        _ears.remove(ear)
        _ear.reset(before)


@contextmanager
def part(begin: float, end: float) -> Iterator[None]:
    """Map progress within the block to an interval of the enclosing work."""
    ear = _ear.get()
    if ear is None:
        yield
        return
    width = ear.end - ear.begin
    inner = replace(ear, begin=ear.begin + begin * width, end=ear.begin + end * width)
    before = _ear.set(inner)
    try:
        yield
    finally:
        _ear.reset(before)


def tell(step: str, share: float) -> None:
    """Report the present step and the completed fraction of the work."""
    ear = _ear.get()
    if ear is not None:
        ear.steps[:] = [step]
        ear.listener(step, ear.begin + share * (ear.end - ear.begin))


def aside(step: str) -> None:
    """Report from any thread that the present step is delayed, or continues."""
    ear = _ear.get() or (_ears[-1] if _ears else None)
    if ear is not None:
        ear.listener(step or "".join(ear.steps), 0.0)
