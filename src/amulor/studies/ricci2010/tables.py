"""The tables of the study as rows of text, for terminal, report and gallery."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from amulor.studies.ricci2010.checks import Check
from amulor.studies.ricci2010.parameters import Parameter
from amulor.studies.ricci2010.sensitivity import Dependence

Rows = list[list[str]]

CHECK_HEADER = ("statement", "found", "needed", "result")
DEPENDENCE_HEADER = ("figure", "statement", "as it is", "flips when")
PARAMETER_HEADER = ("number", "value", "basis", "range", "why")


def verdict(check: Check) -> str:
    """Return the outcome of a check in a word or two.

    Parameters
    ----------
    check : Check
        Statement and outcome.

    Returns
    -------
    str
        "pass" or "FAIL", and whether a number was chosen for it.
    """
    text = "pass" if check.passed else "FAIL"
    return f"{text} (set)" if check.role == "set" else text


def check_rows(checks: Iterable[Check]) -> Rows:
    """Return one row for each check, under `CHECK_HEADER`.

    Parameters
    ----------
    checks : iterable of Check
        Statements and outcomes.

    Returns
    -------
    list of list of str
        Cells.
    """
    return [[c.statement, c.found, c.wanted, verdict(c)] for c in checks]


def dependence_rows(dependence: Iterable[Dependence]) -> Rows:
    """Return one row for each conclusion that flips, under `DEPENDENCE_HEADER`.

    Parameters
    ----------
    dependence : iterable of Dependence
        All conclusions.

    Returns
    -------
    list of list of str
        Cells.
    """
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
    """Return one row for each number, under `PARAMETER_HEADER`.

    Parameters
    ----------
    parameters : mapping of str to Parameter
        All numbers.

    Returns
    -------
    list of list of str
        Cells.
    """
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
    """Return how many statements hold, in a sentence.

    Parameters
    ----------
    checks : iterable of Check
        Statements and outcomes.

    Returns
    -------
    str
        Tests and set statements are counted apart.
    """
    every = list(checks)
    tests = [check for check in every if check.role == "test"]
    chosen = [check for check in every if check.role == "set"]
    text = f"{sum(c.passed for c in tests)} of {len(tests)} statements hold"
    if not chosen:
        return f"{text}."
    return (
        f"{text}; of {len(chosen)} more, for which a number of the study was chosen, "
        f"{sum(c.passed for c in chosen)} hold."
    )
