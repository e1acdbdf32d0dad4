"""Delay and loss of echoes by forward-scattered light, for the survey of a scan."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import SurveyError
from amulor.optics import late_echo
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.survey.properties import WaterProperties
from amulor.survey.survey import Survey
from amulor.survey.view import View, beam_arguments, has_sharp_receiver

Floats = NDArray[np.float64]

#: Coasts and harbors are 0.6 to 0.7 times as late as a Henyey-Greenstein function of
#: their asymmetry, clear ocean down to 0.41 at six attenuation lengths (Petzold) [1].
LEAST_PART = 0.5
#: Relative standard uncertainty of how the delay falls with the frequency [1].
DISPERSION_UNCERTAINTY = 0.3
#: Below this asymmetry small angles do not describe the light [1].
LEAST_ASYMMETRY = 0.6


def states_asymmetry_only(survey: Survey) -> bool:
    """Return whether the survey states the whole phase function by its mean cosine."""
    function = getattr(survey.water, "phase_function", None)
    return (
        getattr(survey.water, "asymmetry", None) is not None
        or getattr(function, "kind", "") == "henyey-greenstein"
    )


def late_echo_delay(
    survey: Survey,
    frequency: Floats,
    *,
    depth: Floats,
    geometry: View,
    water: WaterProperties,
    phase_function: PhaseFunction,
    scattering: float | None = None,
    split_angle: float = math.pi / 2,
) -> Floats:
    """Return delays as slant range [m], of shape (frequency, *directions, depth).

    Without `scattering` [1/m], that of the water is used.
    """
    formula = late_echo.late_echo
    if has_sharp_receiver(survey):
        formula = late_echo.sharp_receiver_late_echo
    return formula(
        **_arguments(survey, frequency, depth, geometry, water, phase_function)
        | {"split_angle": split_angle}
        | ({} if scattering is None else {"scattering": scattering})
    )


def late_echo_response(
    survey: Survey,
    frequency: Floats,
    *,
    depth: Floats,
    geometry: View,
    water: WaterProperties,
    phase_function: PhaseFunction,
) -> NDArray[np.complex128]:
    """Return echoes over those without late light, of shape as the delays [1]."""
    return late_echo.response(
        sharp=has_sharp_receiver(survey),
        split_angle=math.pi / 2,
        **_arguments(survey, frequency, depth, geometry, water, phase_function),
    )


def _arguments(
    survey: Survey,
    frequency: Floats,
    depth: Floats,
    geometry: View,
    water: WaterProperties,
    phase_function: PhaseFunction,
) -> dict[str, Any]:
    """Return the arguments of `late_echo`; SurveyError for large scattering angles."""
    if phase_function.asymmetry < LEAST_ASYMMETRY:
        raise SurveyError(
            f"the asymmetry of the water, {phase_function.asymmetry:g}, is below "
            f"{LEAST_ASYMMETRY:g}, where small angles do not describe the light"
        )
    beams = geometry.baseline.ndim
    return {
        "modulation_frequency": frequency.reshape(-1, *[1] * (beams + 1)),
        "depth": depth,
        "scattering": water.scattering,
        "phase_function": phase_function,
        "group_index": water.group_index,
        "baseline": geometry.baseline[..., None],
        "receiver_radius": survey.instrument.receiver.radius,
        "acceptance_angle": geometry.acceptance,
        "tilt": geometry.tilt[..., None],
        "cross_tilt": geometry.cross_tilt[..., None],
        "standoff": geometry.standoff[..., None],
        "absorption": water.absorption,
        **beam_arguments(survey, water),
    }
