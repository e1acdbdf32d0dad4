"""Small HDF5 files are checked before they are read, sealed and large ones are not."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from amulor import _hdf5
from amulor.errors import FormatError

#: A heap whose only object is larger than the heap.
HEAP = b"GCOL\x01\0\0\0" + (40).to_bytes(8, "little")
HEAP += b"\1\0" + bytes(6) + (64).to_bytes(8, "little") + bytes(8)
SEAL = b"\namulor sha256:" + b"0" * 64 + b"\n"


def refused(path: Path) -> bool:
    """Return whether a file is refused, by its heap."""
    words = (
        f"{path} is damaged: the global heap at byte 8 is not filled by its objects; "
        "copy the file again, or make it again"
    )
    try:
        _hdf5.check_small(path)
    except FormatError as error:
        return str(error) == words
    return False


def test_heaps_of_small_files_without_digest_are_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.nc"
    content = _hdf5.SIGNATURE + HEAP + bytes(64)
    path.write_bytes(content)
    assert refused(path)
    for size, expected in ((len(content), True), (len(content) - 1, False)):
        monkeypatch.setattr(_hdf5, "_SMALL", size)
        assert refused(path) == expected
    monkeypatch.undo()
    path.write_bytes(b"X" + content[1:])
    assert not refused(path)
    # The digest is checked where it stands, at the end.
    assert len(SEAL) == _hdf5.SEAL_LENGTH
    path.write_bytes(content + SEAL)
    assert not refused(path)
    path.write_bytes(content + SEAL + bytes(1))
    assert refused(path)
    assert not refused(tmp_path / "away.nc")


def test_sizes_of_small_files_are_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.nc"
    with h5py.File(path, "w") as storage:
        storage.create_dataset("large", (3000,), "u1", chunks=(1000,))
        storage["text"] = "a"
    _hdf5.check_small(path)
    monkeypatch.setattr(_hdf5, "_PLAIN_SIZE", 2999)
    with pytest.raises(FormatError) as caught:
        _hdf5.check_small(path)
    assert str(caught.value) == (
        f"{path}: variable 'large' has the shape (3000,), of which the file holds 0 "
        "bytes; it is damaged or was not written to its end: make it again"
    )
    monkeypatch.setattr(_hdf5, "_PLAIN_SIZE", 3000)
    _hdf5.check_small(path)


def test_each_stored_byte_may_be_a_thousand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_hdf5, "_PLAIN_SIZE", 1)
    path = tmp_path / "a.nc"
    for size, stored, wrong in ((8 * 1032, 8, False), (8 * 1032 + 8, 8, True)):
        with h5py.File(path, "w") as storage:
            # One of many numbers is stored.
            made = storage.create_dataset("x", (size // 8,), "f8", chunks=(1,))
            made[0] = 1.0
            assert made.id.get_storage_size() == stored
            if wrong:
                with pytest.raises(FormatError, match="'x' has the shape"):
                    _hdf5.check_size(storage, path)
            else:
                _hdf5.check_size(storage, path)


def test_variables_that_are_not_stored_have_a_largest_sum(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.nc"
    with h5py.File(path, "w") as storage:
        storage["stored"] = np.zeros(1000)
        for name in ("a", "b", "c"):
            storage.create_dataset(f"group/{name}", (100,), "u1", chunks=(100,))
        for total, wrong in ((300, False), (299, True)):
            monkeypatch.setattr(_hdf5, "_PLAIN_TOTAL", total)
            if not wrong:
                _hdf5.check_size(storage, path)
                continue
            with pytest.raises(FormatError, match="variable 'group/c' has the shape"):
                _hdf5.check_size(storage, path)


def test_a_digest_has_its_place_behind_the_file() -> None:
    assert _hdf5.SEAL_START == b"\namulor "
    assert _hdf5.SIGNATURE == b"\x89HDF\r\n\x1a\n"
    assert (_hdf5._SMALL, _hdf5._PLAIN_SIZE, _hdf5._PLAIN_TOTAL) == (
        64 * 1024**2, 256 * 1024**2, 2 * 1024**3,
    )  # fmt: skip
