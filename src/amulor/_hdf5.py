"""HDF5 files that are refused before HDF5 reads them: wrong sizes, damaged heaps."""

from __future__ import annotations

import mmap
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
#: First bytes of a global heap of HDF5: signature, version and three zeros.
_HEAP = b"GCOL\x01\0\0\0"
#: Bytes before the content of an object of a heap: index, references and size.
_OBJECT = 16


def check_heaps(content: bytes | mmap.mmap, path: Path) -> None:
    """Raise if a global heap is not filled by its objects.

    HDF5 stores texts and the links of dimensions in global heaps, which have no
    checksum. Its function H5HG__cache_heap_deserialize goes through the objects in the
    same way, and does not return if damage leaves an object without size.
    """
    at = content.find(_HEAP)
    while at >= 0:
        end = at + int.from_bytes(content[at + 8 : at + 16], "little")
        place, step = at + _OBJECT, _OBJECT
        # HDF5 itself refuses a heap beyond the end of the file.
        while step >= _OBJECT and place + _OBJECT <= end <= len(content):
            size = int.from_bytes(content[place + 8 : place + 16], "little")
            used = content[place : place + 2] != b"\0\0"
            # The size of free space, index 0, includes these bytes.
            step = _OBJECT + -(-size // 8) * 8 if used else size
            place += step
        if step < _OBJECT or place > end:
            raise FormatError(
                f"{path} is damaged: the global heap at byte {at} is not filled by its "
                "objects; copy the file again, or make it again"
            )
        at = content.find(_HEAP, at + len(_HEAP))


def check_heaps_of(path: Path) -> None:
    """Check the global heaps of a file, without reading it into memory."""
    with (
        path.open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content,
    ):
        check_heaps(content, path)


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
    """Check the heaps and sizes of a small file without digest, before slow imports.

    Whatever else is wrong with the file is left to its reader.
    """
    try:
        with path.open("rb") as file:
            if path.stat().st_size > _SMALL or file.read(8) != SIGNATURE:
                return
            file.seek(-SEAL_LENGTH, 2)
            if SEAL_START in file.read():
                return
        check_heaps_of(path)
        import h5py

        with h5py.File(path, "r") as storage:
            check_size(storage, path)
    except FormatError:
        raise
    except Exception:  # h5py raises many kinds
        return
