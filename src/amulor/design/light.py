"""The light of many instruments in many waters, and which candidate has which."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.design import geometry
from amulor.design._kernels import points as kernel
from amulor.design.column import Columns, Looks, columns, late_uncertainty, overlaps
from amulor.errors import SurveyError
from amulor.survey import Survey, WaterProperties

__all__ = ["Case", "Lit", "case_of", "given_of", "lit"]

Floats = NDArray[np.float64]

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
class Lit:
    """Light of all looks at all distances, and which of it each candidate has."""

    light: kernel.Light
    """Light, geometry and frequencies."""
    places: list[geometry.Place]
    """Where receivers stand."""
    look: NDArray[np.intp]
    """Row of the light; can be broadcast with the candidates."""
    reach: NDArray[np.intp]
    """Number of the distance."""
    place: NDArray[np.intp]
    """Number of the place."""
    late: Floats
    """Uncertainty of the correction for late light, (look, distance) [m]."""
    bent: Floats
    """Mean square angle that scattering adds, (look, distance) [rad^2]."""


def lit(
    case: Case,
    values: dict[str, Floats],
    frequencies: Floats,
    *,
    joint: bool,
    late: bool = True,
) -> Lit:
    """Return the light that does not depend on power, time, channels and method."""
    given = given_of(case, values)
    distance, reach = np.unique(values["distance"], return_inverse=True)
    places, place = _places(case, values, distance)
    looks, look = _looks(case, given, places, place)
    distinct = np.unique(frequencies[np.isfinite(frequencies)])
    light, bent = _light(case, looks, places, distance, distinct, joint=joint)
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


def given_of(case: Case, values: dict[str, Floats]) -> dict[str, Floats]:
    """Return all axes, those that do not vary as the survey states them."""
    given = {name: np.asarray(each) for name, each in case.stated.items()} | values
    if "attenuation" in values:
        share = case.water.scattering / case.water.attenuation
        given["absorption"] = (1 - share) * values["attenuation"]
        given["scattering"] = share * values["attenuation"]
    return given


def case_of(survey: Survey, water: WaterProperties) -> Case:
    """Return what a survey states for each axis."""
    instrument = survey.instrument
    receiver = np.asarray(instrument.receiver.position)
    stated = {
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
        "phase_floor": instrument.lock_in.phase_floor,
        "dark_rate": instrument.detector.dark_rate,
        "fluctuation": survey.water.signal_fluctuation,
        "radiance": 0.0 if survey.daylight is None else survey.daylight.radiance,
    }
    if survey.targets:
        stated["reflectance"] = survey.targets[0].reflectance
    return Case(survey=survey, water=water, stated=stated)


def _places(
    case: Case, values: dict[str, Floats], distance: Floats
) -> tuple[list[geometry.Place], NDArray[np.intp]]:
    """Return the places of receivers, and which one each candidate has."""
    if not {"baseline", "aim"} & set(values):
        one = geometry.place_of(case.survey, distance)
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
            geometry.with_receiver(case.survey, baseline=b, aim=a), distance
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
        back=np.stack([one.back for one in places])[where],
        **{n: seen(n) for n in ("baseline", "tilt", "cross_tilt", "standoff")},
    )
    return looks, number.reshape(parts[0].shape).astype(np.intp)


def _light(
    case: Case,
    looks: Looks,
    places: list[geometry.Place],
    distance: Floats,
    frequencies: Floats,
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
            case.survey, case.water, Looks(**fields), depth=depth, frequency=frequencies
        )

    first = light()
    overlap = overlaps(case.survey, case.water, looks, depth=depth)
    versions = [first.water]
    if joint:
        factor = 1 + _STEP
        versions.append(light(absorption=looks.absorption * factor).water)
        # The strength is a parameter of its own, so backscatter is kept as it is.
        versions.append(light(scattering=looks.scattering * factor).water / factor)
    bent = case.water.second_moment * np.outer(looks.scattering, depth)
    return (
        kernel.Light(
            overlap=np.ascontiguousarray(overlap),
            mean=first.mean,
            water=np.stack(versions),
            step=_STEP,
            frequency=np.array(frequencies),
            path=np.stack([one.path for one in places]),
            slope=np.stack([one.slope for one in places]),
            offset=np.array([float(one.view.optical_offset) for one in places]),
        ),
        bent,
    )
