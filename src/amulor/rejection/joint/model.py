"""Water signal and its derivatives at the paths of pixels, from tables."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.covariance import times
from amulor.rejection.joint._kernels import model as kernels
from amulor.rejection.joint._kernels.bundles import Signals
from amulor.rejection.joint._kernels.threads import spread
from amulor.rejection.joint.overlap.table import Table, from_pairs
from amulor.rejection.joint.pixels import Pixels, coefficients, places

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


def water_at(
    pixels: Pixels, path: Floats, table: Table, phase_per_path: Floats
) -> tuple[Floats, Complex, Complex]:
    """Return depth [m], water signal of unit strength, and its slope in the path.

    Parameters
    ----------
    pixels : Pixels
        Their places count.
    path : ndarray, shape (pixel,)
        Optical path; infinite for open water [m].
    table : Table
        Water signal against its end.
    phase_per_path : ndarray, shape (frequency,)
        2 pi f / c_0 [rad/m].

    Returns
    -------
    tuple of ndarrays
        Depth, signal [1] and slope [1/m], the latter over (pixel, frequency).
    """
    count, frequencies = len(pixels), phase_per_path.size
    out = Signals(
        np.empty(count),
        np.empty((count, 2, frequencies)),
        np.empty((count, 2, frequencies)),
    )
    spread(
        kernels.water_at, count, path, places(pixels, table), table.arrays,
        phase_per_path, out,
    )  # fmt: skip
    return out.depth, from_pairs(out.water), from_pairs(out.change)


def foreground(pixels: Pixels, table: Table, phase_per_path: Floats) -> Complex:
    """Return the signal of light that comes from in front of all targets.

    Parameters
    ----------
    pixels : Pixels
        Their places count.
    table : Table
        Water signal against its end.
    phase_per_path : ndarray, shape (frequency,)
        2 pi f / c_0 [rad/m].

    Returns
    -------
    ndarray of complex, shape (pixel, frequency)
        As strong as open water at frequency 0 is there [1].
    """
    level = times(coefficients(pixels, table), table.level[:, None])[:, 0]
    turn: Complex = np.exp(1j * pixels.offset[:, None] * phase_per_path)
    return level[:, None] * turn


def all_changes(
    pixels: Pixels, depth: Floats, water: Complex, table: Table, phase_per_path: Floats
) -> Complex:
    """Return the derivatives of the water signal by its shape and by its drift.

    Parameters
    ----------
    pixels : Pixels
        Their places and times count.
    depth : ndarray, shape (pixel,)
        Where the water ends, infinite for open water [m].
    water : ndarray of complex, shape (pixel, frequency)
        Water signal there [1].
    table : Table
        Water signal against its end.
    phase_per_path : ndarray, shape (frequency,)
        2 pi f / c_0 [rad/m].

    Returns
    -------
    ndarray of complex, shape (pixel, parameter, frequency)
        Derivatives [1].
    """
    changes = shape_changes(pixels, depth, table, phase_per_path)
    if not pixels.trends.shape[1]:
        return changes
    by_time = pixels.trends[:, :, None] * water[:, None]
    return np.concatenate([changes, by_time], axis=1)


def shape_changes(
    pixels: Pixels, depth: Floats, table: Table, phase_per_path: Floats
) -> Complex:
    """Return the derivatives of the water signal with respect to its shape.

    Parameters
    ----------
    pixels : Pixels
        Their places count.
    depth : ndarray, shape (pixel,)
        Where the water ends, infinite for open water [m].
    table : Table
        Water signal against its end.
    phase_per_path : ndarray, shape (frequency,)
        2 pi f / c_0 [rad/m].

    Returns
    -------
    ndarray of complex, shape (pixel, parameter, frequency)
        Derivatives [1].
    """
    shape = (len(pixels), len(table.change), phase_per_path.size)
    out = np.empty(shape, dtype=complex)
    spread(
        kernels.interpolate, len(pixels), depth, table.step,
        coefficients(pixels, table), table.change.view(float), out.view(float),
    )  # fmt: skip
    turn = np.exp(1j * pixels.offset[:, None] * phase_per_path)
    out *= turn[:, None, :]
    return out
