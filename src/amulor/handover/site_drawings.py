"""Drawing set of a site: shaded plan, sections across scans, and detail sheets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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
from amulor.view.sheet import Annotations, fitting_scale, largest_on_a3, sheet
from amulor.view.site_plan import annotations_of, visit_colours

Floats = NDArray[np.float64]

#: Size of a printed cell, and the largest semi-axis of an error ellipse, on paper [m].
_CELL, _ELLIPSE = 2.54e-4, 6e-3
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
    """Scale denominator of the details; by default one sheet of A4 for all [1]."""
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
    epoch = order.epoch or site.epoch[-1].name
    visit = [scan for scan in scans if scan.epoch == epoch]
    if not visit:
        raise CubeError(f"the site has no scan of the visit {epoch!r}")
    west, east, south, north = plan.bounds(visit)
    lines = order.lines or _middle_lines(west, east, south, north)
    cuts = {
        chr(ord("A") + number): np.array(line).reshape(2, 2)
        for number, line in enumerate(lines)
    }
    stations = [registration.poses[scan.name].position[:2] for scan in visit]
    corners = np.concatenate([*cuts.values(), stations, [(west, south), (east, north)]])
    overview = fitting_scale(*np.ptp(corners, axis=0))
    spacing = max(scan.surface.spacing for scan in visit)
    coarse = max(max(east - west, north - south) / _OUTLINE, spacing)
    key = plan.orthoplan(visit, cell=coarse)
    tiles = [
        window
        for window in _tiles(order.scale, overview, (west, east, south, north))
        if _has_surface(key, window)
    ]
    names = ["plan", *(f"section_{letter}" for letter in cuts)]
    names += [f"detail_{number + 1}" for number in range(len(tiles))]
    check_files(path, names, overwrite=overwrite)
    heights = path.with_name(f"{path.stem}_plan.tif")
    check_output(heights, overwrite=overwrite)
    draw = _Drawer(
        site, registration, scans, visit, epoch, order, cuts, key, len(names)
    )
    pages = {"plan": draw.plan(overview if tiles else order.scale or overview)}
    tell("drawing sections", 0.5)
    pages |= {f"section_{letter}": draw.section(letter) for letter in cuts}
    for number, window in enumerate(tiles):
        tell("drawing details", 0.6 + 0.3 * number / len(tiles))
        assert order.scale is not None
        name = f"detail_{number + 1}"
        pages[name] = draw.detail(name, order.scale, window)
    sentences = write_pages(pages, path, draw.title, overwrite=overwrite)
    assert draw.raster is not None
    drawings.write_bands(
        draw.raster,
        drawings.bands_of(draw.raster, first="dem"),
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


class _Drawer:
    """Maker of the sheets of one visit."""

    def __init__(
        self,
        site: Site,
        registration: Registration,
        scans: Sequence[PlacedScan],
        visit: Sequence[PlacedScan],
        epoch: str,
        order: SiteOrder,
        cuts: Mapping[str, Floats],
        key: products.Raster,
        count: int,
    ) -> None:
        self.site, self.registration, self.order = site, registration, order
        self.scans, self.visit, self.epoch, self.cuts = scans, visit, epoch, cuts
        self.title = order.title or site.name
        self.spacing = max(scan.surface.spacing for scan in visit)
        self.key, self.count, self.number = key, count, 0
        self.footprints = {
            scan.name: plan.footprint(scan, cell=key.cell) for scan in visit
        }
        self.colours = visit_colours(site)
        self.raster: products.Raster | None = None
        self.interval = order.contours

    def plan(self, scale: float) -> Page:
        """Draw the whole site from above."""
        return self._from_above("plan", scale, plan.bounds(self.visit), cuts=self.cuts)

    def detail(
        self, name: str, scale: float, window: tuple[float, float, float, float]
    ) -> Page:
        """Draw a part of the site from above, at a larger scale."""
        return self._from_above(name, scale, window, cuts={})

    def _from_above(
        self,
        name: str,
        scale: float,
        window: tuple[float, float, float, float],
        *,
        cuts: Mapping[str, Floats],
    ) -> Page:
        cell = max(scale * _CELL, self.spacing / _FINE)
        raster = plan.orthoplan(self.visit, cell=cell, window=window)
        if self.raster is None:
            self.raster = raster
        coarse = plan.orthoplan(self.visit, cell=max(cell, self.spacing), window=window)
        if self.interval is None:
            self.interval = contour_interval(coarse, levels=_LEVELS)
        try:
            contours = products.contours(coarse, interval=self.interval)
        except CubeError:
            contours = []
        annotations = annotations_of(
            self.site,
            self.registration,
            self.visit,
            largest=_ELLIPSE * scale,
            outlines=self.footprints,
            window=None if cuts else window,
            cuts=cuts,
        )
        block = self._block(name, self._statements(raster, annotations))
        words = "footprints, stations"
        if annotations.stations:
            words += f", error ellipses (k = 1, x {annotations.enlarged:g})"
        legend = [(self.colours[self.epoch], "", words)]
        figure = sheet(
            raster,
            block,
            scale=scale,
            show="relief",
            contours=contours,
            annotations=annotations,
            legend=legend,
        )
        wide, high = (count * cell for count in reversed(raster.height.shape))
        covered = np.isfinite(raster.height)
        summary = (
            f"{wide:.3g} x {high:.3g} m at 1:{scale:g}, "
            f"{covered.sum() * cell**2:.3g} m2 measured, contours every "
            f"{self.interval * 1e3:g} mm"
        )
        drawing = self._plan_lines(contours, annotations, block, raster)
        return Page(
            figure=figure,
            block=block,
            summary=summary,
            lines=LineProduct(drawing=drawing, table={}, summary=summary, scale=scale),
        )

    def _statements(
        self, raster: products.Raster, annotations: Annotations
    ) -> list[str]:
        first = self.site.scan[0].name
        datum = self.registration.covariance_of(f"pose {first}")[:3, :3]
        place = math.sqrt(max(float(np.linalg.eigvalsh(datum)[-1]), 0.0))
        several = raster.layers["scans"] > 1
        covered = np.isfinite(raster.height)
        moving = sum(scan.moving for scan in self.visit)
        sigma = in_millimetres(raster.uncertainty)
        return [
            f"Visit {self.epoch}, {len(self.visit)} scans: "
            f"{', '.join(scan.name for scan in self.visit)}. Contours every "
            f"{(self.interval or 0) * 1e3:g} mm; heights count upwards from the origin "
            "of the site",
            f"Standard uncertainty of heights relative to scan {first}: {sigma}. It "
            "includes noise, poses and errors common to a scan, but not the position "
            f"of the whole site, {place * 1e3:.2g} mm",
            f"{(several & covered).sum() / covered.sum():.0%} of the area was measured "
            f"by several scans. Cells {raster.cell * 1e3:.3g} mm, pixels "
            f"{self.spacing * 1e3:.3g} mm",
            *(
                [
                    "Error ellipses: one standard uncertainty of the stations relative "
                    f"to {first}, enlarged {annotations.enlarged:g} times"
                ]
                if annotations.stations
                else []
            ),
            drawings.relief_statement(raster),
            *([f"{moving} points of moving objects are left out"] if moving else []),
            *self._origin(),
        ]

    def _origin(self) -> list[str]:
        """Sentences on the frame of the site, and on simulated data."""
        frame = self.site.frame
        offset = ", ".join(f"{v:.12g}" for v in frame.crs_offset)
        local = "Local frame of the site; north is grid north"
        sentences = [
            f"Reference system: {frame.crs}; add ({offset}) m" if frame.crs else local
        ]
        if any(scan.surface.attributes.get("simulated") for scan in self.scans):
            sentences.append("Simulated data; nothing here was measured")
        return sentences

    def _block(self, name: str, statements: Sequence[str]) -> formats.TitleBlock:
        self.number += 1
        kind = name.replace("_", " ")
        numbered = {"sheet": f"{self.number} of {self.count}"} | dict(self.order.fields)
        return formats.TitleBlock(
            title=f"{self.title}: {kind}",
            statements=tuple(statements),
            fields={**numbered, "view": kind},
        )

    def _plan_lines(
        self,
        contours: Sequence[products.Contour],
        annotations: Annotations,
        block: formats.TitleBlock,
        raster: products.Raster,
    ) -> formats.Drawing:
        """Return contours, footprints, stations and section lines for a DXF file."""
        lines = [
            formats.Line(
                points=contour.points,
                layer="contours",
                label=f"{contour.level:.4g}",
                elevation=contour.level,
            )
            for contour in contours
        ]
        for _, polygons in annotations.outlines:
            lines += [
                formats.Line(points=points, layer="footprints") for points in polygons
            ]
        arm = 4 * raster.cell
        for name, station in annotations.stations.items():
            for step in (np.array([arm, 0.0]), np.array([0.0, arm])):
                ends = np.stack([station.position - step, station.position + step])
                label = name if step[0] else ""
                lines.append(formats.Line(points=ends, layer="stations", label=label))
        lines += [
            formats.Line(points=ends, layer="sections", label=f"{letter}-{letter}'")
            for letter, ends in annotations.cuts.items()
        ]
        return formats.Drawing(
            title=block.title,
            statements=block.statements,
            fields=block.fields,
            lines=tuple(lines),
            axes=("east", "north"),
        )

    def section(self, letter: str) -> Page:
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
        block = self._block(
            f"section_{letter}",
            [
                f"Section from ({ends[0][0]:.3f}, {ends[0][1]:.3f}) to "
                f"({ends[1][0]:.3f}, {ends[1][1]:.3f}) m, east and north, across the "
                f"scans {', '.join(met)}",
                f"Standard uncertainty across the profile, relative to scan {first}: "
                f"{median}. It includes poses and errors common to a scan. The band "
                "is plus and minus twice this uncertainty",
                "Visits differ where their bands do not overlap",
                *self._origin(),
            ],
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
        product = LineProduct(
            drawing=drawing,
            table={},
            summary=(
                f"{length:.3g} m across {len(met)} scans, standard uncertainty {median}"
            ),
            scale=scale,
            heights=self.order.exaggeration,
            key=(self.key, ends),
            colours={name: self.colours[name] for name in drawing.layers},
        )
        return lines_page(product)


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
    window: tuple[float, float, float, float],
) -> list[tuple[float, float, float, float]]:
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


def _has_surface(
    raster: products.Raster, window: tuple[float, float, float, float]
) -> bool:
    """Whether a raster has a height in a window."""
    west, east, south, north = window
    rows = (raster.rows >= south) & (raster.rows <= north)
    columns = (raster.columns >= west) & (raster.columns <= east)
    return bool(np.isfinite(raster.height[np.ix_(rows, columns)]).any())
