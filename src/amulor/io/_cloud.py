"""Makes sure that a point cloud can be exported, and says in words what it is."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import DOUBTFUL
from amulor.errors import CubeError

# What the axes mean, for the header of a file that has no place for it.
_AXES = "right-handed: x right, y down, z forward, in the instrument's axes [m]"

# Largest number that each format can hold.
_LAST = {"row": 2**31 - 1, "column": 2**31 - 1, "quality_flag": 2**15 - 1}


def checked_cloud(cloud: xr.Dataset, *, name: str) -> xr.Dataset:
    """Return a point cloud with at least one point, all of them placed, or raise."""
    cloud = cubes.checked(cloud, level="point_cloud", name=name)
    if cloud.sizes["point"] == 0:
        raise CubeError(
            f"{name}: there is no point in it; look at the quality flags of the range "
            "image that it was made from"
        )
    for variable in ("x", "y", "z", "intensity"):
        broken = np.count_nonzero(~np.isfinite(cloud[variable].values))
        if broken:
            raise CubeError(
                f"{name}: '{variable}' of {broken} points is not finite; drop these "
                "points"
            )
    for variable, last in _LAST.items():
        if variable not in cloud:
            continue
        values = cloud[variable].values
        if not np.all((values >= 0) & (values <= last) & (values == np.floor(values))):
            raise CubeError(
                f"{name}: '{variable}' must hold whole numbers from 0 to {last}, "
                f"found {np.min(values):g} to {np.max(values):g}; make the cloud again "
                "from its range image"
            )
    return cloud


def checked_parts(
    parts: Iterable[xr.Dataset], count: int, *, name: str
) -> Iterator[xr.Dataset]:
    """Yield the parts of a cloud that hold points, checked as by `checked_cloud`."""
    found = 0
    part = None
    for part in parts:
        if part.sizes["point"]:
            found += part.sizes["point"]
            yield checked_cloud(part, name=name)
    if part is not None and not found:
        checked_cloud(part, name=name)
    if found != count:
        raise CubeError(
            f"{name}: {found} points came, {count} were counted before; the range "
            "image changed meanwhile: run it again"
        )


def in_blocks(arrays: Iterable[NDArray[Any]], size: int) -> Iterator[NDArray[Any]]:
    """Yield the elements of arrays in blocks of one size, the last one smaller."""
    waiting: list[NDArray[Any]] = []
    count = 0
    for array in arrays:
        waiting.append(array)
        count += len(array)
        while count >= size:
            joined = waiting[0] if len(waiting) == 1 else np.concatenate(waiting)
            yield joined[:size]
            waiting, count = [joined[size:]], count - size
    if count:
        yield np.concatenate(waiting)


def provenance_lines(cloud: xr.Dataset) -> list[str]:
    """Return what the cloud is and where it comes from, one statement a line."""
    named = ("title", "source", "history", "amulor_schema_version", "software_versions")
    lines = frame_lines(cloud.attrs)
    for key in named:
        text = str(cloud.attrs.get(key, ""))
        lines += [f"{key}: {line.strip()}" for line in text.splitlines()]
    if "quality_flag" in cloud:
        flags = cloud["quality_flag"].attrs
        names = str(flags.get("flag_meanings", "")).split()
        masks = np.atleast_1d(flags.get("flag_masks", []))
        bits = ", ".join(f"{m} {n}" for m, n in zip(masks, names, strict=False))
        lines.append(f"quality_flag: 0 good, or a sum of {bits}")
    words = cubes.error_unknown(cloud)
    if words:
        lines.append(f"uncertainty: {words}; nan where it is not known")
    elif "x_uncertainty" in cloud:
        lines.append(
            "uncertainty: standard uncertainties (GUM, k = 1), of the range along the "
            "beam; those of x, y and z of a point are one error and correlate fully"
        )
    if cloud.attrs.get("simulated"):
        lines.append("simulated: the points come from a simulation")
    return lines


def frame_lines(attributes: Mapping[Hashable, Any]) -> list[str]:
    """Return what the coordinates of a product mean, one statement a line."""
    lines = [f"axes: {attributes.get('frame_axes', _AXES)}"]
    if attributes.get("frame", "instrument") != "instrument":
        numbers = " ".join(f"{v:.12g}" for v in attributes["frame_matrix"])
        lines.append(f"from the instrument's axes, 4 x 4 row by row: {numbers}")
    if attributes.get("crs"):
        offset = ", ".join(f"{v:.12g}" for v in attributes["crs_offset"])
        lines.append(f"reference system: {attributes['crs']}; add ({offset}) m")
    if attributes.get("pose_unknown"):
        lines.append(f"uncertainty of the pose not known: {attributes['pose_unknown']}")
    return lines


def doubtful(cloud: xr.Dataset) -> NDArray[np.bool_]:
    """Return which points have a range that is doubtful by itself."""
    if "quality_flag" not in cloud:
        return np.zeros(cloud.sizes["point"], dtype=bool)
    flags = cloud["quality_flag"].values.astype(np.int64)
    return np.asarray((flags & int(DOUBTFUL)) != 0)
