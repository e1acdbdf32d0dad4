"""Devices of other packages, found by the entry points that they declare."""

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
    """What a device of another package is made from."""

    address: str | None
    """Where it is reached, as the devices file says."""
    timeout: float
    """How long one answer may take [s]."""
    clock: Clock
    """What waits go by: `clock.sleep`, never `time.sleep`."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """What the part `options` of the devices file says."""


#: Makes a device; entry points name one of these.
Factory = Callable[[Wiring], Any]


def names(part: str) -> list[str]:
    """Return the devices that installed packages offer.

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
    """Return a device of another package.

    Parameters
    ----------
    part : str
        One of `GROUPS`.
    name : str
        Name of its entry point.
    wiring : Wiring
        What it is made from.

    Returns
    -------
    object
        Behind the protocol of its part, see `amulor.acquisition.protocols`.

    Raises
    ------
    InstrumentError
        If there is no such device, it cannot be imported, refuses what it was given, or
        lacks what a scan will ask of it.
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
