"""Continuous mode: the lock-in records while the beam moves along a row."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from numpy.typing import NDArray

from amulor.acquisition.clock import Clock, Deadline
from amulor.acquisition.dwell import Dwell, refuse_lacking
from amulor.acquisition.plan import Step
from amulor.acquisition.protocols import (
    LockIn,
    Overload,
    Recorded,
    Scanner,
    StreamingLockIn,
    SweepingScanner,
)
from amulor.acquisition.settings import Procedure
from amulor.acquisition.uncertainty import edge_error, filtered_input
from amulor.errors import InstrumentError, SurveyError
from amulor.survey import Survey

Floats = NDArray[np.float64]

#: Default time before the first pixel and after the last one [s].
RUN_UP = 10e-3
#: Fewest readings of the scanner in a row, and in the fit of its motion.
_LOOKS, _KNOWN_BY = 8, 3
#: Largest relative difference of actual and commanded rate of the beam [1].
_RATE = 0.2
#: Wait before the last points are queried again, as a fraction of a dwell [1].
_AGAIN = 0.05


@dataclass(frozen=True, kw_only=True)
class Swept:
    """Measured dwell and direction of one pixel of a row."""

    dwell: Dwell
    """Signals, mean output and lock-in state of the pixel."""
    azimuth: float
    """Mean azimuth of the beam over the dwell [rad]."""
    elevation: float
    """Mean elevation of the beam over the dwell [rad]."""
    begin: float
    """Start of the dwell by the clock of the scan [s]."""
    off: float
    """Largest deviation of the scanner from a steady motion, over this pixel and its
    neighbors [rad]."""


@dataclass
class _Row:
    """Readings of lock-in and scanner along one row."""

    times: list[Floats] = field(default_factory=list)
    signals: list[NDArray[np.complex128]] = field(default_factory=list)
    fetched: list[float] = field(default_factory=list)
    """Times at which the lock-in was read [s]."""
    states: list[Recorded] = field(default_factory=list)
    located: list[float] = field(default_factory=list)
    """Times at which the scanner was read [s]."""
    azimuth: list[float] = field(default_factory=list)
    elevation: list[float] = field(default_factory=list)

    def last_point(self) -> float:
        """Return the time of the newest reading [s]."""
        return max((float(part[-1]) for part in self.times if part.size), default=-1e99)


@dataclass(frozen=True)
class _Motion:
    """Steady motion of the beam, fitted to readings of the scanner."""

    begin: float
    rate: float
    off: Floats
    """Deviation of each scanner reading from the fit, in order of time [rad]."""

    def at(self, time: float) -> float:
        return self.begin + self.rate * time

    def when(self, azimuth: float) -> float:
        return (azimuth - self.begin) / self.rate


def pitch_of(survey: Survey) -> float:
    """Return the angle between adjacent columns [rad]; raise for a single column."""
    scan = survey.scan
    if scan.columns < 2 or scan.azimuth_span == 0:
        raise SurveyError(
            f"scan.columns = {scan.columns} and scan.azimuth_span = "
            f"{scan.azimuth_span:g} rad leave no way to move along a row; plan more "
            'columns, or take procedure.mode = "continuous" out of the devices file'
        )
    return scan.azimuth_span / (scan.columns - 1)


class SweepReader:
    r"""Acquisition of whole rows while the beam moves (continuous mode).

    The beam moves by one column during one dwell, so that a sample is the mean over its
    pixel. The lock-in records without gaps. A straight line fitted to readings of the
    scanner assigns an equal number of points to each pixel. A sample has the direction
    of the middle of its points. The output of the filter at the start of a pixel is
    subtracted (`amulor.acquisition.uncertainty.filtered_input`). Light of one pixel
    thus does not enter the next, and the noise of neighbors is independent. The error
    due to an edge of the scene within one interval is a separate term
    (`amulor.acquisition.uncertainty.edge_error`).
    """

    def __init__(
        self,
        survey: Survey,
        procedure: Procedure,
        lock_in: LockIn,
        scanner: Scanner,
        clock: Clock,
    ) -> None:
        setting = 'procedure.mode = "continuous"'
        refuse_lacking(lock_in, setting, "begin_stream", "fetch")
        refuse_lacking(scanner, setting, "begin_sweep", "where")
        self._lock_in = cast(StreamingLockIn, lock_in)
        self._scanner = cast(SweepingScanner, scanner)
        self._clock = clock
        self._constant = survey.instrument.lock_in.time_constant
        self._dwell = survey.scan.dwell
        self._pitch = pitch_of(survey)
        self._run_up = RUN_UP if procedure.run_up is None else procedure.run_up

    def start_of(self, steps: Sequence[Step]) -> float:
        """Return the azimuth at which the motion along a row starts [rad]."""
        return self._ends(steps)[0]

    def take(
        self, steps: Sequence[Step], *, timeout: float, watch: Callable[[], None]
    ) -> list[Swept]:
        """Move along neighboring pixels, and return the dwell of each."""
        start, end = self._ends(steps)
        duration = len(steps) * self._dwell + 2 * self._run_up
        self._lock_in.begin_stream(duration + timeout)
        self._lock_in.fetch()  # clears status bits of the move
        row = _Row()
        self._scanner.begin_sweep(end, steps[0].elevation, duration=duration)
        begun = self._clock.now()
        limit = Deadline(self._clock, duration + timeout)
        gap = min(self._dwell, duration / _LOOKS)
        last_edge = end - math.copysign(self._run_up / self._dwell, end - start) * (
            self._pitch
        )
        planned = begun + self._run_up
        while True:
            self._look(row)
            watch()
            motion = self._motion(row, steps)
            if motion is not None and row.last_point() >= motion.when(last_edge):
                return self._pixels(row, steps, motion)
            if limit.passed():
                raise InstrumentError(
                    f"the scanner has not come along row {steps[0].key.row} within "
                    f"{duration + timeout:g} s; see what holds it"
                )
            now = self._clock.now()
            if motion is not None:
                planned = motion.when(last_edge) - len(steps) * self._dwell
            last_end = planned + len(steps) * self._dwell
            passed = max(now - planned, -gap) / gap
            following = planned + gap * (math.floor(passed + 1e-6) + 1)
            again = now + _AGAIN * self._dwell
            self._clock.sleep(
                (again if now >= last_end else min(following, last_end)) - now
            )

    def _ends(self, steps: Sequence[Step]) -> tuple[float, float]:
        first, last = steps[0].azimuth, steps[-1].azimuth
        margin = math.copysign(
            self._pitch * (0.5 + self._run_up / self._dwell), last - first
        )
        return first - margin, last + margin

    def _look(self, row: _Row) -> None:
        """Append readings of lock-in and scanner to the record of a row."""
        before = self._clock.now()
        recorded = self._lock_in.fetch()
        between = self._clock.now()
        azimuth, elevation = self._scanner.where()
        row.fetched.append((before + between) / 2)
        row.states.append(recorded)
        row.times.append(recorded.times)
        row.signals.append(recorded.signals)
        row.located.append((between + self._clock.now()) / 2)
        row.azimuth.append(azimuth)
        row.elevation.append(elevation)

    def _motion(self, row: _Row, steps: Sequence[Step]) -> _Motion | None:
        """Fit the steady motion along the pixels; None with too few readings."""
        first, last = sorted((steps[0].azimuth, steps[-1].azimuth))
        azimuth = np.array(row.azimuth)
        near = 0.5 * self._pitch * (1 + min(self._run_up / self._dwell, 1.0))
        among = (azimuth > first - near) & (azimuth < last + near)
        if among.sum() < _KNOWN_BY:
            return None
        located = np.array(row.located)
        rate, begin = np.polyfit(located[among] - located[0], azimuth[among], 1)
        begin -= rate * located[0]
        commanded = math.copysign(
            self._pitch / self._dwell, self._ends(steps)[1] - self._ends(steps)[0]
        )
        if not abs(rate - commanded) <= _RATE * abs(commanded):
            raise InstrumentError(
                f"the scanner moves by {rate:.4g} rad/s along row {steps[0].key.row} "
                f"and was asked for {commanded:.4g}; take a longer dwell, or a longer "
                "procedure.run_up"
            )
        off = np.where(among, np.abs(azimuth - begin - rate * located), 0.0)
        return _Motion(float(begin), float(rate), off)

    def _pixels(self, row: _Row, steps: Sequence[Step], motion: _Motion) -> list[Swept]:
        signals = np.concatenate(row.signals)
        times, interval = self._even(np.concatenate(row.times))
        elevation = float(np.mean(row.elevation))
        forwards = math.copysign(0.5 * self._pitch, motion.rate)
        # The same number of points for each pixel, so that all are equally wide.
        count = max(round(abs(self._pitch / motion.rate) / interval), 1)
        result = []
        for step in steps:
            edge = motion.when(step.azimuth - forwards) - times[0]
            first = round(edge / interval)
            if first < 0 or first + count >= times.size:
                raise InstrumentError(
                    f"the record does not reach over column {step.key.column} of row "
                    f"{step.key.row}: the scanner was there before the lock-in; take a "
                    "longer procedure.run_up"
                )
            part = slice(first, first + count + 1)
            begin, end = float(times[part][0]), float(times[part][-1])
            dwell = self._dwell_of(row, times[part], signals[part], interval)
            near = np.abs(np.array(row.located) - (begin + end) / 2) <= self._dwell
            result.append(
                Swept(
                    dwell=dwell,
                    azimuth=motion.at((begin + end) / 2),
                    elevation=elevation,
                    begin=begin,
                    off=float(np.max(motion.off[near], initial=0.0)),
                )
            )
        return result

    def _even(self, times: Floats) -> tuple[Floats, float]:
        """Fit equal time steps to all readings; return times and step [s].

        The spacing is that of the instrument; the start is as accurate as one reading.
        """
        interval = float(np.median(np.diff(times)))
        even = interval * np.arange(times.size)
        start = float(np.median(times - even))
        if np.abs(times - start - even).max() > self._dwell / 4:
            raise InstrumentError(
                "the lock-in has not recorded without a gap while the beam moved; take "
                'procedure.mode = "continuous" out of the devices file'
            )
        return np.asarray(start + even, dtype=float), interval

    def _dwell_of(
        self,
        row: _Row,
        times: Floats,
        signals: NDArray[np.complex128],
        interval: float,
    ) -> Dwell:
        begin, end = times[0], times[-1]
        overload, unlocked = Overload.NONE, False
        means = []
        # Readings lie near the borders of pixels: those at both borders count.
        before, near = -math.inf, 0.3 * self._dwell
        for moment, state in zip(row.fetched, row.states, strict=True):
            # Status bits cover the time between two readings.
            if before <= end and moment >= begin:
                overload, unlocked = (
                    overload | state.overload,
                    unlocked | state.unlocked,
                )
            if begin - near <= moment <= end + near:
                means.append(state.mean)
            before = moment
        if not means:
            every = [state.mean for state in row.states]
            means = [float(np.interp((begin + end) / 2, row.fetched, every))]
        count = len(row.states[-1].modulation_frequencies)
        return Dwell(
            signals=[
                filtered_input(column, times, time_constant=self._constant)
                for column in signals.T
            ],
            modulation_frequencies=[*row.states[-1].modulation_frequencies],
            means=[mean for mean in means if not math.isnan(mean)],
            readings=times.size - 1,
            interval=interval,
            spreads=[None] * count,
            overload=overload,
            unlocked=unlocked,
            begin=float(begin),
            duration=float(end - begin),
            edges=[
                edge_error(column, times, time_constant=self._constant)
                for column in signals.T
            ],
        )
