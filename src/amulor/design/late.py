"""How sure the correction for light is that is scattered on its way to the target."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amulor.design.column import Looks
from amulor.design.geometry import Place
from amulor.errors import SurveyError
from amulor.optics.late_echo import RELATIVE_UNCERTAINTY, late_echo
from amulor.survey import Survey, WaterProperties
from amulor.survey.waters.whole_function import whole_phase_function

__all__ = ["late_uncertainty"]

Floats = NDArray[np.float64]

#: Distances at which the delay is worked out, for each factor of two.
_PER_OCTAVE = 3
#: Up to it the delay hardly depends on the modulation; beyond, it is less [Hz].
_FREQUENCY = 50e6
#: Natural waters are at least so much of the delay late, and imaging takes the middle
#: of that and of the whole, see `amulor.imaging.late_light` [1].
_LEAST_PART = 0.5
#: Below this asymmetry small angles do not describe the light [1].
_LEAST_ASYMMETRY = 0.6


def late_uncertainty(
    survey: Survey,
    water: WaterProperties,
    looks: Looks,
    places: list[Place],
    distance: Floats,
) -> Floats:
    """Return the standard uncertainty that imaging states for late light.

    Parameters
    ----------
    survey : Survey
        Its receiver and its calibration count.
    water : WaterProperties
        Its phase function counts.
    looks : Looks
        Waters and receivers.
    places : list of Place
        Where receivers stand; the water begins at the same place for all.
    distance : ndarray, shape (distance,)
        Slant ranges, increasing [m].

    Returns
    -------
    ndarray, shape (look, distance)
        Standard uncertainty after the middle estimate is taken off [m]; 0 where the
        water scatters nothing forward, or by too large angles for an estimate.

    Notes
    -----
    As `amulor.imaging.late_light`: a rectangular distribution between the delay of
    the phase function and half of it, and 15 % of the middle for the model. The delay
    over the square of the distance is interpolated in the logarithm of the distance. It
    is that at 50 MHz, an upper limit for higher frequencies.
    """
    shape = (len(looks.absorption), len(distance))
    if water.scattering == 0 or water.forward_scattering * water.second_moment == 0:
        return np.zeros(shape)
    try:
        function = whole_phase_function(water)
    except SurveyError:
        return np.zeros(shape)
    if function.asymmetry < _LEAST_ASYMMETRY:
        return np.zeros(shape)
    depth = np.maximum(distance - (distance[0] - float(places[0].depth[0])), 1e-3)
    count = 2 + math.ceil(_PER_OCTAVE * math.log2(depth[-1] / depth[0]))
    some = depth
    if len(depth) > count:
        some = np.geomspace(depth[0], depth[-1], count)
    # Where the receiver looks past the echo there is none to be late.
    with np.errstate(all="ignore"):
        delay = late_echo(
            _FREQUENCY,
            depth=some,
            scattering=looks.scattering[:, None],
            phase_function=function,
            split_angle=math.pi / 2,
            group_index=water.group_index,
            baseline=looks.baseline[:, None],
            receiver_radius=looks.radius[:, None],
            acceptance_angle=looks.acceptance[:, None],
            tilt=looks.tilt[:, None],
            cross_tilt=looks.cross_tilt[:, None],
            standoff=looks.standoff[:, None],
        )
    even = np.nan_to_num(delay) / some**2
    if len(some) == 1:
        found = np.repeat(even, len(depth), axis=1)
    else:
        place = np.interp(
            np.log(depth), np.log(some), np.arange(len(some), dtype=float)
        )
        low = np.minimum(place.astype(int), len(some) - 2)
        part = place - low
        found = (1 - part) * even[:, low] + part * even[:, low + 1]
    calibration = survey.calibration
    own = None if calibration is None else calibration.scattering_uncertainty
    relative = math.hypot(RELATIVE_UNCERTAINTY, own or 0.0) * (1 + _LEAST_PART) / 2
    spread = (1 - _LEAST_PART) / math.sqrt(12)
    return np.asarray(math.hypot(relative, spread) * np.abs(found) * depth**2)
