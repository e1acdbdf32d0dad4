"""What delay, geometry and group index add to the error of slant ranges."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.imaging.observation import Observation
from amulor.survey.calibration import Calibration
from amulor.survey.properties import group_index_uncertainty

Floats = NDArray[np.float64]

#: Terms of the error budget that a calibration states.
CALIBRATION_TERMS = ("delay", "group_index", "geometry")
#: Attributes that say when a cube was measured.
_COVERAGE = ("time_coverage_start", "time_coverage_end")


def calibration_terms(
    seen: Observation, path: Floats, slope: Floats
) -> dict[str, Floats]:
    """Return the standard uncertainties that the survey states of the instrument.

    By central differences of the slant range of a fixed path: by the group index, by
    each coordinate of the receiver and by azimuth and elevation of the beams. The
    errors are one and the same for all pixels. The delay is as uncertain as on the day
    of its calibration, and by what it may have changed since with age and temperature,
    in quadrature; its age needs a cube that says when it was measured.
    """
    terms: dict[str, Floats] = {}
    survey = seen.survey
    if survey is None:
        return terms
    index = group_index_uncertainty(survey)
    if index is not None:
        terms["group_index"] = seen.geometry.error_by_index(path, index)
    calibration = survey.calibration
    if calibration is None:
        return terms
    delay = _delay_uncertainty(seen.channel.attrs, calibration)
    if delay is not None:
        terms["delay"] = slope * speed_of_light * delay
    place = calibration.receiver_position_uncertainty
    turn = calibration.direction_uncertainty
    if place is not None and turn is not None:
        terms["geometry"] = seen.geometry.error_by_place(path, place, turn)
    return terms


def joint_instrument_terms(
    seen: Observation, path: Floats, slope: Floats
) -> dict[str, Floats]:
    """Return what a joint estimation has counted for the instrument, term by term."""
    sizes = seen.joint_values(
        "delay_uncertainty_s",
        "group_index_uncertainty",
        "receiver_position_uncertainty_m",
    )
    if sizes is None:
        return {}
    delay, index, place = sizes
    terms = {
        "delay": slope * speed_of_light * delay,
        "group_index": seen.geometry.error_by_index(path, index),
        "geometry": seen.geometry.error_by_place(path, place, 0.0, axes=2),
    }
    return {
        name: term
        for (name, term), size in zip(terms.items(), sizes, strict=True)
        if size > 0
    }


def calibration_age(
    stated: Mapping[str, Any], calibration: Calibration | None
) -> float | None:
    """Age of the calibration of the delay in the middle of a scan [days]."""
    start = stated.get(_COVERAGE[0])
    if calibration is None or calibration.date is None or start is None:
        return None
    ends = [_moment(stated.get(name, start)) for name in _COVERAGE]
    noon = datetime.datetime.combine(
        calibration.date, datetime.time(12), tzinfo=datetime.UTC
    )
    middle = ends[0] + (ends[1] - ends[0]) / 2
    return (middle - noon) / datetime.timedelta(days=1)


def _moment(text: str) -> datetime.datetime:
    """Return a moment, in UTC where no zone is stated."""
    moment = datetime.datetime.fromisoformat(text)
    return moment if moment.tzinfo else moment.replace(tzinfo=datetime.UTC)


def _delay_uncertainty(
    stated: Mapping[str, Any], calibration: Calibration
) -> float | None:
    """Return the standard uncertainty of the delay in the scan, None if not known."""
    if calibration.delay_uncertainty is None:
        return None
    changes = [calibration.delay_uncertainty]
    if calibration.delay_growth is not None:
        age = calibration_age(stated, calibration)
        if age is None:
            return None
        changes.append(calibration.delay_growth * abs(age))
    warmer = calibration.instrument_temperature_uncertainty
    if calibration.delay_per_degree is not None and warmer is not None:
        changes.append(calibration.delay_per_degree * warmer)
    return math.hypot(*changes)
