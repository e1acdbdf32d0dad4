"""Pose messages in order of arrival, checked and sorted into a trajectory."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation

from amulor.errors import FormatError
from amulor.platform.attitude import turn_between
from amulor.platform.trajectory import Trajectory, usual_gap

Floats = NDArray[np.float64]

#: Columns of a pose in a line of text, before those of its covariance.
POSE = ("time", "east", "north", "up", "qx", "qy", "qz", "qw")
#: Elements of the covariance of a pose in a line of text.
UPPER = np.triu_indices(6)

#: Messages in a row that may arrive late; more mean that a clock stepped back.
_LATE = 20
#: Turn between consecutive poses that no vehicle makes [rad].
_JUMP = 2.0
#: Speed in an interval over speed beside it, below which a clock may have stepped [1].
_SLOW = 0.7
#: Length of an interval in which a clock may have stepped, in median intervals [1].
_LONG = 1.5
#: Intervals that state the speed beside an interval [1].
_NEAR = 11
#: Departure from neighbors of an outlying position, in median departures [1].
_JUMPS = 8.0
#: Departure beyond rounding errors of coordinates [m].
_LEAST_JUMP = 1e-6
#: Tolerated deviation of the norm of a quaternion from 1 [1].
_NORM = 0.02


@dataclass(frozen=True, kw_only=True)
class Messages:
    """Pose messages in the order of their arrival."""

    time: Floats
    """Time stamps, shape (n,) [s]."""
    position: Floats
    """East, north, up, shape (n, 3) [m]."""
    attitude: Floats
    """Quaternions (x, y, z, w) from vehicle axes (right, down, forward) to (east,
    north, up), shape (n, 4) [1]."""
    covariance: Floats
    """Covariance of position and rotation about site axes, NaN where unknown, shape
    (n, 6, 6) [m^2, m rad, rad^2]."""
    clock: Literal["unix", "relative"]
    """Origin of the time stamps."""
    crs: str = ""
    """Coordinate reference system; none if empty."""
    crs_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Offset of the positions in the reference system [m]."""
    remarks: tuple[str, ...] = ()
    """Remarks of the reader."""


def pose_line(
    *, time: float, position: ArrayLike, attitude: ArrayLike, covariance: ArrayLike
) -> str:
    """Return a pose as a line of text, for a source of poses.

    Parameters
    ----------
    time : float
        Time stamp [s].
    position : array_like, shape (3,)
        East, north, up [m].
    attitude : array_like, shape (4,)
        Quaternion (x, y, z, w) from vehicle axes (right, down, forward) to (east,
        north, up) [1].
    covariance : array_like, shape (6, 6)
        Covariance of position [m] and rotation about site axes [rad]; NaN if unknown.

    Returns
    -------
    str
        Time, position, quaternion and the upper triangle of the covariance row by row,
        separated by commas.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor.platform import pose_line
    >>> line = pose_line(
    ...     time=0.5,
    ...     position=[0, 1, -8],
    ...     attitude=[0, 0, 0, 1],
    ...     covariance=np.full((6, 6), np.nan),
    ... )
    >>> line[:23]
    '0.5,0,1,-8,0,0,0,1,nan,'
    """
    upper = np.asarray(covariance, dtype=float)[UPPER]
    values = [time, *np.ravel(position), *np.ravel(attitude), *upper]
    return ",".join([f"{value:.17g}" for value in values])


def messages_of(
    lines: Sequence[str],
    *,
    clock: Literal["unix", "relative"],
    crs: str,
    crs_offset: tuple[float, float, float],
) -> Messages:
    """Return the poses of lines from `pose_line`; a wrong line is a pose of NaN."""
    count = len(POSE) + len(UPPER[0])
    table = np.full((len(lines), count), np.nan)
    for number, line in enumerate(lines):
        words = line.split(",")
        with contextlib.suppress(ValueError):
            if len(words) == count:
                table[number] = [float(word) for word in words]
    covariance = np.zeros((len(lines), 6, 6))
    covariance[:, *UPPER] = table[:, len(POSE) :]
    covariance[:, *UPPER[::-1]] = table[:, len(POSE) :]
    return Messages(
        time=table[:, 0],
        position=table[:, 1:4],
        attitude=table[:, 4:8],
        covariance=covariance,
        clock=clock,
        crs=crs,
        crs_offset=crs_offset,
    )


def trajectory_of(
    messages: Messages,
    *,
    source: str,
    place: Callable[[int], str],
    longest_gap: float | None = None,
) -> Trajectory:
    """Return the trajectory of pose messages; FormatError if they are inconsistent.

    `place` names the location of a message in its file. Late messages are sorted,
    repeated ones are dropped, and both are counted in the remarks.
    """
    remarks = [*messages.remarks]
    complete = (
        np.isfinite(messages.time)
        & np.isfinite(messages.position).all(axis=1)
        & np.isfinite(messages.attitude).all(axis=1)
    )
    (used,) = np.nonzero(complete)
    if used.size < complete.size:
        first = place(int(np.argmin(complete)))
        remarks.append(
            f"{_counted(complete.size - used.size, 'message')} without time, position "
            f"or attitude left out; the first is {first}"
        )
    if used.size < 2:
        raise FormatError(
            f"{source}: holds {_counted(used.size, 'complete pose')}; needed are 2 or "
            "more; check the columns or the topic"
        )
    _refuse_wrong_norms(messages.attitude[used], used, place)
    time = messages.time[used]
    late = time < np.maximum.accumulate(time)
    _refuse_steps_back(time, late, used, place)
    if late.any():
        worst = float((np.maximum.accumulate(time) - time).max())
        remarks.append(
            f"{_counted(int(late.sum()), 'message')} up to {worst:.3g} s late, sorted "
            f"by time stamp; the first is {place(int(used[np.argmax(late)]))}"
        )
    order = used[np.argsort(time, kind="stable")]
    order, repeated = _without_repeats(messages, order, place)
    if repeated:
        remarks.append(f"{_counted(repeated, 'repeated message')} left out")
    if order.size < 2:
        raise FormatError(
            f"{source}: holds one pose only, repeated; needed are 2 or more"
        )
    track = Trajectory(
        time=messages.time[order],
        position=messages.position[order],
        attitude=_unit(messages.attitude[order]),
        covariance=messages.covariance[order],
        longest_gap=longest_gap or usual_gap(messages.time[order]),
        clock=messages.clock,
        crs=messages.crs,
        crs_offset=messages.crs_offset,
    )
    _refuse_jumps(track, order, place)
    remarks += _remarks_on_gaps(track, order, place)
    remarks += _remarks_on_speed(track, order, place)
    remarks += _remarks_on_jumps(track, order, place)
    if not np.isfinite(track.covariance).all():
        remarks.append("the uncertainty of the poses is not stated, or in part only")
    return replace(track, remarks=tuple(remarks))


def _refuse_wrong_norms(
    quaternions: Floats, used: NDArray[np.intp], place: Callable[[int], str]
) -> None:
    wrong = np.abs(np.linalg.norm(quaternions, axis=1) - 1) > _NORM
    if wrong.any():
        number = int(np.argmax(wrong))
        raise FormatError(
            f"{place(int(used[number]))}: the attitude is a quaternion with norm "
            f"{np.linalg.norm(quaternions[number]):.3g}, needed is 1; check the order "
            "of its columns"
        )


def _refuse_steps_back(
    time: Floats,
    late: NDArray[np.bool_],
    used: NDArray[np.intp],
    place: Callable[[int], str],
) -> None:
    """Raise if the clock steps back: late messages in long runs or at times of others.

    Messages that were only delayed fall into the gap that they left.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], late.astype(int), [0]])))
    usual = np.median(np.diff(time[~late])) if (~late).sum() > 1 else 0.0
    for begin, end in edges.reshape(-1, 2):
        others = np.sort(np.delete(time, np.arange(begin, end)))
        after = np.clip(np.searchsorted(others, time[begin:end]), 1, others.size - 1)
        away = np.minimum(
            np.abs(time[begin:end] - others[after - 1]),
            np.abs(time[begin:end] - others[after]),
        )
        taken = np.count_nonzero(away < usual / 2)
        if end - begin > _LATE or taken > max(1, (end - begin) / 2):
            step = float(time[begin - 1] - time[begin])
            raise FormatError(
                f"{place(int(used[begin]))}: the clock steps back by {step:.4g} s; "
                "split the file there, or correct its time stamps"
            )


def _without_repeats(
    messages: Messages, order: NDArray[np.intp], place: Callable[[int], str]
) -> tuple[NDArray[np.intp], int]:
    """Return the order without repeated messages, and the number of repeats."""
    again = np.flatnonzero(np.diff(messages.time[order]) == 0) + 1
    for number in again:
        one, other = order[number - 1], order[number]
        if not (
            np.array_equal(messages.position[one], messages.position[other])
            and np.array_equal(messages.attitude[one], messages.attitude[other])
        ):
            raise FormatError(
                f"{place(int(other))}: has the time stamp of {place(int(one))} but "
                "another pose; are these the poses of two vehicles?"
            )
    return np.delete(order, again), int(again.size)


def _refuse_jumps(
    track: Trajectory, order: NDArray[np.intp], place: Callable[[int], str]
) -> None:
    """Raise if the attitude jumps between poses, as with wrongly converted axes."""
    turns = Rotation.from_quat(track.attitude)
    angle = np.linalg.norm(turn_between(turns[:-1], turns[1:]), axis=1)
    near = np.diff(track.time) <= track.longest_gap
    if (near & (angle > _JUMP)).any():
        number = int(np.argmax(near * angle))
        raise FormatError(
            f"{place(int(order[number + 1]))}: the attitude jumps by "
            f"{np.degrees(angle[number]):.0f} deg within "
            f"{track.time[number + 1] - track.time[number]:.3g} s; correct the axes of "
            "the sensor, or leave these messages out"
        )


def _remarks_on_gaps(
    track: Trajectory, order: NDArray[np.intp], place: Callable[[int], str]
) -> list[str]:
    """Describe the number of gaps without poses, and the longest gap."""
    steps = np.diff(track.time)
    (gaps,) = np.nonzero(steps > track.longest_gap)
    if not gaps.size:
        return []
    longest = int(gaps[np.argmax(steps[gaps])])
    return [
        f"{_counted(gaps.size, 'gap')} longer than {track.longest_gap:.3g} s without "
        f"poses; the longest, {steps[longest]:.4g} s, ends at "
        f"{place(int(order[longest + 1]))}"
    ]


def _remarks_on_speed(
    track: Trajectory, order: NDArray[np.intp], place: Callable[[int], str]
) -> list[str]:
    """Describe long intervals in which the speed differs from neighboring intervals."""
    steps = np.diff(track.time)
    moved = np.linalg.norm(np.diff(track.position, axis=0), axis=1)
    beside = steps * median_filter(moved / steps, _NEAR, mode="nearest")
    unlike = (moved < _SLOW * beside) | (_SLOW * moved > beside)
    (where,) = np.nonzero(unlike & (steps > _LONG * np.median(steps)))
    if not where.size:
        return []
    return [
        f"the speed changes in {_counted(where.size, 'long interval')}, first before "
        f"{place(int(order[where[0] + 1]))}: did the clock step?"
    ]


def _remarks_on_jumps(
    track: Trajectory, order: NDArray[np.intp], place: Callable[[int], str]
) -> list[str]:
    """Describe positions that depart from those of their neighbors."""
    away = np.linalg.norm(track.departures[:, :3], axis=1)
    if not np.isfinite(away).any():
        return []
    sigma = np.sqrt(np.einsum("nii->ni", track.covariance)[:, :3].max(axis=1))
    limit = _LEAST_JUMP + _JUMPS * np.nanmedian(away) + 3 * np.nan_to_num(sigma)
    (jumps,) = np.nonzero(away > limit)
    if not jumps.size:
        return []
    worst = int(jumps[np.argmax(away[jumps])])
    return [
        f"positions depart from their neighbors in {_counted(jumps.size, 'pose')}, by "
        f"up to {away[worst]:.3g} m at {place(int(order[worst]))}: is it an outlier, "
        "or did the clock step?"
    ]


def _unit(quaternions: Floats) -> Floats:
    return np.asarray(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))


def _counted(count: int, name: str) -> str:
    return f"{count} {name}" + ("" if count == 1 else "s")
