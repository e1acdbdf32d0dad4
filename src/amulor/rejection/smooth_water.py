"""Smooth water signal of a scan, estimated from lines in the plane of both outputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.covariance import Covariance, times

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Number of terms of a quadratic function of two coordinates.
TERMS = 6
#: Degree of the water signal in the direction, and powers of both coordinates.
_DEGREE = 4
_POWERS = [(i, n - i) for n in range(_DEGREE + 1) for i in range(n + 1)]
#: Expected sizes of terms by their degree, in parts of the expected water signal [1].
_EXPECTED = (1.0, 0.5, 0.5, 0.2, 0.1)
#: Expected size of the range term, in parts of the expected water signal [1].
_RANGE_PART = 0.1
#: Deviation of a line without weight, step by step, in standard errors [1].
_LIMITS = (30.0, 20.0, 12.0, 8.0, 6.0, 5.0, 4.0, 4.0, 4.0, 4.0, 4.0, 4.0)
#: Least share of information that is not due to noise of the phases [1].
_LEAST_SHARE = 0.85
#: Median of the square of a standard normal variable [1].
_MEDIAN_SQUARE = 0.4549
#: Smallest divisor.
_TINY = 1e-300


def quadratic(x: Floats, y: Floats) -> Floats:
    """Return the terms of a quadratic function of two coordinates, on the last axis."""
    return np.stack([np.ones_like(x), x, y, x**2, x * y, y**2], axis=-1)


@dataclass(frozen=True, kw_only=True)
class Field:
    """Extent of the directions of a scan, for functions of the direction."""

    middle: Floats
    """Azimuth and elevation of the middle of the scan [rad]."""
    half_span: Floats
    """Half the span of azimuth and elevation [rad]."""

    @classmethod
    def of(cls, azimuth: Floats, elevation: Floats) -> Field:
        """Return the extent of directions."""
        low, high = (
            np.array([float(limit(part)) for part in (azimuth, elevation)])
            for limit in (np.min, np.max)
        )
        return cls(
            middle=(low + high) / 2, half_span=np.maximum((high - low) / 2, 1e-12)
        )

    def coordinates(self, azimuth: Floats, elevation: Floats) -> tuple[Floats, Floats]:
        """Return the distances from the middle over half the span, from -1 to 1."""
        x = (azimuth - self.middle[0]) / self.half_span[0]
        y = (elevation - self.middle[1]) / self.half_span[1]
        return x, y

    def powers(self, azimuth: Floats, elevation: Floats) -> Floats:
        """Return the terms of a polynomial of the direction, of degree 4."""
        x, y = self.coordinates(azimuth, elevation)
        return np.stack([x**i * y**j for i, j in _POWERS], axis=-1)

    def terms(self, azimuth: Floats, elevation: Floats) -> Floats:
        """Return the terms of a quadratic function of the direction."""
        return quadratic(*self.coordinates(azimuth, elevation))


@dataclass(frozen=True, kw_only=True)
class Offsets:
    """Distances of lines from the origin, arrays over (row, column) of windows."""

    phase: Floats
    """Direction of the line [rad]."""
    offset: Floats
    """Water signal across the line [V]."""
    terms: Floats
    """Terms of the variance of the offset, on the last axis: a polynomial of the water
    signal along the line."""
    good: NDArray[np.bool_]
    """Lines that the fit uses."""


@dataclass(frozen=True, kw_only=True)
class SmoothWater:
    """Water signal: a polynomial of the direction of degree 4, and a range term.

    The light of a layer of water at the target is in phase with the target. Its
    integral over the range is a quarter of a turn off.
    """

    field: Field
    """Directions of the scan."""
    terms: Floats
    """Real terms, imaginary terms, and the term of the range, over
    (modulation_frequency, polarization, term) [V]."""
    covariance: Floats
    """Covariance of the terms, on the last two axes [V^2]."""
    misfit: Floats
    """Scatter of the lines over their variances, at least 1, over
    (modulation_frequency, polarization) [1]."""

    def before(
        self, signal: Complex, azimuth: Floats, elevation: Floats
    ) -> tuple[Complex, Covariance]:
        """Return the water signal in samples, and its covariance."""
        count = len(_POWERS)
        design = self.field.powers(azimuth, elevation).reshape(-1, count)
        water = np.zeros(signal.shape, dtype=complex)
        errors = np.zeros((3, *signal.shape))
        for plane in np.ndindex(signal.shape[:2]):
            terms = self.terms[plane][:, None]
            flat = times(design, terms[:count]) + 1j * times(design, terms[count:-1])
            total, of_range = signal[plane].reshape(-1, 1), 1j * self.terms[plane][-1]
            target = np.exp(1j * np.angle(total - flat))
            target = np.exp(1j * np.angle(total - flat - of_range * target))
            water[plane] = (flat + of_range * target).reshape(signal.shape[2:])
            none = np.zeros_like(design)
            real = np.concatenate([design, none, -target.imag], axis=1)
            imaginary = np.concatenate([none, design, target.real], axis=1)
            for k, (a, b) in enumerate(
                ((real, real), (imaginary, imaginary), (real, imaginary))
            ):
                product = (times(a, self.covariance[plane]) * b).sum(axis=1)
                errors[k][plane] = product.reshape(signal.shape[2:])
        return water, Covariance(*errors)


def fit_smooth_water(
    offsets: list[Offsets],
    sizes: list[float],
    *,
    azimuth: Floats,
    elevation: Floats,
    planes: tuple[int, ...],
    window: int,
) -> SmoothWater:
    """Fit a smooth water signal to the lines of each frequency and channel.

    `sizes` are the expected sizes of the water signal. Windows of `window` pixels, at
    the given directions, share samples.
    """
    field = Field.of(azimuth, elevation)
    design = field.powers(azimuth, elevation)
    fits = [
        _fit(part, design, size, window)
        for part, size in zip(offsets, sizes, strict=True)
    ]
    return SmoothWater(
        field=field,
        terms=np.stack([terms for terms, _, _ in fits]).reshape(*planes, -1),
        covariance=np.stack([errors for _, errors, _ in fits]).reshape(
            *planes, 2 * len(_POWERS) + 1, -1
        ),
        misfit=np.array([misfit for _, _, misfit in fits]).reshape(planes),
    )


def _fit(
    lines: Offsets, design: Floats, size: float, window: int
) -> tuple[Floats, Floats, float]:
    """Fit the terms of the water signal to the lines; return covariance and misfit.

    Both the offset and the phase of a line have errors, which are correlated. Their
    part in the products of the normal equations is subtracted. Lines that cross the
    edge of an object are outliers, and lose their weight.
    """
    expected = (
        np.array([_EXPECTED[i + j] for i, j in _POWERS] * 2 + [_RANGE_PART]) * size
    )
    fitted, covariance = np.zeros(len(expected)), np.diag(expected**2)
    good = lines.good
    if not good.any():
        return fitted, covariance, 1.0
    basis = np.concatenate([design[good], 1j * design[good]], axis=1)
    turned = basis * np.exp(-1j * lines.phase[good])[:, None]
    across = np.pad(turned.imag, ((0, 0), (0, 1)), constant_values=1.0) * expected
    along = np.pad(turned.real, ((0, 0), (0, 1))) * expected
    offset, parts = lines.offset[good], lines.terms[good]
    for limit in _LIMITS:
        water = along @ fitted
        variance = parts[:, 0] + parts[:, 1] * water + parts[:, 2] * water**2
        shared = parts[:, 1] / 2 + parts[:, 2] * water
        rest = offset - across @ fitted
        square = rest**2 / variance
        scale = max(1.0, float(np.median(square)) / _MEDIAN_SQUARE)
        kept = np.clip(1 - square / scale / limit**2, 0, 1) ** 2
        deviation = np.zeros(good.shape)
        deviation[good] = kept * rest / np.sqrt(variance)
        weight = kept / (variance * scale * _repetition(deviation, window))
        columns = across + (shared / variance * rest)[:, None] * along
        noise = weight * np.maximum(parts[:, 2] - shared**2 / variance, 0.0)
        information = (columns * weight[:, None]).T @ columns
        values, vectors = np.linalg.eigh(information)
        by_noise = (((along @ vectors) ** 2) * noise[:, None]).sum(axis=0)
        share = 1 - by_noise / np.maximum(values, _TINY)
        sure = share > _LEAST_SHARE
        gain = np.where(sure, 1 / (values * np.where(sure, share, 1.0) + 1), 0.0)
        slope = vectors.T @ (columns.T @ (weight * rest) - fitted)
        fitted = vectors @ (np.where(sure, vectors.T @ fitted, 0.0) + gain * slope)
        errors = np.where(sure, gain**2 * (values + 1), 1.0)
        covariance = (vectors * errors) @ vectors.T
    return fitted * expected, covariance * np.outer(expected, expected), scale


def _repetition(deviation: Floats, window: int) -> float:
    """Return the number of windows per independent window, from their deviations."""
    products = 0.0
    rows, columns = deviation.shape
    for i in range(min(window, rows)):
        for j in range(1 - window, window):
            if abs(j) < columns and (i > 0 or j > 0):
                first = deviation[i:, max(j, 0) : columns + min(j, 0)]
                second = deviation[: rows - i, max(-j, 0) : columns - max(j, 0)]
                products += float((first * second).sum())
    power = max(float((deviation**2).sum()), _TINY)
    return float(np.clip(1 + 2 * products / power, 1.0, window**2))
