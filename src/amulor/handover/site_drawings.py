"""Drawing set of a site: shaded plan, sections across scans, and detail sheets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from amulor._progress import tell
from amulor.errors import CubeError
from amulor.handover import drawings
from amulor.handover.drawing_set import (
    Page,
    check_files,
    contour_interval,
    lines_page,
    write_pages,
)
from amulor.handover.drawings import LineProduct
from amulor.handover.order import in_millimetres
from amulor.imaging import products
from amulor.io import drawings as formats
from amulor.io.files import check_output
from amulor.site import Site
from amulor.site.merging import plan
from amulor.site.merging.plan import PlacedScan
from amulor.site.registration.result import Registration
from amulor.view.sheet import (
    Annotations,
    Station,
    fitting_scale,
    largest_on_a3,
    sheet,
)
from amulor.view.site_plan import Window, annotations_of, visit_colours

Floats = NDArray[np.float64]

#: Size of a printed cell, and the largest semi-axis of an error ellipse, on paper [m].
_CELL, _ELLIPSE = 2.54e-4, 6e-3
#: Arm of the cross at a station or target, on paper [m].
_ARM = 2e-3
#: Corners of an error ellipse in a DXF file [1].
_AROUND = 73
#: Cells per pixel of the coarsest scan, at most [1].
_FINE = 6.0
#: Contour lines of a plan, about [1].
_LEVELS = 16
#: Cells across the raster for the outline of a scan [1].
_OUTLINE = 150
#: Part by which a section line exceeds the plan at both ends [1].
_BEYOND = 0.03


@dataclass(frozen=True, kw_only=True)
class SiteOrder:
    """Settings of the drawings of a site."""

    epoch: str = ""
    """Visit of the plan; by default the last."""
    scale: float | None = None
    """Scale denominator of the details; by default one sheet of A3 for all [1]."""
    contours: float | None = None
    """Interval of contour lines; by default about 16 levels [m]."""
    lines: tuple[tuple[float, float, float, float], ...] = ()
    """Section lines, east and north of both ends; by default two through the middle
    [m]."""
    exaggeration: float = 1.0
    """Exaggeration of the heights of sections on paper [1]."""
    title: str = ""
    """Title; by default the name of the site."""
    fields: Mapping[str, str] = field(default_factory=dict)
    """Texts of the title block."""


def write_site_drawings(
    site: Site,
    registration: Registration,
    scans: Sequence[PlacedScan],
    path: Path,
    order: SiteOrder,
    *,
    overwrite: bool = False,
) -> str:
    """Write plan, sections and details to one PDF file, each to SVG, lines to DXF."""
    visit = _Visit(site=site, registration=registration, scans=scans, order=order)
    overview = visit.overview_scale()
    tiles = [
        window
        for window in _tiles(order.scale, overview, visit.bounds)
        if _has_surface(visit.key, window)
    ]
    sections = {f"section_{letter}": letter for letter in visit.cuts}
    details = {f"detail_{number + 1}": tile for number, tile in enumerate(tiles)}
    names = ["plan", "uncertainty", *sections, *details]
    check_files(path, names, overwrite=overwrite)
    heights = path.with_name(f"{path.stem}_plan.tif")
    check_output(heights, overwrite=overwrite)
    blocks = _blocks(names, order.title or site.name, order.fields)
    scale = overview if tiles else order.scale or overview
    whole = visit.heights(scale, visit.bounds)
    interval = order.contours or contour_interval(whole.coarse, levels=_LEVELS)
    pages = {
        "plan": visit.plan(
            blocks["plan"],
            whole,
            interval,
            cuts=visit.cuts,
            details={str(number + 1): tile for number, tile in enumerate(tiles)},
        ),
        "uncertainty": visit.uncertainty(blocks["uncertainty"], whole),
    }
    tell("drawing sections", 0.5)
    pages |= {
        name: visit.section(blocks[name], letter) for name, letter in sections.items()
    }
    for number, (name, window) in enumerate(details.items()):
        tell("drawing details", 0.6 + 0.3 * number / len(details))
        part = visit.heights(order.scale or overview, window)
        pages[name] = visit.plan(blocks[name], part, interval)
    sentences = write_pages(pages, path, order.title or site.name, overwrite=overwrite)
    drawings.write_bands(
        whole.fine,
        drawings.bands_of(whole.fine, first="dem"),
        heights,
        pages["plan"].block.statements,
        overwrite=overwrite,
    )
    return "\n".join(
        [
            f"{len(pages)} sheets",
            f"  {heights.name}: heights as GeoTIFF",
            *sentences,
        ]
    )


def _blocks(
    names: Sequence[str], title: str, fields: Mapping[str, str]
) -> dict[str, formats.TitleBlock]:
    """Return title blocks with sheet numbers, by name of the sheet."""
    blocks = {}
    for number, name in enumerate(names):
        kind = name.replace("_", " ")
        sheet_number = {"sheet": f"{number + 1} of {len(names)}"}
        blocks[name] = formats.TitleBlock(
            title=f"{title}: {kind}",
            fields={**sheet_number, **fields, "view": kind},
        )
    return blocks


@dataclass(frozen=True, kw_only=True)
class _Heights:
    """Heights of a part of a site, for print and for contour lines."""

    scale: float
    """Scale denominator [1]."""
    window: Window
    """West, east, south and north bound [m]."""
    fine: products.Raster
    """Cells of a printed dot, or of a part of a pixel."""
    coarse: products.Raster
    """Cells of a pixel and more."""


@dataclass(frozen=True, kw_only=True)
class _Visit:
    """Maker of the sheets of one visit."""

    site: Site
    registration: Registration
    scans: Sequence[PlacedScan]
    """Scans of all visits."""
    order: SiteOrder

    @property
    def epoch(self) -> str:
        """Name of the visit."""
        return self.order.epoch or self.site.epoch[-1].name

    @cached_property
    def present(self) -> list[PlacedScan]:
        """Scans of the visit."""
        scans = [scan for scan in self.scans if scan.epoch == self.epoch]
        if not scans:
            raise CubeError(f"the site has no scan of the visit {self.epoch!r}")
        return scans

    @cached_property
    def bounds(self) -> Window:
        """West, east, south and north bound of the visit [m]."""
        return plan.bounds(self.present)

    @cached_property
    def spacing(self) -> float:
        """Pixel distance of the coarsest scan [m]."""
        return max(scan.surface.spacing for scan in self.present)

    @cached_property
    def cuts(self) -> dict[str, Floats]:
        """Ends of the section lines by letter [m]."""
        lines = self.order.lines or _middle_lines(*self.bounds)
        return {
            chr(ord("A") + number): np.array(line).reshape(2, 2)
            for number, line in enumerate(lines)
        }

    @cached_property
    def key(self) -> products.Raster:
        """Coarse raster of the visit, for key plans."""
        west, east, south, north = self.bounds
        cell = max(max(east - west, north - south) / _OUTLINE, self.spacing)
        return plan.orthoplan(self.present, cell=cell)

    @cached_property
    def footprints(self) -> dict[str, list[Floats]]:
        """Outlines of the scans by name [m]."""
        return {
            scan.name: plan.footprint(scan, cell=self.key.cell) for scan in self.present
        }

    def overview_scale(self) -> float:
        """Return the scale denominator at which plan and stations fit A3 [1]."""
        west, east, south, north = self.bounds
        stations = [self.registration.poses[s.name].position[:2] for s in self.present]
        ends = [end for cut in self.cuts.values() for end in cut]
        corners = np.array([*ends, *stations, (west, south), (east, north)])
        return fitting_scale(*np.ptp(corners, axis=0), paper="A3")

    def heights(self, scale: float, window: Window) -> _Heights:
        """Compute the heights of a part of the site."""
        cell = max(scale * _CELL, self.spacing / _FINE)
        fine, coarse = (
            plan.orthoplan(self.present, cell=size, window=window)
            for size in (cell, max(cell, self.spacing))
        )
        return _Heights(scale=scale, window=window, fine=fine, coarse=coarse)

    def plan(
        self,
        block: formats.TitleBlock,
        heights: _Heights,
        interval: float,
        *,
        cuts: Mapping[str, Floats] | None = None,
        details: Mapping[str, Window] | None = None,
    ) -> Page:
        """Draw the site, or a part without section lines, shaded from above."""
        raster, scale = heights.fine, heights.scale
        try:
            contours = products.contours(heights.coarse, interval=interval)
        except CubeError:
            contours = []
        annotations = replace(self._annotations(heights, cuts), details=details or {})
        block = replace(
            block,
            statements=(
                f"{self._scans()}. Contours every {interval * 1e3:g} mm; heights count "
                "upwards from the origin of the site",
                *(["Gray frames: detail sheets with their numbers"] if details else []),
                *self._statements(raster, annotations),
                drawings.relief_statement(raster),
                *self._moving(),
                *self._origin(),
            ),
        )
        figure = sheet(
            raster,
            block,
            scale=scale,
            show="relief",
            contours=contours,
            annotations=annotations,
            legend=self._legend(annotations),
        )
        wide, high = (count * raster.cell for count in reversed(raster.height.shape))
        covered = np.isfinite(raster.height)
        summary = (
            f"{wide:.3g} x {high:.3g} m at 1:{scale:g}, "
            f"{covered.sum() * raster.cell**2:.3g} m2 measured, contours every "
            f"{interval * 1e3:g} mm"
        )
        drawing = _plan_lines(contours, annotations, block, scale)
        return Page(
            figure=figure,
            block=block,
            summary=summary,
            lines=LineProduct(drawing=drawing, table={}, summary=summary, scale=scale),
        )

    def uncertainty(self, block: formats.TitleBlock, heights: _Heights) -> Page:
        """Draw the standard uncertainty of the heights from above."""
        raster = heights.fine
        annotations = self._annotations(heights, {})
        sigma = raster.uncertainty[np.isfinite(raster.uncertainty)]
        summary = (
            f"standard uncertainty of heights: {in_millimetres(sigma)}, at most "
            f"{np.percentile(sigma, 95) * 1e3:.2g} mm in 95 % of the area"
        )
        block = replace(
            block,
            statements=(
                f"{self._scans()}. Color: standard uncertainty of the height, largest "
                "value within a pixel of the scan",
                f"At most {np.percentile(sigma, 95) * 1e3:.2g} mm in 95 % of the area",
                *self._statements(raster, annotations),
                *self._moving(),
                *self._origin(),
            ),
        )
        figure = sheet(
            raster,
            block,
            scale=heights.scale,
            show="uncertainty",
            annotations=annotations,
            legend=self._legend(annotations),
        )
        return Page(figure=figure, block=block, summary=summary)

    def _annotations(
        self, heights: _Heights, cuts: Mapping[str, Floats] | None
    ) -> Annotations:
        """Return footprints, stations and section lines; of a part, those inside."""
        return annotations_of(
            self.site,
            self.registration,
            self.present,
            largest=_ELLIPSE * heights.scale,
            outlines=self.footprints,
            window=heights.window if cuts is None else None,
            cuts=cuts,
        )

    def _legend(self, annotations: Annotations) -> list[tuple[str, str, str]]:
        """Return the entry of the color of the visit."""
        words = "footprints, stations"
        if annotations.stations:
            words += f", error ellipses (k = 1, x {annotations.enlarged:g})"
        return [(visit_colours(self.site)[self.epoch], "", words)]

    def _scans(self) -> str:
        """Return the visit and its scans in words."""
        names = ", ".join(scan.name for scan in self.present)
        return f"Visit {self.epoch}, {len(self.present)} scans: {names}"

    def _statements(
        self, raster: products.Raster, annotations: Annotations
    ) -> list[str]:
        """Return sentences on the uncertainty of heights and stations."""
        first = self.site.scan[0].name
        datum = self.registration.covariance_of(f"pose {first}")[:3, :3]
        place = math.sqrt(max(float(np.linalg.eigvalsh(datum)[-1]), 0.0))
        covered = np.isfinite(raster.height)
        several = (raster.layers["scans"] > 1) & covered
        sentences = [
            f"Standard uncertainty of heights relative to scan {first}: "
            f"{in_millimetres(raster.uncertainty)}. It "
            "includes noise, poses and errors common to a scan, but not the position "
            f"of the whole site, {place * 1e3:.2g} mm",
            f"{several.sum() / covered.sum():.0%} of the area was measured "
            f"by several scans. Cells {raster.cell * 1e3:.3g} mm, pixels "
            f"{self.spacing * 1e3:.3g} mm",
        ]
        if annotations.stations:
            sentences.append(
                "Error ellipses: one standard uncertainty of the stations relative "
                f"to {first}, enlarged {annotations.enlarged:g} times"
            )
        return sentences

    def _moving(self) -> list[str]:
        """Return a sentence on points that are left out; empty if there are none."""
        moving = sum(scan.moving for scan in self.present)
        return [f"{moving} points of moving objects are left out"] if moving else []

    def _origin(self) -> list[str]:
        """Return sentences on the frame of the site, and on simulated data."""
        frame = self.site.frame
        offset = ", ".join(f"{v:.12g}" for v in frame.crs_offset)
        local = "Local frame of the site; north is grid north"
        sentences = [
            f"Reference system: {frame.crs}; add ({offset}) m" if frame.crs else local
        ]
        if any(scan.surface.attributes.get("simulated") for scan in self.scans):
            sentences.append("Simulated data; nothing here was measured")
        return sentences

    def section(self, block: formats.TitleBlock, letter: str) -> Page:
        """Draw a section across all scans of all visits."""
        ends = self.cuts[letter]
        length = float(np.linalg.norm(ends[1] - ends[0]))
        lines, sigmas, met = [], [], []
        for visit in self.site.epoch:
            for scan in self.scans:
                if scan.epoch != visit.name:
                    continue
                plane = products.plane_of(scan.surface.frame, "top")
                try:
                    cut = products.section(
                        scan.surface, plane, start=ends[0], end=ends[1]
                    )
                except CubeError:
                    continue
                met.append(scan.name)
                sigmas.append(cut.uncertainty)
                points = np.stack([cut.along, cut.height], axis=1)
                lines += [
                    formats.Line(
                        points=points[cut.piece == piece],
                        layer=visit.name,
                        band=cut.uncertainty[cut.piece == piece],
                    )
                    for piece in range(int(cut.piece.max()) + 1)
                ]
        if not lines:
            raise CubeError(
                f"no scan meets the section {letter}-{letter}'; draw another --line"
            )
        first = self.site.scan[0].name
        median = in_millimetres(np.concatenate(sigmas))
        block = replace(
            block,
            statements=(
                f"Section from ({ends[0][0]:.3f}, {ends[0][1]:.3f}) to "
                f"({ends[1][0]:.3f}, {ends[1][1]:.3f}) m, east and north, across the "
                f"scans {', '.join(met)}",
                f"Standard uncertainty across the profile, relative to scan {first}: "
                f"{median}. It includes poses and errors common to a scan. The band "
                "is plus and minus twice this uncertainty",
                "Visits differ where their bands do not overlap",
                *self._origin(),
            ),
        )
        drawing = formats.Drawing(
            title=block.title,
            statements=block.statements,
            fields=block.fields,
            lines=tuple(lines),
            axes=("along", "up"),
            marks=((0.0, letter), (length, f"{letter}'")),
        )
        left, right, low, high = drawing.limits
        tall = (high - low) * self.order.exaggeration
        scale = self.order.scale or fitting_scale(right - left, tall)
        colours = visit_colours(self.site)
        product = LineProduct(
            drawing=drawing,
            table={},
            summary=(
                f"{length:.3g} m across {len(met)} scans, standard uncertainty {median}"
            ),
            scale=scale,
            heights=self.order.exaggeration,
            key=(self.key, ends),
            colours={name: colours[name] for name in drawing.layers},
        )
        return lines_page(product)


def _plan_lines(
    contours: Sequence[products.Contour],
    annotations: Annotations,
    block: formats.TitleBlock,
    scale: float,
) -> formats.Drawing:
    """Return contours, footprints, stations and section lines for a DXF file."""
    lines = [
        formats.Line(
            points=contour.points,
            layer="contours",
            label=drawings.height_beside(contour, scale),
            elevation=contour.level,
        )
        for contour in contours
    ]
    for _, polygons in annotations.outlines:
        lines += [
            formats.Line(points=points, layer="footprints") for points in polygons
        ]
    for name, station in annotations.stations.items():
        lines += _cross(station.position, name, "stations", scale)
        lines.append(_ellipse(station, annotations.enlarged))
    for name, position in annotations.targets.items():
        lines += _cross(position, name, "targets", scale)
    lines += [
        formats.Line(points=ends, layer="sections", label=f"{letter}-{letter}'")
        for letter, ends in annotations.cuts.items()
    ]
    for number, (west, east, south, north) in annotations.details.items():
        corners = [(west, south), (east, south), (east, north), (west, north)]
        points = np.array([*corners, corners[0]])
        lines.append(formats.Line(points=points, layer="details", label=number))
    return formats.Drawing(
        title=block.title,
        statements=block.statements,
        fields=block.fields,
        lines=tuple(lines),
        axes=("east", "north"),
    )


def _cross(position: Floats, name: str, layer: str, scale: float) -> list[formats.Line]:
    """Return a cross of 4 mm on paper with a name."""
    arms = np.diag([_ARM * scale, _ARM * scale])
    return [
        formats.Line(
            points=np.stack([position - arm, position + arm]), layer=layer, label=label
        )
        for arm, label in zip(arms, (name, ""), strict=True)
    ]


def _ellipse(station: Station, factor: float) -> formats.Line:
    """Return the outline of an enlarged error ellipse."""
    values, vectors = np.linalg.eigh(station.covariance)
    angle = np.linspace(0, 2 * np.pi, _AROUND)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    radii = factor * np.sqrt(np.maximum(values, 0))
    return formats.Line(
        points=station.position + ((vectors * radii) @ circle).T,
        layer="error ellipses",
    )


def _middle_lines(
    west: float, east: float, south: float, north: float
) -> tuple[tuple[float, float, float, float], ...]:
    """Return two section lines [m] through the middle, the longer one first."""
    x, y = (west + east) / 2, (south + north) / 2
    beyond = _BEYOND * max(east - west, north - south)
    across = (west - beyond, y, east + beyond, y)
    upwards = (x, south - beyond, x, north + beyond)
    lines = (across, upwards) if east - west >= north - south else (upwards, across)
    a, b = (tuple(round(value, 3) + 0.0 for value in line) for line in lines)
    return (a[0], a[1], a[2], a[3]), (b[0], b[1], b[2], b[3])


def _tiles(
    scale: float | None,
    overview: float,
    window: Window,
) -> list[Window]:
    """Return the windows [m] of A3 detail sheets; empty if the overview is enough."""
    if scale is None or scale >= overview:
        return []
    west, east, south, north = window
    wide, high = (size * scale for size in largest_on_a3())
    columns = math.ceil((east - west) / wide)
    rows = math.ceil((north - south) / high)
    if rows * columns == 1:
        return []
    x = np.linspace(west, east, columns + 1)
    y = np.linspace(north, south, rows + 1)
    return [
        (float(x[column]), float(x[column + 1]), float(y[row + 1]), float(y[row]))
        for row in range(rows)
        for column in range(columns)
    ]


def _has_surface(raster: products.Raster, window: Window) -> bool:
    """Whether a raster has a height in a window."""
    west, east, south, north = window
    rows = (raster.rows >= south) & (raster.rows <= north)
    columns = (raster.columns >= west) & (raster.columns <= east)
    return bool(np.isfinite(raster.height[np.ix_(rows, columns)]).any())
