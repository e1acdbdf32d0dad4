"""What delay, geometry and group index add to the error of slant ranges."""

from __future__ import annotations

import datetime
import math
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.imaging.geometry import beams_of, medium_of, receivers_of
from amulor.optics import rays
from amulor.survey import Survey
from amulor.survey.calibration import Calibration
from amulor.survey.properties import group_index_uncertainty

Floats = NDArray[np.float64]

#: Terms of the error budget that a calibration states.
CALIBRATION_TERMS = ("delay", "group_index", "geometry")
#: Attributes that say when a cube was measured.
_COVERAGE = ("time_coverage_start", "time_coverage_end")


def calibration_terms(
    one: xr.Dataset, path: Floats, slope: Floats, *, survey: Survey | None
) -> dict[str, Floats]:
    """Return the standard uncertainties that the survey states of the instrument.

    By central differences of the slant range of a fixed path: by the group index, by
    each coordinate of the receiver and by azimuth and elevation of the beams. The
    errors are one and the same for all pixels. The delay is as uncertain as on the day
    of its calibration, and by what it may have changed since with age and temperature,
    in quadrature; its age needs a cube that says when it was measured.
    """
    terms: dict[str, Floats] = {}
    if survey is None:
        return terms
    index = group_index_uncertainty(survey)
    if index is not None:
        terms["group_index"] = _by_index(one, path, index)
    calibration = survey.calibration
    if calibration is None:
        return terms
    delay = _delay_uncertainty(one, calibration)
    if delay is not None:
        terms["delay"] = slope * speed_of_light * delay
    place = calibration.receiver_position_uncertainty
    turn = calibration.direction_uncertainty
    if place is not None and turn is not None:
        terms["geometry"] = _by_geometry(one, path, place=place, turn=turn)
    return terms


def joint_instrument_terms(
    one: xr.Dataset, path: Floats, slope: Floats
) -> dict[str, Floats]:
    """Return what a joint estimation has counted for the instrument, term by term."""
    names = (
        "joint_delay_uncertainty_s",
        "joint_group_index_uncertainty",
        "joint_receiver_position_uncertainty_m",
    )
    if "joint_slant_range" not in one or any(name not in one.attrs for name in names):
        return {}
    delay, index, place = (float(one.attrs[name]) for name in names)
    terms = {
        "delay": slope * speed_of_light * delay,
        "group_index": _by_index(one, path, index),
        "geometry": _by_geometry(one, path, place=place, turn=0.0, axes=2),
    }
    stated = {"delay": delay, "group_index": index, "geometry": place}
    return {name: term for name, term in terms.items() if stated[name] > 0}


def calibration_age(one: xr.Dataset, calibration: Calibration | None) -> float | None:
    """Return how old the calibration of the delay was in the middle of a scan."""
    start = one.attrs.get(_COVERAGE[0])
    if calibration is None or calibration.date is None or start is None:
        return None
    ends = [_moment(one.attrs.get(name, start)) for name in _COVERAGE]
    noon = datetime.datetime.combine(
        calibration.date, datetime.time(12), tzinfo=datetime.UTC
    )
    middle = ends[0] + (ends[1] - ends[0]) / 2
    return (middle - noon) / datetime.timedelta(days=1)


def _moment(text: str) -> datetime.datetime:
    """Return a moment, in UTC where no zone is stated."""
    moment = datetime.datetime.fromisoformat(text)
    return moment if moment.tzinfo else moment.replace(tzinfo=datetime.UTC)


def _delay_uncertainty(one: xr.Dataset, calibration: Calibration) -> float | None:
    """Return the standard uncertainty of the delay in the scan, None if not known."""
    if calibration.delay_uncertainty is None:
        return None
    changes = [calibration.delay_uncertainty]
    if calibration.delay_growth is not None:
        age = calibration_age(one, calibration)
        if age is None:
            return None
        changes.append(calibration.delay_growth * abs(age))
    warmer = calibration.instrument_temperature_uncertainty
    if calibration.delay_per_degree is not None and warmer is not None:
        changes.append(calibration.delay_per_degree * warmer)
    return math.hypot(*changes)


def _by_index(one: xr.Dataset, path: Floats, uncertainty: float) -> Floats:
    """Return the error of the range by that of the group index of the water."""
    beam, receiver, medium = beams_of(one), receivers_of(one), medium_of(one)
    step = max(uncertainty, 1e-6)
    ends = [
        rays.slant_range_of_path(
            path,
            beam,
            receiver,
            medium=replace(medium, group_index=medium.group_index + side * step),
        )
        for side in (1, -1)
    ]
    return np.abs(ends[0] - ends[1]) / (2 * step) * uncertainty


def _by_geometry(
    one: xr.Dataset, path: Floats, *, place: float, turn: float, axes: int = 3
) -> Floats:
    """Return the error of the range by receiver's place and beams' direction."""
    beam, receiver, medium = beams_of(one), receivers_of(one), medium_of(one)
    total = np.zeros(path.shape)
    if place > 0:
        for axis in np.eye(3)[:axes]:
            ends = [
                rays.slant_range_of_path(
                    path, beam, receiver + side * place * axis, medium=medium
                )
                for side in (1, -1)
            ]
            total = total + ((ends[0] - ends[1]) / 2) ** 2
    if turn > 0:
        for name in ("azimuth", "elevation"):
            angle = one[name]
            ends = [
                rays.slant_range_of_path(
                    path,
                    beams_of(one.assign_coords({name: angle + side * turn})),
                    receiver,
                    medium=medium,
                )
                for side in (1, -1)
            ]
            total = total + ((ends[0] - ends[1]) / 2) ** 2
    return np.sqrt(total)
