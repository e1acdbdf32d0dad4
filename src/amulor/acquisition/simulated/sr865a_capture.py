"""The capture buffer of a simulated SR865A (manual, pages 134 to 139)."""

from __future__ import annotations

import struct
from collections.abc import Callable

from amulor.acquisition.simulated.bench import Bench

#: Fastest rate of any time constant (page 134) [1/s].
_FASTEST = 1.25e6
#: Points a time constant that the fastest rate of a time constant has at least. The
#: manual says that shorter time constants allow faster rates, and no more.
_POINTS = 16
#: Bytes of a number, of a block, and of the largest buffer.
_NUMBER, _BLOCK, _MOST = 4, 2048, 4096 * 1024
#: Values that are captured, by the code of CAPTURECFG: X, XY, RT, XYRT.
_COLUMNS = (1, 2, 2, 4)
#: Bits of CAPTURESTAT?: recording, triggered, wrapped.
_RECORDING, _TRIGGERED, _WRAPPED = 1, 2, 4

Answer = list[str] | list[bytes]


class Capture:
    """What the commands CAPTURE... do.

    Parameters
    ----------
    bench : Bench
        What is captured.
    shown : callable
        Turns an output of the bench into X, Y, R and theta.
    time_constant : callable
        Returns the time constant that is set [s].
    """

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
        """Forget everything, as *RST does."""
        self._length, self._columns, self._divisor = _BLOCK, 0, 0
        self._state = 0
        self._capacity = 0
        self._stopped: list[list[complex]] = []
        #: What was captured when it was last looked at.
        self._seen: list[list[complex]] = []

    def commands(self) -> dict[str, Callable[[str], Answer]]:
        """Return what answers each command."""
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
        size = int(argument) * 1024
        if not 0 < size <= _MOST:
            raise ValueError(argument)
        self._length = -(-size // _BLOCK) * _BLOCK
        return []

    def _configure(self, argument: str) -> Answer:
        words = {"X": 0, "XY": 1, "RT": 2, "XYRT": 3}
        code = words[argument] if argument in words else int(argument)
        self._columns = range(len(_COLUMNS))[code]
        self._state, self._capacity, self._stopped, self._seen = 0, 0, [], []
        return []

    def _set_rate(self, argument: str) -> Answer:
        self._divisor = range(21)[int(argument)]
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
        mode, trigger = (int(part) for part in argument.split(","))
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
        all_of = self._shown(row[0])
        return (all_of[:1], all_of[:2], all_of[2:], all_of)[self._columns]

    def _value(self, argument: str) -> Answer:
        number = int(argument)
        rows = self._seen if 0 <= number < len(self._seen) else self._rows()
        if number < 0 or number * self._width() >= self._length:
            raise ValueError(argument)
        if number >= len(rows):  # not captured yet
            return [",".join(["0.000000000e+00"] * _COLUMNS[self._columns])]
        return [",".join(f"{value:.9e}" for value in self._numbers(rows[number]))]

    def _block(self, argument: str) -> Answer:
        if self._status() & _RECORDING:
            raise ValueError("capture must be stopped")
        first, length = (int(part) * 1024 for part in argument.split(","))
        if not 0 < length <= 64 * 1024:
            raise ValueError(argument)
        numbers = [value for row in self._stopped for value in self._numbers(row)]
        content = struct.pack(f"<{len(numbers)}f", *numbers).ljust(self._length, b"\0")
        # Beyond the end it begins anew.
        part = (content * 2)[first : first + length]
        count = str(len(part))
        return [f"#{len(count)}{count}".encode() + part]
