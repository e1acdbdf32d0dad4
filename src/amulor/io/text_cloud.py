"""Writes point clouds as text: columns under a header that names them."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import xarray as xr

from amulor.io._cloud import checked_cloud, checked_parts, provenance_lines
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

    Examples
    --------
    >>> from pathlib import Path
    >>> from amulor import imaging, io, rejection, samples
    >>> image = imaging.range_image(
    ...     rejection.cross_polarized(samples.cube("ladder"))
    ... )
    >>> cloud = imaging.point_cloud(image)
    >>> io.write_text(cloud, "ladder.csv")
    >>> lines = Path("ladder.csv").read_text().splitlines()
    >>> sum(not line.startswith("#") for line in lines) - 1 == cloud.sizes["point"]
    True
    """
    cloud = checked_cloud(cloud, name=f"the cloud for {path}")
    write_text_parts([cloud], cloud.sizes["point"], path, overwrite=overwrite)


def write_text_parts(
    parts: Iterable[xr.Dataset],
    count: int,
    path: str | os.PathLike[str],
    *,
    overwrite: bool = False,
) -> None:
    """Write a point cloud that comes in parts; the same file as that of the whole.

    Parameters
    ----------
    parts : iterable of xarray.Dataset
        Cubes of level `point_cloud`; what the header says is that of the first.
    count : int
        Points of all of them.
    path, overwrite
        As in `write_text`.

    Raises
    ------
    CubeError, FormatError
        As `write_text`, and if there are not so many points.
    """
    path = Path(path)
    comma = path.suffix.lower() == ".csv"
    mark = "," if comma else " "
    kept: list[tuple[str, str, str, str]] = []
    with (
        atomic_output(path, overwrite=overwrite) as temporary,
        temporary.open("w", encoding="utf-8", newline="\n") as file,
    ):
        for part in checked_parts(parts, count, name=f"the cloud for {path}"):
            if not kept:
                kept = [column for column in _COLUMNS if column[2] in part]
                names = [
                    f"{name} [{unit}]" if comma else f"{name}[{unit}]"
                    for name, unit, _, _ in kept
                ]
                header = [f"# {line}" for line in provenance_lines(part)]
                header.append(("" if comma else "# ") + mark.join(names))
                file.write("\n".join(header) + "\n")
            table = np.column_stack([part[name].values for _, _, name, _ in kept])
            np.savetxt(file, table, fmt=[form for *_, form in kept], delimiter=mark)
