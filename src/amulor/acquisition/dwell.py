"""What the lock-in says in one dwell: reading by reading, or from its own buffer."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from amulor.acquisition.clock import Clock
from amulor.acquisition.protocols import (
    BufferedLockIn,
    CombLockIn,
    Device,
    LockIn,
    Overload,
    Reading,
)
from amulor.acquisition.settings import Procedure
from amulor.acquisition.settling import Settling, refuse_for_records
from amulor.acquisition.uncertainty import filtered_input, intervals_of, readings_of
from amulor.errors import InstrumentError
from amulor.survey import Survey


@dataclass(frozen=True, kw_only=True)
class Dwell:
    """What one dwell has brought."""

    signals: list[complex]
    """One for each frequency [V]."""
    modulation_frequencies: list[float]
    """What the instrument says it used [Hz]."""
    means: list[float]
    """Mean output of the detector at some moments, empty where not wired [V]."""
    readings: int
    """Of how many readings or intervals the signals are means [1]."""
    interval: float | None
    """Time between them by the instrument's own clock, None without one [s]."""
    spreads: list[float | None]
    """Standard deviation of either output where the record itself tells it [V]."""
    overload: Overload
    """What has overloaded."""
    unlocked: bool
    """Whether the reference was lost."""
    settled: bool = True
    """Whether what was judged to be settled came to be so."""
    edges: list[float] | None = None
    """Standard deviation of either output by edges inside an interval, for each
    frequency, if the beam has moved [V]."""


def lacking(device: Device, *words: str) -> list[str]:
    """Return the methods that a device does not have."""
    return [word for word in words if not hasattr(device, word)]


def refuse_lacking(device: Device, setting: str, *words: str) -> None:
    """Raise if a device lacks what a setting of the procedure asks of it."""
    missing = lacking(device, *words)
    if missing:
        raise InstrumentError(
            f"{device.identity()} has no {', '.join(missing)}; take {setting} out of "
            "the devices file"
        )


class DwellReader:
    """Reads dwells, after what must settle has settled.

    Parameters
    ----------
    survey : Survey
        Its dwell and its time constant count.
    procedure : Procedure
        How the lock-in is read.
    lock_in : LockIn
        What is read.
    clock : Clock
        What waits go by.
    """

    def __init__(
        self, survey: Survey, procedure: Procedure, lock_in: LockIn, clock: Clock
    ) -> None:
        self._constant = survey.instrument.lock_in.time_constant
        self._dwell = survey.scan.dwell
        self._settling = procedure.settling
        self._known = procedure.output_filter == "known"
        self._lock_in, self._clock = lock_in, clock
        #: What a lock-in says that waits, integrates and knows its error by itself.
        self._records = getattr(lock_in, "records", False)
        self._buffer = procedure.readings == "buffer" or self._records
        self._known = self._known and not self._records
        if self._known:
            # One more: what the filter holds at the start is to be known.
            intervals = intervals_of(survey)
            self._number, self._spacing = intervals + 1, self._dwell / intervals
        else:
            self._number = readings_of(survey, settling=procedure.settling)
            self._spacing = self._constant
        self._judge: Settling | None = None
        if procedure.settled_by == "samples":
            refuse_for_records(self._records, lock_in.identity())
            self._judge = Settling(survey, procedure, self._asked, clock)
        self._several = False
        if self._buffer:
            refuse_lacking(lock_in, 'procedure.readings = "buffer"', "record")

    def take(self, *, several: bool, changed: bool) -> Dwell:
        """Return what a dwell brings.

        Parameters
        ----------
        several : bool
            Whether there are several frequencies.
        changed : bool
            Whether more than the direction has changed.

        Returns
        -------
        Dwell
            One signal for each frequency.
        """
        if self._records:
            return self._recorded()
        self._several, settled = several, True
        if self._judge is not None and not self._known:
            settled = self._judge.wait(changed=changed)
        elif changed or not self._known:
            self._clock.sleep(self._settling * self._constant)
        dwell = self._recorded() if self._buffer else self._read(waited=settled)
        return dwell if settled else replace(dwell, settled=False)

    def _asked(self) -> list[Reading]:
        if self._several:
            return cast(CombLockIn, self._lock_in).read_all()
        return [self._lock_in.read()]

    def _read(self, *, waited: bool) -> Dwell:
        """Return a dwell by questions; noise is learnt where it was waited for."""
        readings: list[list[Reading]] = []
        moments: list[float] = []
        for place in range(self._number):
            if place:
                self._clock.sleep(self._spacing)
            asked = self._clock.now()
            readings.append(self._asked())
            moments.append((asked + self._clock.now()) / 2)
        overload, unlocked = Overload.NONE, False
        for reading in itertools.chain.from_iterable(readings):
            overload |= reading.overload
            unlocked |= reading.unlocked
        columns = [
            [reading.signal for reading in column]
            for column in zip(*readings, strict=True)
        ]
        means = [row[0].mean for row in readings if not math.isnan(row[0].mean)]
        signals, left_out, settled = self._signals(columns, moments, means)
        if self._judge is not None and not self._known and waited:
            for column in columns:
                self._judge.learn(
                    column, sum(means) / len(means) if means else math.nan
                )
        return Dwell(
            signals=signals,
            settled=settled,
            modulation_frequencies=[one.modulation_frequency for one in readings[-1]],
            means=means,
            readings=self._number - self._known - left_out,
            interval=self._spacing if left_out else None,
            spreads=[None] * len(signals),
            overload=overload,
            unlocked=unlocked,
        )

    def _recorded(self) -> Dwell:
        lock_in = cast(BufferedLockIn, self._lock_in)
        duration = self._dwell
        if not (self._known or self._records):
            duration = (self._number - 1) * self._constant
        found = lock_in.record(duration)
        means = [] if math.isnan(found.mean) else [found.mean]
        signals, left_out, settled = self._signals(
            [*found.signals.T], found.times, means
        )
        count = len(found.times) - self._known - left_out
        length = float(found.times[-1] - found.times[0])
        return Dwell(
            signals=signals,
            settled=settled,
            modulation_frequencies=[*found.modulation_frequencies],
            means=means,
            readings=count,
            interval=length / (len(found.times) - 1) if len(found.times) > 1 else None,
            spreads=[*(found.spreads or [None] * len(signals))],
            overload=found.overload,
            unlocked=found.unlocked,
        )

    def _signals(
        self,
        columns: Sequence[Sequence[complex] | Any],
        times: ArrayLike,
        means: Sequence[float],
    ) -> tuple[list[complex], int, bool]:
        """Return signals, what is left out at the start, whether the rest agrees."""
        mean = sum(means) / len(means) if means else math.nan
        left_out, settled = 0, True
        if self._judge is not None and self._known and len(columns[0]) > 2:
            moments = np.asarray(times, dtype=float)
            spacing = float(moments[-1] - moments[0]) / (moments.size - 1)
            for column in columns:
                kept = np.exp(-np.diff(moments) / self._constant)
                output = np.asarray(column, dtype=complex)
                entered = (output[1:] - kept * output[:-1]) / (1 - kept)
                wrong = self._judge.unsettled_parts(entered, mean, spacing)
                settled = settled and wrong is not None
                left_out = max(left_out, wrong or 0)
        moments = np.asarray(times, dtype=float)[left_out:]
        signals = [self._signal(column[left_out:], moments) for column in columns]
        return signals, left_out, settled

    def _signal(self, outputs: Sequence[complex] | Any, times: ArrayLike) -> complex:
        """Return what entered the filter, or the mean of what came out of it."""
        if self._known and len(outputs) > 1:
            return filtered_input(outputs, times, time_constant=self._constant)
        return complex(np.mean(outputs))
