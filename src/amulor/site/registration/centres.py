"""Centers of targets in a scan: spheres, discs, checkerboards, picked points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import OptimizeResult, least_squares

from amulor.errors import CubeError
from amulor.site.description import (
    CheckerboardTarget,
    DiscTarget,
    PointTarget,
    SphereTarget,
)
from amulor.site.registration.network import Centre
from amulor.site.registration.surface import ScanSurface

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Seen = SphereTarget | DiscTarget | CheckerboardTarget | PointTarget

#: Least cosine of the angle of incidence on a sphere: beyond, beams graze it [1].
_STEEP = 0.5
#: Smallest number of pixels of a target [1].
_FEWEST = 12
#: Largest distance of a point of a target, in standard deviations [1].
_NEAR = 4.0


def centre_of(
    target: Seen, surface: ScanSurface, image: xr.Dataset, row: int, column: int
) -> tuple[Centre, Flags]:
    """Return the center of a target in a scan, and the mask of its pixels.

    Ranges are compared with those of the shape along the beams, so that noise does not
    bias a sphere towards the instrument. An error of the radius moves the center along
    the line of sight, and is common to all scans of the target.
    """
    find: dict[type, Callable[..., tuple[Centre, Flags]]] = {
        SphereTarget: _sphere,
        DiscTarget: _disc,
        CheckerboardTarget: _checkerboard,
        PointTarget: _point,
    }
    return find[type(target)](target, surface, image, (row, column))


def _at(surface: ScanSurface, place: tuple[int, int], name: str) -> Floats:
    """Return the point of a picked pixel, or of the nearest pixel with a range [m]."""
    row, column = place
    near = np.zeros(surface.usable.shape, dtype=bool)
    near[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3] = True
    candidates = np.argwhere(near & surface.usable)
    if not len(candidates):
        raise CubeError(
            f"target {name!r} in scan {surface.name!r}: no pixel near ({row}, {column})"
            " has a range; pick one on the target, for example with amulor view"
        )
    best = candidates[np.argmin(((candidates - place) ** 2).sum(axis=1))]
    return np.asarray(surface.position[best[0], best[1]])


def _few(target: Seen, surface: ScanSurface, count: int) -> CubeError:
    return CubeError(
        f"target {target.name!r} in scan {surface.name!r}: {count} pixels lie on it, "
        f"at least {_FEWEST} are needed; scan it finer, or look at its place and size"
    )


def _centre(
    target: Seen,
    surface: ScanSurface,
    position: Floats,
    noise: Floats,
    gain: Floats,
    pixels: Flags,
    others: dict[str, Floats] | None = None,
) -> Centre:
    """Return the center of a target, with shared errors propagated from its pixels."""
    shapes = surface.shared.shapes[:, pixels]
    shared = {
        key: np.asarray(gain @ shape)
        for key, shape in zip(surface.shared.keys, shapes, strict=True)
    }
    if surface.motion is not None:
        numbers = np.flatnonzero(pixels)
        centres = np.broadcast_to(position, (len(numbers), 3))
        moved = surface.moved(numbers, centres).mean(axis=1)
        shared |= dict(zip(surface.motion.keys, moved, strict=True))
    return Centre(
        target=target.name,
        scan=surface.name,
        position=position,
        covariance=noise,
        shared=shared | (others or {}),
    )


def _sphere(
    target: SphereTarget, surface: ScanSurface, _: xr.Dataset, place: tuple[int, int]
) -> tuple[Centre, Flags]:
    start = _at(surface, place, target.name)
    ahead = surface.direction[place]
    centre = start + target.radius * ahead
    position = np.where(surface.usable[..., None], surface.position, np.nan)
    on = np.zeros(surface.usable.shape, dtype=bool)
    weight = gradient = np.zeros(0)
    misfit = 1.0
    for number in range(20):
        away = position - centre
        facing = -np.einsum("ijk,ijk->ij", away, surface.direction) / target.radius
        off = np.linalg.norm(away, axis=-1) - target.radius
        # Wide at first, since the picked pixel may be off the center.
        gate = target.radius / 2 if number < 4 else _NEAR * misfit * surface.own
        on = (np.abs(off) < np.maximum(gate, 1e-5)) & (facing > _STEEP)
        if int(on.sum()) < _FEWEST:
            raise _few(target, surface, int(on.sum()))
        beam, begin = surface.direction[on], surface.origin[on]
        to = centre - begin
        along = np.einsum("ij,ij->i", to, beam)
        inside = along**2 - (to**2).sum(axis=1) + target.radius**2
        met = inside > 0
        distance = along - np.sqrt(np.where(met, inside, 0.0))
        spot = begin + distance[:, None] * beam - centre
        gradient = spot / np.einsum("ij,ij->i", spot, beam)[:, None]
        residual = surface.distance[on] - distance
        weight = np.where(met, 1 / np.maximum(surface.own[on], 1e-6) ** 2, 0.0)
        normal = gradient.T @ (weight[:, None] * gradient)
        step = np.linalg.solve(normal, gradient.T @ (weight * residual))
        centre = centre + step
        scatter = np.sqrt(np.sum(weight * residual**2) / max(int(met.sum()) - 3, 1))
        misfit = max(1.0, float(scatter)) if number >= 4 else 3.0
        if number > 5 and np.linalg.norm(step) < 1e-7:
            break
    gain = np.linalg.solve(normal, gradient.T * weight)
    # A larger sphere that the same points lie on has its center farther away.
    by_radius = np.linalg.solve(
        normal, gradient.T @ (weight / np.abs(np.einsum("ij,ij->i", spot, beam)))
    ) * (target.radius * target.radius_uncertainty)
    others = {f"radius: {target.name}": by_radius} if by_radius.any() else {}
    noise = np.linalg.inv(normal) * misfit**2
    return _centre(target, surface, centre, noise, gain, on, others), on


def _plane(
    surface: ScanSurface, middle: Floats, radius: float, target: Seen
) -> tuple[Flags, Floats, Floats]:
    """Fit a plane around a point; return its pixels, parameters and covariance.

    The plane is m . p = 1; the inverse range along a beam from the origin is m . d.
    """
    position = np.where(surface.usable[..., None], surface.position, np.nan)
    near = np.linalg.norm(position - middle, axis=-1) < radius
    plane = np.zeros(3)
    covariance = np.eye(3)
    on = near
    for number in range(8):
        if int(on.sum()) < _FEWEST:
            raise _few(target, surface, int(on.sum()))
        point = surface.position[on]
        slope = surface.direction[on]
        sigma = surface.own[on]
        if number:
            sigma = sigma * np.abs(slope @ plane)
        weight = 1 / np.maximum(sigma, 1e-9) ** 2
        normal = point.T @ (weight[:, None] * point)
        plane = np.linalg.solve(normal, point.T @ weight)
        covariance = np.linalg.inv(normal)
        off = (position @ plane - 1) / np.linalg.norm(plane)
        facing = np.abs(surface.direction @ plane) / np.linalg.norm(plane)
        spread = max(float(1.4826 * np.nanmedian(np.abs(off[near]))), 1e-6)
        gate = 4 * np.minimum(np.maximum(surface.own * facing, 1e-6), 3 * spread + 1e-6)
        on = near & (np.abs(off) < gate)
    return on, plane, covariance


def _disc(
    target: DiscTarget, surface: ScanSurface, _: xr.Dataset, place: tuple[int, int]
) -> tuple[Centre, Flags]:
    middle = _at(surface, place, target.name)
    inner = 0.35 * target.diameter
    plane, covariance = _plane(surface, middle, inner, target)[1:]
    position = np.where(surface.usable[..., None], surface.position, np.nan)
    unit = plane / np.linalg.norm(plane)
    facing = np.abs(surface.direction @ unit)
    off = (position @ plane - 1) / np.linalg.norm(plane)
    near = np.linalg.norm(position - middle, axis=-1) < 1.2 * target.diameter
    on = near & (np.abs(off) < 5 * surface.own * facing)
    labels, _ = ndimage.label(on)
    on = labels == labels[place] if labels[place] else on
    count = int(on.sum())
    if count < _FEWEST:
        raise _few(target, surface, count)
    area = _area(surface, unit)[on]
    point = surface.position[on]
    centre = (area[:, None] * point).sum(axis=0) / area.sum()
    centre = centre - ((centre @ plane - 1) / np.linalg.norm(plane)) * unit
    across = 2 * np.sqrt(area.sum() / np.pi)
    pitch = float(np.sqrt(np.median(area)))
    rim = np.pi * across / pitch
    if abs(across - target.diameter) > 3 * target.diameter_uncertainty + 2 * pitch:
        raise CubeError(
            f"target {target.name!r} in scan {surface.name!r}: the disc looks "
            f"{across * 1e3:.0f} mm wide, stated are {target.diameter * 1e3:.0f} mm; "
            "look at its place, or at what stands right behind it"
        )
    # Each pixel of the rim is inside or outside by chance.
    sideways = pitch / np.sqrt(12) * np.sqrt(2 / rim)
    weight = np.full(count, 1 / count)
    inward = np.eye(3) - np.outer(unit, unit)
    noise = sideways**2 * inward
    height = np.sqrt(float(centre @ covariance @ centre)) / np.linalg.norm(plane)
    noise = noise + height**2 * np.outer(unit, unit)
    gain = surface.direction[on].T * weight
    return _centre(target, surface, centre, noise, gain, on), on


def _area(surface: ScanSurface, unit: Floats) -> Floats:
    """Return the area that each pixel covers on a plane [m^2]."""
    steps = [np.gradient(surface.direction, axis=axis) for axis in (0, 1)]
    solid = np.linalg.norm(np.cross(steps[0], steps[1]), axis=-1)
    facing = np.abs(surface.direction @ unit)
    return np.asarray(solid * surface.distance**2 / np.maximum(facing, 1e-3))


def _checkerboard(
    target: CheckerboardTarget,
    surface: ScanSurface,
    image: xr.Dataset,
    place: tuple[int, int],
) -> tuple[Centre, Flags]:
    middle = _at(surface, place, target.name)
    on, plane, covariance = _plane(surface, middle, 0.5 * target.width, target)
    unit = plane / np.linalg.norm(plane)
    first = np.cross(unit, [0.0, 1.0, 0.0] if abs(unit[1]) < 0.9 else [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(unit, first)])
    # Projected on the plane, so that range noise does not move edges sideways.
    begin, beam = surface.origin[on], surface.direction[on]
    reach = (1 - begin @ plane) / (beam @ plane)
    middle = middle - ((middle @ plane - 1) / np.linalg.norm(plane)) * unit
    flat = (begin + reach[:, None] * beam - middle) @ axes.T
    bright = image["intensity"].values[on]
    level, size = float(bright.mean()), float(bright.std())
    pitch = float(np.sqrt(np.median(_area(surface, unit)[on])))

    def fields(values: Floats) -> Floats:
        sine, cosine = np.sin(values[2]), np.cos(values[2])
        off = (flat - values[:2]) @ np.array([[cosine, -sine], [sine, cosine]])
        edges = np.tanh(off / np.hypot(values[5], 0.5 * pitch))
        return np.asarray(values[3] + values[4] * edges[:, 0] * edges[:, 1])

    starts = [
        np.array([0.0, 0.0, turn, level, sign * size, pitch])
        for turn in np.arange(4) * np.pi / 8
        for sign in (1, -1)
    ]

    def fitted(begin: Floats, evaluations: int) -> OptimizeResult:
        return least_squares(lambda v: fields(v) - bright, begin, max_nfev=evaluations)

    tried = (fitted(trial, 10) for trial in starts)
    best = fitted(min(tried, key=lambda trial: float(trial.cost)).x, 60)
    # The blur of the edges does not move the center.
    slopes = best.jac[:, :5]
    normal = slopes.T @ slopes
    variance = 2 * best.cost / max(len(bright) - 6, 1)
    if np.sqrt(variance) > 0.7 * size or np.linalg.cond(normal) > 1e14:
        raise CubeError(
            f"target {target.name!r} in scan {surface.name!r}: no dark and bright "
            "fields are seen around the place; look at its intensity in amulor view"
        )
    # Residuals occur at the edges, which determine the center (H. White, Econometrica
    # 48 (1980) 817).
    scores = slopes * best.fun[:, None]
    back = np.linalg.inv(normal)
    spread = (back @ (scores.T @ scores) @ back)[:2, :2]
    spread = spread * len(bright) / max(len(bright) - 6, 1)
    if abs(best.x[5]) < 0.5 * pitch:
        # An edge that falls between pixels, all along a row of them.
        spread = spread + np.eye(2) * pitch**2 / 12
    centre = middle + best.x[:2] @ axes
    away = centre / np.linalg.norm(centre)
    distance = 1 / float(plane @ away)
    noise = axes.T @ spread @ axes
    # Range of the plane along the line of sight to the center.
    height = distance**2 * np.sqrt(float(away @ covariance @ away))
    noise = noise + height**2 * np.outer(away, away)
    count = int(on.sum())
    gain = np.outer(away, np.full(count, 1 / count))
    return _centre(target, surface, distance * away, noise, gain, on), on


def _point(
    target: PointTarget, surface: ScanSurface, _: xr.Dataset, place: tuple[int, int]
) -> tuple[Centre, Flags]:
    position = _at(surface, place, target.name)
    away = np.linalg.norm(surface.position - position, axis=-1)
    at = np.unravel_index(int(np.nanargmin(away)), away.shape)
    ahead = surface.direction[at]
    sigma = float(surface.own[at])
    across = target.picking_uncertainty**2 * (np.eye(3) - np.outer(ahead, ahead))
    # The range of a wrongly picked pixel is that of the place beside it.
    slope = surface.normal[at] if surface.smooth[at] else -ahead
    tilt = slope / (slope @ ahead) - ahead
    moved = np.eye(3) - np.outer(ahead, tilt)
    noise = moved @ across @ moved.T + sigma**2 * np.outer(ahead, ahead)
    noise += 1e-12 * np.eye(3)
    on = np.zeros(surface.usable.shape, dtype=bool)
    on[at] = True
    return _centre(target, surface, position, noise, ahead[:, None], on), on
