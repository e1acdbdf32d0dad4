"""Results of the study: checks, sensitivity, tables and report."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from matplotlib.figure import Figure

from amulor.studies.ricci2010.parameters import Parameter
from amulor.studies.ricci2010.study import Study
from amulor.view.report import Heading, Paragraph, Part, Picture, Table, write_report

#: What a statement is worth here. `test`: the paper says it, and nothing was chosen to
#: meet it. `set`: a number of the study was chosen so that it holds, so that it proves
#: nothing. `own`: a check of ours, not of the paper.
Role = Literal["test", "set", "own"]


@dataclass(frozen=True, kw_only=True)
class Check:
    """Statement of the paper or the study, with the result and outcome of its check."""

    statement: str
    """Statement, as a sentence."""
    place: str
    """Place of the statement in the paper; empty if not in the paper."""
    found: str
    """Result with unit, and with standard error if random."""
    wanted: str
    """Required result, with unit."""
    passed: bool
    """Whether the result confirms the statement."""
    role: Role = "test"
    """Role of the statement: test, or basis of an input number."""
    value: float | None = None
    """Result as a number, in the unit of `found`."""

    def __post_init__(self) -> None:
        """Raise a ValueError if a paper statement has no place, or another one has."""
        if (self.role == "own") == bool(self.place):
            raise ValueError(
                f"check {self.statement!r}: a statement of the paper says where it "
                f"stands there, a check of ours does not; got role {self.role!r} and "
                f"place {self.place!r}"
            )

    def plain(self) -> dict[str, Any]:
        """Return the check as plain values, for JSON."""
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
    """Return the check that a number lies between two limits."""
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
    """Return the check of a statement that is true or false."""
    return Check(
        statement=statement,
        found=found,
        wanted=wanted,
        passed=bool(truth),
        place=place,
        role=role or _role(place),
    )


def _role(place: str) -> Role:
    """Return the role of a check: test of a paper statement, or check of the study."""
    return "test" if place else "own"


@dataclass(frozen=True, eq=False)
class Statements:
    """Title, caption and statements of a figure, from `statements.toml`."""

    title: str
    """Short title."""
    caption: str
    """Caption."""
    checks: Mapping[str, Mapping[str, Any]]
    """Statement, place, limits, unit and role of each check, by check name."""

    def row(self, name: str, **words: Any) -> dict[str, Any]:
        """Return the texts of a check, with placeholders replaced by words."""
        return {
            key: value.format(**words) if isinstance(value, str) else value
            for key, value in self.checks[name].items()
            if key != "kind"
        }

    def within(
        self,
        name: str,
        value: float,
        low: float = -math.inf,
        high: float = math.inf,
        *,
        uncertainty: float | None = None,
        note: str = "",
        **words: Any,
    ) -> Check:
        """Return the check that a number lies between two limits, with a note."""
        row = {"place": "", "low": low, "high": high, **self.row(name, **words)}
        check = within(value=value, uncertainty=uncertainty, **row)
        return replace(check, found=check.found + note)

    def holds(
        self, name: str, truth: bool, found: str, *, wanted: str = "", **words: Any
    ) -> Check:
        """Return the check of a statement that is true or false."""
        row = {"place": "", "wanted": wanted, **self.row(name, **words)}
        return holds(truth=truth, found=found, **row)


@cache
def statements(figure: int) -> Statements:
    """Return title, caption and statements of a figure."""
    path = resources.files("amulor.studies.ricci2010") / "statements.toml"
    table = tomllib.loads(path.read_text(encoding="utf-8"))[f"figure_{figure:02d}"]
    return Statements(**{"checks": {}, **table})


@dataclass(frozen=True)
class PaperFigure:
    """Figure of the paper: its statements, checks and drawing."""

    number: int
    """Figure number in the paper."""
    checks: Callable[[Study], list[Check]]
    """Function that compares the reproduction with the statements."""
    draw: Callable[[Study], Figure]
    """Function that draws the figure."""

    @property
    def title(self) -> str:
        """Short title of the figure."""
        return statements(self.number).title

    @property
    def caption(self) -> str:
        """Figure caption."""
        return statements(self.number).caption


@dataclass(frozen=True, kw_only=True)
class Change:
    """Result of a check with one input number at an end of its range."""

    parameter: str
    """Name of the input number."""
    shown: str
    """Value of the input number at the end of its range, with unit."""
    found: str
    """Result of the check, as text."""
    passed: bool
    """Whether the check passes."""
    value: float | None
    """Result as a number."""


@dataclass(frozen=True)
class Dependence:
    """Check with its results at both ends of the range of each input number."""

    figure: int
    """Figure of the paper."""
    check: Check
    """Check with the input numbers at their nominal values."""
    changes: tuple[Change, ...]
    """Results at both ends of each input number that the figure uses."""

    @property
    def flips(self) -> tuple[Change, ...]:
        """Changes of input numbers that reverse the outcome of the check."""
        return tuple(c for c in self.changes if c.passed != self.check.passed)

    @property
    def strongest(self) -> Change | None:
        """Change of an input number with the largest effect; None without values."""
        start = self.check.value
        moved = [c for c in self.changes if c.value is not None]
        if start is None or not moved:
            return None
        return max(moved, key=lambda change: abs((change.value or 0.0) - start))

    def plain(self) -> dict[str, Any]:
        """Return the dependence as plain values, for JSON."""
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
    """Redrawn figure of the paper, with the checks of its statements."""

    number: int
    """Figure number in the paper."""
    title: str
    """Short title."""
    caption: str
    """Caption."""
    checks: tuple[Check, ...]
    """Statements of the paper with their results."""
    drawn: Figure
    """Redrawn figure."""


@dataclass(frozen=True)
class Results:
    """Results of the whole study, or of selected figures."""

    figures: tuple[Redrawn, ...]
    """Figures in the order of the paper."""
    dependence: tuple[Dependence, ...] | None
    """Dependence of each check on the input numbers; None if not computed."""
    parameters: dict[str, Parameter]
    """All input numbers of the study."""

    def plain(self) -> dict[str, Any]:
        """Return all results except the drawings as plain values, for JSON."""
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
    """Return the outcome of a check as a short text for tables."""
    text = "pass" if check.passed else "FAIL"
    return text if check.role == "test" else f"{text} ({check.role})"


def check_rows(checks: Iterable[Check]) -> Rows:
    """Return table rows of checks, with columns as in `CHECK_HEADER`."""
    return [[c.statement, c.place, c.found, c.wanted, verdict(c)] for c in checks]


def dependence_rows(dependence: Iterable[Dependence]) -> Rows:
    """Return table rows of checks whose outcome depends on an input number."""
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
    """Return table rows of input numbers, with columns as in `PARAMETER_HEADER`."""
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
    """Summarize in words how many statements of the paper and of the study hold."""
    listed = list(checks)

    def count(role: Role) -> tuple[int, int]:
        chosen = [check.passed for check in listed if check.role == role]
        return sum(chosen), len(chosen)

    passed, tests = count("test")
    met, chosen = count("set")
    right, unstated = count("own")
    text = f"{passed} of {tests} statements of the paper hold."
    if chosen:
        text += (
            f" For {chosen} more statements, a number of the study was chosen to fit "
            f"the statement, and {met} of these hold."
        )
    if unstated:
        text += (
            f" The study adds {unstated} checks that the paper does not state, and "
            f"{right} of these hold."
        )
    return text


#: Foreword of the report.
FOREWORD = (
    "The paper describes an underwater laser radar with amplitude-modulated light, and "
    "measurements in two water tanks. Its data points and many of its numbers survive "
    "only in pictures that are not available. The measured data in these figures are "
    "therefore synthetic. The models of amulor compute them from the numbers listed at "
    "the end of the page, and add the noise that is listed there. Below each figure, a "
    "table compares statements of the paper with these results. "
    '"FAIL" means that the models do not reproduce the statement. '
    '"(set)" marks a statement that was used to choose a number of the study, so that '
    'it proves nothing. "(own)" marks a check that the paper does not contain.'
)


def write_page(path: Path, results: Results, *, overwrite: bool) -> None:
    """Write figures, checks, dependences and input numbers as one HTML file."""
    checks = [check for figure in results.figures for check in figure.checks]
    parts: list[Part] = [Paragraph(FOREWORD), Paragraph(tally(checks))]
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
