"""Range images as the page reads them: map by map, beam by beam, a few pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import error_unknown
from amulor.view.page import beams


class Picture(Protocol):
    """A range image that is read map by map."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes of the image."""

    @property
    def geometry(self) -> dict[str, Any]:
        """Attributes of its geometry."""

    @property
    def error_unknown(self) -> str:
        """Why its ranges state no error; empty if they do."""

    def has(self, variable: str) -> bool:
        """Return whether there is a variable."""

    def values(self, variable: str, stride: int) -> NDArray[Any]:
        """Return every so many rows and columns of a variable."""

    def beams(self) -> beams.BeamReader:
        """Return what reads the beams."""

    def around(self, rows: list[int], columns: list[int]) -> xr.Dataset:
        """Return an image that holds some pixels, and the scan they belong to."""

    def place(self, row: int, column: int) -> tuple[int, int]:
        """Return where a pixel of the scan is in the image of `around`."""

    def whole(self) -> xr.Dataset:
        """Return the image, or raise `CubeError` if it is too large for that."""


@dataclass(frozen=True)
class MemoryPicture:
    """A range image in memory."""

    image: xr.Dataset
    """Level `range_image`."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.image["slant_range"].shape
        return rows, columns

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes of the image."""
        return {str(key): value for key, value in self.image.attrs.items()}

    @property
    def geometry(self) -> dict[str, Any]:
        """Attributes of its geometry."""
        return dict(self.image["geometry"].attrs)

    @property
    def error_unknown(self) -> str:
        """Why its ranges state no error; empty if they do."""
        return error_unknown(self.image)

    def has(self, variable: str) -> bool:
        """Return whether there is a variable."""
        return variable in self.image

    def values(self, variable: str, stride: int) -> NDArray[Any]:
        """Return every so many rows and columns of a variable."""
        return np.asarray(self.image[variable].values[::stride, ::stride])

    def beams(self) -> beams.BeamReader:
        """Return what reads the beams."""
        return beams.reader_of(self.image)

    def around(self, rows: list[int], columns: list[int]) -> xr.Dataset:
        """Return the whole image."""
        return self.image

    def place(self, row: int, column: int) -> tuple[int, int]:
        """Return the pixel itself."""
        return row, column

    def whole(self) -> xr.Dataset:
        """Return the image."""
        return self.image


@dataclass(frozen=True, kw_only=True)
class Channel:
    """The pictures of one channel."""

    after: Picture | None
    """Water taken out, if it was."""
    before: Picture | None
    """Water left in, if it is known."""

    @property
    def shown(self) -> Picture:
        """The picture that measuring takes: the corrected one where there is one."""
        picture = self.after or self.before
        assert picture is not None
        return picture
