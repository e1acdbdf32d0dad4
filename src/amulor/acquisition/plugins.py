"""Devices of other packages, by their entry points."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from typing import Any

from amulor import _plugins
from amulor.acquisition.clock import Clock
from amulor.errors import InstrumentError

#: Entry points of each part of a devices file.
GROUPS = {
    "lock_in": "amulor.lock_ins",
    "scanner": "amulor.scanners",
    "laser": "amulor.lasers",
    "source": "amulor.sources",
    "digitiser": "amulor.digitisers",
}


@dataclass(frozen=True, kw_only=True)
class Wiring:
    """Arguments of the factory of a device."""

    address: str | None
    """Address in the devices file."""
    timeout: float
    """Longest wait for one answer [s]."""
    clock: Clock
    """Clock of all waits: use `clock.sleep`, never `time.sleep`."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Table `options` of the part in the devices file."""


#: Factory of a device, named by an entry point.
Factory = Callable[[Wiring], Any]


def names(part: str) -> list[str]:
    """Return the names of devices that installed packages offer.

    Parameters
    ----------
    part : str
        One of `GROUPS`.

    Returns
    -------
    list of str
        In alphabetical order.
    """
    return list(_plugins.names(GROUPS[part]))


def make(part: str, name: str, wiring: Wiring) -> Any:
    """Make a device of another package.

    Parameters
    ----------
    part : str
        One of `GROUPS`.
    name : str
        Name of its entry point.
    wiring : Wiring
        Arguments of its factory.

    Returns
    -------
    object
        Device with the protocol of its part, see `amulor.acquisition.protocols`.

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
    except Exception as error:  # it is a program of others
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
    return device


_EVERY = ("identity", "make_safe", "close")
_NEEDED = {
    "lock_in": (
        *_EVERY, "prepare", "set_frequency", "read", "relieve", "sharpen", "full_scale",
    ),
    "scanner": (*_EVERY, "move"),
    "laser": (*_EVERY, "on", "off"),
    "source": (*_EVERY, "set_frequency"),
    "digitiser": (*_EVERY, "prepare", "set_range", "set_frequencies", "acquire"),
}  # fmt: skip
