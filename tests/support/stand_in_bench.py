"""A bench whose outputs and axes are set, for one simulated instrument."""

from __future__ import annotations

import math
from typing import Any

from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.simulated.bench import Faults

#: Peak signal that a lock-in shows as 0.3 and 0.4 V rms.
SIGNAL = math.sqrt(2) * complex(0.3, -0.4)
ANGLE = math.degrees(math.atan2(4, 3))


class StandInBench:
    """A bench whose outputs are set, and whose axes are where they are sent."""

    def __init__(self, *faults: str) -> None:
        self.clock = VirtualClock()
        self.faults = Faults.parse(faults)
        self.readings = 0
        self.noise, self.time_constant = 0.2, 0.01
        self.frequencies = [39e6]
        self.rows: list[list[complex]] = []
        self.is_locked, self.interlock_is_closed, self.laser_on = True, True, False
        self.signal, self.traces = SIGNAL, []
        self.places = dict.fromkeys(
            ("azimuth", "elevation", "launch", "analyser", "target"), 0.0
        )
        self.sent: list[Any] = []

    frequency = property(lambda self: self.frequencies[0])

    def set_laser(self, on: bool) -> None:
        self.laser_on = on

    def set_frequency(self, frequency: float) -> None:
        self.frequencies = [frequency]

    def set_frequencies(self, frequencies: list[float]) -> None:
        self.frequencies = [*frequencies]
        self.sent.append([*frequencies])

    def set_time_constant(self, value: float) -> None:
        self.time_constant = value

    def locked(self) -> bool:
        return self.is_locked

    def output(self) -> tuple[complex, float]:
        self.readings += 1
        return self.signal, 0.25

    def outputs(self) -> tuple[list[complex], float]:
        self.readings += 1
        return [self.signal * (k + 1) for k in range(len(self.frequencies))], 0.25

    def start_trace(self, interval: float, **more: float) -> None:
        self.traces.append((interval, more))

    def trace(self) -> list[list[complex]]:
        return self.rows

    def send(self, goals: dict[str, float], *, speed: float) -> None:
        self.sent.append((goals, speed))
        self.places |= goals

    def stop(self, names: Any = None) -> None:
        self.sent.append(names)

    def place(self, name: str) -> float:
        return self.places[name]

    goal = place

    def arrived(self, name: str) -> bool:
        return name != "elevation"

    def arrival(self, name: str) -> float:
        return -math.inf
