"""Quality flags of the samples of a target signal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from amulor._discoveries import largest_discovered
from amulor.cube import QualityFlag, WaterResidualCause
from amulor.cube.error import LARGEST_CHANCE
from amulor.optics import detection, ranging
from amulor.rejection.covariance import Covariance

#: Least significance of a target signal, in standard errors.
DETECTION_THRESHOLD = 5.0
#: Largest phase error of a detected target; first-order errors fail beyond [rad].
LARGEST_PHASE_ERROR = 0.3


@dataclass(frozen=True, kw_only=True)
class Flags:
    """Quality flags of samples with their test statistics, arrays of one shape."""

    flag: NDArray[np.int16]
    """Quality flags."""
    cause: NDArray[np.int8]
    """Failed water-signal tests, as bits of `WaterResidualCause`."""
    tests: dict[str, NDArray[np.float64]]
    """Test statistics, named in `amulor.cube.schema.SAMPLE_TESTS`."""


def flags(
    saturated: NDArray[np.bool_] | None,
    target_signal: NDArray[np.complex128],
    uncertainty: Covariance,
    *,
    residual: NDArray[np.complex128] | None = None,
    proportional: Covariance | None = None,
    water_is_in: bool = False,
) -> Flags:
    """Return the quality flag of every sample, with its causes and statistics."""
    flag = np.zeros(target_signal.shape, dtype=np.int16)
    missing = ~np.isfinite(target_signal)
    if saturated is not None:
        flag[saturated] |= QualityFlag.SATURATED
    # Residual water must not be detected as a target: it counts as an error, too.
    water = np.zeros_like(target_signal) if residual is None else residual
    power = np.nan_to_num(np.abs(water) ** 2)
    blurred = Covariance(
        uncertainty.in_phase + power, uncertainty.quadrature + power, uncertainty.cross
    )
    standing = blurred if proportional is None else blurred.without(proportional)
    with np.errstate(invalid="ignore", divide="ignore"):
        square = standing.mahalanobis(target_signal)
        far = square >= DETECTION_THRESHOLD**2
    detected = far & ~missing
    phase = phase_error(target_signal, blurred, detected)
    # An error that lies along one direction can leave the strength sure and the phase
    # open.
    detected &= phase < LARGEST_PHASE_ERROR
    flag[~detected & ~missing] |= QualityFlag.NO_TARGET
    if water_is_in:
        flag |= QualityFlag.NO_OPEN_WATER
    ratio = {}
    if residual is not None:
        turn = phase_shift_ratio(target_signal, residual, uncertainty)
        moved = detected & ~(turn <= 1)
        flag[moved] |= QualityFlag.WATER_RESIDUAL
        ratio["residual_phase_ratio"] = np.where(moved, turn, np.nan)
    flag[missing] = QualityFlag.MISSING
    doubted = (flag & QualityFlag.WATER_RESIDUAL) != 0
    return Flags(
        flag=flag,
        cause=np.where(doubted, WaterResidualCause.PHASE_SHIFT, 0).astype(np.int8),
        tests={"signal_significance": np.sqrt(square)} | ratio,
    )


def phase_shift_ratio(
    target_signal: NDArray[np.complex128],
    residual: NDArray[np.complex128],
    uncertainty: Covariance,
) -> NDArray[np.float64]:
    """Return the ratio of residual-water phase shift to phase error; NaN if unknown."""
    error = phase_error(target_signal, uncertainty, np.isfinite(target_signal))
    shift = np.abs(ranging.phase_shift(target_signal, residual=residual))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(residual == 0, 0.0, shift / error)


def looks_like_water(
    saturated: NDArray[np.bool_] | None,
    signal: NDArray[np.complex128],
    water_signal: NDArray[np.complex128],
    uncertainty: Covariance,
) -> tuple[NDArray[np.bool_], dict[str, NDArray[np.float64]]]:
    """Return the mask of pixels shaped like the water signal, and test statistics.

    Least squares with the covariances of the samples: the multiple of the water signal
    differs from zero by five standard errors, and chance makes so large a residual in
    more than 1 of 1000 cases. A target agrees only if it has the phase and the strength
    of the water signal at every frequency and in every channel.
    """
    from scipy.special import chdtrc

    use = np.isfinite(signal) & np.isfinite(water_signal)
    if saturated is not None:
        use &= ~saturated
    determinant = uncertainty.in_phase * uncertainty.quadrature - uncertainty.cross**2
    use &= determinant > 0
    count = use.sum(axis=(0, 1))
    scale = np.divide(1.0, determinant, out=np.zeros(signal.shape), where=use)
    rest = np.where(use, signal, 0)
    shape = np.where(use, water_signal, 0)
    power, cross = (
        _product(factor, shape, uncertainty, scale) for factor in (shape, rest)
    )
    square = _product(rest, rest, uncertainty, scale)
    explained = np.divide(cross**2, power, out=np.zeros(power.shape), where=power > 0)
    misfit = np.maximum(square - explained, 0.0)
    freedom = np.maximum(2 * count - 1, 1)
    by_chance = chdtrc(freedom, misfit)
    similar = (count > 1) & (explained > DETECTION_THRESHOLD**2)
    similar &= by_chance > PLAUSIBLE
    return similar, {
        "water_shape_significance": np.where(similar, np.sqrt(explained), np.nan),
        "water_shape_probability": np.where(similar, by_chance, np.nan),
    }


#: Phase difference of inconsistent channels, in standard errors.
_DISAGREE = 4.0
#: So many are enough where more do than chance makes.
_LEAST_DISAGREEMENT = 2.5
#: Share of chance among these [1].
_BY_CHANCE = 0.1
#: What so many pixels have in common is no outlier [1].
_RARE = 0.15
#: Half of normal deviates are smaller [1].
_HALF = 0.6745


def channels_disagree(
    signal: NDArray[np.complex128],
    uncertainty: Covariance,
    *,
    shown: NDArray[np.bool_] | None = None,
    fit: tuple[Disagreement, ...] | None = None,
) -> tuple[NDArray[np.bool_], tuple[Disagreement, ...], NDArray[np.float32]]:
    """Return the mask of deviating phases between channels, limits and deviations.

    Both samples of a pair are marked, for nothing tells which one is wrong. None are
    where more than 15 % of the samples of a pair disagree, which is no chance. Pixels
    that are not `shown` have no target; what is left of water has no phase of its own.
    Also return the limits of each pair: `fit`, or by default those of this signal;
    and how far each sample stands off, in units of the scatter.

    Every analyser passes some fraction of the same echo: their phases are one, but for
    what most pixels have in common. They disagree where they differ by four standard
    errors, and from 2.5 on where more do than chance makes: a tenth of them at most
    are by chance. Where phases scatter more than stated, their scatter is the error.
    """
    marked = np.zeros(signal.shape, dtype=bool)
    detected = np.isfinite(signal) & (signal != 0)
    sigma = phase_error(signal, uncertainty, detected)
    detected &= sigma < LARGEST_PHASE_ERROR
    if shown is not None:
        detected &= shown
    limits: list[Disagreement] = []
    size = np.full(signal.shape, np.nan, dtype=np.float32)
    for first in range(signal.shape[1]):
        for second in range(first):
            pair = [first, second]
            both = detected[:, pair].all(axis=1)
            turn = np.angle(signal[:, first] * signal[:, second].conj())
            error = np.hypot(sigma[:, first], sigma[:, second])
            away = np.where(both, turn / error, np.nan)
            limit = Disagreement.of(away) if fit is None else fit[len(limits)]
            limits.append(limit)
            marked[:, pair] |= limit.where(away)[:, None]
            off = _standardized(away, limit.usual, limit.scatter).astype(np.float32)
            size[:, pair] = np.fmax(size[:, pair], off[:, None])
    return marked, tuple(limits), size


#: Least fraction of the target pixels with a known phase for this test [1].
_MOST_PIXELS = 0.5
#: A larger one flags the scan [rad].
LARGEST_CHANNEL_PHASE = 0.05


@dataclass(frozen=True, kw_only=True)
class ChannelPhase:
    """Median phase difference between channels, for the targets of a scan.

    All channels see one echo. Leakage, a phase that depends on the amplitude and a
    layer of other water turn the channels by different angles.
    """

    phase: NDArray[np.float64]
    """Largest phase difference over all channel pairs, at each frequency [rad]."""
    significance: NDArray[np.float64]
    """Largest phase difference, less the effect of the hidden water column, over its
    standard uncertainty, at each frequency [1]."""
    probability: float
    """Probability of so large a phase difference by chance, over all pairs and
    frequencies [1]."""

    @property
    def is_real(self) -> bool:
        """Whether the phase difference is significant."""
        return self.probability < LARGEST_CHANCE

    @property
    def cause(self) -> WaterResidualCause:
        """Cause INSTRUMENT for a large and significant phase difference, else 0."""
        if self.is_real and self.phase.max() > LARGEST_CHANNEL_PHASE:
            return WaterResidualCause.INSTRUMENT
        return WaterResidualCause(0)


def channel_phase(
    signal: NDArray[np.complex128],
    independent: Covariance,
    shared: Covariance,
    *,
    column: NDArray[np.complex128],
    shown: NDArray[np.bool_],
) -> ChannelPhase | None:
    """Estimate the targets' phase difference between channels; None for one channel.

    Errors of the pixels average out, those that they share do not. `column` is the
    part of `signal` from the water behind the target, NaN if unknown. A wrong distance
    or interval makes it wrong. Only the phase beyond that of the column is tested.
    """
    frequencies, channels = signal.shape[:2]
    detected = np.isfinite(signal) & (signal != 0) & np.isfinite(column)
    before = signal - column
    individual = phase_error(signal, independent, detected)
    common = phase_error(signal, shared, detected)
    detected &= (np.hypot(individual, common) < LARGEST_PHASE_ERROR) & shown
    phases = np.zeros(frequencies)
    significance = np.zeros(frequencies)
    tests = 0
    for index in range(frequencies):
        for first in range(channels):
            for second in range(first):
                pair = [first, second]
                both = detected[index, pair].all(axis=0)
                # Noise selects the few pixels with a known phase; their mean is biased.
                if both.sum() < max(2.0, _MOST_PIXELS * shown.sum()):
                    continue
                product, without = (
                    part[index, first][both] * part[index, second][both].conj()
                    for part in (signal, before)
                )
                phase = abs(float(np.median(np.angle(product))))
                bound = abs(float(np.median(np.angle(product * without.conj()))))
                random = np.linalg.norm(individual[index, pair][:, both], axis=0)
                systematic = np.linalg.norm(common[index, pair][:, both], axis=0)
                error = np.hypot(
                    np.median(systematic),
                    detection.ERROR_OF_MEDIAN * np.median(random) / np.sqrt(both.sum()),
                )
                tests += 1
                phases[index] = max(phases[index], phase)
                excess = max(0.0, phase - bound) / error
                significance[index] = max(significance[index], excess)
    if not tests:
        return None
    return ChannelPhase(
        phase=phases,
        significance=significance,
        probability=min(1.0, 2 * tests * float(ndtr(-significance.max()))),
    )


def phase_error_gain(
    target: NDArray[np.complex128],
    parts: Sequence[NDArray[np.float64] | float],
    *,
    strongest: NDArray[Any],
    shown: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Return the ratio of target phase error to instrument phase error.

    Leakage has the same voltage in all channels, whatever they see of the target. It is
    a fraction of the echo in the strongest channel, and independent between channels.
    `parts` are the shares of the channels in the target signal. Median of the pixels
    that show a target, for each frequency.
    """
    share = np.sqrt(np.sum([np.square(part) for part in parts], axis=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = share * np.abs(strongest) / np.abs(target)
    gain = np.where(shown & np.isfinite(gain), gain, np.nan)
    return np.array(
        [
            max(1.0, float(np.median(values[np.isfinite(values)])))
            if np.isfinite(values).any()
            else 1.0
            for values in gain
        ]
    )


@dataclass(frozen=True, kw_only=True)
class Disagreement:
    """Limits on the phase difference of two channels, at each frequency."""

    usual: NDArray[np.float64]
    """Median phase difference in standard errors, shape (modulation_frequency, 1,
    1)."""
    scatter: NDArray[np.float64]
    """Scatter about the median, at least 1, with the shape of `usual`."""
    limit: float
    """Least deviation of an outlier, in units of the scatter [1]."""
    rare: NDArray[np.bool_]
    """Whether outliers at a frequency are rare enough to be flagged, with the shape of
    `usual`."""

    @classmethod
    def of(cls, away: NDArray[np.float64]) -> Disagreement:
        """Estimate the limits from standardized phase differences."""
        usual, scatter = np.zeros((len(away), 1, 1)), np.ones((len(away), 1, 1))
        for index, deviations in enumerate(away):
            finite = deviations[np.isfinite(deviations)]
            if finite.size:
                usual[index] = np.median(finite)
                spread = np.median(np.abs(finite - usual[index])) / _HALF
                scatter[index] = max(spread, 1.0)
        size = _standardized(away, usual, scatter)
        far = size > _LEAST_DISAGREEMENT
        chance = largest_discovered(
            2 * ndtr(-size[far]), share=_BY_CHANCE, tests=int(np.isfinite(size).sum())
        )
        limit = min(_DISAGREE, -ndtri(chance / 2)) if chance > 0 else _DISAGREE
        often = (size >= limit).sum(axis=(1, 2), keepdims=True)
        counts = np.isfinite(size).sum(axis=(1, 2), keepdims=True)
        return cls(
            usual=usual, scatter=scatter, limit=limit, rare=often <= _RARE * counts
        )

    def where(self, away: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return the mask of phase differences that are outliers."""
        size = _standardized(away, self.usual, self.scatter)
        return np.asarray((size >= self.limit) & self.rare)


def _standardized(
    away: NDArray[np.float64],
    usual: NDArray[np.float64],
    scatter: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Standardize phase differences: deviation from the median over scatter."""
    return np.asarray(np.abs(away - usual) / scatter)


#: Least p-value of the residual of an explained phase difference [1].
PLAUSIBLE = 1e-3


def _product(
    first: NDArray[np.complex128],
    second: NDArray[np.complex128],
    uncertainty: Covariance,
    scale: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the inner product of two signals by pixel, with inverse covariance."""
    product = scale * (
        uncertainty.quadrature * first.real * second.real
        + uncertainty.in_phase * first.imag * second.imag
        - uncertainty.cross * (first.real * second.imag + first.imag * second.real)
    )
    summed: NDArray[np.float64] = product.sum(axis=(0, 1))
    return summed


def add(cube: xr.Dataset, flag: QualityFlag, where: NDArray[np.bool_]) -> xr.Dataset:
    """Add a quality flag to selected samples with a detected target."""
    return _with_bits(cube, "quality_flag", np.where(where, flag, 0))


def add_water_residual(cube: xr.Dataset, cause: NDArray[np.int8]) -> xr.Dataset:
    """Flag samples that failed a test of the water signal, and store the causes."""
    with_cause = _with_bits(cube, "water_residual_cause", cause)
    return add(with_cause, QualityFlag.WATER_RESIDUAL, cause != 0)


def _with_bits(cube: xr.Dataset, name: str, bits: NDArray[Any]) -> xr.Dataset:
    """Set bits in an integer variable of a cube, for samples with a detected target."""
    flag, old = cube["quality_flag"].values, cube[name]
    detected = (flag & (QualityFlag.MISSING | QualityFlag.NO_TARGET)) == 0
    new = np.where(detected, old.values | bits, old.values).astype(old.dtype)
    return cube.assign({name: old.copy(data=new)})


def phase_error(
    signal: NDArray[np.complex128], uncertainty: Covariance, detected: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the phase uncertainty of detected signals [rad]."""
    return detection.phase_uncertainty(
        np.where(detected & (signal != 0), signal, 1.0),
        in_phase_variance=np.where(detected, uncertainty.in_phase, 1.0),
        quadrature_variance=np.where(detected, uncertainty.quadrature, 1.0),
        covariance=np.where(detected, uncertainty.cross, 0.0),
    )
