"""Driver of pan-tilt heads with the Pelco-D protocol, in steps of 0.01 degrees."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from amulor.acquisition.clock import Clock, Deadline
from amulor.acquisition.settings import ScannerSettings
from amulor.acquisition.settings.parts import PanTiltSettings
from amulor.errors import InstrumentError

_SYNC, _LENGTH = 0xFF, 7
#: Second command byte of a position command, of a position query, and of its answer.
_SET = {"pan": 0x4B, "tilt": 0x4D}
_ASK = {"pan": 0x51, "tilt": 0x53}
_ANSWER = {"pan": 0x59, "tilt": 0x5B}
#: Hundredths of a degree in a turn.
_TURN = 36_000
#: Tolerance of an arrived axis in steps, and number of consecutive positions within it.
_NEAR, _LOOKS = 2, 2
#: Waits for an axis at rest near its goal and far from it [s]; time between queries
#: [s].
_STILL, _HELD, _POLL = 1.0, 3.0, 0.02
#: Distance from its goal beyond which an axis was blocked [0.01 degrees].
_ASTRAY = 50
#: Largest number of bytes that may precede an answer.
_MOST_OTHERS = 64


class Octets(Protocol):
    """Interface of a link that sends and receives bytes."""

    address: str

    def send(self, content: bytes) -> None:
        """Send bytes."""

    def receive(self, most: int) -> bytes:
        """Wait for at least one byte, and return the received bytes."""

    def forget(self) -> None:
        """Discard bytes that were received but not read."""

    def reopen(self) -> None:
        """Close the link and open it again."""

    def close(self) -> None:
        """Close the link."""


def frame(number: int, command: int, value: int = 0) -> bytes:
    """Return a Pelco-D message: sync, head number, command, data and checksum.

    Examples
    --------
    >>> frame(1, 0x51).hex(" ")
    'ff 01 00 51 00 00 52'
    """
    body = bytes([number, 0, command, value >> 8, value & 0xFF])
    return bytes([_SYNC]) + body + bytes([sum(body) & 0xFF])


class PelcoHead:
    """Pan-tilt head that turns the whole instrument.

    Commands for positions are 0x4B and 0x4D, queries 0x51 and 0x53, answers 0x59 and
    0x5B. A head reports neither arrival nor refusal. It has arrived when two successive
    positions lie within 0.02 degrees of the goal. A head at rest more than half a
    degree from the goal is an error.
    """

    def __init__(
        self, link: Octets, settings: ScannerSettings, *, clock: Clock
    ) -> None:
        self._link, self._settings, self._clock = link, settings, clock
        self._head = settings.pan_tilt or PanTiltSettings()
        self._signs = {
            "pan": 1 if self._head.pan_counts == "right" else -1,
            "tilt": -1 if self._head.tilt_counts == "down" else 1,
        }
        self._zeros = {
            "pan": settings.azimuth_zero * 100,
            "tilt": settings.elevation_zero * 100,
        }
        self._position("pan")  # raises if no head answers

    def identity(self) -> str:
        """Return protocol and number of the head, which reports no identity."""
        return f"pan-tilt head {self._head.number} by Pelco-D"

    def move(
        self, azimuth: float, elevation: float, *, timeout: float
    ) -> tuple[float, float]:
        """Turn to a direction [rad] within a time [s]; return the read-back [rad]."""
        goals = {
            "pan": self._counted("pan", azimuth),
            "tilt": self._counted("tilt", elevation),
        }
        for axis, goal in goals.items():
            self._link.send(frame(self._head.number, _SET[axis], goal))
        end = Deadline(self._clock, timeout)
        positions = {
            axis: self._arrived(axis, goal, end) for axis, goal in goals.items()
        }
        return self._angle("pan", positions["pan"]), self._angle(
            "tilt", positions["tilt"]
        )

    def refuse_beyond_reach(
        self, azimuth: Sequence[float], elevation: Sequence[float]
    ) -> None:
        """Raise if a direction [rad] is beyond the limits in the settings."""
        settings, head = self._settings, self._head
        if settings.park_azimuth is not None and settings.park_elevation is not None:
            azimuth = [*azimuth, settings.park_azimuth]
            elevation = [*elevation, settings.park_elevation]
        for name, angles, low, high in (
            ("pan", azimuth, head.lowest_pan, head.highest_pan),
            ("tilt", elevation, head.lowest_tilt, head.highest_tilt),
        ):
            if low is None or high is None:
                continue
            if min(angles) < low or max(angles) > high:
                raise InstrumentError(
                    f"the head goes from {math.degrees(low):g} to "
                    f"{math.degrees(high):g} degrees in {name}, the scan needs "
                    f"{math.degrees(min(angles)):.6g} to "
                    f"{math.degrees(max(angles)):.6g}; change the scan, or "
                    f"scanner.pan_tilt.lowest_{name} and highest_{name}"
                )

    def make_safe(self) -> None:
        """Stop both axes, and turn to the parking direction, if one is set."""
        try:
            self._stop()
        except InstrumentError:
            self._link.reopen()
            self._stop()
        settings = self._settings
        if settings.park_azimuth is not None and settings.park_elevation is not None:
            self.move(
                settings.park_azimuth,
                settings.park_elevation,
                timeout=settings.move_timeout,
            )

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def _stop(self) -> None:
        self._link.send(frame(self._head.number, 0))
        self._position("pan")  # raises if no head answers

    def _counted(self, axis: str, angle: float) -> int:
        steps = self._zeros[axis] + self._signs[axis] * math.degrees(angle) * 100
        return round(steps) % _TURN

    def _angle(self, axis: str, position: int) -> float:
        steps = (position - self._zeros[axis]) * self._signs[axis]
        # Wrapped to half a turn on either side of zero.
        return math.radians(((steps + _TURN / 2) % _TURN - _TURN / 2) / 100)

    def _arrived(self, axis: str, goal: int, end: Deadline) -> int:
        """Wait until an axis reaches its goal or stops; return position [0.01 deg]."""
        near, last, since = 0, None, self._clock.now()
        while True:
            position = self._position(axis)
            astray = abs((position - goal + _TURN // 2) % _TURN - _TURN // 2)
            near = near + 1 if astray <= _NEAR else 0
            if near >= _LOOKS:
                return position
            if position != last:
                last, since = position, self._clock.now()
            still = self._clock.now() - since
            if still > _STILL and astray <= _ASTRAY:
                return position
            if still > _HELD or end.passed():
                raise InstrumentError(
                    f"{axis} of the head at {self._link.address} stands at "
                    f"{position / 100:g} degrees and was sent to {goal / 100:g}; see "
                    "what holds it, and where its limits are"
                )
            self._clock.sleep(_POLL)

    def _position(self, axis: str) -> int:
        """Query the position of an axis [0.01 deg]."""
        self._link.forget()
        self._link.send(frame(self._head.number, _ASK[axis]))
        header = bytes([_SYNC, self._head.number, 0, _ANSWER[axis]])
        content = b""
        while len(content) < _MOST_OTHERS:
            content += self._link.receive(_LENGTH)
            # Answers of other heads, and acknowledgements of four bytes, may come
            # first.
            place = content.find(header)
            if place < 0 or len(content) < place + _LENGTH:
                continue
            message = content[place : place + _LENGTH]
            value = message[4] << 8 | message[5]
            if message == frame(self._head.number, _ANSWER[axis], value):
                return value % _TURN
            raise InstrumentError(
                f"the head at {self._link.address} has answered {message.hex(' ')}, "
                "whose last byte is not the sum of those before; check the cable, its "
                "termination and the bits per second"
            )
        raise InstrumentError(
            f"at {self._link.address} is no head with the number {self._head.number} "
            f"that tells its {axis}: {content[:16].hex(' ')} came; see "
            "scanner.pan_tilt.number, and whether the head tells positions"
        )
