"""Simulated stage controller with the General Command Set 2.0."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass

from amulor.acquisition.protocols import SIMULATOR
from amulor.acquisition.settings import Settings
from amulor.acquisition.simulated.bench import (
    MOUNT_SPEED,
    SCAN_SPEED,
    TARGET_SPEED,
    Bench,
)

#: Answers of ERR?: no error, parameter syntax, unknown command, servo off, position
#: and velocity out of limits, commanded stop, unknown axis, value out of range (chapter
#: "Error codes" of the manuals).
_GOOD, _SYNTAX, _UNKNOWN, _SERVO_OFF, _LIMITS = 0, 1, 2, 5, 7
_VELOCITY, _STOPPED, _NO_AXIS, _BAD_VALUE = 8, 10, 15, 17
#: Commands of one character, without the end of a line: which axes move, whether the
#: controller is ready, stop all.
_MOTION, _READY, _STOP_ALL = "\x05", "\x07", "\x18"
#: Answer to #7 of a controller that is ready.
_IS_READY = "\xb1"
#: Largest velocity relative to the one at the start [1].
_FASTEST = 2.0


@dataclass(frozen=True, kw_only=True)
class _Axis:
    name: str
    """Name of the axis on the bench."""
    unit: float
    """SI units per unit of the axis."""
    zero: float
    """Axis position at which the bench coordinate is zero, in the unit of the axis."""
    speed: float
    """Speed in SI units [1/s]."""
    limit: float
    """Largest position in either direction, in the unit of the axis."""


class _RefusedError(Exception):
    """Refusal of a command, with the error code that ERR? returns."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class SimulatedPiController:
    """Simulated controller of the stages of scanner, polarizers and target."""

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
        self._servo = dict.fromkeys(self._axes, True)
        self._velocity = {
            axis: definition.speed / abs(definition.unit)
            for axis, definition in self._axes.items()
        }
        self._error = _GOOD
        listed = self._listed
        bench = self.bench
        self._questions: dict[str, Callable[[list[str]], list[str]]] = {
            "*IDN?": lambda _: [f"(c) Physik Instrumente, C-884, 0, {SIMULATOR}"],
            "ERR?": lambda _: [str(self._pop_error())],
            "CSV?": lambda _: ["2.0"],
            "VER?": lambda _: [f"FW: {SIMULATOR}"],
            "SAI?": lambda _: (
                [f"{axis} " for axis in [*self._axes][:-1]] + [[*self._axes][-1]]
            ),
            "CST?": lambda axes: listed(axes, lambda _: "SIMULATED"),
            "SVO?": lambda axes: listed(axes, lambda axis: str(int(self._servo[axis]))),
            "FRF?": lambda axes: listed(axes, lambda _: "1"),
            "ONT?": lambda axes: listed(
                axes, lambda axis: str(int(bench.arrived(self._axes[axis].name)))
            ),
            "POS?": lambda axes: listed(
                axes, lambda axis: self._position(axis, bench.place)
            ),
            "MOV?": lambda axes: listed(
                axes, lambda axis: self._position(axis, bench.goal)
            ),
            "TMN?": lambda axes: listed(axes, lambda axis: self._end(axis, -1)),
            "TMX?": lambda axes: listed(axes, lambda axis: self._end(axis, 1)),
            "VEL?": lambda axes: listed(
                axes, lambda axis: f"{self._velocity[axis]:.7f}"
            ),
            "HLP?": lambda _: self._help(),
        }
        self._commands: dict[str, Callable[[list[str]], None]] = {
            "MOV": lambda words: self._move(words, relative=False),
            "MVR": lambda words: self._move(words, relative=True),
            "SVO": self._set_servo,
            "VEL": self._set_velocity,
            "FRF": self._reference,
            "HLT": self._halt,
            "STP": lambda _: self._halt([]),
        }

    #: Commands of one character, without the end of a line.
    at_once = (_MOTION + _READY + _STOP_ALL).encode()

    def answer(self, line: str) -> list[str]:
        """Return the answers to one command line, or to a one-character command."""
        with self._lock:
            if not line:
                return []
            self.lines.append(line)
            del self.lines[:-1000]
            if line == _MOTION:
                return [f"{self._moving():x}"]
            if line == _READY:
                return [_IS_READY]
            if line == _STOP_ALL:
                self._halt([])
                return []
            command, *words = line.split()
            command = command.upper()
            try:
                if command in self._questions:
                    return self._questions[command](words)
                if command in self._commands:
                    self._commands[command](words)
                    return []
            except _RefusedError as refusal:
                self._error = refusal.code
                return []
            # An unknown query has no answer.
            self._error = _UNKNOWN
            return []

    def _pop_error(self) -> int:
        result, self._error = self._error, _GOOD
        return result

    def _moving(self) -> int:
        moving = [not self.bench.arrived(axis.name) for axis in self._axes.values()]
        return sum(1 << place for place, is_moving in enumerate(moving) if is_moving)

    def _refuse_unknown(self, axes: list[str]) -> None:
        if not all(axis in self._axes for axis in axes):
            raise _RefusedError(_NO_AXIS)

    def _pairs(self, words: list[str]) -> dict[str, float]:
        """Parse a command into a number for each axis."""
        axes = words[::2]
        try:
            values = [float(word.replace("_", "?")) for word in words[1::2]]
        except ValueError:
            raise _RefusedError(_SYNTAX) from None
        if not axes or len(values) != len(axes):
            raise _RefusedError(_SYNTAX)
        self._refuse_unknown(axes)
        return dict(zip(axes, values, strict=True))

    def _move(self, words: list[str], *, relative: bool) -> None:
        goals = self._pairs(words)
        # All commands of a line are executed, or none.
        for axis in goals:
            definition = self._axes[axis]
            if not self._servo[axis]:
                raise _RefusedError(_SERVO_OFF)
            if relative:
                goals[axis] += float(self._position(axis, self.bench.goal))
            if not abs(goals[axis] - definition.zero) <= definition.limit:
                raise _RefusedError(_LIMITS)
        moved = {
            self._axes[axis].name: (goal - self._axes[axis].zero)
            * self._axes[axis].unit
            for axis, goal in goals.items()
        }
        first = next(iter(goals))
        speed = self._velocity[first] * abs(self._axes[first].unit)
        self.bench.send(moved, speed=speed)

    def _set_servo(self, words: list[str]) -> None:
        values = self._pairs(words)
        if any(value not in (0, 1) for value in values.values()):
            raise _RefusedError(_BAD_VALUE)
        self._servo |= {axis: bool(value) for axis, value in values.items()}

    def _set_velocity(self, words: list[str]) -> None:
        values = self._pairs(words)
        for axis, value in values.items():
            fastest = _FASTEST * self._axes[axis].speed / abs(self._axes[axis].unit)
            if not 0 < value <= fastest:
                raise _RefusedError(_VELOCITY)
        self._velocity |= values

    def _reference(self, axes: list[str]) -> None:
        self._refuse_unknown(axes)

    def _halt(self, axes: list[str]) -> None:
        self._refuse_unknown(axes)
        self.bench.stop([self._axes[axis].name for axis in axes or self._axes])
        self._error = _STOPPED

    def _position(self, axis: str, of: Callable[[str], float]) -> str:
        definition = self._axes[axis]
        return f"{of(definition.name) / definition.unit + definition.zero:.7f}"

    def _end(self, axis: str, sign: int) -> str:
        definition = self._axes[axis]
        return f"{definition.zero + sign * definition.limit:.7f}"

    def _help(self) -> list[str]:
        words = ["#5 ", "#7 ", "#24 ", *self._questions, *self._commands]
        lines = ["The following commands are valid: ", *words, "end of help"]
        return [f"{line.strip()} " for line in lines[:-1]] + lines[-1:]

    def _listed(self, axes: list[str], value: Callable[[str], str]) -> list[str]:
        self._refuse_unknown(axes)
        lines = [f"{axis}={value(axis)}" for axis in axes or self._axes]
        return [f"{line} " for line in lines[:-1]] + lines[-1:]
