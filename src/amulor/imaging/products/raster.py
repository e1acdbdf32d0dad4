"""Orthographic rasters of a surface: height, uncertainty, amplitude."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from amulor.errors import CubeError
from amulor.imaging.products import _kernels
from amulor.imaging.products.surface import Plane, Surface

Floats = NDArray[np.float64]

#: Cells of a raster, those between which are averaged counted too.
MOST_CELLS = 60_000_000
#: Errors grow by at most this factor where a surface is seen from its edge [1].
_LARGEST_GAIN = 20.0
#: Cells whose averages are worked out at a time.
_AT_ONCE = 2_000_000


@dataclass(frozen=True, kw_only=True)
class Raster:
    """Raster with cells of equal size over a drawing plane, upper row first."""

    height: Floats
    """Height towards the viewer above the frame's origin, NaN without surface, shape
    (rows, columns) [m]."""
    uncertainty: Floats
    """Combined standard uncertainty of the height, including stated errors of the pose
    [m]."""
    own: Floats
    """Part of the uncertainty from noise of the pixels in a cell [m]."""
    amplitude: Floats
    """Mean amplitude of the target signal [V]."""
    cell: float
    """Cell size [m]."""
    left: float
    """Coordinate of the left edge of the raster [m]."""
    top: float
    """Coordinate of the upper edge of the raster [m]."""
    plane: Plane
    """Drawing plane."""
    surface: Surface
    """Surface from which the raster was computed."""
    layers: dict[str, Floats]
    """Means of additional vertex values over each cell, by name."""

    @property
    def columns(self) -> Floats:
        """Coordinates of the column centers [m]."""
        count = self.height.shape[1]
        return np.asarray(self.left + self.cell * (np.arange(count) + 0.5))

    @property
    def rows(self) -> Floats:
        """Coordinates of the row centers, downwards in the raster [m]."""
        count = self.height.shape[0]
        return np.asarray(self.top - self.cell * (np.arange(count) + 0.5))


def raster(
    surface: Surface,
    plane: Plane,
    *,
    cell: float,
    layers: Mapping[str, ArrayLike] | None = None,
) -> Raster:
    r"""Raster of a surface in orthographic projection.

    Parameters
    ----------
    surface : Surface
        Vertices and triangles.
    plane : Plane
        Drawing plane, perpendicular to the direction of view.
    cell : float
        Size of a cell [m].
    layers : mapping of str to array_like, optional
        Further values of the vertices, shape (n,); NaN for missing values.

    Returns
    -------
    Raster
        Raster whose cell edges are whole multiples of the size, so that rasters of one
        frame coincide.

    Raises
    ------
    CubeError
        If the raster would be too large, or no cell holds a surface.
    ValueError
        If the size is not above 0 m.

    Notes
    -----
    The surface is linear in each triangle. Of several surfaces the one nearest to the
    viewer is used. A cell larger than the pixel spacing is the mean of points in it
    that are as dense as the pixels, which weights each pixel i by :math:`w_i`. With
    :math:`g_i = d_i \cdot N_i / (e \cdot N_i)`, the change of height with range (beam
    d, normal N, axis e towards the viewer),
    :math:`u^2 = \sum_i w_i^2 g_i^2 u_i^2 + (\sum_i w_i g_i c_i)^2` with the independent
    part u and the common part c of the range uncertainty, plus that of the pose.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> surface = imaging.products.surface(image)
    >>> plane = imaging.products.plane_of(surface.frame)
    >>> imaging.products.raster(surface, plane, cell=2e-3).height.shape
    (20, 49)
    """
    if not cell > 0:
        raise ValueError(f"cell must be above 0 m, got {cell:g} m")
    flat = surface.position @ plane.axes.T
    used = np.unique(surface.triangles)
    low, high = flat[used, :2].min(axis=0), flat[used, :2].max(axis=0)
    first, last = np.floor(low / cell), np.ceil(high / cell)
    columns, rows = (int(n) for n in np.maximum(last - first, 1))
    parts = max(1, round(cell / surface.spacing))
    if rows * columns * parts**2 > MOST_CELLS:
        raise CubeError(
            f"a raster of {columns} x {rows} cells of {cell * 1e3:g} mm, averaged over "
            f"{parts} x {parts} points each, is too large; at most {MOST_CELLS:.0e} "
            "points fit: take larger cells, a smaller scale, or fewer dots per inch"
        )
    left, top = float(first[0] * cell), float(last[1] * cell)
    fine = cell / parts
    corners = np.stack(
        [(flat[:, 0] - left) / fine, (top - flat[:, 1]) / fine, flat[:, 2]], axis=1
    )
    shape = (rows * parts, columns * parts)
    height = np.full(shape, np.nan)
    owner = np.full(shape, -1, dtype=np.int32)
    weight = np.zeros((*shape, 2), dtype=np.float64)
    _kernels.draw(corners, surface.triangles, height, owner, weight)
    extra = {
        name: np.asarray(values, dtype=float) for name, values in (layers or {}).items()
    }
    cells, layer_means = _averaged(
        surface, plane, flat[:, 2], (owner, weight), parts, list(extra.values())
    )
    if not np.isfinite(cells[0]).any():
        raise CubeError(
            f"no cell of {cell * 1e3:g} mm holds a surface seen from the {plane.side}; "
            "take smaller cells, or look from the other side"
        )
    return Raster(
        height=cells[0],
        own=cells[1],
        uncertainty=_combined(surface, plane, cells, left, top, cell),
        amplitude=cells[3],
        cell=cell,
        left=left,
        top=top,
        plane=plane,
        surface=surface,
        layers=dict(zip(extra, layer_means, strict=True)),
    )


def gains(surface: Surface, towards: Floats) -> Floats:
    """Displacement of vertices along an axis per unit of slant range."""
    along = surface.direction @ towards
    across = np.einsum("ij,ij->i", surface.direction, surface.normal)
    facing = surface.normal @ towards
    with np.errstate(invalid="ignore", divide="ignore"):
        gain = across / facing
    gain = np.where(np.isfinite(gain), gain, along)
    return np.asarray(np.clip(gain, -_LARGEST_GAIN, _LARGEST_GAIN))


def _averaged(
    surface: Surface,
    plane: Plane,
    height: Floats,
    ownership: tuple[NDArray[np.int32], Floats],
    parts: int,
    layers: list[Floats],
) -> tuple[Floats, list[Floats]]:
    """Height, noise, shared error and amplitude of the cells, and additional layers."""
    owner, weight = ownership
    rows, columns = owner.shape[0] // parts, owner.shape[1] // parts
    gain = gains(surface, plane.axes[2])
    noise, shared = (gain * surface.own) ** 2, gain * surface.shared
    means = np.full((4 + len(layers), rows, columns), np.nan)
    band = max(1, _AT_ONCE // max(1, owner.shape[1] * parts))
    for start in range(0, rows, band):
        stop = min(rows, start + band)
        fine = slice(start * parts, stop * parts)
        part = owner[fine]
        covered = np.nonzero(part >= 0)
        if not covered[0].size:
            continue
        cells = covered[0] // parts * columns + covered[1] // parts
        first, second = weight[fine][covered].T
        shares = np.concatenate([first, second, 1 - first - second])
        vertices = surface.triangles[part[covered]].T.ravel()
        matrix = sparse.csr_array(
            (shares, (np.tile(cells, 3), vertices)),
            shape=((stop - start) * columns, len(height)),
        )
        total = np.bincount(cells, minlength=matrix.shape[0]).astype(float)
        with np.errstate(invalid="ignore", divide="ignore"):
            inverse = np.where(total > 0, 1 / total, np.nan)
        square = matrix.power(2)
        values = np.stack(
            [
                matrix @ height * inverse,
                np.sqrt(square @ noise) * inverse,
                np.abs(matrix @ shared) * inverse,
                matrix @ surface.amplitude * inverse,
            ]
        )
        means[:4, start:stop] = values.reshape(4, stop - start, columns)
        for number, layer in enumerate(layers):
            there_is = np.isfinite(layer).astype(float)
            with np.errstate(invalid="ignore", divide="ignore"):
                mean = matrix @ np.nan_to_num(layer) / (matrix @ there_is)
            means[4 + number, start:stop] = mean.reshape(stop - start, columns)
    return means[:4], list(means[4:])


def _combined(
    surface: Surface, plane: Plane, cells: Floats, left: float, top: float, cell: float
) -> Floats:
    """Return the combined uncertainty of cell heights, including pose errors [m]."""
    variance = cells[1] ** 2 + cells[2] ** 2
    if surface.frame.pose is None:
        return np.asarray(np.sqrt(variance))
    rows, columns = cells[0].shape
    at = np.stack(
        [
            np.broadcast_to(left + cell * (np.arange(columns) + 0.5), (rows, columns)),
            np.broadcast_to(
                (top - cell * (np.arange(rows) + 0.5))[:, None], (rows, columns)
            ),
            cells[0],
        ],
        axis=-1,
    ).reshape(-1, 3)
    shifts = surface.frame.shared_errors(at @ plane.axes) @ plane.axes[2]
    return np.asarray(
        np.sqrt(variance + (shifts**2).sum(axis=0).reshape(rows, columns))
    )


#: A drawing with more levels is no drawing.
_MOST_LEVELS = 2000
#: Distance on both sides for the significance test of a line, in cells [1].
_ASIDE = 3
#: A line is drawn if its sides differ by so many standard errors. Neighboring cells
#: share pixels, which makes the true ones up to half as large again [1].
_SURE = 6.0


@dataclass(frozen=True, kw_only=True)
class Contour:
    """Contour line at one height."""

    level: float
    """Height of the line towards the viewer, above the frame's origin [m]."""
    points: Floats
    """Coordinates to the right and upwards along the line, shape (n, 2) [m]."""
    uncertainty: float
    """Median standard uncertainty of the height along the line [m]."""


def contours(raster: Raster, *, interval: float) -> list[Contour]:
    """Significant contour lines of a raster, at multiples of an interval.

    Parameters
    ----------
    raster : Raster
        Heights; lines end where there is no surface.
    interval : float
        Height difference of neighboring lines; levels are its whole multiples [m].

    Returns
    -------
    list of Contour
        Lines from the lowest level to the highest, without those that noise alone may
        cause, as on a terrace at the height of a level.

    Raises
    ------
    CubeError
        If there would be too many levels, or the surface crosses none.
    ValueError
        If the interval is not above 0 m.

    Notes
    -----
    A line is omitted unless the heights three cells to its left and right differ, in
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
    contour_lines = []
    for number in range(first, last + 1):
        level = number * interval
        for line in lines.lines(level):
            points = np.asarray(line, dtype=float)
            if len(points) > 1 and _is_significant(raster, points):
                sigma = _along(raster, points)
                contour_lines.append(
                    Contour(level=level, points=points, uncertainty=sigma)
                )
    return contour_lines


def _is_significant(raster: Raster, points: Floats) -> bool:
    """Whether the height difference across a contour line is significant."""
    step = np.gradient(points, axis=0)
    length = np.linalg.norm(step, axis=1, keepdims=True)
    unit = step / np.where(length > 0, length, 1.0)
    across = raster.cell * np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    for aside in range(_ASIDE, 0, -1):  # near a rim, as far as there is a surface
        sides = [_cells(raster, points + sign * aside * across) for sign in (1, -1)]
        pairs = np.unique(np.concatenate(sides, axis=1), axis=0)
        pairs = pairs[
            np.all((pairs >= 0) & (pairs < (2 * raster.height.shape)), axis=1)
        ]
        left, right = (pairs[:, 0], pairs[:, 1]), (pairs[:, 2], pairs[:, 3])
        apart = raster.height[left] - raster.height[right]
        finite = np.isfinite(apart)
        if finite.any():
            noise = raster.own[left] ** 2 + raster.own[right] ** 2
            error = float(np.sqrt(noise[finite].sum()))
            return bool(abs(float(apart[finite].sum())) > _SURE * error)
    return False


def _cells(raster: Raster, points: Floats) -> NDArray[np.intp]:
    """Row and column of the raster cells that contain points."""
    column = np.floor((points[:, 0] - raster.left) / raster.cell)
    row = np.floor((raster.top - points[:, 1]) / raster.cell)
    return np.stack([row, column], axis=1).astype(np.intp)


def _along(raster: Raster, points: Floats) -> float:
    """Median height uncertainty of the cells along a contour line."""
    row, column = _cells(raster, points).T
    rows, columns = raster.height.shape
    sigma = raster.uncertainty[row.clip(0, rows - 1), column.clip(0, columns - 1)]
    return float(np.nanmedian(sigma)) if np.isfinite(sigma).any() else float("nan")
