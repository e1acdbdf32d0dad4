"""The water signal of a survey against modulation frequency, by each model."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.errors import SurveyError
from amulor.optics import phase_functions, small_angle, small_angle_diffusion
from amulor.survey import Survey, water_properties
from amulor.survey.view import kernel_arguments, medium, view


def diffusion_response(
    survey: Survey, modulation_frequency: ArrayLike
) -> NDArray[np.complex128]:
    """Return the open-water signal at the middle of the scan, diffusion model.

    Parameters
    ----------
    survey : Survey
        Water and instrument count; targets and polarizers do not.
    modulation_frequency : array_like
        Frequencies of the intensity modulation [Hz].

    Returns
    -------
    ndarray of complex
        Received power per launched power [1].

    Notes
    -----
    (46) of Ricci et al. 2010, as rebuilt.
    """
    water = water_properties(survey)
    return small_angle_diffusion.water_response(
        modulation_frequency,
        backscatter_vsf=water.backscatter_vsf,
        group_index=water.group_index,
        end=_end(survey),
        **_middle(survey),
    )


def small_angle_response(
    survey: Survey, modulation_frequency: ArrayLike
) -> NDArray[np.complex128]:
    """Return the open-water signal at the middle of the scan, small-angle model.

    Parameters
    ----------
    survey : Survey
        Water and instrument count; targets and polarizers do not. The water must have
        an asymmetry, since this model needs the whole phase function.
    modulation_frequency : array_like
        Frequencies of the intensity modulation [Hz].

    Returns
    -------
    ndarray of complex
        Received power per launched power [1].

    Raises
    ------
    SurveyError
        If the water states no asymmetry.

    Notes
    -----
    (29) of Ricci et al. 2010, as rebuilt, with the Henyey-Greenstein phase function:
    keeps the unscattered light and the shape of the forward peak.
    """
    asymmetry = survey.water.asymmetry
    if asymmetry is None:
        raise SurveyError(
            "water.asymmetry is missing; the small-angle model needs the whole phase "
            "function, not only its moments: add asymmetry, or use the diffusion model"
        )
    water = water_properties(survey)
    arguments = _middle(survey)
    for name in ("forward_scattering", "diffuse_scattering", "second_moment"):
        del arguments[name]

    def phase_function(angle: NDArray[np.float64]) -> NDArray[np.float64]:
        return phase_functions.henyey_greenstein(angle, asymmetry=asymmetry)

    return small_angle.water_response(
        modulation_frequency,
        scattering=survey.water.scattering,
        phase_function=phase_function,
        split_angle=survey.water.split_angle,
        backscatter_vsf=water.backscatter_vsf,
        group_index=water.group_index,
        end=_end(survey),
        **arguments,
    )


def _end(survey: Survey) -> float:
    end = survey.water.column_end
    return math.inf if end is None else end


def _middle(survey: Survey) -> dict[str, Any]:
    """Return the arguments of the models for the beam in the middle of the scan."""
    water = water_properties(survey)
    where = view(
        survey,
        np.array(survey.scan.azimuth),
        np.array(survey.scan.elevation),
        medium=medium(survey, water),
    )
    found = kernel_arguments(survey, water, where)
    return {name: float(value) for name, value in found.items()}
