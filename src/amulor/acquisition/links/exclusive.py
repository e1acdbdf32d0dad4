"""One scan at a time for each address of a device, whatever folder it writes to."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import tempfile
from pathlib import Path

from filelock import BaseFileLock, FileLock, Timeout

from amulor.errors import InstrumentError

_TCP = re.compile(r"TCPIP\d*::(?P<host>[^:]+)::(?P<port>\d+)::SOCKET", re.IGNORECASE)


def hold(address: str) -> BaseFileLock:
    """Lock the device at an address; the lock of a killed program ends with it."""
    folder = lock_folder()
    lock = FileLock(
        folder / f"{_digest(address)}.lock",
        timeout=0,
        mode=0o666,  # another user of this computer must be able to ask, too
        thread_local=False,
    )
    try:
        folder.mkdir(mode=0o1777, exist_ok=True)
        with contextlib.suppress(OSError):
            os.chmod(folder, 0o1777)
        lock.acquire()
    except Timeout:
        raise InstrumentError(
            f"{address} is driven by another scan on this computer; each would "
            "switch off the other's light: wait for it, or stop it"
        ) from None
    except (OSError, NotImplementedError) as error:
        raise InstrumentError(
            f"{lock.lock_file} cannot be locked, so nobody knows whether another scan "
            f"drives {address}: {error}; check the permissions of {folder}"
        ) from error
    return lock


def lock_folder() -> Path:
    """Return the folder of the locks, the same for all users of this computer."""
    return Path(tempfile.gettempdir()) / "amulor-devices"


def _digest(address: str) -> str:
    """Return one name for all ways to write an address."""
    socket = _TCP.fullmatch(address.strip())
    name = f"tcp://{socket['host']}:{socket['port']}" if socket else address
    name = re.sub(r"^(GPIB|TCPIP|USB|ASRL)0?::", r"\1::", name.strip().upper())
    return hashlib.sha256(name.encode()).hexdigest()[:32]
