"""Devices of other installed packages, loaded by their entry points."""

from __future__ import annotations

import functools
import math
import numbers
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from typing import Any

import numpy as np

from amulor import _plugins
from amulor.acquisition.clock import Clock
from amulor.acquisition.protocols import Overload, Reading, Recorded, Waveform
from amulor.errors import AmulorError, InstrumentError

#: Entry points of each part of a devices file.
GROUPS = {
    "lock_in": "amulor.lock_ins",
    "scanner": "amulor.scanners",
    "laser": "amulor.lasers",
    "source": "amulor.sources",
    "digitiser": "amulor.digitisers",
    "navigation": "amulor.navigation",
}


@dataclass(frozen=True, kw_only=True)
class Wiring:
    """Arguments for the factory of a device: address, timeout, clock, options."""

    address: str | None
    """Address in the devices file."""
    timeout: float
    """Longest wait for one answer of the device [s]."""
    clock: Clock
    """Clock of all waits: use `clock.sleep`, never `time.sleep`."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Table `options` of the part in the devices file."""


#: Factory of a device, named by an entry point.
Factory = Callable[[Wiring], Any]


def names(part: str) -> list[str]:
    """Return the names of the drivers that installed packages offer for a part.

    Parameters
    ----------
    part : str
        Part of the instrument, a name in `GROUPS`.

    Returns
    -------
    list of str
        Names in alphabetical order.
    """
    return list(_plugins.names(GROUPS[part]))


def make(part: str, name: str, wiring: Wiring) -> Any:
    """Make a device with the driver of another installed package.

    Parameters
    ----------
    part : str
        Part of the instrument, a name in `GROUPS`.
    name : str
        Name of the entry point.
    wiring : Wiring
        Arguments for the factory.

    Returns
    -------
    object
        Device with the protocol of its part; see `amulor.acquisition.protocols`.

    Raises
    ------
    InstrumentError
        If there is no such device, if it cannot be imported or made, or if it lacks a
        method that a scan needs.
    """
    entries = metadata.entry_points(group=GROUPS[part], name=name)
    if not entries:
        raise InstrumentError(
            f"no installed package offers the {part} {name!r} (entry point "
            f"{GROUPS[part]}); there are: {', '.join(names(part)) or 'none'}"
        )
    (entry, *_) = entries
    try:
        device = entry.load()(wiring)
    except InstrumentError:
        raise
    except Exception as error:  # code of another package
        raise InstrumentError(
            f"the {part} {name!r} of {entry.value} cannot be made: "
            f"{type(error).__name__}: {error}"
        ) from error
    missing = [word for word in _NEEDED[part] if not callable(getattr(device, word, 0))]
    if missing:
        raise InstrumentError(
            f"the {part} {name!r} of {entry.value} has no {', '.join(missing)}; see "
            "amulor.acquisition.protocols"
        )
    return GuardedDevice(device, f"{part} {name!r} of {entry.value}")


class GuardedDevice:
    """Proxy for a device of another package, which checks results and errors."""

    def __init__(self, device: Any, name: str) -> None:
        self._device, self._name = device, name

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the device; methods check their results."""
        value = getattr(self._device, name)
        if not callable(value):
            return value

        @functools.wraps(value)
        def checked(*args: Any, **options: Any) -> Any:
            try:
                result = value(*args, **options)
            except AmulorError:
                raise
            except Exception as error:  # code of another package
                text = " ".join(str(error).split()) or "no message"
                raise InstrumentError(
                    f"the {self._name} has failed in {name}(): "
                    f"{type(error).__name__}: {text}; check its cable, its power and "
                    "its options in the devices file"
                ) from error
            problem = _CHECKS[name](result) if name in _CHECKS else None
            if problem is not None:
                raise InstrumentError(
                    f"{name}() of the {self._name} has answered {problem}; correct "
                    "that driver, see amulor.acquisition.protocols"
                )
            return result

        return checked


def _number(value: Any, *, what: str, least: float = -math.inf) -> str | None:
    """Describe why a value is not a valid number; None if it is valid."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return f"{_shown(value)}, needed is a number ({what})"
    if not math.isfinite(value):
        return f"{float(value):g}, needed is a finite number ({what})"
    if value <= least:
        return f"{float(value):g}, needed is a number above {least:g} ({what})"
    return None


def _shown(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:60]}..."


def _truth(value: Any) -> str | None:
    if isinstance(value, bool | np.bool_):
        return None
    return f"{_shown(value)}, needed is True or False"


def _text(value: Any) -> str | None:
    return None if isinstance(value, str) else f"{_shown(value)}, needed is a text"


def _state(value: Reading | Recorded) -> str | None:
    """Describe an error in overload bits or mean output; None if they are valid."""
    known = sum(map(int, Overload))
    if not isinstance(value.overload, int) or int(value.overload) & ~known:
        return (
            f"overload = {_shown(value.overload)}, needed is a sum of the bits of "
            f"Overload, at most {known}"
        )
    if not isinstance(value.mean, numbers.Real) or math.isinf(value.mean):
        return f"mean = {_shown(value.mean)}, needed is a number in V, nan if not wired"
    return None


def _reading(value: Any) -> str | None:
    if not isinstance(value, Reading):
        return f"{_shown(value)}, needed is a Reading"
    signal = value.signal
    if not isinstance(signal, numbers.Complex) or not np.isfinite(complex(signal)):
        return f"signal = {_shown(signal)}, needed is a finite complex number in V"
    frequency = _number(value.modulation_frequency, what="in Hz")
    return _state(value) or (frequency and f"modulation_frequency = {frequency}")


def _recorded(value: Any) -> str | None:
    if not isinstance(value, Recorded):
        return f"{_shown(value)}, needed is a Recorded"
    times, signals = np.asarray(value.times), np.asarray(value.signals)
    if signals.ndim != 2 or times.shape != signals.shape[:1]:
        return (
            f"times of shape {times.shape} and signals of shape {signals.shape}, "
            "needed are (n,) and (n, frequency)"
        )
    if not (np.isfinite(times).all() and np.isfinite(signals).all()):
        return "times or signals that are not finite numbers"
    return _state(value)


def _waveform(value: Any) -> str | None:
    if not isinstance(value, Waveform):
        return f"{_shown(value)}, needed is a Waveform"
    if not np.isfinite(np.asarray(value.signal, dtype=float)).all():
        return "a signal that is not of finite numbers"
    return _number(value.sample_rate, what="sample rate in 1/s", least=0.0)


def _all_of(
    check: Callable[[Any], str | None], *, count: int | None = None
) -> Callable[[Any], str | None]:
    """Return a check that applies another check to all items of a sequence."""

    def checked(value: Any) -> str | None:
        if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray):
            return f"{_shown(value)}, needed is a sequence"
        if count is not None and len(value) != count:
            return f"{len(value)} values, needed are {count}"
        return next(filter(None, map(check, value)), None)

    return checked


def _message(value: Any) -> str | None:
    if not isinstance(value, tuple) or len(value) != 2:
        return f"{_shown(value)}, needed are time of arrival and line of text"
    return _number(value[0], what="arrival in s") or _text(value[1])


def _laser_readings(value: Any) -> str | None:
    if not isinstance(value, Mapping):
        return f"{_shown(value)}, needed is a dict"
    unknown = [str(name) for name in value if name not in _LASER_READINGS]
    if unknown:
        return f"{', '.join(unknown)}, possible are {' and '.join(_LASER_READINGS)}"
    problems = (_number(number, what="in A or degC") for number in value.values())
    return next(filter(None, problems), None)


_LASER_READINGS = ("laser_current", "laser_temperature")
_frequency = functools.partial(_number, what="frequency in Hz", least=0.0)
_angle = functools.partial(_number, what="angle in rad")
_voltage = functools.partial(_number, what="in V")
#: Check of the result of each method of a device.
_CHECKS: dict[str, Callable[[Any], str | None]] = {
    "identity": _text,
    "read": _reading,
    "read_all": _all_of(_reading),
    "record": _recorded,
    "fetch": _recorded,
    "acquire": _waveform,
    "set_frequency": _frequency,
    "set_frequencies": _all_of(_frequency),
    "full_scale": functools.partial(_number, what="in V", least=0.0),
    "relieve": _truth,
    "sharpen": _truth,
    "move": _all_of(_angle, count=2),
    "where": _all_of(_angle, count=2),
    "set_output": _voltage,
    "input": _voltage,
    "readings": _laser_readings,
    "messages": _all_of(_message),
}
_EVERY = ("identity", "make_safe", "close")
_NEEDED = {
    "lock_in": (
        *_EVERY, "prepare", "set_frequency", "read", "relieve", "sharpen", "full_scale",
    ),
    "scanner": (*_EVERY, "move"),
    "laser": (*_EVERY, "on", "off"),
    "source": (*_EVERY, "set_frequency"),
    "digitiser": (*_EVERY, "prepare", "set_range", "set_frequencies", "acquire"),
    "navigation": (*_EVERY, "begin", "messages"),
}  # fmt: skip
