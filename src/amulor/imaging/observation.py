"""Input of ranging for a single channel: phases, noise, geometry, survey."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import UNUSABLE, QualityFlag
from amulor.cube.error import flags_of_pixels, may_contain
from amulor.cube.readings import lag_of, range_bend, range_motion, reading_weight
from amulor.cube.schema import PHASE_PREFIX
from amulor.cube.tiles import Span
from amulor.errors import CubeError, SurveyError
from amulor.optics import ambiguity, detection, ranging, rays
from amulor.optics._geometry import Geometry
from amulor.optics._reading_weights import ReadingWeights
from amulor.survey import Survey

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

_WINDOW = (
    "window_distance",
    "window_thickness",
    "window_refractive_index",
    "window_group_index",
)


def geometry_of(cube: xr.Dataset) -> Geometry:
    """Beam geometry of the pixels, from a cube of any level."""
    attributes = cube["geometry"].attrs
    emitter, receiver = (
        np.asarray(attributes[f"{name}_position"], dtype=float)
        for name in ("emitter", "receiver")
    )
    shape = (*cube["azimuth"].shape, 3)
    starts, ends = (
        np.broadcast_to(position, shape).copy() for position in (emitter, receiver)
    )
    for axis, name in enumerate(("origin_x", "origin_y", "origin_z")):
        if name in cube.coords:
            starts[..., axis] = cube[name].values
            ends[..., axis] += cube[name].values - emitter[axis]
    return Geometry(
        azimuth=cube["azimuth"].values,
        elevation=cube["elevation"].values,
        emitter=starts,
        receiver=ends,
        medium=rays.Medium(
            refractive_index=float(attributes["refractive_index"]),
            group_index=float(attributes["group_index"]),
            **{name: float(attributes[name]) for name in _WINDOW if name in attributes},
        ),
    )


@dataclass(frozen=True, kw_only=True)
class Observation:
    """One channel of a target signal, prepared for ranging.

    Arrays run over (frequency, row, column), those of pixels over (row, column).
    """

    channel: xr.Dataset
    """Channel as a dataset, the source of further variables and attributes."""
    geometry: Geometry
    """Beams, receiver positions and media of the pixels."""
    survey: Survey | None
    """Survey; None if the cube has no readable one."""
    most_outliers: float = ambiguity.BREAKDOWN
    """Largest fraction of a pixel's frequencies that may be discarded [1]."""
    span: Span | None = None
    """Directions of the full scan; None if the channel is the full scan."""
    frequency_phase: Floats | None = None
    """Deviation of each frequency from one distance; None if they agree [rad]."""

    @cached_property
    def frequency(self) -> Floats:
        """Modulation frequencies [Hz]."""
        return np.asarray(self.channel["modulation_frequency"].values)

    @cached_property
    def path_per_phase(self) -> Floats:
        """Round-trip optical path per radian of phase [m]."""
        return 2 * ranging.range_per_phase(
            self.frequency[:, None, None], group_index=1.0
        )

    @cached_property
    def signal(self) -> Complex:
        """Target signal [V]."""
        return np.asarray(self.channel.amulor.signal.values)

    @cached_property
    def _flags(self) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
        return flags_of_pixels(
            self.channel["quality_flag"].values, most_outliers=self.most_outliers
        )

    @property
    def flag(self) -> NDArray[np.int16]:
        """Quality flags of the pixels."""
        return self._flags[0]

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Mask of pixels without a flag that makes them unusable."""
        return np.asarray((self.flag & UNUSABLE) == 0)

    @property
    def phase(self) -> Floats:
        """Phases of the target signal, 0 in unusable pixels [rad]."""
        return np.where(self.usable, np.angle(self.signal), 0.0)

    @cached_property
    def sigma(self) -> Floats:
        """Phase uncertainties, infinite for discarded frequencies [rad].

        With the change of the range rate between readings from a vehicle.
        """
        sigma = self._sigma("", self.usable)
        if self.lag is not None and self.survey is not None:
            bend = range_bend(self.lag, self.survey, reading_weight(self.frequency))
            index = self.geometry.medium.group_index
            sigma = np.hypot(sigma, 2 * index * bend / self.path_per_phase)
        return np.where(self._flags[1], np.inf, sigma)

    @property
    def own_sigma(self) -> Floats:
        """Phase uncertainties, without errors common to all pixels [rad]."""
        shared = self.shared_sigma(self.usable)
        if shared is None:
            return self.sigma
        return np.sqrt(np.maximum(self.sigma**2 - shared**2, 0.0))

    def shared_sigma(self, usable: NDArray[np.bool_]) -> Floats | None:
        """Phase uncertainties from errors that pixels share; None if unknown [rad]."""
        if "common_covariance" not in self.channel:
            return None
        return self._sigma("common_", usable)

    def _sigma(self, prefix: str, usable: NDArray[np.bool_]) -> Floats:
        """Phase uncertainty from output uncertainties, arbitrary in unusable pixels."""
        channel, signal = self.channel, self.signal
        cross = channel["common_covariance"] if prefix else channel.amulor.covariance
        mask = np.broadcast_to(usable, signal.shape)
        in_phase, quadrature = (
            np.where(mask, channel[f"{prefix}{output}_uncertainty"].values ** 2, 1.0)
            for output in ("in_phase", "quadrature")
        )
        return detection.phase_uncertainty(
            np.where(mask, signal, 1.0),
            in_phase_variance=in_phase,
            quadrature_variance=quadrature,
            covariance=np.where(mask, cross.values, 0.0),
        )

    @cached_property
    def shift(self) -> Floats:
        """Phase shifts due to the residual water signal, NaN if unknown [rad]."""
        channel = self.channel
        if "residual_in_phase" in channel:
            residual = channel["residual_in_phase"].values
            residual = residual + 1j * channel["residual_quadrature"].values
            return ranging.phase_shift(self.signal, residual=residual)
        taken_out = (channel["quality_flag"].values & QualityFlag.NO_OPEN_WATER) == 0
        return np.where(taken_out, 0.0, np.nan)

    @cached_property
    def lag(self) -> Floats | None:
        """Times of the readings after the first of their pixel [s].

        None if the instrument stands still or reads all frequencies at once.
        """
        return lag_of(self.channel, self.survey)

    def motion(self, weight: Floats) -> Floats | None:
        """Return the standard deviations of the optical paths by the range rate [m].

        They have a sign and count from the mean time of the readings with the weights
        of the frequencies. None if `lag` is.
        """
        if self.lag is None or self.survey is None:
            return None
        change = range_motion(self.lag, self.survey, weight)
        return 2 * self.geometry.medium.group_index * change

    @property
    def has_late_light(self) -> bool:
        """Whether the samples may contain late light; False if simulated without."""
        return may_contain(self.channel, "late_echo")

    def joint_values(self, *names: str) -> tuple[float, ...] | None:
        """Named attributes of a joint estimation; None if any is missing."""
        attributes = self.channel.attrs
        if "joint_slant_range" not in self.channel:
            return None
        if any(f"joint_{name}" not in attributes for name in names):
            return None
        return tuple(float(attributes[f"joint_{name}"]) for name in names)

    def with_frequency_phase(self, phase: Floats) -> Observation:
        """Observation with the phase deviations of contradictory frequencies."""
        return replace(self, frequency_phase=phase)

    def with_noise(self, factor: float) -> Observation:
        """Observation with all phase noise multiplied by a factor."""
        return replace(self, channel=with_noise_scaled(self.channel, factor))


def observe(channel: xr.Dataset, **options: Any) -> Observation:
    """Prepare one channel of a target signal for ranging."""
    return Observation(
        channel=channel,
        geometry=geometry_of(channel),
        survey=readable_survey(channel),
        **options,
    )


def channel_of(cube: xr.Dataset, polarization: str | None) -> xr.Dataset:
    """One polarization channel of a cube."""
    present = cube.amulor.polarizations
    if polarization is None and len(present) > 1:
        raise CubeError(
            f"the cube has the channels {', '.join(present)}; choose one with "
            "polarization (command line: --polarization)"
        )
    chosen = present[0] if polarization is None else polarization
    if chosen not in present:
        raise CubeError(
            f"the cube has no channel {chosen!r}, but {', '.join(present)}; choose one"
        )
    return cube.sel(polarization=chosen)


def readable_survey(cube: xr.Dataset) -> Survey | None:
    """Survey of a cube; None if it has no readable one."""
    try:
        survey: Survey | None = cube.amulor.survey
    except SurveyError:
        return None
    return survey


#: Least number of neighbor pairs for the estimate.
_FEWEST = 30
#: Least significance of excess scatter, in standard errors [1].
_SURE = 4.0
#: Median of chi-square with one degree of freedom, and the relative standard error of
#: such a median times the root of the number of values [1].
_MEDIAN, _OF_MEDIAN = 0.45494, 2.326
#: Terms of the error that are drawn anew for each sample.
_OWN_TERMS = ("counting", "fluctuation")


def noise_scale(
    path: ambiguity.Path,
    error: Floats,
    *,
    path_per_phase: Floats,
    refit: Callable[[float], ambiguity.Path],
    motion: Floats | None = None,
) -> float:
    r"""Ratio of observed to stated phase noise; 1 if not significantly above.

    Phases at n frequencies leave n - 1 residuals a pixel when the range is taken out.
    In the difference of two neighbors everything cancels that they share: water of
    another shape, late light, errors of the reference. What is left is noise, and the
    median of its chi-square over that of chance is the square of the factor (Birge
    ratio). Edges, outliers and mixed pixels do not move a median. With errors that are
    stated too small the tails of the noise are left out as outliers, so that what stays
    scatters less; the factor is looked at once more with errors that are about right.
    """
    factor, chance = _factor(path, error * path_per_phase, motion)
    if not factor**2 > 1 + _SURE * chance:
        return 1.0
    again, _ = _factor(refit(factor), factor * error * path_per_phase, motion)
    return max(factor * again, 1.0)


def _factor(
    path: ambiguity.Path, error: Floats, motion: Floats | None
) -> tuple[float, float]:
    """Ratio of observed to stated noise, and the standard error of its square.

    The factor is 1 where there is too little to tell it.
    """
    valid = np.isfinite(path.length)
    valid &= np.isfinite(error).all(axis=0) & (error > 0).all(axis=0)
    freedom = len(error) - 1 - (motion is not None)
    if freedom < 1:
        return 1.0, 0.0
    variance = _expected(path, error, motion)
    scores = []
    for axis in (0, 1):
        first_of_pair, second_of_pair = _pairs(axis)
        valid_pairs = valid[first_of_pair] & valid[second_of_pair]
        indices = (slice(None), *first_of_pair), (slice(None), *second_of_pair)
        square = (path.residual[indices[0]] - path.residual[indices[1]])[
            :, valid_pairs
        ] ** 2
        first, second = (variance[e][:, valid_pairs] for e in indices)
        left_out = (path.left_out[indices[0]] | path.left_out[indices[1]])[
            :, valid_pairs
        ]
        scores.append(np.where(left_out, np.nan, square / (first + second)))
    score = np.concatenate(scores, axis=1)
    sufficient = np.isfinite(score).sum(axis=1) >= _FEWEST
    if not sufficient.any():
        return 1.0, 0.0
    squares = np.nanmedian(score[sufficient], axis=1) / _MEDIAN
    # That of n - 1 residuals is known beside the others; pairs overlap two by two.
    chance = _OF_MEDIAN * np.sqrt(2 / score.shape[1] / freedom)
    return float(np.sqrt(np.mean(squares))), float(chance)


def with_noise_scaled(target: xr.Dataset, factor: float) -> xr.Dataset:
    """Target signal with its stated noise multiplied by a factor."""
    if factor == 1:
        return target
    more = factor**2 - 1
    changed: dict[str, xr.DataArray] = {}
    for name in ("in_phase_uncertainty", "quadrature_uncertainty"):
        independent = target[name] ** 2 - target.get(f"common_{name}", 0.0) ** 2
        changed[name] = (target[name] ** 2 + more * independent.clip(min=0.0)) ** 0.5
    if "in_phase_quadrature_covariance" in target:
        cross = target["in_phase_quadrature_covariance"]
        independent = cross - target.get("common_covariance", 0.0)
        changed["in_phase_quadrature_covariance"] = cross + more * independent
    for name in _OWN_TERMS:
        if f"{PHASE_PREFIX}{name}" in target:
            changed[f"{PHASE_PREFIX}{name}"] = factor * target[f"{PHASE_PREFIX}{name}"]
    with_attributes = {
        name: values.assign_attrs(target[name].attrs)
        for name, values in changed.items()
    }
    return target.assign(with_attributes).assign_attrs(noise_scale=factor)


def _pairs(axis: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices of all pixels, and of their next neighbors along an axis."""
    first, second = [slice(None)] * 2, [slice(None)] * 2
    first[axis], second[axis] = slice(None, -1), slice(1, None)
    return (first[0], first[1]), (second[0], second[1])


def _expected(path: ambiguity.Path, error: Floats, motion: Floats | None) -> Floats:
    """Variance of residuals about a weighted mean of independent errors."""
    if motion is not None:
        with np.errstate(divide="ignore"):
            precision = np.where(path.left_out, 0.0, error**-2.0)
        return ReadingWeights.of(precision, motion).scatter(error)
    known = np.where(np.isfinite(error), error, 0.0)
    of_mean = np.sum((path.weight * known) ** 2, axis=0)
    return np.asarray((1 - 2 * path.weight) * error**2 + of_mean)
