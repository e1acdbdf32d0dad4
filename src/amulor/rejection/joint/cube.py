"""The target-signal cube that holds the results of the joint estimation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import QualityFlag
from amulor.optics import rays
from amulor.rejection.build import target_cube
from amulor.rejection.covariance import Covariance, covariance_of
from amulor.rejection.joint.drift import change_of
from amulor.rejection.joint.instrument import Instrument, late_echo, range_variance
from amulor.rejection.joint.overlap.frame import Frame
from amulor.rejection.joint.priors import DECISIVE, Shared
from amulor.rejection.joint.solve import Result

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
#: Step of the optical path for the derivative of the slant range [m].
_DIFFERENCE = 1e-5


@dataclass(frozen=True)
class Scan:
    """Samples and where their pixels look."""

    cube: xr.Dataset
    """Level `samples`."""
    frame: Frame
    """How the receiver looks at the scan."""
    azimuth: Floats
    """Of the pixels, flat [rad]."""
    elevation: Floats
    """Of the pixels, flat [rad]."""
    enough: NDArray[np.bool_]
    """Pixels with usable samples at two frequencies, flat."""
    span: float
    """Difference of the longest and the shortest optical path [m]."""


def cube_of(
    scan: Scan, parts: list[Result], shared: Shared, instrument: Instrument
) -> xr.Dataset:
    """Return the target-signal cube of all results."""
    cube, frame = scan.cube, scan.frame
    rows_columns = cube["azimuth"].shape
    shape = cube["in_phase"].shape

    def over_pixels(values: list[NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate(values).reshape(rows_columns)

    def over_samples(values: list[NDArray[Any]]) -> NDArray[Any]:
        flat = np.concatenate(values)
        return np.ascontiguousarray(flat.transpose(2, 1, 0)).reshape(shape)

    def covariances(values: list[Covariance]) -> Covariance:
        return Covariance(
            *(
                over_samples([getattr(part, name) for part in values])
                for name in ("in_phase", "quadrature", "cross")
            )
        )

    signal = cube.amulor.signal.values
    water = over_samples([part.water_signal for part in parts])
    common = covariances([part.common for part in parts])
    stated = covariance_of(cube)
    if shared.noise_scale > 1:
        square = shared.noise_scale**2
        stated = Covariance(
            square * stated.in_phase, square * stated.quadrature, square * stated.cross
        )
    total = stated + common
    if shared.fluctuation > 0:
        deviation = over_samples(
            [part.deviation for part in parts if part.deviation is not None]
        )
        total = total + Covariance(
            deviation.real**2, deviation.imag**2, deviation.real * deviation.imag
        )
    path = over_pixels([part.estimates.path for part in parts])
    detected = over_pixels([part.detected for part in parts])
    beam = frame.beam(
        scan.azimuth.reshape(rows_columns), scan.elevation.reshape(rows_columns)
    )

    def to_range(length: Floats) -> Floats:
        return rays.slant_range_of_path(
            length, beam, frame.receiver, medium=frame.medium
        )

    slant_range = np.where(detected, to_range(path), np.nan)
    slope = (to_range(path + _DIFFERENCE) - to_range(path)) / _DIFFERENCE
    known = range_variance(instrument, path, beam, frame.receiver, frame.medium)
    depth = over_pixels([part.depth for part in parts])
    reached = np.where(detected, depth, np.nan)
    typical = float(np.median(depth[detected])) if detected.any() else 0.0
    late_spread = shared.shape.spread
    if instrument.late_echo:
        place = len(shared.strength) + 1
        error = math.sqrt(float(shared.covariance[place, place]))
        late_spread = frame.late_spread(typical, late_spread, error)
    late = late_echo(reached, late_spread)
    known = known + (instrument.late_echo * late) ** 2
    shared_variance = over_pixels([part.shared_variance for part in parts])
    information = over_pixels([part.estimates.information for part in parts])
    with np.errstate(divide="ignore", invalid="ignore"):
        own = 1 / np.sqrt(information)
        sigma = np.hypot(own, np.sqrt(shared_variance))
        departure = np.zeros(rows_columns)
        if shared.evidence > DECISIVE:
            departure = slope * over_pixels([part.departure for part in parts])
        limit = MATTERS if shared.water_departs else ECHO_MATTERS
        matters = departure > limit * np.hypot(slope * sigma, np.sqrt(known))
    freedom, cost, p_value = _misfit(parts, detected, rows_columns)
    flag = np.zeros(rows_columns, dtype=np.int16)
    wrong = over_pixels([part.estimates.wrong for part in parts])
    flag[detected & (wrong > WRONG)] |= QualityFlag.AMBIGUOUS
    if _intervals_look_alike(shared, frame.phase_per_path, scan.span):
        flag[detected] |= QualityFlag.AMBIGUOUS
    two = np.isfinite(over_pixels([part.near for part in parts]))
    flag[two] |= QualityFlag.MIXED
    contradicted = (p_value < DISAGREEMENT) & ~two
    flag[contradicted] |= QualityFlag.WATER_RESIDUAL
    flag[detected & matters] |= QualityFlag.WATER_RESIDUAL
    flag[~detected] |= QualityFlag.NO_TARGET
    flag[~scan.enough.reshape(rows_columns)] |= QualityFlag.NO_TARGET
    target = target_cube(
        cube,
        signal - water,
        total,
        water_signal=water,
        common=common,
        step="reject, joint estimation",
        joint_late_echo_spread_rad2_per_m=late_spread,
        **_attributes(shared, instrument),
    )
    flag[over_pixels([part.unsettled for part in parts])] |= QualityFlag.OUTLIER
    missing = ~np.isfinite(signal)
    flags = np.broadcast_to(flag, shape).copy()
    left_out = over_samples([part.left_out for part in parts])
    flags[left_out] |= QualityFlag.OUTLIER
    if "saturated" in cube:
        flags[cube["saturated"].values != 0] |= QualityFlag.SATURATED
    flags[missing] = QualityFlag.MISSING
    target["quality_flag"].values[...] = flags
    seen = known[detected & np.isfinite(known)]
    target.attrs["joint_instrument_uncertainty_m"] = float(
        np.sqrt(np.median(seen)) if seen.size else 0.0
    )
    # What the departures move is as uncertain as it is large.
    sigma_common = np.sqrt(slope**2 * shared_variance + known + departure**2)
    half = [
        np.hypot(
            slope * over_pixels([getattr(part.estimates, side) for part in parts]),
            sigma_common,
        )
        for side in ("lower", "upper")
    ]
    usable = detected & np.isfinite(slant_range)
    bound = np.sqrt(over_pixels([part.bound for part in parts]))
    ranges = {
        "slant_range": slant_range,
        "slant_range_uncertainty": np.hypot(slope * own, sigma_common),
        "slant_range_common_uncertainty": sigma_common,
        "slant_range_bound": slope * bound,
        "slant_range_lower": slant_range - half[0],
        "slant_range_upper": slant_range + half[1],
        "wrong_interval_probability": wrong,
    }
    maps = {name: np.where(usable, values, np.nan) for name, values in ranges.items()}
    for name, side in (("near", "nearer_surface"), ("far", "farther_surface")):
        maps[side] = to_range(over_pixels([getattr(part, name) for part in parts]))
    maps["misfit"] = cost / np.maximum(freedom, 1)
    return target.assign(_variables(maps))


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
    parts: list[Result], detected: NDArray[np.bool_], shape: tuple[int, ...]
) -> tuple[Floats, Floats, Floats]:
    """Return degrees of freedom, chi-square and its p-value, pixel by pixel."""
    from scipy.stats import chi2

    channels = parts[0].estimates.amplitude.shape[1]
    used = np.concatenate([part.estimates.used for part in parts]).reshape(shape)
    own = np.concatenate([part.estimates.cost for part in parts]).reshape(shape)
    empty = np.concatenate([part.estimates.empty_cost for part in parts]).reshape(shape)
    cost = np.where(detected, own, empty)
    freedom = np.where(detected, used - channels - 1, used).astype(float)
    p_value = np.ones(shape)
    some = freedom > 0
    p_value[some] = chi2.sf(cost[some], freedom[some])
    return freedom, cost, p_value


def _attributes(shared: Shared, instrument: Instrument) -> dict[str, Any]:
    """Return what the pixels share as attributes of a cube."""
    channels = len(shared.strength)
    errors = np.sqrt(np.diag(shared.covariance)[: channels + 3])
    loss, spread = shared.shape.reduced_attenuation, shared.shape.spread
    forward = shared.shape.forward_scattering
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
