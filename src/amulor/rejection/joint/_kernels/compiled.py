"""Compiler options and threads of the compiled loops of joint estimation."""

from __future__ import annotations

import math
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from amulor._compiled import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])

#: Sums may be evaluated in any order, for vectorization.
#:
#: Small loops with such sums are always inlined (`forceinline`). A call uses the copy
#: of a function that the process has loaded first, and copies that were optimized once
#: or twice differ in the last bit: results would depend on whether the code had just
#: been compiled or came from the cache.
LANES = {"reassoc", "contract"}


def inner(**options: Any) -> Callable[[_Function], _Function]:
    """Compile a function for use inside compiled functions only.

    The entry points for Python and C are omitted; they take a fifth of the compilation
    time. The test for zero before each division is also omitted, because it raises a
    `SystemError` in a thread without Python's lock. Callers must check divisors.
    """
    compiled: Any = numba.njit(
        **{
            "cache": True,
            "error_model": "numpy",
            "no_cpython_wrapper": True,
            "no_cfunc_wrapper": True,
            **options,
        }
    )
    decorator: Callable[[_Function], _Function] = compiled
    return decorator


#: Pixels below which another thread costs more than it brings.
FEWEST = 512
#: Parts of the work for each thread, so that none waits long for the others.
_PARTS = 4


_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class _Here(threading.local):
    """Thread-local flag that marks a thread running a part of a loop."""

    is_part = False


_here = _Here()


class _Turns:
    """Limit on the number of concurrent loop parts, shared by all callers.

    Callers on several threads, as the tasks of a cluster are, share the processors
    instead of multiplying them.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._running = 0

    def run(
        self, function: Callable[..., _Result], most: int, *arguments: Any
    ) -> _Result:
        """Wait until fewer than `most` parts are running, then run a part."""
        with self._changed:
            self._changed.wait_for(lambda: self._running < most)
            self._running += 1
        try:
            _here.is_part = True
            return function(*arguments)
        finally:
            _here.is_part = False
            with self._changed:
                self._running -= 1
                self._changed.notify()


_turns = _Turns()


def _forget_turns() -> None:
    """Reset the limit on concurrent loop parts in a forked process."""
    global _turns
    _turns = _Turns()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_turns)


def spread(
    kernel: Callable[..., None], count: int, *arguments: Any, fewest: int = FEWEST
) -> None:
    """Run a compiled loop over range(count), in parallel threads for large counts.

    Python's threads, since the loops give up its lock. Those of numba spin while they
    wait, and two calls at once end the process under its layer "workqueue": no loop of
    amulor is compiled with `parallel=True`, so that any of them may be entered by many
    threads. Callers on several threads share the number of threads.
    """
    config: Any = numba.config
    most = config.NUMBA_NUM_THREADS
    workers = min(most, count // max(fewest, 1))
    if workers < 2 or _here.is_part:
        kernel(0, count, *arguments)
        return
    size = math.ceil(count / (_PARTS * workers))
    with ThreadPoolExecutor(workers) as pool:
        futures = [
            pool.submit(
                _turns.run, kernel, most, begin, min(begin + size, count), *arguments
            )
            for begin in range(0, count, size)
        ]
    for future in futures:
        future.result()


def each(
    function: Callable[[_Item], _Result], items: Iterable[_Item]
) -> Iterator[_Result]:
    """Apply a function to items in parallel threads; yield the results in order.

    What it calls takes no threads of its own: they have all been given out.
    """
    config: Any = numba.config
    most = config.NUMBA_NUM_THREADS
    if most < 2 or _here.is_part:
        yield from map(function, items)
        return
    waiting: deque[Future[_Result]] = deque()
    with ThreadPoolExecutor(most) as pool:
        try:
            for item in items:
                waiting.append(pool.submit(_turns.run, function, most, item))
                if len(waiting) > most:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
