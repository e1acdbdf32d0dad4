"""Optical properties of the water: indices, absorption, scattering, backscatter."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.errors import SurveyError
from amulor.optics import phase_functions
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.optics.water import seawater
from amulor.survey.survey import Survey
from amulor.survey.water import SALINITIES, TEMPERATURES, Water, state_of
from amulor.survey.waters.phase_function import Tabulated
from amulor.survey.waters.resolve import LayerOptics, WaterOptics, resolved

#: Angles of a phase function as a table: from the innermost on in even steps of the
#: logarithm, then evenly, half a degree apart [rad].
_INNERMOST, _WIDE, _HEAD, _REST = 1e-5, 0.1, 160, 360


@dataclass(frozen=True, kw_only=True)
class WaterProperties:
    """Optical properties of the water, as input of the signal models.

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
    """Scattering coefficient b, of forward and diffuse part together [1/m]."""
    forward_scattering: float
    """Forward scattering coefficient b_f, below the split angle [1/m]."""
    diffuse_scattering: float
    """Diffuse scattering coefficient b_d, beyond the split angle [1/m]."""
    second_moment: float
    """Mean square scattering angle of the forward part [rad^2]."""
    backscatter_vsf: float
    """Volume scattering function at 180 degrees [1/(m sr)]."""
    refractive_index: float
    """Phase index [1]."""
    group_index: float
    """Group index [1]."""
    split_angle: float = math.pi / 2
    """Scattering angle between the forward and the diffuse part [rad]."""
    phase_function: PhaseFunction | None = None
    """Phase function over all angles; None if the survey states only moments."""
    layers: tuple[LayerOptics, ...] = ()
    """Layers across the forward axis; empty for uniform water. With layers, the
    coefficients above are those of the first layer."""
    source: str = ""
    """Source of the coefficients."""
    backscatter_mueller: Any = (1.0, -1.0, -1.0)
    """Reduced Mueller matrix at 180 degrees, in a form of survey files [1]."""
    depolarization_known: bool = True
    """Whether depolarization is known; if not, polarization is assumed to be
    preserved."""

    @property
    def reduced_attenuation(self) -> float:
        """Reduced attenuation coefficient k' = a + b_d [1/m]."""
        return self.absorption + self.diffuse_scattering

    @property
    def attenuation(self) -> float:
        """Attenuation coefficient c = a + b [1/m]."""
        return self.absorption + self.scattering


def water_properties(survey: Survey) -> WaterProperties:
    """Return the optical properties of a survey's water at its wavelength.

    Parameters
    ----------
    survey : Survey
        Survey of which the water is used. Stated numbers are used first; missing ones
        follow from the phase function and from wavelength, temperature and salinity.

    Returns
    -------
    WaterProperties
        Properties in SI units, with the phase function if it is known.

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
    phase_index, group_index = indices(survey)
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
        backscatter_mueller=water.backscatter_mueller
        or optics.mueller
        or _POLARIZATION_KEPT,
        depolarization_known=bool(water.backscatter_mueller or optics.mueller),
    )


#: Mueller matrix straight backwards of water of which nothing is known.
_POLARIZATION_KEPT = (1.0, -1.0, -1.0)


def by_coefficients(survey: Survey, *, factor: float = 1.0) -> Survey:
    """Return a survey with explicit water coefficients, a and b times `factor`."""
    water = survey.water
    if isinstance(water, Water):
        changed = water.model_copy(
            update={
                "absorption": water.absorption * factor,
                "scattering": water.scattering * factor,
            }
        )
        return survey.model_copy(update={"water": changed})
    properties = water_properties(survey)
    scattered = properties.scattering > 0
    common = set(Water.model_fields) & set(type(water).model_fields)
    shared = {name: getattr(water, name) for name in common}
    fields = {
        **shared,
        "kind": None,
        "absorption": properties.absorption * factor,
        "scattering": properties.scattering * factor,
        "forward_fraction": (
            min(properties.forward_scattering / properties.scattering, 1.0)
            if scattered
            else 1.0
        ),
        "second_moment": properties.second_moment,
        "phase_function_at_180": (
            properties.backscatter_vsf / properties.scattering if scattered else 0.0
        ),
        "phase_function": (
            None
            if properties.phase_function is None
            else _tabulated(properties.phase_function)
        ),
        "refractive_index": properties.refractive_index,
        "group_index": properties.group_index,
        "backscatter_mueller": properties.backscatter_mueller,
    }
    return survey.model_copy(update={"water": Water.model_validate(fields)})


@lru_cache(maxsize=8)
def _tabulated(function: PhaseFunction) -> Tabulated:
    """Return a phase function as a table for survey files; cached."""
    angle = np.concatenate(
        [np.geomspace(_INNERMOST, _WIDE, _HEAD)[:-1], np.linspace(_WIDE, np.pi, _REST)]
    )
    value = np.maximum(function(angle), np.finfo(float).tiny)
    return Tabulated(
        kind="tabulated",
        angles=tuple(map(float, angle)),
        values=tuple(map(float, value)),
    )


def indices(survey: Survey) -> tuple[float, float]:
    """Return phase and group index of the water; computed if the survey has none."""
    water, wavelength = survey.water, survey.instrument.wavelength
    state = state_of(water)
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


#: Default standard uncertainty of a phase: leakage of 1 % of the echo rotates it by 0.4
#: degrees (root mean square) [rad].
TYPICAL_PHASE_UNCERTAINTY = math.radians(0.5)
#: Default if the leakage was measured: an aliased harmonic of 1 % rotates the phase by
#: 0.4 degrees (root mean square) [rad].
PHASE_UNCERTAINTY_WITHOUT_LEAKAGE = math.radians(0.4)
#: Errors of an instrument that was not calibrated over the typical ones, with several
#: frequencies, and with one, whose phase no other contradicts [1].
_UNCALIBRATED, _UNTESTED = 3.0, 6.0
#: A stated phase error at one frequency, which no other phase tests, counts as reliable
#: to 50 %. That is two degrees of freedom (ISO/IEC Guide 98-3, G.4.2): quantiles of
#: 97.5 % of Student's distribution over the normal distribution [1].
_STATED_UNTESTED = 4.303 / 1.960


#: Default standard uncertainty of a recorded instrument temperature [degC].
TEMPERATURE_UNCERTAINTY = 0.5


#: Typical cross-talk of two channels, of film polarizers with 1 to 2 degrees of
#: misalignment [1], and difference of their gains [1].
TYPICAL_CROSSTALK, TYPICAL_CHANNEL_GAIN = 0.01, 0.03
#: Typical errors of analog mixers: gain [1], and angle between the outputs [rad]. They
#: turn the phase by 0.64 degrees. The data sheet of the AD8348 states 0.25 dB and 0.5
#: degrees, which turn it by 0.66 degrees.
MIXER = 0.01, math.radians(1.0)


def phase_uncertainty(
    survey: Survey,
    *,
    leakage_measured: bool = False,
    demodulator_measured: bool = False,
    phases_measured: bool = False,
    frequencies: int | None = None,
) -> float:
    """Return the phase uncertainty of the instrument, stated or default [rad].

    `frequencies` is the number of modulation frequencies, by default of the survey.
    """
    stated = survey.instrument.phase_uncertainty
    count = frequencies or len(survey.instrument.modulation_frequencies)
    if stated is not None:
        untested = count == 1 and not phases_measured
        return _STATED_UNTESTED * stated if untested else stated
    factor = uncalibrated_factor(count)
    typical = TYPICAL_PHASE_UNCERTAINTY
    if leakage_measured:
        typical = PHASE_UNCERTAINTY_WITHOUT_LEAKAGE
    if not phases_measured:
        typical *= factor
    if survey.instrument.lock_in.demodulator == "analog" and not demodulator_measured:
        typical = math.hypot(typical, factor * float(quadrature_phase_error(*MIXER)))
    return typical


def uncalibrated_factor(frequencies: int) -> float:
    """Return the default phase error without calibration over the typical one [1]."""
    return _UNTESTED if frequencies == 1 else _UNCALIBRATED


def quadrature_phase_error(gain: ArrayLike, angle: ArrayLike) -> NDArray[np.float64]:
    """Return the rms phase error by gain [1] and angle [rad] of the quadrature output.

    A phasor of the phase p turns by gain sin(p) cos(p) + angle cos(p)^2, to first
    order. All phases from 0 to 2 pi are equally likely.
    """
    return np.sqrt(np.square(gain) / 8 + 3 * np.square(angle) / 8)


def group_index_uncertainty(survey: Survey) -> float | None:
    """Return the standard uncertainty of the group index [1]; None if unknown."""
    water, calibration = survey.water, survey.calibration
    if calibration is not None and calibration.group_index_uncertainty is not None:
        return calibration.group_index_uncertainty
    spans: dict[str, tuple[float, float]] = {}
    errors: dict[str, float | None] = {"temperature": None, "salinity": None}
    if calibration is not None:
        errors["temperature"] = calibration.temperature_uncertainty
        errors["salinity"] = calibration.salinity_uncertainty
    if water.group_index is None:
        if water.temperature is None:
            spans["temperature"] = TEMPERATURES
        if water.salinity is None:
            spans["salinity"] = SALINITIES
    known_errors = {name: error for name, error in errors.items() if name not in spans}
    if not spans and None in known_errors.values():
        return None
    try:
        parts = [_spread(survey, spans)]
        parts += [
            _slope(survey, name) * error
            for name, error in known_errors.items()
            if error is not None
        ]
    except ValueError as error:
        raise SurveyError(
            "calibration: the group index does not follow from temperature and "
            f"salinity here ({error}); state group_index_uncertainty"
        ) from None
    return math.hypot(*parts)


#: Steps of temperature and salinity for the derivative of the index [degC, 1].
_STEP = 0.5
#: Points of each span.
_POINTS = 41


def _spread(survey: Survey, spans: Mapping[str, tuple[float, float]]) -> float:
    """Return the rms group-index error from unknown temperature and salinity [1]."""
    state = state_of(survey.water)
    if not spans:
        return 0.0
    ends = [spans.get(name, (value, value)) for name, value in state.items()]
    # Middles of equal parts: each has the same share of a rectangular distribution.
    part = (np.arange(_POINTS) + 0.5) / _POINTS
    grid = np.meshgrid(*[low + (high - low) * part for low, high in ends])
    wavelength = survey.instrument.wavelength
    index = seawater.group_index(wavelength, temperature=grid[0], salinity=grid[1])
    nominal = seawater.group_index(wavelength, **state)
    return float(np.sqrt(np.mean((index - nominal) ** 2)))


def _slope(survey: Survey, name: str) -> float:
    """Return the temperature or salinity derivative of the group index."""
    state = state_of(survey.water)
    highest = {"temperature": 30.0, "salinity": 43.0}[name]
    # One-sided at the limits of the formula's validity.
    ends = max(state[name] - _STEP, 0.0), min(state[name] + _STEP, highest)
    low, high = (
        float(
            seawater.group_index(survey.instrument.wavelength, **{**state, name: end})
        )
        for end in ends
    )
    return (high - low) / (ends[1] - ends[0])


def _moments(survey: Survey, optics: WaterOptics) -> tuple[float, float, float]:
    """Return forward fraction, second moment and phase function at 180 degrees."""
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
