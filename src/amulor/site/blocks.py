"""Averages of large range images over square blocks of pixels.

A scan of a million pixels has far more detail than its pose needs, and 20 such scans
fill the memory. The average of a block has the noise of its pixels divided by the
square root of their number, and their common errors.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import QualityFlag
from amulor.cube.schema import ALIKE_TERMS, RANGE_PREFIX, WATER_TERMS
from amulor.imaging import flag_mixed, flag_outliers
from amulor.imaging.common import own_variance
from amulor.imaging.observation import geometry_of
from amulor.site.description import (
    DiscTarget,
    PointTarget,
    ScaleBar,
    Site,
    SphereTarget,
)
from amulor.site.registration.line import row_of_image, rows_of_scan
from amulor.site.registration.surface import ScanSurface, usable_pixels

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Numbers = NDArray[np.intp]

#: Largest number of pixels of a scan that is not averaged [1].
MOST_PIXELS = 200_000
#: Attributes of an average: side of a block, columns of the scan [1], and the largest
#: amplitude of its pixels [V].
BLOCK, COLUMNS = "averaged_block", "averaged_columns"
BRIGHTEST = "averaged_brightest"
#: Blocks across a target, at least [1].
_ACROSS = 12
_TOTAL, _COMMON = "slant_range_uncertainty", "slant_range_common_uncertainty"


def block_size(site: Site, name: str, image: xr.Dataset) -> int:
    """Return the side of the averaging blocks of a scan in pixels; 1 for no averaging.

    Blocks remain small compared with the targets in the scan. A scan with picked points
    is not averaged, because a block is not the picked pixel.
    """
    distance = image["slant_range"].values
    size = math.ceil(math.sqrt(distance.size / MOST_PIXELS))
    if size < 2:
        return 1
    angle = _pitch(image)
    for target in site.target:
        if isinstance(target, ScaleBar):
            continue
        for place in target.places:
            if place.scan != name:
                continue
            if isinstance(target, PointTarget):
                return 1
            if isinstance(target, SphereTarget):
                width = 2 * target.radius
            elif isinstance(target, DiscTarget):
                width = target.diameter
            else:
                width = target.width
            row = row_of_image(image.attrs, place.row)
            near = distance[
                max(row - 2, 0) : row + 3,
                max(place.column - 2, 0) : place.column + 3,
            ]
            if np.isfinite(near).any():
                across = width / (float(np.nanmedian(near)) * angle)
                size = max(min(size, int(across / _ACROSS)), 1)
    return size


def _pitch(image: xr.Dataset) -> float:
    """Return the median angle between adjacent beams, the larger of both axes [rad]."""
    direction = geometry_of(image).beam.direction
    return max(
        float(np.median(np.linalg.norm(np.diff(direction, axis=axis), axis=-1)))
        for axis in (0, 1)
    )


def averaged(image: xr.Dataset, size: int) -> xr.Dataset:
    r"""Average a range image over square blocks of pixels.

    The inverse range of a plane is linear in the direction of the beam. So a plane in
    inverse range is fitted to the good pixels of a block, and evaluated at its center.
    In complete blocks this is the mean. With the mean direction :math:`\bar d` of the
    beams the range of a plane is :math:`|\bar d|` over the mean inverse range. A block
    needs more than half of its pixels, with a smaller error than that of one pixel.
    """
    if size < 2:
        return image
    rows, columns = (length // size for length in image["slant_range"].shape)
    distance = image["slant_range"].values
    flag = image["quality_flag"].values.astype(np.int64)
    noise = own_variance(image)
    usable = usable_pixels(image) & np.isfinite(noise)

    def blocks(values: NDArray[np.generic]) -> NDArray[np.generic]:
        """Pixels of each block, shape (block, pixel)."""
        parts = values[: rows * size, : columns * size].reshape(
            rows, size, columns, size
        )
        return parts.swapaxes(1, 2).reshape(rows * columns, size**2)

    on = blocks(usable).astype(bool)
    weight, good = _weights(on, size)
    inverse = blocks(np.where(usable, 1 / np.where(usable, distance, 1.0), 0.0))

    def mean(values: NDArray[np.generic]) -> Floats:
        """Value at the center of each block, by the plane through its good pixels."""
        of_block = np.where(on, np.nan_to_num(blocks(values).astype(float)), 0.0)
        return np.asarray((weight * of_block).sum(axis=1).reshape(rows, columns))

    beams = geometry_of(image).beam.direction
    length = np.linalg.norm(
        [blocks(np.ascontiguousarray(beams[..., k])).mean(axis=1) for k in range(3)],
        axis=0,
    )
    middle = (weight * inverse.astype(float)).sum(axis=1)
    good &= middle > 0
    reach = np.where(good, length / np.where(good, middle, 1.0), np.nan)
    good = good.reshape(rows, columns)
    own = np.where(on, blocks(noise).astype(float), 0.0)
    variance = (weight**2 * own).sum(axis=1).reshape(rows, columns)
    values = {"slant_range": reach.reshape(rows, columns)}
    for name in (_COMMON, *(RANGE_PREFIX + t for t in (*ALIKE_TERMS, *WATER_TERMS))):
        if name in image:
            values[name] = np.where(good, mean(image[name].values), np.nan)
    common = values.get(_COMMON, np.zeros(variance.shape))
    values[_TOTAL] = np.where(good, np.sqrt(common**2 + variance), np.nan)
    brightest = 0.0
    if "intensity" in image:
        values["intensity"] = np.where(good, mean(image["intensity"].values), np.nan)
        brightest = float(image["intensity"].values[usable].max(initial=0.0))
    flags = blocks(flag).astype(np.int64)
    united = np.bitwise_or.reduce(np.where(on | ~good.reshape(-1, 1), flags, 0), axis=1)
    united = united.reshape(rows, columns) | np.where(good, 0, int(QualityFlag.MISSING))
    values["quality_flag"] = united.astype(image["quality_flag"].dtype)
    half = size // 2
    coarse = image[list(values)].isel(
        row=slice(half, half + size * rows, size),
        column=slice(half, half + size * columns, size),
    )
    changed = {name: coarse[name].copy(data=data) for name, data in values.items()}
    angles = {}
    for name in ("azimuth", "elevation", "origin_x", "origin_y", "origin_z"):
        if name in image.coords:
            center = coarse[name].values
            off = blocks(image[name].values).astype(float) - center.reshape(-1, 1)
            if name == "azimuth":
                off = np.remainder(off + math.pi, 2 * math.pi) - math.pi
            angles[name] = coarse[name].copy(
                data=center + off.mean(axis=1).reshape(rows, columns)
            )
    for name in ("time", "reading_time", "reading_duration"):
        if name in image.coords:
            whole = np.asarray(image[name].values, dtype=float)
            instants = whole.reshape(-1, *whole.shape[-2:])
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # empty blocks
                middles = [
                    np.nanmean(blocks(time).astype(float), axis=1) for time in instants
                ]
            times = np.reshape(middles, (*whole.shape[:-2], rows, columns))
            angles[name] = xr.DataArray(
                times, dims=image[name].dims, attrs=image[name].attrs
            )
    if "reading_weight" in image.coords:
        angles["reading_weight"] = image["reading_weight"]
    coarse = coarse.assign(changed).assign_coords(angles)
    coarse.attrs |= {
        BLOCK: size, COLUMNS: image.sizes["column"], BRIGHTEST: brightest
    }  # fmt: skip
    # Blocks at an edge contain both surfaces.
    return flag_outliers(flag_mixed(coarse))


def _weights(on: Flags, size: int) -> tuple[Floats, Flags]:
    """Return pixel weights for a plane's value at block centers, and usable blocks."""
    place = np.arange(size) - (size - 1) / 2
    row, column = (part.ravel() for part in np.meshgrid(place, place, indexing="ij"))
    design = np.stack([np.ones(size**2), row, column], axis=1)
    normal = np.einsum("bp,pi,pj->bij", on.astype(float), design, design)
    good = (on.sum(axis=1) > size**2 / 2) & (np.linalg.det(normal) > 1e-6)
    normal[~good] = np.eye(3)
    first = np.linalg.inv(normal)[:, 0]
    weight = on * (first @ design.T)
    good &= (weight**2).sum(axis=1) < 1 + 1e-9
    return np.where(good[:, None], weight, 0.0), good


def block_side(attributes: Mapping[Any, object]) -> int:
    """Return the side of the blocks of a scan in pixels; 1 if it is not averaged."""
    return int(str(attributes.get(BLOCK, 1)))


def block_of(image: xr.Dataset, row: int, column: int) -> tuple[int, int]:
    """Return row and column of the block that contains a pixel of the scan."""
    size = block_side(image.attrs)
    row = row_of_image(image.attrs, row)
    rows, columns = image["slant_range"].shape
    return min(row // size, rows - 1), min(column // size, columns - 1)


def pixels_of_scan(surface: ScanSurface, pixel: Numbers) -> Numbers:
    """Return the numbers of the scan's pixels at the centers of given blocks."""
    size = block_side(surface.attributes)
    row, column = np.divmod(pixel, surface.distance.shape[1])
    width = surface.distance.shape[1]
    if size > 1:
        width = int(str(surface.attributes[COLUMNS]))
        row, column = row * size + size // 2, column * size + size // 2
    return np.asarray(rows_of_scan(surface.attributes, row) * width + column)
