"""Planes, circles, spheres and cylinders fitted to pixels, with their uncertainty."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from amulor.errors import CubeError
from amulor.imaging.common import own_variance
from amulor.imaging.measure.points import Points, points_of

Floats = NDArray[np.float64]
#: Parameters and positions to residuals of shape (kinds, n).
_Residuals = Callable[[Floats, Floats], Floats]

#: Largest number of fitted pixels; common errors dominate beyond it.
MOST_PIXELS = 1500
#: Least significance of excess scatter, in standard errors [1].
SURE = 4.0
#: Coverage factor of the least radius that is stated [1].
_COVERAGE = 2.0
#: Errors stated up to a fifth too small give so much per degree of freedom [1].
_MISFIT = 1.5
#: Most evaluations of the residuals; a shape that fits needs a tenth of them [1].
_EVALUATIONS = 6000
#: Directions in which the axis of a cylinder is looked for, and of them tried [1].
_AXES, _TRIED = 24, 3
#: Below this cosine of the incidence, distances along beams are cut short [1].
GRAZING = 0.2


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Shape fitted to pixels of a range image, with its uncertainty."""

    kind: str
    """Kind of shape: plane, circle, sphere or cylinder."""
    values: dict[str, float]
    """Parameters: lengths [m], components of unit vectors [1]."""
    uncertainties: dict[str, float]
    """Standard uncertainty of each parameter, errors shared by pixels included; NaN if
    the range errors are unknown."""
    residual: float
    """Root mean square distance of the points from the fitted shape [m]."""
    misfit: float
    """Chi-square per degree of freedom, about 1 if the shape is right. Where it is
    significantly larger, the noise in the uncertainties is enlarged by it [1]."""
    pixels: int
    """Number of fitted pixels [1]."""
    doubt: str = ""
    """Reason not to use the values, else empty: residuals exceed their errors, or the
    pixels do not constrain the radius."""


def plane(image: xr.Dataset, region: ArrayLike) -> Fit:
    """Fit a plane to a region of a range image.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    region : array_like of bool, shape (row, column)
        Pixels on the plane; unusable pixels are omitted.

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
    Least squares of the ranges, which contain all of the error. Distances from the
    plane instead would favor a plane along the beams if the noise is as large as the
    region.

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
    points = points_in(image, region, fewest=4, shape="a plane")
    middle, back, across, slopes = tangent_plane(points)

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
    return fitted("plane", points, residuals, [start], derived, displayed=apart)


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
        `radius`, `centre_x`, `centre_y`, `centre_z` and the normal, as for a plane.
        Pixels picked half their width off the rim shift the circle by as much, which
        the uncertainty does not include.

    Raises
    ------
    CubeError
        If there are fewer than four usable pixels, or they lie on a line.
    """
    points = points_in(image, region, fewest=4, shape="a circle")
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
    return fitted("circle", points, residuals, [start], derived)


def sphere(image: xr.Dataset, region: ArrayLike) -> Fit:
    """Fit a sphere to a region of a range image.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    region : array_like of bool, shape (row, column)
        Pixels on the sphere.

    Returns
    -------
    Fit
        `radius`, `centre_x`, `centre_y`, `centre_z`.

    Raises
    ------
    CubeError
        If there are fewer than five usable pixels, or they lie on a line.

    Notes
    -----
    Least squares of the ranges, which contain all of the error, on the side that beams
    reach. Near the outline, distances from the surface are used instead, which are less
    sensitive to noise. Curvature is fitted instead of radius, as that of a flat region
    is zero within its error. `doubt` states if the radius is below four standard
    errors.
    """
    points = points_in(image, region, fewest=5, shape="a sphere")
    bent = _Bent(points)

    def derived(values: Floats) -> dict[str, float]:
        at, normal = bent.placed(values)
        centre = at - normal / values[3]
        return {"radius": float(1 / abs(values[3])), **_named("centre", centre)}

    return fitted(
        "sphere", points, bent.ranges, [bent.start()], derived, displayed=bent.apart
    )


def cylinder(image: xr.Dataset, region: ArrayLike) -> Fit:
    """Fit a cylinder to a region of a range image.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    region : array_like of bool, shape (row, column)
        Pixels on the side of the cylinder.

    Returns
    -------
    Fit
        `radius`; `axis_x`, `axis_y`, `axis_z`, a unit vector; and `point_x`, `point_y`,
        `point_z`, the point of the axis nearest to the center of the pixels.

    Raises
    ------
    CubeError
        If there are fewer than six usable pixels, or they lie on a line.

    Notes
    -----
    As `sphere`. Distances from the surface alone would have a false minimum, a narrow
    cylinder along the beams, whose points no range error moves off its surface.

    Examples
    --------
    A flat board has no radius:

    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.open_water(samples.cube("ladder"))
    >>> image = imaging.range_image(target, polarization="VH")
    >>> region = np.zeros(image["slant_range"].shape, dtype=bool)
    >>> region[4:36, 44:56] = True
    >>> board = imaging.measure.cylinder(image, region)
    >>> print(board.doubt.partition(",")[0])
    radius not constrained by these pixels
    """
    points = points_in(image, region, fewest=6, shape="a cylinder")
    bent = _Bent(points)
    turns = np.arange(_AXES) * np.pi / _AXES
    starts = sorted(
        (bent.start(turn) for turn in turns),
        key=lambda values: float((bent.ranges(values, points.position) ** 2).sum()),
    )

    def derived(values: Floats) -> dict[str, float]:
        at, normal = bent.placed(values)
        axis = bent.axis(values, normal)
        centre = at - normal / values[3]
        point = centre + ((bent.middle - centre) @ axis) * axis
        return {
            "radius": float(1 / abs(values[3])),
            **_named("axis", axis * np.sign(axis[np.abs(axis).argmax()])),
            **_named("point", point),
        }

    return fitted(
        "cylinder", points, bent.ranges, starts[:_TRIED], derived, displayed=bent.apart
    )


class _Bent:
    """Sphere or cylinder, parametrized by normal and curvature near measured points.

    Parameters are two slopes and an offset of the tangent plane, the curvature, of a
    cylinder also the turn of its axis in that plane. A flat patch has curvature zero,
    where a radius has no limit.
    """

    def __init__(self, points: Points) -> None:
        self.points = points
        self.middle, self.back, self.across, self.slopes = tangent_plane(points)

    def placed(self, values: Floats) -> tuple[Floats, Floats]:
        """Surface point and normal for given parameters."""
        vector = self.back - values[:2] @ self.across
        normal = vector / np.linalg.norm(vector)
        return self.middle + values[2] * normal, normal

    def axis(self, values: Floats, normal: Floats) -> Floats:
        """Return the unit vector along the axis of a cylinder."""
        reference = self.across[0] - (self.across[0] @ normal) * normal
        reference = reference / np.linalg.norm(reference)
        perpendicular = np.cross(normal, reference)
        return np.asarray(
            np.cos(values[4]) * reference + np.sin(values[4]) * perpendicular
        )

    def _gradient(
        self, values: Floats, position: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Offsets from the surface point, its normal, and gradients of the distance."""
        at, normal = self.placed(values)
        away = position - at
        if len(values) > 4:
            axis = self.axis(values, normal)
            away = away - (away @ axis)[:, None] * axis
        outward = normal + values[3] * away
        return away, normal, outward

    def apart(self, values: Floats, position: Floats) -> Floats:
        """Distances of positions from the surface [m]."""
        away, normal, outward = self._gradient(values, position)
        square = values[3] * (away**2).sum(axis=1) + 2 * away @ normal
        return np.asarray(square / (np.linalg.norm(outward, axis=1) + 1))[None]

    def ranges(self, values: Floats, position: Floats) -> Floats:
        """Distances from the surface along the beams, limited at grazing incidence.

        On the far side they count more, since no beam gets there: otherwise a surface
        along the beams would explain any noise.
        """
        outward = self._gradient(values, position)[2]
        facing = -np.einsum("ij,ij->i", outward, self.points.direction)
        facing /= np.maximum(np.linalg.norm(outward, axis=1), 1e-12)
        cosine = (facing + np.hypot(facing, 2 * GRAZING)) / 2
        return np.asarray(self.apart(values, position) / cosine)

    def start(self, turn: float | None = None) -> Floats:
        """Start parameters: plane through the points, curvature by least squares."""
        slopes = self.slopes
        flat = np.array(
            [slopes[0], slopes[1], 0.0, 0.0, *([] if turn is None else [turn])]
        )
        away, normal, _ = self._gradient(flat, self.points.position)
        height = away @ normal
        square = (away**2).sum(axis=1) - height**2
        columns = np.stack([np.ones_like(square), -square / 2], axis=1)
        offset, curvature = np.linalg.lstsq(columns, height, rcond=None)[0]
        flat[2:4] = offset, curvature
        return flat


def tangent_plane(points: Points) -> tuple[Floats, Floats, Floats, Floats]:
    """Centroid, mean direction to the receiver, two axes across it, plane slopes."""
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
    return middle, back, across, slopes


def _principal(away: Floats) -> Floats:
    """Principal axes of points, the shortest last, right-handed."""
    axes = np.linalg.svd(away, full_matrices=False)[2]
    return np.asarray(axes * [[1], [1], [np.linalg.det(axes)]])


def _round(away: Floats) -> Floats:
    """Center and radius of a circle or sphere by linear least squares."""
    columns = np.concatenate([2 * away, np.ones((len(away), 1))], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(columns, (away**2).sum(axis=1), rcond=1e-10)
    if rank < columns.shape[1]:
        raise CubeError("the pixels lie too straight for a round shape; take more")
    centre = solution[:-1]
    radius = np.sqrt(max(solution[-1] + centre @ centre, 0.0))
    return np.append(centre, radius)


def _named(name: str, vector: Floats) -> dict[str, float]:
    return {f"{name}_{axis}": float(vector[at]) for at, axis in enumerate("xyz")}


def points_in(
    image: xr.Dataset,
    region: ArrayLike,
    *,
    fewest: int,
    shape: str,
    most: int = MOST_PIXELS,
) -> Points:
    """Usable pixels of a region as points, thinned evenly if more than `most`."""
    mask = np.asarray(region, dtype=bool)
    if mask.shape != image["slant_range"].shape:
        raise CubeError(
            f"the region has the shape {mask.shape}, the image "
            f"{image['slant_range'].shape}; they must agree"
        )
    there = mask & np.isfinite(image["slant_range"].values)
    row, column = np.nonzero(there & np.isfinite(own_variance(image)))
    if len(row) < fewest:
        unknown = there.sum() - len(row)
        raise CubeError(
            f"{shape} needs at least {fewest} usable pixels, the region has {len(row)}"
            + (
                f"; in {unknown} more the noise of the range is unknown"
                if unknown
                else ""
            )
        )
    step = int(np.ceil(np.sqrt(len(row) / most)))
    if step > 1:
        chosen = (row % step == 0) & (column % step == 0)
        row, column = row[chosen], column[chosen]
    return points_of(image, row, column)


def fitted(
    kind: str,
    points: Points,
    residuals: _Residuals,
    starts: list[Floats],
    derived: Callable[[Floats], dict[str, float]],
    *,
    displayed: _Residuals | None = None,
) -> Fit:
    r"""Least-squares fit of a shape to points, with its uncertainty.

    With weights of the noise, :math:`G = (J^T W J)^{-1} J^T W S` takes errors of ranges
    to those of parameters, S being how residuals change with ranges; the covariance is
    :math:`G C G^T` with all that pixels share.
    """
    sigma = np.sqrt(np.fmax(points.noise, 1e-4 * points.covariance.diagonal()))
    sigma = np.maximum(sigma, 1e-12)
    scale = float(np.median(sigma))

    def weighted(values: Floats) -> Floats:
        weighted_residuals: Floats = residuals(values, points.position) * (
            scale / sigma
        )
        return weighted_residuals.ravel()

    solution = min(
        (
            least_squares(
                weighted, start, method="lm", xtol=1e-12, max_nfev=_EVALUATIONS
            )
            for start in starts
        ),
        key=lambda result: float(result.cost),
    )
    if solution.status == 0:
        raise CubeError(f"no {kind} fits the pixels; choose another part or shape")
    jacobian = _slope(weighted, solution.x)
    normal = jacobian.T @ jacobian
    if np.linalg.cond(normal * np.outer(*[1 / np.sqrt(normal.diagonal())] * 2)) > 1e10:
        raise CubeError(f"the pixels do not settle a {kind}; take a larger part of it")
    inverse = np.linalg.inv(normal)
    change = _along(residuals, solution.x, points) * (scale / sigma)
    kinds, count = change.shape
    by_kind = jacobian.reshape(kinds, count, -1)
    gain = inverse @ np.einsum("knp,kn->pn", by_kind, change)
    # If the range errors are unknown, the misfit is relative to the noise.
    covariance_known = np.isfinite(points.covariance).all()
    scatter = points.covariance if covariance_known else np.diag(points.noise)
    # The trace of (S - J G) C (S - J G)^T, without matrices over all pairs of pixels.
    along = gain @ scatter
    expected = float(
        (change**2).sum(axis=0) @ scatter.diagonal()
        - 2 * np.einsum("knp,kn,pn->", by_kind, change, along, optimize=True)
        + np.trace(along @ gain.T @ normal)
    )
    squares = float(2 * solution.cost)
    freedom = max(kinds * count - len(solution.x), 1)
    misfit = squares / expected if expected > 0 else 1.0
    chance = 1 + SURE * float(np.sqrt(2 / freedom))
    excess = misfit - 1 if misfit > chance else 0.0
    covariance = gain @ (scatter + np.diag(excess * points.noise)) @ gain.T
    values = derived(solution.x)
    names = list(values)
    to_values = _slope(
        lambda at: np.array([*derived(at).values()]), solution.x, step=1e-6
    )
    of_values = ((to_values @ covariance) * to_values).sum(axis=1)
    errors = np.sqrt(np.maximum(of_values, 0.0)).tolist()
    scattered: dict[str, float] = dict(zip(names, errors, strict=True))
    plain = (displayed or residuals)(solution.x, points.position)
    return Fit(
        kind=kind,
        values=values,
        uncertainties=scattered
        if covariance_known
        else dict.fromkeys(names, float("nan")),
        residual=float(np.sqrt(np.mean((plain**2).sum(axis=0)))),
        misfit=misfit,
        pixels=count,
        doubt=_doubt(kind, misfit, chance, values, scattered),
    )


def _doubt(
    kind: str,
    misfit: float,
    chance: float,
    values: dict[str, float],
    uncertainties: dict[str, float],
) -> str:
    """Reason not to use the values of a fit, empty for a good fit."""
    # Pixels of a rim are picked by hand: their scatter is in the uncertainty.
    if kind != "circle" and misfit > max(chance, _MISFIT):
        return (
            f"does not fit this shape (chi-square {misfit:.3g} per degree of freedom)"
        )
    radius, error = values.get("radius", 0.0), uncertainties.get("radius", 0.0)
    if SURE * error > radius > 0:
        # Errors of the curvature are normal where those of the radius are not.
        least = radius / (1 + _COVERAGE * error / radius)
        return (
            f"radius not constrained by these pixels, above {least * 1e3:.3g} mm; "
            "take a larger part of the shape, or a plane"
        )
    return ""


def _slope(
    function: Callable[[Floats], Floats], at: Floats, *, step: float = 1e-6
) -> Floats:
    """Return a function's derivatives by central differences, (result, parameter)."""
    columns = []
    for number in range(len(at)):
        shift = np.zeros_like(at)
        shift[number] = step * max(1.0, abs(at[number]))
        difference = function(at + shift) - function(at - shift)
        columns.append(difference / (2 * shift[number]))
    return np.stack(columns, axis=1)


def _along(residuals: _Residuals, values: Floats, points: Points) -> Floats:
    """Return the derivative of each residual with respect to the range of its point."""
    step = 1e-6
    more = residuals(values, points.position + step * points.direction)
    less = residuals(values, points.position - step * points.direction)
    return np.asarray((more - less) / (2 * step))
