"""What can be held against the lines of figures 10 to 12: drift, flatness, bend."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from amulor.studies.ricci2010.checks import Check, Role, within
from amulor.studies.ricci2010.scenes.short_lines import line
from amulor.studies.ricci2010.study import Study

#: Drift that the phase error of the apparatus hides [degrees].
FLAT = 0.25
#: Departure of a straight drift, over the drift [1].
STRAIGHT = 0.15
#: Standard errors of the Monte Carlo by which a limit must be passed to count.
SURE = 2.0


def drifts(
    study: Study,
    statement: str,
    step: str,
    pair: str,
    *,
    low: float,
    high: float,
    place: str,
    role: Role | None = None,
) -> Check:
    """Return the check of a drift."""
    result = line(study, step, pair)
    check = within(
        statement,
        result.drift,
        low,
        high,
        place=place,
        unit="deg",
        uncertainty=result.error,
        role=role,
    )
    return replace(
        check,
        found=f"{check.found} (fit to the synthetic line: "
        f"{result.fitted:.2f} ± {result.fitted_error:.2f} deg)",
    )


def stays_flat(
    study: Study,
    statement: str,
    step: str,
    pair: str,
    *,
    place: str,
    role: Role | None = None,
) -> Check:
    """Return the check that a drift stays within the phase error of the apparatus."""
    result = line(study, step, pair)
    check = drifts(
        study, statement, step, pair, low=-FLAT, high=FLAT, place=place, role=role
    )
    return allowing(check, abs(result.drift) - SURE * result.error <= FLAT)


def is_straight(study: Study, step: str, pair: str, *, place: str) -> Check:
    """Return the check that a line drifts evenly."""
    result = line(study, step, pair)
    check = within(
        f"({step}) {pair} drifts along a straight line: departure over drift",
        result.bend,
        0.0,
        STRAIGHT,
        place=place,
        uncertainty=result.bend_error,
    )
    return allowing(check, result.bend - SURE * result.bend_error <= STRAIGHT)


def moves(study: Study, statement: str, step: str, pair: str, *, place: str) -> Check:
    """Return the check that a line drifts beyond the phase error of the apparatus."""
    result = line(study, step, pair)
    check = drifts(study, statement, step, pair, low=FLAT, high=np.inf, place=place)
    return surely(check, result.drift - SURE * result.error >= FLAT)


def surely(check: Check, passed: bool) -> Check:
    """Return a check that was decided with regard to the standard error."""
    wanted = f"{check.wanted}, by {SURE:g} standard errors"
    return replace(check, passed=bool(passed), wanted=wanted)


def allowing(check: Check, passed: bool) -> Check:
    """Return a check that fails only beyond the standard error."""
    wanted = f"{check.wanted}, within {SURE:g} standard errors"
    return replace(check, passed=bool(passed), wanted=wanted)
