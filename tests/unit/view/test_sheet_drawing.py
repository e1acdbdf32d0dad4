"""Rasters and lines on a drawing sheet: colors, shading, legend and key plan."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from drawn_sheets import EMPTY_BLOCK, on_paper, raster_of, step
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.testing import assert_allclose

from amulor.errors import CubeError
from amulor.imaging.products import Contour
from amulor.io.drawings import Drawing, Line, TitleBlock
from amulor.view import sheet as sheets
from amulor.view.style import COLOURS


@pytest.fixture(name="step")
def _step() -> Drawing:
    return step()


def test_a_key_plan_has_the_section_line_with_its_letters(step) -> None:
    paper = sheets._Paper((0.0, 0.1, 0.0, 0.05), step, scale=1.0, bars=30.0)
    raster = raster_of(np.zeros((4, 10)))
    cut = np.array([[0.1, 0.395], [0.12, 0.395]])
    paper.key_plan(raster, cut, letter="C")
    plan = paper.figure.axes[-1]
    # Cells of 4.5 mm: ten of them are 45 mm wide.
    low = 10 + EMPTY_BLOCK + 14 - 9 - 17 - 18 - 8
    assert_allclose(on_paper(plan), [232, low, 277, low + 18])
    assert_allclose(plan.images[0].get_extent(), [0.1, 0.12, 0.392, 0.4])
    (line,) = plan.lines
    assert_allclose(line.get_xydata(), cut)
    assert not line.get_clip_on()
    names = {text.get_text(): (text.xy, text.get_position()) for text in plan.texts}
    assert names == {
        "C": ((0.1, 0.395), pytest.approx((-6, 0))),
        "C'": ((0.12, 0.395), pytest.approx((6, 0))),
    }
    assert not any(text.get_annotation_clip() for text in plan.texts)
    assert (list(plan.get_xticks()), list(plan.get_yticks())) == ([], [])
    assert plan.spines["top"].get_visible()
    assert plan.spines["right"].get_visible()
    assert plan.get_title() == "section line"
    tall = sheets._Paper((0.0, 0.1, 0.0, 0.05), step, scale=1.0, bars=30.0)
    tall.key_plan(raster_of(np.zeros((9, 2))), cut, letter="A")
    # 18 mm of height hold nine cells of 2 mm.
    left, _, right, _ = on_paper(tall.figure.axes[-1])
    assert right - left == pytest.approx(4)


@pytest.mark.parametrize(
    ("show", "unit", "colors"),
    [("amplitude", "mV", "gray"), ("height", "mm", "viridis"),
     ("uncertainty", "mm", "cividis")],
)  # fmt: skip
def test_colors_leave_out_one_percent_on_either_side(show, unit, colors) -> None:
    values = 1e-3 * np.arange(-1.0, 101.0)[None]
    values[0, 0] = np.nan
    raster = raster_of(values, amplitude=values, uncertainty=values,
                       surface=SimpleNamespace(spacing=1e-9))  # fmt: skip
    # A window of one cell would be even; three cells shift the maximum by one.
    shift = 1.0 if show == "uncertainty" else 0.0
    pixels, limits, stated = sheets.colours_of(raster, show)
    shown = np.minimum(np.arange(101) + shift, 100)
    low, high = np.percentile(shown, [1, 99])
    assert limits == pytest.approx((low, high))
    assert stated == unit
    assert pixels[0, 0].tolist() == [0, 0, 0, 0]
    middle = colormaps[colors]((50 + shift - low) / (high - low), bytes=True)
    assert pixels[0, 51].tolist() == list(middle)
    assert pixels[0, -1].tolist() == list(colormaps[colors](1.0, bytes=True))


def test_deviations_have_even_limits_and_gray_where_none_is_significant() -> None:
    height = np.array([[1.0, 1.0, 1.0, np.nan]])
    values = np.array([[-1e-3, 3e-3, np.nan, np.nan]])
    pixels, limits, unit = sheets.colours_of(
        raster_of(height), "deviation", values=values
    )
    # The 99th percentile of -1 and 3 mm.
    assert limits == pytest.approx((-2.96, 2.96))
    assert unit == "mm"
    assert pixels[0, 2].tolist() == [226, 226, 226, 255]
    assert pixels[0, 3].tolist() == [0, 0, 0, 0]
    negative = sheets.colours_of(raster_of(height), "deviation", values=-values)
    assert negative[1] == pytest.approx((-2.96, 2.96))
    with pytest.raises(ValueError, match=r"^deviations are needed to be shown$"):
        sheets.colours_of(raster_of(height), "deviation")


def test_colors_of_equal_or_unknown_values_are_defined() -> None:
    even = raster_of(np.full((2, 3), 0.25))
    assert sheets.colours_of(even, "height")[1] == (249.5, 250.5)
    with pytest.raises(CubeError) as refused:
        sheets.colours_of(raster_of(np.full((2, 3), np.nan)), "height")
    assert str(refused.value) == (
        "the height of no cell is known; show another quantity, or look at the flags "
        "of the range image with amulor info"
    )


@pytest.mark.parametrize(("spacing", "reach"), [(0.004, 1), (0.0041, 2), (0.009, 3)])
def test_an_uncertainty_is_the_largest_within_a_pixel(spacing, reach) -> None:
    values = np.full((1, 13), 1e-3)
    values[0, 6], values[0, 0] = 5e-3, np.nan
    raster = raster_of(np.zeros((1, 13)), uncertainty=values,
                       surface=SimpleNamespace(spacing=spacing))  # fmt: skip
    found = sheets._of_pixels(raster)[0]
    assert np.isnan(found[0])
    large = np.flatnonzero(found == 5e-3)
    assert (large[0], large[-1]) == (6 - reach, 6 + reach)
    assert set(found[1:]) == {1e-3, 5e-3}


def test_a_level_surface_is_shaded_evenly_to_the_edges_of_holes() -> None:
    height = np.full((6, 9), 5.0)
    height[2, 3] = np.nan
    shaded = sheets.relief(raster_of(height))
    # The sine of 40 degrees of the light.
    assert np.unique(shaded[..., :3]).tolist() == [int(255 * np.sin(np.radians(40)))]
    assert (shaded[..., 3] == 0).tolist() == np.isnan(height).tolist()
    assert set(shaded[..., 3].ravel()) == {0, 255}


@pytest.mark.parametrize("axis", [0, 1])
def test_slopes_are_lit_from_the_upper_left(axis: int) -> None:
    # A roof that slopes by 0.8 on either side of a level part.
    steps = np.r_[np.arange(12.0), np.full(12, 11.0), np.arange(11.0, -1, -1)]
    profile = 0.8 * 0.002 * steps
    roof = np.tile(profile, (8, 1))
    shaded = sheets.relief(raster_of(roof if axis else roof.T))[..., 0]
    line = shaded[4] if axis else shaded[:, 4]
    high, side = np.sin(np.radians(40)), 0.8 * np.cos(np.radians(40)) / np.sqrt(2)
    level = ((np.sqrt(1.64) - 1) * high + side) / (2 * side)
    # From the left and from above, the first slope is lit, the second in shade.
    assert line[5] >= 254
    assert line[-6] == 0
    assert line[18] == int(255 * level)


def test_relief_is_averaged_over_three_cells() -> None:
    height = np.zeros((11, 11))
    height[5, 5] = 0.01
    shaded = sheets.relief(raster_of(height))[..., 0].astype(int)
    away = np.maximum.outer(*np.abs(np.indices((11, 11))[:, :, 0] - 5)[[0, 0]])
    (level,) = set(shaded[away >= 3])
    assert shaded[5, 3] > level > shaded[5, 7]
    assert shaded[3, 5] > level > shaded[7, 5]


def test_an_extent_has_the_edges_of_the_cells() -> None:
    found = sheets.extent_of(raster_of(np.zeros((3, 5))))
    assert found == pytest.approx((0.1, 0.11, 0.394, 0.4))


def _drawn_sheet(show, raster=None, **options):
    raster = raster_of(np.arange(12.0).reshape(3, 4)) if raster is None else raster
    figure = sheets.sheet(
        raster, TitleBlock(title="T"), scale=1.0, show=show, **options
    )
    words = [text.get_text() for axis in figure.axes[1:] for text in axis.texts]
    return figure, words


def test_a_sheet_has_its_raster_in_place_and_a_color_scale() -> None:
    figure, words = _drawn_sheet("height", legend=[("#0000ff", "", "visit one")])
    axis, _, bar = figure.axes
    assert_allclose(axis.images[0].get_extent(), [0.1, 0.108, 0.394, 0.4])
    # 3 mm around on paper at 1:1.
    assert axis.get_xlim() == pytest.approx((0.097, 0.111))
    assert axis.get_ylim() == pytest.approx((0.391, 0.403))
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("right [m]", "up [m]")
    assert bar.get_title(loc="right") == "height [mm]"
    assert {"no surface measured", "visit one", "up", "1:1 on A4"} <= set(words)
    assert not {"doubtful pixels", "not significant, or not compared"} & set(words)
    assert not axis.collections
    plain, words = _drawn_sheet("relief")
    assert len(plain.axes) == 2
    assert "no surface measured" in words


def test_a_sheet_of_deviations_explains_its_gray() -> None:
    values = 1e-3 * np.arange(12.0).reshape(3, 4)
    _, words = _drawn_sheet("deviation", values=values)
    assert "not significant, or not compared" in words


def test_doubtful_cells_of_a_sheet_are_hatched() -> None:
    height = np.arange(12.0).reshape(3, 4)
    layer = np.zeros((3, 4))
    clear = raster_of(height, layers={"doubtful": layer})
    figure, words = _drawn_sheet("height", clear)
    assert "doubtful pixels" not in words
    layer[1, 2], layer[0, 0] = 0.5, np.nan
    figure, words = _drawn_sheet(
        "height", raster_of(height, layers={"doubtful": layer})
    )
    assert "doubtful pixels" in words
    (hatched,) = figure.axes[0].collections
    assert hatched.hatches == ["////"]
    # Linear between cells of 2 mm: around the center of the cell at 0.105 and 0.397 m.
    box = hatched.get_datalim(figure.axes[0].transData)
    assert_allclose(box.extents, [0.103, 0.395, 0.107, 0.399], atol=1e-6)


def test_a_sheet_has_contours_and_annotations() -> None:
    points = np.stack([np.linspace(0.1, 0.108, 5), np.full(5, 0.397)], axis=1)
    line = Contour(level=0.5, points=points, uncertainty=1e-3)
    target = sheets.Annotations(targets={"T1": np.array([0.104, 0.397])})
    figure, _ = _drawn_sheet("height", contours=[line], annotations=target)
    axis = figure.axes[0]
    assert_allclose(axis.lines[0].get_xydata(), points)
    assert [text.get_text() for text in axis.texts] == ["T1"]


def test_lines_have_the_colors_of_their_layers(step) -> None:
    lines = tuple(
        Line(points=np.array([[0.0, y], [0.1, y]]), layer=f"layer {n}",
             label="name" if n == 1 else "")
        for n, y in enumerate(np.linspace(1.0, 1.05, 10))
    )  # fmt: skip
    many = replace(step, lines=lines)
    figure = sheets.line_sheet(many, scale=1.0)
    axis = figure.axes[0]
    colors = {part.get_gid(): to_hex(part.get_colors()[0] if hasattr(part, "get_colors")
              else part.get_color()[0]) for part in axis.collections}  # fmt: skip
    # Black, seven colors, and black again.
    palette = ["#000000", *(color.lower() for color in COLOURS)]
    assert list(colors.values()) == [palette[n % 8] for n in range(10)]
    assert list(colors) == [f"layer {n}" for n in range(10)]
    assert [text.get_text() for text in axis.texts] == ["name"]
    words = [text.get_text() for text in figure.axes[1].texts]
    assert not any(text.startswith(("layer", "±")) for text in words)
    named = sheets.line_sheet(many, scale=1.0, colours={"layer 2": "#123456"})
    words = [text.get_text() for text in named.axes[1].texts]
    assert [text for text in words if text.startswith("layer")] == list(colors)
    third = named.axes[0].collections[2]
    assert to_hex(third.get_color()[0]) == "#123456"


def test_a_line_with_errors_has_a_band_of_two_standard_uncertainties(step) -> None:
    flat = Line(points=np.array([[0.0, 1.0], [0.1, 1.0]]), layer="a",
                band=np.array([5e-4, 5e-4]))  # fmt: skip
    figure = sheets.line_sheet(replace(step, lines=(flat,)), scale=1.0)
    band = figure.axes[0].collections[0]
    assert band.get_gid() == "uncertainty"
    corners = band.get_paths()[0].vertices
    assert_allclose(corners[:, 1].min(), 0.999)
    assert_allclose(corners[:, 1].max(), 1.001)
    words = [text.get_text() for text in figure.axes[1].texts]
    assert "± 2 standard uncertainties" in words


def test_a_line_sheet_has_room_names_and_a_key_plan(step) -> None:
    marked = replace(step, marks=((0.0, "B"), (0.1, "B'")))
    raster = raster_of(np.zeros((4, 10)))
    cut = np.array([[0.1, 0.395], [0.12, 0.395]])
    figure = sheets.line_sheet(marked, scale=2.0, heights=3.0, key=(raster, cut))
    axis, _, plan = figure.axes
    # 3 mm on paper at 1:2, in heights that are three times as large.
    assert axis.get_ylim() == pytest.approx((1 - 0.002, 1.04 + 0.002))
    assert axis.get_xlim() == (0.0, 0.1)
    assert [(text.get_text(), text.xy) for text in axis.texts] == [
        ("B", (0.0, 1.0)), ("B'", (0.1, 1.0)),
    ]  # fmt: skip
    assert [text.get_text() for text in plan.texts] == ["B", "B'"]
    plain = sheets.line_sheet(step, scale=2.0, key=(raster, cut))
    assert [text.get_text() for text in plain.axes[2].texts] == ["A", "A'"]
    assert len(sheets.line_sheet(step, scale=2.0).axes) == 2


def test_a_picture_is_drawn_at_the_right_of_the_axis_only(step) -> None:
    picture = raster_of(np.zeros((5, 6)), left=-0.005, cell=0.002)
    figure = sheets.line_sheet(step, scale=1.0, picture=picture)
    axis = figure.axes[0]
    (shown,) = axis.images
    assert_allclose(shown.get_extent(), [-0.005, 0.007, 0.39, 0.4])
    # Centers at -4, -2, 0, 2, ... mm.
    opacity = np.asarray(shown.get_array())[0, :, 3]
    assert opacity.tolist() == [0, 0, 255, 255, 255, 255]
    assert axis.get_xlim() == (0.0, 0.1)
    assert axis.get_ylim() == pytest.approx((0.997, 1.043))
