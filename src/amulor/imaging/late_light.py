"""Delay of echoes due to forward-scattered light, and its uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from amulor.cube.tiles import Span, span_of
from amulor.errors import SurveyError
from amulor.imaging.observation import Observation
from amulor.optics import late_echo, ranging
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.survey import Survey, WaterProperties, water_properties
from amulor.survey.late_light import (
    DISPERSION_UNCERTAINTY,
    LEAST_ASYMMETRY,
    LEAST_PART,
    late_echo_delay,
    states_asymmetry_only,
)
from amulor.survey.view import view
from amulor.survey.waters.whole_function import asymmetry_of

Floats = NDArray[np.float64]

#: Directions along each side of the scan, and distances, that are worked out.
_DIRECTIONS, _DISTANCES = 5, 16
#: Asymmetries of the Henyey-Greenstein functions that are as late as those waters [1].
_ASYMMETRIES = (0.90, 0.98)
#: Above this asymmetry no Henyey-Greenstein function is taken [1].
_LARGEST_ASYMMETRY = 0.999
#: Relative uncertainty of the delay of a difference between spots, which may be glossy.
#: Mirrored light has 0.31 of the delay in photon transport (benchmark scene) [1].
_OF_SPOTS = 0.4


@dataclass(frozen=True, kw_only=True)
class LateFit:
    """Scan-wide statistics for the estimate of late light."""

    depth: tuple[float, float] | None = None
    """Least and largest target distance [m]; None without a pixel with a range."""
    span: Span | None = None
    """Range of scan directions; None without a pixel with a range."""
    in_view: bool = True
    """Whether all targets lie in the receiver's field of view."""


@dataclass(frozen=True, kw_only=True)
class LateLight:
    """Range error due to late, forward-scattered light, with its uncertainty."""

    late: Floats
    """Estimated range error, to be subtracted, shape (row, column) [m]."""
    uncertainty: Floats | None
    """Standard uncertainty of the estimate; None without an estimate [m]."""
    note: str
    """Statement of the subtraction, or the reason for not subtracting."""


def late_light(
    observation: Observation,
    slant_range: Floats,
    *,
    weight: Floats,
    fit: LateFit | None = None,
) -> tuple[LateLight, LateFit]:
    """Range error of one channel due to late light, and the statistics used.

    The water is that of the survey. A stated phase function gives one delay. Otherwise
    the delay has a rectangular distribution between two ends: with an asymmetry between
    the Henyey-Greenstein function and half of its delay, since natural waters of the
    same asymmetry are less late; with moments of the forward part alone between
    Henyey-Greenstein functions with these moments and with asymmetries of 0.90 to 0.98.
    Phasor lines have the delay of the difference between their spots, which is shorter
    if bright spots are glossy.
    """
    nothing = np.zeros(slant_range.shape)
    survey = observation.survey
    if not observation.has_late_light:
        note = "absent from this simulation"
        return LateLight(late=nothing, uncertainty=nothing, note=note), LateFit()
    if survey is None:
        return _unknown(nothing, "no survey describes the water"), LateFit()
    usable = np.isfinite(slant_range)
    ends, used, why = _delays(observation, survey, slant_range, weight, fit)
    if ends is None:
        return _unknown(nothing, why), used
    lowest, highest = ends
    if fit is None:
        bounded = np.isfinite(lowest[usable]) & np.isfinite(highest[usable])
        used = replace(used, in_view=bool(np.all(bounded)))
    if not used.in_view:
        why = "the receiver looks past some of the echoes"
        return _unknown(nothing, why), used
    middle = np.where(usable, (lowest + highest) / 2, 0.0)
    calibration = survey.calibration
    calibrated = None if calibration is None else calibration.scattering_uncertainty
    of_spots = _OF_SPOTS if "phasor_line_window" in observation.channel.attrs else 0.0
    relative = math.hypot(late_echo.RELATIVE_UNCERTAINTY, calibrated or 0.0, of_spots)
    spread = np.where(usable, highest - lowest, 0.0) / math.sqrt(12)
    light = LateLight(
        late=middle,
        uncertainty=np.hypot(relative * middle, spread),
        note="taken off",
    )
    return light, used


def dispersion(
    observation: Observation,
    slant_range: Floats,
    *,
    weight: Floats,
    fit: LateFit | None = None,
) -> tuple[tuple[Floats, Floats] | None, LateFit]:
    """Late-light phase deviations with errors, or None if unknown, and statistics used.

    The higher the frequency, the less light that took many ways counts: a delay that
    differs with the frequency, which is no other distance and no other interval.
    """
    survey = observation.survey
    if len(weight) < 2 or survey is None or not observation.has_late_light:
        return None, LateFit()
    apart = np.eye(len(weight)) - weight
    ends, used, _ = _delays(observation, survey, slant_range, apart, fit)
    if ends is None:
        return None, used
    lowest, highest = ends
    to_phase = ranging.phase_per_range(
        observation.frequency[:, None, None],
        group_index=water_properties(survey).group_index,
    )
    turn = np.nan_to_num(to_phase * (lowest + highest) / 2)
    spread = np.nan_to_num(to_phase * (highest - lowest) / 2)
    return (turn, np.hypot(DISPERSION_UNCERTAINTY * turn, spread)), used


def _fit(observation: Observation, slant_range: Floats) -> LateFit:
    """Limits of target distance and scan direction; empty if no pixel has a range."""
    if not np.isfinite(slant_range).any():
        return LateFit()
    depth = observation.geometry.depth(slant_range)
    depth = depth[np.isfinite(depth) & (depth > 0)]
    return LateFit(
        depth=(float(np.min(depth)), float(np.max(depth))),
        span=span_of(observation.channel)
        if observation.span is None
        else observation.span,
    )


def _unknown(nothing: Floats, why: str) -> LateLight:
    return LateLight(late=nothing, uncertainty=None, note=f"not known: {why}")


def _delays(
    observation: Observation,
    survey: Survey,
    slant_range: Floats,
    weight: Floats,
    fit: LateFit | None,
) -> tuple[tuple[Floats, Floats] | None, LateFit, str]:
    """Least and largest delay per pixel (None if unknown), statistics, and reason."""
    fit = _fit(observation, slant_range) if fit is None else fit
    try:
        water = water_properties(survey)
        functions = _phase_functions(water)
        if fit.depth is None:
            return None, fit, "no pixel has a range"
        ends = _between(
            observation, slant_range, survey=survey, water=water, weight=weight,
            functions=functions, fit=fit,
        )  # fmt: skip
    except SurveyError as error:
        return None, fit, str(error)
    return ends, fit, ""


def _between(
    observation: Observation,
    slant_range: Floats,
    *,
    survey: Survey,
    water: WaterProperties,
    weight: Floats,
    functions: tuple[tuple[PhaseFunction, float, float], ...],
    fit: LateFit,
) -> tuple[Floats, Floats]:
    """Least and largest delay per pixel over the water's possible properties [m].

    Of delays at all frequencies, weighted by one row or by several.
    """
    from scipy.interpolate import RegularGridInterpolator

    depth = observation.geometry.depth(slant_range)
    usable = np.isfinite(depth) & (depth > 0)
    assert fit.depth is not None
    assert fit.span is not None
    ends = fit.depth
    distance = np.unique(np.geomspace(ends[0] * 0.999, ends[1] * 1.001, _DISTANCES))
    sides = [_spread(*fit.span.azimuth), _spread(*fit.span.elevation)]
    azimuth, elevation = np.meshgrid(*sides, indexing="ij")
    geometry = view(survey, azimuth, elevation)
    frequency = observation.frequency
    shape = (*slant_range.shape, 3)
    place = np.empty(shape)
    place[..., 0] = observation.geometry.azimuth
    place[..., 1] = observation.geometry.elevation
    # Values beyond the sampled pixels of a tiled scan are clipped to its limits.
    reached = np.clip(depth, ends[0], ends[1])
    place[..., 2] = np.log(np.where(usable, reached, ends[0]))
    delays = []
    for function, scattering, split in functions:
        echo_delay = late_echo_delay(
            survey,
            frequency,
            depth=distance,
            geometry=geometry,
            water=water,
            phase_function=function,
            scattering=scattering,
            split_angle=split,
        )
        mean = np.tensordot(np.atleast_2d(weight), echo_delay, axes=1)
        # Over the square of the distance it is nearly even, and so well interpolated.
        even = RegularGridInterpolator(
            (*sides, np.log(distance)), np.moveaxis(mean / distance**2, 0, -1)
        )
        delay = even(place) * np.where(usable, depth, np.nan)[..., None] ** 2
        delays.append(
            np.moveaxis(delay, -1, 0).reshape(*weight.shape[:-1], *usable.shape)
        )
    if len(delays) == 1 and states_asymmetry_only(survey):
        delays.append(LEAST_PART * delays[0])
    return np.min(delays, axis=0), np.max(delays, axis=0)


def _spread(low: float, high: float) -> Floats:
    """Return evenly spaced angles over a slightly extended interval."""
    margin = 1e-6 + 1e-6 * (high - low)
    return np.linspace(low - margin, high + margin, _DIRECTIONS)


def _phase_functions(
    water: WaterProperties,
) -> tuple[tuple[PhaseFunction, float, float], ...]:
    """Possible properties of the water: phase function, scattering, split angle."""
    right = math.pi / 2
    if water.scattering == 0:
        return ((_function(_ASYMMETRIES[0]), 0.0, right),)
    from_survey = water.phase_function
    if from_survey is not None:
        return ((from_survey, water.scattering, right),)
    usual = tuple((_function(g), water.scattering, right) for g in _ASYMMETRIES)
    moment, split = water.second_moment, water.split_angle
    fitted = _asymmetry(moment, split) if water.forward_scattering > 0 else None
    if fitted is None:
        return usual
    function = _function(fitted)
    # The forward part is the survey's, so the whole is that over the forward fraction.
    scattering = water.forward_scattering / function.forward_split(split)[0]
    return (*usual, (function, scattering, split))


@lru_cache(maxsize=16)
def _function(asymmetry: float) -> PhaseFunction:
    """Henyey-Greenstein function, cached together with its transform."""
    return henyey_greenstein_function(asymmetry=asymmetry)


def _asymmetry(moment: float, split_angle: float) -> float | None:
    """Asymmetry for a second moment of forward scattering; None if out of limits."""
    try:
        asymmetry = asymmetry_of(moment, split=split_angle)
    except SurveyError:
        return None
    return asymmetry if LEAST_ASYMMETRY <= asymmetry <= _LARGEST_ASYMMETRY else None
