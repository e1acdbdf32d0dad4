"""Range checks of the water and receiver arguments of the small-angle models."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

from amulor.optics import _bounds

__all__ = ["Receiver", "checked", "phase_per_depth", "refuse_behind_receiver"]

_Check = Callable[..., NDArray[np.float64]]


def _at_least_one(value: ArrayLike, *, name: str, unit: str) -> NDArray[np.float64]:
    return _bounds.at_least(value, 1.0, name=name, unit=unit)


_LEAST, _MOST = float(np.nextafter(0.0, -1.0)), float(np.finfo(np.float64).max)
_BELOW_ONE = float(np.nextafter(1.0, 0.0))

# Rule, unit, and limits (above, up to) for a float argument.
_RULES: dict[str, tuple[_Check, str, float, float]] = {
    name: (check, unit, above, most)
    for check, above, most, units in (
        (
            _bounds.not_negative,
            _LEAST,
            _MOST,
            {
                "depth": "m",
                "modulation_frequency": "Hz",
                "absorption": "1/m",
                "scattering": "1/m",
                "forward_scattering": "1/m",
                "diffuse_scattering": "1/m",
                "second_moment": "rad^2",
                "backscatter_vsf": "1/(m sr)",
                "baseline": "m",
                "beam_radius": "m",
                "beam_divergence": "rad",
            },
        ),
        (
            _bounds.positive,
            0.0,
            _MOST,
            {"receiver_radius": "m", "acceptance_angle": "rad"},
        ),
        (
            _bounds.finite,
            -np.inf,
            _MOST,
            # Of a surface, depth and standoff together must not be negative.
            {"tilt": "rad", "cross_tilt": "rad", "standoff": "m"},
        ),
        (_at_least_one, _BELOW_ONE, _MOST, {"group_index": ""}),
        (_bounds.reach, _LEAST, np.inf, {"end": "m"}),
    )
    for name, unit in units.items()
}


def checked(name: str, value: ArrayLike) -> Any:
    """Return an argument as float or array; ValueError if outside its allowed range."""
    check, unit, above, most = _RULES[name]
    if type(value) is float and above < value <= most:
        return value
    if isinstance(value, np.ndarray) and value.dtype == np.float64 and value.ndim:
        # Most sweeps; other arguments, and refused ones, are checked below.
        good = value.size > 0 and above < value.min() and value.max() <= most
        if good:
            return value
    array = check(value, name=name, unit=unit)
    return float(array) if array.ndim == 0 else array


def refuse_behind_receiver(standoff: Any, depth: Any = None) -> None:
    """Raise a ValueError if water or surface would lie behind the receiver."""
    if depth is None:
        path, name = standoff, "standoff"
    else:
        path, name = depth + standoff, "depth + standoff"
    if np.any(path < 0):
        _bounds.not_negative(path, name=name, unit="m")


def phase_per_depth(
    modulation_frequency: ArrayLike, *, group_index: ArrayLike
) -> NDArray[np.float64]:
    """Return the phase of an echo per meter of depth [rad/m]."""
    frequency = checked("modulation_frequency", modulation_frequency)
    index = checked("group_index", group_index)
    if not isinstance(index, float):
        _bounds.broadcast(modulation_frequency=frequency, group_index=index)
    return np.asarray(4 * np.pi / speed_of_light * frequency * index)


@dataclass(frozen=True, kw_only=True)
class _Checked:
    """Base class of arguments with range checks on construction."""

    def __post_init__(self) -> None:
        values = self.__dict__  # as the class is frozen
        for name, value in values.items():
            values[name] = checked(name, value)

    def named(self) -> dict[str, Any]:
        """Return the arguments as a dictionary, by argument name."""
        return dict(self.__dict__)


@dataclass(frozen=True, kw_only=True)
class Receiver(_Checked):
    """Receiver size and geometry relative to the beam, as floats or arrays."""

    baseline: Any
    receiver_radius: Any
    acceptance_angle: Any
    tilt: Any
    cross_tilt: Any
    standoff: Any
