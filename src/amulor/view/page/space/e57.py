"""Reads E57 files: all scans of one, each at its pose."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import FormatError, MissingExtraError
from amulor.view.page.space.shape import Shape, scalars_of, up_of

_CARTESIAN = tuple(f"cartesian{axis}" for axis in "XYZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_COLOURS = ("colorRed", "colorGreen", "colorBlue")
#: `cartesianInvalidState` of a pixel that has no point.
_NOTHING_MEANT = 2


def read_e57(path: Path) -> Shape:
    """Read an E57 file.

    Parameters
    ----------
    path : pathlib.Path
        The file; the format is in metres.

    Returns
    -------
    Shape
        Points of all scans in the frame of the file, with `scan` as a number of each
        if there are several, and `doubtful` where a state says so.

    Raises
    ------
    FormatError
        If it is damaged, or has no point.
    MissingExtraError
        If pye57 is not installed.
    """
    try:
        import pye57
    except ImportError as error:
        raise MissingExtraError(
            "pye57", extra="e57", purpose="reading E57 files"
        ) from error
    try:
        file = pye57.E57(str(path))
        try:
            scans = [_scan(file, number) for number in range(file.scan_count)]
        finally:
            file.close()
    except Exception as error:  # libe57 raises what its C++ does
        reason = str(error).partition("\n")[0].strip()[:200] or type(error).__name__
        raise FormatError(
            f"{path.name} cannot be read as E57: {reason}; it is damaged or was not "
            "copied whole"
        ) from error
    if not sum(len(position) for position, *_ in scans):
        raise FormatError(f"{path.name} holds no point")
    statements = scans[0][2]
    if len(scans) > 1:
        for number, (position, columns, _, _) in enumerate(scans):
            columns["scan"] = np.full(len(position), float(number))
    shared = set.intersection(*(set(columns) for _, columns, _, _ in scans))
    columns = {
        key: np.concatenate([one[key] for _, one, _, _ in scans])
        for key in scans[0][1]
        if key in shared
    }
    colour = None
    if set(_COLOURS) <= set(columns):
        parts = np.stack([columns.pop(name) for name in _COLOURS], axis=1)
        colour = np.clip(parts, 0, 255).astype(np.uint8)
    scalars, _ = scalars_of(columns)
    position = np.concatenate([one for one, *_ in scans])
    turned = any(moved for *_, moved in scans)
    return Shape(
        position=position,
        scalars=scalars,
        colour=colour,
        up="z" if turned else up_of(statements),
        statements=statements,
        total=len(position),
    )


def _scan(
    file: Any, number: int
) -> tuple[NDArray[np.float64], dict[str, NDArray[Any]], list[str], bool]:
    """Return places, numbers and words of a scan, and whether it has a pose."""
    header = file.get_header(number)
    names = set(header.point_fields)
    raw = file.read_scan_raw(number)
    state = np.zeros(header.point_count, dtype=int)
    if set(_CARTESIAN) <= names:
        position = np.stack([raw[name] for name in _CARTESIAN], axis=1)
        state = np.asarray(raw.get("cartesianInvalidState", state))
    elif set(_SPHERICAL) <= names:
        reach, azimuth, elevation = (raw[name] for name in _SPHERICAL)
        level = reach * np.cos(elevation)
        position = np.stack(
            [
                level * np.cos(azimuth),
                level * np.sin(azimuth),
                reach * np.sin(elevation),
            ],
            axis=1,
        )
        state = np.asarray(raw.get("sphericalInvalidState", state))
    else:
        raise FormatError("a scan has neither cartesian nor spherical coordinates")
    there = state != _NOTHING_MEANT
    moved = bool(header.has_pose())
    position = np.asarray(position, dtype=float)[there]
    if moved:
        position = position @ header.rotation_matrix.T + header.translation
    columns = {
        name: np.asarray(values)[there]
        for name, values in raw.items()
        if name in ("intensity", *_COLOURS)
    }
    if (state == 1).any():
        columns["doubtful"] = (state == 1)[there].astype(float)
    try:
        words = str(header["description"].value()).splitlines()
    except Exception:  # the format does not ask for a description
        words = []
    return position, columns, words, moved
