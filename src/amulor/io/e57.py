"""Writes point clouds as structured scans in E57 files."""

from __future__ import annotations

import contextlib
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
from amulor.errors import FormatError, MissingExtraError
from amulor.io._cloud import checked_cloud, checked_parts, provenance_lines
from amulor.io.e57_records import BLOCK, FIELDS, Records
from amulor.io.files import atomic_output


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


def write_e57_parts(
    parts: Callable[[], Iterable[xr.Dataset]],
    count: int,
    path: str | os.PathLike[str],
    *,
    shape: tuple[int, int],
    overwrite: bool = False,
) -> None:
    """Write the cloud of a scan that comes in parts, so that none is in memory whole.

    Parameters
    ----------
    parts : callable
        Gives the parts in the order of their rows, the same ones each time: once for
        bounds and identifiers and once to write them.
    count : int
        Points that they hold together.
    path, overwrite
        As in `write_e57`.
    shape : tuple of int
        Rows and columns of the scan [1].

    Raises
    ------
    CubeError, FormatError, MissingExtraError
        As `write_e57`, and if there are more or fewer points.

    Notes
    -----
    The file is that of the whole cloud, byte for byte: records are handed over in
    blocks of the same size for whatever parts.
    """
    name = f"the cloud for {path}"

    def checked() -> Iterator[xr.Dataset]:
        return checked_parts(parts(), count, name=name)

    libe57 = _libe57()
    _write_file(libe57, [Records(checked, shape, name=name)], path, overwrite=overwrite)


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


def _libe57() -> Any:
    try:
        from pye57 import libe57
    except ImportError as error:
        raise MissingExtraError(
            "pye57", extra="e57", purpose="writing E57 files"
        ) from error
    return libe57


def _shape_of(cloud: xr.Dataset) -> tuple[int, int]:
    """Return rows and columns of the scan that a cloud comes from."""
    if "scan_shape" in cloud.attrs:
        rows, columns = (int(size) for size in cloud.attrs["scan_shape"])
        return rows, columns
    return int(cloud["row"].max()) + 1, int(cloud["column"].max()) + 1


def _pose(matrix: NDArray[np.float64]) -> dict[str, dict[str, float]]:
    """Return a pose as the format states it: unit quaternion and translation."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    rotation = {"w": float(w), "x": float(x), "y": float(y), "z": float(z)}
    place = dict(zip("xyz", matrix[:3, 3].tolist(), strict=True))
    return {"rotation": rotation, "translation": place}


def _write(libe57: Any, path: Path, scans: Sequence[Records]) -> None:
    file = libe57.ImageFile(str(path), "w")
    try:
        file.extensionsAdd("", libe57.E57_V1_0_URI)
        # The same clouds get the same identifiers.
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
    # The writer takes its records from these, again and again.
    taken: dict[str, NDArray[Any]] = {
        key: np.zeros(size, dtype=kind) for key, kind in FIELDS.items()
    }
    prototype = libe57.StructureNode(file)
    for key, values in taken.items():
        if values.dtype.kind == "f":
            field = libe57.FloatNode(file, 0.0, libe57.E57_DOUBLE)
        else:
            field = libe57.IntegerNode(file, 0, 0, max(1, int(scan.ends[key][1])))
        prototype.set(key, field)
    points = libe57.CompressedVectorNode(file, prototype, libe57.VectorNode(file, True))
    node.set("points", points)
    buffers = libe57.VectorSourceDestBuffer()
    for key, values in taken.items():
        buffers.append(
            libe57.SourceDestBuffer(file, key, values, values.size, True, True)
        )
    writer = points.writer(buffers)
    try:
        for block in scan.blocks():
            for key, values in taken.items():
                values[: len(block)] = block[key]
            writer.write(len(block))
    except BaseException:
        # A writer that is open when its file goes ends the whole program.
        with contextlib.suppress(libe57.E57Exception):
            writer.close()
        raise
    writer.close()
