"""Surfaces of revolution, such as pottery: axis and profile with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import least_squares

from amulor.errors import CubeError
from amulor.imaging.measure.fits import (
    GRAZING,
    SURE,
    Fit,
    fitted,
    points_in,
    tangent_plane,
)
from amulor.imaging.measure.points import Points

Floats = NDArray[np.float64]

#: Directions of the axis that are tried across the view [1].
_DIRECTIONS = 36
#: Another direction counts as such from this angle on [rad].
_APART = np.radians(30)
#: Fewest pixels for a profile, and most before they are thinned [1].
_FEWEST, _MOST = 60, 3200
#: Free heights of a profile: distance in pixels, and largest number [1].
_PIXELS_APART, _MOST_KNOTS = 2.5, 45
#: Chi-square per pixel of a profile beyond which its spline is too smooth [1].
_LOCAL = 1.5
#: Heights at which a profile is stated [1].
_HEIGHTS = 81
#: Scatter around a surface of revolution, of its largest radius, that is not round [1].
_ROUND = 0.02
#: Share of the points behind the axis, which hides them, that is not round [1].
_BEHIND = 0.05
#: Pixels farther from the surface, in standard deviations, belong to other parts [1].
_OTHER = 5.0


@dataclass(frozen=True, kw_only=True)
class Revolution:
    """Surface of revolution fitted to pixels of a range image."""

    fit: Fit
    """Axis (`axis_x`, `axis_y`, `axis_z`, a unit vector upwards in the image) and the
    point of the axis nearest to the center of the pixels (`point_x`, ...)."""
    height: Floats
    """Heights along the axis above its point, ascending, shape (n,) [m]."""
    radius: Floats
    """Radius at each height, shape (n,) [m]."""
    uncertainty: Floats
    """Standard uncertainty of each radius, errors shared by pixels included; NaN if the
    range errors are unknown, shape (n,) [m]."""
    left_out: int
    """Number of pixels off the surface, such as handles, which the fit excludes [1]."""


def revolution(image: xr.Dataset, region: ArrayLike) -> Revolution:
    r"""Fit a surface of revolution to a region of a range image.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    region : array_like of bool, shape (row, column)
        Pixels of the object; unusable pixels are omitted.

    Returns
    -------
    Revolution
        Axis and profile.

    Raises
    ------
    CubeError
        If the region has fewer than 60 usable pixels, or does not determine an axis.

    Notes
    -----
    The profile is a cubic spline :math:`s(h)` of the radius over the height along the
    axis. The fit is by least squares of the ranges, as for `cylinder`. The distance of
    a point from the surface is :math:`(r - s(h)) / \sqrt{1 + s'(h)^2}`. Pixels more
    than five standard deviations off the surface are excluded, so that handles do not
    move the axis. Where an edge is sharper than the spline, the uncertainty of the
    radius includes the spread of the points. `fit.doubt` states that an object is not
    round, or that the pixels do not constrain its radius. An object with more than 5 %
    of the points behind the axis is not round.

    Examples
    --------
    A narrow flat board has no radius:

    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.open_water(samples.cube("ladder"))
    >>> image = imaging.range_image(target, polarization="VH")
    >>> region = np.zeros(image["slant_range"].shape, dtype=bool)
    >>> region[4:36, 44:56] = True
    >>> board = imaging.measure.revolution(image, region)
    >>> print(board.fit.doubt)
    radius not constrained by these pixels; take a larger part
    """
    points = points_in(
        image, region, fewest=_FEWEST, shape="a surface of revolution", most=_MOST
    )
    guess = _Turned(points, _axis_of(points))
    start, near = guess.robust()
    if near.sum() < _FEWEST:
        raise CubeError(
            f"only {int(near.sum())} of {len(near)} pixels lie on one surface of "
            f"revolution, which needs {_FEWEST}; choose a region of the round part"
        )
    chosen = _Turned(_subset(points, near), guess.placed(start)[1])
    fit = fitted(
        "surface of revolution",
        chosen.points,
        chosen.ranges,
        [chosen.start],
        chosen.derived,
        displayed=chosen.apart,
    )
    names = [f"radius_{number}" for number in range(_HEIGHTS)]
    radius, error = (
        np.array([values[name] for name in names])
        for values in (fit.values, fit.uncertainties)
    )
    unresolved = _unresolved(chosen.points, fit, chosen.heights, radius)
    return Revolution(
        fit=replace(
            fit,
            values={k: v for k, v in fit.values.items() if k not in names},
            uncertainties={
                k: v for k, v in fit.uncertainties.items() if k not in names
            },
            doubt=_doubt(fit, radius, error, _behind(chosen, fit)),
        ),
        height=chosen.heights,
        radius=radius,
        uncertainty=np.hypot(error, unresolved),
        left_out=int((~near).sum()),
    )


def _behind(turned: _Turned, fit: Fit) -> float:
    """Share of the points of a fit that lie beyond its axis [1]."""
    point = np.array([fit.values[f"point_{at}"] for at in "xyz"])
    away = turned.points.position - point
    return float(np.mean(away @ turned.back < 0))


def _doubt(fit: Fit, radius: Floats, error: Floats, behind: float) -> str:
    """Reason not to use a profile, empty if there is none."""
    widest = int(np.argmax(radius))
    if behind > _BEHIND:
        return f"not round: {behind:.0%} of the pixels lie behind the axis"
    if fit.residual > _ROUND * radius[widest] and fit.misfit > _LOCAL:
        return f"not round: pixels lie {fit.residual * 1e3:.2g} mm off (rms)"
    if SURE * error[widest] > radius[widest]:
        return "radius not constrained by these pixels; take a larger part"
    return ""


class _Turned:
    """Surface of revolution, parametrized near a start direction of its axis.

    Parameters are two slopes of the axis, its offsets across and along the view, and
    the radii at the knots of the profile.
    """

    def __init__(self, points: Points, axis: Floats) -> None:
        self.points = points
        self.middle, back, _, _ = tangent_plane(points)
        self.start_axis = axis
        self.back = back - (back @ axis) * axis
        self.back /= np.linalg.norm(self.back)
        self.across = np.cross(axis, self.back)
        height = (points.position - self.middle) @ axis
        knots = _knots(height, (points.position - self.middle) @ self.across)
        self.basis = make_interp_spline(knots, np.eye(len(knots)))
        self.heights = np.linspace(knots[0], knots[-1], _HEIGHTS)
        centre = _centre(points.position - self.middle, self.across, self.back, height)
        offsets = np.array([centre @ self.across, centre @ self.back])
        away = points.position - self.middle - centre
        radius = np.hypot(away @ self.across, away @ self.back)
        radii = np.linalg.lstsq(self.basis(height), radius, rcond=None)[0]
        self.start = np.concatenate([np.zeros(2), offsets, radii])

    def placed(self, values: Floats) -> tuple[Floats, Floats]:
        """Point and unit vector of the axis."""
        axis = self.start_axis + values[0] * self.across + values[1] * self.back
        axis = axis / np.linalg.norm(axis)
        point = self.middle + values[2] * self.across + values[3] * self.back
        return point, axis

    def _surface(
        self, values: Floats, position: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Radial distances from the surface, profile slopes, radial unit vectors."""
        point, axis = self.placed(values)
        away = position - point
        height = away @ axis
        radial = away - height[:, None] * axis
        radius = np.linalg.norm(radial, axis=1)
        radial = radial / np.maximum(radius, 1e-12)[:, None]
        profile = self.profile(values)
        return radius - profile(height), profile(height, 1), radial

    def profile(self, values: Floats) -> BSpline:
        """Radius as a spline of the height along the axis."""
        return BSpline(self.basis.t, self.basis.c @ values[4:], self.basis.k)

    def apart(self, values: Floats, position: Floats) -> Floats:
        """Distances of positions from the surface [m]."""
        off, slope, _ = self._surface(values, position)
        return np.asarray(off / np.hypot(1.0, slope))[None]

    def ranges(self, values: Floats, position: Floats) -> Floats:
        """Distances from the surface along the beams, limited at grazing incidence."""
        off, slope, radial = self._surface(values, position)
        normal = radial - slope[:, None] * self.placed(values)[1]
        normal /= np.hypot(1.0, slope)[:, None]
        facing = -np.einsum("ij,ij->i", normal, self.points.direction)
        cosine = (facing + np.hypot(facing, 2 * GRAZING)) / 2
        return np.asarray(off / np.hypot(1.0, slope) / cosine)[None]

    def robust(self) -> tuple[Floats, NDArray[np.bool_]]:
        """Parameters of a robust fit, and a mask of the pixels on the surface."""
        sigma = np.sqrt(
            np.fmax(self.points.noise, 1e-4 * self.points.covariance.diagonal())
        )

        def weighted(values: Floats) -> Floats:
            ranges: Floats = self.ranges(values, self.points.position)[0]
            return ranges / sigma

        # Coarse at first: a profile through handles is far off.
        values = self.start
        for limit in (30.0, 3.0):
            values = least_squares(
                weighted, values, loss="cauchy", f_scale=limit, max_nfev=30
            ).x
        residual = np.abs(weighted(values))
        spread = max(1.0, 1.4826 * float(np.median(residual)))
        return values, residual < _OTHER * spread

    def derived(self, values: Floats) -> dict[str, float]:
        """Direction and a point of the axis, and the radius at each height, by name."""
        point, axis = self.placed(values)
        radii = self.profile(values)(self.heights)
        return {
            **{f"axis_{name}": float(v) for name, v in zip("xyz", axis, strict=True)},
            **{f"point_{name}": float(v) for name, v in zip("xyz", point, strict=True)},
            **{f"radius_{number}": float(v) for number, v in enumerate(radii)},
        }


def _unresolved(points: Points, fit: Fit, heights: Floats, radius: Floats) -> Floats:
    """Spread of points around a profile near each height, in excess of noise [m].

    Edges and rims are sharper than the spline; the profile misses them by this spread.
    """
    axis, point = (
        np.array([fit.values[f"{name}_{at}"] for at in "xyz"])
        for name in ("axis", "point")
    )
    away = points.position - point
    height = away @ axis
    radial = away - height[:, None] * axis
    distance = np.linalg.norm(radial, axis=1)
    facing = np.einsum("ij,ij->i", radial, points.direction) / distance
    squares = (distance - np.interp(height, heights, radius)) ** 2
    noise = points.noise * np.maximum(facing**2, GRAZING**2)
    near = np.abs(heights[:, None] - height) < 2 * (heights[1] - heights[0])
    count = np.maximum(near.sum(axis=1), 1)
    excess = near @ squares / count - _LOCAL * (near @ noise) / count
    return np.asarray(np.sqrt(np.maximum(excess, 0.0)))


def _axis_of(points: Points) -> Floats:
    """Axis direction, across the view, for which circles at each height fit best."""
    middle, back, across, _ = tangent_plane(points)
    away = points.position - middle
    turns = np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
    trials = np.cos(turns)[:, None] * across[0] + np.sin(turns)[:, None] * across[1]
    misfits = np.array([_misfit(away, trial, back) for trial in trials])
    best = int(np.argmin(misfits))
    apart = np.abs(trials @ trials[best]) < np.cos(_APART)
    chance = 1 + 4 * np.sqrt(2 / len(away))
    if misfits[apart].min() < chance * misfits[best]:
        raise CubeError(
            "the pixels do not settle the axis of a surface of revolution: another "
            "direction fits them as well, as for a ball or a board; take a larger part"
        )
    axis = trials[best]
    return np.asarray(axis if axis[1] <= 0 else -axis)


def _misfit(away: Floats, axis: Floats, back: Floats) -> float:
    """Trimmed mean square of radial distances from the circle at each height [m^2]."""
    side = np.cross(axis, back)
    height = away @ axis
    centre = _centre(away, side, back, height)
    radius = np.hypot((away - centre) @ side, (away - centre) @ back)
    squares = (radius - _level_means(radius, height)) ** 2
    # Without the farthest tenth, such as handles.
    return float(np.mean(np.sort(squares)[: int(0.9 * len(squares))]))


def _knots(height: Floats, across: Floats) -> Floats:
    """Knots of the profile spline, only at heights with pixels."""
    extent = float(np.ptp(height))
    pixel = np.sqrt(extent * float(np.ptp(across)) / len(height))
    step = max(_PIXELS_APART * pixel, extent / (_MOST_KNOTS - 1))
    count = max(int(extent / step) + 1, 5)
    trial = np.linspace(height.min(), height.max(), count)
    nearest = np.abs(trial[:, None] - height).min(axis=1)
    return np.asarray(trial[nearest < (trial[1] - trial[0]) / 2])


def _levels(height: Floats) -> NDArray[np.intp]:
    """Level number of each height; all levels have equally many pixels."""
    count = int(np.clip(len(height) // 20, 3, 40))
    edges = np.quantile(height, np.linspace(0, 1, count + 1)[1:-1])
    # Equal heights may leave a level without a pixel.
    return np.unique(np.searchsorted(edges, height), return_inverse=True)[1]


def _level_means(values: Floats, height: Floats) -> Floats:
    """Median of values over the pixels of the same height level."""
    level = _levels(height)
    medians = [np.median(values[level == n]) for n in range(level.max() + 1)]
    return np.asarray(medians)[level]


def _centre(away: Floats, side: Floats, back: Floats, height: Floats) -> Floats:
    """Fit concentric circles, one per height level, and return their common center."""
    x, z = away @ side, away @ back
    level = _levels(height)
    columns = np.zeros((len(x), 2 + level.max() + 1))
    columns[:, 0], columns[:, 1] = 2 * x, 2 * z
    columns[np.arange(len(x)), 2 + level] = 1.0
    solution = np.linalg.lstsq(columns, x**2 + z**2, rcond=None)[0]
    return np.asarray(solution[0] * side + solution[1] * back)


def _subset(points: Points, chosen: NDArray[np.bool_]) -> Points:
    """Points that a mask selects."""
    return Points(
        position=points.position[chosen],
        direction=points.direction[chosen],
        covariance=points.covariance[np.ix_(chosen, chosen)],
        noise=points.noise[chosen],
    )
