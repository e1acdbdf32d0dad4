"""Which driver a part of the devices file stands for."""

from __future__ import annotations

import contextlib
from typing import Any, cast

from amulor.acquisition import plugins
from amulor.acquisition.clock import Clock
from amulor.acquisition.drivers.analog import AnalogScanner, outputs_of
from amulor.acquisition.drivers.digitiser import DigitiserLockIn
from amulor.acquisition.drivers.ophyd_async import OphydLockIn, OphydScanner
from amulor.acquisition.drivers.pelco_d import PelcoHead
from amulor.acquisition.drivers.pi_gcs import (
    PiController,
    PiMount,
    PiScanner,
)
from amulor.acquisition.drivers.pymeasure import PymeasureLockIn
from amulor.acquisition.drivers.scpi import ScpiLockIn, ScpiSource
from amulor.acquisition.drivers.stanford import Sr844
from amulor.acquisition.drivers.stanford_sr865a import INPUT_RANGES, Sr865a
from amulor.acquisition.drivers.zurich import ZurichLockIn
from amulor.acquisition.links.lines import OctetLink, SerialPort, linked
from amulor.acquisition.protocols import (
    LockIn,
    RotationMount,
    Scanner,
    Source,
)
from amulor.acquisition.settings import (
    MountSettings,
    ScannerSettings,
    Settings,
    TargetSettings,
)


def other(part: str, settings: Settings, clock: Clock) -> Any:
    """Return a device of another package."""
    driver = getattr(settings, part).driver
    return plugins.make(part, driver, wiring(part, settings, clock))


def wiring(part: str, settings: Settings, clock: Clock) -> plugins.Wiring:
    """Return what a device of another package is made from."""
    own = getattr(settings, part)
    return plugins.Wiring(
        address=own.address, timeout=own.timeout, clock=clock, options=own.options or {}
    )


class Stages:
    """Controllers by their address: several axes share one link."""

    def __init__(self, clock: Clock, opened: contextlib.ExitStack) -> None:
        self._clock = clock
        self._opened = opened
        self._known: dict[str, PiController] = {}

    def at(self, own: ScannerSettings | MountSettings | TargetSettings) -> PiController:
        """Return the controller of a part, made when it is first asked for."""
        assert own.address is not None
        if own.address not in self._known:
            link = linked(own, serial_end=PiController.serial_end)
            self._opened.callback(link.close)
            self._known[own.address] = PiController(link, clock=self._clock)
        return self._known[own.address]


def source_of(settings: Settings, clock: Clock) -> Source | None:
    """Return what modulates the laser, None if the lock-in does."""
    own = settings.source
    if own.driver == "none":
        return None
    if own.driver == "scpi":
        link = linked(own)
        try:
            return ScpiSource(link, own, clock=clock)
        except BaseException:
            link.close()
            raise
    return cast(Source, other("source", settings, clock))


def scanner_of(
    settings: Settings, stages: Stages, lock_in: LockIn, clock: Clock
) -> Scanner:
    """Return what turns the beam."""
    own = settings.scanner
    if own.driver == "analog":
        assert own.analog is not None
        outputs = outputs_of(own.analog, lock_in=lock_in, address=own.address)
        tolerance = settings.procedure.position_tolerance
        try:
            return AnalogScanner(outputs, own.analog, clock=clock, tolerance=tolerance)
        except BaseException:
            outputs.close()
            raise
    if own.driver == "pi_gcs":
        return PiScanner(stages.at(own), own)
    if own.driver == "pelco_d":
        assert own.address is not None
        port = SerialPort(baud_rate=own.baud_rate, flow_control=own.flow_control)
        octets = OctetLink(own.address, timeout=own.timeout, serial=port)
        try:
            return PelcoHead(octets, own, clock=clock)
        except BaseException:
            octets.close()
            raise
    if own.driver == "ophyd_async":
        return OphydScanner.made(wiring("scanner", settings, clock), own)
    return cast(Scanner, other("scanner", settings, clock))


def lock_in_of(settings: Settings, clock: Clock) -> LockIn:
    """Return what measures."""
    own = settings.lock_in
    if own.driver == "digitiser":
        return DigitiserLockIn(other("digitiser", settings, clock), clock=clock)
    if own.driver == "pymeasure":
        return PymeasureLockIn(wiring("lock_in", settings, clock))
    if own.driver == "ophyd_async":
        return OphydLockIn.made(wiring("lock_in", settings, clock))
    if own.driver == "scpi":
        assert own.scpi is not None
        link = linked(own)
        external = own.reference == "external"
        try:
            return ScpiLockIn(link, own.scpi, clock=clock, external=external)
        except BaseException:
            link.close()
            raise
    if own.driver not in ("sr844", "sr865a", "zurich"):
        return cast(LockIn, other("lock_in", settings, clock))
    external = own.reference == "external"
    assert own.address is not None
    if own.driver == "zurich":
        assert own.modulation_amplitude is not None
        return ZurichLockIn.connect(
            own.address,
            mean_output_input=own.mean_output_input,
            modulation_amplitude=own.modulation_amplitude,
            clock=clock,
        )
    driver: type[Sr844 | Sr865a] = Sr844 if own.driver == "sr844" else Sr865a
    link = linked(own, serial_end=driver.serial_end)
    try:
        if own.modulation_amplitude is None:
            return Sr844(
                link,
                mean_output_input=own.mean_output_input,
                clock=clock,
                external=external,
            )
        return Sr865a(
            link,
            mean_output_input=own.mean_output_input,
            modulation_amplitude=own.modulation_amplitude,
            input_range=own.input_range or INPUT_RANGES[0],
            clock=clock,
            external=external,
        )
    except BaseException:
        link.close()
        raise


def mount_of(own: MountSettings, stages: Stages) -> RotationMount | None:
    """Return what turns a polarizer, None if nothing does."""
    return None if own.driver == "none" else PiMount(stages.at(own), own.axis)
