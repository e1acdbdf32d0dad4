"""One line out, lines back: a link to an instrument over PyVISA."""

from __future__ import annotations

import contextlib
import importlib
from typing import Any, Protocol

from amulor.errors import InstrumentError, MissingExtraError

#: Bytes that are asked for at once.
_LONGEST = 4096


class Conversation(Protocol):
    """What a driver needs of a link; a test can be one, too."""

    address: str
    """How messages name the other end."""

    def send(self, line: str) -> None:
        """Send one line that has no answer."""

    def ask(self, line: str, *, answers: int = 1) -> list[str]:
        """Send one line, or several with line feeds between, and return the answers."""

    def reopen(self) -> None:
        """Close the link and open it again, for a last attempt to make safe."""

    def close(self) -> None:
        """Close the link."""


class Link:
    """A link over PyVISA: GPIB, serial port, USB or network.

    Parameters
    ----------
    address : str
        VISA resource name.
    timeout : float
        How long one answer may take [s].
    manager : object
        A `pyvisa.ResourceManager`.

    Notes
    -----
    Lines end with a line feed, on a serial port with a carriage return: that is how an
    SR844 ends its answers (its manual, page 4-8), and what the others can be set to.
    """

    def __init__(self, address: str, *, timeout: float, manager: Any) -> None:
        self.address = address
        self._timeout = timeout
        self._manager = manager
        self._resource: Any = None
        self._open()

    @classmethod
    def open(cls, address: str, *, timeout: float) -> Link:
        """Open a link.

        Parameters
        ----------
        address : str
            VISA resource name.
        timeout : float
            How long one answer may take [s].

        Returns
        -------
        Link
            Open.

        Raises
        ------
        MissingExtraError
            If PyVISA is not installed.
        InstrumentError
            If nothing can be reached there.
        """
        try:
            pyvisa = importlib.import_module("pyvisa")
        except ImportError:
            raise MissingExtraError(
                "pyvisa", extra="acquire", purpose="talking to instruments"
            ) from None
        return cls(address, timeout=timeout, manager=pyvisa.ResourceManager())

    def send(self, line: str) -> None:
        """Send one line that has no answer."""
        with self._explained(line):
            self._resource.write(line)

    def ask(self, line: str, *, answers: int = 1) -> list[str]:
        """Send one line, or several with line feeds between, and return the answers."""
        with self._explained(line):
            self._resource.write(line)
            return [self._line() for _ in range(answers)]

    def reopen(self) -> None:
        """Close the link and open it again."""
        self.close()
        self._open()

    def close(self) -> None:
        """Close the link; it may be called twice."""
        if self._resource is not None:
            with contextlib.suppress(Exception):
                self._resource.close()
            self._resource = None

    def _open(self) -> None:
        end = "\r" if self.address.upper().startswith("ASRL") else "\n"
        self._end = end.encode()
        try:
            self._resource = self._manager.open_resource(
                self.address,
                read_termination=end,
                write_termination=end,
                timeout=round(self._timeout * 1000),
                open_timeout=round(self._timeout * 1000),
            )
        except Exception as error:  # PyVISA and what it rests on raise many kinds
            raise InstrumentError(
                f"nothing can be reached at {self.address}: {_reason(error)}; check "
                "address, cable and power, and that no other program holds the link"
            ) from error

    def _line(self) -> str:
        # What `read` of the resource does, without what it does for other devices.
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
