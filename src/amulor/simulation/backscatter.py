"""Open-water signal of a survey against modulation frequency, by three models."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.simulation.models import (
    ClosureModel,
    DiffusionModel,
    SignalModel,
    SmallAngleModel,
)
from amulor.survey import Survey, water_properties
from amulor.survey.view import view


def diffusion_response(
    survey: Survey, modulation_frequency: ArrayLike
) -> NDArray[np.complex128]:
    """Return the open-water signal at the middle of the scan by the diffusion model.

    Eq. (46) of Ricci et al. 2010, as rederived.
    """
    return _response(survey, modulation_frequency, DiffusionModel())


def small_angle_response(
    survey: Survey, modulation_frequency: ArrayLike
) -> NDArray[np.complex128]:
    """Return the open-water signal at the middle of the scan by the small-angle model.

    Eq. (29) of Ricci et al. 2010, as rederived, with the whole phase function,
    including unscattered light and the shape of the forward peak.
    """
    return _response(survey, modulation_frequency, SmallAngleModel())


def closure_response(
    survey: Survey, modulation_frequency: ArrayLike
) -> NDArray[np.complex128]:
    """Return the open-water signal at the middle of the scan by the closure model.

    `amulor.optics.small_angle_closure`, a fast form of eq. (29) of Ricci et al. 2010,
    as rederived.
    """
    return _response(survey, modulation_frequency, ClosureModel())


def _response(
    survey: Survey, modulation_frequency: ArrayLike, model: SignalModel
) -> NDArray[np.complex128]:
    """Return the open-water signal of the scan's middle beam by a forward model."""
    water = water_properties(survey)
    beam = view(survey, np.array(survey.scan.azimuth), np.array(survey.scan.elevation))
    end = survey.water.column_end
    return model.column(
        np.asarray(modulation_frequency, dtype=np.float64),
        survey=survey,
        water=water,
        view=beam,
        end=np.inf if end is None else end,
    )
