"""Point clouds as ROS 2 messages PointCloud2 in MCAP files."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.errors import MissingExtraError
from amulor.io.files import atomic_output
from amulor.io.shapes import (
    checked_cloud,
    checked_parts,
    in_blocks,
    provenance_lines,
)

#: Topic of the messages.
TOPIC = "/points"
#: Largest number of points in a message.
BLOCK = 2**18
#: Codes of number types in a field of a message, by type code of numpy.
_CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
#: Variables that become fields of the same name.
_PLAIN = (
    "x", "y", "z", "intensity", "slant_range_uncertainty",
    "slant_range_common_uncertainty", "quality_flag", "row", "column", "time",
)  # fmt: skip
#: Identifiers of the frame of points, after REP 103 and 105.
_FRAMES = {"instrument": "instrument_optical_frame", "z-up": "instrument"}
_DEFINITION = """\
std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
{line}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{line}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{line}
MSG: sensor_msgs/PointField
uint8 INT8=1
uint8 UINT8=2
uint8 INT16=3
uint8 UINT16=4
uint8 INT32=5
uint8 UINT32=6
uint8 FLOAT32=7
uint8 FLOAT64=8
string name
uint32 offset
uint8 datatype
uint32 count
""".format(line="=" * 80)


def write_mcap(
    cloud: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a point cloud as messages PointCloud2 of ROS 2 to an MCAP file.

    Parameters
    ----------
    cloud : xarray.Dataset
        A cube of level `point_cloud`. With the covariances of
        `imaging.point_cloud(image, covariance=True)`, each point has its full
        covariance.
    path : path-like
        File to write, usually with the suffix `.mcap`.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    CubeError
        If the cube is no point cloud, is empty, or has points without a position.
    FormatError
        If the file exists and `overwrite` is not set, or cannot be written.
    MissingExtraError
        If the extra `platform` is not installed.

    Notes
    -----
    Fields are in double precision, on the topic `/points`: coordinates [m], amplitude
    [V], the covariance of the coordinates (`covariance_xx` to `covariance_zz`) [m^2],
    uncertainties, flags, pixel and time. A message has at most 262,144 points. Its
    stamp is the time of its first point, or of the start of the scan. Metadata of the
    file state frame, reference system and provenance.

    Examples
    --------
    >>> from mcap.reader import make_reader
    >>> from amulor import imaging, io, rejection, samples
    >>> image = imaging.range_image(
    ...     rejection.cross_polarized(samples.cube("ladder"))
    ... )
    >>> cloud = imaging.point_cloud(image, covariance=True)
    >>> io.write_mcap(cloud, "ladder.mcap")
    >>> with open("ladder.mcap", "rb") as file:
    ...     summary = make_reader(file).get_summary()
    >>> [schema.name for schema in summary.schemas.values()]
    ['sensor_msgs/msg/PointCloud2']
    """
    cloud = checked_cloud(cloud, name=f"the cloud for {path}")
    write_mcap_parts([cloud], cloud.sizes["point"], path, overwrite=overwrite)


def write_mcap_parts(
    parts: Iterable[xr.Dataset],
    count: int,
    path: str | os.PathLike[str],
    *,
    overwrite: bool = False,
) -> None:
    """Write a point cloud in parts; the file is as if written in one piece."""
    try:
        from mcap.writer import Writer
    except ImportError:
        raise MissingExtraError(
            "mcap-ros2-support", extra="platform", purpose="a cloud in MCAP"
        ) from None
    first: list[xr.Dataset] = []

    def records() -> Iterator[NDArray[np.void]]:
        for part in checked_parts(parts, count, name=f"the cloud for {path}"):
            if not first:
                first.append(part)
            yield _records(part)

    with (
        atomic_output(path, overwrite=overwrite) as temporary,
        temporary.open("wb") as file,
    ):
        writer = Writer(file)
        writer.start(profile="ros2", library="amulor")
        schema = writer.register_schema(
            "sensor_msgs/msg/PointCloud2", "ros2msg", _DEFINITION.encode()
        )
        channel = writer.register_channel(TOPIC, "cdr", schema)
        for number, block in enumerate(in_blocks(records(), BLOCK)):
            cloud = first[0]
            stamp = _stamp(cloud, block)
            writer.add_message(
                channel,
                log_time=stamp,
                publish_time=stamp,
                sequence=number,
                data=_message(block, stamp, _frame(cloud)),
            )
        writer.add_metadata("amulor", _statements(first[0]))
        writer.finish()  # type: ignore[no-untyped-call]


def _records(cloud: xr.Dataset) -> NDArray[np.void]:
    """Return the points of a cloud as records without padding."""
    values: dict[str, NDArray[Any]] = {
        name: cloud[name].values for name in _PLAIN if name in cloud
    }
    if "xy_covariance" in cloud:
        for name, variable in (("xx", "x"), ("yy", "y"), ("zz", "z")):
            sigma = cloud[f"{variable}_uncertainty"].values
            values[f"covariance_{name}"] = sigma**2
        for name in ("xy", "xz", "yz"):
            values[f"covariance_{name}"] = cloud[f"{name}_covariance"].values
    types = [
        (name, np.dtype(array.dtype).newbyteorder("<"))
        for name, array in values.items()
    ]
    records = np.empty(cloud.sizes["point"], dtype=types)
    for name, array in values.items():
        records[name] = array
    return records


def _stamp(cloud: xr.Dataset, block: NDArray[np.void]) -> int:
    """Return the time of a message, from the points or the start of the scan [ns]."""
    if "time" in (block.dtype.names or ()):
        return max(round(float(block["time"][0]) * 1e9), 0)
    text = str(cloud.attrs.get("time_coverage_start", ""))
    if not text:
        return 0
    moment = datetime.fromisoformat(text)
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return max(round(moment.timestamp() * 1e6) * 1000, 0)


def _frame(cloud: xr.Dataset) -> str:
    """Return the identifier of the frame of a cloud."""
    return _FRAMES.get(str(cloud.attrs.get("frame", "instrument")), "map")


def _statements(cloud: xr.Dataset) -> dict[str, str]:
    """Return frame, reference system and provenance of a cloud."""
    offset = np.asarray(cloud.attrs.get("crs_offset", np.zeros(3)), dtype=float)
    return {
        "axes": str(cloud.attrs.get("frame_axes", "")),
        "crs": str(cloud.attrs.get("crs", "")),
        "crs_offset": " ".join(f"{value:.17g}" for value in offset),
        "trajectory_clock": str(cloud.attrs.get("trajectory_clock", "")),
        "not_in_uncertainties": str(cloud.attrs.get("pose_unknown", "")),
        "provenance": "\n".join(provenance_lines(cloud)),
    }


def _message(block: NDArray[np.void], stamp: int, frame: str) -> bytes:
    """Return a message PointCloud2 in the encoding CDR, little-endian."""
    out = bytearray()

    def put(form: str, value: int) -> None:
        out.extend(b"\0" * (-len(out) % struct.calcsize(form)))
        out.extend(struct.pack(f"<{form}", value))

    def text(value: str) -> None:
        data = value.encode() + b"\0"
        put("I", len(data))
        out.extend(data)

    seconds, nanoseconds = divmod(stamp, 10**9)
    put("i", seconds)
    put("I", nanoseconds)
    text(frame)
    put("I", 1)
    put("I", len(block))
    fields: Mapping[str, Any] = block.dtype.fields or {}
    put("I", len(fields))
    for name, (kind, offset, *_) in fields.items():
        text(name)
        put("I", offset)
        put("B", _CODES[kind.str[1:]])
        put("I", 1)
    put("B", 0)
    put("I", block.dtype.itemsize)
    put("I", block.nbytes)
    put("I", block.nbytes)
    out.extend(block.tobytes())
    coordinates = np.stack([block[axis] for axis in "xyz"])
    put("B", int(np.isfinite(coordinates).all()))
    # CDR, little-endian; alignment counts from after this header.
    return b"\0\1\0\0" + bytes(out)
