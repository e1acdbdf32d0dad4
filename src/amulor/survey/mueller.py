"""How a survey states a Mueller matrix: three diagonal numbers or all sixteen."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator

from amulor.optics.polarization import depolarization

Row = tuple[float, float, float, float]
_Stated = tuple[float, float, float] | tuple[Row, Row, Row, Row]


def matrix(stated: Any) -> NDArray[np.float64]:
    """Return the reduced Mueller matrix that a survey states.

    Parameters
    ----------
    stated : tuple
        (m22, m33, m44) of a diagonal matrix, or four rows of four.

    Returns
    -------
    ndarray, shape (4, 4)
        Reduced matrix, upper left element 1 [1].
    """
    values = np.asarray(stated, dtype=float)
    if values.shape == (3,):
        return np.diag([1.0, *values])
    return values


def _check(stated: _Stated) -> _Stated:
    values = matrix(stated)
    if not np.all(np.isfinite(values)):
        raise ValueError("a Mueller matrix must hold finite numbers")
    if values[0, 0] != 1:
        raise ValueError(
            f"a reduced Mueller matrix starts with 1, found {values[0, 0]:g}; divide "
            "all elements by the first one"
        )
    defect = float(depolarization.realizability_defect(values))
    # A matrix printed with three digits may miss the limit by its last one.
    if defect > 1e-3:
        raise ValueError(
            f"no surface or particle can have this Mueller matrix: the smallest "
            f"eigenvalue of its coherency matrix is {-defect:.3g}, below 0"
        )
    return stated


ReducedMueller = Annotated[_Stated, AfterValidator(_check)]
