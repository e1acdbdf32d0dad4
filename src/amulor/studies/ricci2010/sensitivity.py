"""Which number each conclusion depends on: every one varied over its range, in turn."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from amulor.errors import AmulorError
from amulor.studies.ricci2010.checks import Check
from amulor.studies.ricci2010.parameters import varied
from amulor.studies.ricci2010.study import Study

Checks = Callable[[Study], list[Check]]


@dataclass(frozen=True)
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
        """Return it for other programs.

        Returns
        -------
        dict
            Texts, numbers and truth values.
        """
        return {
            "figure": self.figure,
            "statement": self.check.statement,
            "found": self.check.found,
            "passed": self.check.passed,
            "flips": [vars(change) for change in self.flips],
            "changes": [vars(change) for change in self.changes],
        }


def sensitivity(
    study: Study,
    figures: Mapping[int, Checks],
    *,
    progress: Callable[[str, float], None] = lambda step, share: None,
) -> tuple[Dependence, ...]:
    """Vary every number that is not printed in the paper to both ends of its range.

    Parameters
    ----------
    study : Study
        Numbers as they are.
    figures : mapping of int to callable
        Number of each figure to its checks.
    progress : callable, optional
        Called with a step and the share of the work done before it.

    Returns
    -------
    tuple of Dependence
        One for each check, in order.

    Notes
    -----
    One number at a time; numbers that a figure does not read are left alone. The
    noise is the same in all, so that a flip is the number's doing.
    """
    read, before = {}, {}
    for number, checks in figures.items():
        progress(f"what figure {number} reads", 0.0)
        read[number], before[number] = study.read_by(checks)
    changes: dict[tuple[int, int], list[Change]] = {}
    free = [p for p in study.parameters.values() if p.limits is not None]
    for done, parameter in enumerate(free):
        progress(f"varying {parameter.name}", done / len(free))
        assert parameter.limits is not None
        assert parameter.shown_limits is not None
        for value, shown in zip(parameter.limits, parameter.shown_limits, strict=True):
            if value == parameter.value:
                continue
            other = study.with_parameters(
                varied(study.parameters, parameter.name, value)
            )
            for number, checks in figures.items():
                if parameter.name not in read[number]:
                    continue
                for place, (found, text, passed) in enumerate(
                    _outcomes(checks, other, len(before[number]))
                ):
                    changes.setdefault((number, place), []).append(
                        Change(parameter.name, shown, text, passed, found)
                    )
    return tuple(
        Dependence(number, check, tuple(changes.get((number, place), ())))
        for number in figures
        for place, check in enumerate(before[number])
    )


def _outcomes(
    checks: Checks, study: Study, count: int
) -> list[tuple[float | None, str, bool]]:
    """Return value, text and outcome of each check; all fail where nothing comes."""
    try:
        found = checks(study)
    except (AmulorError, ValueError) as problem:
        return [(None, f"cannot be computed: {problem}", False)] * count
    if len(found) != count:
        raise RuntimeError(f"{len(found)} checks where there were {count}")
    return [(check.value, check.found, check.passed) for check in found]
