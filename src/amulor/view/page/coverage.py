"""Track and coverage of a running scan from a vehicle, for the browser page."""

from __future__ import annotations

import itertools
import time as clock_time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.acquisition import plan
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import Record
from amulor.acquisition.navigation import (
    RecordedTrajectory,
    line_steps,
    recorded_trajectory,
    speed_advice,
)
from amulor.acquisition.plan import Key
from amulor.errors import AmulorError
from amulor.optics import rays
from amulor.platform import instrument_poses
from amulor.survey import Survey
from amulor.survey.course import planned, planned_spacing, planned_track
from amulor.survey.directions import scan_directions

Floats = NDArray[np.float64]

#: Newest lines that determine the advice on speed [1].
_NEWEST = 10
#: Most columns of a footprint, lines and positions of the track in the picture [1].
_COLUMNS, _MOST_LINES, _MOST_PLACES = 12, 300, 400
#: Shortest time between two looks at the trajectory [s], and largest share of time [1].
_AGAIN, _SHARE = 1.0, 0.1
#: Vertical part of the mean beam, above which the picture is a plan [1].
_DOWNWARDS = 0.7


#: State of a scan of whose vehicle nothing is known.
_UNKNOWN: dict[str, Any] = {
    "lines": 0, "without_pose": 0, "between": None, "wanted": None, "speed": None,
    "planned_speed": None, "density": None, "wanted_density": None, "area": None,
    "plan": True, "track": [], "course": [], "footprint": [], "share": [],
}  # fmt: skip


class Coverage:
    """Track of the vehicle, and the lines of points that were measured from it."""

    def __init__(self, survey: Survey) -> None:
        self._survey = survey
        shape = (survey.scan.rows, survey.scan.columns)
        self._sum, self._count = np.zeros(shape), np.zeros(shape)
        azimuth, elevation, _ = scan_directions(survey)
        self._beams = rays.direction(azimuth, elevation)
        self._next = -np.inf
        self._seen: tuple[int, float] | None = None
        #: Number of the newest state [1].
        self.version = 0
        #: Newest state, for the page; empty before the first pose.
        self.state: dict[str, Any] = {}
        #: Advice on the speed of the newest lines.
        self.advice: list[str] = []

    def take(self, key: Key, record: Record) -> None:
        """Add the time of a reading of a pixel."""
        if key.kind == plan.SCAN and record.begin is not None:
            middle = record.begin + (record.duration or 0.0) / 2
            self._sum[key.row, key.column] += middle
            self._count[key.row, key.column] += 1

    def look(
        self, journal: Journal, ranges: Callable[[], Floats], *, version: int
    ) -> None:
        """Compute track and coverage again, if samples are new and time has passed.

        `ranges` returns the slant ranges so far, NaN where unknown [m]; `version` is
        the number of their computations.
        """
        begun = clock_time.monotonic()
        news = (version, float(self._count.sum()))
        if begun < self._next or news in (self._seen, (version, 0.0)):
            return
        self._seen = news
        try:
            recorded = recorded_trajectory(journal, self._survey)
        except AmulorError as error:
            recorded, self.state = None, {**_UNKNOWN, "remarks": [str(error)]}
        if recorded is not None:
            self._take_stock(recorded, ranges())
        self.version += 1
        now = clock_time.monotonic()
        self._next = now + max(_AGAIN, (now - begun) / _SHARE)

    def _take_stock(self, recorded: RecordedTrajectory, ranges: Floats) -> None:
        """Compute lines, densities and the picture from the trajectory so far."""
        time = np.divide(
            self._sum, self._count, out=np.full_like(self._sum, np.nan),
            where=self._count > 0,
        )  # fmt: skip
        (rows,) = np.nonzero(np.isfinite(time).any(axis=1))
        middle = np.nanmean(time[rows], axis=1)
        steps = line_steps(recorded, middle)
        self.advice = speed_advice(steps[-_NEWEST:], self._survey)
        known = recorded.known(time[rows])
        state = {
            **_UNKNOWN,
            "lines": int(rows.size),
            "without_pose": int((~known & (time[rows] < _end(recorded))).sum()),
            "remarks": list(recorded.lines),
            "between": _median(steps[-_NEWEST:]),
            "wanted": planned_spacing(self._survey, 0.0)[0],
        }
        if recorded.trajectory is not None and known.any():
            state |= self._picture(recorded, rows, time[rows], ranges[rows])
        self.state = state

    def _picture(
        self, recorded: RecordedTrajectory, rows: NDArray[np.intp], time: Floats,
        ranges: Floats,
    ) -> dict[str, Any]:  # fmt: skip
        """Return speed, densities, and the lines in the plane of the picture [m]."""
        track, mounting = recorded.trajectory, recorded.mounting
        assert track is not None
        columns, edges = _thinned(time.shape[1])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # blocks without a range
            distance = np.stack(
                [np.nanmedian(ranges[:, a:b], axis=1) for a, b in edges], axis=1
            )
            middle = float(np.nanmedian(ranges))
        at = recorded.origin + time[:, columns]
        beams = self._beams[np.ix_(rows, columns)]
        poses = instrument_poses(track, mounting, np.nan_to_num(at, nan=-1.0).ravel())
        local = (distance[..., None] * beams).reshape(-1, 3)
        points = poses.place(local).reshape(*at.shape, 3)
        points[~np.isfinite(at)] = np.nan
        axes, plan_view = _plane(poses.turn(beams.reshape(-1, 3)))
        flat = points @ axes.T
        area, count = _areas(flat, columns)
        across, along = planned_spacing(self._survey, middle)
        wanted = 1 / (across * along) if across * along > 0 else np.nan
        with np.errstate(invalid="ignore", divide="ignore"):
            density = np.where(area > 0, count / area, np.nan)
        newest = float(np.nanmax(time))
        begin = recorded.origin + float(np.nanmin(time))
        instants = np.linspace(begin, recorded.origin + newest, _MOST_PLACES)
        path = instrument_poses(track, mounting, instants)
        speed = np.linalg.norm(path.velocity, axis=1)
        duration = planned_track(self._survey)[1]
        assert self._survey.platform is not None
        course, _ = planned(
            self._survey.platform.course, np.linspace(0.0, duration, _MOST_PLACES)
        )
        every = max(1, -(-len(rows) // _MOST_LINES))
        shown = range(0, len(rows), every)
        share = np.append(density, density[-1:]) / wanted
        return {
            "plan": plan_view,
            "track": _listed(path.position @ axes.T),
            "course": _listed(course @ axes.T),
            "footprint": [_listed(flat[row]) for row in shown],
            "share": [_number(share[row]) for row in shown],
            "speed": _number(_last(speed)),
            "planned_speed": planned_track(self._survey)[0] / duration,
            "density": _median(density[np.isfinite(density)][-_NEWEST:]),
            "wanted_density": _number(wanted),
            "area": _number(np.nansum(area)),
        }


def _end(recorded: RecordedTrajectory) -> float:
    """Return the time of the newest pose, before which poses are missing [s]."""
    if recorded.trajectory is None:
        return np.inf
    offset = recorded.mounting.clock_offset
    return float(recorded.trajectory.time[-1] - offset - recorded.origin)


def _thinned(count: int) -> tuple[NDArray[np.intp], list[tuple[int, int]]]:
    """Return columns of a footprint, and the columns whose ranges each stands for."""
    columns = np.unique(np.linspace(0, count - 1, _COLUMNS).round().astype(np.intp))
    borders = [0, *((columns[1:] + columns[:-1]) // 2 + 1).tolist(), count]
    return columns, list(itertools.pairwise(borders))


def _plane(beams: Floats) -> tuple[Floats, bool]:
    """Return both axes of the picture, and whether it is a plan.

    A plan has east to the right and north up. Beams to the side give an elevation,
    whose horizontal axis points to the right of the mean beam.
    """
    mean = np.nanmean(beams, axis=0)
    if abs(mean[2]) > _DOWNWARDS * np.linalg.norm(mean):
        return np.eye(3)[:2], True
    right = np.array([mean[1], -mean[0], 0.0])
    return np.stack([right / np.linalg.norm(right), [0.0, 0.0, 1.0]]), False


def _areas(flat: Floats, columns: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Return area between each line and the next [m^2], and number of points in it."""
    across = np.diff(flat[:-1], axis=1)
    forward = np.diff(flat, axis=0)[:, :-1]
    area = np.abs(across[..., 0] * forward[..., 1] - across[..., 1] * forward[..., 0])
    good = np.isfinite(area)
    points = np.where(good, np.diff(columns), 0)
    return np.where(good, area, 0.0).sum(axis=1), points.sum(axis=1).astype(float)


def _last(values: Floats) -> float:
    """Return the last finite value."""
    finite = values[np.isfinite(values)]
    return float(finite[-1]) if finite.size else float("nan")


def _median(values: Floats) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else None


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _listed(places: Floats) -> list[list[float] | None]:
    """Return places for JSON to a millimeter, with None for unknown ones."""
    return [
        [round(float(x), 4) for x in place] if np.isfinite(place).all() else None
        for place in places
    ]
