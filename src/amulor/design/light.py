"""Echo and water signal of many instruments in many waters, from shared tables."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light
from scipy.interpolate import CubicSpline, PchipInterpolator

from amulor.design import _kernels as kernel
from amulor.design import geometry
from amulor.design.geometry import Place
from amulor.errors import SurveyError
from amulor.optics import small_angle, target_echo
from amulor.optics.late_echo import RELATIVE_UNCERTAINTY, late_echo
from amulor.optics.small_angle import sharp_receiver
from amulor.survey import Survey, WaterProperties
from amulor.survey.course import course_speed
from amulor.survey.late_light import LEAST_ASYMMETRY, LEAST_PART
from amulor.survey.view import beam_arguments, has_sharp_receiver
from amulor.survey.waters.whole_function import whole_phase_function

__all__ = [
    "Case",
    "Columns",
    "Lit",
    "Looks",
    "case_of",
    "columns",
    "late_uncertainty",
    "lit",
    "overlaps",
    "values_on_axes",
]


Floats = NDArray[np.float64]

#: Knots of the logarithm of the overlap, evenly in the logarithm of the depth.
_KNOTS = 64
#: Second difference beyond which a step between knots is divided, and its parts; and
#: the logarithm of the overlap below the largest, from which on it does not matter.
_BEND, _FINER, _FAINT = 0.1, 4, 20.0
#: First knot [m]: in front of it the overlap is that of the knot.
_NEAREST = 5e-3
#: Growth of the panels of the integral, and their points.
_GROWTH, _POINTS = 1.3, 6
#: Largest phase over one panel [rad].
_TURN = 2.5
#: Logarithm of a negligible overlap.
_DARK = -690.0
#: Overlap so small somewhere that its logarithm falls steeply.
_STEEP = -100.0
#: Optical depth, and distance, beyond which no open water is summed up.
_FADED, _FARTHEST = 14.0, 150.0


@dataclass(frozen=True, kw_only=True)
class Looks:
    """Distinct pairs of receiver geometry and water, arrays over (look,)."""

    absorption: Floats
    """Absorption coefficient [1/m]."""
    scattering: Floats
    """Scattering coefficient [1/m]."""
    baseline: Floats
    """Distance between receiver and beam at depth zero [m]."""
    tilt: Floats
    """Inclination of the beam to the receiver axis along the baseline [rad]."""
    cross_tilt: Floats
    """Inclination of the beam across the baseline [rad]."""
    standoff: Floats
    """Air and glass before the water, as equivalent water depth [m]."""
    radius: Floats
    """1/e half-width of the receiver aperture [m]."""
    acceptance: Floats
    """1/e half-width of the field of view in the water [rad]."""
    back: Floats
    """Return path length in water from each depth, shape (look, depth) [m]."""


@dataclass(frozen=True, kw_only=True)
class Columns:
    """Water signal per launched power, without polarizers, arrays over (look, ...)."""

    mean: Floats
    """Unmodulated water signal in front of each depth, full column last, shape
    (look, depth + 1) [1].
    """
    water: NDArray[np.complex128]
    """Water signal at each frequency, shape (look, depth + 1, frequency) [1]."""


def columns(
    survey: Survey,
    water: WaterProperties,
    looks: Looks,
    *,
    depth: Floats,
    frequency: Floats,
) -> Columns:
    r"""Compute water signals up to each depth and in total, by the small-angle model.

    :math:`\ln F(z)` of eq. (29) of Ricci et al. 2010, as rebuilt, is computed at 64
    depths for each look and interpolated by a cubic spline in :math:`\ln z`. The water
    signal is :math:`\beta_\pi \int F(z) e^{2 i \omega z / v} dz`. Gauss's rule is
    applied to panels between the requested depths, so that one sum gives all depths.
    """
    farthest = _farthest(survey, looks, depth)
    place, logarithm = _knots(survey, water, looks, farthest)
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


def _knots(
    survey: Survey, water: WaterProperties, looks: Looks, farthest: float
) -> tuple[Floats, Floats]:
    """Logarithms of knots and of the overlap there, with more of them at bends."""
    place = np.linspace(math.log(_NEAREST), math.log(farthest), _KNOTS)
    logarithm = _log_overlap(survey, water, looks, np.exp(place))
    bend = np.abs(np.diff(logarithm, 2, axis=1))
    lit = logarithm > logarithm.max(axis=1, keepdims=True) - _FAINT
    bent = np.where(lit[:, 1:-1] | lit[:, 2:], bend, 0.0).max(axis=0) > _BEND
    between = np.flatnonzero(np.append(bent, False) | np.append(False, bent))
    step = (place[1] - place[0]) / _FINER
    more = (place[between, None] + step * np.arange(1, _FINER)).ravel()
    if not more.size:
        return place, logarithm
    finer = _log_overlap(survey, water, looks, np.exp(more))
    place = np.append(place, more)
    order = np.argsort(place)
    return place[order], np.append(logarithm, finer, axis=1)[:, order]


def _log_overlap(
    survey: Survey, water: WaterProperties, looks: Looks, knots: Floats
) -> Floats:
    """Logarithm of the two-way overlap F at spline knots, shape (look, knot)."""
    overlap = (
        sharp_receiver.overlap if has_sharp_receiver(survey) else small_angle.overlap
    )
    value = overlap(knots, **_arguments(survey, water, looks))
    return np.asarray(np.log(np.maximum(value, math.exp(_DARK))))


def overlaps(
    survey: Survey, water: WaterProperties, looks: Looks, *, depth: Floats
) -> Floats:
    """Two-way overlap F of beam and receiver, by the small-angle model [sr]."""
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
    """Keyword arguments of the small-angle functions, for all views of the receiver."""
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
    """Depth at which the integral over the water column ends [m]."""
    least = float(np.min(looks.absorption + 0.1 * looks.scattering))
    faded = _FADED / (2 * least) if least > 0 else _FARTHEST
    reach = max(1.5 * float(depth[-1]), min(faded, _FARTHEST))
    end = survey.water.column_end
    # A target may be at the end of the water, or be evaluated behind it.
    return reach if end is None else max(min(reach, end), float(depth[-1]))


def _nodes(
    place: Floats,
    depth: Floats,
    farthest: float,
    rate: Floats,
    *,
    end: float | None,
) -> kernel.Nodes:
    """Quadrature nodes along the water column, with their phase factors."""
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


#: Number of distances per factor of two at which the delay is computed.
_PER_OCTAVE = 3
#: Up to it the delay hardly depends on the modulation; beyond, it is less [Hz].
_FREQUENCY = 50e6


def late_uncertainty(
    survey: Survey,
    water: WaterProperties,
    looks: Looks,
    places: list[Place],
    distance: Floats,
) -> Floats:
    """Return the standard uncertainty of the late-light correction [m].

    As in `amulor.imaging.late_light`, it combines a rectangular distribution between
    the delay of the phase function and half of it, and 5 % of the middle as model
    error. The delay over the squared distance is interpolated in the logarithm of the
    distance. The delay is that at 50 MHz, an upper limit for higher frequencies.
    """
    shape = (len(looks.absorption), len(distance))
    if water.scattering == 0 or water.forward_scattering * water.second_moment == 0:
        return np.zeros(shape)
    try:
        function = whole_phase_function(water)
    except SurveyError:
        return np.zeros(shape)
    if function.asymmetry < LEAST_ASYMMETRY:
        return np.zeros(shape)
    depth = np.maximum(distance - (distance[0] - float(places[0].depth[0])), 1e-3)
    count = 2 + math.ceil(_PER_OCTAVE * math.log2(depth[-1] / depth[0]))
    sampled = depth
    if len(depth) > count:
        sampled = np.geomspace(depth[0], depth[-1], count)
    # Where the receiver looks past the echo there is none to be late.
    with np.errstate(all="ignore"):
        delay = late_echo(
            _FREQUENCY,
            depth=sampled,
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
    even = np.nan_to_num(delay) / sampled**2
    if len(sampled) == 1:
        per_square = np.repeat(even, len(depth), axis=1)
    else:
        place = np.interp(
            np.log(depth), np.log(sampled), np.arange(len(sampled), dtype=float)
        )
        low = np.minimum(place.astype(int), len(sampled) - 2)
        part = place - low
        per_square = (1 - part) * even[:, low] + part * even[:, low + 1]
    calibration = survey.calibration
    scattering_error = (
        None if calibration is None else calibration.scattering_uncertainty
    )
    relative = (
        math.hypot(RELATIVE_UNCERTAINTY, scattering_error or 0.0) * (1 + LEAST_PART) / 2
    )
    spread = (1 - LEAST_PART) / math.sqrt(12)
    return np.asarray(math.hypot(relative, spread) * np.abs(per_square) * depth**2)


#: Assumed values where none are stated, for the water and its uncertainties.
ASSUMED = {
    "reflectance": 0.1,
    "slope": 0.0,
    "texture": 0.1,
    "water_change": 0.01,
    "column_uncertainty": 0.1,
    "ratio_uncertainty": 0.01,
    "departure": 0.003,
}
#: Relative change of absorption and scattering for derivatives [1].
_STEP = 1e-3


@dataclass(frozen=True, kw_only=True)
class Case:
    """Survey, its water properties, and its values on the axes of an evaluation."""

    survey: Survey
    """Survey: instrument, water and target."""
    water: WaterProperties
    """Optical properties of the water."""
    survey_values: dict[str, float]
    """Values of the survey on all axes except distance."""


@dataclass(frozen=True, kw_only=True)
class Lit:
    """Signals for all receiver views and distances, with the indices of candidates."""

    light: kernel.Light
    """Overlaps, water signals, optical paths and frequencies."""
    places: list[geometry.Place]
    """Distinct receiver positions."""
    look: NDArray[np.intp]
    """Row in `light` for each candidate, broadcastable."""
    reach: NDArray[np.intp]
    """Distance index of each candidate."""
    place: NDArray[np.intp]
    """Receiver-position index of each candidate."""
    late: Floats
    """Uncertainty of the late-light correction, shape (look, distance) [m]."""
    bent: Floats
    """Mean square scattering angle on the path, shape (look, distance) [rad^2]."""


def lit(
    case: Case,
    values: dict[str, Floats],
    frequencies: Floats,
    *,
    joint: bool,
    late: bool = True,
) -> Lit:
    """Compute signals per launched power, for any dwell time, channel and method."""
    by_axis = values_on_axes(case, values)
    distance, reach = np.unique(values["distance"], return_inverse=True)
    places, place = _places(case, values, distance)
    looks, look = _looks(case, by_axis, places, place)
    distinct = np.unique(frequencies[np.isfinite(frequencies)])
    light, bent = _light(case, looks, places, distinct, joint=joint)
    late_error = np.zeros(bent.shape)
    if late:
        late_error = late_uncertainty(case.survey, case.water, looks, places, distance)
    return Lit(
        light=light,
        places=places,
        look=look,
        reach=reach.reshape(values["distance"].shape).astype(np.intp),
        place=place,
        late=late_error,
        bent=bent,
    )


def values_on_axes(case: Case, values: dict[str, Floats]) -> dict[str, Floats]:
    """Values of all parameters; those of the survey for parameters that do not vary."""
    by_axis = {
        name: np.asarray(value) for name, value in case.survey_values.items()
    } | values
    if "attenuation" in values:
        share = case.water.scattering / case.water.attenuation
        by_axis["absorption"] = (1 - share) * values["attenuation"]
        by_axis["scattering"] = share * values["attenuation"]
    return by_axis


def case_of(survey: Survey, water: WaterProperties) -> Case:
    """Return a survey with its water properties and values on the evaluation axes."""
    instrument = survey.instrument
    receiver = np.asarray(instrument.receiver.position)
    survey_values = {
        **ASSUMED,
        "absorption": water.absorption,
        "scattering": water.scattering,
        "power": instrument.power,
        "modulation_depth": instrument.modulation_depth,
        "baseline": float(np.linalg.norm(receiver - instrument.emitter.position)),
        "aim": geometry.aim_of(survey),
        "radius": instrument.receiver.radius,
        "field_of_view": instrument.receiver.acceptance,
        "dwell": survey.scan.dwell,
        "speed": 0.0
        if survey.platform is None
        else course_speed(survey.platform.course),
        "phase_floor": instrument.lock_in.phase_floor,
        "dark_rate": instrument.detector.dark_rate,
        "fluctuation": survey.water.signal_fluctuation,
        "radiance": 0.0 if survey.daylight is None else survey.daylight.radiance,
    }
    if survey.targets:
        survey_values["reflectance"] = survey.targets[0].reflectance
    return Case(survey=survey, water=water, survey_values=survey_values)


def _places(
    case: Case, values: dict[str, Floats], distance: Floats
) -> tuple[list[geometry.Place], NDArray[np.intp]]:
    """Distinct receiver positions, and the index of each candidate's position."""
    if not {"baseline", "aim"} & set(values):
        place = geometry.place_of(case.survey, distance)
        return [place], np.zeros((), dtype=np.intp)
    baseline, aim = np.broadcast_arrays(
        values.get("baseline", np.asarray(case.survey_values["baseline"])),
        values.get("aim", np.asarray(case.survey_values["aim"])),
    )
    pairs, number = np.unique(
        np.stack([baseline.ravel(), aim.ravel()]), axis=1, return_inverse=True
    )
    places = [
        geometry.place_of(
            geometry.with_receiver(case.survey, baseline=b, aim=a), distance
        )
        for b, a in pairs.T
    ]
    return places, number.reshape(baseline.shape).astype(np.intp)


def _looks(
    case: Case,
    by_axis: dict[str, Floats],
    places: list[geometry.Place],
    place: NDArray[np.intp],
) -> tuple[Looks, NDArray[np.intp]]:
    """Distinct pairs of receiver view and water, and the pair index of candidates."""
    names = ("absorption", "scattering", "radius", "field_of_view")
    parts = np.broadcast_arrays(*(by_axis[name] for name in names), place)
    distinct, number = np.unique(
        np.stack([part.ravel() for part in parts]), axis=1, return_inverse=True
    )
    where = distinct[4].astype(int)

    def view_values(name: str) -> Floats:
        value = np.array([float(getattr(position.view, name)) for position in places])
        return np.asarray(value[where])

    narrower = np.array([position.per_acceptance for position in places])[where]
    looks = Looks(
        absorption=distinct[0],
        scattering=distinct[1],
        radius=distinct[2],
        acceptance=distinct[3] * narrower,
        back=np.stack([position.back for position in places])[where],
        **{n: view_values(n) for n in ("baseline", "tilt", "cross_tilt", "standoff")},
    )
    return looks, number.reshape(parts[0].shape).astype(np.intp)


def _light(
    case: Case,
    looks: Looks,
    places: list[geometry.Place],
    frequencies: Floats,
    *,
    joint: bool,
) -> tuple[kernel.Light, Floats]:
    """Signals for the compiled loops, and the mean square scattering angle [rad^2]."""
    depth = places[0].depth

    def light(**changed: Floats) -> Columns:
        fields = {**vars(looks), **changed}
        return columns(
            case.survey, case.water, Looks(**fields), depth=depth, frequency=frequencies
        )

    first = light()
    overlap = overlaps(case.survey, case.water, looks, depth=depth)
    versions = [first.water]
    if joint:
        factor = 1 + _STEP
        versions.append(light(absorption=looks.absorption * factor).water)
        # The strength is a separate parameter, so backscatter is unchanged.
        versions.append(light(scattering=looks.scattering * factor).water / factor)
    bent = case.water.second_moment * np.outer(looks.scattering, depth)
    return (
        kernel.Light(
            overlap=np.ascontiguousarray(overlap),
            mean=first.mean,
            water=np.stack(versions),
            step=_STEP,
            frequency=np.array(frequencies),
            path=np.stack([position.path for position in places]),
            slope=np.stack([position.slope for position in places]),
            offset=np.array(
                [float(position.view.optical_offset) for position in places]
            ),
        ),
        bent,
    )
