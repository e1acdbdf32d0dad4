"""A simulated pan-tilt head that speaks Pelco-D, in front of a bench."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator

from amulor.acquisition.simulated.bench import Bench

#: Pan goes round, to the right; tilt down, from level, up to this far either way [deg].
_TILT = 90.0
#: How fast it turns [rad/s].
SPEED = math.radians(30.0)


class _Frames:
    """Cuts what comes over one link into frames of seven bytes; others are noise."""

    def __init__(self) -> None:
        self._rest = b""

    def taken(self, received: bytes) -> Iterator[bytes]:
        """Yield frames whose checksum is right, in the order in which they came."""
        self._rest += received
        while True:
            start = self._rest.find(b"\xff")
            self._rest = b"" if start < 0 else self._rest[start:]
            if len(self._rest) < 7:
                return
            one = self._rest[:7]
            if sum(one[1:6]) % 256 == one[6]:
                yield one
                self._rest = self._rest[7:]
            else:
                self._rest = self._rest[1:]


class SimulatedPelcoHead:
    """A head that turns azimuth and elevation of a bench.

    As heads do, it takes no notice of frames with another number, a wrong checksum or a
    command that it does not know, and acknowledges the others by four bytes. Beyond its
    limit stops it goes as far as they let it. Positions are told while it turns, too.
    """

    def __init__(self, bench: Bench, number: int = 1) -> None:
        self.bench, self._number = bench, number
        self.frames: list[bytes] = []
        self._lock = threading.Lock()

    def cutter(self) -> _Frames:
        """Return what cuts the bytes of one link."""
        return _Frames()

    def answer(self, line: bytes) -> list[bytes]:
        """Return the answers to one frame."""
        with self._lock:
            if line[1] != self._number:
                return []
            self.frames.append(line)
            del self.frames[:-1000]
            command, value = line[2] << 8 | line[3], line[4] << 8 | line[5]
            if command == 0x51:
                return [self._told(0x59, self._degrees("azimuth") % 360.0)]
            if command == 0x53:
                return [self._told(0x5B, -self._degrees("elevation") % 360.0)]
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
        """Return where an axis is, on its way as well."""
        place = self.bench.place(name)
        left = self.bench.arrival(name) - self.bench.clock.now()
        if 0 < left < math.inf:
            goal = self.bench.goal(name)
            place = goal - math.copysign(
                min(left * SPEED, abs(goal - place)), goal - place
            )
        return math.degrees(place)

    def _told(self, command: int, degrees: float) -> bytes:
        value = round(degrees * 100) % 36_000
        body = bytes([self._number, 0, command, value // 256, value % 256])
        return b"\xff" + body + bytes([sum(body) % 256])
