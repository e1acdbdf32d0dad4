"""Selection and connection of the driver for each device in the devices file."""

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
    """Connect a device whose driver comes from another installed package."""
    driver = getattr(settings, part).driver
    return plugins.make(part, driver, wiring(part, settings, clock))


def wiring(part: str, settings: Settings, clock: Clock) -> plugins.Wiring:
    """Return address, timeout, clock and options for the driver of another package."""
    section = getattr(settings, part)
    return plugins.Wiring(
        address=section.address,
        timeout=section.timeout,
        clock=clock,
        options=section.options or {},
    )


class Stages:
    """Links to stage controllers by address; axes at one address share a link."""

    def __init__(self, clock: Clock, opened: contextlib.ExitStack) -> None:
        self._clock = clock
        self._opened = opened
        self._controllers: dict[str, PiController] = {}

    def at(
        self, part: ScannerSettings | MountSettings | TargetSettings
    ) -> PiController:
        """Return the stage controller at a part's address; connect it on first use."""
        assert part.address is not None
        if part.address not in self._controllers:
            link = linked(part, serial_end=PiController.serial_end)
            self._opened.callback(link.close)
            self._controllers[part.address] = PiController(link, clock=self._clock)
        return self._controllers[part.address]


def source_of(settings: Settings, clock: Clock) -> Source | None:
    """Connect the modulation source; None if the lock-in modulates the laser."""
    part = settings.source
    if part.driver == "none":
        return None
    if part.driver == "scpi":
        link = linked(part)
        try:
            return ScpiSource(link, part, clock=clock)
        except BaseException:
            link.close()
            raise
    return cast(Source, other("source", settings, clock))


def scanner_of(
    settings: Settings, stages: Stages, lock_in: LockIn, clock: Clock
) -> Scanner:
    """Connect the scanner configured in the devices file."""
    part = settings.scanner
    if part.driver == "analog":
        assert part.analog is not None
        outputs = outputs_of(part.analog, lock_in=lock_in, address=part.address)
        tolerance = settings.procedure.position_tolerance
        try:
            return AnalogScanner(outputs, part.analog, clock=clock, tolerance=tolerance)
        except BaseException:
            outputs.close()
            raise
    if part.driver == "pi_gcs":
        return PiScanner(stages.at(part), part)
    if part.driver == "pelco_d":
        assert part.address is not None
        port = SerialPort(baud_rate=part.baud_rate, flow_control=part.flow_control)
        octets = OctetLink(part.address, timeout=part.timeout, serial=port)
        try:
            return PelcoHead(octets, part, clock=clock)
        except BaseException:
            octets.close()
            raise
    if part.driver == "ophyd_async":
        return OphydScanner.made(wiring("scanner", settings, clock), part)
    return cast(Scanner, other("scanner", settings, clock))


def lock_in_of(settings: Settings, clock: Clock) -> LockIn:
    """Connect the lock-in amplifier configured in the devices file."""
    part = settings.lock_in
    if part.driver == "digitiser":
        return DigitiserLockIn(other("digitiser", settings, clock), clock=clock)
    if part.driver == "pymeasure":
        return PymeasureLockIn(wiring("lock_in", settings, clock))
    if part.driver == "ophyd_async":
        return OphydLockIn.made(wiring("lock_in", settings, clock))
    if part.driver == "scpi":
        assert part.scpi is not None
        link = linked(part)
        external = part.reference == "external"
        try:
            return ScpiLockIn(link, part.scpi, clock=clock, external=external)
        except BaseException:
            link.close()
            raise
    if part.driver not in ("sr844", "sr865a", "zurich"):
        return cast(LockIn, other("lock_in", settings, clock))
    external = part.reference == "external"
    assert part.address is not None
    if part.driver == "zurich":
        assert part.modulation_amplitude is not None
        return ZurichLockIn.connect(
            part.address,
            mean_output_input=part.mean_output_input,
            modulation_amplitude=part.modulation_amplitude,
            clock=clock,
        )
    driver: type[Sr844 | Sr865a] = Sr844 if part.driver == "sr844" else Sr865a
    link = linked(part, serial_end=driver.serial_end)
    try:
        if part.modulation_amplitude is None:
            return Sr844(
                link,
                mean_output_input=part.mean_output_input,
                clock=clock,
                external=external,
            )
        return Sr865a(
            link,
            mean_output_input=part.mean_output_input,
            modulation_amplitude=part.modulation_amplitude,
            input_range=part.input_range or INPUT_RANGES[0],
            clock=clock,
            external=external,
        )
    except BaseException:
        link.close()
        raise


def mount_of(part: MountSettings, stages: Stages) -> RotationMount | None:
    """Connect the rotation mount of a polarizer; None without a motor."""
    return None if part.driver == "none" else PiMount(stages.at(part), part.axis)
