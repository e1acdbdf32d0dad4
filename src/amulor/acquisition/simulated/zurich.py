"""Simulated UHFLI with the nodes of its data server (from the manual)."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from amulor.acquisition.protocols import SIMULATOR
from amulor.acquisition.simulated.bench import Bench

#: Ticks of its clock in a second (UHF manual: 1.8 GHz).
CLOCKBASE = 1.8e9
#: Fastest rate of the demodulators; others are this divided by powers of two [1/s].
_FASTEST = CLOCKBASE / 128
#: Input and output ranges, peak [V].
_INPUT_RANGES = tuple(0.01 * step for step in range(1, 151))
_OUTPUT_RANGES = (0.15, 1.5)
#: Threshold voltage of the laser gate [V].
_GATE = 2.0
#: Rows in the buffer of a client that does not poll.
_MOST_ROWS = 200_000
#: Nodes that can be set, with their values after power on.
_NODES: tuple[tuple[str, Any], ...] = (
    (r"oscs/[0-7]/freq", 10e6),
    (r"demods/[0-7]/(adcselect|oscselect|sinc|enable)", 0),
    (r"demods/[0-7]/harmonic", 1),
    (r"demods/[0-7]/order", 3),
    (r"demods/[0-7]/phaseshift", 0.0),
    (r"demods/[0-7]/timeconstant", 0.01),
    (r"demods/[0-7]/rate", 1716.0),
    (r"sigins/[01]/range", 1.5),
    (r"sigins/[01]/(ac|imp50)", 0),
    (r"sigouts/[01]/(on|imp50)", 0),
    (r"sigouts/[01]/(offset|range)", 0.0),
    (r"sigouts/[01]/(amplitudes|enables)/[0-7]", 0.0),
    (r"auxouts/[0-3]/(outputselect|offset)", 0.0),
)


class SimulatedNode:
    """Node of the data server; a call with a value sets it, without one reads it."""

    def __init__(self, device: SimulatedUhfli, path: str) -> None:
        self._device, self._path = device, path

    def __getattr__(self, name: str) -> SimulatedNode:
        """Return a child node."""
        return SimulatedNode(self._device, f"{self._path}/{name}")

    def __getitem__(self, number: int) -> SimulatedNode:
        """Return a numbered child node."""
        return SimulatedNode(self._device, f"{self._path}/{number}")

    def __str__(self) -> str:
        """Return the full path of the node."""
        return f"/{self._device.serial}/{self._path}"

    def __call__(self, *value: Any) -> Any:
        """Set the node to a value, or read it without a value."""
        return self._device.handle(self._path, *value)

    def subscribe(self) -> None:
        """Subscribe to the node."""
        self._device.subscribe(self._path)


class _Polled(Mapping[Any, dict[str, Any]]):
    """Result of a poll: streamed data, by path or by node."""

    def __init__(self, content: dict[str, dict[str, Any]]) -> None:
        self._content = content

    def __getitem__(self, key: Any) -> dict[str, Any]:
        return self._content[str(key)]

    def __iter__(self) -> Any:
        return iter(self._content)

    def __len__(self) -> int:
        return len(self._content)


class SimulatedUhfli:
    """Simulated UHFLI on a bench; its first auxiliary output gates the laser.

    An unknown node raises, as in the data server. Each enabled oscillator of the first
    output modulates the laser with the depth of the survey, at any amplitude; input 1
    sees all of them.
    """

    device_type = "UHFLI"

    def __init__(self, bench: Bench, *, options: str = "MF") -> None:
        self.bench, self.serial = bench, f"dev0 ({SIMULATOR})"
        self.session = self
        self._options = options
        self._values: dict[str, Any] = {}
        self._subscribed: set[str] = set()
        self._row: list[complex] = [0j]
        self._driven: list[int] = []
        self._begun = bench.clock.now()

    def __getattr__(self, name: str) -> SimulatedNode:
        """Return a node of the data server."""
        if name.startswith("_"):
            raise AttributeError(name)
        return SimulatedNode(self, name)

    def handle(self, path: str, *value: Any) -> Any:
        """Set or read a node of the data server: a setting or a measured value."""
        if value:
            self._set(path, value[0])
            return None
        special: dict[str, Callable[[], Any]] = {
            "features/options": lambda: self._options,
            "clockbase": lambda: CLOCKBASE,
            "status/time": lambda: self._ticks(self.bench.clock.now()),
            "sigins/0/max": self._reached,
            "sigins/0/min": lambda: -self._reached(),
        }
        if path in special:
            return special[path]()
        if match := re.fullmatch(r"demods/([0-7])/sample", path):
            return self._sample(int(match[1]))
        if match := re.fullmatch(r"auxouts/([0-3])/value", path):
            return self._auxiliary(int(match[1]))
        return self._get(path)

    def subscribe(self, path: str) -> None:
        """Stream a node from now on."""
        if not re.fullmatch(r"demods/[0-7]/sample", path):
            raise RuntimeError(f"ZIException: node {path} cannot be streamed")
        self._subscribed.add(path)
        self._restart()

    def poll(self, recording_time: float = 0.1, *, timeout: float = 0.5) -> _Polled:
        """Wait for a time [s], and return the data streamed since the last poll."""
        self.bench.clock.sleep(recording_time)
        rows = self.bench.trace()
        start, interval = self._trace_start, self._trace_interval
        self._restart(start + len(rows) * interval)
        self._row, mean = self.bench.outputs()
        times = start + np.arange(len(rows)) * interval
        result = {}
        for path in sorted(self._subscribed):
            place = int(path.split("/")[1])
            if not self._get(f"demods/{place}/enable") or not rows:
                continue
            signal = np.array([self._demodulated(row, place) for row in rows])
            result[f"/{self.serial}/{path}"] = {
                "timestamp": np.array([self._ticks(time) for time in times]),
                "x": signal.real / math.sqrt(2),
                "y": -signal.imag / math.sqrt(2),
                "frequency": np.full(len(rows), self._frequency(place)),
                "auxin0": np.full(len(rows), mean),
                "auxin1": np.zeros(len(rows)),
            }
        return _Polled(result)

    def _get(self, path: str) -> Any:
        for pattern, after_power_on in _NODES:
            if re.fullmatch(pattern, path):
                return self._values.get(path, after_power_on)
        raise RuntimeError(f"ZIException: the path /{self.serial}/{path} was not found")

    def _set(self, path: str, value: Any) -> None:
        self._get(path)
        if path.startswith("sigins") and path.endswith("range"):
            value = min(_INPUT_RANGES, key=lambda limit: (limit < value - 1e-9, limit))
        elif path.endswith("/range"):
            value = min(_OUTPUT_RANGES, key=lambda limit: (limit < value - 1e-9, limit))
        elif path.endswith("/rate"):
            value = _FASTEST / 2 ** max(0, round(math.log2(_FASTEST / value)))
        self._values[path] = value
        if path == "demods/0/timeconstant":
            self.bench.set_time_constant(value)
        if path.startswith("auxouts/0/"):
            self.bench.set_laser(self._auxiliary(0) > _GATE)
        if path.startswith(("oscs/", "sigouts/0/")):
            self._drive()
        if path.startswith(("oscs/", "sigouts/0/", "demods/")):
            self._restart()

    def _drive(self) -> None:
        """Modulate the bench with the oscillators enabled on the first output."""
        channels = range(8) if "MF" in self._options.split() else (3,)
        enabled = [
            n
            for n in channels
            if self._get("sigouts/0/on") and self._get(f"sigouts/0/enables/{n}")
        ]
        # Without the option MF, all demodulators use the first oscillator.
        driven = enabled if len(channels) > 1 else [0] * bool(enabled)
        frequencies = [self._get(f"oscs/{n}/freq") for n in driven]
        if frequencies and (driven, frequencies) != (
            self._driven,
            self.bench.frequencies,
        ):
            self.bench.set_frequencies(frequencies)
        self._driven = driven

    def _restart(self, start: float | None = None) -> None:
        """Restart the stream now, or at a time [s]."""
        interval = 1 / self._get("demods/0/rate")
        now = self.bench.clock.now() if start is None else start
        self.bench.start_trace(interval, most=_MOST_ROWS, start=now)
        self._trace_start, self._trace_interval = now, interval

    def _demodulated(self, row: list[complex], place: int) -> complex:
        """Return the output of a demodulator [V]."""
        oscillator = int(self._get(f"demods/{place}/oscselect"))
        if oscillator not in self._driven:
            return 0j
        return row[min(self._driven.index(oscillator), len(row) - 1)]

    def _frequency(self, place: int) -> float:
        oscillator = int(self._get(f"demods/{place}/oscselect"))
        return float(self._get(f"oscs/{oscillator}/freq"))

    def _sample(self, place: int) -> dict[str, Any]:
        self._row, mean = self.bench.outputs()
        signal = self._demodulated(self._row, place) / math.sqrt(2)
        return {
            "timestamp": np.array([self._ticks(self.bench.clock.now())]),
            "x": np.array([signal.real]),
            "y": np.array([-signal.imag]),
            "frequency": np.array([self._frequency(place)]),
            "auxin0": np.array([mean]),
            "auxin1": np.array([0.0]),
        }

    def _reached(self) -> float:
        """Return the largest recent input over the input range [1]."""
        if self.bench.faults.active("overload", self.bench.readings):
            return 1.0
        return float(sum(map(abs, self._row)) / self._get("sigins/0/range"))

    def _auxiliary(self, number: int) -> float:
        manual = self._get(f"auxouts/{number}/outputselect") == -1
        return float(self._get(f"auxouts/{number}/offset")) if manual else 0.0

    def _ticks(self, time: float) -> int:
        return round((time - self._begun) * CLOCKBASE)
