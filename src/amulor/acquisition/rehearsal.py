"""Rehearsal: simulated instrument on network ports, with its devices file."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from amulor.acquisition.clock import RealClock
from amulor.acquisition.connect import simulated_bench
from amulor.acquisition.links.tcp import DeviceServer
from amulor.acquisition.settings import Settings
from amulor.acquisition.simulated.bench import Bench
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
    ports: tuple[int, int] = (0, 0),
) -> Iterator[Rehearsal]:
    """Serve a simulated lock-in and stages within a `with` block."""
    if any(not 0 <= port <= _LAST_PORT for port in ports):
        raise ValueError(
            f"ports must be from 1 to {_LAST_PORT}, or 0 for any free one, got "
            f"{ports[0]} and {ports[1]}"
        )
    if survey.platform is not None:
        raise SurveyError(
            "platform: simulated devices on the network stand still; leave [platform] "
            "out, or simulate the devices within amulor acquire"
        )
    base = settings or Settings()
    bench = simulated_bench(survey, base, scene=scene, clock=RealClock(speed))
    lock_in = {"sr844": SimulatedSr844, "sr865a": SimulatedSr865a}[model](bench)
    stages = SimulatedPiController(bench, base)
    with (
        DeviceServer(lock_in, host=host, port=ports[0]) as first,
        DeviceServer(stages, host=host, port=ports[1]) as second,
    ):
        yield Rehearsal(
            settings=_addressed(base, model, first.address, second.address, speed),
            bench=bench,
            lock_in=lock_in,
            stages=stages,
        )


def _addressed(
    base: Settings, model: Model, lock_in: str, stages: str, speed: float
) -> Settings:
    content = base.model_dump(exclude_unset=True)
    parts: dict[str, dict[str, object]] = {
        "lock_in": {"driver": model, "address": lock_in, "mean_output_input": 1},
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
    for name, part in parts.items():
        content[name] = {**content.get(name, {}), **part}
    return Settings.model_validate(content)
