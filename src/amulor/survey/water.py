"""Water described by coefficients, and the fields common to all kinds of water."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from amulor.survey.mueller import ReducedMueller
from amulor.survey.quantity import (
    Angle,
    AngleSquared,
    Description,
    Fraction,
    Length,
    PerMetre,
    PerSteradian,
    Temperature,
)
from amulor.survey.waters.phase_function import PhaseFunctionStated


class WaterState(Description):
    """Temperature, salinity and other fields common to all kinds of water."""

    split_angle: Annotated[Angle, Field(gt=0, le=math.pi)] = math.pi / 2
    """Angle that separates forward scattering from diffuse scattering [rad]. 90 degrees
    is right for the small-angle model, which simulates scans, and for its closure. With
    90 degrees, the diffusion model of Ricci et al. 2010 gives a cut-off that is 57 to
    83 % too high, and an echo of a far target that is too weak. State 10 to 20 degrees
    for the diffusion model."""
    temperature: Annotated[Temperature, Field(ge=0, le=30)] | None = None
    """Temperature of the water, which determines the refractive indices [degC]. Without
    a temperature, amulor assumes 15 degC. The uncertainty of the ranges then includes
    temperatures from 0 to 30 degC."""
    salinity: Annotated[float, Field(ge=0, le=43)] | None = None
    """Practical salinity, which determines the refractive indices; 0 is fresh water
    [1]. Without a salinity, amulor assumes 20. The uncertainty of the ranges then
    includes salinities from 0 to 40."""
    refractive_index: Annotated[float, Field(ge=1.2, le=1.5)] | None = None
    """Phase index; computed from temperature and salinity by default [1]."""
    group_index: Annotated[float, Field(ge=1.2, le=1.6)] | None = None
    """Group index; computed from temperature and salinity by default [1]."""
    backscatter_mueller: ReducedMueller | None = None
    """Reduced Mueller matrix of the water at 180 degrees [1]. For jerlov, petzold and
    case-1, the default is a measurement in the sea. For pure, milk and spheres, the
    default is that of molecules and spheres. For coefficients and layers, the default
    conserves the polarization: 1, -1, -1."""
    column_end: Annotated[Length, Field(gt=0)] | None = None
    """Distance at which the open water ends (far wall of a tank); unlimited by default
    [m]."""
    signal_fluctuation: Annotated[Fraction, Field(ge=0, lt=1)] = 0.0
    """Relative standard deviation of the water signal between samples, such as from
    drifting clouds of particles [1]."""


#: Salinity and temperature of waters that do not state them [1, degC].
SALINITIES, TEMPERATURES = (0.0, 40.0), (0.0, 30.0)


def state_of(water: WaterState) -> dict[str, float]:
    """Return temperature and salinity of the water; mid-range values if not stated."""
    stated = {"temperature": water.temperature, "salinity": water.salinity}
    spans = {"temperature": TEMPERATURES, "salinity": SALINITIES}
    return {
        name: sum(spans[name]) / 2 if value is None else value
        for name, value in stated.items()
    }


class Water(WaterState):
    """Optical properties of a homogeneous water body at the laser's wavelength.

    Examples
    --------
    >>> from amulor.survey import Water, Survey, water_properties
    >>> water = Water(
    ...     absorption="0.05 1/m",
    ...     scattering="0.3 1/m",
    ...     asymmetry=0.92,
    ...     temperature="12 degC",
    ...     salinity=38,
    ... )
    >>> survey = Survey.preset("amulor-2010").with_({"water": water})
    >>> water_properties(survey).attenuation
    0.35
    """

    kind: Literal["coefficients"] | None = None
    """Kind of water. Without a kind, the coefficients describe the water."""
    absorption: Annotated[PerMetre, Field(ge=0)]
    """Absorption coefficient a [1/m]."""
    scattering: Annotated[PerMetre, Field(ge=0)]
    """Scattering coefficient b [1/m]."""
    asymmetry: Annotated[float, Field(gt=-1, lt=1)] | None = None
    """Mean cosine g of a Henyey-Greenstein phase function [1]."""
    forward_fraction: Annotated[Fraction, Field(ge=0, le=1)] | None = None
    """Fraction of the scattering below the split angle; by default from the asymmetry
    [1]."""
    second_moment: Annotated[AngleSquared, Field(ge=0)] | None = None
    """Mean square scattering angle of the forward part; by default from the asymmetry
    [rad^2]."""
    phase_function_at_180: Annotated[PerSteradian, Field(ge=0)] | None = None
    """Phase function at 180 degrees; by default from the asymmetry [1/sr]."""
    phase_function: PhaseFunctionStated | None = None
    """Phase function, instead of asymmetry or moments."""

    @model_validator(mode="after")
    def _phase_function_is_stated(self) -> Self:
        parts = {
            "forward_fraction": self.forward_fraction,
            "second_moment": self.second_moment,
            "phase_function_at_180": self.phase_function_at_180,
        }
        missing = [name for name, value in parts.items() if value is None]
        if self.phase_function is not None:
            if self.asymmetry is not None:
                raise ValueError(
                    "the phase function is stated twice; give asymmetry or "
                    "phase_function"
                )
            return self
        if self.asymmetry is None and missing and self.scattering > 0:
            raise ValueError(
                "the phase function is not stated: give asymmetry (Henyey-Greenstein), "
                f"or all of {', '.join(parts)}, or phase_function; missing: "
                f"{', '.join(missing)}"
            )
        return self

    @model_validator(mode="after")
    def _water_attenuates(self) -> Self:
        refuse_clear(self.absorption, self.scattering)
        return self

    @model_serializer(mode="wrap")
    def _coefficients_first(self, dump: SerializerFunctionWrapHandler) -> Any:
        """Serialize the fields in a fixed order, coefficients first."""
        content = dump(self)
        return {name: content[name] for name in _ORDER if name in content}


#: Order of the fields in a file; surveys are compared by digests of their text.
_ORDER = (
    "kind",
    "absorption",
    "scattering",
    "asymmetry",
    "split_angle",
    "forward_fraction",
    "second_moment",
    "phase_function_at_180",
    "temperature",
    "salinity",
    "refractive_index",
    "group_index",
    "backscatter_mueller",
    "column_end",
    "signal_fluctuation",
    "phase_function",
)


def refuse_clear(absorption: float, scattering: float) -> None:
    """Raise if the water neither absorbs nor scatters."""
    if absorption + scattering <= 0:
        raise ValueError(
            "absorption and scattering are both 0 1/m; even the clearest water "
            "absorbs, about 0.005 1/m in the blue"
        )
