"""Server that lets a simulated device answer lines of text on a network port."""

from __future__ import annotations

import contextlib
import socket
import socketserver
import threading
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Any, Protocol


class LinkLostError(Exception):
    """Request by a simulated device to break its link."""


class Speaker(Protocol):
    """Simulated device that answers lines of text."""

    def answer(self, line: str) -> Sequence[str | bytes]:
        """Return the answers to one command line, if any.

        A line feed ends each text; nothing is added to bytes, such as a binary block.

        A device with an attribute `at_once` (bytes) receives each of these characters
        without the end of a line. A method `cutter` returns an object like `_Lines`,
        which splits the bytes of one link. A method `stream` yields texts that are sent
        without a request; the device then receives nothing.
        """


def _sent(answer: str | bytes) -> bytes:
    return answer if isinstance(answer, bytes) else f"{answer}\n".encode("latin-1")


class _Lines:
    """Splitter of received bytes into lines and one-character commands."""

    def __init__(self, at_once: bytes) -> None:
        self._at_once = at_once
        self._rest = b""

    def split(self, received: bytes) -> Iterator[str]:
        """Yield lines and one-character commands in order."""
        for number in received:
            byte = bytes([number])
            if byte in self._at_once and not self._rest:
                yield byte.decode("latin-1")
            elif byte == b"\n":
                line, self._rest = self._rest, b""
                yield line.decode("latin-1").strip(" \r\t")
            else:
                self._rest += byte


class _Server(socketserver.ThreadingTCPServer):
    """TCP server of one simulated device, which can break its links."""

    allow_reuse_address = True
    daemon_threads = True
    request_queue_size = 128

    def __init__(self, host: str, port: int, speaker: Speaker) -> None:
        self.speaker = speaker
        self.links: set[Any] = set()
        super().__init__((host, port), _Conversation)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a link in a separate thread."""
        self.links.add(request)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Close a link."""
        self.links.discard(request)
        super().shutdown_request(request)


class _Conversation(socketserver.StreamRequestHandler):
    """Request handler of one TCP connection to a simulated device."""

    # Answers are short; waiting to send them together would cost 40 ms each.
    disable_nagle_algorithm = True
    server: _Server

    def handle(self) -> None:
        """Answer commands until the link ends."""
        speaker = self.server.speaker
        if stream := getattr(speaker, "stream", None):
            with contextlib.suppress(OSError):
                for text in stream():
                    self.connection.sendall(text.encode("ascii"))
            return
        cutter = getattr(speaker, "cutter", None)
        lines: Any = cutter() if cutter else _Lines(getattr(speaker, "at_once", b""))
        with contextlib.suppress(LinkLostError, OSError):
            while received := self.connection.recv(4096):
                answers = [
                    answer
                    for line in lines.split(received)
                    for answer in speaker.answer(line)
                ]
                if answers:
                    self.connection.sendall(b"".join(map(_sent, answers)))


class DeviceServer:
    """Server of one simulated device, with a thread for each link."""

    def __init__(
        self, speaker: Speaker, *, host: str = "127.0.0.1", port: int = 0
    ) -> None:
        self._server = _Server(host, port, speaker)
        self._host, self._port = self._server.socket.getsockname()[:2]
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.02,), daemon=True
        )
        self._thread.start()

    @property
    def address(self) -> str:
        """Address of the device, as written in a devices file."""
        return f"tcp://{self._host}:{self._port}"

    @property
    def visa_name(self) -> str:
        """VISA resource name of the device."""
        return f"TCPIP::{self._host}::{self._port}::SOCKET"

    def __enter__(self) -> DeviceServer:
        """Return the server."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the server."""
        self.close()

    def close(self) -> None:
        """Stop listening, and break all links."""
        self._server.shutdown()
        self._server.server_close()
        for link in [*self._server.links]:
            with contextlib.suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
        self._thread.join(timeout=5)
