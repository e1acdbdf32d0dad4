"""Plan of a site from above: scans placed in its frame, and their common raster."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import contourpy
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from amulor._progress import tell
from amulor.cube import DOUBTFUL
from amulor.errors import CubeError
from amulor.imaging import products
from amulor.platform.attitude import cross_matrix
from amulor.site.description import Site, SiteScan
from amulor.site.merging.cloud import by_unknowns, seen_by_others, unknowns_of
from amulor.site.registration.result import Registration
from amulor.site.registration.surface import ScanSurface, corrected

Floats = NDArray[np.float64]

#: Heights of two scans that differ by more standard errors are two surfaces [1].
_APART = 5.0
#: Height differences within so many cells are relief inside a cell [1].
_RELIEF = 2.0
#: Smallest part of the largest outline of a scan that is drawn [1].
_PART = 0.02


@dataclass(frozen=True, kw_only=True)
class PlacedScan:
    """Surface of a scan in the frame of the site."""

    name: str
    """Name of the scan."""
    epoch: str
    """Visit."""
    surface: products.Surface
    """Vertices and triangles, without points that other scans see through. Its shared
    uncertainty includes pose and shared errors against the first scan."""
    upward: Floats
    """Standard uncertainty of each height against the first scan, shape (n,) [m]."""
    doubtful: Floats
    """1 for a doubtful pixel, else 0, shape (n,)."""
    moving: int
    """Number of points that other scans see through, which are left out [1]."""


def placed(
    site: Site,
    registration: Registration,
    surfaces: Mapping[str, ScanSurface],
    images: Mapping[str, xr.Dataset],
) -> list[PlacedScan]:
    """Place the surfaces of all scans in the frame of the site."""
    scans = []
    for number, scan in enumerate(site.scan):
        tell(f"placing {scan.name}", number / len(site.scan))
        scans.append(_placed(site, registration, surfaces, images[scan.name], scan))
    return scans


def _placed(
    site: Site,
    registration: Registration,
    surfaces: Mapping[str, ScanSurface],
    image: xr.Dataset,
    scan: SiteScan,
) -> PlacedScan:
    pose, scanned = registration.poses[scan.name], surfaces[scan.name]
    surface = products.surface(image, frame=pose.frame(site.frame))
    pixel = surface.pixel
    local = corrected(scanned, registration.errors).reshape(-1, 3)[pixel]
    position = pose.place(local)
    spread = _relative_spread(site, registration, scanned, scan.name, position, pixel)
    upward = surface.own * surface.direction[:, 2]
    variance = np.einsum("nii->ni", spread)
    peers = {peer.name: surfaces[peer.name] for peer in site.scans_of(scan.epoch)}
    sigma = np.sqrt(surface.own**2 + variance.sum(axis=1))
    confirmed, through = seen_by_others(
        scan.name, peers, registration.poses, position, sigma
    )
    measured = np.asarray(np.isfinite(position).all(axis=1))
    moving = (through > confirmed) & measured
    fixed = np.asarray(measured & ~moving)
    flags = image["quality_flag"].values.ravel()[pixel]
    return PlacedScan(
        name=scan.name,
        epoch=scan.epoch,
        surface=replace(
            surface,
            position=np.where(measured[:, None], position, surface.position),
            shared=np.sqrt(
                np.einsum("ni,nij,nj->n", surface.direction, spread, surface.direction)
            ),
            triangles=surface.triangles[fixed[surface.triangles].all(axis=1)],
        ),
        upward=np.sqrt(variance[:, 2] + upward**2),
        doubtful=((flags & int(DOUBTFUL)) != 0).astype(float),
        moving=int(moving.sum()),
    )


def _relative_spread(
    site: Site,
    registration: Registration,
    surface: ScanSurface,
    name: str,
    position: Floats,
    pixel: NDArray[np.intp],
) -> Floats:
    """Covariance of points relative to the first scan, without noise [m^2]."""
    first = site.scan[0].name
    slope = by_unknowns(surface, registration.poses[name], position, pixel)
    arm = position - registration.poses[first].position
    carried = np.concatenate(
        [np.broadcast_to(np.eye(3), (len(pixel), 3, 3)), -cross_matrix(arm)], axis=2
    )
    slopes = np.concatenate([slope, -carried], axis=2)
    names = (*unknowns_of(name, surface), f"pose {first}")
    covariance = registration.covariance_of(*names)
    return np.asarray(
        np.einsum("nij,jk,nlk->nil", slopes, covariance, slopes, optimize=True)
    )


def bounds(scans: Sequence[PlacedScan]) -> tuple[float, float, float, float]:
    """Return west, east, south and north of all surfaces [m]."""
    used = [s.surface.position[np.unique(s.surface.triangles), :2] for s in scans]
    points = np.concatenate([part for part in used if len(part)])
    (west, south), (east, north) = points.min(axis=0), points.max(axis=0)
    return float(west), float(east), float(south), float(north)


def orthoplan(
    scans: Sequence[PlacedScan],
    *,
    cell: float,
    window: tuple[float, float, float, float] | None = None,
) -> products.Raster:
    r"""Combine scans in a raster of heights.

    Parameters
    ----------
    scans : sequence of PlacedScan
        Scans of one visit.
    cell : float
        Size of a cell [m].
    window : tuple of float, optional
        West, east, south and north bound; by default those of all scans. Memory grows
        with the cells in the window [m].

    Returns
    -------
    Raster
        Mean height of each cell, weighted by the inverse square of its uncertainty. Of
        surfaces above each other, the upper one. The layers are `doubtful` and `scans`
        (number of scans in a cell).

    Raises
    ------
    CubeError
        If no scan has a surface in the window.
    """
    west, east, south, north = window or bounds(scans)
    # Rounded, so that a bound on a cell's edge is that edge.
    steps = np.round(np.array([west, east, south, north]) / cell, 6)
    left, bottom = np.floor(steps[[0, 2]])
    right, top = np.ceil(steps[[1, 3]])
    shape = int(top - bottom), int(right - left)
    weight, height, noise, sigma, light, doubtful, count = (
        np.zeros(shape) for _ in range(7)
    )
    part: products.Raster | None = None
    for scan in scans:
        single = _raster_in(scan, cell, (west, east, south, north))
        if single is None:
            continue
        part = single
        rows, columns, inner = _overlap(part, shape, cell, left, top)
        new = {
            "height": part.height[inner],
            "sigma": part.layers["sigma"][inner],
            "own": part.own[inner],
            "light": part.amplitude[inner],
            "doubtful": np.nan_to_num(part.layers["doubtful"][inner]),
        }
        at = (rows, columns)
        with np.errstate(invalid="ignore", divide="ignore"):
            old = height[at] / weight[at]
            old_sigma = sigma[at] / weight[at]
            step = new["height"] - old
            limit = np.maximum(
                _APART * np.hypot(new["sigma"], old_sigma), _RELIEF * cell
            )
        measured = np.isfinite(new["height"])
        upper = measured & ((weight[at] == 0) | (step > limit))
        alike = measured & ~upper & (np.abs(step) <= limit)
        for total in (weight, height, noise, sigma, light, doubtful, count):
            total[at][upper] = 0.0
        used = upper | alike
        share = 1 / np.maximum(new["sigma"][used], 1e-9) ** 2
        weight[at][used] += share
        height[at][used] += share * new["height"][used]
        noise[at][used] += (share * new["own"][used]) ** 2
        sigma[at][used] += share * new["sigma"][used]
        light[at][used] += share * new["light"][used]
        doubtful[at][used] = np.maximum(doubtful[at][used], new["doubtful"][used])
        count[at][used] += 1
    if part is None or not weight.any():
        raise CubeError("no scan has a surface in this part of the site")
    with np.errstate(invalid="ignore", divide="ignore"):
        inverse = np.where(weight > 0, 1 / weight, np.nan)
    return replace(
        part,
        height=height * inverse,
        own=np.sqrt(noise) * inverse,
        uncertainty=sigma * inverse,
        amplitude=light * inverse,
        left=float(left * cell),
        top=float(top * cell),
        layers={"doubtful": doubtful, "scans": count},
    )


def _raster_in(
    scan: PlacedScan, cell: float, window: tuple[float, float, float, float]
) -> products.Raster | None:
    """Raster of a scan's triangles in a window; None if there are none."""
    west, east, south, north = window
    surface = scan.surface
    x, y = surface.position[:, 0], surface.position[:, 1]
    inside = (x >= west - cell) & (x <= east + cell)
    inside &= (y >= south - cell) & (y <= north + cell)
    triangles = surface.triangles[inside[surface.triangles].any(axis=1)]
    if not len(triangles):
        return None
    try:
        return products.raster(
            replace(surface, triangles=triangles),
            products.plane_of(surface.frame, "top"),
            cell=cell,
            layers={"sigma": scan.upward, "doubtful": scan.doubtful},
        )
    except CubeError:
        return None


def _overlap(
    part: products.Raster, shape: tuple[int, int], cell: float, left: float, top: float
) -> tuple[slice, slice, tuple[slice, slice]]:
    """Rows and columns of a large raster that a part covers, and slices of the part."""
    column = round(part.left / cell - left)
    row = round(top - part.top / cell)
    high, wide = part.height.shape
    first_row, last_row = max(row, 0), max(min(row + high, shape[0]), 0)
    first, last = max(column, 0), max(min(column + wide, shape[1]), 0)
    last_row, last = max(last_row, first_row), max(last, first)
    inner = slice(first_row - row, last_row - row), slice(first - column, last - column)
    return slice(first_row, last_row), slice(first, last), inner


def footprint(scan: PlacedScan, *, cell: float) -> list[Floats]:
    """Return outlines of the area in plan that a scan covers [m].

    Gaps of up to six cells are closed, and holes are left out.
    """
    if not len(scan.surface.triangles):
        return []
    raster = _raster_in(scan, cell, bounds([scan]))
    if raster is None:
        return []
    covered = np.pad(np.isfinite(raster.height), 8)
    covered = ndimage.binary_closing(covered, iterations=3)
    covered = ndimage.binary_fill_holes(covered)
    labels, count = ndimage.label(covered)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    large = np.flatnonzero(sizes >= _PART * sizes.max(initial=1)) + 1
    rows, columns = covered.shape
    x = raster.left + cell * (np.arange(columns) - 7.5)
    y = raster.top - cell * (np.arange(rows) - 7.5)
    smooth = ndimage.gaussian_filter(np.isin(labels, large).astype(float), 1.0)
    lines = contourpy.contour_generator(x, y, smooth).lines(0.5)
    return [np.asarray(line, dtype=float) for line in lines if len(line) > 8]
