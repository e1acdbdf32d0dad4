"""Writes the surface of a range image as a mesh whose vertices know their errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import imaging, io
from amulor.imaging import products

Floats = NDArray[np.float64]


def write_mesh(
    image: xr.Dataset,
    path: Path,
    surface: products.Surface,
    *,
    scalars: dict[str, tuple[Floats, str]] | None = None,
    overwrite: bool,
) -> None:
    """Write the surface of a range image as a mesh with vertex uncertainties.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    path : pathlib.Path
        File to make (PLY).
    surface : amulor.imaging.products.Surface
        Its surface.
    scalars : dict, optional
        Further properties of the vertices: name to values and what they are.
    overwrite : bool
        Whether an existing file is replaced.
    """
    chosen = imaging.leave_out(image, mixed=True)
    cloud = imaging.point_cloud(chosen, frame=surface.frame)
    io.write_ply(
        cloud, path, faces=surface.triangles, scalars=scalars, overwrite=overwrite
    )
