"""Simulated SR865A, with its capture buffer (manual, pages 134 to 139)."""

from __future__ import annotations

import cmath
import functools
import math
import re
import struct
from collections.abc import Callable

from amulor.acquisition.simulated.bench import Bench
from amulor.acquisition.simulated.stanford import (
    Number,
    Setting,
    SimulatedStanford,
    index_of,
    whole,
)

#: Fastest rate of any time constant (page 134) [1/s].
_FASTEST = 1.25e6
#: Least number of points per time constant at the fastest rate. The manual says only
#: that shorter time constants allow faster rates.
_POINTS = 16
#: Bytes of a number, of a block, and of the largest buffer.
_NUMBER, _BLOCK, _MOST = 4, 2048, 4096 * 1024
#: Values that are captured, by the code of CAPTURECFG: X, XY, RT, XYRT.
_COLUMNS = (1, 2, 2, 4)
#: Bits of CAPTURESTAT?: recording, triggered, wrapped.
_RECORDING, _TRIGGERED, _WRAPPED = 1, 2, 4

Answer = list[str] | list[bytes]


class Capture:
    """Capture buffer with its commands, such as CAPTURELEN."""

    def __init__(
        self,
        bench: Bench,
        *,
        shown: Callable[[complex], tuple[float, float, float, float]],
        time_constant: Callable[[], float],
    ) -> None:
        self._bench, self._shown, self._time_constant = bench, shown, time_constant
        self.reset()

    def reset(self) -> None:
        """Reset the buffer, as *RST does."""
        self._length, self._columns, self._divisor = _BLOCK, 0, 0
        self._state = 0
        self._capacity = 0
        self._stopped: list[list[complex]] = []
        #: Captured rows at the last query.
        self._seen: list[list[complex]] = []

    def commands(self) -> dict[str, Callable[[str], Answer]]:
        """Return the functions that answer the commands, by command."""
        return {
            "CAPTURELEN": self._set_length,
            "CAPTURELEN?": lambda _: [str(self._length // 1024)],
            "CAPTURECFG": self._configure,
            "CAPTURECFG?": lambda _: [str(self._columns)],
            "CAPTURERATEMAX?": lambda _: [f"{self._fastest():.9e}"],
            "CAPTURERATE": self._set_rate,
            "CAPTURERATE?": lambda _: [f"{self._rate():.9e}"],
            "CAPTURESTART": self._start,
            "CAPTURESTOP": self._stop,
            "CAPTURESTAT?": lambda _: [str(self._status())],
            "CAPTUREBYTES?": lambda _: [str(len(self._rows()) * self._width())],
            "CAPTUREPROG?": self._progress,
            "CAPTUREVAL?": self._value,
            "CAPTUREGET?": self._block,
        }

    def _set_length(self, argument: str) -> Answer:
        size = whole(argument) * 1024
        if not 0 < size <= _MOST:
            raise ValueError(argument)
        self._length = -(-size // _BLOCK) * _BLOCK
        return []

    def _configure(self, argument: str) -> Answer:
        words = {"X": 0, "XY": 1, "RT": 2, "XYRT": 3}
        code = str(words.get(argument, argument))
        self._columns = index_of(code, len(_COLUMNS))
        self._state, self._capacity, self._stopped, self._seen = 0, 0, [], []
        return []

    def _set_rate(self, argument: str) -> Answer:
        self._divisor = index_of(argument, 21)
        return []

    def _fastest(self) -> float:
        rate = _FASTEST
        while rate / 2 >= _POINTS / self._time_constant():
            rate /= 2
        return rate

    def _rate(self) -> float:
        return float(self._fastest() / 2**self._divisor)

    def _width(self) -> int:
        return _NUMBER * _COLUMNS[self._columns]

    def _start(self, argument: str) -> Answer:
        words = {"ONE": "0", "IMM": "0", "CONT": "1", "TRIG": "1", "SAMP": "2"}
        mode, trigger = (
            whole(words.get(part.strip(), part)) for part in argument.split(",")
        )
        if mode != 0 or trigger != 0:  # the bench has no trigger and no wrapping buffer
            raise ValueError(argument)
        self._capacity = self._length // self._width()
        self._bench.start_trace(1 / self._rate(), most=self._capacity)
        self._state = _RECORDING | _TRIGGERED
        self._stopped, self._seen = [], []
        return []

    def _stop(self, _: str) -> Answer:
        if self._status() & _RECORDING:
            self._stopped = [*self._bench.trace()]
            self._state &= ~_RECORDING
        return []

    def _rows(self) -> list[list[complex]]:
        recording = self._status() & _RECORDING
        self._seen = self._bench.trace() if recording else self._stopped
        return self._seen

    def _status(self) -> int:
        if self._state & _RECORDING and len(self._bench.trace()) >= self._capacity:
            self._stopped = [*self._bench.trace()]
            self._state = self._state & ~_RECORDING | _WRAPPED
        return self._state

    def _progress(self, _: str) -> Answer:
        if self._status() & _RECORDING:
            raise ValueError("capture must be stopped")
        size = len(self._stopped) * self._width()
        return [str(-(-size // _BLOCK) * _BLOCK // 1024)]

    def _numbers(self, row: list[complex]) -> tuple[float, ...]:
        components = self._shown(row[0])
        return (components[:1], components[:2], components[2:], components)[
            self._columns
        ]

    def _value(self, argument: str) -> Answer:
        number = whole(argument)
        rows = self._seen if 0 <= number < len(self._seen) else self._rows()
        if number < 0 or number * self._width() >= self._length:
            raise ValueError(argument)
        if number >= len(rows):  # not captured yet
            return [",".join(["0.000000000e+00"] * _COLUMNS[self._columns])]
        return [",".join(f"{value:.9e}" for value in self._numbers(rows[number]))]

    def _block(self, argument: str) -> Answer:
        if self._status() & _RECORDING:
            raise ValueError("capture must be stopped")
        first, length = (whole(part) * 1024 for part in argument.split(","))
        if first < 0 or not 0 < length <= 64 * 1024:
            raise ValueError(argument)
        numbers = [value for row in self._stopped for value in self._numbers(row)]
        content = struct.pack(f"<{len(numbers)}f", *numbers).ljust(self._length, b"\0")
        # Beyond its end, the buffer starts again.
        part = (content * 2)[first : first + length]
        count = str(len(part))
        return [f"#{len(count)}{count}".encode() + part]


#: Time constants by the code of OFLT: 1 us to 30 ks, in steps of 1 and 3 [s].
_TIME_CONSTANTS = (
    1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0,
    10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4, 3e4,
)  # fmt: skip
#: Full scales by the code of SCAL: 1 V down to 1 nV, in steps of 1, 2 and 5 [V rms].
_SCALES = (
    1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5,
    2e-5, 1e-5, 5e-6, 2e-6, 1e-6, 5e-7, 2e-7, 1e-7, 5e-8, 2e-8, 1e-8, 5e-9, 2e-9, 1e-9,
)  # fmt: skip
#: Input ranges by the code of IRNG [V peak].
_INPUT_RANGES = (1.0, 0.3, 0.1, 0.03, 0.01)
#: Equivalent noise bandwidth times time constant, by the code of OFSL: 6 to 24 dB per
#: octave [1].
_BANDWIDTHS = (1 / 4, 1 / 8, 3 / 32, 5 / 64)
#: Bits of LIAS?: scale of channel 1, reference unlocked, input range.
_CHANNEL_1, _UNLOCKED, _INPUT = 1, 8, 16
#: Bits of CUROVLDSTAT?.
_OVERLOADS = 0xF1B
#: Names of values in SNAP?, OUTP? and CDSP by code; capitals are required.
_PARAMETERS = (
    "X", "Y", "R", "THeta", "IN1", "IN2", "IN3", "IN4", "XNOise", "YNOise", "OUT1",
    "OUT2", "PHAse", "SAMp", "LEVel", "FInt", "FExt",
)  # fmt: skip
_OFF_ON = ("OFF", "ON")
#: Channels that are displayed and captured.
_DATA = 4


class SimulatedSr865a(SimulatedStanford):
    """Simulated SR865A: settings, auxiliary channels, status bits, capture buffer."""

    model = "SR865A"
    unlocked_bit = _UNLOCKED
    frequencies = (1e-3, 4e6)
    #: A space before the parameter, and none before the question mark (page 103).
    command = re.compile(r"(?P<word>[*A-Z]+)(?P<query>\?)?(\s+(?P<rest>.*))?")
    joins_answers = True
    bare = (
        *SimulatedStanford.bare, "FREQINT?", "FREQDET?", "FREQEXT?", "SNAPD?", "ILVL?",
        "ENBW?", "CUROVLDSTAT?", "APHS", "CAPTURELEN?", "CAPTURECFG?", "CAPTURERATE?",
        "CAPTURERATEMAX?", "CAPTURESTOP", "CAPTURESTAT?", "CAPTUREBYTES?",
        "CAPTUREPROG?",
    )  # fmt: skip
    outputs = (0, 1, 2, 3)
    snapped = (2, 3)
    settings = {  # noqa: RUF012
        "TBMODE": Setting(1, ("AUTO", "INternal")), "TBSTAT": Setting(1),
        "REFM": Setting(1, ("COMmon", "DIFference")),
        "RSRC": Setting(3, ("INTernal", "EXTernal", "DUAL", "CHOP")),
        "RTRG": Setting(2, ("SIN", "POSttl", "NEGttl")),
        "REFZ": Setting(1, ("50ohms", "1MEG")),
        "HARM": Setting(99, first=1), "HARMDUAL": Setting(99, first=1),
        "IVMD": Setting(1, ("VOLTage", "CURRent")), "ISRC": Setting(1, ("A", "A-B")),
        "ICPL": Setting(1, ("AC", "DC")), "IGND": Setting(1, ("FLOat", "GROund")),
        "IRNG": Setting(4), "ICUR": Setting(1), "SCAL": Setting(27),
        "OFLT": Setting(21), "OFSL": Setting(3), "SYNC": Setting(1, _OFF_ON),
        "ADVFILT": Setting(1, _OFF_ON), "DBLK": Setting(1, _OFF_ON),
        "DLAY": Setting(5), "GSPD": Setting(16), "*PSC": Setting(1),
    }  # fmt: skip
    numbers = {  # noqa: RUF012
        "PHAS": Number(-360_000, 360_000), "SLVL": Number(1e-9, 2.0, 1e-9),
        "SOFF": Number(-5, 5), "BLADESLOTS": Number(0, 1),
        "PSTF": Number(1e-3, 4e6, 1e5, 4), "PSTA": Number(1e-9, 2.0, 0.1, 4),
        "PSTL": Number(-5, 5, 0.0, 4),
    }  # fmt: skip

    def __init__(self, bench: Bench) -> None:
        self._capture: Capture | None = None
        super().__init__(bench)
        self._capture = Capture(
            bench,
            shown=self._components,
            time_constant=lambda: self._time_constant(self._set["OFLT"]),
        )
        handlers = self._handlers
        handlers.update(self._capture.commands())
        handlers["AUXV"], handlers["AUXV?"] = (
            handlers.pop("AUXO"),
            handlers.pop("AUXO?"),
        )
        handlers["OUTP?"] = lambda text: [
            self._shown(self._values()[self._parameter(text)])
        ]
        handlers["FREQINT"], handlers["FREQINT?"] = handlers["FREQ"], handlers["FREQ?"]
        handlers["FREQDET?"] = handlers["FREQ?"]
        handlers["FREQEXT?"] = lambda _: [
            self._shown(0.0)
        ]  # nothing is connected to it
        handlers["OAUX?"] = lambda code: [
            self._shown(self._auxiliary(index_of(code, 4)))
        ]
        handlers["OUTR?"] = lambda code: [
            self._shown(self._channels()[index_of(code, _DATA)])
        ]
        handlers["SNAPD?"] = lambda _: [",".join(map(self._shown, self._channels()))]
        handlers["CDSP"], handlers["CDSP?"] = self._set_channel, self._channel
        handlers["ILVL?"] = lambda _: [str(self._strength())]
        handlers["ENBW?"] = lambda _: [self._shown(self._bandwidth())]
        handlers["CUROVLDSTAT?"] = lambda _: [str(self._overloads_now())]
        handlers["APHS"] = self._auto_phase
        for name in self.numbers:
            handlers[name] = functools.partial(self._set_number, name)
            handlers[f"{name}?"] = functools.partial(self._number, name)

    def _components(self, output: complex) -> tuple[float, float, float, float]:
        """Return X, Y, R [V rms] and theta [deg] of an output of the bench."""
        turned = output.conjugate() / math.sqrt(2)
        turned *= cmath.exp(-1j * math.radians(self._numbers["PHAS"][0]))
        angle = math.degrees(cmath.phase(turned))
        return turned.real, turned.imag, abs(turned), angle

    def _reset(self, argument: str) -> list[str]:
        if self._capture is not None:
            self._capture.reset()
        self._numbers = {
            name: [number.after_reset] * max(number.channels, 1)
            for name, number in self.numbers.items()
        }
        self._shows = list(range(_DATA))
        return super()._reset(argument)

    def _set_number(self, name: str, argument: str) -> list[str]:
        number, channel = self.numbers[name], 0
        if number.channels:
            place, argument = argument.split(",")
            channel = index_of(place, number.channels)
        if not number.low <= float(argument) <= number.high:
            raise ValueError(argument)
        self._numbers[name][channel] = float(argument)
        return []

    def _number(self, name: str, channel: str) -> list[str]:
        count = max(self.numbers[name].channels, 1)
        place = index_of(channel, count) if channel else 0
        return [self._shown(self._numbers[name][place])]

    def _parameter(self, text: str) -> int:
        for code, word in enumerate(_PARAMETERS):
            needed = "".join(letter for letter in word if not letter.islower())
            if text.startswith(needed) and word.upper().startswith(text):
                return code
        return whole(text)

    def _values(self) -> dict[int, float]:
        x, y, mean = self._measured()
        phase = self._numbers["PHAS"][0]
        turned = complex(x, y) * cmath.exp(-1j * math.radians(phase))
        noise = self.bench.noise / math.sqrt(2 * self._bandwidth())
        monitor = self._monitor()
        shown = (
            turned.real, turned.imag, abs(turned), math.degrees(cmath.phase(turned)),
            mean, monitor, 0.0, 0.0, noise, noise, self._outputs[0], self._outputs[1],
            phase, self._numbers["SLVL"][0], self._numbers["SOFF"][0],
            self.bench.frequency, 0.0,
        )  # fmt: skip
        return dict(enumerate(shown))

    def _shown(self, value: float) -> str:
        return f"{value:.9e}"

    def _auxiliary(self, code: int) -> float:
        return self._monitor() if code == 1 else self._values()[4 + code]

    def _channels(self) -> list[float]:
        values = self._values()
        return [values[code] for code in self._shows]

    def _set_channel(self, argument: str) -> list[str]:
        place, parameter = argument.split(",")
        code = self._parameter(parameter.strip())
        if not 0 <= code < len(_PARAMETERS):
            raise ValueError(argument)
        self._shows[index_of(place, _DATA)] = code
        return []

    def _channel(self, argument: str) -> list[str]:
        return [str(self._shows[index_of(argument, _DATA)])]

    def _strength(self) -> int:
        """Return the signal strength, from 0 to 4 (overload)."""
        values = self._values()
        part = math.sqrt(2) * values[2] / _INPUT_RANGES[self._set["IRNG"]]
        return min(int(4 * part), 4)

    def _bandwidth(self) -> float:
        return _BANDWIDTHS[self._set["OFSL"]] / _TIME_CONSTANTS[self._set["OFLT"]]

    def _overloads_now(self) -> int:
        """Return the present overload bits; latched bits are unchanged."""
        latched = self._bits["LIAS"]
        self._bits["LIAS"] = 0
        self._measured()
        self._note_unlocked()
        now = self._bits["LIAS"] & _OVERLOADS
        self._bits["LIAS"] |= latched
        return now

    def _auto_phase(self, _: str) -> list[str]:
        values = self._values()
        turned = values[3] + self._numbers["PHAS"][0]
        self._numbers["PHAS"][0] = (turned + 180) % 360 - 180
        return []

    def _latch(self, amplitude: float, overloaded: bool) -> None:
        if amplitude > _SCALES[self._set["SCAL"]]:
            self._bits["LIAS"] |= _CHANNEL_1
        limit = _INPUT_RANGES[self._set["IRNG"]]
        if overloaded or amplitude * math.sqrt(2) > limit:
            self._bits["LIAS"] |= _INPUT

    def _rounded(self, frequency: float) -> float:
        return float(f"{frequency:.6g}")

    def _frequency_of(self, argument: str) -> float:
        for unit, factor in (("KHZ", 1e3), ("MHZ", 1e6), ("HZ", 1.0)):
            if argument.endswith(unit):
                return factor * float(argument.removesuffix(unit))
        return float(argument)

    def _time_constant(self, code: int) -> float:
        return _TIME_CONSTANTS[code]
