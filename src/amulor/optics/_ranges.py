"""Arguments as arrays, refused outside of the range that a formula or table has."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def within(
    value: ArrayLike, low: float, high: float, *, name: str, unit: str
) -> NDArray[np.float64]:
    """Return the value as an array, refused outside of low..high.

    Parameters
    ----------
    value : array_like
        Argument of a formula.
    low, high : float
        Ends of its range, both allowed.
    name, unit : str
        How the message calls them.

    Returns
    -------
    ndarray
        The value.

    Raises
    ------
    ValueError
        If any of it is outside, or not a number.

    Examples
    --------
    >>> print(within([1, 2], 0, 3, name="depth", unit="m"))
    [1. 2.]
    """
    array = np.asarray(value, dtype=np.float64)
    rounding = 1e-12 * abs(high)  # 700 * 1e-9 is above 700e-9
    if not np.all((array >= low - rounding) & (array <= high + rounding)):
        raise ValueError(
            f"{name} must be from {low:g} to {high:g} {unit}, got values from "
            f"{np.min(array):g} to {np.max(array):g} {unit}"
        )
    return array
