"""From a survey and axes to what the compiled loops take, and through them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.design._kernels import points as kernel
from amulor.design._kernels.assess import assess
from amulor.design.light import Case, Lit, given_of, lit
from amulor.design.methods import PREDICTED
from amulor.errors import SurveyError
from amulor.optics import detection
from amulor.optics.polarization import mueller
from amulor.rejection.channels import PARTNERS
from amulor.survey import OpenWater, counting
from amulor.survey.mueller import matrix

__all__ = ["MOST_BENT", "Assessed", "assessed"]

Floats = NDArray[np.float64]

#: Coefficients of the surface that is fitted to shots over a scan, and over one row.
_SURFACE, _ROW = 6, 3
#: Mean square angle of scattering up to which small angles describe it [rad^2].
MOST_BENT = 0.5
#: Share of the dwell that the lock-in's time constant may have [1].
_LOCK_IN = 0.1


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


def assessed(
    case: Case,
    values: dict[str, Floats],
    *,
    frequencies: Floats,
    method: str,
    pairs: tuple[str, ...],
    interval: tuple[float, float] | None,
    late: bool = True,
    known: Lit | None = None,
) -> Assessed:
    """Return the errors of candidates, all of them in one compiled loop."""
    pairs = _ordered(method, pairs)
    given = given_of(case, values)
    shape = np.broadcast_shapes(
        frequencies.shape[1:], *(each.shape for each in values.values())
    )
    count = int(np.prod(shape))
    if known is None:
        known = lit(case, values, frequencies, joint=method == "joint", late=late)

    def flat(array: Any) -> NDArray[Any]:
        # Memory of its own: read-only views would be compiled for once more.
        return np.array(np.broadcast_to(array, shape), order="C").reshape(-1)

    there = np.isfinite(frequencies)
    lit_frequencies = known.light.frequency
    index = np.searchsorted(
        lit_frequencies, np.where(there, frequencies, lit_frequencies[0])
    )
    index = np.where(there, index, -1).astype(np.intp)
    flat_index = np.ascontiguousarray(np.stack([flat(one) for one in index], axis=1))
    repetition = _repetition(frequencies, case.water.group_index)
    near, far = (0.0, repetition) if interval is None else interval
    reached = tuple(np.broadcast_arrays(known.look, known.reach))
    footprint = _footprint(case, given, values["distance"])
    own = _numbers(case, given, known) | {
        "near": near,
        "far": far,
        "distance": values["distance"],
        "late": known.late[reached],
        "footprint": footprint,
    }
    number = np.empty((count, len(kernel.NUMBERS)))
    for column, name in enumerate(kernel.NUMBERS):
        number[:, column] = flat(own[name])
    points = kernel.Points(
        number=number,
        look=flat(known.look),
        reach=flat(known.reach),
        place=flat(known.place),
        frequency_index=flat_index,
        target_fraction=_fractions(case, given, pairs, "target", flat),
        water_fraction=_fractions(case, given, pairs, "water", flat),
        has_analyser=np.array([pair != "none" for pair in pairs]),
    )
    result = np.empty((count, len(kernel.RESULTS)))
    scratch = _scratch(flat_index.shape[1], len(pairs))
    assess(PREDICTED[method].kernel, points, known.light, scratch, result)
    return Assessed(
        result=result.reshape(*shape, -1),
        late=flat(own["late"]).reshape(shape),
        footprint=flat(footprint).reshape(shape),
        near=flat(near).reshape(shape),
        far=flat(np.inf if interval is None else far).reshape(shape),
        repetition=flat(repetition).reshape(shape),
        bent=flat(known.bent[reached]).reshape(shape),
        volt=case.survey.instrument.detector.volt_per_photoelectron_rate,
    )


def _ordered(method: str, pairs: tuple[str, ...]) -> tuple[str, ...]:
    """Return channels in the order that a method takes them in."""
    if method not in PREDICTED:
        raise SurveyError(
            f"method: found {method!r}, but it must be one of {', '.join(PREDICTED)}"
        )
    if not PREDICTED[method].channel_pair:
        return pairs
    for co, cross in PARTNERS.items():
        if co in pairs and cross in pairs:
            return co, cross
    raise SurveyError(
        f"method {method}: needs a co-polarized channel and its partner, such as VV "
        f"and VH, found {', '.join(pairs)}"
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


def _numbers(case: Case, given: dict[str, Floats], known: Lit) -> dict[str, Any]:
    """Return the columns of `points.NUMBERS` that a survey and its axes state."""
    survey = case.survey
    instrument, detector = survey.instrument, survey.instrument.detector
    constant = np.minimum(instrument.lock_in.time_constant, _LOCK_IN * given["dwell"])
    time = detection.settled_integration_time(given["dwell"], time_constant=constant)
    passed = np.array([float(one.view.transmission) for one in known.places])[
        known.place
    ]
    cosine = np.stack([one.cosine for one in known.places])[
        tuple(np.broadcast_arrays(known.place, known.reach))
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
        stated = case.water.backscatter_mueller
    known = matrix(stated)
    name = f"{what}_m22"
    if name not in given:
        each = [float(mueller.detected_fraction(known, pair=pair)) for pair in pairs]
        return np.stack([flat(value) for value in each], axis=1)
    # The other elements change in proportion, as more or less of it is depolarized.
    if known[1, 1] == 0:
        known = np.diag([1.0, 1.0, -1.0, -1.0])
    factor = given[name] / known[1, 1]
    bare = np.zeros((4, 4))
    bare[0, 0] = 1.0
    parts = []
    for pair in pairs:
        lost = float(mueller.detected_fraction(bare, pair=pair))
        kept = float(mueller.detected_fraction(known, pair=pair)) - lost
        parts.append(flat(lost + factor * kept))
    return np.stack(parts, axis=1)


def _scratch(frequency_count: int, channels: int) -> kernel.Scratch:
    """Return memory for one point."""
    both = (frequency_count, channels)
    return kernel.Scratch(
        target=np.zeros(both, dtype=complex),
        water=np.zeros(both, dtype=complex),
        open_water=np.zeros(both, dtype=complex),
        change=np.zeros((*both, 4), dtype=complex),
        laser_rate=np.zeros(channels),
        sky_rate=np.zeros(channels),
        open_rate=np.zeros(channels),
        to_range=np.zeros(frequency_count),
        variance=np.zeros((frequency_count, len(kernel.RANDOM))),
        bias=np.zeros((frequency_count, len(kernel.SYSTEMATIC))),
        size=np.zeros(frequency_count),
    )
