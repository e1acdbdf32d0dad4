"""Drawing set of one object: elevation, section, half-profile and deviation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import NDArray

from amulor._progress import tell
from amulor.errors import CubeError
from amulor.handover import drawings, references
from amulor.handover.drawings import LineProduct, Said
from amulor.handover.order import Order
from amulor.imaging import products
from amulor.imaging.measure import Revolution
from amulor.io import drawings as formats
from amulor.io.files import check_output
from amulor.view.sheet import fitting_scale, sheet

Floats = NDArray[np.float64]

#: Contour lines of an elevation, about [1].
_LEVELS = 8
#: Part of the cells that the choice of a contour interval leaves out on a side [%].
_STRAY = 1.0
#: Corners of each circle of a body of revolution [1].
_AROUND = 360
#: Part by which a section line exceeds the object at both ends [1].
_BEYOND = 0.02


@dataclass(frozen=True, kw_only=True)
class Page:
    """Sheet of a drawing set."""

    figure: Figure
    """Drawing with title block."""
    block: formats.TitleBlock
    """Texts of the title block."""
    summary: str
    """Result in one sentence."""
    lines: LineProduct | None = None
    """Lines for a DXF file; None for maps."""


def write_set(
    image: xr.Dataset,
    surface: products.Surface,
    path: Path,
    order: Order,
    remarks: Said,
    *,
    overwrite: bool,
) -> str:
    """Write all sheets to one PDF file, each sheet to SVG, and lines to DXF."""
    plane = products.plane_of(surface.frame, order.side)
    body, reason = _body_of(image)
    order = replace(order, scale=_scale_of(order, surface, plane, body))
    line = order.line or middle_line(surface, plane)
    makers: dict[str, Callable[[Order], Page]] = {
        "elevation" if order.side == "front" else "plan": lambda chosen: _elevation(
            image, surface, plane, chosen, remarks
        ),
        "section": lambda chosen: lines_page(
            drawings.section(surface, plane, replace(chosen, line=line), remarks)
        ),
    }
    if body is not None:
        makers["profile"] = lambda chosen: lines_page(
            drawings.profile(image, chosen, remarks, body=body)
        )
    if order.against is not None or body is not None:
        makers["deviation"] = lambda chosen: _deviation(
            image, surface, chosen, remarks, body
        )
    check_files(path, makers, overwrite=overwrite)
    pages = {}
    for number, (name, make) in enumerate(makers.items()):
        tell("drawing", 0.2 + 0.6 * number / len(makers))
        numbered = {"sheet": f"{number + 1} of {len(makers)}"} | dict(order.fields)
        pages[name] = make(replace(order, fields=numbered))
    sentences = [f"{len(pages)} sheets at 1:{order.scale:g}"]
    sentences += write_pages(pages, path, remarks[0], overwrite=overwrite)
    if body is None:
        sentences.append(f"  no half-profile: {reason}")
    return "\n".join(sentences)


def check_files(path: Path, names: Iterable[str], *, overwrite: bool) -> None:
    """Raise if a file of `write_pages` exists and may not be replaced."""
    files = [_file_of(path, name) for name in names]
    for file in (path, *files, *(file.with_suffix(".dxf") for file in files)):
        check_output(file, overwrite=overwrite)


def write_pages(
    pages: Mapping[str, Page], path: Path, title: str, *, overwrite: bool
) -> list[str]:
    """Write pages to one PDF file, each to SVG, lines to DXF; describe each page."""
    drawings.save_pages(
        [page.figure for page in pages.values()],
        path,
        replace(next(iter(pages.values())).block, title=title),
        overwrite=overwrite,
    )
    sentences = []
    for name, page in pages.items():
        file = _file_of(path, name)
        drawings.save_sheet(page.figure, file, page.block, overwrite=overwrite)
        written = [file.name]
        if page.lines is not None:
            drawing = file.with_suffix(".dxf")
            page.lines.write(drawing, overwrite=overwrite)
            written.append(drawing.name)
        sentences.append(f"  {', '.join(written)}: {page.summary}")
    return sentences


def _file_of(path: Path, name: str) -> Path:
    """Return the SVG file of a page beside the PDF file of the set."""
    return path.with_name(f"{path.stem}_{name}.svg")


def middle_line(
    surface: products.Surface, plane: products.Plane
) -> tuple[float, float, float, float]:
    """Return a section line through a surface's middle, along its longer side [m]."""
    flat = surface.position[np.unique(surface.triangles)] @ plane.axes[:2].T
    low, high = flat.min(axis=0), flat.max(axis=0)
    middle = np.median(flat, axis=0)
    along = int(np.argmax(high - low))
    beyond = _BEYOND * (high - low)[along]
    ends = np.stack([middle, middle])
    ends[:, along] = low[along] - beyond, high[along] + beyond
    # Millimeters, so that the statement on the sheet is the line that was cut.
    right, up, end_right, end_up = np.round(ends.ravel(), 3).tolist()
    return right, up, end_right, end_up


def _body_of(image: xr.Dataset) -> tuple[Revolution | None, str]:
    """Fit a surface of revolution; None and the reason if it fails or is doubtful."""
    try:
        body = drawings.turned_body(image)
    except CubeError as error:
        return None, str(error)
    return (None, body.fit.doubt) if body.fit.doubt else (body, "")


def _scale_of(
    order: Order,
    surface: products.Surface,
    plane: products.Plane,
    body: Revolution | None,
) -> float:
    """Return the scale denominator common to all sheets [1]."""
    scale = drawings.scale_of(order, surface, plane)
    if order.scale is not None or body is None:
        return scale
    size = 2 * float(body.radius.max()), float(np.ptp(body.height))
    return max(scale, fitting_scale(*size))


def _elevation(
    image: xr.Dataset,
    surface: products.Surface,
    plane: products.Plane,
    order: Order,
    remarks: Said,
) -> Page:
    """Draw the shaded relief of a surface, with contour lines."""
    scale = drawings.scale_of(order, surface, plane)
    drawn = replace(order, product="orthoimage")
    raster = drawings.flagged_raster(image, surface, plane, drawn, scale)
    # Contours of cells as large as the pixels: finer ones would follow the noise.
    coarse_order = replace(order, product="contours")
    coarse = drawings.flagged_raster(image, surface, plane, coarse_order, scale)
    interval = order.contours or contour_interval(coarse)
    warning = drawings.grazing_warning(surface, plane)
    statements = [
        drawings.relief_statement(raster),
        drawings.raster_statement(raster),
        *warning,
        *remarks[1],
    ]
    contours, product = _contours(coarse, interval, order, remarks)
    if product is not None:
        statements.insert(0, f"Contours every {interval * 1e3:g} mm")
    block = drawings.block_of(plane, order, remarks[0], statements)
    wide, high = (count * raster.cell for count in reversed(raster.height.shape))
    levels = product.summary if product is not None else "no contour lines"
    return Page(
        figure=sheet(raster, block, scale=scale, show="relief", contours=contours),
        block=block,
        summary="; ".join([f"{wide:.3g} x {high:.3g} m, {levels}", *warning]),
        lines=product,
    )


def _contours(
    raster: products.Raster, interval: float, order: Order, remarks: Said
) -> tuple[list[products.Contour], LineProduct | None]:
    """Return contour lines and their drawing; an empty list and None if none exist."""
    try:
        contours = products.contours(raster, interval=interval)
        product = drawings.contour_product(raster, contours, interval, order, remarks)
    except CubeError:
        return [], None
    return contours, product


def contour_interval(raster: products.Raster, *, levels: int = _LEVELS) -> float:
    """Return a rounded contour interval for a number of levels, above noise [m]."""
    finite = raster.height[np.isfinite(raster.height)]
    low, high = np.percentile(finite, [_STRAY, 100 - _STRAY])
    noise = raster.own[np.isfinite(raster.own)]
    least = 4 * float(np.median(noise)) if noise.size else 0.0
    return formats.rounded_up(max((high - low) / levels, least, 1e-4))


def lines_page(product: LineProduct) -> Page:
    """Return a line drawing as a page."""
    return Page(
        figure=product.figure(),
        block=product.drawing,
        summary=product.summary,
        lines=product,
    )


def _deviation(
    image: xr.Dataset,
    surface: products.Surface,
    order: Order,
    remarks: Said,
    body: Revolution | None,
) -> Page:
    """Draw the deviation from a reference, or from the fitted surface of revolution."""
    if order.against is not None:
        deviation = references.compare(surface, order)
        name, place = order.against.name, references.PLACE_KNOWN
    else:
        assert body is not None
        deviation = replace(from_body(image, body), surface=surface)
        name = "the fitted surface of revolution"
        place = (
            "The body is fitted to the same scan: errors of the distance that all "
            "pixels share move both. The uncertainty is that of pixel and radius"
        )
    about = references.described(deviation, remarks, name, place)
    figure, block = references.deviation_sheet(deviation, order, about)
    summary = f"from {name}: {references.summary_of(deviation)}"
    return Page(figure=figure, block=block, summary=summary)


def from_body(image: xr.Dataset, body: Revolution) -> products.Deviation:
    """Compute the deviations of a scan from a surface of revolution fitted to it."""
    surface = products.surface(image)
    axis, point = drawings.axis_of(body)
    across = np.cross(axis, surface.direction.mean(axis=0))
    across /= np.linalg.norm(across)
    angle = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(
        axis, across
    )
    center = point + body.height[:, None, None] * axis
    vertices = center + body.radius[:, None, None] * ring
    numbers = np.arange(body.radius.size * _AROUND).reshape(-1, _AROUND)
    a, b = numbers[:-1], np.roll(numbers[:-1], -1, axis=1)
    c, d = numbers[1:], np.roll(numbers[1:], -1, axis=1)
    faces = [np.stack(corners, axis=-1) for corners in ((a, b, c), (b, d, c))]
    return products.deviation(
        replace(surface, shared=np.zeros_like(surface.shared)),
        vertices.reshape(-1, 3),
        np.concatenate(faces).reshape(-1, 3),
        shared=np.repeat(body.uncertainty, _AROUND),
        reference=surface.frame,
    )
