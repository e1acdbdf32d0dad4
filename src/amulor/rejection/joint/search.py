"""The most likely path of each pixel for a known water signal."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint._kernels import search
from amulor.rejection.joint.frame import Table
from amulor.rejection.joint.model import near
from amulor.rejection.joint.pixels import Pixels, grid_of, parts, shares

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
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
    information: Floats
    """Inverse variance of the path with the water signal known [1/m^2]."""
    lower: Floats
    """How far the path may be shorter until `cost` has risen by 1 [m]."""
    upper: Floats
    """How far it may be longer [m]."""
    wrong: Floats
    """Probability that the path lies in another ambiguity interval [1]."""
    used: NDArray[np.intp]
    """Number of outputs that count, two for each sample."""
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
    wavenumber: Floats,
    known: Floats | None = None,
) -> Estimates:
    """Return the most likely path of each pixel for a given water signal.

    Parameters
    ----------
    pixels : Pixels
        Samples.
    weights : ndarray
        Their inverse covariance, from `weight`.
    table : Table
        Water signal against its end.
    gain : ndarray of complex, shape (channel, frequency)
        Strength of the water signal [V].
    transfer : ndarray of complex, shape (frequency,)
        What the echo of the target has beyond its delay [1].
    wavenumber : ndarray, shape (frequency,)
        Phase per path [1/m].
    known : ndarray, optional
        Paths to start from instead of looking for the highest likelihood anywhere;
        leaves the limits of the profile and other intervals alone [m].

    Returns
    -------
    Estimates
        Arrays over the pixels.
    """
    count, channels, frequencies = pixels.signal.shape
    grid = grid_of(pixels, wavenumber) if count else np.arange(2.0)
    out = np.empty((count, search.COLUMNS))
    amplitude = np.empty((count, channels))
    influence = np.empty((count, channels, 2, frequencies))
    search.estimate(
        parts(pixels.signal),
        np.ascontiguousarray(weights),
        parts(gain),
        shares(pixels, table),
        pixels.turned,
        parts(table.value),
        parts(table.slope),
        table.step,
        wavenumber,
        parts(transfer),
        grid,
        pixels.shortest,
        pixels.longest,
        pixels.depths,
        np.zeros(0) if known is None else known,
        known is not None,
        out,
        amplitude,
        influence,
    )
    return Estimates(
        path=out[:, search.PATH],
        amplitude=amplitude,
        cost=out[:, search.COST],
        empty_cost=out[:, search.EMPTY_COST],
        information=out[:, search.INFORMATION],
        lower=out[:, search.LOWER],
        upper=out[:, search.UPPER],
        wrong=out[:, search.WRONG],
        used=out[:, search.USED].astype(np.intp),
        influence=influence[..., 0, :] + 1j * influence[..., 1, :],
    )


def without_offset(
    pixels: Pixels, table: Table, *, offset: Complex, wavenumber: Floats
) -> Pixels:
    """Return samples less what the water sends from in front of all targets.

    Parameters
    ----------
    pixels : Pixels
        Samples.
    table : Table
        Water signal against its end.
    offset : ndarray of complex, shape (channel, frequency)
        That light in the middle of the scan [V].
    wavenumber : ndarray, shape (frequency,)
        Phase per path [1/m].

    Returns
    -------
    Pixels
        The rest.
    """
    if not np.any(offset):
        return pixels
    light = near(pixels, table, wavenumber)[:, None] * offset
    return replace(pixels, signal=np.where(pixels.usable, pixels.signal - light, 0.0))
