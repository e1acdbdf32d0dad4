"""From a survey and axes to what the compiled loops take, and through them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from amulor.design import geometry
from amulor.design._kernels import points as kernel
from amulor.design._kernels.assess import assess
from amulor.design.column import Columns, Looks, columns
from amulor.design.late import late_uncertainty
from amulor.errors import SurveyError
from amulor.optics import detection
from amulor.optics.polarization import mueller
from amulor.rejection.channels.names import PARTNERS
from amulor.survey import OpenWater, Survey, WaterProperties, counting
from amulor.survey.mueller import matrix

__all__ = ["METHODS", "Assessed", "Case", "Method", "assessed", "case_of"]

Floats = NDArray[np.float64]

Method = Literal["none", "frequency", "open-water", "unmix", "combined", "joint"]
#: Ways to take the water out, by the names of `amulor reject`.
METHODS: dict[str, int] = {
    "none": kernel.KEPT,
    "frequency": kernel.ONE_FREQUENCY,
    "open-water": kernel.OPEN_WATER,
    "unmix": kernel.UNMIX,
    "combined": kernel.COMBINED,
    "joint": kernel.JOINT,
}
#: Methods that subtract a reference, and that take two channels.
_WITH_SHOTS = ("frequency", "open-water", "combined", "joint")
_PAIRED = ("unmix", "combined")
#: Coefficients of the surface that is fitted to shots over a scan, and over one row.
_SURFACE, _ROW = 6, 3
#: What is assumed where nothing is stated: of the water, of what is known of it.
ASSUMED = {
    "reflectance": 0.1,
    "slope": 0.0,
    "texture": 0.1,
    "water_change": 0.01,
    "column_uncertainty": 0.1,
    "ratio_uncertainty": 0.01,
    "departure": 0.003,
}
#: Share of the dwell that the lock-in's time constant may have [1].
_LOCK_IN = 0.1
#: Relative change of absorption and scattering for derivatives [1].
_STEP = 1e-3


@dataclass(frozen=True, kw_only=True)
class Case:
    """A survey, its water, and the number that it states for each axis."""

    survey: Survey
    """Instrument, water and target."""
    water: WaterProperties
    """Its optical numbers."""
    stated: dict[str, float]
    """Axis to the survey's own value; distance is not among them."""


@dataclass(frozen=True, kw_only=True)
class Assessed:
    """Errors of candidates; arrays of one shape."""

    result: Floats
    """Columns of `points.RESULTS` along the last axis."""
    late: Floats
    """Uncertainty of the correction for late light [m]."""
    footprint: Floats
    """Error by uneven light on a slope [m]."""
    near: Floats
    """Nearest range that is possible [m]."""
    far: Floats
    """Farthest one, infinite where nothing but the phases says so [m]."""
    repetition: Floats
    """Range after which all phases repeat [m]."""
    bent: Floats
    """Mean square angle that scattering adds on the way [rad^2]."""
    volt: float
    """Output per rate of photoelectrons [V s]."""


def case_of(survey: Survey, water: WaterProperties) -> Case:
    """Return what a survey states for each axis.

    Parameters
    ----------
    survey : Survey
        The first of its targets counts.
    water : WaterProperties
        Of this survey.

    Returns
    -------
    Case
        With what is assumed where the survey says nothing.
    """
    instrument = survey.instrument
    receiver = np.asarray(instrument.receiver.position)
    stated = {
        **ASSUMED,
        "absorption": water.absorption,
        "scattering": water.scattering,
        "power": instrument.power,
        "modulation_depth": instrument.modulation_depth,
        "baseline": float(np.linalg.norm(receiver - instrument.emitter.position)),
        "aim": geometry.aim_of(survey, water),
        "radius": instrument.receiver.radius,
        "field_of_view": instrument.receiver.acceptance,
        "dwell": survey.scan.dwell,
        "phase_floor": instrument.lock_in.phase_floor,
        "dark_rate": instrument.detector.dark_rate,
        "fluctuation": survey.water.signal_fluctuation,
        "radiance": 0.0 if survey.daylight is None else survey.daylight.radiance,
    }
    if survey.targets:
        stated["reflectance"] = survey.targets[0].reflectance
    return Case(survey=survey, water=water, stated=stated)


def assessed(
    case: Case,
    values: dict[str, Floats],
    *,
    frequencies: Floats,
    method: str,
    pairs: tuple[str, ...],
    interval: tuple[float, float] | None,
    late: bool = True,
) -> Assessed:
    """Return the errors of candidates, all of them in one compiled loop.

    Parameters
    ----------
    case : Case
        Survey and what it states.
    values : dict of str to ndarray
        Axis to values that can be broadcast; `distance` is among them.
    frequencies : ndarray, shape (K, ...)
        Sets of frequencies, NaN where a set has fewer [Hz].
    method : str
        Of `METHODS`.
    pairs : tuple of str
        Channels, a co-polarized one and its partner for methods that unmix.
    interval : tuple of float, optional
        Nearest and farthest range that are possible [m]; from 0 to where the phases
        repeat by default.
    late : bool
        Whether light that scatters on its way comes later.

    Returns
    -------
    Assessed
        Arrays of the broadcast shape.

    Raises
    ------
    SurveyError
        If the channels do not fit the method, or the receiver looks past the beam.
    """
    pairs = _ordered(method, pairs)
    given = {name: np.asarray(each) for name, each in case.stated.items()} | values
    if "attenuation" in values:
        share = case.water.scattering / case.water.attenuation
        given["absorption"] = (1 - share) * values["attenuation"]
        given["scattering"] = share * values["attenuation"]
    shape = np.broadcast_shapes(
        frequencies.shape[1:], *(each.shape for each in values.values())
    )
    count = int(np.prod(shape))

    def flat(array: Any) -> NDArray[Any]:
        # Memory of its own: read-only views would be compiled for once more.
        return np.array(np.broadcast_to(array, shape), order="C").reshape(-1)

    distance, reach = np.unique(values["distance"], return_inverse=True)
    reach = reach.reshape(values["distance"].shape)
    places, place = _places(case, values, distance)
    looks, look = _looks(case, given, places, place)
    tone, tones = _tones(frequencies)
    light, bent = _light(case, looks, places, distance, tones, joint=method == "joint")
    flat_tone = np.ascontiguousarray(np.stack([flat(one) for one in tone], axis=1))
    repetition = _repetition(frequencies, case.water.group_index)
    near, far = (0.0, repetition) if interval is None else interval
    late_error = (
        late_uncertainty(case.survey, case.water, looks, places, distance, tones)
        if late
        else np.zeros((len(looks.absorption), len(distance)))
    )
    reached = np.broadcast_arrays(look, reach)
    footprint = _footprint(case, given, values["distance"])
    number = np.empty((count, len(kernel.NUMBERS)))
    own = _numbers(case, given, places, place, reach)
    own |= {
        "near": near,
        "far": far,
        "distance": values["distance"],
        "late": late_error[reached[0], reached[1]],
        "footprint": footprint,
    }
    for column, name in enumerate(kernel.NUMBERS):
        number[:, column] = flat(own[name])
    points = kernel.Points(
        number=number,
        look=flat(look),
        reach=flat(reach),
        place=flat(place),
        tone=flat_tone,
        target_fraction=_fractions(case, given, pairs, "target", flat),
        water_fraction=_fractions(case, given, pairs, "water", flat),
        has_analyser=np.array([pair != "none" for pair in pairs]),
    )
    result = np.empty((count, len(kernel.RESULTS)))
    scratch = _scratch(flat_tone.shape[1], len(pairs))
    assess(METHODS[method], points, light, scratch, result)
    return Assessed(
        result=result.reshape(*shape, -1),
        late=flat(own["late"]).reshape(shape),
        footprint=flat(footprint).reshape(shape),
        near=flat(near).reshape(shape),
        far=flat(np.inf if interval is None else far).reshape(shape),
        repetition=flat(repetition).reshape(shape),
        bent=flat(bent[reached[0], reached[1]]).reshape(shape),
        volt=case.survey.instrument.detector.volt_per_photoelectron_rate,
    )


def _ordered(method: str, pairs: tuple[str, ...]) -> tuple[str, ...]:
    """Return channels in the order that a method takes them in."""
    if method not in METHODS:
        raise SurveyError(
            f"method: found {method!r}, but it must be one of {', '.join(METHODS)}"
        )
    if method not in _PAIRED:
        return pairs
    for co, cross in PARTNERS.items():
        if co in pairs and cross in pairs:
            return co, cross
    raise SurveyError(
        f"method {method}: needs a co-polarized channel and its partner, such as VV "
        f"and VH, found {', '.join(pairs)}"
    )


def _tones(frequencies: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Return the number of each frequency, -1 where there is none, and all of them."""
    there = np.isfinite(frequencies)
    every = np.unique(frequencies[there])
    number = np.searchsorted(every, np.where(there, frequencies, every[0]))
    return np.where(there, number, -1).astype(np.intp), every


def _places(
    case: Case, values: dict[str, Floats], distance: Floats
) -> tuple[list[geometry.Place], NDArray[np.intp]]:
    """Return the places of receivers, and which one each candidate has."""
    if not {"baseline", "aim"} & set(values):
        one = geometry.place_of(case.survey, case.water, distance)
        return [one], np.zeros((), dtype=np.intp)
    baseline, aim = np.broadcast_arrays(
        values.get("baseline", np.asarray(case.stated["baseline"])),
        values.get("aim", np.asarray(case.stated["aim"])),
    )
    each, number = np.unique(
        np.stack([baseline.ravel(), aim.ravel()]), axis=1, return_inverse=True
    )
    places = [
        geometry.place_of(
            geometry.with_receiver(case.survey, case.water, baseline=b, aim=a),
            case.water,
            distance,
        )
        for b, a in each.T
    ]
    return places, number.reshape(baseline.shape).astype(np.intp)


def _looks(
    case: Case,
    given: dict[str, Floats],
    places: list[geometry.Place],
    place: NDArray[np.intp],
) -> tuple[Looks, NDArray[np.intp]]:
    """Return all different looks through waters, and which one each candidate has."""
    names = ("absorption", "scattering", "radius", "field_of_view")
    parts = np.broadcast_arrays(*(given[name] for name in names), place)
    each, number = np.unique(
        np.stack([part.ravel() for part in parts]), axis=1, return_inverse=True
    )
    where = each[4].astype(int)

    def seen(name: str) -> Floats:
        value = np.array([float(getattr(one.view, name)) for one in places])
        return np.asarray(value[where])

    narrower = np.array([one.per_acceptance for one in places])[where]
    looks = Looks(
        absorption=each[0],
        scattering=each[1],
        radius=each[2],
        acceptance=each[3] * narrower,
        **{n: seen(n) for n in ("baseline", "tilt", "cross_tilt", "standoff")},
    )
    return looks, number.reshape(parts[0].shape).astype(np.intp)


def _light(
    case: Case,
    looks: Looks,
    places: list[geometry.Place],
    distance: Floats,
    tones: Floats,
    *,
    joint: bool,
) -> tuple[kernel.Light, Floats]:
    """Return light as the loops take it, and the mean square angle of the way."""
    before = distance[0] - float(places[0].depth[0])
    depth = distance - before
    if depth[0] <= 0:
        raise SurveyError(
            f"distance: {distance[0]:g} m lies before the water, which begins at "
            f"{before:g} m"
        )

    def light(**changed: Floats) -> Columns:
        fields = {**vars(looks), **changed}
        return columns(
            case.survey, case.water, Looks(**fields), depth=depth, frequency=tones
        )

    first = light()
    versions = [first.water]
    if joint:
        factor = 1 + _STEP
        versions.append(light(absorption=looks.absorption * factor).water)
        # The strength is a parameter of its own, so backscatter is kept as it is.
        versions.append(light(scattering=looks.scattering * factor).water / factor)
    bent = case.water.second_moment * np.outer(looks.scattering, depth)
    return (
        kernel.Light(
            overlap=np.ascontiguousarray(first.overlap),
            mean=first.mean,
            water=np.stack(versions),
            step=_STEP,
            frequency=np.array(tones),
            path=np.stack([one.path for one in places]),
            slope=np.stack([one.slope for one in places]),
            offset=np.array([float(one.view.optical_offset) for one in places]),
        ),
        bent,
    )


def _repetition(frequencies: Floats, group_index: float) -> Floats:
    """Return the range after which the phases of each set repeat [m]."""
    smallest = np.nanmin(frequencies, axis=0)
    if len(frequencies) > 1:
        apart = np.diff(np.sort(frequencies, axis=0), axis=0)
        smallest = np.fmin(smallest, np.nanmin(np.where(apart > 0, apart, np.inf), 0))
    return np.asarray(299792458.0 / (2 * group_index * smallest))


def _footprint(case: Case, given: dict[str, Floats], distance: Floats) -> Floats:
    """Return the error by uneven reflectance of the lit spot on a slope [m]."""
    emitter = case.survey.instrument.emitter
    width = np.hypot(
        emitter.beam_radius or 0.0, (emitter.beam_divergence or 0.0) * distance
    )
    return np.asarray(given["texture"] * width * np.tan(given["slope"]) / 2)


def _numbers(
    case: Case,
    given: dict[str, Floats],
    places: list[geometry.Place],
    place: NDArray[np.intp],
    reach: NDArray[np.intp],
) -> dict[str, Any]:
    """Return the columns of `points.NUMBERS` that a survey and its axes state."""
    survey = case.survey
    instrument, detector = survey.instrument, survey.instrument.detector
    constant = np.minimum(instrument.lock_in.time_constant, _LOCK_IN * given["dwell"])
    time = detection.settled_integration_time(given["dwell"], time_constant=constant)
    passed = np.array([float(one.view.transmission) for one in places])[place]
    cosine = np.stack([one.cosine for one in places])[
        tuple(np.broadcast_arrays(place, reach))
    ]
    slanted = cosine * np.cos(given["slope"])
    plan = survey.scan.open_water or OpenWater()
    row = survey.scan.rows == 1 or survey.scan.elevation_span == 0
    shots = plan.columns * plan.rows * plan.repeats
    own = {
        "rate": counting.full_rate(survey) * given["power"] / instrument.power,
        "shot": 2 * detector.excess_noise_factor / time,
        "dark": given["dark_rate"],
        "sky": _sky(case, given),
        "echo": given["reflectance"] / math.pi * slanted * passed,
        "passed": passed,
        "reference": min(_ROW if row else _SURFACE, shots) / shots,
        "shots": float(shots),
        "pixels": float(survey.scan.rows * survey.scan.columns),
        "per_saturation": detector.volt_per_photoelectron_rate / detector.saturation,
        "depth": given["modulation_depth"],
    }
    kept = ("phase_floor", "fluctuation", "water_change", "column_uncertainty")
    return own | {
        name: given[name] for name in (*kept, "ratio_uncertainty", "departure")
    }


def _sky(case: Case, given: dict[str, Floats]) -> Floats | float:
    """Return photoelectrons by daylight without an analyser [1/s]."""
    survey = case.survey
    if survey.daylight is None:
        if np.any(given["radiance"] > 0):
            raise SurveyError(
                "radiance: daylight needs the bandwidth of the filter; state "
                "[daylight] in the survey"
            )
        return 0.0
    plain = survey.instrument.model_copy(update={"polarizations": ("none",)})
    light = survey.daylight.model_copy(update={"radiance": 1.0})
    rate = counting.background_rate(
        survey.model_copy(update={"instrument": plain, "daylight": light})
    )[0]
    receiver = survey.instrument.receiver
    taken = given["radius"] * given["field_of_view"]
    share = (taken / (receiver.radius * receiver.acceptance)) ** 2
    return np.asarray(rate * given["radiance"] * share)


def _fractions(
    case: Case, given: dict[str, Floats], pairs: tuple[str, ...], what: str, flat: Any
) -> Floats:
    """Return what each analyser passes of target or water, (point, channel)."""
    if what == "target":
        stated: Any = "painted-metal"
        if case.survey.targets:
            stated = case.survey.targets[0].mueller
    else:
        stated = case.survey.water.backscatter_mueller
    known = matrix(stated)
    name = f"{what}_m22"
    if name not in given:
        each = [float(mueller.detected_fraction(known, pair=pair)) for pair in pairs]
        return np.stack([flat(value) for value in each], axis=1)
    # The other elements change in proportion, as more or less of it is depolarized.
    factor = given[name] / known[1, 1] if known[1, 1] else np.ones(1)
    bare = np.zeros((4, 4))
    bare[0, 0] = 1.0
    parts = []
    for pair in pairs:
        lost = float(mueller.detected_fraction(bare, pair=pair))
        kept = float(mueller.detected_fraction(known, pair=pair)) - lost
        parts.append(flat(lost + factor * kept))
    return np.stack(parts, axis=1)


def _scratch(tones: int, channels: int) -> kernel.Scratch:
    """Return memory for one point."""
    both = (tones, channels)
    return kernel.Scratch(
        target=np.zeros(both, dtype=complex),
        water=np.zeros(both, dtype=complex),
        open_water=np.zeros(both, dtype=complex),
        change=np.zeros((*both, 4), dtype=complex),
        laser_rate=np.zeros(channels),
        sky_rate=np.zeros(channels),
        open_rate=np.zeros(channels),
        to_range=np.zeros(tones),
        variance=np.zeros((tones, len(kernel.RANDOM))),
        bias=np.zeros((tones, len(kernel.SYSTEMATIC))),
        size=np.zeros(tones),
    )
