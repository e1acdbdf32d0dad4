"""What a device must offer to a scan: SI units, blocking calls, a safe state."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

#: What the identity of every simulated device holds, wherever it runs.
SIMULATOR = "amulor simulator"


class Overload(enum.IntFlag):
    """Where a lock-in ran out of room; bits that add up."""

    NONE = 0
    INPUT = 1
    """The signal input, before any mixing."""
    RESERVE = 2
    """An amplifier between the mixer and the filter."""
    OUTPUT = 4
    """The output filter: the signal itself is larger than the full scale."""
    MEAN = 8
    """An auxiliary input: the mean output of the detector is larger than it takes."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """One look at a lock-in amplifier, all values of one instant."""

    signal: complex
    """Peak amplitude of the modulation, delayed echo with positive phase [V]."""
    mean: float
    """Mean output of the detector, not a number where it is not wired [V]."""
    modulation_frequency: float
    """Frequency that the instrument says it detects at [Hz]."""
    overload: Overload = Overload.NONE
    """What has overloaded since the reading before."""
    unlocked: bool = False
    """Whether the reference was lost at any time since the reading before."""


class Device(Protocol):
    """What every device can do."""

    def identity(self) -> str:
        """Return maker, model, serial number and firmware as the device says them."""

    def make_safe(self) -> None:
        """Bring the device into the state that it may be left alone in.

        It can be called at any time, twice, and after an error.
        """

    def close(self) -> None:
        """Let go of the link to the device; it may be called twice."""


class LockIn(Device, Protocol):
    """A lock-in amplifier that makes its own reference."""

    def prepare(self, *, time_constant: float) -> None:
        """Set internal reference, one-pole output filter and time constant [s]."""

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Set the modulation frequency [Hz], wait for lock, return what is set [Hz]."""

    def read(self) -> Reading:
        """Return the outputs and the state of this instant."""

    def relieve(self, overload: Overload) -> bool:
        """Take one step that makes room for an overload; False if there is none."""

    def sharpen(self, amplitude: float) -> bool:
        """Take one step to a finer scale if this peak amplitude [V] leaves room."""

    def full_scale(self) -> float:
        """Return the largest peak amplitude of the present setting [V]."""


class CombLockIn(LockIn, Protocol):
    """A lock-in amplifier that measures several frequencies at once."""

    def set_frequencies(
        self, frequencies: Sequence[float], *, timeout: float
    ) -> list[float]:
        """Modulate by all of them and nothing else [Hz]; return what is set [Hz].

        `set_frequency` does the same for one.
        """

    def read_all(self) -> list[Reading]:
        """Return the outputs of one instant, in the order of the frequencies."""


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """What a lock-in has recorded during a dwell, by its own clock."""

    times: NDArray[np.float64]
    """Moments, rising, of shape (n,) [s]."""
    signals: NDArray[np.complex128]
    """Peak amplitude at each of them, of shape (n, frequency), delay as a positive
    phase [V]."""
    mean: float
    """Mean output of the detector, not a number where it is not wired [V]."""
    modulation_frequencies: tuple[float, ...]
    """Frequencies that the instrument says it used [Hz]."""
    overload: Overload = Overload.NONE
    """What has overloaded meanwhile."""
    unlocked: bool = False
    """Whether the reference was lost meanwhile."""
    spreads: tuple[float, ...] | None = None
    """Standard deviation of either output of the mean signal, for each frequency, if
    the record tells it [V]."""


class BufferedLockIn(LockIn, Protocol):
    """A lock-in amplifier that records its outputs by its own clock."""

    def record(self, duration: float) -> Recorded:
        """Return the outputs of a time [s] that begins with this call.

        Of all frequencies that are set, at least one moment; the first not before the
        call, and as many as the instrument makes in that time.
        """


class StreamingLockIn(BufferedLockIn, Protocol):
    """A lock-in amplifier that records on and on while it is asked for what it has."""

    def begin_stream(self, duration: float) -> None:
        """Begin to record at once, without a gap, for a time at least [s]."""

    def fetch(self) -> Recorded:
        """Return what has been recorded since the last call, oldest first.

        Its times are by the clock of the scan, evenly spaced over all calls, without a
        gap between two of them; there may be none yet. Mean and state are of now.
        """


@dataclass(frozen=True, kw_only=True)
class Waveform:
    """One record of a digitiser, all inputs at the same moments."""

    signal: NDArray[np.float64]
    """The detector, of shape (n,) [V]."""
    reference: NDArray[np.float64] | None
    """What modulates the laser, of the same shape; None if every record starts in phase
    with it."""
    sample_rate: float
    """As the digitiser counts it [1/s]."""
    clipped: bool = False
    """Whether the converter came to its end."""
    shows_mean: bool = False
    """Whether the mean of the record is the mean output of the detector."""


class Digitiser(Device, Protocol):
    """What records the detector directly; no modulation is its safe state."""

    ranges: tuple[float, ...]
    """Largest voltages that it takes, rising [V]."""
    shows_mean: bool
    """Whether the detector's mean output passes its input."""

    def prepare(self) -> None:
        """Set all that a scan needs."""

    def set_range(self, number: int) -> None:
        """Take one of the ranges, by its number."""

    def set_frequencies(
        self, frequencies: Sequence[float], *, timeout: float
    ) -> list[float]:
        """Modulate by all of them at once [Hz]; return what is put out [Hz]."""

    def acquire(self, duration: float) -> Waveform:
        """Return a record of a time [s], or of what the memory takes."""


class Source(Device, Protocol):
    """A generator that modulates the laser; no output is its safe state.

    The lock-in then takes its reference from the generator.
    """

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Put out a frequency [Hz] within a time [s]; return what it is [Hz]."""


class Scanner(Device, Protocol):
    """What turns the beam, or the instrument with it."""

    def move(
        self, azimuth: float, elevation: float, *, timeout: float
    ) -> tuple[float, float]:
        """Turn to a direction [rad] within a time [s]; return where it stands [rad]."""


class SweepingScanner(Scanner, Protocol):
    """A scanner that moves at a steady rate and says meanwhile where it is."""

    def begin_sweep(self, azimuth: float, elevation: float, *, duration: float) -> None:
        """Set out for a direction [rad], to be there after a time [s]; do not wait."""

    def where(self) -> tuple[float, float]:
        """Return where it is now, also while it moves [rad]."""


class RotationMount(Device, Protocol):
    """A polarizer or a retarder that turns about the beam."""

    def rotate(self, angle: float, *, timeout: float) -> float:
        """Turn to an angle [rad] within a time [s]; return where it stands [rad]."""


class Laser(Device, Protocol):
    """The light source; off is its safe state.

    One that also has a method ``check()`` is asked in every sample with light; it
    raises an `InstrumentError` if the interlock is open, which ends the scan. One with
    a method ``readings()`` is asked in every sample; it returns what it knows of
    ``laser_current`` [A] and ``laser_temperature`` [degC].
    """

    def on(self) -> None:
        """Let light out."""

    def off(self) -> None:
        """Let no light out."""


class TargetStage(Device, Protocol):
    """What takes the target out of the beam, so that only water is seen."""

    def bring_in(self, *, timeout: float) -> float | None:
        """Put the target where it is scanned, within a time [s]; return where [m]."""

    def take_out(self, *, timeout: float) -> float | None:
        """Leave open water in every beam, within a time [s]; return where it is [m].

        None says that nobody can tell.
        """
