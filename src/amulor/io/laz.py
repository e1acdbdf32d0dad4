"""Point clouds as LAS and LAZ files."""

from __future__ import annotations

import logging
import os
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor._las import check_counts
from amulor.cube import provenance
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
    spread,
    up_of,
)

#: Step of the coordinates in the file [m]: the rounding, half of it, is far below the
#: range precision of any instrument.
SCALE = 1e-6
# Coordinates are 32-bit steps from an offset.
_LARGEST = np.iinfo(np.int32).max
_BRIGHTEST = np.iinfo(np.uint16).max
#: Number of points compressed at once: whole chunks of 50,000.
_BLOCK = 200_000
# Name, type, variable, and description of at most 32 bytes, where the unit goes.
_EXTRA = (
    ("amplitude", np.float64, "intensity", "amplitude of the signal [V]"),
    (
        "slant_range_uncertainty",
        np.float64,
        "slant_range_uncertainty",
        "standard uncertainty [m]",
    ),
    (
        "common_uncertainty",
        np.float64,
        "slant_range_common_uncertainty",
        "part that points share [m]",
    ),
    ("sigma_x", np.float64, "x_uncertainty", "standard uncertainty of x [m]"),
    ("sigma_y", np.float64, "y_uncertainty", "standard uncertainty of y [m]"),
    ("sigma_z", np.float64, "z_uncertainty", "standard uncertainty of z [m]"),
    ("quality_flag", np.uint16, "quality_flag", "amulor flag bits, 0: good [1]"),
    ("row", np.uint32, "row", "row of the scan [1]"),
    ("column", np.uint32, "column", "column of the scan [1]"),
)

# Extra dimensions of a slim file: 18 bytes in 5 fields. QGIS rejects files with 24
# bytes in 8 fields (its issue 62496).
_SLIM = (
    ("amplitude", np.float32, "intensity", "amplitude of the signal [V]"),
    ("sigma_x", np.float32, "x_uncertainty", "standard uncertainty of x [m]"),
    ("sigma_y", np.float32, "y_uncertainty", "standard uncertainty of y [m]"),
    ("sigma_z", np.float32, "z_uncertainty", "standard uncertainty of z [m]"),
    ("quality_flag", np.uint16, "quality_flag", "amulor flag bits, 0: good [1]"),
)
#: Unix time of the origin of GPS time (1980-01-06), and of the adjusted standard GPS
#: time of LAS files after it [s].
_GPS, _ADJUSTED = 315_964_800, 1_000_000_000
#: Start (Unix time) and size of the latest differences of GPS time and UTC [s].
_LEAPS = ((1_341_100_800, 16), (1_435_708_800, 17), (1_483_228_800, 18))

#: Number of points read at once.
_PART = 500_000
#: Number of points of a block whose ends are stored: one chunk of most writers.
_CHUNK = 50_000
#: Number of the record that describes compression; layers of a compressed item by its
#: kind, and the kind of extra bytes, each of which is a layer.
_LASZIP, _LAYERS, _BYTES = 22204, {10: 9, 11: 1, 12: 2, 13: 1}, 14
#: Class of errors that a library in Rust raises where its own code fails.
_PANIC = "PanicException"
#: Dimensions of the format without meaning for such a scan.
_DULL = {
    "X", "Y", "Z", "red", "green", "blue", "return_number", "number_of_returns",
    "synthetic", "key_point", "overlap", "scanner_channel", "scan_direction_flag",
    "edge_of_flight_line", "user_data", "scan_angle", "scan_angle_rank",
    "point_source_id", "gps_time", "withheld", "raw_classification",
}  # fmt: skip
#: Dimensions that every file has, whether they say something or not.
_OFTEN_UNUSED = ("classification", "intensity")


def write_laz(
    cloud: xr.Dataset,
    path: str | os.PathLike[str],
    *,
    slim: bool = False,
    overwrite: bool = False,
) -> None:
    """Write a point cloud to a LAS 1.4 file, compressed unless its suffix is `.las`.

    Parameters
    ----------
    cloud : xarray.Dataset
        A cube of level `point_cloud`.
    path : path-like
        File to write, usually with the suffix `.laz`.
    slim : bool
        Whether to write 18 bytes of extra dimensions per point in place of up to 58:
        amplitude, uncertainties of the coordinates and flags only.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    CubeError
        If the cube is no point cloud, is empty, or has points without a position or
        with a negative intensity.
    FormatError
        If the cloud is too wide for the format, if the file exists and `overwrite`
        is not set, or if it cannot be written.
    MissingExtraError
        If laspy is not installed.

    Notes
    -----
    The file has point format 6. Coordinates are rounded to 1e-6 m, which limits the
    cloud to 4294 m along each axis. `intensity` is the amplitude scaled such that the
    largest is 65535. The amplitude itself and the other variables are extra dimensions,
    with units in their descriptions. Points with a doubtful range have the flag
    "withheld"; readers omit or mark them. Points from a vehicle have `gps_time`: the
    adjusted standard GPS time if the trajectory has dates, else the time of its clock.
    `point_source_id` is the attribute `line_number` of the cloud. An extended record of
    the user "amulor" has provenance and axes.

    Examples
    --------
    >>> import laspy
    >>> from amulor import imaging, io, rejection, samples
    >>> image = imaging.range_image(
    ...     rejection.cross_polarized(samples.cube("ladder"))
    ... )
    >>> cloud = imaging.point_cloud(image)
    >>> io.write_laz(cloud, "ladder.laz")
    >>> laspy.read("ladder.laz").header.point_count, cloud.sizes["point"]
    (4000, 4000)
    """
    cloud = checked_cloud(cloud, name=f"the cloud for {path}")
    write_laz_parts(
        lambda: [cloud], cloud.sizes["point"], path, slim=slim, overwrite=overwrite
    )


def write_laz_parts(
    parts: Callable[[], Iterable[xr.Dataset]],
    count: int,
    path: str | os.PathLike[str],
    *,
    slim: bool = False,
    overwrite: bool = False,
) -> None:
    """Write a point cloud to a LAS or LAZ file in parts, with bounded memory.

    The file equals that of the whole cloud, byte for byte, because points are
    compressed in blocks of equal size for any division into parts.
    """
    laspy = _laspy("writing")
    name = f"the cloud for {path}"
    extent = _extent(checked_parts(parts(), count, name=name), name=name)
    path = Path(path)
    header, extras = _header(laspy, extent, _SLIM if slim else _EXTRA, name=name)
    text = "\n".join(provenance_lines(extent.first))
    record = laspy.VLR("amulor", 1, "provenance", text.encode())
    records = (
        _records(laspy, part, header, extras, extent.brightest)
        for part in checked_parts(parts(), count, name=name)
    )
    with atomic_output(path, overwrite=overwrite) as temporary:
        try:
            with (
                temporary.open("w+b") as file,
                laspy.open(
                    file,
                    mode="w",
                    header=header,
                    do_compress=path.suffix.lower() != ".las",
                    closefd=False,
                ) as writer,
            ):
                for block in in_blocks(records, _BLOCK):
                    writer.write_points(
                        laspy.PackedPointRecord(block, header.point_format)
                    )
                writer.write_evlrs(laspy.vlrs.vlrlist.VLRList([record]))
        except _lazrs_error() as error:
            raise FormatError(
                f"{path} cannot be written: {error}; free some space or choose another "
                "folder"
            ) from error


@dataclass(frozen=True, kw_only=True)
class _Extent:
    """Bounds and largest amplitude of a cloud, for the file header."""

    first: xr.Dataset
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    brightest: float


def _extent(parts: Iterable[xr.Dataset], *, name: str) -> _Extent:
    """Bounds and largest amplitude of a cloud that is read in parts."""
    first: xr.Dataset | None = None
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    brightest = 0.0
    for part in parts:
        first = part if first is None else first
        placed = [part[axis].values for axis in "xyz"]
        low = np.minimum(low, [values.min() for values in placed])
        high = np.maximum(high, [values.max() for values in placed])
        amplitude = part["intensity"].values
        if np.min(amplitude) < 0:
            raise CubeError(
                f"{name}: 'intensity' must not be below 0 V, found "
                f"{np.min(amplitude):g} V; it is an amplitude"
            )
        brightest = max(brightest, float(np.max(amplitude)))
    assert first is not None
    return _Extent(first=first, low=low, high=high, brightest=brightest or 1.0)


def _header(
    laspy: Any, extent: _Extent, dimensions: tuple[Any, ...], *, name: str
) -> tuple[Any, list[Any]]:
    """Header of a LAS file, and the extra dimensions that its points have."""
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.global_encoding.wkt = True  # asked for by this point format, even if unused
    header.system_identifier = "amulor"
    header.generating_software = f"amulor {provenance.software_versions()['amulor']}"
    extras = [entry for entry in dimensions if entry[2] in extent.first]
    if "time" in extent.first and extent.first.attrs.get("trajectory_clock") == "unix":
        header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.add_extra_dims(
        [laspy.ExtraBytesParams(key, kind, about) for key, kind, _, about in extras]
    )
    header.scales = np.full(3, SCALE)
    header.offsets = _offsets(extent, name=name)
    return header, extras


def _offsets(extent: _Extent, *, name: str) -> NDArray[np.float64]:
    # Whole meters, which the file holds exactly; adding zero makes -0 a plain 0.
    offsets = np.round((extent.low + extent.high) / 2) + 0.0
    ends = np.stack([extent.low, extent.high])
    wide = np.abs(np.round((ends - offsets) / SCALE)).max(axis=0) > _LARGEST
    if wide.any():
        axis = int(np.argmax(wide))
        low, high = ends[:, axis]
        raise FormatError(
            f"{name}: '{'xyz'[axis]}' goes from {low:g} m to {high:g} m, but a LAS "
            f"file in steps of {SCALE:g} m holds {2 * _LARGEST * SCALE:.0f} m; write a "
            "PLY or an E57 file, or leave out the far points"
        )
    return np.asarray(offsets)


def _records(
    laspy: Any, part: xr.Dataset, header: Any, extras: list[Any], brightest: float
) -> NDArray[np.void]:
    """Points of a cloud as LAS records."""
    points = laspy.ScaleAwarePointRecord.zeros(part.sizes["point"], header=header)
    for axis, offset in zip("xyz", header.offsets, strict=True):
        steps = np.round((part[axis].values - offset) / SCALE)
        points[axis.upper()] = steps.astype(np.int32)
    share = part["intensity"].values / brightest
    points["intensity"] = np.round(share * _BRIGHTEST).astype(np.uint16)
    points["return_number"] = np.ones(part.sizes["point"], dtype=np.uint8)
    points["number_of_returns"] = np.ones(part.sizes["point"], dtype=np.uint8)
    points["withheld"] = doubtful(part).astype(np.uint8)
    if "time" in part:
        points["gps_time"] = _gps_time(part)
    number = int(part.attrs.get("line_number", 0))
    points["point_source_id"] = np.full(part.sizes["point"], number, dtype=np.uint16)
    for key, kind, variable, _ in extras:
        points[key] = part[variable].values.astype(kind)
    records: NDArray[np.void] = points.array
    return records


def _gps_time(part: xr.Dataset) -> NDArray[np.float64]:
    """Return times of points as adjusted standard GPS times, if dated [s]."""
    time = np.asarray(part["time"].values, dtype=float)
    if part.attrs.get("trajectory_clock") != "unix":
        return time
    begins = [begin for begin, _ in _LEAPS]
    sizes = np.array([_LEAPS[0][1] - 1, *(size for _, size in _LEAPS)])
    leap = sizes[np.searchsorted(begins, time, side="right")]
    return np.asarray(time - _GPS + leap - _ADJUSTED)


def _laspy(purpose: str) -> Any:
    try:
        import laspy
        import lazrs  # noqa: F401  laspy reads and writes LAZ with it
    except ImportError as error:
        raise MissingExtraError(
            "laspy[lazrs]", extra="export", purpose=f"{purpose} LAS and LAZ files"
        ) from error
    return laspy


def _lazrs_error() -> Any:
    """Exception class of `lazrs`, the library that decodes LAZ files."""
    import lazrs

    return lazrs.LazrsError


def read_laz(path: Path, *, most: int) -> Shape:
    """Read a LAS or LAZ file in chunks; return at most `most` of its points."""
    return _opened(path, lambda file: _points_of(file, most, path.name))


def read_laz_box(
    path: Path, thin: Shape, box: NDArray[np.float64], *, most: int
) -> Shape:
    """Further points of a thinned cloud in a box, at most a given number.

    Only blocks of the file whose ends meet the box, shape (2, 3) [m], are read.
    """
    return _opened(path, lambda file: _points_in(file, thin, box, most))


def _opened(path: Path, read: Callable[[Any], Shape]) -> Shape:
    """Shape that is read from an open LAS or LAZ file; FormatError if damaged."""
    laspy = _laspy("reading")
    # The error describes the damage; its log would repeat it.
    logging.getLogger("laspy").addHandler(logging.NullHandler())
    check_counts(path)
    _check_chunks(path)
    try:
        with laspy.open(path) as file:
            _check_layers(path, file.header)
            return read(file)
    except FormatError:
        raise
    # laspy and lazrs raise whatever they meet; panics of lazrs are no `Exception`.
    except BaseException as error:
        if not isinstance(error, Exception) and type(error).__name__ != _PANIC:
            raise
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(
            f"{path.name} cannot be read as LAS or LAZ: {reason}; it is damaged or was "
            "not copied whole"
        ) from error


def _check_chunks(path: Path) -> None:
    """Raise if a LAZ file has more chunks than bytes: lazrs would abort the process."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(105)
        if len(head) < 105 or not head[104] & 0x80:  # not compressed, or none at all
            return
        (points,) = struct.unpack_from("<I", head, 96)
        file.seek(points)
        (table,) = struct.unpack("<q", file.read(8).ljust(8, b"\0"))
        if table == -1 and size > 8:  # written at the end by writers that cannot seek
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


def _check_layers(path: Path, header: Any) -> None:
    """Raise if layers are longer than their chunk: lazrs would allocate their size."""
    import lazrs

    records = [part for part in header.vlrs if part.record_id == _LASZIP]
    if not records:
        return
    content = records[0].record_data
    (count,) = struct.unpack_from("<H", content, 32)
    items = [struct.unpack_from("<HH", content, 34 + 6 * n) for n in range(count)]
    layers = sum(
        size if kind == _BYTES else _LAYERS.get(kind, 0) for kind, size in items
    )
    if not layers:
        return
    described = lazrs.LazVlr(content)
    place = header.offset_to_point_data
    with path.open("rb") as file:
        file.seek(place)
        chunks = lazrs.read_chunk_table(file, described) or []
        place += 8
        for _, size in chunks:
            # The first point and the number of points come before the layers.
            begin = described.item_size() + 4
            file.seek(place + begin)
            sizes = struct.unpack(f"<{layers}I", file.read(4 * layers))
            if sum(sizes) > size - begin - 4 * layers:
                raise FormatError(
                    f"{path.name} declares {sum(sizes)} bytes of layers in a chunk of "
                    f"{size} bytes; it is damaged or was not copied whole"
                )
            place += size


def _points_of(file: Any, most: int, name: str) -> Shape:
    total = int(file.header.point_count)
    indices = spread(total, most)
    parts: list[dict[str, NDArray[Any]]] = []
    ends = []
    first = 0
    for part in file.chunk_iterator(_PART):
        if total > most:
            ends += [
                _ends(part[at : at + _CHUNK]) for at in range(0, len(part), _CHUNK)
            ]
        chosen = indices[(indices >= first) & (indices < first + len(part))] - first
        first += len(part)
        parts.append(_columns_of(part[chosen]))
    if first < total or not total:
        raise FormatError(
            f"{name} says that it has {total} points, and has {first}; it is empty or "
            "was not copied whole"
        )
    shape = _shape_of(
        {key: np.concatenate([part[key] for part in parts]) for key in parts[0]},
        _statements_of(file),
    )
    return replace(shape, total=total, ends=np.array(ends) if ends else None)


def _ends(part: Any) -> NDArray[np.float64]:
    """Lowest and highest coordinates of points, shape (2, 3) [m]."""
    axes = [np.asarray(part[axis]) for axis in "xyz"]
    return np.array([[side(axis) for axis in axes] for side in (np.min, np.max)])


def _points_in(file: Any, thin: Shape, box: NDArray[np.float64], most: int) -> Shape:
    assert thin.ends is not None
    drawn = spread(thin.total, len(thin.position))
    meets = (thin.ends[:, 0] <= box[1]) & (thin.ends[:, 1] >= box[0])
    rng = np.random.default_rng(3)
    found: dict[str, NDArray[Any]] = {}
    for block in np.flatnonzero(meets.all(axis=1)):
        first = int(block) * _CHUNK
        file.seek(first)
        part = file.read_points(_CHUNK)
        place = np.stack([np.asarray(part[axis]) for axis in "xyz"], axis=1)
        inside = ((place >= box[0]) & (place <= box[1])).all(axis=1)
        low, high = np.searchsorted(drawn, [first, first + len(part)])
        inside[drawn[low:high] - first] = False
        more = _columns_of(part[inside])
        # The points with the smallest numbers are an even part of all.
        more["number"] = rng.random(int(inside.sum()))
        found = {
            key: np.concatenate([found[key], values]) if found else values
            for key, values in more.items()
        }
        if len(found["number"]) > most:
            smallest = np.argpartition(found["number"], most)[:most]
            found = {key: values[smallest] for key, values in found.items()}
    if not found:
        found = _columns_of(file.read_points(0))
    found.pop("number", None)
    return _shape_of(found, ())


def _shape_of(columns: dict[str, NDArray[Any]], statements: Sequence[str]) -> Shape:
    position = np.stack([columns.pop(axis) for axis in "xyz"], axis=1)
    colour = None
    if "red" in columns:
        light = np.stack([columns.pop(c) for c in ("red", "green", "blue")], axis=1)
        # Some programs write 8 bits into the 16 of the format.
        shift = 8 if light.max(initial=0) > 255 else 0
        colour = (light >> shift).astype(np.uint8)
    scalars, unused = scalars_of(
        {
            key: values
            for key, values in columns.items()
            if key not in _OFTEN_UNUSED or (values.size and np.ptp(values) > 0)
        }
    )
    if unused:
        statements = [*statements, f"not shown: {', '.join(unused)}"]
    return Shape(
        position=position,
        scalars=scalars,
        colour=colour if colour is not None and colour.any() else None,
        up=up_of(statements),
        statements=statements,
    )


def _columns_of(part: Any) -> dict[str, NDArray[Any]]:
    names = list(part.point_format.dimension_names)
    columns = {axis: np.asarray(getattr(part, axis)) for axis in "xyz"}
    if {"red", "green", "blue"} <= set(names):
        columns |= {c: np.asarray(part[c]) for c in ("red", "green", "blue")}
    for key in names:
        values = np.asarray(part[key]) if key not in _DULL else None
        if values is not None and values.ndim == 1:
            columns[key] = values
    return columns


def _statements_of(file: Any) -> list[str]:
    """Statements that amulor stored in a variable-length record of a LAS file."""
    records = [*(file.header.vlrs or []), *(file.evlrs or [])]
    for record in records:
        if getattr(record, "user_id", "") == "amulor":
            text = record.record_data.decode("utf-8", "replace")
            return [str(line) for line in text.splitlines()]
    return []
