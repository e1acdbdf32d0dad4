"""Drawing files for surveyors: GeoTIFF, DXF, SVG, PNG and CSV tables."""

from __future__ import annotations

__all__ = [
    "Band",
    "Drawing",
    "Line",
    "TitleBlock",
    "write_dxf",
    "write_geotiff",
    "write_picture",
    "write_table",
]

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.errors import FormatError, MissingExtraError
from amulor.io.files import atomic_output
from amulor.survey.scan import projected_code

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Line:
    """Polyline of a drawing, with layer, label and uncertainty band."""

    points: Floats
    """Coordinates to the right and upwards on the sheet, shape (n, 2) [m]."""
    layer: str
    """Layer name, such as "contours"."""
    label: str = ""
    """Text beside the line, such as its height."""
    elevation: float = 0.0
    """Height above the drawing plane [m]."""
    band: Floats | None = None
    """Standard uncertainty across the line at its points; None draws no band. The band
    extends two standard uncertainties to either side; shape (n,) [m]."""


@dataclass(frozen=True, kw_only=True)
class TitleBlock:
    """Texts around a drawing: title, statements, and fields of the title block."""

    title: str
    """Title."""
    statements: tuple[str, ...] = ()
    """Statements about frame, errors and provenance."""
    fields: Mapping[str, str] = field(default_factory=dict)
    """Texts by field; missing fields stay blank for a pen."""


#: Fields of a title block, in the order of their cells: two rows of four.
FIELDS = (
    "project",
    "object",
    "find number",
    "sheet",
    "author",
    "institution",
    "date",
    "view",
)


@dataclass(frozen=True, kw_only=True)
class Drawing(TitleBlock):
    """Line drawing: polylines with axis names and title block."""

    lines: tuple[Line, ...]
    """Polylines, at least one."""
    axes: tuple[str, str]
    """Names of the right and the up axis."""
    marks: tuple[tuple[float, str], ...] = ()
    """Places along the right axis with names above the frame, such as "A" at the start
    of a section [m]."""

    @property
    def limits(self) -> tuple[float, float, float, float]:
        """Left, right, lower and upper bound of all lines and marks [m]."""
        points = np.concatenate([line.points for line in self.lines])
        (left, low), (right, high) = points.min(axis=0), points.max(axis=0)
        places = [place for place, _ in self.marks]
        left, right = min([left, *places]), max([right, *places])
        return float(left), float(right), float(low), float(high)

    @property
    def layers(self) -> tuple[str, ...]:
        """Layer names in the order of the lines."""
        return tuple(dict.fromkeys(line.layer for line in self.lines))


def checked(drawing: Drawing, *, name: str) -> Drawing:
    """Return a drawing; raise if it has no lines or a point is not finite."""
    if not drawing.lines:
        raise FormatError(f"{name}: there is no line to draw")
    for line in drawing.lines:
        if not np.isfinite(line.points).all():
            raise FormatError(f"{name}: a line of layer {line.layer} is not finite")
    return drawing


def sides(line: Line) -> Floats | None:
    """Return the outline of a line's band, two standard uncertainties on each side."""
    if line.band is None or len(line.points) < 2:
        return None
    step = np.gradient(line.points, axis=0)
    length = np.linalg.norm(step, axis=1, keepdims=True)
    unit = step / np.where(length > 0, length, 1.0)
    across = np.stack([-unit[:, 1], unit[:, 0]], axis=1) * 2 * line.band[:, None]
    return np.concatenate([line.points + across, (line.points - across)[::-1]])


def rounded_up(value: float) -> float:
    """Smallest number of the series 1, 2, 5, 10, 20, ... not below a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(s * power for s in (1, 2, 5, 10) if s * power >= value * 0.999))


def grid_step(low: float, high: float, scale: float) -> float:
    """Grid spacing of a drawing [m]: 20 to 50 mm on paper, 8 or 4 mm and more if small.

    Where larger steps give fewer than two places, 4 to 10 mm are taken.
    """
    step = rounded_up(0.02 * scale)
    if high - low >= 4 * step:
        return step
    step = rounded_up(0.008 * scale)
    few = len(places_between(low, high, step)) < 2
    return rounded_up(0.004 * scale) if few else step


def places_between(low: float, high: float, step: float) -> Floats:
    """Multiples of a step between two bounds [m]."""
    count = np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1)
    return np.asarray(np.round(step * count, 9))


#: Height of letters on paper [m].
_DXF_LETTERS = 0.002
#: Colors of layers by number, after the seven plain ones of the format.
_DXF_COLOURS = (7, 5, 1, 3, 6, 30, 4)
_METRES = 6


def write_dxf(
    drawing: Drawing,
    path: str | os.PathLike[str],
    *,
    scale: float = 1.0,
    overwrite: bool = False,
) -> None:
    """Write a line drawing to a DXF file, in meters.

    The format is AutoCAD 2010, with light-weight polylines and a layer for each kind of
    line. The layer "uncertainty" has the outline of the band of two standard
    uncertainties, the layer "axes" a frame with coordinates and the names of places,
    and the layer "notes" the statements as text below the drawing. The title block is a
    block reference with an attribute for each field, blank if it has no text.

    Parameters
    ----------
    drawing : Drawing
        Lines, statements and fields of the title block.
    path : path-like
        File to write.
    scale : float
        Scale denominator for which letters are 2 mm high on paper [1].
    overwrite : bool
        Replace an existing file.

    Raises
    ------
    FormatError
        If there is no line, or a point is not finite.
    MissingExtraError
        If ezdxf is not installed.
    """
    ezdxf = _ezdxf()
    drawing = checked(drawing, name=str(path))
    document = ezdxf.new("R2010", units=_METRES)
    document.header["$MEASUREMENT"] = 1
    names = (*drawing.layers, "uncertainty", "axes", "notes")
    for number, name in enumerate(names):
        document.layers.add(name, color=_DXF_COLOURS[number % len(_DXF_COLOURS)])
    space = document.modelspace()
    letters = _DXF_LETTERS * scale

    def write(text: str, place: tuple[float, float], layer: str) -> None:
        entity = space.add_text(
            " ".join(text.split()), height=letters, dxfattribs={"layer": layer}
        )
        entity.set_placement(place)

    for line in drawing.lines:
        space.add_lwpolyline(
            np.asarray(line.points, dtype=float).tolist(),
            dxfattribs={"layer": line.layer, "elevation": line.elevation},
        )
        outline = sides(line)
        if outline is not None:
            space.add_lwpolyline(
                outline.tolist(), close=True, dxfattribs={"layer": "uncertainty"}
            )
        if line.label:
            middle = line.points[len(line.points) // 2]
            write(line.label, (float(middle[0]), float(middle[1])), line.layer)
    bottom = _frame(space, drawing, scale, write)
    left = drawing.limits[0]
    for number, statement in enumerate((drawing.title, *drawing.statements)):
        write(statement, (left, bottom - (number + 2) * 1.6 * letters), "notes")
    place = left, bottom - (len(drawing.statements) + 4) * 1.6 * letters
    fields = (
        dict.fromkeys(FIELDS, "") | dict(drawing.fields) | {"scale": f"1:{scale:g}"}
    )
    _title_block(document, fields, place, letters)
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        document.saveas(temporary)


def _frame(
    space: Any,
    drawing: Drawing,
    scale: float,
    write: Callable[[str, tuple[float, float], str], None],
) -> float:
    """Draw a coordinate frame and named points; return the frame's lower edge [m]."""
    letters = _DXF_LETTERS * scale
    left, right, low, high = drawing.limits
    low, high = low - 2 * letters, high + 2 * letters
    layer = {"layer": "axes"}
    corners = [(left, low), (right, low), (right, high), (left, high)]
    space.add_lwpolyline(corners, close=True, dxfattribs=layer)
    for place in places_between(left, right, grid_step(left, right, scale)):
        space.add_line((place, low), (place, low - letters / 2), dxfattribs=layer)
        write(f"{place + 0.0:g}", (float(place), low - 1.8 * letters), "axes")
    for place in places_between(low, high, grid_step(low, high, scale)):
        space.add_line((left, place), (left - letters / 2, place), dxfattribs=layer)
        write(f"{place + 0.0:g}", (left - 5 * letters, float(place)), "axes")
    write(f"{drawing.axes[0]} [m]", (left, low - 3.4 * letters), "axes")
    write(f"{drawing.axes[1]} [m]", (left - 5 * letters, high + 2.6 * letters), "axes")
    for place, name in drawing.marks:
        write(name, (place, high + letters), "axes")
    return low - 4 * letters


def _title_block(
    document: Any, fields: Mapping[str, str], place: tuple[float, float], letters: float
) -> None:
    """Insert a title block, a line for each field, at a place below the drawing."""
    block = document.blocks.new(name="TITLE_BLOCK")
    for number, name in enumerate(fields):
        y = -1.6 * letters * number
        caption = block.add_text(name, height=letters)
        caption.set_placement((0, y))
        block.add_attdef(
            name.upper().replace(" ", "_"), (12 * letters, y), height=letters
        )
    inserted = document.modelspace().add_blockref(
        "TITLE_BLOCK", place, dxfattribs={"layer": "notes"}
    )
    inserted.add_auto_attribs(
        {name.upper().replace(" ", "_"): text for name, text in fields.items()}
    )


def _ezdxf() -> Any:
    try:
        import ezdxf
    except ImportError as error:
        raise MissingExtraError(
            "ezdxf", extra="export", purpose="writing DXF files"
        ) from error
    return ezdxf


# Tags and keys of OGC GeoTIFF 1.1.
_SCALE, _TIE, _KEYS, _TEXTS = 33550, 33922, 34735, 34737
_GDAL_METADATA, _GDAL_NODATA = 42112, 42113
_MODEL_TYPE, _RASTER_TYPE, _CITATION = 1024, 1025, 1026
_PROJECTED, _LINEAR_UNIT, _METRE = 3072, 3076, 9001
_IS_PROJECTED, _IS_AREA, _USER_DEFINED = 1, 1, 32767


@dataclass(frozen=True, kw_only=True)
class Band:
    """Band of a GeoTIFF file: one quantity over the raster."""

    name: str
    """Quantity with its unit."""
    unit: str
    """Unit, such as "m"."""
    values: Floats
    """Values, upper row first, NaN without data, shape (rows, columns)."""


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
    """Write raster bands of equal size to a GeoTIFF file.

    Values have single precision (60 nm at one meter) and are compressed by deflate. NaN
    marks missing data. Bands are stored one after the other, with names and units in
    the form of GDAL.
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
    """Names and units of the bands, in the XML metadata format of GDAL."""
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


def write_picture(
    pixels: NDArray[np.uint8],
    path: str | os.PathLike[str],
    *,
    dots_per_metre: float,
    texts: Mapping[str, str],
    overwrite: bool = False,
) -> None:
    """Write a picture to a PNG file with its resolution and text fields."""
    from PIL import Image, PngImagePlugin

    described = PngImagePlugin.PngInfo()
    for key, text in texts.items():
        described.add_itxt(key, text)
    density = round(dots_per_metre) * 0.0254  # dots per inch, whole ones per meter
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        Image.fromarray(pixels).save(
            temporary, format="PNG", dpi=(density, density), pnginfo=described
        )


def write_table(
    columns: Mapping[str, ArrayLike],
    path: str | os.PathLike[str],
    *,
    statements: Sequence[str] = (),
    overwrite: bool = False,
) -> None:
    """Write columns of numbers to a CSV file."""
    arrays = {name: np.asarray(values) for name, values in columns.items()}
    texts = []
    for values in arrays.values():
        if values.dtype.kind in "iub":
            texts.append([str(int(value)) for value in values])
        else:
            texts.append(["" if np.isnan(v) else f"{v:.7g}" for v in values])
    with (
        atomic_output(Path(path), overwrite=overwrite) as temporary,
        temporary.open("w", encoding="utf-8", newline="\n") as file,
    ):
        file.writelines(f"# {' '.join(text.split())}\n" for text in statements)
        file.write(",".join(arrays) + "\n")
        file.writelines(",".join(row) + "\n" for row in zip(*texts, strict=True))
