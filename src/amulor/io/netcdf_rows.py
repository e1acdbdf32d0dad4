"""Reads and writes cubes of netCDF-4 files by rows, so that none is in memory whole.

The files are those of `amulor.io.netcdf`, and are read by it as well.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from amulor import cube as cubes
from amulor.cube import schema, tiles
from amulor.errors import AmulorError, CubeError, FormatError
from amulor.io.files import atomic_output, load_hdf5
from amulor.io.netcdf import (
    _HDF5_SIGNATURE,
    _LIBRARY_VERSION,
    _SEAL_LENGTH,
    _SEAL_START,
    CHUNK_VALUES,
    _check_fits,
    _check_storable,
    _create,
    _group,
    _listing,
    _reason,
    _root,
    _set_attributes,
    _with_present_names,
    read_cube,
)

__all__ = ["CubeRows", "RowWriter", "is_large", "open_rows", "row_writer"]

#: Bytes of a file that are read at once for its digest.
_PIECE = 2**24
#: Files above this many bytes of samples are worked on by rows, unless somebody says
#: otherwise; a step that holds all of them at once takes up to 75 times as much.
LARGE = 2**24


class CubeRows:
    """The rows of a cube in a file; made by `open_rows`."""

    def __init__(self, cube: xr.Dataset, path: Path, storage: Any) -> None:
        self._cube, self._path = cube, path
        self._storage = storage
        self._stored = {
            name
            for name, variable in cube.variables.items()
            if name in storage and _is_as_stored(variable, storage[name])
        }
        self._rows = int(cube.sizes["row"])
        self._columns = int(cube.sizes["column"])
        names = [name for name, v in cube.variables.items() if "row" in v.dims]
        self._head = cube.drop_vars(names).load()

    @property
    def head(self) -> xr.Dataset:
        """All that does not run over the rows."""
        return self._head

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self._rows

    @property
    def columns(self) -> int:
        """Number of columns."""
        return self._columns

    def tile(self, begin: int, end: int) -> xr.Dataset:
        """Return some rows, checked.

        Parameters
        ----------
        begin, end : int
            The first one, and the one behind the last.

        Returns
        -------
        xarray.Dataset
            In memory, with all of `head`.

        Raises
        ------
        CubeError, FormatError
            If the rows do not keep the schema, or are damaged.
        """
        part = cubes.without_unknown_errors(self._read(self._cube, begin, end))
        cubes.check(part, name=f"{self._path}, rows {begin} to {end - 1}")
        return part

    def directions(self, begin: int, end: int) -> xr.Dataset:
        """Return azimuth and elevation of some rows."""
        return self._read(tiles.directions_of(self._cube), begin, end)

    def _read(self, cube: xr.Dataset, begin: int, end: int) -> xr.Dataset:
        def rows(name: Any) -> xr.Variable:
            variable = cube.variables[name]
            if "row" not in variable.dims:
                return variable
            place = {"row": slice(begin, end)}
            if name not in self._stored:
                return variable.isel(place)
            index = tuple(place.get(str(key), slice(None)) for key in variable.dims)
            # Of the file itself, as the layers above take as long again; closed at
            # once, as each that is open keeps blocks.
            values = self._storage[name][index]
            return xr.Variable(variable.dims, values, variable.attrs)

        try:
            part = xr.Dataset(
                {name: rows(name) for name in cube.data_vars},
                {name: rows(name) for name in cube.coords},
                cube.attrs,
            )
            return part.load().drop_encoding()
        except AmulorError:
            raise
        except Exception as error:  # as in `read_cube`
            raise FormatError(
                f"rows {begin} to {end - 1} of {self._path} cannot be read: "
                f"{_reason(error)}; the file is damaged: copy it again, or make it "
                "again"
            ) from error


def _is_as_stored(variable: xr.Variable, stored: Any) -> bool:
    """Return whether a variable over the rows has the values that the file has."""
    coded = {"scale_factor", "add_offset", "missing_value"} & set(variable.encoding)
    missing = variable.encoding.get("_FillValue", np.nan)
    return bool(
        "row" in variable.dims
        and not coded
        and np.all(np.isnan(missing))
        and stored.shape == variable.shape
        and stored.dtype == variable.dtype
        and stored.dtype.kind in "fi"
    )


@contextmanager
def open_rows(
    path: str | os.PathLike[str], *, check_digest: bool = True
) -> Iterator[CubeRows]:
    """Open a cube to read rows of it.

    Parameters
    ----------
    path : path-like
        netCDF-4 file with a cube over rows and columns.
    check_digest : bool
        Whether all of the file is read before for its digest; if not, damage is found
        by the checksums of its blocks as they are read.

    Yields
    ------
    CubeRows
        Until the block ends.

    Raises
    ------
    FormatError
        If the file is missing, damaged, or no netCDF-4 file.
    CubeError
        If it has no rows and columns.
    """
    load_hdf5()
    import h5netcdf
    import h5py

    path = Path(path)
    with ExitStack() as stack:
        try:
            if check_digest:
                _check_digest(path)
            storage = stack.enter_context(h5py.File(path, "r"))
            if "amulor_schema_version" not in dict(storage.attrs):
                raise FormatError(
                    f"{path} is no cube of amulor: it lacks the attribute "
                    "'amulor_schema_version'; name a file that amulor wrote"
                )
            file = stack.enter_context(
                h5netcdf.File(storage, "r", decode_vlen_strings=True)
            )
            cube = _opened(file, None)
            for group in schema.GROUPS:
                if group in file.groups:
                    part = _opened(file, group)
                    _check_fits(part, cube, path=path, group=group)
                    cube = cubes.attach(cube, part, group)
            cube = _with_present_names(cube)
        except AmulorError:
            raise
        except Exception as error:  # h5py and what decodes the file raise many kinds
            raise FormatError(
                f"{path} cannot be read as a netCDF-4 file: {_reason(error)}; it is "
                "damaged, or another program wrote it: copy it again, or make it again"
            ) from error
        if not {"row", "column"} <= set(cube.sizes):
            raise CubeError(
                f"{path} has the dimensions {', '.join(map(str, cube.sizes))}; rows "
                "and columns are needed to work row by row: read it whole"
            )
        yield CubeRows(cube, path, storage)


def is_large(path: str | os.PathLike[str], *, most: int | None = None) -> bool:
    """Return whether a file should be worked on row by row.

    Parameters
    ----------
    path : path-like
        Any file; one that cannot be read is not large.
    most : int, optional
        Bytes of samples, or of ranges, of the largest file that is not; `LARGE` by
        default [B].

    Returns
    -------
    bool
        True above these.
    """
    load_hdf5()
    import h5py

    limit = LARGE if most is None else most
    try:
        with h5py.File(path, "r") as storage:
            found = storage.get("in_phase", storage.get("slant_range"))
            return found is not None and found.size * found.dtype.itemsize > limit
    except (OSError, RuntimeError, ValueError, KeyError, AttributeError):
        return False


def _opened(file: Any, group: str | None) -> xr.Dataset:
    """Return a group of a file, of which nothing over the rows is read yet."""
    store = xr.backends.H5NetCDFStore(file, group=group)
    part = xr.open_dataset(store, decode_times=False, cache=False)
    few = {
        name: variable.load()
        for name, variable in part.variables.items()
        if "row" not in variable.dims
    }
    part = part.assign({name: v for name, v in few.items() if name in part.data_vars})
    part = part.assign_coords({n: v for n, v in few.items() if n in part.coords})
    if "polarization" in part.coords:
        part = part.assign_coords(polarization=part["polarization"].astype(object))
    return part


def _check_digest(path: Path) -> None:
    """Refuse a file whose bytes are not those that amulor wrote."""
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            start = file.read(len(_HDF5_SIGNATURE))
            file.seek(max(size - _SEAL_LENGTH, 0))
            end = file.read()
            if start != _HDF5_SIGNATURE:
                # `read_cube` says what it is.
                read_cube(path)
            at = end.rfind(_SEAL_START)
            if at < 0:
                return
            stated = end[at + len(_SEAL_START) :].strip().decode("ascii", "replace")
            file.seek(0)
            found = _digest(file, size - len(end) + at)
    except OSError as error:
        raise FormatError(
            f"{path} cannot be read: {error.strerror or error}; check name and rights"
        ) from error
    if stated != found:
        raise FormatError(
            f"{path} is damaged: its bytes are not the ones that amulor wrote; copy it "
            "again, or make it again"
        )


def _digest(file: Any, length: int) -> str:
    """Return the digest of the first bytes of a file, as `cube.digest` does."""
    found = hashlib.sha256()
    left = length
    while left > 0:
        piece = file.read(min(left, _PIECE))
        if not piece:
            break
        found.update(piece)
        left -= len(piece)
    return f"sha256:{found.hexdigest()}"


class RowWriter:
    """A cube that is written row by row; made by `row_writer`."""

    def __init__(self, file: Any, rows: int, *, name: str, over: str = "row") -> None:
        self._file, self._rows, self._name, self._over = file, rows, name, over
        self._made: dict[str, dict[str, Any]] | None = None
        self._written = 0

    def put(self, tile: xr.Dataset, begin: int) -> None:
        """Write some rows.

        Parameters
        ----------
        tile : xarray.Dataset
            A cube with the variables of the first tile, in the order of the rows; what
            does not run over the rows is taken from the first tile.
        begin : int
            Which row its first one is.

        Raises
        ------
        CubeError
            If it does not keep the schema, has other variables than the first, or does
            not follow the tile before.
        """
        tile = cubes.checked(tile, name=self._name)
        parts = {"": _root(tile)}
        for group in schema.GROUPS:
            part = _group(tile, group, name=self._name)
            if part is not None:
                parts[group] = part
        if begin != self._written:
            raise CubeError(
                f"{self._name}: {self._over}s from {begin} on do not follow "
                f"{self._over} {self._written - 1}; write the tiles in order"
            )
        if self._made is None:
            self._made = {key: self._begun(key, part) for key, part in parts.items()}
        end = begin + tile.sizes[self._over]
        for key, part in parts.items():
            over = {
                str(name): variable
                for name, variable in part.variables.items()
                if self._over in variable.dims
            }
            made = self._made.get(key, {})
            if set(made) != set(over):
                odd = ", ".join(sorted(set(made) ^ set(over)))
                raise CubeError(
                    f"{self._name}: {self._over}s from {begin} on and the first ones "
                    f"differ in {odd}; tiles of one cube have the same variables"
                )
            for name, variable in over.items():
                place = tuple(
                    slice(begin, end) if dimension == self._over else slice(None)
                    for dimension in variable.dims
                )
                values = variable.values
                kind = values.dtype.kind
                made[name][place] = values.astype(np.int8) if kind == "b" else values
        self._written = end

    def end(self) -> None:
        """Say that all rows are written.

        Raises
        ------
        CubeError
            If some are missing.
        """
        if self._written != self._rows:
            raise CubeError(
                f"{self._name}: {self._written} of {self._rows} {self._over}s are "
                "written; write the others"
            )

    def _begun(self, key: str, part: xr.Dataset) -> dict[str, Any]:
        """Make a group with what does not run over the rows; return what does."""
        _check_storable(part, name=self._name)
        group = self._file.create_group(key) if key else self._file
        sizes = dict(part.sizes)
        if self._over in sizes:
            sizes[self._over] = self._rows
        for dimension, size in sizes.items():
            group.dimensions[dimension] = size
        listed, attributes = _listing(part)
        made = {}
        for name, variable in part.variables.items():
            over = self._over in variable.dims
            shape = tuple(int(sizes[dimension]) for dimension in variable.dims)
            created = _create(
                group, str(name), variable, listed[name], shape=shape if over else None
            )
            if over:
                made[str(name)] = created
        _set_attributes(group, attributes)
        return made


@contextmanager
def row_writer(
    path: str | os.PathLike[str],
    rows: int,
    *,
    overwrite: bool = False,
    over: str = "row",
) -> Iterator[RowWriter]:
    """Write a cube row by row; the file is there when all of it is written.

    Parameters
    ----------
    path : path-like
        File to make.
    rows : int
        Rows of the whole cube.
    overwrite : bool
        Whether an existing file is replaced.
    over : str
        The dimension that is written part by part: "row", or "point" of a cloud.

    Yields
    ------
    RowWriter
        Takes the tiles in order.

    Raises
    ------
    FormatError
        If the file exists and `overwrite` is not set, or cannot be written.
    CubeError
        If rows are missing at the end.
    """
    load_hdf5()
    import h5netcdf

    with atomic_output(path, overwrite=overwrite) as temporary:
        with h5netcdf.File(temporary, "w", libver=_LIBRARY_VERSION) as file:
            writer = RowWriter(file, rows, name=f"the cube for {path}", over=over)
            yield writer
            writer.end()
        with temporary.open("r+b") as file:
            found = _digest(file, temporary.stat().st_size)
            file.seek(0, os.SEEK_END)
            file.write(_SEAL_START + found.encode() + b"\n")


def tile_rows(source: tiles.Source) -> int:
    """Return how many rows a tile has: whole blocks of a file, within bounds.

    Parameters
    ----------
    source : Source
        Where the rows come from.

    Returns
    -------
    int
        As `amulor.cube.tiles.bands` takes by default, in whole blocks of the file.
    """
    first, end = next(tiles.bands(source))
    block = max(1, CHUNK_VALUES // max(source.columns, 1))
    rows = end - first
    return rows if rows < block else rows // block * block
