"""Phase drift of an instrument, from repeated readings of a standing reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["PhaseDrift"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Variances of a random walk over all readings, in variances of one reading [1].
_WALKS = np.logspace(-1.5, 7, 25)
#: Points of a drift in the attributes of a cube.
_MOST_POINTS = 100


@dataclass(frozen=True, kw_only=True)
class PhaseDrift:
    """Phase of a standing reference against time, shape (frequency, channel, reading).

    The readings of a channel are in the order of time.
    """

    time: Floats
    """Time of each reading [s]."""
    phase: Floats
    """Estimated phase minus `zero` [rad]."""
    uncertainty: Floats
    """Standard uncertainty of the phase, with that between two readings [rad]."""
    zero: Floats
    """Middle of smallest and largest phase, shape (frequency, channel) [rad]."""

    @classmethod
    def of(
        cls, signal: Complex, *, variance: Floats | float, time: Floats
    ) -> PhaseDrift:
        r"""Estimate a phase drift by smoothing; a missing reading is NaN.

        The drift is a random walk with the variance :math:`q \Delta t`. Kalman filter
        and Rauch-Tung-Striebel smoother give the phase for each of 25 rates q. The
        result is the mean over the rates, weighted by their likelihoods.
        """
        time = np.broadcast_to(time, signal.shape).astype(float)
        order = np.argsort(time, axis=-1)
        time = np.take_along_axis(time, order, axis=-1)
        variance = np.broadcast_to(variance, signal.shape)
        variance = np.take_along_axis(variance, order, axis=-1)
        signal = np.take_along_axis(signal, order, axis=-1)
        missing = ~np.isfinite(signal) | (signal == 0)
        mean = np.where(missing, 0, signal).sum(axis=-1, keepdims=True)
        phase = _filled(np.angle(signal * np.conj(mean)), missing)
        with np.errstate(divide="ignore", invalid="ignore"):
            noise = variance / np.abs(signal) ** 2
        noise = np.maximum(_filled(noise, missing), 1e-18)
        noise = np.where(missing, np.inf, noise)
        phase, square = _smoothed(np.unwrap(phase, axis=-1), noise, time)
        level = (phase.min(axis=-1) + phase.max(axis=-1)) / 2
        return cls(
            time=time,
            phase=phase - level[..., None],
            uncertainty=np.sqrt(square),
            zero=np.angle(mean[..., 0] * np.exp(1j * level)),
        )

    def corrected(self, signal: Complex, time: Floats) -> Complex:
        """Return samples without the drift, shape (frequency, channel, ...) [V]."""
        time = np.broadcast_to(time, signal.shape)
        turn = np.empty(signal.shape, dtype=complex)
        for at in np.ndindex(self.zero.shape):
            phase = np.interp(time[at], self.time[at], self.phase[at])
            turn[at] = np.exp(-1j * np.nan_to_num(phase))
        return signal * turn

    def attributes(self, frequency: Floats) -> dict[str, Any]:
        """Return the attributes of a cube that was corrected to `zero`.

        The phase of the instrument when its delay was calibrated is unknown. The
        difference from `zero` has an even distribution over the range of the drift.
        """
        count = self.time.shape[-1]
        number = np.unique(np.linspace(0, count - 1, _MOST_POINTS).astype(int))
        size = np.sqrt(np.mean(self.uncertainty**2, axis=-1))
        change = np.max(np.ptp(self.phase, axis=-1), axis=1)
        return {
            "reference_phase_rad": self.zero.ravel(),
            "reference_phase_uncertainty_rad": np.max(size, axis=1),
            "instrument_drift_uncertainty_s": change
            / (2 * np.pi * frequency * np.sqrt(12)),
            "reference_time_s": self.time[..., number].ravel(),
            "reference_drift_rad": self.phase[..., number].ravel(),
        }


def _filled(values: Floats, missing: NDArray[np.bool_]) -> Floats:
    """Return values with missing ones replaced by the nearest earlier one, or 0."""
    number = np.where(missing, 0, np.arange(values.shape[-1]))
    nearest = np.maximum.accumulate(number, axis=-1)
    filled = np.take_along_axis(np.where(missing, 0.0, values), nearest, axis=-1)
    return np.asarray(filled)


def _smoothed(phase: Floats, noise: Floats, time: Floats) -> tuple[Floats, Floats]:
    """Return smoothed phases and their variances; missing readings have infinite noise.

    A reading at a time between two readings has a further variance of q dt / 6.
    """
    count = phase.shape[-1]
    typical = np.nanmedian(np.where(np.isfinite(noise), noise, np.nan), axis=-1)
    gaps = np.diff(time, axis=-1)
    # A channel without time has equal intervals.
    middle = np.median(gaps, axis=-1, keepdims=True) if count > 1 else np.ones(1)
    gaps = np.where(middle > 0, gaps / np.where(middle > 0, middle, 1.0), 1.0)
    rate = np.multiply.outer(_WALKS / count, np.nan_to_num(typical, nan=1.0))
    shape = (*rate.shape, count)
    state, square = np.empty(shape), np.empty(shape)
    chance = np.zeros(rate.shape)
    state[..., 0] = phase[..., 0]
    # An unknown first phase: larger than any drift.
    square[..., 0] = np.minimum(noise[..., 0], 1e2)
    for k in range(1, count):
        before = square[..., k - 1] + rate * gaps[..., k - 1]
        total = before + noise[..., k]
        off = phase[..., k] - state[..., k - 1]
        gain = before / total
        state[..., k] = state[..., k - 1] + gain * off
        square[..., k] = before * (1 - gain)
        known = np.isfinite(total)
        with np.errstate(invalid="ignore"):
            chance -= np.where(known, np.log(total) + off**2 / total, 0.0) / 2
    for k in range(count - 2, -1, -1):
        before = square[..., k] + rate * gaps[..., k]
        gain = square[..., k] / before
        state[..., k] += gain * (state[..., k + 1] - state[..., k])
        square[..., k] += gain**2 * (square[..., k + 1] - before)
    weight = np.exp(chance - chance.max(axis=0))
    weight = (weight / weight.sum(axis=0))[..., None]
    mean = np.sum(weight * state, axis=0)
    between = rate[..., None] / 6
    variance = np.sum(weight * (square + between + (state - mean) ** 2), axis=0)
    return mean, variance
