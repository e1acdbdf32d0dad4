"""Kinds of water whose coefficients follow from type, station or ingredients."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from amulor.survey.quantity import (
    Description,
    Fraction,
    Length,
    MassConcentration,
    PerMetre,
)
from amulor.survey.water import Water, WaterState, refuse_clear
from amulor.survey.waters.phase_function import PhaseFunctionStated


class JerlovWater(WaterState):
    """Sea water of one of Jerlov's optical types.

    Examples
    --------
    >>> from amulor.survey import JerlovWater, Survey, water_properties
    >>> water = JerlovWater(
    ...     kind="jerlov", type="3C", source="solonenko-mobley-2015"
    ... )
    >>> survey = Survey.preset("amulor-2010").with_({"water": water})
    >>> found = water_properties(survey)
    >>> round(found.absorption, 2), round(found.scattering, 2)
    (0.36, 1.79)
    """

    kind: Literal["jerlov"]
    """Kind of water."""
    type: Literal["I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C"]
    """Jerlov type: I to III in the open ocean, 1C to 9C at coasts."""
    source: Literal["solonenko-mobley-2015", "williamson-hollins-2022"]
    """Source of absorption and scattering: a model fitted to diffuse attenuation
    (Solonenko and Mobley), or averages of measurements (Williamson and Hollins, types
    IB to 5C). Their values differ by a factor of several."""
    particles: PhaseFunctionStated | None = None
    """Phase function of the particles; Petzold's average particle by default. amulor
    adds the scattering by molecules."""


class PetzoldWater(WaterState):
    """Water at a station where Petzold measured volume scattering functions.

    Examples
    --------
    >>> from amulor.survey import PetzoldWater, Survey, water_properties
    >>> water = PetzoldWater(
    ...     kind="petzold",
    ...     station="NUC 2200",
    ...     absorption="0.4 1/m",
    ...     scattering="1.8 1/m",
    ... )
    >>> survey = Survey.preset("amulor-2010").with_({"water": water})
    >>> round(water_properties(survey).attenuation, 2)
    2.2
    """

    kind: Literal["petzold"]
    """Kind of water."""
    station: Literal[
        "AUTEC 7",
        "AUTEC 8",
        "AUTEC 9",
        "HAOCE 5",
        "HAOCE 11",
        "NUC 2200",
        "NUC 2040",
        "NUC 2240",
    ]
    """Station: clear ocean (AUTEC), coast (HAOCE) or San Diego Harbor (NUC)."""
    absorption: Annotated[PerMetre, Field(ge=0)] | None = None
    """Absorption coefficient; by default the measured value, for wavelengths from 510
    to 550 nm [1/m]."""
    scattering: Annotated[PerMetre, Field(gt=0)] | None = None
    """Scattering coefficient; by default the measured value, for wavelengths from 510
    to 550 nm [1/m]."""


class PureWater(WaterState):
    """Pure fresh or sea water of a given temperature and salinity.

    Examples
    --------
    >>> from amulor.survey import PureWater, Survey, water_properties
    >>> water = PureWater(kind="pure", temperature="15 degC", salinity=0.0)
    >>> survey = Survey.preset("amulor-2010").with_({"water": water})
    >>> found = water_properties(survey)
    >>> round(found.absorption, 4), round(found.group_index, 3)
    (0.0026, 1.381)
    """

    kind: Literal["pure"]
    """Kind of water."""
    absorption_source: Literal["mason-2016", "pope-fry-1997"] = "mason-2016"
    """Source of the absorption. Pope and Fry measured fresh water at 22 degC; their
    value at 405 nm is twice that of Mason."""


class Case1Water(WaterState):
    """Open-ocean (case-1) water, whose optical properties follow from chlorophyll.

    Examples
    --------
    >>> from amulor.survey import Case1Water, Survey, water_properties
    >>> water = Case1Water(kind="case-1", chlorophyll="0.5 mg/m^3")
    >>> survey = Survey.preset("amulor-2010").with_({"water": water})
    >>> round(water_properties(survey).attenuation, 2)
    0.38
    """

    kind: Literal["case-1"]
    """Kind of water."""
    chlorophyll: Annotated[MassConcentration, Field(ge=0.02, le=30)]
    """Concentration of chlorophyll a [mg/m^3]."""
    cdom_absorption: Annotated[PerMetre, Field(ge=0)] | None = None
    """Absorption of dissolved matter at 440 nm; by default a fifth of the absorption of
    the particles [1/m]."""
    cdom_slope: Annotated[PerMetre, Field(ge=0, le=0.1e9)] = 0.014e9
    """Spectral slope of dissolved matter, such as "0.014 1/nm" [1/m]."""


class MilkWater(WaterState):
    """Milk in pure water, given by fat content and volume.

    Examples
    --------
    >>> from amulor.survey import MilkWater, Survey, water_properties
    >>> water = MilkWater(
    ...     kind="milk",
    ...     volume_fraction="0.002 %",
    ...     fat="3.5 %",
    ...     scattering_source="jensen-2001",
    ...     salinity=0.0,
    ... )
    >>> survey = Survey.preset("amulor-2010").with_({"water": water})
    >>> round(water_properties(survey).scattering, 2)
    0.5
    """

    kind: Literal["milk"]
    """Kind of water."""
    volume_fraction: Annotated[Fraction, Field(gt=0, le=0.05)]
    """Volume of the milk over volume of the mixture; 0.001 is 1 ml in a liter [1]."""
    fat: Annotated[Fraction, Field(ge=0.001, le=0.05)]
    """Mass fraction of fat in the milk [1]."""
    scattering_source: Literal["mie", "jensen-2001"] = "mie"
    """Source of the scattering coefficient: spheres of fat and casein, or measurements
    of skim milk (fat up to 0.5 %) and whole milk (3 to 4 %). The phase function is
    always that of the spheres."""

    @model_validator(mode="after")
    def _was_measured(self) -> Self:
        skim, whole = self.fat <= 0.005, 0.03 <= self.fat <= 0.04
        if self.scattering_source == "jensen-2001" and not (skim or whole):
            raise ValueError(
                f"fat is {100 * self.fat:g} %, but Jensen et al. 2001 measured skim "
                "milk (up to 0.5 %) and whole milk (3 to 4 %) only; use "
                'scattering_source = "mie"'
            )
        return self


class SphereWater(WaterState):
    """Pure water with spheres of one size, whose scattering follows Mie's theory.

    Examples
    --------
    >>> from amulor.survey import SphereWater, Survey, water_properties
    >>> water = SphereWater(
    ...     kind="spheres",
    ...     diameter="2 um",
    ...     particle_index=1.59,
    ...     scattering="0.5 1/m",
    ... )
    >>> survey = Survey.preset("amulor-2010").with_({"water": water})
    >>> round(water_properties(survey).attenuation, 2)
    0.51
    """

    kind: Literal["spheres"]
    """Kind of water."""
    diameter: Annotated[Length, Field(gt=0, le=1e-3)]
    """Diameter of the spheres [m]."""
    particle_index: Annotated[float, Field(ge=1.0, le=3.0)]
    """Refractive index of the spheres, relative to vacuum [1]."""
    particle_absorption_index: Annotated[float, Field(ge=0, le=3)] = 0.0
    """Imaginary part of the refractive index of the spheres [1]."""
    volume_fraction: Annotated[Fraction, Field(gt=0, le=0.05)] | None = None
    """Volume of the spheres over volume of the water [1]."""
    scattering: Annotated[PerMetre, Field(gt=0)] | None = None
    """Scattering coefficient of the spheres, instead of their volume fraction [1/m]."""
    absorption: Annotated[PerMetre, Field(ge=0)] | None = None
    """Absorption coefficient of the mixture; by default that of pure water and spheres
    [1/m]."""

    @model_validator(mode="after")
    def _is_stated_once(self) -> Self:
        if (self.volume_fraction is None) == (self.scattering is None):
            raise ValueError("spheres need a volume_fraction or a scattering, not both")
        return self


class WaterLayer(Description):
    """Layer of water, perpendicular to the forward axis of the instrument.

    Examples
    --------
    >>> from amulor.survey import WaterLayer
    >>> grain = {"kind": "henyey-greenstein", "asymmetry": 0.9}
    >>> layer = WaterLayer(
    ...     thickness="3 m",
    ...     absorption="0.05 1/m",
    ...     scattering="0.1 1/m",
    ...     phase_function=grain,
    ... )
    >>> layer.thickness, layer.phase_function.asymmetry
    (3.0, 0.9)
    """

    thickness: Annotated[Length, Field(gt=0)] | None = None
    """Thickness along the forward axis; omitted for the last layer, which has no end
    [m]."""
    absorption: Annotated[PerMetre, Field(ge=0)]
    """Absorption coefficient a [1/m]."""
    scattering: Annotated[PerMetre, Field(ge=0)]
    """Scattering coefficient b [1/m]."""
    phase_function: PhaseFunctionStated
    """Phase function of the layer."""

    @model_validator(mode="after")
    def _water_attenuates(self) -> Self:
        refuse_clear(self.absorption, self.scattering)
        return self


class LayeredWater(WaterState):
    """Layers of water, for photon transport in open water only.

    Examples
    --------
    >>> from amulor.survey import LayeredWater, Survey, WaterLayer, water_properties
    >>> grain = {"kind": "henyey-greenstein", "asymmetry": 0.9}
    >>> clear = WaterLayer(
    ...     thickness="3 m",
    ...     absorption="0.05 1/m",
    ...     scattering="0.1 1/m",
    ...     phase_function=grain,
    ... )
    >>> below = WaterLayer(
    ...     absorption="0.1 1/m", scattering="1 1/m", phase_function=grain
    ... )
    >>> water = LayeredWater(kind="layers", layers=(clear, below))
    >>> survey = Survey.preset("amulor-2010").with_({"water": water, "targets": []})
    >>> [round(layer.scattering, 2) for layer in water_properties(survey).layers]
    [0.1, 1.0]
    """

    kind: Literal["layers"]
    """Kind of water."""
    layers: Annotated[tuple[WaterLayer, ...], Field(min_length=2, max_length=50)]
    """Layers of water, beginning with the nearest."""

    @model_validator(mode="after")
    def _only_the_last_goes_on(self) -> Self:
        missing = [layer.thickness is None for layer in self.layers]
        if any(missing[:-1]) or not missing[-1]:
            raise ValueError(
                "every layer needs a thickness but the last one, which goes on"
            )
        return self


def _kind(description: Any) -> Any:
    """Return the `kind` of a water; "coefficients" if it states none."""
    if isinstance(description, dict):
        return description.get("kind") or "coefficients"
    return getattr(description, "kind", None) or "coefficients"


WaterStated = Annotated[
    Annotated[Water, Tag("coefficients")]
    | Annotated[JerlovWater, Tag("jerlov")]
    | Annotated[PetzoldWater, Tag("petzold")]
    | Annotated[PureWater, Tag("pure")]
    | Annotated[Case1Water, Tag("case-1")]
    | Annotated[MilkWater, Tag("milk")]
    | Annotated[SphereWater, Tag("spheres")]
    | Annotated[LayeredWater, Tag("layers")],
    Discriminator(_kind),
]
