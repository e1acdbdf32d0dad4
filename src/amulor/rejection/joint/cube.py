"""The target-signal cube that holds the results of the joint estimation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import QualityFlag, WaterResidualCause
from amulor.optics._geometry import Geometry
from amulor.rejection.build import target_cube
from amulor.rejection.covariance import Covariance
from amulor.rejection.joint.overlap import Frame
from amulor.rejection.joint.priors import (
    DECISIVE,
    Instrument,
    Shared,
    change_of,
    change_uncertainty,
    late_echo,
    layout_of,
    range_variance,
)
from amulor.rejection.joint.search import Estimates
from amulor.rejection.joint.solve import Result
from amulor.rejection.observation import Observation

Floats = NDArray[np.float64]

#: A path is settled when another interval is less likely than this [1].
WRONG = 3e-4
#: A p-value of the samples below this says that the model is wrong [1].
DISAGREEMENT = 1e-4
#: Departures matter when they move a path by this much of its other uncertainty: then
#: the interval holds nothing else [1].
MATTERS = 10.0
#: The same where the echo departs and the water does not: a delay that all frequencies
#: share goes with it, and no sample shows that [1].
ECHO_MATTERS = 0.3
#: Part of the pixels that is most of them [1].
_MOST = 0.5


@dataclass(frozen=True, kw_only=True)
class Scan:
    """What the pixels of a scan share."""

    frame: Frame
    """How the receiver looks at the scan."""
    shared: Shared
    """Strength and shape of the water signal, departures, fluctuation."""
    instrument: Instrument
    """How well it is known."""
    span: float
    """Difference of the longest and the shortest optical path [m]."""
    late_spread: float
    """Growth of the mean square angle by which echoes are late [rad^2/m]."""
    instrument_uncertainty: float
    """Median of what is not known of the instrument, over slant ranges [m]."""
    echo_is_doubted: bool
    """Whether the scan by itself refuses its echo, which shots of other water hide."""


def typical_of(
    frame: Frame,
    geometry: Geometry,
    result: Result,
    shared: Shared,
    instrument: Instrument,
) -> tuple[float, float]:
    """Spread by which echoes are late, and what the instrument leaves open."""
    seen = result.detected
    typical = float(np.median(result.depth[seen])) if seen.any() else 0.0
    late_spread = shared.shape.spread
    if instrument.late_echo:
        place = len(shared.strength) + 1
        error = math.sqrt(float(shared.covariance[place, place]))
        late_spread = frame.late_spread(typical, late_spread, error)
    known = _known(geometry, result, instrument, late_spread)
    some = known[seen & np.isfinite(known)]
    return late_spread, float(np.sqrt(np.median(some)) if some.size else 0.0)


def refuses_its_echo(
    geometry: Geometry, result: Result, shared: Shared, instrument: Instrument
) -> bool:
    """Return whether most pixels are flagged since the echo is no pure delay."""
    if (
        shared.evidence <= DECISIVE
        or shared.water_departs
        or not shared.echo_departs
        or not result.detected.any()
    ):
        return False
    _, slope = geometry.slant_range_and_slope(result.estimates.path)
    known = _known(geometry, result, instrument, shared.shape.spread)
    with np.errstate(divide="ignore", invalid="ignore"):
        departure, limit = _departure(result, slope, known, ECHO_MATTERS)
    return bool(np.mean((departure > limit)[result.detected]) > _MOST)


def _departure(
    result: Result, slope: Floats, known: Floats, limit: float
) -> tuple[Floats, Floats]:
    """Return how far departures move slant ranges, and from where on it matters [m]."""
    own = 1 / np.sqrt(result.estimates.information)
    sigma = np.hypot(own, np.sqrt(result.shared_variance))
    departure = slope * result.departure
    return departure, limit * np.hypot(slope * sigma, np.sqrt(known))


def _known(
    geometry: Geometry, result: Result, instrument: Instrument, late_spread: float
) -> Floats:
    """Return the variance of slant ranges by what the samples cannot tell [m^2]."""
    known = range_variance(instrument, result.estimates.path, geometry)
    late = late_echo(np.where(result.detected, result.depth, np.nan), late_spread)
    total: Floats = known + (instrument.late_echo * late) ** 2
    return total


def cube_of(rows: Observation, scan: Scan, result: Result) -> xr.Dataset:
    """Target-signal cube of some rows or of a part of them."""
    frame, shared = scan.frame, scan.shared
    rows_columns = rows.azimuth.shape
    signal, stated = rows.signal, rows.covariance
    shape = signal.shape

    def over_pixels(values: NDArray[Any]) -> NDArray[Any]:
        return values.reshape(rows_columns)

    def over_samples(values: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(values.transpose(2, 1, 0)).reshape(shape)

    water = over_samples(result.water_signal)
    common = Covariance(*(over_samples(each) for each in vars(result.common).values()))
    if shared.noise_scale > 1:
        square = shared.noise_scale**2
        stated = Covariance(
            square * stated.in_phase, square * stated.quadrature, square * stated.cross
        )
    total = stated + common
    if result.deviation is not None:
        deviation = over_samples(result.deviation)
        total = total + Covariance(
            deviation.real**2, deviation.imag**2, deviation.real * deviation.imag
        )
    estimates = result.estimates
    path, detected = estimates.path, result.detected
    geometry = frame.geometry(rows.azimuth.ravel(), rows.elevation.ravel())
    slant_range, slope = geometry.slant_range_and_slope(path)
    slant_range = np.where(detected, slant_range, np.nan)
    known = _known(geometry, result, scan.instrument, scan.late_spread)
    with np.errstate(divide="ignore", invalid="ignore"):
        own = 1 / np.sqrt(estimates.information)
        limit = MATTERS
        if scan.echo_is_doubted or not shared.water_departs:
            limit = ECHO_MATTERS
        departure, shift_limit = _departure(result, slope, known, limit)
        if shared.evidence <= DECISIVE:
            departure = np.zeros(len(path))
        matters = (departure > shift_limit) & (shared.evidence > DECISIVE)
    freedom, cost, p_value = _misfit(estimates, detected)
    flag = np.zeros(len(path), dtype=np.int16)
    flag[detected & (estimates.wrong > WRONG)] |= QualityFlag.AMBIGUOUS
    if _intervals_look_alike(shared, frame.phase_per_path, scan.span):
        flag[detected] |= QualityFlag.AMBIGUOUS
    two = np.isfinite(result.near)
    flag[two] |= QualityFlag.MIXED
    contradicted = (p_value < DISAGREEMENT) & ~two
    cause = np.zeros(len(path), dtype=np.int8)
    cause[contradicted] |= WaterResidualCause.MODEL_MISFIT
    cause[detected & matters] |= WaterResidualCause.MODEL_DEPARTURE
    flag[cause != 0] |= QualityFlag.WATER_RESIDUAL
    flag[~detected | ~result.enough] |= QualityFlag.NO_TARGET
    target = target_cube(
        rows.cube,
        signal - water,
        total,
        water_signal=water,
        common=common,
        step="reject, joint estimation",
        joint_late_echo_spread_rad2_per_m=scan.late_spread,
        **_attributes(shared, scan.instrument),
    )
    flag[result.unsettled] |= QualityFlag.OUTLIER
    missing = ~np.isfinite(signal)
    flags = np.broadcast_to(over_pixels(flag), shape).copy()
    flags[over_samples(result.left_out)] |= QualityFlag.OUTLIER
    if rows.saturated is not None:
        flags[rows.saturated] |= QualityFlag.SATURATED
    flags[missing] = QualityFlag.MISSING
    target["quality_flag"].values[...] = flags
    causes = np.broadcast_to(over_pixels(cause), shape)
    target["water_residual_cause"].values[...] = np.where(missing, 0, causes)
    # Whether there is a target is tested on all samples of a pixel together.
    target = target.drop_vars("signal_significance")
    target.attrs["joint_instrument_uncertainty_m"] = scan.instrument_uncertainty
    # What the departures move is as uncertain as it is large.
    sigma_common = np.sqrt(slope**2 * result.shared_variance + known + departure**2)
    half = [
        np.hypot(slope * getattr(estimates, side), sigma_common)
        for side in ("lower", "upper")
    ]
    usable = detected & np.isfinite(slant_range)
    ranges = {
        "slant_range": slant_range,
        "slant_range_uncertainty": np.hypot(slope * own, sigma_common),
        "slant_range_common_uncertainty": sigma_common,
        "slant_range_bound": slope * np.sqrt(result.bound),
        "slant_range_lower": slant_range - half[0],
        "slant_range_upper": slant_range + half[1],
        "wrong_interval_probability": estimates.wrong,
    }
    maps = {name: np.where(usable, values, np.nan) for name, values in ranges.items()}
    for name, side in (("near", "nearer_surface"), ("far", "farther_surface")):
        maps[side] = geometry.slant_range(getattr(result, name))
    maps["misfit"] = cost / np.maximum(freedom, 1)
    maps["misfit_probability"], maps["detection"] = p_value, estimates.explained
    maps["departure"], maps["departure_limit"] = departure, shift_limit
    return target.assign(
        _variables({name: over_pixels(values) for name, values in maps.items()})
    )


def _intervals_look_alike(shared: Shared, rate: Floats, span: float) -> bool:
    """Return whether another interval is within the departures that the scan shows.

    The paths of all pixels were moved into one by them.
    """
    width = shared.widths[2]
    if shared.evidence <= DECISIVE or not span > 0:
        return False
    # From half a period of the highest frequency on, in small steps.
    period = 2 * np.pi / rate.max()
    shift = np.arange(0.5 * period, max(span, period) + period, period / 48)
    turned = np.exp(1j * rate * shift[:, None])
    apart = np.sum(np.abs(turned - 1) ** 2, axis=1) / width**2
    return bool(np.any(apart < -2 * np.log(WRONG)))


def _variables(maps: dict[str, Floats]) -> dict[str, xr.Variable]:
    """Return maps as the variables of the schema whose names begin with `joint_`."""
    specs = cubes.LEVELS["target_signal"].variables
    variables = {}
    for short, values in maps.items():
        spec = specs[f"joint_{short}"]
        attributes = {"long_name": spec.long_name, "units": spec.units}
        variables[f"joint_{short}"] = xr.Variable(spec.dimensions, values, attributes)
    return variables


def _misfit(
    estimates: Estimates, detected: NDArray[np.bool_]
) -> tuple[Floats, Floats, Floats]:
    """Return degrees of freedom, chi-square and its p-value, pixel by pixel."""
    from scipy.stats import chi2

    used, channels = estimates.used, estimates.amplitude.shape[1]
    cost = np.where(detected, estimates.cost, estimates.empty_cost)
    freedom = np.where(detected, used - channels - 1, used).astype(float)
    p_value = np.ones(len(cost))
    some = freedom > 0
    p_value[some] = chi2.sf(cost[some], freedom[some])
    return freedom, cost, p_value


def _attributes(shared: Shared, instrument: Instrument) -> dict[str, Any]:
    """Return what the pixels share as attributes of a cube."""
    channels = len(shared.strength)
    errors = np.sqrt(np.diag(shared.covariance)[: channels + 3])
    loss, spread = shared.shape.reduced_attenuation, shared.shape.spread
    forward = shared.shape.forward_scattering
    trend = layout_of(shared).trend
    return {
        "joint_water_strength_volt": shared.strength,
        "joint_water_strength_uncertainty_volt": errors[:channels],
        "joint_reduced_attenuation_per_m": loss,
        "joint_reduced_attenuation_uncertainty_per_m": loss * errors[channels],
        "joint_spread_rad2_per_m": spread,
        "joint_spread_uncertainty_rad2_per_m": spread * errors[channels + 1],
        "joint_forward_scattering_per_m": forward,
        "joint_forward_scattering_uncertainty_per_m": forward * errors[channels + 2],
        "joint_fluctuation": shared.fluctuation,
        "joint_shot_strength": shared.shot_factor,
        "joint_noise_scale": shared.noise_scale,
        "joint_water_drift": change_of(shared.trend),
        "joint_water_drift_uncertainty": change_uncertainty(
            shared.covariance[trend, trend], preferred=shared.water_drifts
        ),
        "joint_receiver_turn_rad": shared.shape.turn,
        "joint_late_echo_uncertainty": instrument.late_echo,
        "joint_delay_uncertainty_s": instrument.delay,
        "joint_group_index_uncertainty": instrument.group_index,
        "joint_receiver_position_uncertainty_m": instrument.position,
        "joint_receiver_direction_uncertainty_rad": instrument.direction,
        "joint_departure_widths": np.array(shared.widths),
        "joint_departure_evidence": shared.evidence,
        "joint_misfit": shared.misfit,
    }
