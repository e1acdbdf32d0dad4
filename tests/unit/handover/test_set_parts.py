"""Parts of a drawing set: scale, section line, contours, deviation, and files."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose
from PIL import Image

from amulor.errors import CubeError, FormatError
from amulor.handover import Order, drawing_set, drawings
from amulor.handover.drawing_set import Page
from amulor.imaging import products
from amulor.imaging.measure import Fit, Revolution
from amulor.io.drawings import TitleBlock

#: Wall whose right side is nearer, 0.126 m wide and 0.084 m high.
WALL = scenes.plane((0.3, 0.0, 0.954), 1.5, own=2e-4)
SURFACE = products.surface(WALL)
FRONT = products.plane_of(SURFACE.frame)


def flat(points: list[tuple[float, float]]) -> products.Surface:
    """Return a surface of triangles from one point to all pairs of the others."""
    position = np.array([[x, -y, 1.0] for x, y in points])
    fan = [[0, n, n + 1] for n in range(1, len(points) - 1)]
    return replace(SURFACE, position=position, triangles=np.array(fan))


def test_a_section_line_goes_through_the_middle_along_the_longer_side() -> None:
    """The line exceeds both ends by 2 % of the longer side, and is rounded to mm."""
    points = [(0.0, 0.0), (2.0, 0.3), (0.5, 1.0), (0.7, 0.2), (0.6, 0.1234)]
    line = drawing_set.middle_line(flat(points), FRONT)
    # Medians of 0, 0.5, 0.6, 0.7, 2 and of 0, 0.1234, 0.2, 0.3, 1.
    assert line == (-0.04, 0.2, 2.04, 0.2)
    turned = [(y + 0.0004, x) for x, y in points]
    assert drawing_set.middle_line(flat(turned), FRONT) == (0.2, -0.04, 0.2, 2.04)
    # Points without a triangle do not count.
    more = flat(points)
    more = replace(more, position=np.concatenate([more.position, [[9.0, 9.0, 9.0]]]))
    assert drawing_set.middle_line(more, FRONT) == line


def body_of(**changes: Any) -> Revolution:
    """Return a cylinder of 0.05 m of radius about a slanting axis, 0.12 m high."""
    values = dict(zip(
        ("axis_x", "axis_y", "axis_z", "point_x", "point_y", "point_z"),
        (0.6, -0.8, 0.0, 0.1, 0.2, 2.0),
        strict=True,
    ))  # fmt: skip
    fit = Fit(
        kind="revolution", values=values, uncertainties={}, residual=0.0, misfit=1.0,
        pixels=99, doubt=changes.pop("doubt", ""),
    )  # fmt: skip
    fields: dict[str, Any] = {
        "fit": fit, "height": np.array([-0.05, 0.0, 0.07]),
        "radius": np.array([0.05, 0.06, 0.05]),
        "uncertainty": np.array([1e-3, 2e-3, 3e-3]), "left_out": 0,
    }  # fmt: skip
    return Revolution(**(fields | changes))


def test_the_scale_of_a_set_fits_surface_and_body(monkeypatch) -> None:
    """The larger denominator of both is taken, unless a scale is stated."""
    monkeypatch.setattr(drawings, "scale_of", lambda order, *_: order.scale or 2.0)
    order = Order(product="drawings")

    def scale(body: Revolution | None, order: Order = order) -> float:
        return drawing_set._scale_of(order, SURFACE, FRONT, body)

    assert scale(None) == 2.0
    # 0.12 m wide and high fit A4 at 1:1, of 168 by 165 mm.
    assert scale(body_of()) == 2.0
    # 0.9 m high at 1:10: 90 mm of 165; 0.9 m wide at 1:5: 180 mm of 255.
    assert scale(body_of(height=np.array([-0.3, 0.0, 0.6]))) == 10.0
    assert scale(body_of(radius=np.array([0.1, 0.45, 0.1]))) == 5.0
    assert scale(body_of(radius=np.full(3, 9.0)), replace(order, scale=3.0)) == 3.0


@pytest.mark.parametrize(
    ("fitted", "reason"),
    [(body_of(), ""), (body_of(doubt="not round"), "not round"), (None, "too few")],
)
def test_a_doubtful_body_is_none_with_its_reason(monkeypatch, fitted, reason) -> None:
    """A fit that fails is none, too."""

    def turned(image: object) -> Revolution:
        if fitted is None:
            raise CubeError("too few")
        return fitted

    monkeypatch.setattr(drawings, "turned_body", turned)
    nothing: Any = None
    found = drawing_set._body_of(nothing)
    assert found == (None if reason else fitted, reason)


@pytest.mark.parametrize(
    ("own", "levels", "interval"),
    [
        # 98 of 100 heights lie within 0.98 m; a tenth of it is 98 mm.
        (1e-3, 10, 0.1),
        (1e-3, 20, 0.05),
        # Four times the noise is more: 120 mm.
        (0.03, 10, 0.2),
        (np.nan, 10, 0.1),
    ],
)
def test_a_contour_interval_is_a_round_part_of_the_heights(
    own: float, levels: int, interval: float
) -> None:
    """Heights without a value, and 1 % of the others at each end, do not count."""
    height = np.append(np.linspace(0.0, 1.0, 1001), [np.nan] * 7)
    raster: Any = SimpleNamespace(height=height, own=np.array([np.nan, own, own]))
    found = drawing_set.contour_interval(raster, levels=levels)
    assert found == pytest.approx(interval)


def test_a_level_surface_has_contours_of_a_tenth_of_a_millimeter() -> None:
    """By default heights have eight intervals; equal heights have the smallest one."""
    raster: Any = SimpleNamespace(height=np.ones(5), own=np.full(5, 1e-6))
    assert drawing_set.contour_interval(raster) == pytest.approx(1e-4)
    raster.height = np.linspace(0.0, 1.6, 1001)
    # 98 % of 1.6 m in eight parts are 196 mm.
    assert drawing_set.contour_interval(raster) == pytest.approx(0.2)


def captured_body(
    monkeypatch: pytest.MonkeyPatch, body: Revolution
) -> tuple[dict[str, Any], Any]:
    """Return the mesh of a body, as deviations from it are computed."""
    seen: dict[str, Any] = {}

    def deviation(surface: Any, vertices: Any, faces: Any, **words: Any) -> str:
        seen.update(words, surface=surface, vertices=vertices, faces=faces)
        return "deviation"

    surface = replace(SURFACE, shared=np.full(len(SURFACE.own), 1e-3))
    monkeypatch.setattr(products, "surface", lambda image: surface)
    monkeypatch.setattr(products, "deviation", deviation)
    nothing: Any = None
    assert drawing_set.from_body(nothing, body) == "deviation"
    return seen, surface


def test_a_body_of_revolution_is_a_tube_of_triangles(monkeypatch) -> None:
    """Rings of 360 corners lie about the axis, and triangles join them all around."""
    body = body_of()
    seen, surface = captured_body(monkeypatch, body)
    axis, point = np.array([0.6, -0.8, 0.0]), np.array([0.1, 0.2, 2.0])
    rings = seen["vertices"].reshape(3, 360, 3) - point
    heights = np.broadcast_to(body.height[:, None], (3, 360))
    assert_allclose(rings @ axis, heights, atol=1e-12)
    across = rings - (rings @ axis)[..., None] * axis
    assert_allclose(
        np.linalg.norm(across, axis=-1), np.broadcast_to(body.radius[:, None], (3, 360))
    )
    # Neighbors are one degree apart, the last and the first one, too.
    turns = np.einsum("rni,rni->rn", across, np.roll(across, 1, axis=1))
    assert_allclose(turns / body.radius[:, None] ** 2, np.cos(np.radians(1.0)))
    faces = seen["faces"]
    assert faces.shape == (2 * 2 * 360, 3)
    edges = Counter(
        tuple(sorted(edge))
        for a, b, c in faces.tolist()
        for edge in ((a, b), (b, c), (c, a))
    )
    # Edges are those of two triangles, but for the rims at both ends.
    rims = {edge for edge, count in edges.items() if count == 1}
    assert set(edges.values()) == {1, 2}
    assert rims == {
        tuple(sorted((first + n, first + (n + 1) % 360)))
        for first in (0, 720)
        for n in range(360)
    }
    area = np.linalg.norm(
        np.cross(
            seen["vertices"][faces[:, 1]] - seen["vertices"][faces[:, 0]],
            seen["vertices"][faces[:, 2]] - seen["vertices"][faces[:, 0]],
        ),
        axis=1,
    ).sum() / 2  # fmt: skip
    # Two frustums of a cone: pi (r + R) s.
    slants = np.hypot(0.01, [0.05, 0.07])
    assert area == pytest.approx(np.pi * 0.11 * slants.sum(), rel=1e-3)
    # Errors that all pixels share move the body, too.
    assert np.all(seen["surface"].shared == 0)
    assert seen["shared"].reshape(3, 360).tolist() == [[e] * 360 for e in
                                                       (1e-3, 2e-3, 3e-3)]  # fmt: skip
    assert seen["reference"] is surface.frame


class Drawn:
    """Recorder of sheets that are not drawn."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.sheets: list[dict[str, Any]] = []
        monkeypatch.setattr(drawing_set, "sheet", self._sheet)

    def _sheet(self, *words: Any, **more: Any) -> Figure:
        self.sheets.append({"words": words} | more)
        return Figure()


def test_an_elevation_has_its_contours_and_their_statement_first(monkeypatch) -> None:
    """The sheet is a relief; the lines of the drawing are the contours."""
    drawn = Drawn(monkeypatch)
    order = Order(product="drawings", contours=0.01, dots_per_inch=60.0)
    page = drawing_set._elevation(WALL, SURFACE, FRONT, order, ("Wall", ["made"]))
    (sheet,) = drawn.sheets
    raster, block = sheet["words"]
    assert (sheet["show"], sheet["scale"]) == ("relief", 1.0)
    # 0.12 m wide, sloping by 0.3 / 0.954: levels from -1.59 to -1.56 m.
    assert [round(line.level, 6) for line in sheet["contours"]] == [
        -1.59, -1.58, -1.57, -1.56
    ]  # fmt: skip
    assert block is page.block
    assert block.statements == (
        "Contours every 10 mm",
        drawings.relief_statement(raster),
        drawings.raster_statement(raster),
        "made",
    )
    assert block.title == "Wall"
    assert page.lines is not None
    assert len(page.lines.drawing.lines) == 4
    # 0.126 m of slope seen over cells of 1/60 inch.
    assert raster.cell == pytest.approx(0.0254 / 60)
    size, _, levels = page.summary.partition(", ")
    wide, high = (float(text.removesuffix(" m")) for text in size.split(" x "))
    assert (wide, high) == pytest.approx((0.126, 0.084), abs=3e-3)
    assert levels == "4 contour lines at 4 levels"


def test_an_elevation_without_contours_says_so(monkeypatch) -> None:
    """A grazing view is a statement and a part of the summary."""
    drawn = Drawn(monkeypatch)
    monkeypatch.setattr(drawings, "grazing_warning", lambda *_: ["Warning: edge-on"])
    order = Order(product="drawings", contours=5.0, dots_per_inch=60.0)
    page = drawing_set._elevation(WALL, SURFACE, FRONT, order, ("Wall", ["made"]))
    assert drawn.sheets[0]["contours"] == []
    assert page.lines is None
    assert page.block.statements[2:] == ("Warning: edge-on", "made")
    assert page.summary.endswith(" m, no contour lines; Warning: edge-on")


def test_contours_of_an_elevation_are_rounded_by_default(monkeypatch) -> None:
    """Eight parts of some 38 mm are 5 mm."""
    Drawn(monkeypatch)
    order = Order(product="drawings", dots_per_inch=60.0)
    page = drawing_set._elevation(WALL, SURFACE, FRONT, order, ("Wall", []))
    assert page.block.statements[0] == "Contours every 5 mm"


def test_a_body_is_compared_with_if_no_reference_is_stated(monkeypatch) -> None:
    """The page names the reference, and which errors it shares with the scan."""
    told: list[tuple[Any, ...]] = []
    parts = drawing_set.references
    monkeypatch.setattr(parts, "compare", lambda surface, order: "against")
    monkeypatch.setattr(drawing_set, "from_body", lambda *_: SURFACE)
    monkeypatch.setattr(parts, "described", lambda *words: told.append(words))
    monkeypatch.setattr(parts, "deviation_sheet", lambda *_: ("figure", "block"))
    monkeypatch.setattr(parts, "summary_of", lambda _: "sum")
    image: Any = None
    order = Order(product="drawings", against=Path("x/model.ply"))
    said: Any = ("Wall", [])
    body = body_of()
    page = drawing_set._deviation(image, SURFACE, order, said, body)
    assert (page.figure, page.block) == ("figure", "block")
    assert page.summary == "from model.ply: sum"
    order = replace(order, against=None)
    # `SURFACE` stands for the deviation, whose surface is replaced.
    monkeypatch.setattr(drawing_set, "replace", lambda deviation, surface: surface)
    page = drawing_set._deviation(image, SURFACE, order, said, body)
    assert page.summary == "from the fitted surface of revolution: sum"
    assert told == [
        ("against", said, "model.ply", "The reference's own place counts as known"),
        (SURFACE, said, "the fitted surface of revolution",
         "The body is fitted to the same scan: errors of the distance that all pixels "
         "share move both. The uncertainty is that of pixel and radius"),
    ]  # fmt: skip


def page_of(title: str, lines: Any = None) -> Page:
    """Return a page with an empty sheet."""
    block = TitleBlock(title=title, statements=("s",), fields={"author": "D"})
    return Page(figure=Figure(), block=block, summary=f"sum {title}", lines=lines)


def test_pages_are_one_file_and_a_file_each(monkeypatch, tmp_path) -> None:
    """Pages with lines have a DXF file, too; the PDF file has the title of the set."""
    written: list[tuple[Any, ...]] = []
    monkeypatch.setattr(
        drawings, "save_pages", lambda *words, overwrite: written.append(words)
    )
    monkeypatch.setattr(
        drawings, "save_sheet", lambda *words, overwrite: written.append(words)
    )
    lines = SimpleNamespace(write=lambda path, overwrite: written.append((path,)))
    pages = {"plan": page_of("one", lines), "map": page_of("two")}
    found = drawing_set.write_pages(pages, tmp_path / "s.pdf", "All", overwrite=False)
    assert found == ["  s_plan.svg, s_plan.dxf: sum one", "  s_map.svg: sum two"]
    one, two = pages.values()
    assert written == [
        ([one.figure, two.figure], tmp_path / "s.pdf", replace(one.block, title="All")),
        (one.figure, tmp_path / "s_plan.svg", one.block),
        (tmp_path / "s_plan.dxf",),
        (two.figure, tmp_path / "s_map.svg", two.block),
    ]


@pytest.mark.parametrize("name", ["s.pdf", "s_a.svg", "s_b.svg", "s_a.dxf", "s_b.dxf"])
def test_each_file_of_a_set_is_checked_before_the_work(tmp_path, name) -> None:
    """A file that exists is kept unless it may be replaced."""
    path = tmp_path / "s.pdf"
    drawing_set.check_files(path, ["a", "b"], overwrite=False)
    (tmp_path / name).touch()
    drawing_set.check_files(path, ["a", "b"], overwrite=True)
    with pytest.raises(FormatError, match=f"{name} exists already"):
        drawing_set.check_files(path, ["a", "b"], overwrite=False)


@pytest.mark.parametrize(
    ("side", "body", "against", "names"),
    [
        ("front", False, False, ["elevation", "section"]),
        ("top", False, True, ["plan", "section", "deviation"]),
        ("front", True, False, ["elevation", "section", "profile", "deviation"]),
    ],
)
def test_a_set_has_the_sheets_that_a_scan_allows(
    monkeypatch, side: Any, body: bool, against: bool, names: list[str]
) -> None:
    """Sheets are numbered, drawn in order at one scale, and named in the result."""
    steps: list[tuple[str, float]] = []
    orders: dict[str, Order] = {}

    def page(name: str) -> Any:
        def make(*words: Any, **more: Any) -> Page:
            orders[name] = next(word for word in words if isinstance(word, Order))
            return page_of(name)

        return make

    fitted = (body_of(), "") if body else (None, "not round")
    monkeypatch.setattr(drawing_set, "_body_of", lambda image: fitted)
    monkeypatch.setattr(drawing_set, "_scale_of", lambda *_: 4.0)
    monkeypatch.setattr(drawing_set, "tell", lambda *words: steps.append(words))
    monkeypatch.setattr(drawing_set, "_elevation", page(names[0]))
    monkeypatch.setattr(drawing_set, "_deviation", page("deviation"))
    monkeypatch.setattr(drawing_set, "lines_page", lambda page: page)
    monkeypatch.setattr(drawings, "section", page("section"))
    monkeypatch.setattr(drawings, "profile", page("profile"))
    monkeypatch.setattr(drawing_set, "check_files", lambda *_, **__: None)
    monkeypatch.setattr(
        drawing_set,
        "write_pages",
        lambda pages, path, title, overwrite: [f"{title}: {name}" for name in pages],
    )
    order = Order(
        product="drawings", side=side, fields={"author": "D"},
        against=Path("m.ply") if against else None,
    )  # fmt: skip
    image: Any = None
    said = drawing_set.write_set(
        image, SURFACE, Path("s.pdf"), order, ("Wall", []), overwrite=False
    )
    assert said.splitlines() == [
        f"{len(names)} sheets at 1:4",
        *(f"Wall: {name}" for name in names),
        *([] if body else ["  no half-profile: not round"]),
    ]
    assert list(orders) == names
    assert [order.fields for order in orders.values()] == [
        {"sheet": f"{number} of {len(names)}", "author": "D"}
        for number in range(1, len(names) + 1)
    ]
    assert {order.scale for order in orders.values()} == {4.0}
    # Without a stated line the section goes through the middle, 0.126 m wide.
    line = orders["section"].line
    assert line is not None
    assert steps == [
        ("drawing", pytest.approx(0.2 + 0.6 * n / len(names)))
        for n in range(len(names))
    ]


def test_a_stated_section_line_is_cut(monkeypatch) -> None:
    """The line of the order goes before the one through the middle."""
    lines: list[Any] = []
    monkeypatch.setattr(drawing_set, "_body_of", lambda image: (None, ""))
    monkeypatch.setattr(drawing_set, "_elevation", lambda *_: page_of("e"))
    monkeypatch.setattr(drawing_set, "lines_page", lambda page: page)
    monkeypatch.setattr(
        drawings, "section",
        lambda surface, plane, order, remarks: lines.append(order.line) or page_of("s"),
    )  # fmt: skip
    monkeypatch.setattr(drawing_set, "write_pages", lambda *_, **__: [])
    image: Any = None
    stated = (0.0, 0.1, 0.2, 0.3)
    for line in (stated, None):
        order = Order(product="drawings", scale=1.0, line=line)
        drawing_set.write_set(
            image, SURFACE, Path("s.pdf"), order, ("", []), overwrite=True
        )
    assert lines == [stated, drawing_set.middle_line(SURFACE, FRONT)]


def test_sheets_have_300_dots_per_inch(tmp_path) -> None:
    """A PNG file of two by one inches; an SVG file has no date."""
    block = TitleBlock(title="t", statements=(), fields={})
    figure = Figure(figsize=(2, 1))
    drawings.save_sheet(figure, tmp_path / "a.png", block, overwrite=False)
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (600, 300)
    drawings.save_sheet(figure, tmp_path / "a.svg", block, overwrite=False)
    assert "dc:date" not in (tmp_path / "a.svg").read_text()
    with pytest.raises(FormatError, match=r"a\.svg exists already"):
        drawings.save_sheet(figure, tmp_path / "a.svg", block, overwrite=False)
