"""What the paper says of a figure, and where, beside what was found."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

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
