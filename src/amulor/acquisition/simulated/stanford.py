"""Simulated lock-ins of Stanford Research: their common commands, and the SR844."""

from __future__ import annotations

import cmath
import functools
import math
import re
import threading
from collections.abc import Callable, Sequence
from typing import NamedTuple

from amulor.acquisition.links.tcp import LinkLostError
from amulor.acquisition.protocols import SIMULATOR
from amulor.acquisition.simulated.bench import Bench

#: Voltage of the interlock's monitor while it is closed [V], and the auxiliary input
#: that it is wired to.
INTERLOCK = 5.0
INTERLOCK_INPUT = 2
#: Threshold voltage of the laser gate [V].
_GATE = 2.0
#: Bits of *ESR?: unknown command, refused value.
_COMMAND_ERROR, _EXECUTION_ERROR = 32, 16
#: Bits of *STB?: error, lock-in status, standard event.
_ERRORS, _LOCK_IN, _EVENTS = 4, 8, 32
#: Lines from clients in memory.
_MOST_LINES = 1000
_COMMAND = re.compile(r"(?P<word>[*A-Z]+)\s*(?P<query>\?)?\s*(?P<rest>.*)")
#: Bit of *STB? that requests service, and bits of status registers.
_SERVICE, _BITS = 64, {"LIAS": 16, "LIAE": 16}


class Setting(NamedTuple):
    """Setting of an instrument with numbered choices."""

    last: int = 0
    """Highest code of a choice."""
    words: tuple[str, ...] = ()
    """Name of each code; required letters in capitals, such as "DIFference"."""
    first: int = 0
    """Lowest code, which *RST sets."""


class Number(NamedTuple):
    """Setting of an instrument with a numeric value, for one or more channels."""

    low: float
    high: float
    after_reset: float = 0.0
    channels: int = 0
    """Number of channels, counted from 0; 0 for a setting without channels."""


class SimulatedStanford:
    """Simulated commands common to SR844 and SR865A: settings, status, laser gate."""

    model = ""
    unlocked_bit = 0
    #: Lowest and highest modulation frequency [Hz].
    frequencies = (0.0, math.inf)
    #: Form of a command.
    command = _COMMAND
    #: Commands without a parameter.
    bare: tuple[str, ...] = ("*IDN?", "*RST", "*CLS", "*OPC?", "*TST?", "FREQ?")
    #: Whether the answers to one line are sent as one line, with semicolons.
    joins_answers = False
    #: Bits of *STB? without any event.
    idle_status = 0
    #: Numbers of the auxiliary outputs in commands, in the order of the panel, and
    #: their largest voltage either way [V].
    outputs: tuple[int, ...] = ()
    largest_output = 10.5
    #: Settings by code.
    settings: dict[str, Setting] = {}  # noqa: RUF012  replaced as a whole by each model

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.lines: list[str] = []
        self._lock = threading.Lock()
        self._handlers: dict[str, Callable[[str], Sequence[str | bytes]]] = {
            "*IDN?": lambda _: [
                f"Stanford_Research_Systems,{self.model},s/n00000,{SIMULATOR}"
            ],
            "*RST": self._reset,
            "*CLS": lambda _: self._clear(),
            "*OPC?": lambda _: ["1"],
            "*TST?": lambda _: ["0"],
            "*STB?": lambda bit: [_register_text(self._status_byte(), bit)],
            "*ESR?": lambda bit: self._pop("*ESR", bit),
            "ERRS?": lambda bit: self._pop("ERRS", bit),
            "LIAS?": lambda bit: self._lock_in_status(bit),
            "FREQ": self._set_frequency,
            "FREQ?": lambda _: [f"{self.bench.frequency:.6E}"],
            "SNAP?": self._snapshot,
            "OUTP?": lambda code: [self._shown(self._values()[int(code)])],
            "AUXO": self._set_output,
            "AUXO?": self._output,
        }
        for word in ("*SRE", "*ESE", "ERRE", "LIAE"):
            self._handlers[word] = functools.partial(self._enable, word)
            self._handlers[f"{word}?"] = functools.partial(self._is_enabled, word)
        self._reset("")

    def answer(self, line: str) -> list[str | bytes]:
        """Return the answers to a line of one or several commands."""
        with self._lock:
            self.lines.append(line)
            del self.lines[:-_MOST_LINES]
            result: list[str | bytes] = []
            for command in line.split(";"):
                answers = self._answer_command(command.strip())
                if answers is None:  # silent from here on: it "does not answer"
                    return []
                result += answers
            if self.joins_answers and all(isinstance(text, str) for text in result):
                return [";".join(map(str, result))] if result else []
            return result

    def _answer_command(self, command: str) -> Sequence[str | bytes] | None:
        parsed = self.command.fullmatch(command.upper())
        if parsed is None:
            self._bits["*ESR"] |= _COMMAND_ERROR * bool(command)
            return []
        word, argument = (
            parsed["word"] + (parsed["query"] or ""),
            "".join((parsed["rest"] or "").split()),
        )
        number = self.bench.readings + 1
        if word == "SNAP?" and self.bench.faults.active("lost-link", number):
            self.bench.readings += 1
            raise LinkLostError
        if word == "SNAP?" and self.bench.faults.active("timeout", number):
            self.bench.readings += 1
            return None
        if argument and word in self.bare:
            self._bits["*ESR"] |= _COMMAND_ERROR
            return []
        try:
            if "_" in argument:  # which Python would take for a number
                raise ValueError(argument)
            if word in self._handlers:
                return self._handlers[word](argument)
            if parsed["word"] in self.settings:
                return self._choice(
                    parsed["word"], argument, query=bool(parsed["query"])
                )
        except (ValueError, LookupError):
            self._bits["*ESR"] |= _EXECUTION_ERROR
            return []
        self._bits["*ESR"] |= _COMMAND_ERROR
        return []

    def _choice(self, name: str, argument: str, *, query: bool) -> list[str]:
        """Query or set a setting by code."""
        if query:
            if argument:
                raise ValueError(argument)
            return [str(self._set[name])]
        setting = self.settings[name]
        for code, word in enumerate(setting.words, start=setting.first):
            needed = "".join(letter for letter in word if not letter.islower())
            if argument.startswith(needed) and word.upper().startswith(argument):
                argument = str(code)
        code = whole(argument)
        if not setting.first <= code <= setting.last:
            raise ValueError(argument)
        self._set[name] = code
        if name == "OFLT":
            self.bench.set_time_constant(self._time_constant(code))
        return []

    def _reset(self, _: str) -> list[str]:
        self._set = {name: setting.first for name, setting in self.settings.items()}
        self._outputs = dict.fromkeys(self.outputs, 0.0)
        self._bits = {"*ESR": 0, "ERRS": 0, "LIAS": 0}
        self._enabled = {"*SRE": 0, "*ESE": 0, "ERRE": 0, "LIAE": 0}
        self.bench.set_laser(False)
        return []

    def _clear(self) -> list[str]:
        self._bits = dict.fromkeys(self._bits, 0)
        return []

    def _enable(self, word: str, argument: str) -> list[str]:
        """Set a status-enable register or one bit of it."""
        place, _, value = argument.partition(",")
        count = _BITS.get(word, 8)
        if not 0 <= whole(place) < (count if value else 1 << count):
            raise ValueError(argument)
        if value:
            bit = 1 << whole(place)
            others = self._enabled[word] & ~bit
            self._enabled[word] = others | bit * index_of(value, 2)
        else:
            self._enabled[word] = whole(place)
        return []

    def _is_enabled(self, word: str, bit: str) -> list[str]:
        return [_register_text(self._enabled[word], bit, count=_BITS.get(word, 8))]

    def _status_byte(self) -> int:
        self._note_unlocked()
        status = (
            self.idle_status
            | _ERRORS * bool(self._bits["ERRS"] & self._enabled["ERRE"])
            | _LOCK_IN * bool(self._bits["LIAS"] & self._enabled["LIAE"])
            | _EVENTS * bool(self._bits["*ESR"] & self._enabled["*ESE"])
        )
        return status | _SERVICE * bool(status & self._enabled["*SRE"])

    def _pop(self, word: str, bit: str) -> list[str]:
        """Return and clear a status register, or one bit of it."""
        result = _register_text(self._bits[word], bit, count=_BITS.get(word, 8))
        self._bits[word] &= ~(1 << whole(bit)) if bit else 0
        return [result]

    def _lock_in_status(self, bit: str) -> list[str]:
        self._note_unlocked()
        return self._pop("LIAS", bit)

    def _note_unlocked(self) -> None:
        if not self.bench.locked():
            self._bits["LIAS"] |= self.unlocked_bit

    def _set_frequency(self, argument: str) -> list[str]:
        frequency = self._frequency_of(argument)
        low, high = self.frequencies
        if not low <= frequency <= high:
            raise ValueError(argument)
        self._note_frequency(frequency)
        self.bench.set_frequency(self._rounded(frequency))
        self._bits["LIAS"] |= self.unlocked_bit
        return []

    def _frequency_of(self, argument: str) -> float:
        return float(argument)

    def _note_frequency(self, frequency: float) -> None:
        """Latch the status bits of a new frequency [Hz]."""

    def _set_output(self, argument: str) -> list[str]:
        number, voltage = argument.split(",")
        code = self.outputs.index(whole(number))
        if not abs(float(voltage)) <= self.largest_output:
            raise ValueError(voltage)
        self._outputs[whole(number)] = float(voltage)
        if code == 0:  # the laser is wired to the first one
            self.bench.set_laser(float(voltage) > _GATE)
        return []

    def _output(self, argument: str) -> list[str]:
        return [f"{self._outputs[whole(argument)]:.3f}"]

    def _monitor(self) -> float:
        """Return the simulated voltage of the interlock monitor [V]."""
        return INTERLOCK * self.bench.interlock_is_closed

    def _measured(self) -> tuple[float, float, float]:
        """Return X, Y [V rms] and the mean output [V], and latch status bits."""
        signal, mean = self.bench.output()
        faults, number = self.bench.faults, self.bench.readings
        if faults.active("unlock", number):
            self._bits["LIAS"] |= self.unlocked_bit
        x, y = signal.real / math.sqrt(2), -signal.imag / math.sqrt(2)
        self._latch(math.hypot(x, y), faults.active("overload", number))
        return x, y, mean

    def _snapshot(self, argument: str) -> list[str]:
        codes = [self._parameter(text.strip()) for text in argument.split(",")]
        if not self.snapped[0] <= len(codes) <= self.snapped[1]:
            raise ValueError(argument)
        values = self._values()
        return [",".join(self._shown(values[code]) for code in codes)]

    #: Fewest and most values of one SNAP?.
    snapped = (2, 6)

    def _parameter(self, text: str) -> int:
        return whole(text)

    def _values(self) -> dict[int, float]:
        """Return the present values by their codes in the command SNAP?."""
        raise NotImplementedError

    def _shown(self, value: float) -> str:
        raise NotImplementedError

    def _latch(self, amplitude: float, overloaded: bool) -> None:
        raise NotImplementedError

    def _rounded(self, frequency: float) -> float:
        raise NotImplementedError

    def _time_constant(self, code: int) -> float:
        raise NotImplementedError


def _register_text(register: int, bit: str, *, count: int = 8) -> str:
    """Return the value of a register, or of one of its bits, as text."""
    if not bit:
        return str(register)
    if not 0 <= whole(bit) < count:
        raise ValueError(bit)
    return str(register >> whole(bit) & 1)


def index_of(text: str, count: int, *, first: int = 0) -> int:
    """Return the index that a code states as text; raise if beyond `count`."""
    place = whole(text) - first
    if not 0 <= place < count:
        raise ValueError(text)
    return place


def whole(text: str) -> int:
    """Parse a whole number, which may be written as 5, 5.0 or 0.5E1."""
    number = float(text)
    if not number.is_integer():
        raise ValueError(text)
    return int(number)


#: Time constants by the code of OFLT: 100 us to 30 ks, in steps of 1 and 3 [s].
_TIME_CONSTANTS = (
    1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0,
    1e3, 3e3, 1e4, 3e4,
)  # fmt: skip
#: Full scales by the code of SENS: 100 nV to 1 V, in steps of 1 and 3 [V rms].
_SENSITIVITIES = (
    1e-7, 3e-7, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3,
    1.0,
)  # fmt: skip
#: Reference of R in dBm: 1 mW in this resistance [ohm].
_LOAD = 50.0
#: Bits of LIAS? (manual, page 4-32).
_UNLOCKED, _INPUT, _FILTER, _CHANGED = 1, 16, 64, 128
_CHANNEL_1, _CHANNEL_2 = 256, 512
#: Relative change of the reference frequency that sets a status bit [1].
_CHANGE = 0.01


class SimulatedSr844(SimulatedStanford):
    """Simulated SR844: three-digit frequencies, outputs clipped at full scale."""

    model = "SR844"
    unlocked_bit = _UNLOCKED
    frequencies = (25e3, 200e6)
    #: No scan and no command in progress (manual, page 4-31).
    idle_status = 0b11
    bare = (*SimulatedStanford.bare, "PHAS?", "APHS")
    outputs = (1, 2)
    #: Codes of the settings (manual, chapter 4).
    settings = {  # noqa: RUF012
        "OUTX": Setting(1), "FMOD": Setting(1), "HARM": Setting(1), "OFSL": Setting(4),
        "OFLT": Setting(17), "WRSV": Setting(2), "CRSV": Setting(2),
        "SENS": Setting(14), "INPZ": Setting(1), "REFZ": Setting(1),
        "RMOD": Setting(2),
    }  # fmt: skip

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        self._phase = 0.0
        # Outputs 1 to 5 only (manual, page 4-25).
        self._handlers["OUTP?"] = lambda code: [
            self._shown(self._values()[1 + index_of(code, 5, first=1)])
        ]
        self._handlers["PHAS"] = self._set_phase
        self._handlers["PHAS?"] = lambda _: [f"{self._phase:.2f}"]
        self._handlers["APHS"] = self._auto_phase
        # The displays of both channels (manual, page 4-25).
        self._handlers["OUTR?"] = lambda code: [
            self._shown(self._values()[9 + index_of(code, 2, first=1)])
        ]
        self._handlers["AUXI?"] = lambda code: [self._shown(self._auxiliary(code))]

    def _note_frequency(self, frequency: float) -> None:
        before = self.bench.frequency
        if abs(frequency - before) > _CHANGE * before:
            self._bits["LIAS"] |= _CHANGED

    def _set_phase(self, argument: str) -> list[str]:
        if not -360 <= float(argument) <= 360:
            raise ValueError(argument)
        self._phase = float(argument)
        return []

    def _auto_phase(self, _: str) -> list[str]:
        turned = self._phase + self._values()[5]
        self._phase = (turned + 180) % 360 - 180
        return []

    def _auxiliary(self, code: str) -> float:
        if code not in ("1", "2"):
            raise ValueError(code)
        return self._monitor() if code == "2" else self._values()[6]

    def _values(self) -> dict[int, float]:
        x, y, mean = self._measured()
        turned = complex(x, y) * cmath.exp(-1j * math.radians(self._phase))
        x, y = turned.real, turned.imag
        scale = _SENSITIVITIES[self._set["SENS"]]
        over = max(math.hypot(x, y) / scale, 1.0)
        self._bits["LIAS"] |= _CHANNEL_1 * (abs(x) > scale)
        self._bits["LIAS"] |= _CHANNEL_2 * (abs(y) > scale)
        size = math.hypot(x, y) / over
        power = size**2 / _LOAD / 1e-3
        return {
            1: x / over,
            2: y / over,
            3: size,
            4: 10 * math.log10(power) if power > 0 else -math.inf,
            5: math.degrees(math.atan2(y, x)),
            6: mean,
            7: self._monitor(),
            8: self.bench.frequency,
            # The displays show X and Y after *RST.
            9: x / over,
            10: y / over,
        }

    def _shown(self, value: float) -> str:
        return f"{value:.6E}"

    def _latch(self, amplitude: float, overloaded: bool) -> None:
        if amplitude > _SENSITIVITIES[self._set["SENS"]]:
            self._bits["LIAS"] |= _FILTER
        if overloaded:
            self._bits["LIAS"] |= _INPUT

    def _rounded(self, frequency: float) -> float:
        return float(f"{frequency:.3g}")

    def _time_constant(self, code: int) -> float:
        return _TIME_CONSTANTS[code]
