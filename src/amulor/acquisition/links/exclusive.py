"""One scan at a time for each address of a device, whatever folder it writes to."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import sqlite3
import tempfile
from pathlib import Path

from amulor.errors import InstrumentError

#: Two that ask at the same moment get in each other's way; within this time one of them
#: has it [s].
_AT_ONCE = 0.25
_TCP = re.compile(r"TCPIP\d*::(?P<host>[^:]+)::(?P<port>\d+)::SOCKET", re.IGNORECASE)


def hold(address: str) -> sqlite3.Connection:
    """Return the right to drive the device at an address of this computer.

    Parameters
    ----------
    address : str
        As the devices file names it; a socket counts as the same with and without VISA.

    Returns
    -------
    sqlite3.Connection
        The right lasts until it is closed; that of a program that was killed is gone
        with it.

    Raises
    ------
    InstrumentError
        If another program has it, or it cannot be asked for.
    """
    folder = lock_folder()
    path = folder / f"{_digest(address)}.lock"
    lock = None
    try:
        folder.mkdir(mode=0o1777, exist_ok=True)
        # Another user of this computer must be able to ask, too.
        with contextlib.suppress(OSError):
            os.chmod(folder, 0o1777)
        lock = sqlite3.connect(path, isolation_level=None, timeout=_AT_ONCE)
        with contextlib.suppress(OSError):
            os.chmod(path, 0o666)
        lock.execute("BEGIN EXCLUSIVE")
    except (sqlite3.Error, OSError) as error:
        if lock is not None:
            lock.close()
        if "locked" in str(error):
            raise InstrumentError(
                f"{address} is driven by another scan on this computer; each would "
                "switch off the other's light: wait for it, or stop it"
            ) from None
        raise InstrumentError(
            f"{path} cannot be locked, so nobody knows whether another scan drives "
            f"{address}: {error}; check the permissions of {folder}"
        ) from error
    return lock


def lock_folder() -> Path:
    """Return where the locks of this computer are.

    Returns
    -------
    pathlib.Path
        The same for all its users.
    """
    return Path(tempfile.gettempdir()) / "amulor-devices"


def _digest(address: str) -> str:
    """Return one name for all ways to write an address."""
    socket = _TCP.fullmatch(address.strip())
    name = f"tcp://{socket['host']}:{socket['port']}" if socket else address
    name = re.sub(r"^(GPIB|TCPIP|USB|ASRL)0?::", r"\1::", name.strip().upper())
    return hashlib.sha256(name.encode()).hexdigest()[:32]
