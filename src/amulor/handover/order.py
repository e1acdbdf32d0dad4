"""What is to be made of a range image, checked before the work."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from amulor import io
from amulor.errors import FormatError

Product = Literal[
    "cloud", "mesh", "orthoimage", "dem", "contours", "section", "deviation"
]
Unit = Literal["m", "cm", "mm", "inch"]

_PICTURES = (".png", ".pdf", ".svg")
_RASTERS = (".tif", ".tiff")
#: Endings of the files that each product is written to.
ENDINGS: dict[Product, tuple[str, ...]] = {
    "cloud": (*io.CLOUD_SUFFIXES, ".nc"),
    "mesh": (".ply",),
    "orthoimage": (*_PICTURES, *_RASTERS),
    "dem": (*_RASTERS, ".pdf", ".svg"),
    "contours": (".dxf", ".svg", ".csv"),
    "section": (".dxf", ".svg", ".csv"),
    "deviation": (".csv", *_RASTERS, *_PICTURES, ".ply"),
}


@dataclass(frozen=True, kw_only=True)
class Order:
    """A product of a range image."""

    product: Product
    """Which one."""
    side: Literal["front", "top"] = "front"
    """From where a drawing is seen."""
    show: Literal["amplitude", "height", "relief", "uncertainty"] = "amplitude"
    """What an orthoimage shows."""
    scale: float = 10.0
    """Metres of the object to one of the paper [1]."""
    dots_per_inch: float = 300.0
    """Dots of an orthoimage on paper."""
    cell: float | None = None
    """Size of a cell of a raster; by default that of a dot of an orthoimage, and the
    spacing of the pixels otherwise [m]."""
    contours: float | None = None
    """Interval of contour lines [m]."""
    line: tuple[float, float, float, float] | None = None
    """Start and end of a section, right and up [m]."""
    against: Path | None = None
    """Mesh or range image that a scan is compared with."""
    unit: Unit = "m"
    """Unit of that mesh."""
    farthest: float | None = None
    """Largest deviation that is one [m]."""
    title: str = ""
    """What is drawn; the title of the range image by default."""


def product_of(
    path: Path,
    *,
    line: object = None,
    against: object = None,
    contours: object = None,
) -> Product:
    """Return the product that a file name and what else is stated mean.

    Parameters
    ----------
    path : pathlib.Path
        File to be written.
    line, against, contours : object, optional
        Whether a section, a comparison or contour lines are asked for.

    Returns
    -------
    str
        A key of `ENDINGS`.

    Raises
    ------
    FormatError
        If the ending names none.
    """
    ending = path.suffix.lower()
    if line is not None:
        return "section"
    if against is not None:
        return "deviation"
    if ending in ENDINGS["cloud"] and not (contours is not None and ending == ".csv"):
        return "cloud"
    if ending in _RASTERS:
        return "dem"
    if ending == ".dxf" or (ending == ".csv" and contours is not None):
        return "contours"
    if ending in _PICTURES:
        return "orthoimage"
    known = dict.fromkeys(e for endings in ENDINGS.values() for e in endings)
    raise FormatError(
        f"{path}: the ending says the format; use one of {', '.join(known)}"
    )
