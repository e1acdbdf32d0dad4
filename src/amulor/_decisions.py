"""What is decided once for a scan, however many tiles it is worked on in.

A step that looks at all pixels to decide something (a median, a table over the span of
the scan, whether a flag is too frequent to mean anything) asks for it by `decided`.
Worked on as a whole, it decides. Worked on in tiles, it decides on a sample of the scan
first, and every tile is told what was decided.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

__all__ = ["Decisions", "decided", "deciding", "fitted_once", "told"]

_Value = TypeVar("_Value")
_Choices = TypeVar("_Choices")


class Decisions:
    """What was decided on a sample, in the order in which it was asked for."""

    def __init__(self, **known: Any) -> None:
        self._found: dict[str, list[Any]] = {}
        #: What is known of the whole scan before, and is the same in the sample.
        self.known = known

    def keep(self, name: str, value: Any) -> None:
        """Add what was decided under a name."""
        self._found.setdefault(name, []).append(value)

    def get(self, name: str, number: int) -> Any:
        """Return what was decided when a name was asked for the n-th time."""
        try:
            return self._found[name][number]
        except (KeyError, IndexError):
            raise RuntimeError(
                f"{name!r} is asked for the {number + 1}. time in a tile, but was not "
                "in the sample: decide what leads there once as well"
            ) from None


class _Asking:
    """One run of a step: on the sample, or on a tile."""

    def __init__(self, decisions: Decisions, *, is_sample: bool) -> None:
        self.decisions, self.is_sample = decisions, is_sample
        self.times: dict[str, int] = {}


_asking: ContextVar[_Asking | None] = ContextVar("_asking", default=None)


def decided(name: str, decide: Callable[[], _Value]) -> _Value:
    """Return what is decided once for a scan."""
    asking = _asking.get()
    if asking is None:
        return decide()
    if name in asking.decisions.known:
        known: _Value = asking.decisions.known[name]
        return known
    if not asking.is_sample:
        number = asking.times.get(name, 0)
        asking.times[name] = number + 1
        value: _Value = asking.decisions.get(name, number)
        return value
    token = _asking.set(None)
    try:
        value = decide()
    finally:
        _asking.reset(token)
    asking.decisions.keep(name, value)
    return value


def fitted_once(
    name: str,
    fit: Callable[[], tuple[_Value, _Choices]],
    apply: Callable[[_Choices], _Value],
) -> _Value:
    """Return the result of a fit to these pixels, or of the choices of the scan."""
    results: list[_Value] = []

    def decide() -> _Choices:
        result, choices = fit()
        results.append(result)
        return choices

    choices = decided(name, decide)
    return results[0] if results else apply(choices)


@contextmanager
def deciding(decisions: Decisions) -> Iterator[None]:
    """Keep what a step decides inside."""
    with _as(_Asking(decisions, is_sample=True)):
        yield


@contextmanager
def told(decisions: Decisions) -> Iterator[None]:
    """Tell a step inside what was decided."""
    with _as(_Asking(decisions, is_sample=False)):
        yield


@contextmanager
def _as(asking: _Asking) -> Iterator[None]:
    token = _asking.set(asking)
    try:
        yield
    finally:
        _asking.reset(token)
