"""Clocks of a scan: real time, scaled real time, or virtual time."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Clock of a scan and its devices; a rehearsal may run faster than real time."""

    def now(self) -> float:
        """Return the time since a fixed origin [s]."""

    def sleep(self, duration: float) -> None:
        """Wait for a duration [s]."""


#: Shortest wait for an instrument in real time, at any speed of a rehearsal [s].
_LEAST = 2.0


class Deadline:
    """Timeout of a wait for an instrument.

    The timeout passes by the clock of the scan. If that clock is faster than real time,
    a part of the timeout must also pass in real time, because links have delays.

    Parameters
    ----------
    clock : Clock
        Clock of the devices.
    timeout : float
        Longest wait [s].
    """

    def __init__(self, clock: Clock, timeout: float) -> None:
        self._clock = clock
        self._end = clock.now() + timeout
        self._real = isinstance(clock, RealClock)
        self._wall = time.monotonic() + min(timeout, _LEAST)

    def passed(self) -> bool:
        """Return whether the timeout has passed."""
        if self._clock.now() <= self._end:
            return False
        return not self._real or time.monotonic() > self._wall


#: Slowest and fastest clock of a rehearsal [1].
SLOWEST, FASTEST = 1e-3, 1e6


class RealClock:
    """Clock that runs in real time, or at a multiple of real time.

    Parameters
    ----------
    speed : float
        Seconds of this clock in one second of real time, 0.001 to a million [1]. Use
        values other than 1 for simulated devices only.
    """

    def __init__(self, speed: float = 1.0) -> None:
        if not SLOWEST <= speed <= FASTEST:
            raise ValueError(
                f"speed must be above 0, from {SLOWEST:g} to {FASTEST:g} times that of "
                f"the wall, got {speed:g}: at less a scan would seem to hang"
            )
        self._speed = speed

    def now(self) -> float:
        """Return the time since a fixed origin [s]."""
        return time.monotonic() * self._speed

    def sleep(self, duration: float) -> None:
        """Wait for a duration [s]."""
        if duration > 0:
            time.sleep(duration / self._speed)


class VirtualClock:
    """Clock of virtual time: a wait advances it at once, without real delay."""

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        """Return the virtual time, the sum of all waits [s]."""
        return self._now

    def sleep(self, duration: float) -> None:
        """Advance the clock by a duration [s], without waiting."""
        self._now += max(duration, 0.0)
