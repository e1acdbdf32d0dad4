"""Grids, bands and places of texts in drawings, and all tags of a GeoTIFF."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import ezdxf
import numpy as np
import pytest
import tifffile
from numpy.testing import assert_allclose
from PIL import Image

from amulor.errors import FormatError
from amulor.io import drawings
from amulor.io.drawings import FIELDS, Band, Drawing, Line


@pytest.mark.parametrize(
    ("value", "rounded"),
    [(0.3, 0.5), (1.0, 1), (1.0009, 1), (1.002, 2), (2.1, 5), (5.1, 10), (99.0, 100),
     (0.02, 0.02), (0.021, 0.05)],
)  # fmt: skip
def test_steps_are_of_the_series_1_2_5(value: float, rounded: float) -> None:
    assert drawings.rounded_up(value) == pytest.approx(rounded)


@pytest.mark.parametrize(
    ("low", "high", "step"),
    # At 1:10, 20 mm on paper are 0.2 m, 8 mm are 0.1 m and 4 mm 0.05 m.
    [(0.0, 0.8, 0.2), (0.0, 0.79, 0.1), (0.05, 0.31, 0.1), (0.05, 0.19, 0.05),
     (0.0, 0.1, 0.1), (0.001, 0.1, 0.05)],
)  # fmt: skip
def test_a_grid_is_finer_in_a_small_drawing(low, high, step) -> None:
    assert drawings.grid_step(low, high, 10.0) == pytest.approx(step)


def test_places_are_multiples_with_both_bounds() -> None:
    found = drawings.places_between(-0.2, 0.3, 0.1)
    assert found.tolist() == [-0.2, -0.1, 0.0, 0.1, 0.2, 0.3]
    assert drawings.places_between(0.01, 0.09, 0.1).tolist() == []
    assert drawings.places_between(-0.05, 0.19, 0.1).tolist() == [0.0, 0.1]


def line(*points: tuple[float, float], **fields: object) -> Line:
    return Line(points=np.array(points), layer="section", **fields)


def test_a_band_is_two_uncertainties_to_either_side() -> None:
    flat = line((0, 0), (3, 0), (9, 0), band=np.array([0.1, 0.2, 0.3]))
    assert_allclose(
        drawings.sides(flat),
        [(0, 0.2), (3, 0.4), (9, 0.6), (9, -0.6), (3, -0.4), (0, -0.2)],
    )
    steep = line((0, 0), (3, 4), band=np.array([0.5, 0.5]))
    assert_allclose(
        drawings.sides(steep), [(-0.8, 0.6), (2.2, 4.6), (3.8, 3.4), (0.8, -0.6)]
    )
    # A place that stands twice has no direction, and no band there.
    same = line((1, 1), (1, 1), band=np.array([0.5, 0.5]))
    assert_allclose(drawings.sides(same), np.ones((4, 2)))
    assert drawings.sides(line((0, 0), (1, 0))) is None
    assert drawings.sides(line((0, 0), band=np.array([0.5]))) is None


def test_limits_reach_to_lines_and_marks() -> None:
    lines = (line((0, 5), (2, 1)), line((-1, 3), (1, 7)))
    drawing = Drawing(title="", lines=lines, axes=("a", "b"))
    assert drawing.limits == (-1, 2, 1, 7)
    marked = replace(drawing, marks=((-3.0, "A"), (4.0, "A'")))
    assert marked.limits == (-3, 4, 1, 7)
    assert drawing.layers == ("section",)
    with pytest.raises(FormatError, match=r"^x: there is no line to draw$"):
        drawings.checked(replace(drawing, lines=()), name="x")
    broken = replace(drawing, lines=(line((0, np.nan)),))
    with pytest.raises(FormatError, match=r"^x: a line of layer section is not fin"):
        drawings.checked(broken, name="x")
    assert drawings.checked(drawing, name="x") is drawing


def test_texts_of_a_dxf_stand_in_letters_of_two_millimeters(tmp_path: Path) -> None:
    drawing = Drawing(
        title="A  step", statements=("one", "two"), axes=("along", "up"),
        lines=(
            line((0, 1), (0.1, 1.04), elevation=0.5),
            replace(line((0.02, 1.0), (0.04, 1.0), (0.06, 1.02), label="1.0"),
                    layer="other"),
        ),
        marks=((0.0, "A"),), fields={"project": "Harbor"},
    )  # fmt: skip
    path = tmp_path / "d.dxf"
    drawings.write_dxf(drawing, path, scale=2.0)
    document = ezdxf.readfile(path)
    space = document.modelspace()
    assert document.header["$MEASUREMENT"] == 1
    names = ("section", "other", "uncertainty", "axes", "notes")
    colors = [document.layers.get(name).color for name in names]
    assert colors == [7, 5, 1, 3, 6]
    letter = 0.004
    low, high = 1.0 - 2 * letter, 1.04 + 2 * letter
    texts = {t.dxf.text: (t.dxf.insert.x, t.dxf.insert.y) for t in space.query("TEXT")}
    # 0.1 m at 1:2 has steps of 20 mm, 0.056 m has the same of 8 mm.
    expected = {
        "1.0": (0.04, 1.0), "A": (0.0, high + letter),
        "along [m]": (0.0, low - 3.4 * letter),
        "up [m]": (-5 * letter, high + 2.6 * letter),
        "A step": (0.0, low - 4 * letter - 3.2 * letter),
        "one": (0.0, low - 4 * letter - 4.8 * letter),
        "two": (0.0, low - 4 * letter - 6.4 * letter),
    }  # fmt: skip
    ticks = drawings.places_between(0.0, 0.1, drawings.grid_step(0.0, 0.1, 2.0))
    expected |= {f"{x + 0.0:g}": (x, low - 1.8 * letter) for x in ticks}
    ups = drawings.places_between(low, high, drawings.grid_step(low, high, 2.0))
    expected |= {f"{y:g}": (-5 * letter, y) for y in ups}
    assert set(texts) == set(expected)
    for words, place in expected.items():
        assert texts[words] == pytest.approx(place), words
    ends = [(part.dxf.start, part.dxf.end) for part in space.query("LINE")]
    drawn = sorted((a.x, a.y, b.x, b.y) for a, b in ends)
    marks = [(x, low, x, low - letter / 2) for x in ticks]
    marks += [(0.0, y, -letter / 2, y) for y in ups]
    assert_allclose(drawn, sorted(marks), atol=1e-12)
    (first,) = space.query('LWPOLYLINE[layer=="section"]')
    assert first.dxf.elevation == 0.5
    (frame,) = space.query('LWPOLYLINE[layer=="axes"]')
    assert frame.closed
    assert_allclose(
        np.array(frame.get_points("xy")),
        [(0, low), (0.1, low), (0.1, high), (0, high)],
    )
    (block,) = space.query("INSERT")
    assert block.dxf.layer == "notes"
    place = (block.dxf.insert.x, block.dxf.insert.y)
    assert place == pytest.approx((0.0, low - 4 * letter - 6 * 1.6 * letter))
    names = [*FIELDS, "scale"]
    captions = document.blocks.get("TITLE_BLOCK").query("TEXT")
    assert [(t.dxf.text, t.dxf.insert.x) for t in captions] == [(n, 0) for n in names]
    heights = [-1.6 * letter * n for n in range(9)]
    assert_allclose([t.dxf.insert.y for t in captions], heights)
    stated = document.blocks.get("TITLE_BLOCK").query("ATTDEF")
    assert_allclose([t.dxf.insert.x for t in stated], 12 * letter)
    assert_allclose([t.dxf.insert.y for t in stated], heights)
    assert {t.dxf.height for t in (*stated, *captions)} == {letter}


@pytest.mark.parametrize(("crs", "keys"), [("", 4), ("EPSG:32632", 5)])
def test_a_geotiff_has_its_place_system_and_names(tmp_path, crs, keys) -> None:
    path = tmp_path / "d.tif"
    values = np.arange(6.0).reshape(2, 3)
    bands = [Band(name="height & more", unit="m", values=values),
             Band(name="error", unit="mm", values=-values)]  # fmt: skip
    drawings.write_geotiff(
        bands, path, cell=0.5, left=1.0, top=2.0, crs=crs, offset=(100.0, 200.0),
        statements=["first", "µ second"],
    )  # fmt: skip
    with tifffile.TiffFile(path) as file:
        assert_allclose(file.asarray(), [values, -values])
        page = file.pages[0]
        tags = {tag.code: tag.value for tag in page.tags}
        assert page.dtype == np.float32
    assert tags[33550] == (0.5, 0.5, 0.0)
    shift = (100.0, 200.0) if crs else (0.0, 0.0)
    assert tags[33922] == (0.0, 0.0, 0.0, 1 + shift[0], 2 + shift[1], 0.0)
    text = (crs or "local frame of the instrument, see description") + "|"
    assert tags[34737].rstrip("\0") == text
    directory = np.array(tags[34735]).reshape(-1, 4).tolist()
    assert directory[0] == [1, 1, 1, keys]
    model = 1 if crs else 32767
    expected = [[1024, 0, 1, model], [1025, 0, 1, 1], [1026, 34737, len(text), 0]]
    expected += [[3072, 0, 1, 32632]] if crs else []
    assert directory[1:] == [*expected, [3076, 0, 1, 9001]]
    assert tags[42113].rstrip("\0") == "nan"
    assert tags[42112] == (
        '<GDALMetadata><Item name="DESCRIPTION" sample="0" role="description">height '
        '&amp; more</Item><Item name="UNITTYPE" sample="0" role="unittype">m</Item>'
        '<Item name="DESCRIPTION" sample="1" role="description">error</Item>'
        '<Item name="UNITTYPE" sample="1" role="unittype">mm</Item></GDALMetadata>'
    )
    assert tags[270] == "first\n? second"
    assert tags[305] == "amulor"
    # Deflate; two planes, one after the other.
    assert (tags[259], tags[284]) == (8, 2)


def test_files_are_kept_unless_they_may_be_replaced(tmp_path: Path) -> None:
    band = Band(name="h", unit="m", values=np.zeros((2, 2)))
    drawing = Drawing(title="", lines=(line((0, 0), (1, 1)),), axes=("a", "b"))
    pixels = np.zeros((2, 2, 4), np.uint8)
    writers = {
        "a.tif": lambda path, **k: drawings.write_geotiff(
            [band], path, cell=1, left=0, top=0, **k),
        "a.dxf": lambda path, **k: drawings.write_dxf(drawing, path, **k),
        "a.png": lambda path, **k: drawings.write_picture(
            pixels, path, dots_per_metre=100.0, texts={}, **k),
        "a.csv": lambda path, **k: drawings.write_table({"a": [1]}, path, **k),
    }  # fmt: skip
    for name, write in writers.items():
        path = tmp_path / name
        write(path)
        with pytest.raises(FormatError, match="overwrite"):
            write(path)
        write(path, overwrite=True)
    with pytest.raises(FormatError) as refused:
        drawings.write_geotiff([Band(name="h", unit="m", values=np.zeros(3))],
                               tmp_path / "b.tif", cell=1, left=0, top=0)  # fmt: skip
    assert str(refused.value).endswith("bands must be rasters of rows and columns")


def test_a_picture_has_whole_dots_per_meter(tmp_path: Path) -> None:
    path = tmp_path / "p.png"
    drawings.write_picture(
        np.zeros((2, 2, 4), np.uint8), path, dots_per_metre=1000.4, texts={}
    )
    with Image.open(path) as found:
        assert found.info["dpi"] == pytest.approx((25.4, 25.4))


def test_numbers_of_a_table_have_seven_digits(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    columns = {"n": np.array([3, 4], np.uint8), "x": [1 / 3, 123456789.0]}
    drawings.write_table(columns, path)
    assert path.read_text() == "n,x\n3,0.3333333\n4,1.234568e+08\n"
