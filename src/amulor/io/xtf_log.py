"""Navigation in files of sonars: the eXtended Triton Format (XTF)."""

from __future__ import annotations

import mmap
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import FormatError
from amulor.io.navigation_logs import UNKNOWN, trajectory_of_fixes
from amulor.io.trajectories import reading
from amulor.platform import Trajectory

Floats = NDArray[np.float64]
Records = NDArray[np.void]

#: First byte of a file, first word of a record, size of both headers [bytes].
_FILE, _RECORD, _HEADER, _START = 0x7B, 0xFACE, 1024, 14
#: Unit of coordinates and numbers of channels in the header of a file.
_CONTENT = np.dtype(
    {
        "names": ["unit", "sonar", "depth", "snippet", "forward", "echo", "phase"],
        "formats": ["<u2", "<u2", "<u2", "u1", "u1", "<u2", "u1"],
        "offsets": [164, 166, 168, 170, 171, 172, 174],
        "itemsize": _HEADER,
    }
)
#: Channels that the header of a file describes in 1024 bytes, each in 128 bytes.
_CHANNELS, _OF_CHANNEL = 6, 128
#: Unit of coordinates in the header: longitude and latitude.
_GEOGRAPHIC = 3
_DATE = {
    "year": "<u2", "month": "u1", "day": "u1", "hour": "u1", "minute": "u1",
    "second": "u1",
}  # fmt: skip


def _record(begin: int, fields: dict[str, str], **others: tuple[str, int]) -> np.dtype:
    """Return the layout of a record: fields in a row from a byte, and others."""
    sizes = [np.dtype(kind).itemsize for kind in fields.values()]
    places = begin + np.cumsum([0, *sizes[:-1]])
    formats = [*fields.values(), *(kind for kind, _ in others.values())]
    offsets = [*places.tolist(), *(at for _, at in others.values())]
    return np.dtype({"names": [*fields, *others], "formats": formats,
                     "offsets": offsets, "itemsize": 64})  # fmt: skip


#: Records with positions and attitudes: type, and layout. The part of a second counts
#: tenths of milliseconds in positions, and milliseconds in attitudes.
_ANGLES = {"pitch": "<f4", "roll": "<f4", "heave": "<f4"}
_POSITION = 107, _record(
    14,
    {**_DATE, "part": "<u2", "latitude": "<f8", "longitude": "<f8", "height": "<f8",
     **_ANGLES, "heading": "<f4"},
)  # fmt: skip
_ATTITUDE = 3, _record(
    54, {**_DATE, "part": "<u2"}, microsecond=("<u4", 22), epoch=("<u4", 26),
    pitch=("<f4", 30), roll=("<f4", 34), heading=("<f4", 50),
)  # fmt: skip


def trajectory_from_xtf(
    path: str | os.PathLike[str],
    *,
    crs: str,
    crs_offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    uncertainty: tuple[float, float, float] = UNKNOWN,
) -> Trajectory:
    """Read a trajectory from the navigation in an XTF file.

    Parameters
    ----------
    path : path-like
        File of a sonar or of a navigation program (XTF).
    crs : str
        Projected reference system of the trajectory, such as "EPSG:32632".
    crs_offset : tuple of float
        Offset of the local frame in the reference system, which is subtracted [m].
    uncertainty : tuple of float
        Standard uncertainties where the log states none: of each coordinate [m], of the
        heading [rad], and of pitch and roll [rad].

    Returns
    -------
    Trajectory
        The trajectory, with Unix times. XTF states no uncertainties.

    Raises
    ------
    FormatError
        If the file is no XTF file or damaged, its coordinates are not longitude and
        latitude, or it holds fewer than two positions.
    MissingExtraError
        If the extra `platform` is not installed.

    Notes
    -----
    Records used: raw navigation (type 107: position, height, heading, pitch, roll), and
    attitude (type 3). Poses have the times of the attitude records if these state a
    heading, else those of the positions. Headings are converted to grid north.

    Examples
    --------
    >>> from amulor.errors import FormatError
    >>> from amulor.io.xtf_log import trajectory_from_xtf
    >>> try:
    ...     trajectory_from_xtf("dive.xtf", crs="EPSG:32632")
    ... except FormatError as error:
    ...     print(error)
    dive.xtf: cannot be read (No such file or directory); check name and folder
    """
    path = Path(path)
    with reading(path), path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size < _HEADER or file.read(1)[0] != _FILE:
            raise FormatError(
                f"{path}: is no XTF file, which has a header of {_HEADER} bytes "
                f"that begins with 0x7B ({size} bytes); check the file"
            )
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            found, remarks = _records(path, content)
    positions, late = _timed(found[_POSITION[0]], 1e-4)
    attitudes, wrong = _timed(found[_ATTITUDE[0]], 1e-3)
    if late + wrong:
        remarks.append(f"{late + wrong} x record with an impossible date left out")
    if len(positions) < 2:
        raise FormatError(
            f"{path}: has {len(positions)} positions (raw navigation, type 107), "
            "needed are 2 or more; convert the log to a table and state its columns"
        )
    fixes = _columns(positions, "time", "latitude", "longitude", "height")
    headed = attitudes if len(attitudes) and attitudes["heading"].any() else positions
    angles = _columns(headed, "time", "heading", "pitch", "roll")
    return trajectory_of_fixes(
        path,
        fixes,
        np.full((len(fixes), 3), np.nan),
        np.column_stack([angles, np.full((len(angles), 3), np.nan)]),
        crs=crs,
        crs_offset=crs_offset,
        uncertainty=uncertainty,
        remarks=remarks,
        place=lambda number: f"{path}, attitude {number + 1}",
    )


def _records(path: Path, content: mmap.mmap) -> tuple[dict[int, Records], list[str]]:
    """Return the records of positions and attitudes, and remarks."""
    unit, *channels = np.frombuffer(content[:_HEADER], _CONTENT)[0].item()
    if unit != _GEOGRAPHIC:
        raise FormatError(
            f"{path}: its coordinates are not longitude and latitude (unit {unit}, "
            f"needed is {_GEOGRAPHIC}); export it with geographic coordinates, or "
            "convert the log to a table and state its columns"
        )
    beyond = max(sum(channels) - _CHANNELS, 0) * _OF_CHANNEL
    place = _HEADER + -(-beyond // _HEADER) * _HEADER
    layouts = dict([_POSITION, _ATTITUDE])
    parts: dict[int, list[bytes]] = {kind: [] for kind in layouts}
    remarks = []
    while place < len(content):
        start = content[place : place + _START]
        size = int.from_bytes(start[10:14], "little")
        if len(start) == _START and int.from_bytes(start[:2], "little") != _RECORD:
            raise FormatError(
                f"{path}: is damaged at byte {place}, where no record begins; copy it "
                "again"
            )
        if len(start) < _START or not _START <= size <= len(content) - place:
            remarks.append(f"the file is cut off in the record at byte {place}")
            break
        kind = start[2]
        if kind in layouts and size >= layouts[kind].itemsize:
            parts[kind].append(content[place : place + layouts[kind].itemsize])
        place += size
    return {
        kind: np.frombuffer(b"".join(parts[kind]), layout)
        for kind, layout in layouts.items()
    }, remarks


def _timed(records: Records, unit: float) -> tuple[Records, int]:
    """Return records with a possible date and a field of Unix time, and other ones."""
    limits = {
        "year": (1970, 2200), "month": (1, 12), "day": (1, 31), "hour": (0, 23),
        "minute": (0, 59), "second": (0, 60),
    }  # fmt: skip
    names: tuple[str, ...] = records.dtype.names or ()
    epoch = records["epoch"] if "epoch" in names else np.zeros(len(records))
    good = np.ones(len(records), dtype=bool)
    for name, (least, most) in limits.items():
        good &= (records[name] >= least) & (records[name] <= most)
    good |= epoch > 0
    used = records[good]
    result: Records = np.empty(
        len(used), dtype=[(name, "f8") for name in ("time", *names)]
    )
    for name in names:
        result[name] = used[name]
    months = (used["year"].astype(int) - 1970) * 12 + used["month"].astype(int) - 1
    days = months.astype("M8[M]").astype("M8[D]").astype(float) + result["day"] - 1
    time = 86400 * days + 3600 * result["hour"] + 60 * result["minute"]
    time += result["second"] + unit * result["part"]
    if "epoch" in names:
        by_epoch = result["epoch"] + 1e-6 * result["microsecond"]
        time = np.where(result["epoch"] > 0, by_epoch, time)
    result["time"] = time
    return result, int((~good).sum())


def _columns(records: Any, *names: str) -> Floats:
    """Return fields of records as columns."""
    return np.column_stack([records[name] for name in names])
