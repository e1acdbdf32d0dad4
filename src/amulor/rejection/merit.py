"""Figures of merit of each frequency and channel, without water subtraction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.cube import UNUSABLE
from amulor.optics import interference, ranging
from amulor.rejection import quality
from amulor.rejection.observation import Observation
from amulor.rejection.reference.before_target import water_before_target
from amulor.rejection.reference.presence import shows_target

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Merit:
    """Figures of merit, arrays over (modulation_frequency, polarization).

    Medians over the pixels that show a target; NaN where none does.
    """

    amplitude: Floats
    """Amplitude of the sum of target and water [V]."""
    water_amplitude: Floats
    """Amplitude of the water in front of the target [V]."""
    ratio: Floats
    """Signal-to-optical-noise ratio, eq. (54) [1]."""
    contrast: Floats
    """Contrast against the water, eq. (54) [1]."""
    noise: Floats
    """Random slant-range error, water fluctuation included [m]."""
    shift: Floats
    """Root-mean-square slant-range error caused by the water [m]."""
    usable: Floats
    """Fraction of pixels with a detected target [1]."""

    @property
    def error(self) -> Floats:
        """Root sum of squares of range noise and range shift [m]."""
        return np.hypot(self.noise, self.shift)


def merit(scan: Observation, *, interval: tuple[float, float] | None) -> Merit:
    """Return the figures of merit of every frequency and channel.

    The samples need open-water shots; errors are those of `open_water`.
    """
    water = water_before_target(scan, interval=interval)
    signal = scan.signal
    target = interference.target_signal(signal, water.signal)
    errors = scan.covariance + water.fluctuation
    flag = quality.flags(scan.saturated, target, errors + water.common).flag
    usable = ((flag & UNUSABLE) == 0) & (target != 0) & (signal != 0)
    usable &= shows_target(scan, water, interval=interval)[0]
    phase = quality.phase_error(signal, errors, usable)
    turned = interference.phase_error(
        np.where(usable, target, 1.0), np.where(usable, water.signal, 0.0)
    )
    to_range = ranging.range_per_phase(
        scan.frequency[:, None],
        group_index=float(scan.cube["geometry"].attrs["group_index"]),
    )
    amplitude = _median(np.abs(signal), usable)
    water_amplitude = _median(np.abs(water.signal), usable)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(water.signal == 0, np.inf, np.abs(signal / water.signal))
    contrast = interference.contrast(
        np.where(usable, signal, 1.0), np.where(usable, water.signal, 0.0)
    )
    return Merit(
        amplitude=amplitude,
        water_amplitude=water_amplitude,
        ratio=_median(ratio, usable),
        contrast=_median(contrast, usable),
        noise=to_range * _median(phase, usable),
        shift=to_range * np.sqrt(_mean(turned**2, usable)),
        usable=usable.mean(axis=(2, 3)),
    )


def _median(values: Floats, usable: NDArray[np.bool_]) -> Floats:
    median = np.full(values.shape[:2], np.nan)
    for index in np.ndindex(median.shape):
        if usable[index].any():
            median[index] = np.median(values[index][usable[index]])
    return median


def _mean(values: Floats, usable: NDArray[np.bool_]) -> Floats:
    count = usable.sum(axis=(2, 3)).astype(float)
    total = np.where(usable, values, 0.0).sum(axis=(2, 3))
    mean: Floats = np.divide(
        total, count, out=np.full(count.shape, np.nan), where=count > 0
    )
    return mean
