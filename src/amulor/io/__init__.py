"""Reads and writes files: cubes and tallies as netCDF, clouds in others' formats."""

from __future__ import annotations

import os
from pathlib import Path

import xarray as xr

from amulor.errors import FormatError
from amulor.io.e57 import write_e57
from amulor.io.files import check_output, make_folder
from amulor.io.laz import write_laz
from amulor.io.netcdf import read_cube, write_cube
from amulor.io.ply import write_ply
from amulor.io.tallies import read_tally, write_tally

__all__ = [
    "CLOUD_SUFFIXES",
    "check_output",
    "make_folder",
    "read_cube",
    "read_tally",
    "write_cloud",
    "write_cube",
    "write_e57",
    "write_laz",
    "write_ply",
    "write_tally",
]

#: Suffixes that `write_cloud` knows.
CLOUD_SUFFIXES = (".ply", ".laz", ".las", ".e57")


def write_cloud(
    cloud: xr.Dataset,
    path: str | os.PathLike[str],
    *,
    shape: tuple[int, int],
    overwrite: bool = False,
) -> None:
    """Write a point cloud in the format that the suffix of the file names.

    Parameters
    ----------
    cloud : xarray.Dataset
        A cube of level `point_cloud`.
    path : path-like
        File to make, with one of `CLOUD_SUFFIXES` in small or capital letters.
    shape : tuple of int
        Rows and columns of the scan, which an E57 file needs [1].
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    CubeError
        If the cube is no point cloud, or one that cannot be exported.
    FormatError
        If the suffix is none of these, if the file exists and `overwrite` is not set,
        or if it cannot be written.
    MissingExtraError
        If the package that writes the format is not installed.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".ply":
        write_ply(cloud, path, overwrite=overwrite)
    elif suffix in (".laz", ".las"):
        write_laz(cloud, path, overwrite=overwrite)
    elif suffix == ".e57":
        write_e57(cloud, path, shape=shape, overwrite=overwrite)
    else:
        raise FormatError(
            f"{path} has the suffix {suffix!r}, which names no format for point "
            f"clouds; use one of {', '.join(CLOUD_SUFFIXES)}"
        )
