"""Error budget of a range image: error terms, their sum, and unknown errors."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.cube import QualityFlag, error_unknown
from amulor.cube.error import (
    SHAPE_KNOWN,
    by_frequency,
    instrument_phase,
    leakage_volt,
)
from amulor.cube.schema import RANGE_PREFIX, TERMS, Term
from amulor.imaging.corners import Patches, corner_error
from amulor.imaging.instrument_tests import InstrumentTest, instrument_tests
from amulor.imaging.late_light import LateFit, late_light
from amulor.imaging.observation import Observation
from amulor.imaging.ranges import Ranges
from amulor.imaging.surroundings import SurroundingLight, surroundings_error
from amulor.survey.calibration import Calibration
from amulor.survey.properties import group_index_uncertainty

Floats = NDArray[np.float64]


def completed(
    observation: Observation,
    ranges: Ranges,
    *,
    fit: LateFit | None = None,
    patches: Patches | None = None,
    around: SurroundingLight | None = None,
) -> tuple[Ranges, dict[str, Any], LateFit, Patches | None, SurroundingLight | None]:
    """Subtract late light, add error terms; return ranges, attributes, statistics."""
    slant_range = np.where(ranges.usable, ranges.slant_range, np.nan)
    light, fit = late_light(observation, slant_range, weight=ranges.weight, fit=fit)
    ranges, shared = _without_instrument(observation, ranges)
    if light.note == "taken off":
        ranges = _without_late_light(observation, ranges)
    # Values stated in the survey replace the assumptions of the estimation.
    shared |= calibration_terms(observation, ranges.path, ranges.slope)
    phases = instrument_term(observation, ranges.weight, ranges.slope)
    if phases is not None:
        shared["instrument"] = phases
    corners, patches = corner_error(
        observation,
        slant_range - light.late,
        weight=ranges.weight,
        slope=ranges.slope,
        noise=ranges.total,
        fit=patches,
    )
    flag = ranges.flag
    others = [term**2 for term in shared.values()]
    rest = np.sqrt(np.sum([ranges.total**2, *others], axis=0))
    surroundings, around = surroundings_error(
        observation,
        slant_range - light.late,
        weight=ranges.weight,
        slope=ranges.slope,
        noise=rest,
        fit=around,
    )
    if surroundings is not None:
        shared["surroundings"] = surroundings
    if corners is not None:
        flag = flag | np.where(corners > rest, np.int16(QualityFlag.CORNER), 0)
        shared["corners"] = corners
    unknown = _unknown_of_water(observation.channel)
    unknown += [name for name in CALIBRATION_TERMS if name not in shared]
    further = dict(ranges.others)
    if light.uncertainty is None:
        unknown.append("late_echo")
    elif light.note == "taken off":
        shared["late_echo"] = light.uncertainty
        further["slant_range_late_echo"] = light.late
    attributes: dict[str, Any] = {
        "late_echo_correction": light.note,
        "uncertainty_unknown": " ".join(name for name in TERMS if name in unknown),
    }
    calibration = None if observation.survey is None else observation.survey.calibration
    if calibration is not None and calibration.date is not None:
        attributes["delay_calibrated"] = calibration.date.isoformat()
        age = calibration_age(observation.channel.attrs, calibration)
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
            flag=flag,
            total=total,
            terms={**ranges.terms, **shared},
            common=common,
            others=further,
        ),
        attributes,
        fit,
        patches,
        around,
    )


def _without_instrument(
    observation: Observation, ranges: Ranges
) -> tuple[Ranges, dict[str, Floats]]:
    """Subtract instrument terms from joint-estimation errors; return ranges and terms.

    It counts delay, index and place of the receiver in the common error of its ranges.
    """
    terms = joint_instrument_terms(observation, ranges.path, ranges.slope)
    if not terms or ranges.common is None:
        return ranges, {}
    counted = np.sum([term**2 for term in terms.values()], axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        # The estimation's derivatives differ from these in the last digits.
        scale = np.fmin(ranges.common / np.sqrt(counted), 1.0)
        terms = {name: term * scale for name, term in terms.items()}
        counted = counted * scale**2
        common, total = (
            np.sqrt(np.maximum(values**2 - counted, 0.0))
            for values in (ranges.common, ranges.total)
        )
    divided = {**ranges.terms, "water_model": common}
    return replace(ranges, common=common, total=total, terms=divided), terms


def _without_late_light(observation: Observation, ranges: Ranges) -> Ranges:
    """Subtract the late-light term from joint-estimation errors; return the ranges.

    It knows the light by its spread alone; the image knows the water, takes the delay
    off and states what is left. Few frequencies cannot show that the water has another
    shape than its model: there both are kept.
    """
    sizes = observation.joint_values(
        "late_echo_uncertainty", "late_echo_spread_rad2_per_m"
    )
    if sizes is None:
        return ranges
    if len(observation.frequency) < SHAPE_KNOWN or ranges.common is None:
        return ranges
    part, spread = sizes
    depth = observation.geometry.depth(ranges.slant_range)
    counted = np.square(part * 0.25 * spread * np.square(depth))
    with np.errstate(invalid="ignore"):
        common, total = (
            np.sqrt(np.maximum(values**2 - counted, 0.0))
            for values in (ranges.common, ranges.total)
        )
    divided = {**ranges.terms, "water_model": common}
    return replace(ranges, common=common, total=total, terms=divided)


def _unknown_of_water(channel: xr.Dataset) -> list[str]:
    """Names of water-signal errors that open-water references do not determine."""
    unknown = []
    drift = channel.attrs.get("open_water_drift_uncertainty")
    if drift is not None and not np.all(np.isfinite(drift)):
        # Shots that repeat no direction show no change.
        unknown.append("drift")
    if "open_water_degree" in channel.attrs and "residual_in_phase" not in channel:
        # Without a survey the amount of water behind a target is unknown.
        unknown.append("column")
    return unknown


def uncertainties(ranges: Ranges) -> dict[str, Floats]:
    """Uncertainty variables of a range image: total, common part and error terms."""
    variables = {"slant_range_uncertainty": ranges.total}
    if ranges.common is not None:
        variables["slant_range_common_uncertainty"] = ranges.common
    return variables | {
        f"{RANGE_PREFIX}{name}": term for name, term in ranges.terms.items()
    }


@dataclass(frozen=True, kw_only=True)
class BudgetLine:
    """One term of the error budget of an image, median over its usable pixels."""

    term: Term
    """Name of the term, with its evaluation type A or B."""
    uncertainty: float
    """Standard uncertainty [m]."""
    share: float
    """Share of the combined variance [1]."""
    samples: int | None
    """Number of samples behind a type-A term, if stated in the image."""


@dataclass(frozen=True, kw_only=True)
class ErrorBudget:
    """Error budget of a range image in the terms of the GUM.

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
    """Known terms in the order of `amulor.cube.schema`."""
    combined: float
    """Combined standard uncertainty, median over the usable pixels; NaN if unknown
    [m]."""
    common: float
    """Part of the combined uncertainty shared by all pixels; NaN if not stated [m]."""
    unknown: tuple[Term, ...]
    """Unknown error terms, not included in the combined uncertainty."""
    late_echo: str
    """Treatment of late light, or the reason for not subtracting it."""
    late: float
    """Subtracted late-light delay, median; NaN if none [m]."""
    calibrated: str
    """Date of the delay calibration; empty if the survey has none."""
    age: float
    """Age of the calibration at the time of the scan; NaN if the cube has no date
    [days]."""
    error_unknown: str
    """Reason for a missing combined uncertainty of all or some pixels; else empty."""
    tests: tuple[InstrumentTest, ...] = ()
    """Failed instrument tests, from the data of the scan."""

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
        Medians over the pixels with a known uncertainty, NaN without such pixels.
        Without water rejection no uncertainty is known, and the budget has no lines.

    Notes
    -----
    Shares are medians of ratios, so their sum may differ from 1. Images from versions
    without error terms have no lines.

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
        tests=instrument_tests(image),
    )


def age_in_words(days: float) -> str:
    """Age of a calibration in words, to follow its date; empty if unknown."""
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


#: Terms of the error budget that a calibration states.
CALIBRATION_TERMS = ("delay", "group_index", "geometry")
#: Attributes that say when a cube was measured.
_COVERAGE = ("time_coverage_start", "time_coverage_end")


def calibration_terms(
    observation: Observation, path: Floats, slope: Floats
) -> dict[str, Floats]:
    """Range uncertainties due to group index, delay and geometry, where known.

    By central differences of the slant range of a fixed path: by the group index, by
    each coordinate of the receiver and by azimuth and elevation of the beams. The
    errors are common to all pixels. The uncertainty of the delay is that on the day of
    its calibration, plus its possible change with age and temperature, in quadrature.
    The age is known only if the cube states the time of its measurement.
    """
    terms: dict[str, Floats] = {}
    survey = observation.survey
    if survey is None:
        return terms
    index = group_index_uncertainty(survey)
    if index is not None:
        terms["group_index"] = observation.geometry.error_by_index(path, index)
    calibration = survey.calibration
    attributes = observation.channel.attrs
    delay = (
        attributes.get("calibration_delay_uncertainty_s")
        if calibration is None or calibration.delay_uncertainty is None
        else _delay_uncertainty(attributes, calibration)
    )
    if delay is not None:
        terms["delay"] = slope * speed_of_light * float(delay)
    if calibration is None:
        return terms
    place = calibration.receiver_position_uncertainty
    turn = calibration.direction_uncertainty
    if place is not None and turn is not None:
        terms["geometry"] = observation.geometry.error_by_place(path, place, turn)
    return terms


def instrument_term(
    observation: Observation, weight: Floats, slope: Floats
) -> Floats | None:
    """Range error due to instrument phase and method disagreement; None if zero.

    Leakage, walk and harmonics turn each frequency by an angle of its own, of the
    stated or typical size, and by as much as channels or frequencies differ where
    chance does not explain that. If the frequencies differ, the turns of all add up
    with one sign. Unmixing multiplies the former. The error of a measured leakage turns
    weak echoes most. A drift during the scan turns all frequencies the same way.
    """
    channel = observation.channel
    remaining = by_frequency(channel, "instrument_drift_uncertainty_s", 0.0)
    warmer = by_frequency(channel, "temperature_delay_uncertainty_s", 0.0)
    drift = speed_of_light * np.hypot(weight @ remaining, weight @ warmer)
    phases = instrument_phase(channel, observation.survey)
    per_phase = np.abs(weight * observation.path_per_phase.ravel())
    path: Any = np.linalg.norm(per_phase * phases)
    if observation.frequency_phase is not None:
        # Leakage, other water and most errors of a demodulator turn many frequencies
        # the same way: they do not average out.
        path = per_phase @ with_deviations(phases, observation.frequency_phase)
    leakage = leakage_volt(channel)
    if np.any(leakage > 0):
        with np.errstate(divide="ignore", invalid="ignore"):
            turned = (per_phase * leakage)[:, None, None] / np.abs(observation.signal)
        turned = np.where(np.isfinite(turned), turned, 0.0)
        path = np.hypot(path, np.linalg.norm(turned, axis=0))
    # Of `auto`: by how much the ranges of another method differ.
    methods = float(channel.attrs.get("method_disagreement_m", 0.0))
    total = np.hypot(slope * np.hypot(path, drift), methods)
    return total if np.any(total > 0) else None


def with_deviations(phases: Floats, deviations: Floats) -> Floats:
    """Return phase uncertainties, enlarged to cover deviations from one distance [rad].

    The stated or typical uncertainty counts as one further deviation. The fitted
    distance removes one. An interval of 1.96 uncertainties contains 95 % of the errors,
    as Student's factor for so few deviations makes it.
    """
    from scipy.special import stdtrit

    count = deviations.size
    size = np.sqrt((phases**2 + np.sum(deviations**2)) / count)
    student: float = stdtrit(count, 0.975) / 1.96
    return np.maximum(phases, student * size)


def joint_instrument_terms(
    observation: Observation, path: Floats, slope: Floats
) -> dict[str, Floats]:
    """Instrument error terms that are included in the errors of a joint estimation."""
    sizes = observation.joint_values(
        "delay_uncertainty_s",
        "group_index_uncertainty",
        "receiver_position_uncertainty_m",
    )
    if sizes is None:
        return {}
    delay, index, place = sizes
    terms = {
        "delay": slope * speed_of_light * delay,
        "group_index": observation.geometry.error_by_index(path, index),
        "geometry": observation.geometry.error_by_place(path, place, 0.0, axes=2),
    }
    return {
        name: term
        for (name, term), size in zip(terms.items(), sizes, strict=True)
        if size > 0
    }


def calibration_age(
    attributes: Mapping[str, Any], calibration: Calibration | None
) -> float | None:
    """Age of the delay calibration at the middle of a scan; None if unknown [days]."""
    start = attributes.get(_COVERAGE[0])
    if calibration is None or calibration.date is None or start is None:
        return None
    ends = [_moment(attributes.get(name, start)) for name in _COVERAGE]
    noon = datetime.datetime.combine(
        calibration.date, datetime.time(12), tzinfo=datetime.UTC
    )
    middle = ends[0] + (ends[1] - ends[0]) / 2
    return (middle - noon) / datetime.timedelta(days=1)


def _moment(text: str) -> datetime.datetime:
    """Point in time parsed from text, in UTC if no time zone is given."""
    moment = datetime.datetime.fromisoformat(text)
    return moment if moment.tzinfo else moment.replace(tzinfo=datetime.UTC)


def _delay_uncertainty(
    attributes: Mapping[str, Any], calibration: Calibration
) -> float | None:
    """Return the standard uncertainty of the delay during a scan; None if unknown."""
    if calibration.delay_uncertainty is None:
        return None
    changes = [calibration.delay_uncertainty]
    if attributes.get("reference_calibrated"):
        # The standing reference shows changes with age and temperature.
        return changes[0]
    if calibration.delay_growth is not None:
        age = calibration_age(attributes, calibration)
        if age is None:
            return None
        changes.append(calibration.delay_growth * abs(age))
    warmer = calibration.instrument_temperature_uncertainty
    if "temperature_delay_uncertainty_s" in attributes:
        warmer = None
    if calibration.delay_per_degree is not None and warmer is not None:
        changes.append(calibration.delay_per_degree * warmer)
    return math.hypot(*changes)
