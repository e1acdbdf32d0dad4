"""Line drawings, rasters and sheets of a surface."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from amulor.cube import DOUBTFUL
from amulor.errors import CubeError
from amulor.handover.order import Order, in_millimetres
from amulor.imaging import measure, products
from amulor.io import drawings as formats
from amulor.io.files import atomic_output
from amulor.view.pdf import write_pdf
from amulor.view.sheet import fitting_scale, line_sheet
from amulor.view.style import style

Floats = NDArray[np.float64]
Said = tuple[str, list[str]]
_INCH = 0.0254
#: Shortest contour line with its height beside it, on paper [m].
_LABELLED = 0.015


@dataclass(frozen=True, kw_only=True)
class LineProduct:
    """Line drawing with its scale, its table of numbers and a summary."""

    drawing: formats.Drawing
    """Lines and title block."""
    table: Mapping[str, ArrayLike]
    """Columns of the CSV file, by name with unit."""
    summary: str
    """Result in one sentence."""
    scale: float
    """Scale denominator on paper [1]."""
    heights: float = 1.0
    """Exaggeration of the upward axis on paper [1]."""
    key: tuple[products.Raster, Floats] | None = None
    """View for a key plan, and the ends of the section line in it [m]."""
    picture: products.Raster | None = None
    """Shaded relief under the lines."""
    colours: Mapping[str, str] | None = None
    """Colors of the layers, for a legend."""

    def figure(self) -> Figure:
        """Draw the lines on a sheet."""
        return line_sheet(
            self.drawing,
            scale=self.scale,
            heights=self.heights,
            key=self.key,
            picture=self.picture,
            colours=self.colours,
        )

    def write(self, path: Path, *, overwrite: bool) -> str:
        """Write a table, a DXF file or a sheet, and return the summary."""
        ending = path.suffix.lower()
        if ending == ".csv":
            statements = [self.drawing.title, *self.drawing.statements]
            formats.write_table(
                self.table, path, statements=statements, overwrite=overwrite
            )
        elif ending == ".dxf":
            formats.write_dxf(self.drawing, path, scale=self.scale, overwrite=overwrite)
        else:
            save_sheet(self.figure(), path, self.drawing, overwrite=overwrite)
        return self.summary


def section(
    surface: products.Surface, plane: products.Plane, order: Order, remarks: Said
) -> LineProduct:
    """Draw the section of a surface along the line in the order."""
    assert order.line is not None
    cut = products.section(surface, plane, start=order.line[:2], end=order.line[2:])
    pieces = int(cut.piece.max()) + 1
    line = ", ".join(f"{v:g}" for v in order.line)
    median = in_millimetres(cut.uncertainty)
    band = "; the band is two of them wide to either side"
    finite = bool(np.isfinite(cut.uncertainty).all())
    statements = [
        f"Section between the places ({line}) m, right and up, of the drawing seen "
        f"from the {plane.side}: distance along it, and height ({plane.names[2]}) "
        "towards the viewer from the origin of the axes",
        f"Standard uncertainty across the profile: {median}{band if finite else ''}",
        *remarks[1],
    ]
    lines = tuple(
        formats.Line(
            points=np.stack([cut.along, cut.height], axis=1)[cut.piece == number],
            layer="section",
            band=cut.uncertainty[cut.piece == number] if finite else None,
        )
        for number in range(pieces)
    )
    right = cut.start[0] + cut.along / _length(cut) * (cut.end[0] - cut.start[0])
    up = cut.start[1] + cut.along / _length(cut) * (cut.end[1] - cut.start[1])
    high = float(np.ptp(cut.height)) * order.exaggeration
    return LineProduct(
        drawing=formats.Drawing(
            title=f"{remarks[0]}: section",
            lines=lines,
            axes=("along", plane.names[2]),
            statements=tuple(statements),
            marks=((0.0, "A"), (_length(cut), "A'")),
            fields=_fields(order, plane, "section A-A'"),
        ),
        table={
            "piece": cut.piece,
            "along [m]": cut.along,
            f"{plane.names[2]} [m]": cut.height,
            "standard_uncertainty [m]": cut.uncertainty,
            "own_part [m]": cut.own,
            f"{plane.names[0]} [m]": right,
            f"{plane.names[1]} [m]": up,
        },
        scale=order.scale or fitting_scale(_length(cut), high),
        heights=order.exaggeration,
        key=(_thumbnail(surface, plane), np.array([cut.start, cut.end])),
        summary=(
            f"section of {_length(cut):.3f} m in {pieces} "
            f"piece{'s' if pieces > 1 else ''}, standard uncertainty {median}"
        ),
    )


def turned_body(image: xr.Dataset) -> measure.Revolution:
    """Fit a surface of revolution to the surface pixels of a range image."""
    surface = products.surface(image)
    region = np.zeros(image["slant_range"].size, dtype=bool)
    region[surface.pixel] = True
    return measure.revolution(image, region.reshape(image["slant_range"].shape))


def _diameter(value: float, uncertainty: float) -> str:
    """Diameter with its standard uncertainty as text, both in meters."""
    if not math.isfinite(uncertainty):
        return f"{1e3 * value:.1f} mm (error not known)"
    return f"{1e3 * value:.1f} ± {1e3 * uncertainty:.2g} mm"


def profile(
    image: xr.Dataset,
    order: Order,
    remarks: Said,
    *,
    body: measure.Revolution | None = None,
) -> LineProduct:
    """Draw the half-profile of a surface of revolution, with diameters."""
    turned = body or turned_body(image)
    fit = turned.fit
    height = turned.height - turned.height[0]
    widest = int(np.argmax(turned.radius))
    diameters = {
        place: _diameter(2 * turned.radius[n], 2 * turned.uncertainty[n])
        for place, n in (("upper end", -1), ("widest place", widest), ("lower end", 0))
    }
    said = "; ".join(f"{place} {text}" for place, text in diameters.items())
    slope = math.hypot(fit.uncertainties["axis_x"], fit.uncertainties["axis_z"])
    statements = [
        f"Diameters with standard uncertainty: {said}",
        f"Surface of revolution through {fit.pixels} pixels; {turned.left_out} others "
        f"lie off it, such as handles. Scatter {fit.residual * 1e3:.2g} mm (rms)"
        + (
            f", direction of the axis within {1e3 * slope:.2g} mrad"
            if math.isfinite(slope)
            else ""
        ),
        "Only the outside was measured; the thickness of the wall is unknown",
        *([f"Doubtful: {fit.doubt}"] if fit.doubt else []),
        *remarks[1],
    ]
    axis, point = axis_of(turned)
    base = point + turned.height[0] * axis
    scale = order.scale or fitting_scale(
        2 * float(turned.radius.max()), float(height[-1])
    )
    doubt = f"; doubtful: {fit.doubt}" if fit.doubt else ""
    return LineProduct(
        drawing=_profile_drawing(
            turned, height, diameters, remarks[0], statements, order
        ),
        table={
            "height [m]": height,
            "radius [m]": turned.radius,
            "standard_uncertainty [m]": turned.uncertainty,
        },
        scale=scale,
        picture=_seen_along(products.surface(image), axis, base, scale / 8e3),
        summary=f"half-profile of {height[-1] * 1e3:.0f} mm; diameters: {said}{doubt}",
    )


def axis_of(turned: measure.Revolution) -> tuple[Floats, Floats]:
    """Return the axis of a surface of revolution: unit vector and a point on it [m]."""
    axis, point = (
        np.array([turned.fit.values[f"{name}_{at}"] for at in "xyz"])
        for name in ("axis", "point")
    )
    return axis, point


def _profile_drawing(
    turned: measure.Revolution,
    height: Floats,
    diameters: dict[str, str],
    title: str,
    statements: list[str],
    order: Order,
) -> formats.Drawing:
    """Return the half-profile, its mirror image, axis and diameters as lines."""
    radius, error = turned.radius, turned.uncertainty
    widest = int(np.argmax(radius))
    left = formats.Line(
        points=np.stack([-radius, height], axis=1),
        layer="profile",
        band=error if np.isfinite(error).all() else None,
    )
    right = formats.Line(points=np.stack([radius, height], axis=1), layer="outline")
    axis = formats.Line(
        points=np.array([[0.0, height[0]], [0.0, height[-1]]]), layer="axis"
    )
    across = [
        formats.Line(
            points=np.array([[-radius[n], height[n]], [0.0, height[n]]]),
            layer="diameters",
            label=f"Ø {text}",
        )
        for n, text in {
            len(radius) - 1: diameters["upper end"],
            0: diameters["lower end"],
            widest: diameters["widest place"],
        }.items()
    ]
    return formats.Drawing(
        title=f"{title}: half-profile",
        lines=(left, right, axis, *across),
        axes=("from the axis", "height"),
        statements=tuple(statements),
        fields={**order.fields, "view": "half-profile and elevation"},
    )


def _seen_along(
    surface: products.Surface, axis: Floats, base: Floats, cell: float
) -> products.Raster:
    """Return a raster of a surface, with an axis upright and `base` as origin."""
    nearer = -surface.direction.mean(axis=0)
    nearer -= (nearer @ axis) * axis
    nearer /= np.linalg.norm(nearer)
    plane = products.Plane(
        side="front",
        axes=np.stack([np.cross(axis, nearer), axis, nearer]),
        names=("from the axis", "height", "nearer"),
    )
    shifted = replace(surface, position=surface.position - base)
    return products.raster(shifted, plane, cell=cell)


def contours(raster: products.Raster, order: Order, remarks: Said) -> LineProduct:
    """Draw the contour lines of a raster, by default every 10 mm."""
    interval = order.contours if order.contours is not None else 0.01
    lines = products.contours(raster, interval=interval)
    return contour_product(raster, lines, interval, order, remarks)


def contour_product(
    raster: products.Raster,
    lines: Sequence[products.Contour],
    interval: float,
    order: Order,
    remarks: Said,
) -> LineProduct:
    """Draw contour lines with labels, a table, and a warning about noise."""
    if not lines:
        raise CubeError(
            f"no contour line every {interval * 1e3:g} mm stands out of the noise; "
            "take another interval, or larger cells (--cell), which average more pixels"
        )
    finite = raster.uncertainty[np.isfinite(raster.uncertainty)]
    sigma = float(np.median(finite)) if finite.size else math.nan
    statements = [f"Contours every {interval * 1e3:g} mm", *remarks[1]]
    doubt = ""
    if interval < 4 * sigma:
        doubt = (
            f"; noise draws them, too: the interval is less than four standard "
            f"uncertainties ({sigma * 1e3:.2g} mm), take larger cells (--cell)"
        )
        statements.append(doubt.removeprefix("; ").capitalize())
    counts = [len(line.points) for line in lines]
    points = np.concatenate([line.points for line in lines])
    scale = scale_of(order, raster.surface, raster.plane)
    levels = len({line.level for line in lines})
    return LineProduct(
        drawing=formats.Drawing(
            title=f"{remarks[0]}: contours",
            fields=_fields(order, raster.plane, "contours"),
            lines=tuple(
                formats.Line(
                    points=line.points,
                    layer="contours",
                    label=height_beside(line, scale),
                    elevation=line.level,
                )
                for line in lines
            ),
            axes=raster.plane.names[:2],
            statements=tuple(statements),
        ),
        table={
            "line": np.repeat(np.arange(len(lines)), counts),
            "level [m]": np.repeat([line.level for line in lines], counts),
            f"{raster.plane.names[0]} [m]": points[:, 0],
            f"{raster.plane.names[1]} [m]": points[:, 1],
            "standard_uncertainty_of_level [m]": np.repeat(
                [line.uncertainty for line in lines], counts
            ),
        },
        scale=scale,
        summary=f"{len(lines)} contour lines at {levels} levels{doubt}",
    )


def height_beside(line: products.Contour, scale: float) -> str:
    """Return the height of a contour line as text; empty if the line is short."""
    extent = float(np.ptp(line.points, axis=0).max())
    return f"{line.level:.4g}" if extent > _LABELLED * scale else ""


def scale_of(order: Order, surface: products.Surface, plane: products.Plane) -> float:
    """Return the scale in the order [1], else the largest usual scale that fits A4."""
    if order.scale is not None:
        return order.scale
    return fitting_scale(*_size(surface, plane))


def cell_of(order: Order, surface: products.Surface, scale: float) -> float:
    """Return the ordered cell size, else that of a printed dot or rounded pixel [m]."""
    if order.cell is not None:
        return order.cell
    if order.product == "orthoimage":
        return scale * _INCH / order.dots_per_inch
    # A round number near the spacing: 1, 2 or 5 times a power of ten.
    power = 10.0 ** np.floor(np.log10(surface.spacing))
    steps = np.array([1.0, 2.0, 5.0, 10.0]) * power
    return float(steps[np.argmin(np.abs(np.log(steps / surface.spacing)))])


def raster_statement(raster: products.Raster) -> str:
    """Return a sentence on view, cell size, heights and uncertainty of a raster."""
    names = raster.plane.names
    return (
        f"Seen from the {raster.plane.side}; heights ({names[2]}) count towards the "
        "viewer from the origin of the axes; standard uncertainty: "
        f"{in_millimetres(raster.uncertainty)}. Cells "
        f"{raster.cell * 1e3:.3g} mm, pixels of the scan "
        f"{raster.surface.spacing * 1e3:.3g} mm"
    )


#: Angle between beams and view beyond which a drawing shows surfaces edge-on [rad].
_GRAZING = np.radians(65)


def grazing_warning(surface: products.Surface, plane: products.Plane) -> list[str]:
    """Return a warning if the beams are strongly oblique to the view direction."""
    angle = float(np.median(np.arccos(np.abs(surface.direction @ plane.axes[2]))))
    if angle < _GRAZING:
        return []
    better = "elevation (--seen-from front)"
    if plane.side == "front":
        better = "plan (--seen-from top)"
    return [
        f"Warning: the beams meet this view at {np.degrees(angle):.0f} degrees, so it "
        f"shows surfaces edge-on, with large errors; the {better} shows what was "
        "scanned"
    ]


def flagged_raster(
    image: xr.Dataset,
    surface: products.Surface,
    plane: products.Plane,
    order: Order,
    scale: float,
) -> products.Raster:
    """Return a raster of a surface with the share of doubtful pixels as a layer."""
    flags = image["quality_flag"].values.ravel()[surface.pixel]
    return products.raster(
        surface,
        plane,
        cell=cell_of(order, surface, scale),
        layers={"doubtful": ((flags & int(DOUBTFUL)) != 0).astype(float)},
    )


def block_of(
    plane: products.Plane, order: Order, title: str, statements: Sequence[str]
) -> formats.TitleBlock:
    """Return the title block of a raster's drawing sheet."""
    return formats.TitleBlock(
        title=title, statements=tuple(statements), fields=_fields(order, plane)
    )


def relief_statement(raster: products.Raster) -> str:
    """Return a sentence about shaded relief and its limits."""
    apart = max(raster.surface.spacing, raster.cell)
    slope = float(np.nanmedian(raster.own)) * 2**0.5 / apart
    return (
        "Light from the upper left, 40 degrees high, on means of 3 x 3 cells; noise "
        f"alone tilts neighboring pixels by {np.degrees(np.arctan(slope)):.1f} "
        "degrees (standard uncertainty): flatter relief is no tool mark"
    )


def bands_of(raster: products.Raster, *, first: str) -> list[formats.Band]:
    """Return heights, height uncertainties and amplitudes of a raster as bands."""
    heights = [
        formats.Band(name="height towards the viewer", unit="m", values=raster.height),
        formats.Band(
            name="combined standard uncertainty of the height",
            unit="m",
            values=raster.uncertainty,
        ),
        formats.Band(
            name="part of it that is noise of the pixels", unit="m", values=raster.own
        ),
    ]
    light = formats.Band(
        name="amplitude of the target signal", unit="V", values=raster.amplitude
    )
    return [light, *heights] if first == "orthoimage" else [*heights, light]


def write_bands(
    raster: products.Raster,
    bands: Sequence[formats.Band],
    path: Path,
    statements: Sequence[str],
    *,
    overwrite: bool,
) -> None:
    """Write bands of a raster as a GeoTIFF in the raster's frame."""
    frame = raster.surface.frame
    plan = raster.plane.side == "top"
    formats.write_geotiff(
        bands,
        path,
        cell=raster.cell,
        left=raster.left,
        top=raster.top,
        crs=frame.crs if plan else "",
        offset=frame.crs_offset[:2] if plan else (0.0, 0.0),
        statements=statements,
        overwrite=overwrite,
    )


def save_sheet(
    figure: Figure, path: Path, block: formats.TitleBlock, *, overwrite: bool
) -> None:
    """Write a drawing sheet at its paper size as PDF, SVG or PNG."""
    kind = path.suffix.lower().removeprefix(".")
    if kind == "pdf":
        save_pages([figure], path, block, overwrite=overwrite)
        return
    plain = {"svg": {"Date": None}, "png": {}}
    with atomic_output(path, overwrite=overwrite) as temporary, style():
        figure.savefig(temporary, format=kind, dpi=300, metadata=plain[kind])


def save_pages(
    figures: Sequence[Figure], path: Path, block: formats.TitleBlock, *, overwrite: bool
) -> None:
    """Write drawing sheets as one PDF file with the texts of a title block."""
    write_pdf(
        figures,
        path,
        title=block.title,
        author=block.fields.get("author", ""),
        subject=". ".join(block.statements),
        overwrite=overwrite,
    )


def _thumbnail(surface: products.Surface, plane: products.Plane) -> products.Raster:
    """Return a coarse raster of a surface for a key plan."""
    cell = max(max(_size(surface, plane)) / 150, surface.spacing)
    return products.raster(surface, plane, cell=cell)


def _size(surface: products.Surface, plane: products.Plane) -> tuple[float, float]:
    """Return width and height of a surface in a drawing [m]."""
    used = surface.position[np.unique(surface.triangles)] @ plane.axes[:2].T
    wide, high = np.ptp(used, axis=0)
    return float(wide), float(high)


#: Side of a drawing in words.
_VIEWS = {"front": "front elevation", "top": "plan"}


def _fields(order: Order, plane: products.Plane, kind: str = "") -> dict[str, str]:
    """Return the texts of the title block: those of the order, and the view's name."""
    view = _VIEWS[plane.side]
    return {**order.fields, "view": f"{kind}, {view}" if kind else view}


def _length(cut: products.Section) -> float:
    return float(np.hypot(cut.end[0] - cut.start[0], cut.end[1] - cut.start[1]))
