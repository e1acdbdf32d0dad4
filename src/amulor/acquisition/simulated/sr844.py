"""A simulated SR844 RF lock-in amplifier in front of a bench, from its manual alone."""

from __future__ import annotations

import math

from amulor.acquisition.simulated.stanford import SimulatedStanford

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
#: Bits of LIAS? (manual, page 4-32).
_UNLOCKED, _INPUT, _FILTER, _CHANNEL_1, _CHANNEL_2 = 1, 16, 64, 256, 512


class SimulatedSr844(SimulatedStanford):
    """An SR844: its oscillator has three digits, its outputs end at the full scale."""

    model = "SR844"
    unlocked_bit = _UNLOCKED
    outputs = (1, 2)
    codes = {  # noqa: RUF012
        "OUTX": 1, "FMOD": 1, "HARM": 1, "OFSL": 4, "OFLT": 17, "WRSV": 2, "CRSV": 2,
        "SENS": 14,
    }  # fmt: skip

    def _snapshot(self, argument: str) -> list[str]:
        x, y, mean = self._measured()
        scale = _SENSITIVITIES[self._set["SENS"]]
        over = max(math.hypot(x, y) / scale, 1.0)
        self._status |= _CHANNEL_1 * (abs(x) > scale) | _CHANNEL_2 * (abs(y) > scale)
        values = {
            1: x / over,
            2: y / over,
            6: mean,
            7: 0.0,
            8: self.bench.frequency,
        }
        return [",".join(f"{values[int(code)]:.6E}" for code in argument.split(","))]

    def _latch(self, amplitude: float, overloaded: bool) -> None:
        if amplitude > _SENSITIVITIES[self._set["SENS"]]:
            self._status |= _FILTER
        if overloaded:
            self._status |= _INPUT

    def _rounded(self, frequency: float) -> float:
        return float(f"{frequency:.3g}")

    def _time_constant(self, code: int) -> float:
        return _TIME_CONSTANTS[code]
