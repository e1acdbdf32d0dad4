"""Predicted errors of candidates, from the arrays of the compiled loops."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.cube.readings import LEAST_RATE
from amulor.design import _kernels as kernel
from amulor.design._kernels import assess
from amulor.design.axes import LOCK_IN_SHARE, PREDICTED
from amulor.design.light import Case, Lit, lit, values_on_axes
from amulor.errors import SurveyError
from amulor.optics import detection
from amulor.optics.polarization import mueller
from amulor.rejection.channels import PARTNERS
from amulor.survey import OpenWater, Survey, counting
from amulor.survey.course import range_rate
from amulor.survey.mueller import matrix

__all__ = ["MOST_BENT", "Assessed", "assessed"]

Floats = NDArray[np.float64]

#: Coefficients of the surface that is fitted to shots over a scan, and over one row.
_SURFACE, _ROW = 6, 3
#: Mean square angle of scattering up to which small angles describe it [rad^2].
MOST_BENT = 0.5


@dataclass(frozen=True, kw_only=True)
class Assessed:
    """Predicted errors of candidates, as arrays of one shape."""

    result: Floats
    """Errors of the compiled loops, columns of `RESULTS` along the last axis."""
    late: Floats
    """Uncertainty of the late-light correction [m]."""
    footprint: Floats
    """Error from uneven reflectance within the laser spot on a slope [m]."""
    near: Floats
    """Nearest possible slant range [m]."""
    far: Floats
    """Farthest possible slant range, infinite if not stated [m]."""
    repetition: Floats
    """Unambiguous range, after which all phases repeat [m]."""
    bent: Floats
    """Mean square scattering angle on the path [rad^2]."""
    volt: float
    """Detector output per photoelectron rate [V s]."""


def assessed(
    case: Case,
    values: dict[str, Floats],
    *,
    frequencies: Floats,
    method: str,
    pairs: tuple[str, ...],
    interval: tuple[float, float] | None,
    late: bool = True,
    lighting: Lit | None = None,
) -> Assessed:
    """Compute the errors of all candidates in one compiled loop."""
    pairs = _ordered(method, pairs)
    by_axis = values_on_axes(case, values)
    shape = np.broadcast_shapes(
        frequencies.shape[1:], *(value.shape for value in values.values())
    )
    count = int(np.prod(shape))
    if lighting is None:
        lighting = lit(case, values, frequencies, joint=method == "joint", late=late)

    def flat(array: Any) -> NDArray[Any]:
        # Copies, as read-only views would need another compilation.
        return np.array(np.broadcast_to(array, shape), order="C").reshape(-1)

    present = np.isfinite(frequencies)
    lit_frequencies = lighting.light.frequency
    index = np.searchsorted(
        lit_frequencies, np.where(present, frequencies, lit_frequencies[0])
    )
    index = np.where(present, index, -1).astype(np.intp)
    flat_index = np.ascontiguousarray(
        np.stack([flat(column) for column in index], axis=1)
    )
    repetition = _repetition(frequencies, case.water.group_index)
    near, far = (0.0, repetition) if interval is None else interval
    reached = tuple(np.broadcast_arrays(lighting.look, lighting.reach))
    footprint = _footprint(case, by_axis, values["distance"])
    columns = _numbers(case, by_axis, lighting) | {
        "near": near,
        "far": far,
        "distance": values["distance"],
        "late": lighting.late[reached],
        "footprint": footprint,
    }
    number = np.empty((count, len(kernel.NUMBERS)))
    for column, name in enumerate(kernel.NUMBERS):
        number[:, column] = flat(columns[name])
    points = kernel.Points(
        number=number,
        look=flat(lighting.look),
        reach=flat(lighting.reach),
        place=flat(lighting.place),
        frequency_index=flat_index,
        target_fraction=_fractions(case, by_axis, pairs, "target", flat),
        water_fraction=_fractions(case, by_axis, pairs, "water", flat),
        has_analyser=np.array([pair != "none" for pair in pairs]),
    )
    result = np.empty((count, len(kernel.RESULTS)))
    scratch = _scratch(flat_index.shape[1], len(pairs))
    assess(PREDICTED[method].kernel, points, lighting.light, scratch, result)
    return Assessed(
        result=result.reshape(*shape, -1),
        late=flat(columns["late"]).reshape(shape),
        footprint=flat(footprint).reshape(shape),
        near=flat(near).reshape(shape),
        far=flat(np.inf if interval is None else far).reshape(shape),
        repetition=flat(repetition).reshape(shape),
        bent=flat(lighting.bent[reached]).reshape(shape),
        volt=case.survey.instrument.detector.volt_per_photoelectron_rate,
    )


def _ordered(method: str, pairs: tuple[str, ...]) -> tuple[str, ...]:
    """Return the channel pair that a rejection method needs, else all channels."""
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
    """Ambiguity interval of a set's smallest frequency or frequency difference [m]."""
    smallest = np.nanmin(frequencies, axis=0)
    if len(frequencies) > 1:
        apart = np.diff(np.sort(frequencies, axis=0), axis=0)
        smallest = np.fmin(smallest, np.nanmin(np.where(apart > 0, apart, np.inf), 0))
    return np.asarray(299792458.0 / (2 * group_index * smallest))


def _footprint(case: Case, by_axis: dict[str, Floats], distance: Floats) -> Floats:
    """Range error from uneven reflectance in the spot on an inclined surface [m]."""
    emitter = case.survey.instrument.emitter
    width = np.hypot(
        emitter.beam_radius or 0.0, (emitter.beam_divergence or 0.0) * distance
    )
    return np.asarray(by_axis["texture"] * width * np.tan(by_axis["slope"]) / 2)


def _numbers(case: Case, by_axis: dict[str, Floats], lighting: Lit) -> dict[str, Any]:
    """Parameters of each point for the compiled loops, by column name."""
    survey = case.survey
    instrument, detector = survey.instrument, survey.instrument.detector
    constant = np.minimum(
        instrument.lock_in.time_constant, LOCK_IN_SHARE * by_axis["dwell"]
    )
    time = detection.settled_integration_time(by_axis["dwell"], time_constant=constant)
    passed = np.array(
        [float(position.view.transmission) for position in lighting.places]
    )[lighting.place]
    cosine = np.stack([position.cosine for position in lighting.places])[
        tuple(np.broadcast_arrays(lighting.place, lighting.reach))
    ]
    slanted = cosine * np.cos(by_axis["slope"])
    plan = survey.scan.open_water or OpenWater()
    row = survey.scan.rows == 1 or survey.scan.elevation_span == 0
    shots = plan.columns * plan.rows * plan.repeats
    columns = {
        "rate": counting.full_rate(survey) * by_axis["power"] / instrument.power,
        "shot": 2 * detector.excess_noise_factor / time,
        "dark": by_axis["dark_rate"],
        "sky": _sky(case, by_axis),
        "echo": by_axis["reflectance"] / math.pi * slanted * passed,
        "passed": passed,
        "reference": min(_ROW if row else _SURFACE, shots) / shots,
        "shots": float(shots),
        "pixels": float(survey.scan.rows * survey.scan.columns),
        "per_saturation": detector.volt_per_photoelectron_rate / detector.saturation,
        "depth": by_axis["modulation_depth"],
        "motion": _motion(survey, by_axis),
    }
    copied = ("phase_floor", "fluctuation", "water_change", "column_uncertainty")
    return columns | {
        name: by_axis[name] for name in (*copied, "ratio_uncertainty", "departure")
    }


def _motion(survey: Survey, by_axis: dict[str, Floats]) -> Floats | float:
    """Change of the range from one frequency to the next, by an unknown rate [m]."""
    if survey.platform is None:
        if np.any(by_axis["speed"] > 0):
            raise SurveyError(
                "speed: the survey states no vehicle; state its course in [platform]"
            )
        return 0.0
    if survey.platform.readings == "at-once":
        return 0.0
    rate, _ = range_rate(survey.platform, by_axis["speed"])
    return np.maximum(rate, LEAST_RATE) * by_axis["dwell"]


def _sky(case: Case, by_axis: dict[str, Floats]) -> Floats | float:
    """Photoelectron rate of daylight in the detector, without an analyzer [1/s]."""
    survey = case.survey
    if survey.daylight is None:
        if np.any(by_axis["radiance"] > 0):
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
    etendue = by_axis["radius"] * by_axis["field_of_view"]
    share = (etendue / (receiver.radius * receiver.acceptance)) ** 2
    return np.asarray(rate * by_axis["radiance"] * share)


def _fractions(
    case: Case,
    by_axis: dict[str, Floats],
    pairs: tuple[str, ...],
    surface: str,
    flat: Any,
) -> Floats:
    """Fraction of target or water light that each analyzer passes, (point, channel)."""
    if surface == "target":
        description: Any = "painted-metal"
        if case.survey.targets:
            description = case.survey.targets[0].mueller
    else:
        description = case.water.backscatter_mueller
    reduced = matrix(description)
    name = f"{surface}_m22"
    if name not in by_axis:
        fractions = [
            float(mueller.detected_fraction(reduced, pair=pair)) for pair in pairs
        ]
        return np.stack([flat(value) for value in fractions], axis=1)
    # The other elements change in proportion, as more or less of it is depolarized.
    if reduced[1, 1] == 0:
        reduced = np.diag([1.0, 1.0, -1.0, -1.0])
    factor = by_axis[name] / reduced[1, 1]
    bare = np.zeros((4, 4))
    bare[0, 0] = 1.0
    parts = []
    for pair in pairs:
        lost = float(mueller.detected_fraction(bare, pair=pair))
        polarized = float(mueller.detected_fraction(reduced, pair=pair)) - lost
        parts.append(flat(lost + factor * polarized))
    return np.stack(parts, axis=1)


def _scratch(frequency_count: int, channels: int) -> kernel.Scratch:
    """Allocate the work arrays for one point."""
    shape = (frequency_count, channels)
    return kernel.Scratch(
        target=np.zeros(shape, dtype=complex),
        water=np.zeros(shape, dtype=complex),
        open_water=np.zeros(shape, dtype=complex),
        change=np.zeros((*shape, 4), dtype=complex),
        laser_rate=np.zeros(channels),
        sky_rate=np.zeros(channels),
        open_rate=np.zeros(channels),
        to_range=np.zeros(frequency_count),
        variance=np.zeros((frequency_count, len(kernel.RANDOM))),
        bias=np.zeros((frequency_count, len(kernel.SYSTEMATIC))),
        size=np.zeros(frequency_count),
    )
