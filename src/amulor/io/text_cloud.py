"""Point clouds as text: columns of numbers, usually with a header."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import numpy as np
import xarray as xr

from amulor.errors import FormatError
from amulor.io.files import atomic_output
from amulor.io.shapes import (
    Shape,
    checked_cloud,
    checked_parts,
    provenance_lines,
    scalars_of,
    up_of,
)

# Name of a column, its unit, the variable, and how it is printed: coordinates to the
# micrometer, errors to four digits.
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
_MOST_HEADER = 500
_MOST_COLUMNS = 64


def write_text(
    cloud: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a point cloud as text, one line per point.

    Parameters
    ----------
    cloud : xarray.Dataset
        A cube of level `point_cloud`.
    path : path-like
        File to write. With the suffix `.csv` commas separate the fields below a header,
        otherwise spaces below a comment.
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
    First lines that begin with "#" describe the content, the axes and the provenance.
    Coordinates are rounded to a micrometer. The encoding is UTF-8.

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
    >>> header = next(line for line in lines if not line.startswith("#"))
    >>> header.split(",")[:4]
    ['x [m]', 'y [m]', 'z [m]', 'amplitude [V]']
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
    """Write a point cloud as text in parts; the file is as if written in one piece."""
    path = Path(path)
    comma = path.suffix.lower() == ".csv"
    mark = "," if comma else " "
    columns: list[tuple[str, str, str, str]] = []
    with (
        atomic_output(path, overwrite=overwrite) as temporary,
        temporary.open("w", encoding="utf-8", newline="\n") as file,
    ):
        for part in checked_parts(parts, count, name=f"the cloud for {path}"):
            if not columns:
                columns = [column for column in _COLUMNS if column[2] in part]
                names = [
                    f"{name} [{unit}]" if comma else f"{name}[{unit}]"
                    for name, unit, _, _ in columns
                ]
                header = [f"# {line}" for line in provenance_lines(part)]
                header.append(("" if comma else "# ") + mark.join(names))
                file.write("\n".join(header) + "\n")
            table = np.column_stack([part[name].values for _, _, name, _ in columns])
            np.savetxt(file, table, fmt=[form for *_, form in columns], delimiter=mark)


def read_text(path: Path, *, unit: float) -> Shape:
    """Read a point cloud from text.

    Lines of numbers, separated by spaces, tabs, commas or semicolons: x, y, z, then an
    amplitude, or red, green, blue, unless a header names the columns. Lines that begin
    with "#" or "//" are comments.
    """
    with path.open("rb") as file:
        lines = [line.decode("utf-8", "replace") for line in islice(file, _MOST_HEADER)]
    comments: list[str] = []
    names: list[str] | None = None
    skip = 0
    first: list[str] = []
    mark: str | None = None
    for line in lines:
        text = line.strip()
        if not text or text.startswith(("#", "//")):
            comments.append(text.lstrip("#/ "))
            skip += 1
            continue
        mark = next((m for m in ",;" if m in text), None)
        first = [part.strip() for part in text.split(mark)]
        if all(_is_number(part) for part in first) and len(first) >= 3:
            break
        skip += 1
        if len(first) == 1 and first[0].isdigit():
            continue  # some programs begin with the number of points
        if names is not None or len(first) < 3:
            raise FormatError(
                f"{path.name}, line {skip}: {text[:60]!r} are no coordinates; a cloud "
                "as text has x, y and z in every line"
            )
        names = [_plain(part) for part in first]
    else:
        raise FormatError(f"{path.name} has no line with x, y and z in it")
    if names is None and comments:
        words = comments[-1].split(mark)
        if len(words) == len(first) and not any(_is_number(part) for part in words):
            names = [_plain(part) for part in words]
    names = _named(names, len(first), path.name)
    table = _table(path, mark, skip, len(first))
    columns = dict(zip(names, table.T, strict=True))
    position = np.stack([columns.pop(axis) for axis in "xyz"], axis=1) * unit
    colour = None
    light = [columns.get(name) for name in ("red", "green", "blue")]
    if all(part is not None for part in light):
        stacked = np.stack([part for part in light if part is not None], axis=1)
        if stacked.min() >= 0 and stacked.max() <= 255 and stacked.max() > 1:
            colour = stacked.astype(np.uint8)
            for name in ("red", "green", "blue"):
                del columns[name]
    scalars, unused = scalars_of(columns)
    return Shape(
        position=position,
        scalars=scalars,
        colour=colour,
        up=up_of(comments),
        statements=[
            *comments,
            *([f"not shown: {', '.join(unused)}"] if unused else []),
        ],
        total=len(position),
    )


def _table(path: Path, mark: str | None, skip: int, width: int) -> np.ndarray:
    try:
        table = np.loadtxt(
            path,
            delimiter=mark,
            skiprows=skip,
            comments=("#", "//"),
            ndmin=2,
            encoding="utf-8",
        )
    except (ValueError, UnicodeDecodeError) as error:
        note = re.sub(r"\s+", " ", str(error)).partition(";")[0]
        raise FormatError(
            f"{path.name} cannot be read as columns of numbers: {note}; it is damaged, "
            "or no point cloud"
        ) from None
    if table.shape[1] != width:
        raise FormatError(
            f"{path.name} has {table.shape[1]} columns, and {width} in its first line"
        )
    return table


def _named(names: list[str] | None, width: int, name: str) -> list[str]:
    """Names of all columns: from the header, else usual names for their number."""
    if width > _MOST_COLUMNS:
        raise FormatError(f"{name} has {width} columns; no point cloud has so many")
    if names is not None and {"x", "y", "z"} <= set(names) and len(names) == width:
        return [
            title if names.index(title) == at else f"{title} {at + 1}"
            for at, title in enumerate(names)
        ]
    colours = ["red", "green", "blue"]
    usual = {
        3: [], 4: ["intensity"], 6: colours, 7: ["intensity", *colours],
    }.get(width)  # fmt: skip
    if usual is None:
        usual = [f"column {at + 1}" for at in range(3, width)]
    return ["x", "y", "z", *usual]


def _plain(text: str) -> str:
    """Name of a column without unit and quotes."""
    name = text.strip().strip('"').partition("[")[0].strip().lower()
    short = {"r": "red", "g": "green", "b": "blue", "//x": "x"}
    return short.get(name, name) or "unnamed"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
