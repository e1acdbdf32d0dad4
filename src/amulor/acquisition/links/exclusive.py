"""Locks of devices on this computer: one scan at a time for each device."""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import ipaddress
import os
import re
import socket
import tempfile
from collections.abc import Iterable
from pathlib import Path

from filelock import FileLock, Timeout

from amulor.errors import InstrumentError

_TCP = re.compile(r"tcp://\[?(?P<host>[^]/]+?)\]?:(?P<port>\d+)/?", re.IGNORECASE)
_VISA_TCP = re.compile(
    r"TCPIP\d*::\[?(?P<host>.+?)\]?"
    r"(::(?P<port>\d+)::SOCKET|(::(?P<name>(?!INSTR$)[^:]+))?(::INSTR)?)",
    re.IGNORECASE,
)
#: Device of a data server of Zurich Instruments, which has a unique serial number.
_ZURICH = re.compile(r"(hf2:)?[^:]+:(?P<serial>dev\d+)", re.IGNORECASE)
_SERIAL = re.compile(r"ASRL(?P<port>.+?)(::INSTR)?", re.IGNORECASE)
_USB = re.compile(
    r"USB(?P<board>\d*)::(?P<maker>\w+)::(?P<model>\w+)::(?P<serial>[^:]+).*",
    re.IGNORECASE,
)
_GPIB = re.compile(
    r"GPIB(?P<board>\d*)::(?P<address>\d+)(::(?P<secondary>\d+))?(::INSTR)?",
    re.IGNORECASE,
)
#: Names of a whole instrument by VXI-11 and HiSLIP, and ports of instruments: telnet,
#: HiSLIP, SCPI by lines.
_WHOLE = re.compile(r"(inst0|hislip0(,4880)?)", re.IGNORECASE)
_INSTRUMENT_PORTS = (23, 4880, 5024, 5025)
#: Name of this computer, whatever address reaches it.
_HERE = "here"


class DeviceLocks:
    """Locks of devices; the operating system frees them when the program ends."""

    def __init__(self) -> None:
        self._stack = contextlib.ExitStack()

    def take(self, lock: FileLock) -> None:
        """Take a lock; raise Timeout if another scan has it."""
        lock.acquire()
        self._stack.callback(lock.release)

    def release(self) -> None:
        """Release all locks; it may be called twice."""
        self._stack.close()


def hold(*addresses: str) -> DeviceLocks:
    """Lock devices until this program ends or releases the locks."""
    folder = lock_folder()
    names = {name: address for address in addresses for name in device_names(address)}
    locks = DeviceLocks()
    if not names:
        return locks
    try:
        folder.mkdir(mode=0o1777, exist_ok=True)
        with contextlib.suppress(OSError):
            os.chmod(folder, 0o1777)
    except OSError as error:
        raise _cannot_lock(folder, addresses[0], error) from error
    # Sorted, so that two scans cannot lock a part of the devices each.
    for name, address in sorted(names.items()):
        path = folder / f"{hashlib.sha256(name.encode()).hexdigest()[:32]}.lock"
        lock = FileLock(
            path,
            timeout=0,
            mode=0o666,  # other users of this computer must be able to lock, too
            thread_local=False,
        )
        try:
            locks.take(lock)
        except Timeout:
            locks.release()
            raise InstrumentError(
                f"{address} is driven by another scan on this computer; each would "
                "switch off the other's light: wait for it, or stop it"
            ) from None
        except (OSError, NotImplementedError) as error:
            locks.release()
            raise _cannot_lock(path, address, error) from error
    return locks


def _cannot_lock(path: Path, address: str, error: Exception) -> InstrumentError:
    return InstrumentError(
        f"{path} cannot be locked, so nobody knows whether another scan "
        f"drives {address}: {error}; check the permissions of {lock_folder()}"
    )


def lock_folder() -> Path:
    """Return the folder of device locks, shared by all users of this computer."""
    return Path(tempfile.gettempdir()) / "amulor-devices"


def device_names(address: str) -> list[str]:
    """Return the lock names of an address; addresses of one device share a name."""
    address = address.strip()
    if match := _TCP.fullmatch(address) or _VISA_TCP.fullmatch(address):
        parts = match.groupdict()
        name = parts.get("name") or "inst0"
        if parts["port"] is not None:
            port = int(parts["port"])
            place = "instrument" if port in _INSTRUMENT_PORTS else str(port)
        else:
            place = "instrument" if _WHOLE.fullmatch(name) else name.lower()
        return [
            # A simulator on this computer has one device at each port.
            f"{host} {parts['port'] if host == _HERE and parts['port'] else place}"
            for host in _hosts(parts["host"])
        ]
    if match := _ZURICH.fullmatch(address):
        return [match["serial"].lower()]
    if match := _SERIAL.fullmatch(address):
        return [_serial_port(match["port"])]
    if match := _USB.fullmatch(address):
        maker, model = (_number(match[name]) for name in ("maker", "model"))
        return [f"usb {maker} {model} {match['serial'].lower()}"]
    if match := _GPIB.fullmatch(address):
        board, secondary = int(match["board"] or 0), int(match["secondary"] or 0)
        return [f"gpib {board} {int(match['address'])} {secondary}"]
    return [_without_alias(address)]


def _hosts(host: str) -> list[str]:
    """Return the IP addresses of a host; its name in lower case if there are none."""
    try:
        entries = socket.getaddrinfo(host, None)
        resolved: Iterable[str] = {str(entry[4][0]) for entry in entries}
    except (OSError, UnicodeError):
        resolved = {host.rstrip(".").lower()}
    return sorted({_HERE if _is_here(address) else address for address in resolved})


def _is_here(address: str) -> bool:
    """Return whether an IP address belongs to this computer."""
    try:
        number = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return False
    if number.is_loopback:
        return True
    family = socket.AF_INET if number.version == 4 else socket.AF_INET6
    with (
        contextlib.suppress(OSError),
        socket.socket(family, socket.SOCK_DGRAM) as probe,
    ):
        probe.bind((address, 0))
        return True
    return False


def _serial_port(port: str) -> str:
    """Return the lock name of a serial port, equal for all names of the same port."""
    with contextlib.suppress(OSError):
        status = os.stat(port)
        if status.st_rdev:
            return f"serial {status.st_rdev}"
        return f"serial {os.path.realpath(port)}"
    return f"serial {re.sub(r'^com', '', port.lower())}"


def _number(text: str) -> str:
    try:
        return str(int(text, 0))
    except ValueError:
        return text.lower()


def _without_alias(address: str) -> str:
    """Return the lock name of an address, with VISA aliases resolved."""
    if "://" not in address and "{" not in address and "[" not in address:
        with contextlib.suppress(Exception):  # of the library, or none is installed
            visa = importlib.import_module("pyvisa")
            resource = visa.ResourceManager().resource_info(address).resource_name
            if resource and resource.lower() != address.lower():
                return " ".join(device_names(str(resource)))
    return address.lower()
