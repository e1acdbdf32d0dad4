"""Target-signal cube with the results of the joint estimation."""

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

#: Probability of another ambiguity interval beyond which a pixel is ambiguous [1].
WRONG = 3e-4
#: P-value of the samples below which they contradict the model [1].
DISAGREEMENT = 1e-4
#: Shift of a path by departures, over its other uncertainty, from which a pixel is
#: flagged [1].
MATTERS = 10.0
#: Limit where the echo departs and the water does not: the departure may include a
#: delay of all frequencies, which no sample shows [1].
ECHO_MATTERS = 0.3
#: Share of the pixels that is most of them [1].
_MOST = 0.5


@dataclass(frozen=True, kw_only=True)
class Scan:
    """Parameters of a scan that its pixels share."""

    frame: Frame
    """View of the receiver over the scan."""
    shared: Shared
    """Shared parameters: water strength and shape, departures, fluctuation."""
    instrument: Instrument
    """Standard uncertainties of the instrument."""
    span: float
    """Difference between longest and shortest optical path [m]."""
    late_spread: float
    """Growth of the mean square angle that explains late echoes [rad^2/m]."""
    instrument_uncertainty: float
    """Median slant-range uncertainty from instrument errors [m]."""
    echo_is_doubted: bool
    """Whether the echo departs from the model in a fit without open-water shots."""


def typical_of(
    frame: Frame,
    geometry: Geometry,
    result: Result,
    shared: Shared,
    instrument: Instrument,
) -> tuple[float, float]:
    """Return late-echo angular spread [rad^2/m], and median instrument error [m]."""
    detected = result.detected
    typical = float(np.median(result.depth[detected])) if detected.any() else 0.0
    late_spread = shared.shape.spread
    if instrument.late_echo:
        place = len(shared.strength) + 1
        error = math.sqrt(float(shared.covariance[place, place]))
        late_spread = frame.late_spread(typical, late_spread, error)
    variance = _variance_of(geometry, result, instrument, late_spread)
    finite = variance[detected & np.isfinite(variance)]
    return late_spread, float(np.sqrt(np.median(finite)) if finite.size else 0.0)


def echo_departs(
    geometry: Geometry, result: Result, shared: Shared, instrument: Instrument
) -> bool:
    """Return whether the echo's departure from the model would flag most pixels."""
    if (
        shared.evidence <= DECISIVE
        or shared.water_departs
        or not shared.echo_departs
        or not result.detected.any()
    ):
        return False
    _, slope = geometry.slant_range_and_slope(result.estimates.path)
    variance = _variance_of(geometry, result, instrument, shared.shape.spread)
    with np.errstate(divide="ignore", invalid="ignore"):
        departure, limit = _departure(result, slope, variance, ECHO_MATTERS)
    return bool(np.mean((departure > limit)[result.detected]) > _MOST)


def _departure(
    result: Result, slope: Floats, variance: Floats, limit: float
) -> tuple[Floats, Floats]:
    """Return range shifts due to model departures, and their flag limits [m]."""
    deviation = 1 / np.sqrt(result.estimates.information)
    sigma = np.hypot(deviation, np.sqrt(result.shared_variance))
    departure = slope * result.departure
    return departure, limit * np.hypot(slope * sigma, np.sqrt(variance))


def _variance_of(
    geometry: Geometry, result: Result, instrument: Instrument, late_spread: float
) -> Floats:
    """Return the slant-range variance from instrument errors and late echo [m^2]."""
    variance = range_variance(instrument, result.estimates.path, geometry)
    late = late_echo(np.where(result.detected, result.depth, np.nan), late_spread)
    total: Floats = variance + (instrument.late_echo * late) ** 2
    return total


def cube_of(rows: Observation, scan: Scan, result: Result) -> xr.Dataset:
    """Return the target-signal cube of some rows of a scan, from its estimates."""
    frame, shared = scan.frame, scan.shared
    rows_columns = rows.azimuth.shape
    signal, covariance = rows.signal, rows.covariance
    shape = signal.shape

    def over_pixels(values: NDArray[Any]) -> NDArray[Any]:
        return values.reshape(rows_columns)

    def over_samples(values: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(values.transpose(2, 1, 0)).reshape(shape)

    water = over_samples(result.water_signal)
    common = Covariance(
        *(over_samples(errors) for errors in vars(result.common).values())
    )
    if shared.noise_scale > 1:
        square = shared.noise_scale**2
        covariance = Covariance(
            square * covariance.in_phase,
            square * covariance.quadrature,
            square * covariance.cross,
        )
    total = covariance + common
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
    variance = _variance_of(geometry, result, scan.instrument, scan.late_spread)
    with np.errstate(divide="ignore", invalid="ignore"):
        deviation_of_path = 1 / np.sqrt(estimates.information)
        limit = MATTERS
        if scan.echo_is_doubted or not shared.water_departs:
            limit = ECHO_MATTERS
        departure, shift_limit = _departure(result, slope, variance, limit)
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
    if rows.motion is not None:
        outlying = result.unsettled | result.left_out.any(axis=(1, 2))
        flag[contradicted | outlying] |= QualityFlag.MOVED
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
    # The test for a target uses all samples of a pixel together.
    target = target.drop_vars("signal_significance")
    target.attrs["joint_instrument_uncertainty_m"] = scan.instrument_uncertainty
    # A shift by departures is as uncertain as it is large.
    sigma_common = np.sqrt(slope**2 * result.shared_variance + variance + departure**2)
    half = [
        np.hypot(slope * getattr(estimates, side), sigma_common)
        for side in ("lower", "upper")
    ]
    usable = detected & np.isfinite(slant_range)
    ranges = {
        "slant_range": slant_range,
        "slant_range_uncertainty": np.hypot(slope * deviation_of_path, sigma_common),
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
    """Return whether model departures could hide a wrong ambiguity interval.

    The departures would move the paths of all pixels by one interval.
    """
    width = shared.widths[2]
    if shared.evidence <= DECISIVE or not span > 0:
        return False
    # From half a period of the highest frequency on, in small steps.
    period = 2 * np.pi / rate.max()
    shift = np.arange(0.5 * period, max(span, period) + period, period / 48)
    phasor = np.exp(1j * rate * shift[:, None])
    apart = np.sum(np.abs(phasor - 1) ** 2, axis=1) / width**2
    return bool(np.any(apart < -2 * np.log(WRONG)))


def _variables(maps: dict[str, Floats]) -> dict[str, xr.Variable]:
    """Return maps over pixels as cube variables, with the prefix `joint_`."""
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
    has_freedom = freedom > 0
    p_value[has_freedom] = chi2.sf(cost[has_freedom], freedom[has_freedom])
    return freedom, cost, p_value


def _attributes(shared: Shared, instrument: Instrument) -> dict[str, Any]:
    """Return the shared parameters as attributes of a cube."""
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
