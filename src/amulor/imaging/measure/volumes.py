"""Volume between the surface of a range image and a plane, with its uncertainty."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.imaging.common import own_variance
from amulor.imaging.correlation import covariance
from amulor.imaging.edges import steps
from amulor.imaging.measure.figures import Measurement
from amulor.imaging.measure.fits import MOST_PIXELS, plane
from amulor.imaging.measure.points import rays_of

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]

#: Pixels with one of these are no part of a surface.
_OFF_SURFACE = QualityFlag.MIXED | QualityFlag.OUTLIER
#: Corners of a cell in both of its divisions into two triangles: 0 1 above 2 3.
_TRIANGLES = ((0, 1, 2), (1, 3, 2), (0, 1, 3), (0, 3, 2))


def volume(
    image: xr.Dataset,
    region: ArrayLike,
    *,
    base: ArrayLike,
    grid: tuple[Sequence[int], Sequence[int]] | None = None,
) -> Measurement:
    r"""Volume between a region of the surface and a plane fitted to another region.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    region : array_like of bool, shape (row, column)
        Pixels on the body and around it.
    base : array_like of bool, shape (row, column)
        Pixels on the plane on which the body stands. They may overlap the region.
    grid : tuple of two sequences of int, optional
        Rows and columns of the region's surface, ascending. Fewer of them make a coarse
        surface; by default every row and column.

    Returns
    -------
    Measurement
        Volume [m3], positive on the side of the plane towards the instrument.

    Raises
    ------
    CubeError
        If the base is no plane, or the region has no cell of four pixels.

    Notes
    -----
    The sum over triangles between neighboring pixels of
    :math:`-(n \cdot a) (h_1 + h_2 + h_3) / 3`: vector area a, heights h over the plane
    with the normal n. Missing, mixed and outlying pixels are interpolated along their
    row or column, whichever gap is shorter. The surface between pixels is straight, so
    a part that the body hides counts as part of it. The uncertainty contains the errors
    of all ranges, those of the plane included, and the sampling of edges: an edge may
    lie anywhere between two pixels, alike along a row or column of the scan.

    Examples
    --------
    The second board of the ladder over the plane of the first one:

    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.open_water(samples.cube("ladder"))
    >>> image = imaging.range_image(target, polarization="VH")
    >>> region, board = np.zeros((2, *image["slant_range"].shape), dtype=bool)
    >>> board[4:36, 2:14] = True
    >>> region[4:36, 2:34] = True
    >>> found = imaging.measure.volume(image, region, base=board)
    >>> print(f"{found.value * 1e6:.1f} cm3 +- {found.uncertainty * 1e6:.1f} cm3")
    19.4 cm3 +- 1.8 cm3
    """
    mask = np.asarray(region, dtype=bool)
    if mask.shape != image["slant_range"].shape:
        raise CubeError(
            f"the region has the shape {mask.shape}, the image "
            f"{image['slant_range'].shape}; they must agree"
        )
    row, column = np.nonzero(mask)
    if not len(row):
        raise CubeError("the region has no pixel; enlarge it")
    # The whole lines of the grid between the ends of the region.
    lines = [
        np.arange(at.min(), at.max() + 1) if grid is None else _between(grid[axis], at)
        for axis, at in enumerate((row, column))
    ]
    window = np.ix_(*lines)
    part = image.isel(row=lines[0], column=lines[1])
    surface = _Surface(part, mask[window])
    ground = _Ground(image, np.asarray(base, dtype=bool))
    value, by_point, by_plane = _sum(surface, ground)
    gradient = np.zeros(mask.shape)
    gradient[window] = surface.by_range(by_point)
    gradient += ground.by_range(by_plane)
    spacing = max(-(-int(np.ptp(line)) // max(len(line) - 1, 1)) for line in lines)
    random, shared = _variances(image, gradient, spacing=spacing)
    edges = surface.edge_variance(ground.normal)
    return Measurement(
        value=value,
        uncertainty=float(np.sqrt(max(random + shared, 0.0) + edges)),
        random=float(np.sqrt(random)),
        unit="m3",
        pixels=int(np.count_nonzero(gradient)),
    )


def _between(line: Sequence[int], places: Numbers) -> Numbers:
    """Rows or columns of a grid from the first to the last place."""
    at = np.asarray(line, dtype=np.intp)
    return np.asarray(at[(at >= places.min()) & (at <= places.max())])


class _Ground:
    """Plane of the base, and its derivatives with respect to the base ranges."""

    def __init__(self, image: xr.Dataset, base: NDArray[np.bool_]) -> None:
        fit = plane(image, base)
        if fit.doubt:
            raise CubeError(f"the base is no plane: {fit.doubt}")
        self.normal = np.array([fit.values[f"normal_{axis}"] for axis in "xyz"])
        self.offset = fit.values["offset"]
        self.across = np.linalg.svd(self.normal[None])[2][1:]
        self.shape = base.shape
        self.rows, self.columns = np.nonzero(
            base & np.isfinite(image["slant_range"].values)
        )
        step = int(np.ceil(np.sqrt(len(self.rows) / MOST_PIXELS)))
        chosen = (self.rows % step == 0) & (self.columns % step == 0)
        self.rows, self.columns = self.rows[chosen], self.columns[chosen]
        position, direction = rays_of(
            image,
            self.rows,
            self.columns,
            image["slant_range"].values[self.rows, self.columns],
        )
        noise = own_variance(image)[self.rows, self.columns]
        weight = 1 / np.maximum(noise, 1e-24)
        closeness = direction @ self.normal
        design = self.design(position)
        weighted = design * (weight / closeness**2)[:, None]
        self.gain = np.linalg.solve(
            design.T @ weighted, (weighted * closeness[:, None]).T
        )

    def design(self, position: Floats) -> Floats:
        """Return the design matrix of a plane fit: two slopes and an offset."""
        flat = position @ self.across.T
        return np.concatenate([flat, np.ones((len(flat), 1))], axis=1)

    def by_range(self, by_plane: Floats) -> Floats:
        """Propagate derivatives from plane parameters to base ranges."""
        gradient = np.zeros(self.shape)
        np.add.at(gradient, (self.rows, self.columns), by_plane @ self.gain)
        return gradient


class _Surface:
    """Points of a rectangle of pixels, the missing ones interpolated."""

    def __init__(self, image: xr.Dataset, mask: NDArray[np.bool_]) -> None:
        self.shape = mask.shape
        flags = image["quality_flag"].values
        ranges = image["slant_range"].values
        usable = np.isfinite(ranges) & ((flags & _OFF_SURFACE) == 0)
        self.weights, self.gaps = _interpolation(usable)
        filled = self.weights @ np.where(usable, ranges, 0.0).ravel()
        there = np.asarray(self.weights.sum(axis=1)).ravel() > 0
        row, column = np.indices(mask.shape).reshape(2, -1)
        self.position, self.direction = rays_of(image, row, column, filled)
        inside = (mask.ravel() & there).reshape(mask.shape)
        corners = np.arange(mask.size).reshape(mask.shape)
        views = [
            np.s_[:-1, :-1],
            np.s_[:-1, 1:],
            np.s_[1:, :-1],
            np.s_[1:, 1:],
        ]
        whole = np.logical_and.reduce([inside[view] for view in views])
        self.cells = np.stack([corners[view][whole] for view in views])
        if not self.cells.shape[1]:
            raise CubeError("the region has no cell of four pixels; enlarge it")
        self.whole = whole
        clean = np.where(usable, ranges, np.nan)
        self.steps = steps(clean, own_variance(image))
        self.usable = usable

    def by_range(self, by_point: Floats) -> Floats:
        """Propagate derivatives from points to measured ranges."""
        along = np.einsum("ik,ik->i", by_point, self.direction)
        return np.asarray(self.weights.T @ along).reshape(self.shape)

    def edge_variance(self, normal: Floats) -> float:
        """Variance of the volume due to unknown edge positions between pixels [m^6]."""
        heights = (self.position @ normal).reshape(self.shape)
        points = self.position.reshape(*self.shape, 3)
        total = 0.0
        for axis in (0, 1):
            level = np.moveaxis(heights, axis, 0)
            place = np.moveaxis(points, axis, 0)
            is_step = np.moveaxis(self.steps[1 - axis], axis, 0)[:-1]
            gap = np.moveaxis(self.gaps, axis, 0)
            wide = np.maximum(gap[1:], gap[:-1])
            near = is_step | (wide > 1)
            whole = np.moveaxis(self.whole, axis, 0)
            beside = np.zeros_like(near)
            beside[:, :-1] |= whole
            beside[:, 1:] |= whole
            height = np.where(near & beside, np.abs(np.diff(level, axis=0)), 0.0)
            along = np.diff(place, axis=0)
            sideways = np.gradient(place, axis=1)[:-1] if place.shape[1] > 1 else along
            area = np.abs(np.cross(along, sideways) @ normal)
            # One straight edge has one error along the line of pixels beside it. In a
            # gap of w pixels, w such lines share the height; their errors are one.
            line = (height * area * wide**1.5).sum(axis=1) / np.sqrt(12)
            total += float((line**2).sum())
        return total


def _interpolation(usable: NDArray[np.bool_]) -> tuple[csr_array, Floats]:
    """Weights of the measured ranges in each pixel, and width of the gap [pixel]."""
    low, high, gap = _neighbors(usable)
    low_down, high_down, gap_down = (part.T for part in _neighbors(usable.T))
    down = gap_down < gap
    row, column = np.indices(usable.shape)
    ends = (
        np.where(
            down, low_down * usable.shape[1] + column, row * usable.shape[1] + low
        ),
        np.where(
            down, high_down * usable.shape[1] + column, row * usable.shape[1] + high
        ),
    )
    shortest = np.where(down, gap_down, gap)
    place = np.where(down, row - low_down, column - low)
    share = np.divide(place, shortest, out=np.zeros(usable.shape), where=shortest > 0)
    known = np.isfinite(shortest)
    size = usable.size
    index = np.arange(size).reshape(usable.shape)[known]
    ends_known = np.concatenate([end[known] for end in ends])
    weights = np.concatenate([1 - share[known], share[known]])
    matrix = csr_array(
        (weights, (np.concatenate([index, index]), ends_known)), shape=(size, size)
    )
    return matrix, np.where(known, np.maximum(shortest, 1.0), 0.0)


def _neighbors(usable: NDArray[np.bool_]) -> tuple[Numbers, Numbers, Floats]:
    """Columns of the next usable pixels on both sides, and the gap between them."""
    size = usable.shape[1]
    column = np.broadcast_to(np.arange(size), usable.shape)
    low = np.maximum.accumulate(np.where(usable, column, -1), axis=1)
    backward = np.where(usable, column, size)[:, ::-1]
    high = np.minimum.accumulate(backward, axis=1)[:, ::-1]
    gap = np.where((low >= 0) & (high < size), (high - low).astype(float), np.inf)
    return np.maximum(low, 0), np.minimum(high, size - 1), gap


def _sum(surface: _Surface, ground: _Ground) -> tuple[float, Floats, Floats]:
    """Volume, and its derivatives with respect to the points and the plane."""
    by_point = np.zeros_like(surface.position)
    by_plane = np.zeros(3)
    total = 0.0
    for names in _TRIANGLES:
        corners = surface.cells[list(names)]
        place = surface.position[corners]
        height = place @ ground.normal - ground.offset
        mean = height.mean(axis=0)
        vector = np.cross(place[1] - place[0], place[2] - place[0]) / 2
        area = -vector @ ground.normal
        # Each of the two divisions of a cell counts by half.
        total += 0.5 * float(area @ mean)
        for k in range(3):
            opposite = place[(k + 1) % 3] - place[(k + 2) % 3]
            turned = np.cross(opposite, ground.normal) / 2
            change = (area[:, None] * ground.normal) / 3 - mean[:, None] * turned
            np.add.at(by_point, corners[k], 0.5 * change)
        design = ground.design(place.reshape(-1, 3)).reshape(*place.shape[:2], 3)
        by_plane -= 0.5 * (area[:, None] * design.mean(axis=0)).sum(axis=0)
        by_plane[:2] += 0.5 * mean @ (vector @ ground.across.T)
    return total, by_point, by_plane


def _variances(
    image: xr.Dataset, gradient: Floats, *, spacing: int
) -> tuple[float, float]:
    """Variances of the volume due to pixel noise, and due to correlated errors.

    Shared errors change slowly over the scan, so a pixel stands for its surroundings.
    """
    noise = own_variance(image)
    row, column = np.nonzero(gradient)
    values = gradient[row, column]
    random = float(values**2 @ noise[row, column])
    step = spacing * int(np.ceil(np.sqrt(len(row) / MOST_PIXELS)))
    block = (row // step) * gradient.shape[1] + column // step
    _, first, owner = np.unique(block, return_index=True, return_inverse=True)
    lumped = np.bincount(owner.ravel(), weights=values)
    mask = np.zeros(gradient.shape, dtype=bool)
    mask[row[first], column[first]] = True
    order = np.argsort(row[first] * gradient.shape[1] + column[first])
    matrix = covariance(image, mask)
    matrix[np.diag_indices(len(order))] -= noise[mask]
    weights = lumped[order]
    return random, float(weights @ matrix @ weights)
