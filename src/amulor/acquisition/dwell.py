"""One dwell: settling of the lock-in after a move, then its readings."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
from amulor.acquisition.uncertainty import (
    filtered_input,
    intervals_of,
    reading_variance,
    readings_of,
)
from amulor.errors import InstrumentError
from amulor.survey import Survey

#: Shortest wait after a move, in time constants: earlier readings depend more on the
#: last direction than on the present one.
FLOOR = 2.0
#: Largest remainder of the last direction, in standard errors of one reading: less than
#: a tenth of that of a mean over ten.
_RESIDUAL = 0.25
#: Squared distance of two readings, in variances of one of its parts, that noise passes
#: once in a hundred times.
_AGREE = 9.21
#: Longest wait, in units of `procedure.settling`; weight of the newest dwell in the
#: estimate of the noise.
_MOST, _WEIGHT = 4.0, 0.1


class Settling:
    r"""Test for a settled lock-in: successive readings agree within their noise.

    A one-pole filter with the output :math:`y_0` on arrival and y after a time t still
    has a remainder :math:`(y - y_0) / (e^{t / T} - 1)` of the last direction. The wait
    continues until the remainder is a quarter of the noise of a reading. Then two
    readings a time constant apart must agree, because a ringing stage or rising light
    does not follow a step response. The noise is that of counting, or of the readings
    of earlier dwells, whichever is larger, so that moving water does not count as
    unsettled.
    """

    def __init__(
        self,
        survey: Survey,
        procedure: Procedure,
        ask: Callable[[], list[Reading]],
        clock: Clock,
    ) -> None:
        instrument = survey.instrument
        self._constant = instrument.lock_in.time_constant
        self._settling = procedure.settling
        self._ask, self._clock = ask, clock
        self._volt = instrument.detector.volt_per_photoelectron_rate
        self._depth = instrument.modulation_depth
        self._dark_rate = instrument.detector.dark_rate
        dark, light = reading_variance(
            survey, rate=np.array([0.0, 1.0]), time_constant=self._constant
        )
        self._variances = float(dark), float(light - dark)
        #: Variance of earlier dwells relative to the counting variance, at least 1.
        self._excess = 1.0

    def wait(self, *, changed: bool) -> bool:
        """Wait after a move until readings agree; return whether they do."""
        start = self._clock.now()
        end = start + _MOST * self._settling * self._constant
        if changed:
            self._clock.sleep(self._settling * self._constant)
            before = self._ask()
        else:
            first = self._ask()
            self._clock.sleep(FLOOR * self._constant)
            before = self._ask()
            passed = (self._clock.now() - start) / self._constant
            remainder = max(
                abs(later.signal - earlier.signal) / math.sqrt(self._variance(later))
                for later, earlier in zip(before, first, strict=True)
            ) / math.expm1(passed)
            if remainder > _RESIDUAL:
                longer = self._constant * math.log(remainder / _RESIDUAL)
                self._clock.sleep(min(longer, end - self._clock.now()))
                before = self._ask()
        while True:
            since = self._clock.now()
            self._clock.sleep(self._constant)
            after = self._ask()
            decay = math.exp(-(self._clock.now() - since) / self._constant)
            if all(
                not new.unlocked
                and abs(new.signal - old.signal) ** 2
                <= _AGREE * 2 * (1 - decay) * self._variance(new)
                for new, old in zip(after, before, strict=True)
            ):
                return True
            if self._clock.now() >= end:
                return False
            before = after

    def unsettled_parts(
        self, entered: NDArray[np.complex128], mean: float, spacing: float
    ) -> int | None:
        """Return the count of unsettled leading inputs; None if over half of all."""
        size = max(round(self._constant / spacing), 1)
        blocks = [entered[at : at + size] for at in range(0, entered.size, size)]
        if len(blocks) > 1 and blocks[-1].size < size:
            blocks[-2:] = [np.concatenate(blocks[-2:])]
        level = complex(np.mean(entered[entered.size // 2 :]))
        variance = self._counting_variance(level, mean) / math.tanh(
            0.5 * spacing / self._constant
        )
        wrong = [
            number
            for number in range(len(blocks) - 1)
            if not self._agree(blocks[number], blocks[number + 1 :], variance)
        ]
        if not wrong:
            if len(blocks) > 2:
                means = np.array([block.mean() for block in blocks])
                self._learn(float(means.var(ddof=1)) / (2 * variance / size))
            return 0
        unsettled = sum(block.size for block in blocks[: wrong[-1] + 1])
        return unsettled if unsettled <= entered.size // 2 else None

    def _agree(
        self,
        block: NDArray[np.complex128],
        later_blocks: Sequence[NDArray[np.complex128]],
        variance: float,
    ) -> bool:
        later = np.concatenate(later_blocks)
        expected = variance * self._excess * (1 / block.size + 1 / later.size)
        # One false alarm in a thousand blocks, because a scan has many dwells of many
        # blocks.
        return bool(abs(block.mean() - later.mean()) ** 2 <= 1.5 * _AGREE * expected)

    def learn(self, signals: Sequence[complex], mean: float) -> None:
        """Update the noise estimate with settled readings, a time constant apart."""
        if len(signals) < 3:
            return
        steps = np.abs(np.diff(np.asarray(signals))) ** 2
        variance = self._counting_variance(complex(np.mean(signals)), mean)
        self._learn(float(steps.mean()) / (4 * (1 - math.exp(-1)) * variance))

    def _learn(self, ratio: float) -> None:
        self._excess = max(self._excess + _WEIGHT * (ratio - self._excess), 1.0)

    def _variance(self, reading: Reading) -> float:
        """Return the noise variance of a reading per quadrature [V^2]."""
        return self._counting_variance(reading.signal, reading.mean) * self._excess

    def _counting_variance(self, signal: complex, mean: float) -> float:
        lower = abs(signal) / (self._depth * self._volt)
        rate = lower if math.isnan(mean) else mean / self._volt - self._dark_rate
        dark, light = self._variances
        # Without light, one photoelectron in a reading is the least.
        return dark + light * max(rate, lower, 0.5 / self._constant)


def refuse_for_records(records: bool, lock_in: str) -> None:
    """Raise if the lock-in is a digitizer, which has no output filter to settle."""
    if records:
        raise InstrumentError(
            f"{lock_in} records the detector itself, which has nothing to settle; take "
            'procedure.settled_by = "samples" out of the devices file'
        )


@dataclass(frozen=True, kw_only=True)
class Dwell:
    """Signals, mean outputs and lock-in state of one dwell."""

    signals: list[complex]
    """Signal at each frequency [V]."""
    modulation_frequencies: list[float]
    """Modulation frequencies read back [Hz]."""
    means: list[float]
    """Mean outputs of the detector, empty without a wired input [V]."""
    readings: int
    """Number of readings or intervals in the mean [1]."""
    interval: float | None
    """Time between readings by the instrument's clock; None without a clock [s]."""
    spreads: list[float | None]
    """Noise standard deviation per quadrature at each frequency, from the record; None
    without a record [V]."""
    overload: Overload
    """Overloads during the dwell."""
    unlocked: bool
    """Whether the reference was lost."""
    begin: float
    """Start of the integration window by the clock of the scan [s]."""
    duration: float
    """Length of the integration window [s]."""
    settled: bool = True
    """Whether the readings agreed within the longest wait."""
    edges: list[float] | None = None
    """Standard deviation per quadrature from signal steps inside an interval, for each
    frequency; None if the beam did not move [V]."""


def lacking(device: Device, *words: str) -> list[str]:
    """Return the names of the required methods that a device lacks."""
    return [word for word in words if not hasattr(device, word)]


def refuse_lacking(device: Device, setting: str, *words: str) -> None:
    """Raise if a device lacks methods that a setting of the procedure needs."""
    missing = lacking(device, *words)
    if missing:
        raise InstrumentError(
            f"{device.identity()} has no {', '.join(missing)}; take {setting} out of "
            "the devices file"
        )


class DwellReader:
    """Reader of dwells that waits for settling before each dwell."""

    def __init__(
        self, survey: Survey, procedure: Procedure, lock_in: LockIn, clock: Clock
    ) -> None:
        self._constant = survey.instrument.lock_in.time_constant
        self._dwell = survey.scan.dwell
        self._settling = procedure.settling
        self._filter_is_known = procedure.output_filter == "known"
        self._lock_in, self._clock = lock_in, clock
        #: Whether the lock-in integrates and estimates its errors itself.
        self._records = getattr(lock_in, "records", False)
        self._buffer = procedure.readings == "buffer" or self._records
        self._filter_is_known = self._filter_is_known and not self._records
        if self._filter_is_known:
            # One more reading: the filter output at the start is needed.
            intervals = intervals_of(survey)
            self._number, self._spacing = intervals + 1, self._dwell / intervals
        else:
            self._number = readings_of(survey, settling=procedure.settling)
            self._spacing = self._constant
        self._judge: Settling | None = None
        if procedure.settled_by == "samples":
            refuse_for_records(self._records, lock_in.identity())
            self._judge = Settling(survey, procedure, self._read_once, clock)
        self._several = False
        if self._buffer:
            refuse_lacking(lock_in, 'procedure.readings = "buffer"', "record")

    def take(self, *, several: bool, changed: bool) -> Dwell:
        """Wait for settling, and read one dwell."""
        if self._records:
            return self._recorded()
        self._several, settled = several, True
        if self._judge is not None and not self._filter_is_known:
            settled = self._judge.wait(changed=changed)
        elif changed or not self._filter_is_known:
            self._clock.sleep(self._settling * self._constant)
        dwell = self._recorded() if self._buffer else self._read(waited=settled)
        return dwell if settled else replace(dwell, settled=False)

    def _read_once(self) -> list[Reading]:
        if self._several:
            return cast(CombLockIn, self._lock_in).read_all()
        return [self._lock_in.read()]

    def _read(self, *, waited: bool) -> Dwell:
        """Read a dwell query by query; update the noise if readings agreed before."""
        readings: list[list[Reading]] = []
        moments: list[float] = []
        for place in range(self._number):
            if place:
                self._clock.sleep(self._spacing)
            start = self._clock.now()
            readings.append(self._read_once())
            moments.append((start + self._clock.now()) / 2)
        overload, unlocked = Overload.NONE, False
        for reading in itertools.chain.from_iterable(readings):
            overload |= reading.overload
            unlocked |= reading.unlocked
        columns = [
            [reading.signal for reading in column]
            for column in zip(*readings, strict=True)
        ]
        means = [row[0].mean for row in readings if not math.isnan(row[0].mean)]
        signals, skipped, settled = self._signals(columns, moments, means)
        if self._judge is not None and not self._filter_is_known and waited:
            for column in columns:
                self._judge.learn(
                    column, sum(means) / len(means) if means else math.nan
                )
        begin, duration = self._window(moments[skipped], moments[-1] - moments[skipped])
        return Dwell(
            begin=begin,
            duration=duration,
            signals=signals,
            settled=settled,
            modulation_frequencies=[
                reading.modulation_frequency for reading in readings[-1]
            ],
            means=means,
            readings=self._number - self._filter_is_known - skipped,
            interval=self._spacing if skipped else None,
            spreads=[None] * len(signals),
            overload=overload,
            unlocked=unlocked,
        )

    def _recorded(self) -> Dwell:
        lock_in = cast(BufferedLockIn, self._lock_in)
        duration = self._dwell
        if not (self._filter_is_known or self._records):
            duration = (self._number - 1) * self._constant
        start = self._clock.now()
        recorded = lock_in.record(duration)
        means = [] if math.isnan(recorded.mean) else [recorded.mean]
        signals, skipped, settled = self._signals(
            [*recorded.signals.T], recorded.times, means
        )
        count = len(recorded.times) - self._filter_is_known - skipped
        length = float(recorded.times[-1] - recorded.times[0])
        steps = len(recorded.times) - 1
        late = float(recorded.times[skipped] - recorded.times[0])
        begin, window = self._window(start + late, length - late)
        return Dwell(
            begin=begin,
            duration=window,
            signals=signals,
            settled=settled,
            modulation_frequencies=[*recorded.modulation_frequencies],
            means=means,
            readings=count,
            interval=length / steps if steps else None,
            spreads=[*(recorded.spreads or [None] * len(signals))],
            overload=recorded.overload,
            unlocked=recorded.unlocked,
        )

    def _window(self, begin: float, duration: float) -> tuple[float, float]:
        """Return begin and length of the integration window of readings [s]."""
        if self._records:
            return begin, self._dwell
        if self._filter_is_known:
            return begin, duration
        # The output of one pole is a time constant late: the mean over two.
        return begin - 2 * self._constant, duration + 2 * self._constant

    def _signals(
        self,
        columns: Sequence[Sequence[complex] | Any],
        times: ArrayLike,
        means: Sequence[float],
    ) -> tuple[list[complex], int, bool]:
        """Return mean signals, count of skipped readings, and whether all settled."""
        mean = sum(means) / len(means) if means else math.nan
        skipped, settled = 0, True
        if self._judge is not None and self._filter_is_known and len(columns[0]) > 2:
            moments = np.asarray(times, dtype=float)
            spacing = float(moments[-1] - moments[0]) / (moments.size - 1)
            for column in columns:
                decay = np.exp(-np.diff(moments) / self._constant)
                output = np.asarray(column, dtype=complex)
                entered = (output[1:] - decay * output[:-1]) / (1 - decay)
                wrong = self._judge.unsettled_parts(entered, mean, spacing)
                settled = settled and wrong is not None
                skipped = max(skipped, wrong or 0)
        moments = np.asarray(times, dtype=float)[skipped:]
        signals = [self._signal(column[skipped:], moments) for column in columns]
        return signals, skipped, settled

    def _signal(self, outputs: Sequence[complex] | Any, times: ArrayLike) -> complex:
        """Return the mean filter input if the filter is known, else the mean output."""
        if self._filter_is_known and len(outputs) > 1:
            return filtered_input(outputs, times, time_constant=self._constant)
        return complex(np.mean(outputs))
