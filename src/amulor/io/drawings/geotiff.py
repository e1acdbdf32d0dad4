"""Writes rasters as GeoTIFF: bands of floats in a local or a stated frame."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from amulor.errors import FormatError, MissingExtraError
from amulor.io.files import atomic_output
from amulor.survey.reference_system import projected_code

Floats = NDArray[np.float64]

# Tags and keys of OGC GeoTIFF 1.1.
_SCALE, _TIE, _KEYS, _TEXTS = 33550, 33922, 34735, 34737
_GDAL_METADATA, _GDAL_NODATA = 42112, 42113
_MODEL_TYPE, _RASTER_TYPE, _CITATION = 1024, 1025, 1026
_PROJECTED, _LINEAR_UNIT, _METRE = 3072, 3076, 9001
_IS_PROJECTED, _IS_AREA, _USER_DEFINED = 1, 1, 32767


@dataclass(frozen=True, kw_only=True)
class Band:
    """One layer of a raster."""

    name: str
    """What it is, with its unit."""
    unit: str
    """Such as "m"."""
    values: Floats
    """Shape (rows, columns), the first row the upper one; not a number for none."""


def write_geotiff(
    bands: Sequence[Band],
    path: str | os.PathLike[str],
    *,
    cell: float,
    left: float,
    top: float,
    crs: str = "",
    offset: tuple[float, float] = (0.0, 0.0),
    statements: Sequence[str] = (),
    overwrite: bool = False,
) -> None:
    """Write bands of one size to a GeoTIFF file.

    Parameters
    ----------
    bands : sequence of Band
        At least one.
    path : path-like
        File to make.
    cell : float
        Size of a cell [m].
    left, top : float
        Coordinates of the left and the upper edge [m].
    crs : str
        Reference system: "EPSG:" and a number of a projected one in metres. Any other
        text is written as a citation of a local frame.
    offset : tuple of float
        What is added to the edges where the system is one of EPSG [m].
    statements : sequence of str
        What is to be said of it, for the description.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    FormatError
        If the file exists and `overwrite` is not set, or cannot be written, or the
        reference system is not a projected one in metres.
    MissingExtraError
        If tifffile is not installed, or pyproj where there is a number of EPSG.

    Notes
    -----
    Single precision, which holds a metre to 60 nm; deflate; not a number is no data.
    Bands lie one after the other, with their names and units as GDAL reads them.
    """
    tifffile = _tifffile()
    values = np.stack([band.values for band in bands]).astype(np.float32)
    if values.ndim != 3 or not values.shape[0]:
        raise FormatError(f"{path}: bands must be rasters of rows and columns")
    try:
        code = projected_code(crs)
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from None
    shift = offset if code else (0.0, 0.0)
    tie = (0.0, 0.0, 0.0, left + shift[0], top + shift[1], 0.0)
    text = (crs or "local frame of the instrument, see description") + "|"
    citation = text.encode("ascii", "replace").decode()
    keys = [
        (_MODEL_TYPE, 0, 1, _IS_PROJECTED if code else _USER_DEFINED),
        (_RASTER_TYPE, 0, 1, _IS_AREA),
        (_CITATION, _TEXTS, len(citation), 0),
    ]
    if code:
        keys.append((_PROJECTED, 0, 1, code))
    keys.append((_LINEAR_UNIT, 0, 1, _METRE))
    directory = [1, 1, 1, len(keys)] + [number for key in keys for number in key]
    tags = [
        (_SCALE, "d", 3, (cell, cell, 0.0), True),
        (_TIE, "d", 6, tie, True),
        (_KEYS, "H", len(directory), tuple(directory), True),
        (_TEXTS, "s", len(citation) + 1, citation, True),
        (_GDAL_NODATA, "s", 4, "nan", True),
    ]
    metadata = _metadata(bands)
    tags.append((_GDAL_METADATA, "s", len(metadata) + 1, metadata, True))
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        tifffile.imwrite(
            temporary,
            values if len(values) > 1 else values[0],
            photometric="minisblack",
            planarconfig="separate" if len(values) > 1 else None,
            compression="zlib",
            description="\n".join(statements).encode("ascii", "replace").decode(),
            software="amulor",
            metadata=None,
            extratags=tags,
        )


def _metadata(bands: Sequence[Band]) -> str:
    """Return names and units of the bands in the XML that GDAL reads."""
    items = []
    for number, band in enumerate(bands):
        for key, role, text in (
            ("DESCRIPTION", "description", band.name),
            ("UNITTYPE", "unittype", band.unit),
        ):
            items.append(
                f'<Item name="{key}" sample="{number}" role={quoteattr(role)}>'
                f"{escape(text)}</Item>"
            )
    text = f"<GDALMetadata>{''.join(items)}</GDALMetadata>"
    return text.encode("ascii", "xmlcharrefreplace").decode()


def _tifffile() -> Any:
    try:
        import tifffile
    except ImportError as error:
        raise MissingExtraError(
            "tifffile", extra="export", purpose="writing GeoTIFF files"
        ) from error
    return tifffile
