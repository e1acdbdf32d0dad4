"""Late light of echoes, whose phases differ with the frequency as changed water."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import SurveyError
from amulor.optics import ranging
from amulor.rejection.observation import Observation
from amulor.survey import Survey, water_properties
from amulor.survey.late_light import (
    DISPERSION_UNCERTAINTY,
    LEAST_PART,
    late_echo_delay,
    late_echo_response,
    states_asymmetry_only,
)
from amulor.survey.view import view

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Natural waters of an asymmetry are late by a part of the Henyey-Greenstein function:
#: mean of a rectangular distribution, and its relative standard uncertainty [1].
_NATURAL = (1 + LEAST_PART) / 2
_OF_NATURAL = (1 - LEAST_PART) / 2 / _NATURAL / 3**0.5


def late_phase(scan: Observation, path: Floats) -> tuple[Floats, Floats] | None:
    """Phases by late light of pixels at optical paths, and their uncertainties [rad].

    Arrays over (frequency, row, column). The uncertainty is that of the differences
    between frequencies. None if the scan has no late light, or the survey does not
    describe its water.
    """
    settled = np.isfinite(path)
    if not settled.any():
        return None
    late = _late_light(scan)
    if late is None:
        return None
    survey, of = late
    index = of["water"].group_index
    middle = float(np.median(path[settled]))
    try:
        delay = late_echo_delay(
            survey, scan.frequency, depth=np.array([middle / (2 * index)]), **of
        )
    except SurveyError:
        return None
    relative = DISPERSION_UNCERTAINTY
    if states_asymmetry_only(survey):
        delay, relative = _NATURAL * delay, math.hypot(relative, _OF_NATURAL)
    # The delay grows with the square of the distance.
    late_path = delay * (path / middle) ** 2
    slope = ranging.phase_per_range(scan.frequency[:, None, None], group_index=index)
    weight = slope**2 / np.sum(slope**2)
    apart = late_path - np.sum(weight * late_path, axis=0)
    # Signed, as one relative error.
    return slope * apart, slope * apart * relative


def late_response(scan: Observation, depth: Floats) -> Complex | None:
    """Logarithms of echoes with late light over those without, (frequency, depth) [1].

    `depth` is the water between instrument and surface [m]. None as in `late_phase`.
    """
    late = _late_light(scan)
    if late is None:
        return None
    survey, of = late
    try:
        response = late_echo_response(survey, scan.frequency, depth=depth, **of)
    except SurveyError:
        return None
    part = _NATURAL if states_asymmetry_only(survey) else 1.0
    return np.asarray(part * np.log(response.reshape(scan.frequency.size, -1)))


def _late_light(scan: Observation) -> tuple[Survey, dict[str, Any]] | None:
    """Return the survey, and water and geometry of its late light; None if none."""
    survey = scan.survey
    if survey is None or not scan.has_late_light:
        return None
    try:
        water = water_properties(survey)
        function = water.phase_function
        if function is None or water.scattering == 0:
            return None
        azimuth, elevation = (
            np.median(part) for part in (scan.azimuth, scan.elevation)
        )
        geometry = view(survey, np.array([azimuth]), np.array([elevation]))
    except SurveyError:
        return None
    return survey, {
        "geometry": geometry,
        "water": water,
        "phase_function": function,
    }
