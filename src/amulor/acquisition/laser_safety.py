"""Maximum permissible exposure and hazard distance of a visible beam (IEC 60825-1).

A calculation for planning. It is no classification and no certificate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from amulor.survey import Survey, water_properties

LaserClass = Literal["1", "2", "3R", "3B", "4"]

#: Wavelengths of the limits below [m].
_VISIBLE = (400e-9, 700e-9)
#: Exposures of the limits below [s].
_EXPOSURES = (18e-6, 3e4)
#: Diameter of the pupil [m].
APERTURE = 7e-3
#: Longest modulation period that counts by its mean [s].
_ONE_PULSE = 5e-6
#: Largest power of each class above 1, for a continuous visible point source [W].
_CLASS_POWERS = {"2": 1e-3, "3R": 5e-3, "3B": 0.5, "4": math.inf}
#: Exposure of class 1 [s].
_CLASS_1_EXPOSURE = 3e4
#: Accuracy of a distance, and the distance beyond which it is infinite [m].
_EXACT, _FARTHEST = 1e-4, 1e6


@dataclass(frozen=True, kw_only=True)
class Hazard:
    """Hazard of a laser beam to an eye in the beam."""

    permissible_irradiance: float
    """Maximum permissible exposure at the cornea, averaged over the exposure time
    [W/m2]."""
    irradiance: float
    """Irradiance at the instrument, averaged over the pupil [W/m2]."""
    distance_in_air: float
    """Hazard distance in air, beyond which the exposure is permissible [m]."""
    distance_in_water: float
    """Hazard distance in the survey's water, by absorption and divergence [m]."""
    class_power: float
    """Largest power of the laser class [W]."""
    exceeds_class: bool
    """Whether the laser power of the survey exceeds the class power."""


def permissible_irradiance(wavelength: float, *, exposure: float) -> float:
    r"""Return the maximum permissible exposure of an eye to a visible beam [W/m2].

    Notes
    -----
    The limits are from IEC 60825-1:2014, table A.1, for an angular subtense of at most
    1.5 mrad. Thermal limit: :math:`18\, t^{3/4}` J/m2 up to 10 s and 10 W/m2 beyond.
    Photochemical limit, from 10 s on and below 600 nm: :math:`100\, C_3` J/m2 up to
    100 s and :math:`C_3` W/m2 beyond, with
    :math:`C_3 = 10^{0.02 (\lambda / \mathrm{nm} - 450)}`, at least 1. The smaller limit
    applies.

    Examples
    --------
    The aversion response, 0.25 s, and the power through the pupil:

    >>> limit = permissible_irradiance(532e-9, exposure=0.25)
    >>> print(f"{limit:.1f} W/m2, {limit * 3.85e-5 * 1e3:.2f} mW")
    25.5 W/m2, 0.98 mW
    """
    if not _VISIBLE[0] <= wavelength <= _VISIBLE[1]:
        raise ValueError(
            f"wavelength must lie between 400 nm and 700 nm, got {wavelength * 1e9:g} "
            "nm; take the limits of another one from the standard"
        )
    if not _EXPOSURES[0] <= exposure <= _EXPOSURES[1]:
        raise ValueError(
            f"exposure must lie between 18 us and 30000 s, got {exposure:g} s"
        )
    thermal = 18 * exposure**-0.25 if exposure < 10 else 10.0
    if exposure < 10 or wavelength >= 600e-9:
        return thermal
    blue = max(1.0, 10 ** (0.02 * (wavelength * 1e9 - 450)))
    return min(thermal, 100 * blue / min(exposure, 100.0))


def pupil_irradiance(power: float, *, diameter: float) -> float:
    """Return the irradiance of a Gaussian beam averaged over a pupil [W/m2]."""
    if not (power >= 0 and diameter > 0):
        raise ValueError(
            f"power must not be negative and diameter above 0, got {power:g} W and "
            f"{diameter:g} m"
        )
    fraction = -math.expm1(-((APERTURE / diameter) ** 2))
    return power * fraction / (math.pi / 4 * APERTURE**2)


def hazard(
    survey: Survey,
    *,
    beam_diameter: float,
    divergence: float,
    laser_class: LaserClass,
    exposure: float = 0.25,
) -> Hazard:
    """Return the eye hazard of the laser beam of a survey.

    The beam widens by its divergence, in water by the divergence over the refractive
    index, and is absorbed. Scattering counts as no protection, because light scattered
    forward may still reach the eye. Periods of the modulation below 5 us count as one
    pulse, so that the mean power applies.
    """
    if not (beam_diameter > 0 and divergence >= 0):
        raise ValueError(
            "beam_diameter must be above 0 and divergence not negative, got "
            f"{beam_diameter:g} m and {divergence:g} rad"
        )
    slowest = min(survey.instrument.modulation_frequencies)
    if slowest * _ONE_PULSE < 1:
        raise ValueError(
            f"a modulation of {slowest:g} Hz is so slow that each period counts by "
            "itself; take the rules for pulses from the standard"
        )
    power, wavelength = survey.instrument.power, survey.instrument.wavelength
    limit = permissible_irradiance(wavelength, exposure=exposure)
    water = water_properties(survey)

    def distance(growth: float, absorption: float) -> float:
        def irradiance(length: float) -> float:
            return pupil_irradiance(
                power * math.exp(-absorption * length),
                diameter=beam_diameter + growth * length,
            )

        near, far = 0.0, 1.0
        if irradiance(near) <= limit:
            return 0.0
        while irradiance(far) > limit:
            near, far = far, 2 * far
            if far > _FARTHEST:
                return math.inf
        while far - near > _EXACT:
            middle = (near + far) / 2
            near, far = (middle, far) if irradiance(middle) > limit else (near, middle)
        return far

    allowed = _CLASS_POWERS.get(laser_class)
    if allowed is None:
        class_1 = permissible_irradiance(wavelength, exposure=_CLASS_1_EXPOSURE)
        allowed = class_1 * math.pi / 4 * APERTURE**2
    return Hazard(
        permissible_irradiance=limit,
        irradiance=pupil_irradiance(power, diameter=beam_diameter),
        distance_in_air=distance(divergence, 0.0),
        distance_in_water=distance(
            divergence / water.refractive_index, water.absorption
        ),
        class_power=allowed,
        exceeds_class=power > allowed,
    )
