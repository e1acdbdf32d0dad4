"""The SR865A lock-in amplifier, up to 4 MHz, as a conversation."""

from __future__ import annotations

import math

from amulor.acquisition.clock import Clock, Deadline
from amulor.acquisition.drivers.stanford import Stanford
from amulor.acquisition.links.visa import Conversation
from amulor.acquisition.protocols import Overload, Reading
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
#: Fraction of the full scale below which a finer one is taken; the steps are 2 and 2.5.
_FINER_BELOW = 0.3


class Sr865a(Stanford):
    """An SR865A, its oscillator as the reference.

    The commands are those of the remote programming chapter of its manual: RSRC, FREQ,
    OFLT, OFSL, SCAL, IRNG, SNAP?, LIAS?, AUXV. Outputs that the panel counts from 1 to
    4 are 0 to 3 in AUXV, as in the maker's own package srsinst.sr860. It counts in
    volts rms and its phase falls with delay; readings are peak amplitudes whose phase
    rises with delay.

    Parameters
    ----------
    link : Conversation
        An open link.
    mean_output_input : int or None
        Auxiliary input that the mean output of the detector is wired to [1].
    modulation_amplitude : float
        Root mean square of the modulation output [V].
    clock : Clock
        What waits go by.
    external : bool
        Whether the frequency comes from a generator at the reference input.
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
        clock: Clock,
        external: bool = False,
    ) -> None:
        super().__init__(
            link,
            mean_output_input=mean_output_input,
            clock=clock,
            external=external,
        )
        self._amplitude = modulation_amplitude

    def prepare(self, *, time_constant: float) -> None:
        """Set internal reference, one-pole output filter and time constant [s]."""
        code = self.index_of(time_constant, TIME_CONSTANTS, "time constant")
        self._scale = self._range = 0
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
        """Set the modulation frequency [Hz], wait for lock, return what is set [Hz]."""
        low, high = _FREQUENCIES
        if not low <= frequency <= high:
            raise InstrumentError(
                f"SR865A has no {frequency:g} Hz, it goes from {low:g} to {high:g} Hz; "
                "change the modulation frequencies of the survey"
            )
        if not self._external:
            self._link.send(f"FREQ {frequency:.7g}")
        end = Deadline(self._clock, timeout)
        self.number("LIAS?")  # clears what was before
        while int(self.number("LIAS?")) & UNLOCKED:
            if end.passed():
                raise InstrumentError(
                    f"SR865A has not locked to {frequency:g} Hz within {timeout:g} s"
                )
            self._clock.sleep(_POLL)
        self._frequency = self.number("FREQEXT?" if self._external else "FREQ?")
        return self._frequency

    def read(self) -> Reading:
        """Return the outputs and the state of this instant."""
        values = "0,1" if self._mean_input is None else f"0,1,{3 + self._mean_input}"
        line = f"SNAP? {values}"
        snapshot, status = self._link.ask(f"{line}\nLIAS?", answers=2)
        result = self.parsed(snapshot, line, count=values.count(",") + 1)
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

    def relieve(self, overload: Overload) -> bool:
        """Take one step that makes room: IRNG for the input, SCAL for the outputs."""
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
        """Take the next finer SCAL if this peak amplitude [V] leaves room.

        The input range is left alone: what is beside the modulation needs it.
        """
        if self._scale == len(SCALES) - 1:
            return False
        if amplitude > _FINER_BELOW * self.full_scale():
            return False
        self._scale += 1
        self._link.send(f"SCAL {self._scale}")
        return True

    def full_scale(self) -> float:
        """Return the largest peak amplitude of the present setting [V]."""
        return math.sqrt(2) * SCALES[self._scale]
