"""A simulated SR844 RF lock-in amplifier in front of a bench, from its manual alone."""

from __future__ import annotations

import cmath
import math

from amulor.acquisition.simulated.bench import Bench
from amulor.acquisition.simulated.stanford import (
    Setting,
    SimulatedStanford,
)

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
#: What R in dBm is relative to: 1 mW in this resistance [ohm].
_LOAD = 50.0
#: Bits of LIAS? (manual, page 4-32).
_UNLOCKED, _INPUT, _FILTER, _CHANNEL_1, _CHANNEL_2 = 1, 16, 64, 256, 512


class SimulatedSr844(SimulatedStanford):
    """An SR844: its oscillator has three digits, its outputs end at the full scale."""

    model = "SR844"
    unlocked_bit = _UNLOCKED
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
        self._handlers["PHAS"] = self._set_phase
        self._handlers["PHAS?"] = lambda _: [f"{self._phase:.2f}"]
        self._handlers["AUXI?"] = lambda code: [self._shown(self._auxiliary(code))]

    def _set_phase(self, argument: str) -> list[str]:
        if not -360 <= float(argument) <= 360:
            raise ValueError(argument)
        self._phase = float(argument)
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
