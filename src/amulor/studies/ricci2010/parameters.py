"""Input numbers of the study, with source and range, from a TOML file."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from typing import Any, Literal

from amulor import units

#: Source of a number: printed in the paper's text, deduced from printed numbers, or
#: assumed because nothing determines it.
Basis = Literal["text", "deduced", "assumed"]


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """Input number of the study, with source and range."""

    name: str
    """Name in `parameters.toml`."""
    value: float
    """Value in the unit of `amulor.units.SI_UNITS`."""
    basis: Basis
    """Kind of source: "text", "deduced" or "assumed"."""
    reason: str
    """Explanation of the source, in a sentence."""
    shown: str
    """Value as written in the file, with its unit."""
    quantity: str
    """Physical quantity, a key of `amulor.units.SI_UNITS`."""
    limits: tuple[float, float] | None = None
    """Lowest and highest value allowed by the paper; None for a printed value."""
    shown_limits: tuple[str, str] | None = None
    """Limits as written in the file, with their units."""


def load() -> dict[str, Parameter]:
    """Return all input numbers of the study."""
    text = (resources.files("amulor.studies.ricci2010") / "parameters.toml").read_text(
        encoding="utf-8"
    )
    return parse(text)


def parse(text: str) -> dict[str, Parameter]:
    """Parse the input numbers from a TOML text."""
    return {name: _entry(name, entry) for name, entry in tomllib.loads(text).items()}


def varied(
    parameters: Mapping[str, Parameter], name: str, value: float
) -> dict[str, Parameter]:
    """Return the input numbers with one value changed."""
    return {**parameters, name: replace(parameters[name], value=value)}


def _entry(name: str, entry: Mapping[str, Any]) -> Parameter:
    fields = {"value", "quantity", "basis", "reason", "range"}
    wrong = sorted(set(entry) ^ fields - {"range"} - (set(entry) & {"range"}))
    missing = sorted(fields - {"range"} - set(entry))
    if missing or set(entry) - fields:
        raise ValueError(
            f"parameter {name!r}: missing or unknown {', '.join(wrong or missing)}"
        )
    basis, quantity = entry["basis"], entry["quantity"]
    if basis not in ("text", "deduced", "assumed"):
        raise ValueError(
            f"parameter {name!r}: basis is {basis!r}, and must be text, deduced or "
            "assumed"
        )
    if (basis == "text") == ("range" in entry):
        raise ValueError(
            f"parameter {name!r}: a printed number has no range, every other one has"
        )
    value = units.parse(entry["value"], quantity)
    limits = limit_texts = None
    if "range" in entry:
        low, high = (units.parse(end, quantity) for end in entry["range"])
        if not low <= value <= high or low == high:
            raise ValueError(
                f"parameter {name!r}: {entry['value']} is outside its range "
                f"{entry['range'][0]} to {entry['range'][1]}"
            )
        limits, limit_texts = (low, high), (entry["range"][0], entry["range"][1])
    return Parameter(
        name=name,
        value=value,
        basis=basis,
        reason=entry["reason"],
        shown=entry["value"],
        quantity=quantity,
        limits=limits,
        shown_limits=limit_texts,
    )
