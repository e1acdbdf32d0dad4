"""Measurement cubes as netCDF-4 files, read and written whole or row by row."""

from __future__ import annotations

import hashlib
import io
import os
import warnings
from collections.abc import Hashable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor._hdf5 import (
    SEAL_LENGTH,
    SEAL_START,
    SIGNATURE,
    check_heaps,
    check_heaps_of,
    check_size,
)
from amulor.cube import schema, tiles
from amulor.errors import AmulorError, CubeError, FormatError
from amulor.io.files import atomic_output, load_hdf5, read_bytes

__all__ = [
    "CubeRows",
    "RowWriter",
    "is_large",
    "open_rows",
    "read_cube",
    "row_writer",
    "tile_rows",
    "write_cube",
]

_CLASSIC_SIGNATURE = b"CDF"
# 128 KiB of float64: whole blocks of a file fit in any tile of rows, so that none is
# compressed twice; larger ones are neither smaller in the file nor faster.
CHUNK_VALUES = 2**14
# Structures of HDF5 1.10, the first whose indices of chunks have checksums too.
_LIBRARY_VERSION = ("v110", "v110")
_GROUP_TITLES = {
    "open_water": "shots into open water, without a target",
    "truth": "what the cube was simulated from; no processing step reads it",
}
# Directions of the beams and the frequencies are known for every pixel, measured or
# not; any other number may be missing.
_NEVER_MISSING = {"modulation_frequency", "azimuth", "elevation"}
# A reader would interpret these attributes and change the values.
_RESERVED_ATTRIBUTES = {
    "_FillValue", "missing_value", "scale_factor", "add_offset", "coordinates",
    "dtype", "_Unsigned", "_Encoding", "CLASS", "NAME", "REFERENCE_LIST",
    "DIMENSION_LIST", "_Netcdf4Dimid", "_Netcdf4Coordinates", "_nc3_strict",
    "_NCProperties",
}  # fmt: skip


def read_cube(path: str | os.PathLike[str]) -> xr.Dataset:
    """Read a measurement cube from a netCDF-4 file into memory.

    Parameters
    ----------
    path : path-like
        File from `write_cube`, or from another program that follows the schema.

    Returns
    -------
    xarray.Dataset
        Cube in memory. Variables of the groups `open_water` and `truth` have the name
        of their group as a prefix. The file is closed.

    Raises
    ------
    FormatError
        If the file is missing, damaged, or no netCDF-4 file.
    CubeError
        If what it holds does not keep the schema of its level.

    Examples
    --------
    >>> from amulor import io, samples
    >>> io.write_cube(samples.cube("ladder"), "ladder.nc")
    >>> io.read_cube("ladder.nc").attrs["level"]
    'samples'
    """
    path = Path(path)
    content = read_bytes(path)
    load_hdf5()
    if content.startswith(_CLASSIC_SIGNATURE):
        raise FormatError(
            f"{path} is a netCDF-3 file, needed is netCDF-4; convert it with "
            "nccopy -k netCDF-4"
        )
    if not content.startswith(SIGNATURE):
        raise FormatError(
            f"{path} is no netCDF-4 file, it starts with {content[:8]!r}; name a cube "
            "that amulor wrote"
        )
    _check_seal(content, path)
    try:
        with warnings.catch_warnings():
            # Warnings about foreign files become errors in the check below.
            warnings.simplefilter("ignore")
            cube = _decoded(content, path)
        cubes.check(cube, name=str(path))
    except AmulorError:
        raise
    except Exception as error:  # h5py and what decodes the file raise many kinds
        raise _unreadable(path, error) from error
    return cube


def write_cube(
    cube: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a measurement cube to a netCDF-4 file.

    Parameters
    ----------
    cube : xarray.Dataset
        Cube of any level. Dimensions that the selection of a single value removed are
        restored.
    path : path-like
        File to write, usually with the suffix `.nc`.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    CubeError
        If the cube does not conform to the schema of its level, or has content that
        netCDF cannot store.
    FormatError
        If the file exists and `overwrite` is not set, or cannot be written.

    Notes
    -----
    `read_cube` returns an identical cube, with the exceptions that netCDF requires:
    lists in attributes become arrays, lists of one value become that value, and the
    `encoding` is lost.

    Examples
    --------
    >>> from amulor import io, samples
    >>> cube = samples.cube("ladder")
    >>> io.write_cube(cube, "ladder.nc")
    >>> io.read_cube("ladder.nc")["in_phase"].shape
    (1, 2, 40, 100)
    """
    path = Path(path)
    name = f"the cube for {path}"
    cube = cubes.checked(cube, name=name)
    parts = {"": _root(cube)}
    for group in schema.GROUPS:
        part = _group(cube, group, name=name)
        if part is not None:
            parts[group] = part
    for part in parts.values():
        _check_storable(part, name=name)
    with atomic_output(path, overwrite=overwrite) as temporary:
        temporary.write_bytes(_encoded(parts))


def _root(cube: xr.Dataset) -> xr.Dataset:
    return cubes.without_groups(cube).drop_encoding()


def _group(cube: xr.Dataset, group: str, *, name: str) -> xr.Dataset | None:
    prefix = f"{group}_"
    variables = {
        str(key).removeprefix(prefix): variable.variable
        for key, variable in cube.data_vars.items()
        if str(key).startswith(prefix)
    }
    if not variables:
        return None
    dimensions = {key for variable in variables.values() for key in variable.dims}
    coordinates = {key: cube[key].variable for key in cube.indexes if key in dimensions}
    for key in variables:
        if not key or key in dimensions:
            raise CubeError(
                f"{name}: variable '{prefix}{key}' cannot be stored, because its "
                f"short name '{key}' is empty or is that of a dimension; rename it"
            )
    attributes = {"title": _GROUP_TITLES[group]}
    return xr.Dataset(variables, coordinates, attributes).drop_encoding()


def _check_storable(part: xr.Dataset, *, name: str) -> None:
    _check_attributes(part.attrs, name=name, owner="the cube")
    for key, variable in part.variables.items():
        owner = f"variable '{key}'"
        if not isinstance(key, str) or not key.isprintable() or {*"/ "} & {*key}:
            raise CubeError(
                f"{name}: {key!r} is no name for a variable of a netCDF file; rename it"
            )
        _check_attributes(variable.attrs, name=name, owner=owner)
        if not (_is_number(variable.dtype) or _is_text(variable)):
            raise CubeError(
                f"{name}: {owner} holds {variable.dtype}, which a netCDF file cannot; "
                "store real numbers or text, complex ones as two variables"
            )


def _is_number(dtype: np.dtype[Any]) -> bool:
    return dtype.kind in "biu" or dtype in (np.float32, np.float64)


def _is_text(variable: xr.Variable) -> bool:
    return variable.dtype.kind in "OUT" and all(
        _is_storable_text(value) for value in variable.values.flat
    )


def _check_attributes(
    attributes: Mapping[Hashable, Any], *, name: str, owner: str
) -> None:
    for key, value in attributes.items():
        if not isinstance(key, str) or not key or "/" in key:
            raise CubeError(
                f"{name}: {key!r} of {owner} is no name for an attribute of a netCDF "
                "file; rename it"
            )
        if key in _RESERVED_ATTRIBUTES:
            raise CubeError(
                f"{name}: attribute '{key}' of {owner} would change how a reader takes "
                "the values; apply it to the values and drop it"
            )
        if not _is_attribute(value):
            text = " ".join(repr(value).split())
            raise CubeError(
                f"{name}: attribute '{key}' of {owner} is {text}, which a netCDF file "
                "cannot hold; write text, a number, or a list of one of them, and 0 "
                "or 1 for no or yes"
            )


def _is_attribute(value: Any) -> bool:
    values = np.asarray(value, dtype=None if hasattr(value, "dtype") else object)
    if values.ndim > 1 or values.size == 0:
        return False
    if values.dtype.kind in "OU" and all(
        _is_storable_text(text) for text in values.flat
    ):
        return True
    try:
        dtype = np.asarray(value).dtype
    except ValueError:  # lists of different lengths
        return False
    return _is_number(dtype) and dtype.kind != "b"


def _is_storable_text(value: Any) -> bool:
    # NetCDF ends a text at a zero; half of a surrogate pair has no bytes in UTF-8.
    return isinstance(value, str) and not any(
        letter == "\0" or "\ud800" <= letter <= "\udfff" for letter in value
    )


def _encoded(parts: Mapping[str, xr.Dataset]) -> bytes:
    load_hdf5()
    import h5netcdf

    # Built in memory first: on a full disk, one write fails, instead of an HDF5 file
    # that stays open.
    buffer = io.BytesIO()
    with h5netcdf.File(buffer, "w", libver=_LIBRARY_VERSION) as file:
        for group, part in parts.items():
            _fill(file.create_group(group) if group else file, part)
    content = buffer.getvalue()
    return content + _seal(content)


def _seal(content: bytes) -> bytes:
    return SEAL_START + cubes.digest(content).encode() + b"\n"


def _check_seal(content: bytes, path: Path) -> None:
    start = content.rfind(SEAL_START, -SEAL_LENGTH)
    if start < 0:
        check_heaps(content, path)
    elif content[start:] != _seal(content[:start]):
        raise FormatError(
            f"{path} is damaged: its bytes are not the ones that amulor wrote; copy it "
            "again, or make it again"
        )


def _fill(group: Any, part: xr.Dataset) -> None:
    for dimension, size in part.sizes.items():
        group.dimensions[dimension] = size
    listed, attributes = _listing(part)
    for key, variable in part.variables.items():
        _create(group, str(key), variable, listed[key])
    _set_attributes(group, attributes)


def _listing(
    part: xr.Dataset,
) -> tuple[dict[Hashable, dict[str, Any]], dict[str, Any]]:
    """Attributes of variables and their group, with the CF attribute `coordinates`."""
    attributes = {key: dict(variable.attrs) for key, variable in part.variables.items()}
    listed: set[Hashable] = set(part.indexes)
    for key in part.data_vars:
        beside = [
            place
            for place, coordinate in part.coords.items()
            if place not in part.indexes
            and set(coordinate.dims) <= {*part.variables[key].dims}
        ]
        listed.update(beside)
        if beside:
            attributes[key]["coordinates"] = " ".join(map(str, beside))
    group_attributes = dict(part.attrs)
    unlisted = [str(place) for place in part.coords if place not in listed]
    if unlisted:
        group_attributes["coordinates"] = " ".join(unlisted)
    return attributes, group_attributes


def _create(
    group: Any,
    key: str,
    variable: xr.Variable,
    attributes: dict[str, Any],
    *,
    shape: tuple[int, ...] | None = None,
) -> Any:
    """Create a variable in a file; if `shape` is set, write no values yet."""
    import h5py

    values = variable.values
    full_shape = values.shape if shape is None else shape
    dtype: Any = values.dtype.newbyteorder("=")
    options: dict[str, Any] = {}
    if dtype.kind == "b":  # netCDF has no booleans; xarray marks them like this
        values, dtype = values.astype(np.int8), np.dtype(np.int8)
        attributes = {**attributes, "dtype": "bool"}
    if dtype.kind in "OUT":
        values, dtype = values.astype(object), h5py.string_dtype()
    elif len(full_shape) > 0 and min(full_shape) > 0:
        options.update(
            chunks=_chunks(full_shape),
            compression="gzip",
            compression_opts=4,
            shuffle=True,
            fletcher32=True,
        )
    if dtype.kind == "f" and key not in _NEVER_MISSING:
        options["fillvalue"] = dtype.type(np.nan)
    created = group.create_variable(key, variable.dims, dtype, **options)
    if values.size > 0 and shape is None:
        created[...] = values
    _set_attributes(created, attributes)
    return created


def _chunks(shape: tuple[int, ...]) -> tuple[int, ...]:
    # Whole trailing dimensions as long as they fit, then a part of one, then ones.
    chunks: list[int] = []
    room = CHUNK_VALUES
    for size in reversed(shape):
        chunks.append(max(1, min(size, room)))
        room //= size
    return tuple(reversed(chunks))


def _set_attributes(owner: Any, attributes: Mapping[str, Any]) -> None:
    for key, value in attributes.items():
        if isinstance(value, str):
            value = _text(value)
        elif np.asarray(value).dtype.kind == "U":
            value = np.asarray(value).tolist()
        owner.attrs[key] = value


def _text(value: str) -> Any:
    # Characters of fixed length, which every netCDF reader knows, old ones too.
    import h5py

    encoded = value.encode()
    if not encoded:
        return h5py.Empty(np.dtype("S1"))
    kind = "ascii" if value.isascii() else "utf-8"
    return np.array(encoded, dtype=h5py.string_dtype(kind, len(encoded)))


def _decoded(content: bytes, path: Path) -> xr.Dataset:
    import h5netcdf

    with indexed_file(content) as storage:
        # All variables, because h5netcdf fails badly at a damaged one.
        if "amulor_schema_version" not in dict(storage.attrs):
            raise FormatError(
                f"{path} is no cube of amulor: it lacks the attribute "
                "'amulor_schema_version'; name a file that amulor wrote"
            )
        check_size(storage, path)
        with h5netcdf.File(storage, "r", decode_vlen_strings=True) as file:
            cube = _opened(file, None)
            for group in schema.GROUPS:
                if group in file.groups:
                    part = _opened(file, group)
                    _check_fits(part, cube, path=path, group=group)
                    cube = cubes.attach(cube, part, group)
    return cubes.without_unknown_errors(_with_present_names(cube))


def indexed_file(content: bytes) -> Any:
    """Open an HDF5 file from bytes, with cached path lookup."""
    import h5py

    class IndexedFile(h5py.File):  # type: ignore[misc]
        """HDF5 file with cached path lookup, which h5netcdf repeats very often."""

        def __getitem__(self, name: Any) -> Any:
            """Object at a path, or of a reference."""
            if not isinstance(name, str):
                return super().__getitem__(name)
            if name not in objects:
                objects[name] = super().__getitem__(name)
            return objects[name]

    objects: dict[str, Any] = {}
    return IndexedFile(io.BytesIO(content), "r")


def _with_present_names(cube: xr.Dataset) -> xr.Dataset:
    """Cube of schema version 1, with variables renamed to the present names."""
    former = {
        old: new
        for old, new in schema.FORMER_NAMES.items()
        if old in cube.data_vars and new not in cube.variables
    }
    return cube.rename_vars(former)


def _opened(file: Any, group: str | None, *, by_rows: bool = False) -> xr.Dataset:
    """Open a group of a file; if by rows, leave variables with rows unread."""
    store = xr.backends.H5NetCDFStore(file, group=group)
    # Units such as "days since 2020-01-01" are left to the schema.
    part = xr.open_dataset(store, decode_times=False, cache=not by_rows)
    if by_rows:
        few = {
            name: variable.load()
            for name, variable in part.variables.items()
            if "row" not in variable.dims
        }
        part = part.assign({n: v for n, v in few.items() if n in part.data_vars})
        part = part.assign_coords({n: v for n, v in few.items() if n in part.coords})
    else:
        part = part.load().drop_encoding()
    if "polarization" in part.coords:
        part = part.assign_coords(polarization=part["polarization"].astype(object))
    return part


def _check_fits(part: xr.Dataset, cube: xr.Dataset, *, path: Path, group: str) -> None:
    for dimension, size in part.sizes.items():
        if cube.sizes.get(dimension, size) != size:
            raise FormatError(
                f"{path}: group '{group}' has {size} of dimension '{dimension}', the "
                f"cube has {cube.sizes[dimension]}; make the file again"
            )
    for key in part.indexes:
        stored, needed = _values(part, key), _values(cube, key)
        if key in cube.indexes and not np.array_equal(stored, needed):
            raise FormatError(
                f"{path}: group '{group}' has '{key}' {stored.tolist()}, the cube has "
                f"{needed.tolist()}; make the file again"
            )


def _values(part: xr.Dataset, key: Hashable) -> NDArray[Any]:
    return np.asarray(part[key].values) if key in part.variables else np.empty(0)


def _unreadable(path: Path, error: Exception) -> FormatError:
    """Return the error message for a file that h5py cannot read."""
    return FormatError(
        f"{path} cannot be read as a netCDF-4 file: {_reason(error)}; it is damaged, "
        "or another program wrote it: copy it again, or make it again"
    )


def _reason(error: Exception) -> str:
    if isinstance(error, (OSError, RuntimeError, ValueError, KeyError)) and error.args:
        return " ".join(str(error.args[0]).split())
    return "its parts do not fit together"


#: Bytes of a file that are read at once for its digest.
_PIECE = 2**24


class CubeRows:
    """Cube that is read from a file row by row; created by `open_rows`."""

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
        """Variables and coordinates without row dimension, and the attributes."""
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
        """Read a range of rows as a cube; raise unless it conforms to the schema."""
        part = cubes.without_unknown_errors(self._read(self._cube, begin, end))
        cubes.check(part, name=f"{self._path}, rows {begin} to {end - 1}")
        return part

    def directions(self, begin: int, end: int) -> xr.Dataset:
        """Azimuth and elevation of a range of rows."""
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
    """Whether a file stores a variable's rows without scaling or fill value."""
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
    """Open a cube file, to read it row by row."""
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
            check_size(storage, path)
            file = stack.enter_context(
                h5netcdf.File(storage, "r", decode_vlen_strings=True)
            )
            cube = _opened(file, None, by_rows=True)
            for group in schema.GROUPS:
                if group in file.groups:
                    part = _opened(file, group, by_rows=True)
                    _check_fits(part, cube, path=path, group=group)
                    cube = cubes.attach(cube, part, group)
            cube = _with_present_names(cube)
        except AmulorError:
            raise
        except Exception as error:  # h5py and what decodes the file raise many kinds
            raise _unreadable(path, error) from error
        if not {"row", "column"} <= set(cube.sizes):
            raise CubeError(
                f"{path}: is of level {cube.attrs.get('level')}, which has no rows and "
                "columns; name samples, a target signal or a range image"
            )
        yield CubeRows(cube, path, storage)


#: Variables by which the size of a file is judged.
_SIZED = ("in_phase", "slant_range")


def is_large(
    path: str | os.PathLike[str], *, variables: Sequence[str] = _SIZED
) -> bool:
    """Whether a cube file is so large that it is processed row by row."""
    load_hdf5()
    import h5py

    try:
        with h5py.File(path, "r") as storage:
            variables_stored = [storage[name] for name in variables if name in storage]
            return any(
                tiles.is_large(stored.size * stored.dtype.itemsize)
                for stored in variables_stored
            )
    except (OSError, RuntimeError, ValueError, KeyError, AttributeError):
        return False


def _check_digest(path: Path) -> None:
    """Raise if the bytes of a file differ from those that amulor wrote."""
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            start = file.read(len(SIGNATURE))
            file.seek(max(size - SEAL_LENGTH, 0))
            end = file.read()
            if start != SIGNATURE:
                # `read_cube` reports the error.
                read_cube(path)
            at = end.rfind(SEAL_START)
            if at < 0:
                check_heaps_of(path)
                return
            recorded = end[at + len(SEAL_START) :].strip().decode("ascii", "replace")
            file.seek(0)
            computed = _digest(file, size - len(end) + at)
    except OSError as error:
        raise FormatError(
            f"{path} cannot be read: {error.strerror or error}; check name and rights"
        ) from error
    if recorded != computed:
        raise FormatError(
            f"{path} is damaged: its bytes are not the ones that amulor wrote; copy it "
            "again, or make it again"
        )


def _digest(file: Any, length: int) -> str:
    """Digest of the first bytes of a file, as `cube.digest` computes it."""
    digest = hashlib.sha256()
    remaining = length
    while remaining > 0:
        piece = file.read(min(remaining, _PIECE))
        if not piece:
            break
        digest.update(piece)
        remaining -= len(piece)
    return f"sha256:{digest.hexdigest()}"


class RowWriter:
    """Writer of a cube file, row by row; created by `row_writer`."""

    def __init__(self, file: Any, rows: int, *, name: str, over: str = "row") -> None:
        self._file, self._rows, self._name, self._over = file, rows, name, over
        self._made: dict[str, dict[str, Any]] | None = None
        self._written = 0

    def put(self, tile: xr.Dataset, begin: int) -> None:
        """Write a tile that begins at row `begin`; tiles must be in order."""
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
            stored = self._made.get(key, {})
            if set(stored) != set(over):
                odd = ", ".join(sorted(set(stored) ^ set(over)))
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
                stored[name][place] = values.astype(np.int8) if kind == "b" else values
        self._written = end

    def end(self) -> None:
        """Raise if any rows of the file are missing."""
        if self._written != self._rows:
            raise CubeError(
                f"{self._name}: {self._written} of {self._rows} {self._over}s are "
                "written; write the others"
            )

    def _begun(self, key: str, part: xr.Dataset) -> dict[str, Any]:
        """Create a group in the file, and write its variables without row dimension."""
        _check_storable(part, name=self._name)
        group = self._file.create_group(key) if key else self._file
        sizes = dict(part.sizes)
        if self._over in sizes:
            sizes[self._over] = self._rows
        for dimension, size in sizes.items():
            group.dimensions[dimension] = size
        listed, attributes = _listing(part)
        arrays = {}
        for name, variable in part.variables.items():
            over = self._over in variable.dims
            shape = tuple(int(sizes[dimension]) for dimension in variable.dims)
            created = _create(
                group, str(name), variable, listed[name], shape=shape if over else None
            )
            if over:
                arrays[str(name)] = created
        _set_attributes(group, attributes)
        return arrays


@contextmanager
def row_writer(
    path: str | os.PathLike[str],
    rows: int,
    *,
    overwrite: bool = False,
    over: str = "row",
) -> Iterator[RowWriter]:
    """Write a cube file row by row; rename it to its final name when complete."""
    load_hdf5()
    import h5netcdf

    with atomic_output(path, overwrite=overwrite) as temporary:
        with h5netcdf.File(temporary, "w", libver=_LIBRARY_VERSION) as file:
            writer = RowWriter(file, rows, name=f"the cube for {path}", over=over)
            yield writer
            writer.end()
        with temporary.open("r+b") as file:
            digest = _digest(file, temporary.stat().st_size)
            file.seek(0, os.SEEK_END)
            file.write(SEAL_START + digest.encode() + b"\n")


def tile_rows(source: tiles.Source) -> int:
    """Rows per tile: whole storage blocks of the file, within the limits of memory."""
    first, end = next(tiles.bands(source))
    block = max(1, CHUNK_VALUES // max(source.columns, 1))
    rows = end - first
    return rows if rows < block else rows // block * block
