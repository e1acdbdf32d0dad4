"""Scans of a site as point clouds in its frame, for files that keep scans apart."""

from __future__ import annotations

import numpy as np
import xarray as xr

from amulor.imaging import Frame, point_cloud
from amulor.site.merging.cloud import Merged
from amulor.site.registration.result import Registration


def scan_clouds(
    cloud: Merged, registration: Registration, images: dict[str, xr.Dataset]
) -> list[xr.Dataset]:
    """Return one point cloud for each scan, with its pose and its uncertainties.

    Parameters
    ----------
    cloud : Merged
        For places and uncertainties.
    registration : Registration
        For the poses.
    images : dict of str to xarray.Dataset
        Range images by scan.

    Returns
    -------
    list of xarray.Dataset
        Level `point_cloud`, in the order of the site file.
    """
    frame = cloud.site.frame
    clouds = []
    for number, scan in enumerate(cloud.site.scan):
        pose = registration.poses[scan.name]
        axes = Frame(
            name="pose",
            rotation=pose.rotation,
            position=pose.position,
            crs=frame.crs,
            crs_offset=frame.crs_offset,
        )
        one = point_cloud(images[scan.name], frame=axes)
        columns = int(one.attrs["scan_shape"][1])
        pixel = one["row"].values.astype(int) * columns + one["column"].values
        mine = np.flatnonzero(cloud.scan == number)
        order = np.searchsorted(cloud.pixel[mine], pixel)
        order = np.minimum(order, len(mine) - 1)
        there = cloud.pixel[mine[order]] == pixel
        one = one.isel(point=np.flatnonzero(there))
        at = mine[order[there]]
        changed = {}
        for axis, name in enumerate("xyz"):
            changed[name] = one[name].copy(data=cloud.position[at, axis])
            changed[f"{name}_uncertainty"] = one[f"{name}_uncertainty"].copy(
                data=cloud.sigma[at, axis]
            )
        one = one.assign(changed)
        one.attrs["title"] = scan.name
        clouds.append(one)
    return clouds
