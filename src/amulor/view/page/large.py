"""Range images too large to be held at once: maps are read band by band."""

from __future__ import annotations

import hashlib
import threading
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import error_unknown, without_unknown_errors
from amulor.errors import CubeError, FormatError
from amulor.view.page.beams import BeamReader, Floats, Numbers, values_of

#: Smaller files are read at once [byte].
_LARGE = 64_000_000
_BAND = 256
#: Rows and columns that stand for the scan beside the pixels that are measured [1].
_MESH = 128
#: Behind the file a digest of it stands, see `amulor.io.netcdf` [byte].
_SEAL_LENGTH = 80


def is_large(path: Path) -> bool:
    """Return whether a file is a range image that is better read in bands.

    Parameters
    ----------
    path : pathlib.Path
        Any file.

    Returns
    -------
    bool
        False also for what is no file at all: the reader of small ones explains it.
    """
    try:
        if path.stat().st_size < _LARGE:
            return False
        with h5py.File(path, "r") as file:
            level = file.attrs.get("level", b"")
            text = level.decode() if isinstance(level, bytes) else str(level)
            return text == "range_image"
    except OSError:
        return False


def large_picture(path: Path) -> LargePicture:
    """Open a range image of any size.

    Parameters
    ----------
    path : pathlib.Path
        File of level `range_image`.

    Returns
    -------
    LargePicture
        Reads what is asked for, and keeps nothing.

    Raises
    ------
    FormatError
        If its bytes are not the ones that amulor wrote.
    """
    digest = hashlib.sha256()
    with path.open("rb") as file:
        file.seek(-_SEAL_LENGTH, 2)
        left = file.tell()
        seal = file.read()
        file.seek(0)
        while left > 0 and (part := file.read(min(left, 1 << 22))):
            digest.update(part)
            left -= len(part)
    # What another program wrote has no seal.
    said = f"\namulor sha256:{digest.hexdigest()}\n".encode()
    if seal.startswith(b"\namulor sha256:") and seal != said:
        raise FormatError(
            f"{path} is damaged: its bytes are not the ones that amulor wrote; copy it "
            "again, or make it again"
        )
    return LargePicture(path)


class LargePicture:
    """A range image in a file.

    Parameters
    ----------
    path : pathlib.Path
        File of level `range_image`.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._file = h5py.File(path, "r", rdcc_nbytes=1 << 20)
        rows, columns = self._file["slant_range"].shape
        self.shape: tuple[int, int] = (int(rows), int(columns))
        self.attributes = _plain(self._file.attrs)
        self.geometry = _plain(self._file["geometry"].attrs)
        # Files of before say it by their flags alone.
        first = self._read("quality_flag", slice(0, _BAND), slice(None))
        flags = {"quality_flag": (("row", "column"), first)}
        self.error_unknown = error_unknown(xr.Dataset(flags, attrs=self.attributes))

    def has(self, variable: str) -> bool:
        """Return whether there is a variable."""
        return variable in self._file

    def values(self, variable: str, stride: int) -> NDArray[Any]:
        """Return every so many rows and columns of a variable, floats in 32 bits."""
        rows, columns = (-(-size // stride) for size in self.shape)
        kind = self._read(variable, slice(0, 1), slice(0, 1)).dtype.kind
        out = np.empty((rows, columns), np.uint16 if kind in "iu" else np.float32)
        # A band is a whole number of steps, so that each begins where it should.
        band = max(1, _BAND // stride) * stride
        for first in range(0, self.shape[0], band):
            part = self._read(variable, slice(first, first + band), slice(None))
            at = first // stride
            part = part[::stride, ::stride]
            out[at : at + len(part)] = part
        return out

    def beams(self) -> BeamReader:
        """Return what reads the beams."""

        def read(rows: Numbers, columns: Numbers) -> Floats:
            names = [name for name in _BEAM_NAMES if name in self._file]
            return values_of(self._part(names, rows, columns))

        return read

    def around(self, rows: list[int], columns: list[int]) -> xr.Dataset:
        """Return an image of the rows and columns asked for and a mesh of others."""
        self._kept = [
            np.union1d(
                np.linspace(0, size - 1, min(size, _MESH)).astype(np.intp),
                np.asarray(wanted, dtype=np.intp),
            )
            for size, wanted in zip(self.shape, (rows, columns), strict=True)
        ]
        names = [
            str(name)
            for name, variable in self._file.items()
            if getattr(variable, "ndim", 0) == 2 and variable.shape == self.shape
        ]
        return without_unknown_errors(self._part(names, *self._kept))

    def place(self, row: int, column: int) -> tuple[int, int]:
        """Return where a pixel of the scan is in the last image of `around`."""
        first, second = (
            int(np.searchsorted(kept, value))
            for kept, value in zip(self._kept, (row, column), strict=True)
        )
        return first, second

    def whole(self) -> xr.Dataset:
        """Refuse: what is read band by band is not held at once."""
        raise CubeError(
            f"{self._path.name} is too large for products beside a page: "
            f"{self.shape[0]} x {self.shape[1]} pixels; use amulor export, or "
            "amulor report"
        )

    def _part(self, names: list[str], rows: Numbers, columns: Numbers) -> xr.Dataset:
        variables = {
            name: (
                ("row", "column"),
                np.concatenate(
                    [
                        self._read(name, slice(first, first + _BAND), slice(None))[
                            rows[(rows >= first) & (rows < first + _BAND)] - first
                        ][:, columns]
                        for first in range(0, self.shape[0], _BAND)
                        if np.any((rows >= first) & (rows < first + _BAND))
                    ]
                ),
                _plain(self._file[name].attrs),
            )
            for name in names
        }
        coordinates = {
            name: variables.pop(name)
            for name in (*_BEAM_NAMES, "time")
            if name in variables
        }
        return xr.Dataset(
            variables,
            {**coordinates, "geometry": ((), np.int32(0), self.geometry)},
            self.attributes,
        )

    def _read(self, name: str, rows: slice, columns: slice) -> NDArray[Any]:
        try:
            with self._lock:
                return np.asarray(self._file[name][rows, columns])
        except (OSError, KeyError, RuntimeError) as error:
            raise FormatError(
                f"{self._path} can no longer be read: {error}; open it again"
            ) from error


_BEAM_NAMES = ("azimuth", "elevation", "origin_x", "origin_y", "origin_z")
_STRUCTURE = ("DIMENSION", "CLASS", "NAME", "REFERENCE", "_Netcdf4", "_FillValue")


def _plain(attributes: Any) -> dict[str, Any]:
    """Return attributes as Python has them."""
    found: dict[str, Any] = {}
    for name, value in attributes.items():
        if name.startswith(_STRUCTURE):
            continue
        if isinstance(value, bytes):
            value = value.decode()
        elif isinstance(value, h5py.Empty):
            value = ""
        elif isinstance(value, np.ndarray) and value.shape == (1,):
            value = value[0]
        found[name] = value
    return found
