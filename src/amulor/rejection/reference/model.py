"""The model of the water that rejection takes where shots do not tell."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from amulor.errors import SurveyError
from amulor.optics import small_angle, small_angle_diffusion
from amulor.survey import Survey, WaterProperties, water_properties
from amulor.survey.view import kernel_arguments, medium, view
from amulor.survey.waters.whole_function import (
    whole_function_arguments,
    whole_phase_function,
)

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


def water_signal(
    survey: Survey,
    azimuth: Floats,
    elevation: Floats,
    *,
    modulation_frequency: Floats,
    end: Floats | float | None = None,
    paper: bool = False,
) -> Complex:
    """Return the light of the water up to some depth, in any unit.

    Parameters
    ----------
    survey : Survey
        Its water and its instrument count.
    azimuth, elevation : ndarray, shape (n,)
        Directions of the beams [rad].
    modulation_frequency : ndarray, shape (m,)
        Modulation frequencies [Hz].
    end : array_like, shape (n,), optional
        Depth at which the water ends; where the survey ends it by default, and there
        at the latest [m].
    paper : bool
        Whether to take the diffusion form of the paper in any case.

    Returns
    -------
    ndarray of complex, shape (m, n)
        With the phase counted from where the water begins.

    Notes
    -----
    Eq. (29) of Ricci et al. 2010, as rebuilt, with the whole phase function of the
    water, within some percent of photons; water whose stated moments no phase function
    has by the diffusion form (46).
    """
    water = water_properties(survey)
    where = view(survey, azimuth, elevation, medium=medium(survey, water))
    far = np.inf if survey.water.column_end is None else survey.water.column_end
    form: Callable[..., Complex]
    if not paper and _has_phase_function(water):
        form = small_angle.water_response
        arguments = whole_function_arguments(survey, water, where)
    else:
        form = small_angle_diffusion.water_response
        arguments = kernel_arguments(survey, water, where)
    return form(
        modulation_frequency[:, None],
        backscatter_vsf=1.0,
        group_index=water.group_index,
        end=far if end is None else np.minimum(end, far),
        **arguments,
    )


@lru_cache(maxsize=8)
def _has_phase_function(water: WaterProperties) -> bool:
    if water.forward_scattering * water.second_moment == 0:
        return True
    try:
        whole_phase_function(water)
    except SurveyError:
        return False
    return True
