"""One line out, lines back: a link to an instrument over PyVISA."""

from __future__ import annotations

import contextlib
import importlib
from dataclasses import dataclass
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


@dataclass(frozen=True)
class SerialPort:
    """How characters go over a serial port; a link that is none takes no notice."""

    end: str = "\n"
    """What a line ends with: a line feed, or a carriage return."""
    baud_rate: int | None = None
    """Bits per second; that of the VISA library if None [1/s]."""
    flow_control: str | None = None
    """none, xon_xoff, rts_cts or dtr_dsr; that of the VISA library if None."""


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
    serial : SerialPort
        How characters go, if the address is that of a serial port.
    lock : bool
        Whether the instrument's own lock is taken, and held until the link is closed.

    Notes
    -----
    Lines end with a line feed everywhere but on a serial port of an instrument that
    ends them otherwise, as an SR844 does.
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
        """Open a link.

        Parameters
        ----------
        address : str
            VISA resource name.
        timeout : float
            How long one answer may take [s].
        serial : SerialPort
            How characters go, if the address is that of a serial port.
        lock : bool
            Whether the instrument's own lock is taken.

        Returns
        -------
        Link
            Open.

        Raises
        ------
        MissingExtraError
            If PyVISA is not installed.
        InstrumentError
            If nothing can be reached there, or another program has locked it.
        """
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
        """What PyVISA talks through, for devices that know no lines."""
        return self._resource

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
        if self._lock:
            # That of the old link may still stand: to be heard matters more.
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
        except Exception as error:  # PyVISA and what it rests on raise many kinds
            raise InstrumentError(
                f"nothing can be reached at {self.address}: {_reason(error)}; check "
                "address, cable and power, and that no other program holds the link"
            ) from error

    def _take_lock(self) -> None:
        """Take the lock that the instrument has, which ends with the link."""
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
        """Return what PyVISA is to set on a serial port."""
        settings: dict[str, Any] = {}
        if self._serial is not None and self._serial.baud_rate is not None:
            settings["baud_rate"] = self._serial.baud_rate
        if self._serial is not None and self._serial.flow_control is not None:
            constants = importlib.import_module("pyvisa.constants")
            control = constants.ControlFlow[self._serial.flow_control]
            settings["flow_control"] = control
        return settings

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
