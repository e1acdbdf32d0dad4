"""Point clouds and meshes of any format: columns, and checks of their values."""

from __future__ import annotations

import logging
import re
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import DOUBTFUL
from amulor.errors import CubeError, FormatError, MissingExtraError

Up = Literal["-y", "y", "z"]

#: Point values that the page has labels for, and their names in files.
KNOWN = {
    "uncertainty": ("slant_range_uncertainty", "sigma_range", "uncertainty"),
    "common": (
        "slant_range_common_uncertainty",
        "common_uncertainty",
        "sigma_range_shared",
    ),
    "sigma_x": ("sigma_x", "x_uncertainty"),
    "sigma_y": ("sigma_y", "y_uncertainty"),
    "sigma_z": ("sigma_z", "z_uncertainty"),
    "amplitude": ("amplitude",),
    "intensity": ("intensity", "reflectance", "i"),
    "flags": ("quality_flag",),
}
#: Largest number of point values that are shown; others are omitted, which the page
#: states.
_MOST_OTHERS = 8
_TAKEN = (*KNOWN, "height", "position", "faces", "colour")


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Point cloud or mesh, as read from a file."""

    position: NDArray[np.float64]
    """Points or vertices, shape (n, 3) [m]."""
    scalars: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    """Numeric properties of the points, named as in `KNOWN` or as in the file."""
    colour: NDArray[np.uint8] | None = None
    """Red, green and blue of the points, shape (n, 3)."""
    faces: NDArray[np.intp] | None = None
    """Point numbers of each triangle's corners, shape (m, 3)."""
    up: Up = "z"
    """Axis that points up."""
    statements: Sequence[str] = ()
    """Description and provenance lines of the file."""
    total: int = 0
    """Number of points in the file, of which a thinned cloud has only a part."""
    ends: NDArray[np.float64] | None = None
    """Lowest and highest coordinates of each block of the file, shape (n, 2, 3) [m]."""


def scalars_of(
    columns: Mapping[str, NDArray[Any]],
) -> tuple[dict[str, NDArray[np.float64]], list[str]]:
    """Columns as numbers, by their names in `KNOWN`, and names of unused columns."""
    plain = {
        name: name.lower().removeprefix("scalar_").partition("[")[0].strip()
        for name in columns
    }
    scalars: dict[str, NDArray[np.float64]] = {}
    used: set[str] = set()
    for name, aliases in KNOWN.items():
        for column, plain_name in plain.items():
            if plain_name in aliases and column not in used and name not in scalars:
                scalars[name] = np.asarray(columns[column], dtype=float)
                used.add(column)
    if "amplitude" in scalars:
        # A LAS file also has the amplitude in parts of its largest value.
        scalars.pop("intensity", None)
    remaining = [column for column in columns if column not in used]
    for column in remaining[:_MOST_OTHERS]:
        # The name becomes part of a URL, beside the names of the page itself.
        name = re.sub(r"[^\w -]", "_", plain[column])[:40].strip() or "unnamed"
        while name in scalars or name in _TAKEN:
            name += " 2"
        scalars[name] = np.asarray(columns[column], dtype=float)
    return scalars, remaining[_MOST_OTHERS:]


def up_of(statements: Sequence[str], default: Up = "z") -> Up:
    """Vertical axis of a file's coordinates, from its header lines."""
    for line in statements:
        if line.startswith("axes:"):
            return "-y" if "y down" in line else "z"
    return default


def checked(shape: Shape, name: str) -> Shape:
    """Drop non-finite points and empty columns; raise if no point remains."""
    # Columns without a finite value, such as errors with the water left in.
    scalars = {k: v for k, v in shape.scalars.items() if np.isfinite(v).any()}
    shape = Shape(**{**vars(shape), "scalars": scalars})
    finite = np.asarray(np.isfinite(shape.position).all(axis=1))
    count = len(shape.position)
    if not finite.any():
        raise FormatError(
            f"{name} holds no point with a finite place; it is empty or damaged"
        )
    largest = float(np.abs(shape.position[finite]).max())
    if largest > 1e9:
        raise FormatError(
            f"{name} has a coordinate of {largest:.3g} m, which no survey has; it is "
            "damaged, or its unit is another one (--unit)"
        )
    faces = shape.faces
    if faces is not None and len(faces):
        if faces.min() < 0 or faces.max() >= count:
            raise FormatError(
                f"{name} has a triangle with corner {int(faces.max())}, but only "
                f"{count} vertices; it is damaged, write it again"
            )
        faces = faces[np.all(finite[faces], axis=1)]
        # A vertex with one damaged coordinate may have another beyond all measure.
        position = np.where(finite[:, np.newaxis], shape.position, np.nan)
        return Shape(**{**vars(shape), "faces": faces, "position": position})
    if finite.all():
        return Shape(**{**vars(shape), "faces": None})
    return thinned(Shape(**{**vars(shape), "faces": None}), np.flatnonzero(finite))


def thinned(shape: Shape, indices: NDArray[np.intp]) -> Shape:
    """Select points of a cloud, and drop triangles."""
    return Shape(
        position=shape.position[indices],
        scalars={name: values[indices] for name, values in shape.scalars.items()},
        colour=None if shape.colour is None else shape.colour[indices],
        up=shape.up,
        statements=shape.statements,
        total=shape.total or len(shape.position),
    )


def spread(total: int, most: int) -> NDArray[np.intp]:
    """Return the indices of an evenly distributed random subset of points.

    Regular steps through the rows of a scan would select points along lines.
    """
    step = -(-total // most)
    if step <= 1:
        return np.arange(total)
    first = np.arange(0, total, step)
    # Equal files give equal pictures.
    offset = np.random.default_rng(1).integers(0, step, first.size)
    return np.asarray(np.minimum(first + offset, total - 1), dtype=np.intp)


def read_mesh(path: Path, *, unit: float) -> Shape:
    """Read an STL, OBJ, OFF or GLB mesh, without linked files such as textures."""
    try:
        import trimesh
    except ImportError as error:
        raise MissingExtraError(
            "trimesh", extra="scene", purpose="reading meshes"
        ) from error
    # The error describes the damage; its log would repeat it.
    logging.getLogger("trimesh").addHandler(logging.NullHandler())
    ending = path.suffix.lower().removeprefix(".")
    try:
        with path.open("rb") as file:
            mesh: Any = trimesh.load(
                file,
                file_type=ending,
                force="mesh",
                process=False,
                skip_materials=True,
            )
        vertices = vertices_of(mesh) * unit
        faces = np.array(mesh.faces, dtype=np.intp).reshape(-1, 3)
    except Exception as error:  # trimesh's readers raise many kinds
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(f"{path.name} cannot be read as a mesh: {reason}") from error
    if not len(faces):
        raise FormatError(f"{path.name} holds no triangle; it is empty or damaged")
    # The format of glTF says that y is up; others say nothing.
    up: Up = "y" if ending == "glb" else "z"
    return Shape(position=vertices, faces=faces, up=up, total=len(vertices))


def vertices_of(mesh: Any) -> NDArray[np.float64]:
    """Vertices of a mesh, shape (n, 3); raise if they have other coordinates."""
    vertices = np.array(mesh.vertices, dtype=float)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ValueError("its vertices do not have three coordinates each")
    return vertices


# What the axes mean, for the header of a file that has no place for it.
_AXES = "right-handed: x right, y down, z forward, in the instrument's axes [m]"

# Largest number that each format can hold.
_LAST = {"row": 2**31 - 1, "column": 2**31 - 1, "quality_flag": 2**15 - 1}


def checked_cloud(cloud: xr.Dataset, *, name: str) -> xr.Dataset:
    """Return a point cloud; raise if it is empty or has invalid values."""
    cloud = cubes.checked(cloud, level="point_cloud", name=name)
    if cloud.sizes["point"] == 0:
        raise CubeError(
            f"{name}: there is no point in it; look at the quality flags of the range "
            "image that it was made from"
        )
    for variable in ("x", "y", "z", "intensity"):
        broken = np.count_nonzero(~np.isfinite(cloud[variable].values))
        if broken:
            raise CubeError(
                f"{name}: '{variable}' of {broken} points is not finite; drop these "
                "points"
            )
    for variable, last in _LAST.items():
        if variable not in cloud:
            continue
        values = cloud[variable].values
        if not np.all((values >= 0) & (values <= last) & (values == np.floor(values))):
            raise CubeError(
                f"{name}: '{variable}' must hold whole numbers from 0 to {last}, "
                f"found {np.min(values):g} to {np.max(values):g}; make the cloud again "
                "from its range image"
            )
    return cloud


def checked_parts(
    parts: Iterable[xr.Dataset], count: int, *, name: str
) -> Iterator[xr.Dataset]:
    """Yield non-empty parts of a cloud; raise for invalid values or a wrong count."""
    summed = 0
    part = None
    for part in parts:
        if part.sizes["point"]:
            summed += part.sizes["point"]
            yield checked_cloud(part, name=name)
    if part is not None and not summed:
        checked_cloud(part, name=name)
    if summed != count:
        raise CubeError(
            f"{name}: {summed} points came, {count} were counted before; the range "
            "image changed meanwhile: run it again"
        )


def in_blocks(arrays: Iterable[NDArray[Any]], size: int) -> Iterator[NDArray[Any]]:
    """Yield the elements of several arrays in blocks of equal size."""
    waiting: list[NDArray[Any]] = []
    count = 0
    for array in arrays:
        waiting.append(array)
        count += len(array)
        while count >= size:
            joined = waiting[0] if len(waiting) == 1 else np.concatenate(waiting)
            yield joined[:size]
            waiting, count = [joined[size:]], count - size
    if count:
        yield np.concatenate(waiting)


def provenance_lines(cloud: xr.Dataset) -> list[str]:
    """Return description and processing history of a cloud, as lines of text."""
    named = ("title", "source", "history", "amulor_schema_version", "software_versions")
    lines = frame_lines(cloud.attrs)
    for key in named:
        text = str(cloud.attrs.get(key, ""))
        lines += [f"{key}: {line.strip()}" for line in text.splitlines()]
    if "quality_flag" in cloud:
        flags = cloud["quality_flag"].attrs
        names = str(flags.get("flag_meanings", "")).split()
        masks = np.atleast_1d(flags.get("flag_masks", []))
        bits = ", ".join(f"{m} {n}" for m, n in zip(masks, names, strict=False))
        lines.append(f"quality_flag: 0 good, or a sum of {bits}")
    words = cubes.error_unknown(cloud)
    if words:
        lines.append(f"uncertainty: {words}; nan where it is not known")
    elif "x_uncertainty" in cloud:
        lines.append(
            "uncertainty: standard uncertainties (GUM, k = 1), of the range along the "
            "beam; those of x, y and z of a point are one error and correlate fully"
        )
    if cloud.attrs.get("simulated"):
        lines.append("simulated: the points come from a simulation")
    return lines


def frame_lines(attributes: Mapping[Hashable, Any]) -> list[str]:
    """Return the meaning of a product's coordinates, as lines of text."""
    lines = [f"axes: {attributes.get('frame_axes', _AXES)}"]
    if attributes.get("frame", "instrument") not in ("instrument", "trajectory"):
        numbers = " ".join(f"{v:.12g}" for v in attributes["frame_matrix"])
        lines.append(f"from the instrument's axes, 4 x 4 row by row: {numbers}")
    if attributes.get("crs"):
        offset = ", ".join(f"{v:.12g}" for v in attributes["crs_offset"])
        lines.append(f"reference system: {attributes['crs']}; add ({offset}) m")
    if attributes.get("reading_spread"):
        spread = float(attributes["reading_spread"])
        lines.append(
            f"readings of a point: taken along {spread * 1e3:.3g} mm of the track"
        )
    if attributes.get("pose_unknown"):
        lines.append(f"uncertainty of the pose not known: {attributes['pose_unknown']}")
    return lines


def doubtful(cloud: xr.Dataset) -> NDArray[np.bool_]:
    """Mask of points with flags that make their range doubtful."""
    if "quality_flag" not in cloud:
        return np.zeros(cloud.sizes["point"], dtype=bool)
    flags = cloud["quality_flag"].values.astype(np.int64)
    return np.asarray((flags & int(DOUBTFUL)) != 0)
