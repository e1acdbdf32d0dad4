"""Devices behind real drivers, all in one process: each way a lab may be wired."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.connect import LockInGate, simulated_bench
from amulor.acquisition.devices import Devices
from amulor.acquisition.drivers.analog import AnalogScanner, LockInOutputs
from amulor.acquisition.drivers.digitiser import DigitiserLockIn
from amulor.acquisition.drivers.pelco_d import PelcoHead
from amulor.acquisition.drivers.pi_gcs import (
    PiController,
    PiMount,
    PiScanner,
    PiTargetStage,
)
from amulor.acquisition.drivers.stanford_sr865a import Sr865a
from amulor.acquisition.drivers.zurich import ZurichLockIn
from amulor.acquisition.settings import LaserSettings, ScannerSettings, Settings
from amulor.acquisition.settings.parts import AnalogSettings
from amulor.acquisition.simulated.bench import SCAN_SPEED, Bench
from amulor.acquisition.simulated.devices import (
    SimulatedDigitiser,
    SimulatedLaser,
    SimulatedLockIn,
    SimulatedMount,
    SimulatedScanner,
    SimulatedTargetStage,
)
from amulor.acquisition.simulated.pelco_head import SimulatedPelcoHead
from amulor.acquisition.simulated.pi import SimulatedPiController
from amulor.acquisition.simulated.sr865a import SimulatedSr865a
from amulor.acquisition.simulated.zurich import SimulatedUhfli
from amulor.survey import Survey

#: Angle of a mirror's beam per volt [rad/V].
_TURN = 0.035


class Lines:
    """A conversation without a wire."""

    address = "no wire"

    def __init__(self, answer: Callable[[str], list[str]]) -> None:
        self._answer = answer

    def send(self, line: str) -> None:
        self._answer(line)

    def ask(self, line: str, *, answers: int = 1) -> list[str]:
        return [text for one in line.split("\n") for text in self._answer(one)]

    def reopen(self) -> None:
        pass

    def close(self) -> None:
        pass


class Octets:
    """The same of bytes."""

    address = "no wire"

    def __init__(self, head: SimulatedPelcoHead) -> None:
        self._head, self._cutter, self._left = head, head.cutter(), b""

    def send(self, content: bytes) -> None:
        for one in self._cutter.split(content):
            self._left += b"".join(self._head.answer(one))

    def receive(self, most: int) -> bytes:
        found, self._left = self._left[:most], self._left[most:]
        assert found, "nobody answers"
        return found

    def forget(self) -> None:
        self._left = b""

    def reopen(self) -> None:
        pass

    def close(self) -> None:
        pass


class Mirrors(LockInOutputs):
    """Auxiliary outputs that turn the mirrors of a bench."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        super().__init__(self)

    def identity(self) -> str:
        return "outputs of a bench"

    def set_output(self, number: int, voltage: float) -> float:
        voltage = round(voltage, 3)
        name = {1: "azimuth", 2: "elevation"}[number]
        self._bench.send({name: voltage * _TURN}, speed=SCAN_SPEED)
        return voltage


def _mirrors(bench: Bench, clock: VirtualClock) -> AnalogScanner:
    volts = [float(volt) for volt in np.linspace(-9, 9, 5)]
    one = {"volts": volts, "angles": [volt * _TURN for volt in volts]}
    own = AnalogSettings.model_validate(
        {
            "outputs": "lock_in",
            "settling": 0.05,
            "azimuth": {"output": "1", **one},
            "elevation": {"output": "2", **one},
        }
    )
    return AnalogScanner(Mirrors(bench), own, clock=clock, tolerance=1e-3)


def devices_of(
    way: str, survey: Survey, settings: Settings, *, scene: Any, part: int
) -> Devices:
    """Return the devices of a way: embedded, sr865a, uhfli, digitiser, mirrors, head.

    What a way has no driver for is embedded; `sr865a` and `uhfli` drive stages and the
    gate of the laser, too.
    """
    clock = VirtualClock()
    bench = simulated_bench(survey, settings, scene=scene, clock=clock, part=part)
    parts: dict[str, Any] = {
        "laser": SimulatedLaser(bench),
        "lock_in": SimulatedLockIn(bench),
        "scanner": SimulatedScanner(bench),
        "launch": SimulatedMount(bench, "launch"),
        "analyser": SimulatedMount(bench, "analyser"),
        "target": SimulatedTargetStage(bench),
    }
    if way in ("sr865a", "uhfli"):
        lock_in: Any
        if way == "sr865a":
            link = Lines(SimulatedSr865a(bench).answer)
            lock_in = Sr865a(
                link, mean_output_input=1, modulation_amplitude=0.1, clock=clock
            )
        else:
            lock_in = ZurichLockIn(
                SimulatedUhfli(bench), mean_output_input=1, modulation_amplitude=0.1,
                clock=clock,
            )  # fmt: skip
        stages = PiController(
            Lines(SimulatedPiController(bench, settings).answer), clock=clock
        )
        parts = {
            "laser": LockInGate(lock_in, LaserSettings(driver="lock_in_output")),
            "lock_in": lock_in,
            "scanner": PiScanner(stages, settings.scanner),
            "launch": PiMount(stages, settings.launch.axis),
            "analyser": PiMount(stages, settings.analyser.axis),
            "target": PiTargetStage(stages, settings.target),
        }
    elif way == "digitiser":
        card = SimulatedDigitiser(bench, memory=1024)
        parts["lock_in"] = DigitiserLockIn(card, clock=clock)
    elif way == "mirrors":
        parts["scanner"] = _mirrors(bench, clock)
    elif way == "head":
        parts["scanner"] = PelcoHead(
            Octets(SimulatedPelcoHead(bench)),
            ScannerSettings(driver="pelco_d", address="no wire"),
            clock=clock,
        )
    else:
        assert way == "embedded", way
    return Devices(**parts, clock=clock)


class Wire:
    """A link whose packets take a time each way by the clock of the devices [s]."""

    address = "a wire"

    def __init__(
        self, answer: Callable[[str], list[str]], clock: VirtualClock, late: float
    ) -> None:
        self._answer, self._clock, self._late = answer, clock, late
        self.questions = 0

    def send(self, line: str) -> None:
        self._clock.sleep(self._late)
        self._answer(line)

    def ask(self, line: str, *, answers: int = 1) -> list[str]:
        self.questions += 1
        self._clock.sleep(self._late)
        found = [text for one in line.split("\n") for text in self._answer(one)]
        self._clock.sleep(self._late)
        return found

    def reopen(self) -> None:
        pass

    def close(self) -> None:
        pass


def wired_sr865a(
    survey: Survey, settings: Settings, *, scene: Any, late: float
) -> tuple[Devices, list[Wire]]:
    """Return an SR865A and stages behind wires that take a time each way [s]."""
    clock = VirtualClock()
    bench = simulated_bench(survey, settings, scene=scene, clock=clock)
    wires = [
        Wire(SimulatedSr865a(bench).answer, clock, late),
        Wire(SimulatedPiController(bench, settings).answer, clock, late),
    ]
    lock_in = Sr865a(
        wires[0], mean_output_input=1, modulation_amplitude=0.5, clock=clock
    )
    stages = PiController(wires[1], clock=clock)
    devices = Devices(
        laser=LockInGate(lock_in, settings.laser),
        lock_in=lock_in,
        scanner=PiScanner(stages, settings.scanner),
        launch=PiMount(stages, settings.launch.axis),
        analyser=PiMount(stages, settings.analyser.axis),
        target=PiTargetStage(stages, settings.target),
        clock=clock,
    )
    return devices, wires
