"""Point clouds as structured scans in E57 files."""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.errors import CubeError, FormatError, MissingExtraError
from amulor.io.files import atomic_output
from amulor.io.shapes import (
    Shape,
    checked_cloud,
    checked_parts,
    doubtful,
    in_blocks,
    provenance_lines,
    scalars_of,
    up_of,
)

Arrays = dict[str, NDArray[Any]]

#: Fields of a record and their types. pye57 0.4.19 takes only every other half of the
#: integers that C calls long.
FIELDS: dict[str, type] = {
    "cartesianX": np.float64,
    "cartesianY": np.float64,
    "cartesianZ": np.float64,
    "intensity": np.float64,
    "rowIndex": np.longlong,
    "columnIndex": np.longlong,
    "cartesianInvalidState": np.int8,
}
#: Number of records per block.
BLOCK = 2**18
# What `cartesianInvalidState` says of a pixel, after ASTM E2807.
_VALID, _DIRECTION_ONLY, _NOTHING_MEANT = 0, 1, 2
_CARTESIAN = tuple(f"cartesian{axis}" for axis in "XYZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_COLOURS = ("colorRed", "colorGreen", "colorBlue")


def write_e57(
    cloud: xr.Dataset,
    path: str | os.PathLike[str],
    *,
    shape: tuple[int, int] | None = None,
    overwrite: bool = False,
) -> None:
    """Write a point cloud to an E57 file, one record for each pixel of the scan.

    Parameters
    ----------
    cloud : xarray.Dataset
        A cube of level `point_cloud`.
    path : path-like
        File to write, usually with the suffix `.e57`.
    shape : tuple of int, optional
        Rows and columns of the scan, for each of which the file has a record [1]. By
        default the attribute `scan_shape` of the cloud, or as many as its points need.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    CubeError
        If the cube is no point cloud, is empty, has points without a position, has
        two points in one pixel, or points outside the scan.
    FormatError
        If the file exists and `overwrite` is not set, or cannot be written.
    MissingExtraError
        If pye57 is not installed.

    Notes
    -----
    Records are stored row by row, coordinates and intensity in double precision. A
    pixel without a point has zeros and `cartesianInvalidState` 2. A pixel with a
    doubtful range has its coordinates and state 1: only the direction is valid. Points
    are stored in the axes of the instrument; `pose` transforms them to the frame of the
    cloud. For a scan from a vehicle, these are the axes in the middle of the scan. The
    format has no fields for uncertainty and quality flags; use PLY or LAZ for these.

    Examples
    --------
    >>> import pye57
    >>> from amulor import imaging, io, rejection, samples
    >>> image = imaging.range_image(
    ...     rejection.cross_polarized(samples.cube("ladder"))
    ... )
    >>> cloud = imaging.point_cloud(image)
    >>> io.write_e57(cloud, "ladder.e57")
    >>> pye57.E57("ladder.e57").scan_count
    1
    """
    shapes = None if shape is None else [shape]
    write_e57_scans([cloud], path, shapes=shapes, overwrite=overwrite)


def write_e57_parts(
    parts: Callable[[], Iterable[xr.Dataset]],
    count: int,
    path: str | os.PathLike[str],
    *,
    shape: tuple[int, int],
    overwrite: bool = False,
) -> None:
    """Write a point cloud to an E57 file in parts, with bounded memory.

    The file equals that of the whole cloud, byte for byte, because records are written
    in blocks of equal size for any division into parts.
    """
    name = f"the cloud for {path}"

    def checked() -> Iterator[xr.Dataset]:
        return checked_parts(parts(), count, name=name)

    libe57 = _pye57("writing").libe57
    _write_file(libe57, [Records(checked, shape, name=name)], path, overwrite=overwrite)


def write_e57_scans(
    clouds: Sequence[xr.Dataset],
    path: str | os.PathLike[str],
    *,
    shapes: Sequence[tuple[int, int]] | None = None,
    overwrite: bool = False,
) -> None:
    """Write the point clouds of several scans with their poses to one E57 file.

    Parameters
    ----------
    clouds : sequence of xarray.Dataset
        Cubes of level `point_cloud`; their titles name the scans.
    path : path-like
        File to write, usually with the suffix `.e57`.
    shapes : sequence of tuple of int, optional
        Rows and columns of each scan, as in `write_e57` [1].
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    CubeError
        As `write_e57`.
    FormatError
        As `write_e57`.
    MissingExtraError
        If pye57 is not installed.

    Examples
    --------
    >>> import pye57
    >>> from amulor import imaging, io, rejection, samples
    >>> image = imaging.range_image(
    ...     rejection.cross_polarized(samples.cube("ladder"))
    ... )
    >>> cloud = imaging.point_cloud(image)
    >>> io.write_e57_scans([cloud, cloud], "ladder.e57")
    >>> pye57.E57("ladder.e57").scan_count
    2
    """
    libe57 = _pye57("writing").libe57
    name = f"the cloud for {path}"
    scans = []
    for number, cloud in enumerate(clouds):
        cloud = checked_cloud(cloud, name=name)
        shape = _shape_of(cloud) if shapes is None else shapes[number]
        scans.append(Records(partial(iter, [cloud]), shape, name=name))
    _write_file(libe57, scans, path, overwrite=overwrite)


def _write_file(
    libe57: Any,
    scans: Sequence[Records],
    path: str | os.PathLike[str],
    *,
    overwrite: bool,
) -> None:
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        try:
            _write(libe57, temporary, scans)
        except libe57.E57Exception as error:
            reason = str(error).partition("\n")[0]
            raise FormatError(
                f"{path} cannot be written: {reason}; free some space or choose "
                "another folder"
            ) from error


def _pye57(purpose: str) -> Any:
    try:
        import pye57
    except ImportError as error:
        raise MissingExtraError(
            "pye57", extra="e57", purpose=f"{purpose} E57 files"
        ) from error
    return pye57


def _shape_of(cloud: xr.Dataset) -> tuple[int, int]:
    """Numbers of rows and columns of the scan from which a cloud was computed."""
    if "scan_shape" in cloud.attrs:
        rows, columns = (int(size) for size in cloud.attrs["scan_shape"])
        return rows, columns
    return int(cloud["row"].max()) + 1, int(cloud["column"].max()) + 1


def _pose(matrix: NDArray[np.float64]) -> dict[str, dict[str, float]]:
    """Pose in the form that E57 files use: unit quaternion and translation."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    rotation = {"w": float(w), "x": float(x), "y": float(y), "z": float(z)}
    place = dict(zip("xyz", matrix[:3, 3].tolist(), strict=True))
    return {"rotation": rotation, "translation": place}


def _write(libe57: Any, path: Path, scans: Sequence[Records]) -> None:
    file = libe57.ImageFile(str(path), "w")
    try:
        file.extensionsAdd("", libe57.E57_V1_0_URI)
        # Equal clouds get equal identifiers.
        digests = [scan.digest for scan in scans]
        digest = digests[0] if len(scans) == 1 else cubes.digest(str(digests).encode())
        _set(libe57, file, file.root(), {
            "formatName": "ASTM E57 3D Imaging Data File",
            "guid": f"{{{uuid.uuid5(uuid.NAMESPACE_OID, digest)}}}",
            "versionMajor": int(libe57.E57_FORMAT_MAJOR),
            "versionMinor": int(libe57.E57_FORMAT_MINOR),
            "e57LibraryVersion": libe57.E57_LIBRARY_ID,
            "coordinateMetadata": "",
        })  # fmt: skip
        listed = libe57.VectorNode(file, True)
        file.root().set("data3D", listed)
        file.root().set("images2D", libe57.VectorNode(file, True))
        for scan in scans:
            node = libe57.StructureNode(file)
            listed.append(node)
            _set(libe57, file, node, {
                "guid": f"{{{uuid.uuid5(uuid.NAMESPACE_OID, scan.digest + ' scan')}}}",
                "name": str(scan.first.attrs.get("title") or "scan"),
                "description": "\n".join(provenance_lines(scan.first)),
                **_bounds(scan),
                **({} if scan.matrix is None else {"pose": _pose(scan.matrix)}),
            })  # fmt: skip
            _write_points(libe57, file, node, scan)
        file.close()
    except BaseException:
        file.cancel()
        raise


def _bounds(scan: Records) -> dict[str, dict[str, int | float]]:
    def named(start: str, key: str) -> dict[str, int | float]:
        low, high = scan.ends[key]
        return {f"{start}Minimum": low, f"{start}Maximum": high}

    return {
        "indexBounds": {
            **named("row", "rowIndex"),
            **named("column", "columnIndex"),
            "returnMinimum": 0,
            "returnMaximum": 0,
        },
        "cartesianBounds": {
            key: end for axis in "xyz" for key, end in named(axis, axis).items()
        },
        "intensityLimits": named("intensity", "intensity"),
    }


def _set(libe57: Any, file: Any, node: Any, children: Mapping[str, Any]) -> None:
    for key, value in children.items():
        if isinstance(value, Mapping):
            child = libe57.StructureNode(file)
            _set(libe57, file, child, value)
        else:
            kinds = {
                str: libe57.StringNode,
                int: libe57.IntegerNode,
                float: libe57.FloatNode,
            }
            child = kinds[type(value)](file, value)
        node.set(key, child)


def _write_points(libe57: Any, file: Any, node: Any, scan: Records) -> None:
    size = min(BLOCK, scan.count)
    # The writer reads its records from these arrays repeatedly.
    fields: dict[str, NDArray[Any]] = {
        key: np.zeros(size, dtype=kind) for key, kind in FIELDS.items()
    }
    prototype = libe57.StructureNode(file)
    for key, values in fields.items():
        if values.dtype.kind == "f":
            field = libe57.FloatNode(file, 0.0, libe57.E57_DOUBLE)
        else:
            field = libe57.IntegerNode(file, 0, 0, max(1, int(scan.ends[key][1])))
        prototype.set(key, field)
    points = libe57.CompressedVectorNode(file, prototype, libe57.VectorNode(file, True))
    node.set("points", points)
    buffers = libe57.VectorSourceDestBuffer()
    for key, values in fields.items():
        buffers.append(
            libe57.SourceDestBuffer(file, key, values, values.size, True, True)
        )
    writer = points.writer(buffers)
    try:
        for block in scan.blocks():
            for key, values in fields.items():
                values[: len(block)] = block[key]
            writer.write(len(block))
    except BaseException:
        # An open writer whose file is deleted ends the whole program.
        with contextlib.suppress(libe57.E57Exception):
            writer.close()
        raise
    writer.close()


class Records:
    """E57 records of one scan, together with the metadata of the scan."""

    def __init__(
        self,
        parts: Callable[[], Iterable[xr.Dataset]],
        shape: tuple[int, int],
        *,
        name: str,
    ) -> None:
        self._parts, self._shape, self._name = parts, shape, name
        ends: dict[str, tuple[float, float]] = {}
        digests = {key: hashlib.sha256() for key in FIELDS}
        first: xr.Dataset | None = None
        for part, records in self._pieces():
            if part is not None:
                first = part if first is None else first
                for axis in "xyz":
                    _widen(ends, axis, part[axis].values)
            for key, values in records.items():
                digests[key].update(values.tobytes())
                _widen(ends, key, values)
        assert first is not None
        #: A part of the cloud, for its attributes.
        self.first = first
        #: Matrix from the records to the frame of the cloud, if any.
        self.matrix = _in_the_instrument(first)[1]
        parts_digests = [digest.hexdigest() for digest in digests.values()]
        #: Of all that is written.
        self.digest = cubes.digest(
            "\n".join([*provenance_lines(first), *parts_digests])
        )
        #: Smallest and largest value of each field, and of x, y and z of the points.
        self.ends = ends

    @property
    def count(self) -> int:
        """Number of records."""
        return self._shape[0] * self._shape[1]

    def blocks(self) -> Iterator[NDArray[np.void]]:
        """Yield the E57 records in pixel order, in blocks of `BLOCK` records."""
        return in_blocks((_packed(records) for _, records in self._pieces()), BLOCK)

    def _pieces(self) -> Iterator[tuple[xr.Dataset | None, Arrays]]:
        """Yield E57 records in row order, each with its part of the cloud or None."""
        rows, columns = self._shape
        done = 0
        for part in self._parts():
            row, last = int(part["row"].min()), int(part["row"].max())
            column = int(part["column"].max())
            if last >= rows or column >= columns:
                raise CubeError(
                    f"{self._name}: a point is in row {last} and one in column "
                    f"{column}, but the scan has {rows} rows and {columns} columns, "
                    "numbered from 0; give the shape of the scan that the cloud was "
                    "made from"
                )
            if row < done:
                raise CubeError(
                    f"{self._name}: a point of row {row} comes after those of row "
                    f"{done - 1}; give the parts in the order of their rows"
                )
            yield from self._without_points(done, row)
            yield part, self._of(part, (row, last + 1))
            done = last + 1
        yield from self._without_points(done, rows)

    def _without_points(self, begin: int, end: int) -> Iterator[tuple[None, Arrays]]:
        """Yield the E57 records of rows without points, in small blocks."""
        columns = self._shape[1]
        few = max(1, BLOCK // columns)
        for first in range(begin, end, few):
            yield None, _empty((first, min(first + few, end)), columns)

    def _of(self, part: xr.Dataset, rows: tuple[int, int]) -> Arrays:
        """Return the E57 records of rows that contain points."""
        part, _ = _in_the_instrument(part)
        columns = self._shape[1]
        row = part["row"].values.astype(np.int64) - rows[0]
        pixel = row * columns + part["column"].values.astype(np.int64)
        if np.unique(pixel).size < pixel.size:
            raise CubeError(
                f"{self._name}: a pixel of the scan has two points, an E57 scan has "
                "room for one; write each scan to its own file"
            )
        records = _empty(rows, columns)
        for key, variable in zip(FIELDS, ("x", "y", "z", "intensity"), strict=False):
            records[key][pixel] = part[variable].values
        state = np.where(doubtful(part), _DIRECTION_ONLY, _VALID)
        records["cartesianInvalidState"][pixel] = state
        return records


def _empty(rows: tuple[int, int], columns: int) -> Arrays:
    """Return the E57 records of rows without points."""
    pixels = np.arange(rows[0] * columns, rows[1] * columns)
    records: Arrays = {
        key: np.zeros(pixels.size, dtype=kind) for key, kind in FIELDS.items()
    }
    records["rowIndex"][:] = pixels // columns
    records["columnIndex"][:] = pixels % columns
    records["cartesianInvalidState"][:] = _NOTHING_MEANT
    return records


def _packed(records: Mapping[str, NDArray[Any]]) -> NDArray[np.void]:
    """Return the E57 records as one structured array."""
    packed = np.empty(len(records["intensity"]), dtype=list(FIELDS.items()))
    for key, values in records.items():
        packed[key] = values
    return packed


def _widen(
    ends: dict[str, tuple[float, float]], key: str, values: NDArray[Any]
) -> None:
    low, high = ends.get(key, (math.inf, -math.inf))
    ends[key] = min(low, values.min().item()), max(high, values.max().item())


def _in_the_instrument(
    cloud: xr.Dataset,
) -> tuple[xr.Dataset, NDArray[np.float64] | None]:
    """Cloud in instrument axes, and the matrix to its frame; None without a change."""
    frame = cloud.attrs.get("frame", "instrument")
    name = "middle_pose" if frame == "trajectory" else "frame_matrix"
    if frame == "instrument" or name not in cloud.attrs:
        return cloud, None
    matrix = np.asarray(cloud.attrs[name], dtype=float).reshape(4, 4)
    away = [cloud[axis].values - matrix[k, 3] for k, axis in enumerate("xyz")]
    # Not as a matrix product, whose rounding depends on the number of points.
    instrument_position = [
        away[0] * matrix[0, k] + away[1] * matrix[1, k] + away[2] * matrix[2, k]
        for k in range(3)
    ]
    return (
        cloud.assign(
            {
                axis: cloud[axis].copy(data=instrument_position[k])
                for k, axis in enumerate("xyz")
            }
        ),
        matrix,
    )


def read_e57(path: Path) -> Shape:
    """Read all scans of an E57 file, each transformed by its pose."""
    pye57 = _pye57("reading")
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
        key: np.concatenate([scan_values[key] for _, scan_values, _, _ in scans])
        for key in scans[0][1]
        if key in shared
    }
    colour = None
    if set(_COLOURS) <= set(columns):
        parts = np.stack([columns.pop(name) for name in _COLOURS], axis=1)
        colour = np.clip(parts, 0, 255).astype(np.uint8)
    scalars, _ = scalars_of(columns)
    position = np.concatenate([scan_values for scan_values, *_ in scans])
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
    """Positions, point values and texts of a scan, and whether it has a pose."""
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
    present = state != _NOTHING_MEANT
    moved = bool(header.has_pose())
    position = np.asarray(position, dtype=float)[present]
    if moved:
        position = position @ header.rotation_matrix.T + header.translation
    columns = {
        name: np.asarray(values)[present]
        for name, values in raw.items()
        if name in ("intensity", *_COLOURS)
    }
    if (state == 1).any():
        columns["doubtful"] = (state == 1)[present].astype(float)
    try:
        words = str(header["description"].value()).splitlines()
    except Exception:  # the format requires no description
        words = []
    return position, columns, words, moved
