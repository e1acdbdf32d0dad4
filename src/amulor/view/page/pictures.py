"""Range images as the browser page needs them: maps, beams, error correlations."""

from __future__ import annotations

import hashlib
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import h5py
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor._hdf5 import SEAL_LENGTH
from amulor.cube import error_unknown, without_unknown_errors
from amulor.cube.schema import ALIKE_TERMS, WATER_TERMS
from amulor.errors import CubeError, FormatError
from amulor.imaging.measure import reference_basis
from amulor.imaging.observation import geometry_of
from amulor.view.page.layers import MAPS

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]

#: Largest displacement of a point by interpolated beams [m].
TOLERANCE = 2e-6
#: Values of a node: place at range zero (3), direction (3), azimuth, elevation.
VALUES = 8
_FIRST_STEP = 64
_CHECKED = 30_000


class BeamReader(Protocol):
    """Function that returns the beams at selected rows and columns of a scan."""

    def __call__(self, rows: Numbers, columns: Numbers, /) -> Floats:
        """Beams at rows and columns, shape (row, column, value)."""


@dataclass(frozen=True)
class Nodes:
    """Beams on a coarse grid of pixels, between which the page interpolates."""

    rows: Numbers
    """Row numbers of the nodes, including the first and the last row [1]."""
    columns: Numbers
    """Column numbers of the nodes [1]."""
    values: NDArray[np.float32]
    """Point of zero slant range [m], direction [1], azimuth and elevation [rad]; shape
    (node rows, node columns, 8)."""


def reader_of(image: xr.Dataset) -> BeamReader:
    """Return a function that reads the beams of a range image in memory."""

    def read(rows: Numbers, columns: Numbers) -> Floats:
        part = image.isel(row=rows, column=columns)
        return values_of(part)

    return read


def values_of(part: xr.Dataset) -> Floats:
    """Beams of a range image in one array, shape (row, column, value)."""
    beam = geometry_of(part).beam
    base = beam.entry - beam.length_before[..., None] * beam.direction
    angles = np.stack([part["azimuth"].values, part["elevation"].values], axis=-1)
    return np.concatenate([base, beam.direction, angles], axis=-1)


def nodes_of(
    read: BeamReader, shape: tuple[int, int], *, farthest: float, stride: int = 1
) -> Nodes:
    """Coarsest beam grid whose interpolation error is within the tolerance."""
    step = _FIRST_STEP
    while step > stride:
        nodes = _grid(read, shape, step)
        if _error(read, shape, nodes, farthest) <= TOLERANCE:
            return nodes
        step //= 2
    return _grid(read, shape, max(stride, 1))


def interpolated(nodes: Nodes, rows: Numbers, columns: Numbers) -> Floats:
    """Interpolate beams bilinearly between grid nodes, as the page's script does."""
    up, low = _between(nodes.rows, rows), _between(nodes.columns, columns)
    values = nodes.values.astype(float)
    top = values[up[0]][:, low[0]], values[up[0]][:, low[1]]
    bottom = values[up[1]][:, low[0]], values[up[1]][:, low[1]]
    across, along = low[2][None, :, None], up[2][:, None, None]
    first = top[0] * (1 - across) + top[1] * across
    second = bottom[0] * (1 - across) + bottom[1] * across
    result: Floats = first * (1 - along) + second * along
    return result


def _between(nodes: Numbers, at: Numbers) -> tuple[Numbers, Numbers, Floats]:
    """Node indices around each row or column, and interpolation weights."""
    before = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 1)
    after = np.minimum(before + 1, len(nodes) - 1)
    width = np.maximum(nodes[after] - nodes[before], 1)
    return before, after, (at - nodes[before]) / width


def _grid(read: BeamReader, shape: tuple[int, int], step: int) -> Nodes:
    rows, columns = (_places(size, step) for size in shape)
    return Nodes(rows, columns, read(rows, columns).astype(np.float32))


def _places(size: int, step: int) -> Numbers:
    return np.unique(np.append(np.arange(0, size, step), size - 1))


def _error(
    read: BeamReader, shape: tuple[int, int], nodes: Nodes, farthest: float
) -> float:
    """Largest point error due to interpolation of beam origins and directions [m]."""
    rows, columns = (np.arange(size) for size in shape)
    thin = max(1, int(np.ceil(np.sqrt(rows.size * columns.size / _CHECKED))))
    rows, columns = rows[::thin], columns[::thin]
    shift = interpolated(nodes, rows, columns) - read(rows, columns)
    far = shift[..., :3] + farthest * shift[..., 3:6]
    return float(max(np.abs(far).max(), np.abs(shift[..., :3]).max()))


class Picture(Protocol):
    """Interface of a range image whose maps are read one at a time."""

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns."""

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes of the image."""

    @property
    def geometry(self) -> dict[str, Any]:
        """Attributes of the scan geometry: positions and refractive indices."""

    @property
    def error_unknown(self) -> str:
        """Reason for unknown range errors; empty if they are known."""

    def has(self, variable: str) -> bool:
        """Whether the image has a variable."""

    def values(self, variable: str, stride: int) -> NDArray[Any]:
        """Values of a variable at every `stride`-th row and column."""

    def beams(self) -> BeamReader:
        """Return a function that reads the beams of the image."""

    def around(self, rows: list[int], columns: list[int]) -> xr.Dataset:
        """Part of the range image that contains given pixels and their neighbors."""

    def place(self, row: int, column: int) -> tuple[int, int]:
        """Row and column of a scan's pixel within the image from `around`."""

    def whole(self) -> xr.Dataset:
        """Whole image in memory; `CubeError` if it is too large."""


@dataclass(frozen=True)
class MemoryPicture:
    """Range image in memory."""

    image: xr.Dataset
    """Range image, level `range_image`."""

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns."""
        rows, columns = self.image["slant_range"].shape
        return rows, columns

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes of the image."""
        return {str(key): value for key, value in self.image.attrs.items()}

    @property
    def geometry(self) -> dict[str, Any]:
        """Attributes of the scan geometry: positions and refractive indices."""
        return dict(self.image["geometry"].attrs)

    @property
    def error_unknown(self) -> str:
        """Reason for unknown range errors; empty if they are known."""
        return error_unknown(self.image)

    def has(self, variable: str) -> bool:
        """Whether the image has a variable."""
        return variable in self.image

    def values(self, variable: str, stride: int) -> NDArray[Any]:
        """Values of a variable at every `stride`-th row and column."""
        return np.asarray(self.image[variable].values[::stride, ::stride])

    def beams(self) -> BeamReader:
        """Return a function that reads the beams of the image."""
        return reader_of(self.image)

    def around(self, rows: list[int], columns: list[int]) -> xr.Dataset:
        """Whole image, which contains the neighbors of any pixel."""
        return self.image

    def place(self, row: int, column: int) -> tuple[int, int]:
        """Unchanged row and column, since `around` returns the whole image."""
        return row, column

    def whole(self) -> xr.Dataset:
        """Whole image."""
        return self.image


@dataclass(frozen=True, kw_only=True)
class Channel:
    """Range images of one channel, before and after water rejection."""

    after: Picture | None
    """Range image after water rejection, if there is one."""
    before: Picture | None
    """Range image before water rejection, if it is available."""
    compared: str = ""
    """Result of the comparison with a reference, or reason for its failure."""

    @property
    def shown(self) -> Picture:
        """Range image used for measurements: after rejection, if available."""
        picture = self.after or self.before
        assert picture is not None
        return picture


_BAND = 256
#: Number of rows and columns that represent the scan, in addition to measured pixels
#: [1].
_MESH = 128


def large_picture(path: Path) -> LargePicture:
    """Open a range image of any size; FormatError if its file is damaged."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        file.seek(-SEAL_LENGTH, 2)
        remaining = file.tell()
        seal = file.read()
        file.seek(0)
        while remaining > 0 and (part := file.read(min(remaining, 1 << 22))):
            digest.update(part)
            remaining -= len(part)
    # Files of other programs have no digest.
    expected = f"\namulor sha256:{digest.hexdigest()}\n".encode()
    if seal.startswith(b"\namulor sha256:") and seal != expected:
        raise FormatError(
            f"{path} is damaged: its bytes are not the ones that amulor wrote; copy it "
            "again, or make it again"
        )
    return LargePicture(path)


class LargePicture:
    """Range image in a file, read in bands of rows."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._file = h5py.File(path, "r", rdcc_nbytes=1 << 20)
        rows, columns = self._file["slant_range"].shape
        self.shape: tuple[int, int] = (int(rows), int(columns))
        self.attributes = _plain(self._file.attrs)
        self.geometry = _plain(self._file["geometry"].attrs)
        # Older files state this only by their flags.
        first = self._read("quality_flag", slice(0, _BAND), slice(None))
        flags = {"quality_flag": (("row", "column"), first)}
        self.error_unknown = error_unknown(xr.Dataset(flags, attrs=self.attributes))

    def has(self, variable: str) -> bool:
        """Whether the image has a variable."""
        return variable in self._file

    def values(self, variable: str, stride: int) -> NDArray[Any]:
        """Values at every `stride`-th row and column; float32, integers as uint16."""
        rows, columns = (-(-size // stride) for size in self.shape)
        kind = self._read(variable, slice(0, 1), slice(0, 1)).dtype.kind
        out = np.empty((rows, columns), np.uint16 if kind in "iu" else np.float32)
        # A band is a whole number of strides, so that each band begins at a drawn row.
        band = max(1, _BAND // stride) * stride
        for first in range(0, self.shape[0], band):
            part = self._read(variable, slice(first, first + band), slice(None))
            at = first // stride
            part = part[::stride, ::stride]
            out[at : at + len(part)] = part
        return out

    def beams(self) -> BeamReader:
        """Return a function that reads the beams of the image."""

        def read(rows: Numbers, columns: Numbers) -> Floats:
            names = [name for name in _BEAM_NAMES if name in self._file]
            return values_of(self._part(names, rows, columns))

        return read

    def around(self, rows: list[int], columns: list[int]) -> xr.Dataset:
        """Range image of the given rows and columns, and of a coarse grid elsewhere."""
        self._kept = [
            np.union1d(
                np.linspace(0, size - 1, min(size, _MESH)).astype(np.intp),
                np.asarray(indices, dtype=np.intp),
            )
            for size, indices in zip(self.shape, (rows, columns), strict=True)
        ]
        names = [
            str(name)
            for name, variable in self._file.items()
            if getattr(variable, "ndim", 0) == 2 and variable.shape == self.shape
        ]
        return without_unknown_errors(self._part(names, *self._kept))

    def place(self, row: int, column: int) -> tuple[int, int]:
        """Row and column of a scan's pixel within the last image from `around`."""
        first, second = (
            int(np.searchsorted(indices, value))
            for indices, value in zip(self._kept, (row, column), strict=True)
        )
        return first, second

    def whole(self) -> xr.Dataset:
        """Raise `CubeError`: an image read in bands is too large for memory."""
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
    """Attributes converted to plain Python values."""
    plain: dict[str, Any] = {}
    for name, value in attributes.items():
        if name.startswith(_STRUCTURE):
            continue
        if isinstance(value, bytes):
            value = value.decode()
        elif isinstance(value, h5py.Empty):
            value = ""
        elif isinstance(value, np.ndarray) and value.shape == (1,):
            value = value[0]
        plain[name] = value
    return plain


def sharing_of(picture: Picture) -> dict[str, Any] | None:
    """Parameters of the error correlation of two pixels; None if errors are unknown."""
    if not picture.has("slant_range_common_uncertainty") or picture.error_unknown:
        return None
    names = {
        kind: [
            MAPS[f"slant_range_uncertainty_{term}"].name
            for term in terms
            if picture.has(f"slant_range_uncertainty_{term}")
        ]
        for kind, terms in (
            ("alike", ALIKE_TERMS),
            ("of_water", WATER_TERMS),
        )
    }
    basis: dict[str, Any] = {}
    if "open_water_degree" in picture.attributes:
        thin = max(1, int(np.sqrt(picture.shape[0] * picture.shape[1] / 250_000)))
        angles = [picture.values(name, thin) for name in ("azimuth", "elevation")]
        degree = int(np.max(picture.attributes["open_water_degree"]))
        basis = reference_basis(*angles, degree=degree)
    return {**names, **basis}
