"""A simulated device on a network port: one line in, lines out."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Any, Protocol


class LinkLostError(Exception):
    """What a simulated device raises to break its link off."""


class Speaker(Protocol):
    """What a simulated device says."""

    def answer(self, line: str) -> Sequence[str | bytes]:
        """Return the answers to one line, none to one that has none.

        Text is ended by a line feed; bytes, such as a binary block, by nothing.

        Raises
        ------
        LinkLostError
            To break the link off instead.

        Notes
        -----
        A device with an attribute `at_once` (bytes) is handed each of these characters
        without the end of a line. One with a method `cutter`, which returns an object
        like `_Lines`, is handed what that makes of the bytes of one link.
        """


def _sent(answer: str | bytes) -> bytes:
    return answer if isinstance(answer, bytes) else f"{answer}\n".encode("latin-1")


class _Lines:
    """Cuts what comes in into lines, and into characters that are commands alone.

    Parameters
    ----------
    at_once : bytes
        Characters that a device takes as soon as they come, without the end of a line.
    """

    def __init__(self, at_once: bytes) -> None:
        self._at_once = at_once
        self._rest = b""

    def taken(self, received: bytes) -> Iterator[str]:
        """Yield lines and characters in the order in which they came."""
        for number in received:
            byte = bytes([number])
            if byte in self._at_once and not self._rest:
                yield byte.decode("ascii")
            elif byte == b"\n":
                line, self._rest = self._rest, b""
                yield line.decode("ascii").strip(" \r\t")
            else:
                self._rest += byte


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
        own = getattr(self._speaker, "cutter", None)
        lines: Any = own() if own else _Lines(getattr(self._speaker, "at_once", b""))
        try:
            while received := link.recv(4096):
                answers = [
                    answer
                    for line in lines.taken(received)
                    for answer in self._speaker.answer(line)
                ]
                if answers:
                    link.sendall(b"".join(map(_sent, answers)))
        except (LinkLostError, OSError, UnicodeDecodeError):
            pass
        finally:
            self._links.discard(link)
            link.close()
