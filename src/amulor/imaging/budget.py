"""The error budget of a range image: all terms, their sum, and what is not known."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import error_unknown
from amulor.cube.schema import RANGE_PREFIX, TERMS, Term
from amulor.imaging.calibration import (
    CALIBRATION_TERMS,
    calibration_age,
    calibration_terms,
    joint_instrument_terms,
)
from amulor.imaging.late_light import LateFit, late_light
from amulor.imaging.observation import Observation
from amulor.imaging.ranges import Ranges

Floats = NDArray[np.float64]

#: Frequencies from which on the samples show the shape of the water signal.
_SHAPE_KNOWN = 4


def completed(
    seen: Observation, ranges: Ranges, *, fit: LateFit | None = None
) -> tuple[Ranges, dict[str, Any], LateFit]:
    """Subtract late light and add all known terms; attributes, statistics used."""
    slant_range = np.where(ranges.usable, ranges.slant_range, np.nan)
    light, fit = late_light(seen, slant_range, weight=ranges.weight, fit=fit)
    ranges, shared = _without_instrument(seen, ranges)
    if light.note == "taken off":
        ranges = _without_late_light(seen, ranges)
    # What the survey states wins over what the estimation took for lack of it.
    shared |= calibration_terms(seen, ranges.path, ranges.slope)
    unknown = _unknown_of_water(seen.channel)
    unknown += [name for name in CALIBRATION_TERMS if name not in shared]
    others = dict(ranges.others)
    if light.uncertainty is None:
        unknown.append("late_echo")
    elif light.note == "taken off":
        shared["late_echo"] = light.uncertainty
        others["slant_range_late_echo"] = light.late
    attributes: dict[str, Any] = {
        "late_echo_correction": light.note,
        "uncertainty_unknown": " ".join(name for name in TERMS if name in unknown),
    }
    calibration = None if seen.survey is None else seen.survey.calibration
    if calibration is not None and calibration.date is not None:
        attributes["delay_calibrated"] = calibration.date.isoformat()
        age = calibration_age(seen.channel.attrs, calibration)
        if age is not None:
            attributes["delay_calibration_age_days"] = age
    common, total = ranges.common, ranges.total
    if shared:
        added = np.sum([term**2 for term in shared.values()], axis=0)
        common = np.sqrt(added if common is None else added + common**2)
        total = np.sqrt(added + total**2)
    return (
        replace(
            ranges,
            slant_range=ranges.slant_range - light.late,
            total=total,
            terms={**ranges.terms, **shared},
            common=common,
            others=others,
        ),
        attributes,
        fit,
    )


def _without_instrument(
    seen: Observation, ranges: Ranges
) -> tuple[Ranges, dict[str, Floats]]:
    """Return ranges less what a joint estimation put in for the instrument, and that.

    It counts delay, index and place of the receiver in the common error of its ranges.
    """
    terms = joint_instrument_terms(seen, ranges.path, ranges.slope)
    if not terms or ranges.common is None:
        return ranges, {}
    known = np.sum([term**2 for term in terms.values()], axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        # Its derivatives and those here differ in their last digits.
        scale = np.fmin(ranges.common / np.sqrt(known), 1.0)
        terms = {name: term * scale for name, term in terms.items()}
        known = known * scale**2
        common, total = (
            np.sqrt(np.maximum(values**2 - known, 0.0))
            for values in (ranges.common, ranges.total)
        )
    divided = {**ranges.terms, "water_model": common}
    return replace(ranges, common=common, total=total, terms=divided), terms


def _without_late_light(seen: Observation, ranges: Ranges) -> Ranges:
    """Return ranges less what a joint estimation put in for late light.

    It knows the light by its spread alone; the image knows the water, takes the delay
    off and states what is left. Few frequencies cannot show that the water has another
    shape than its model: there both are kept.
    """
    stated = seen.joint_values("late_echo_uncertainty", "late_echo_spread_rad2_per_m")
    if stated is None:
        return ranges
    if len(seen.frequency) < _SHAPE_KNOWN or ranges.common is None:
        return ranges
    part, spread = stated
    depth = seen.geometry.depth(ranges.slant_range)
    known = np.square(part * 0.25 * spread * np.square(depth))
    with np.errstate(invalid="ignore"):
        common, total = (
            np.sqrt(np.maximum(values**2 - known, 0.0))
            for values in (ranges.common, ranges.total)
        )
    divided = {**ranges.terms, "water_model": common}
    return replace(ranges, common=common, total=total, terms=divided)


def _unknown_of_water(one: xr.Dataset) -> list[str]:
    """Return the terms of the water signal that open-water shots leave open."""
    unknown = []
    drift = one.attrs.get("open_water_drift_uncertainty")
    if drift is not None and not np.all(np.isfinite(drift)):
        # Shots that repeat no direction show no change.
        unknown.append("drift")
    if "open_water_degree" in one.attrs and "residual_in_phase" not in one:
        # No survey tells how much water is behind a target.
        unknown.append("column")
    return unknown


def uncertainties(ranges: Ranges) -> dict[str, Floats]:
    """Return the variables of an image that hold its uncertainty."""
    found = {"slant_range_uncertainty": ranges.total}
    if ranges.common is not None:
        found["slant_range_common_uncertainty"] = ranges.common
    return found | {
        f"{RANGE_PREFIX}{name}": term for name, term in ranges.terms.items()
    }


@dataclass(frozen=True, kw_only=True)
class BudgetLine:
    """One term of the error budget of an image, medians over its usable pixels."""

    term: Term
    """Which one, and whether it is of type A or B."""
    uncertainty: float
    """Standard uncertainty [m]."""
    share: float
    """Part of the combined variance [1]."""
    samples: int | None
    """Measurements that a term of type A was found from, where the image says so."""


@dataclass(frozen=True, kw_only=True)
class ErrorBudget:
    """The error budget of a range image in the words of the GUM.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.polarization(
    ...     samples.cube("ladder"),
    ...     target_ratio=0.242, water_ratio=0.099, water_fluctuation=0.137,
    ... )
    >>> image = imaging.range_image(target)
    >>> budget = imaging.error_budget(image)
    >>> print(f"{1e3 * budget.combined:.2f} mm")
    7.08 mm
    >>> print(f"{1e3 * budget.expanded:.2f} mm with k = 2")
    14.16 mm with k = 2
    """

    lines: tuple[BudgetLine, ...]
    """All terms that are known, in the order of `amulor.cube.schema`."""
    combined: float
    """Combined standard uncertainty, median over the usable pixels; not a number where
    it is not known [m]."""
    common: float
    """Part of it that all pixels share; not a number if the image does not say [m]."""
    unknown: tuple[Term, ...]
    """Terms that nobody knows, and that the combined uncertainty does not hold."""
    late_echo: str
    """Whether late light was taken off, or why not."""
    late: float
    """What was taken off, median; not a number if nothing was [m]."""
    calibrated: str
    """Day on which the delay was calibrated; empty if the survey has none."""
    age: float
    """Days from then to the scan; not a number where the cube has no date."""
    error_unknown: str
    """Why there is no combined uncertainty, or not for all pixels; else empty."""

    @property
    def expanded(self) -> float:
        """Expanded uncertainty with the coverage factor `COVERAGE_FACTOR` [m]."""
        return COVERAGE_FACTOR * self.combined


#: Coverage factor of expanded uncertainties: about 95 of 100 for normal errors [1].
COVERAGE_FACTOR = 2.0


def error_budget(image: xr.Dataset) -> ErrorBudget:
    """Return the error budget of a range image.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.

    Returns
    -------
    ErrorBudget
        Medians over the pixels that state their uncertainty; not a number without any.
        With the water left in none does, and there are no lines.

    Notes
    -----
    Shares are medians of the ratios, so that they need not add up to 1 exactly. An
    image that was made before there were terms has no lines.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.polarization(
    ...     samples.cube("ladder"),
    ...     target_ratio=0.242, water_ratio=0.099, water_fluctuation=0.137,
    ... )
    >>> image = imaging.range_image(target)
    >>> budget = imaging.error_budget(image)
    >>> max(budget.lines, key=lambda line: line.share).term.name
    'fluctuation'
    """
    total = image["slant_range_uncertainty"].values
    usable = np.isfinite(total) & (total > 0)
    shots = image.attrs.get("open_water_shots")
    lines = []
    for term in TERMS.values():
        name = f"{RANGE_PREFIX}{term.name}"
        if name not in image or not usable.any():
            continue
        values = image[name].values
        counted = term.name in _FROM_SHOTS and shots is not None
        lines.append(
            BudgetLine(
                term=term,
                uncertainty=_median(values[usable]),
                share=_median((values[usable] / total[usable]) ** 2),
                samples=int(shots) if counted and shots is not None else None,
            )
        )
    unknown = str(image.attrs.get("uncertainty_unknown", "")).split()
    return ErrorBudget(
        lines=tuple(lines),
        combined=_median(total[usable]),
        common=_median_of(image, "slant_range_common_uncertainty", usable),
        unknown=tuple(TERMS[name] for name in unknown if name in TERMS),
        late_echo=str(image.attrs.get("late_echo_correction", "")),
        late=_median_of(image, "slant_range_late_echo", usable),
        calibrated=str(image.attrs.get("delay_calibrated", "")),
        age=float(image.attrs.get("delay_calibration_age_days", math.nan)),
        error_unknown=error_unknown(image),
    )


def age_in_words(days: float) -> str:
    """Return how old a calibration was, to follow its date."""
    if math.isnan(days):
        return ""
    return f", {abs(days):.0f} days {'before' if days >= 0 else 'after'} the scan"


#: Terms whose size comes from the scatter of the open-water shots.
_FROM_SHOTS = ("fluctuation", "reference")


def _median_of(image: xr.Dataset, name: str, usable: NDArray[np.bool_]) -> float:
    return _median(image[name].values[usable]) if name in image else math.nan


def _median(values: Floats) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else math.nan
