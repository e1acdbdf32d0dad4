"""The forward models that a simulation can use for target and water light."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from amulor.errors import SurveyError
from amulor.optics import small_angle, small_angle_diffusion, target_echo
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.survey import Survey, WaterProperties
from amulor.survey.view import View, kernel_arguments

Complex = NDArray[np.complex128]


class SignalModel(Protocol):
    """What a forward model gives: responses before any polarizer."""

    @property
    def title(self) -> str:
        """What a cube says it was made with."""
        ...

    def echo(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        surface: dict[str, Any],
    ) -> Complex:
        """Return received per launched power from the surfaces that beams meet [1].

        Parameters
        ----------
        modulation_frequency : ndarray
            Frequencies, with axes for the shape of the view [Hz].
        survey : Survey
            Instrument and water.
        water : WaterProperties
            Its optical numbers.
        view : View
            How the receiver looks at each beam.
        surface : dict
            `depth`, `optical_path`, `reflectance`, `cosine` of
            `amulor.optics.target_echo.target_response`, over the beams.

        Returns
        -------
        ndarray of complex
            Over frequencies and beams.
        """
        ...

    def column(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        end: Any,
    ) -> Complex:
        """Return received per launched power from the water in front of `end` [1].

        Parameters
        ----------
        modulation_frequency : ndarray
            Frequencies, with axes for the shape of the view [Hz].
        survey : Survey
            Instrument and water.
        water : WaterProperties
            Its optical numbers.
        view : View
            How the receiver looks at each beam.
        end : array_like
            Depth at which the column ends, over the beams or one for all [m].

        Returns
        -------
        ndarray of complex
            Over frequencies and beams, with the phase counted from where the water
            begins.
        """
        ...


@dataclass(frozen=True)
class DiffusionModel:
    """The diffusion form (43), (46) of Ricci et al. 2010, as rebuilt: fast.

    Takes b_f, b_d and the second moment of the water, and spreads all light alike.
    """

    title: str = "small-angle diffusion model"
    """What a cube says it was made with."""

    def echo(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        surface: dict[str, Any],
    ) -> Complex:
        """Return received per launched power from surfaces; see `SignalModel`."""
        return target_echo.target_response(
            modulation_frequency, **surface, **kernel_arguments(survey, water, view)
        )

    def column(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        end: Any,
    ) -> Complex:
        """Return received per launched power from the water; see `SignalModel`."""
        return small_angle_diffusion.water_response(
            modulation_frequency,
            backscatter_vsf=water.backscatter_vsf,
            group_index=water.group_index,
            end=end,
            **kernel_arguments(survey, water, view),
        )


@dataclass(frozen=True)
class SmallAngleModel:
    """The small-angle form (29) of Ricci et al. 2010, as rebuilt: slower, and better.

    Takes the whole Henyey-Greenstein phase function of the water, and keeps the light
    that was not scattered. Some milliseconds for each pixel.
    """

    title: str = "small-angle model with the whole phase function"
    """What a cube says it was made with."""

    def echo(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        surface: dict[str, Any],
    ) -> Complex:
        """Return received per launched power from surfaces; see `SignalModel`."""
        return target_echo.small_angle_target_response(
            modulation_frequency,
            **surface,
            **whole_function_arguments(survey, water, view),
        )

    def column(
        self,
        modulation_frequency: NDArray[np.float64],
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        end: Any,
    ) -> Complex:
        """Return received per launched power from the water; see `SignalModel`."""
        return small_angle.water_response(
            modulation_frequency,
            backscatter_vsf=water.backscatter_vsf,
            group_index=water.group_index,
            end=end,
            **whole_function_arguments(survey, water, view),
        )


def whole_function_arguments(
    survey: Survey, water: WaterProperties, view: View
) -> dict[str, Any]:
    """Return what target and water signal both take in the small-angle model.

    Parameters
    ----------
    survey : Survey
        Its receiver and water count; the water must have an asymmetry.
    water : WaterProperties
        Optical numbers of the water.
    view : View
        How the receiver looks at each beam.

    Returns
    -------
    dict
        Keyword arguments of `amulor.optics.small_angle.overlap`.

    Raises
    ------
    SurveyError
        If the water states no asymmetry.
    """
    asymmetry = survey.water.asymmetry
    if asymmetry is None:
        raise SurveyError(
            "water.asymmetry is missing; the small-angle model needs the whole phase "
            "function, not only its moments: add asymmetry, or use the diffusion model"
        )
    arguments = kernel_arguments(survey, water, view)
    for name in ("forward_scattering", "diffuse_scattering", "second_moment"):
        del arguments[name]
    return {
        **arguments,
        "scattering": survey.water.scattering,
        "phase_function": _henyey_greenstein(asymmetry),
        "split_angle": survey.water.split_angle,
    }


@lru_cache(maxsize=8)
def _henyey_greenstein(asymmetry: float) -> PhaseFunction:
    """Return one and the same function each time: its transform is kept with it."""
    return henyey_greenstein_function(asymmetry=asymmetry)
