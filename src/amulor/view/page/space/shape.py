"""What a cloud or a mesh is, whatever its file: places, triangles, numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from amulor.errors import FormatError

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
    """Return numbers of points by the names of the page, and names that are left out.

    Parameters
    ----------
    columns : mapping
        Columns of the file but the coordinates, shape (n,) each.

    Returns
    -------
    dict
        Float arrays of shape (n,).
    list of str
        Columns that are not shown.
    """
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
    """Return which axis points up, from what a file of amulor says of its axes.

    Parameters
    ----------
    statements : sequence of str
        Lines of its header.
    default : str
        For a file that says nothing.

    Returns
    -------
    str
        "-y" in the instrument's axes, whose y is down.
    """
    for line in statements:
        if line.startswith("axes:"):
            return "-y" if "y down" in line else "z"
    return default


def checked(shape: Shape, name: str) -> Shape:
    """Return a shape whose points can be drawn, or raise.

    Parameters
    ----------
    shape : Shape
        As it was read.
    name : str
        Name of the file.

    Returns
    -------
    Shape
        Points without a finite place left out of a cloud.

    Raises
    ------
    FormatError
        If nothing is left, or a triangle has a corner that is not there.
    """
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
    """Return some points of a cloud.

    Parameters
    ----------
    shape : Shape
        Any; its triangles are lost.
    kept : ndarray of int, shape (k,)
        Which points.

    Returns
    -------
    Shape
        A cloud that knows how many points there were.
    """
    return Shape(
        position=shape.position[kept],
        scalars={name: values[kept] for name, values in shape.scalars.items()},
        colour=None if shape.colour is None else shape.colour[kept],
        up=shape.up,
        statements=shape.statements,
        total=shape.total or len(shape.position),
    )


def spread(total: int, most: int) -> NDArray[np.intp]:
    """Return numbers of points that stand for all of them.

    Parameters
    ----------
    total : int
        Points in the file.
    most : int
        Points that may be kept.

    Returns
    -------
    ndarray of int, shape (k,)
        Rising. One of every so many in the order of the file, each at a place of its
        own among them: the rows of a scan and an even step would give lines.
    """
    step = -(-total // most)
    if step <= 1:
        return np.arange(total)
    first = np.arange(0, total, step)
    # The same file looks the same again.
    offset = np.random.default_rng(1).integers(0, step, first.size)
    return np.asarray(np.minimum(first + offset, total - 1), dtype=np.intp)
