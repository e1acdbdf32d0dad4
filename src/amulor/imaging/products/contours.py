"""Contour lines of a raster, with the uncertainty of their height."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.errors import CubeError
from amulor.imaging.products.raster import Raster

Floats = NDArray[np.float64]

#: A drawing with more levels is no drawing.
_MOST_LEVELS = 2000
#: Cells on either side at which a line must stand apart from noise [1].
_ASIDE = 3
#: A line is drawn if its sides differ by so many standard errors. Neighbouring cells
#: share pixels, which makes the true ones up to half as large again [1].
_SURE = 6.0


@dataclass(frozen=True, kw_only=True)
class Contour:
    """One line of equal height."""

    level: float
    """Height towards the viewer from the frame's origin [m]."""
    points: Floats
    """Right and up along the line, shape (n, 2) [m]."""
    uncertainty: float
    """Standard uncertainty of the height along it, the median [m]."""


def contours(raster: Raster, *, interval: float) -> list[Contour]:
    """Return the contour lines of a raster.

    Parameters
    ----------
    raster : Raster
        Heights; lines end where there is no surface.
    interval : float
        Difference of height of neighbouring lines; levels are its whole multiples [m].

    Returns
    -------
    list of Contour
        From the lowest level to the highest; without lines that noise alone may draw,
        as on a terrace that lies at a level.

    Raises
    ------
    CubeError
        If there would be too many levels, or the surface crosses none.
    ValueError
        If the interval is not above 0 m.

    Notes
    -----
    A line is left out unless the heights three cells to its left and right differ, in
    the mean along it, by more than 6 standard errors of their noise.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> surface = imaging.products.surface(image)
    >>> plane = imaging.products.plane_of(surface.frame)
    >>> raster = imaging.products.raster(surface, plane, cell=2e-3)
    >>> lines = imaging.products.contours(raster, interval=0.02)
    >>> sorted({round(line.level, 3) for line in lines})
    [-1.44, -1.42, -1.4]
    """
    import contourpy

    if not interval > 0:
        raise ValueError(f"interval must be above 0 m, got {interval:g} m")
    low, high = np.nanmin(raster.height), np.nanmax(raster.height)
    first, last = int(np.ceil(low / interval)), int(np.floor(high / interval))
    if last < first:
        raise CubeError(
            f"the surface goes from {low:.4f} to {high:.4f} m and crosses no multiple "
            f"of {interval * 1e3:g} mm; take a smaller interval"
        )
    if last - first + 1 > _MOST_LEVELS:
        raise CubeError(
            f"{last - first + 1} contour levels are too many, at most {_MOST_LEVELS}; "
            f"take an interval above {(high - low) / _MOST_LEVELS * 1e3:.3g} mm"
        )
    if min(raster.height.shape) < 2:
        raise CubeError("contours need two rows and two columns; take smaller cells")
    lines = contourpy.contour_generator(
        raster.columns,
        raster.rows,
        np.ma.masked_invalid(raster.height),
        corner_mask=False,
    )
    found = []
    for number in range(first, last + 1):
        level = number * interval
        for line in lines.lines(level):
            points = np.asarray(line, dtype=float)
            if len(points) > 1 and _stands_out(raster, points):
                sigma = _along(raster, points)
                found.append(Contour(level=level, points=points, uncertainty=sigma))
    return found


def _stands_out(raster: Raster, points: Floats) -> bool:
    """Return whether the surface is higher on one side of a line, noise apart."""
    step = np.gradient(points, axis=0)
    length = np.linalg.norm(step, axis=1, keepdims=True)
    unit = step / np.where(length > 0, length, 1.0)
    across = raster.cell * np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    for aside in range(_ASIDE, 0, -1):  # near a rim, as far as there is a surface
        sides = [_cells(raster, points + way * aside * across) for way in (1, -1)]
        pairs = np.unique(np.concatenate(sides, axis=1), axis=0)
        pairs = pairs[
            np.all((pairs >= 0) & (pairs < (2 * raster.height.shape)), axis=1)
        ]
        left, right = (pairs[:, 0], pairs[:, 1]), (pairs[:, 2], pairs[:, 3])
        apart = raster.height[left] - raster.height[right]
        there = np.isfinite(apart)
        if there.any():
            noise = raster.own[left] ** 2 + raster.own[right] ** 2
            error = float(np.sqrt(noise[there].sum()))
            return bool(abs(float(apart[there].sum())) > _SURE * error)
    return False


def _cells(raster: Raster, points: Floats) -> NDArray[np.intp]:
    """Return row and column of the cells that hold some points."""
    column = np.floor((points[:, 0] - raster.left) / raster.cell)
    row = np.floor((raster.top - points[:, 1]) / raster.cell)
    return np.stack([row, column], axis=1).astype(np.intp)


def _along(raster: Raster, points: Floats) -> float:
    """Return the median uncertainty of the height of the cells that a line crosses."""
    row, column = _cells(raster, points).T
    rows, columns = raster.height.shape
    sigma = raster.uncertainty[row.clip(0, rows - 1), column.clip(0, columns - 1)]
    return float(np.nanmedian(sigma)) if np.isfinite(sigma).any() else float("nan")
