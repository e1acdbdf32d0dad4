"""Links for lines of text and for bytes: VISA, serial port, network."""

from __future__ import annotations

import contextlib
import importlib
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from amulor.acquisition.settings.parts import Linked
from amulor.errors import InstrumentError, MissingExtraError

#: Prefix of a socket address: tcp://host:port.
SCHEME = "tcp://"
_LONGEST = 4096


def connected(address: str, timeout: float, *, port: str) -> socket.socket:
    """Connect a socket to an instrument."""
    host, _, number = address.removeprefix(SCHEME).rpartition(":")
    if not host or not number.isdigit():
        raise InstrumentError(
            f"{address!r} is no address of a link over TCP; needed is "
            f"tcp://host:port, such as tcp://10.0.0.5:{port}"
        )
    try:
        link = socket.create_connection((host, int(number)), timeout=timeout)
    except OSError as error:
        raise InstrumentError(
            f"nothing can be reached at {address}: {error}; check address, "
            "cable and power, and that no other program holds the link"
        ) from error
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return link


class DirectLink:
    """TCP link for lines of text, each ended by a line feed.

    A query takes a third of the time through PyVISA-py, and a closed connection is
    detected at once.
    """

    def __init__(self, address: str, *, timeout: float) -> None:
        self.address = address
        self._timeout = timeout
        self._socket: socket.socket | None = None
        self._rest = b""
        self._open()

    def send(self, line: str) -> None:
        """Send a line without an answer."""
        with self._explained(line) as link:
            link.sendall(line.encode("ascii") + b"\n")

    def ask(self, line: str, *, answers: int = 1) -> list[str]:
        """Send lines, separated by line feeds, and return the answers."""
        with self._explained(line) as link:
            link.sendall(line.encode("ascii") + b"\n")
            result = self._rest
            while result.count(b"\n") < answers:
                part = link.recv(_LONGEST)
                if not part:
                    raise ConnectionResetError("the other end closed the link")
                result += part
            *lines, self._rest = result.split(b"\n", answers)
            return [text.decode("ascii").strip() for text in lines]

    def reopen(self) -> None:
        """Close the link and open it again."""
        self.close()
        self._open()

    def close(self) -> None:
        """Close the link; it may be called twice."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _open(self) -> None:
        self._socket = connected(self.address, self._timeout, port="50000")
        self._rest = b""

    @contextlib.contextmanager
    def _explained(self, line: str) -> Iterator[socket.socket]:
        if self._socket is None:
            raise InstrumentError(
                f"the link to {self.address} is closed; open it again"
            )
        try:
            yield self._socket
        except (OSError, UnicodeDecodeError) as error:
            raise InstrumentError(
                f"{self.address} has not answered {line.splitlines()[-1]!r} within "
                f"{self._timeout:g} s: {error}; check cable and power"
            ) from error


class Conversation(Protocol):
    """Interface of a link that exchanges lines of text with an instrument."""

    address: str
    """Address of the device, for messages."""

    def send(self, line: str) -> None:
        """Send a line without an answer."""

    def ask(self, line: str, *, answers: int = 1) -> list[str]:
        """Send lines, separated by line feeds, and return the answers."""

    def reopen(self) -> None:
        """Close the link and open it again."""

    def close(self) -> None:
        """Close the link."""


@dataclass(frozen=True)
class SerialPort:
    """Settings of a serial port; other links ignore them."""

    end: str = "\n"
    """End of a line: a line feed, or a carriage return."""
    baud_rate: int | None = None
    """Bits per second; if None, the default of the VISA library [1/s]."""
    flow_control: str | None = None
    """Flow control: none, xon_xoff, rts_cts or dtr_dsr; if None, the default of the
    VISA library."""


class Link:
    """Link through PyVISA: GPIB, serial port, USB or network.

    Lines end with a line feed, except on the serial port of an instrument with another
    line end, such as an SR844.
    """

    def __init__(
        self,
        address: str,
        *,
        timeout: float,
        manager: Any,
        serial: SerialPort = SerialPort(),
        lock: bool = False,
    ) -> None:
        self.address = address
        self._lock = lock
        self._serial = serial if address.upper().startswith("ASRL") else None
        self._timeout = timeout
        self._manager = manager
        self._resource: Any = None
        self._open()
        if lock:
            self._take_lock()

    @classmethod
    def open(
        cls,
        address: str,
        *,
        timeout: float,
        serial: SerialPort = SerialPort(),
        lock: bool = False,
    ) -> Link:
        """Open a link through PyVISA."""
        try:
            pyvisa = importlib.import_module("pyvisa")
        except ImportError:
            raise MissingExtraError(
                "pyvisa", extra="acquire", purpose="talking to instruments"
            ) from None
        manager = pyvisa.ResourceManager()
        return cls(address, timeout=timeout, manager=manager, serial=serial, lock=lock)

    @property
    def resource(self) -> Any:
        """PyVISA resource, for devices that exchange bytes."""
        return self._resource

    def send(self, line: str) -> None:
        """Send a line without an answer."""
        with self._explained(line):
            self._resource.write(line)

    def ask(self, line: str, *, answers: int = 1) -> list[str]:
        """Send lines, separated by line feeds, and return the answers."""
        with self._explained(line):
            self._resource.write(line)
            return [self._line() for _ in range(answers)]

    def reopen(self) -> None:
        """Close the link and open it again."""
        self.close()
        self._open()
        if self._lock:
            # The lock of the old link may persist: a working link matters more.
            with contextlib.suppress(Exception):
                self._resource.lock_excl(0)

    def close(self) -> None:
        """Close the link; it may be called twice."""
        if self._resource is not None:
            with contextlib.suppress(Exception):
                self._resource.close()
            self._resource = None

    def _open(self) -> None:
        end = "\n" if self._serial is None else self._serial.end
        self._end = end.encode()
        try:
            self._resource = self._manager.open_resource(
                self.address,
                read_termination=end,
                write_termination=end,
                timeout=round(self._timeout * 1000),
                open_timeout=round(self._timeout * 1000),
                **self._port_settings(),
            )
        except Exception as error:  # PyVISA and its dependencies raise many kinds
            raise InstrumentError(
                f"nothing can be reached at {self.address}: {_reason(error)}; check "
                "address, cable and power, and that no other program holds the link"
            ) from error

    def _take_lock(self) -> None:
        """Lock the instrument for this link; the lock ends with the link."""
        try:
            self._resource.lock_excl(0)
        except Exception as error:  # as above
            self.close()
            raise InstrumentError(
                f"{self.address} cannot be locked: {_reason(error)}; another program, "
                "maybe on another computer, has it: wait for that, or stop it. If its "
                "link has no locks, take lock out of the devices file"
            ) from error

    def _port_settings(self) -> dict[str, Any]:
        """Return the settings of a serial port for PyVISA."""
        settings: dict[str, Any] = {}
        if self._serial is not None and self._serial.baud_rate is not None:
            settings["baud_rate"] = self._serial.baud_rate
        if self._serial is not None and self._serial.flow_control is not None:
            constants = importlib.import_module("pyvisa.constants")
            control = constants.ControlFlow[self._serial.flow_control]
            settings["flow_control"] = control
        return settings

    def _line(self) -> str:
        # As in `read` of the resource, without its steps for other kinds of devices.
        resource = self._resource
        result: bytes = b""
        while not result.endswith(self._end):
            part, _ = resource.visalib.read(resource.session, _LONGEST)
            result += part
        return result.decode("ascii").strip()

    @contextlib.contextmanager
    def _explained(self, line: str) -> Any:
        if self._resource is None:
            raise InstrumentError(
                f"the link to {self.address} is closed; open it again"
            )
        try:
            yield
        except Exception as error:  # as above
            raise InstrumentError(
                f"{self.address} has not answered {line.splitlines()[-1]!r} within "
                f"{self._timeout:g} s: {_reason(error)}; check cable and power"
            ) from error


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


class OctetLink:
    """Link for bytes: over TCP, or over a serial port through PyVISA."""

    def __init__(
        self,
        address: str,
        *,
        timeout: float,
        serial: SerialPort = SerialPort(),
    ) -> None:
        self.address = address
        self._timeout, self._serial = timeout, serial
        self._socket: socket.socket | None = None
        self._link: Link | None = None
        self._open()

    def send(self, content: bytes) -> None:
        """Send bytes, without waiting for an answer."""
        with self._explained():
            if self._socket is not None:
                self._socket.sendall(content)
            else:
                self._port().write_raw(content)

    def receive(self, most: int) -> bytes:
        """Return received bytes, at least one and at most `most`."""
        with self._explained():
            if self._socket is None:
                return bytes(self._port().read_bytes(1))
            content = self._socket.recv(most)
            if not content:
                raise ConnectionResetError("the other end closed the link")
            return content

    def forget(self) -> None:
        """Discard bytes that were received but not read."""
        with self._explained():
            if self._socket is None:
                port = self._port()
                while waiting := port.bytes_in_buffer:
                    port.read_bytes(waiting)
                return
            self._socket.setblocking(False)
            try:
                while self._socket.recv(4096):
                    pass
            except BlockingIOError:
                pass
            finally:
                self._socket.settimeout(self._timeout)

    def reopen(self) -> None:
        """Close the link and open it again."""
        self.close()
        self._open()

    def close(self) -> None:
        """Close the link; it may be called twice."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        if self._link is not None:
            self._link.close()
            self._link = None

    def _open(self) -> None:
        if not self.address.startswith(SCHEME):
            self._link = Link.open(
                self.address, timeout=self._timeout, serial=self._serial
            )
            return
        self._socket = connected(self.address, self._timeout, port="4001")

    def _port(self) -> Any:
        if self._link is None:
            raise ConnectionError("the link is closed")
        return self._link.resource

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # PyVISA and its dependencies raise many kinds
            text = " ".join(str(error).split()) or type(error).__name__
            raise InstrumentError(
                f"{self.address} has not answered within {self._timeout:g} s: {text}; "
                "check cable, power, bits per second and the number of the device"
            ) from error


def open_link(
    address: str,
    *,
    timeout: float,
    serial: SerialPort = SerialPort(),
    lock: bool = False,
) -> Conversation:
    """Open the link to an address; the address implies the type of link."""
    if address.startswith(SCHEME):
        return DirectLink(address, timeout=timeout)
    return Link.open(address, timeout=timeout, serial=serial, lock=lock)


def linked(part: Linked, *, serial_end: str = "\n") -> Conversation:
    """Open the link for a device in the devices file."""
    assert part.address is not None
    port = SerialPort(
        end=serial_end, baud_rate=part.baud_rate, flow_control=part.flow_control
    )
    return open_link(
        part.address, timeout=part.timeout, serial=port, lock=bool(part.lock)
    )
