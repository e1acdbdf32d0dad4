"""Readers and writers of files: netCDF cubes and tallies, common cloud formats.

Photon histograms of other instruments become cubes (`read_transients`) or the response
of slabs (`read_slabs`, `slab_response`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import xarray as xr

from amulor.errors import FormatError
from amulor.io.arrivals import read_arrivals
from amulor.io.e57 import write_e57, write_e57_parts, write_e57_scans
from amulor.io.files import check_output, make_folder
from amulor.io.histograms import Histograms, read_histograms
from amulor.io.laz import write_laz, write_laz_parts
from amulor.io.mcap_cloud import write_mcap, write_mcap_parts
from amulor.io.netcdf import read_cube, row_writer, write_cube
from amulor.io.ply import write_ply, write_ply_parts
from amulor.io.shapes import checked_parts
from amulor.io.slab_response import Slabs, mean_delay, read_slabs, slab_response
from amulor.io.tallies import read_tally, write_tally
from amulor.io.text_cloud import write_text, write_text_parts
from amulor.io.transients import medium_from_minimum, read_transients

__all__ = [
    "CLOUD_SUFFIXES",
    "Histograms",
    "Slabs",
    "check_output",
    "make_folder",
    "mean_delay",
    "medium_from_minimum",
    "read_arrivals",
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
    "write_mcap",
    "write_ply",
    "write_tally",
    "write_text",
]

#: Suffixes that `write_cloud` knows.
CLOUD_SUFFIXES = (".ply", ".laz", ".las", ".e57", ".mcap", ".xyz", ".csv")


def write_cloud(
    cloud: xr.Dataset,
    path: str | os.PathLike[str],
    *,
    shape: tuple[int, int] | None = None,
    slim: bool = False,
    overwrite: bool = False,
) -> None:
    """Write a point cloud in the format of the file's suffix.

    Parameters
    ----------
    cloud : xarray.Dataset
        A cube of level `point_cloud`.
    path : path-like
        File to write, with a suffix of `CLOUD_SUFFIXES`.
    shape : tuple of int, optional
        Rows and columns of the scan, for E57 files only [1]; for the default see
        `write_e57`.
    slim : bool
        Whether LAS and LAZ files have fewer extra dimensions; see `write_laz`.
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
        write_laz(cloud, path, slim=slim, overwrite=overwrite)
    elif suffix == ".e57":
        write_e57(cloud, path, shape=shape, overwrite=overwrite)
    elif suffix == ".mcap":
        write_mcap(cloud, path, overwrite=overwrite)
    elif suffix in (".xyz", ".csv"):
        write_text(cloud, path, overwrite=overwrite)
    else:
        raise _no_cloud_format(path)


def write_cloud_parts(
    parts: Callable[[], Iterator[xr.Dataset]],
    count: int,
    path: str | os.PathLike[str],
    *,
    shape: tuple[int, int],
    slim: bool = False,
    overwrite: bool = False,
) -> None:
    """Write a point cloud in parts; the file is as if written in one piece."""
    match Path(path).suffix.lower():
        case ".ply":
            write_ply_parts(parts(), count, path, overwrite=overwrite)
        case ".laz" | ".las":
            write_laz_parts(parts, count, path, slim=slim, overwrite=overwrite)
        case ".e57":
            write_e57_parts(parts, count, path, shape=shape, overwrite=overwrite)
        case ".mcap":
            write_mcap_parts(parts(), count, path, overwrite=overwrite)
        case ".nc":
            name, done = f"the cloud for {path}", 0
            with row_writer(path, count, overwrite=overwrite, over="point") as writer:
                for part in checked_parts(parts(), count, name=name):
                    scan_shape = np.array(shape, dtype=np.int32)
                    writer.put(part.assign_attrs(scan_shape=scan_shape), done)
                    done += part.sizes["point"]
        case ".xyz" | ".csv":
            write_text_parts(parts(), count, path, overwrite=overwrite)
        case _:
            raise _no_cloud_format(path)


def _no_cloud_format(path: str | os.PathLike[str]) -> FormatError:
    return FormatError(
        f"{path} has the suffix {Path(path).suffix.lower()!r}, which names no format "
        f"for point clouds; use one of {', '.join(CLOUD_SUFFIXES)}"
    )


def __dir__() -> list[str]:
    """List the public names without the modules that define them."""
    return sorted(__all__)
