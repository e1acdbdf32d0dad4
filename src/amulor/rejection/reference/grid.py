"""Check of planned open-water shots by the interpolation error between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.errors import AmulorError
from amulor.rejection.reference.model import is_measure, models_for, open_water
from amulor.rejection.reference.shots import BEYOND_AT_LEAST
from amulor.rejection.reference.surface import (
    FEWEST_SHOTS,
    HIGHEST_DEGREE,
    cross_validation_errors,
    expected_degrees,
    noiseless,
)
from amulor.survey import OpenWater, Scan, Survey
from amulor.survey.directions import open_water_directions
from amulor.survey.properties import by_coefficients
from amulor.survey.water import Water

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Largest allowed interpolation error of a plan, relative to the largest signal; the
#: error in waters outside the tested set may be three times larger [1].
LARGEST_ERROR = 0.01
#: Directions along each side of the scan at which it is looked for.
_CHECKS = 33
#: Numbers of rows and columns that are tried in turn.
_NUMBERS = (1, 3, 5, 7, 9, 11)
#: Factors of absorption and scattering of the waters that the shots may meet: as the
#: survey has it, and waters that lie between the models or beside them.
_WATERS = ((1.0, 1.0), (0.6, 0.6), (1.2, 1.2), (1.7, 1.7), (0.6, 1.5), (1.5, 0.6))
#: How much shots scatter where the survey does not say it, of the signal, and at least,
#: of the largest one [1].
_OF_EACH, _OF_LARGEST = 5e-3, 1e-3


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Interpolation error of planned open-water shots, and a sufficient number."""

    error: float
    """Largest error of the interpolation, relative to the largest water signal [1]."""
    refused: str
    """Reason why the methods would refuse the shots; empty if accepted."""
    enough: tuple[int, int] | None
    """Sufficient columns and rows of shots; None if the scan is too wide."""

    @property
    def holds(self) -> bool:
        """Whether the references are accepted and interpolated accurately enough."""
        return not self.refused and self.error <= LARGEST_ERROR


def judge_plan(survey: Survey) -> Plan | None:
    """Estimate the interpolation error of a survey's planned shots; None without any.

    Shots without noise are interpolated as by `shots.fit_shots`: by a polynomial of the
    signal itself, or of its ratio to the water model with the smallest cross-validation
    error. An F test against the scatter of the shots determines the degree. The
    survey's water would be interpolated without any error by its own model. The test
    therefore includes waters with other absorption and scattering, and the largest
    error of all counts. It is repeated for more rows and columns until the error is
    below `LARGEST_ERROR`.
    """
    plan = survey.scan.open_water
    if plan is None:
        return None
    judge = _Judge(survey)
    error = judge.error(plan)
    refused = _refused(survey.scan, plan)
    enough: tuple[int, int] | None = plan.columns, plan.rows
    if refused or error > LARGEST_ERROR:
        candidates = [
            OpenWater(columns=columns, rows=rows, repeats=plan.repeats)
            for columns in _NUMBERS
            for rows in _NUMBERS
            if columns >= plan.columns and rows >= plan.rows
        ]
        candidates.sort(key=lambda candidate: candidate.columns * candidate.rows)
        enough = next(
            (
                (candidate.columns, candidate.rows)
                for candidate in candidates
                if not _refused(survey.scan, candidate)
                and judge.error(candidate) <= LARGEST_ERROR
            ),
            None,
        )
    return Plan(error=error, refused=refused, enough=enough)


def _refused(scan: Scan, plan: OpenWater) -> str:
    """Return the reason to refuse planned references; empty if acceptable."""
    count = plan.columns * plan.rows * plan.repeats
    if count < FEWEST_SHOTS:
        return f"they are {count}, and {FEWEST_SHOTS} are needed to judge their scatter"
    if scan.moves == "both":
        return ""
    for directions, pixels, span, along in (
        (plan.columns, scan.columns, scan.azimuth_span, "side to side"),
        (plan.rows, scan.rows, scan.elevation_span, "top to bottom"),
    ):
        if directions == 1 and pixels > 1 and span > 2 * BEYOND_AT_LEAST:
            return f"they do not reach the edges of the scan from {along}"
    return ""


def _waters(survey: Survey) -> list[Survey]:
    """Return copies of a survey with possible waters, the stated water first."""
    try:
        described = by_coefficients(survey)
    except AmulorError:
        return [survey]
    water = described.water
    assert isinstance(water, Water)
    others = [
        described.model_copy(
            update={
                "water": water.model_copy(
                    update={
                        "absorption": a * water.absorption,
                        "scattering": b * water.scattering,
                    }
                )
            }
        )
        for a, b in _WATERS[1:]
    ]
    return [survey, *others]


class _Judge:
    """Interpolation test of planned references in several waters, over directions."""

    def __init__(self, survey: Survey) -> None:
        scan = survey.scan
        across = np.linspace(-0.5, 0.5, _CHECKS) * scan.azimuth_span + scan.azimuth
        up = np.linspace(-0.5, 0.5, _CHECKS) * scan.elevation_span + scan.elevation
        if scan.columns == 1:
            across = np.array([scan.azimuth])
        if scan.rows == 1:
            up = np.array([scan.elevation])
        self._survey = survey
        self._frequency = np.asarray(survey.instrument.modulation_frequencies)
        self._checks = np.stack([k.ravel() for k in np.meshgrid(across, up)], axis=1)
        # Where the receiver turns with the beam, the water is the same everywhere.
        waters = [] if scan.moves == "both" else _waters(survey)
        self._waters = [
            (water, open_water(water, self._checks, self._frequency))
            for water in waters
        ]
        self._models: dict[int, Complex] = {}

    def error(self, plan: OpenWater) -> float:
        """Return a plan's peak interpolation error, relative to the largest signal."""
        survey, frequency, checks = self._survey, self._frequency, self._checks
        scan = survey.scan.model_copy(update={"open_water": plan})
        planned = survey.model_copy(update={"scan": scan})
        shots = np.stack(open_water_directions(planned), axis=1)[:: plan.repeats]
        models = models_for(survey, shots, frequency, repeats=plan.repeats)
        predictions = (
            []
            if models is None
            else [candidate(shots, frequency) for candidate in models]
        )
        scatter = survey.water.signal_fluctuation or _OF_EACH
        largest = 0.0
        for water, truth in self._waters:
            signal = open_water(water, shots, frequency)
            best, degrees = _best(
                signal, predictions, shots, plan.repeats, scatter=scatter
            )
            model = None
            if models is not None and best is not None:
                if best not in self._models:
                    self._models[best] = models[best](checks, frequency)
                model = predictions[best], self._models[best]
            expected = noiseless(
                signal, plan.repeats, shots, checks, model=model, degrees=degrees
            )
            off = np.abs(expected - truth).max(axis=1) / np.abs(truth).max(axis=1)
            largest = max(largest, float(off.max()))
        return largest


def _best(
    signal: Complex,
    predictions: list[Complex],
    shots: Floats,
    repeats: int,
    *,
    scatter: float,
) -> tuple[int | None, list[int]]:
    """Select water model (None if not needed) and degrees by cross-validation.

    And the degree of its polynomial at each frequency.
    """
    size = np.abs(signal)
    error = np.hypot(scatter * size, _OF_LARGEST * size.max(axis=1, keepdims=True))
    best, chosen, least = None, [HIGHEST_DEGREE] * len(signal), np.inf
    for number, model in enumerate([None, *predictions]):
        if model is not None and not is_measure(model):
            continue
        degrees = expected_degrees(signal, error, repeats, shots, model=model)
        off = cross_validation_errors(
            signal, repeats, shots, model=model, degrees=degrees
        )
        score = float(np.sum((off / error) ** 2))
        if score < least:
            best, chosen, least = (number - 1 if number else None), degrees, score
    return best, chosen
