"""Range errors of a target signal, as expected in its range image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light
from scipy.special import chdtri

from amulor.cube.error import SHAPE_KNOWN, instrument_phase, may_contain
from amulor.cube.readings import lag_of, range_motion
from amulor.optics import ambiguity, detection, ranging
from amulor.optics._geometry import Geometry
from amulor.optics._mixed_beam import mixed_beams
from amulor.rejection.observation import Observation
from amulor.survey.view import medium_of

Floats = NDArray[np.float64]
Interval = tuple[float, float] | None

#: Frequencies that disagree by more than this chance do not agree [1].
_DISAGREEMENT = 1e-4


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Range errors of the usable pixels of a method, NaN where unknown."""

    noise: Floats
    """Standard uncertainty of the slant range, with light of corners [m]."""
    own_noise: Floats
    """Part of it that is not common to all pixels, after smoothing [m]."""
    bias: Floats
    """Estimated bias of the slant range [m]."""
    agree: NDArray[np.bool_]
    """Mask of pixels whose frequencies agree."""
    path: Floats
    """Optical path [m]."""
    mixed: NDArray[np.bool_]
    """Mask of beams with two surfaces."""
    in_corner: NDArray[np.bool_]
    """Mask of pixels with the flag `CORNER` in the range image."""
    corner_light: bool = False
    """Whether light of corners exceeds the other errors of the samples."""


def errors_of(
    target: xr.Dataset,
    usable: NDArray[np.bool_],
    excluded: NDArray[np.bool_],
    *,
    interval: Interval,
) -> Errors:
    """Return the range errors of the usable pixels of a channel."""
    if "joint_slant_range_uncertainty" in target:
        errors = _errors_of_joint(target, usable)
    else:
        errors = _errors_of_samples(target, usable, excluded)
    if "smoothing_gain" in target:
        rest = np.sqrt(1 - target["smoothing_gain"].values[usable])
        errors = replace(errors, own_noise=rest * errors.own_noise)
    corners = _corner_error(target, usable, errors, interval)
    if not np.any(corners):
        return errors
    from amulor.imaging.corners import is_corner_light

    rest = np.hypot(errors.noise, instrument_error(target))
    return replace(
        errors,
        noise=np.hypot(errors.noise, corners),
        in_corner=corners > rest,
        corner_light=is_corner_light(corners, errors.noise),
    )


def _corner_error(
    target: xr.Dataset,
    usable: NDArray[np.bool_],
    errors: Errors,
    interval: Interval,
) -> Floats:
    """Return the range errors by light that corners reflect twice; 0 without [m]."""
    if target.amulor.survey is None or not may_contain(target, "corner_light"):
        return np.zeros(errors.noise.shape)
    # Other cubes load no module of images.
    from amulor.imaging.corners import corner_error
    from amulor.imaging.observation import observe
    from amulor.imaging.ranges import weight_of

    observation = observe(target.isel(polarization=0))
    shortest, _ = observation.geometry.path_limits(interval, observation.frequency)
    path, noise = (np.full(usable.shape, np.nan) for _ in range(2))
    path[usable], noise[usable] = errors.path, errors.noise
    repeat = repeated_path(observation.frequency)
    path += repeat * np.maximum(np.ceil((shortest - path) / repeat), 0.0)
    slant_range, slope = observation.geometry.slant_range_and_slope(path)
    corners, _ = corner_error(
        observation,
        slant_range,
        weight=weight_of(observation.frequency, observation.sigma, observation.usable),
        slope=slope,
        noise=noise,
    )
    return np.zeros(errors.noise.shape) if corners is None else corners[usable]


def _errors_of_joint(target: xr.Dataset, usable: NDArray[np.bool_]) -> Errors:
    """Return the range errors that a joint estimation states."""
    uncertainty = target["joint_slant_range_uncertainty"].values[usable]
    settled = np.isfinite(uncertainty)
    # Unknown instrument errors are not included in any other method's error.
    instrument = target.attrs["joint_instrument_uncertainty_m"]
    kept = np.zeros(settled.shape)
    if target.sizes["modulation_frequency"] < SHAPE_KNOWN:
        # They contain late light, which the range image keeps here.
        from amulor.rejection.joint.priors import late_echo

        kept = target.attrs["joint_late_echo_uncertainty"] * late_echo(
            target["joint_slant_range"].values[usable],
            target.attrs["joint_late_echo_spread_rad2_per_m"],
        )
    common = target["joint_slant_range_common_uncertainty"].values[usable]
    none = np.zeros(settled.shape, dtype=bool)
    return Errors(
        noise=np.sqrt(np.maximum(uncertainty**2 - instrument**2, 0.0) + kept**2),
        own_noise=np.sqrt(np.maximum(uncertainty**2 - common**2, 0.0)),
        bias=np.zeros(settled.shape),
        agree=settled,
        path=_joint_path(target)[usable],
        mixed=none,
        in_corner=none,
    )


def _motion(
    target: xr.Dataset, sigma: Floats, usable: NDArray[np.bool_]
) -> Floats | None:
    """Return the motion of a vehicle between readings, as optical paths [m]."""
    channel = target.isel(polarization=0)
    survey = target.amulor.survey
    lag = lag_of(channel, survey)
    if lag is None:
        return None
    weight = np.nan_to_num(np.median(sigma, axis=1) ** -2.0)
    return (
        2
        * float(target["geometry"].attrs["group_index"])
        * range_motion(lag[:, usable], survey, weight)
    )


def _errors_of_samples(
    target: xr.Dataset, usable: NDArray[np.bool_], excluded: NDArray[np.bool_]
) -> Errors:
    """Return the range errors of phases, from the errors of the samples."""
    signal = target.amulor.signal.values[:, 0][:, usable]
    instrument = instrument_phase(target, target.amulor.survey)
    observed = Observation(cube=target)
    errors = observed.covariance.part((slice(None), 0))
    to_range = ranging.range_per_phase(
        target["modulation_frequency"].values[:, None],
        group_index=float(target["geometry"].attrs["group_index"]),
    )
    sigma = to_range * detection.phase_uncertainty(
        signal,
        in_phase_variance=errors.in_phase[:, usable],
        quadrature_variance=errors.quadrature[:, usable],
        covariance=errors.cross[:, usable],
    )
    sigma = np.where(excluded[:, usable], np.inf, sigma)
    weight, noise = ranging.weights_and_uncertainty(sigma)
    own = noise
    if (common := observed.common_covariance) is not None:
        common = common.part((slice(None), 0))
        shared = to_range * detection.phase_uncertainty(
            signal,
            in_phase_variance=common.in_phase[:, usable],
            quadrature_variance=common.quadrature[:, usable],
            covariance=common.cross[:, usable],
        )
        rest = np.where(np.isfinite(sigma), sigma**2 - shared**2, 0.0)
        own = np.sqrt(np.sum(weight**2 * np.maximum(rest, 0.0), axis=0))
    bias = np.zeros(noise.shape)
    if "residual_in_phase" in target:
        water = (
            target["residual_in_phase"].values
            + 1j * target["residual_quadrature"].values
        )[:, 0][:, usable]
        turned = ranging.phase_shift(signal, residual=water)
        shift = to_range * np.where(water == 0, 0.0, turned)
        bias = np.sum(weight * shift, axis=0)
    frequency = target["modulation_frequency"].values
    path = ambiguity.optical_path(
        np.angle(signal),
        sigma / to_range,
        modulation_frequency=frequency,
        shortest=np.zeros(noise.shape),
        # As far as the phases do not repeat.
        longest=np.full(noise.shape, 0.999 * repeated_path(frequency)),
        doubt=np.broadcast_to(instrument[:, None], sigma.shape),
        motion=_motion(target, sigma, usable),
    )
    # Only whether they agree: which interval is right is a matter of its limits.
    freedom = (np.isfinite(sigma) & ~path.left_out).sum(axis=0) - 1
    agree = path.strain <= chdtri(np.maximum(freedom, 1), _DISAGREEMENT)
    agree = np.asarray(agree | (freedom < 1))
    group_index = float(target["geometry"].attrs["group_index"])
    mixed, _, _ = mixed_beams(
        np.abs(signal),
        sigma / to_range,
        phase_per_range=1 / to_range.ravel(),
        slant_range=np.where(agree, path.length / (2 * group_index), np.nan),
        uncertainty=noise,
    )
    return Errors(
        noise=noise,
        own_noise=own,
        bias=bias,
        agree=agree,
        path=path.length,
        mixed=mixed,
        in_corner=np.zeros(agree.shape, dtype=bool),
    )


def _joint_path(target: xr.Dataset) -> Floats:
    """Return the optical paths from the joint estimation; NaN without a survey [m]."""
    distance: Floats = target["joint_slant_range"].values
    survey = target.amulor.survey
    if survey is None:
        return np.full(distance.shape, np.nan)
    geometry = Geometry(
        azimuth=target["azimuth"].values,
        elevation=target["elevation"].values,
        emitter=np.asarray(survey.instrument.emitter.position),
        receiver=np.asarray(survey.instrument.receiver.position),
        medium=medium_of(survey),
    )
    settled = np.isfinite(distance)
    path = geometry.optical_path(
        np.where(settled, distance, geometry.beam.length_before + 1.0)
    )
    return np.where(settled, path, np.nan)


def repeated_path(frequency: Floats) -> float:
    """Return the unambiguous round-trip optical path for a set of frequencies [m]."""
    return float(speed_of_light / np.min(np.append(np.diff(frequency), frequency[0])))


def instrument_error(target: xr.Dataset) -> float:
    """Return the range error from instrument phase errors [m].

    The frequencies are weighted by their squares, as those of equal phase noise.
    """
    frequency = target["modulation_frequency"].values
    weight = frequency**2 / np.sum(frequency**2)
    to_range = ranging.range_per_phase(
        frequency, group_index=float(target["geometry"].attrs["group_index"])
    )
    phase = instrument_phase(target, target.amulor.survey)
    return float(np.linalg.norm(weight * to_range * phase))
