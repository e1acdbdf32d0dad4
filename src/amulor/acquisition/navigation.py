"""Trajectory of the vehicle from the navigation messages in a journal."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.acquisition.cube.samples import entry, identities_of, procedure_of
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.settings.parts import PoseFrame
from amulor.errors import FormatError, SurveyError
from amulor.io import navigation_logs
from amulor.platform import Mounting, Trajectory, instrument_poses
from amulor.platform.arrivals import without_steps
from amulor.platform.messages import messages_of, trajectory_of
from amulor.survey import Survey
from amulor.survey.course import planned_spacing
from amulor.survey.scan import Pose

Floats = NDArray[np.float64]

#: Distance of lines over the planned one, above which a vehicle is too fast [1].
_TOO_FAR = 1.2


@dataclass(frozen=True, kw_only=True)
class RecordedTrajectory:
    """Trajectory of the vehicle that a scan recorded."""

    trajectory: Trajectory | None
    """Trajectory; None if the messages determine none."""
    mounting: Mounting
    """Mounting of the survey."""
    origin: float
    """Start of the scan by the clock of the trajectory, without clock offset [s]."""
    lines: tuple[str, ...]
    """Irregularities of the messages, a line of text each."""

    def known(self, time: Floats) -> NDArray[np.bool_]:
        """Return whether there is a pose at times of the scan [s]."""
        if self.trajectory is None:
            return np.zeros(time.shape, dtype=bool)
        result = np.zeros(time.size, dtype=bool)
        (finite,) = np.nonzero(np.isfinite(time.ravel()))
        if finite.size:
            at = self.origin + time.ravel()[finite]
            poses = instrument_poses(self.trajectory, self.mounting, at)
            result[finite] = poses.known
        return result.reshape(time.shape)


def line_steps(recorded: RecordedTrajectory, time: Floats) -> Floats:
    """Return distances of the instrument from line to line, NaN if unknown [m].

    `time` has the middle of each line by the clock of the scan [s].
    """
    if recorded.trajectory is None:
        return np.full(max(time.size - 1, 0), np.nan)
    poses = instrument_poses(
        recorded.trajectory, recorded.mounting, recorded.origin + time
    )
    return np.asarray(np.linalg.norm(np.diff(poses.position, axis=0), axis=1))


def speed_advice(steps: Floats, survey: Survey) -> list[str]:
    """Describe lines that are farther apart than planned, from `line_steps`."""
    steps = steps[np.isfinite(steps)]
    wanted = planned_spacing(survey, 0.0)[0]
    if not steps.size or wanted == 0 or np.median(steps) <= _TOO_FAR * wanted:
        return []
    between = float(np.median(steps))
    return [
        f"too fast: {1e3 * between:.3g} mm between lines, {1e3 * wanted:.3g} wanted; "
        f"drive {between / wanted:.2g} times slower, or plan shorter rows"
    ]


def middle_times(time: Floats) -> Floats:
    """Return the middle of each row that has readings, in order [s].

    `time` has the times of the readings by frequency, channel, row and column [s].
    """
    rows = [row[np.isfinite(row)] for row in np.moveaxis(time, 2, 0)]
    return np.array([row.mean() for row in rows if row.size])


def recorded_trajectory(journal: Journal, survey: Survey) -> RecordedTrajectory | None:
    """Return the trajectory in a journal; None for a scan without navigation."""
    if survey.platform is None or "navigation" not in identities_of(journal):
        return None
    driver, frame = _source(journal, survey)
    messages = journal.messages()
    origin = 0.0
    parts = journal.segments()
    if frame.clock == "unix" and parts:
        origin = datetime.fromisoformat(parts[0]["started"]).timestamp()
    mounting = survey.platform.mounting
    stamps = _stamps(messages, driver)
    numbers = [number for number, _, _ in stamps]
    times, arrivals = (np.array([row[i] for row in stamps]) for i in (1, 2))
    steady, lines = without_steps(times, arrivals, origin=origin, mounting=mounting)
    track = None
    try:
        used = _within(messages, numbers, steady)
        track = _trajectory(used, driver, frame, journal.folder)
        lines += [f"navigation: {remark}" for remark in track.remarks]
        instrument_poses(track, mounting, [origin])
    except (FormatError, SurveyError) as error:
        track = None
        lines.append(f"navigation: no trajectory: {error}")
    return RecordedTrajectory(
        trajectory=track, mounting=mounting, origin=origin, lines=tuple(lines)
    )


def _source(journal: Journal, survey: Survey) -> tuple[str, PoseFrame]:
    """Return driver and frame of the described source, or of a simulated vehicle."""
    procedure_of(journal)  # refuses a damaged devices file
    devices = tomllib.loads(entry(journal, "devices"))
    part: dict[str, Any] | None = devices.get("navigation")
    if part is not None:
        # Only the frame: a package with the driver may be missing now.
        content = {name: part[name] for name in PoseFrame.model_fields if name in part}
        frame = PoseFrame.model_validate(content, context={"from_text": True})
        return str(part["driver"]), frame
    pose = survey.pose or Pose()
    return "simulated", PoseFrame(
        clock="relative", crs=pose.crs, crs_offset=pose.crs_offset
    )


def _stamps(
    messages: Sequence[tuple[int, float, str]], driver: str
) -> list[tuple[int, float, float]]:
    """Return index, time stamp [s] and arrival [s] of the messages with a stamp."""
    if driver == "nmea":
        sentences = [(index, line) for index, (_, _, line) in enumerate(messages)]
        stamped = navigation_logs.stamps_of_sentences(sentences)
    else:
        lines = [line for _, _, line in messages]
        poses = messages_of(lines, clock="relative", crs="", crs_offset=(0.0, 0.0, 0.0))
        stamped = [*enumerate(poses.time.tolist())]
    return [
        (index, stamp, messages[index][1])
        for index, stamp in stamped
        if np.isfinite(stamp)
    ]


def _within(
    messages: Sequence[tuple[int, float, str]],
    numbers: Sequence[int],
    steady: NDArray[np.bool_],
) -> list[tuple[int, str]]:
    """Return number and line of the messages on the steady clock.

    Sentences without a stamp need a steady stamp before and after them.
    """
    if not numbers:
        return [(number, line) for number, _, line in messages]
    index, last = np.arange(len(messages)), len(numbers) - 1
    after = np.minimum(np.searchsorted(numbers, index, side="left"), last)
    before = np.maximum(np.searchsorted(numbers, index, side="right") - 1, 0)
    good = steady[after] & steady[before]
    return [
        (number, line)
        for (number, _, line), is_good in zip(messages, good, strict=True)
        if is_good
    ]


def _trajectory(
    messages: Sequence[tuple[int, str]], driver: str, frame: PoseFrame, folder: Path
) -> Trajectory:
    """Return the trajectory of the messages, numbered as in the journal."""
    if driver == "nmea":
        return navigation_logs.trajectory_from_sentences(
            messages,
            source=folder / FILE_NAME,
            crs=frame.crs,
            crs_offset=frame.crs_offset,
        )
    # On a steady clock, the order of arrival is no more than that of the link.
    messages = sorted(messages, key=lambda message: _time_of(message[1]))
    return trajectory_of(
        messages_of(
            [line for _, line in messages],
            clock=frame.clock,
            crs=frame.crs,
            crs_offset=frame.crs_offset,
        ),
        source=str(folder / FILE_NAME),
        place=lambda index: f"message {messages[index][0]}",
    )


def _time_of(line: str) -> float:
    """Return the time stamp of a pose; infinite if it has none [s]."""
    try:
        time = float(line.partition(",")[0])
    except ValueError:
        return np.inf
    return time if np.isfinite(time) else np.inf
