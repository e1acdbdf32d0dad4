"""Devices of ophyd-async as scanner, lock-in and laser, by the names of their parts."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from amulor.acquisition.clock import Clock, Deadline
from amulor.acquisition.links.ophyd_device import (
    OphydDevice,
    closed_if_it_fails,
    done,
    value_of,
)
from amulor.acquisition.plugins import Wiring
from amulor.acquisition.protocols import Overload, Reading
from amulor.acquisition.settings import ScannerSettings
from amulor.errors import InstrumentError

#: How near a value must be that is read back, in parts.
_SAME = 0.01
_POLL = 0.01
#: What the part `options` must and may say, beside the class.
_LOCK_IN = ("x", "y", "frequency", "time_constant", "full_scale")
_LOCK_IN_MORE = (
    "mean", "input_overload", "output_overload", "unlocked", "phase", "counts",
    "outputs", "inputs",
)  # fmt: skip
_LASER_MORE = ("on", "off", "state", "interlock", "interlock_closed", "current",
               "temperature")  # fmt: skip


class OphydScanner:
    """Two axes of ophyd-async that turn the beam; each has `set` and `locate`."""

    def __init__(
        self,
        device: OphydDevice,
        settings: ScannerSettings,
        *,
        azimuth: str,
        elevation: str,
    ) -> None:
        self._own, self._settings = device, settings
        self._paths = (azimuth, elevation)
        self._axes = [device.part(path) for path in self._paths]
        for path, axis in zip(self._paths, self._axes, strict=True):
            if not (hasattr(axis, "set") and hasattr(axis, "locate")):
                raise InstrumentError(
                    f"{path} of {device.identity()} cannot be set and located, as an "
                    "axis must be; name a movable part in scanner.options"
                )

    @classmethod
    def made(cls, wiring: Wiring, settings: ScannerSettings) -> OphydScanner:
        """Return the scanner that a devices file names."""
        own = OphydDevice.made(
            "scanner", wiring, needed=("azimuth", "elevation"), more=()
        )
        with closed_if_it_fails(own):
            paths = {
                name: str(wiring.options[name]) for name in ("azimuth", "elevation")
            }
            return cls(own, settings, **paths)

    def identity(self) -> str:
        """Return what the device says it is, and its axes."""
        return f"{', '.join(self._paths)} of {self._own.identity()}"

    def move(
        self, azimuth: float, elevation: float, *, timeout: float
    ) -> tuple[float, float]:
        """Turn to a direction [rad] within a time [s]; return where it stands [rad]."""
        goals = self._positions(azimuth, elevation)

        async def there() -> list[Any]:
            pairs = zip(self._axes, goals, strict=True)
            await asyncio.gather(*(done(axis.set(goal)) for axis, goal in pairs))
            return await asyncio.gather(*(done(axis.locate()) for axis in self._axes))

        found = self._own.call(
            f"go to {goals[0]:.6g} and {goals[1]:.6g}", there, timeout=timeout
        )
        own = self._settings
        across, up = (float(place["readback"]) for place in found)
        return (
            (across - own.azimuth_zero) * own.angle_per_unit,
            (up - own.elevation_zero) * own.angle_per_unit,
        )

    def refuse_beyond_reach(
        self, azimuth: Sequence[float], elevation: Sequence[float]
    ) -> None:
        """Raise if an axis that checks its goals refuses one of these [rad]."""
        own = self._settings
        if own.park_azimuth is not None and own.park_elevation is not None:
            azimuth = [*azimuth, own.park_azimuth]
            elevation = [*elevation, own.park_elevation]
        ends = zip(
            self._positions(min(azimuth), min(elevation)),
            self._positions(max(azimuth), max(elevation)),
            strict=True,
        )
        for path, axis, goals in zip(self._paths, self._axes, ends, strict=True):
            check = getattr(axis, "check_value", None)
            if check is None:
                continue
            for goal in goals:
                self._own.call(
                    f"take {path} to {goal:.6g}, where the scan needs it",
                    partial(check, goal),
                )

    def make_safe(self) -> None:
        """Stop both axes, and turn to where they are to be left if that is stated."""
        own, wrong = self._settings, []
        for path, axis in zip(self._paths, self._axes, strict=True):
            if hasattr(axis, "stop"):
                try:
                    self._own.call(f"stop {path}", partial(axis.stop, success=True))
                except InstrumentError as error:  # the other one is to stop, too
                    wrong.append(str(error))
        if wrong:
            raise InstrumentError("; ".join(wrong))
        if own.park_azimuth is not None and own.park_elevation is not None:
            self.move(own.park_azimuth, own.park_elevation, timeout=own.move_timeout)

    def close(self) -> None:
        """Let go of the device."""
        self._own.close()

    def _positions(self, azimuth: float, elevation: float) -> tuple[float, float]:
        own = self._settings
        return (
            own.azimuth_zero + azimuth / own.angle_per_unit,
            own.elevation_zero + elevation / own.angle_per_unit,
        )


class OphydLockIn:
    """A lock-in of ophyd-async; read after `trigger`, if it has that."""

    def __init__(
        self, device: OphydDevice, options: Mapping[str, Any], *, clock: Clock
    ) -> None:
        self._own, self._options, self._clock = device, options, clock
        self._frequency = math.nan
        self._factor = 1.0 if options.get("counts") == "peak" else math.sqrt(2)
        names = ("x", "y", "mean", "input_overload", "output_overload", "unlocked")
        self._names = [name for name in names if name in options]
        self._parts = [device.part(str(options[name])) for name in self._names]
        self._outputs = [str(path) for path in options.get("outputs", ())]
        self._inputs = [str(path) for path in options.get("inputs", ())]
        paths = [options["frequency"], options["time_constant"]]
        for path in [*paths, *self._outputs, *self._inputs]:
            device.part(str(path))

    @classmethod
    def made(cls, wiring: Wiring) -> OphydLockIn:
        """Return the lock-in that a devices file names."""
        own = OphydDevice.made("lock_in", wiring, needed=_LOCK_IN, more=_LOCK_IN_MORE)
        with closed_if_it_fails(own):
            return cls(own, wiring.options, clock=wiring.clock)

    def identity(self) -> str:
        """Return what the device says it is."""
        return self._own.identity()

    def prepare(self, *, time_constant: float) -> None:
        """Set the time constant [s]."""
        path = str(self._options["time_constant"])
        self._own.set(path, time_constant)
        found = float(self._own.value(path))
        if not math.isclose(found, time_constant, rel_tol=_SAME):
            raise InstrumentError(
                f"{self.identity()} makes {found:g} s of a time constant of "
                f"{time_constant:g} s; change instrument.lock_in.time_constant"
            )

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Set the modulation frequency [Hz], wait for lock, return what is set [Hz]."""
        path = str(self._options["frequency"])
        self._own.set(path, frequency, timeout=timeout)
        self._frequency = float(self._own.value(path))
        end = Deadline(self._clock, timeout)
        while self.read().unlocked:
            if end.passed():
                raise InstrumentError(
                    f"{self.identity()} has not locked to {frequency:g} Hz within "
                    f"{timeout:g} s; check the reference"
                )
            self._clock.sleep(_POLL)
        return self._frequency

    def read(self) -> Reading:
        """Return the outputs and the state of this instant."""
        trigger = getattr(self._own.device, "trigger", None)

        async def look() -> list[Any]:
            if trigger is not None:
                await done(trigger())
            return await asyncio.gather(*(value_of(part) for part in self._parts))

        found = dict(zip(self._names, self._own.call("be read", look), strict=True))
        overload = Overload.NONE
        if found.get("input_overload"):
            overload |= Overload.INPUT
        if found.get("output_overload"):
            overload |= Overload.OUTPUT
        y = float(found["y"])
        rises = self._options.get("phase") == "rises"
        return Reading(
            signal=self._factor * complex(float(found["x"]), y if rises else -y),
            mean=float(found.get("mean", math.nan)),
            modulation_frequency=self._frequency,
            overload=overload,
            unlocked=bool(found.get("unlocked", False)),
        )

    def relieve(self, overload: Overload) -> bool:
        """Make no room: the scale is what the options say."""
        return False

    def sharpen(self, amplitude: float) -> bool:
        """Change nothing."""
        return False

    def full_scale(self) -> float:
        """Return the largest peak amplitude [V]."""
        return self._factor * float(self._options["full_scale"])

    def set_output(self, number: int, voltage: float) -> float:
        """Set an auxiliary output, counted from 1 [V]; return what is read back [V]."""
        path = self._numbered("outputs", self._outputs, number)
        self._own.set(path, voltage)
        return float(self._own.value(path))

    def input(self, number: int) -> float:
        """Return the voltage at an auxiliary input, counted from 1 [V]."""
        return float(self._own.value(self._numbered("inputs", self._inputs, number)))

    def reconnect(self) -> None:
        """Do nothing: ophyd-async holds its links itself."""

    def make_safe(self) -> None:
        """Do nothing: a lock-in without light is safe; the laser's gate is its own."""

    def close(self) -> None:
        """Let go of the device."""
        self._own.close()

    def _numbered(self, what: str, paths: Sequence[str], number: int) -> str:
        if not 1 <= number <= len(paths):
            raise InstrumentError(
                f"lock_in.options.{what} names {len(paths)}, asked for was number "
                f"{number}; name it, or change the part laser"
            )
        return paths[number - 1]


class OphydLaser:
    """A laser or a shutter of ophyd-async: a part lets light out, one is read back."""

    def __init__(self, device: OphydDevice, options: Mapping[str, Any]) -> None:
        self._own, self._options = device, options
        self._enable = str(options["enable"])
        self._state = str(options.get("state", self._enable))
        for name in ("enable", "state", "interlock", "current", "temperature"):
            if name in options:
                device.part(str(options[name]))

    @classmethod
    def made(cls, wiring: Wiring) -> OphydLaser:
        """Return the laser that a devices file names."""
        own = OphydDevice.made("laser", wiring, needed=("enable",), more=_LASER_MORE)
        with closed_if_it_fails(own):
            return cls(own, wiring.options)

    def identity(self) -> str:
        """Return what the device says it is."""
        return f"{self._enable} of {self._own.identity()}"

    def on(self) -> None:
        """Let light out, if the interlock is closed."""
        self.check()
        self._own.set(self._enable, self._options.get("on", True))

    def off(self) -> None:
        """Let no light out, and read back that it is so."""
        wanted = self._options.get("off", False)
        self._own.set(self._enable, wanted)
        found = self._own.value(self._state)
        if found != wanted:
            raise InstrumentError(
                f"{self._state} of {self._own.identity()} is {found!r} and not "
                f"{wanted!r}: the laser may be on; switch it off by hand"
            )

    def check(self) -> None:
        """Raise if the interlock is open."""
        if "interlock" not in self._options:
            return
        found = self._own.value(str(self._options["interlock"]))
        if found != self._options.get("interlock_closed", True):
            raise InstrumentError(
                f"the interlock of the laser is open: {self._options['interlock']} of "
                f"{self._own.identity()} is {found!r}; see who opened it, and close it"
            )

    def readings(self) -> dict[str, float]:
        """Return current [A] and temperature [degC] of the diode, as far as known."""
        return {
            f"laser_{name}": float(self._own.value(str(self._options[name])))
            for name in ("current", "temperature")
            if name in self._options
        }

    def make_safe(self) -> None:
        """Let no light out; once more if that has failed."""
        try:
            self.off()
        except InstrumentError:
            self.off()

    def close(self) -> None:
        """Let go of the device."""
        self._own.close()
