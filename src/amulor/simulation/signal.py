"""What reaches the detector from the target and from the water, as Stokes vectors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.optics.polarization import mueller
from amulor.simulation.geometry import Geometry
from amulor.simulation.models import (
    DEFAULT_MODEL,
    FittedModel,
    SignalModel,
    UncertainModel,
)
from amulor.survey import Survey, WaterProperties
from amulor.survey.mueller import matrix
from amulor.survey.view import View


@dataclass(frozen=True)
class Light:
    """Received power, dimensions (modulation_frequency, polarization, pixels...)."""

    modulated: NDArray[np.complex128]
    """Power per launched power at each modulation frequency [1]."""
    mean: NDArray[np.float64]
    """Power per launched power without modulation [1]."""
    variance: NDArray[np.float64] | float = 0.0
    """Variance of the modulated power by the model's own errors, real and imaginary
    part together [1]."""

    def __add__(self, other: Light) -> Light:
        """Return what both send together."""
        return Light(
            self.modulated + other.modulated,
            self.mean + other.mean,
            self.variance + other.variance,
        )


def target_light(
    survey: Survey,
    water: WaterProperties,
    geometry: Geometry,
    *,
    model: SignalModel = DEFAULT_MODEL,
) -> Light:
    """Return the light that the targets send back.

    Parameters
    ----------
    survey : Survey
        Targets and instrument.
    water : WaterProperties
        The water in between.
    geometry : Geometry
        What each beam meets.
    model : SignalModel
        Forward model; the small-angle form with the whole phase function by default.

    Returns
    -------
    Light
        Over (modulation_frequency, polarization, row, column); 0 without a target.
    """
    met = geometry.target >= 0
    reflectance = np.zeros(met.shape)
    fraction = np.zeros((len(survey.instrument.polarizations), *met.shape))
    for number, target in enumerate(survey.targets):
        own = geometry.target == number
        reflectance[own] = target.reflectance
        fraction[:, own] = _fractions(survey, target.mueller)[:, None]
    frequency = _frequencies(survey)
    depth = np.where(met, geometry.depth, 0.0)
    surface = {
        "depth": depth,
        "optical_path": geometry.optical_path,
        # Without a target anything that can be.
        "return_path": np.where(met, geometry.return_path, geometry.view.baseline),
        "reflectance": reflectance,
        "cosine": geometry.cosine,
    }
    common: dict[str, Any] = {"survey": survey, "water": water, "view": geometry.view}
    each = frequency[:, None, None, None]
    passed = fraction * geometry.brightness * geometry.view.transmission
    if isinstance(model, UncertainModel):
        response, error = model.echo_with_error(each, surface=surface, **common)
        return _light(response * passed, error * passed)
    return _light(model.echo(each, surface=surface, **common) * passed)


def water_light(
    survey: Survey,
    water: WaterProperties,
    view: View,
    *,
    end: NDArray[np.float64] | None = None,
    model: SignalModel = DEFAULT_MODEL,
) -> Light:
    """Return the light that the water scatters back.

    Parameters
    ----------
    survey : Survey
        Instrument and water.
    water : WaterProperties
        Its optical numbers.
    view : View
        How the receiver looks at each beam.
    end : ndarray, optional
        Where the column ends, infinite where it meets nothing [m]; nowhere by default.
    model : SignalModel
        Forward model; the small-angle form with the whole phase function by default.

    Returns
    -------
    Light
        Over (modulation_frequency, polarization, and the shape of the view).
    """
    frequency, stop = _column_axes(survey, view, end)
    # The model counts the delay from where the water begins.
    turn = np.exp(2j * np.pi * frequency * view.optical_offset / speed_of_light)
    fraction = _fractions(survey, water.backscatter_mueller)
    passed = fraction.reshape(-1, *[1] * view.tilt.ndim) * view.transmission
    common: dict[str, Any] = {"survey": survey, "water": water, "view": view}
    if isinstance(model, UncertainModel):
        response, error = model.column_with_error(frequency, end=stop, **common)
        return _light(response * turn * passed, error * passed)
    return _light(model.column(frequency, end=stop, **common) * turn * passed)


def fitted(
    model: FittedModel,
    survey: Survey,
    water: WaterProperties,
    view: View,
    *,
    end: NDArray[np.float64],
    farthest: float,
) -> SignalModel:
    """Return a model with the choices that all columns of water of a scan share."""
    frequency, stop = _column_axes(survey, view, end)
    return model.fit(
        frequency, survey=survey, water=water, view=view, end=stop, farthest=farthest
    )


def _column_axes(
    survey: Survey, view: View, end: NDArray[np.float64] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the frequencies with axes for a view, and where the columns end [m]."""
    far = np.inf if survey.water.column_end is None else survey.water.column_end
    stop = np.minimum(np.inf if end is None else end, far)
    return _frequencies(survey).reshape(-1, 1, *[1] * view.tilt.ndim), stop


def _frequencies(survey: Survey) -> NDArray[np.float64]:
    """Return zero, for the mean light, and then the modulation frequencies."""
    return np.array([0.0, *survey.instrument.modulation_frequencies])


def _light(
    response: NDArray[np.complex128], error: NDArray[np.float64] | None = None
) -> Light:
    # Rounding leaves less than nothing where the receiver sees no light.
    still = np.maximum(response[:1].real, 0.0)
    mean = np.broadcast_to(still, response[1:].shape)
    return Light(response[1:], mean, 0.0 if error is None else error[1:] ** 2)


def _fractions(survey: Survey, stated: Any) -> NDArray[np.float64]:
    """Return the fraction of the light that each analyser passes."""
    pairs = survey.instrument.polarizations
    reduced = matrix(stated)
    return np.array([float(mueller.detected_fraction(reduced, pair=p)) for p in pairs])
