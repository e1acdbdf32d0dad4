"""Dwells of a lock-in with given readings: waits, windows, means, unsettled parts."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.dwell import DwellReader, Settling, lacking, refuse_lacking
from amulor.acquisition.protocols import Overload, Reading, Recorded
from amulor.acquisition.settings import Procedure
from amulor.errors import InstrumentError
from amulor.survey import Survey

NAN = math.nan
#: Difference of two independent numbers of variance 1 a part that noise exceeds once in
#: a hundred times: the square of it is exponential with a mean of 4.
ONE_PERCENT = math.sqrt(-4 * math.log(0.01))


def reading(signal: complex, *, mean: float = NAN, **more: object) -> Reading:
    return Reading(signal=signal, mean=mean, modulation_frequency=39e6, **more)


class Asked:
    """Answers of a lock-in in order, the last one again and again."""

    def __init__(self, clock: VirtualClock, *answers: list[Reading]) -> None:
        self._clock, self._answers, self.times = clock, [*answers], []

    def __call__(self) -> list[Reading]:
        self.times.append(self._clock.now())
        return self._answers.pop(0) if len(self._answers) > 1 else self._answers[0]


def judge(clock: VirtualClock, ask: object, **fields: object) -> Settling:
    """Return a judge with a variance of 1 V^2 and a time constant of 0.5 s."""
    made = object.__new__(Settling)
    known = {
        "_constant": 0.5, "_settling": 5.0, "_ask": ask, "_clock": clock, "_volt": 1.0,
        "_depth": 1.0, "_dark_rate": 0.0, "_variances": (1.0, 0.0), "_excess": 1.0,
    }  # fmt: skip
    vars(made).update({**known, **fields})
    return made


def test_after_a_change_readings_must_agree_within_their_noise(clock) -> None:
    # Noise a time constant apart keeps 1/e of itself.
    limit = ONE_PERCENT * math.sqrt(1 - math.exp(-1))
    for factor, settled in ((0.99, True), (1.01, False)):
        clock = VirtualClock()
        ask = Asked(clock, [reading(0)], [reading(1j * factor * limit)])
        assert judge(clock, ask).wait(changed=True)
        # Five time constants, then one more, or another one until two agree.
        assert ask.times == ([2.5, 3.0] if settled else [2.5, 3.0, 3.5])
    clock = VirtualClock()
    ask = Asked(clock, [reading(0)], [reading(1j * 1.01 * limit)])
    assert judge(clock, ask, _excess=2.0).wait(changed=True)
    assert ask.times == [2.5, 3.0]


def test_all_tones_must_agree_and_be_locked(clock) -> None:
    high = ONE_PERCENT
    ask = Asked(
        clock,
        [reading(0), reading(0)],
        [reading(0), reading(high)],
        [reading(0, unlocked=True), reading(high)],
        [reading(0), reading(high)],
    )
    assert judge(clock, ask).wait(changed=True)
    assert ask.times == [2.5, 3.0, 3.5, 4.0]


def test_the_wait_ends_after_four_times_the_settling(clock) -> None:
    class Restless(Asked):
        def __call__(self) -> list[Reading]:
            super().__call__()
            return [reading(100.0 * len(self.times))]

    ask = Restless(clock, [])
    assert not judge(clock, ask).wait(changed=True)
    assert ask.times[-1] == clock.now() == 10.0


@pytest.mark.parametrize(
    ("remainder", "times"),
    [
        # Two time constants are the shortest wait; then the remainder is awaited.
        (0.249, [0, 1.0, 1.5]), (0.25 * math.e**3, [0, 1.0, 2.5, 3.0]),
        (0.25 * math.e**50, [0, 1.0, 10.0, 10.5]),
    ],
)  # fmt: skip
def test_a_remainder_is_awaited_until_it_is_a_quarter_of_the_noise(
    remainder, times
) -> None:
    step = remainder * math.expm1(2.0)
    clock = VirtualClock()
    ask = Asked(
        clock, [reading(-step), reading(0)], [reading(0), reading(0)]
    )  # fmt: skip
    assert judge(clock, ask).wait(changed=False)
    assert_allclose(ask.times, times)
    # The larger remainder of several tones counts, whichever it is.
    clock = VirtualClock()
    ask = Asked(clock, [reading(0), reading(1j * step)], [reading(0), reading(0)])
    assert judge(clock, ask).wait(changed=False)
    assert_allclose(ask.times, times)
    # Four times the variance is half of the remainder.
    clock = VirtualClock()
    ask = Asked(clock, [reading(2 * step)], [reading(0)])
    assert judge(clock, ask, _excess=4.0).wait(changed=False)
    assert_allclose(ask.times, times)


def test_the_noise_of_a_judge_is_that_of_its_survey(small: Survey, clock) -> None:
    survey = small.with_(
        {
            "instrument.detector.dark_rate": "1e6 1/s",
            "instrument.modulation_depth": 0.4,
        }
    )
    made = Settling(survey, Procedure(settling=4), list, clock)
    # 2 F (r + d) / T of 1.2, 20 ms and (8e-12 V s)^2.
    noise = (8e-12) ** 2 * 2 * 1.2 / 0.02
    found = made._counting_variance(0.0, 8e-12 * 4e6)
    assert found == pytest.approx(noise * (3e6 + 1e6))
    found = made._counting_variance(0.4 * 8e-12 * 2e6, NAN)
    assert found == pytest.approx(noise * (2e6 + 1e6))
    assert (made._constant, made._settling, made._excess) == (0.01, 4.0, 1.0)


def test_unsettled_parts_are_whole_blocks_and_at_most_half(clock) -> None:
    made = judge(clock, None, _variances=(1e-6, 0.0))

    def parts(*levels: tuple[int, float], spacing: float = 0.1) -> int | None:
        entered = np.concatenate([np.full(size, value) for size, value in levels])
        return made.unsettled_parts(entered.astype(complex), NAN, spacing)

    # Blocks of five inputs; a last part that is no block joins the one before.
    assert parts((5, 1), (19, 0)) == 5
    assert parts((10, 1), (10, 0)) == 10
    assert parts((11, 1), (9, 0)) is None
    # A late step makes all before it wrong.
    assert parts((5, 0), (5, 1), (10, 0)) == 10
    assert parts((20, 0)) == 0
    # Inputs farther apart than a time constant are blocks of one.
    assert parts((1, 1), (5, 0), spacing=2.0) == 1
    assert parts((4, 0)) == 0
    # The variance of an input: that of a reading over tanh(s / 2).
    noise = math.sqrt(1e-6 / math.tanh(0.5 * 0.1 / 0.5) * (1 / 5 + 1 / 5))
    limit = math.sqrt(1.5 * 9.21) * noise
    assert parts((5, 0.97 * limit), (5, 0)) == 0
    assert parts((5, 1.03 * limit), (5, 0)) == 5
    assert made._excess == 1.0


def test_noise_is_learned_from_the_means_of_three_blocks(clock) -> None:
    made = judge(clock, None, _variances=(1e-6, 0.0))
    # Both parts of a mean of five inputs.
    square = 2 * 1e-6 / math.tanh(0.1) / 5
    blocks = np.array([1, -1, 0]) * 1.5 * math.sqrt(square)
    entered = np.repeat(blocks, 5).astype(complex)
    assert made.unsettled_parts(entered, NAN, 0.1) == 0
    # The variance of the three means is 2.25 times as large; a tenth of it counts.
    assert made._excess == pytest.approx(1 + 0.1 * 1.25)
    made._excess = 1.0
    assert made.unsettled_parts(entered[:10], NAN, 0.1) == 0
    assert made._excess == 1.0


class LockIn:
    """A lock-in whose readings take 2 ms each, with rising signals."""

    def __init__(self, clock: VirtualClock, **more: object) -> None:
        self._clock, self.count, self.recorded = clock, 0, []
        vars(self).update(more)

    def identity(self) -> str:
        return "a lock-in"

    def read(self) -> Reading:
        self._clock.sleep(2e-3)
        self.count += 1
        return reading(
            complex(self.count, -1),
            mean=0.5 * self.count if self.count % 2 else NAN,
            overload=Overload.INPUT if self.count == 2 else Overload.NONE,
            unlocked=self.count == 3,
        )

    def read_all(self) -> list[Reading]:
        self._clock.sleep(2e-3)
        self.count += 1
        return [reading(self.count), reading(10j * self.count, mean=9.0)]


@pytest.fixture
def dwelling(small: Survey) -> Survey:
    """Return a dwell of 8 readings after settling."""
    return small.with_({"scan.dwell": "125 ms"})


def test_readings_of_a_dwell_are_averaged_over_their_window(dwelling, clock) -> None:
    lock_in = LockIn(clock)
    reader = DwellReader(dwelling, Procedure(), lock_in, clock)
    dwell = reader.take(several=False, changed=False)
    assert lock_in.count == 8
    assert dwell.signals == [4.5 - 1j]
    assert dwell.modulation_frequencies == [39e6]
    assert dwell.means == [0.5, 1.5, 2.5, 3.5]
    assert (dwell.readings, dwell.interval, dwell.spreads) == (8, None, [None])
    assert dwell.overload == Overload.INPUT
    assert dwell.unlocked
    assert dwell.settled
    assert dwell.edges is None
    # Five time constants; readings last 2 ms, one time constant apart; each is the mean
    # over two before it.
    assert dwell.begin == pytest.approx(50e-3 + 1e-3 - 20e-3)
    assert dwell.duration == pytest.approx(7 * 12e-3 + 20e-3)
    assert clock.now() == pytest.approx(50e-3 + 8 * 2e-3 + 7 * 10e-3)


def test_frequencies_at_once_have_their_own_means(dwelling, clock) -> None:
    reader = DwellReader(dwelling, Procedure(settling=8), LockIn(clock), clock)
    dwell = reader.take(several=True, changed=True)
    # 125 ms are 12.5 time constants: 8 of settling leave 5 readings.
    assert dwell.signals == [3, 30j]
    assert dwell.readings == 5
    assert dwell.means == []
    assert dwell.spreads == [None, None]
    assert dwell.overload == Overload.NONE
    assert not dwell.unlocked
    assert clock.now() == pytest.approx(80e-3 + 5 * 2e-3 + 4 * 10e-3)


def test_a_known_filter_needs_no_wait_after_a_move(small, clock) -> None:
    known = Procedure(output_filter="known")
    for changed, wait in ((False, 0.0), (True, 50e-3)):
        clock = VirtualClock()
        lock_in = LockIn(clock)
        dwell = DwellReader(small, known, lock_in, clock).take(
            several=False, changed=changed
        )
        # 50 ms are five intervals, with six readings.
        assert lock_in.count == 6
        assert dwell.readings == 5
        assert dwell.interval is None
        # A signal that rises by 1 V in each 12 ms is early by 12 ms / (e^1.2 - 1).
        early = 1 / math.expm1(1.2)
        assert_allclose(dwell.signals, [4 - 1j + early])
        assert dwell.begin == pytest.approx(wait + 1e-3)
        assert dwell.duration == pytest.approx(5 * 12e-3)


class Buffered(LockIn):
    """A lock-in with a buffer of three times and two frequencies."""

    def record(self, duration: float) -> Recorded:
        self.recorded.append(duration)
        self._clock.sleep(duration)
        more = {"spreads": self.spreads} if hasattr(self, "spreads") else {}
        return Recorded(
            times=np.array([0.5, 0.51, 0.53]),
            signals=np.array([[1, 2j], [2, 4j], [6, 12j]]),
            mean=getattr(self, "mean", NAN),
            modulation_frequencies=(20e6, 39e6),
            overload=Overload.OUTPUT,
            unlocked=True,
            **more,
        )


def test_a_record_of_a_buffer_is_a_dwell(dwelling, clock) -> None:
    lock_in = Buffered(clock, mean=0.25)
    buffer = Procedure(readings="buffer")
    dwell = DwellReader(dwelling, buffer, lock_in, clock).take(
        several=True, changed=True
    )
    assert lock_in.recorded == pytest.approx([70e-3])
    assert dwell.signals == [3, 6j]
    assert dwell.modulation_frequencies == [20e6, 39e6]
    assert dwell.means == [0.25]
    assert dwell.readings == 3
    assert dwell.interval == pytest.approx(15e-3)
    assert dwell.spreads == [None, None]
    assert dwell.overload == Overload.OUTPUT
    assert dwell.unlocked
    assert dwell.begin == pytest.approx(50e-3 - 20e-3)
    assert dwell.duration == pytest.approx(30e-3 + 20e-3)
    # With a known filter the whole dwell is recorded, less one interval at its begin.
    lock_in = Buffered(clock, spreads=(1e-6, 2e-6))
    known = Procedure(readings="buffer", output_filter="known")
    reader = DwellReader(dwelling, known, lock_in, clock)
    begun = clock.now()
    dwell = reader.take(several=True, changed=False)
    assert lock_in.recorded == pytest.approx([125e-3])
    assert dwell.means == []
    assert dwell.readings == 2
    assert dwell.spreads == [1e-6, 2e-6]
    assert (dwell.begin, dwell.duration) == pytest.approx((begun, 30e-3))


def test_a_digitizer_records_the_dwell_without_a_wait(dwelling, clock) -> None:
    lock_in = Buffered(clock, records=True, spreads=(1e-6, 2e-6))
    for procedure in (Procedure(), Procedure(output_filter="known")):
        reader = DwellReader(dwelling, procedure, lock_in, clock)
        begun = clock.now()
        dwell = reader.take(several=True, changed=True)
        assert dwell.signals == [3, 6j]
        assert dwell.readings == 3
        assert (dwell.begin, dwell.duration) == pytest.approx((begun, 125e-3))
    assert lock_in.recorded == pytest.approx([125e-3] * 2)


def test_unsettled_intervals_are_left_out_of_a_record(dwelling, clock) -> None:
    known = Procedure(readings="buffer", output_filter="known", settled_by="samples")
    reader = DwellReader(dwelling, known, Buffered(clock), clock)
    reader._judge = SimpleNamespace(unsettled_parts=lambda *_: 1)
    dwell = reader.take(several=True, changed=False)
    # The interval of 20 ms from 2 to 6 V behind 10 ms.
    assert_allclose(dwell.signals[0], (6 - math.exp(-2) * 2) / (1 - math.exp(-2)))
    assert dwell.readings == 1
    assert dwell.interval == pytest.approx(15e-3)
    assert (dwell.begin, dwell.duration) == pytest.approx((10e-3, 20e-3))
    assert dwell.settled
    # The same of queries, whose interval is then that of the queries.
    queried = Procedure(output_filter="known", settled_by="samples")
    clock = VirtualClock()
    reader = DwellReader(dwelling, queried, LockIn(clock), clock)
    reader._judge = SimpleNamespace(unsettled_parts=lambda *_: 2)
    dwell = reader.take(several=False, changed=False)
    # 13 intervals of 125 / 13 ms.
    assert dwell.readings == 11
    assert dwell.interval == pytest.approx(125e-3 / 13)
    step = 125e-3 / 13 + 2e-3
    assert dwell.begin == pytest.approx(1e-3 + 2 * step)
    assert dwell.duration == pytest.approx(11 * step)
    reader._judge = SimpleNamespace(unsettled_parts=lambda *_: None)
    dwell = reader.take(several=False, changed=False)
    assert not dwell.settled
    assert (dwell.readings, dwell.interval) == (13, None)


def test_a_judged_dwell_is_read_after_its_wait_and_learned_from(
    dwelling, clock
) -> None:
    learned: list[tuple[list[complex], float]] = []
    waits: list[bool] = []
    answers = [True, False]

    def wait(*, changed: bool) -> bool:
        waits.append(changed)
        return answers[len(waits) - 1]

    reader = DwellReader(
        dwelling, Procedure(settled_by="samples"), LockIn(clock), clock
    )
    assert isinstance(reader._judge, Settling)
    reader._judge = SimpleNamespace(
        wait=wait, learn=lambda column, mean: learned.append((column, mean))
    )
    dwell = reader.take(several=False, changed=True)
    assert dwell.settled
    assert learned == [([complex(k, -1) for k in range(1, 9)], 2.0)]
    dwell = reader.take(several=False, changed=False)
    assert waits == [True, False]
    assert not dwell.settled
    assert len(learned) == 1
    assert clock.now() == pytest.approx(2 * (8 * 2e-3 + 7 * 10e-3))


def test_what_a_procedure_needs_is_named(dwelling, clock) -> None:
    device = SimpleNamespace(identity=lambda: "a lock-in", fetch=None)
    assert lacking(device, "record", "fetch", "where") == ["record", "where"]
    refuse_lacking(device, "a setting", "fetch")
    for procedure, lock_in, text in (
        (
            Procedure(readings="buffer"),
            device,
            'a lock-in has no record; take procedure.readings = "buffer" out of the '
            "devices file",
        ),
        (
            Procedure(settled_by="samples"),
            Buffered(clock, records=True),
            "a lock-in records the detector itself, which has nothing to settle; take "
            'procedure.settled_by = "samples" out of the devices file',
        ),
    ):
        with pytest.raises(InstrumentError) as caught:
            DwellReader(dwelling, procedure, lock_in, clock)
        assert str(caught.value) == text
