"""A simulated device on a network port: one line in, lines out."""

from __future__ import annotations

import contextlib
import socket
import threading
from types import TracebackType
from typing import Protocol


class LinkLostError(Exception):
    """What a simulated device raises to break its link off."""


class Speaker(Protocol):
    """What a simulated device says."""

    def answer(self, line: str) -> list[str]:
        """Return the answers to one line, none to one that has none.

        Raises
        ------
        LinkLostError
            To break the link off instead.
        """


class DeviceServer:
    """Serves one simulated device to any number of links, each in a thread.

    Parameters
    ----------
    speaker : Speaker
        The device.
    host : str
        Address to listen at.
    port : int
        Port; any free one by default [1].
    """

    def __init__(
        self, speaker: Speaker, *, host: str = "127.0.0.1", port: int = 0
    ) -> None:
        self._speaker = speaker
        self._listener = socket.create_server((host, port))
        self._links: set[socket.socket] = set()
        self._closing = False
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Address of the device, as devices files name it."""
        host, port = self._listener.getsockname()[:2]
        return f"tcp://{host}:{port}"

    @property
    def visa_name(self) -> str:
        """VISA resource name of the device."""
        host, port = self._listener.getsockname()[:2]
        return f"TCPIP::{host}::{port}::SOCKET"

    def __enter__(self) -> DeviceServer:
        """Return the server."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Stop listening and break all links off."""
        self._closing = True
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for link in [*self._links]:
            with contextlib.suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
        self._thread.join(timeout=5)

    def _listen(self) -> None:
        while not self._closing:
            try:
                link, _ = self._listener.accept()
            except OSError:
                return
            # Answers are short; waiting to send them together would cost 40 ms each.
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._links.add(link)
            threading.Thread(target=self._serve, args=(link,), daemon=True).start()

    def _serve(self, link: socket.socket) -> None:
        rest = b""
        try:
            while received := link.recv(4096):
                *lines, rest = (rest + received).split(b"\n")
                answers = [
                    answer
                    for line in lines
                    for answer in self._speaker.answer(line.decode("ascii").strip())
                ]
                if answers:
                    link.sendall("".join(f"{text}\n" for text in answers).encode())
        except (LinkLostError, OSError, UnicodeDecodeError):
            pass
        finally:
            self._links.discard(link)
            link.close()
