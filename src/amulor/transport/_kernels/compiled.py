"""How the loops of this folder are compiled.

Most take arrays that their caller holds, and make none. So references to them need not
be counted, which bundles of arrays would pay for at each corner of each path: with the
counts a run takes two to four times as long.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

from amulor._compiled import numba

Loop = TypeVar("Loop", bound=Callable[..., Any])


class Compiler(Protocol):
    """A decorator that leaves the types of a loop as they are."""

    def __call__(self, loop: Loop, /) -> Loop:
        """Return the compiled loop."""


# The types that come with numba do not know all of these options.
_njit: Any = numba.njit
_COMMON: dict[str, Any] = {"cache": True, "error_model": "numpy"}
#: Without an entry from Python, which would take a tenth of the time of compiling;
#: `py_func` is the uncompiled function.
_INTERNAL: dict[str, Any] = {
    **_COMMON,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}

#: Loops that make no array. Tests call them from Python, too.
kernel: Compiler = _njit(_nrt=False, **_COMMON)

#: The same for those that only other loops call.
inner: Compiler = _njit(_nrt=False, **_INTERNAL)

#: The same for steps that their caller takes in whole, as handing over all the arrays
#: would take longer than what they do.
step: Compiler = _njit(_nrt=False, forceinline=True, **_INTERNAL)

#: Loops that make arrays, called by other loops.
allocating: Compiler = _njit(**_INTERNAL)

#: Loops that Python calls, on several threads at once.
entry: Compiler = _njit(nogil=True, **_COMMON)

#: The same for those that make arrays.
allocating_entry: Compiler = _njit(nogil=True, **_COMMON)
