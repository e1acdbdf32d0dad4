"""Sheets are true to scale, carry their title block, and have readable letters."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import exact_scenes as scenes
import ezdxf
import numpy as np
import pytest
from matplotlib.figure import Figure
from project_files import project_text

from amulor import imaging
from amulor.cli import main
from amulor.errors import FormatError
from amulor.handover import Order, drawings, hand_over
from amulor.imaging import products
from amulor.imaging.products import Contour
from amulor.io.drawings import FIELDS, Drawing, Line
from amulor.view.sheet import (
    Annotations,
    Station,
    _around,
    _contour_lines,
    _label,
    _Paper,
    _scale_bar,
    annotate,
    colours_of,
    fitting_scale,
    line_sheet,
)

SVG = "{http://www.w3.org/2000/svg}"
PROJECT = project_text(
    {"a": ("a.nc", '["raw.nc"]', "")},
    title="Harbour basin",
    monument="Amphora field",
    operator="A. Diver",
    find_number="HB 17",
    institution="Institute of Marine Archaeology",
)


def texts_of(path: Path) -> list[ET.Element]:
    return list(ET.parse(path).iter(f"{SVG}text"))


def letters_of(text: ET.Element) -> float:
    """Return the height of the letters [pt]."""
    size = re.search(r"(?:font-size:|font:[^;]*?)\s*([\d.]+)px", text.get("style", ""))
    assert size is not None, text.attrib
    return float(size[1])


def words_of(figure: Figure) -> list[str]:
    return [text.get_text() for axis in figure.axes for text in axis.texts]


@pytest.fixture
def steps():
    """Return a step of 40 mm that begins 20 mm from the left."""
    points = np.array([[0.0, -1.5], [0.02, -1.5], [0.02, -1.46], [0.1, -1.46]])
    line = Line(points=points, layer="section", band=np.full(4, 5e-4))
    return Drawing(
        title="Step",
        lines=(line,),
        axes=("along", "nearer"),
        statements=("a statement",) * 3,
    )


@pytest.mark.parametrize(("scale", "heights"), [(1.0, 1.0), (2.0, 1.0), (2.0, 3.0)])
def test_lengths_on_paper_are_those_of_the_object(steps, scale, heights) -> None:
    figure = line_sheet(steps, scale=scale, heights=heights)
    axis = figure.axes[0]
    to_paper = axis.transData + figure.dpi_scale_trans.inverted()
    figure.draw_without_rendering()
    before, after = to_paper.transform(steps.lines[0].points[[0, 2]]) * 25.4
    np.testing.assert_allclose(after - before, [20 / scale, 40 * heights / scale])


def test_names_of_the_ends_stand_above_the_frame(steps) -> None:
    marked = replace(steps, marks=((0.0, "A"), (0.12, "A'")))
    figure = line_sheet(marked, scale=1.0)
    figure.draw_without_rendering()
    axis = figure.axes[0]
    assert axis.get_xlim() == (0.0, 0.12)
    marks = {text.get_text(): text for text in axis.texts}
    top = axis.get_window_extent().y1
    for name in ("A", "A'"):
        assert marks[name].get_window_extent().y0 > top


def test_a_low_section_has_two_heights_at_least() -> None:
    points = np.array([[0.0, -0.09], [2.0, 0.02], [4.0, 0.11]])
    low = Drawing(
        title="low", lines=(Line(points=points, layer="section"),), axes=("along", "up")
    )
    (axis, *_) = line_sheet(low, scale=20.0).axes
    # 4 to 10 mm on paper at 1:20 is 0.08 to 0.2 m.
    texts = [text.get_text() for text in axis.get_yticklabels()]
    assert texts == ["-0.1", "0.0", "0.1"]
    assert {text.get_rotation() for text in axis.get_yticklabels()} == {0.0}


def test_exaggerated_heights_are_stated(steps) -> None:
    stated = [
        t.get_text()
        for a in line_sheet(steps, scale=1, heights=2).axes
        for t in a.texts
    ]
    assert "1:1 on A4, heights x 2" in stated
    plain = [t.get_text() for a in line_sheet(steps, scale=1).axes for t in a.texts]
    assert "1:1 on A4" in plain


def test_a_drawing_larger_than_any_paper_names_a_scale_that_fits(steps) -> None:
    with pytest.raises(FormatError, match="smaller scale, such as 1:") as refused:
        line_sheet(steps, scale=0.01)
    scale = float(str(refused.value).rsplit(":", 1)[1])
    line_sheet(steps, scale=scale)


@pytest.mark.parametrize(
    ("wide", "high", "scale"),
    # A4 is 210 x 297 mm; a quarter of it is title block.
    [(0.1, 0.1, 1), (0.16, 0.16, 1), (0.18, 0.18, 2), (0.2, 0.05, 1), (1.5, 1.2, 10)],
)
def test_the_scale_without_an_option_fits_a4(wide, high, scale) -> None:
    assert fitting_scale(wide, high) == scale
    box = np.array([[0, 0], [wide, 0], [wide, high - 8e-3 * scale]])
    drawing = Drawing(
        title="", lines=(Line(points=box, layer="a"),), axes=("right", "up")
    )
    stated = [
        t.get_text() for a in line_sheet(drawing, scale=scale).axes for t in a.texts
    ]
    assert f"1:{scale} on A4" in stated


def test_the_title_block_has_the_fields_of_the_project(
    ladder_file, tmp_path, capsys
) -> None:
    project = tmp_path / "project.toml"
    project.write_text(PROJECT)
    path = tmp_path / "s.svg"
    words = ["--line=-6cm,0m,6cm,0m", "--project", str(project), "--sheet", "3 of 7"]
    assert main(["export", str(ladder_file), "-o", str(path), *words]) == 0
    texts = [text.text for text in texts_of(path)]
    assert set(FIELDS) <= set(texts)
    for value in (
        "Harbour basin",
        "Amphora field",
        "HB 17",
        "A. Diver",
        "Institute of Marine Archaeology",
        "2026-05-01 to 2026-05-02",
        "3 of 7",
        "section A-A', front elevation",
    ):
        assert value in texts, value
    assert {"A", "A'", "section line", "1:1 on A4"} <= set(texts)
    # Notes on a drawing are read on paper: 7 points and more.
    assert min(letters_of(text) for text in texts_of(path)) >= 7


def test_a_project_file_that_lacks_a_field_is_one_line(
    ladder_file, tmp_path, capsys
) -> None:
    project = tmp_path / "project.toml"
    project.write_text(PROJECT.replace('title = "Harbour basin"\n', ""))
    words = [str(ladder_file), "-o", str(tmp_path / "o.pdf"), "--project", str(project)]
    assert main(["export", *words]) == 1
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "project.title" in message
    assert not (tmp_path / "o.pdf").exists()


def test_letters_in_a_pdf_are_truetype(ladder, tmp_path) -> None:
    path = tmp_path / "o.pdf"
    hand_over(ladder, path, Order(product="orthoimage", dots_per_inch=60))
    content = path.read_bytes()
    assert b"/Type3" not in content
    assert b"/Subtype /CIDFontType2" in content or b"/TrueType" in content


def test_contours_state_their_heights(tmp_path) -> None:
    slope = scenes.plane((0.3, 0.0, 0.954), 1.5, own=2e-4)
    order = Order(product="contours", contours=0.01)
    hand_over(slope, tmp_path / "c.svg", order)
    texts = {text.text for text in texts_of(tmp_path / "c.svg")}
    # 0.12 m wide, sloping by 0.3 / 0.954, about -1.57 m high.
    assert {"-1.56", "-1.57", "-1.58"} <= texts


def test_the_map_of_uncertainty_shows_pixels_not_their_grid() -> None:
    wall = scenes.plane((0, 0, 1), 1.5, own=2e-4)
    surface = products.surface(wall)
    plane = products.plane_of(surface.frame)
    raster = products.raster(surface, plane, cell=surface.spacing / 8)
    # Between pixels, a mean of three has less noise: the raster has a grid.
    inner = raster.own[8:-8, 8:-8]
    assert np.ptp(inner) > 0.2 * inner.max()
    _, (low, high), unit = colours_of(raster, "uncertainty")
    largest = np.nanmax(raster.uncertainty) * 1e3
    assert unit == "mm"
    assert high == pytest.approx(largest, rel=0.01)
    assert low > 0.9 * high


def test_a_plan_of_an_upright_scan_warns(tmp_path) -> None:
    slope = scenes.plane((0.0, -0.6, 0.8), 1.5, own=2e-4)
    order = Order(product="dem", side="top")
    text = hand_over(slope, tmp_path / "top.pdf", order)
    angle = re.search(r"the beams meet this view at (\d+) degrees", text)
    assert angle is not None
    # Beams within 33 mrad of level, seen from above.
    assert 87 <= int(angle[1]) <= 90
    assert "--seen-from front" in text
    front = hand_over(slope, tmp_path / "front.pdf", Order(product="dem"))
    assert "beams meet" not in front


def test_doubtful_pixels_are_hatched(ladder, tmp_path) -> None:
    flagged = ladder.copy(deep=True)
    hand_over(flagged, tmp_path / "a.svg", Order(product="dem"))
    flagged["quality_flag"].values[5:9, 5:9] |= 1 << 5
    assert imaging.leave_out(flagged, good_only=True)["slant_range"].isnull().any()
    hand_over(flagged, tmp_path / "b.svg", Order(product="dem"))
    legends = [
        "doubtful pixels" in {text.text for text in texts_of(tmp_path / name)}
        for name in ("a.svg", "b.svg")
    ]
    assert legends == [False, True]


def test_a_half_profile_has_the_diameters_of_a_cone(tmp_path) -> None:
    image = scenes.cone(own=1e-5)
    order = Order(product="profile")
    text = hand_over(image, tmp_path / "p.csv", order)
    lines = (tmp_path / "p.csv").read_text().splitlines()
    rows = np.array(
        [[float(v) for v in line.split(",")] for line in lines if line[:1].isdigit()]
    )
    height, radius, sigma = rows.T
    slope = np.polyfit(height, radius, 1)[0]
    assert slope == pytest.approx(-0.2, abs=1e-4)
    assert (sigma > 0).all()
    stated = re.search(r"lower end ([\d.]+) ± ([\d.]+) mm", text)
    assert stated is not None
    assert float(stated[1]) == pytest.approx(2e3 * radius[0], abs=0.06)
    hand_over(image, tmp_path / "p.svg", order)
    texts = {t.text for t in texts_of(tmp_path / "p.svg") if t.text}
    assert any(t.startswith(f"Ø {stated[1]}") for t in texts)
    assert "half-profile and elevation" in texts
    hand_over(image, tmp_path / "p.dxf", order)
    space = ezdxf.readfile(tmp_path / "p.dxf").modelspace()
    lines = space.query('LWPOLYLINE[layer=="diameters"]')
    ends = [[float(place[0]) for place in line.get_points()] for line in lines]
    # Diameters stand on the side of the profile, from the surface to the axis.
    assert sorted(ends) == [
        pytest.approx([-value, 0.0], rel=1e-4, abs=1e-9)
        for value in sorted({radius[0], radius[-1], radius.max()}, reverse=True)
    ]


def test_heights_of_steep_contours_do_not_cover_each_other(tmp_path) -> None:
    # At 45 degrees, contours every 2 mm are 2 mm apart on paper at 1:1.
    slope = scenes.plane((0.707, 0.0, 0.707), 1.1, own=2e-4)
    order = Order(product="orthoimage", contours=0.002, scale=1.0, dots_per_inch=60)
    hand_over(slope, tmp_path / "c.svg", order)
    heights = {}
    for text in texts_of(tmp_path / "c.svg"):
        if re.fullmatch(r"-1\.\d+", text.text or ""):
            x, y = (float(text.get(name, "nan")) for name in "xy")
            heights[text.text] = np.array([x, y])
    assert len(heights) >= 3
    places = list(heights.values())
    apart = [
        np.linalg.norm(a - b)
        for number, a in enumerate(places)
        for b in places[number + 1 :]
    ]
    # 9 mm in points of 1/72 inch.
    assert min(apart) > 9 / 25.4 * 72 - 1


def test_a_half_profile_without_known_errors_has_no_nan() -> None:
    from amulor.handover import drawings

    assert drawings._diameter(0.1458, 0.00011) == "145.8 ± 0.11 mm"
    assert drawings._diameter(0.1458, float("nan")) == "145.8 mm (error not known)"


@pytest.mark.parametrize(("scale", "length"), [(1.0, 0.05), (2.0, 0.1), (50.0, 2.0)])
def test_a_scale_bar_has_four_parts_of_two_colours_in_turn(scale, length) -> None:
    axis = Figure().add_subplot()
    _scale_bar(axis, scale, (3.0, 5.0))
    bars = axis.patches
    # Paper is drawn in mm; the length is the next of 1, 2, 5 above 30 mm on paper.
    width = length / scale * 1e3
    assert [bar.get_x() for bar in bars] == pytest.approx(
        [3.0 + n * width / 4 for n in range(4)]
    )
    assert {round(bar.get_width(), 9) for bar in bars} == {round(width / 4, 9)}
    assert [bar.get_facecolor()[0] for bar in bars] == [0.0, 1.0, 0.0, 1.0]
    number, unit = (length, "m") if length >= 1 else (length * 1e3, "mm")
    texts = {text.get_text(): text.get_position()[0] for text in axis.texts}
    assert texts == pytest.approx(
        {
            "0": 3.0,
            f"{number / 2:g}": 3.0 + width / 2,
            f"{number:g} {unit}": 3.0 + width,
        }
    )


def test_entries_of_a_legend_stand_inside_the_frame_beside_their_colours(steps) -> None:
    legend = [("#ff0000", "", f"entry {n}") for n in range(5)]
    paper = _Paper((0.0, 0.1, 0.0, 0.05), steps, scale=1.0)
    paper.block(legend, arrow="north")
    (frame,) = (axis for axis in paper.figure.axes if axis is not paper.axis)
    texts = {text.get_text(): text.get_position() for text in frame.texts}
    boxes = [
        bar for bar in frame.patches if bar.get_facecolor() == (1.0, 0.0, 0.0, 1.0)
    ]
    outer = frame.patches[0].get_bbox()
    title, line = texts["Step"][1], float(frame.lines[0].get_ydata()[0])
    assert line == pytest.approx(paper.below - 9.0 - 2 * 8.5)
    for box, (_, _, words) in zip(boxes, legend, strict=True):
        corners = box.get_bbox()
        x, y = texts[words]
        # Paper is drawn in mm.
        assert corners.y0 < y < corners.y1
        assert 0 < x - corners.x1 < 3
        assert outer.x0 < corners.x0 < corners.x1 < outer.x1
        # Under the fields, in the 16 mm of the scale bar.
        assert line - 16 < corners.y0 < corners.y1 < line < title
    # Three in a column, from the top.
    places = [(bar.get_x(), bar.get_y()) for bar in boxes]
    columns = [places[:3], places[3:]]
    assert [len({x for x, _ in column}) for column in columns] == [1, 1]
    assert columns[0][0][0] < columns[1][0][0] - 40
    assert np.all(np.diff([y for _, y in columns[0]]) < -3)


@pytest.mark.parametrize("count", [1, 4, 9])
def test_statements_fill_the_title_block_to_its_lower_border(steps, count) -> None:
    told = replace(steps, statements=tuple(f"statement {n}" for n in range(count)))
    figure = line_sheet(told, scale=1.0)
    figure.draw_without_rendering()
    to_paper = figure.dpi_scale_trans.inverted()
    boxes = [
        to_paper.transform(text.get_window_extent()) * 25.4
        for axis in figure.axes
        for text in axis.texts
        if text.get_text().startswith("statement 0")
    ]
    ((low, high),) = [box[:, 1] for box in boxes]
    # Lines of 3.1 mm, 10 mm above the edge of the paper.
    assert high - low == pytest.approx(3.1 * count, abs=1.2)
    assert 11.5 < low < 15


@pytest.mark.parametrize(
    ("low", "high", "scale", "step"),
    # On paper 20 to 50 mm; 8 to 20 mm where a drawing is less than four steps wide, and
    # 4 to 10 mm where fewer than two places are left.
    [
        (0.0, 0.2, 1.0, 0.02),
        (0.0, 0.08, 1.0, 0.02),
        (0.0, 0.0799, 1.0, 0.01),
        (-3.0, 5.0, 50.0, 1.0),
        (0.001, 0.0099, 1.0, 0.005),
    ],
)
def test_a_grid_has_round_coordinates(low, high, scale, step) -> None:
    drawing = Drawing(title="", lines=(), axes=("right", "up"))
    paper = _Paper((low, high, low, high), drawing, scale=scale)
    paper.grid(("right", "up"))
    ticks = paper.axis.get_xticks()
    expected = np.arange(np.ceil(low / step), np.floor(high / step + 1e-9) + 1) * step
    assert ticks == pytest.approx(expected)
    texts = [text.get_text() for text in paper.axis.get_xticklabels()]
    assert [float(text) for text in texts] == pytest.approx(ticks)
    assert len({len(text.partition(".")[2]) for text in texts}) == 1
    assert paper.axis.get_xlabel() == "right [m]"
    assert paper.axis.get_ylabel() == "up [m]"


def test_fields_of_a_title_block_stand_in_two_rows_of_four_cells(steps) -> None:
    filled = replace(steps, fields={name: f"<{name}>" for name in FIELDS})
    paper = _Paper((0.0, 0.1, 0.0, 0.05), filled, scale=1.0)
    paper.block([], arrow="up")
    (frame,) = (axis for axis in paper.figure.axes if axis is not paper.axis)
    cells = [bar.get_bbox() for bar in frame.patches if not bar.get_fill()][1:]
    assert len(cells) == len(FIELDS) == 8
    # Rows of 8.5 mm, under a title of 9 mm, over the whole width within the border.
    top = paper.below - 9.0
    assert [cell.y1 for cell in cells] == pytest.approx([top] * 4 + [top - 8.5] * 4)
    assert {round(cell.height, 6) for cell in cells} == {8.5}
    width = (paper.width - 20.0) / 4
    assert [cell.x0 for cell in cells] == pytest.approx(
        [10.0 + width * column for column in (0, 1, 2, 3)] * 2
    )
    places = {text.get_text(): text.get_position() for text in frame.texts}
    for name, cell in zip(FIELDS, cells, strict=True):
        for words in (name, f"<{name}>"):
            x, y = places[words]
            assert cell.x0 < x < cell.x0 + 3
            assert cell.y0 < y < cell.y1
        # The name above the entry.
        assert places[name][1] > places[f"<{name}>"][1]


def test_a_colour_scale_runs_between_its_limits(steps) -> None:
    paper = _Paper((0.0, 0.1, 0.0, 0.05), steps, scale=1.0)
    paper.colour_bar("height", (-2.0, 6.0), "mm")
    bar = paper.figure.axes[-1]
    (image,) = bar.images
    assert tuple(image.get_extent()) == (-2.0, 6.0, 0.0, 1.0)
    values = np.asarray(image.get_array())[0]
    assert (values[0], values[-1]) == (0.0, 1.0)
    assert np.all(np.diff(values) > 0)
    assert bar.get_title(loc="right") == "height [mm]"
    # 50 mm long, 6 mm from the border of 10 mm.
    box = bar.get_position()
    assert box.width * paper.width == pytest.approx(50.0)
    assert box.x1 * paper.width == pytest.approx(paper.width - 16.0)


def test_annotations_stand_at_their_places() -> None:
    axis = Figure(figsize=(6, 6)).add_subplot()
    axis.set_xlim(0, 10)
    axis.set_ylim(0, 10)
    outline = np.array([[1.0, 1.0], [4.0, 1.0], [4.0, 5.0]])
    hole = np.array([[2.0, 2.0], [3.0, 2.0], [3.0, 3.0]])
    cut = np.array([[1.0, 8.0], [7.0, 8.0]])
    annotate(
        axis,
        Annotations(
            outlines=(("#ff0000", (outline, hole)),),
            stations={
                "s": Station(
                    position=np.array([5.0, 4.0]),
                    covariance=np.diag([4e-4, 1e-4]),
                    colour="#0000ff",
                )
            },
            enlarged=20.0,
            targets={"T": np.array([6.0, 2.0])},
            cuts={"A": cut},
            details={"1": (7.0, 9.0, 1.0, 3.0)},
        ),
    )
    lines = {line.get_gid(): line.get_xydata() for line in axis.lines}
    np.testing.assert_array_equal(lines["footprint"], outline)
    assert sum(line.get_gid() == "footprint" for line in axis.lines) == 1
    drawn = [np.asarray(line.get_xydata()).tolist() for line in axis.lines]
    for points in (hole, [[5.0, 4.0]], [[6.0, 2.0]], cut):
        assert np.asarray(points).tolist() in drawn
    boxes = {patch.get_gid(): patch for patch in axis.patches}
    ellipse = boxes["error-ellipse"]
    assert ellipse.get_center() == (5.0, 4.0)
    # Diameters: twice 20 mm and 10 mm, enlarged 20 times.
    assert (ellipse.get_width(), ellipse.get_height()) == pytest.approx((0.8, 0.4))
    assert boxes["detail"].get_bbox().extents.tolist() == [7.0, 1.0, 9.0, 3.0]
    texts = {text.get_text(): text for text in axis.texts}
    assert set(texts) == {"s", "T", "A", "A'", "1"}
    assert texts["A"].xy == (1.0, 8.0)
    assert texts["A'"].xy == (7.0, 8.0)
    assert texts["A"].get_position() == pytest.approx((-7.0, 0.0))
    assert texts["A'"].get_position() == pytest.approx((7.0, 0.0))
    assert (texts["s"].xy, texts["T"].xy) == ((5.0, 4.0), (6.0, 2.0))


def test_the_sheet_has_room_for_stations_and_letters() -> None:
    scan = (0.0, 4.0, 0.0, 3.0)
    assert _around(scan, None, 0.1) == pytest.approx((-0.1, 4.1, -0.1, 3.1))
    station = Station(
        position=np.array([-2.0, 1.0]), covariance=np.eye(2), colour="#000000"
    )
    cut = np.array([[1.0, 2.0], [1.0, 5.0]])
    annotations = Annotations(stations={"s": station}, cuts={"A": cut})
    # The letter stands one room beyond the end of its line.
    expected = (-2.1, 4.1, -0.1, 5.2)
    assert _around(scan, annotations, 0.1) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("length", "apart", "labels"),
    # Lines above 9 mm on paper have a height, unless another one is as near.
    [(8.9e-3, 0.02, 0), (9.1e-3, 0.02, 2), (0.02, 8.9e-3, 1), (0.02, 9.1e-3, 2)],
)
def test_heights_of_contours_are_apart_on_paper(length, apart, labels) -> None:
    axis = Figure().add_subplot()
    scale = 10.0
    along = np.linspace(0.0, length * scale, 21)
    contours = [
        Contour(
            level=level,
            points=np.stack([along, np.full(21, level_y)], axis=1),
            uncertainty=1e-3,
        )
        for level, level_y in ((-1.25, 0.0), (-1.2, apart * scale))
    ]
    _contour_lines(axis, contours, scale)
    assert len(axis.lines) == 2
    assert [text.get_text() for text in axis.texts] == ["-1.25", "-1.2"][:labels]
    for text in axis.texts:
        assert text.get_position()[0] == pytest.approx(length * scale / 2)


@pytest.mark.parametrize(
    ("direction", "rotation"), [(0, 0), (45, 45), (90, -90), (135, -45), (180, 0)]
)
def test_a_label_reads_from_left_to_right(direction, rotation) -> None:
    axis = Figure().add_subplot()
    angle = np.radians(direction)
    points = np.linspace(0, 1, 9)[:, None] * [np.cos(angle), np.sin(angle)]
    _label(axis, points, "1.2")
    (text,) = axis.texts
    # Upwards and downwards are both upright.
    off = (text.get_rotation() - rotation + 90) % 180 - 90
    assert off == pytest.approx(0, abs=1e-6)
    turned = (text.get_rotation() + 180) % 360 - 180
    assert -90.001 < turned < 90.001
    assert text.get_position() == pytest.approx(tuple(points[4]))


@pytest.mark.parametrize(("stated", "interval"), [(None, 0.01), (0.05, 0.05)])
def test_contours_are_10_mm_apart_unless_stated(monkeypatch, stated, interval) -> None:
    monkeypatch.setattr(products, "contours", lambda _, *, interval: (interval,))
    monkeypatch.setattr(drawings, "contour_product", lambda *given: given)
    order = SimpleNamespace(contours=stated)
    assert drawings.contours("raster", order, ("", [])) == (
        "raster", (interval,), interval, order, ("", [])
    )  # fmt: skip


@pytest.mark.parametrize(
    ("spacing", "cell"),
    [(0.9e-3, 1e-3), (1.3e-3, 1e-3), (1.6e-3, 2e-3), (4e-3, 5e-3), (7.5e-3, 1e-2)],
)
def test_a_cell_is_round_and_near_the_spacing_of_pixels(spacing, cell) -> None:
    surface = SimpleNamespace(spacing=spacing)
    order = Order(product="heights")
    assert drawings.cell_of(order, surface, 10.0) == pytest.approx(cell, rel=1e-12)
    stated = replace(order, cell=0.123)
    assert drawings.cell_of(stated, surface, 10.0) == 0.123


def test_a_cell_of_an_orthoimage_is_a_dot_on_paper() -> None:
    # A hundred dots per inch at 1:10 are 2.54 mm of the object.
    order = Order(product="orthoimage", dots_per_inch=100.0)
    cell = drawings.cell_of(order, SimpleNamespace(spacing=1.0), 10.0)
    assert cell == pytest.approx(2.54e-3, rel=1e-12)
