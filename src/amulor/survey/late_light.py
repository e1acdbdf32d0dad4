"""Delay of echoes by forward-scattered light, for instrument and water of a survey."""

from __future__ import annotations

import math

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
    if phase_function.asymmetry < LEAST_ASYMMETRY:
        raise SurveyError(
            f"the asymmetry of the water, {phase_function.asymmetry:g}, is below "
            f"{LEAST_ASYMMETRY:g}, where small angles do not describe the light"
        )
    formula = late_echo.late_echo
    if has_sharp_receiver(survey):
        formula = late_echo.sharp_receiver_late_echo
    beams = geometry.baseline.ndim
    return formula(
        frequency.reshape(-1, *[1] * (beams + 1)),
        depth=depth,
        scattering=water.scattering if scattering is None else scattering,
        phase_function=phase_function,
        split_angle=split_angle,
        group_index=water.group_index,
        baseline=geometry.baseline[..., None],
        receiver_radius=survey.instrument.receiver.radius,
        acceptance_angle=geometry.acceptance,
        tilt=geometry.tilt[..., None],
        cross_tilt=geometry.cross_tilt[..., None],
        standoff=geometry.standoff[..., None],
        absorption=water.absorption,
        **beam_arguments(survey, water),
    )
