"""Covariances of in-phase and quadrature outputs, and error propagation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Samples that are worked on at once.
_BLOCK = 32_768


@dataclass(frozen=True)
class Covariance:
    """Covariance of in-phase and quadrature outputs, arrays of one shape [V^2]."""

    in_phase: Floats
    """Variance of the in-phase output."""
    quadrature: Floats
    """Variance of the quadrature output."""
    cross: Floats
    """Covariance of in-phase and quadrature output."""

    def __add__(self, other: Covariance) -> Covariance:
        """Return the covariance of a sum of independent errors."""
        return Covariance(
            self.in_phase + other.in_phase,
            self.quadrature + other.quadrature,
            self.cross + other.cross,
        )

    def without(self, other: Covariance) -> Covariance:
        """Return the difference of covariances, with negative variances set to 0."""
        return Covariance(
            np.maximum(self.in_phase - other.in_phase, 0.0),
            np.maximum(self.quadrature - other.quadrature, 0.0),
            self.cross - other.cross,
        )

    def scaled(self, factor: Floats | float) -> Covariance:
        """Return the covariance times a factor."""
        return Covariance(
            self.in_phase * factor, self.quadrature * factor, self.cross * factor
        )

    def turned(self, factor: Complex) -> Covariance:
        """Return the covariance of signals after multiplication by complex factors."""
        a, b = factor.real, factor.imag
        product = 2 * a * b * self.cross
        return Covariance(
            a**2 * self.in_phase + b**2 * self.quadrature - product,
            b**2 * self.in_phase + a**2 * self.quadrature + product,
            a * b * (self.in_phase - self.quadrature) + (a**2 - b**2) * self.cross,
        )

    def part(self, index: Any) -> Covariance:
        """Return the elements of the covariance arrays at an index."""
        return Covariance(
            self.in_phase[index], self.quadrature[index], self.cross[index]
        )

    def where(self, mask: NDArray[np.bool_], other: Covariance) -> Covariance:
        """Return the covariance where a mask is set, elsewhere the other one."""
        return Covariance(
            np.where(mask, self.in_phase, other.in_phase),
            np.where(mask, self.quadrature, other.quadrature),
            np.where(mask, self.cross, other.cross),
        )

    def mahalanobis(self, signal: Complex) -> Floats:
        """Return the squared Mahalanobis distance of a signal from zero [1]."""
        real, imaginary = signal.real, signal.imag
        determinant = self.in_phase * self.quadrature - self.cross**2
        product = (
            self.quadrature * real**2
            + self.in_phase * imaginary**2
            - 2 * self.cross * real * imaginary
        )
        # A signal without any error is infinitely far off zero, unless it is zero.
        certain = np.where(np.abs(signal) > 0, np.inf, 0.0)
        square: Floats = np.divide(
            product, determinant, out=certain, where=determinant > 0
        )
        return np.where(np.isfinite(signal), square, np.nan)


def along(signal: Complex, size: float | Floats) -> Covariance:
    """Return the covariance due to a random relative amplitude error of a signal."""
    return Covariance(
        (size * signal.real) ** 2,
        (size * signal.imag) ** 2,
        size**2 * signal.real * signal.imag,
    )


#: Rows of a matrix that are multiplied at once.
_TOGETHER = 64
#: Largest number of multiplications that are one product. OpenBLAS spreads larger ones,
#: from 2^18 on, over threads, which wait for each other longer than they work: in
#: products of 10^7, where another program has a processor, fourteen times as long.
_LARGEST = 2**17


def times(rows: Floats, matrix: Floats) -> Floats:
    """Return a matrix product with rounding independent of the number of rows.

    Libraries of linear algebra choose the order of their sums by the shape of what they
    are given; here that is always the same.
    """
    count = len(rows)
    together = max(1, min(_TOGETHER, _LARGEST // max(matrix.size, 1)))
    if count < together or count % together:
        full = np.zeros((-(-count // together) * together, rows.shape[1]))
        full[:count] = rows
        rows = full
    blocks = rows.reshape(-1, together, rows.shape[1])
    product: Floats = np.matmul(blocks, matrix)
    return product.reshape(-1, matrix.shape[1])[:count]


def isotropic(size: Floats) -> Covariance:
    """Return the covariance of equal, independent output errors of total `size`."""
    half = size**2 / 2
    return Covariance(half, half, np.zeros(half.shape))


def stacked(parts: list[Covariance], shape: tuple[int, ...]) -> Covariance:
    """Stack covariances by frequency and channel into arrays of shape `shape`."""
    return Covariance(
        *(
            np.array([getattr(part, name) for part in parts]).reshape(shape)
            for name in ("in_phase", "quadrature", "cross")
        )
    )


def phase_uncertainties(
    signal: Complex, terms: Mapping[str, Covariance]
) -> dict[str, NDArray[np.float32]]:
    """Return the phase uncertainty of a signal due to each error term [rad]."""
    flat = signal.reshape(-1)
    parts = {
        name: [
            np.broadcast_to(getattr(errors, output), signal.shape).reshape(-1)
            for output in ("in_phase", "quadrature", "cross")
        ]
        for name, errors in terms.items()
    }
    uncertainties = {name: np.empty(flat.size, dtype=np.float32) for name in terms}
    with np.errstate(divide="ignore", invalid="ignore"):
        # In blocks that stay in the cache: cubes are larger than it.
        for begin in range(0, flat.size, _BLOCK):
            block = slice(begin, begin + _BLOCK)
            real, imaginary = flat[block].real, flat[block].imag
            power = (real**2 + imaginary**2) ** 2
            by = (imaginary**2 / power, real**2 / power, -2 * real * imaginary / power)
            for name, outputs in parts.items():
                variance = by[0] * outputs[0][block]
                variance += by[1] * outputs[1][block]
                variance += by[2] * outputs[2][block]
                np.sqrt(np.maximum(variance, 0.0, out=variance), out=variance)
                uncertainties[name][block] = variance
    return {name: error.reshape(signal.shape) for name, error in uncertainties.items()}
