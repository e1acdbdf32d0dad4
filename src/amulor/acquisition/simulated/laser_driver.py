"""A simulated laser diode driver that takes SCPI commands, in front of a bench."""

from __future__ import annotations

import re
from collections.abc import Callable

from amulor.acquisition.protocols import SIMULATOR
from amulor.acquisition.simulated.bench import Bench

#: Current and temperature after *RST [A], [degC], and how fast the current comes [A/s].
_CURRENT, _TEMPERATURE = 0.08, 25.0
#: How much warmer the diode is with light, and how fast it becomes so [K], [s].
_WARMER, _WARMING = 0.5, 10.0


class SimulatedLaserDriver:
    """Current source and temperature controller; an open interlock switches off.

    Parameters
    ----------
    bench : Bench
        Whose laser it drives.
    """

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.lines: list[str] = []
        self._errors: list[str] = []
        self._set = _CURRENT
        self._on, self._since = False, 0.0
        self._answers: dict[str, Callable[[], str]] = {
            "*IDN?": lambda: f"amulor,laser diode driver,0,{SIMULATOR}",
            "OUTP?": lambda: str(int(self._lit())),
            "SOUR:CURR?": lambda: f"{self._set:.6e}",
            "MEAS:CURR?": lambda: f"{self._set * self._lit():.6e}",
            "MEAS:TEMP?": lambda: f"{self._temperature():.3f}",
            "INP:ILOCK?": lambda: str(int(self.bench.interlock_is_closed)),
            "SYST:ERR?": lambda: (
                self._errors.pop(0) if self._errors else '0,"No error"'
            ),
        }

    def answer(self, line: str) -> list[str]:
        """Return the answers to one line."""
        self.lines.append(line)
        if line in self._answers:
            return [self._answers[line]()]
        if line == "OUTP ON" and not self.bench.interlock_is_closed:
            self._errors.append('-221,"Settings conflict; interlock open"')
        elif line in ("OUTP ON", "OUTP OFF"):
            self._on, self._since = line == "OUTP ON", self.bench.clock.now()
            self.bench.set_laser(self._on)
        elif found := re.fullmatch(r"SOUR:CURR ([0-9.eE+-]+)", line):
            self._set = float(found[1])
        else:
            self._errors.append('-113,"Undefined header"')
        return []

    def _lit(self) -> bool:
        if self._on and not self.bench.interlock_is_closed:
            self._on = False
            self.bench.set_laser(False)
        return self._on

    def _temperature(self) -> float:
        passed = self.bench.clock.now() - self._since
        return _TEMPERATURE + _WARMER * min(passed / _WARMING, 1.0) * self._lit()
