"""The time that a scan and its devices go by: real, faster, or only counted."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Where the time comes from, so that a rehearsal can be faster than a scan."""

    def now(self) -> float:
        """Return the time since some fixed moment [s]."""

    def sleep(self, duration: float) -> None:
        """Wait for a time [s]."""


#: Shortest wait for an instrument on the wall, however fast a rehearsal goes [s].
_LEAST = 2.0


class Deadline:
    """The end of a wait for an instrument.

    Over when the time has passed by the clock of the scan, and at least a part of it on
    the wall: answers take their time on the wire, also where the clock runs faster.

    Parameters
    ----------
    clock : Clock
        What the devices go by.
    timeout : float
        How long the wait may be [s].
    """

    def __init__(self, clock: Clock, timeout: float) -> None:
        self._clock = clock
        self._end = clock.now() + timeout
        self._real = isinstance(clock, RealClock)
        self._wall = time.monotonic() + min(timeout, _LEAST)

    def passed(self) -> bool:
        """Return whether the wait is over."""
        if self._clock.now() <= self._end:
            return False
        return not self._real or time.monotonic() > self._wall


#: Slowest and fastest clock of a rehearsal [1].
SLOWEST, FASTEST = 1e-3, 1e6


class RealClock:
    """The time on the wall, or a multiple of it.

    Parameters
    ----------
    speed : float
        How many seconds of this clock pass in one second, 0.001 to a million [1].
        Anything but 1 is for simulated devices.
    """

    def __init__(self, speed: float = 1.0) -> None:
        if not SLOWEST <= speed <= FASTEST:
            raise ValueError(
                f"speed must be above 0, from {SLOWEST:g} to {FASTEST:g} times that of "
                f"the wall, got {speed:g}: at less a scan would seem to hang"
            )
        self._speed = speed

    def now(self) -> float:
        """Return the time since some fixed moment [s]."""
        return time.monotonic() * self._speed

    def sleep(self, duration: float) -> None:
        """Wait for a time [s]."""
        if duration > 0:
            time.sleep(duration / self._speed)


class VirtualClock:
    """A clock that jumps instead of waiting, for devices in the same program."""

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        """Return the time that has been slept so far [s]."""
        return self._now

    def sleep(self, duration: float) -> None:
        """Let a time [s] pass at once."""
        self._now += max(duration, 0.0)
