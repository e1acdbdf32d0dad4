"""Water signal and its derivatives at the paths of pixels, from tables."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint._kernels import model as kernels
from amulor.rejection.joint.frame import Table
from amulor.rejection.joint.pixels import Pixels, parts, shares

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


def water_at(
    pixels: Pixels, path: Floats, table: Table, wavenumber: Floats
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
    wavenumber : ndarray, shape (frequency,)
        Phase per path [1/m].

    Returns
    -------
    tuple of ndarrays
        Depth, signal [1] and slope [1/m], the latter over (pixel, frequency).
    """
    count = len(pixels)
    depth = np.empty(count)
    water = np.empty((count, 2, wavenumber.size))
    change = np.empty_like(water)
    kernels.water_at(
        path,
        pixels.shortest,
        pixels.longest,
        pixels.depths,
        table.step,
        shares(pixels, table),
        parts(table.value),
        parts(table.slope),
        pixels.turned,
        wavenumber,
        depth,
        water,
        change,
    )
    return (
        depth,
        water[:, 0] + 1j * water[:, 1],
        change[:, 0] + 1j * change[:, 1],
    )


def near(pixels: Pixels, table: Table, wavenumber: Floats) -> Complex:
    """Return the water signal of light that comes from the start of the water.

    Parameters
    ----------
    pixels : Pixels
        Their places count.
    table : Table
        Water signal against its end.
    wavenumber : ndarray, shape (frequency,)
        Phase per path [1/m].

    Returns
    -------
    ndarray of complex, shape (pixel, frequency)
        As strong as open water at frequency 0 is there [1].
    """
    level = shares(pixels, table) @ table.level
    turn: Complex = np.exp(1j * pixels.turned[:, None] * wavenumber)
    return level[:, None] * turn


def shape_changes(
    pixels: Pixels, depth: Floats, table: Table, wavenumber: Floats
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
    wavenumber : ndarray, shape (frequency,)
        Phase per path [1/m].

    Returns
    -------
    ndarray of complex, shape (pixel, parameter, frequency)
        Derivatives [1].
    """
    out = np.empty((len(pixels), len(table.change), wavenumber.size), dtype=complex)
    kernels.interpolate(depth, table.step, shares(pixels, table), table.change, out)
    turn = np.exp(1j * pixels.turned[:, None] * wavenumber)
    out *= turn[:, None, :]
    return out
