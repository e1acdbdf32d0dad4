"""Pixels of a range image as points in space, with the covariance of their ranges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from amulor.cube import UNUSABLE, QualityFlag
from amulor.errors import CubeError
from amulor.imaging.common import own_variance
from amulor.imaging.correlation import covariance
from amulor.imaging.observation import geometry_of

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Points:
    """Points in space, with range errors along their beams."""

    position: Floats
    """Coordinates (right, down, forward), shape (n, 3) [m]."""
    direction: Floats
    """Displacement of each point per unit of range, shape (n, 3) [1]."""
    covariance: Floats
    """Covariance of the slant ranges, shape (n, n) [m^2]."""
    noise: Floats
    """Part of the covariance's diagonal from noise of single pixels, shape (n,)
    [m^2]."""


def points_of(image: xr.Dataset, rows: ArrayLike, columns: ArrayLike) -> Points:
    """Pixels of a range image as points in space.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    rows, columns : array_like of int, shape (n,)
        Pixels in any order; a pixel may occur twice.

    Returns
    -------
    Points
        Points in this order. Beam directions and refractive indices are assumed to be
        as stated; an error of the group index is part of the range errors.

    Raises
    ------
    CubeError
        If a pixel is outside of the image or has no range, or if there are too many.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> points = imaging.measure.points_of(image, [20, 20], [8, 60])
    >>> print((points.position[:, 2] * 1e3).round(0))
    [1483. 1424.]
    """
    row, column = (np.atleast_1d(np.asarray(v, dtype=np.intp)) for v in (rows, columns))
    shape = image["slant_range"].shape
    inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    if not inside.all():
        first = int(np.argmin(inside))
        raise CubeError(
            f"pixel ({row[first]}, {column[first]}) is outside of the image of "
            f"{shape[0]} rows and {shape[1]} columns"
        )
    ranges = image["slant_range"].values[row, column]
    if not np.isfinite(ranges).all():
        first = int(np.argmin(np.isfinite(ranges)))
        raise CubeError(
            f"pixel ({row[first]}, {column[first]}) holds no range: "
            f"{_reason(image, int(row[first]), int(column[first]))}; pick another"
        )
    numbers, place = np.unique(row * shape[1] + column, return_inverse=True)
    mask = np.zeros(shape, dtype=bool)
    mask.flat[numbers] = True
    matrix = covariance(image, mask)[np.ix_(place, place)]
    position, direction = rays_of(image, row, column, ranges)
    return Points(
        position=position,
        direction=direction,
        covariance=matrix,
        noise=own_variance(image)[row, column],
    )


def rays_of(
    image: xr.Dataset, row: Numbers, column: Numbers, ranges: Floats
) -> tuple[Floats, Floats]:
    """Points at given ranges along the beams of pixels, and their beam directions."""
    beam = geometry_of(_only(image, row, column)).beam
    travelled = ranges - beam.length_before[0]
    direction = np.asarray(beam.direction[0])
    return beam.entry[0] + travelled[:, None] * direction, direction


def _only(image: xr.Dataset, row: Numbers, column: Numbers) -> xr.Dataset:
    """Beam origins and directions of selected pixels, as an image of one row."""
    names = ("origin_x", "origin_y", "origin_z", "azimuth", "elevation")
    return xr.Dataset(
        coords={
            "geometry": image["geometry"].variable,
            **{
                name: (("row", "column"), image[name].values[row, column][None])
                for name in names
                if name in image.coords
            },
        }
    )


def _reason(image: xr.Dataset, row: int, column: int) -> str:
    """Reason why a pixel has no range, from its quality flags."""
    flag = QualityFlag(int(image["quality_flag"].values[row, column]) & UNUSABLE)
    names = [str(bit.name).lower().replace("_", " ") for bit in flag]
    return ", ".join(names) or "not measured"


def reference_basis(
    azimuth: ArrayLike, elevation: ArrayLike, *, degree: int
) -> dict[str, Any]:
    r"""Polynomial basis of the correlated open-water reference errors.

    Parameters
    ----------
    azimuth, elevation : array_like, shape (row, column)
        Directions of the scan [rad].
    degree : int
        Degree of the polynomial.

    Returns
    -------
    dict
        `middle` and `factor` of the two angles, `powers` of the monomials, and
        `matrix`, which transforms the monomials of a pixel to a vector. The errors of
        two pixels correlate by the cosine of the angle between their vectors.

    Notes
    -----
    As `amulor.imaging.correlation.covariance`:
    :math:`\phi_i^T (\Phi^T \Phi)^{-1} \phi_j` over its diagonal, by the singular values
    of :math:`\Phi`. For programs that compute a covariance on their own, such as a
    saved page.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import imaging
    >>> azimuth, elevation = np.linspace(-1, 1, 4), np.zeros(4)
    >>> basis = imaging.measure.reference_basis(azimuth, elevation, degree=1)
    >>> basis["powers"]
    [[0, 0], [0, 1], [1, 0]]
    """
    middle, factor, axes = [], [], []
    for angles in (azimuth, elevation):
        values = np.asarray(angles, dtype=float)
        span = float(np.ptp(values))
        middle.append(float(values.mean()))
        factor.append(2 / span if span > 0 else 0.0)
        axes.append((values - middle[-1]) * factor[-1])
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    columns = np.stack([(axes[0] ** i * axes[1] ** j).ravel() for i, j in powers], 1)
    _, singular, turned = np.linalg.svd(columns, full_matrices=False)
    significant = singular > 1e-9 * singular[0]
    matrix = turned[significant].T / singular[significant]
    return {
        "middle": middle,
        "factor": factor,
        "powers": [list(power) for power in powers],
        "matrix": matrix.tolist(),
    }
