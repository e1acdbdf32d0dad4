"""Generators, laser drivers and lock-ins with SCPI commands from the devices file."""

from __future__ import annotations

import contextlib
import math

from amulor.acquisition.clock import Clock, Deadline
from amulor.acquisition.links.lines import Conversation
from amulor.acquisition.protocols import Overload, Reading
from amulor.acquisition.settings.parts import (
    LaserSettings,
    ScpiLaserSettings,
    ScpiLockInSettings,
    ScpiSourceSettings,
    SourceSettings,
)
from amulor.errors import InstrumentError


class _Scpi:
    """SCPI instrument that answers ``*IDN?``, locked for one program if configured."""

    def __init__(
        self, link: Conversation, words: ScpiLaserSettings | ScpiSourceSettings
    ) -> None:
        self._link = link
        self._unlock: str | None = None
        (self._identity,) = link.ask("*IDN?")
        if words.lock is not None:
            answer = self._answer(words.lock)
            if answer != (words.lock_granted or "1"):
                raise InstrumentError(
                    f"{self._identity} at {link.address} answers {answer!r} to "
                    f"{words.lock}: another program, maybe on another computer, drives "
                    "it; wait for that, or stop it"
                )
            self._unlock = words.unlock

    def identity(self) -> str:
        """Return maker, model, serial number and firmware."""
        return self._identity

    def close(self) -> None:
        """Release the lock on the instrument, and close the link."""
        if self._unlock is not None:
            with contextlib.suppress(InstrumentError):
                self._link.send(self._unlock)
            self._unlock = None
        self._link.close()

    def _send(self, lines: tuple[str, ...]) -> None:
        for line in lines:
            self._link.send(line)

    def _answer(self, question: str) -> str:
        (answer,) = self._link.ask(question)
        return answer.strip()


class ScpiSource(_Scpi):
    """Signal generator that modulates the laser, with configured commands."""

    def __init__(
        self, link: Conversation, settings: SourceSettings, *, clock: Clock
    ) -> None:
        super().__init__(link, settings.scpi)
        self._settings, self._words, self._clock = settings, settings.scpi, clock
        self._puts_out = False
        assert settings.amplitude is not None
        self._send(self._words.off)
        self._send(self._words.prepare)
        self._send((self._words.amplitude.format(value=settings.amplitude),))
        self._refuse_error("its amplitude")

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Output a modulation frequency [Hz]; return the read-back [Hz]."""
        self._send((self._words.frequency.format(value=frequency),))
        if not self._puts_out:
            self._send(self._words.on)
            self._puts_out = True
        self._refuse_error(f"{frequency:g} Hz")
        answer = self._answer(self._words.frequency_read)
        try:
            actual = float(answer)
        except ValueError:
            actual = math.nan
        if not math.isclose(actual, frequency, rel_tol=1e-3):
            raise InstrumentError(
                f"the source at {self._link.address} was set to {frequency:g} Hz and "
                f"says {answer!r}; see its range and source.scpi of the devices file"
            )
        self._clock.sleep(self._settings.settling)
        return actual

    def make_safe(self) -> None:
        """Switch the output off, through a new link if the old link is broken."""
        self._puts_out = False
        try:
            self._send(self._words.off)
            self._answer("*IDN?")
        except InstrumentError:
            self._link.reopen()
            self._send(self._words.off)
            self._answer("*IDN?")

    def _refuse_error(self, setting: str) -> None:
        if self._words.error is None:
            return
        answer = self._answer(self._words.error)
        if not answer.startswith(self._words.no_error):
            raise InstrumentError(
                f"the source at {self._link.address} refused {setting}: {answer}; see "
                "source.scpi and source.amplitude of the devices file"
            )


class ScpiLaser(_Scpi):
    """Laser diode driver or shutter, with commands from the devices file."""

    def __init__(self, link: Conversation, settings: LaserSettings) -> None:
        assert settings.scpi is not None
        super().__init__(link, settings.scpi)
        self._words = settings.scpi

    def on(self) -> None:
        """Switch the laser on; raise if the interlock is open."""
        self.check()
        self._send(self._words.prepare or ())
        self._send(self._words.on)
        if self._words.error is not None:
            answer = self._answer(self._words.error)
            if not answer.startswith(self._words.no_error or "0"):
                raise InstrumentError(
                    f"the laser at {self._link.address} has refused to be switched on: "
                    f"{answer}; see laser.scpi of the devices file"
                )
        # Answered after the commands were executed; light may come later.
        self._answer(self._words.state)

    def readings(self) -> dict[str, float]:
        """Return diode current [A] and temperature [degC], where configured."""
        values = {}
        for name, question in (
            ("laser_current", self._words.current),
            ("laser_temperature", self._words.temperature),
        ):
            if question is None:
                continue
            answer = self._answer(question)
            try:
                values[name] = float(answer)
            except ValueError:
                values[name] = math.nan
            if not math.isfinite(values[name]):
                raise InstrumentError(
                    f"the laser at {self._link.address} has answered {question!r} by "
                    f"{answer!r}, needed is a number; see laser.scpi"
                )
        return values

    def off(self) -> None:
        """Switch the laser off; raise if its state is not off."""
        self._send(self._words.off)
        answer = self._answer(self._words.state)
        if answer != self._words.is_off:
            raise InstrumentError(
                f"the laser at {self._link.address} answers {answer!r} to "
                f"{self._words.state} and not {self._words.is_off!r}: it may be on; "
                "switch it off by hand"
            )

    def check(self) -> None:
        """Raise if the laser interlock is open."""
        if self._words.interlock is None:
            return
        answer = self._answer(self._words.interlock)
        if answer != self._words.interlock_closed:
            raise InstrumentError(
                f"the interlock of the laser is open: {self._link.address} answers "
                f"{answer!r} to {self._words.interlock}; see who opened it and why"
            )

    def make_safe(self) -> None:
        """Switch the laser off, through a new link if the old link is broken."""
        try:
            self.off()
        except InstrumentError:
            self._link.reopen()
            self.off()


_POLL = 0.01
#: Fraction of the next finer full scale up to which it is selected.
_FINER_BELOW = 0.5


class ScpiLockIn:
    """Lock-in amplifier with commands from the devices file."""

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
        # Coarse scales first, in whatever order of codes.
        self._order = sorted(
            range(len(words.scales)), key=words.scales.__getitem__, reverse=True
        )
        self._place = 0
        self._frequency = math.nan

    def identity(self) -> str:
        """Return maker, model, serial number and firmware."""
        return self._identity

    def prepare(self, *, time_constant: float) -> None:
        """Send preparation commands, time constant [s] and the coarsest scale."""
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
        """Set the modulation frequency, wait for lock, return the actual one [Hz]."""
        words = self._words
        if not self._external:
            self._link.send(words.frequency.format(value=frequency))
        end = Deadline(self._clock, timeout)
        self._status()  # clears earlier status bits
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
        """Return the present outputs, overload bits and lock state."""
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
        """Select the next coarser scale; False if there is none."""
        if self._words.scale is None or self._place == 0:
            return False
        self._set_scale(self._place - 1)
        return True

    def sharpen(self, amplitude: float) -> bool:
        """Select the next finer scale if the amplitude [V] allows it; else False."""
        if self._words.scale is None or self._place == len(self._order) - 1:
            return False
        if amplitude > _FINER_BELOW * self._peak(self._place + 1):
            return False
        self._set_scale(self._place + 1)
        return True

    def full_scale(self) -> float:
        """Return the full scale of the present setting, as a peak amplitude [V]."""
        return self._peak(self._place)

    def set_output(self, number: int, voltage: float) -> float:
        """Set the voltage of auxiliary output 1, 2, ...; return its read-back [V]."""
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
        """Do nothing: a lock-in is harmless; the laser has its own safe state."""

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
            numbers = [float(part) for part in answer.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) != count or not all(map(math.isfinite, numbers)):
            raise InstrumentError(
                f"{self._identity} has answered {question!r} by {answer!r}, needed are "
                f"{count} numbers; see lock_in.scpi of the devices file"
            )
        return numbers
