"""Phases of late light, which differ with the frequency as changed water does."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amulor.errors import SurveyError
from amulor.optics import late_echo, ranging
from amulor.rejection.observation import Observation
from amulor.survey import water_properties
from amulor.survey.view import beam_arguments, has_sharp_receiver, view

Floats = NDArray[np.float64]

#: Relative standard uncertainty of how the delay falls with the frequency [1].
_UNCERTAINTY = 0.3
#: Natural waters of an asymmetry are between half as late as, and as late as, the
#: Henyey-Greenstein function: factor and its relative standard uncertainty [1].
_NATURAL, _OF_NATURAL = 0.75, 0.25 / 0.75 / 3**0.5


def late_phase(scan: Observation, path: Floats) -> tuple[Floats, Floats] | None:
    """Phases by late light of pixels at optical paths, and their uncertainties [rad].

    Arrays over (frequency, row, column). The uncertainty is that of the differences
    between frequencies. None if the scan has no late light, or the survey does not
    describe its water.
    """
    survey = scan.survey
    settled = np.isfinite(path)
    if survey is None or not scan.has_late_light or not settled.any():
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
        formula = late_echo.late_echo
        if has_sharp_receiver(survey):
            formula = late_echo.sharp_receiver_late_echo
        index = water.group_index
        middle = float(np.median(path[settled]))
        delay = formula(
            scan.frequency,
            depth=middle / (2 * index),
            scattering=water.scattering,
            phase_function=function,
            split_angle=math.pi / 2,
            group_index=index,
            baseline=geometry.baseline,
            receiver_radius=survey.instrument.receiver.radius,
            acceptance_angle=geometry.acceptance,
            tilt=geometry.tilt,
            cross_tilt=geometry.cross_tilt,
            standoff=geometry.standoff,
            absorption=water.absorption,
            **beam_arguments(survey, water),
        )
    except SurveyError:
        return None
    relative = _UNCERTAINTY
    if getattr(survey.water, "asymmetry", None) is not None:
        delay, relative = _NATURAL * delay, math.hypot(relative, _OF_NATURAL)
    # The delay grows with the square of the distance.
    late = delay.reshape(-1, 1, 1) * (path / middle) ** 2
    slope = ranging.phase_per_range(scan.frequency[:, None, None], group_index=index)
    weight = slope**2 / np.sum(slope**2)
    apart = late - np.sum(weight * late, axis=0)
    # Signed, as one relative error.
    return slope * apart, slope * apart * relative
