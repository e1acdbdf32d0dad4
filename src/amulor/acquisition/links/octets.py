"""Bytes out, bytes back: a link to a device that knows no lines."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from typing import Any

from amulor.acquisition.links.direct import SCHEME, connected
from amulor.acquisition.links.visa import Link, SerialPort
from amulor.errors import InstrumentError


class OctetLink:
    """A link over TCP (such as a serial server) or, through PyVISA, a serial port.

    Parameters
    ----------
    address : str
        "tcp://host:port", or the VISA resource name of a serial port.
    timeout : float
        How long an answer may take [s].
    serial : SerialPort
        Its bits per second and flow control.
    """

    def __init__(
        self,
        address: str,
        *,
        timeout: float,
        serial: SerialPort = SerialPort(),  # noqa: B008 - it is frozen
    ) -> None:
        self.address = address
        self._timeout, self._serial = timeout, serial
        self._socket: socket.socket | None = None
        self._link: Link | None = None
        self._open()

    def send(self, content: bytes) -> None:
        """Send bytes that have no answer, or whose answer nobody waits for."""
        with self._explained():
            if self._socket is not None:
                self._socket.sendall(content)
            else:
                self._port().write_raw(content)

    def receive(self, most: int) -> bytes:
        """Return what has come, at least one byte and at most so many.

        Raises
        ------
        InstrumentError
            If nothing comes in time, or the link is lost.
        """
        with self._explained():
            if self._socket is None:
                return bytes(self._port().read_bytes(1))
            content = self._socket.recv(most)
            if not content:
                raise ConnectionResetError("the other end closed the link")
            return content

    def forget(self) -> None:
        """Throw away what has come and was not asked for."""
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
        except Exception as error:  # PyVISA and what it rests on raise many kinds
            text = " ".join(str(error).split()) or type(error).__name__
            raise InstrumentError(
                f"{self.address} has not answered within {self._timeout:g} s: {text}; "
                "check cable, power, bits per second and the number of the device"
            ) from error
