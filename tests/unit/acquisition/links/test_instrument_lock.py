"""The lock that an instrument itself has: over VXI-11, and by commands."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading

import pytest

from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.connect import open_link
from amulor.acquisition.drivers.scpi import ScpiLaser, ScpiSource
from amulor.acquisition.settings import LockInSettings, ScannerSettings
from amulor.acquisition.settings.parts import LaserSettings, SourceSettings
from amulor.errors import InstrumentError

#: Procedures of the core channel and errors, as the specification of VXI-11 has them.
CREATE_LINK, WRITE, READ, LOCK, UNLOCK, DESTROY_LINK = 10, 11, 12, 18, 19, 23
LOCKED_BY_ANOTHER, NOT_LOCKED = 11, 12
END = 4


class Vxi11Instrument:
    """An instrument on a port, that echoes questions and lets one link lock it."""

    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"TCPIP::127.0.0.1,{self.listener.getsockname()[1]}::INSTR"
        self.locked_by: int | None = None
        self.heard: list[str] = []
        self._links, self._answers = 0, {}
        self._mutex = threading.Lock()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                link, _ = self.listener.accept()
                threading.Thread(target=self._serve, args=(link,), daemon=True).start()

    def _serve(self, link: socket.socket) -> None:
        own: set[int] = set()
        stream = link.makefile("rb")
        with link, stream, contextlib.suppress(OSError, struct.error):
            while head := stream.read(4):
                size = struct.unpack(">I", head)[0] & 0x7FFFFFFF
                content = stream.read(size)
                (xid, _, _, _, _, procedure) = struct.unpack(">6I", content[:24])
                with self._mutex:
                    found = self._done(procedure, content[40:], own)
                reply = struct.pack(">6I", xid, 1, 0, 0, 0, 0) + found
                link.sendall(struct.pack(">I", len(reply) | 1 << 31) + reply)
        # A link that is gone holds no lock.
        if self.locked_by in own:
            self.locked_by = None

    def _done(self, procedure: int, arguments: bytes, own: set[int]) -> bytes:
        if procedure == CREATE_LINK:
            self._links += 1
            own.add(self._links)
            return struct.pack(">4I", 0, self._links, 0, 4096)
        (number,) = struct.unpack(">I", arguments[:4])
        others = self.locked_by not in (None, number)
        if procedure == LOCK:
            if not others:
                self.locked_by = number
            return struct.pack(">I", LOCKED_BY_ANOTHER if others else 0)
        if procedure in (UNLOCK, DESTROY_LINK):
            mine = self.locked_by == number
            self.locked_by = None if mine else self.locked_by
            missing = NOT_LOCKED if procedure == UNLOCK and not mine else 0
            return struct.pack(">I", missing)
        if procedure == WRITE and others:
            return struct.pack(">2I", LOCKED_BY_ANOTHER, 0)
        if procedure == WRITE:
            (size,) = struct.unpack(">I", arguments[16:20])
            text = arguments[20 : 20 + size].decode()
            self.heard.append(text.strip())
            self._answers[number] = text.encode() if "?" in text else b""
            return struct.pack(">2I", 0, size)
        assert procedure == READ
        answer = self._answers[number]
        padded = answer + b"\0" * (-len(answer) % 4)
        return struct.pack(">3I", 0, END, len(answer)) + padded


@pytest.fixture
def instrument():
    pytest.importorskip("pyvisa_py", reason="PyVISA-py is not installed")
    found = Vxi11Instrument()
    yield found
    found.listener.close()


def test_a_lock_keeps_others_out_until_the_link_is_closed(instrument) -> None:
    ours = open_link(instrument.address, timeout=60.0, lock=True)
    assert ours.ask("who?") == ["who?"]
    assert instrument.locked_by is not None
    with pytest.raises(InstrumentError, match=r"cannot be locked.*on another computer"):
        open_link(instrument.address, timeout=60.0, lock=True)
    # One that asks for no lock is refused what it says.
    other = open_link(instrument.address, timeout=60.0)
    with pytest.raises(InstrumentError):
        other.send("OUTP OFF")
    ours.reopen()
    assert instrument.locked_by is not None
    ours.close()
    other.send("OUTP OFF")
    assert instrument.heard == ["who?", "OUTP OFF"]
    other.close()
    second = open_link(instrument.address, timeout=60.0, lock=True)
    second.close()


def test_a_lock_of_the_lost_link_does_not_keep_us_from_making_safe(instrument) -> None:
    ours = open_link(instrument.address, timeout=60.0, lock=True)
    dead = instrument.locked_by
    ours.close()
    instrument.locked_by = dead  # the instrument has not noticed yet
    ours.reopen()  # is no error; what it says is heard as soon as it has
    instrument.locked_by = None
    ours.send("OUTP OFF")
    assert instrument.heard == ["OUTP OFF"]
    ours.close()


def test_a_link_without_locks_is_refused_in_the_devices_file() -> None:
    for address in ("tcp://10.0.0.5:5025", "GPIB0::8::INSTR", "ASRL3::INSTR"):
        with pytest.raises(ValueError, match="lock needs VXI-11 or HiSLIP"):
            ScannerSettings(driver="pi_gcs", address=address, lock=True)
    own = LockInSettings(driver="sr844", address="TCPIP::10.0.0.5::INSTR", lock=True)
    assert own.lock


class Generator:
    """An instrument that gives one session at a time the right to drive it."""

    address = "a generator"

    def __init__(self, granted: str) -> None:
        self.granted, self.said = granted, []

    def send(self, line: str) -> None:
        self.said.append(line)

    def ask(self, line: str, *, answers: int = 1) -> list[str]:
        self.send(line)
        answers = {"*IDN?": "a maker,33500B", "SYST:LOCK:REQ?": self.granted}
        return [answers.get(line, "+0")]

    def reopen(self) -> None:
        pass

    def close(self) -> None:
        self.said.append("closed")


@pytest.mark.parametrize("kind", ["laser", "source"])
def test_a_generator_is_asked_for_its_lock_first(kind: str) -> None:
    words = {"lock": "SYST:LOCK:REQ?", "unlock": "SYST:LOCK:REL"}

    def made(link: Generator) -> ScpiLaser | ScpiSource:
        if kind == "laser":
            settings = LaserSettings(driver="scpi", address="tcp://a:1", scpi=words)
            return ScpiLaser(link, settings)
        own = SourceSettings(
            driver="scpi", address="tcp://a:1", amplitude=0.5, scpi=words
        )
        return ScpiSource(link, own, clock=VirtualClock())

    busy = Generator("0")
    with pytest.raises(InstrumentError, match="another program, maybe on another"):
        made(busy)
    # Nothing was set in what somebody else drives.
    assert busy.said == ["*IDN?", "SYST:LOCK:REQ?"]
    free = Generator("1")
    device = made(free)
    assert free.said[:2] == ["*IDN?", "SYST:LOCK:REQ?"]
    device.close()
    device.close()
    assert free.said[-3:] == ["SYST:LOCK:REL", "closed", "closed"]
