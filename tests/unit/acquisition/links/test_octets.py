"""Links over TCP by a server in this program, and serial ports by a stand-in."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from amulor.acquisition.links import lines
from amulor.acquisition.links.lines import DirectLink, Link, OctetLink, SerialPort
from amulor.acquisition.links.tcp import DeviceServer, LinkLostError, _Lines, _sent
from amulor.errors import InstrumentError


@contextlib.contextmanager
def listening(*parts: bytes) -> Iterator[tuple[str, list[bytes]]]:
    """Serve one link after another, each with one of the parts, and what it got."""
    server = socket.create_server(("127.0.0.1", 0))
    got: list[bytes] = []
    ends: list[socket.socket] = []

    def serve() -> None:
        for part in parts:
            with contextlib.suppress(OSError):
                link, _ = server.accept()
                ends.append(link)
                link.sendall(part)
                link.settimeout(5.0)
                got.append(link.recv(100))

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield f"tcp://127.0.0.1:{server.getsockname()[1]}", got
    for link in ends:
        link.close()
    server.close()
    thread.join(5.0)


def test_octets_are_received_as_they_come() -> None:
    with listening(b"\x01\x02\x03", b"\x04") as (address, got):
        link = OctetLink(address, timeout=5.0)
        assert link.receive(2) == b"\x01\x02"
        link.forget()
        link.send(b"\xff\x00")
        link.reopen()
        assert link.receive(7) == b"\x04"
        assert got == [b"\xff\x00"]
        link.close()
        link.close()
        with pytest.raises(InstrumentError) as caught:
            link.receive(1)
        assert str(caught.value) == (
            f"{address} has not answered within 5 s: the link is closed; check cable, "
            "power, bits per second and the number of the device"
        )
        with pytest.raises(InstrumentError, match="the link is closed"):
            link.send(b"\x00")
        with pytest.raises(InstrumentError, match="the link is closed"):
            link.forget()


def test_a_link_that_ends_is_an_error() -> None:
    with listening(b"") as (address, _):
        link = OctetLink(address, timeout=0.1)
        with pytest.raises(InstrumentError, match=r"has not answered within 0\.1 s: "):
            link.receive(1)
        link._socket.shutdown(socket.SHUT_RD)
        with pytest.raises(InstrumentError, match="the other end closed the link"):
            link.receive(1)
        link.close()


class Port:
    """A serial port of PyVISA with waiting octets."""

    def __init__(self, waiting: bytes = b"") -> None:
        self.waiting, self.sent, self.opened = waiting, [], []
        self.closed = 0

    def write_raw(self, content: bytes) -> None:
        self.sent.append(content)

    @property
    def bytes_in_buffer(self) -> int:
        return min(len(self.waiting), 2)

    def read_bytes(self, count: int) -> bytes:
        found, self.waiting = self.waiting[:count], self.waiting[count:]
        return found

    def close(self) -> None:
        self.closed += 1


def test_a_serial_port_is_read_octet_by_octet(monkeypatch) -> None:
    port = Port(b"abc")
    opened: list[Any] = []

    def open_link(address: str, **more: Any) -> Any:
        opened.append((address, more))
        return SimpleNamespace(resource=port, close=port.close)

    monkeypatch.setattr(Link, "open", open_link)
    serial = SerialPort(baud_rate=2400)
    link = OctetLink("ASRL1", timeout=2.0, serial=serial)
    assert opened == [("ASRL1", {"timeout": 2.0, "serial": serial})]
    assert link.receive(3) == b"a"
    link.forget()
    assert port.waiting == b""
    link.send(b"x")
    assert port.sent == [b"x"]
    link.reopen()
    assert port.closed == 1
    assert len(opened) == 2
    link.close()
    assert port.closed == 2


class Manager:
    """A resource manager that notes how it opens a resource."""

    def __init__(self, *answers: bytes, wrong: Exception | None = None) -> None:
        self.answers, self.opened, self.wrong = [*answers], [], wrong
        self.locks: list[int] = []
        self.written: list[str] = []
        self.closed = 0

    def open_resource(self, address: str, **more: Any) -> Any:
        self.opened.append((address, more))
        if self.wrong is not None:
            raise self.wrong
        return SimpleNamespace(
            write=self.written.append, session=7, lock_excl=self.locks.append,
            visalib=SimpleNamespace(read=self.read), close=self.close,
        )  # fmt: skip

    def read(self, session: int, most: int) -> tuple[bytes, None]:
        assert (session, most) == (7, 4096)
        return self.answers.pop(0), None

    def close(self) -> None:
        self.closed += 1


def test_lines_of_a_visa_link_end_by_its_port() -> None:
    manager = Manager(b"on", b"e\n", b" two \n", b"three\r")
    link = Link("GPIB0::8", timeout=1.5, manager=manager, serial=SerialPort(end="\r"))
    assert manager.opened == [
        (
            "GPIB0::8",
            {
                "read_termination": "\n", "write_termination": "\n", "timeout": 1500,
                "open_timeout": 1500,
            },
        )
    ]  # fmt: skip
    assert link.ask("A?\nB?", answers=2) == ["one", "two"]
    link.send("C")
    assert manager.written == ["A?\nB?", "C"]
    assert manager.locks == []
    link.close()
    link.close()
    assert manager.closed == 1
    with pytest.raises(InstrumentError) as caught:
        link.send("C")
    assert str(caught.value) == "the link to GPIB0::8 is closed; open it again"
    serial = Link(
        "asrl1", timeout=1.5, manager=manager,
        serial=SerialPort(end="\r", baud_rate=9600),
    )  # fmt: skip
    assert manager.opened[-1][1]["read_termination"] == "\r"
    assert manager.opened[-1][1]["baud_rate"] == 9600
    assert serial.ask("D?") == ["three"]
    with pytest.raises(InstrumentError) as caught:
        serial.ask("E?\nF?")
    assert str(caught.value) == (
        "asrl1 has not answered 'F?' within 1.5 s: pop from empty list; check cable "
        "and power"
    )


def test_a_visa_link_is_locked_and_locked_again() -> None:
    manager = Manager()
    link = Link("A", timeout=1.0, manager=manager, lock=True)
    assert manager.locks == [0]
    link.reopen()
    assert manager.locks == [0, 0]
    assert manager.closed == 1

    def refuse(timeout: int) -> None:
        raise ValueError

    link._resource.lock_excl = refuse
    with pytest.raises(InstrumentError) as caught:
        link._take_lock()
    assert str(caught.value) == (
        "A cannot be locked: ValueError; another program, maybe on another computer, "
        "has it: wait for that, or stop it. If its link has no locks, take lock out of "
        "the devices file"
    )
    assert link.resource is None
    assert manager.closed == 2
    with pytest.raises(InstrumentError) as caught:
        Link("B", timeout=1.0, manager=Manager(wrong=OSError("no\n  such port")))
    assert str(caught.value) == (
        "nothing can be reached at B: no such port; check address, cable and power, "
        "and that no other program holds the link"
    )


def test_lines_over_tcp_are_kept_for_the_next_question() -> None:
    with listening(b"one\r\ntwo\nthr", b"four\n") as (address, got):
        link = DirectLink(address, timeout=0.2)
        assert link.ask("A?") == ["one"]
        assert link.ask("B?") == ["two"]
        with pytest.raises(InstrumentError) as caught:
            link.ask("C?\nD?", answers=1)
        assert str(caught.value) == (
            f"{address} has not answered 'D?' within 0.2 s: timed out; check cable and "
            "power"
        )
        # What is left of the old link is no answer of the new one.
        link.reopen()
        assert link.ask("E?") == ["four"]
        link.close()
        with pytest.raises(InstrumentError) as caught:
            link.send("F")
        assert str(caught.value) == f"the link to {address} is closed; open it again"
    assert got[0].startswith(b"A?\n")


@pytest.mark.parametrize("address", ["tcp://", "tcp://host", "tcp://:5", "tcp://h:x"])
def test_an_address_has_host_and_port(address) -> None:
    for open_link, port in ((DirectLink, 50000), (OctetLink, 4001)):
        with pytest.raises(InstrumentError) as caught:
            open_link(address, timeout=1.0)
        assert str(caught.value) == (
            f"{address!r} is no address of a link over TCP; needed is tcp://host:port, "
            f"such as tcp://10.0.0.5:{port}"
        )


def test_a_server_cuts_lines_and_single_characters() -> None:
    cutter = _Lines(b"\x05\x18")
    assert [*cutter.split(b"MOV 1 2\r\n\x05PO")] == ["MOV 1 2", "\x05"]
    # Within a line a character is a part of it.
    assert [*cutter.split(b"S\x05?\n\x18\x05")] == ["POS\x05?", "\x18", "\x05"]
    assert [*_Lines(b"").split(b" a \t\n\n")] == ["a", ""]
    assert _sent("é") == b"\xe9\n"
    assert _sent(b"#10") == b"#10"


class Speaker:
    at_once = b"!"

    def answer(self, line: str) -> list[str | bytes]:
        if line == "lose":
            raise LinkLostError
        return [] if line == "quiet" else [f"{line}?", b"raw"]


def test_a_server_answers_each_link_until_it_is_lost() -> None:
    with DeviceServer(Speaker()) as server:
        host, port = server.address.removeprefix("tcp://").split(":")
        assert server.visa_name == f"TCPIP::{host}::{port}::SOCKET"
        with socket.create_connection((host, int(port)), timeout=5) as link:
            link.sendall(b"quiet\n!a\n")
            found = b""
            while len(found) < 12:
                found += link.recv(100)
            assert found == b"!?\nrawa?\nraw"
            link.sendall(b"lose\n")
            assert link.recv(10) == b""
        with socket.create_connection((host, int(port)), timeout=5) as link:
            link.sendall(b"a\n")
            assert link.recv(3) == b"a?\n"


def test_a_server_streams_without_a_question() -> None:
    class Streams:
        def answer(self, line: str) -> list[str]:
            return []

        def stream(self) -> Iterator[str]:
            yield "$one\r\n"
            yield "$two\r\n"

    with DeviceServer(Streams()) as server:
        host, port = server.address.removeprefix("tcp://").split(":")
        with socket.create_connection((host, int(port)), timeout=5) as link:
            found = b""
            while part := link.recv(100):
                found += part
    assert found == b"$one\r\n$two\r\n"


def test_a_part_is_linked_by_its_address(monkeypatch) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(
        lines, "open_link", lambda address, **more: asked.append((address, more))
    )
    part = SimpleNamespace(
        address="ASRL1", baud_rate=9600, flow_control="none", timeout=3.0, lock=None
    )
    lines.linked(part, serial_end="\r")
    part.lock = True
    lines.linked(part)
    assert asked == [
        (
            "ASRL1",
            {
                "timeout": 3.0, "lock": lock,
                "serial": SerialPort(end=end, baud_rate=9600, flow_control="none"),
            },
        )
        for lock, end in ((False, "\r"), (True, "\n"))
    ]  # fmt: skip
