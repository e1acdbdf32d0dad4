"""Driver of the lock-in amplifier SR865A of Stanford Research, up to 4 MHz."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from amulor.acquisition.clock import Clock, Deadline
from amulor.acquisition.drivers.stanford import Stanford
from amulor.acquisition.links.lines import Conversation
from amulor.acquisition.protocols import Overload, Reading, Recorded
from amulor.errors import InstrumentError

#: Time constants by the code of OFLT [s].
TIME_CONSTANTS = tuple(
    factor * 10.0**exponent for exponent in range(-6, 5) for factor in (1, 3)
)
#: Full scales by the code of SCAL, as the instrument counts them [V rms].
SCALES = tuple(
    [
        factor * 10.0**exponent
        for exponent in range(-1, -10, -1)
        for factor in (10, 5, 2)
    ]
    + [1e-9]
)
#: Input ranges by the code of IRNG [V peak].
INPUT_RANGES = (1.0, 0.3, 0.1, 0.03, 0.01)
#: Bits of LIAS?: scale of the outputs, unlocked reference, input range.
OUTPUT, UNLOCKED, INPUT = 0b11, 8, 16
_FREQUENCIES = (1e-3, 4e6)
_POLL = 0.01
#: Bytes of a captured point (X and Y), points of the largest buffer, least points a
#: time constant, and queries in one packet.
_POINT, _CAPACITY, _POINTS, _PACKET = 8, 4096 * 1024 // 8, 4.0, 64
#: Fastest capture: the buffer lasts for half a minute [1/s].
_FASTEST = 20e3
#: Largest relative drift between the clocks of instrument and computer [1]; the clock
#: of a computer under time synchronization may drift as much for a while.
_DRIFT = 5e-4
#: Bits of CAPTURESTAT?: points are recorded; the buffer is full.
_RECORDING, _WRAPPED = 1, 4
#: Attempts to query points that are late.
_ATTEMPTS = 10
#: Fraction of the full scale below which a finer scale is selected; the steps are 2 and
#: 2.5.
_FINER_BELOW = 0.3


class _BufferIsFull(Exception):  # noqa: N818  caught inside this module
    """The capture buffer is full and must be restarted."""


class Sr865a(Stanford):
    """Lock-in amplifier SR865A, with an internal or an external reference.

    The commands are those of the remote programming chapter of its manual: RSRC, FREQ,
    OFLT, OFSL, SCAL, IRNG, SNAP?, LIAS?, AUXV. Outputs that the panel counts from 1 to
    4 are 0 to 3 in AUXV, as in the maker's own package srsinst.sr860. Its outputs
    are in volts rms, with a phase that falls with delay; readings are peak amplitudes
    with a phase that rises with delay.
    """

    model = "SR865A"
    _inputs, _first_output, _outputs = 4, 0, 4
    _set_output = "AUXV"
    _get_input, _first_input = "OAUX", 0

    def __init__(
        self,
        link: Conversation,
        *,
        mean_output_input: int | None,
        modulation_amplitude: float,
        input_range: float = INPUT_RANGES[0],
        clock: Clock,
        external: bool = False,
    ) -> None:
        super().__init__(
            link,
            mean_output_input=mean_output_input,
            clock=clock,
            external=external,
        )
        self._amplitude, self._first_range = modulation_amplitude, input_range
        self._rate, self._stride = 0.0, 1
        #: Number of the next point of a stream.
        self._next = 0
        #: Earliest and latest start of the buffer, and the time of this estimate.
        self._began_after, self._began_before, self._noted = -math.inf, math.inf, 0.0

    def prepare(self, *, time_constant: float) -> None:
        """Set the reference, a one-pole output filter and the time constant [s]."""
        code = self.index_of(time_constant, TIME_CONSTANTS, "time constant")
        self._scale = 0
        self._range = self.index_of(self._first_range, INPUT_RANGES, "input range", "V")
        self._constant, self._rate = time_constant, 0.0
        self._frequency = math.nan
        lines = [
            "*RST",
            f"RSRC {int(self._external)}",
            "HARM 1",
            "PHAS 0",
            "OFSL 0",
            f"OFLT {code}",
        ]
        lines += ["ADVFILT 0", "SYNC 0", f"IRNG {self._range}", f"SCAL {self._scale}"]
        # Voltage input A, AC, and the modulation output at the stated level.
        lines += ["IVMD 0", "ISRC 0", "ICPL 0", f"SLVL {self._amplitude:.6g}", "SOFF 0"]
        self.configure(lines)

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Set the modulation frequency, wait for lock, return the actual one [Hz]."""
        low, high = _FREQUENCIES
        if not low <= frequency <= high:
            raise InstrumentError(
                f"SR865A has no {frequency:g} Hz, it goes from {low:g} to {high:g} Hz; "
                "change the modulation frequencies of the survey"
            )
        if not self._external:
            self._link.send(f"FREQ {frequency:.7g}")
        end = Deadline(self._clock, timeout)
        self.number("LIAS?")  # clears earlier status bits
        while int(self.number("LIAS?")) & UNLOCKED:
            if end.passed():
                raise InstrumentError(
                    f"SR865A has not locked to {frequency:g} Hz within {timeout:g} s"
                )
            self._clock.sleep(_POLL)
        self._frequency = self.number("FREQEXT?" if self._external else "FREQ?")
        return self._frequency

    def read(self) -> Reading:
        """Return the present outputs, overload bits and lock state."""
        snapshot, status = self._link.ask(f"{self._snap()}\nLIAS?", answers=2)
        return self._reading(snapshot, status)

    def _snap(self) -> str:
        return "SNAP? 0,1" + f",{3 + (self._mean_input or 0)}" * bool(self._mean_input)

    def _reading(self, snapshot: str, status: str) -> Reading:
        count = 2 if self._mean_input is None else 3
        result = self.parsed(snapshot, self._snap(), count=count)
        bits = int(self.parsed(status, "LIAS?", count=1)[0])
        overload = Overload.NONE
        if bits & INPUT:
            overload |= Overload.INPUT
        if bits & OUTPUT:
            overload |= Overload.OUTPUT
        return Reading(
            signal=math.sqrt(2) * complex(result[0], -result[1]),
            mean=math.nan if self._mean_input is None else result[2],
            modulation_frequency=self._frequency,
            overload=overload,
            unlocked=bool(bits & UNLOCKED),
        )

    def record(self, duration: float) -> Recorded:
        """Record the outputs for a time [s] from this call on.

        Notes
        -----
        The capture buffer (manual, pages 134 to 139) runs all the time. Points are
        queried by CAPTUREVAL?, in one packet with the progress of the buffer:
        CAPTUREGET? would need a stop, which waits for a block of 256 points. It runs at
        its fastest rate, and every n-th point is queried: finer steps lose less time
        before the first point.

        Only points recorded after this call are used. If a query sent at :math:`t_s`
        reports n points at the rate f, the buffer began after :math:`t_s - n / f`,
        regardless of the delay of the answer. The latest of these bounds is used, less
        the drift of the clocks since then. The times of answers give an upper bound,
        which checks that the instrument counts as assumed.
        """
        for _ in range(_ATTEMPTS):
            try:
                return self._record(duration)
            except _BufferIsFull:
                self._start_capture()
        raise InstrumentError(
            f"the capture of SR865A at {self._link.address} is full as soon as it "
            "begins; switch it off and on"
        )

    def _record(self, duration: float) -> Recorded:
        rate = self._rate or self._start_capture()
        now = self._clock.now()
        count = math.ceil(duration * rate / self._stride - 1e-9) + 1
        began = self._began_after - _DRIFT * (now - self._noted)
        first = max(math.ceil((now - began) * rate), 0)
        requested = [first + self._stride * number for number in range(count)]
        if requested[-1] + self._stride > _CAPACITY:
            raise _BufferIsFull
        # The query then arrives just after the last point was recorded.
        self._wait(requested[-1])
        points: dict[int, complex] = {}
        overload, unlocked = Overload.NONE, False
        for _ in range(_ATTEMPTS):
            missing = [number for number in requested if number not in points]
            for start in range(0, len(missing), _PACKET):
                part = missing[start : start + _PACKET]
                last = self._points_and_state(part, points)
                overload, unlocked = overload | last.overload, unlocked | last.unlocked
            if len(points) == count:
                break
            self._wait(requested[-1])
        else:
            raise InstrumentError(
                f"SR865A at {self._link.address} has captured {len(points)} of {count} "
                f"points after {_ATTEMPTS} questions; switch it off and on"
            )
        signals = [[math.sqrt(2) * points[number].conjugate()] for number in requested]
        return Recorded(
            times=np.asarray(np.arange(count) * (self._stride / rate)),
            signals=np.array(signals, dtype=complex),
            mean=last.mean,
            modulation_frequencies=(self._frequency,),
            overload=overload,
            unlocked=unlocked,
        )

    def begin_stream(self, duration: float) -> None:
        """Start a capture buffer that lasts for at least a duration [s].

        Notes
        -----
        A buffer with enough remaining time continues. Otherwise it restarts, at a lower
        rate if the fastest rate would fill it too early.
        """
        if self._room() < duration:
            self._start_capture(duration)
        if self._room() < duration:
            raise InstrumentError(
                f"the buffer of SR865A holds {_CAPACITY / self._rate:.3g} s at this "
                f"time constant, and {duration:.3g} s are needed at once; take a "
                "shorter dwell, or a longer time constant"
            )
        began = self._began_after - _DRIFT * (self._clock.now() - self._noted)
        self._next = max(math.ceil((self._clock.now() - began) * self._rate), 0)

    def _room(self) -> float:
        """Return the time until the capture buffer is full [s]."""
        if not self._rate:
            return 0.0
        return _CAPACITY / self._rate - (self._clock.now() - self._began_after)

    def fetch(self) -> Recorded:
        """Return the points captured since the last call.

        Notes
        -----
        The time of a point follows from the middle of the earliest and latest start of
        the buffer that all answers so far allow (see `record`); its error is at most
        half of a round trip.
        """
        points: dict[int, complex] = {}
        overload, unlocked = Overload.NONE, False
        while True:
            newest = math.floor(
                (self._clock.now() - self._began_after) * self._rate * (1 + _DRIFT)
            )
            requested = [*range(self._next, newest + 1, self._stride)][:_PACKET]
            try:
                last = self._points_and_state(requested, points)
            except _BufferIsFull:
                raise InstrumentError(
                    f"the capture of SR865A at {self._link.address} came to its end "
                    "while the beam moved; see that nobody else drives it"
                ) from None
            overload, unlocked = overload | last.overload, unlocked | last.unlocked
            captured = [number for number in requested if number in points]
            if captured:
                self._next = captured[-1] + self._stride
            if len(captured) < _PACKET:
                break
        numbers = sorted(points)
        began = (self._began_after + self._began_before) / 2
        signals = [[math.sqrt(2) * points[number].conjugate()] for number in numbers]
        return Recorded(
            times=began + np.array(numbers, dtype=float) / self._rate,
            signals=np.array(signals, dtype=complex).reshape(len(numbers), 1),
            mean=last.mean,
            modulation_frequencies=(self._frequency,),
            overload=overload,
            unlocked=unlocked,
        )

    def _wait(self, number: int) -> None:
        """Wait until the buffer should have captured the point with this number."""
        moment = self._began_after + (number + 0.6) / self._rate
        self._clock.sleep(moment - self._clock.now())

    def _points_and_state(
        self, requested: Sequence[int], points: dict[int, complex]
    ) -> Reading:
        """Read points of the buffer into `points`; return the present outputs."""
        questions = [f"CAPTUREVAL? {number}" for number in requested]
        lines = ["CAPTUREBYTES?", *questions, "CAPTURESTAT?", self._snap(), "LIAS?"]
        sent = self._clock.now()
        length, *values, running, snapshot, status = self._link.ask(
            "\n".join(lines), answers=len(lines)
        )
        state = int(self.parsed(running, "CAPTURESTAT?", count=1)[0])
        if not state & _RECORDING and state & _WRAPPED:
            raise _BufferIsFull
        if not state & _RECORDING:
            # The newest point dates all others, so it must be recent.
            raise InstrumentError(
                f"the capture of SR865A at {self._link.address} has been stopped; see "
                "that nobody else drives it"
            )
        count = self._note(sent, length)
        for number, line, value in zip(requested, questions, values, strict=True):
            if number < count:  # others are zero
                points[number] = complex(*self.parsed(value, line, count=2))
        return self._reading(snapshot, status)

    def _note(self, sent: float, length: str) -> int:
        """Update the start time of the capture buffer; return its number of points."""
        count = int(self.parsed(length, "CAPTUREBYTES?", count=1)[0]) // _POINT
        apart = _DRIFT * (sent - self._noted)
        self._noted, past = sent, count / self._rate
        self._began_after = max(self._began_after - apart, sent - past)
        answered = self._clock.now() - past + 1 / self._rate
        self._began_before = min(self._began_before + apart, answered)
        if self._began_after > self._began_before:
            raise InstrumentError(
                f"the buffer of SR865A at {self._link.address} does not count its "
                "points as they come, so that their age is not known; take "
                'procedure.readings = "buffer" out of the devices file'
            )
        return count

    def _start_capture(self, duration: float = 0.0) -> float:
        """Restart the capture buffer; return its sample rate [1/s].

        The rate is the fastest one at which the buffer lasts for the duration [s].
        """
        if self._rate:
            self._link.send("CAPTURESTOP")
        fastest = self.number("CAPTURERATEMAX?")
        most = min(_FASTEST, _CAPACITY / max(1.1 * duration, 1e-9))
        divisor = max(math.ceil(math.log2(fastest / most)), 0)
        lines = ["CAPTURECFG 1", f"CAPTURELEN {_CAPACITY * _POINT // 1024}"]
        self.configure([*lines, f"CAPTURERATE {min(divisor, 20)}", "CAPTURESTART 0,0"])
        self._rate = self.number("CAPTURERATE?")
        self._stride = max(math.floor(self._rate * self._constant / _POINTS), 1)
        self._began_after, self._began_before = -math.inf, math.inf
        self._noted = sent = self._clock.now()
        (length,) = self._link.ask("CAPTUREBYTES?")
        self._note(sent, length)
        return self._rate

    def relieve(self, overload: Overload) -> bool:
        """Increase input range or output scale by one step; False if not possible."""
        if overload & Overload.INPUT and self._range > 0:
            self._range -= 1
            self._link.send(f"IRNG {self._range}")
        elif overload & Overload.OUTPUT and self._scale > 0:
            self._scale -= 1
            self._link.send(f"SCAL {self._scale}")
        else:
            return False
        return True

    def sharpen(self, amplitude: float) -> bool:
        """Select the next finer scale if the amplitude [V] allows it; else False.

        The input range stays as the devices file or an overload has set it, since
        signals beside the modulation need it.
        """
        if self._scale == len(SCALES) - 1:
            return False
        if amplitude > _FINER_BELOW * self.full_scale():
            return False
        self._scale += 1
        self._link.send(f"SCAL {self._scale}")
        return True

    def full_scale(self) -> float:
        """Return the full scale of the present setting, as a peak amplitude [V]."""
        return math.sqrt(2) * SCALES[self._scale]
