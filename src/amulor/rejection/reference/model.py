"""Water-signal model for the interpolation between open-water shots."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor._chebyshev import BoxSeries
from amulor.cube.tiles import Span
from amulor.errors import AmulorError, SurveyError
from amulor.optics import small_angle, small_angle_diffusion
from amulor.rejection.observation import Observation
from amulor.rejection.reference.surface import (
    FEWEST_SHOTS,
    noise_of,
    noiseless,
    places_of,
    surface_of,
)
from amulor.survey import Survey, WaterProperties, water_properties
from amulor.survey.properties import by_coefficients
from amulor.survey.view import View, kernel_arguments, view
from amulor.survey.waters.whole_function import (
    whole_function_arguments,
    whole_phase_function,
)

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


def water_signal(
    survey: Survey,
    where: View,
    *,
    modulation_frequency: Floats,
    end: Floats | float | None = None,
    paper: bool = False,
) -> Complex:
    """Return the modeled water signal up to a depth, in arbitrary units.

    Eq. (29) of Ricci et al. 2010, as rederived, with the whole phase function of the
    water, within some percent of photons; water whose stated moments no phase function
    has by the diffusion form (46).
    """
    water = water_properties(survey)
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


Model = Callable[[Floats, Floats], Complex]

#: A polynomial of the signal itself that misses less of the survey's own water between
#: the shots needs no model, in parts of the largest signal: as much as ten shots
#: scatter [1].
_SMOOTH = 0.005
#: Directions along azimuth and elevation at which it is looked for.
_CHECKS = 9
#: A model that varies more than by this factor is no measure of a signal [1].
_LARGEST_RATIO = 1e6
#: Factors of the survey's a and b that are tried.
_FACTORS = (1.0, 0.5, 0.7, 1.4, 2.0)
#: Nodes along azimuth and elevation of the table that pixels look up.
_NODES = 33


@dataclass(frozen=True)
class Shape:
    """Water signal of a model at one frequency, in arbitrary units."""

    at_shots: Complex
    """Water signal at the shots."""
    at_pixels: Complex
    """Water signal at the pixels."""

    def part(self, use: NDArray[np.bool_]) -> Shape:
        """Return a copy with selected open-water references."""
        return Shape(self.at_shots[use], self.at_pixels)


@dataclass(frozen=True)
class ModelBehindShots:
    """Water model by which open-water references are divided before interpolation."""

    model: Model
    """Function from directions within the scan to the water signal."""
    at_shots: Complex
    """Modeled water signal at the shots, shape (frequency, shot)."""

    def over(self, pixels: Floats, frequency: Floats) -> list[Shape]:
        """Return modeled signals at references and pixels, a `Shape` per frequency."""
        return [
            Shape(at_shots, at_pixels)
            for at_shots, at_pixels in zip(
                self.at_shots, self.model(pixels, frequency), strict=True
            )
        ]


def model_behind_shots(
    scan: Observation, shots: Observation, directions: Floats, *, span: Span
) -> ModelBehindShots | None:
    """Choose the water model of least cross-validation error; None if none helps.

    None without a survey, and if a polynomial alone is sufficient for the water of the
    survey or fits the shots better than any model. `directions` are those of the shots,
    shape (shot, 2) [rad].

    Candidates are `model.water_signal` at several turbidities, and the rederived
    diffusion form (46) of Ricci et al. 2010, each with the delay of every direction.
    The ratio of the shots to each candidate is fitted by a polynomial over the
    directions. The best candidate has the smallest prediction error at omitted
    directions, over all frequencies and channels. Chebyshev polynomials interpolate it
    to the pixels.
    """
    survey, frequency = scan.survey, scan.frequency
    if survey is None:
        return None
    group = places_of(directions).group
    distinct = directions[np.unique(group, return_index=True)[1]]
    candidates = models_for(
        survey, distinct, frequency, repeats=len(directions) // len(distinct)
    )
    if candidates is None:
        return None
    predictions = [candidate(distinct, frequency)[:, group] for candidate in candidates]
    scores = [
        _cross_validation_error(prediction, directions, shots)
        for prediction in [None, *predictions]
    ]
    best = int(np.argmin(scores)) - 1
    if best < 0:
        return None
    low, high = np.array([span.azimuth, span.elevation]).T
    model = _Tabled(candidates[best], low, high, frequency).at
    return ModelBehindShots(model, predictions[best])


def models_for(
    survey: Survey, directions: Floats, frequency: Floats, *, repeats: int
) -> list[Model] | None:
    """Return the candidate models for the interpolation; None if unnecessary."""
    if len(directions) < 2 or survey.scan.moves == "both":
        return None
    try:
        if _is_smooth(survey, directions, frequency, repeats):
            return None
        candidates: list[Model] = [
            partial(
                open_water,
                by_coefficients(survey, factor=factor) if factor != 1 else survey,
            )
            for factor in _FACTORS
        ]
        candidates.append(partial(open_water, survey, paper=True))
        for candidate in candidates:
            candidate(directions[:1], frequency)
    except AmulorError:
        return None
    return candidates


def _is_smooth(
    survey: Survey, directions: Floats, frequency: Floats, repeats: int
) -> bool:
    """Return whether a polynomial alone follows the water signal between references.

    Cross-validation alone is not sufficient: the shots of three rows always fit a
    parabola.
    """
    low, high = directions.min(axis=0), directions.max(axis=0)
    axes = [
        np.unique(np.linspace(*ends, _CHECKS)) for ends in zip(low, high, strict=True)
    ]
    checks = np.stack([axis.ravel() for axis in np.meshgrid(*axes)], axis=1)
    at_shots, truth = (
        open_water(survey, places, frequency) for places in (directions, checks)
    )
    off = np.abs(noiseless(at_shots, repeats, directions, checks) - truth)
    return bool(np.all(off.max(axis=1) < _SMOOTH * np.abs(truth).max(axis=1)))


def is_measure(model: Complex) -> bool:
    """Return whether a model varies little enough for use as a divisor."""
    strength = np.abs(model)
    return bool(strength.min() * _LARGEST_RATIO > strength.max())


def _cross_validation_error(
    model: Complex | None, directions: Floats, shots: Observation
) -> float:
    """Return a model's cross-validation error: at directions omitted from the fit."""
    if model is not None and not is_measure(model):
        return np.inf
    total = 0.0
    for index in np.ndindex(shots.signal.shape[:2]):
        use = shots.usable[index]
        if use.sum() < FEWEST_SHOTS:
            continue
        places = places_of(directions[use])
        values = shots.signal[index][use]
        instrument = shots.covariance.part(index).part(use)
        total += surface_of(
            values,
            instrument,
            places,
            noise=noise_of(values, instrument, places),
            model=None if model is None else model[index[0]][use],
        ).cross_validation
    return total


def open_water(
    survey: Survey, places: Floats, frequency: Floats, *, paper: bool = False
) -> Complex:
    """Return the modeled open-water signal, with the delay before the water."""
    where = view(survey, *places.T)
    response = water_signal(survey, where, modulation_frequency=frequency, paper=paper)
    turn = 2j * np.pi * frequency[:, None] * where.optical_offset / speed_of_light
    return np.asarray(response * np.exp(turn))


class _Tabled:
    """Water model tabulated over the directions of a scan."""

    def __init__(
        self, model: Model, low: Floats, high: Floats, frequency: Floats
    ) -> None:
        self._series = BoxSeries(low, high, (_NODES, _NODES))
        self._series.fill(model(self._series.places().T, frequency))

    def at(self, places: Floats, frequency: Floats) -> Complex:
        """Return the water signal at places, for the frequencies of the table."""
        return self._series.at(places.T)
