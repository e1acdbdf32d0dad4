"""What is being done now, told to whoever listens: a bar, a log, or nobody.

Work that may take seconds says so with `tell`, whoever called it; a command listens.
Nothing has to be handed down through the functions between.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

__all__ = ["Listener", "listening", "part", "tell"]

#: Takes what is done now and the share of the work done before it [1].
Listener = Callable[[str, float], None]


@dataclass(frozen=True)
class _Ear:
    """A listener, and which share of its work is being done."""

    listener: Listener
    begin: float = 0.0
    end: float = 1.0


_ear: ContextVar[_Ear | None] = ContextVar("_ear", default=None)


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Tell a listener what is done inside, and nobody else.

    Parameters
    ----------
    listener : callable
        Takes what is done now and the share of the work done before it.
    """
    reached = 0.0

    def rising(step: str, share: float) -> None:
        # Work that is done twice, as by two methods in turn, does not go back.
        nonlocal reached
        reached = max(reached, share)
        listener(step, reached)

    before = _ear.set(_Ear(rising))
    try:
        yield
    finally:
        _ear.reset(before)


@contextmanager
def part(begin: float, end: float) -> Iterator[None]:
    """Let what is told inside be a part of the work around it.

    Parameters
    ----------
    begin, end : float
        Shares of that work done before and after, from 0 to 1.
    """
    ear = _ear.get()
    if ear is None:
        yield
        return
    width = ear.end - ear.begin
    inner = _Ear(ear.listener, ear.begin + begin * width, ear.begin + end * width)
    before = _ear.set(inner)
    try:
        yield
    finally:
        _ear.reset(before)


def tell(step: str, share: float) -> None:
    """Say what is done now.

    Parameters
    ----------
    step : str
        A few words, such as "light of the water".
    share : float
        Share of the present part done before it, from 0 to 1.
    """
    ear = _ear.get()
    if ear is not None:
        ear.listener(step, ear.begin + share * (ear.end - ear.begin))
