"""What a run of the study comes to: figures, checks, dependences, numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure

from amulor.studies.ricci2010.checks import Check
from amulor.studies.ricci2010.parameters import Parameter
from amulor.studies.ricci2010.sensitivity import Dependence


@dataclass(frozen=True, kw_only=True)
class Redrawn:
    """One figure, redrawn."""

    number: int
    """Its number in the paper."""
    title: str
    """Short title."""
    caption: str
    """What is to be seen."""
    checks: tuple[Check, ...]
    """What the paper says of it, beside what was found."""
    drawn: Figure
    """The figure."""


@dataclass(frozen=True)
class Results:
    """The study, or the part of it that was asked for."""

    figures: tuple[Redrawn, ...]
    """In the order of the paper."""
    dependence: tuple[Dependence, ...] | None
    """What each conclusion depends on; None if it was not looked into."""
    parameters: dict[str, Parameter]
    """All numbers of the study."""

    def plain(self) -> dict[str, Any]:
        """Return all but the pictures for other programs."""
        return {
            "figures": [
                {
                    "number": figure.number,
                    "title": figure.title,
                    "caption": figure.caption,
                    "checks": [check.plain() for check in figure.checks],
                }
                for figure in self.figures
            ],
            "sensitivity": None
            if self.dependence is None
            else [dependence.plain() for dependence in self.dependence],
            "parameters": [vars(entry) for entry in self.parameters.values()],
        }
