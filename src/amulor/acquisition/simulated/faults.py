"""Faults that simulated devices show on purpose, timed by the number of a reading."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong."""

    kind: str
    """overload, saturation, unlock, lost-link, timeout, stuck, darkness (the light is
    blocked behind the laser) or interlock (it is open)."""
    first: int
    """Number of the reading that it begins at, counted from 1 [1]."""
    count: int
    """How many readings it lasts [1]."""


@dataclass(frozen=True)
class Faults:
    """All faults of a simulated instrument."""

    planned: tuple[Fault, ...] = ()
    """In any order."""

    @classmethod
    def parse(cls, texts: Iterable[str]) -> Faults:
        """Return the faults that texts such as "unlock@500x3" stand for.

        Parameters
        ----------
        texts : iterable of str
            Kind, first reading and, after an x, how many readings; one by default.

        Returns
        -------
        Faults
            In the same order.

        Examples
        --------
        >>> Faults.parse(["unlock@500x3"]).active("unlock", 502)
        True
        """
        result = []
        for text in texts:
            kind, _, when = text.partition("@")
            first, _, count = when.partition("x")
            result.append(Fault(kind, int(first), int(count or 1)))
        return cls(tuple(result))

    def active(self, kind: str, reading: int) -> bool:
        """Return whether a fault of a kind shows at a reading.

        Parameters
        ----------
        kind : str
            As in `Fault`.
        reading : int
            Number of the reading, counted from 1 [1].

        Returns
        -------
        bool
            True if one does.
        """
        return any(
            fault.kind == kind and fault.first <= reading < fault.first + fault.count
            for fault in self.planned
        )
