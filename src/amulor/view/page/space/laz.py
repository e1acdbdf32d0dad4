"""Reads LAS and LAZ files part by part, so that a large one needs little memory."""

from __future__ import annotations

import logging
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import FormatError, MissingExtraError
from amulor.view.page.space.shape import Shape, scalars_of, spread, up_of

_PART = 500_000
#: Dimensions of the format that say nothing of a scan of this kind.
_DULL = {
    "X", "Y", "Z", "red", "green", "blue", "return_number", "number_of_returns",
    "synthetic", "key_point", "overlap", "scanner_channel", "scan_direction_flag",
    "edge_of_flight_line", "user_data", "scan_angle", "scan_angle_rank",
    "point_source_id", "gps_time", "withheld", "raw_classification",
}  # fmt: skip
#: Dimensions that every file has, whether they say something or not.
_OFTEN_UNUSED = ("classification", "intensity")


def read_laz(path: Path, *, most: int) -> Shape:
    """Read a LAS or LAZ file.

    Parameters
    ----------
    path : pathlib.Path
        The file; its coordinates count as metres, as the format's users have it.
    most : int
        Points that are kept at most.

    Returns
    -------
    Shape
        With extra dimensions as numbers of points.

    Raises
    ------
    FormatError
        If it is damaged.
    MissingExtraError
        If laspy is not installed.
    """
    try:
        import laspy
        import lazrs  # noqa: F401  laspy reads compressed points with it
    except ImportError as error:
        raise MissingExtraError(
            "laspy[lazrs]", extra="export", purpose="reading LAS and LAZ files"
        ) from error
    # What it has to say of damage is in the error; its log would be more lines.
    logging.getLogger("laspy").addHandler(logging.NullHandler())
    _check_chunks(path)
    try:
        with laspy.open(path) as file:
            return _read(file, most, path.name)
    except FormatError:
        raise
    except Exception as error:  # laspy and lazrs raise whatever they meet
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(
            f"{path.name} cannot be read as LAS or LAZ: {reason}; it is damaged or was "
            "not copied whole"
        ) from error


def _check_chunks(path: Path) -> None:
    """Refuse a LAZ file of more parts than bytes: lazrs would end the program."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(105)
        if len(head) < 105 or not head[104] & 0x80:  # not compressed, or none at all
            return
        (points,) = struct.unpack_from("<I", head, 96)
        file.seek(points)
        (table,) = struct.unpack("<q", file.read(8).ljust(8, b"\0"))
        if table == -1 and size > 8:  # written at the end, by what could not go back
            file.seek(size - 8)
            (table,) = struct.unpack("<q", file.read(8))
        if not 0 <= table <= size - 8:
            return
        file.seek(table + 4)
        (chunks,) = struct.unpack("<I", file.read(4))
    if chunks > size:
        raise FormatError(
            f"{path.name} says that it has {chunks} parts, more than bytes; it is "
            "damaged or was not copied whole"
        )


def _read(file: Any, most: int, name: str) -> Shape:
    total = int(file.header.point_count)
    kept = spread(total, most)
    parts: list[dict[str, NDArray[Any]]] = []
    first = 0
    for part in file.chunk_iterator(_PART):
        chosen = kept[(kept >= first) & (kept < first + len(part))] - first
        first += len(part)
        parts.append(_columns(part[chosen]))
    if first < total or not total:
        raise FormatError(
            f"{name} says that it has {total} points, and has {first}; it is empty or "
            "was not copied whole"
        )
    columns = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    position = np.stack([columns.pop(axis) for axis in "xyz"], axis=1)
    colour = None
    if "red" in columns:
        light = np.stack([columns.pop(c) for c in ("red", "green", "blue")], axis=1)
        # Some programs write 8 bits into the 16 of the format.
        shift = 8 if light.max(initial=0) > 255 else 0
        colour = (light >> shift).astype(np.uint8)
    scalars, left = scalars_of(
        {
            key: values
            for key, values in columns.items()
            if np.ptp(values) > 0 or key not in _OFTEN_UNUSED
        }
    )
    statements = _statements(file)
    if left:
        statements.append(f"not shown: {', '.join(left)}")
    return Shape(
        position=position,
        scalars=scalars,
        colour=colour if colour is not None and colour.any() else None,
        up=up_of(statements),
        statements=statements,
        total=total,
    )


def _columns(part: Any) -> dict[str, NDArray[Any]]:
    names = list(part.point_format.dimension_names)
    found = {axis: np.asarray(getattr(part, axis)) for axis in "xyz"}
    if {"red", "green", "blue"} <= set(names):
        found |= {c: np.asarray(part[c]) for c in ("red", "green", "blue")}
    for key in names:
        values = np.asarray(part[key]) if key not in _DULL else None
        if values is not None and values.ndim == 1:
            found[key] = values
    return found


def _statements(file: Any) -> list[str]:
    """Return what amulor wrote into a record of its own."""
    records = [*(file.header.vlrs or []), *(file.evlrs or [])]
    for record in records:
        if getattr(record, "user_id", "") == "amulor":
            text = record.record_data.decode("utf-8", "replace")
            return [str(line) for line in text.splitlines()]
    return []
