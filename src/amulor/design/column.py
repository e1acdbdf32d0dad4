"""Echo and water light of many instruments in many waters, from one table each."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light
from scipy.interpolate import CubicSpline, PchipInterpolator

from amulor.design._kernels import points as kernel
from amulor.design.geometry import Place
from amulor.errors import SurveyError
from amulor.optics import small_angle, target_echo
from amulor.optics.late_echo import RELATIVE_UNCERTAINTY, late_echo
from amulor.optics.small_angle import sharp_receiver
from amulor.survey import Survey, WaterProperties
from amulor.survey.view import beam_arguments, has_sharp_receiver
from amulor.survey.waters.whole_function import whole_phase_function

__all__ = ["Columns", "Looks", "columns", "late_uncertainty", "overlaps"]


Floats = NDArray[np.float64]

#: Knots of the logarithm of the overlap, evenly in the logarithm of the depth.
_KNOTS = 64
#: First knot [m]: in front of it the overlap is that of the knot.
_NEAREST = 5e-3
#: Growth of the panels of the integral, and their points.
_GROWTH, _POINTS = 1.3, 6
#: Largest phase over one panel [rad].
_TURN = 2.5
#: Light of an overlap so small counts as none (logarithm).
_DARK = -690.0
#: Overlap so small somewhere that its logarithm falls steeply.
_STEEP = -100.0
#: Optical depth, and distance, beyond which no open water is summed up.
_FADED, _FARTHEST = 14.0, 150.0


@dataclass(frozen=True, kw_only=True)
class Looks:
    """How receivers look through waters, arrays over (look,)."""

    absorption: Floats
    """Absorption coefficient [1/m]."""
    scattering: Floats
    """Scattering coefficient [1/m]."""
    baseline: Floats
    """Distance of receiver and beam where the depth is zero [m]."""
    tilt: Floats
    """Inclination of the beam against the receiver's axis [rad]."""
    cross_tilt: Floats
    """The same across the baseline [rad]."""
    standoff: Floats
    """Air and glass before the water, as a depth of water [m]."""
    radius: Floats
    """1/e half-width of the aperture [m]."""
    acceptance: Floats
    """1/e half-width of the field of view in the water [rad]."""
    back: Floats
    """Water on the way back from each depth, shape (look, depth) [m]."""


@dataclass(frozen=True, kw_only=True)
class Columns:
    """Received per launched power before polarizers, arrays over (look, ...)."""

    mean: Floats
    """Light of the water in front of each depth, the last one to its end, shape
    (look, depth + 1) [1]."""
    water: NDArray[np.complex128]
    """The same at each frequency, shape (look, depth + 1, frequency) [1]."""


def columns(
    survey: Survey,
    water: WaterProperties,
    looks: Looks,
    *,
    depth: Floats,
    frequency: Floats,
) -> Columns:
    r"""Return the water light by the small-angle model, in front of all depths at once.

    :math:`\ln F(z)` of eq. (29) of Ricci et al. 2010, as rebuilt, is computed at 64
    depths for each look and a cubic spline of :math:`\ln z` goes through them. The
    water is :math:`\beta_\pi \int F(z) e^{2 i \omega z / v} dz` by Gauss's rule on
    panels that begin and end at the asked depths, so one sum serves all depths.
    """
    farthest = _farthest(survey, looks, depth)
    knots = np.geomspace(_NEAREST, farthest, _KNOTS)
    place = np.log(knots)
    logarithm = _log_overlap(survey, water, looks, knots)
    spline = CubicSpline(place, logarithm, axis=1)
    # Where the view of the receiver begins, a smooth spline swings far above the light.
    steep = logarithm.min(axis=1) < _STEEP
    if steep.any():
        straight = PchipInterpolator(place, logarithm[steep], axis=1)
        spline.c[:, :, steep] = straight.c
    # Pieces as (power, segment, look); evaluated from the start of each.
    piece = np.ascontiguousarray(spline.c)
    rate = 4 * math.pi / speed_of_light * water.group_index * frequency
    nodes = _nodes(place, depth, farthest, rate, end=survey.water.column_end)
    count = len(looks.absorption)
    mean = np.empty((count, len(depth) + 1))
    summed = np.empty((count, len(depth) + 1, len(frequency)), dtype=complex)
    kernel.fill_columns(piece, nodes, mean, summed)
    per_scattering = (
        water.backscatter_vsf / water.scattering if water.scattering > 0 else 0.0
    )
    vsf = per_scattering * looks.scattering
    return Columns(
        mean=vsf[:, None] * mean,
        water=np.asarray(vsf[:, None, None] * summed),
    )


def _log_overlap(
    survey: Survey, water: WaterProperties, looks: Looks, knots: Floats
) -> Floats:
    """Return the logarithm of F at all knots, shape (look, knot)."""
    overlap = (
        sharp_receiver.overlap if has_sharp_receiver(survey) else small_angle.overlap
    )
    value = overlap(knots, **_arguments(survey, water, looks))
    return np.asarray(np.log(np.maximum(value, math.exp(_DARK))))


def overlaps(
    survey: Survey, water: WaterProperties, looks: Looks, *, depth: Floats
) -> Floats:
    """Return F of the ways out and back, by the small-angle model."""
    echo = (
        target_echo.sharp_receiver_target_response
        if has_sharp_receiver(survey)
        else target_echo.small_angle_target_response
    )
    value = echo(
        0.0,
        depth=depth,
        optical_path=0.0,
        reflectance=1.0,
        return_path=looks.back,
        **_arguments(survey, water, looks),
    )
    return np.asarray(np.pi * value.real)


def _arguments(survey: Survey, water: WaterProperties, looks: Looks) -> dict[str, Any]:
    """Return waters and receivers as the optics take them, shape (look, 1)."""
    absorption, scattering = looks.absorption, looks.scattering
    forward = water.forward_scattering * water.second_moment
    arguments: dict[str, Any] = beam_arguments(survey, water)
    if forward == 0:
        # Light that is scattered by no angle is not scattered.
        share = water.diffuse_scattering / water.scattering if water.scattering else 0.0
        absorption = absorption + share * scattering
        scattering = np.zeros_like(scattering)
    return {
        "absorption": absorption[:, None],
        "scattering": scattering[:, None],
        "phase_function": whole_phase_function(water),
        "split_angle": water.split_angle,
        "baseline": looks.baseline[:, None],
        "receiver_radius": looks.radius[:, None],
        "acceptance_angle": looks.acceptance[:, None],
        "tilt": looks.tilt[:, None],
        "cross_tilt": looks.cross_tilt[:, None],
        "standoff": looks.standoff[:, None],
        **arguments,
    }


def _farthest(survey: Survey, looks: Looks, depth: Floats) -> float:
    """Return how far the water is summed up [m]."""
    least = float(np.min(looks.absorption + 0.1 * looks.scattering))
    faded = _FADED / (2 * least) if least > 0 else _FARTHEST
    reach = max(1.5 * float(depth[-1]), min(faded, _FARTHEST))
    end = survey.water.column_end
    # A target may stand at the end of the water, or be asked for behind it.
    return reach if end is None else max(min(reach, end), float(depth[-1]))


def _nodes(
    place: Floats,
    depth: Floats,
    farthest: float,
    rate: Floats,
    *,
    end: float | None,
) -> kernel.Nodes:
    """Return the points of the integral, their pieces of the spline and phases."""
    widest = _TURN / max(float(rate.max()), 1e-9)
    edges = [0.0, float(math.exp(place[0]))]
    while edges[-1] < farthest * (1 - 1e-9):
        step = min((_GROWTH - 1) * edges[-1], widest)
        edges.append(min(edges[-1] + step, farthest))
    ends = [] if end is None or end > farthest else [end]
    edge = np.unique(np.concatenate([edges, depth, ends]))
    node, weight = np.polynomial.legendre.leggauss(_POINTS)
    half = np.diff(edge)[:, None] / 2
    z = (edge[:-1, None] + half * (node + 1)).ravel()
    logarithm = np.clip(np.log(z), place[0], place[-1])
    segment = np.clip(np.searchsorted(place, logarithm) - 1, 0, len(place) - 2)
    return kernel.Nodes(
        segment=segment,
        within=logarithm - place[segment],
        weight=np.where(
            z < (np.inf if end is None else end), (half * weight).ravel(), 0.0
        ),
        turn=np.exp(1j * z[:, None] * rate),
        stop=np.searchsorted(edge, depth) * _POINTS,
    )


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
