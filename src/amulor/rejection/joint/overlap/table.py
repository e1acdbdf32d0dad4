"""The table of the water signal, and complex numbers as compiled loops take them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint._kernels.bundles import WaterTable

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True)
class Table:
    """Water signal of unit strength against the depth where the water ends.

    Strength 1 is 1 V of open water at frequency 0 in the middle of the scan.
    """

    step: float
    """Distance of the nodes of depth [m]."""
    value: Complex
    """Water signal, axes (component, node, frequency) [1]."""
    slope: Complex
    """Its derivative with respect to the depth [1/m]."""
    change: Complex
    """Derivative with respect to the parameters of the shape, one axis more [1]."""
    basis: Floats
    """How much of each component a direction of `Frame` has, (direction, component)."""
    level: Floats
    """Open water at frequency 0, by component; 1 in the middle of the scan [1]."""
    strength: float
    """Received per launched power behind strength 1, per backscatter [sr m]."""

    @cached_property
    def arrays(self) -> WaterTable:
        """The water signal as compiled loops take it."""
        return WaterTable(self.step, to_pairs(self.value), to_pairs(self.slope))


def to_pairs(values: Complex) -> Floats:
    """Return complex numbers as real and imaginary parts, the axis before the last."""
    return np.ascontiguousarray(np.stack([values.real, values.imag], axis=-2))


def from_pairs(values: Floats) -> Complex:
    """Return complex numbers from parts on the axis before the last."""
    pairs: Complex = values[..., 0, :] + 1j * values[..., 1, :]
    return pairs
