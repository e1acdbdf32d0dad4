"""Navigation by NMEA 0183: a serial port, a network port, or a growing file."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from pathlib import Path

from amulor.acquisition.clock import Clock
from amulor.acquisition.links.lines import OctetLink, SerialPort
from amulor.acquisition.settings.parts import NavigationSettings
from amulor.errors import InstrumentError

#: Prefix of the address of a file that another program extends.
_FILE = "file:"
#: Wait before a lost link is opened again, and before a file is read again [s].
_AGAIN, _FILE_AGAIN = 1.0, 0.01
#: Longest sentence [bytes].
_LONGEST = 1000


class _File:
    """Growing file, read from its present end."""

    def __init__(self, path: Path) -> None:
        try:
            self._file = path.open("rb")
        except OSError as error:
            raise InstrumentError(
                f"navigation: {path} cannot be read ({error.strerror or error}); start "
                "the program that writes it, or correct navigation.address"
            ) from None
        self._file.seek(0, 2)

    def receive(self, most: int) -> bytes:
        """Return new bytes; none if there are none yet."""
        content = self._file.read(most)
        if not content:
            time.sleep(_FILE_AGAIN)
        return content

    def reopen(self) -> None:
        """Do nothing: a file has no link."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class NmeaNavigation:
    """Receiver of NMEA 0183 sentences, in a thread that notes their arrival."""

    def __init__(self, settings: NavigationSettings, *, clock: Clock) -> None:
        assert settings.address is not None
        self._address, self._clock = settings.address, clock
        self._patience = settings.timeout
        self._link: _File | OctetLink
        if settings.address.startswith(_FILE):
            self._link = _File(Path(settings.address.removeprefix(_FILE)))
        else:
            port = SerialPort(
                baud_rate=settings.baud_rate, flow_control=settings.flow_control
            )
            self._link = OctetLink(
                settings.address, timeout=settings.timeout, serial=port
            )
        self._arrived: deque[tuple[float, str]] = deque()
        self._first, self._closed = threading.Event(), threading.Event()
        # From now on, so that the link has no old sentences when the scan begins.
        threading.Thread(target=self._listen, daemon=True).start()

    def identity(self) -> str:
        """Return the format; sentences do not name their instrument."""
        return "NMEA 0183"

    def begin(self) -> None:
        """Discard earlier sentences, and wait for the next one."""
        self._arrived.clear()
        self._first.clear()
        if not self._first.wait(self._patience):
            raise InstrumentError(
                f"navigation: no sentence from {self._address} within "
                f"{self._patience:g} s; check cable, bits per second and the output of "
                "the navigation"
            )

    def messages(self) -> list[tuple[float, str]]:
        """Return arrival by the clock [s] and text of the sentences since the last."""
        return [self._arrived.popleft() for _ in range(len(self._arrived))]

    def make_safe(self) -> None:
        """Do nothing: navigation moves nothing."""

    def close(self) -> None:
        """Stop to receive, and close the link."""
        self._closed.set()
        self._link.close()

    def _listen(self) -> None:
        rest = b""
        while not self._closed.is_set():
            try:
                received = self._link.receive(4096)
            except (InstrumentError, OSError, ValueError):
                # The rest of a sentence from before is not joined to a new one.
                rest = b""
                self._closed.wait(_AGAIN)
                if not self._closed.is_set():
                    with contextlib.suppress(InstrumentError, OSError):
                        self._link.reopen()
                continue
            now = self._clock.now()
            *lines, rest = (rest + received).split(b"\n")
            rest = rest[-_LONGEST:]
            for line in lines:
                text = line[-_LONGEST:].decode("ascii", errors="replace").strip()
                if text:
                    self._arrived.append((now, text))
                    self._first.set()
