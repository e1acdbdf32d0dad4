"""What simulated Stanford lock-ins share: settings by code, latching status, gate."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

from amulor.acquisition.links.tcp import LinkLostError
from amulor.acquisition.protocols import SIMULATOR
from amulor.acquisition.simulated.bench import Bench

#: Voltage of the laser's gate from which on light is let out [V].
_GATE = 2.0
#: Bits of *ESR?: a command that is not known, a value that is not allowed.
_COMMAND_ERROR, _EXECUTION_ERROR = 32, 16


class SimulatedStanford:
    """What both models share: settings by code, the status that latches, the gate.

    Parameters
    ----------
    bench : Bench
        What the lock-in measures.
    """

    model = ""
    unlocked_bit = 0
    #: What commands call the auxiliary outputs, in the order of the panel.
    outputs: tuple[int, ...] = ()
    #: Highest code of each setting.
    codes: dict[str, int] = {}  # noqa: RUF012  replaced as a whole by each model

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.lines: list[str] = []
        self._lock = threading.Lock()
        self._handlers: dict[str, Callable[[str], list[str]]] = {
            "*IDN?": lambda _: [
                f"Stanford_Research_Systems,{self.model},s/n00000,{SIMULATOR}"
            ],
            "*RST": self._reset,
            "*CLS": lambda _: self._clear(),
            "*ESR?": lambda _: [str(self._taken_error())],
            "LIAS?": lambda _: [str(self._taken_status())],
            "FREQ": self._set_frequency,
            "FREQ?": lambda _: [f"{self.bench.frequency:.6E}"],
            "PHAS": lambda _: [],
            "SNAP?": self._snapshot,
            "AUXO": self._set_output,
            "AUXO?": self._output,
        }
        self._reset("")

    def answer(self, line: str) -> list[str]:
        """Return the answers to one line, which may hold several commands."""
        with self._lock:
            self.lines.append(line)
            del self.lines[:-1000]
            result: list[str] = []
            for command in line.split(";"):
                answers = self._one(command.strip())
                if answers is None:  # silent from here on: it "does not answer"
                    return []
                result += answers
            return result

    def _one(self, command: str) -> list[str] | None:
        for end in (5, 4):
            word = command[:end].upper()
            if word in self._handlers:
                argument = command[end:].strip()
                break
            if word.rstrip("?") in self.codes and len(word.rstrip("?")) == 4:
                return self._code(word, command[end:].strip())
        else:
            self._error |= _COMMAND_ERROR
            return []
        number = self.bench.readings + 1
        if word == "SNAP?" and self.bench.faults.active("lost-link", number):
            self.bench.readings += 1
            raise LinkLostError
        if word == "SNAP?" and self.bench.faults.active("timeout", number):
            self.bench.readings += 1
            return None
        try:
            return self._handlers[word](argument)
        except (ValueError, LookupError):
            self._error |= _EXECUTION_ERROR
            return []

    def _code(self, word: str, argument: str) -> list[str]:
        name = word.rstrip("?")
        if word.endswith("?"):
            return [str(self._set[name])]
        if not argument.isdigit() or int(argument) > self.codes[name]:
            self._error |= _EXECUTION_ERROR
            return []
        self._set[name] = int(argument)
        if name == "OFLT":
            self.bench.set_time_constant(self._time_constant(int(argument)))
        return []

    def _reset(self, _: str) -> list[str]:
        self._set = dict.fromkeys(self.codes, 0)
        self._outputs = dict.fromkeys(self.outputs, 0.0)
        self._status = self._error = 0
        self.bench.set_laser(False)
        return []

    def _clear(self) -> list[str]:
        self._status = self._error = 0
        return []

    def _taken_error(self) -> int:
        result, self._error = self._error, 0
        return result

    def _taken_status(self) -> int:
        result, self._status = self._status, 0
        if not self.bench.locked():
            result |= self.unlocked_bit
        return result

    def _set_frequency(self, argument: str) -> list[str]:
        self.bench.set_frequency(self._rounded(float(argument)))
        self._status |= self.unlocked_bit
        return []

    def _set_output(self, argument: str) -> list[str]:
        number, voltage = argument.split(",")
        code = self.outputs.index(int(number))
        self._outputs[int(number)] = float(voltage)
        if code == 0:  # the laser is wired to the first one
            self.bench.set_laser(float(voltage) > _GATE)
        return []

    def _output(self, argument: str) -> list[str]:
        return [f"{self._outputs[int(argument)]:.3f}"]

    def _measured(self) -> tuple[float, float, float]:
        """Return X and Y [V rms] and the mean output [V], and latch what is wrong."""
        signal, mean = self.bench.output()
        faults, number = self.bench.faults, self.bench.readings
        if faults.active("unlock", number):
            self._status |= self.unlocked_bit
        x, y = signal.real / math.sqrt(2), -signal.imag / math.sqrt(2)
        self._latch(math.hypot(x, y), faults.active("overload", number))
        return x, y, mean

    def _snapshot(self, argument: str) -> list[str]:
        raise NotImplementedError

    def _latch(self, amplitude: float, overloaded: bool) -> None:
        raise NotImplementedError

    def _rounded(self, frequency: float) -> float:
        raise NotImplementedError

    def _time_constant(self, code: int) -> float:
        raise NotImplementedError
