"""The records of a scan for an E57 file: one for each pixel, in blocks of one size."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.errors import CubeError
from amulor.io._cloud import doubtful, in_blocks, provenance_lines

__all__ = ["BLOCK", "FIELDS", "Records"]

Arrays = dict[str, NDArray[Any]]

#: Fields of a record and their types. pye57 0.4.19 takes only every other half of the
#: integers that C calls long.
FIELDS: dict[str, type] = {
    "cartesianX": np.float64,
    "cartesianY": np.float64,
    "cartesianZ": np.float64,
    "intensity": np.float64,
    "rowIndex": np.longlong,
    "columnIndex": np.longlong,
    "cartesianInvalidState": np.int8,
}
#: Records that are handed over at once.
BLOCK = 2**18
# What `cartesianInvalidState` says of a pixel, after ASTM E2807.
_VALID, _DIRECTION_ONLY, _NOTHING_MEANT = 0, 1, 2


class Records:
    """The records of one scan, and what stands beside them in a file.

    Parameters
    ----------
    parts : callable
        Gives the parts of the cloud in the order of their rows, none empty, the same
        ones each time.
    shape : tuple of int
        Rows and columns of the scan [1].
    name : str
        How a message names the cloud.

    Raises
    ------
    CubeError
        If two points are in one pixel, a point is outside the scan, or parts are out of
        order.
    """

    def __init__(
        self,
        parts: Callable[[], Iterable[xr.Dataset]],
        shape: tuple[int, int],
        *,
        name: str,
    ) -> None:
        self._parts, self._shape, self._name = parts, shape, name
        ends: dict[str, tuple[float, float]] = {}
        digests = {key: hashlib.sha256() for key in FIELDS}
        first: xr.Dataset | None = None
        for part, records in self._pieces():
            if part is not None:
                first = part if first is None else first
                for axis in "xyz":
                    _widen(ends, axis, part[axis].values)
            for key, values in records.items():
                digests[key].update(values.tobytes())
                _widen(ends, key, values)
        assert first is not None
        #: A part of the cloud, for its attributes.
        self.first = first
        #: The matrix that takes the records into the frame of the cloud, if any.
        self.matrix = _in_the_instrument(first)[1]
        each = [found.hexdigest() for found in digests.values()]
        #: Of all that is written.
        self.digest = cubes.digest("\n".join([*provenance_lines(first), *each]))
        #: Smallest and largest value of each field, and of x, y and z of the points.
        self.ends = ends

    @property
    def count(self) -> int:
        """Number of records."""
        return self._shape[0] * self._shape[1]

    def blocks(self) -> Iterator[NDArray[np.void]]:
        """Yield the records in the order of the pixels, `BLOCK` at a time."""
        return in_blocks((_packed(found) for _, found in self._pieces()), BLOCK)

    def _pieces(self) -> Iterator[tuple[xr.Dataset | None, Arrays]]:
        """Yield parts of the cloud with the records of all rows up to their end."""
        rows, columns = self._shape
        done = 0
        for part in self._parts():
            row, last = int(part["row"].min()), int(part["row"].max())
            column = int(part["column"].max())
            if last >= rows or column >= columns:
                raise CubeError(
                    f"{self._name}: a point is in row {last} and one in column "
                    f"{column}, but the scan has {rows} rows and {columns} columns, "
                    "numbered from 0; give the shape of the scan that the cloud was "
                    "made from"
                )
            if row < done:
                raise CubeError(
                    f"{self._name}: a point of row {row} comes after those of row "
                    f"{done - 1}; give the parts in the order of their rows"
                )
            yield from self._without_points(done, row)
            yield part, self._of(part, (row, last + 1))
            done = last + 1
        yield from self._without_points(done, rows)

    def _without_points(self, begin: int, end: int) -> Iterator[tuple[None, Arrays]]:
        """Yield records of rows that hold no point, a few at a time."""
        columns = self._shape[1]
        few = max(1, BLOCK // columns)
        for first in range(begin, end, few):
            yield None, _empty((first, min(first + few, end)), columns)

    def _of(self, part: xr.Dataset, rows: tuple[int, int]) -> Arrays:
        """Return the records of rows with points."""
        part, _ = _in_the_instrument(part)
        columns = self._shape[1]
        row = part["row"].values.astype(np.int64) - rows[0]
        pixel = row * columns + part["column"].values.astype(np.int64)
        if np.unique(pixel).size < pixel.size:
            raise CubeError(
                f"{self._name}: a pixel of the scan has two points, an E57 scan has "
                "room for one; write each scan to its own file"
            )
        records = _empty(rows, columns)
        for key, variable in zip(FIELDS, ("x", "y", "z", "intensity"), strict=False):
            records[key][pixel] = part[variable].values
        state = np.where(doubtful(part), _DIRECTION_ONLY, _VALID)
        records["cartesianInvalidState"][pixel] = state
        return records


def _empty(rows: tuple[int, int], columns: int) -> Arrays:
    """Return the records of rows without a point."""
    pixels = np.arange(rows[0] * columns, rows[1] * columns)
    records: Arrays = {
        key: np.zeros(pixels.size, dtype=kind) for key, kind in FIELDS.items()
    }
    records["rowIndex"][:] = pixels // columns
    records["columnIndex"][:] = pixels % columns
    records["cartesianInvalidState"][:] = _NOTHING_MEANT
    return records


def _packed(records: Mapping[str, NDArray[Any]]) -> NDArray[np.void]:
    """Return records as one array."""
    packed = np.empty(len(records["intensity"]), dtype=list(FIELDS.items()))
    for key, values in records.items():
        packed[key] = values
    return packed


def _widen(
    ends: dict[str, tuple[float, float]], key: str, values: NDArray[Any]
) -> None:
    low, high = ends.get(key, (math.inf, -math.inf))
    ends[key] = min(low, values.min().item()), max(high, values.max().item())


def _in_the_instrument(
    cloud: xr.Dataset,
) -> tuple[xr.Dataset, NDArray[np.float64] | None]:
    """Return the cloud in the instrument's axes, and the matrix that takes it back."""
    if cloud.attrs.get("frame", "instrument") == "instrument":
        return cloud, None
    matrix = np.asarray(cloud.attrs["frame_matrix"], dtype=float).reshape(4, 4)
    away = [cloud[axis].values - matrix[k, 3] for k, axis in enumerate("xyz")]
    # Not by a product of matrices, whose sums depend on how many points there are.
    own = [
        away[0] * matrix[0, k] + away[1] * matrix[1, k] + away[2] * matrix[2, k]
        for k in range(3)
    ]
    return (
        cloud.assign(
            {axis: cloud[axis].copy(data=own[k]) for k, axis in enumerate("xyz")}
        ),
        matrix,
    )
