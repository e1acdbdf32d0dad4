"""Simulated pan-tilt head with the Pelco-D protocol, on a simulated bench."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator

from amulor.acquisition.simulated.bench import Bench

#: Limit of tilt, down from level, either way; pan has no limit [deg].
_TILT = 90.0
#: Speed of the head [rad/s].
SPEED = math.radians(30.0)


class _Frames:
    """Splitter of received bytes into frames of seven bytes, for one link."""

    def __init__(self) -> None:
        self._rest = b""

    def split(self, received: bytes) -> Iterator[bytes]:
        """Yield frames with a correct checksum, in order."""
        self._rest += received
        while True:
            start = self._rest.find(b"\xff")
            self._rest = b"" if start < 0 else self._rest[start:]
            if len(self._rest) < 7:
                return
            frame = self._rest[:7]
            if sum(frame[1:6]) % 256 == frame[6]:
                yield frame
                self._rest = self._rest[7:]
            else:
                self._rest = self._rest[1:]


class SimulatedPelcoHead:
    """Simulated Pelco-D pan-tilt head that points the beam of a simulated bench.

    Like real heads, it ignores frames with another number, a wrong checksum or an
    unknown command, and acknowledges others by four bytes. It stops at its limits.
    Positions can be queried while it turns.
    """

    def __init__(self, bench: Bench, number: int = 1) -> None:
        self.bench, self._number = bench, number
        self.frames: list[bytes] = []
        self._lock = threading.Lock()

    def cutter(self) -> _Frames:
        """Return a splitter of received bytes, one for each link."""
        return _Frames()

    def answer(self, line: bytes) -> list[bytes]:
        """Return the answers to one Pelco-D frame."""
        with self._lock:
            if line[1] != self._number:
                return []
            self.frames.append(line)
            del self.frames[:-1000]
            command, value = line[2] << 8 | line[3], line[4] << 8 | line[5]
            if command == 0x51:
                return [self._position_frame(0x59, self._degrees("azimuth") % 360.0)]
            if command == 0x53:
                return [self._position_frame(0x5B, -self._degrees("elevation") % 360.0)]
            if command == 0x4B:
                self._turn("azimuth", math.remainder(value / 100, 360.0))
            elif command == 0x4D:
                down = math.remainder(value / 100, 360.0)
                self._turn("elevation", -min(max(down, -_TILT), _TILT))
            elif command == 0 and not value:
                self.bench.stop()
            else:
                return []
            # The general response: sync, number, alarms, checksum.
            body = bytes([self._number, 0])
            return [b"\xff" + body + bytes([(sum(body) + line[6]) % 256])]

    def _turn(self, name: str, degrees: float) -> None:
        self.bench.send({name: math.radians(degrees)}, speed=SPEED)

    def _degrees(self, name: str) -> float:
        """Return the present position of an axis [deg]."""
        place = self.bench.place(name)
        remaining = self.bench.arrival(name) - self.bench.clock.now()
        if 0 < remaining < math.inf:
            goal = self.bench.goal(name)
            place = goal - math.copysign(
                min(remaining * SPEED, abs(goal - place)), goal - place
            )
        return math.degrees(place)

    def _position_frame(self, command: int, degrees: float) -> bytes:
        value = round(degrees * 100) % 36_000
        body = bytes([self._number, 0, command, value // 256, value % 256])
        return b"\xff" + body + bytes([sum(body) % 256])
