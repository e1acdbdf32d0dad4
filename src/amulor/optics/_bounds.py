"""Arguments as arrays, refused outside of a closed range or below zero."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def between(
    value: ArrayLike, low: float, high: float, *, name: str
) -> NDArray[np.float64]:
    """Return the value as an array, refused outside of low..high.

    Unlike `amulor.optics._ranges.within` it leaves no room for rounding: a share of
    -1e-13 would make a root of it undefined.

    Parameters
    ----------
    value : array_like
        Argument of a formula [1].
    low, high : float
        Ends of its range, both allowed [1].
    name : str
        How the message calls it.

    Returns
    -------
    ndarray
        The value [1].

    Raises
    ------
    ValueError
        If any of it is outside, or not a number.

    Examples
    --------
    >>> print(between([0.5, 1], 0, 1, name="transmission"))
    [0.5 1. ]
    """
    array = np.asarray(value, dtype=np.float64)
    if not np.all((array >= low) & (array <= high)):
        raise ValueError(
            f"{name} must be from {low:g} to {high:g}, got values from "
            f"{np.min(array):g} to {np.max(array):g}"
        )
    return array


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
