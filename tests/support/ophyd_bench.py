"""Devices of ophyd-async in front of a simulated instrument, as a beamline has them."""

from __future__ import annotations

import asyncio
import math
from functools import cached_property
from typing import Any

from bluesky.protocols import Movable
from ophyd_async.core import (
    AsyncStatus,
    MovableLogic,
    StandardMovable,
    StandardReadable,
    soft_signal_r_and_setter,
    soft_signal_rw,
)

#: What the devices that a devices file names stand in front of.
BENCH: list[Any] = []
#: Farthest that an axis goes [deg].
LIMIT = 40.0


class AxisLogic(MovableLogic):
    """Moves one thing of the bench, in degrees."""

    def __init__(self, axis: Axis) -> None:
        super().__init__(setpoint=axis.setpoint, readback=axis.readback)
        self.axis = axis

    async def check_move(self, new_position: float) -> None:
        if abs(new_position) > LIMIT:
            raise ValueError(f"{new_position:g} deg is beyond {LIMIT:g} deg")

    async def stop(self) -> None:
        self.axis.bench.stop()
        self.axis.stops += 1

    async def move(self, new_position: float, timeout: Any) -> None:
        axis = self.axis
        await self.setpoint.set(new_position)
        axis.bench.send({axis.what: math.radians(new_position)}, speed=axis.speed)
        while not axis.bench.arrived(axis.what):
            await asyncio.sleep(1e-3)
        axis.set_readback(math.degrees(axis.bench.place(axis.what)))


class Axis(StandardReadable, StandardMovable[float]):
    """One axis of a head that turns the beam."""

    def __init__(self, bench: Any, what: str, *, speed: float) -> None:
        self.bench, self.what, self.speed, self.stops = bench, what, speed, 0
        with self.add_children_as_readables():
            self.readback, self.set_readback = soft_signal_r_and_setter(
                float, 0.0, units="deg"
            )
        self.setpoint = soft_signal_rw(float, 0.0, units="deg")
        super().__init__()

    @cached_property
    def movable_logic(self) -> AxisLogic:
        return AxisLogic(self)


class Knob(StandardReadable, Movable):
    """A number or a switch of the bench."""

    def __init__(self, kind: type, initial: Any, turned: Any) -> None:
        self._turned = turned
        with self.add_children_as_readables():
            self.value, self._show = soft_signal_r_and_setter(kind, initial)
        super().__init__()

    @AsyncStatus.wrap
    async def set(self, value: Any) -> None:
        self._turned(value)
        self._show(value)


class Head(StandardReadable):
    """Two axes."""

    def __init__(self, speed: float = 5.0, name: str = "") -> None:
        with self.add_children_as_readables():
            self.pan = Axis(BENCH[0], "azimuth", speed=speed)
            self.tilt = Axis(BENCH[0], "elevation", speed=speed)
        super().__init__(name=name)


class Detection(StandardReadable):
    """A lock-in that is read when it is triggered, and the shutter of the laser."""

    def __init__(self, name: str = "") -> None:
        self._bench = bench = BENCH[0]
        self.serial = soft_signal_rw(str, "serial 7")
        self.sine = soft_signal_rw(float, 0.0)
        self.frequency = Knob(float, 1e6, bench.set_frequency)
        self.constant = Knob(float, 0.1, bench.set_time_constant)
        self.shutter = Knob(bool, False, bench.set_laser)
        self.closed, self.show_closed = soft_signal_r_and_setter(bool, True)
        self.x, self._x = soft_signal_r_and_setter(float)
        self.y, self._y = soft_signal_r_and_setter(float)
        self.current, self._mean = soft_signal_r_and_setter(float)
        self.lost, self._lost = soft_signal_r_and_setter(bool)
        super().__init__(name=name)

    @AsyncStatus.wrap
    async def trigger(self) -> None:
        signal, mean = self._bench.output()
        self._x(signal.real / math.sqrt(2))
        self._y(-signal.imag / math.sqrt(2))
        self._mean(mean)
        self._lost(not self._bench.locked())
