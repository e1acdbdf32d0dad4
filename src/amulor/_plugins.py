"""Entry-point names of installed packages, without importing the packages."""

from __future__ import annotations

from importlib import metadata

#: Group of the rejection methods.
REJECTION = "amulor.rejection"


def names(group: str) -> tuple[str, ...]:
    """Return the names of a group's entry points in alphabetical order."""
    return tuple(sorted(metadata.entry_points(group=group).names))
