"""From a range image to points in space."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import UNUSABLE
from amulor.imaging.geometry import beams_of


def point_cloud(image: xr.Dataset) -> xr.Dataset:
    """Place every usable pixel of a range image in space.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.

    Returns
    -------
    xarray.Dataset
        Level `point_cloud`; x right, y down, z forward in the axes of the instrument,
        in which the emitter stands at its `emitter_position`. `row` and `column` say
        which pixel a point comes from, the attribute `scan_shape` how many rows and
        columns the scan has. Points lie on the beam as bent by the window.
    """
    image = cubes.checked(image, "range_image")
    flag = image["quality_flag"].values
    row, column = np.nonzero((flag & UNUSABLE) == 0)
    beam = beams_of(image)
    water = image["slant_range"].values - beam.length_before
    position = beam.entry + water[..., None] * beam.direction
    points = position[row, column]
    cloud = cubes.build(
        "point_cloud",
        {
            "x": points[:, 0],
            "y": points[:, 1],
            "z": points[:, 2],
            "intensity": image["intensity"].values[row, column],
            "slant_range_uncertainty": image["slant_range_uncertainty"].values[
                row, column
            ],
            **_common(image, row, column),
            "quality_flag": flag[row, column],
            "row": row.astype(np.int32),
            "column": column.astype(np.int32),
        },
        {},
        geometry=image.amulor.geometry,
        attributes={
            **image.attrs,
            "level": "point_cloud",
            "scan_shape": np.array(flag.shape, dtype=np.int32),
        },
    )
    return cubes.note(cloud, "point cloud")


def _common(
    image: xr.Dataset, row: NDArray[np.intp], column: NDArray[np.intp]
) -> dict[str, NDArray[np.float64]]:
    """Return the part of the uncertainty that all points share, if the image has it."""
    name = "slant_range_common_uncertainty"
    return {name: image[name].values[row, column]} if name in image else {}
