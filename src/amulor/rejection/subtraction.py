"""Open-water subtraction: the target signal and each of its errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor._progress import part, tell
from amulor.cube import WaterResidualCause
from amulor.cube.tiles import Span
from amulor.rejection import quality
from amulor.rejection.covariance import Covariance, along
from amulor.rejection.observation import Observation
from amulor.rejection.reference.before_target import (
    DEPARTURE,
    Strength,
    WaterBeforeTarget,
    WaterFit,
    contradiction,
    strength_of,
    water_before_target,
)
from amulor.rejection.reference.late_phase import late_phase
from amulor.rejection.reference.presence import CutColumns, shows_target

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: At one frequency the column must be weaker than this, in parts of the target [1].
TOO_STRONG = 0.3


@dataclass(frozen=True, kw_only=True)
class SubtractionFit:
    """Scan-wide parameters of the open-water subtraction."""

    water: WaterFit
    """Scan-wide fit of the water in front of the targets."""
    cut: CutColumns | None
    """Open-water signal truncated at depths, as in a shadow; None without a survey."""
    usual_column: Floats | None
    """Median amplitude of the water column behind the targets, over
    (modulation_frequency, polarization) [V]; None where it is not needed."""
    strength: Strength
    """Relative change of the water from the shots to the scan."""
    disagreement: tuple[quality.Disagreement, ...]
    """Limits on the phase difference of each pair of channels."""
    channel_phase: quality.ChannelPhase | None
    """Phase difference of the target between channels; None with one channel."""
    phase_error_gain: Floats
    """Ratio of target phase error to phase error of the strongest channel, over
    (modulation_frequency, polarization) [1]."""


@dataclass(frozen=True, kw_only=True)
class Subtraction:
    """Result of open-water subtraction, arrays of the shape of the samples."""

    target: Complex
    """Target signal [V]."""
    water_signal: Complex
    """Water signal that was subtracted [V]."""
    residual: Complex | None
    """Estimated residual water signal, NaN where it is unknown; None if no survey
    describes the water [V]."""
    put_back: bool
    """Whether the water column behind the target was added back."""
    counting: Covariance
    """Covariance of the stated errors of the samples [V^2]."""
    fluctuation: Covariance
    """Covariance of the water fluctuation from sample to sample [V^2]."""
    reference: Covariance
    """Covariance from the fit of the shots, common to all pixels of a channel [V^2]."""
    column: Covariance
    """Covariance from the column behind the target, common to pixels and channels
    [V^2]."""
    change: Covariance
    """Covariance from drift and strength of the water, common to pixels and channels
    [V^2]."""
    has_target: NDArray[np.bool_]
    """Pixels with a detected target, shape (row, column)."""
    cause: NDArray[np.int8]
    """Failed tests of `WaterResidualCause` where target and water are
    indistinguishable, shape (row, column)."""
    tests: dict[str, NDArray[Any]]
    """Test statistics, named in `PIXEL_TESTS` and `SAMPLE_TESTS`."""
    outlying: NDArray[np.bool_]
    """Mask of samples whose phases differ between channels."""
    water: WaterBeforeTarget
    """Water signal in front of the targets, from shots and survey."""
    fit: SubtractionFit
    """Scan-wide parameters, for other rows of the scan."""

    @property
    def independent(self) -> Covariance:
        """Covariance of the errors that are independent between samples [V^2]."""
        return self.counting + self.fluctuation

    @property
    def of_water(self) -> Covariance:
        """Covariance of water-signal errors, shared by pixels and channels [V^2]."""
        return self.column + self.change

    @property
    def shared(self) -> Covariance:
        """Covariance of all errors that the pixels share [V^2]."""
        return self.reference + self.of_water


def subtract_open_water(
    scan: Observation,
    *,
    interval: tuple[float, float] | None = None,
    column_uncertainty: float | None = None,
    put_back: bool = True,
    fit: SubtractionFit | None = None,
    span: Span | None = None,
) -> Subtraction:
    """Subtract the open-water signal from checked samples, phasor by phasor.

    Options and errors are those of `amulor.rejection.open_water`. Without `fit`, what
    it holds is estimated from these samples, whose scan spans `span`.
    """
    _refuse_odd_fraction(column_uncertainty)
    with part(0.0, 0.7):
        water = water_before_target(
            scan,
            interval=interval,
            survey_is_right=column_uncertainty is not None,
            fit=None if fit is None else fit.water,
            span=span,
        )
    tell("where there are targets", 0.7)
    has_target, cut, chance = shows_target(
        scan, water, interval=interval, fit=None if fit is None else fit.cut
    )
    target, water_signal = water.difference, water.to_the_end
    counting = scan.covariance
    nothing = np.zeros(target.shape)
    column = Covariance(nothing, nothing, nothing)
    residual = None
    behind = np.zeros(target.shape, dtype=complex)
    usual_column = None if fit is None else fit.usual_column
    cause = np.zeros(target.shape[2:], dtype=np.int8)
    tests: dict[str, NDArray[Any]] = {"no_target_probability": chance}
    if water.hidden_fraction is not None:
        residual = -water.hidden_fraction * water_signal
        behind = -residual if put_back else np.full_like(behind, np.nan)
        if put_back:
            hidden_signal = np.nan_to_num(residual)
            if len(target) == 1:
                if usual_column is None:
                    usual_column = _usual_size(hidden_signal)
                ratio = _column_over_target(
                    target - hidden_signal, hidden_signal, usual_column
                )
                tests["column_over_target"] = ratio
                cause[ratio > TOO_STRONG] |= WaterResidualCause.STRONG_COLUMN
                behind[..., ratio > TOO_STRONG] = np.nan
            target, water_signal = target - hidden_signal, water_signal + hidden_signal
            column = (
                along(hidden_signal, column_uncertainty or 0.0)
                if water.hidden_error is None
                else water.hidden_error
            )
            residual = np.where(np.isnan(residual), residual, 0)
    tell("errors of the target signal", 0.85)
    change = along(water.drift * water.signal, 12**-0.5)
    # Only the water in front of the target fluctuates, drifts and departs; a column
    # that is not added back is no change of the water.
    hidden = 0.0 if put_back or residual is None else np.nan_to_num(residual)
    strength = None if fit is None else fit.strength
    if strength is None and scan.reads_in_turn:
        # Another distance at each reading looks like another water.
        strength = Strength(change=0.0, uncertainty=DEPARTURE)
    if strength is None:
        strength = strength_of(
            target - hidden,
            water.signal,
            counting + water.fluctuation,
            water.common + column + change,
            modulation_frequency=scan.frequency,
            path=water.path,
            late=late_phase(scan, water.path),
        )
    target = target - strength.subtracted * water.signal
    change = change + along(water.signal, strength.error)
    errors = counting + water.fluctuation + water.common + column
    similar, shape = quality.looks_like_water(
        scan.saturated, target, water.signal, errors
    )
    cause[similar] |= WaterResidualCause.WATER_SHAPE
    cause |= contradiction(strength, water.turbidity)
    if fit is not None:
        channel_phase = fit.channel_phase
    elif scan.reads_in_turn:
        channel_phase = None
    else:
        channel_phase = quality.channel_phase(
            target,
            counting + water.fluctuation,
            water.common + column + change,
            column=behind,
            shown=has_target,
        )
    if channel_phase is not None:
        cause |= channel_phase.cause
    if fit is not None:
        gain = fit.phase_error_gain
    else:
        strongest = np.nanmax(np.abs(np.nan_to_num(target)), axis=1)
        gain = np.stack(
            [
                quality.phase_error_gain(
                    target[:, c], [1.0], strongest=strongest, shown=has_target
                )
                for c in range(target.shape[1])
            ],
            axis=1,
        )
    outlying, disagreement, size = quality.channels_disagree(
        target,
        errors + change,
        shown=has_target,
        fit=None if fit is None else fit.disagreement,
    )
    tests |= shape
    if disagreement:
        tests["channel_disagreement"] = size
    return Subtraction(
        target=target,
        water_signal=water_signal + strength.subtracted * water.signal,
        residual=residual,
        put_back=put_back and residual is not None,
        counting=counting,
        fluctuation=water.fluctuation,
        reference=water.common,
        column=column,
        change=change,
        has_target=has_target,
        cause=cause,
        tests=tests,
        outlying=outlying,
        water=water,
        fit=SubtractionFit(
            water=water.fit,
            cut=cut,
            usual_column=usual_column,
            strength=strength,
            disagreement=disagreement,
            channel_phase=channel_phase,
            phase_error_gain=gain,
        ),
    )


def _column_over_target(target: Complex, column: Complex, usual: Floats) -> Floats:
    """Return the ratio of hidden-column signal to target signal for each pixel.

    The distance that cuts the column off comes from the signal after subtraction. With
    one frequency, either of target and column may explain it. Where the column is
    stronger than 0.3 (30 %, `TOO_STRONG`) of the target, it is the column
    that sets this distance, and a single frequency cannot contradict it. In a shadow
    the column may come out short: the median of the scan counts as well.
    """
    size = np.maximum(np.abs(column), usual[..., None, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio: Floats = np.fmax.reduce(size / np.abs(target), axis=(0, 1))
    return ratio


def _usual_size(column: Complex) -> Floats:
    """Return the median nonzero amplitude of hidden columns, (frequency, channel)."""
    return np.array(
        [
            [
                np.median(amplitudes[amplitudes > 0]) if amplitudes.any() else 0.0
                for amplitudes in channels
            ]
            for channels in np.abs(column)
        ]
    )


def _refuse_odd_fraction(column_uncertainty: float | None) -> None:
    if column_uncertainty is not None and not 0 <= column_uncertainty <= 1:
        raise ValueError(
            "column_uncertainty must lie between 0 and 1 (a fraction of the water "
            f"behind the target), got {column_uncertainty:g}"
        )
