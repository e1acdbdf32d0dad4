"""Serial ports: what ends a line by maker, baud rate and flow control as stated."""

from __future__ import annotations

import contextlib
import os
import threading

import pytest

from amulor.acquisition import connect as connecting
from amulor.acquisition.drivers.pi_gcs import PiController
from amulor.acquisition.drivers.stanford import Sr844
from amulor.acquisition.drivers.stanford_sr865a import Sr865a
from amulor.acquisition.links import lines as opening
from amulor.acquisition.links.lines import Link, SerialPort
from amulor.acquisition.settings import LockInSettings, ScannerSettings, Settings
from amulor.errors import InstrumentError


class Manager:
    """A VISA library that only takes note of how a resource is opened."""

    def __init__(self) -> None:
        self.words: dict[str, object] = {}

    def open_resource(self, address: str, **words: object) -> Manager:
        self.words = words
        return self

    def close(self) -> None:
        """Do nothing."""


@pytest.mark.parametrize(
    ("driver", "end"), [(Sr844, "\r"), (Sr865a, "\n"), (PiController, "\n")]
)
def test_lines_end_as_the_maker_says(driver, end) -> None:
    # SR844: carriage return (manual, page 4-8). SR86x and PI: line feed.
    assert driver.serial_end == end
    manager = Manager()
    port = SerialPort(end=driver.serial_end)
    Link("ASRL3::INSTR", timeout=1.0, manager=manager, serial=port)
    assert manager.words["read_termination"] == end
    assert manager.words["write_termination"] == end
    assert "baud_rate" not in manager.words
    # Elsewhere it is a line feed, whoever made it.
    Link("GPIB0::8::INSTR", timeout=1.0, manager=manager, serial=port)
    assert manager.words["read_termination"] == "\n"


@pytest.mark.parametrize("name", ["none", "xon_xoff", "rts_cts", "dtr_dsr"])
def test_baud_rate_and_flow_control_are_those_of_the_file(name) -> None:
    constants = pytest.importorskip("pyvisa.constants", reason="PyVISA is missing")
    manager = Manager()
    port = SerialPort(end="\n", baud_rate=115_200, flow_control=name)
    Link("asrl/dev/ttyUSB0::instr", timeout=1.0, manager=manager, serial=port)
    assert manager.words["baud_rate"] == 115_200
    assert manager.words["flow_control"] == constants.ControlFlow[name]


def test_each_device_is_linked_as_its_part_of_the_file_says(monkeypatch) -> None:
    asked = {}

    def open_link(
        address: str, *, timeout: float, serial: SerialPort, lock: bool
    ) -> object:
        assert not lock
        asked[address] = serial
        raise InstrumentError("enough")

    monkeypatch.setattr(opening, "open_link", open_link)
    for part in ("sr844", "sr865a"):
        settings = Settings.model_validate(
            {
                "lock_in": {
                    "driver": part,
                    "address": f"ASRL/{part}::INSTR",
                    "baud_rate": 19_200,
                    **({"modulation_amplitude": 0.5} if part == "sr865a" else {}),
                },
                "scanner": {"driver": "pi_gcs", "address": "ASRL2::INSTR"},
                "launch": {"driver": "none"},
                "analyser": {"driver": "none"},
                "laser": {"driver": "lock_in_output"},
                "target": {"driver": "operator"},
            }
        )
        with pytest.raises(InstrumentError, match="enough"):
            connecting.connect(None, settings, ask=print)
    assert asked == {
        "ASRL/sr844::INSTR": SerialPort(end="\r", baud_rate=19_200),
        "ASRL/sr865a::INSTR": SerialPort(end="\n", baud_rate=19_200),
    }


def test_a_baud_rate_without_a_serial_port_is_a_mistake() -> None:
    with pytest.raises(ValueError, match=r"baud_rate is that of a serial port"):
        ScannerSettings(driver="pi_gcs", address="tcp://10.0.0.5:5", baud_rate=9600)
    with pytest.raises(ValueError, match=r"flow_control is that of a serial port"):
        LockInSettings(flow_control="rts_cts")


def test_an_sr844_is_spoken_to_over_a_serial_line() -> None:
    pytest.importorskip("serial", reason="pyserial is not installed")
    pytest.importorskip("pyvisa_py", reason="PyVISA-py is not installed")
    pty = pytest.importorskip("pty", reason="there are no such terminals here")
    import tty

    far, near = pty.openpty()
    tty.setraw(near)
    heard = []

    def instrument() -> None:
        rest = b""
        with contextlib.suppress(OSError):
            while part := os.read(far, 100):
                *lines, rest = (rest + part).split(b"\r")
                heard.extend(lines)
                for line in lines:
                    if line == b"*IDN?":
                        os.write(far, b"Stanford_Research_Systems,SR844,1,1\r")

    threading.Thread(target=instrument, daemon=True).start()
    link = connecting.open_link(
        f"ASRL{os.ttyname(near)}::INSTR",
        timeout=60.0,
        serial=SerialPort(end="\r", baud_rate=19_200, flow_control="none"),
    )
    try:
        found = Sr844(link, mean_output_input=None, clock=None)
        assert "SR844" in found.identity()
        assert heard == [b"OUTX 0", b"*IDN?"]
    finally:
        link.close()
        os.close(near)
        os.close(far)
