"""Pan-tilt heads by Pelco-D: frames of seven bytes, positions of 0.01 degrees."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from amulor.acquisition.clock import Clock, Deadline
from amulor.acquisition.settings import ScannerSettings
from amulor.acquisition.settings.parts import PanTiltSettings
from amulor.errors import InstrumentError

_SYNC, _LENGTH = 0xFF, 7
#: Second command byte: set a position, ask for one, and what the answer has instead.
_SET = {"pan": 0x4B, "tilt": 0x4D}
_ASK = {"pan": 0x51, "tilt": 0x53}
_ANSWER = {"pan": 0x59, "tilt": 0x5B}
#: Hundredths of a degree in a turn.
_TURN = 36_000
#: Steps within which an axis is there, and looks one after the other that say so.
_NEAR, _LOOKS = 2, 2
#: How long an axis that stands near its goal, and far from it, is waited for [s]; and
#: time between looks [s].
_STILL, _HELD, _POLL = 1.0, 3.0, 0.02
#: Farther from where it was sent, an axis was held up [0.01 degrees].
_ASTRAY = 50
#: Most bytes that may come before an answer.
_MOST_OTHERS = 64


class Octets(Protocol):
    """What the driver needs of a link; a test can be one, too."""

    address: str

    def send(self, content: bytes) -> None:
        """Send bytes."""

    def receive(self, most: int) -> bytes:
        """Return what has come, at least one byte."""

    def forget(self) -> None:
        """Throw away what has come."""

    def reopen(self) -> None:
        """Close the link and open it again."""

    def close(self) -> None:
        """Close the link."""


def frame(number: int, command: int, value: int = 0) -> bytes:
    """Return a message: sync, number, two command bytes, two data bytes, checksum.

    Examples
    --------
    >>> frame(1, 0x51).hex(" ")
    'ff 01 00 51 00 00 52'
    """
    body = bytes([number, 0, command, value >> 8, value & 0xFF])
    return bytes([_SYNC]) + body + bytes([sum(body) & 0xFF])


class PelcoHead:
    """Pan and tilt of a head, which turns the whole instrument.

    Set positions are 0x4B and 0x4D, questions 0x51 and 0x53, answers 0x59 and 0x5B. A
    head says neither that it has arrived nor that it refuses: it has arrived where two
    looks in a row find it within 0.02 degrees of its goal, and one that no longer moves
    and stands farther off than half a degree is an error.
    """

    def __init__(
        self, link: Octets, settings: ScannerSettings, *, clock: Clock
    ) -> None:
        self._link, self._own, self._clock = link, settings, clock
        self._head = settings.pan_tilt or PanTiltSettings()
        self._signs = {
            "pan": 1 if self._head.pan_counts == "right" else -1,
            "tilt": -1 if self._head.tilt_counts == "down" else 1,
        }
        self._zeros = {
            "pan": settings.azimuth_zero * 100,
            "tilt": settings.elevation_zero * 100,
        }
        self._position("pan")  # raises if nobody is there

    def identity(self) -> str:
        """Return the protocol and the number; a head does not say who it is."""
        return f"pan-tilt head {self._head.number} by Pelco-D"

    def move(
        self, azimuth: float, elevation: float, *, timeout: float
    ) -> tuple[float, float]:
        """Turn to a direction [rad] within a time [s]; return where it stands [rad]."""
        goals = {
            "pan": self._counted("pan", azimuth),
            "tilt": self._counted("tilt", elevation),
        }
        for axis, goal in goals.items():
            self._link.send(frame(self._head.number, _SET[axis], goal))
        end = Deadline(self._clock, timeout)
        stands = {axis: self._arrived(axis, goal, end) for axis, goal in goals.items()}
        return self._angle("pan", stands["pan"]), self._angle("tilt", stands["tilt"])

    def refuse_beyond_reach(
        self, azimuth: Sequence[float], elevation: Sequence[float]
    ) -> None:
        """Raise if a direction [rad] is beyond the ends that are stated."""
        own, head = self._own, self._head
        if own.park_azimuth is not None and own.park_elevation is not None:
            azimuth = [*azimuth, own.park_azimuth]
            elevation = [*elevation, own.park_elevation]
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
        """Stop, and turn to where it is to be left if that is stated."""
        try:
            self._stop()
        except InstrumentError:
            self._link.reopen()
            self._stop()
        own = self._own
        if own.park_azimuth is not None and own.park_elevation is not None:
            self.move(own.park_azimuth, own.park_elevation, timeout=own.move_timeout)

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def _stop(self) -> None:
        self._link.send(frame(self._head.number, 0))
        self._position("pan")  # raises if nobody is there

    def _counted(self, axis: str, angle: float) -> int:
        steps = self._zeros[axis] + self._signs[axis] * math.degrees(angle) * 100
        return round(steps) % _TURN

    def _angle(self, axis: str, position: int) -> float:
        steps = (position - self._zeros[axis]) * self._signs[axis]
        # Between half a turn to either side of the zero.
        return math.radians(((steps + _TURN / 2) % _TURN - _TURN / 2) / 100)

    def _arrived(self, axis: str, goal: int, end: Deadline) -> int:
        """Return where an axis stands when it is there, or moves no more."""
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
        """Return what a head answers to the question for a position."""
        self._link.forget()
        self._link.send(frame(self._head.number, _ASK[axis]))
        wanted = bytes([_SYNC, self._head.number, 0, _ANSWER[axis]])
        content = b""
        while len(content) < _MOST_OTHERS:
            content += self._link.receive(_LENGTH)
            # Others on the line, and acknowledgements of four bytes, may come first.
            place = content.find(wanted)
            if place < 0 or len(content) < place + _LENGTH:
                continue
            found = content[place : place + _LENGTH]
            value = found[4] << 8 | found[5]
            if found == frame(self._head.number, _ANSWER[axis], value):
                return value % _TURN
            raise InstrumentError(
                f"the head at {self._link.address} has answered {found.hex(' ')}, "
                "whose last byte is not the sum of those before; check the cable, its "
                "termination and the bits per second"
            )
        raise InstrumentError(
            f"at {self._link.address} is no head with the number {self._head.number} "
            f"that tells its {axis}: {content[:16].hex(' ')} came; see "
            "scanner.pan_tilt.number, and whether the head tells positions"
        )
