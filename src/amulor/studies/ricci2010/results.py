"""What a run of the study comes to: checks, tables, files."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from matplotlib.figure import Figure

from amulor.studies.ricci2010.parameters import Parameter
from amulor.view.report import Heading, Paragraph, Part, Picture, Table, write_report

#: What a statement is worth here. `test`: the paper says it, and nothing was chosen to
#: meet it. `set`: a number of the study was chosen so that it holds, so that it proves
#: nothing. `own`: the paper does not say it; it is asked here besides.
Role = Literal["test", "set", "own"]


@dataclass(frozen=True, kw_only=True)
class Check:
    """A statement and whether it holds."""

    statement: str
    """What is stated, in a sentence."""
    place: str
    """Where the paper says it; empty for a check of ours."""
    found: str
    """What was found, with its unit and, where it is random, its standard error."""
    wanted: str
    """What would do, with its unit."""
    passed: bool
    """Whether it does."""
    role: Role = "test"
    """Whether it is a test, or was used to choose a number."""
    value: float | None = None
    """What was found, in the unit of `found`."""

    def __post_init__(self) -> None:
        """Refuse a statement of the paper without its place."""
        if (self.role == "own") == bool(self.place):
            raise ValueError(
                f"check {self.statement!r}: a statement of the paper says where it "
                f"stands there, a check of ours does not; got role {self.role!r} and "
                f"place {self.place!r}"
            )

    def plain(self) -> dict[str, Any]:
        """Return the check for other programs."""
        return dict(vars(self))


def within(
    statement: str,
    value: float,
    low: float,
    high: float,
    *,
    place: str,
    unit: str = "",
    digits: int = 3,
    uncertainty: float | None = None,
    role: Role | None = None,
) -> Check:
    """Return the check that a number lies between two others."""
    space = f" {unit}" if unit else ""

    def text(number: float) -> str:
        return f"{number:.{digits}g}"

    error = "" if uncertainty is None else f" ± {uncertainty:.2g}"
    if math.isinf(low):
        wanted = f"at most {text(high)}{space}"
    elif math.isinf(high):
        wanted = f"at least {text(low)}{space}"
    else:
        wanted = f"{text(low)} to {text(high)}{space}"
    return Check(
        statement=statement,
        found=f"{text(value)}{error}{space}",
        wanted=wanted,
        passed=bool(low <= value <= high),
        place=place,
        role=role or _role(place),
        value=float(value),
    )


def holds(
    statement: str,
    truth: bool,
    *,
    place: str,
    found: str,
    wanted: str,
    role: Role | None = None,
) -> Check:
    """Return the check of a statement that is no single number."""
    return Check(
        statement=statement,
        found=found,
        wanted=wanted,
        passed=bool(truth),
        place=place,
        role=role or _role(place),
    )


def _role(place: str) -> Role:
    """Return what a statement is worth unless it was used to choose a number."""
    return "test" if place else "own"


@dataclass(frozen=True, kw_only=True)
class Change:
    """What became of a check when one number went to an end of its range."""

    parameter: str
    """Name of the number."""
    shown: str
    """Its value there, with its unit."""
    found: str
    """What was found there."""
    passed: bool
    """Whether the check passes there."""
    value: float | None
    """What was found, as a number."""


@dataclass(frozen=True)
class Dependence:
    """One check, and what it does at the ends of all ranges that reach it."""

    figure: int
    """Figure of the paper."""
    check: Check
    """The check with the numbers as they are."""
    changes: tuple[Change, ...]
    """At both ends of each number that its figure reads."""

    @property
    def flips(self) -> tuple[Change, ...]:
        """The changes that turn pass into fail, or fail into pass."""
        return tuple(c for c in self.changes if c.passed != self.check.passed)

    @property
    def strongest(self) -> Change | None:
        """The change that moves the number found the most; None if it is no number."""
        start = self.check.value
        moved = [c for c in self.changes if c.value is not None]
        if start is None or not moved:
            return None
        return max(moved, key=lambda change: abs((change.value or 0.0) - start))

    def plain(self) -> dict[str, Any]:
        """Return it for other programs."""
        return {
            "figure": self.figure,
            "statement": self.check.statement,
            "found": self.check.found,
            "passed": self.check.passed,
            "flips": [vars(change) for change in self.flips],
            "changes": [vars(change) for change in self.changes],
        }


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


Rows = list[list[str]]

CHECK_HEADER = ("statement", "in the paper", "found", "needed", "result")
DEPENDENCE_HEADER = ("figure", "statement", "as it is", "flips when")
PARAMETER_HEADER = ("number", "value", "basis", "range", "why")


def verdict(check: Check) -> str:
    """Return the outcome of a check in a word or two."""
    text = "pass" if check.passed else "FAIL"
    return text if check.role == "test" else f"{text} ({check.role})"


def check_rows(checks: Iterable[Check]) -> Rows:
    """Return one row for each check, under `CHECK_HEADER`."""
    return [[c.statement, c.place, c.found, c.wanted, verdict(c)] for c in checks]


def dependence_rows(dependence: Iterable[Dependence]) -> Rows:
    """Return one row for each conclusion that flips, under `DEPENDENCE_HEADER`."""
    return [
        [
            str(entry.figure),
            entry.check.statement,
            "holds" if entry.check.passed else "does not hold",
            "; ".join(f"{flip.parameter} = {flip.shown}" for flip in entry.flips),
        ]
        for entry in dependence
        if entry.flips
    ]


def parameter_rows(parameters: Mapping[str, Parameter]) -> Rows:
    """Return one row for each number, under `PARAMETER_HEADER`."""
    return [
        [
            entry.name,
            entry.shown,
            entry.basis,
            " to ".join(entry.shown_limits) if entry.shown_limits else "",
            entry.reason,
        ]
        for entry in parameters.values()
    ]


def tally(checks: Iterable[Check]) -> str:
    """Return how many statements hold, in a sentence."""
    every = list(checks)

    def count(role: Role) -> tuple[int, int]:
        chosen = [check.passed for check in every if check.role == role]
        return sum(chosen), len(chosen)

    held, tests = count("test")
    met, chosen = count("set")
    right, own = count("own")
    text = f"{held} of {tests} statements of the paper hold."
    if chosen:
        text += (
            f" For {chosen} more a number of the study was chosen, and {met} of these "
            "hold."
        )
    if own:
        text += (
            f" The study adds {own} checks that the paper does not state; {right} hold."
        )
    return text


#: What a reader must know before the first figure.
FOREWORD = (
    "The data points and many numbers of the paper survive only in pictures that are "
    "not available. The measured data in these figures are synthetic. They are "
    "computed with the models of amulor from the numbers listed at the end, with the "
    'noise of these numbers. "FAIL" means that these physics do not reproduce the '
    'statement. "(set)" marks a statement from which a number of the study was '
    "deduced; it proves nothing. "
    '"(own)" marks a check that the paper does not state.'
)


def write_page(path: Path, results: Results, *, overwrite: bool) -> None:
    """Write figures, checks, dependences and numbers as one HTML file."""
    every = [check for figure in results.figures for check in figure.checks]
    parts: list[Part] = [Paragraph(FOREWORD), Paragraph(tally(every))]
    for figure in results.figures:
        rows = [
            [*row[:-1], f"!{row[-1]}" if row[-1].startswith("FAIL") else row[-1]]
            for row in check_rows(figure.checks)
        ]
        parts += [
            Heading(f"Figure {figure.number}. {figure.title}"),
            Picture(figure.drawn, figure.caption),
            Table(CHECK_HEADER, rows, "What the paper says, and what was found"),
        ]
    if results.dependence is not None:
        parts += [
            Heading("What the conclusions depend on"),
            Paragraph(
                "Every number that is not printed was taken to both ends of its range, "
                "one at a time. These conclusions flip:"
            ),
            Table(
                DEPENDENCE_HEADER,
                dependence_rows(results.dependence),
                "Conclusions that are not listed hold, or fail, at both ends of every "
                "range.",
            ),
        ]
    parts += [
        Heading("The numbers"),
        Table(
            PARAMETER_HEADER,
            parameter_rows(results.parameters),
            "text: printed in the paper; deduced: follows from what is printed; "
            "assumed: chosen, as nothing fixes it",
        ),
    ]
    title = "Ricci et al. 2010, figures 1 and 3 to 15 redrawn"
    write_report(path, title, parts, overwrite=overwrite)
