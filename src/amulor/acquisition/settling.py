"""When a lock-in has settled after a move, judged from what it reads."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from amulor.acquisition.clock import Clock
from amulor.acquisition.protocols import Reading
from amulor.acquisition.settings import Procedure
from amulor.acquisition.uncertainty import reading_variance
from amulor.errors import InstrumentError
from amulor.survey import Survey

#: Shortest wait after a move, in time constants: before that the step response says
#: more about the last direction than about this one.
FLOOR = 2.0
#: What the step response may leave of the last direction, in standard errors of one
#: reading: less than a tenth of that of a mean over ten.
_LEFT = 0.25
#: Squared distance of two readings, in variances of one of its parts, that noise passes
#: once in a hundred times.
_AGREE = 9.21
#: Longest wait, in times of `procedure.settling`; weight of the newest dwell in what
#: is known of the noise.
_MOST, _WEIGHT = 4.0, 0.1


class Settling:
    r"""Waits until successive readings agree within their noise.

    Parameters
    ----------
    survey : Survey
        Detector, time constant and modulation depth.
    procedure : Procedure
        Longest waits, and that after more than a move.
    ask : callable
        Returns a reading of each frequency.
    clock : Clock
        What waits go by.

    Notes
    -----
    A one-pole filter that held :math:`y_0` on arrival and shows y after a time t still
    holds :math:`(y - y_0) / (e^{t / T} - 1)` of its last direction: the step response
    is known, and so is how much longer it takes until this is a quarter of the noise of
    a reading. Then two readings a time constant apart must agree, since a stage that
    rings or light that comes up follows no step response. The noise is that of
    counting, or what the readings of dwells before have shown, whichever is more:
    water that moves is no unsettled filter.
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
        #: Variance that dwells have shown over that of counting, at least 1.
        self._excess = 1.0

    def wait(self, *, changed: bool) -> bool:
        """Wait after a move; return whether readings came to agree.

        Parameters
        ----------
        changed : bool
            Whether more than the direction has changed: then what the output held says
            nothing, and it is waited for as long as without judging.

        Returns
        -------
        bool
            False if they still differ after four times `procedure.settling`.
        """
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
            left = max(
                abs(one.signal - held.signal) / math.sqrt(self._variance(one))
                for one, held in zip(before, first, strict=True)
            ) / math.expm1(passed)
            if left > _LEFT:
                longer = self._constant * math.log(left / _LEFT)
                self._clock.sleep(min(longer, end - self._clock.now()))
                before = self._ask()
        while True:
            since = self._clock.now()
            self._clock.sleep(self._constant)
            after = self._ask()
            kept = math.exp(-(self._clock.now() - since) / self._constant)
            if all(
                not new.unlocked
                and abs(new.signal - old.signal) ** 2
                <= _AGREE * 2 * (1 - kept) * self._variance(new)
                for new, old in zip(after, before, strict=True)
            ):
                return True
            if self._clock.now() >= end:
                return False
            before = after

    def unsettled_parts(
        self, entered: NDArray[np.complex128], mean: float, spacing: float
    ) -> int | None:
        """Return how many of the first inputs of a known filter are not yet settled.

        Parameters
        ----------
        entered : ndarray of complex, shape (n,)
            Mean input over intervals, of white noise [V].
        mean : float
            Mean output of the detector, not a number where it is not wired [V].
        spacing : float
            Length of an interval [s].

        Returns
        -------
        int or None
            0 if all agree; None if those of the second half differ as well.
        """
        many = max(round(self._constant / spacing), 1)
        blocks = [entered[at : at + many] for at in range(0, entered.size, many)]
        if len(blocks) > 1 and blocks[-1].size < many:
            blocks[-2:] = [np.concatenate(blocks[-2:])]
        level = complex(np.mean(entered[entered.size // 2 :]))
        one = self._counted(level, mean) / math.tanh(0.5 * spacing / self._constant)
        wrong = [
            number
            for number in range(len(blocks) - 1)
            if not self._agree(blocks[number], blocks[number + 1 :], one)
        ]
        if not wrong:
            if len(blocks) > 2:
                means = np.array([block.mean() for block in blocks])
                self._learn(float(means.var(ddof=1)) / (2 * one / many))
            return 0
        unsettled = sum(block.size for block in blocks[: wrong[-1] + 1])
        return unsettled if unsettled <= entered.size // 2 else None

    def _agree(
        self,
        block: NDArray[np.complex128],
        rest: Sequence[NDArray[np.complex128]],
        variance: float,
    ) -> bool:
        later = np.concatenate(rest)
        expected = variance * self._excess * (1 / block.size + 1 / later.size)
        # A scan has many dwells, and a dwell many blocks: once in a thousand each.
        return bool(abs(block.mean() - later.mean()) ** 2 <= 1.5 * _AGREE * expected)

    def learn(self, signals: Sequence[complex], mean: float) -> None:
        """Take note of readings of a settled dwell, a time constant apart [V]."""
        if len(signals) < 3:
            return
        steps = np.abs(np.diff(np.asarray(signals))) ** 2
        one = self._counted(complex(np.mean(signals)), mean)
        self._learn(float(steps.mean()) / (4 * (1 - math.exp(-1)) * one))

    def _learn(self, ratio: float) -> None:
        self._excess = max(self._excess + _WEIGHT * (ratio - self._excess), 1.0)

    def _variance(self, reading: Reading) -> float:
        """Return the variance of either output of a reading [V^2]."""
        return self._counted(reading.signal, reading.mean) * self._excess

    def _counted(self, signal: complex, mean: float) -> float:
        lower = abs(signal) / (self._depth * self._volt)
        rate = lower if math.isnan(mean) else mean / self._volt - self._dark_rate
        dark, light = self._variances
        # In darkness no less than one photoelectron in a reading.
        return dark + light * max(rate, lower, 0.5 / self._constant)


def refuse_for_records(records: bool, lock_in: str) -> None:
    """Raise if what is read has no output filter that could settle."""
    if records:
        raise InstrumentError(
            f"{lock_in} records the detector itself, which has nothing to settle; take "
            'procedure.settled_by = "samples" out of the devices file'
        )
