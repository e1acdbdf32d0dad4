"""Reads and writes files: cubes and tallies as netCDF, clouds in others' formats.

Photon histograms of other instruments become cubes (`read_transients`) or the response
of slabs (`read_slabs`, `slab_response`).
"""

from __future__ import annotations

import os
from pathlib import Path

import xarray as xr

from amulor.errors import FormatError
from amulor.io.e57 import write_e57, write_e57_scans
from amulor.io.files import check_output, make_folder
from amulor.io.histograms import Histograms, read_histograms
from amulor.io.laz import write_laz
from amulor.io.netcdf import read_cube, write_cube
from amulor.io.ply import write_ply
from amulor.io.slab_response import Slabs, mean_delay, read_slabs, slab_response
from amulor.io.tallies import read_tally, write_tally
from amulor.io.text_cloud import write_text
from amulor.io.transients import medium_from_minimum, read_transients

__all__ = [
    "CLOUD_SUFFIXES",
    "Histograms",
    "Slabs",
    "check_output",
    "make_folder",
    "mean_delay",
    "medium_from_minimum",
    "read_cube",
    "read_histograms",
    "read_slabs",
    "read_tally",
    "read_transients",
    "slab_response",
    "write_cloud",
    "write_cube",
    "write_e57",
    "write_e57_scans",
    "write_laz",
    "write_ply",
    "write_tally",
    "write_text",
]

#: Suffixes that `write_cloud` knows.
CLOUD_SUFFIXES = (".ply", ".laz", ".las", ".e57", ".xyz", ".csv")


def write_cloud(
    cloud: xr.Dataset,
    path: str | os.PathLike[str],
    *,
    shape: tuple[int, int] | None = None,
    overwrite: bool = False,
) -> None:
    """Write a point cloud in the format that the suffix of the file names.

    Parameters
    ----------
    cloud : xarray.Dataset
        A cube of level `point_cloud`.
    path : path-like
        File to make, with one of `CLOUD_SUFFIXES` in small or capital letters.
    shape : tuple of int, optional
        Rows and columns of the scan, for an E57 file only [1]; see `write_e57` for
        what it is by default.
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

    Examples
    --------
    >>> from pathlib import Path
    >>> from amulor import imaging, io, rejection, samples
    >>> image = imaging.range_image(
    ...     rejection.cross_polarized(samples.cube("ladder"))
    ... )
    >>> cloud = imaging.point_cloud(image)
    >>> io.write_cloud(cloud, "ladder.xyz")
    >>> Path("ladder.xyz").read_text().splitlines()[0]
    "# axes: right-handed: x right, y down, z forward, in the instrument's axes [m]"
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".ply":
        write_ply(cloud, path, overwrite=overwrite)
    elif suffix in (".laz", ".las"):
        write_laz(cloud, path, overwrite=overwrite)
    elif suffix == ".e57":
        write_e57(cloud, path, shape=shape, overwrite=overwrite)
    elif suffix in (".xyz", ".csv"):
        write_text(cloud, path, overwrite=overwrite)
    else:
        raise FormatError(
            f"{path} has the suffix {suffix!r}, which names no format for point "
            f"clouds; use one of {', '.join(CLOUD_SUFFIXES)}"
        )


def __dir__() -> list[str]:
    """List the public names, not the modules that they come from."""
    return sorted(__all__)
