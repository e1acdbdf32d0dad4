"""Weights of readings at different times, with a path that changes at a rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ReadingWeights:
    """Weights of readings whose paths share an unknown rate with a normal prior."""

    precision: Floats
    """Inverse variance of each path, readings along the first axis [1/m^2]."""
    motion: Floats | None
    """Standard deviation of each path by the rate, with a sign; None at rest [m]."""
    weight: Floats
    """Weights of the paths in the most probable one, with a sum of 1 [1]."""
    information: Floats
    """Inverse variance of this path [1/m^2]."""
    rate_weight: Floats
    """Weights of the paths in the rate, over its standard deviation [1/m]."""

    @classmethod
    def of(cls, precision: Floats, motion: Floats | None) -> ReadingWeights:
        """Return the weights of readings with given errors."""
        total = precision.sum(axis=0)
        if motion is None:
            with np.errstate(invalid="ignore"):
                return cls(precision, None, precision / total, total, np.zeros(1))
        along = (precision * motion).sum(axis=0)
        spread = 1 + (precision * motion**2).sum(axis=0)
        # The sum over pairs, where the difference would cancel.
        information = (total + _pairs(precision, motion)) / spread
        with np.errstate(invalid="ignore"):
            weight = precision * (spread - along * motion) / spread / information
        rate_weight = (precision * motion - along * weight) / spread
        return cls(precision, motion, weight, information, rate_weight)

    def square(self, error: Floats) -> Floats:
        """Return chi-square of path errors, with the most probable rate."""
        total = np.sum(error**2 * self.precision, axis=0)
        if self.motion is None:
            return np.asarray(total)
        along = np.sum(self.precision * self.motion * error, axis=0)
        spread = 1 + np.sum(self.precision * self.motion**2, axis=0)
        return np.asarray(total - along**2 / spread)

    def without_rate(self, error: Floats) -> Floats:
        """Return path errors about the most probable rate [m]."""
        if self.motion is None:
            return error
        known = np.where(self.precision > 0, error, 0.0)
        return np.asarray(
            error - self.motion * np.sum(self.rate_weight * known, axis=0)
        )

    def scatter(self, error: Floats) -> Floats:
        """Return the variance of residuals by independent errors of the paths [m^2]."""
        sigma = np.where(self.precision > 0, error, 0.0)
        variance = []
        for k in range(len(sigma)):
            share = self.weight
            if self.motion is not None:
                share = share + self.motion[k] * self.rate_weight
            of_mean = np.sum((share * sigma) ** 2, axis=0)
            variance.append((1 - 2 * share[k]) * error[k] ** 2 + of_mean)
        return np.array(variance)


def _pairs(precision: Floats, motion: Floats) -> Floats:
    """Return the sum over pairs of readings of their weights and differences."""
    total = np.zeros(precision.shape[1:])
    for k in range(1, len(precision)):
        apart = (motion[k] - motion[:k]) ** 2
        total += precision[k] * np.sum(precision[:k] * apart, axis=0)
    return total
