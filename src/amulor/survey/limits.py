"""Limits of the numbers in a survey file, each with its reason.

Whoever builds a survey in Python may go beyond, to look at limits of the formulas. In a
file such a number is a slip: a unit that was mistaken, or a digit too many.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from amulor import units

__all__ = ["LIMITS", "Limit", "beyond"]


@dataclass(frozen=True, kw_only=True)
class Limit:
    """Largest and, if any, smallest magnitude of a number in a survey file."""

    quantity: str
    """Physical quantity, a key of `amulor.units.SI_UNITS`."""
    least: float | None = None
    """Smallest allowed value; for coordinates, the smallest magnitude [SI]."""
    most: float
    """Largest allowed value; for coordinates, the largest magnitude [SI]."""
    reason: str
    """Reason of the limits."""

    def broken(self, value: float) -> str:
        """Return the error message for a value outside the limits, else empty text."""
        if abs(value) > self.most:
            word, end = "at most", self.most
        elif self.least is not None and abs(value) < self.least:
            word, end = "at least", self.least
        else:
            return ""
        return (
            f'found "{units.write(value, self.quantity)}", but it must be {word} '
            f"{units.write(end, self.quantity)}: {self.reason}"
        )


_COEFFICIENT = Limit(
    quantity="attenuation coefficient",
    most=1000.0,
    reason="undiluted milk scatters about as much, and nothing is seen through it",
)
_PLACE = Limit(
    quantity="length",
    most=20.0,
    reason="emitter and receiver are parts of one instrument",
)
_TARGET = Limit(
    quantity="length", most=1000.0, reason="no laser is seen so far through water"
)
_SIZE = Limit(quantity="length", most=1000.0, reason="no scan is so wide")

#: Limits by the path of the field; `*` matches each item of a list.
LIMITS: Mapping[str, Limit] = {
    **{
        f"water.{name}": _COEFFICIENT
        for name in (
            "absorption",
            "scattering",
            "cdom_absorption",
            "layers.*.absorption",
            "layers.*.scattering",
        )
    },
    "water.column_end": _TARGET,
    "water.layers.*.thickness": _TARGET,
    "targets.*.position.*": _TARGET,
    **{
        f"targets.*.{name}": _SIZE
        for name in ("width", "height", "tread_width", "diameter", "step_heights.*")
    },
    "instrument.emitter.position.*": _PLACE,
    "instrument.receiver.position.*": _PLACE,
    "instrument.receiver.radius": Limit(
        quantity="length",
        least=1e-5,
        most=1.0,
        reason="a receiver is a lens or a bare detector, not a wall",
    ),
    "instrument.window.distance": _PLACE,
    "instrument.window.thickness": Limit(
        quantity="length", most=1.0, reason="windows are thinner"
    ),
    "instrument.power": Limit(
        quantity="power",
        least=1e-9,
        most=100.0,
        reason="modulated blue lasers have milliwatts to watts",
    ),
    "instrument.modulation_frequencies.*": Limit(
        quantity="frequency",
        least=1e3,
        most=1e10,
        reason="below, phases do not tell a distance (mHz are thousandths of 1 Hz)",
    ),
    "instrument.detector.dark_rate": Limit(
        quantity="frequency", most=1e15, reason="it would drown all light"
    ),
    "instrument.detector.saturation": Limit(
        quantity="voltage",
        least=1e-6,
        most=1e4,
        reason="detectors with amplifier give microvolts to volts",
    ),
    "instrument.lock_in.time_constant": Limit(
        quantity="time", least=1e-8, most=1e3, reason="lock-in amplifiers have others"
    ),
    "scan.dwell": Limit(
        quantity="time", least=1e-7, most=3600.0, reason="it is spent on each pixel"
    ),
}


def beyond(content: Any) -> Iterator[tuple[str, str]]:
    """Yield path and error message of each number outside its limits."""
    for path, limit in LIMITS.items():
        for path_of_value, value in _at(content, path.split("."), ""):
            message = limit.broken(value)
            if message:
                yield path_of_value, message


def _at(content: Any, path: list[str], parent: str) -> Iterator[tuple[str, float]]:
    """Yield full path and value of each number whose path matches a pattern."""
    if content is None:
        return
    if not path:
        if isinstance(content, int | float):
            yield parent, float(content)
        return
    first, remainder = path[0], path[1:]
    if first == "*":
        if isinstance(content, list | tuple):
            for number, item in enumerate(content):
                yield from _at(item, remainder, f"{parent}.{number}")
    elif isinstance(content, Mapping) and first in content:
        yield from _at(
            content[first], remainder, f"{parent}.{first}" if parent else first
        )
