"""A lock-in amplifier by commands that the devices file states."""

from __future__ import annotations

import math

from amulor.acquisition.clock import Clock, Deadline
from amulor.acquisition.links.visa import Conversation
from amulor.acquisition.protocols import Overload, Reading
from amulor.acquisition.settings.lock_in import ScpiLockInSettings
from amulor.errors import InstrumentError

_POLL = 0.01
#: Part of the full scale below which a finer one is taken, and of which it leaves half.
_FINER_BELOW = 0.5


class ScpiLockIn:
    """A lock-in that is spoken to as a devices file says.

    Parameters
    ----------
    link : Conversation
        An open link.
    words : ScpiLockInSettings
        Its commands.
    clock : Clock
        What waits go by.
    external : bool
        Whether the frequency comes from a generator at the reference input.
    """

    def __init__(
        self,
        link: Conversation,
        words: ScpiLockInSettings,
        *,
        clock: Clock,
        external: bool = False,
    ) -> None:
        self._link, self._words, self._clock = link, words, clock
        self._external = external
        (self._identity,) = link.ask("*IDN?")
        # Coarse first, whatever the codes are.
        self._order = sorted(
            range(len(words.scales)), key=words.scales.__getitem__, reverse=True
        )
        self._place = 0
        self._frequency = math.nan

    def identity(self) -> str:
        """Return maker, model, serial number and firmware."""
        return self._identity

    def prepare(self, *, time_constant: float) -> None:
        """Send what a scan needs, the time constant [s], and the coarsest scale."""
        words = self._words
        code = None
        for number, value in enumerate(words.time_constants):
            if math.isclose(value, time_constant, rel_tol=1e-6):
                code = number
        if words.time_constants and code is None:
            raise InstrumentError(
                f"lock_in.scpi.time_constants has no {time_constant:g} s, which the "
                "survey asks for; change instrument.lock_in.time_constant"
            )
        for line in words.prepare:
            self._link.send(line)
        self._link.send(words.time_constant.format(value=time_constant, code=code))
        self._set_scale(0)
        if words.error is not None:
            (answer,) = self._link.ask(words.error)
            if not answer.startswith(words.no_error):
                raise InstrumentError(
                    f"{self._identity} has refused what prepares it: {answer}; see "
                    "lock_in.scpi of the devices file"
                )

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Set the modulation frequency [Hz], wait for lock, return what is set [Hz]."""
        words = self._words
        if not self._external:
            self._link.send(words.frequency.format(value=frequency))
        end = Deadline(self._clock, timeout)
        self._status()  # clears what was before
        while self._status() & words.unlocked:
            if end.passed():
                raise InstrumentError(
                    f"{self._identity} has not locked to {frequency:g} Hz within "
                    f"{timeout:g} s; see its reference"
                )
            self._clock.sleep(_POLL)
        (self._frequency,) = self._numbers(words.frequency_read, 1)
        return self._frequency

    def read(self) -> Reading:
        """Return the outputs and the state of this instant."""
        words = self._words
        x, y = self._numbers(words.read, 2)
        mean = math.nan if words.mean is None else self._numbers(words.mean, 1)[0]
        bits = self._status()
        overload = Overload.NONE
        if bits & words.input_overload:
            overload |= Overload.INPUT
        if bits & words.output_overload:
            overload |= Overload.OUTPUT
        peak = math.sqrt(2) if words.counts == "rms" else 1.0
        return Reading(
            signal=peak * complex(x, -y if words.phase == "falls" else y),
            mean=mean,
            modulation_frequency=self._frequency,
            overload=overload,
            unlocked=bool(bits & words.unlocked),
        )

    def relieve(self, overload: Overload) -> bool:
        """Take the next coarser scale, if there is one."""
        if self._words.scale is None or self._place == 0:
            return False
        self._set_scale(self._place - 1)
        return True

    def sharpen(self, amplitude: float) -> bool:
        """Take the next finer scale if this peak amplitude [V] leaves room in it."""
        if self._words.scale is None or self._place == len(self._order) - 1:
            return False
        if amplitude > _FINER_BELOW * self._peak(self._place + 1):
            return False
        self._set_scale(self._place + 1)
        return True

    def full_scale(self) -> float:
        """Return the largest peak amplitude of the present setting [V]."""
        return self._peak(self._place)

    def set_output(self, number: int, voltage: float) -> float:
        """Set an auxiliary output, counted from 1 [V]; return what is read back [V]."""
        words = self._words
        if words.output is None or words.output_read is None:
            raise InstrumentError(
                "lock_in.scpi states no auxiliary output; add output and output_read, "
                "or choose another laser.driver"
            )
        code = number - 1 + words.first_output
        self._link.send(words.output.format(code=code, value=voltage))
        return self._numbers(words.output_read.format(code=code), 1)[0]

    def reconnect(self) -> None:
        """Open the link again after it was lost."""
        self._link.reopen()

    def make_safe(self) -> None:
        """Do nothing: a lock-in without light is safe; the laser's gate is its own."""

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def _peak(self, place: int) -> float:
        scale = self._words.scales[self._order[place]]
        return scale * (math.sqrt(2) if self._words.counts == "rms" else 1.0)

    def _set_scale(self, place: int) -> None:
        self._place = place
        if self._words.scale is not None:
            code = self._order[place]
            value = self._words.scales[code]
            self._link.send(self._words.scale.format(code=code, value=value))

    def _status(self) -> int:
        if self._words.status is None:
            return 0
        return int(self._numbers(self._words.status, 1)[0])

    def _numbers(self, question: str, count: int) -> list[float]:
        (answer,) = self._link.ask(question)
        try:
            found = [float(part) for part in answer.split(",")]
        except ValueError:
            found = []
        if len(found) != count or not all(map(math.isfinite, found)):
            raise InstrumentError(
                f"{self._identity} has answered {question!r} by {answer!r}, needed are "
                f"{count} numbers; see lock_in.scpi of the devices file"
            )
        return found
