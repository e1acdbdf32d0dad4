"""Estimates of single pixels for known shared parameters, with their errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.covariance import Covariance, times
from amulor.rejection.joint import motion as joint_motion
from amulor.rejection.joint import normal as joint_normal
from amulor.rejection.joint._kernels import normal as kernels
from amulor.rejection.joint._kernels.bundles import Covariances, WaterModel
from amulor.rejection.joint._kernels.compiled import spread
from amulor.rejection.joint.overlap import Frame
from amulor.rejection.joint.priors import Shared, drifted, layout_of
from amulor.rejection.joint.samples import FEWEST_FREQUENCIES, Pixels
from amulor.rejection.joint.scatter import (
    Cleaned,
    is_detected,
    part_of,
    without_outliers,
)
from amulor.rejection.joint.search import Estimates, are_two, may_be_two, two_surfaces

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True)
class Result:
    """Pixel estimates with their errors, as flat arrays."""

    estimates: Estimates
    """Estimated paths and amplitudes, without influences."""
    left_out: NDArray[np.bool_]
    """Outlying samples, (pixel, channel, frequency)."""
    unsettled: NDArray[np.bool_]
    """Pixels with uncertain outliers."""
    near: Floats
    """Optical path to the nearer of two surfaces; NaN for a single surface [m]."""
    far: Floats
    """Optical path to the farther surface [m]."""
    enough: NDArray[np.bool_]
    """Pixels with usable samples at two or more frequencies."""
    detected: NDArray[np.bool_]
    """Pixels with a detected target."""
    depth: Floats
    """Depth where the water ends, infinite for open water [m]."""
    water_signal: Complex
    """Water signal, (pixel, channel, frequency) [V]."""
    common: Covariance
    """Water-signal covariance from shared-parameter errors [V^2]."""
    deviation: Complex | None
    """Standard deviation of the water fluctuation; None for steady water [V]."""
    shared_variance: Floats
    """Path variance from shared-parameter errors [m^2]."""
    bound: Floats
    """Cramer-Rao bound of the path variance [m^2]."""
    departure: Floats
    """Path shift due to model departures, with its uncertainty [m]."""


def solve(frame: Frame, pixels: Pixels, shared: Shared, transfer: Complex) -> Result:
    """Estimate pixels for known shared parameters."""
    rate = frame.phase_per_path
    usable = pixels.usable
    pixels = drifted(pixels, shared.trend)
    complete = _estimates(frame, pixels, shared, transfer)
    cleaned = without_outliers(
        pixels,
        complete,
        lambda part: _estimates(frame, part, shared, transfer),
        shared.judged,
        max(shared.misfit, 1.0),
    )
    cleaned, near, far = _mixed(pixels, complete, cleaned, shared, transfer, rate)
    left_out = pixels.usable & ~cleaned.pixels.usable
    pixels, estimates = cleaned.pixels, cleaned.estimates
    detected = is_detected(estimates)
    path = np.where(detected, estimates.path, np.inf)
    depth, water, _ = joint_normal.water_at(pixels, path, shared.table, rate)
    changes = joint_normal.all_changes(pixels, depth, water, shared.table, rate)
    foreground = joint_normal.foreground(pixels, shared.table, rate)
    water_signal = shared.water_signal(water, foreground)
    deviation = None
    if shared.fluctuation > 0:
        deviation = shared.fluctuation * water_signal
    echo = np.exp(1j * np.where(detected, path, 0.0)[:, None] * rate) * transfer
    slopes = _path_slopes(shared, estimates, water, foreground, changes, echo)
    layout = layout_of(shared)
    own_variance = np.divide(
        1.0,
        estimates.information,
        out=np.full(len(pixels), np.nan),
        where=estimates.information > 0,
    )
    parametric = slopes[:, layout.parametric]
    free = slice(layout.blocks[1].start, layout.blocks[2].stop)
    moved = np.abs(times(slopes[:, free], _free_parameters(shared)[:, None])[:, 0])
    unsure = _variance(slopes[:, free], shared.covariance[free, free])
    return Result(
        # The influences are most of the memory, and no longer used.
        left_out=left_out,
        unsettled=cleaned.unsettled,
        near=near,
        far=far,
        estimates=replace(estimates, influence=np.zeros((0, 0, 0), dtype=complex)),
        enough=usable.any(axis=1).sum(axis=1) >= FEWEST_FREQUENCIES,
        detected=detected,
        depth=depth,
        water_signal=water_signal,
        common=_common(shared, water, foreground, changes),
        deviation=deviation,
        shared_variance=_variance(slopes, shared.covariance),
        bound=own_variance + _variance(parametric, shared.parametric),
        departure=np.hypot(moved, np.sqrt(np.maximum(unsure, 0.0))),
    )


def _estimates(
    frame: Frame, pixels: Pixels, shared: Shared, transfer: Complex
) -> Estimates:
    """Estimate optical paths and amplitudes of pixels."""
    return joint_motion.estimates_of(
        pixels, shared, transfer=transfer, phase_per_path=frame.phase_per_path
    )


def _mixed(
    pixels: Pixels,
    complete: Estimates,
    cleaned: Cleaned,
    shared: Shared,
    transfer: Complex,
    rate: Floats,
) -> tuple[Cleaned, Floats, Floats]:
    """Restore the samples of two-surface pixels; return results and both paths."""
    count = len(pixels)
    near, far = np.full(count, np.nan), np.full(count, np.nan)
    number = (pixels.usable & ~cleaned.pixels.usable).sum(axis=(1, 2))
    candidates = np.flatnonzero(
        may_be_two(complete, is_detected(complete), (number > 0) | cleaned.unsettled)
    )
    if not len(candidates):
        return cleaned, near, far
    pair = two_surfaces(
        joint_motion.at_instant(
            pixels.part(candidates), complete.path[candidates],
            complete.rate[candidates], shared, rate,
        ),
        complete.path[candidates], shared, transfer=transfer, phase_per_path=rate,
    )  # fmt: skip
    pair = replace(pair, cost=pair.cost + complete.rate[candidates] ** 2)
    is_mixed = are_two(
        pair,
        part_of(complete, candidates),
        part_of(cleaned.estimates, candidates),
        number[candidates],
    )
    candidates = candidates[is_mixed]
    near[candidates], far[candidates] = pair.near[is_mixed], pair.far[is_mixed]
    return cleaned.restored(pixels, complete, candidates), near, far


def _variance(slopes: Floats, covariance: Floats) -> Floats:
    """Return the path variances due to shared-parameter errors [m^2]."""
    variance: Floats = np.einsum("ni,ni->n", times(slopes, covariance), slopes)
    return variance


def _free_parameters(shared: Shared) -> Floats:
    """Return the departures of water and echo, in the parameter order of `Layout`."""
    return np.concatenate(
        [
            shared.departure.real.ravel(),
            shared.departure.imag.ravel(),
            shared.echo.real,
            shared.echo.imag,
        ]
    )


def _path_slopes(
    shared: Shared,
    estimates: Estimates,
    water: Complex,
    foreground: Complex,
    changes: Complex,
    echo: Complex,
) -> Floats:
    """Return the derivatives of paths by shared parameters, (pixel, parameter)."""
    layout = layout_of(shared)
    channels = len(shared.strength)
    out = np.zeros((len(water), layout.size))
    pull = np.conj(estimates.influence)
    for c in range(channels):
        out[:, c] = -np.sum(
            (pull[:, c] * (water + shared.departure[c] * foreground)).real, axis=-1
        )
    scaled = pull * shared.gain
    out[:, layout.shape] = -np.einsum("ncf,nmf->nm", scaled, changes).real
    _, free, echoes = layout.blocks
    by_light = pull * shared.strength[:, None] * foreground[:, None]
    by_departure = np.stack([-by_light.real, by_light.imag], axis=1)
    out[:, free] = by_departure.reshape(len(water), -1)
    by_echo = np.einsum("ncf,nc->nf", pull, estimates.amplitude) * echo
    out[:, echoes] = np.concatenate([-by_echo.real, by_echo.imag], axis=1)
    return out


def _common(
    shared: Shared, water: Complex, foreground: Complex, changes: Complex
) -> Covariance:
    """Return the water-signal covariance due to shared-parameter errors [V^2]."""
    layout = layout_of(shared)
    channels, frequencies = shared.departure.shape
    shape = (len(water), channels, frequencies)
    out = Covariances(np.empty(shape), np.empty(shape), np.empty(shape))
    inner = np.arange(layout.shape.start, layout.shape.stop)
    channel, frequency = np.indices((channels, frequencies))
    departure = layout.blocks[1].start + channel * frequencies + frequency
    columns = np.concatenate(
        [
            channel[..., None],
            np.broadcast_to(inner, (channels, frequencies, inner.size)),
            departure[..., None],
            departure[..., None] + channels * frequencies,
        ],
        axis=-1,
    )
    covariance = shared.covariance[columns[..., :, None], columns[..., None, :]]
    model = WaterModel(
        strength=shared.strength,
        gain=np.ascontiguousarray(shared.gain),
        departure=np.ascontiguousarray(shared.departure),
        foreground=foreground,
        water=water,
        changes=changes,
        covariance=np.ascontiguousarray(covariance),
    )
    spread(kernels.common, len(water), model, out)
    return Covariance(*out)
