"""Point clouds and meshes as PLY files."""

from __future__ import annotations

import logging
import os
import textwrap
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from amulor.errors import FormatError, MissingExtraError
from amulor.io.files import atomic_output
from amulor.io.shapes import (
    Shape,
    checked_cloud,
    checked_parts,
    provenance_lines,
    scalars_of,
    up_of,
)

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
    ("scalar_sigma_x", "double", "<f8", "x_uncertainty"),
    ("scalar_sigma_y", "double", "<f8", "y_uncertainty"),
    ("scalar_sigma_z", "double", "<f8", "z_uncertainty"),
    ("scalar_quality_flag", "int", "<i4", "quality_flag"),
    ("scalar_row", "int", "<i4", "row"),
    ("scalar_column", "int", "<i4", "column"),
)

_LINE_LENGTH = 200
#: Lines of a header that are read for comments.
_MOST_LINES = 2000
#: Sizes of the types of properties [byte].
_BYTES = {
    kind: size
    for size, kinds in (
        (1, "char uchar int8 uint8"),
        (2, "short ushort int16 uint16 float16"),
        (4, "int uint int32 uint32 float float32"),
        (8, "double float64 int64 uint64"),
    )
    for kind in kinds.split()
}
_COLOURS = ("red", "green", "blue")


def write_ply(
    cloud: xr.Dataset,
    path: str | os.PathLike[str],
    *,
    faces: ArrayLike | None = None,
    scalars: Mapping[str, tuple[ArrayLike, str]] | None = None,
    overwrite: bool = False,
) -> None:
    """Write a point cloud, or a mesh over its points, to a binary PLY file.

    Parameters
    ----------
    cloud : xarray.Dataset
        A cube of level `point_cloud`.
    path : path-like
        File to write, usually with the suffix `.ply`.
    faces : array_like of int, shape (m, 3), optional
        Triangles between points, as point indices; none for a cloud.
    scalars : mapping of str to tuple, optional
        Further properties of the points: name, values of shape (n,), and description.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    CubeError
        If the cube is no point cloud, is empty, or has points without a position.
    ValueError
        If a triangle refers to a missing point, or a property has the wrong number of
        values.
    FormatError
        If the file exists and `overwrite` is not set, or cannot be written.

    Notes
    -----
    The file is little-endian and lossless. It has an element `vertex`, and for
    triangles an element `face`. Coordinates [m] are `double`; names of other variables
    start with `scalar_`. Comments have units and provenance.

    Examples
    --------
    >>> from pathlib import Path
    >>> from amulor import imaging, io, rejection, samples
    >>> image = imaging.range_image(
    ...     rejection.cross_polarized(samples.cube("ladder"))
    ... )
    >>> cloud = imaging.point_cloud(image)
    >>> io.write_ply(cloud, "ladder.ply")
    >>> Path("ladder.ply").read_bytes()[:3]
    b'ply'
    """
    cloud = checked_cloud(cloud, name=f"the cloud for {path}")
    more = {
        name: np.asarray(values, dtype=float)
        for name, (values, _) in (scalars or {}).items()
    }
    count = cloud.sizes["point"]
    for name, values in more.items():
        if values.shape != (count,):
            raise ValueError(
                f"scalars must have {count} values each, as many as points; {name} has "
                f"{values.size}"
            )
    triangles = _triangles(faces, count)
    about = {name: text for name, (_, text) in (scalars or {}).items()}
    _write([cloud], count, path, overwrite=overwrite, more=more, about=about,
           triangles=triangles)  # fmt: skip


def write_ply_parts(
    parts: Iterable[xr.Dataset],
    count: int,
    path: str | os.PathLike[str],
    *,
    overwrite: bool = False,
) -> None:
    """Write a point cloud to PLY in parts; the file is as if written in one piece."""
    checked = checked_parts(parts, count, name=f"the cloud for {path}")
    _write(checked, count, path, overwrite=overwrite)


def _write(
    parts: Iterable[xr.Dataset],
    count: int,
    path: str | os.PathLike[str],
    *,
    overwrite: bool,
    more: Mapping[str, NDArray[np.float64]] | None = None,
    about: Mapping[str, str] | None = None,
    triangles: NDArray[np.void] | None = None,
) -> None:
    """Write parts of a cloud to PLY; only a single part may have triangles."""
    faces = [] if triangles is None else _face_lines(triangles)
    with (
        atomic_output(Path(path), overwrite=overwrite) as temporary,
        temporary.open("wb") as file,
    ):
        for part in parts:
            if file.tell() == 0:
                file.write(_header(part, count, about or {}, faces))
            file.write(_vertices(part, more or {}).data)
        if faces and triangles is not None:
            file.write(triangles.data)


def _header(
    cloud: xr.Dataset, count: int, about: Mapping[str, str], faces: list[str]
) -> bytes:
    """Header of a PLY file, up to the first point."""
    properties = [entry for entry in _PROPERTIES if entry[3] in cloud]
    comments = [
        f"{name}: {cloud[variable].attrs['long_name']} "
        f"[{cloud[variable].attrs['units']}]"
        for name, _, _, variable in properties
    ]
    comments += [f"{name}: {text}" for name, text in about.items()]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {line}" for line in _ascii(provenance_lines(cloud) + comments)),
        f"element vertex {count}",
        *(f"property {kind} {name}" for name, kind, _, _ in properties),
        *(f"property double {name}" for name in about),
        *faces,
        "end_header\n",
    ]
    return "\n".join(lines).encode("ascii")


def _vertices(
    cloud: xr.Dataset, more: Mapping[str, NDArray[np.float64]]
) -> NDArray[np.void]:
    """Points of a cloud as PLY vertex records."""
    properties = [entry for entry in _PROPERTIES if entry[3] in cloud]
    vertices = np.empty(
        cloud.sizes["point"],
        dtype=[(name, code) for name, _, code, _ in properties]
        + [(name, "<f8") for name in more],
    )
    for name, _, _, variable in properties:
        vertices[name] = cloud[variable].values
    for name, values in more.items():
        vertices[name] = values
    return vertices


def _triangles(faces: ArrayLike | None, count: int) -> NDArray[np.void]:
    """Triangles as PLY face records."""
    corners = np.zeros((0, 3)) if faces is None else np.asarray(faces)
    if corners.ndim != 2 or corners.shape[1] != 3:
        raise ValueError(f"faces must have the shape (m, 3), got {corners.shape}")
    if corners.size and not (corners.min() >= 0 and corners.max() < count):
        raise ValueError(f"faces must name points from 0 to {count - 1}")
    records = np.empty(len(corners), dtype=[("number", "u1"), ("corners", "<i4", 3)])
    records["number"], records["corners"] = 3, corners
    return records


def _face_lines(triangles: NDArray[np.void]) -> list[str]:
    if not len(triangles):
        return []
    return [
        f"element face {len(triangles)}",
        "property list uchar int vertex_indices",
    ]


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


def read_ply(path: Path, *, unit: float) -> Shape:
    """Read a PLY file, text or binary, with all numeric properties of its points."""
    try:
        from trimesh.exchange import ply
        from trimesh.geometry import triangulate_quads
    except ImportError as error:
        raise MissingExtraError(
            "trimesh", extra="scene", purpose="reading PLY files"
        ) from error
    # The error describes the damage in one line; the log of trimesh would add more
    # lines.
    logging.getLogger("trimesh").addHandler(logging.NullHandler())
    with path.open("rb") as file:
        if file.readline(16).strip() != b"ply":
            raise FormatError(
                f"{path.name} is no PLY file: it does not begin with 'ply'"
            )
        comments = _comments(file)
        file.seek(0)
        _check_length(file, path.name)
        file.seek(0)
        try:
            # Without `fix_texture` the vertices are those of the file, in its order.
            loaded: Any = ply.load_ply(file, fix_texture=False, skip_materials=True)
            vertex = loaded["metadata"]["_ply_raw"]["vertex"]
            columns = _columns_of(vertex)
            faces = loaded.get("faces")
            if faces is not None:
                faces = np.asarray(triangulate_quads(faces), dtype=np.intp)
                faces = faces.reshape(-1, 3)
        except Exception as error:  # trimesh raises a different error for each damage
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            raise FormatError(
                f"{path.name} cannot be read as PLY: {reason}; it is damaged, was not "
                "copied whole, or mixes polygons of several numbers of corners: write "
                "triangles"
            ) from error
    if not {"x", "y", "z"} <= set(columns):
        raise FormatError(f"{path.name} has no points with x, y and z")
    position = np.stack([columns.pop(axis).astype(float) for axis in "xyz"], axis=1)
    colour = None
    if set(_COLOURS) <= set(columns):
        parts = [columns.pop(name) for name in _COLOURS]
        if parts[0].dtype == np.uint8:
            colour = np.stack(parts, axis=1)
    if any(c.startswith("scalar_intensity:") and c.endswith("[V]") for c in comments):
        columns["amplitude"] = columns.pop("scalar_intensity")
    scalars, unused = scalars_of(columns)
    return Shape(
        position=position * unit,
        scalars=scalars,
        colour=colour,
        faces=faces,
        up=up_of(comments),
        statements=[
            *comments,
            *([f"not shown: {', '.join(unused)}"] if unused else []),
        ],
        total=len(position),
    )


def _comments(file: BinaryIO) -> list[str]:
    """Comments in the header of a PLY file, which trimesh discards."""
    comments = []
    for _ in range(_MOST_LINES):
        line = file.readline(4096).decode("ascii", "replace").strip()
        if not line or line == "end_header":
            break
        if line.startswith(("comment ", "obj_info ")):
            comments.append(line.partition(" ")[2])
    return comments


def _check_length(file: BinaryIO, name: str) -> None:
    """Raise if a file has fewer or more lines or bytes than its header declares."""
    elements: list[tuple[int, list[list[str]]]] = []
    form = ""
    for _ in range(_MOST_LINES):
        words = file.readline(4096).decode("ascii", "replace").split()
        if words[:1] == ["format"] and len(words) > 1:
            form = words[1]
        if words[:1] == ["element"] and len(words) == 3 and words[2].isdigit():
            elements.append((int(words[2]), []))
        if words[:1] == ["property"] and elements:
            elements[-1][1].append(words[1:-1])
        if words == ["end_header"]:
            break
    else:
        return
    if form == "ascii":
        unit, declared = "lines", sum(count for count, _ in elements)
        length = sum(1 for line in file if not line.isspace())
    else:
        unit, begin = "bytes", file.tell()
        try:
            declared = _bytes_of(file, elements, "big" if "big" in form else "little")
        except (LookupError, ValueError, OSError):  # trimesh names the damage
            return
        length = file.seek(0, os.SEEK_END) - begin
    if length != declared:
        counts = " + ".join(str(count) for count, _ in elements)
        raise FormatError(
            f"{name} declares {counts} elements in {declared} {unit}, and has {length} "
            f"{unit}; it is damaged, was not copied whole, or mixes polygons of "
            "several numbers of corners: write triangles"
        )


def _bytes_of(
    file: BinaryIO,
    elements: list[tuple[int, list[list[str]]]],
    order: Literal["big", "little"],
) -> int:
    """Byte count of binary elements whose lists have the first record's length."""
    begin, size = file.tell(), 0
    for count, properties in elements:
        record = 0
        for kinds in properties if count else []:
            if kinds[0] == "list":
                file.seek(begin + size + record)
                number = int.from_bytes(file.read(_BYTES[kinds[1]]), order)
                record += _BYTES[kinds[1]] + number * _BYTES[kinds[2]]
            else:
                record += _BYTES[kinds[0]]
        size += count * record
    return size


def _columns_of(element: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Values of a PLY element by name, in the byte order of this computer."""
    data, count = element.get("data", {}), element["length"]
    columns = {}
    for name in element["properties"]:
        values = np.asarray(data[name])
        if values.size != count or values.dtype.kind not in "iuf":
            raise ValueError(f"{name!r} has {values.size} numbers for {count} points")
        plain = values.dtype.newbyteorder("=")
        columns[name] = values.reshape(count).astype(plain)
    return columns
