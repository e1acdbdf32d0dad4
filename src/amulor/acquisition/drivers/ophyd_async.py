"""Scanner, lock-in and laser that are devices of ophyd-async."""

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

#: Largest relative difference of a read-back value [1].
_SAME = 0.01
_POLL = 0.01
#: Required and further entries of the part `options`, beside the class.
_LOCK_IN = ("x", "y", "frequency", "time_constant", "full_scale")
_LOCK_IN_MORE = (
    "mean", "input_overload", "output_overload", "unlocked", "phase", "counts",
    "outputs", "inputs",
)  # fmt: skip
_LASER_MORE = ("on", "off", "state", "interlock", "interlock_closed", "current",
               "temperature")  # fmt: skip


class OphydScanner:
    """Scanner of two ophyd-async axes, each with `set` and `locate`."""

    def __init__(
        self,
        device: OphydDevice,
        settings: ScannerSettings,
        *,
        azimuth: str,
        elevation: str,
    ) -> None:
        self._device, self._settings = device, settings
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
        """Connect the scanner configured in the devices file."""
        device = OphydDevice.made(
            "scanner", wiring, needed=("azimuth", "elevation"), more=()
        )
        with closed_if_it_fails(device):
            paths = {
                name: str(wiring.options[name]) for name in ("azimuth", "elevation")
            }
            return cls(device, settings, **paths)

    def identity(self) -> str:
        """Return the identity of the device and its axes."""
        return f"{', '.join(self._paths)} of {self._device.identity()}"

    def move(
        self, azimuth: float, elevation: float, *, timeout: float
    ) -> tuple[float, float]:
        """Turn to a direction [rad] within a time [s]; return the read-back [rad]."""
        goals = self._positions(azimuth, elevation)

        async def reach() -> list[Any]:
            pairs = zip(self._axes, goals, strict=True)
            await asyncio.gather(*(done(axis.set(goal)) for axis, goal in pairs))
            return await asyncio.gather(*(done(axis.locate()) for axis in self._axes))

        places = self._device.call(
            f"go to {goals[0]:.6g} and {goals[1]:.6g}", reach, timeout=timeout
        )
        settings = self._settings
        across, up = (float(place["readback"]) for place in places)
        return (
            (across - settings.azimuth_zero) * settings.angle_per_unit,
            (up - settings.elevation_zero) * settings.angle_per_unit,
        )

    def refuse_beyond_reach(
        self, azimuth: Sequence[float], elevation: Sequence[float]
    ) -> None:
        """Raise if an axis refuses a direction [rad] of the scan or of parking."""
        settings = self._settings
        if settings.park_azimuth is not None and settings.park_elevation is not None:
            azimuth = [*azimuth, settings.park_azimuth]
            elevation = [*elevation, settings.park_elevation]
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
                self._device.call(
                    f"take {path} to {goal:.6g}, where the scan needs it",
                    partial(check, goal),
                )

    def make_safe(self) -> None:
        """Stop both axes, and turn to the parking direction, if one is set."""
        settings, wrong = self._settings, []
        for path, axis in zip(self._paths, self._axes, strict=True):
            if hasattr(axis, "stop"):
                try:
                    self._device.call(f"stop {path}", partial(axis.stop, success=True))
                except InstrumentError as error:  # the other axis must stop, too
                    wrong.append(str(error))
        if wrong:
            raise InstrumentError("; ".join(wrong))
        if settings.park_azimuth is not None and settings.park_elevation is not None:
            self.move(
                settings.park_azimuth,
                settings.park_elevation,
                timeout=settings.move_timeout,
            )

    def close(self) -> None:
        """Release the device."""
        self._device.close()

    def _positions(self, azimuth: float, elevation: float) -> tuple[float, float]:
        settings = self._settings
        return (
            settings.azimuth_zero + azimuth / settings.angle_per_unit,
            settings.elevation_zero + elevation / settings.angle_per_unit,
        )


class OphydLockIn:
    """Lock-in as an ophyd-async device; triggered before readings if possible."""

    def __init__(
        self, device: OphydDevice, options: Mapping[str, Any], *, clock: Clock
    ) -> None:
        self._device, self._options, self._clock = device, options, clock
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
        """Connect the lock-in amplifier configured in the devices file."""
        device = OphydDevice.made(
            "lock_in", wiring, needed=_LOCK_IN, more=_LOCK_IN_MORE
        )
        with closed_if_it_fails(device):
            return cls(device, wiring.options, clock=wiring.clock)

    def identity(self) -> str:
        """Return the identity of the device."""
        return self._device.identity()

    def prepare(self, *, time_constant: float) -> None:
        """Set the time constant [s]."""
        path = str(self._options["time_constant"])
        self._device.set(path, time_constant)
        actual = float(self._device.value(path))
        if not math.isclose(actual, time_constant, rel_tol=_SAME):
            raise InstrumentError(
                f"{self.identity()} makes {actual:g} s of a time constant of "
                f"{time_constant:g} s; change instrument.lock_in.time_constant"
            )

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Set the modulation frequency, wait for lock, return the actual one [Hz]."""
        path = str(self._options["frequency"])
        self._device.set(path, frequency, timeout=timeout)
        self._frequency = float(self._device.value(path))
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
        """Return the present outputs, overload bits and lock state."""
        trigger = getattr(self._device.device, "trigger", None)

        async def look() -> list[Any]:
            if trigger is not None:
                await done(trigger())
            return await asyncio.gather(*(value_of(part) for part in self._parts))

        values = dict(zip(self._names, self._device.call("be read", look), strict=True))
        overload = Overload.NONE
        if values.get("input_overload"):
            overload |= Overload.INPUT
        if values.get("output_overload"):
            overload |= Overload.OUTPUT
        y = float(values["y"])
        rises = self._options.get("phase") == "rises"
        return Reading(
            signal=self._factor * complex(float(values["x"]), y if rises else -y),
            mean=float(values.get("mean", math.nan)),
            modulation_frequency=self._frequency,
            overload=overload,
            unlocked=bool(values.get("unlocked", False)),
        )

    def relieve(self, overload: Overload) -> bool:
        """Return False: the scale is fixed in the options."""
        return False

    def sharpen(self, amplitude: float) -> bool:
        """Return False: the scale is fixed in the options."""
        return False

    def full_scale(self) -> float:
        """Return the full scale, as a peak amplitude [V]."""
        return self._factor * float(self._options["full_scale"])

    def set_output(self, number: int, voltage: float) -> float:
        """Set the voltage of auxiliary output 1, 2, ...; return its read-back [V]."""
        path = self._numbered("outputs", self._outputs, number)
        self._device.set(path, voltage)
        return float(self._device.value(path))

    def input(self, number: int) -> float:
        """Return the voltage at auxiliary input 1, 2, ... [V]."""
        return float(self._device.value(self._numbered("inputs", self._inputs, number)))

    def reconnect(self) -> None:
        """Do nothing: ophyd-async reconnects by itself."""

    def make_safe(self) -> None:
        """Do nothing: a lock-in is harmless; the laser has its own safe state."""

    def close(self) -> None:
        """Release the device."""
        self._device.close()

    def _numbered(self, kind: str, paths: Sequence[str], number: int) -> str:
        if not 1 <= number <= len(paths):
            raise InstrumentError(
                f"lock_in.options.{kind} names {len(paths)}, asked for was number "
                f"{number}; name it, or change the part laser"
            )
        return paths[number - 1]


class OphydLaser:
    """Laser or shutter of ophyd-async, with signals to enable it and read it back."""

    def __init__(self, device: OphydDevice, options: Mapping[str, Any]) -> None:
        self._device, self._options = device, options
        self._enable = str(options["enable"])
        self._state = str(options.get("state", self._enable))
        for name in ("enable", "state", "interlock", "current", "temperature"):
            if name in options:
                device.part(str(options[name]))

    @classmethod
    def made(cls, wiring: Wiring) -> OphydLaser:
        """Connect the laser configured in the devices file."""
        device = OphydDevice.made("laser", wiring, needed=("enable",), more=_LASER_MORE)
        with closed_if_it_fails(device):
            return cls(device, wiring.options)

    def identity(self) -> str:
        """Return the identity of the device."""
        return f"{self._enable} of {self._device.identity()}"

    def on(self) -> None:
        """Switch the laser on; raise if the interlock is open."""
        self.check()
        self._device.set(self._enable, self._options.get("on", True))

    def off(self) -> None:
        """Switch the laser off; raise if its state is not off."""
        off_value = self._options.get("off", False)
        self._device.set(self._enable, off_value)
        state = self._device.value(self._state)
        if state != off_value:
            raise InstrumentError(
                f"{self._state} of {self._device.identity()} is {state!r} and not "
                f"{off_value!r}: the laser may be on; switch it off by hand"
            )

    def check(self) -> None:
        """Raise if the laser interlock is open."""
        if "interlock" not in self._options:
            return
        state = self._device.value(str(self._options["interlock"]))
        if state != self._options.get("interlock_closed", True):
            raise InstrumentError(
                f"the interlock of the laser is open: {self._options['interlock']} of "
                f"{self._device.identity()} is {state!r}; see who opened it, and "
                "close it"
            )

    def readings(self) -> dict[str, float]:
        """Return current [A] and temperature [degC] of the diode, if measured."""
        return {
            f"laser_{name}": float(self._device.value(str(self._options[name])))
            for name in ("current", "temperature")
            if name in self._options
        }

    def make_safe(self) -> None:
        """Switch the laser off; try twice if necessary."""
        try:
            self.off()
        except InstrumentError:
            self.off()

    def close(self) -> None:
        """Release the device."""
        self._device.close()
