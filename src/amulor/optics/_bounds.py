"""Arguments as arrays, refused outside of the range that a formula or table has."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def within(
    value: ArrayLike, low: float, high: float, *, name: str, unit: str = ""
) -> NDArray[np.float64]:
    """Return the value as an array, refused outside of low..high.

    What is beyond an end by rounding alone, a part in 1e12 of that end, is taken for
    the end itself: 700 * 1e-9 is above 700e-9, and what follows may rely on the range.
    An end at 0 has no such room.

    Parameters
    ----------
    value : array_like
        Argument of a formula.
    low, high : float
        Ends of its range, both allowed.
    name, unit : str
        How the message calls them; the unit may be empty.

    Returns
    -------
    ndarray
        The value, within low..high.

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
    least, most = low - 1e-12 * abs(low), high + 1e-12 * abs(high)
    if not np.all((array >= least) & (array <= most)):
        span = f"{low:g} to {high:g} {unit}".rstrip()
        found = f"{np.min(array):g} to {np.max(array):g} {unit}".rstrip()
        raise ValueError(f"{name} must be from {span}, got values from {found}")
    return np.asarray(np.clip(array, low, high))


def not_negative(value: ArrayLike, *, name: str, unit: str) -> NDArray[np.float64]:
    """Return the value as an array, refused if negative or not finite.

    Parameters
    ----------
    value : array_like
        Argument of a formula.
    name, unit : str
        How the message calls them; the unit may be empty.

    Returns
    -------
    ndarray
        The value.

    Raises
    ------
    ValueError
        If any of it is below zero, infinite or not a number.

    Examples
    --------
    >>> print(not_negative(1.5, name="depth", unit="m"))
    1.5
    """
    array = np.asarray(value, dtype=np.float64)
    if not np.all((array >= 0) & np.isfinite(array)):
        raise ValueError(
            f"{name} must be finite and not negative, got values from "
            f"{np.min(array):g} to {np.max(array):g} {unit}".rstrip()
        )
    return array


def positive(value: ArrayLike, *, name: str, unit: str) -> NDArray[np.float64]:
    """Return the value as an array, refused unless above zero and finite.

    Parameters
    ----------
    value : array_like
        Argument of a formula.
    name, unit : str
        How the message calls them; the unit may be empty.

    Returns
    -------
    ndarray
        The value.

    Raises
    ------
    ValueError
        If any of it is not above zero, infinite or not a number.

    Examples
    --------
    >>> print(positive(0.02, name="receiver_radius", unit="m"))
    0.02
    """
    array = np.asarray(value, dtype=np.float64)
    if not np.all((array > 0) & np.isfinite(array)):
        raise ValueError(
            f"{name} must be finite and above 0, got values from "
            f"{np.min(array):g} to {np.max(array):g} {unit}".rstrip()
        )
    return array
