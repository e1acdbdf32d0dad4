"""The SR844 RF lock-in amplifier, 25 kHz to 200 MHz, as a conversation."""

from __future__ import annotations

import math

from amulor.acquisition.clock import Deadline
from amulor.acquisition.drivers.stanford import Stanford
from amulor.acquisition.protocols import Overload, Reading
from amulor.errors import InstrumentError

#: Time constants by the code of OFLT [s].
TIME_CONSTANTS = tuple(
    factor * 10.0**exponent for exponent in range(-4, 5) for factor in (1, 3)
)
#: Full scales by the code of SENS, as the instrument counts them [V rms].
SENSITIVITIES = tuple(
    [factor * 10.0**exponent for exponent in range(-7, 0) for factor in (1, 3)] + [1.0]
)
#: Bits of LIAS? (manual, page 4-32).
UNLOCKED, OUT_OF_RANGE, INPUT, RESERVE, FILTER = 1, 2, 16, 32, 64
#: More of them: display or output of either channel, either auxiliary input.
CHANNEL_1, CHANNEL_2, AUXILIARY = 256, 512, 1024
_FREQUENCIES = (25e3, 200e6)
#: Reserves by the codes of WRSV and CRSV: the first has the most room.
_HIGH, _NORMAL = 0, 1
_POLL = 0.01
#: Fraction of the full scale below which a finer one is taken; the steps are 3.2.
_FINER_BELOW = 0.2


class Sr844(Stanford):
    """An SR844, its oscillator as the reference.

    The commands are those of chapter 4 of its manual: syntax (4-8, 4-10), SNAP? (4-25,
    4-26), LIAS? (4-32). It counts in volts rms and its phase falls with delay; readings
    are peak amplitudes whose phase rises with delay.

    Everything is answered over the interface that OUTX names (4-10), which is sent
    first: 1 for GPIB, 0 for the serial port, also behind a converter to a network. By
    ASCII it makes about 60 readings a second.
    """

    model = "SR844"
    serial_end = "\r"  # so it ends its answers (manual, page 4-8)
    _inputs, _outputs = 2, 2
    _set_output = "AUXO"
    _get_input = "AUXI"

    def _choose_interface(self) -> None:
        """Let answers come over this link (manual, page 4-10)."""
        self._link.send(f"OUTX {int('GPIB' in self._link.address.upper())}")

    def prepare(self, *, time_constant: float) -> None:
        """Set internal reference, one-pole output filter and time constant [s]."""
        code = self.index_of(time_constant, TIME_CONSTANTS, "time constant")
        self._sensitivity = len(SENSITIVITIES) - 1
        self._wide = self._close = _NORMAL
        # After *RST neither ratio nor offset is in what SNAP? answers.
        lines = [
            "*RST",
            f"FMOD {int(not self._external)}",
            "HARM 0",
            "PHAS 0",
            "OFSL 1",
            f"OFLT {code}",
        ]
        lines += [f"WRSV {self._wide}", f"CRSV {self._close}"]
        self.configure([*lines, f"SENS {self._sensitivity}"])

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Set the modulation frequency [Hz], wait for lock, return what is set [Hz]."""
        low, high = _FREQUENCIES
        if not low <= frequency <= high:
            raise InstrumentError(
                f"SR844 has no {frequency:g} Hz, it goes from {low:g} to {high:g} Hz; "
                "change the modulation frequencies of the survey"
            )
        if not self._external:
            self._link.send(f"FREQ {frequency:.6g}")
        end = Deadline(self._clock, timeout)
        self.number("LIAS?")  # clears what was before
        while int(self.number("LIAS?")) & (UNLOCKED | OUT_OF_RANGE):
            if end.passed():
                raise InstrumentError(
                    f"SR844 has not locked to {frequency:g} Hz within {timeout:g} s; "
                    "see its reference display"
                )
            self._clock.sleep(_POLL)
        return self.number("FREQ?")

    def read(self) -> Reading:
        """Return the outputs and the state of this instant."""
        values = (
            "1,2,8" if self._mean_input is None else f"1,2,8,{5 + self._mean_input}"
        )
        line = f"SNAP? {values};LIAS?"
        snapshot, status = self._link.ask(line, answers=2)
        result = self.parsed(snapshot, line, count=values.count(",") + 1)
        bits = int(self.parsed(status, line, count=1)[0])
        overload = Overload.NONE
        for bit, kind in (
            (INPUT, Overload.INPUT),
            (RESERVE, Overload.RESERVE),
            (FILTER | CHANNEL_1 | CHANNEL_2, Overload.OUTPUT),
        ):
            if bits & bit:
                overload |= kind
        if bits & AUXILIARY and self._mean_input is not None:
            overload |= Overload.MEAN
        return Reading(
            signal=math.sqrt(2) * complex(result[0], -result[1]),
            mean=math.nan if self._mean_input is None else result[3],
            modulation_frequency=result[2],
            overload=overload,
            unlocked=bool(bits & (UNLOCKED | OUT_OF_RANGE)),
        )

    def relieve(self, overload: Overload) -> bool:
        """Take one step that makes room: first the reserve that lacks it, then SENS."""
        if overload & Overload.INPUT and self._wide > _HIGH:
            self._wide -= 1
            self._link.send(f"WRSV {self._wide}")
        elif overload & Overload.RESERVE and self._close > _HIGH:
            self._close -= 1
            self._link.send(f"CRSV {self._close}")
        elif overload & ~Overload.MEAN and self._sensitivity < len(SENSITIVITIES) - 1:
            self._sensitivity += 1
            self._link.send(f"SENS {self._sensitivity}")
        else:
            return False
        return True

    def sharpen(self, amplitude: float) -> bool:
        """Take the next finer SENS if this peak amplitude [V] leaves room."""
        if self._sensitivity == 0 or amplitude > _FINER_BELOW * self.full_scale():
            return False
        self._sensitivity -= 1
        self._link.send(f"SENS {self._sensitivity}")
        return True

    def full_scale(self) -> float:
        """Return the largest peak amplitude of the present setting [V]."""
        return math.sqrt(2) * SENSITIVITIES[self._sensitivity]
