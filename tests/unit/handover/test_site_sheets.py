"""Sheets of a site state and show its scans: two visits of a plane, made by hand."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose
from plane_visits import SCANS, SITE, STEP, placed, visit

from amulor.errors import CubeError
from amulor.handover import drawings, site_drawings
from amulor.handover.site_drawings import SiteOrder
from amulor.io.drawings import TitleBlock
from amulor.view.sheet import Annotations, Station, fitting_scale
from amulor.view.site_plan import visit_colours


def block() -> TitleBlock:
    """Return the title block of a sheet without statements."""
    return TitleBlock(title="Harbor: plan", statements=(), fields={"author": "D"})


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Return the list of sheets that are made, but not drawn."""
    sheets: list[dict[str, Any]] = []

    def sheet(raster: Any, block: TitleBlock, **more: Any) -> Figure:
        sheets.append({"raster": raster, "block": block} | more)
        return Figure()

    def line_sheet(drawing: Any, **more: Any) -> Figure:
        sheets.append({"drawing": drawing} | more)
        return Figure()

    monkeypatch.setattr(site_drawings, "sheet", sheet)
    monkeypatch.setattr(drawings, "line_sheet", line_sheet)
    return sheets


def test_a_plan_is_that_of_the_last_visit_unless_stated() -> None:
    """Bounds, spacing and outlines are those of the scans of one visit."""
    last = visit()
    assert last.epoch == "two"
    assert [scan.name for scan in last.present] == ["b", "c"]
    assert last.bounds == (0.0, 5.5, 0.0, 2.0)
    first = visit(SiteOrder(epoch="one"))
    assert first.bounds == (0.0, 3.0, 0.0, 2.0)
    assert list(first.footprints) == ["a"]
    with pytest.raises(CubeError, match=r"^the site has no scan of the visit 'x'$"):
        _ = visit(SiteOrder(epoch="x")).present


def test_the_coarsest_scan_sets_the_pixel_of_a_site() -> None:
    """A scan of half the size of squares changes nothing."""
    fine = placed("c", "two", 2.5)
    half = fine.surface.position * [0.5, 0.5, 1.0]
    surface = SimpleNamespace(position=half, spacing=STEP / 2)
    scans = [SCANS[1], SimpleNamespace(epoch="two", surface=surface)]
    assert visit(scans=scans).spacing == pytest.approx(STEP, rel=0.05)
    assert visit(scans=scans[::-1]).spacing == pytest.approx(STEP, rel=0.05)


def test_section_lines_have_letters_from_a_on() -> None:
    """Two lines through the middle, 3 % longer on each side, or those stated."""
    found = {letter: ends.tolist() for letter, ends in visit().cuts.items()}
    assert found == {
        "A": [[-0.165, 1.0], [5.665, 1.0]],
        "B": [[2.75, -0.165], [2.75, 2.165]],
    }
    lines = ((0.0, 1.0, 2.0, 3.0), (4.0, 5.0, 6.0, 7.0), (8.0, 9.0, 8.0, 7.0))
    stated = visit(SiteOrder(lines=lines)).cuts
    assert list(stated) == ["A", "B", "C"]
    assert stated["B"].tolist() == [[4.0, 5.0], [6.0, 7.0]]


def test_a_key_plan_has_cells_of_a_pixel_or_a_150th() -> None:
    """Cells are no smaller than pixels, and 150 at most lie across the longer side."""
    assert visit().key.cell == pytest.approx(visit().spacing)
    apart = [SCANS[1], placed("c", "two", 97.0)]
    assert visit(scans=apart).key.cell == pytest.approx(100 / 150)


@pytest.mark.parametrize(
    ("order", "size"),
    [
        # East: section A. North: from station b at -2 to the end of section B.
        (SiteOrder(), (5.83, 4.165)),
        (SiteOrder(epoch="one"), (3.18, 2.18)),
        (SiteOrder(lines=((-20.0, 0.0, 9.0, 0.0),)), (29.0, 4.0)),
    ],
)
def test_an_overview_has_room_for_scans_stations_and_sections(order, size) -> None:
    """The scale is one at which all of them fit A3."""
    wide, high = size
    assert visit(order).overview_scale() == fitting_scale(wide, high, paper="A3")


@pytest.mark.parametrize(
    ("scale", "fine", "coarse"),
    # Printed cells of 0.254 mm, a sixth of a pixel at least; contours by the pixel.
    [(50.0, None, None), (400.0, 0.1016, None), (2000.0, 0.508, 0.508)],
)
def test_heights_have_cells_for_print_and_for_contours(
    monkeypatch, scale: float, fine: float | None, coarse: float | None
) -> None:
    """The window is that of the sheet."""
    monkeypatch.setattr(
        site_drawings.plan, "orthoplan", lambda scans, *, cell, window: (cell, window)
    )
    last = visit()
    window = (0.0, 1.0, 0.0, 1.0)
    found: Any = last.heights(scale, window)
    assert (found.scale, found.window) == (scale, window)
    assert found.fine == (pytest.approx(fine or last.spacing / 6), window)
    assert found.coarse == (pytest.approx(coarse or last.spacing), window)


HEIGHTS = visit().heights(200.0, visit().bounds)


def test_a_plan_states_scans_contours_errors_and_frame(drawn) -> None:
    """A tenth of both scans overlap; the whole site is uncertain by 3 mm."""
    last = visit()
    page = last.plan(
        block(), HEIGHTS, 0.05, cuts=last.cuts, details={"1": (0, 1, 0, 1)}
    )
    (sheet,) = drawn
    assert page.block == sheet["block"]
    words = (
        r"(\d+)% of the area was measured by several scans\. "
        r"Cells (\S+) mm, pixels (\S+) mm"
    )
    overlap = re.fullmatch(words, page.block.statements[3])
    assert overlap is not None
    assert int(overlap[1]) == pytest.approx(9, abs=1)
    assert float(overlap[2]) == pytest.approx(HEIGHTS.fine.cell * 1e3, rel=0.01)
    assert float(overlap[3]) == pytest.approx(last.spacing * 1e3, rel=0.01)
    ellipses = sheet["annotations"].enlarged
    assert page.block.statements == (
        "Visit two, 2 scans: b, c. Contours every 50 mm; heights count upwards from "
        "the origin of the site",
        "Gray frames: detail sheets with their numbers",
        "Standard uncertainty of heights relative to scan a: "
        f"{page.block.statements[2].split(': ')[1].split('. ')[0]}. It includes noise, "
        "poses and errors common to a scan, but not the position of the whole site, "
        "3 mm",
        page.block.statements[3],
        "Error ellipses: one standard uncertainty of the stations relative to a, "
        f"enlarged {ellipses:g} times",
        drawings.relief_statement(HEIGHTS.fine),
        "11 points of moving objects are left out",
        "Local frame of the site; north is grid north",
    )
    assert (sheet["scale"], sheet["show"]) == (200.0, "relief")
    assert sheet["annotations"].details == {"1": (0, 1, 0, 1)}
    colour = visit_colours(SITE)["two"]
    words = f"footprints, stations, error ellipses (k = 1, x {ellipses:g})"
    assert sheet["legend"] == [(colour, "", words)]
    # The largest semi-axis, of 20 mm in b and 3 mm in a, is 6 mm on paper at 1:200.
    assert ellipses == 50.0
    # Heights from 0 to 0.2 m.
    levels = sorted({round(line.level, 9) for line in sheet["contours"]})
    assert levels == [0.05, 0.1, 0.15]


def test_a_plan_is_summed_up_by_size_and_area(drawn) -> None:
    """5.5 by 2 m are 11 square meters."""
    last = visit()
    page = last.plan(block(), HEIGHTS, 0.05, cuts=last.cuts)
    words = re.fullmatch(
        r"(\S+) x (\S+) m at 1:200, (\S+) m2 measured, contours every 50 mm",
        page.summary,
    )
    assert words is not None, page.summary
    wide, high, area = (float(word) for word in words.groups())
    assert (wide, high) == pytest.approx((5.5, 2.0), abs=0.15)
    assert area == pytest.approx(11.0, rel=0.04)
    assert page.lines is not None
    assert (page.lines.scale, page.lines.summary) == (200.0, page.summary)
    layers = page.lines.drawing.layers
    assert set(layers) == {
        "contours", "footprints", "stations", "error ellipses", "targets", "sections"
    }  # fmt: skip
    assert not any("Gray frames" in text for text in page.block.statements)


def test_a_part_of_a_plan_has_the_stations_inside_of_it(drawn) -> None:
    """Section lines belong to the whole plan; an empty part has no contours."""
    last = visit()
    part = last.heights(200.0, (3.0, 5.5, 0.0, 2.0))
    page = last.plan(block(), part, 5.0)
    annotations = drawn[0]["annotations"]
    assert list(annotations.stations) == ["c"]
    assert (annotations.targets, annotations.cuts, annotations.details) == ({}, {}, {})
    assert drawn[0]["contours"] == []
    assert page.summary.endswith("contours every 5000 mm")
    empty = last.heights(200.0, (0.0, 2.0, 0.0, 2.0))
    page = last.plan(block(), empty, 0.05)
    assert drawn[1]["annotations"].stations == {}
    assert drawn[1]["legend"][0][2] == "footprints, stations"
    assert not any("Error ellipses" in text for text in page.block.statements)


def test_a_map_of_uncertainty_states_its_95th_percentile(drawn) -> None:
    """The median is not the largest: 100 cells from 1 to 100 mm."""
    raster = HEIGHTS.fine
    values = np.full(raster.height.size, np.nan)
    values[:101] = np.linspace(1e-3, 101e-3, 101)
    changed = SimpleNamespace(
        **{name: getattr(raster, name) for name in ("height", "cell", "layers")},
        uncertainty=values.reshape(raster.height.shape),
    )
    heights: Any = SimpleNamespace(fine=changed, scale=200.0, window=HEIGHTS.window)
    page = visit().uncertainty(block(), heights)
    assert page.summary == (
        "standard uncertainty of heights: 51 mm (median), at most 96 mm in 95 % of the "
        "area"
    )
    assert page.block.statements[:2] == (
        "Visit two, 2 scans: b, c. Color: standard uncertainty of the height, largest "
        "value within a pixel of the scan",
        "At most 96 mm in 95 % of the area",
    )
    assert page.block.statements[2].startswith("Standard uncertainty of heights rel")
    assert page.block.statements[-2:] == (
        "11 points of moving objects are left out",
        "Local frame of the site; north is grid north",
    )
    assert page.lines is None
    (sheet,) = drawn
    assert (sheet["scale"], sheet["show"]) == (200.0, "uncertainty")
    # All stations, and no section lines.
    assert list(sheet["annotations"].stations) == ["b", "c"]
    assert sheet["annotations"].cuts == {}
    assert len(sheet["legend"]) == 1


def test_a_site_states_its_reference_system_and_simulated_scans() -> None:
    """Scans of all visits are on the sheets; nothing is said of no moving points."""
    frame = {"crs": "Harbor grid", "crs_offset": ["5e5 m", "4.9e6 m", "0.5 m"]}
    site = SITE.model_validate(SITE.model_dump() | {"frame": frame})
    still = [placed("a", "one", 0.0), placed("b", "two", 0.0), placed("c", "two", 2.5)]
    still[0].surface.attributes["simulated"] = 1
    there = visit(site=site, scans=still)
    assert there._origin() == [
        "Reference system: Harbor grid; add (500000, 4900000, 0.5) m",
        "Simulated data; nothing here was measured",
    ]
    assert there._moving() == []
    assert visit()._moving() == ["11 points of moving objects are left out"]


def test_a_section_goes_through_all_visits(drawn) -> None:
    """Lines are in the order of the visits; the earlier one lies 0.3 m higher."""
    lines = ((0.5, 1.1, 4.96, 1.1), (1.0, 0.25, 1.0, 1.75))
    there = visit(SiteOrder(lines=lines))
    page = there.section(block(), "A")
    (sheet,) = drawn
    drawing = sheet["drawing"]
    assert [line.layer for line in drawing.lines] == ["one", "two", "two"]
    heights = [line.points[:, 1] for line in drawing.lines]
    for found, expected in zip(heights, (0.41, 0.11, 0.11), strict=True):
        assert_allclose(found, expected, atol=1e-9)
    ends = [line.points[[0, -1], 0].tolist() for line in drawing.lines]
    assert ends == [pytest.approx([0.0, 2.5])] * 2 + [pytest.approx([2.0, 4.46])]
    assert all(np.all(line.band > 0) for line in drawing.lines)
    assert drawing.marks == ((0.0, "A"), (pytest.approx(4.46), "A'"))
    assert drawing.axes == ("along", "up")
    assert (drawing.title, drawing.fields) == ("Harbor: plan", {"author": "D"})
    median = page.summary.partition("standard uncertainty ")[2]
    assert page.summary == f"4.46 m across 3 scans, standard uncertainty {median}"
    assert page.block.statements == (
        "Section from (0.500, 1.100) to (4.960, 1.100) m, east and north, across the "
        "scans a, b, c",
        f"Standard uncertainty across the profile, relative to scan a: {median}. It "
        "includes poses and errors common to a scan. The band is plus and minus twice "
        "this uncertainty",
        "Visits differ where their bands do not overlap",
        "Local frame of the site; north is grid north",
    )
    raster, places = sheet["key"]
    assert raster is there.key
    assert places.tolist() == [[0.5, 1.1], [4.96, 1.1]]
    assert sheet["colours"] == visit_colours(SITE)
    assert (sheet["scale"], sheet["heights"]) == (fitting_scale(4.46, 0.3), 1.0)


def test_a_section_meets_the_scans_on_its_way(drawn) -> None:
    """Scans beside the line are left out; a line off the site is refused."""
    lines = ((4.0, 0.25, 4.0, 1.75), (1.0, 0.25, 1.0, 1.75), (90.0, 0.0, 91.0, 0.0))
    there = visit(SiteOrder(lines=lines, exaggeration=30.0))
    page = there.section(block(), "A")
    assert page.block.statements[0].endswith("across the scans c")
    assert page.summary.startswith("1.5 m across 1 scans, ")
    assert sorted(drawn[0]["colours"]) == ["two"]
    # 0.15 m of slope, exaggerated 30 times, are higher than 1.5 m are wide.
    assert (drawn[0]["scale"], drawn[0]["heights"]) == (fitting_scale(1.5, 4.5), 30.0)
    assert there.section(block(), "B").summary.startswith("1.5 m across 2 scans, ")
    message = r"^no scan meets the section C-C'; draw another --line$"
    with pytest.raises(CubeError, match=message):
        there.section(block(), "C")
    stated = visit(SiteOrder(lines=lines, scale=7.0))
    stated.section(block(), "A")
    assert drawn[-1]["scale"] == 7.0


def test_title_blocks_have_numbers_and_names_of_sheets() -> None:
    """Fields of the project may replace the number, and never the view."""
    blocks = site_drawings._blocks(
        ["plan", "section_A"], "Harbor", {"author": "D", "view": "x"}
    )
    assert [(b.title, b.fields) for b in blocks.values()] == [
        ("Harbor: plan", {"sheet": "1 of 2", "author": "D", "view": "plan"}),
        ("Harbor: section A", {"sheet": "2 of 2", "author": "D", "view": "section A"}),
    ]


def test_lines_of_a_plan_have_layers_names_and_heights() -> None:
    """Everything of the plan is in the DXF file, at its place."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    contour: Any = SimpleNamespace(
        level=-1.25, points=np.array([[0.0, 0.0], [0.0, 9.0]])
    )
    short: Any = SimpleNamespace(level=-1.3, points=np.array([[0.0, 0.0], [0.0, 0.1]]))
    annotations = Annotations(
        outlines=(("#ff0000", (square, square + 2)),),
        stations={
            "s": Station(
                position=np.array([5.0, 4.0]),
                covariance=np.diag([4e-4, 1e-4]),
                colour="#0000ff",
            )
        },
        enlarged=20.0,
        targets={"T": np.array([6.0, 2.0])},
        cuts={"A": square[:2]},
        details={"1": (7.0, 9.0, 1.0, 3.0)},
    )
    stated = TitleBlock(title="t", statements=("s",), fields={"author": "D"})
    drawing = site_drawings._plan_lines([contour, short], annotations, stated, 50.0)
    assert (drawing.title, drawing.statements) == ("t", ("s",))
    assert drawing.fields == {"author": "D"}
    assert drawing.axes == ("east", "north")
    assert [(line.layer, line.label) for line in drawing.lines] == [
        ("contours", "-1.25"), ("contours", ""),
        ("footprints", ""), ("footprints", ""),
        ("stations", "s"), ("stations", ""), ("error ellipses", ""),
        ("targets", "T"), ("targets", ""), ("sections", "A-A'"), ("details", "1"),
    ]  # fmt: skip
    elevations = [line.elevation for line in drawing.lines[:3]]
    assert elevations[:2] == [-1.25, -1.3]
    assert_allclose(drawing.lines[3].points, square + 2)
    # Semi-axes of 20 and 10 mm, 20 times enlarged.
    ellipse = drawing.lines[6].points
    assert ellipse.shape == (73, 2)
    assert np.ptp(ellipse, axis=0) == pytest.approx([0.8, 0.4], rel=2e-3)
    assert_allclose(drawing.lines[7].points, [[5.9, 2.0], [6.1, 2.0]])
    corners = [[7, 1], [9, 1], [9, 3], [7, 3], [7, 1]]
    assert drawing.lines[-1].points.tolist() == corners
