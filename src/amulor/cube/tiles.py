"""Tiles of rows of a cube: sources of rows, and assembly of tiles."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube.accessor import without_groups
from amulor.cube.schema import QualityFlag
from amulor.errors import AmulorError

__all__ = [
    "Changed",
    "Derived",
    "InMemory",
    "OfRows",
    "Source",
    "Span",
    "Whole",
    "bands",
    "directions_of",
    "fit_on_sample",
    "is_large",
    "sample_of",
    "span_of",
]

#: Bytes of one variable above which a scan is processed by rows; a step in one piece
#: takes up to 75 times as much. AMULOR_LARGE states another number.
LARGE = 2**24
#: Default number of samples of a variable that are processed at once; a step needs ten
#: to a hundred times as much memory.
SAMPLES_AT_ONCE = 2**18


def is_large(size: float) -> bool:
    """Return whether a scan is processed by rows, from a variable's size [bytes]."""
    limit = os.environ.get("AMULOR_LARGE", "").strip() or LARGE
    try:
        return size > float(limit)
    except ValueError:
        raise AmulorError(
            f"AMULOR_LARGE is {limit!r}; state the bytes of a variable above which a "
            "scan is processed by rows, such as 64e6"
        ) from None


Indices = NDArray[np.intp]
#: Function of rows of a scan and the number of the first row; returns rows of the
#: result.
OfRows = Callable[[xr.Dataset, int], xr.Dataset]


class Source(Protocol):
    """Object from which rows of a cube are read, in memory or in a file."""

    @property
    def head(self) -> xr.Dataset:
        """Variables and coordinates without row dimension, and the attributes."""
        ...

    @property
    def rows(self) -> int:
        """Number of rows."""
        ...

    @property
    def columns(self) -> int:
        """Number of columns."""
        ...

    def tile(self, begin: int, end: int) -> xr.Dataset:
        """Return the rows from `begin` to before `end`, and the variables of `head`."""
        ...

    def directions(self, begin: int, end: int) -> xr.Dataset:
        """Return azimuth and elevation of a range of rows."""
        ...


@dataclass(frozen=True)
class InMemory:
    """Rows of a cube in memory."""

    cube: xr.Dataset
    """Any cube over rows and columns."""

    @property
    def head(self) -> xr.Dataset:
        """Variables and coordinates without row dimension, and the attributes."""
        names = [name for name, v in self.cube.variables.items() if "row" in v.dims]
        return self.cube.drop_vars(names)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self.cube.sizes["row"])

    @property
    def columns(self) -> int:
        """Number of columns."""
        return int(self.cube.sizes["column"])

    def tile(self, begin: int, end: int) -> xr.Dataset:
        """Return the rows of a tile; the cube itself if the tile has all rows."""
        if begin == 0 and end >= self.rows:
            return self.cube
        return self.cube.isel(row=slice(begin, end))

    def directions(self, begin: int, end: int) -> xr.Dataset:
        """Return azimuth and elevation of the rows of a tile."""
        return directions_of(self.cube.isel(row=slice(begin, end)))


class Derived:
    """Base of row sources that process the rows of another source.

    Parameters
    ----------
    source : Source
        Source of the original rows.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self._head: xr.Dataset | None = None

    @property
    def head(self) -> xr.Dataset:
        """Variables and coordinates without row dimension, and the attributes."""
        if self._head is None:
            self._head = InMemory(self.tile(0, 1)).head
        return self._head

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self._source.rows

    @property
    def columns(self) -> int:
        """Number of columns."""
        return self._source.columns

    def tile(self, begin: int, end: int) -> xr.Dataset:
        """Compute the rows of a tile from the other source."""
        raise NotImplementedError

    def directions(self, begin: int, end: int) -> xr.Dataset:
        """Return azimuth and elevation of rows, as in the other source."""
        return self._source.directions(begin, end)


class Changed(Derived):
    """Row source that applies a function to tiles of another source.

    Parameters
    ----------
    source : Source
        Source of the original rows.
    change : callable
        Function from a cube to a cube with as many rows and columns, which needs no
        other rows.
    """

    def __init__(
        self, source: Source, change: Callable[[xr.Dataset], xr.Dataset]
    ) -> None:
        super().__init__(source)
        self._change = change

    def tile(self, begin: int, end: int) -> xr.Dataset:
        """Return the rows of a tile with the function applied."""
        return self._change(self._source.tile(begin, end))


def directions_of(cube: xr.Dataset) -> xr.Dataset:
    """Return azimuth and elevation of a cube, without its other variables.

    Parameters
    ----------
    cube : xarray.Dataset
        Any cube over rows and columns.

    Returns
    -------
    xarray.Dataset
        Dataset with the coordinates azimuth and elevation only.
    """
    names = ("azimuth", "elevation")
    return xr.Dataset(coords={name: cube.variables[name] for name in names})


def bands(source: Source, rows: int | None = None) -> Iterator[tuple[int, int]]:
    """Yield first row and end row of each tile of a source.

    Parameters
    ----------
    source : Source
        Source of the rows.
    rows : int, optional
        Rows of a tile; by default the rows with about `SAMPLES_AT_ONCE` samples.

    Yields
    ------
    tuple of int
        First row of a tile, and the row after its last.
    """
    if rows is None:
        rows = max(1, SAMPLES_AT_ONCE // max(samples_of_row(source), 1))
    for begin in range(0, source.rows, rows):
        yield begin, min(begin + rows, source.rows)


def samples_of_row(source: Source) -> int:
    """Return the number of samples in a row [1]."""
    sizes = source.head.sizes
    planes = sizes.get("modulation_frequency", 1) * sizes.get("polarization", 1)
    return int(source.columns * planes)


class Whole:
    """Cube assembled from tiles, in arrays that are allocated once.

    Parameters
    ----------
    rows, columns : int
        Numbers of rows and columns of the whole cube.
    """

    def __init__(self, rows: int, columns: int) -> None:
        self._sizes = {"row": rows, "column": columns}
        self._first: xr.Dataset | None = None
        self._arrays: dict[Any, np.ndarray[Any, Any]] = {}

    def put(self, tile: xr.Dataset, row: int, column: int = 0) -> None:
        """Copy a tile to its rows and columns in the assembled cube.

        Parameters
        ----------
        tile : xarray.Dataset
            Tile with the variables of the first tile. Variables without rows and
            columns are taken from the first tile.
        row, column : int
            First row and column of the tile in the whole cube.
        """
        begin = {"row": row, "column": column}
        if self._first is None:
            self._first = tile
            for name, variable in tile.variables.items():
                if set(self._sizes) & set(variable.dims):
                    shape = [
                        self._sizes.get(str(dimension), size)
                        for dimension, size in variable.sizes.items()
                    ]
                    self._arrays[name] = np.empty(shape, variable.dtype)
        for name, array in self._arrays.items():
            variable = tile.variables[name]
            place = tuple(
                slice(begin[str(dimension)], begin[str(dimension)] + size)
                if dimension in begin
                else slice(None)
                for dimension, size in variable.sizes.items()
            )
            array[place] = variable.values

    def made(self) -> xr.Dataset:
        """Return the assembled cube, with the attributes of its first tile."""
        assert self._first is not None
        first = self._first

        def variable(name: Any) -> xr.Variable:
            template = first.variables[name]
            if name not in self._arrays:
                return template
            return xr.Variable(template.dims, self._arrays[name], template.attrs)

        return xr.Dataset(
            {name: variable(name) for name in first.data_vars},
            {name: variable(name) for name in first.coords},
            first.attrs,
        )


#: Pixels of the sample on which a scan in tiles is judged.
SAMPLE = 2**16
#: Least number of adjacent rows and columns in a sample of a scan; noise is estimated
#: from neighbors.
_BAND = 8


def sample_of(source: Source) -> xr.Dataset:
    """Return evenly spaced bands of rows and columns of a scan, as a smaller cube.

    Parameters
    ----------
    source : Source
        Source of the rows.

    Returns
    -------
    xarray.Dataset
        Whole scan if it has at most `SAMPLE` pixels. Of a larger scan about as many
        pixels, in patches of at least `_BAND` rows and columns from all over the scan.
        A row and a column of missing samples separate neighboring patches, which are
        not neighbors in the scan.
    """
    rows, columns = source.rows, source.columns
    if rows * columns <= SAMPLE:
        return source.tile(0, rows)
    side = int(SAMPLE**0.5)
    wide = columns if rows > side and columns <= 4 * side else min(columns, side)
    across = _spread_bands(columns, wide)
    down = _spread_bands(rows, SAMPLE // wide)
    strips = [source.tile(begin, end).isel(column=across[0]) for begin, end in down[1]]
    cube = xr.concat(
        [_with_gap(strip) for strip in strips[:-1]] + strips[-1:],
        dim="row",
        data_vars="minimal",
        coords="minimal",
        compat="override",
        join="override",
        combine_attrs="override",
    )
    return _without(cube, column=across[2])


def _spread_bands(
    size: int, count: int
) -> tuple[Indices, list[tuple[int, int]], Indices]:
    """Return indices and limits of evenly spaced bands, and positions of separators."""
    if count >= size:
        return np.arange(size), [(0, size)], np.zeros(0, dtype=int)
    number = max(count // _BAND, 1)
    width = min(max(count // number, 1), size)
    begins = np.unique(np.linspace(0, size - width, number).astype(int))
    bands = [(int(begin), int(begin) + width) for begin in begins]
    # Bands that touch each other are one.
    joined = [bands[0]]
    for begin, end in bands[1:]:
        if begin <= joined[-1][1] + 1:
            joined[-1] = (joined[-1][0], end)
        else:
            joined.append((begin, end))
    index: list[int] = []
    gaps: list[int] = []
    for begin, end in joined:
        if index:
            gaps.append(len(index))
            index.append(begin)
        index += range(begin, end)
    return np.array(index), joined, np.array(gaps, dtype=int)


def _with_gap(strip: xr.Dataset) -> xr.Dataset:
    """Return rows followed by one row of missing samples."""
    last = strip.sizes["row"] - 1
    index = np.append(np.arange(last + 1), last)
    return _without(strip.isel(row=index), row=np.array([last + 1]))


def _without(cube: xr.Dataset, **places: Indices) -> xr.Dataset:
    """Return a cube with the samples of some rows or columns marked as missing."""
    ((dimension, place),) = places.items()
    if not len(place):
        return cube
    cube = cube.copy()
    for name in cube.data_vars:
        variable = cube[name].variable
        if dimension not in variable.dims:
            continue
        values = variable.values.copy()
        at = tuple(place if key == dimension else slice(None) for key in variable.dims)
        if values.dtype.kind == "f":
            values[at] = np.nan
        elif name == "quality_flag":
            values[at] = QualityFlag.MISSING
        cube[name] = variable.copy(data=values)
    return cube


@dataclass(frozen=True)
class Span:
    """Smallest and largest azimuth and elevation of a scan."""

    azimuth: tuple[float, float]
    """Smallest and largest azimuth [rad]."""
    elevation: tuple[float, float]
    """Smallest and largest elevation [rad]."""


def span_of(source: Source | xr.Dataset) -> Span:
    """Return the smallest and largest angles of a scan."""
    if isinstance(source, xr.Dataset):
        parts = [source]
    else:
        parts = [source.directions(begin, end) for begin, end in bands(source)]
    spans = []
    for name in ("azimuth", "elevation"):
        angles = [part[name].values for part in parts]
        spans.append(
            (
                min(float(np.min(angle)) for angle in angles),
                max(float(np.max(angle)) for angle in angles),
            )
        )
    return Span(*spans)


def fit_on_sample(
    step: Callable[..., tuple[xr.Dataset, Any]],
    source: Source,
    *,
    needs_span: bool = True,
    **options: Any,
) -> OfRows:
    """Fit a processing step to a sample of a scan; return the step for its rows.

    `step(cube, *, fit=None, span=None, **options)` returns its result and the
    statistics that it used: `fit`, or those of the cube if `fit` is None. `span` is the
    range of the directions, for which all rows are read; a step with `needs_span=False`
    has no such argument.
    """
    sample = without_groups(sample_of(source), "truth")
    spans = {"span": span_of(source)} if needs_span else {}
    _, fit = step(sample, **spans, **options)
    return lambda rows, first: step(rows, fit=fit, **options)[0]
