"""Slow change of the strength of the water while a scan is measured."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.polynomial import legendre
from numpy.typing import NDArray

from amulor.cube import tiles
from amulor.rejection.covariance import times
from amulor.rejection.joint.pixels import Pixels

Floats = NDArray[np.float64]

#: Legendre's polynomials over the time of the scan that make up the change.
TRENDS = 3
#: Pixels below which no change is looked for.
FEWEST = 96


@dataclass(frozen=True, kw_only=True)
class Clock:
    """When a scan was measured."""

    rows: int
    """Rows of the scan."""
    columns: int
    """Columns of the scan."""
    stated: bool
    """Whether every pixel says its time; if not, they were measured row by row."""
    begin: float
    """Time of the first pixel [s], 0 where none is stated."""
    length: float
    """Time from the first to the last [s], or pixels."""


def clock_of(source: tiles.Source) -> Clock:
    """Return when a scan was measured.

    Parameters
    ----------
    source : Source
        Level `samples`.

    Returns
    -------
    Clock
        The same for whatever tiles the samples come in.
    """
    rows, columns = source.rows, source.columns
    row_by_row = Clock(
        rows=rows,
        columns=columns,
        stated=False,
        begin=0.0,
        length=float(max(rows * columns - 1, 0)),
    )
    first, last = np.inf, -np.inf
    for begin, end in tiles.bands(source):
        tile = source.tile(begin, end)
        if "time" not in tile:
            return row_by_row
        time = tile["time"].values.astype(float)
        if not np.isfinite(time).all():
            return row_by_row
        first, last = min(first, float(time.min())), max(last, float(time.max()))
    return replace(row_by_row, stated=True, begin=first, length=last - first)


def trends_of(
    cube: xr.Dataset, clock: Clock | None = None, *, row: int = 0, column: int = 0
) -> Floats:
    """Return the polynomials that make up the change, at the time of each pixel.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, a scan or a part of one. Without times the pixels are taken as
        measured row by row.
    clock : Clock, optional
        Of the scan; by default the cube is all of it.
    row, column : int, optional
        Where in the scan the cube begins.

    Returns
    -------
    ndarray, shape (pixel, trend)
        Between -1 and 1, of mean zero over equal times [1].
    """
    clock = clock_of(tiles.InMemory(cube)) if clock is None else clock
    shape = cube["azimuth"].shape
    if clock.stated:
        time = cube["time"].values.ravel().astype(float)
    else:
        first = np.arange(row, row + shape[0])[:, None] * clock.columns
        time = (first + np.arange(column, column + shape[1])).ravel().astype(float)
    if clock.rows * clock.columns < FEWEST or not clock.length > 0:
        return np.zeros((time.size, 0))
    place = 2 * (time - clock.begin) / clock.length - 1
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
    factor = 1 + times(pixels.trends, trend[:, None])[:, 0]
    return replace(
        pixels,
        interpolation=pixels.interpolation * factor[:, None],
        # By these the water, as it is then, changes with the coefficients.
        trends=pixels.trends / factor[:, None],
    )


def change_of(trend: Floats) -> float:
    """Return by how much the water has changed from first to last, relative [1]."""
    return float(2 * np.sum(trend[::2]))


def change_uncertainty(covariance: Floats, *, preferred: bool) -> float:
    """Return the standard uncertainty of that change.

    Parameters
    ----------
    covariance : ndarray, shape (trends, trends)
        Of the coefficients [1].
    preferred : bool
        Whether the samples prefer a change over none.

    Returns
    -------
    float
        Infinite where no change was looked for or none is preferred: a receiver that
        looks elsewhere may explain the samples as well [1].
    """
    if not len(covariance) or not preferred:
        return np.inf
    slope = np.where(np.arange(len(covariance)) % 2 == 0, 2.0, 0.0)
    return float(np.sqrt(max(float(slope @ covariance @ slope), 0.0)))
