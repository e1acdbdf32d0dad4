"""Opens the link that an address names."""

from __future__ import annotations

from amulor.acquisition.links.direct import SCHEME, DirectLink
from amulor.acquisition.links.visa import Conversation, Link, SerialPort
from amulor.acquisition.settings.parts import Linked


def open_link(
    address: str,
    *,
    timeout: float,
    serial: SerialPort = SerialPort(),  # noqa: B008 - it is frozen
    lock: bool = False,
) -> Conversation:
    """Open the link that an address names.

    Parameters
    ----------
    address : str
        VISA resource name, or tcp://host:port for a socket without a VISA library.
    timeout : float
        How long one answer may take [s].
    serial : SerialPort
        How characters go, if the address is that of a serial port.
    lock : bool
        Whether the instrument's own lock is taken, over VXI-11 or HiSLIP.

    Returns
    -------
    Conversation
        Open.

    Raises
    ------
    InstrumentError
        If nothing can be reached there, or another program has locked it.
    MissingExtraError
        If PyVISA is needed and not installed.
    """
    if address.startswith(SCHEME):
        return DirectLink(address, timeout=timeout)
    return Link.open(address, timeout=timeout, serial=serial, lock=lock)


def linked(own: Linked, *, serial_end: str = "\n") -> Conversation:
    """Open the link that a part of the devices file states."""
    assert own.address is not None
    port = SerialPort(
        end=serial_end, baud_rate=own.baud_rate, flow_control=own.flow_control
    )
    return open_link(own.address, timeout=own.timeout, serial=port, lock=bool(own.lock))
