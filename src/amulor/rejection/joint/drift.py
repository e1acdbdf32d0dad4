"""Slow change of the strength of the water while a scan is measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.polynomial import legendre
from numpy.typing import NDArray

from amulor.rejection.joint.pixels import Pixels

Floats = NDArray[np.float64]

#: Legendre's polynomials over the time of the scan that make up the change.
TRENDS = 3
#: Pixels below which no change is looked for.
FEWEST = 96


def trends_of(cube: xr.Dataset) -> Floats:
    """Return the polynomials that make up the change, at the time of each pixel.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`. Without times the pixels are taken as measured row by row.

    Returns
    -------
    ndarray, shape (pixel, trend)
        Between -1 and 1, of mean zero over equal times [1].
    """
    count = cube["azimuth"].size
    time = np.arange(count, dtype=float)
    if "time" in cube:
        stated = cube["time"].values.ravel().astype(float)
        if np.isfinite(stated).all():
            time = stated
    length = float(np.ptp(time))
    if count < FEWEST or not length > 0:
        return np.zeros((count, 0))
    place = 2 * (time - time.min()) / length - 1
    return np.asarray(legendre.legvander(place, TRENDS)[:, 1:])


def drifted(pixels: Pixels, trend: Floats) -> Pixels:
    """Return pixels whose water is as strong as it was at their time.

    Parameters
    ----------
    pixels : Pixels
        As they were made, with the polynomials at their time.
    trend : ndarray
        Coefficients of the polynomials; none where no change is looked for [1].

    Returns
    -------
    Pixels
        With the strength of the water in their place within the scan.
    """
    if not len(trend):
        return replace(pixels, trends=pixels.trends[:, :0])
    if not np.any(trend):
        return pixels
    factor = 1 + pixels.trends @ trend
    return replace(
        pixels,
        interpolation=pixels.interpolation * factor[:, None],
        # By these the water, as it is then, changes with the coefficients.
        trends=pixels.trends / factor[:, None],
    )


def change_of(trend: Floats) -> float:
    """Return by how much the water has changed from first to last, relative [1]."""
    return float(2 * np.sum(trend[::2]))
