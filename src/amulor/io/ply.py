"""Writes point clouds as PLY files."""

from __future__ import annotations

import os
import textwrap
from pathlib import Path

import numpy as np
import xarray as xr

from amulor.io._cloud import checked_cloud, provenance_lines
from amulor.io.files import atomic_output

# Property of the file, its type, and the variable it comes from. CloudCompare shows
# each property that starts with `scalar_` as a scalar field of that name.
_PROPERTIES = (
    ("x", "double", "<f8", "x"),
    ("y", "double", "<f8", "y"),
    ("z", "double", "<f8", "z"),
    ("scalar_intensity", "double", "<f8", "intensity"),
    ("scalar_slant_range_uncertainty", "double", "<f8", "slant_range_uncertainty"),
    (
        "scalar_slant_range_common_uncertainty",
        "double",
        "<f8",
        "slant_range_common_uncertainty",
    ),
    ("scalar_quality_flag", "int", "<i4", "quality_flag"),
    ("scalar_row", "int", "<i4", "row"),
    ("scalar_column", "int", "<i4", "column"),
)

_LINE_LENGTH = 200


def write_ply(
    cloud: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a point cloud to a binary PLY file, without loss.

    Parameters
    ----------
    cloud : xarray.Dataset
        A cube of level `point_cloud`.
    path : path-like
        File to make, by custom with the suffix `.ply`.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    CubeError
        If the cube is no point cloud, is empty, or has points without a position.
    FormatError
        If the file exists and `overwrite` is not set, or cannot be written.

    Notes
    -----
    Little-endian, one element `vertex`; coordinates [m] as `double`, the other
    variables as properties that start with `scalar_`. Units and provenance stand in
    comments.
    """
    cloud = checked_cloud(cloud, name=f"the cloud for {path}")
    kept = [entry for entry in _PROPERTIES if entry[3] in cloud]
    vertices = np.empty(
        cloud.sizes["point"], dtype=[(name, code) for name, _, code, _ in kept]
    )
    for name, _, _, variable in kept:
        vertices[name] = cloud[variable].values
    comments = [
        f"{name}: {cloud[variable].attrs['long_name']} "
        f"[{cloud[variable].attrs['units']}]"
        for name, _, _, variable in kept
    ]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {line}" for line in _ascii(provenance_lines(cloud) + comments)),
        f"element vertex {vertices.size}",
        *(f"property {kind} {name}" for name, kind, _, _ in kept),
        "end_header\n",
    ]
    with (
        atomic_output(Path(path), overwrite=overwrite) as temporary,
        temporary.open("wb") as file,
    ):
        file.write("\n".join(header).encode("ascii"))
        file.write(vertices.data)


def _ascii(lines: list[str]) -> list[str]:
    # Readers give up on lines beyond 1000 characters, and take the word end_header
    # for the end of the header wherever it stands.
    return [
        part.replace("end_header", "end header")
        for line in lines
        for part in textwrap.wrap(
            line.encode("ascii", "backslashreplace").decode(), _LINE_LENGTH
        )
    ]
