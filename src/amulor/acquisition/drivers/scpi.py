"""Signal generators and laser drivers by commands that the devices file states."""

from __future__ import annotations

import contextlib
import math

from amulor.acquisition.clock import Clock
from amulor.acquisition.links.visa import Conversation
from amulor.acquisition.settings.light import (
    LaserSettings,
    ScpiLaserSettings,
    ScpiSourceSettings,
    SourceSettings,
)
from amulor.errors import InstrumentError


class _Scpi:
    """An instrument that says who it is when asked by ``*IDN?``.

    Parameters
    ----------
    link : Conversation
        An open link.
    words : object
        Its commands; `lock` is asked before anything is set.
    """

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
        """Let others drive it, and close the link."""
        if self._unlock is not None:
            with contextlib.suppress(InstrumentError):
                self._link.send(self._unlock)
            self._unlock = None
        self._link.close()

    def _say(self, lines: tuple[str, ...]) -> None:
        for line in lines:
            self._link.send(line)

    def _answer(self, question: str) -> str:
        (answer,) = self._link.ask(question)
        return answer.strip()


class ScpiSource(_Scpi):
    """A signal generator that modulates the laser.

    Parameters
    ----------
    link : Conversation
        An open link.
    settings : SourceSettings
        Its commands, and the amplitude.
    clock : Clock
        What waits go by.
    """

    def __init__(
        self, link: Conversation, settings: SourceSettings, *, clock: Clock
    ) -> None:
        super().__init__(link, settings.scpi)
        self._settings, self._words, self._clock = settings, settings.scpi, clock
        self._puts_out = False
        assert settings.amplitude is not None
        self._say(self._words.off)
        self._say(self._words.prepare)
        self._say((self._words.amplitude.format(value=settings.amplitude),))
        self._refuse_error("its amplitude")

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Put out a modulation frequency [Hz]; return what the generator says [Hz]."""
        self._say((self._words.frequency.format(value=frequency),))
        if not self._puts_out:
            self._say(self._words.on)
            self._puts_out = True
        self._refuse_error(f"{frequency:g} Hz")
        answer = self._answer(self._words.frequency_read)
        try:
            found = float(answer)
        except ValueError:
            found = math.nan
        if not math.isclose(found, frequency, rel_tol=1e-3):
            raise InstrumentError(
                f"the source at {self._link.address} was set to {frequency:g} Hz and "
                f"says {answer!r}; see its range and source.scpi of the devices file"
            )
        self._clock.sleep(self._settings.settling)
        return found

    def make_safe(self) -> None:
        """Put nothing out, over a new link if the old one is lost."""
        self._puts_out = False
        try:
            self._say(self._words.off)
            self._answer("*IDN?")
        except InstrumentError:
            self._link.reopen()
            self._say(self._words.off)
            self._answer("*IDN?")

    def _refuse_error(self, what: str) -> None:
        if self._words.error is None:
            return
        answer = self._answer(self._words.error)
        if not answer.startswith(self._words.no_error):
            raise InstrumentError(
                f"the source at {self._link.address} refused {what}: {answer}; see "
                "source.scpi and source.amplitude of the devices file"
            )


class ScpiLaser(_Scpi):
    """A laser diode driver, or anything that lets light out by commands.

    Parameters
    ----------
    link : Conversation
        An open link.
    settings : LaserSettings
        Its commands.
    """

    def __init__(self, link: Conversation, settings: LaserSettings) -> None:
        assert settings.scpi is not None
        super().__init__(link, settings.scpi)
        self._words = settings.scpi

    def on(self) -> None:
        """Let light out, if the interlock is closed."""
        self.check()
        self._say(self._words.prepare or ())
        self._say(self._words.on)
        if self._words.error is not None:
            answer = self._answer(self._words.error)
            if not answer.startswith(self._words.no_error or "0"):
                raise InstrumentError(
                    f"the laser at {self._link.address} has refused to be switched on: "
                    f"{answer}; see laser.scpi of the devices file"
                )

    def readings(self) -> dict[str, float]:
        """Return current [A] and temperature [degC], as far as they are asked for."""
        found = {}
        for name, question in (
            ("laser_current", self._words.current),
            ("laser_temperature", self._words.temperature),
        ):
            if question is None:
                continue
            answer = self._answer(question)
            try:
                found[name] = float(answer)
            except ValueError:
                found[name] = math.nan
            if not math.isfinite(found[name]):
                raise InstrumentError(
                    f"the laser at {self._link.address} has answered {question!r} by "
                    f"{answer!r}, needed is a number; see laser.scpi"
                )
        return found

    def off(self) -> None:
        """Let no light out, and read back that it is so."""
        self._say(self._words.off)
        answer = self._answer(self._words.state)
        if answer != self._words.is_off:
            raise InstrumentError(
                f"the laser at {self._link.address} answers {answer!r} to "
                f"{self._words.state} and not {self._words.is_off!r}: it may be on; "
                "switch it off by hand"
            )

    def check(self) -> None:
        """Raise if the interlock is open."""
        if self._words.interlock is None:
            return
        answer = self._answer(self._words.interlock)
        if answer != self._words.interlock_closed:
            raise InstrumentError(
                f"the interlock of the laser is open: {self._link.address} answers "
                f"{answer!r} to {self._words.interlock}; see who opened it and why"
            )

    def make_safe(self) -> None:
        """Let no light out, over a new link if the old one is lost."""
        try:
            self.off()
        except InstrumentError:
            self._link.reopen()
            self.off()
