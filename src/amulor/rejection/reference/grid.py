"""Whether planned open-water shots are dense enough for the scan between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.reference import surface
from amulor.rejection.reference.model import water_signal
from amulor.survey import OpenWater, Survey
from amulor.survey.directions import open_water_directions

Floats = NDArray[np.float64]

#: Largest error between the shots that a plan may leave, of the largest signal [1].
LARGEST_ERROR = 0.02
#: Directions along each side of the scan at which it is looked for.
_CHECKS = 33
#: Numbers of rows and columns that are tried in turn.
_NUMBERS = (1, 3, 5, 7, 9, 11)


@dataclass(frozen=True)
class Plan:
    """What planned shots leave between them."""

    error: float
    """Largest error of the interpolation, of the largest water signal [1]."""
    enough: tuple[int, int] | None
    """Columns and rows of shots that would do; None if the scan is too wide for any."""


def judge_plan(survey: Survey) -> Plan | None:
    """Return how well the planned open-water shots of a survey span its scan.

    Parameters
    ----------
    survey : Survey
        Its water, instrument and scan count.

    Returns
    -------
    Plan or None
        None if no shots are planned.

    Notes
    -----
    The water signal of the survey's own water, (46) of Ricci et al. 2010, as rebuilt,
    without noise: what the polynomial of the highest degree that the shots allow
    misses between them. The same for more rows and columns until that is less than
    `LARGEST_ERROR`.
    """
    plan = survey.scan.open_water
    if plan is None:
        return None
    error = _error(survey, plan)
    enough: tuple[int, int] | None = plan.columns, plan.rows
    if error > LARGEST_ERROR:
        tried = [
            OpenWater(columns=columns, rows=rows, repeats=plan.repeats)
            for columns in _NUMBERS
            for rows in _NUMBERS
            if columns >= plan.columns and rows >= plan.rows
        ]
        tried.sort(key=lambda each: each.columns * each.rows)
        enough = next(
            (
                (each.columns, each.rows)
                for each in tried
                if _error(survey, each) <= LARGEST_ERROR
            ),
            None,
        )
    return Plan(error, enough)


def _error(survey: Survey, plan: OpenWater) -> float:
    scan = survey.scan.model_copy(update={"open_water": plan})
    planned = survey.model_copy(update={"scan": scan})
    places = np.stack(open_water_directions(planned), axis=1)[:: plan.repeats]
    across = np.linspace(-0.5, 0.5, _CHECKS) * scan.azimuth_span + scan.azimuth
    up = np.linspace(-0.5, 0.5, _CHECKS) * scan.elevation_span + scan.elevation
    if scan.columns == 1:
        across = np.array([scan.azimuth])
    if scan.rows == 1:
        up = np.array([scan.elevation])
    checks = np.stack([each.ravel() for each in np.meshgrid(across, up)], axis=1)
    expected = surface.noiseless(
        _open_water(survey, places), plan.repeats, places, checks
    )
    truth = _open_water(survey, checks)
    return float(
        np.max(np.abs(expected - truth).max(axis=1) / np.abs(truth).max(axis=1))
    )


def _open_water(survey: Survey, places: Floats) -> NDArray[np.complex128]:
    """Return the water signal over (frequency, direction), in any unit."""
    frequency = np.asarray(survey.instrument.modulation_frequencies)
    return water_signal(survey, *places.T, modulation_frequency=frequency)
