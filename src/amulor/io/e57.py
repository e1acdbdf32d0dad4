"""Writes point clouds as structured scans in E57 files."""

from __future__ import annotations

import contextlib
import os
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from amulor import cube as cubes
from amulor.errors import CubeError, FormatError, MissingExtraError
from amulor.io._cloud import checked_cloud, doubtful, provenance_lines
from amulor.io.files import atomic_output

#: A cloud, its records, and the matrix that takes it into its frame.
_Part = tuple[xr.Dataset, Mapping[str, NDArray[Any]], NDArray[np.float64] | None]

# What `cartesianInvalidState` says of a pixel, after ASTM E2807.
_VALID, _DIRECTION_ONLY, _NOTHING_MEANT = 0, 1, 2


def write_e57(
    cloud: xr.Dataset,
    path: str | os.PathLike[str],
    *,
    shape: tuple[int, int] | None = None,
    overwrite: bool = False,
) -> None:
    """Write a point cloud to an E57 file, with a record for each pixel of its scan.

    Parameters
    ----------
    cloud : xarray.Dataset
        A cube of level `point_cloud`.
    path : path-like
        File to make, by custom with the suffix `.e57`.
    shape : tuple of int, optional
        Rows and columns of the scan, for which a scan in E57 has room [1]. By default
        what the cloud says in its attribute `scan_shape`, or as many as its points
        need.
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
    Records go row by row. Coordinates and intensity are stored in double precision. A
    pixel without a point has zeros and `cartesianInvalidState` 2; one whose range is
    doubtful has its coordinates and 1, so that its direction is to be relied on only.
    Points are stored in the instrument's axes, and `pose` turns them into those of
    the cloud. The format has no field for an uncertainty or a quality flag; a PLY or
    LAZ file holds them.

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


def write_e57_scans(
    clouds: Sequence[xr.Dataset],
    path: str | os.PathLike[str],
    *,
    shapes: Sequence[tuple[int, int]] | None = None,
    overwrite: bool = False,
) -> None:
    """Write the point clouds of several scans to one E57 file, each with its pose.

    Parameters
    ----------
    clouds : sequence of xarray.Dataset
        Cubes of level `point_cloud`; their titles name the scans.
    path : path-like
        File to make, by custom with the suffix `.e57`.
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
    libe57 = _libe57()
    name = f"the cloud for {path}"
    parts = []
    for number, cloud in enumerate(clouds):
        cloud = checked_cloud(cloud, name=name)
        cloud, matrix = _in_the_instrument(cloud)
        shape = _shape_of(cloud) if shapes is None else shapes[number]
        parts.append((cloud, _records(cloud, shape, name=name), matrix))
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        try:
            _write(libe57, temporary, parts)
        except libe57.E57Exception as error:
            reason = str(error).partition("\n")[0]
            raise FormatError(
                f"{path} cannot be written: {reason}; free some space or choose "
                "another folder"
            ) from error


def _libe57() -> Any:
    try:
        from pye57 import libe57
    except ImportError as error:
        raise MissingExtraError(
            "pye57", extra="export", purpose="writing E57 files"
        ) from error
    return libe57


def _shape_of(cloud: xr.Dataset) -> tuple[int, int]:
    """Return rows and columns of the scan that a cloud comes from."""
    if "scan_shape" in cloud.attrs:
        rows, columns = (int(size) for size in cloud.attrs["scan_shape"])
        return rows, columns
    return int(cloud["row"].max()) + 1, int(cloud["column"].max()) + 1


def _records(
    cloud: xr.Dataset, shape: tuple[int, int], *, name: str
) -> dict[str, NDArray[Any]]:
    row = cloud["row"].values.astype(np.int64)
    column = cloud["column"].values.astype(np.int64)
    if row.max() >= shape[0] or column.max() >= shape[1]:
        raise CubeError(
            f"{name}: a point is in row {row.max()} and one in column {column.max()}, "
            f"but the scan has {shape[0]} rows and {shape[1]} columns, numbered from "
            "0; give the shape of the scan that the cloud was made from"
        )
    pixel = row * shape[1] + column
    if np.unique(pixel).size < pixel.size:
        raise CubeError(
            f"{name}: a pixel of the scan has two points, an E57 scan has room for "
            "one; write each scan to its own file"
        )
    pixels = np.arange(shape[0] * shape[1])
    records: dict[str, NDArray[Any]] = {
        f"cartesian{axis.upper()}": np.zeros(pixels.size) for axis in "xyz"
    }
    records["intensity"] = np.zeros(pixels.size)
    for key, variable in zip(records, ("x", "y", "z", "intensity"), strict=True):
        records[key][pixel] = cloud[variable].values
    # pye57 0.4.19 takes only every other half of the integers that C calls long.
    records["rowIndex"] = (pixels // shape[1]).astype(np.longlong)
    records["columnIndex"] = (pixels % shape[1]).astype(np.longlong)
    state = np.full(pixels.size, _NOTHING_MEANT, dtype=np.int8)
    state[pixel] = np.where(doubtful(cloud), _DIRECTION_ONLY, _VALID)
    records["cartesianInvalidState"] = state
    return records


def _in_the_instrument(
    cloud: xr.Dataset,
) -> tuple[xr.Dataset, NDArray[np.float64] | None]:
    """Return the cloud in the instrument's axes, and the matrix that takes it back."""
    if cloud.attrs.get("frame", "instrument") == "instrument":
        return cloud, None
    matrix = np.asarray(cloud.attrs["frame_matrix"], dtype=float).reshape(4, 4)
    placed = np.stack([cloud[axis].values for axis in "xyz"], axis=1)
    own = (placed - matrix[:3, 3]) @ matrix[:3, :3]
    return (
        cloud.assign(
            {
                axis: cloud[axis].copy(data=own[:, number])
                for number, axis in enumerate("xyz")
            }
        ),
        matrix,
    )


def _pose(matrix: NDArray[np.float64]) -> dict[str, dict[str, float]]:
    """Return a pose as the format states it: unit quaternion and translation."""
    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    rotation = {"w": float(w), "x": float(x), "y": float(y), "z": float(z)}
    place = dict(zip("xyz", matrix[:3, 3].tolist(), strict=True))
    return {"rotation": rotation, "translation": place}


def _write(libe57: Any, path: Path, parts: Sequence[_Part]) -> None:
    file = libe57.ImageFile(str(path), "w")
    try:
        file.extensionsAdd("", libe57.E57_V1_0_URI)
        # The same clouds get the same identifiers.
        digests = [_digest(cloud, records) for cloud, records, _ in parts]
        digest = digests[0] if len(parts) == 1 else cubes.digest(str(digests).encode())
        _set(libe57, file, file.root(), {
            "formatName": "ASTM E57 3D Imaging Data File",
            "guid": f"{{{uuid.uuid5(uuid.NAMESPACE_OID, digest)}}}",
            "versionMajor": int(libe57.E57_FORMAT_MAJOR),
            "versionMinor": int(libe57.E57_FORMAT_MINOR),
            "e57LibraryVersion": libe57.E57_LIBRARY_ID,
            "coordinateMetadata": "",
        })  # fmt: skip
        scans = libe57.VectorNode(file, True)
        file.root().set("data3D", scans)
        file.root().set("images2D", libe57.VectorNode(file, True))
        for own, (cloud, records, matrix) in zip(digests, parts, strict=True):
            scan = libe57.StructureNode(file)
            scans.append(scan)
            _set(libe57, file, scan, {
                "guid": f"{{{uuid.uuid5(uuid.NAMESPACE_OID, own + ' scan')}}}",
                "name": str(cloud.attrs.get("title") or "scan"),
                "description": "\n".join(provenance_lines(cloud)),
                **_bounds(cloud, records),
                **({} if matrix is None else {"pose": _pose(matrix)}),
            })  # fmt: skip
            _write_points(libe57, file, scan, records)
        file.close()
    except BaseException:
        file.cancel()
        raise


def _digest(cloud: xr.Dataset, records: Mapping[str, NDArray[Any]]) -> str:
    text = "\n".join(provenance_lines(cloud))
    content = b"".join(values.tobytes() for values in records.values())
    return cubes.digest(text.encode() + content)


def _bounds(
    cloud: xr.Dataset, records: Mapping[str, NDArray[Any]]
) -> dict[str, dict[str, int | float]]:
    def ends(start: str, values: NDArray[Any]) -> dict[str, int | float]:
        return {
            f"{start}Minimum": values.min().item(),
            f"{start}Maximum": values.max().item(),
        }

    return {
        "indexBounds": {
            **ends("row", records["rowIndex"]),
            **ends("column", records["columnIndex"]),
            "returnMinimum": 0,
            "returnMaximum": 0,
        },
        "cartesianBounds": {
            key: end
            for axis in "xyz"
            for key, end in ends(axis, cloud[axis].values.astype(float)).items()
        },
        "intensityLimits": ends("intensity", records["intensity"]),
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


def _write_points(
    libe57: Any, file: Any, scan: Any, records: Mapping[str, NDArray[Any]]
) -> None:
    prototype = libe57.StructureNode(file)
    for key, values in records.items():
        if values.dtype.kind == "f":
            field = libe57.FloatNode(file, 0.0, libe57.E57_DOUBLE)
        else:
            field = libe57.IntegerNode(file, 0, 0, max(1, int(values.max())))
        prototype.set(key, field)
    points = libe57.CompressedVectorNode(file, prototype, libe57.VectorNode(file, True))
    scan.set("points", points)
    buffers = libe57.VectorSourceDestBuffer()
    for key, values in records.items():
        buffers.append(
            libe57.SourceDestBuffer(file, key, values, values.size, True, True)
        )
    writer = points.writer(buffers)
    try:
        writer.write(next(iter(records.values())).size)
    except BaseException:
        # A writer that is open when its file goes ends the whole program.
        with contextlib.suppress(libe57.E57Exception):
            writer.close()
        raise
    writer.close()
