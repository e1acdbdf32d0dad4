"""A simulated digitiser with two inputs and a generator, in front of a bench."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from amulor.acquisition.protocols import SIMULATOR, Waveform
from amulor.acquisition.simulated.bench import Bench
from amulor.errors import InstrumentError

#: Amplitude of each tone at the reference input, and its noise [V].
_REFERENCE, _REFERENCE_NOISE = 0.1, 1e-4


class SimulatedDigitiser:
    """Records the photodiode of a bench, and what modulates its laser.

    Parameters
    ----------
    bench : Bench
        What it sees.
    sample_rate : float
        As it says [1/s].
    memory : int
        Most samples of a record [1].
    bits : int
        Of its converter [1].
    clock_offset : float
        By how much its clock is too fast, in parts [1].
    seed : int
        Of its noise and of the moments at which records start [1].
    """

    ranges: tuple[float, ...] = (0.01, 0.1, 1.0, 10.0)
    shows_mean = True

    def __init__(
        self,
        bench: Bench,
        *,
        sample_rate: float = 125e6,
        memory: int = 16_384,
        bits: int = 14,
        clock_offset: float = 0.0,
        seed: int = 1,
    ) -> None:
        self.bench = bench
        self._rate, self._memory, self._bits = sample_rate, memory, bits
        self._offset = clock_offset
        self._rng = np.random.default_rng(seed)
        self._range = len(self.ranges) - 1
        self.puts_out = False

    def identity(self) -> str:
        """Return that it is no device of this world."""
        return f"amulor,digitiser,0,{SIMULATOR}"

    def prepare(self) -> None:
        """Put no modulation out yet."""
        self.puts_out = False

    def set_range(self, number: int) -> None:
        """Take one of the ranges."""
        self._range = number

    def set_frequencies(
        self, frequencies: Sequence[float], *, timeout: float
    ) -> list[float]:
        """Modulate by all of them at once [Hz]."""
        self.bench.set_frequencies(frequencies)
        self.puts_out = True
        return [*frequencies]

    def acquire(self, duration: float) -> Waveform:
        """Return a record of a time [s], no longer than the memory."""
        faults, number = self.bench.faults, self.bench.readings + 1
        if faults.active("timeout", number) or faults.active("lost-link", number):
            self.bench.readings += 1
            raise InstrumentError("the simulated digitiser does not answer in time")
        count = int(min(max(round(duration * self._rate), 1024), self._memory))
        tones, mean = self.bench.instant()
        spread = self.bench.noise * math.sqrt(self.bench.time_constant * self._rate)
        # The generator counts true time; this clock is too fast.
        times = self._rng.uniform(0, 1e-3) + np.arange(count) / (
            self._rate * (1 + self._offset)
        )
        signal = mean + spread * self._rng.standard_normal(count)
        reference = _REFERENCE_NOISE * self._rng.standard_normal(count)
        lost = faults.active("unlock", number) or not self.puts_out
        for frequency, tone in zip(self.bench.frequencies, tones, strict=True):
            turn = np.exp(-2j * np.pi * (frequency * times % 1.0))
            signal += (tone * turn).real
            reference += _REFERENCE * turn.real * (not lost)
        if faults.active("overload", number):
            signal *= 100 * self.ranges[-1] / max(np.max(np.abs(signal)), 1e-12)
        limit = self.ranges[self._range]
        step = limit / 2 ** (self._bits - 1)
        digits = np.clip(np.round(signal / step) * step, -limit, limit - step)
        self.bench.clock.sleep(count / self._rate)
        return Waveform(
            signal=digits,
            reference=reference,
            sample_rate=self._rate,
            clipped=bool(np.any((digits >= limit - step) | (digits <= -limit))),
            shows_mean=True,
        )

    def make_safe(self) -> None:
        """Put no modulation out."""
        self.puts_out = False

    def close(self) -> None:
        """Do nothing."""
