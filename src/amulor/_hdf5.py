"""HDF5 files that declare more than they hold, refused before arrays are allocated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from amulor.errors import FormatError

#: First bytes of an HDF5 file.
SIGNATURE = b"\x89HDF\r\n\x1a\n"
# Behind the end of the HDF5 file, where its readers do not look and where whoever
# changes the file on purpose cuts it off: a digest of all bytes before it. Damage is
# then found before HDF5 sees it, which does not return from some damaged files.
SEAL_START, SEAL_LENGTH = b"\namulor ", 80
#: Size up to which variables may be declared and not stored: one, and all [byte].
_PLAIN_SIZE, _PLAIN_TOTAL = 1 << 28, 1 << 31
#: Bytes that deflate makes of one, at most.
_MOST_COMPRESSED = 1032
#: Largest file that is checked before the libraries of cubes are imported [byte].
_SMALL = 1 << 26


def check_size(storage: Any, path: Path) -> None:
    """Raise if the file stores too few bytes for its variables, or lacks them."""
    import h5py

    total = 0

    def check(name: str, node: Any) -> None:
        nonlocal total
        if not isinstance(node, h5py.Dataset):
            return
        if node.external or node.is_virtual:
            raise FormatError(
                f"{path}: variable '{name}' refers to the content of other files; "
                "write a copy that holds it, as h5repack does"
            )
        stored = node.id.get_storage_size()
        unstored = node.nbytes - _MOST_COMPRESSED * stored
        total += max(unstored, 0)
        if (unstored > 0 and node.nbytes > _PLAIN_SIZE) or total > _PLAIN_TOTAL:
            raise FormatError(
                f"{path}: variable '{name}' has the shape {node.shape}, of which the "
                f"file holds {stored} bytes; it is damaged or was not written to its "
                "end: make it again"
            )

    storage.visititems(check)


def check_small(path: Path) -> None:
    """Check the sizes of a small file that has no digest, before slow imports.

    Whatever else is wrong with the file is left to its reader.
    """
    try:
        with path.open("rb") as file:
            if path.stat().st_size > _SMALL or file.read(8) != SIGNATURE:
                return
            file.seek(-SEAL_LENGTH, 2)
            if SEAL_START in file.read():
                return
            import h5py

            with h5py.File(path, "r") as storage:
                check_size(storage, path)
    except FormatError:
        raise
    except Exception:  # h5py raises many kinds
        return
