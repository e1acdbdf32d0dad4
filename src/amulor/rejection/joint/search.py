"""The most likely path of each pixel for a known water signal."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint._kernels import bundles
from amulor.rejection.joint._kernels import search as kernels
from amulor.rejection.joint._kernels.threads import spread
from amulor.rejection.joint.model import foreground
from amulor.rejection.joint.overlap.table import Table, from_pairs, to_pairs
from amulor.rejection.joint.pixels import (
    Pixels,
    echo_of,
    grid_of,
    phasors,
    places,
    samples,
)

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True)
class Estimates:
    """Most likely path of each pixel, and what belongs to it."""

    path: Floats
    """Optical path, out and back; not a number where none is possible [m]."""
    amplitude: Floats
    """Target amplitude in each channel, (pixel, channel) [V]."""
    cost: Floats
    """Sum of squared errors in units of their standard deviation [1]."""
    empty_cost: Floats
    """The same for open water without a target [1]."""
    explained: Floats
    """How much less `cost` is with a target, for one covariance of the samples [1]."""
    information: Floats
    """Inverse variance of the path with the water signal known [1/m^2]."""
    lower: Floats
    """How far the path may be shorter until `cost` has risen by 1 [m]."""
    upper: Floats
    """How far it may be longer [m]."""
    wrong: Floats
    """Probability that the path lies in another ambiguity interval [1]."""
    outlying: Floats
    """How much `cost` falls without the sample that disagrees most [1]."""
    next_outlying: Floats
    """How much it falls without the one that disagrees most but for that one [1]."""
    used: NDArray[np.intp]
    """Number of outputs that count, two for each sample."""
    which: NDArray[np.intp]
    """Sample that disagrees most, channel times frequencies plus frequency."""
    influence: Complex
    """Shift of the path per unit of in-phase + 1j * quadrature, as the real part of
    the product with its conjugate, (pixel, channel, frequency) [m/V]."""


def estimate(
    pixels: Pixels,
    weights: Floats,
    table: Table,
    *,
    gain: Complex,
    transfer: Complex,
    phase_per_path: Floats,
    fluctuation: float = 0.0,
    front: Complex | None = None,
    known: Floats | None = None,
) -> Estimates:
    """Return the most likely path of each pixel for a given water signal.

    Parameters
    ----------
    pixels : Pixels
        Samples.
    weights : ndarray
        Their inverse covariance without the fluctuation, from `weight`.
    table : Table
        Water signal against its end.
    gain : ndarray of complex, shape (channel, frequency)
        Strength of the water signal [V].
    transfer : ndarray of complex, shape (frequency,)
        What the echo of the target has beyond its delay [1].
    phase_per_path : ndarray, shape (frequency,)
        2 pi f / c_0 [rad/m].
    fluctuation : float, optional
        Relative random change of the water signal from sample to sample [1].
    front : ndarray of complex, shape (channel, frequency), optional
        Light from in front of all targets in the middle of the scan, which was taken
        off the samples and fluctuates as well [V].
    known : ndarray, optional
        Paths to start from instead of looking for the highest likelihood anywhere;
        leaves the limits of the profile and other intervals alone [m].

    Returns
    -------
    Estimates
        Arrays over the pixels.
    """
    count, channels, frequencies = pixels.signal.shape
    echo = echo_of(transfer, phase_per_path)
    path = grid_of(pixels, phase_per_path) if count else np.arange(2.0)
    out = bundles.Solutions(
        **{name: np.empty(count) for name in _SCALARS},
        used=np.empty(count, dtype=np.intp),
        which=np.empty(count, dtype=np.intp),
        amplitude=np.empty((count, channels)),
        influence=np.empty((count, channels, 2, frequencies)),
    )
    spread(
        kernels.estimate,
        count,
        samples(pixels, weights),
        places(pixels, table),
        bundles.Model(
            table.arrays,
            echo,
            to_pairs(gain),
            fluctuation,
            to_pairs(np.zeros_like(gain) if front is None else front),
            table.level,
        ),
        phasors(path, echo),
        np.full(count, np.nan) if known is None else known,
        out,
    )
    return Estimates(**out._asdict() | {"influence": from_pairs(out.influence)})


#: Numbers that every pixel has one of.
_SCALARS = (
    "path", "cost", "empty_cost", "explained", "information", "lower", "upper",
    "wrong", "outlying", "next_outlying",
)  # fmt: skip


def without_foreground(
    pixels: Pixels, table: Table, *, strength: Complex, phase_per_path: Floats
) -> Pixels:
    """Return samples less what the water sends from in front of all targets.

    Parameters
    ----------
    pixels : Pixels
        Samples.
    table : Table
        Water signal against its end.
    strength : ndarray of complex, shape (channel, frequency)
        That light in the middle of the scan [V].
    phase_per_path : ndarray, shape (frequency,)
        2 pi f / c_0 [rad/m].

    Returns
    -------
    Pixels
        The rest.
    """
    if not np.any(strength):
        return pixels
    light = foreground(pixels, table, phase_per_path)[:, None] * strength
    return replace(pixels, signal=np.where(pixels.usable, pixels.signal - light, 0.0))
