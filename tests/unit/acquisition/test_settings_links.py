"""Rules of links, mirrors, heads, sources and digitizers in the devices file."""

from __future__ import annotations

import math
from typing import Any

import pytest
from device_files import LINKED, device_sections
from pydantic import ValidationError

from amulor.acquisition.settings import LaserSettings, ScannerSettings, Settings
from amulor.acquisition.settings.parts import Linked, MirrorSettings

SR865A = {"driver": "sr865a", **LINKED, "modulation_amplitude": "0.5 V"}
SOURCE = {"driver": "scpi", **LINKED, "amplitude": "1 V"}


def message(kind: Any, content: dict[str, Any]) -> str | None:
    """Return the problem of settings; None without one."""
    try:
        kind.model_validate(content)
    except ValidationError as error:
        (first,) = error.errors()
        return str(first["msg"]).removeprefix("Value error, ")
    return None


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ({"address": "tcpip::a::instr", "lock": True}, None),
        (
            {"address": "TCPIP::a::5::SOCKET", "lock": True},
            "lock needs VXI-11 or HiSLIP, but the address is 'TCPIP::a::5::SOCKET'; "
            "take it out, or state a name such as TCPIP::10.0.0.5::INSTR",
        ),
        (
            {"address": "GPIB::8::INSTR", "lock": True},
            "lock needs VXI-11 or HiSLIP, but the address is 'GPIB::8::INSTR'; take it "
            "out, or state a name such as TCPIP::10.0.0.5::INSTR",
        ),
        (
            {"lock": True},
            "lock needs VXI-11 or HiSLIP, but the address is None; take it out, or "
            "state a name such as TCPIP::10.0.0.5::INSTR",
        ),
        ({"address": "asrl3", "baud_rate": 9600, "flow_control": "none"}, None),
        (
            {"address": "tcp://a:5", "flow_control": "none"},
            "flow_control is that of a serial port, but the address is 'tcp://a:5'; "
            "take it out, or state a port such as ASRL3::INSTR",
        ),
        (
            {"baud_rate": 9600, "flow_control": "none"},
            "baud_rate is that of a serial port, but the address is None; take it out, "
            "or state a port such as ASRL3::INSTR",
        ),
    ],
)
def test_locks_and_serial_settings_belong_to_their_links(content, text) -> None:
    assert message(Linked, content) == text


def test_mirrors_have_an_angle_at_each_rising_voltage() -> None:
    def mirror(volts: list[float], angles: list[float]) -> str | None:
        return message(
            MirrorSettings, {"output": "1", "volts": volts, "angles": angles}
        )

    assert mirror([-1.0, 0.0, 1.0], [0.1, 0.0, -0.1]) is None
    missing = "an angle for each voltage is needed; state it"
    assert mirror([-1.0, 0.0, 1.0], [0.1, 0.0]) == missing
    assert mirror([-1.0, 0.0, 0.0], [0.1, 0.0, 0.2]) == "volts must rise"
    assert mirror([-1.0, 0.0], [0.1, 0.0]) is not None


def test_drivers_are_those_built_in_or_installed() -> None:
    found = message(ScannerSettings, {"driver": "wheel"})
    assert found == (
        "there is no scanner 'wheel'; there are simulated, pi_gcs, analog, pelco_d, "
        "ophyd_async, and others by the entry point amulor.scanners of a package"
    )
    assert message(LaserSettings, {"driver": "simulated"}) is None


def mirrors(azimuth: str, elevation: str, outputs: str = "lock_in") -> dict[str, Any]:
    one = {"volts": [-1.0, 0.0, 1.0], "angles": [-0.1, 0.0, 0.1]}
    return {
        "driver": "analog",
        "analog": {
            "outputs": outputs,
            "settling": "1 ms",
            "azimuth": {"output": azimuth, **one},
            "elevation": {"output": elevation, **one},
        },
    }


def wired(**parts: Any) -> dict[str, Any]:
    """Return devices of which the laser has a link of its own."""
    return device_sections(
        **{"laser": {"driver": "scpi", "scpi": {}, **LINKED}, **parts}
    )


HEAD = {"driver": "pelco_d", **LINKED}
GATE = {"driver": "lock_in_output", "output": 3}


@pytest.mark.parametrize(
    ("parts", "text"),
    [
        ({"scanner": mirrors("1", "2")}, None),
        ({"scanner": mirrors("Dev1/ao0", "Dev1/ao1", "nidaqmx")}, None),
        (
            {"scanner": mirrors("1", "3")},
            "mirrors and laser need outputs of their own among 1, 2 of the lock-in, "
            "stated are 1, 3",
        ),
        (
            {"scanner": mirrors("2", "2")},
            "mirrors and laser need outputs of their own among 1, 2 of the lock-in, "
            "stated are 2, 2",
        ),
        ({"lock_in": SR865A, "scanner": mirrors("1", "4"), "laser": GATE}, None),
        (
            {"lock_in": SR865A, "scanner": mirrors("1", "3"), "laser": GATE},
            "mirrors and laser need outputs of their own among 1, 2, 3, 4 of the "
            "lock-in, stated are 1, 3, 3",
        ),
        (
            {"scanner": HEAD,
             "procedure": {"position_tolerance": 1.001 * math.radians(0.01)}},
            None,
        ),
        (
            {"scanner": HEAD,
             "procedure": {"position_tolerance": 0.999 * math.radians(0.01)}},
            "a pan-tilt head by Pelco-D counts in 0.01 degrees, "
            "procedure.position_tolerance is less, and every sample would be flagged; "
            'state what the head is good for, such as "0.05 deg"',
        ),
        (
            {"lock_in": {"driver": "sr844", **LINKED, "reference": "external"}},
            'lock_in.reference is "external", but nothing says what makes the '
            "frequency; add the part source",
        ),
        (
            {"lock_in": {"driver": "sr844", **LINKED, "reference": "external"},
             "source": SOURCE},
            None,
        ),
        (
            {"source": SOURCE},
            "the part source makes the frequency, but the lock-in takes its own; set "
            'lock_in.reference = "external"',
        ),
        (
            {"lock_in": {**SR865A, "driver": "zurich"}, "source": SOURCE},
            None,
        ),
        (
            {"lock_in": {"driver": "digitiser"}},
            'lock_in.driver = "digitiser" and the part digitiser with its driver '
            "belong together; state both, or none of them",
        ),
        ({"lock_in": {**SR865A, "driver": "zurich"},
          "procedure": {"frequencies_at_once": 2}}, None),
        (
            {"procedure": {"frequencies_at_once": 2}},
            "the lock-in 'sr844' has one oscillator; take "
            "procedure.frequencies_at_once out, or use a lock-in with several",
        ),
        (
            {"lock_in": {**SR865A, "driver": "zurich"}, "source": SOURCE,
             "procedure": {"frequencies_at_once": 2}},
            "procedure.frequencies_at_once needs the oscillators of the lock-in, but "
            "the part source modulates the laser; take one of them out",
        ),
    ],
)  # fmt: skip
def test_parts_of_a_file_agree(parts, text) -> None:
    assert message(Settings, wired(**parts)) == text
