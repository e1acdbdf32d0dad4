"""Reads PLY files: points, their numbers, and triangles."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from amulor.errors import FormatError
from amulor.view.page.space.shape import Shape, scalars_of, up_of

_KINDS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2",
    "int16": "i2", "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4",
    "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8",
    "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MOST_LINES = 2000
_COLOURS = ("red", "green", "blue")


@dataclass
class _Element:
    name: str
    count: int
    plain: list[tuple[str, str]] = field(default_factory=list)
    """Names and types of single numbers."""
    lists: list[tuple[str, str, str]] = field(default_factory=list)
    """Names of lists, types of their length and of their numbers."""


def read_ply(path: Path, *, unit: float) -> Shape:
    """Read a PLY file.

    Parameters
    ----------
    path : pathlib.Path
        Cloud or mesh, as text or binary.
    unit : float
        Metres of a unit of its coordinates [m].

    Returns
    -------
    Shape
        With all numbers of its points; polygons as fans of triangles.

    Raises
    ------
    FormatError
        If it is no PLY file, or ends too early.
    """
    with path.open("rb") as file:
        order, elements, comments = _header(file, path.name)
        size = path.stat().st_size - file.tell()
        columns: dict[str, NDArray[Any]] = {}
        faces: NDArray[np.intp] | None = None
        for element in elements:
            if element.count > max(size, 0):  # every record has a byte at least
                raise _short(path.name, element)
            if element.name == "vertex" and not element.lists:
                columns = _table(file, element, order, path.name)
            elif element.name == "face" and len(element.lists) == 1:
                faces = _faces(file, element, order, path.name)
            elif element.count and not (columns and faces is not None):
                raise FormatError(
                    f"{path.name} has an element {element.name!r} before its points "
                    "or triangles end, whose length is not known; write it without"
                )
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
    scalars, left = scalars_of(columns)
    statements = [*comments, *_left_out(left)]
    return Shape(
        position=position * unit,
        scalars=scalars,
        colour=colour,
        faces=faces,
        up=up_of(comments),
        statements=statements,
        total=len(position),
    )


def _left_out(names: list[str]) -> list[str]:
    return [f"not shown: {', '.join(names)}"] if names else []


def _header(file: BinaryIO, name: str) -> tuple[str, list[_Element], list[str]]:
    """Return the order of bytes, the elements and the comments."""
    if file.readline(16).strip() != b"ply":
        raise FormatError(f"{name} is no PLY file: it does not begin with 'ply'")
    order: str | None = None
    elements: list[_Element] = []
    comments: list[str] = []
    for _ in range(_MOST_LINES):
        line = file.readline(4096).decode("ascii", "replace").strip()
        words = line.split()
        match words:
            case ["end_header"]:
                if order is None:
                    break
                return order, elements, comments
            case ["format", kind, _] if kind in _ORDERS:
                order = _ORDERS[kind]
            case ["comment" | "obj_info", *_]:
                comments.append(line.partition(" ")[2])
            case ["element", kind, count] if count.isdigit():
                elements.append(_Element(kind, int(count)))
            case ["property", "list", length, kind, own] if (
                elements and length in _KINDS and kind in _KINDS
            ):
                elements[-1].lists.append((own, _KINDS[length], _KINDS[kind]))
            case ["property", kind, own] if elements and kind in _KINDS:
                elements[-1].plain.append((own, _KINDS[kind]))
            case _:
                raise FormatError(
                    f"{name}: the header of the PLY file has a line {line[:60]!r} "
                    "that cannot be; it is damaged"
                )
    raise FormatError(f"{name}: the header of the PLY file has no end")


def _table(
    file: BinaryIO, element: _Element, order: str, name: str
) -> dict[str, NDArray[Any]]:
    """Return the columns of an element without lists."""
    names = [own for own, _ in element.plain]
    if len(set(names)) < len(names) or not names:
        raise FormatError(f"{name}: two properties of its points have the same name")
    if not order:
        rows = _text(file, element, name)
        try:
            table = np.array(rows, dtype=float).reshape(element.count, len(names))
        except ValueError:
            raise _short(name, element) from None
        return {
            own: table[:, at].astype(kind)
            for at, (own, kind) in enumerate(element.plain)
        }
    kind = np.dtype([(own, order + code) for own, code in element.plain])
    content = file.read(kind.itemsize * element.count)
    if len(content) < kind.itemsize * element.count:
        raise _short(name, element)
    records = np.frombuffer(content, kind)
    return {own: records[own].astype(code) for own, code in element.plain}


def _text(file: BinaryIO, element: _Element, name: str) -> list[list[bytes]]:
    rows = [file.readline().split() for _ in range(element.count)]
    if rows and not rows[-1]:
        raise _short(name, element)
    return rows


def _faces(
    file: BinaryIO, element: _Element, order: str, name: str
) -> NDArray[np.intp]:
    """Return triangles; polygons become fans."""
    _, length, kind = element.lists[0]
    if element.plain:
        return _mixed_faces(file, element, order, name)
    if not order:
        try:
            rows = [[int(w) for w in row] for row in _text(file, element, name)]
        except ValueError:
            raise _short(name, element) from None
        return _fans([row[1 : 1 + row[0]] for row in rows if row], name)
    # Nearly all meshes have triangles only, which are records of one length.
    record = np.dtype([("number", order + length), ("corners", order + kind, 3)])
    content = file.read()
    whole = len(content) >= record.itemsize * element.count
    if whole:
        found = np.frombuffer(content, record, element.count)
        if (found["number"] == 3).all():
            file.seek(record.itemsize * element.count - len(content), 1)
            return found["corners"].astype(np.intp)
    rows, at = [], 0
    sizes = np.dtype(order + length), np.dtype(order + kind)
    for _ in range(element.count):
        if at + sizes[0].itemsize > len(content):
            raise _short(name, element)
        count = int(np.frombuffer(content, sizes[0], 1, at)[0])
        at += sizes[0].itemsize
        if count < 0 or at + count * sizes[1].itemsize > len(content):
            raise _short(name, element)
        rows.append(np.frombuffer(content, sizes[1], count, at).tolist())
        at += count * sizes[1].itemsize
    file.seek(at - len(content), 1)
    return _fans(rows, name)


def _mixed_faces(
    file: BinaryIO, element: _Element, order: str, name: str
) -> NDArray[np.intp]:
    """Return triangles that have numbers of their own behind their corners."""
    if not order:
        rows = _text(file, element, name)
        try:
            corners = [[int(w) for w in row[1 : 1 + int(row[0])]] for row in rows]
        except ValueError:
            raise _short(name, element) from None
        return _fans(corners, name)
    _, length, kind = element.lists[0]
    record = np.dtype(
        [
            ("number", order + length),
            ("corners", order + kind, 3),
            *((own, order + code) for own, code in element.plain),
        ]
    )
    content = file.read(record.itemsize * element.count)
    if len(content) < record.itemsize * element.count:
        raise _short(name, element)
    found = np.frombuffer(content, record)
    if not (found["number"] == 3).all():
        raise FormatError(
            f"{name}: polygons with numbers of their own are not read; write triangles"
        )
    return found["corners"].astype(np.intp)


def _fans(polygons: list[list[int]], name: str) -> NDArray[np.intp]:
    triangles = [
        (corners[0], corners[k], corners[k + 1])
        for corners in polygons
        for k in range(1, len(corners) - 1)
    ]
    try:
        return np.array(triangles, dtype=np.intp).reshape(-1, 3)
    except OverflowError:
        raise FormatError(f"{name} has a corner number that cannot be") from None


def _short(name: str, element: _Element) -> FormatError:
    return FormatError(
        f"{name} ends before its {element.count} records of {element.name!r}, or "
        "they are no numbers; it is damaged or was not copied whole"
    )
