"""False-discovery-rate threshold (Benjamini-Hochberg).

Of what is called out, only a stated share is to be there by chance: Y. Benjamini and
Y. Hochberg, J. R. Stat. Soc. B 57 (1995) 289-300,
doi:10.1111/j.2517-6161.1995.tb02031.x.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["largest_discovered"]


def largest_discovered(
    chance: NDArray[np.float64], *, share: float, tests: int | None = None
) -> float:
    """Return the largest p-value counted as a discovery; -1 if there is none."""
    order = np.sort(chance[np.isfinite(chance)], axis=None)
    tests = len(order) if tests is None else tests
    below = np.flatnonzero(order * tests <= share * np.arange(1, len(order) + 1))
    return float(order[below[-1]]) if len(below) else -1.0
