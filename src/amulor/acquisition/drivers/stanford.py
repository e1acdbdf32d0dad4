"""Lock-in amplifiers of Stanford Research: their common commands, and the SR844."""

from __future__ import annotations

import math
from collections.abc import Sequence

from amulor.acquisition.clock import Clock, Deadline
from amulor.acquisition.links.lines import Conversation
from amulor.acquisition.protocols import Overload, Reading
from amulor.errors import InstrumentError

#: Bits of the standard event register: execution error and command error.
_ERROR_BITS = 0b0011_0000


class Stanford:
    """Commands shared by Stanford lock-ins: identity, queries, auxiliary channels."""

    model = ""
    #: Line end on a serial port.
    serial_end = "\n"
    #: Number of auxiliary inputs.
    _inputs = 0
    #: Number of the first auxiliary output in commands, and count of outputs.
    _first_output, _outputs = 1, 0
    _set_output = ""
    #: Query of an auxiliary input, and number of the first one.
    _get_input, _first_input = "", 1

    def __init__(
        self,
        link: Conversation,
        *,
        mean_output_input: int | None,
        clock: Clock,
        external: bool = False,
    ) -> None:
        if mean_output_input is not None and not 1 <= mean_output_input <= self._inputs:
            raise InstrumentError(
                f"{self.model} has auxiliary inputs 1 to {self._inputs}, stated is "
                f"{mean_output_input}; wire another one, and change "
                "lock_in.mean_output_input"
            )
        self._link = link
        self._clock = clock
        self._mean_input = mean_output_input
        self._external = external
        self._choose_interface()
        self._identity = self._identify()

    def identity(self) -> str:
        """Return maker, model, serial number and firmware."""
        return self._identity

    def set_output(self, number: int, voltage: float) -> float:
        """Set the voltage of auxiliary output 1, 2, ...; return its read-back [V]."""
        if not 1 <= number <= self._outputs:
            raise InstrumentError(
                f"{self.model} has auxiliary outputs 1 to {self._outputs}, asked for "
                f"was {number}; wire another one, and change laser.output"
            )
        word, code = self._set_output, number - 1 + self._first_output
        return self.number(f"{word} {code},{voltage:.3f};{word}? {code}")

    def input(self, number: int) -> float:
        """Return the voltage at auxiliary input 1, 2, ... [V]."""
        if not 1 <= number <= self._inputs:
            raise InstrumentError(
                f"{self.model} has auxiliary inputs 1 to {self._inputs}, asked for was "
                f"{number}; wire another one, and change laser.interlock_input"
            )
        return self.number(f"{self._get_input}? {number - 1 + self._first_input}")

    def reconnect(self) -> None:
        """Open the link again after it was lost."""
        self._link.reopen()
        self._choose_interface()

    def make_safe(self) -> None:
        """Do nothing: a lock-in is harmless; the laser has its own safe state."""

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def number(self, line: str) -> float:
        """Return the numeric answer of a query."""
        return self.numbers(line, count=1)[0]

    def numbers(self, line: str, *, count: int) -> list[float]:
        """Return the comma-separated numbers of the answer to a query."""
        (answer,) = self._link.ask(line)
        return self.parsed(answer, line, count=count)

    def parsed(self, answer: str, line: str, *, count: int) -> list[float]:
        """Return the numbers in an answer; raise if it has other content."""
        try:
            result = [float(part) for part in answer.split(",")]
        except ValueError:
            result = []
        if len(result) != count or not all(map(math.isfinite, result)):
            raise InstrumentError(
                f"{self.model} at {self._link.address} has answered {line!r} by "
                f"{answer!r}, needed are {count} numbers; switch it off and on"
            )
        return result

    def configure(self, lines: Sequence[str]) -> None:
        """Send setting commands; raise if the instrument refuses any."""
        for line in lines:
            self._link.send(line)
        status = int(self.number("*ESR?"))
        if status & _ERROR_BITS:
            raise InstrumentError(
                f"{self.model} at {self._link.address} refused one of "
                f"{'; '.join(lines)} (event status {status}); check its firmware"
            )

    def index_of(
        self, requested: float, offered: Sequence[float], quantity: str, unit: str = "s"
    ) -> int:
        """Return the instrument's index code for the requested value of a setting."""
        for code, value in enumerate(offered):
            if math.isclose(value, requested, rel_tol=1e-6):
                return code
        closest = sorted(offered, key=lambda value: abs(math.log(value / requested)))[
            :2
        ]
        raise InstrumentError(
            f"{self.model} has no {quantity} of {requested:g} {unit}; it has "
            f"{min(closest):g} {unit} and {max(closest):g} {unit}: change "
            f"{'instrument.lock_in of the survey' if unit == 's' else 'the setting'}"
        )

    def _choose_interface(self) -> None:
        """Make the instrument send its answers to this link."""

    def _identify(self) -> str:
        (result,) = self._link.ask("*IDN?")
        parts = [part.strip() for part in result.split(",")]
        if len(parts) < 2 or parts[1] != self.model:
            raise InstrumentError(
                f"at {self._link.address} is {result!r}, needed is {self.model}; check "
                "the address"
            )
        return result


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
#: Further bits of LIAS?: display or output of either channel, either auxiliary input.
CHANNEL_1, CHANNEL_2, AUXILIARY = 256, 512, 1024
_FREQUENCIES = (25e3, 200e6)
#: Reserves by the codes of WRSV and CRSV: the first is the largest.
_HIGH, _NORMAL = 0, 1
_POLL = 0.01
#: Fraction of the full scale below which a finer scale is selected; the steps are 3.2.
_FINER_BELOW = 0.2


class Sr844(Stanford):
    """Lock-in amplifier SR844, with an internal or an external reference.

    The commands are those of chapter 4 of its manual: syntax (4-8, 4-10), SNAP? (4-25,
    4-26), LIAS? (4-32). Its outputs are in volts rms, with a phase that falls with
    delay; readings are peak amplitudes with a phase that rises with delay.

    Answers go to the interface set by OUTX (4-10), which is sent first: 1 for GPIB, 0
    for the serial port, also behind a network converter. With ASCII the instrument
    gives about 60 readings a second.
    """

    model = "SR844"
    serial_end = "\r"  # so it ends its answers (manual, page 4-8)
    _inputs, _outputs = 2, 2
    _set_output = "AUXO"
    _get_input = "AUXI"

    def _choose_interface(self) -> None:
        """Make the instrument send its answers to this link (manual, page 4-10)."""
        self._link.send(f"OUTX {int('GPIB' in self._link.address.upper())}")

    def prepare(self, *, time_constant: float) -> None:
        """Set the reference, a one-pole output filter and the time constant [s]."""
        code = self.index_of(time_constant, TIME_CONSTANTS, "time constant")
        self._sensitivity = len(SENSITIVITIES) - 1
        self._wide = self._close = _NORMAL
        # After *RST, the answer to SNAP? contains neither ratio nor offset.
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
        """Set the modulation frequency, wait for lock, return the actual one [Hz]."""
        low, high = _FREQUENCIES
        if not low <= frequency <= high:
            raise InstrumentError(
                f"SR844 has no {frequency:g} Hz, it goes from {low:g} to {high:g} Hz; "
                "change the modulation frequencies of the survey"
            )
        if not self._external:
            self._link.send(f"FREQ {frequency:.6g}")
        end = Deadline(self._clock, timeout)
        self.number("LIAS?")  # clears earlier status bits
        while int(self.number("LIAS?")) & (UNLOCKED | OUT_OF_RANGE):
            if end.passed():
                raise InstrumentError(
                    f"SR844 has not locked to {frequency:g} Hz within {timeout:g} s; "
                    "see its reference display"
                )
            self._clock.sleep(_POLL)
        return self.number("FREQ?")

    def read(self) -> Reading:
        """Return the present outputs, overload bits and lock state."""
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
        """Increase the reserve or full scale by one step; False if at the maximum."""
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
        """Select the next finer scale if the amplitude [V] allows it; else False."""
        if self._sensitivity == 0 or amplitude > _FINER_BELOW * self.full_scale():
            return False
        self._sensitivity -= 1
        self._link.send(f"SENS {self._sensitivity}")
        return True

    def full_scale(self) -> float:
        """Return the full scale of the present setting, as a peak amplitude [V]."""
        return math.sqrt(2) * SENSITIVITIES[self._sensitivity]
