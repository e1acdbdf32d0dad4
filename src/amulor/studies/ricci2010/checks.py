"""What the paper says of a figure, beside what was found."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

#: What a statement is worth here. `test`: nothing was chosen to meet it. `set`: a
#: number of the study was chosen so that it holds, so that it proves nothing.
Role = Literal["test", "set"]


@dataclass(frozen=True, kw_only=True)
class Check:
    """A statement and whether it holds."""

    statement: str
    """What is stated, in a sentence."""
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

    def plain(self) -> dict[str, Any]:
        """Return the check for other programs.

        Returns
        -------
        dict
            Texts, a number and a truth value.
        """
        return dict(vars(self))


def within(
    statement: str,
    value: float,
    low: float,
    high: float,
    *,
    unit: str = "",
    digits: int = 3,
    uncertainty: float | None = None,
    role: Role = "test",
) -> Check:
    """Return the check that a number lies between two others.

    Parameters
    ----------
    statement : str
        What is stated.
    value : float
        What was found; not-a-number does not pass.
    low, high : float
        What would do, each of them infinite where there is no limit.
    unit : str
        Unit of all of them.
    digits : int
        Significant digits to show.
    uncertainty : float, optional
        Standard error of what was found.
    role : {"test", "set"}
        Whether it is a test, or was used to choose a number.

    Returns
    -------
    Check
        With its texts.
    """
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
        role=role,
        value=float(value),
    )


def holds(
    statement: str, truth: bool, *, found: str, wanted: str, role: Role = "test"
) -> Check:
    """Return the check of a statement that is no single number.

    Parameters
    ----------
    statement : str
        What is stated.
    truth : bool
        Whether it holds.
    found, wanted : str
        What was found and what would do.
    role : {"test", "set"}
        Whether it is a test, or was used to choose a number.

    Returns
    -------
    Check
        With these texts.
    """
    return Check(
        statement=statement,
        found=found,
        wanted=wanted,
        passed=bool(truth),
        role=role,
    )
