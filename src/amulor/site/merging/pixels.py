"""Points of all pixels of a site; averaged scans are read again in pieces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from amulor._progress import tell
from amulor.imaging.common import own_variance
from amulor.imaging.observation import geometry_of
from amulor.site.blocks import block_side
from amulor.site.load import range_image_of
from amulor.site.merging.cloud import (
    Merged,
    covariances,
    derivatives,
    scan_cloud,
    seen_by_others,
    unknowns_of,
)
from amulor.site.registration.line import Motion, motion_of, straightened
from amulor.site.registration.result import Registration
from amulor.site.registration.surface import ScanSurface, usable_pixels

Floats = NDArray[np.float64]

#: Largest number of pixels of a piece [1].
_AT_ONCE = 100_000


def all_points(
    cloud: Merged, registration: Registration, surfaces: Mapping[str, ScanSurface]
) -> Iterator[Merged]:
    """Yield the points of all pixels of a site, in pieces that fit in memory.

    Scans that were averaged over blocks of pixels are read again. Shared errors,
    weights and moving objects of a pixel are those of its block.
    """
    scans = cloud.site.scan
    coarse = {
        scan.name for scan in scans if block_side(surfaces[scan.name].attributes) > 1
    }
    if not coarse:
        yield cloud
        return
    for number, scan in enumerate(scans):
        tell(f"points of {scan.name}", number / len(scans))
        if scan.name in coarse:
            yield from _pieces(
                cloud, registration, surfaces, number, *_fine(cloud, surfaces, number)
            )
        else:
            yield cloud.of(cloud.scan == number)


def scan_clouds(
    cloud: Merged,
    registration: Registration,
    surfaces: Mapping[str, ScanSurface],
    images: Mapping[str, xr.Dataset],
) -> Iterator[xr.Dataset]:
    """Yield the point cloud of each scan, with its pose, from all of its pixels."""
    for number, scan in enumerate(cloud.site.scan):
        points, image = cloud, images[scan.name]
        if block_side(surfaces[scan.name].attributes) > 1:
            image, motion = _fine(cloud, surfaces, number)
            points = joined(
                list(_pieces(cloud, registration, surfaces, number, image, motion))
            )
        yield scan_cloud(points, number, registration, image)


def _fine(
    cloud: Merged, surfaces: Mapping[str, ScanSurface], number: int
) -> tuple[xr.Dataset, Motion | None]:
    """Return the range image of an averaged scan with all pixels, and its motion."""
    scan = cloud.site.scan[number]
    image = range_image_of(scan)
    motion, coarse = motion_of(cloud.site, scan, image), surfaces[scan.name].motion
    if motion is None or coarse is None:
        return image, None
    motion = replace(motion, start=coarse.start)
    return straightened(image, motion), motion


def joined(pieces: Sequence[Merged]) -> Merged:
    """Concatenate pieces of a merged point cloud."""
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(piece, name) for piece in pieces])
        for name, value in vars(pieces[0]).items()
        if isinstance(value, np.ndarray)
    }
    return replace(pieces[0], **arrays)


def _pieces(
    cloud: Merged,
    registration: Registration,
    surfaces: Mapping[str, ScanSurface],
    number: int,
    image: xr.Dataset,
    motion: Motion | None,
) -> Iterator[Merged]:
    """Yield the points of one scan, some rows of pixels at a time."""
    scan = cloud.site.scan[number]
    surface = surfaces[scan.name]
    side = block_side(surface.attributes)
    shape = surface.distance.shape
    # Nearest block with a range, for pixels in blocks without one.
    rows, columns = ndimage.distance_transform_edt(
        ~surface.usable, return_distances=False, return_indices=True
    )
    block_near = np.asarray(rows) * shape[1] + np.asarray(columns)
    mine = np.flatnonzero(cloud.scan == number)
    place = np.full(surface.distance.size, -1)
    place[cloud.pixel[mine]] = mine
    peers = {peer.name: surfaces[peer.name] for peer in cloud.site.scans_of(scan.epoch)}
    width = image.sizes["column"]
    step = max(_AT_ONCE // width, 1)
    for begin in range(0, image.sizes["row"], step):
        part = image.isel(row=slice(begin, begin + step))
        usable = usable_pixels(part)
        row, column = np.nonzero(usable)
        at_block = np.stack(
            [
                np.minimum((row + begin) // side, shape[0] - 1),
                np.minimum(column // side, shape[1] - 1),
            ]
        )
        block = block_near[tuple(at_block)]
        alone = ~surface.usable[tuple(at_block)]
        yield _points(
            cloud, registration, surfaces, number, part, usable, motion,
            block=block, member=place[block], alone=alone, peers=peers,
            pixel=(row + begin) * width + column,
        )  # fmt: skip


def _points(
    cloud: Merged,
    registration: Registration,
    surfaces: Mapping[str, ScanSurface],
    number: int,
    image: xr.Dataset,
    usable: NDArray[np.bool_],
    motion: Motion | None,
    *,
    block: NDArray[np.intp],
    member: NDArray[np.intp],
    alone: NDArray[np.bool_],
    peers: Mapping[str, ScanSurface],
    pixel: NDArray[np.intp],
) -> Merged:
    """Return the points of some rows of a scan, with the errors of their blocks."""
    name = cloud.site.scan[number].name
    surface, pose = surfaces[name], registration.poses[name]
    distance = image["slant_range"].values[usable]
    count = len(surface.shared.keys)
    shapes, growth = (
        values.reshape(count, surface.distance.size)[:, block]
        for values in (surface.shared.shapes, surface.shared.growth)
    )
    shapes = shapes + growth * (distance - surface.distance.ravel()[block])
    errors = np.array([registration.errors.get(k, 0.0) for k in surface.shared.keys])
    beams = geometry_of(image).beam
    before = np.broadcast_to(beams.length_before, usable.shape)[usable]
    direction = np.broadcast_to(beams.direction, (*usable.shape, 3))[usable]
    entry = np.broadcast_to(beams.entry, (*usable.shape, 3))[usable]
    local = entry + (distance - errors @ shapes - before)[:, None] * direction
    moved = np.zeros((0, len(local), 3))
    if motion is not None:
        moved = motion.shifts(pixel, local)
        by_poses = [registration.errors.get(key, 0.0) for key in motion.keys]
        local = local - np.tensordot(by_poses, moved, axes=1)
    position, beam = pose.place(local), pose.turn(direction)
    sigma = np.sqrt(own_variance(image))[usable]
    if motion is not None:
        sigma = np.hypot(sigma, motion.own.ravel()[pixel])
    spread = covariances(
        derivatives(pose, position, beam, shapes, moved),
        registration.covariance_of(*unknowns_of(name, surface)), sigma, beam,
    )  # fmt: skip
    confirmed, moving = cloud.confirmed[member], cloud.moving[member]
    if alone.any():
        largest = np.sqrt(np.linalg.eigvalsh(spread[alone])[:, -1])
        confirmed[alone], through = seen_by_others(
            name, peers, registration.poses, position[alone], largest
        )
        moving[alone] = through > confirmed[alone]
    return Merged(
        position=position,
        covariance=spread,
        own=sigma,
        beam=beam,
        normal=cloud.normal[member],
        intensity=image["intensity"].values[usable],
        scan=np.full(len(pixel), number, dtype=np.int16),
        pixel=pixel,
        flag=image["quality_flag"].values[usable].astype(np.int16),
        confirmed=confirmed,
        moving=moving,
        share=cloud.share[member],
        site=cloud.site,
        brightest=cloud.brightest,
    )
