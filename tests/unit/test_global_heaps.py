"""Global heaps of HDF5: whole ones pass, and damaged ones are named by their place."""

from __future__ import annotations

from pathlib import Path

import pytest

from amulor._hdf5 import check_heaps
from amulor.errors import FormatError

PATH = Path("cube.nc")


def item(index: int, size: int, content: int | None = None) -> bytes:
    """Return an object: index, references, four zeros, size and content."""
    head = index.to_bytes(2, "little") + b"\1\0" + bytes(4) + size.to_bytes(8, "little")
    return head + bytes(size if content is None else content)


def heap(*parts: bytes, less: int = 0) -> bytes:
    """Return a heap of objects whose size is stated, or stated too small."""
    body = b"".join(parts)
    return b"GCOL\1\0\0\0" + (16 + len(body) - less).to_bytes(8, "little") + body


#: Two objects, of which one is filled up to eight bytes, and free space of 32 bytes.
WHOLE = heap(item(1, 8), item(2, 5, 8), item(0, 32, 16))


@pytest.mark.parametrize(
    "content",
    [
        b"", b"no heap at all", WHOLE, b"before" + WHOLE + WHOLE + b"behind",
        # Less than the head of an object is left at the end.
        heap(item(1, 8), bytes(8)),
        # A heap beyond the end of the file is for HDF5 to refuse.
        heap(item(1, 8), item(2, 64, 8))[:-30],
    ],
)  # fmt: skip
def test_heaps_that_their_objects_fill_are_read(content: bytes) -> None:
    check_heaps(content, PATH)


@pytest.mark.parametrize("before", [0, 1, len(WHOLE)])
@pytest.mark.parametrize(
    "damaged",
    [
        # Free space of no size, for which HDF5 does not return, or of half a head.
        heap(item(1, 8), item(0, 0, 16)),
        heap(item(1, 8), item(0, 8, 16)),
        # An object that is larger than the heap, and one that is larger by its filling.
        heap(item(1, 64, 8), item(0, 16, 0)),
        heap(item(1, 8), item(2, 9, 15)),
    ],
)
def test_a_heap_that_its_objects_do_not_fill_is_named(
    damaged: bytes, before: int
) -> None:
    content = (WHOLE if before == len(WHOLE) else bytes(before)) + damaged
    with pytest.raises(FormatError, match=f"heap at byte {before} is not filled"):
        check_heaps(content + bytes(64), PATH)
