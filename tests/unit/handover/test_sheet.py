"""Sheets are true to scale, carry their title block, and have readable letters."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import exact_scenes as scenes
import ezdxf
import numpy as np
import pytest
from matplotlib.figure import Figure
from project_files import project_text

from amulor import imaging
from amulor.cli import main
from amulor.errors import FormatError
from amulor.handover import Order, hand_over
from amulor.imaging import products
from amulor.io.drawings import FIELDS, Drawing, Line
from amulor.view.sheet import (
    _Paper,
    _scale_bar,
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
    title = texts["Step"][1]
    for box, (_, _, words) in zip(boxes, legend, strict=True):
        corners = box.get_bbox()
        x, y = texts[words]
        # Paper is drawn in mm.
        assert corners.y0 < y < corners.y1
        assert 0 < x - corners.x1 < 3
        assert outer.x0 < corners.x0 < corners.x1 < outer.x1
        assert outer.y0 < corners.y0 < corners.y1 < title
    areas = {(round(b.get_x(), 6), round(b.get_y(), 6)) for b in boxes}
    assert len(areas) == len(legend)


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
