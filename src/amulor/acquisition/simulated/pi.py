"""A simulated stage controller that speaks the General Command Set 2.0."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass

from amulor.acquisition.protocols import SIMULATOR
from amulor.acquisition.settings import Settings
from amulor.acquisition.simulated.bench import (
    MOUNT_SPEED,
    SCAN_SPEED,
    TARGET_SPEED,
    Bench,
)

#: Answers of ERR?: nothing, unknown command, position out of limits, unknown axis,
#: stopped on purpose.
_GOOD, _UNKNOWN, _LIMITS, _NO_AXIS, _STOPPED = 0, 2, 7, 15, 10
#: Asks for the axes that move: the one character 5.
_MOTION = "\x05"
_QUESTIONS = ("POS?", "ONT?", "FRF?", "TMN?", "TMX?")


@dataclass(frozen=True, kw_only=True)
class _Axis:
    name: str
    """What of the bench it moves."""
    unit: float
    """SI units per unit of the axis."""
    zero: float
    """Position of the axis where the bench is at zero."""
    speed: float
    """In SI units [1/s]."""
    limit: float
    """Largest position either way, in the unit of the axis."""


class SimulatedPiController:
    """Five axes: azimuth, elevation, launch, analyser and target.

    Parameters
    ----------
    bench : Bench
        What the axes move.
    settings : Settings
        Their names, units and zeros.
    """

    def __init__(self, bench: Bench, settings: Settings) -> None:
        self.bench = bench
        self.lines: list[str] = []
        self._error = _GOOD
        self._lock = threading.Lock()
        scanner = settings.scanner
        turn, degree = scanner.angle_per_unit, math.radians(1.0)
        half = abs(math.pi / 2 / turn)
        position_units = {
            scanner.azimuth_axis: ("azimuth", turn, scanner.azimuth_zero),
            scanner.elevation_axis: ("elevation", turn, scanner.elevation_zero),
            settings.launch.axis: ("launch", degree, 0.0),
            settings.analyser.axis: ("analyser", degree, 0.0),
            settings.target.axis: ("target", 1e-3, 0.0),
        }
        speeds = {
            "azimuth": (SCAN_SPEED, half),
            "elevation": (SCAN_SPEED, half),
            "launch": (MOUNT_SPEED, 360.0),
            "analyser": (MOUNT_SPEED, 360.0),
            "target": (TARGET_SPEED, 1000.0),
        }
        self._axes = {
            axis: _Axis(
                name=name,
                unit=unit,
                zero=zero,
                speed=speeds[name][0],
                limit=speeds[name][1],
            )
            for axis, (name, unit, zero) in position_units.items()
        }

    def answer(self, line: str) -> list[str]:
        """Return the answer to one line."""
        with self._lock:
            self.lines.append(line)
            del self.lines[:-1000]
            command, *words = line.split() or [""]
            if command == "*IDN?":
                return [f"(c) Physik Instrumente, C-884, 0, {SIMULATOR}"]
            if command == "ERR?":
                result, self._error = self._error, _GOOD
                return [str(result)]
            if command == _MOTION:
                moving = [
                    not self.bench.arrived(axis.name) for axis in self._axes.values()
                ]
                bits = sum(1 << place for place, one in enumerate(moving) if one)
                return [f"{bits:x}"]
            if command in ("STP", "HLT"):
                self.bench.stop()
                self._error = _STOPPED
                return []
            if command == "MOV":
                self._move(words)
                return []
            if command == "SVO":
                self._known(words[::2])
                return []
            if command in _QUESTIONS and self._known(words):
                return self._listed(command, words or [*self._axes])
            self._error = self._error or _UNKNOWN
            return []

    def _known(self, axes: list[str]) -> bool:
        if all(axis in self._axes for axis in axes):
            return True
        self._error = _NO_AXIS
        return False

    def _move(self, words: list[str]) -> None:
        axes = words[::2]
        try:
            goals = [float(word) for word in words[1::2]]
        except ValueError:
            goals = []
        if not axes or len(goals) != len(axes):
            self._error = _UNKNOWN
            return
        if not self._known(axes):
            return
        # A line is carried out as a whole or not at all.
        for axis, goal in zip(axes, goals, strict=True):
            if abs(goal - self._axes[axis].zero) > self._axes[axis].limit:
                self._error = _LIMITS
                return
        moved = {}
        for axis, goal in zip(axes, goals, strict=True):
            own = self._axes[axis]
            moved[own.name] = (goal - own.zero) * own.unit
        self.bench.send(moved, speed=self._axes[axes[0]].speed)

    def _listed(self, command: str, axes: list[str]) -> list[str]:
        lines = []
        for axis in axes:
            own = self._axes[axis]
            if command == "POS?":
                position = self.bench.place(own.name) / own.unit + own.zero
                lines.append(f"{axis}={position:.7f}")
            elif command == "ONT?":
                lines.append(f"{axis}={int(self.bench.arrived(own.name))}")
            elif command in ("TMN?", "TMX?"):
                end = own.limit if command == "TMX?" else -own.limit
                lines.append(f"{axis}={own.zero + end:.7f}")
            else:
                lines.append(f"{axis}=1")
        return [f"{line} " for line in lines[:-1]] + lines[-1:]
