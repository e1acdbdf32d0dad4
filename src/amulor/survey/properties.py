"""What follows from a description of water: indices, split scattering, backscatter."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from amulor.errors import SurveyError
from amulor.optics import phase_functions
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.optics.water import seawater
from amulor.survey.survey import Survey
from amulor.survey.water import Water
from amulor.survey.waters.phase_function import Tabulated
from amulor.survey.waters.resolve import LayerOptics, WaterOptics, resolved

#: Angles of a phase function as a table: from the innermost on in even steps of the
#: logarithm, then evenly, half a degree apart [rad].
_INNERMOST, _WIDE, _HEAD, _REST = 1e-5, 0.1, 160, 360


@dataclass(frozen=True, kw_only=True)
class WaterProperties:
    """The numbers of the water that the signal models take.

    Examples
    --------
    >>> from amulor.survey import Survey, water_properties
    >>> found = water_properties(Survey.preset("amulor-2010"))
    >>> round(found.attenuation, 3), round(found.reduced_attenuation, 3)
    (0.06, 0.018)
    """

    absorption: float
    """Absorption coefficient a [1/m]."""
    scattering: float
    """Scattering coefficient b, forward and diffuse [1/m]."""
    forward_scattering: float
    """Scattering below the split angle, b_f [1/m]."""
    diffuse_scattering: float
    """Scattering beyond the split angle, b_d [1/m]."""
    second_moment: float
    """Mean square angle of the forward part [rad^2]."""
    backscatter_vsf: float
    """Volume scattering function at 180 degrees [1/(m sr)]."""
    refractive_index: float
    """Phase index [1]."""
    group_index: float
    """Group index [1]."""
    split_angle: float = math.pi / 2
    """Angle between the forward and the diffuse part [rad]."""
    phase_function: PhaseFunction | None = None
    """The whole phase function; None where the survey states moments only."""
    layers: tuple[LayerOptics, ...] = ()
    """Layers across the forward axis; empty for uniform water. The numbers above are
    then those of the first one."""
    source: str = ""
    """Where the coefficients come from."""

    @property
    def reduced_attenuation(self) -> float:
        """Reduced attenuation coefficient k' = a + b_d [1/m]."""
        return self.absorption + self.diffuse_scattering

    @property
    def attenuation(self) -> float:
        """Attenuation coefficient c = a + b [1/m]."""
        return self.absorption + self.scattering


def water_properties(survey: Survey) -> WaterProperties:
    """Return the optical numbers of a survey's water at its wavelength.

    Parameters
    ----------
    survey : Survey
        Stated numbers win; what is not stated follows from the water's phase function
        and from wavelength, temperature and salinity.

    Returns
    -------
    WaterProperties
        Numbers in SI units, and the phase function where it is known.

    Raises
    ------
    SurveyError
        If the water is not known at this wavelength.
    MissingExtraError
        If the water holds spheres or milk and the extra `mie` is not installed.

    Examples
    --------
    >>> from amulor.survey import Survey, water_properties
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {
    ...         "water": {
    ...             "kind": "jerlov",
    ...             "type": "1C",
    ...             "source": "williamson-hollins-2022",
    ...         }
    ...     }
    ... )
    >>> found = water_properties(survey)
    >>> round(found.absorption, 3), round(found.scattering, 3)
    (0.182, 0.472)
    """
    water = survey.water
    wavelength = survey.instrument.wavelength
    phase_index, group_index = _indices(survey)
    optics = resolved(water, wavelength=wavelength, refractive_index=phase_index)
    forward, moment, backwards = _moments(survey, optics)
    return WaterProperties(
        absorption=optics.absorption,
        scattering=optics.scattering,
        forward_scattering=forward * optics.scattering,
        diffuse_scattering=(1 - forward) * optics.scattering,
        second_moment=moment,
        backscatter_vsf=optics.scattering * backwards,
        refractive_index=phase_index,
        group_index=group_index,
        split_angle=water.split_angle,
        phase_function=optics.phase_function,
        layers=optics.layers,
        source=optics.source,
    )


def by_coefficients(survey: Survey, *, factor: float = 1.0) -> Survey:
    """Return a survey whose water is stated by its coefficients and moments.

    Parameters
    ----------
    survey : Survey
        With any water but layers.
    factor : float
        What absorption and scattering are multiplied with, above 0 [1].

    Returns
    -------
    Survey
        The same to models that take moments, and to those that take the whole phase
        function, which it holds as a table; water that was stated by coefficients keeps
        all else that it states.
    """
    water = survey.water
    if isinstance(water, Water):
        changed = water.model_copy(
            update={
                "absorption": water.absorption * factor,
                "scattering": water.scattering * factor,
            }
        )
        return survey.model_copy(update={"water": changed})
    known = water_properties(survey)
    scattered = known.scattering > 0
    common = set(Water.model_fields) & set(type(water).model_fields)
    kept = {name: getattr(water, name) for name in common}
    stated = {
        **kept,
        "kind": None,
        "absorption": known.absorption * factor,
        "scattering": known.scattering * factor,
        "forward_fraction": (
            min(known.forward_scattering / known.scattering, 1.0) if scattered else 1.0
        ),
        "second_moment": known.second_moment,
        "phase_function_at_180": (
            known.backscatter_vsf / known.scattering if scattered else 0.0
        ),
        "phase_function": (
            None if known.phase_function is None else _tabulated(known.phase_function)
        ),
        "refractive_index": known.refractive_index,
        "group_index": known.group_index,
    }
    return survey.model_copy(update={"water": Water.model_validate(stated)})


@lru_cache(maxsize=8)
def _tabulated(function: PhaseFunction) -> Tabulated:
    """Return a phase function as a survey states one, the same each time."""
    angle = np.concatenate(
        [np.geomspace(_INNERMOST, _WIDE, _HEAD)[:-1], np.linspace(_WIDE, np.pi, _REST)]
    )
    value = np.maximum(function(angle), np.finfo(float).tiny)
    return Tabulated(
        kind="tabulated",
        angles=tuple(map(float, angle)),
        values=tuple(map(float, value)),
    )


def _indices(survey: Survey) -> tuple[float, float]:
    """Return phase and group index of the water, stated or of its state."""
    water, wavelength = survey.water, survey.instrument.wavelength
    state = {"temperature": water.temperature, "salinity": water.salinity}
    phase_index, group_index = water.refractive_index, water.group_index
    try:
        if phase_index is None:
            phase_index = float(seawater.refractive_index_vacuum(wavelength, **state))
        if group_index is None:
            group_index = float(seawater.group_index(wavelength, **state))
    except ValueError as error:
        raise SurveyError(
            f"water: the indices do not follow from wavelength, temperature and "
            f"salinity ({error}); give refractive_index and group_index"
        ) from None
    return phase_index, group_index


def _moments(survey: Survey, optics: WaterOptics) -> tuple[float, float, float]:
    """Return forward fraction, second moment and value at 180 degrees."""
    water, split = survey.water, survey.water.split_angle
    forward = moment = backwards = asymmetry = None
    if isinstance(water, Water):
        forward, moment, backwards, asymmetry = (
            water.forward_fraction,
            water.second_moment,
            water.phase_function_at_180,
            water.asymmetry,
        )
    if asymmetry is not None:
        closed = {"asymmetry": asymmetry, "split_angle": split}
        if forward is None:
            forward = float(
                phase_functions.henyey_greenstein_forward_fraction(**closed)
            )
        if moment is None:
            moment = float(phase_functions.henyey_greenstein_second_moment(**closed))
        if backwards is None:
            backwards = (1 - asymmetry) / (4 * math.pi * (1 + asymmetry) ** 2)
    elif optics.phase_function is not None and optics.scattering > 0:
        fraction, square = optics.phase_function.forward_split(split)
        forward = fraction if forward is None else forward
        moment = square if moment is None else moment
        if backwards is None:
            backwards = optics.phase_function.at_180
    return forward or 0.0, moment or 0.0, backwards or 0.0
