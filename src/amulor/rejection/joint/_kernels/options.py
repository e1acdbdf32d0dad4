"""How the loops of the joint estimation are compiled, and why so."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from amulor._compiled import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])

#: Sums may be taken in any order, so that they run in parallel lanes.
#:
#: Small loops that do so are always inlined (`forceinline`). A call goes to whichever
#: copy of a function the process has loaded first, and copies that were optimized once
#: or twice differ in the last bit: results would depend on whether the code had just
#: been compiled or came from the cache.
LANES = {"reassoc", "contract"}


def inner(**options: Any) -> Callable[[_Function], _Function]:
    """Compile a function that compiled ones call alone.

    Without the entries for Python and C, which take a fifth of the time of compilation,
    and without a test for zero before every division, which ends a thread that has
    given up Python's lock in a `SystemError`; who divides by what may be zero looks
    first.

    Parameters
    ----------
    **options
        Further options of `numba.njit`.

    Returns
    -------
    callable
        Decorator.
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
