"""A simulated SR865A lock-in amplifier in front of a bench, from its manual alone."""

from __future__ import annotations

import math

from amulor.acquisition.simulated.bench import Bench
from amulor.acquisition.simulated.stanford import SimulatedStanford

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
#: Largest level of the sine output [V rms].
_LARGEST_LEVEL = 2.0
#: Bits of LIAS?: scale of channel 1, reference unlocked, input range.
_CHANNEL_1, _UNLOCKED, _INPUT = 1, 8, 16


class SimulatedSr865a(SimulatedStanford):
    """An SR865A: its outputs in numbers do not end at the scale, its input does."""

    model = "SR865A"
    unlocked_bit = _UNLOCKED
    outputs = (0, 1, 2, 3)
    codes = {  # noqa: RUF012
        "RSRC": 3, "HARM": 99, "OFSL": 3, "OFLT": 21, "SYNC": 1, "IRNG": 4, "SCAL": 27,
        "IVMD": 1, "ISRC": 1, "ICPL": 1,
    }  # fmt: skip

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        self._handlers["SLVL"] = self._set_level
        self._handlers["SOFF"] = lambda _: []
        self._handlers["ADVFI"] = lambda _: []  # ADVFILT, by its first letters
        self._handlers["AUXV"] = self._handlers.pop("AUXO")
        self._handlers["AUXV?"] = self._handlers.pop("AUXO?")

    def _set_level(self, argument: str) -> list[str]:
        if not 0 <= float(argument) <= _LARGEST_LEVEL:
            raise ValueError(argument)
        return []

    def _snapshot(self, argument: str) -> list[str]:
        x, y, mean = self._measured()
        values = {0: x, 1: y, 4: mean, 5: 0.0, 6: 0.0, 7: 0.0}
        return [",".join(f"{values[int(code)]:.9e}" for code in argument.split(","))]

    def _latch(self, amplitude: float, overloaded: bool) -> None:
        if amplitude > _SCALES[self._set["SCAL"]]:
            self._status |= _CHANNEL_1
        limit = _INPUT_RANGES[self._set["IRNG"]]
        if overloaded or amplitude * math.sqrt(2) > limit:
            self._status |= _INPUT

    def _rounded(self, frequency: float) -> float:
        return float(f"{frequency:.6g}")

    def _time_constant(self, code: int) -> float:
        return _TIME_CONSTANTS[code]
