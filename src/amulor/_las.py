"""LAS and LAZ files that declare more than they hold, refused before slow imports."""

from __future__ import annotations

import struct
from pathlib import Path

from amulor.errors import FormatError

#: Header of LAS 1.4, the longest header that is read here [byte].
_HEADER = 255
#: Header of a variable-length record, and of an extended one [byte].
_VLR, _EVLR = 54, 60


def check_counts(path: Path) -> None:
    """Raise if a header declares more records than the file can hold."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_HEADER).ljust(_HEADER, b"\0")
    if not head.startswith(b"LASF"):
        return
    header, points, records, form, length, count = struct.unpack_from(
        "<HIIBHI", head, 94
    )
    checks = [("records", records, min(points, size) - header, _VLR)]
    if head[25] >= 4:  # minor version; 1.4 added extended records and 64-bit counts
        start, extended, count = struct.unpack_from("<QIQ", head, 235)
        checks.append(("extended records", extended, size - start, _EVLR))
    if not form & 0x80:  # not compressed
        checks.append(("points", count, size - points, length))
    for name, declared, room, least in checks:
        if declared * least > max(room, 0):
            raise FormatError(
                f"{path.name} declares {declared} {name} of at least {least} bytes "
                f"each, but has {max(room, 0)} bytes for them; it is damaged or was "
                "not copied whole"
            )
