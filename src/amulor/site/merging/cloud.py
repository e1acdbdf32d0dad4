"""Merged point cloud of a site, with covariance and confirmation of each point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from amulor._progress import tell
from amulor.imaging import point_cloud
from amulor.platform.attitude import cross_matrix
from amulor.site.blocks import BRIGHTEST
from amulor.site.description import Site
from amulor.site.registration.pair import on_grid
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.result import Registration
from amulor.site.registration.surface import ScanSurface, corrected

Floats = NDArray[np.float64]
Counts = NDArray[np.int16]

#: Standard errors in front of a surface beyond which a point is seen through, and
#: within which it is confirmed [1].
_THROUGH, _CONFIRMED = 6.0, 4.0
#: Smallest cosine of the angle of incidence for which a beam can see through a point
#: [1].
_GRAZING = 0.15


def seen_by_others(
    name: str,
    surfaces: Mapping[str, ScanSurface],
    poses: Mapping[str, ScanPose],
    point: Floats,
    sigma: Floats,
) -> tuple[Counts, Counts]:
    """Count other scans that confirm each point, and scans that see through it."""
    confirmed = np.zeros(len(point), dtype=np.int16)
    through = np.zeros(len(point), dtype=np.int16)
    for peer, surface in surfaces.items():
        if peer == name or not len(point):
            continue
        local = poses[peer].back(point)
        pixels = np.flatnonzero(surface.usable)
        near, number = _nearest_beams(surface, local, pixels)
        met = np.flatnonzero(np.isfinite(near))
        if not len(met):
            continue
        at = on_grid(surface, local[met], pixels[number[met]])
        normal = surface.normal.reshape(-1, 3)[at.pixel]
        facing = -np.einsum("ij,ij->i", np.nan_to_num(normal), at.direction)
        good = at.inside & (facing > _GRAZING)
        error = np.hypot(
            sigma[met] / np.maximum(facing, _GRAZING), surface.own.ravel()[at.pixel]
        )
        score = at.distance / error
        confirmed[met] += good & (np.abs(score) < _CONFIRMED)
        # In front of the surface by more than the relief of a patch, too.
        before = at.distance < -3 * surface.spacing
        through[met] += good & (score < -_THROUGH) & before
    return confirmed, through


def _nearest_beams(
    surface: ScanSurface, points: Floats, pixels: NDArray[np.intp]
) -> tuple[Floats, NDArray[np.intp]]:
    """Return the distance to the nearest beam of each point, and its place in `pixels`.

    Distances are infinite for points far from all beams.
    """
    if surface.motion is not None:
        # Beams from many places: the nearest point is near the beam.
        tree = cKDTree(surface.position.reshape(-1, 3)[pixels])
        reach = 0.5 * float(np.nanmedian(surface.distance))
        away, number = tree.query(points, distance_upper_bound=reach)
        return np.asarray(away), np.asarray(number)
    away = points - surface.origin[surface.usable].mean(axis=0)
    distance = np.linalg.norm(away, axis=1)
    tree = cKDTree(surface.direction.reshape(-1, 3)[pixels])
    near, number = tree.query(
        away / np.maximum(distance, 1e-9)[:, None],
        distance_upper_bound=6 * surface.spacing / np.nanmedian(surface.distance),
    )
    return np.asarray(near), np.asarray(number)


Flags = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Merged:
    """Point cloud merged from all scans, in the frame of the site."""

    position: Floats
    """East, north and up of each point, shape (n, 3) [m]."""
    covariance: Floats
    """Covariance of each point, including shared errors and pose, shape (n, 3, 3)
    [m^2]."""
    own: Floats
    """Standard uncertainty of the range from noise of the pixel, shape (n,) [m]."""
    beam: Floats
    """Direction of the beam of each point, shape (n, 3) [1]."""
    normal: Floats
    """Unit normals towards the instrument; NaN off smooth surfaces, shape (n, 3)
    [1]."""
    intensity: Floats
    """Amplitude of the target signal, shape (n,) [V]."""
    scan: NDArray[np.int16]
    """Number of the point's scan in the site file, counted from 0, shape (n,)."""
    pixel: NDArray[np.intp]
    """Number of the point's pixel, counted row by row, shape (n,)."""
    flag: NDArray[np.int16]
    """Quality flags of the range image, shape (n,)."""
    confirmed: NDArray[np.int16]
    """Number of other scans of the visit that confirm the point, shape (n,) [1]."""
    moving: Flags
    """Mask of points that other scans of the visit see through: moving objects."""
    share: Floats
    """Weight of a point among all points at its place; the weights of all scans sum to
    1, shape (n,) [1]."""
    site: Site
    """Description of the site."""
    brightest: float = 0.0
    """Largest amplitude of all pixels, if larger than those of the points [V]."""

    def of(self, at: NDArray[np.intp] | Flags) -> Merged:
        """Return a selection of the points."""
        arrays: dict[str, Any] = {
            name: value[at]
            for name, value in vars(self).items()
            if isinstance(value, np.ndarray)
        }
        return replace(self, **arrays)

    @property
    def sigma(self) -> Floats:
        """Standard uncertainties of the point coordinates, shape (n, 3) [m]."""
        return np.asarray(np.sqrt(np.einsum("nii->ni", self.covariance)))

    def of_epoch(self, epoch: str) -> Flags:
        """Return the mask of the points of one visit."""
        numbers = [k for k, scan in enumerate(self.site.scan) if scan.epoch == epoch]
        return np.asarray(np.isin(self.scan, numbers))


def unknowns_of(scan: str, surface: ScanSurface) -> tuple[str, ...]:
    """Return the names of the fitted unknowns on which a scan's points depend."""
    return (f"pose {scan}", *(f"error {key}" for key in surface.keys))


def by_unknowns(
    surface: ScanSurface, pose: ScanPose, position: Floats, pixel: NDArray[np.intp]
) -> Floats:
    """Return derivatives of a scan's points with respect to pose and shared errors."""
    beam = pose.turn(surface.direction.reshape(-1, 3)[pixel])
    number = len(surface.shared.keys)
    shapes = surface.shared.shapes.reshape(number, surface.distance.size)[:, pixel]
    moved = surface.moved(pixel, pose.back(position))
    return derivatives(pose, position, beam, shapes, moved)


def derivatives(
    pose: ScanPose, position: Floats, beam: Floats, shapes: Floats, moved: Floats
) -> Floats:
    """Return derivatives of points with respect to pose and shared errors.

    `moved` are the shifts by errors of a moving instrument, in its axes.
    """
    return np.concatenate(
        [
            np.broadcast_to(np.eye(3), (len(position), 3, 3)),
            -cross_matrix(position - pose.position),
            -beam[:, :, None] * shapes.T[:, None, :],
            -np.transpose(moved @ pose.rotation.T, (1, 2, 0)),
        ],
        axis=2,
    )


def covariances(
    slope: Floats, covariance: Floats, sigma: Floats, beam: Floats
) -> Floats:
    """Return covariances of points due to pose, shared errors and noise, (n, 3, 3)."""
    spread = np.einsum("nij,jk,nlk->nil", slope, covariance, slope, optimize=True)
    spread += (sigma**2)[:, None, None] * beam[:, :, None] * beam[:, None, :]
    return np.asarray(spread)


def merge(
    site: Site,
    registration: Registration,
    surfaces: Mapping[str, ScanSurface],
    images: Mapping[str, xr.Dataset],
) -> Merged:
    r"""Merge all scans of a site into one point cloud.

    The covariance of a point is :math:`C_i = \sigma_i^2 d d^T + J_i \Sigma J_i^T`, with
    the direction d of the beam, the noise :math:`\sigma_i` of the pixel, and the
    derivatives J by pose and shared errors. Their covariance :math:`\Sigma` is that of
    the registration, which has estimated these errors from all scans.
    """
    # Filled scan by scan, because parts need as much memory again as the columns.
    columns: dict[str, Any] = {}
    begin, total = 0, sum(int(surfaces[s.name].usable.sum()) for s in site.scan)

    def keep(**values: NDArray[Any]) -> None:
        for key, value in values.items():
            if key not in columns:
                columns[key] = np.empty((total, *value.shape[1:]), value.dtype)
            columns[key][begin : begin + len(value)] = value

    for number, scan in enumerate(site.scan):
        tell(f"placing {scan.name}", number / len(site.scan))
        surface, pose = surfaces[scan.name], registration.poses[scan.name]
        pixel = np.flatnonzero(surface.usable)
        local = corrected(surface, registration.errors).reshape(-1, 3)[pixel]
        position = pose.place(local)
        beam = pose.turn(surface.direction.reshape(-1, 3)[pixel])
        names = unknowns_of(scan.name, surface)
        covariance = registration.covariance_of(*names)
        slope = by_unknowns(surface, pose, position, pixel)
        sigma = surface.own.ravel()[pixel]
        spread = covariances(slope, covariance, sigma, beam)
        peers = {peer.name: surfaces[peer.name] for peer in site.scans_of(scan.epoch)}
        largest = np.sqrt(np.linalg.eigvalsh(spread)[:, -1])
        confirmed, through = seen_by_others(
            scan.name, peers, registration.poses, position, largest
        )
        image = images[scan.name]
        keep(
            position=position,
            covariance=spread,
            own=sigma,
            beam=beam,
            normal=pose.turn(surface.normal.reshape(-1, 3)[pixel]),
            intensity=image["intensity"].values.ravel()[pixel].astype(float),
            scan=np.full(len(pixel), number, dtype=np.int16),
            pixel=pixel,
            flag=image["quality_flag"].values.ravel()[pixel].astype(np.int16),
            confirmed=confirmed,
            moving=through > confirmed,
        )
        begin += len(pixel)
    tell("weighing what several scans see", 0.9)
    share = _shares(
        site, columns["position"], columns["scan"], columns["own"], columns["moving"]
    )
    brightest = max(
        (float(image.attrs.get(BRIGHTEST, 0.0)) for image in images.values()),
        default=0.0,
    )
    return Merged(**columns, share=share, site=site, brightest=brightest)


def _shares(
    site: Site,
    position: NDArray[np.generic],
    scan: NDArray[np.generic],
    sigma: NDArray[np.generic],
    moving: NDArray[np.generic],
) -> Floats:
    """Return point weights, smaller where scans of the same visit overlap."""
    epochs = np.array([[e.name for e in site.epoch].index(s.epoch) for s in site.scan])
    share = np.ones(len(position))
    precision = 1 / np.maximum(np.asarray(sigma, dtype=float), 1e-9) ** 2
    for epoch in range(len(site.epoch)):
        at = np.flatnonzero((epochs[scan.astype(int)] == epoch) & ~moving.astype(bool))
        numbers = np.unique(scan[at])
        trees, reach = {}, {}
        for number in numbers:
            mine = at[scan[at] == number]
            trees[number] = (cKDTree(position[mine]), mine)
            nearest_two = trees[number][0].query(
                position[mine[:: max(len(mine) // 500, 1)]], k=2
            )
            reach[number] = 1.5 * float(np.median(nearest_two[0][:, 1]))
        for number in numbers:
            mine = trees[number][1]
            total = precision[mine].copy()
            for peer in numbers:
                if peer == number:
                    continue
                tree, theirs = trees[peer]
                away, nearest = tree.query(
                    position[mine], distance_upper_bound=reach[peer]
                )
                met = np.isfinite(away)
                total[met] += precision[theirs[nearest[met]]]
            share[mine] = precision[mine] / total
    return share


def scan_cloud(
    cloud: Merged, number: int, registration: Registration, image: xr.Dataset
) -> xr.Dataset:
    """Return the point cloud of one scan, with its pose and point uncertainties."""
    scan = cloud.site.scan[number]
    frame = registration.poses[scan.name].frame(cloud.site.frame)
    single = point_cloud(image, frame=frame)
    columns = int(single.attrs["scan_shape"][1])
    pixel = single["row"].values.astype(int) * columns + single["column"].values
    mine = np.flatnonzero(cloud.scan == number)
    order = np.searchsorted(cloud.pixel[mine], pixel)
    order = np.minimum(order, len(mine) - 1)
    present = cloud.pixel[mine[order]] == pixel
    single = single.isel(point=np.flatnonzero(present))
    at = mine[order[present]]
    changed = {}
    for axis, name in enumerate("xyz"):
        changed[name] = single[name].copy(data=cloud.position[at, axis])
        changed[f"{name}_uncertainty"] = single[f"{name}_uncertainty"].copy(
            data=cloud.sigma[at, axis]
        )
    single = single.assign(changed)
    single.attrs["title"] = scan.name
    return single
