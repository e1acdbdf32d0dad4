"""Optical coefficients and phase function of any kind of water in a survey."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import assert_never

import numpy as np

from amulor.errors import SurveyError
from amulor.optics.phase_functions import mie, mixture, models, tables
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.optics.water import case_1, milk, seawater, types
from amulor.survey.mueller import SEA, keeping
from amulor.survey.water import Water, WaterState, state_of
from amulor.survey.waters.named import (
    Case1Water,
    JerlovWater,
    LayeredWater,
    MilkWater,
    PetzoldWater,
    PureWater,
    SphereWater,
    WaterStated,
)
from amulor.survey.waters.phase_function import phase_function

#: Wavelengths at which coefficients of Petzold's stations are valid, about 530 nm [m].
_PETZOLD_SPAN = 20e-9
_PETZOLD = 530e-9
#: Depolarization ratio of the molecules of water for natural light [1].
_MOLECULES = 0.039
#: Fat between that of skim and of whole milk, by mass [1].
_SKIM = 0.01


@dataclass(frozen=True, kw_only=True)
class LayerOptics:
    """Absorption, scattering and phase function of a layer of water."""

    thickness: float
    """Thickness along the forward axis; infinite for the last layer [m]."""
    absorption: float
    """Absorption coefficient a [1/m]."""
    scattering: float
    """Scattering coefficient b [1/m]."""
    phase_function: PhaseFunction
    """Phase function of the layer."""


@dataclass(frozen=True, kw_only=True)
class WaterOptics:
    """Absorption, scattering and phase function of water."""

    absorption: float
    """Absorption coefficient a [1/m]."""
    scattering: float
    """Scattering coefficient b [1/m]."""
    phase_function: PhaseFunction | None
    """Phase function; None if only moments are stated."""
    source: str
    """Source of coefficients and phase function."""
    mueller: tuple[float, float, float] | None = None
    """Mueller matrix at 180 degrees, (m22, m33, m44); None if unknown [1]."""
    layers: tuple[LayerOptics, ...] = ()
    """Layers, if the water has any; its coefficients are those of the first layer."""


@lru_cache(maxsize=64)
def resolved(
    water: WaterStated, *, wavelength: float, refractive_index: float
) -> WaterOptics:
    """Return absorption, scattering and phase function of any kind of water; cached."""
    try:
        return _resolved(water, wavelength, refractive_index)
    except ValueError as error:
        raise SurveyError(
            f"water: is not known at {1e9 * wavelength:g} nm ({error}); state its "
            "coefficients, or another wavelength"
        ) from None


def _resolved(
    water: WaterStated, wavelength: float, refractive_index: float
) -> WaterOptics:
    match water:
        case Water():
            return _by_coefficients(water)
        case JerlovWater():
            return _jerlov(water, wavelength)
        case PetzoldWater():
            return _petzold(water, wavelength)
        case PureWater():
            return _pure(water, wavelength)
        case Case1Water():
            return _case_1(water, wavelength)
        case MilkWater():
            return _milk(water, wavelength, refractive_index)
        case SphereWater():
            return _spheres(water, wavelength, refractive_index)
        case LayeredWater():
            return _layered(water)
    assert_never(water)


def _by_coefficients(water: Water) -> WaterOptics:
    function = None
    if water.phase_function is not None:
        function = phase_function(water.phase_function)
    elif water.asymmetry is not None:
        function = _henyey_greenstein(water.asymmetry)
    return WaterOptics(
        absorption=water.absorption,
        scattering=water.scattering,
        phase_function=function,
        source="coefficients as stated",
    )


@lru_cache(maxsize=32)
def _henyey_greenstein(asymmetry: float) -> PhaseFunction | None:
    try:
        return models.henyey_greenstein_function(asymmetry=asymmetry)
    except ValueError:  # too sharp a peak for tables, not for its closed forms
        return None


def _jerlov(water: JerlovWater, wavelength: float) -> WaterOptics:
    optics = types.jerlov(water.type, wavelength, source=water.source)
    scattering = float(optics.scattering)
    molecules = min(_molecules(water, wavelength), scattering)
    particles = (
        tables.petzold("average_particle")
        if water.particles is None
        else phase_function(water.particles)
    )
    return WaterOptics(
        absorption=float(optics.absorption),
        scattering=scattering,
        phase_function=mixture.mixture(
            [models.rayleigh_phase(depolarization=_MOLECULES), particles],
            scattering=[molecules, scattering - molecules],
        ),
        mueller=SEA,
        source=f"Jerlov type {water.type}, {water.source} ({optics.status})",
    )


def _petzold(water: PetzoldWater, wavelength: float) -> WaterOptics:
    station = types.petzold_station(water.station)
    coefficients = (water.absorption, water.scattering)
    if None in coefficients and abs(wavelength - _PETZOLD) > _PETZOLD_SPAN:
        raise SurveyError(
            f"water: Petzold measured {water.station} at 530 nm, not at "
            f"{1e9 * wavelength:g} nm, where only the shape of his phase function may "
            "serve; state absorption and scattering beside the station"
        )
    return WaterOptics(
        absorption=station.absorption if coefficients[0] is None else coefficients[0],
        scattering=station.scattering if coefficients[1] is None else coefficients[1],
        phase_function=_station(water.station),
        mueller=SEA,
        source=f"Petzold 1972, {water.station}"
        + ("" if None in coefficients else " (phase function)"),
    )


@lru_cache(maxsize=16)
def _station(name: str) -> PhaseFunction:
    return tables.petzold(name)


def _pure(water: PureWater, wavelength: float) -> WaterOptics:
    if water.absorption_source == "pope-fry-1997":
        absorption = float(seawater.pope_fry_absorption(wavelength))
    else:
        absorption = _absorption(water, wavelength)
    kind = "sea" if state_of(water)["salinity"] > 0 else "fresh"
    return WaterOptics(
        absorption=absorption,
        scattering=_molecules(water, wavelength),
        phase_function=models.rayleigh_phase(depolarization=_MOLECULES),
        mueller=keeping(1 - _MOLECULES),
        source=f"pure {kind} water, {water.absorption_source}, Zhang 2009",
    )


def _case_1(water: Case1Water, wavelength: float) -> WaterOptics:
    pigment = {"chlorophyll": water.chlorophyll}
    dissolved = water.cdom_absorption
    if dissolved is None:
        dissolved = case_1.CDOM_FRACTION * float(
            case_1.particle_absorption(440e-9, **pigment)
        )
    scattering = float(case_1.particle_scattering(wavelength, **pigment))
    backscattering = float(case_1.particle_backscattering(wavelength, **pigment))
    molecules = _molecules(water, wavelength)
    cdom = case_1.cdom_absorption(
        wavelength, absorption_at_440=dissolved, cdom_slope=water.cdom_slope
    )
    return WaterOptics(
        absorption=_absorption(water, wavelength)
        + float(case_1.particle_absorption(wavelength, **pigment))
        + float(cdom),
        scattering=molecules + scattering,
        phase_function=mixture.mixture(
            [
                models.rayleigh_phase(depolarization=_MOLECULES),
                mixture.fournier_forand_with_backscatter(backscattering / scattering),
            ],
            scattering=[molecules, scattering],
        ),
        mueller=SEA,
        source=f"case 1, {water.chlorophyll:g} mg/m^3 chlorophyll (Bricaud 1998, "
        "Morel and Maritorena 2001)",
    )


def _milk(water: MilkWater, wavelength: float, refractive_index: float) -> WaterOptics:
    spheres = milk.milk_suspension(
        wavelength,
        volume_fraction=water.volume_fraction,
        fat=water.fat,
        medium_index=refractive_index,
    )
    added, absorbed, source = spheres.scattering, spheres.absorption, "Mie spheres"
    if water.scattering_source == "jensen-2001":
        kind = "skim" if water.fat <= _SKIM else "whole"
        measured = milk.measured_milk(wavelength, kind=kind)
        share = 1 - spheres.phase_function.asymmetry
        added = water.volume_fraction * measured.reduced_scattering / share
        absorbed = water.volume_fraction * measured.absorption
        source = f"{kind} milk of Jensen 2001"
    return _in_pure_water(
        water,
        wavelength,
        absorption=absorbed,
        scattering=added,
        function=spheres.phase_function,
        source=f"milk, {100 * water.fat:g} % fat, {source}, within a factor of 1.5",
    )


def _spheres(
    water: SphereWater, wavelength: float, refractive_index: float
) -> WaterOptics:
    volume = np.pi / 6 * water.diameter**3
    suspension = mie.size_distribution(
        water.diameter,
        number=(water.volume_fraction or 1e-6) / volume,
        wavelength=wavelength,
        particle_index=complex(water.particle_index, water.particle_absorption_index),
        medium_index=refractive_index,
    )
    factor = (
        1.0 if water.scattering is None else water.scattering / suspension.scattering
    )
    return _in_pure_water(
        water,
        wavelength,
        absorption=max(suspension.extinction - suspension.scattering, 0.0) * factor,
        scattering=suspension.scattering * factor,
        function=suspension.phase_function,
        source=f"Mie spheres of {1e6 * water.diameter:g} um",
        whole_absorption=water.absorption,
    )


def _layered(water: LayeredWater) -> WaterOptics:
    layers = tuple(
        LayerOptics(
            thickness=np.inf if layer.thickness is None else layer.thickness,
            absorption=layer.absorption,
            scattering=layer.scattering,
            phase_function=phase_function(layer.phase_function),
        )
        for layer in water.layers
    )
    first = layers[0]
    return WaterOptics(
        absorption=first.absorption,
        scattering=first.scattering,
        phase_function=first.phase_function,
        layers=layers,
        source=f"{len(layers)} layers as stated, the first one here",
    )


def _in_pure_water(
    water: WaterState,
    wavelength: float,
    *,
    absorption: float,
    scattering: float,
    function: PhaseFunction,
    source: str,
    whole_absorption: float | None = None,
) -> WaterOptics:
    """Return the optical properties of pure water with particles."""
    molecules = _molecules(water, wavelength)
    if whole_absorption is None:
        whole_absorption = _absorption(water, wavelength) + absorption
    rayleigh = models.rayleigh_phase(depolarization=_MOLECULES)
    # Spheres keep polarization straight backwards; molecules keep a little less.
    backward = molecules * rayleigh.at_180, scattering * function.at_180
    depolarized = _MOLECULES * backward[0] / sum(backward)
    return WaterOptics(
        absorption=whole_absorption,
        scattering=molecules + scattering,
        phase_function=mixture.mixture(
            [rayleigh, function], scattering=[molecules, scattering]
        ),
        mueller=keeping(1 - depolarized),
        source=f"{source}, in pure water",
    )


def _absorption(water: WaterState, wavelength: float) -> float:
    return float(seawater.mason_absorption(wavelength, **state_of(water)))


def _molecules(water: WaterState, wavelength: float) -> float:
    return float(seawater.molecular_scattering(wavelength, **state_of(water)))
