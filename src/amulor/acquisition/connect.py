"""From the devices file to connected devices."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any, cast

from amulor.acquisition import plugins
from amulor.acquisition.clock import Clock, RealClock, VirtualClock
from amulor.acquisition.devices import Devices
from amulor.acquisition.drivers.analog import AnalogScanner, outputs_of
from amulor.acquisition.drivers.digitiser import DigitiserLockIn
from amulor.acquisition.drivers.pi_gcs import (
    PiController,
    PiMount,
    PiScanner,
    PiTargetStage,
)
from amulor.acquisition.drivers.pymeasure import PymeasureLockIn
from amulor.acquisition.drivers.scpi import ScpiLaser, ScpiSource
from amulor.acquisition.drivers.scpi_lock_in import ScpiLockIn
from amulor.acquisition.drivers.stanford_sr844 import Sr844
from amulor.acquisition.drivers.stanford_sr865a import Sr865a
from amulor.acquisition.drivers.zurich import ZurichLockIn
from amulor.acquisition.gate import LockInGate
from amulor.acquisition.links.direct import SCHEME, DirectLink
from amulor.acquisition.links.exclusive import hold
from amulor.acquisition.links.visa import Conversation, Link, SerialPort
from amulor.acquisition.operator import OperatorTargetStage
from amulor.acquisition.protocols import (
    Laser,
    LockIn,
    RotationMount,
    Scanner,
    Source,
    TargetStage,
)
from amulor.acquisition.settings import (
    MountSettings,
    ScannerSettings,
    Settings,
    TargetSettings,
)
from amulor.acquisition.settings.parts import Linked
from amulor.acquisition.simulated.bench import Bench
from amulor.acquisition.simulated.devices import (
    SimulatedLaser,
    SimulatedLockIn,
    SimulatedMount,
    SimulatedScanner,
    SimulatedTargetStage,
)
from amulor.acquisition.simulated.scene import Scene
from amulor.errors import InstrumentError
from amulor.survey import Survey


def connect(
    survey: Survey,
    settings: Settings,
    *,
    scene: Scene | None = None,
    part: int = 0,
    ask: Callable[[str], None] | None = None,
) -> Devices:
    """Connect the devices that a file names.

    Parameters
    ----------
    survey : Survey
        What embedded simulated devices stand in front of.
    settings : Settings
        Which devices, and where.
    scene : callable, optional
        Works out what embedded simulated devices see, such as
        `amulor.simulation.scene_light`; they need it, others do not.
    part : int
        How many parts of the scan there were before; simulated noise is another one
        in each [1].
    ask : callable, optional
        Asks an operator to do something and returns when it is done.

    Returns
    -------
    Devices
        All of them, with the laser off.

    Raises
    ------
    InstrumentError
        If one does not answer, or is another one than stated; if simulated devices
        have no scene.
    MissingExtraError
        If the package that talks to one is not installed.
    """
    if settings.simulated:
        devices = _simulated(survey, settings, scene, part)
    else:
        devices = _real(settings, ask)
    try:
        devices.laser.off()
    except BaseException:
        devices.close()
        raise
    return devices


def simulated_bench(
    survey: Survey, settings: Settings, *, scene: Scene, clock: Clock, part: int = 0
) -> Bench:
    """Return the simulated instrument of a survey.

    Parameters
    ----------
    survey : Survey
        What it stands in front of.
    settings : Settings
        Imperfections, and the angles of the mounts.
    scene : callable
        Works out the light of a survey, such as `amulor.simulation.scene_light`.
    clock : Clock
        What it goes by.
    part : int
        Added to the seed [1].

    Returns
    -------
    Bench
        With the laser off.
    """
    simulation = settings.simulation
    return Bench(
        survey,
        simulation.model_copy(update={"seed": simulation.seed + part}),
        scene=scene,
        clock=clock,
        launch=settings.launch.angles,
        analyser=settings.analyser.angles,
    )


def open_link(
    address: str,
    *,
    timeout: float,
    serial: SerialPort = SerialPort(),  # noqa: B008 - it is frozen
) -> Conversation:
    """Open the link that an address names.

    Parameters
    ----------
    address : str
        VISA resource name, or tcp://host:port for a socket without a VISA library.
    timeout : float
        How long one answer may take [s].
    serial : SerialPort
        How characters go, if the address is that of a serial port.

    Returns
    -------
    Conversation
        Open.

    Raises
    ------
    InstrumentError
        If nothing can be reached there.
    MissingExtraError
        If PyVISA is needed and not installed.
    """
    if address.startswith(SCHEME):
        return DirectLink(address, timeout=timeout)
    return Link.open(address, timeout=timeout, serial=serial)


def _linked(own: Linked, *, serial_end: str = "\n") -> Conversation:
    """Open the link that a part of the devices file states."""
    assert own.address is not None
    port = SerialPort(
        end=serial_end, baud_rate=own.baud_rate, flow_control=own.flow_control
    )
    return open_link(own.address, timeout=own.timeout, serial=port)


def _simulated(
    survey: Survey, settings: Settings, scene: Scene | None, part: int
) -> Devices:
    if scene is None:
        raise InstrumentError(
            "simulated devices have no light to measure; hand over "
            "scene=amulor.simulation.scene_light, or settings with real devices"
        )
    speed = settings.simulation.speed
    clock: Clock = VirtualClock() if speed is None else RealClock(speed)
    bench = simulated_bench(survey, settings, scene=scene, clock=clock, part=part)
    return Devices(
        laser=SimulatedLaser(bench),
        lock_in=SimulatedLockIn(bench),
        scanner=SimulatedScanner(bench),
        launch=SimulatedMount(bench, "launch"),
        analyser=SimulatedMount(bench, "analyser"),
        target=SimulatedTargetStage(bench),
        clock=clock,
    )


def _real(settings: Settings, ask: Callable[[str], None] | None) -> Devices:
    clock = RealClock(settings.procedure.clock_speed)
    with contextlib.ExitStack() as opened:
        # Nothing is said to a device that another scan drives.
        held = opened.enter_context(contextlib.ExitStack())
        for address in _addresses(settings):
            held.callback(hold(address).close)
        lock_in = _lock_in(settings, clock)
        opened.callback(lock_in.close)
        stages = _Stages(clock, opened)
        laser = _laser(settings, lock_in, clock)
        opened.callback(laser.close)
        source = _source(settings, clock)
        if source is not None:
            opened.callback(source.close)
        devices = Devices(
            laser=laser,
            lock_in=lock_in,
            source=source,
            scanner=_scanner(settings, stages, lock_in, clock),
            launch=_mount(settings.launch, stages),
            analyser=_mount(settings.analyser, stages),
            target=_target(settings.target, stages, ask),
            clock=clock,
            release=held.close,
        )
        opened.pop_all()
    return devices


def _addresses(settings: Settings) -> list[str]:
    """Return where devices are reached, each address once."""
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
    return sorted(
        {
            part.address
            for part in parts
            if part.address is not None and part.driver not in ("none", "operator")
        }
    )


class _Stages:
    """Controllers by their address: several axes share one link."""

    def __init__(self, clock: Clock, opened: contextlib.ExitStack) -> None:
        self._clock = clock
        self._opened = opened
        self._known: dict[str, PiController] = {}

    def at(self, own: ScannerSettings | MountSettings | TargetSettings) -> PiController:
        assert own.address is not None
        if own.address not in self._known:
            link = _linked(own, serial_end=PiController.serial_end)
            self._opened.callback(link.close)
            self._known[own.address] = PiController(link, clock=self._clock)
        return self._known[own.address]


def _other(part: str, settings: Settings, clock: Clock) -> Any:
    """Return a device of another package."""
    driver = getattr(settings, part).driver
    return plugins.make(part, driver, _wiring(part, settings, clock))


def _wiring(part: str, settings: Settings, clock: Clock) -> plugins.Wiring:
    own = getattr(settings, part)
    return plugins.Wiring(
        address=own.address, timeout=own.timeout, clock=clock, options=own.options or {}
    )


def _laser(settings: Settings, lock_in: LockIn, clock: Clock) -> Laser:
    own = settings.laser
    if own.driver == "scpi":
        return ScpiLaser(_linked(own), own)
    if own.driver != "lock_in_output":
        return cast(Laser, _other("laser", settings, clock))
    for word in ("set_output", "reconnect", *["input"] * bool(own.interlock_input)):
        if not hasattr(lock_in, word):
            raise InstrumentError(
                f"the lock-in {settings.lock_in.driver!r} has no {word!r} to drive and "
                "watch the laser by; choose another laser.driver, or take "
                "laser.interlock_input out"
            )
    return LockInGate(cast(Any, lock_in), own)


def _source(settings: Settings, clock: Clock) -> Source | None:
    own = settings.source
    if own.driver == "none":
        return None
    if own.driver == "scpi":
        return ScpiSource(_linked(own), own, clock=clock)
    return cast(Source, _other("source", settings, clock))


def _scanner(
    settings: Settings, stages: _Stages, lock_in: LockIn, clock: Clock
) -> Scanner:
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
    return cast(Scanner, _other("scanner", settings, clock))


def _lock_in(settings: Settings, clock: Clock) -> LockIn:
    own = settings.lock_in
    if own.driver == "digitiser":
        return DigitiserLockIn(_other("digitiser", settings, clock), clock=clock)
    if own.driver == "pymeasure":
        return PymeasureLockIn(_wiring("lock_in", settings, clock))
    if own.driver == "scpi":
        assert own.scpi is not None
        link = _linked(own)
        external = own.reference == "external"
        try:
            return ScpiLockIn(link, own.scpi, clock=clock, external=external)
        except BaseException:
            link.close()
            raise
    if own.driver not in ("sr844", "sr865a", "zurich"):
        return cast(LockIn, _other("lock_in", settings, clock))
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
    link = _linked(own, serial_end=driver.serial_end)
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
            clock=clock,
            external=external,
        )
    except BaseException:
        link.close()
        raise


def _mount(own: MountSettings, stages: _Stages) -> RotationMount | None:
    return None if own.driver == "none" else PiMount(stages.at(own), own.axis)


def _target(
    own: TargetSettings, stages: _Stages, ask: Callable[[str], None] | None
) -> TargetStage:
    if own.driver == "operator":
        return OperatorTargetStage(ask)
    return PiTargetStage(stages.at(own), own)
