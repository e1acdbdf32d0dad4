"""Rehearsal: simulated instrument on network ports, with its devices file."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from amulor.acquisition.clock import RealClock
from amulor.acquisition.connect import simulated_bench
from amulor.acquisition.links.tcp import DeviceServer, Speaker
from amulor.acquisition.settings import Settings
from amulor.acquisition.settings.parts import PoseFrame
from amulor.acquisition.simulated.bench import Bench
from amulor.acquisition.simulated.nmea import SimulatedNmea
from amulor.acquisition.simulated.pi import SimulatedPiController
from amulor.acquisition.simulated.scene import Scene
from amulor.acquisition.simulated.sr865a import SimulatedSr865a
from amulor.acquisition.simulated.stanford import (
    INTERLOCK_INPUT,
    SimulatedSr844,
    SimulatedStanford,
)
from amulor.errors import SurveyError
from amulor.survey import Survey

#: Models of simulated lock-ins.
Model = Literal["sr844", "sr865a"]
_LAST_PORT = 65535
#: Reference system of sentences of a survey without one, and offset of its site [m].
_CRS, _CRS_OFFSET = "EPSG:32632", (500e3, 4.883e6, 0.0)


@dataclass(frozen=True, kw_only=True)
class Rehearsal:
    """Simulated devices on network ports."""

    settings: Settings
    """Devices file with the addresses of the simulated devices."""
    bench: Bench
    """Simulated bench of the devices."""
    lock_in: SimulatedStanford
    """Lock-in at the first port."""
    stages: SimulatedPiController
    """Stage controller at the second port."""


@contextlib.contextmanager
def rehearse(
    survey: Survey,
    settings: Settings | None = None,
    *,
    scene: Scene,
    model: Model = "sr844",
    speed: float = 1.0,
    host: str = "127.0.0.1",
    ports: tuple[int, int, int] = (0, 0, 0),
) -> Iterator[Rehearsal]:
    """Serve a simulated lock-in, stages and navigation within a `with` block.

    Only a survey with a vehicle has a navigation. The course of the vehicle begins when
    the first client connects to it.
    """
    if any(not 0 <= port <= _LAST_PORT for port in ports):
        raise ValueError(
            f"ports must be from 1 to {_LAST_PORT}, or 0 for any free one, got "
            f"{', '.join(map(str, ports))}"
        )
    if survey.platform is not None and speed != 1:
        raise SurveyError(
            f"platform: the sentences of its navigation have the time of day, so that "
            f"simulated devices on the network run at speed 1, got {speed:g}"
        )
    base = settings or Settings()
    bench = simulated_bench(survey, base, scene=scene, clock=RealClock(speed))
    lock_in = {"sr844": SimulatedSr844, "sr865a": SimulatedSr865a}[model](bench)
    stages = SimulatedPiController(bench, base)
    frame = _frame(survey, base)
    with contextlib.ExitStack() as servers:

        def served(device: Speaker, port: int) -> str:
            server = DeviceServer(device, host=host, port=port)
            return servers.enter_context(server).address

        addresses = {
            "lock_in": served(lock_in, ports[0]),
            "stages": served(stages, ports[1]),
        }
        if bench.vehicle is not None:
            navigation = SimulatedNmea(bench, bench.vehicle, frame)
            addresses["navigation"] = served(navigation, ports[2])
        yield Rehearsal(
            settings=_addressed(base, model, addresses, frame, speed),
            bench=bench,
            lock_in=lock_in,
            stages=stages,
        )


def _frame(survey: Survey, base: Settings) -> PoseFrame:
    """Return the reference system of the sentences of a simulated navigation."""
    stated = base.navigation or survey.pose
    if stated is None or not stated.crs:
        return PoseFrame(crs=_CRS, crs_offset=_CRS_OFFSET)
    return PoseFrame(crs=stated.crs, crs_offset=stated.crs_offset)


def _addressed(
    base: Settings,
    model: Model,
    addresses: dict[str, str],
    frame: PoseFrame,
    speed: float,
) -> Settings:
    """Return the devices file with the addresses of the simulated devices."""
    stages = addresses["stages"]
    content = base.model_dump(exclude_unset=True)
    parts: dict[str, dict[str, object]] = {
        "lock_in": {
            "driver": model,
            "address": addresses["lock_in"],
            "mean_output_input": 1,
        },
        "scanner": {"driver": "pi_gcs", "address": stages},
        "launch": {"driver": "pi_gcs", "address": stages},
        "analyser": {"driver": "pi_gcs", "address": stages, "axis": base.analyser.axis},
        "laser": {
            "driver": "lock_in_output",
            "output": 1,
            "on_voltage": 5.0,
            "interlock_input": INTERLOCK_INPUT,
        },
        "target": {"driver": "pi_gcs", "address": stages},
        "procedure": {"clock_speed": speed},
    }
    if model == "sr865a":
        amplitude = base.lock_in.modulation_amplitude
        parts["lock_in"]["modulation_amplitude"] = (
            0.5 if amplitude is None else amplitude
        )
    if "navigation" in addresses:
        parts["navigation"] = {
            "driver": "nmea",
            "address": addresses["navigation"],
            "crs": frame.crs,
            "crs_offset": frame.crs_offset,
        }
    for name, part in parts.items():
        content[name] = {**content.get(name, {}), **part}
    return Settings.model_validate(content)
