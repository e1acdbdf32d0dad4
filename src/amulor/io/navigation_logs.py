"""Navigation logs as trajectories: NMEA 0183 sentences, and ROS 2 bags in MCAP."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, time
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from amulor.errors import FormatError, MissingExtraError
from amulor.io.trajectories import (
    FROM_NED,
    in_enu,
    projected,
    quaternions_of,
    reading,
)
from amulor.platform import Trajectory, rotation_of
from amulor.platform.attitude import covariance_of
from amulor.platform.messages import Messages, trajectory_of

Floats = NDArray[np.float64]

#: Message types of a bag that state poses.
_POSES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PoseStamped",
)
_DAY = 86400.0
#: Uncertainties of a coordinate, of the heading, of pitch and roll that are not stated.
UNKNOWN = (np.nan, np.nan, np.nan)


def trajectory_from_nmea(
    path: str | os.PathLike[str],
    *,
    crs: str,
    crs_offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    uncertainty: tuple[float, float, float] = UNKNOWN,
) -> Trajectory:
    """Read a trajectory from a log of NMEA 0183 sentences.

    Parameters
    ----------
    path : path-like
        Text file with one sentence per line.
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
        The trajectory, with Unix times. Poses have the times of the attitudes.

    Raises
    ------
    FormatError
        If the log lacks positions (GGA), dates (ZDA or RMC) or attitudes (PASHR), or no
        order of its messages is certain.
    MissingExtraError
        If the extra `platform` is not installed.

    Notes
    -----
    Sentences used: GGA (position), GST (its uncertainty), ZDA and RMC (date), and PASHR
    (true heading, pitch, roll and their uncertainties). Headings are converted to grid
    north. Positions are interpolated to the times of the attitudes by a cubic spline;
    an eighth of the second difference of positions is added to their uncertainty.
    Heights are above mean sea level, as GGA states them.

    Examples
    --------
    >>> from pathlib import Path
    >>> from amulor.io.navigation_logs import nmea_sentence, trajectory_from_nmea
    >>> lines = [nmea_sentence("GPZDA,102030.00,04,05,2026,00,00")]
    >>> for second in range(30, 34):
    ...     place = "4417.1000,N,00833.9000,E,4,12,0.8,-8.0,M,48.0,M,,"
    ...     lines.append(nmea_sentence(f"GPGGA,1020{second}.00,{place}"))
    ...     angles = "90.0,T,1.0,-2.0,0.0,0.05,0.05,0.1,2,1"
    ...     lines.append(nmea_sentence(f"PASHR,1020{second}.00,{angles}"))
    >>> size = Path("rov.nmea").write_text("".join(lines))
    >>> track = trajectory_from_nmea("rov.nmea", crs="EPSG:32632")
    >>> track.time.size, track.clock
    (4, 'unix')
    """
    path = Path(path)
    log = _NmeaLog(path)
    with reading(path), path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            log.take(number, line)
    return log.trajectory(crs, crs_offset, uncertainty)


def trajectory_from_sentences(
    sentences: Sequence[tuple[int, str]],
    *,
    source: Path,
    crs: str,
    crs_offset: tuple[float, float, float],
) -> Trajectory:
    """Return the trajectory of numbered NMEA sentences, as `trajectory_from_nmea`."""
    return _log_of(sentences, source).trajectory(crs, crs_offset)


def stamps_of_sentences(
    sentences: Sequence[tuple[int, str]],
) -> list[tuple[int, float]]:
    """Return number and Unix time [s] of each sentence with an attitude."""
    log = _log_of(sentences, Path())
    return [(n, row[0]) for n, row in zip(log.lines, log.attitudes, strict=True)]


def _log_of(sentences: Sequence[tuple[int, str]], source: Path) -> _NmeaLog:
    log = _NmeaLog(source)
    for number, sentence in sentences:
        log.take(number, sentence.encode("ascii", errors="replace"))
    return log


def nmea_sentence(content: str) -> str:
    r"""Return a sentence of NMEA 0183 with its checksum.

    Parameters
    ----------
    content : str
        Talker, type and fields, separated by commas.

    Returns
    -------
    str
        The sentence with dollar sign, checksum and line end.

    Examples
    --------
    >>> from amulor.io.navigation_logs import nmea_sentence
    >>> nmea_sentence("GPHDT,123.456,T")
    '$GPHDT,123.456,T*32\r\n'
    """
    return f"${content}*{_checksum(content):02X}\r\n"


def _checksum(content: str) -> int:
    return reduce(lambda a, b: a ^ b, content.encode(), 0)


@dataclass
class _NmeaLog:
    """Positions and attitudes gathered from the sentences of a log."""

    path: Path
    day: date | None = None
    fixes: list[list[float]] = field(default_factory=list)
    attitudes: list[list[float]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    broken: Counter[str] = field(default_factory=Counter)
    errors: dict[float, list[float]] = field(default_factory=dict)

    def take(self, number: int, line: bytes) -> None:
        """Read position, attitude or date from a log line; count broken lines."""
        text = line.decode("ascii", errors="replace").strip()
        if not text.startswith("$"):
            self.broken["line without a sentence"] += bool(text)
            return
        content, _, stated = text[1:].partition("*")
        try:
            if int(stated, 16) != _checksum(content):
                raise ValueError(stated)
            if content.startswith("PASHR,"):
                self._take_attitude(number, content.split(","))
            else:
                self._take_message(content.split(",")[0][2:], text)
        except ValueError:
            self.broken["sentence with a wrong checksum or field"] += 1

    def _take_message(self, kind: str, text: str) -> None:
        if kind not in ("GGA", "GST", "ZDA", "RMC"):
            return
        try:
            from pynmeagps import NMEAReader
            from pynmeagps.exceptions import NMEAParseError
        except ImportError:
            raise MissingExtraError(
                "pynmeagps", extra="platform", purpose="a log of NMEA 0183"
            ) from None
        try:
            message: Any = NMEAReader.parse(text.encode() + b"\r\n")
        except NMEAParseError as error:
            raise ValueError(str(error)) from None
        if kind == "ZDA":
            self.day = date(message.year, message.month, message.day)
        elif kind == "RMC" and message.date:
            self.day = message.date
        elif kind == "GST" and self.day is not None:
            spread = (message.stdLong, message.stdLat, message.stdAlt)
            self.errors[self._moment(message.time)] = [float(value) for value in spread]
        elif kind == "GGA" and self.day is not None and message.quality:
            place = (message.lat, message.lon, message.alt)
            self.fixes.append(
                [self._moment(message.time), *(float(value) for value in place)]
            )

    def _take_attitude(self, number: int, words: list[str]) -> None:
        if self.day is None:
            return
        clock = words[1]
        moment = self._moment(
            time(int(clock[:2]), int(clock[2:4]), int(clock[4:6]))
        ) + float("0" + clock[6:])
        heading, roll, pitch = (float(words[place]) for place in (2, 4, 5))
        sigma = [float(words[place]) if words[place:] and words[place] else np.nan
                 for place in (7, 8, 9)]  # fmt: skip
        self.attitudes.append([moment, heading, pitch, roll, *sigma])
        self.lines.append(number)

    def _moment(self, clock: time) -> float:
        """Return the Unix time of a time of day, across midnight [s]."""
        assert self.day is not None
        moment = datetime.combine(self.day, clock, tzinfo=UTC).timestamp()
        last = max((rows[-1][0] for rows in (self.fixes, self.attitudes) if rows),
                   default=moment)  # fmt: skip
        # The sentence with the new date may follow the first position of a day.
        return moment + _DAY * round((last - moment) / _DAY)

    def trajectory(
        self,
        crs: str,
        crs_offset: tuple[float, float, float],
        uncertainty: tuple[float, float, float] = UNKNOWN,
    ) -> Trajectory:
        """Return the trajectory of the log."""
        needed: dict[str, list[Any]] = {
            "date (ZDA or RMC)": [self.day] if self.day else [],
            "position (GGA) after a date": self.fixes,
            "attitude (PASHR) after a date": self.attitudes,
        }
        for what, rows in needed.items():
            if len(rows) < 2 - ("date (" in what):
                raise FormatError(
                    f"{self.path}: has no {what}; record it, or convert the log to a "
                    "table and state its columns"
                )
        fixes = np.array(self.fixes)
        sigma = np.array(
            [self.errors.get(moment, [np.nan] * 3) for moment in fixes[:, 0]]
        )
        remarks = [f"{count} x {text} left out" for text, count in self.broken.items()
                   if count]  # fmt: skip
        return trajectory_of_fixes(
            self.path,
            fixes,
            sigma,
            np.array(self.attitudes),
            crs=crs,
            crs_offset=crs_offset,
            uncertainty=uncertainty,
            remarks=remarks,
            place=lambda number: f"{self.path}, line {self.lines[number]}",
        )


def trajectory_of_fixes(
    path: Path,
    fixes: Floats,
    sigma: Floats,
    angles: Floats,
    *,
    crs: str,
    crs_offset: tuple[float, float, float],
    uncertainty: tuple[float, float, float],
    remarks: Sequence[str],
    place: Callable[[int], str],
) -> Trajectory:
    """Return the trajectory of geographic positions and attitudes of their own times.

    `fixes` are rows of Unix time, latitude, longitude, height; `sigma` is the
    uncertainty east, north and up. `angles` are rows of Unix time, heading, pitch and
    roll, with the uncertainties of roll, pitch and heading [deg]. `uncertainty` is that
    of a coordinate, of the heading and of the other angles, where these are NaN.
    """
    sigma = np.where(np.isnan(sigma), uncertainty[0], sigma)
    stated = np.degrees([uncertainty[2], uncertainty[2], uncertainty[1]])
    spreads = np.where(np.isnan(angles[:, 4:7]), stated, angles[:, 4:7])
    projection, convergence = projected(
        fixes[:, 1], fixes[:, 2], crs,
        place=lambda number: f"{path}, position {number + 1}",
    )  # fmt: skip
    places = np.column_stack([projection, fixes[:, 3]]) - np.array(crs_offset)
    position, spread = _resampled(fixes[:, 0], places, sigma, at=angles[:, 0])
    moments, turns_of_grid = _increasing(fixes[:, 0], convergence)
    north = np.interp(angles[:, 0], moments, turns_of_grid)
    turns = rotation_of(
        np.radians(angles[:, 1]) - north,
        np.radians(angles[:, 2]),
        np.radians(angles[:, 3]),
    )
    level = np.hypot(spreads[:, 0], spreads[:, 1]) / np.sqrt(2)
    outside = int((~np.isfinite(position).all(axis=1)).sum())
    if outside:
        remarks = [
            *remarks,
            f"{outside} attitudes before the first, after the last or far from any "
            "position",
        ]
    messages = Messages(
        time=angles[:, 0],
        position=position,
        attitude=quaternions_of(turns),
        covariance=covariance_of(
            turns, spread, np.radians(spreads[:, 2]), np.radians(level)
        ),
        clock="unix",
        crs=crs,
        crs_offset=crs_offset,
        remarks=tuple(remarks),
    )
    return trajectory_of(messages, source=str(path), place=place)


def _increasing(times: Floats, *values: Floats) -> tuple[Floats, ...]:
    """Return values in order of time; of equal times, only the first."""
    unique, first = np.unique(times, return_index=True)
    return unique, *(value[first] for value in values)


def _resampled(
    times: Floats, places: Floats, sigma: Floats, *, at: Floats
) -> tuple[Floats, Floats]:
    """Return positions, NaN in gaps, and their uncertainties at other times."""
    times, places, sigma = _increasing(times, places, sigma)
    position = CubicSpline(times, places)(at)
    after = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    step = times[after] - times[after - 1]
    near = (at >= times[0]) & (at <= times[-1])
    near &= step <= 5 * np.median(np.diff(times))
    position[~near] = np.nan
    bend = np.zeros_like(places)
    if len(places) > 2:
        bend[1:-1] = np.abs(np.diff(places, 2, axis=0)) / 8
    spread = np.hypot(np.maximum(sigma[after], sigma[after - 1]),
                      np.maximum(bend[after], bend[after - 1]))  # fmt: skip
    return position, spread


def trajectory_from_bag(
    path: str | os.PathLike[str], *, topic: str | None = None
) -> Trajectory:
    """Read a trajectory from a ROS 2 bag in the MCAP format.

    Parameters
    ----------
    path : path-like
        Bag (MCAP).
    topic : str, optional
        Topic of the poses; needed if several topics have poses.

    Returns
    -------
    Trajectory
        The trajectory, with the time stamps of the message headers.

    Raises
    ------
    FormatError
        If the file cannot be read, no topic or several topics have poses, or no order
        of the messages is certain.
    MissingExtraError
        If the extra `platform` is not installed.

    Notes
    -----
    Messages used: Odometry, PoseWithCovarianceStamped and PoseStamped. Axes follow REP
    103: a frame whose name ends in "_ned" has north, east, down, and its vehicle has
    forward, right, down; all other frames have east, north, up, and forward, left, up.
    A covariance of zeros, or one that begins with -1, is unknown.

    Examples
    --------
    >>> from amulor.errors import FormatError
    >>> from amulor.io.navigation_logs import trajectory_from_bag
    >>> try:
    ...     trajectory_from_bag("dive.mcap")
    ... except FormatError as error:
    ...     print(error)
    dive.mcap: cannot be read (No such file or directory); check name and folder
    """
    path = Path(path)
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError:
        raise MissingExtraError(
            "mcap-ros2-support",
            extra="platform",
            purpose="a bag of ROS 2",
        ) from None
    rows: dict[str, list[Any]] = {}
    with reading(path):
        size = path.stat().st_size
    try:
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            topics = None if topic is None else [topic]
            for schema, channel, _, message in reader.iter_decoded_messages(topics):
                if schema is not None and schema.name in _POSES:
                    rows.setdefault(channel.topic, []).append(message)
    # The reader seeks before the start of a file that is cut off.
    except (McapError, OSError, ValueError, KeyError, IndexError, EOFError) as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(
            f"{path}: is damaged, or no MCAP file ({reason}; {size} bytes); copy it "
            "again"
        ) from None
    if len(rows) != 1:
        wanted = f"of topic {topic}" if topic else "of any topic"
        found = f"poses are in the topics {', '.join(sorted(rows))}; state one"
        raise FormatError(
            f"{path}: {found}"
            if rows
            else f"{path}: holds no pose {wanted}; needed "
            "are messages of the types " + ", ".join(_POSES)
        )
    ((name, poses),) = rows.items()
    return trajectory_of(
        _messages_of(poses),
        source=str(path),
        place=lambda number: f"{path}, message {number + 1} of {name}",
    )


def _messages_of(poses: list[Any]) -> Messages:
    """Return the poses of decoded ROS messages in site axes."""
    frames = {str(message.header.frame_id) for message in poses}
    is_ned = {frame.endswith("_ned") for frame in frames}
    if len(is_ned) > 1:
        raise FormatError(
            f"the poses are in the frames {', '.join(sorted(frames))}, some of which "
            "point down; record one frame per topic"
        )
    stamped = [message.header.stamp for message in poses]
    outer = [message.pose for message in poses]
    inner = [pose.pose if hasattr(pose, "pose") else pose for pose in outer]
    place = np.array([[p.position.x, p.position.y, p.position.z] for p in inner])
    turn = np.array(
        [[p.orientation.x, p.orientation.y, p.orientation.z, p.orientation.w]
         for p in inner]
    )  # fmt: skip
    covariance = np.array(
        [np.reshape(p.covariance, (6, 6)) if hasattr(p, "covariance")
         else np.full((6, 6), np.nan) for p in outer]
    ).astype(float)  # fmt: skip
    unknown = (covariance[:, 0, 0] < 0) | (covariance == 0).all(axis=(1, 2))
    covariance[unknown] = np.nan
    axes = "FLU in ENU"
    if is_ned == {True}:
        axes = "FRD in NED"
        place = place @ FROM_NED.T
        both = np.kron(np.eye(2), FROM_NED)
        covariance = both @ covariance @ both.T
    return Messages(
        time=np.array([stamp.sec + 1e-9 * stamp.nanosec for stamp in stamped]),
        position=place,
        attitude=in_enu(turn, axes),
        covariance=covariance,
        clock="unix",
    )
