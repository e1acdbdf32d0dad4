"""What the lock-in says in one dwell: reading by reading, or from its own buffer."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
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
        if changed or not self._known:
            self._clock.sleep(self._settling * self._constant)
        return self._recorded() if self._buffer else self._read(several=several)

    def _read(self, *, several: bool) -> Dwell:
        ask: Callable[[], list[Reading]]
        ask = cast(CombLockIn, self._lock_in).read_all if several else self._one
        readings: list[list[Reading]] = []
        moments: list[float] = []
        for place in range(self._number):
            if place:
                self._clock.sleep(self._spacing)
            asked = self._clock.now()
            readings.append(ask())
            moments.append((asked + self._clock.now()) / 2)
        overload, unlocked = Overload.NONE, False
        for reading in itertools.chain.from_iterable(readings):
            overload |= reading.overload
            unlocked |= reading.unlocked
        columns = [
            [reading.signal for reading in column]
            for column in zip(*readings, strict=True)
        ]
        signals = [self._signal(column, moments) for column in columns]
        means = [row[0].mean for row in readings if not math.isnan(row[0].mean)]
        return Dwell(
            signals=signals,
            modulation_frequencies=[one.modulation_frequency for one in readings[-1]],
            means=means,
            readings=self._number - self._known,
            interval=None,
            spreads=[None] * len(signals),
            overload=overload,
            unlocked=unlocked,
        )

    def _one(self) -> list[Reading]:
        return [self._lock_in.read()]

    def _recorded(self) -> Dwell:
        lock_in = cast(BufferedLockIn, self._lock_in)
        duration = self._dwell
        if not (self._known or self._records):
            duration = (self._number - 1) * self._constant
        found = lock_in.record(duration)
        signals = [self._signal(column, found.times) for column in found.signals.T]
        count = len(found.times) - self._known
        length = float(found.times[-1] - found.times[0])
        return Dwell(
            signals=signals,
            modulation_frequencies=[*found.modulation_frequencies],
            means=[] if math.isnan(found.mean) else [found.mean],
            readings=count,
            interval=length / (len(found.times) - 1) if len(found.times) > 1 else None,
            spreads=[*(found.spreads or [None] * len(signals))],
            overload=found.overload,
            unlocked=found.unlocked,
        )

    def _signal(self, outputs: Sequence[complex] | Any, times: ArrayLike) -> complex:
        """Return what entered the filter, or the mean of what came out of it."""
        if self._known and len(outputs) > 1:
            return filtered_input(outputs, times, time_constant=self._constant)
        return complex(np.mean(outputs))
