"""Settings of a product made from a range image, and their checks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from amulor import imaging, io
from amulor.errors import FormatError
from amulor.imaging import error_budget, products
from amulor.imaging.frame import Frame

Product = Literal[
    "cloud",
    "mesh",
    "orthoimage",
    "dem",
    "contours",
    "section",
    "profile",
    "deviation",
    "drawings",
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
    "contours": (".dxf", ".svg", ".pdf", ".csv"),
    "section": (".dxf", ".svg", ".pdf", ".csv"),
    "profile": (".dxf", ".svg", ".pdf", ".csv"),
    "deviation": (".csv", *_RASTERS, *_PICTURES, ".ply"),
    "drawings": (".pdf",),
}


@dataclass(frozen=True, kw_only=True)
class Order:
    """Settings of one product, such as a mesh or a drawing, of a range image."""

    product: Product
    """Kind of product."""
    side: Literal["front", "top"] = "front"
    """Side of view of a drawing."""
    show: Literal["amplitude", "height", "relief", "uncertainty"] = "amplitude"
    """Quantity of an orthoimage."""
    scale: float | None = None
    """Scale of a drawing: meters of the object in one meter of paper; by default the
    largest usual scale that fits a sheet of A4 [1]."""
    exaggeration: float = 1.0
    """Exaggeration of the heights of a section on paper [1]."""
    dots_per_inch: float = 300.0
    """Resolution of an orthoimage on paper [dots per inch]."""
    cell: float | None = None
    """Size of a raster cell. By default it is the size of a printed dot for an
    orthoimage, and about the spacing of the pixels otherwise [m]."""
    contours: float | None = None
    """Interval of contour lines [m]."""
    line: tuple[float, float, float, float] | None = None
    """Start and end of a section, right and up [m]."""
    against: Path | None = None
    """Mesh or range image that the scan is compared with."""
    unit: Unit = "m"
    """Unit of length in the mesh file."""
    farthest: float | None = None
    """Largest distance of a pixel from the reference; farther ones are ignored [m]."""
    slim: bool = False
    """Whether a LAS or LAZ file has fewer extra dimensions."""
    title: str = ""
    """Title of the drawing; by default that of the range image."""
    fields: Mapping[str, str] = field(default_factory=dict)
    """Texts of the title block, by field of `amulor.io.drawings.FIELDS`."""


def product_of(
    path: Path,
    *,
    line: object = None,
    against: object = None,
    contours: object = None,
) -> Product:
    """Return the kind of product that a file ending and the options imply."""
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
    endings_known = dict.fromkeys(e for endings in ENDINGS.values() for e in endings)
    raise FormatError(
        f"{path}: the ending says the format; use one of {', '.join(endings_known)}"
    )


def statements_of(image: xr.Dataset, frame: Frame) -> list[str]:
    """Return sentences on axes, uncertainty and processing for a product's file."""
    budget = error_budget(image)
    statements = [f"Axes: {frame.axes}"]
    if frame.name == "pose":
        numbers = ", ".join(f"{v:.6g}" for v in frame.position)
        statements.append(f"Instrument at ({numbers}) m; pose as stated")
    if frame.crs:
        offset = ", ".join(f"{v:.12g}" for v in frame.crs_offset)
        statements.append(f"Reference system: {frame.crs}; add ({offset}) m")
    if budget.error_unknown:
        statements.append(_sentence(budget.error_unknown))
    if math.isfinite(budget.combined):
        statements.append(
            "Uncertainties are standard uncertainties (GUM, k = 1); about 95 of 100 "
            "errors lie within twice as much. Slant range: median "
            f"{budget.combined * 1e3:.3g} mm, of which all pixels share "
            f"{budget.common * 1e3:.3g} mm"
        )
    unknown = [term.name.replace("_", " ") for term in budget.unknown]
    if frame.unknown:
        unknown += [f"{name} of the pose" for name in frame.unknown]
    unknown.append("directions of the beams, which count as known")
    if math.isfinite(budget.combined):
        statements.append(f"Not in them: {', '.join(unknown)}")
    geometry = image["geometry"].attrs
    index = float(geometry["group_index"])
    statements.append(f"Meters of water range by the group index {index:.4f}")
    if image.attrs.get("simulated"):
        statements.append("Simulated data; nothing here was measured")
    history = str(image.attrs.get("history", "")).splitlines()
    if history:
        statements.append(f"Last step: {history[-1]}")
    return statements


def _sentence(words: str) -> str:
    """Return a text with its first letter capitalized."""
    return words[0].upper() + words[1:]


def in_millimetres(values: ArrayLike) -> str:
    """Return the median of uncertainties [m] as text in millimeters."""
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    return f"{np.median(finite) * 1e3:.2g} mm (median)" if finite.size else "not known"


Floats = NDArray[np.float64]


def write_mesh(
    image: xr.Dataset,
    path: Path,
    surface: products.Surface,
    *,
    scalars: dict[str, tuple[Floats, str]] | None = None,
    overwrite: bool,
) -> None:
    """Write the surface of a range image as a mesh with vertex uncertainties."""
    chosen = imaging.leave_out(image, mixed=True)
    cloud = imaging.point_cloud(chosen, frame=surface.frame)
    io.write_ply(
        cloud, path, faces=surface.triangles, scalars=scalars, overwrite=overwrite
    )
