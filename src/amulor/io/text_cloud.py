"""Writes point clouds as text: columns under a header that names them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import xarray as xr

from amulor.io._cloud import checked_cloud, provenance_lines
from amulor.io.files import atomic_output

# Name of a column, its unit, the variable, and how it is printed: coordinates to the
# micrometre, errors to four digits.
_COLUMNS = (
    ("x", "m", "x", "%.6f"),
    ("y", "m", "y", "%.6f"),
    ("z", "m", "z", "%.6f"),
    ("amplitude", "V", "intensity", "%.6g"),
    ("sigma_x", "m", "x_uncertainty", "%.4g"),
    ("sigma_y", "m", "y_uncertainty", "%.4g"),
    ("sigma_z", "m", "z_uncertainty", "%.4g"),
    ("sigma_range", "m", "slant_range_uncertainty", "%.4g"),
    ("sigma_range_shared", "m", "slant_range_common_uncertainty", "%.4g"),
    ("quality_flag", "1", "quality_flag", "%d"),
    ("row", "1", "row", "%d"),
    ("column", "1", "column", "%d"),
)


def write_text(
    cloud: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a point cloud as text, a line for each point.

    Parameters
    ----------
    cloud : xarray.Dataset
        A cube of level `point_cloud`.
    path : path-like
        File to make: with the suffix `.csv` fields are set apart by commas under a
        header, with any other one by spaces under a comment.
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
    Lines at the start that begin with "#" say what it is, the axes, and where it comes
    from. Coordinates are rounded to a micrometre. UTF-8.
    """
    path = Path(path)
    cloud = checked_cloud(cloud, name=f"the cloud for {path}")
    kept = [column for column in _COLUMNS if column[2] in cloud]
    comma = path.suffix.lower() == ".csv"
    mark = "," if comma else " "
    names = [
        f"{name} [{unit}]" if comma else f"{name}[{unit}]" for name, unit, _, _ in kept
    ]
    header = [f"# {line}" for line in provenance_lines(cloud)]
    header.append(("" if comma else "# ") + mark.join(names))
    table = np.column_stack([cloud[variable].values for _, _, variable, _ in kept])
    with (
        atomic_output(path, overwrite=overwrite) as temporary,
        temporary.open("w", encoding="utf-8", newline="\n") as file,
    ):
        file.write("\n".join(header) + "\n")
        np.savetxt(file, table, fmt=[form for *_, form in kept], delimiter=mark)
