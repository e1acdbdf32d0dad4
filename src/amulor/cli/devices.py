"""`amulor devices`: simulated devices for a rehearsal."""

from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def simulate(
    survey: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    lock_in: Literal["sr844", "sr865a"] = "sr844",
    devices: Path | None = None,
    speed: float = 1.0,
    fault: Annotated[tuple[str, ...], Parameter(show_default=False)] = (),
    host: str = "127.0.0.1",
    lock_in_port: int = 0,
    stage_port: int = 0,
    navigation_port: int = 0,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Serve simulated devices on the network until Ctrl-C.

    A survey with a section [platform] also has a navigation, which sends sentences of
    NMEA 0183. The course of the vehicle begins when a scan connects to it.

    Parameters
    ----------
    survey
        Survey file (TOML) of the instrument and the scene to simulate.
    output
        Devices file (TOML) to write, for "amulor acquire --devices".
    lock_in
        Model of the simulated lock-in amplifier.
    devices
        Devices file (TOML) to start from; its section [simulation] sets the errors of
        the simulated devices.
    speed
        Simulated time over real time.
    fault
        Fault to simulate, with the number of the reading, such as "unlock@500x3"; may
        be repeated. Kinds: overload, saturation, unlock, lost-link, timeout, stuck,
        darkness, interlock.
    host
        Network address on which the devices listen.
    lock_in_port
        Port of the lock-in amplifier; by default any free port.
    stage_port
        Port of the stages; by default any free port.
    navigation_port
        Port of the navigation; by default any free port.
    overwrite
        Replace an existing file.
    """
    from pydantic import ValidationError

    from amulor import io
    from amulor.acquisition import Settings
    from amulor.acquisition.rehearsal import rehearse
    from amulor.cli._arguments import UsageError, refusing
    from amulor.errors import InstrumentError
    from amulor.io.files import atomic_output
    from amulor.simulation import scene_light
    from amulor.survey import Survey

    inputs = [survey] if devices is None else [survey, devices]
    io.check_output(output, overwrite=overwrite, inputs=inputs)
    described = Survey.from_toml(survey)
    base = Settings() if devices is None else Settings.from_toml(devices)
    try:
        content = base.model_dump(exclude_unset=True)
        content.setdefault("simulation", {})
        content["simulation"]["faults"] = (*base.simulation.faults, *fault)
        settings = Settings.model_validate(content)
    except ValidationError as error:
        raise UsageError(
            f"--fault {error.errors()[0]['input']}: needed is kind@reading, or "
            "kind@reading and x and how many readings, such as unlock@500x3; kinds: "
            "overload, saturation, unlock, lost-link, timeout, stuck, darkness, "
            "interlock"
        ) from None
    ports = (lock_in_port, stage_port, navigation_port)
    try:
        with (
            refusing(),
            rehearse(
                described,
                settings,
                scene=scene_light,
                model=lock_in,
                speed=speed,
                host=host,
                ports=ports,
            ) as rehearsal,
        ):
            with atomic_output(output, overwrite=overwrite) as temporary:
                temporary.write_text(rehearsal.settings.to_toml(), encoding="utf-8")
            print(f"{output}: {lock_in} at {rehearsal.settings.lock_in.address}")
            print(f"{output}: stages at {rehearsal.settings.scanner.address}")
            navigation = rehearsal.settings.navigation
            if navigation is not None:
                print(f"{output}: navigation at {navigation.address}")
            print("Ctrl-C ends it.")
            sys.stdout.flush()
            _wait_for_the_end()
    except OSError as error:
        reason = error.strerror or error
        raise InstrumentError(f"cannot serve at {host}: {reason}") from None


def _wait_for_the_end() -> None:
    end = threading.Event()
    before = {
        number: signal.signal(number, lambda *_: end.set())
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        end.wait()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
