"""Interfaces of a scan's devices, with SI units, blocking calls and a safe state."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

#: Part of the identity of every simulated device.
SIMULATOR = "amulor simulator"


class Overload(enum.IntFlag):
    """Overloaded stages of a lock-in, as bit flags."""

    NONE = 0
    INPUT = 1
    """Signal input, before the mixer."""
    RESERVE = 2
    """Amplifier between mixer and filter."""
    OUTPUT = 4
    """Output filter: the signal is larger than the full scale."""
    MEAN = 8
    """Auxiliary input of the mean output of the detector."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """Reading of a lock-in amplifier, all values at one instant."""

    signal: complex
    """Complex signal: peak amplitude, delayed echo with positive phase [V]."""
    mean: float
    """Mean output of the detector, NaN without a wired input [V]."""
    modulation_frequency: float
    """Modulation frequency read back from the instrument [Hz]."""
    overload: Overload = Overload.NONE
    """Overloads since the last reading."""
    unlocked: bool = False
    """Whether the reference was lost since the last reading."""


class Device(Protocol):
    """Methods common to all devices of a scan."""

    def identity(self) -> str:
        """Return maker, model, serial number and firmware from the device."""

    def make_safe(self) -> None:
        """Bring the device into its safe state.

        It can be called at any time, twice, and after an error.
        """

    def close(self) -> None:
        """Close the link to the device; it may be called twice."""


class LockIn(Device, Protocol):
    """Lock-in amplifier that demodulates the detector signal."""

    def prepare(self, *, time_constant: float) -> None:
        """Set the reference, a one-pole output filter and the time constant [s]."""

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Set the modulation frequency, wait for lock, return the actual one [Hz]."""

    def read(self) -> Reading:
        """Return the present outputs, overload bits and lock state."""

    def relieve(self, overload: Overload) -> bool:
        """Increase range or reserve by one step; False if at the maximum."""

    def sharpen(self, amplitude: float) -> bool:
        """Select the next finer scale if the amplitude [V] allows it; else False."""

    def full_scale(self) -> float:
        """Return the full scale of the present setting, as a peak amplitude [V]."""


class CombLockIn(LockIn, Protocol):
    """Lock-in amplifier that measures at several frequencies at once."""

    def set_frequencies(
        self, frequencies: Sequence[float], *, timeout: float
    ) -> list[float]:
        """Modulate at these frequencies only [Hz]; return the actual ones [Hz].

        `set_frequency` does the same for one.
        """

    def read_all(self) -> list[Reading]:
        """Return the present outputs, in the order of the frequencies."""


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """Readings recorded during a dwell, timed by the clock of the lock-in."""

    times: NDArray[np.float64]
    """Times in ascending order, shape (n,) [s]."""
    signals: NDArray[np.complex128]
    """Complex peak signal at each time, delay as positive phase, shape (n, frequency)
    [V]."""
    mean: float
    """Mean output of the detector, NaN without a wired input [V]."""
    modulation_frequencies: tuple[float, ...]
    """Modulation frequencies read back from the instrument [Hz]."""
    overload: Overload = Overload.NONE
    """Overloads during the record."""
    unlocked: bool = False
    """Whether the reference was lost during the record."""
    spreads: tuple[float, ...] | None = None
    """Noise standard deviation of the mean signal per quadrature, for each frequency,
    if estimated from the record [V]."""


class BufferedLockIn(LockIn, Protocol):
    """Lock-in amplifier with a buffer that records its outputs."""

    def record(self, duration: float) -> Recorded:
        """Record the outputs for a time [s] from this call on.

        The record has all frequencies that are set and at least one time, none of them
        before the call.
        """


class StreamingLockIn(BufferedLockIn, Protocol):
    """Lock-in amplifier that streams its outputs without a gap."""

    def begin_stream(self, duration: float) -> None:
        """Start at once to record outputs without gaps, for at least a time [s]."""

    def fetch(self) -> Recorded:
        """Return the outputs recorded since the last call, oldest first.

        Its times are by the clock of the scan, evenly spaced over all calls without a
        gap; there may be none yet. Mean and state are the present ones.
        """


@dataclass(frozen=True, kw_only=True)
class Waveform:
    """Record of a digitizer, all inputs sampled at the same times."""

    signal: NDArray[np.float64]
    """Output of the detector, shape (n,) [V]."""
    reference: NDArray[np.float64] | None
    """Modulation signal of the laser, shape (n,); None if every record starts in phase
    with the modulation."""
    sample_rate: float
    """Sample rate by the clock of the digitizer [1/s]."""
    clipped: bool = False
    """Whether the signal exceeded the input range of the converter."""
    shows_mean: bool = False
    """Whether the mean of the record is the mean output of the detector."""


class Digitiser(Device, Protocol):
    """Digitizer of the detector signal; its modulation is off in the safe state."""

    ranges: tuple[float, ...]
    """Input ranges as peak voltages, in ascending order [V]."""
    shows_mean: bool
    """Whether the mean of a record is the mean output of the detector."""

    def prepare(self) -> None:
        """Configure the digitizer for a scan."""

    def set_range(self, number: int) -> None:
        """Select an input range by its index in the attribute `ranges`."""

    def set_frequencies(
        self, frequencies: Sequence[float], *, timeout: float
    ) -> list[float]:
        """Modulate at several frequencies at once [Hz]; return the actual ones [Hz]."""

    def acquire(self, duration: float) -> Waveform:
        """Return a record of a duration [s], shorter if the memory is full."""


class Source(Device, Protocol):
    """Generator that modulates the laser; its output is off in the safe state.

    The lock-in then takes its reference from the generator.
    """

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Output a frequency [Hz] within a time [s]; return the actual one [Hz]."""


class Scanner(Device, Protocol):
    """Scanner that turns the beam or the whole instrument."""

    def move(
        self, azimuth: float, elevation: float, *, timeout: float
    ) -> tuple[float, float]:
        """Turn to a direction [rad] within a time [s]; return the read-back [rad]."""


class SweepingScanner(Scanner, Protocol):
    """Scanner that moves steadily and can be read during the motion."""

    def begin_sweep(self, azimuth: float, elevation: float, *, duration: float) -> None:
        """Start a motion that reaches a direction [rad] after a time [s]."""

    def where(self) -> tuple[float, float]:
        """Return the present direction, also during a motion [rad]."""


class RotationMount(Device, Protocol):
    """Rotation mount of a polarizer or a retarder."""

    def rotate(self, angle: float, *, timeout: float) -> float:
        """Turn to an angle [rad] within a time [s]; return the read-back [rad]."""


class Laser(Device, Protocol):
    """Laser, which is off in its safe state.

    An optional method ``check()`` is called in every sample with light; it raises an
    `InstrumentError` if the interlock is open, which ends the scan. An optional method
    ``readings()`` is called in every sample; it returns ``laser_current`` [A] and
    ``laser_temperature`` [degC], or one of them.
    """

    def on(self) -> None:
        """Switch the laser on."""

    def off(self) -> None:
        """Switch the laser off."""


class Shutter(Device, Protocol):
    """Shutter in front of the detector, closed in its safe state."""

    def shut(self) -> None:
        """Close the shutter: no light from the water reaches the detector."""

    def open(self) -> None:
        """Open the shutter."""


class Navigation(Device, Protocol):
    """Source of the poses of the vehicle that carries the instrument."""

    def begin(self) -> None:
        """Start to receive messages."""

    def messages(self) -> list[tuple[float, str]]:
        """Return the messages since the last call, in the order of their arrival.

        Each has its time of arrival by the clock of the scan [s], and a line of text
        from `amulor.platform.pose_line`, or a sentence of NMEA 0183. A lost link
        is no error: the scan goes on, and its readings have no pose until the next
        message.
        """


class TargetStage(Device, Protocol):
    """Stage that takes the target out of the beam for open-water references."""

    def bring_in(self, *, timeout: float) -> float | None:
        """Put the target into the beam within a time [s]; return its position [m]."""

    def take_out(self, *, timeout: float) -> float | None:
        """Take the target out of the beam in a time [s]; return its position [m].

        None means that the position is not measured.
        """
