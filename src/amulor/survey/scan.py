"""Scan and pose of the instrument, and coordinate reference systems."""

from __future__ import annotations

import contextlib
import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from amulor.errors import MissingExtraError, SurveyError
from amulor.survey import toml_file
from amulor.survey.quantity import (
    Angle,
    Count,
    Description,
    Length,
    Position,
    Temperature,
    Time,
    Voltage,
)

_NEEDED = 'state a projected system in meters, such as "EPSG:32632", or a name'


def epsg_code(text: str) -> int | None:
    """Return the EPSG code in the name of a reference system; None if there is none."""
    if not re.match(r"\s*(epsg\b|\d+\s*$)", text, flags=re.IGNORECASE):
        return None
    match = re.fullmatch(r"\s*epsg:(\d{4,5})\s*", text, flags=re.IGNORECASE)
    if not match:
        raise ValueError(
            f'"{text}" is no number of EPSG: write "EPSG:" and its four or five '
            'digits, such as "EPSG:32632"'
        )
    return int(match[1])


def projected_code(text: str) -> int | None:
    """Return the EPSG code of a projected system in meters; None for plain names."""
    code = epsg_code(text)
    if code is None:
        return None
    pyproj = _pyproj()
    try:
        system = pyproj.CRS.from_epsg(code)
    except pyproj.exceptions.CRSError:
        raise ValueError(f"EPSG has no system {code}; {_NEEDED}") from None
    described = f"EPSG:{code} ({system.name})"
    if system.is_compound:
        flat = system.sub_crs_list[0].to_epsg()
        raise ValueError(
            f"{described} is a system with heights; state its horizontal part"
            + (f', "EPSG:{flat}"' if flat else "")
        )
    units = {axis.unit_name for axis in system.axis_info}
    if units != {"metre"}:
        raise ValueError(f"{described} is in units of {', '.join(units)}; {_NEEDED}")
    if not system.is_projected:
        raise ValueError(f"{described} is no projected system; {_NEEDED}")
    if "Pseudo Mercator" in system.coordinate_operation.method_name:
        raise ValueError(
            f"{described} stretches lengths, by 41 % at 45 degrees of latitude; "
            + _NEEDED
        )
    return code


def _checked(text: str) -> str:
    """Return a reference-system name; ValueError if its EPSG code is not projected."""
    # Only writers of coordinates in the reference system require pyproj.
    with contextlib.suppress(MissingExtraError):
        projected_code(text)
    return text


def _pyproj() -> Any:
    try:
        import pyproj
    except ImportError:
        raise MissingExtraError(
            "pyproj", extra="export", purpose="a reference system of EPSG"
        ) from None
    return pyproj


#: Text of a survey or a site file.
ReferenceSystem = Annotated[str, Field(max_length=200), AfterValidator(_checked)]


class OpenWater(Description):
    """Open-water reference measurements: the same water without the target.

    Examples
    --------
    >>> from amulor.survey import OpenWater, Survey
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {"scan.open_water": OpenWater(columns=9, rows=9)}
    ... )
    >>> survey.scan.open_water.repeats
    10
    """

    columns: Annotated[Count, Field(ge=1, le=10_000)] = 9
    """Number of directions along a row, from edge to edge of the scan [1]."""
    rows: Annotated[Count, Field(ge=1, le=10_000)] = 3
    """Number of rows of directions [1]."""
    repeats: Annotated[Count, Field(ge=1, le=100_000)] = 10
    """Number of samples in each direction [1]."""


class StandingReference(Description):
    """Standing target or end of a fiber, whose phase is read before each row.

    Its signal has a constant optical path, so that changes of its phase are those of
    the instrument.

    Examples
    --------
    >>> from amulor.survey import StandingReference
    >>> reference = StandingReference(
    ...     azimuth="12 deg", elevation="0 deg", amplitude="20 mV"
    ... )
    >>> reference.readings
    1
    """

    azimuth: Annotated[Angle, Field(gt=-math.pi / 2, lt=math.pi / 2)]
    """Azimuth of the reference, to the right [rad]."""
    elevation: Annotated[Angle, Field(gt=-math.pi / 2, lt=math.pi / 2)]
    """Elevation of the reference, upwards [rad]."""
    amplitude: Annotated[Voltage, Field(gt=0, le=1e4)]
    """Expected amplitude of its signal in each channel, for simulations and the error
    budget [V]."""
    readings: Annotated[Count, Field(ge=1, le=10_000)] = 1
    """Number of readings for each channel, before each row and before each round of
    open-water reference measurements [1]."""


class Scan(Description):
    """Scan over a rectangular grid of directions.

    Examples
    --------
    >>> from amulor.survey import Scan
    >>> scan = Scan(
    ...     columns=120,
    ...     rows=80,
    ...     azimuth_span="12 deg",
    ...     elevation_span="8 deg",
    ...     dwell="60 ms",
    ... )
    >>> scan.columns * scan.rows * scan.dwell
    576.0
    """

    columns: Annotated[Count, Field(ge=1, le=20_000)]
    """Number of pixels along a row [1]."""
    rows: Annotated[Count, Field(ge=1, le=20_000)]
    """Rows of pixels; the first row is at the top [1]."""
    azimuth_span: Annotated[Angle, Field(ge=0, lt=math.pi)]
    """Azimuth difference between the first and the last column [rad]."""
    elevation_span: Annotated[Angle, Field(ge=0, lt=math.pi)]
    """Elevation difference between the first and the last row [rad]."""
    azimuth: Annotated[Angle, Field(gt=-math.pi / 2, lt=math.pi / 2)] = 0.0
    """Azimuth of the middle of the scan, to the right [rad]."""
    elevation: Annotated[Angle, Field(gt=-math.pi / 2, lt=math.pi / 2)] = 0.0
    """Elevation of the middle of the scan, upwards [rad]."""
    dwell: Annotated[Time, Field(gt=0)]
    """Measuring time of each pixel, for each frequency and channel [s]."""
    order: Literal["raster", "serpentine"] = "raster"
    """Direction of the rows: all rows from left to right, or every second row from
    right to left."""
    moves: Literal["beam", "both"] = "beam"
    """Moving part: the beam only, or emitter and receiver together."""
    open_water: OpenWater | None = None
    """Open-water reference measurements; none by default."""
    reference: StandingReference | None = None
    """Standing reference for the phase of the instrument; none by default."""
    second_reflection: bool | None = None
    """Whether a simulation includes light that two surfaces of the targets reflect, one
    after the other, as in concave corners; without it by default."""
    instrument_temperature: Annotated[Temperature, Field(ge=-60, le=100)] | None = None
    """Temperature of the instrument during the scan, for the correction by a
    temperature calibration; not recorded by default [degC]."""
    instrument_temperature_uncertainty: (
        Annotated[Temperature, Field(ge=0, le=60)] | None
    ) = None
    """Standard uncertainty of the recorded instrument temperature; 0.5 degC by default
    [degC]."""


class Pose(Description):
    """Position (east, north, up) and attitude (heading, pitch, roll) of the instrument.

    Examples
    --------
    >>> from amulor.survey import Pose
    >>> pose = Pose(
    ...     position=("431.2 m", "88.0 m", "-12.5 m"),
    ...     heading="45 deg",
    ...     pitch="-10 deg",
    ...     level_uncertainty="0.2 deg",
    ... )
    >>> pose.position, round(pose.heading, 4)
    ((431.2, 88.0, -12.5), 0.7854)
    """

    position: Position = (0.0, 0.0, 0.0)
    """Origin of the instrument's axes (east, north, up), in the local frame [m]."""
    heading: Annotated[Angle, Field(ge=-2 * math.pi, le=2 * math.pi)] = 0.0
    """Direction of the forward axis, clockwise from grid north [rad]."""
    pitch: Annotated[Angle, Field(ge=-math.pi / 2, le=math.pi / 2)] = 0.0
    """Elevation of the forward axis [rad]. At -90 deg the instrument looks straight
    down, and the upper edge of the scan points towards the heading."""
    roll: Annotated[Angle, Field(ge=-math.pi, le=math.pi)] = 0.0
    """Angle of the right axis below the horizontal, about the forward axis [rad]."""
    crs: ReferenceSystem = ""
    """Reference system of the local frame: a projected system in meters, such as
    "EPSG:32632", or a name; none by default."""
    crs_offset: Position = (0.0, 0.0, 0.0)
    """Offset of the local frame in the reference system (east, north, up) [m]. The
    offset is separate from the position, because many programs round coordinates of
    millions of meters to more than a millimeter."""
    position_uncertainty: Annotated[Length, Field(ge=0, le=1000)] | None = None
    """Standard uncertainty of each coordinate of the position; unknown by default
    [m]."""
    heading_uncertainty: Annotated[Angle, Field(ge=0, le=1)] | None = None
    """Standard uncertainty of the heading; unknown by default [rad]."""
    level_uncertainty: Annotated[Angle, Field(ge=0, le=1)] | None = None
    """Standard uncertainty of pitch and of roll; unknown by default [rad]."""


class _PoseFile(Description):
    """Content of a file with a pose and nothing else."""

    pose: Pose
    """Position and attitude of the instrument."""


def read_pose(path: str | Path) -> Pose:
    r"""Read a pose from a TOML file that has only the section [pose].

    Parameters
    ----------
    path : str or pathlib.Path
        Pose file (TOML).

    Returns
    -------
    Pose
        Pose in SI units.

    Raises
    ------
    SurveyError
        If the file is invalid; the message has one line per error.

    Examples
    --------
    >>> from pathlib import Path
    >>> from amulor.survey import read_pose
    >>> size = Path("pose.toml").write_text(
    ...     '[pose]\nheading = "90 deg"\nposition = ["10 m", "0 m", "-8 m"]\n'
    ... )
    >>> read_pose("pose.toml").position
    (10.0, 0.0, -8.0)
    """
    return toml_file.read(
        path, _PoseFile, what="a file with a [pose]", error=SurveyError
    ).pose
