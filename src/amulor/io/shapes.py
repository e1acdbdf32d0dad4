"""Points, triangles and numbers of a cloud or a mesh of any format; reads meshes."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from amulor.errors import FormatError, MissingExtraError

Up = Literal["-y", "y", "z"]

#: Numbers of points that the page has words for, and the names they have in files.
KNOWN = {
    "uncertainty": ("slant_range_uncertainty", "sigma_range"),
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
#: Further numbers of points that are shown; the rest is left out, and the page says so.
_MOST_OTHERS = 8
_TAKEN = (*KNOWN, "height", "position", "faces", "colour")


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A point cloud, or a mesh."""

    position: NDArray[np.float64]
    """Points or vertices, shape (n, 3) [m]."""
    scalars: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    """Numbers of the points by the names of `KNOWN` or by those of the file."""
    colour: NDArray[np.uint8] | None = None
    """Red, green, blue of the points, shape (n, 3)."""
    faces: NDArray[np.intp] | None = None
    """Corners of triangles, shape (m, 3)."""
    up: Up = "z"
    """Which of its axes points up."""
    statements: Sequence[str] = ()
    """What the file says of itself."""
    total: int = 0
    """Points in the file; more than are here if it was thinned."""


def scalars_of(
    columns: Mapping[str, NDArray[Any]],
) -> tuple[dict[str, NDArray[np.float64]], list[str]]:
    """Sort columns into numbers by names of `KNOWN`, and names that are left out."""
    plain = {
        name: name.lower().removeprefix("scalar_").partition("[")[0].strip()
        for name in columns
    }
    found: dict[str, NDArray[np.float64]] = {}
    taken: set[str] = set()
    for name, aliases in KNOWN.items():
        for column, own in plain.items():
            if own in aliases and column not in taken and name not in found:
                found[name] = np.asarray(columns[column], dtype=float)
                taken.add(column)
    if "amplitude" in found:
        # Beside the amplitude a LAS file has it once more, in parts of the largest.
        found.pop("intensity", None)
    others = [column for column in columns if column not in taken]
    for column in others[:_MOST_OTHERS]:
        # The name becomes a part of an address, beside those of the page itself.
        name = re.sub(r"[^\w -]", "_", plain[column])[:40].strip() or "unnamed"
        while name in found or name in _TAKEN:
            name += " 2"
        found[name] = np.asarray(columns[column], dtype=float)
    return found, others[_MOST_OTHERS:]


def up_of(statements: Sequence[str], default: Up = "z") -> Up:
    """Vertical axis by the header lines of a file of amulor: -y in instrument axes."""
    for line in statements:
        if line.startswith("axes:"):
            return "-y" if "y down" in line else "z"
    return default


def checked(shape: Shape, name: str) -> Shape:
    """Drop points without a finite place and numbers never known; raise if empty."""
    # Numbers of which none is known, such as errors with the water left in.
    known = {k: v for k, v in shape.scalars.items() if np.isfinite(v).any()}
    shape = Shape(**{**vars(shape), "scalars": known})
    there = np.asarray(np.isfinite(shape.position).all(axis=1))
    count = len(shape.position)
    if not there.any():
        raise FormatError(
            f"{name} holds no point with a finite place; it is empty or damaged"
        )
    largest = float(np.abs(shape.position[there]).max())
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
        faces = faces[np.all(there[faces], axis=1)]
        return Shape(**{**vars(shape), "faces": faces})
    if there.all():
        return Shape(**{**vars(shape), "faces": None})
    return thinned(Shape(**{**vars(shape), "faces": None}), np.flatnonzero(there))


def thinned(shape: Shape, kept: NDArray[np.intp]) -> Shape:
    """Select some points of a cloud; its triangles are dropped."""
    return Shape(
        position=shape.position[kept],
        scalars={name: values[kept] for name, values in shape.scalars.items()},
        colour=None if shape.colour is None else shape.colour[kept],
        up=shape.up,
        statements=shape.statements,
        total=shape.total or len(shape.position),
    )


def spread(total: int, most: int) -> NDArray[np.intp]:
    """Numbers of points drawn evenly: one of every so many, at a random place in each.

    The rows of a scan and an even step would give lines.
    """
    step = -(-total // most)
    if step <= 1:
        return np.arange(total)
    first = np.arange(0, total, step)
    # The same file looks the same again.
    offset = np.random.default_rng(1).integers(0, step, first.size)
    return np.asarray(np.minimum(first + offset, total - 1), dtype=np.intp)


def read_mesh(path: Path, *, unit: float) -> Shape:
    """Read STL, OBJ, OFF or GLB; files that it names, such as textures, stay closed."""
    try:
        import trimesh
    except ImportError as error:
        raise MissingExtraError(
            "trimesh", extra="scene", purpose="reading meshes"
        ) from error
    # What it has to say of damage is in the error; its log would be more lines.
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
        vertices = np.array(mesh.vertices, dtype=float).reshape(-1, 3) * unit
        faces = np.array(mesh.faces, dtype=np.intp).reshape(-1, 3)
    except Exception as error:  # trimesh's readers raise whatever they meet
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(f"{path.name} cannot be read as a mesh: {reason}") from error
    if not len(faces):
        raise FormatError(f"{path.name} holds no triangle; it is empty or damaged")
    # The format of glTF says that y is up; others say nothing.
    up: Up = "y" if ending == "glb" else "z"
    return Shape(position=vertices, faces=faces, up=up, total=len(vertices))
