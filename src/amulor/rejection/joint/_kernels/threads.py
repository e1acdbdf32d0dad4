"""How the compiled loops of the joint estimation share the processors."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba

#: Pixels below which another thread costs more than it brings.
FEWEST = 512
#: Parts of the work for each thread, so that none waits long for the others.
_PARTS = 4


def spread(
    kernel: Callable[..., None], count: int, *arguments: Any, fewest: int = FEWEST
) -> None:
    """Run a compiled loop over range(count) in as many threads as that is worth.

    Python's threads, since the loops give up its lock. Those of numba spin while they
    wait, and two calls at once end the process under its layer "workqueue".

    Parameters
    ----------
    kernel : callable
        Called as kernel(begin, end, *arguments) for parts of the range, which it must
        treat one by one.
    count : int
        Length of the range.
    *arguments
        Further arguments.
    fewest : int
        Part of the range that is worth a thread. Of these there are as many as the
        environment variable NUMBA_NUM_THREADS says at most, by default one for each
        processor.
    """
    config: Any = numba.config
    workers = min(config.NUMBA_NUM_THREADS, count // max(fewest, 1))
    if workers < 2:
        kernel(0, count, *arguments)
        return
    size = math.ceil(count / (_PARTS * workers))
    with ThreadPoolExecutor(workers) as pool:
        futures = [
            pool.submit(kernel, begin, min(begin + size, count), *arguments)
            for begin in range(0, count, size)
        ]
    for future in futures:
        future.result()
