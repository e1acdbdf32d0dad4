"""What more of one thing buys of another: the front of candidates, and its knee."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def front(cost: ArrayLike, error: ArrayLike) -> NDArray[np.intp]:
    """Return which candidates no other one beats in both cost and error."""
    cost, error = np.asarray(cost, dtype=float), np.asarray(error, dtype=float)
    if cost.ndim != 1 or cost.shape != error.shape:
        raise ValueError(
            f"cost and error must be 1-D and of one length; got shapes {cost.shape} "
            f"and {error.shape}"
        )
    finite = np.flatnonzero(np.isfinite(cost) & np.isfinite(error))
    order = finite[np.lexsort((error[finite], cost[finite]))]
    if not len(order):
        return order
    best = np.minimum.accumulate(error[order])
    better = np.concatenate([[True], error[order][1:] < best[:-1]])
    kept: NDArray[np.intp] = order[better]
    return kept


def knee(cost: ArrayLike, error: ArrayLike) -> int | None:
    """Return where a front bends most: beyond it, more cost buys little."""
    x, y = (np.log(np.asarray(values, dtype=float)) for values in (cost, error))
    if len(x) < 3 or x[-1] <= x[0] or y[0] <= y[-1]:
        return None
    below = 1 - (x - x[0]) / (x[-1] - x[0]) - (y - y[-1]) / (y[0] - y[-1])
    at = int(np.argmax(below))
    return at if below[at] > 1e-9 else None
