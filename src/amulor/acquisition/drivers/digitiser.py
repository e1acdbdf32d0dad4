"""Software lock-in amplifier, which demodulates the records of a digitizer."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from amulor.acquisition.clock import Clock
from amulor.acquisition.demodulation import clock_offset, demodulate
from amulor.acquisition.protocols import Digitiser, Overload, Reading, Recorded
from amulor.errors import InstrumentError

#: Fractions of the range above which a signal counts as clipped, and below which a
#: finer range is selected.
_FULL, _FINER_BELOW = 0.999, 0.25
#: Least signal-to-noise ratio of a reference tone [1].
_PRESENT = 10.0


class DigitiserLockIn:
    """Software lock-in amplifier that demodulates detector records of a digitizer.

    Phases are those of the detector relative to the reference, tone by tone, so that
    the start of a record has no effect and no trigger is needed. The frequency
    difference between the clocks of digitizer and generator is estimated from the
    reference and corrected. There is no output filter that must settle. Without a
    recorded reference, the digitizer must start each record in phase with its
    generator.
    """

    #: The lock-in integrates without an output filter to settle, and estimates its
    #: errors.
    records = True

    def __init__(self, digitiser: Digitiser, *, clock: Clock) -> None:
        self._digitiser, self._clock = digitiser, clock
        self._frequencies: tuple[float, ...] = ()
        self._range = len(digitiser.ranges) - 1

    def identity(self) -> str:
        """Return maker, model, serial number and firmware."""
        return self._digitiser.identity()

    def prepare(self, *, time_constant: float) -> None:
        """Configure the digitizer, and select its largest input range."""
        self._digitiser.prepare()
        self._set_range(len(self._digitiser.ranges) - 1)

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Set the modulation frequency [Hz]; return the actual one [Hz]."""
        return self.set_frequencies([frequency], timeout=timeout)[0]

    def set_frequencies(
        self, frequencies: Sequence[float], *, timeout: float
    ) -> list[float]:
        """Modulate at several frequencies at once [Hz]; return the actual ones [Hz]."""
        actual = self._digitiser.set_frequencies(frequencies, timeout=timeout)
        if len(actual) != len(frequencies):
            raise InstrumentError(
                f"{self.identity()} modulates by {len(actual)} frequencies, asked for "
                f"are {len(frequencies)}; lower procedure.frequencies_at_once"
            )
        self._frequencies = tuple(actual)
        return [*actual]

    def read(self) -> Reading:
        """Return the outputs of one record at the first frequency."""
        return self.read_all()[0]

    def read_all(self) -> list[Reading]:
        """Return the outputs of one record at every frequency."""
        recorded = self.record(0.0)
        return [
            Reading(
                signal=complex(signal),
                mean=recorded.mean,
                modulation_frequency=frequency,
                overload=recorded.overload,
                unlocked=recorded.unlocked,
            )
            for signal, frequency in zip(
                recorded.signals.mean(axis=0),
                recorded.modulation_frequencies,
                strict=True,
            )
        ]

    def record(self, duration: float) -> Recorded:
        """Demodulate all records that fit into a duration [s], at least one."""
        began = self._clock.now()
        signals, variances, means, offsets = [], [], [], []
        overload, unlocked = Overload.NONE, False
        while True:
            remaining = duration - (self._clock.now() - began)
            waveform = self._digitiser.acquire(max(remaining, 0.0))
            values = np.asarray(waveform.signal, dtype=float)
            rate, used = waveform.sample_rate, [*self._frequencies]
            if waveform.clipped or np.max(np.abs(values)) >= _FULL * self.full_scale():
                overload |= Overload.INPUT
            turn, extra = np.ones(len(used), dtype=complex), np.zeros(len(used))
            if waveform.reference is not None:
                offset = clock_offset(
                    waveform.reference, sample_rate=rate, frequencies=used
                )
                offsets.append(offset)
                used = [frequency * (1 + offset) for frequency in used]
                reference = demodulate(
                    waveform.reference, sample_rate=rate, frequencies=used
                )
                size = np.abs(reference.signals)
                unlocked |= bool(np.any(size <= _PRESENT * reference.spreads))
                turn = np.conj(reference.signals) / np.maximum(size, 1e-300)
                extra = reference.spreads / np.maximum(size, 1e-300)
            tones = demodulate(values, sample_rate=rate, frequencies=used)
            signals.append(tones.signals * turn)
            variances.append(tones.spreads**2 + (np.abs(tones.signals) * extra) ** 2)
            means.append(tones.offset if waveform.shows_mean else math.nan)
            # Another record of equal length must fit.
            length = len(values) / rate
            if self._clock.now() - began + length > duration * (1 + 1e-9):
                break
        count = len(signals)
        # Frequencies refer to the clock of the generator.
        return Recorded(
            times=np.linspace(0.0, duration, count),
            signals=np.array(signals),
            mean=float(np.mean(means)),
            modulation_frequencies=self._frequencies,
            overload=overload,
            unlocked=unlocked,
            spreads=tuple(np.sqrt(np.sum(variances, axis=0)) / count),
        )

    def relieve(self, overload: Overload) -> bool:
        """Select the next larger range; False if there is none."""
        if self._range == len(self._digitiser.ranges) - 1:
            return False
        self._set_range(self._range + 1)
        return True

    def sharpen(self, amplitude: float) -> bool:
        """Select the next smaller range if the amplitude [V] allows it; else False."""
        if self._range == 0 or amplitude > _FINER_BELOW * self.full_scale():
            return False
        # If the input shows the mean of the detector, the range must include it.
        if self._digitiser.shows_mean:
            return False
        self._set_range(self._range - 1)
        return True

    def full_scale(self) -> float:
        """Return the largest voltage of the present range [V]."""
        return self._digitiser.ranges[self._range]

    def make_safe(self) -> None:
        """Switch the modulation off."""
        self._digitiser.make_safe()

    def close(self) -> None:
        """Close the digitizer."""
        self._digitiser.close()

    def _set_range(self, number: int) -> None:
        self._digitiser.set_range(number)
        self._range = number
