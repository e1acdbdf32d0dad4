"""The tables of the study as rows of text, for terminal, report and gallery."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from amulor.studies.ricci2010.checks import Check, Role
from amulor.studies.ricci2010.parameters import Parameter
from amulor.studies.ricci2010.sensitivity import Dependence

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
    text = f"{held} of {tests} statements of the paper hold"
    if chosen:
        text += (
            f"; of {chosen} more, for which a number of the study was chosen, {met} "
            "hold"
        )
    if own:
        text += f"; of {own} checks that the paper does not state, {right} hold"
    return f"{text}."
