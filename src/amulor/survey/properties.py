"""What follows from a description of water: indices, split scattering, backscatter."""

from __future__ import annotations

import math
from dataclasses import dataclass

from amulor.errors import SurveyError
from amulor.optics import phase_functions
from amulor.optics.water import seawater
from amulor.survey.survey import Survey


@dataclass(frozen=True, kw_only=True)
class WaterProperties:
    """The numbers of the water that the signal models take."""

    absorption: float
    """Absorption coefficient a [1/m]."""
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

    @property
    def reduced_attenuation(self) -> float:
        """Reduced attenuation coefficient k' = a + b_d [1/m]."""
        return self.absorption + self.diffuse_scattering


def water_properties(survey: Survey) -> WaterProperties:
    """Return the optical numbers of a survey's water at its wavelength.

    Parameters
    ----------
    survey : Survey
        Stated numbers win; what is not stated follows from a Henyey-Greenstein phase
        function and from wavelength, temperature and salinity.

    Returns
    -------
    WaterProperties
        Numbers in SI units.

    Raises
    ------
    SurveyError
        If the indices cannot be computed for this wavelength or water.
    """
    water = survey.water
    forward, moment, backwards = (
        water.forward_fraction,
        water.second_moment,
        water.phase_function_at_180,
    )
    if water.asymmetry is not None:
        g, split = water.asymmetry, water.split_angle
        if forward is None:
            forward = float(
                phase_functions.henyey_greenstein_forward_fraction(
                    asymmetry=g, split_angle=split
                )
            )
        if moment is None:
            moment = float(
                phase_functions.henyey_greenstein_second_moment(
                    asymmetry=g, split_angle=split
                )
            )
        if backwards is None:
            backwards = (1 - g) / (4 * math.pi * (1 + g) ** 2)
    forward, moment, backwards = forward or 0.0, moment or 0.0, backwards or 0.0
    state = {"temperature": water.temperature, "salinity": water.salinity}
    wavelength = survey.instrument.wavelength
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
    return WaterProperties(
        absorption=water.absorption,
        forward_scattering=forward * water.scattering,
        diffuse_scattering=(1 - forward) * water.scattering,
        second_moment=moment,
        backscatter_vsf=water.scattering * backwards,
        refractive_index=phase_index,
        group_index=group_index,
    )
