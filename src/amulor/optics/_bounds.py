"""Range checks of arguments: NaN, infinity, sign and shape.

Each function returns its argument as an array of float64 or raises a `ValueError`, such
as "absorption must be finite and not negative [1/m], got nan at index (3,)". Properties
of water, instrument and formula must be finite (`finite`, `not_negative`, `positive`,
`at_least`, `within`). A length to an end may be infinite (`reach`). Measured values may
be infinite, or NaN for a missing sample (`measured`, `above_zero`). The functions
`broadcast`, `one_axis` and `last_axes` check shapes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "above_zero",
    "at_least",
    "broadcast",
    "checked_angle",
    "checked_split_angle",
    "finite",
    "last_axes",
    "measured",
    "not_negative",
    "one_axis",
    "positive",
    "reach",
    "require",
    "within",
]

Array = NDArray[np.float64]


def require(
    value: ArrayLike,
    allowed: ArrayLike,
    *,
    name: str,
    rule: str,
    unit: str = "",
    hint: str = "",
) -> None:
    """Raise a ValueError unless `allowed` is true for every element of `value`.

    Examples
    --------
    >>> require([0.1, 2.0], [True, False], name="gain", rule="at most 1")
    Traceback (most recent call last):
    ValueError: gain must be at most 1, got 2 at index (1,)
    """
    if np.all(allowed):
        return
    array = np.asarray(value)
    index = tuple(int(i) for i in np.argwhere(~np.asarray(allowed))[0])
    where = f" at index {index}" if index else ""
    bracket = f" [{unit}]" if unit else ""
    tail = f"; {hint}" if hint else ""
    raise ValueError(
        f"{name} must be {rule}{bracket}, got {array[index]:g}{where}{tail}"
    )


def finite(value: ArrayLike, *, name: str, unit: str = "") -> Array:
    """Return the value; ValueError if an element is infinite or not a number.

    Examples
    --------
    >>> print(finite(-0.1, name="tilt", unit="rad"))
    -0.1
    """
    return _checked(value, lambda x: abs(x) < np.inf, "finite", name=name, unit=unit)


def not_negative(
    value: ArrayLike, *, name: str, unit: str = "", hint: str = ""
) -> Array:
    """Return the value; ValueError if negative, infinite or not a number.

    Examples
    --------
    >>> print(not_negative(1.5, name="depth", unit="m"))
    1.5
    """
    rule = "finite and not negative"
    return _checked(
        value, lambda x: (x >= 0) & (x < np.inf), rule, name=name, unit=unit, hint=hint
    )


def positive(value: ArrayLike, *, name: str, unit: str = "", hint: str = "") -> Array:
    """Return the value; ValueError unless above zero and finite.

    Examples
    --------
    >>> print(positive(0.02, name="receiver_radius", unit="m"))
    0.02
    """
    rule = "finite and above 0"
    return _checked(
        value, lambda x: (x > 0) & (x < np.inf), rule, name=name, unit=unit, hint=hint
    )


def at_least(
    value: ArrayLike, low: float, *, name: str, unit: str = "", hint: str = ""
) -> Array:
    """Return the value; ValueError if below a limit, infinite or not a number.

    Examples
    --------
    >>> print(at_least(1.38, 1, name="group_index"))
    1.38
    """
    rule = f"finite and at least {_text(low)}"
    return _checked(
        value,
        lambda x: (x >= low) & (x < np.inf),
        rule,
        name=name,
        unit=unit,
        hint=hint,
    )


def within(
    value: ArrayLike,
    low: float,
    high: float,
    *,
    name: str,
    unit: str = "",
    above: bool = False,
    below: bool = False,
    hint: str = "",
) -> Array:
    """Return the value; ValueError if outside of the interval low..high.

    Values beyond an allowed end by at most 1e-12 of that end are set to the end, since
    rounding causes such differences: 700 * 1e-9 is above 700e-9. An end at 0 has no
    such tolerance.

    Examples
    --------
    >>> print(within([1, 2], 0, 3, name="depth", unit="m"))
    [1. 2.]
    >>> within(0, 0, 1, name="modulation_depth", above=True)
    Traceback (most recent call last):
    ValueError: modulation_depth must be above 0 and at most 1, got 0
    """
    least = low if above else low - 1e-12 * abs(low)
    most = high if below else high + 1e-12 * abs(high)

    def allowed(x: Any) -> Any:
        return ((x > least) if above else (x >= least)) & (
            (x < most) if below else (x <= most)
        )

    if above or below:
        rule = f"{'above' if above else 'at least'} {_text(low)} and "
        rule += f"{'below' if below else 'at most'} {_text(high)}"
    else:
        rule = f"from {_text(low)} to {_text(high)}"
    array = _checked(value, allowed, rule, name=name, unit=unit, hint=hint)
    return np.asarray(np.clip(array, low, high))


def reach(value: ArrayLike, *, name: str, unit: str = "m") -> Array:
    """Return a length, possibly infinite; ValueError if negative or not a number.

    Examples
    --------
    >>> print(reach(np.inf, name="end"))
    inf
    """
    rule = "not negative, inf if there is no end"
    return _checked(value, lambda x: x >= 0, rule, name=name, unit=unit)


def measured(value: ArrayLike, *, name: str, unit: str = "", hint: str = "") -> Array:
    """Return a modulus, uncertainty or count; ValueError if negative, NaN is allowed.

    Examples
    --------
    >>> print(measured([0.2, np.nan], name="phase_uncertainty", unit="rad"))
    [0.2 nan]
    """
    rule = "not negative, NaN where it is missing"
    return _checked(value, lambda x: ~(x < 0), rule, name=name, unit=unit, hint=hint)


def above_zero(value: ArrayLike, *, name: str, unit: str = "", hint: str = "") -> Array:
    """Return a measured value; ValueError unless above zero, NaN is allowed.

    Examples
    --------
    >>> print(above_zero([1e4, np.nan], name="photoelectrons"))
    [10000.    nan]
    """
    rule = "above 0, NaN where it is missing"
    return _checked(value, lambda x: ~(x <= 0), rule, name=name, unit=unit, hint=hint)


def checked_angle(value: ArrayLike, *, name: str) -> Array:
    """Return scattering angles as an array; ValueError if outside of 0..pi [rad].

    Examples
    --------
    >>> print(checked_angle(np.pi / 2, name="angle").round(3))
    1.571
    """
    rule = "from 0 to pi"
    return _checked(
        value, lambda x: (x >= 0) & (x <= np.pi), rule, name=name, unit="rad"
    )


def checked_split_angle(value: ArrayLike, *, above: float = 0.0) -> Array:
    """Return split angles as an array; ValueError unless above a limit, at most pi.

    Examples
    --------
    >>> print(checked_split_angle(np.pi / 2).round(3))
    1.571
    """
    return _checked(
        value,
        lambda x: (x > above) & (x <= np.pi),
        f"above {above:g} and at most pi",
        name="split_angle",
        unit="rad",
        hint="below it nothing would be forward",
    )


def broadcast(**arguments: ArrayLike) -> tuple[int, ...]:
    """Return the broadcast shape of the arguments; ValueError if they cannot broadcast.

    Examples
    --------
    >>> broadcast(depth=np.zeros((2, 1)), baseline=np.zeros(3))
    (2, 3)
    """
    shapes = {name: np.shape(value) for name, value in arguments.items()}
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        listed = ", ".join(f"{name} {shape}" for name, shape in shapes.items() if shape)
        raise ValueError(
            f"arguments must have shapes that broadcast, got {listed}"
        ) from None


def one_axis(least: int, **columns: ArrayLike) -> None:
    """Raise a ValueError unless arrays are 1-D, of equal length and at least `least`.

    Examples
    --------
    >>> one_axis(2, angle=[0.0, 1.0], value=[1.0, 2.0])
    """
    shapes = [np.shape(column) for column in columns.values()]
    first = shapes[0]
    if len(first) != 1 or first[0] < least or any(shape != first for shape in shapes):
        one_length = ", of one length" if len(shapes) > 1 else ""
        raise ValueError(
            f"{' and '.join(columns)} must be 1-D{one_length}, at least {least} long, "
            f"got {' and '.join(str(shape) for shape in shapes)}"
        )


def last_axes(
    value: ArrayLike, shape: tuple[int, ...], *, name: str, meaning: str = ""
) -> Array:
    """Return a value as an array; ValueError unless its last axes have a given shape.

    Examples
    --------
    >>> last_axes([1.0, 0.0, 0.0, 0.0], (4,), name="stokes").shape
    (4,)
    """
    array = np.asarray(value, dtype=np.float64)
    if array.shape[-len(shape) :] != shape:
        detail = f" {meaning}" if meaning else ""
        raise ValueError(
            f"{name} must have last axes {shape}{detail}, got {array.shape}"
        )
    return array


def _checked(
    value: ArrayLike,
    allowed: Callable[[Any], Any],
    rule: str,
    *,
    name: str,
    unit: str,
    hint: str = "",
) -> Array:
    array = np.asarray(value, dtype=np.float64)
    good = allowed(array)
    if not good.all():
        require(array, good, name=name, rule=rule, unit=unit, hint=hint)
    return array


def _text(number: float) -> str:
    """Format a number for an error message; pi and -pi by name."""
    return {np.pi: "pi", -np.pi: "-pi"}.get(number, f"{number:g}")
