"""Connection of all devices in a devices file."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from typing import Any, Protocol, cast

from amulor.acquisition import plan
from amulor.acquisition.clock import Clock, RealClock, VirtualClock
from amulor.acquisition.devices import Devices
from amulor.acquisition.drivers import chosen
from amulor.acquisition.drivers.nmea import NmeaNavigation
from amulor.acquisition.drivers.ophyd_async import OphydLaser
from amulor.acquisition.drivers.pi_gcs import PiTargetStage
from amulor.acquisition.drivers.scpi import ScpiLaser
from amulor.acquisition.links.exclusive import hold
from amulor.acquisition.links.lines import linked, open_link
from amulor.acquisition.protocols import (
    Laser,
    LockIn,
    Navigation,
    Shutter,
    TargetStage,
)
from amulor.acquisition.settings import Settings, ShutterSettings, TargetSettings
from amulor.acquisition.settings.parts import LaserSettings
from amulor.acquisition.simulated.bench import LOCK_TIME, TARGET_SPEED, Bench
from amulor.acquisition.simulated.devices import (
    SimulatedLaser,
    SimulatedLockIn,
    SimulatedMount,
    SimulatedNavigation,
    SimulatedScanner,
    SimulatedShutter,
    SimulatedTargetStage,
)
from amulor.acquisition.simulated.scene import Scene
from amulor.errors import InstrumentError
from amulor.survey import Survey

__all__ = ["connect", "open_link", "simulated_bench"]


#: Largest voltage that counts as off; an enable input of TTL levels needs 0.8 V [V].
_OFF = 0.1


class _HasOutputs(Protocol):
    def identity(self) -> str: ...

    def set_output(self, number: int, voltage: float) -> float: ...

    def input(self, number: int) -> float: ...

    def reconnect(self) -> None: ...


class LockInGate:
    """Laser that an auxiliary output of the lock-in enables."""

    def __init__(self, lock_in: _HasOutputs, settings: LaserSettings) -> None:
        self._lock_in = lock_in
        self._settings = settings

    def identity(self) -> str:
        """Return the output's number and the identity of the lock-in."""
        return f"output {self._settings.output} of {self._lock_in.identity()}"

    def on(self) -> None:
        """Switch the laser on; raise if the interlock is open."""
        self.check()
        self._lock_in.set_output(self._settings.output, self._settings.on_voltage)

    def off(self) -> None:
        """Switch the laser off, and check the output by its read-back."""
        voltage = self._lock_in.set_output(self._settings.output, 0.0)
        if abs(voltage) > _OFF:
            raise InstrumentError(
                f"output {self._settings.output} of the lock-in stands at {voltage:g} "
                "V and not at 0 V: the laser may be on; switch it off by hand"
            )

    def check(self) -> None:
        """Raise if the laser interlock is open."""
        settings = self._settings
        if settings.interlock_input is None:
            return
        voltage = self._lock_in.input(settings.interlock_input)
        if not voltage >= settings.interlock_voltage:
            raise InstrumentError(
                f"the interlock of the laser is open: input {settings.interlock_input} "
                f"of the lock-in stands at {voltage:g} V, closed it has at least "
                f"{settings.interlock_voltage:g} V; see who opened it, and close it"
            )

    def make_safe(self) -> None:
        """Switch the laser off, through a new link if the old link is broken."""
        try:
            self.off()
        except InstrumentError:
            self._lock_in.reconnect()
            self.off()

    def close(self) -> None:
        """Do nothing: the link belongs to the lock-in."""


class LockInShutter:
    """Shutter that an auxiliary output of the lock-in moves."""

    def __init__(
        self, lock_in: _HasOutputs, settings: ShutterSettings, clock: Clock
    ) -> None:
        self._lock_in, self._settings, self._clock = lock_in, settings, clock

    def identity(self) -> str:
        """Return the output's number and the identity of the lock-in."""
        return f"output {self._settings.output} of {self._lock_in.identity()}"

    def shut(self) -> None:
        """Close the shutter, and wait for its motion."""
        self._set(self._settings.closed_voltage)

    def open(self) -> None:
        """Open the shutter, and wait for its motion."""
        self._set(self._settings.open_voltage)

    def _set(self, voltage: float) -> None:
        there = self._lock_in.set_output(self._settings.output, voltage)
        if abs(there - voltage) > _OFF:
            raise InstrumentError(
                f"output {self._settings.output} of the lock-in stands at {there:g} V "
                f"and not at {voltage:g} V: the shutter may be in the other position; "
                "see to its cable"
            )
        self._clock.sleep(self._settings.move_time)

    def make_safe(self) -> None:
        """Close the shutter."""
        self.shut()

    def close(self) -> None:
        """Do nothing: the link belongs to the lock-in."""


class OperatorShutter:
    """Shutter without a motor: an operator moves it."""

    def __init__(self, ask: Callable[[str], None]) -> None:
        self._ask = ask

    def identity(self) -> str:
        """Return "operator"."""
        return "operator"

    def shut(self) -> None:
        """Ask the operator to close the shutter."""
        self._ask("Close the shutter in front of the detector")

    def open(self) -> None:
        """Ask the operator to open the shutter."""
        self._ask("Open the shutter in front of the detector")

    def make_safe(self) -> None:
        """Do nothing: there is no motor."""

    def close(self) -> None:
        """Do nothing: there is no link."""


class OperatorTargetStage:
    """Target stage without a motor: an operator moves the target."""

    def __init__(self, ask: Callable[[str], None]) -> None:
        self._ask = ask

    def identity(self) -> str:
        """Return "operator"."""
        return "operator"

    def bring_in(self, *, timeout: float) -> None:
        """Ask the operator to put the target into the beam."""
        self._ask("The laser is off. Put the target into the beam")

    def take_out(self, *, timeout: float) -> None:
        """Ask the operator to take the target out of the beam."""
        self._ask(
            "The laser is off. Take the target out: only water is to be in the beam"
        )

    def make_safe(self) -> None:
        """Do nothing: there is no motor."""

    def close(self) -> None:
        """Do nothing: there is no link."""


def connect(
    survey: Survey,
    settings: Settings,
    *,
    scene: Scene | None = None,
    part: int = 0,
    elapsed: float = 0.0,
    ask: Callable[[str], None] | None = None,
    shutter_closed: bool = False,
) -> Devices:
    """Connect all devices in the settings of a scan, and switch the laser off.

    Simulated devices have a shutter if the settings or the scan need one. Their vehicle
    has moved since the scan began a time `elapsed` ago [s].
    """
    _refuse_target(survey, settings, ask)
    if settings.simulated:
        devices = _simulated(survey, settings, scene, part, elapsed, shutter_closed)
    else:
        devices = _real(settings, ask)
    try:
        devices.laser.off()
    except BaseException:
        devices.close()
        raise
    return devices


def _refuse_target(
    survey: Survey, settings: Settings, ask: Callable[[str], None] | None
) -> None:
    """Raise if the operator for the target, or a stage for references, is missing."""
    driver = settings.target.driver
    if driver == "operator" and ask is None:
        raise InstrumentError(
            'target.driver = "operator" needs somebody who moves the target, but this '
            "is no terminal; run it on one, or set target.driver to a stage, or to "
            '"none" for a survey without open-water shots'
        )
    if driver == "none" and survey.scan.open_water is not None:
        raise InstrumentError(
            'target.driver is "none", but the survey plans open-water shots, for which '
            "the target must leave the beam; take scan.open_water out of the survey, "
            'or set target.driver to "operator" or to a stage'
        )


def _shutter(
    settings: Settings,
    lock_in: LockIn,
    clock: Clock,
    ask: Callable[[str], None] | None,
) -> Shutter | None:
    part = settings.shutter
    if part is None:
        return None
    if part.driver == "operator":
        if ask is None:
            raise InstrumentError(
                'shutter.driver = "operator" needs somebody who moves the shutter, but '
                "this is no terminal; run it on one, or take the part shutter out"
            )
        return OperatorShutter(ask)
    if not hasattr(lock_in, "set_output"):
        raise InstrumentError(
            f"the lock-in {settings.lock_in.driver!r} has no outputs to move the "
            'shutter by; set shutter.driver to "operator", or take it out'
        )
    return LockInShutter(cast(Any, lock_in), part, clock)


def lead_time(survey: Survey, settings: Settings) -> float:
    """Estimate the time of simulated references before the first row [s]."""
    procedure, target = settings.procedure, settings.target
    dwells = len([*plan.reference_block(survey, procedure, block=0)])
    dwell = survey.scan.dwell + procedure.settling * (
        survey.instrument.lock_in.time_constant
    )
    way = abs(target.position_out - target.position_in)
    moves = 0.0 if survey.scan.open_water is None else 2 * way / TARGET_SPEED
    return dwells * dwell + moves + LOCK_TIME * len(plan.combs(survey, procedure))


def simulated_bench(
    survey: Survey, settings: Settings, *, scene: Scene, clock: Clock, part: int = 0
) -> Bench:
    """Return the simulated bench for a survey."""
    simulation = settings.simulation
    return Bench(
        survey,
        simulation.model_copy(update={"seed": simulation.seed + part}),
        scene=scene,
        clock=clock,
        launch=settings.launch.angles,
        analyser=settings.analyser.angles,
        course=(simulation.seed, lead_time(survey, settings)),
    )


def _simulated(
    survey: Survey,
    settings: Settings,
    scene: Scene | None,
    part: int,
    elapsed: float,
    shutter_closed: bool,
) -> Devices:
    if scene is None:
        raise InstrumentError(
            "simulated devices have no light to measure; hand over "
            "scene=amulor.simulation.scene_light, or settings with real devices"
        )
    speed = settings.simulation.speed
    clock: Clock = VirtualClock() if speed is None else RealClock(speed)
    bench = simulated_bench(survey, settings, scene=scene, clock=clock, part=part)
    navigation = None
    if bench.vehicle is not None:
        navigation = SimulatedNavigation(bench, bench.vehicle, elapsed)
    stated = settings.shutter
    shutter: Shutter | None = None
    if shutter_closed or (stated is not None and stated.driver == "simulated"):
        shutter = SimulatedShutter(bench)
    return Devices(
        shutter=shutter,
        laser=SimulatedLaser(bench),
        lock_in=SimulatedLockIn(bench),
        scanner=SimulatedScanner(bench),
        launch=SimulatedMount(bench, "launch"),
        analyser=SimulatedMount(bench, "analyser"),
        target=SimulatedTargetStage(bench),
        navigation=navigation,
        clock=clock,
    )


def _real(settings: Settings, ask: Callable[[str], None] | None) -> Devices:
    clock = RealClock(settings.procedure.clock_speed)
    with contextlib.ExitStack() as opened:
        # A device that another scan drives receives no command.
        locks = opened.enter_context(contextlib.ExitStack())
        locks.callback(hold(*_addresses(settings)).release)
        lock_in = chosen.lock_in_of(settings, clock)
        opened.callback(lock_in.close)
        stages = chosen.Stages(clock, opened)
        laser = _laser(settings, lock_in, clock)
        opened.callback(laser.close)
        source = chosen.source_of(settings, clock)
        if source is not None:
            opened.callback(source.close)
        devices = Devices(
            laser=laser,
            lock_in=lock_in,
            source=source,
            scanner=chosen.scanner_of(settings, stages, lock_in, clock),
            launch=chosen.mount_of(settings.launch, stages),
            analyser=chosen.mount_of(settings.analyser, stages),
            target=_target(settings.target, stages, ask),
            shutter=_shutter(settings, lock_in, clock, ask),
            clock=clock,
            navigation=_navigation(settings, clock, opened),
            release=locks.close,
        )
        opened.pop_all()
    return devices


def _addresses(settings: Settings) -> list[str]:
    """Return distinct device addresses, or class and arguments for ophyd-async."""
    parts = (
        settings.lock_in,
        settings.scanner,
        settings.launch,
        settings.analyser,
        settings.target,
        settings.laser,
        settings.source,
        settings.digitiser,
    )
    addresses = {
        part.address
        for part in parts
        if part.address is not None and part.driver not in ("none", "operator")
    }
    if settings.navigation is not None and settings.navigation.address is not None:
        addresses.add(settings.navigation.address)
    # A device without an address is identified by its class and arguments.
    definitions = {
        json.dumps([options.get("class"), options.get("arguments")], sort_keys=True)
        for part in parts
        if part.driver == "ophyd_async" and part.address is None
        for options in [getattr(part, "options", None) or {}]
    }
    return sorted(addresses | definitions)


def _laser(settings: Settings, lock_in: LockIn, clock: Clock) -> Laser:
    part = settings.laser
    if part.driver == "scpi":
        link = linked(part)
        try:
            return ScpiLaser(link, part)
        except BaseException:
            link.close()
            raise
    if part.driver == "ophyd_async":
        return OphydLaser.made(chosen.wiring("laser", settings, clock))
    if part.driver != "lock_in_output":
        return cast(Laser, chosen.other("laser", settings, clock))
    for word in ("set_output", "reconnect", *["input"] * bool(part.interlock_input)):
        if not hasattr(lock_in, word):
            raise InstrumentError(
                f"the lock-in {settings.lock_in.driver!r} has no {word!r} to drive and "
                "watch the laser by; choose another laser.driver, or take "
                "laser.interlock_input out"
            )
    return LockInGate(cast(Any, lock_in), part)


def _navigation(
    settings: Settings, clock: Clock, opened: contextlib.ExitStack
) -> Navigation | None:
    part = settings.navigation
    if part is None:
        return None
    source: Navigation
    if part.driver == "nmea":
        source = NmeaNavigation(part, clock=clock)
    else:
        source = cast(Navigation, chosen.other("navigation", settings, clock))
    opened.callback(source.close)
    return source


def _target(
    part: TargetSettings, stages: chosen.Stages, ask: Callable[[str], None] | None
) -> TargetStage | None:
    if part.driver == "none":
        return None
    if part.driver == "operator":
        assert ask is not None
        return OperatorTargetStage(ask)
    return PiTargetStage(stages.at(part), part)
