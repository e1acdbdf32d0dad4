"""Paper of a drawing sheet: its size, title block, grid, labels and ellipses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drawn_sheets import EMPTY_BLOCK, on_paper, step
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.transforms import Bbox
from numpy.testing import assert_allclose

from amulor.errors import FormatError
from amulor.imaging.products import Contour
from amulor.io.drawings import FIELDS, Drawing
from amulor.view import sheet as sheets
from amulor.view.style import style

#: Sheets of ISO 216, short and long side [mm].
ISO = {
    "A4": (210, 297), "A3": (297, 420), "A2": (420, 594), "A1": (594, 841),
    "A0": (841, 1189),
}  # fmt: skip


@pytest.fixture(name="step")
def _step() -> Drawing:
    return step()


@pytest.mark.parametrize("degrees", [0.0, 30.0, 120.0])
def test_an_error_ellipse_has_the_axes_of_its_covariance(degrees: float) -> None:
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    covariance = turn @ np.diag([9e-6, 4e-6]) @ turn.T
    drawn = sheets.error_ellipse((1.0, 2.0), covariance, factor=10, colour="#ff0000")
    assert drawn.center == (1.0, 2.0)
    # Twice 3 and 2 mm, enlarged ten times.
    assert (drawn.width, drawn.height) == pytest.approx((0.06, 0.04))
    assert drawn.angle % 180 == pytest.approx(degrees % 180, abs=1e-6)
    assert not drawn.get_fill()
    assert to_hex(drawn.get_edgecolor()) == "#ff0000"
    flat = sheets.error_ellipse((0, 0), np.diag([1.0, -1e-9]), factor=1, colour="k")
    assert (flat.width, flat.height) == (2.0, 0.0)


@pytest.mark.parametrize("paper", list(ISO))
def test_an_object_is_drawn_at_1_to_1_until_the_paper_is_full(paper: str) -> None:
    short, long = np.array(ISO[paper]) / 1e3
    # 42 mm beside the drawing, and 132 mm below for the title block.
    for wide, high in ((short - 0.042, long - 0.132), (long - 0.042, short - 0.132)):
        assert sheets.fitting_scale(wide, high, paper=paper) == 1
        assert sheets.fitting_scale(1.02 * wide, high, paper=paper) == 2
        assert sheets.fitting_scale(wide, 1.02 * high, paper=paper) == 2
    assert sheets.fitting_scale(0.01, 0.01, paper=paper) == 1


def test_the_largest_raster_of_an_a3_sheet_leaves_room_for_its_block() -> None:
    wide, high = sheets.largest_on_a3()
    # Borders of 10 mm, numbers of 16 mm, 3 mm around, and 15 lines of 3.1 mm.
    assert wide == pytest.approx((420 - 20 - 16 - 6) / 1e3)
    assert high == pytest.approx((297 - 20 - 16 - 6 - EMPTY_BLOCK - 46.5) / 1e3)


@pytest.mark.parametrize(
    ("wide", "high", "name", "size"),
    [(261, 129, "A4", (297, 210)), (261.1, 129, "A3", (420, 297)),
     (174, 216, "A4", (210, 297)), (174.1, 216, "A3", (420, 297)),
     (174, 216.1, "A3", (297, 420)), (384, 216, "A3", (420, 297)),
     (384.1, 216, "A2", (594, 420)), (805, 1108, "A0", (841, 1189)),
     (1153, 760, "A0", (1189, 841))],
)  # fmt: skip
def test_a_drawing_gets_the_smallest_sheet_with_room(wide, high, name, size) -> None:
    # 36 mm beside the drawing; borders, numbers and an empty block are 81 mm high.
    found = sheets._paper(wide, high, [], 1.0, 16.0)
    assert found == (name, *size, [])
    # A key plan is higher than a scale bar.
    assert sheets._paper(wide, high - 14, [], 1.0, 30.0)[0] == name


def test_a_drawing_beyond_a0_states_the_size_it_needs() -> None:
    with pytest.raises(FormatError) as refused:
        sheets._paper(2000.0, 3000.0, ["one"], 5.0, 16.0)
    assert str(refused.value) == (
        "at 1:5 the drawing needs 2036 x 3084 mm, more than an A0 sheet; take a "
        "smaller scale, such as 1:20"
    )


@pytest.mark.parametrize(("width", "letters"), [(210, 137), (297, 202)])
def test_statements_are_wrapped_to_the_width_of_the_block(width, letters) -> None:
    # Letters of 1.34 mm within borders of 10 mm and margins of 3 mm.
    row = "a" * (letters - 3) + " b"
    assert sheets._wrapped([row + "c", "next"], width) == [row + "c", "next"]
    assert sheets._wrapped([row + "cd"], width) == [row[:-2], "   bcd"]


def test_plot_axes_stand_in_the_middle_of_the_room_above_the_block(step) -> None:
    paper = sheets._Paper((0.2, 0.5, 1.0, 1.2), step, scale=2.0, heights=0.5)
    assert (paper.name, paper.width, paper.height) == ("A4", 297, 210)
    assert paper.below == pytest.approx(10 + EMPTY_BLOCK)
    # 150 mm wide and 50 mm high; 16 mm at the left and below are for numbers.
    left = 26 + (297 - 36 - 150) / 2
    low = 55 + 16 + (210 - 10 - 55 - 16 - 50) / 2
    assert_allclose(on_paper(paper.axis), [left, low, left + 150, low + 50])
    assert (paper.axis.get_xlim(), paper.axis.get_ylim()) == ((0.2, 0.5), (1.0, 1.2))
    assert_allclose(paper.figure.get_size_inches() * 25.4, [297, 210])


@pytest.mark.parametrize(
    ("high", "heights", "labels", "rotation"),
    [(0.2, 1.0, ["0.00", "0.02", "0.04"], 90), (0.03, 1.0, ["0.00", "0.01"], 90),
     (0.009, 1.0, ["0.000", "0.005"], 0), (0.009, 3.0, ["0.000", "0.005"], 90)],
)  # fmt: skip
def test_upward_coordinates_are_turned_where_there_is_room(
    step, high, heights, labels, rotation
) -> None:
    with style():  # which hides two of the spines
        paper = sheets._Paper((0.0, 0.1, 0.0, high), step, scale=1.0, heights=heights)
        paper.grid(("east", "up"))
    shown = paper.axis.get_yticklabels()
    assert [text.get_text() for text in shown][: len(labels)] == labels
    assert {text.get_rotation() for text in shown} == {rotation}
    assert {text.get_verticalalignment() for text in shown} == {"center"}
    assert all(line.get_visible() for line in paper.axis.get_xgridlines())
    assert paper.axis.get_axisbelow() is False
    assert all(spine.get_visible() for spine in paper.axis.spines.values())


@pytest.mark.parametrize(
    ("scale", "wide", "last"), [(5.0, 0.5, "0.5"), (100.0, 20.0, "20"),
                                (500.0, 90.0, "90")],
)  # fmt: skip
def test_coordinates_have_the_digits_of_their_step(step, scale, wide, last) -> None:
    paper = sheets._Paper((0.0, wide, 0.0, wide / 3), step, scale=scale)
    paper.grid(("east", "up"))
    assert paper.axis.get_xticklabels()[-1].get_text() == last


def test_a_title_block_has_its_texts_at_their_places(step) -> None:
    filled = replace(
        step, title="word " * 30, statements=("first", "second"),
        fields={"project": "long " * 30, "sheet": "3"},
    )  # fmt: skip
    paper = sheets._Paper((0.0, 0.1, 0.0, 0.05), filled, scale=2.0, heights=1.5)
    top = 10 + EMPTY_BLOCK + 2 * 3.1
    assert paper.below == pytest.approx(top)
    paper.block([("#ffffff", "", "entry")], arrow="north")
    (frame,) = (axis for axis in paper.figure.axes if axis is not paper.axis)
    assert_allclose(on_paper(frame), [0, 0, 297, top])
    assert (frame.get_xlim(), frame.get_ylim()) == ((0, 297), (0, top))
    assert not frame.axison
    assert_allclose(frame.patches[0].get_bbox().extents, [10, 10, 287, top])
    places = {text.get_text(): text.get_position() for text in frame.texts}
    # A third of the width in letters, and a cell of 69.25 mm in letters of 1.34 mm.
    title = " ".join(["word"] * 19) + " ..."
    project = " ".join(["long"] * 9) + " ..."
    line = top - 9 - 17
    expected = {
        title: (13, top - 4.5), "1:2 on A4, heights x 1.5": (284, top - 4.5),
        "north": (76, line - 11.8), "entry": (91.5, line - 3.5),
        "first\nsecond": (13, line - 16), "project": (11.5, top - 10),
        project: (11.5, top - 9 - 7.3), "3": (11.5 + 3 * 69.25, top - 9 - 7.3),
        "view": (11.5 + 3 * 69.25, top - 18.5), "0": (16, line - 8),
        "50": (41, line - 8), "100 mm": (66, line - 8),
    }  # fmt: skip
    expected |= {
        name: (11.5 + 69.25 * (n % 4), top - 10 - 8.5 * (n // 4))
        for n, name in enumerate(FIELDS)
    }
    blank = places.pop("", None)
    assert blank is not None
    arrow = [text for text in frame.texts if getattr(text, "arrow_patch", None)]
    assert [(a.xy, a.xyann) for a in arrow] == [((76, line - 2.5), (76, line - 11))]
    assert set(places) == set(expected)
    for words, place in expected.items():
        assert places[words] == pytest.approx(place), words
    colored = next(p for p in frame.patches if to_hex(p.get_facecolor()) == "#ffffff"
                   and p.get_gid() is None and p.get_fill())  # fmt: skip
    assert_allclose(colored.get_bbox().extents, [86, line - 4.8, 90, line - 2.2])
    bars = [p for p in frame.patches if p.get_gid() == "scale-bar"]
    assert {(p.get_y(), p.get_height()) for p in bars} == {(line - 7, 1.6)}
    (rule,) = frame.lines
    assert_allclose(rule.get_xydata(), [[10, line], [287, line]])


def test_a_color_scale_stands_in_the_block(step) -> None:
    paper = sheets._Paper((0.0, 0.1, 0.0, 0.05), step, scale=1.0)
    paper.colour_bar("deviation", (-2.0, 6.0), "mm")
    bar = paper.figure.axes[-1]
    low = 55 - 9 - 17 - 8.5
    assert_allclose(on_paper(bar), [231, low, 281, low + 2.4])
    assert bar.images[0].get_cmap().name == "RdBu_r"
    assert np.asarray(bar.images[0].get_array()).shape == (1, 256)
    assert list(bar.get_yticks()) == []
    assert 3 <= len(bar.get_xticks()) <= 5


def test_a_contour_has_its_height_at_the_longest_line_of_its_level() -> None:
    axis = Figure().add_subplot()
    lines = [
        Contour(level=0.5, uncertainty=1e-3,
                points=np.stack([np.linspace(0, 1, count), np.full(count, y)], axis=1))
        for count, y in ((5, 0.0), (7, 1.0), (6, 2.0))
    ]  # fmt: skip
    sheets._contour_lines(axis, lines, 10.0)
    assert len(axis.lines) == 3
    (text,) = axis.texts
    assert (text.get_text(), text.get_position()) == ("0.5", (0.5, 1.0))


def test_a_label_has_the_direction_of_the_line_three_points_around() -> None:
    axis = Figure().add_subplot()
    points = np.zeros((11, 2))
    points[:, 0] = np.arange(11)
    points[2, 1], points[8, 1] = -3.0, 3.0
    sheets._label(axis, points, "x")
    sheets._label(axis, np.array([[0.0, 0.0], [5.0, 0.0], [1.0, 1.0]]), "y")
    long, short = axis.texts
    assert long.get_rotation() == pytest.approx(45)
    assert long.get_position() == (5.0, 0.0)
    assert short.get_rotation() == pytest.approx(45)
    assert long.get_clip_on()
    assert (long.get_ha(), long.get_va()) == ("center", "center")


def test_the_part_of_a_box_that_another_one_covers() -> None:
    box = Bbox.from_extents(0, 0, 4, 2)
    assert sheets._common(box, Bbox.from_extents(3, 1, 9, 9)) == pytest.approx(1 / 8)
    assert sheets._common(box, Bbox.from_extents(-1, -1, 9, 9)) == 1.0
    assert sheets._common(box, Bbox.from_extents(5, 0, 6, 1)) == 0.0


def _labelled(*places: tuple[float, float]) -> tuple[Axes, list]:
    """Return axes of 0 to 10 with centered labels at places."""
    axis = Figure(figsize=(6, 6)).add_axes((0.1, 0.1, 0.8, 0.8))
    axis.set_xlim(0, 10)
    axis.set_ylim(0, 10)
    labels = [
        axis.annotate("name", place, xytext=(9, 8), textcoords="offset points",
                      ha="center", va="center", fontsize=7)
        for place in places
    ]  # fmt: skip
    return axis, labels


def test_a_single_label_stands_4_points_beside_its_place() -> None:
    axis, (label,) = _labelled((5.0, 5.0))
    sheets.separate(axis, [label], [])
    wide = label.get_window_extent().width * 72 / 100
    assert_allclose(label.get_position(), (wide / 2 + 4, 0.0), rtol=1e-6)
    assert len(axis.lines) == 0


@pytest.mark.parametrize(
    ("place", "signs"),
    [((10, 10), (-1, -1)), ((0, 10), (1, -1)), ((0, 0), (1, 1)), ((10, 0), (-1, 1)),
     ((10, 5), (-1, 0)), ((5, 0), (0, 1)), ((5, 10), (0, -1))],
)  # fmt: skip
def test_a_label_at_an_edge_stands_inside(place, signs) -> None:
    axis, (label,) = _labelled(place)
    sheets.separate(axis, [label], [])
    assert tuple(np.sign(np.round(label.get_position(), 6))) == signs


def test_labels_of_one_place_do_not_cover_each_other() -> None:
    axis, labels = _labelled(*[(5.0, 5.0)] * 11)
    sheets.separate(axis, labels, [])
    boxes = [label.get_window_extent() for label in labels]
    covered = [
        sheets._common(one, other)
        for k, one in enumerate(boxes) for other in boxes[k + 1 :]
    ]  # fmt: skip
    assert max(covered) < 1e-3
    # Those more than 13 points away have a line to their place.
    far = [n for n, label in enumerate(labels) if _away(label) > 13]
    assert 0 < len(far) < 11
    assert len(axis.lines) == len(far)
    for line, n in zip(axis.lines, far, strict=True):
        place, end = axis.transData.transform(line.get_xydata())
        assert_allclose(end, (boxes[n].p0 + boxes[n].p1) / 2, atol=0.5)
        assert_allclose(place, axis.transData.transform((5, 5)))


def _away(label) -> int:
    """Distance of a label from its place, straight or at 45 degrees [pt]."""
    half = np.array(label.get_window_extent().size) / 2 * 72 / 100
    for away in (4, 8, 13, 19, 26, 34):
        parts = np.abs(label.get_position()) / (half + away)
        if any(np.allclose(parts, of) for of in ([1, 0], [0, 1], [0.70711, 0.70711])):
            return away
    raise AssertionError(label.get_position())


def test_a_label_leaves_a_mark_uncovered() -> None:
    axis, (label,) = _labelled((5.0, 5.0))
    mark = axis.add_patch(Rectangle((5.05, 5.0), 5, 5))
    sheets.separate(axis, [label], [mark])
    assert tuple(np.sign(np.round(label.get_position(), 6))) == (-1, 0)
