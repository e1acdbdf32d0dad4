"""Trajectories of vehicles: files of amulor, tables, NMEA 0183 logs and ROS 2 bags."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from amulor.errors import FormatError
from amulor.io.files import atomic_output
from amulor.io.recording_table import ANGLES, Column, Table, TableSettings, read_table
from amulor.platform import Trajectory, rotation_of
from amulor.platform.attitude import covariance_of
from amulor.platform.messages import POSE, UPPER, Messages, trajectory_of
from amulor.survey import toml_file
from amulor.survey.quantity import Angle, Description, Length, Position, Time
from amulor.survey.scan import ReferenceSystem, projected_code

Floats = NDArray[np.float64]

#: Rotation from (right, down, forward) to (forward, right, down) axes of a vehicle.
_TO_FRD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
#: Rotation from (right, down, forward) to (forward, left, up) axes of a vehicle.
_TO_FLU = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
#: Rotation from (north, east, down) to (east, north, up).
FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_HEADER = "amulor trajectory, version 1"


class TrajectoryColumns(Description):
    """Column name of each quantity of a trajectory."""

    time: Column
    """Time stamp of the pose."""
    east: Column | None = None
    """Position to the east [m]."""
    north: Column | None = None
    """Position to the north [m]."""
    up: Column | None = None
    """Height above the origin of the frame [m]."""
    down: Column | None = None
    """Depth below the origin of the frame, instead of the height [m]."""
    latitude: Column | None = None
    """Geographic latitude, instead of the position to the north [deg]."""
    longitude: Column | None = None
    """Geographic longitude, instead of the position to the east [deg]."""
    heading: Column | None = None
    """Direction of the vehicle's forward axis, clockwise from north."""
    pitch: Column | None = None
    """Elevation of the vehicle's forward axis."""
    roll: Column | None = None
    """Angle of the vehicle's right axis below the horizontal."""
    qx: Column | None = None
    """First vector component of the attitude's quaternion [1]."""
    qy: Column | None = None
    """Second vector component of the attitude's quaternion [1]."""
    qz: Column | None = None
    """Third vector component of the attitude's quaternion [1]."""
    qw: Column | None = None
    """Scalar component of the attitude's quaternion [1]."""
    position_uncertainty: Column | None = None
    """Standard uncertainty of each coordinate [m]."""
    heading_uncertainty: Column | None = None
    """Standard uncertainty of the heading."""
    level_uncertainty: Column | None = None
    """Standard uncertainty of pitch and roll."""

    @property
    def texts(self) -> set[str]:
        """Names of the columns that hold text."""
        return {self.time}

    @model_validator(mode="after")
    def _a_pose_is_stated(self) -> Self:
        flat = [("east", "north"), ("latitude", "longitude")]
        heights = [("up",), ("down",)]
        turns = [("heading", "pitch", "roll"), ("qx", "qy", "qz", "qw")]
        for groups in (flat, heights, turns):
            given = [self._given(names) for names in groups]
            for names, part in zip(groups, given, strict=True):
                if 0 < len(part) < len(names):
                    raise ValueError(f"{', '.join(names)} belong together; state all")
            if sum(map(bool, given)) != 1:
                choices = " or ".join(", ".join(names) for names in groups)
                raise ValueError(f"needed are columns for {choices}, once")
        return self

    def _given(self, names: tuple[str, ...]) -> list[str]:
        return [name for name in names if getattr(self, name) is not None]


class TrajectoryConstants(Description):
    """Constants of a trajectory, and the meaning of its columns."""

    time: Literal["seconds", "milliseconds", "microseconds", "nanoseconds", "iso8601"]
    """Unit of the time stamps; "iso8601" for a date and time as text."""
    clock: Literal["unix", "relative"] = "unix"
    """Origin of time stamps that are numbers: 1970-01-01 UTC, or unknown."""
    angle_unit: Literal["rad", "mrad", "deg"] = "deg"
    """Unit of heading, pitch, roll and their uncertainties."""
    quaternion_axes: Literal["FRD in NED", "FLU in ENU"] = "FRD in NED"
    """Axes of the vehicle and of the frame between which quaternions rotate: forward,
    right, down in north, east, down, or forward, left, up in east, north, up (ROS)."""
    heading_from: Literal["grid", "true"] = "grid"
    """North from which the heading counts: grid north of `crs`, or true north."""
    crs: ReferenceSystem = ""
    """Projected reference system of the positions, such as "EPSG:32632"."""
    crs_offset: Position = (0.0, 0.0, 0.0)
    """Offset of the local frame in the reference system (east, north, up), which is
    subtracted from projected positions [m]."""
    position_uncertainty: Annotated[Length, Field(ge=0, le=1000)] | None = None
    """Standard uncertainty of each coordinate if no column has it [m]."""
    heading_uncertainty: Annotated[Angle, Field(ge=0, le=1)] | None = None
    """Standard uncertainty of the heading if no column has it [rad]."""
    level_uncertainty: Annotated[Angle, Field(ge=0, le=1)] | None = None
    """Standard uncertainty of pitch and roll if no column has it [rad]."""
    longest_gap: Annotated[Time, Field(gt=0, le=3600)] | None = None
    """Longest interval between poses that is interpolated, by default five median
    intervals [s]."""


class TrajectoryMap(Description):
    """Assignment of the columns of a table to the quantities of a trajectory."""

    table: TableSettings = TableSettings()
    """File format of the table."""
    columns: TrajectoryColumns
    """Names of columns."""
    constants: TrajectoryConstants
    """Units and constants."""

    @model_validator(mode="after")
    def _a_projection_is_stated(self) -> Self:
        geographic = self.columns.latitude is not None
        if (geographic or self.constants.heading_from == "true") and (
            not self.constants.crs
        ):
            raise ValueError(
                "latitude, longitude and headings from true north need constants.crs, "
                'a projected system such as "EPSG:32632"'
            )
        return self

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a map of columns from a TOML file."""
        return toml_file.read(
            path, cls, what="a column map of a trajectory", error=FormatError
        )


def trajectory_from_table(
    path: str | os.PathLike[str], described: TrajectoryMap
) -> Trajectory:
    r"""Read a trajectory from a table with any names of columns.

    Parameters
    ----------
    path : path-like
        Table (CSV or HDF5).
    described : TrajectoryMap
        Assignment of its columns.

    Returns
    -------
    Trajectory
        The trajectory. Its remarks name late, repeated and incomplete messages and
        gaps.

    Raises
    ------
    FormatError
        If the table cannot be read, or no order of its poses is certain: the clock
        steps back, two poses have one time, or the attitude jumps.

    Examples
    --------
    >>> from pathlib import Path
    >>> from amulor.io.trajectories import TrajectoryMap, trajectory_from_table
    >>> lines = ["t,E,N,depth,hdg,pitch,roll"]
    >>> lines += [f"{0.1 * i:.1f},{0.02 * i:.2f},0,8,90,0,0" for i in range(20)]
    >>> size = Path("rov.csv").write_text("\n".join(lines))
    >>> described = TrajectoryMap(
    ...     columns={
    ...         "time": "t", "east": "E", "north": "N", "down": "depth",
    ...         "heading": "hdg", "pitch": "pitch", "roll": "roll",
    ...     },
    ...     constants={"time": "seconds", "clock": "relative"},
    ... )
    >>> track = trajectory_from_table("rov.csv", described)
    >>> track.at([0.55]).position.round(3).tolist()
    [[0.11, 0.0, -8.0]]
    """
    path = Path(path)
    table = read_table(path, described)
    columns, constants = described.columns, described.constants
    decimal = described.table.decimal
    count = len(table)

    def numbers(name: str | None) -> Floats:
        return np.zeros(count) if name is None else table.numbers(name, decimal=decimal)

    clock: Literal["unix", "relative"] = constants.clock
    if constants.time == "iso8601":
        time, clock = _moments(table, columns.time), "unix"
    else:
        factor = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6,
                  "nanoseconds": 1e-9}[constants.time]  # fmt: skip
        time = factor * numbers(columns.time)
    up = -numbers(columns.down) if columns.up is None else numbers(columns.up)
    convergence = np.zeros(count)
    offset = np.array(constants.crs_offset)
    if columns.latitude is not None:
        place, convergence = projected(
            numbers(columns.latitude), numbers(columns.longitude), constants.crs,
            place=table.place,
        )  # fmt: skip
        position = np.column_stack([place, up]) - offset
    else:
        flat = [numbers(columns.east), numbers(columns.north)]
        position = np.column_stack([*flat, up]) - offset
        if constants.heading_from == "true":
            _, _, convergence = geographic(position[:, :2] + offset[:2], constants.crs)
    if constants.heading_from == "grid":
        convergence = np.zeros(count)
    unit = ANGLES[constants.angle_unit]
    if columns.heading is not None:
        heading, pitch, roll = (
            unit * numbers(getattr(columns, name))
            for name in ("heading", "pitch", "roll")
        )
        _refuse_wrong_angles(heading, pitch, roll, table.place)
        attitude = quaternions_of(rotation_of(heading - convergence, pitch, roll))
    else:
        stated = np.column_stack(
            [numbers(getattr(columns, name)) for name in ("qx", "qy", "qz", "qw")]
        )
        attitude = in_enu(stated, constants.quaternion_axes)
        attitude = _turned_about_up(attitude, -convergence)
    sigma = [
        factor * numbers(getattr(columns, name))
        if getattr(columns, name) is not None
        else np.full(count, np.nan if fixed is None else fixed)
        for name, factor, fixed in (
            ("position_uncertainty", 1.0, constants.position_uncertainty),
            ("heading_uncertainty", unit, constants.heading_uncertainty),
            ("level_uncertainty", unit, constants.level_uncertainty),
        )
    ]
    messages = Messages(
        time=time,
        position=position,
        attitude=attitude,
        covariance=covariance_of(matrices_of(attitude), *sigma),
        clock=clock,
        crs=constants.crs,
        crs_offset=constants.crs_offset,
    )
    return trajectory_of(
        messages,
        source=str(path),
        place=table.place,
        longest_gap=constants.longest_gap,
    )


def write_trajectory(
    track: Trajectory, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a trajectory to a CSV file of amulor.

    Parameters
    ----------
    track : Trajectory
        The trajectory.
    path : path-like
        File to write.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    FormatError
        If the file exists and `overwrite` is not set, or cannot be written.

    Notes
    -----
    Comment lines state clock, longest gap and reference system. A line has time,
    position, quaternion and the 21 elements of the covariance's upper triangle, row by
    row. Numbers have 17 digits, so that the file holds the exact trajectory.

    Examples
    --------
    >>> from amulor.io.trajectories import read_trajectory, write_trajectory
    >>> from amulor.platform import Trajectory
    >>> track = Trajectory.of_angles(
    ...     time=[0, 1], position=[[0, 0, 0], [0, 1, 0]], heading=0.0
    ... )
    >>> write_trajectory(track, "track.csv")
    >>> read_trajectory("track.csv").duration
    1.0
    """
    table = np.column_stack(
        [track.time, track.position, track.attitude, track.covariance[:, *UPPER]]
    )
    offset = " ".join(f"{value:.17g}" for value in track.crs_offset)
    lines = [
        _HEADER,
        f"clock: {track.clock}",
        f"longest_gap: {track.longest_gap:.17g} s",
        f"crs: {track.crs}",
        f"crs_offset: {offset} m",
        *(f"remark: {remark}" for remark in track.remarks),
    ]
    names = [*POSE, *(f"c{row}{column}" for row, column in zip(*UPPER, strict=True))]
    with (
        atomic_output(path, overwrite=overwrite) as temporary,
        open(temporary, "w", encoding="utf-8") as file,
    ):
        file.writelines(f"# {line}\n" for line in lines)
        np.savetxt(
            file, table, fmt="%.17g", delimiter=",", header=",".join(names), comments=""
        )


def read_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read a trajectory from a CSV file of amulor.

    Parameters
    ----------
    path : path-like
        File from `write_trajectory` or `amulor import trajectory`.

    Returns
    -------
    Trajectory
        The trajectory.

    Raises
    ------
    FormatError
        If the file is missing, damaged, or no trajectory of amulor.

    Examples
    --------
    >>> from amulor.io.trajectories import read_trajectory, write_trajectory
    >>> from amulor.platform import Trajectory
    >>> track = Trajectory.of_angles(
    ...     time=[0, 1], position=[[0, 0, 0], [0, 1, 0]], heading=0.0
    ... )
    >>> write_trajectory(track, "turn.csv")
    >>> bool((read_trajectory("turn.csv").attitude == track.attitude).all())
    True
    """
    path = Path(path)
    needed = "import the file with amulor import trajectory"
    try:
        with reading(path), path.open(encoding="utf-8") as file:
            if file.readline().strip() != f"# {_HEADER}":
                raise FormatError(f"{path}: is no trajectory of amulor; {needed}")
            stated: dict[str, str] = {}
            remarks = []
            line = file.readline()
            while line.startswith("# "):
                name, _, text = line[2:].strip().partition(": ")
                if name == "remark":
                    remarks.append(text)
                stated[name.rstrip(":")] = text
                line = file.readline()
            table = np.loadtxt(file, delimiter=",", ndmin=2)
        covariance = np.zeros((len(table), 6, 6))
        covariance[:, *UPPER] = table[:, len(POSE) :]
        covariance[:, *UPPER[::-1]] = table[:, len(POSE) :]
        offset = [float(word) for word in stated["crs_offset"].split()[:3]]
        return Trajectory(
            time=table[:, 0],
            position=table[:, 1:4],
            attitude=table[:, 4:8],
            covariance=covariance,
            longest_gap=float(stated["longest_gap"].split()[0]),
            clock="unix" if stated["clock"] == "unix" else "relative",
            crs=stated.get("crs", ""),
            crs_offset=(offset[0], offset[1], offset[2]),
            remarks=tuple(remarks),
        )
    except (ValueError, IndexError, KeyError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise FormatError(f"{path}: is damaged ({reason}); {needed} again") from None


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Raise a FormatError if the system does not read a log or trajectory."""
    try:
        yield
    except OSError as error:
        raise FormatError(
            f"{path}: cannot be read ({error.strerror or error}); check name and folder"
        ) from None


def projected(
    latitude: Floats, longitude: Floats, crs: str, *, place: Callable[[int], str]
) -> tuple[Floats, Floats]:
    """Return projected positions [m], and the meridian convergence there [rad]."""
    wrong = (np.abs(latitude) > 90) | (np.abs(longitude) > 360)
    if wrong.any():
        number = int(np.argmax(wrong))
        raise FormatError(
            f"{place(number)}: latitude {latitude[number]:g}, longitude "
            f"{longitude[number]:g} are no angles in degrees; are they metres, or in "
            "the wrong order?"
        )
    transformer, projection = _projection(crs)
    east, north = transformer.transform(longitude, latitude)
    convergence = projection.get_factors(longitude, latitude).meridian_convergence
    return np.column_stack([east, north]), np.radians(convergence)


def geographic(position: Floats, crs: str) -> tuple[Floats, Floats, Floats]:
    """Return longitudes, latitudes [deg] and meridian convergence [rad]."""
    transformer, projection = _projection(crs)
    longitude, latitude = transformer.transform(
        position[:, 0], position[:, 1], direction="INVERSE"
    )
    factors = projection.get_factors(longitude, latitude)
    convergence = np.asarray(np.radians(factors.meridian_convergence))
    return np.asarray(longitude), np.asarray(latitude), convergence


def _projection(crs: str) -> tuple[Any, Any]:
    """Return the transformer from WGS 84, and the projection, of a reference system."""
    code = projected_code(crs)
    if code is None:
        raise FormatError(
            f"crs {crs!r} is a name; geographic positions need a projected system of "
            'EPSG, such as "EPSG:32632"'
        )
    import pyproj

    transformer = pyproj.Transformer.from_crs(4326, code, always_xy=True)
    return transformer, pyproj.Proj(code)


def _moments(table: Table, name: str) -> Floats:
    """Return time stamps of a column of dates as Unix times [s]."""
    texts = table.texts(name)
    time = np.full(len(texts), np.nan)
    for number, text in enumerate(texts):
        moment = str(text).replace("Z", "").replace("z", "")
        try:
            time[number] = np.datetime64(moment, "ns").astype(np.int64) * 1e-9
        except ValueError:
            raise FormatError(
                f"{table.place(number)}: column {name!r} holds {str(text)!r}, needed "
                'is a date and time in UTC, such as "2026-05-04T10:20:30.5"'
            ) from None
    return time


def _refuse_wrong_angles(
    heading: Floats, pitch: Floats, roll: Floats, place: Callable[[int], str]
) -> None:
    limits = {"heading": (heading, 2 * np.pi), "pitch": (pitch, np.pi / 2),
              "roll": (roll, np.pi)}  # fmt: skip
    for name, (angle, limit) in limits.items():
        wrong = np.abs(angle) > limit * (1 + 1e-9)
        if wrong.any():
            number = int(np.argmax(wrong))
            raise FormatError(
                f"{place(number)}: {name} {np.degrees(angle[number]):.4g} deg is "
                f"beyond {np.degrees(limit):.0f} deg; check constants.angle_unit"
            )


def quaternions_of(turns: Floats) -> Floats:
    """Return quaternions of rotation matrices, NaN where a matrix is not finite."""
    result = np.full((len(turns), 4), np.nan)
    finite = np.isfinite(turns).all(axis=(1, 2))
    if finite.any():
        result[finite] = Rotation.from_matrix(turns[finite]).as_quat()
    return result


def in_enu(quaternions: Floats, axes: str) -> Floats:
    """Return quaternions from (right, down, forward) to (east, north, up).

    Products with fixed rotations keep the norm, so that a wrong one is noticed later.
    """
    if axes == "FRD in NED":
        left, right = Rotation.from_matrix(FROM_NED), Rotation.from_matrix(_TO_FRD)
    else:
        left, right = Rotation.identity(), Rotation.from_matrix(_TO_FLU)
    size = np.linalg.norm(quaternions, axis=1)
    result = np.full_like(quaternions, np.nan)
    usable = np.isfinite(size) & (size > 0)
    if usable.any():
        turned = left * Rotation.from_quat(quaternions[usable]) * right
        result[usable] = turned.as_quat() * size[usable, None]
    return result


def _turned_about_up(quaternions: Floats, angle: Floats) -> Floats:
    """Return attitudes with the heading increased by an angle [rad]."""
    if not angle.any():
        return quaternions
    turns = Rotation.from_rotvec(-angle[:, None] * np.array([0.0, 0.0, 1.0]))
    result = np.full_like(quaternions, np.nan)
    finite = np.isfinite(quaternions).all(axis=1)
    result[finite] = (turns[finite] * Rotation.from_quat(quaternions[finite])).as_quat()
    return result


def matrices_of(quaternions: Floats) -> Floats:
    """Return rotation matrices of quaternions, NaN where a quaternion is not finite."""
    turns = np.full((len(quaternions), 3, 3), np.nan)
    finite = np.isfinite(quaternions).all(axis=1)
    if finite.any():
        turns[finite] = Rotation.from_quat(quaternions[finite]).as_matrix()
    return turns
