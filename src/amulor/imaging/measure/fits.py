"""Planes, circles, spheres and cylinders fitted to pixels, with their uncertainty."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from amulor.errors import CubeError
from amulor.imaging.measure.points import Points, points_of

Floats = NDArray[np.float64]
#: Parameters and positions to residuals of shape (kinds, n).
_Residuals = Callable[[Floats, Floats], Floats]

#: More pixels than these tell no more, since what they share stays; they are thinned.
MOST_PIXELS = 1500
#: The scatter must stand out of chance by this many standard errors [1].
_SURE = 4.0
#: Directions in which the axis of a cylinder is looked for [1].
_AXES = 64


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A shape in space."""

    kind: str
    """plane, circle, sphere or cylinder."""
    values: dict[str, float]
    """What it is: lengths [m], parts of unit vectors [1]."""
    uncertainties: dict[str, float]
    """Standard uncertainty of each, the errors that pixels share included."""
    residual: float
    """Root mean square of what is left between the points and the shape [m]."""
    misfit: float
    """Its square over what the stated errors leave; about 1 if the shape is right.
    Where it is larger than chance makes it, the noise in the uncertainties is enlarged
    by it [1]."""
    pixels: int
    """How many pixels it was fitted to [1]."""


def plane(image: xr.Dataset, region: ArrayLike) -> Fit:
    """Fit a plane.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    region : array_like of bool, shape (row, column)
        Pixels that lie on it; unusable ones are left out.

    Returns
    -------
    Fit
        `normal_x`, `normal_y`, `normal_z` towards the instrument; `offset`, the
        distance of the plane from the origin of the axes along the normal; `tilt`,
        the angle of the normal to the backward axis [rad].

    Raises
    ------
    CubeError
        If the region has too few usable pixels, or they lie on a line.

    Notes
    -----
    Least squares of ranges, where all of the error is: distances from the plane would
    be the smallest of a plane along the beams where noise is as large as the region.

    Examples
    --------
    A board in milky water:

    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> region = np.zeros(image["slant_range"].shape, dtype=bool)
    >>> region[2:38, 42:58] = True
    >>> board = imaging.measure.plane(image, region)
    >>> board.pixels
    576
    >>> print(f"chi-square per degree of freedom {board.misfit:.0f}: water is left in")
    chi-square per degree of freedom 29: water is left in
    """
    points = _points(image, region, fewest=4, what="a plane")
    middle = points.position.mean(axis=0)
    back = -points.direction.mean(axis=0)
    back /= np.linalg.norm(back)
    across = np.linalg.svd(back[None])[2][1:]
    away = points.position - middle
    beside = away @ across.T
    spread = np.linalg.svd(beside, compute_uv=False)
    if spread[1] < 1e-9 * spread[0]:
        raise CubeError("the pixels lie on a line, through which many planes go")
    slopes = np.linalg.lstsq(beside, away @ back, rcond=None)[0]

    def normal(values: Floats) -> Floats:
        vector = back - values[:2] @ across
        return np.asarray(vector / np.linalg.norm(vector))

    def apart(values: Floats, position: Floats) -> Floats:
        return np.asarray((position - middle) @ normal(values) - values[2])[None]

    def residuals(values: Floats, position: Floats) -> Floats:
        return apart(values, position) / (points.direction @ normal(values))

    def derived(values: Floats) -> dict[str, float]:
        at = normal(values)
        sideways = float(np.hypot(at[0], at[1]))
        return {
            "normal_x": float(at[0]),
            "normal_y": float(at[1]),
            "normal_z": float(at[2]),
            "offset": float(middle @ at + values[2]),
            "tilt": float(np.arctan2(sideways, -at[2])),
        }

    start = np.append(slopes, 0.0)
    return _fitted("plane", points, residuals, [start], derived, shown=apart)


def circle(image: xr.Dataset, region: ArrayLike) -> Fit:
    """Fit a circle to pixels of its rim.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    region : array_like of bool, shape (row, column)
        Pixels on the rim.

    Returns
    -------
    Fit
        `radius`, `centre_x`, `centre_y`, `centre_z` and the normal, as of a plane. A
        pixel that is picked half its width off the rim moves the circle by as much:
        that is not in the uncertainty.

    Raises
    ------
    CubeError
        If there are fewer than four usable pixels, or they lie on a line.
    """
    points = _points(image, region, fewest=4, what="a circle")
    middle = points.position.mean(axis=0)
    axes = _principal(points.position - middle)
    axes = axes if axes[2, 2] <= 0 else axes * [[1], [-1], [-1]]
    flat = (points.position - middle) @ axes[:2].T
    guess = _round(flat)

    def placed(values: Floats) -> tuple[Floats, Floats]:
        vector = axes[2] + values[0] * axes[0] + values[1] * axes[1]
        return middle + values[2:5] @ axes, vector / np.linalg.norm(vector)

    def residuals(values: Floats, position: Floats) -> Floats:
        centre, normal = placed(values)
        off = (position - centre) @ normal
        inward = position - centre - off[:, None] * normal
        return np.stack([off, np.linalg.norm(inward, axis=1) - values[5]])

    def derived(values: Floats) -> dict[str, float]:
        centre, normal = placed(values)
        return {
            "radius": float(values[5]),
            **_named("centre", centre),
            **_named("normal", normal),
        }

    start = np.array([0.0, 0.0, guess[0], guess[1], 0.0, guess[2]])
    return _fitted("circle", points, residuals, [start], derived)


def sphere(image: xr.Dataset, region: ArrayLike) -> Fit:
    """Fit a sphere.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    region : array_like of bool, shape (row, column)
        Pixels on it.

    Returns
    -------
    Fit
        `radius`, `centre_x`, `centre_y`, `centre_z`.

    Raises
    ------
    CubeError
        If there are fewer than five usable pixels, or they lie in a plane.

    Notes
    -----
    Least squares of distances from the surface, not of ranges, so that pixels near the
    outline count no more than others; this adds less than the noise squared over the
    diameter to the radius.
    """
    points = _points(image, region, fewest=5, what="a sphere")
    middle = points.position.mean(axis=0)
    away = points.position - middle
    guess = _round(away)

    def residuals(values: Floats, position: Floats) -> Floats:
        reach = np.linalg.norm(position - middle - values[:3], axis=1)
        return np.asarray(reach - values[3])[None]

    def derived(values: Floats) -> dict[str, float]:
        return {"radius": float(values[3]), **_named("centre", middle + values[:3])}

    return _fitted("sphere", points, residuals, [guess], derived)


def cylinder(image: xr.Dataset, region: ArrayLike) -> Fit:
    """Fit a cylinder.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    region : array_like of bool, shape (row, column)
        Pixels on its side.

    Returns
    -------
    Fit
        `radius`; `axis_x`, `axis_y`, `axis_z`, a unit vector; and `point_x`,
        `point_y`, `point_z`, where the axis is nearest to the middle of the pixels.

    Raises
    ------
    CubeError
        If there are fewer than six usable pixels, or they lie in a plane.
    """
    points = _points(image, region, fewest=6, what="a cylinder")
    middle = points.position.mean(axis=0)
    away = points.position - middle
    starts: list[tuple[float, int, Floats]] = []
    frames: list[tuple[Floats, Floats]] = []
    for axis in _hemisphere(away):
        across = np.linalg.svd(axis[None])[2][1:]
        found = _round(away @ across.T)
        left = np.linalg.norm(away @ across.T - found[:2], axis=1) - found[2]
        starts.append((float(left @ left), len(frames), found))
        frames.append((axis, across))
    best = min(starts, key=lambda one: one[0])
    axis, across = frames[best[1]]

    def placed(values: Floats) -> tuple[Floats, Floats]:
        vector = axis + values[:2] @ across
        vector = vector / np.linalg.norm(vector)
        point = values[2:4] @ across
        return middle + point - (point @ vector) * vector, vector

    def residuals(values: Floats, position: Floats) -> Floats:
        point, vector = placed(values)
        reach = np.linalg.norm(np.cross(position - point, vector), axis=1)
        return np.asarray(reach - values[4])[None]

    def derived(values: Floats) -> dict[str, float]:
        point, vector = placed(values)
        return {
            "radius": float(values[4]),
            **_named("axis", vector * np.sign(vector[np.abs(vector).argmax()])),
            **_named("point", point),
        }

    start = np.concatenate([np.zeros(2), best[2]])
    return _fitted("cylinder", points, residuals, [start], derived)


def _principal(away: Floats) -> Floats:
    """Return the principal axes of points, the shortest last, right-handed."""
    axes = np.linalg.svd(away, full_matrices=False)[2]
    return np.asarray(axes * [[1], [1], [np.linalg.det(axes)]])


def _round(away: Floats) -> Floats:
    """Return centre and radius of a circle or sphere, algebraically."""
    columns = np.concatenate([2 * away, np.ones((len(away), 1))], axis=1)
    found, _, rank, _ = np.linalg.lstsq(columns, (away**2).sum(axis=1), rcond=1e-10)
    if rank < columns.shape[1]:
        raise CubeError("the pixels lie too straight for a round shape; take more")
    centre = found[:-1]
    radius = np.sqrt(max(found[-1] + centre @ centre, 0.0))
    return np.append(centre, radius)


def _hemisphere(away: Floats) -> Floats:
    """Return directions all around, and the principal ones of the points."""
    number = np.arange(_AXES) + 0.5
    rise, turn = number / _AXES, np.pi * (1 + 5**0.5) * number
    side = np.sqrt(1 - rise**2)
    spiral = np.stack([side * np.cos(turn), side * np.sin(turn), rise], axis=1)
    return np.concatenate([_principal(away), spiral])


def _named(name: str, vector: Floats) -> dict[str, float]:
    return {f"{name}_{axis}": float(vector[at]) for at, axis in enumerate("xyz")}


def _points(image: xr.Dataset, region: ArrayLike, *, fewest: int, what: str) -> Points:
    """Return the usable pixels of a region, evenly thinned if there are many."""
    mask = np.asarray(region, dtype=bool)
    if mask.shape != image["slant_range"].shape:
        raise CubeError(
            f"the region has the shape {mask.shape}, the image "
            f"{image['slant_range'].shape}; they must agree"
        )
    row, column = np.nonzero(mask & np.isfinite(image["slant_range"].values))
    if len(row) < fewest:
        raise CubeError(
            f"{what} needs at least {fewest} usable pixels, the region has {len(row)}"
        )
    step = int(np.ceil(np.sqrt(len(row) / MOST_PIXELS)))
    if step > 1:
        kept = (row % step == 0) & (column % step == 0)
        row, column = row[kept], column[kept]
    return points_of(image, row, column)


def _fitted(
    kind: str,
    points: Points,
    residuals: _Residuals,
    starts: list[Floats],
    derived: Callable[[Floats], dict[str, float]],
    *,
    shown: _Residuals | None = None,
) -> Fit:
    r"""Return the shape that is nearest to points, and its uncertainty.

    With weights of the noise, :math:`G = (J^T W J)^{-1} J^T W S` takes errors of ranges
    to those of parameters, S being how residuals change with ranges; the covariance is
    :math:`G C G^T` with all that pixels share.
    """
    sigma = np.sqrt(np.maximum(points.noise, 1e-4 * points.covariance.diagonal()))
    sigma = np.maximum(sigma, 1e-12)
    scale = float(np.median(sigma))

    def weighted(values: Floats) -> Floats:
        left: Floats = residuals(values, points.position) * (scale / sigma)
        return left.ravel()

    found = min(
        (least_squares(weighted, start, method="lm", xtol=1e-12) for start in starts),
        key=lambda one: float(one.cost),
    )
    jacobian = _slope(weighted, found.x)
    normal = jacobian.T @ jacobian
    if np.linalg.cond(normal * np.outer(*[1 / np.sqrt(normal.diagonal())] * 2)) > 1e10:
        raise CubeError(f"the pixels do not settle a {kind}; take a larger part of it")
    inverse = np.linalg.inv(normal)
    change = _along(residuals, found.x, points) * (scale / sigma)
    kinds, count = change.shape
    spread = np.zeros((kinds * count, count))
    for at in range(kinds):
        spread[at * count + np.arange(count), np.arange(count)] = change[at]
    gain = inverse @ jacobian.T @ spread
    left_over = spread - jacobian @ gain
    expected = float(np.einsum("ij,jk,ik->", left_over, points.covariance, left_over))
    squares = float(2 * found.cost)
    freedom = max(kinds * count - len(found.x), 1)
    misfit = squares / expected if expected > 0 else 1.0
    excess = misfit - 1 if misfit > 1 + _SURE * np.sqrt(2 / freedom) else 0.0
    matrix = points.covariance + np.diag(excess * points.noise)
    covariance = gain @ matrix @ gain.T
    values = derived(found.x)
    names = list(values)
    to_values = _slope(lambda at: np.array([*derived(at).values()]), found.x, step=1e-6)
    of_values = np.einsum("ij,jk,ik->i", to_values, covariance, to_values)
    plain = (shown or residuals)(found.x, points.position)
    return Fit(
        kind=kind,
        values=values,
        uncertainties=dict(
            zip(names, np.sqrt(np.maximum(of_values, 0.0)).tolist(), strict=True)
        ),
        residual=float(np.sqrt(np.mean((plain**2).sum(axis=0)))),
        misfit=misfit,
        pixels=count,
    )


def _slope(
    function: Callable[[Floats], Floats], at: Floats, *, step: float = 1e-6
) -> Floats:
    """Return derivatives by central differences, shape (results, parameters)."""
    columns = []
    for number in range(len(at)):
        shift = np.zeros_like(at)
        shift[number] = step * max(1.0, abs(at[number]))
        difference = function(at + shift) - function(at - shift)
        columns.append(difference / (2 * shift[number]))
    return np.stack(columns, axis=1)


def _along(residuals: _Residuals, values: Floats, points: Points) -> Floats:
    """Return how residuals change with the range of their own point."""
    step = 1e-6
    more = residuals(values, points.position + step * points.direction)
    less = residuals(values, points.position - step * points.direction)
    return np.asarray((more - less) / (2 * step))
