"""Drawing files for surveyors: GeoTIFF, DXF, SVG, PNG and CSV tables."""

from __future__ import annotations

__all__ = [
    "Band",
    "Drawing",
    "Line",
    "write_dxf",
    "write_geotiff",
    "write_picture",
    "write_svg",
    "write_table",
]

import os
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
class Drawing:
    """Line drawing: polylines with title, axis names and statements."""

    title: str
    """Title."""
    lines: tuple[Line, ...]
    """Polylines, at least one."""
    axes: tuple[str, str]
    """Names of the right and the up axis."""
    statements: tuple[str, ...] = ()
    """Statements about frame, errors and provenance."""

    @property
    def limits(self) -> tuple[float, float, float, float]:
        """Left, right, lower and upper bound of all lines [m]."""
        points = np.concatenate([line.points for line in self.lines])
        (left, low), (right, high) = points.min(axis=0), points.max(axis=0)
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


# Colors of Okabe and Ito, a layer each; sizes on paper [mm].
_SVG_COLOURS = ("#000000", "#0072B2", "#D55E00", "#009E73", "#CC79A7")
_MARGIN, _LETTERS, _THICK = 15.0, 2.6, 0.25
#: Letters of a line of statements: the width of a page [1].
_LINE = 105
#: Longest sheet that is still printed [mm].
_LONGEST = 5000.0


def write_svg(
    drawing: Drawing,
    path: str | os.PathLike[str],
    *,
    scale: float,
    overwrite: bool = False,
) -> None:
    """Write a line drawing to an SVG file, at its scale in millimeters on paper."""
    drawing = checked(drawing, name=str(path))
    left, right, low, high = drawing.limits
    to_paper = 1000.0 / scale
    notes = [
        line
        for statement in (
            f"{drawing.axes[0]} {left:.3f} to {right:.3f} m, "
            f"{drawing.axes[1]} {low:.3f} to {high:.3f} m",
            *drawing.statements,
        )
        for line in textwrap.wrap(statement, _LINE, subsequent_indent="\u2003")
    ]
    widest = max(map(len, (drawing.title, *notes))) * _LETTERS * 0.55
    bar = bar_length(right - left, scale)
    width = max((right - left) * to_paper, bar * to_paper, widest) + 2 * _MARGIN
    written = (4 + len(notes)) * 1.5 * _LETTERS
    height = (high - low) * to_paper + 2 * _MARGIN + written + 12
    if max(width, height) > _LONGEST:
        raise FormatError(
            f"{path}: at 1:{scale:g} the sheet would be {max(width, height) / 1e3:.1f} "
            f"m long; take a smaller scale, such as 1:{scale * 10:g}"
        )

    def placed(points: Floats) -> str:
        x = (points[:, 0] - left) * to_paper + _MARGIN
        y = (high - points[:, 1]) * to_paper + _MARGIN
        return " ".join(f"{a:.3f},{b:.3f}" for a, b in zip(x, y, strict=True))

    body = []
    for line in drawing.lines:
        outline = sides(line)
        if outline is not None:
            body.append(
                f'<polygon class="uncertainty" points="{placed(outline)}" '
                'fill="#56B4E9" fill-opacity="0.35" stroke="none"/>'
            )
    for number, layer in enumerate(drawing.layers):
        colour = _SVG_COLOURS[number % len(_SVG_COLOURS)]
        body.append(
            f'<g id="{escape(layer)}" fill="none" stroke="{colour}" '
            f'stroke-width="{_THICK}" stroke-linejoin="round">'
        )
        for line in (line for line in drawing.lines if line.layer == layer):
            title = f"<title>{escape(line.label)}</title>" if line.label else ""
            body.append(f'<polyline points="{placed(line.points)}">{title}</polyline>')
        body.append("</g>")
    below = (high - low) * to_paper + _MARGIN + 8
    body += _scale_bar(bar, to_paper, below, scale)
    body.append(_text(drawing.title, below + 12, bold=True))
    body += [
        _text(text, below + 12 + (number + 1) * 1.5 * _LETTERS)
        for number, text in enumerate(notes)
    ]
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        temporary.write_text(
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.3f}mm" '
            f'height="{height:.3f}mm" viewBox="0 0 {width:.3f} {height:.3f}" '
            'font-family="DejaVu Sans, Arial, sans-serif">\n'
            f"<title>{escape(drawing.title)}</title>\n"
            f'<rect width="100%" height="100%" fill="#ffffff"/>\n'
            + "\n".join(body)
            + "\n</svg>\n",
            encoding="utf-8",
        )


def bar_length(extent: float, scale: float) -> float:
    """Length of a scale bar, a round number that suits the drawing [m]."""
    longest = max(0.5 * extent, 0.02 * scale)
    power = 10.0 ** np.floor(np.log10(longest))
    fitting = [step * power for step in (1.0, 2.0, 5.0) if step * power <= longest]
    return float(fitting[-1])


def _scale_bar(length: float, to_paper: float, y: float, scale: float) -> list[str]:
    size = length * to_paper
    parts = [
        f'<rect x="{_MARGIN + n * size / 4:.3f}" y="{y:.3f}" width="{size / 4:.3f}" '
        f'height="1.6" fill="{"#000000" if n % 2 == 0 else "#ffffff"}" '
        f'stroke="#000000" stroke-width="0.15"/>'
        for n in range(4)
    ]
    label = f"{length * 1e3:g} mm" if length < 1 else f"{length:g} m"
    return [
        '<g id="scale-bar">',
        *parts,
        f'<text x="{_MARGIN:.3f}" y="{y + 5:.3f}" font-size="{_LETTERS}">0</text>',
        f'<text x="{_MARGIN + size:.3f}" y="{y + 5:.3f}" font-size="{_LETTERS}" '
        f'text-anchor="middle">{label}</text>',
        f'<text x="{_MARGIN + size / 2:.3f}" y="{y + 5:.3f}" font-size="{_LETTERS}" '
        f'text-anchor="middle">1:{scale:g}</text>',
        "</g>",
    ]


def _text(text: str, y: float, *, bold: bool = False) -> str:
    weight = ' font-weight="bold"' if bold else ""
    return (
        f'<text x="{_MARGIN}" y="{y:.3f}" font-size="{_LETTERS}"{weight}>'
        f"{escape(text)}</text>"
    )


#: Letters of labels and statements in the drawing [m].
_DXF_LETTERS = 0.002
#: Colors of layers by number, after the seven plain ones of the format.
_DXF_COLOURS = (7, 5, 1, 3, 6, 30, 4)
_METRES = 6


def write_dxf(
    drawing: Drawing, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a line drawing to a DXF file, in meters.

    The format is AutoCAD 2010, with light-weight polylines and a layer for each kind of
    line. The layer "uncertainty" has the outline of the band of two standard
    uncertainties. The layer "notes" has the statements as text below the drawing.
    """
    ezdxf = _ezdxf()
    drawing = checked(drawing, name=str(path))
    document = ezdxf.new("R2010", units=_METRES)
    document.header["$MEASUREMENT"] = 1
    names = (*drawing.layers, "uncertainty", "notes")
    for number, name in enumerate(names):
        document.layers.add(name, color=_DXF_COLOURS[number % len(_DXF_COLOURS)])
    space = document.modelspace()
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
            text = space.add_text(
                line.label, height=_DXF_LETTERS, dxfattribs={"layer": line.layer}
            )
            text.set_placement((float(middle[0]), float(middle[1])))
    left, _, low, _ = drawing.limits
    for number, statement in enumerate((drawing.title, *drawing.statements)):
        text = space.add_text(
            _one_line(statement), height=_DXF_LETTERS, dxfattribs={"layer": "notes"}
        )
        text.set_placement((left, low - (number + 3) * 1.6 * _DXF_LETTERS))
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        document.saveas(temporary)


def _one_line(text: str) -> str:
    return " ".join(text.split())


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
