"""Drawings are read back by other programs' readers with the numbers put in."""

from __future__ import annotations

import csv
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from PIL import Image, TiffImagePlugin

from amulor.errors import FormatError, MissingExtraError
from amulor.io.drawings import (
    Band,
    Drawing,
    Line,
    write_dxf,
    write_geotiff,
    write_picture,
    write_table,
)


@pytest.fixture
def values():
    values = np.arange(12.0).reshape(3, 4) / 7 - 1.5
    values[1, 2] = np.nan
    return values


@pytest.fixture
def drawing():
    steps = np.array([[0.0, -1.5], [0.02, -1.5], [0.02, -1.46], [0.04, -1.46]])
    flat = np.array([[0.0, -1.4], [0.1, -1.4]])
    return Drawing(
        title="A ladder <&> µm",
        lines=(
            Line(points=steps, layer="section"),
            Line(points=flat, layer="other", label="-1.4", band=np.full(2, 5e-4)),
        ),
        axes=("along", "nearer"),
        statements=("standard uncertainty 0.5 mm",),
    )


class TestGeotiff:
    def test_one_band_is_read_by_another_program(self, values, tmp_path):
        path = tmp_path / "dem.tif"
        write_geotiff(
            [Band(name="height", unit="m", values=values)],
            path,
            cell=0.002,
            left=-0.05,
            top=0.04,
            statements=["axes: right, up"],
        )
        with Image.open(path) as found:
            np.testing.assert_array_equal(np.array(found), values.astype(np.float32))
            tags = dict(found.tag_v2)
        assert tags[33550] == (0.002, 0.002, 0.0)
        # Column 0, row 0 (the upper left corner) lies at left and top.
        assert tags[33922] == (0.0, 0.0, 0.0, -0.05, 0.04, 0.0)
        keys = np.array(tags[34735]).reshape(-1, 4)
        assert keys[0].tolist() == [1, 1, 1, len(keys) - 1]
        stated = {key: value for key, _, _, value in keys[1:].tolist()}
        # A model of the user's own, cells as areas, metres.
        assert (stated[1024], stated[1025], stated[3076]) == (32767, 1, 9001)
        assert tags[42113].strip("\0 ") == "nan"
        assert "right, up" in tags[TiffImagePlugin.IMAGEDESCRIPTION]

    def test_bands_keep_their_order_and_names(self, values, tmp_path):
        tifffile = pytest.importorskip("tifffile")
        path = tmp_path / "dem.tif"
        bands = [
            Band(name="height", unit="m", values=values),
            Band(name="its standard uncertainty <1 mm", unit="m", values=values / 100),
        ]
        write_geotiff(bands, path, cell=0.002, left=0.0, top=0.0)
        with tifffile.TiffFile(path) as file:
            found = file.asarray()
            metadata = file.pages[0].tags[42112].value
        np.testing.assert_allclose(found[1], values / 100, rtol=1e-7)
        items = ET.fromstring(metadata).findall("Item")
        names = {
            i.get("sample"): i.text for i in items if i.get("role") == "description"
        }
        assert names == {"0": "height", "1": "its standard uncertainty <1 mm"}

    def test_a_stated_system_has_its_code_and_the_offset_added(self, values, tmp_path):
        path = tmp_path / "dem.tif"
        write_geotiff(
            [Band(name="height", unit="m", values=values)],
            path,
            cell=0.5,
            left=10.25,
            top=20.5,
            crs="EPSG:32632",
            offset=(512000.0, 4890000.0),
        )
        with Image.open(path) as found:
            tags = dict(found.tag_v2)
        assert tags[33922][3:5] == (512010.25, 4890020.5)
        keys = np.array(tags[34735]).reshape(-1, 4)[1:].tolist()
        stated = {key: value for key, _, _, value in keys}
        assert (stated[1024], stated[3072]) == (1, 32632)

    def test_gdal_reads_system_edges_and_values(self, values, tmp_path):
        path = tmp_path / "dem.tif"
        write_geotiff(
            [Band(name="height", unit="m", values=values)],
            path,
            cell=0.5,
            left=10.25,
            top=20.5,
            crs="EPSG:25832",
            offset=(512000.0, 4890000.0),
        )
        with rasterio.open(path) as found:
            assert found.crs.to_epsg() == 25832
            assert found.crs.linear_units == "metre"
            assert found.bounds.left == 512010.25
            assert found.bounds.top == 4890020.5
            assert found.res == (0.5, 0.5)
            assert found.descriptions == ("height",)
            np.testing.assert_array_equal(found.read(1), values.astype(np.float32))

    @pytest.mark.parametrize("crs", ["EPSG:99999", "EPSG:4326", "EPSG:2263"])
    def test_no_file_is_written_in_a_system_that_is_none_of_metres(
        self, values, tmp_path, crs
    ):
        with pytest.raises(FormatError, match="state a projected system in meters"):
            write_geotiff(
                [Band(name="height", unit="m", values=values)],
                tmp_path / "dem.tif",
                cell=0.5,
                left=0,
                top=0,
                crs=crs,
            )
        assert list(tmp_path.iterdir()) == []

    def test_without_its_package_it_says_what_to_install(
        self, values, tmp_path, monkeypatch
    ):
        monkeypatch.setitem(sys.modules, "tifffile", None)
        with pytest.raises(MissingExtraError, match=r"amulor\[export\]"):
            write_geotiff(
                [Band(name="h", unit="m", values=values)],
                tmp_path / "x.tif",
                cell=1,
                left=0,
                top=0,
            )
        assert list(tmp_path.iterdir()) == []


class TestDxf:
    def test_lines_come_back_in_metres_on_their_layers(self, drawing, tmp_path):
        ezdxf = pytest.importorskip("ezdxf")
        path = tmp_path / "section.dxf"
        write_dxf(drawing, path)
        document = ezdxf.readfile(path)
        assert not document.audit().has_errors
        assert document.units == 6  # metres
        lines = document.modelspace().query('LWPOLYLINE[layer=="section"]')
        assert len(lines) == 1
        np.testing.assert_array_equal(
            np.array(lines[0].get_points("xy")), drawing.lines[0].points
        )
        (band,) = document.modelspace().query('LWPOLYLINE[layer=="uncertainty"]')
        assert band.closed
        across = np.array(band.get_points("xy"))[:, 1]
        assert set(np.round(np.abs(across + 1.4), 12)) == {1e-3}  # two of 0.5 mm
        texts = [t.dxf.text for t in document.modelspace().query("TEXT")]
        assert "standard uncertainty 0.5 mm" in texts

    def test_notes_stand_below_the_drawing_line_under_line(self, drawing, tmp_path):
        ezdxf = pytest.importorskip("ezdxf")
        path = tmp_path / "section.dxf"
        write_dxf(drawing, path)
        texts = ezdxf.readfile(path).modelspace().query("TEXT")
        # Letters of 2 mm: to be read beside lines of centimetres.
        assert {text.dxf.height for text in texts} == {0.002}
        notes = [text for text in texts if text.dxf.layer == "notes"]
        assert [text.dxf.text for text in notes] == [
            "A ladder <&> µm",
            "standard uncertainty 0.5 mm",
        ]
        low = min(line.points[:, 1].min() for line in drawing.lines)
        height = [text.dxf.insert.y for text in notes]
        assert height[0] < low - 0.002
        # Lines of text that neither touch nor fall apart.
        assert 0.0025 < height[0] - height[1] < 0.005
        assert {text.dxf.insert.x for text in notes} == {0.0}

    def test_the_file_is_plain_pairs_of_code_and_value(self, drawing, tmp_path):
        # The format as it is written down, without the library that wrote it.
        pytest.importorskip("ezdxf")
        path = tmp_path / "section.dxf"
        write_dxf(drawing, path)
        lines = path.read_text().splitlines()
        pairs = list(zip(lines[::2], lines[1::2], strict=True))
        assert pairs[-1] == ("  0", "EOF")
        start = next(
            n
            for n, (code, value) in enumerate(pairs)
            if (code.strip(), value) == ("0", "LWPOLYLINE")
        )
        entity = []
        for code, value in pairs[start + 1 :]:
            if code.strip() == "0":
                break
            entity.append((int(code), value))
        x = [float(value) for code, value in entity if code == 10]
        y = [float(value) for code, value in entity if code == 20]
        np.testing.assert_array_equal(np.stack([x, y], 1), drawing.lines[0].points)

    def test_without_its_package_it_says_what_to_install(
        self, drawing, tmp_path, monkeypatch
    ):
        monkeypatch.setitem(sys.modules, "ezdxf", None)
        with pytest.raises(MissingExtraError, match=r"amulor\[export\]"):
            write_dxf(drawing, tmp_path / "x.dxf")

    def test_frame_coordinates_marks_and_title_block(self, drawing, tmp_path):
        ezdxf = pytest.importorskip("ezdxf")
        path = tmp_path / "section.dxf"
        fields = {"project": "Harbour", "find number": "HB 17"}
        marked = replace(drawing, marks=((0.0, "A"), (0.12, "A'")), fields=fields)
        write_dxf(marked, path, scale=2)
        document = ezdxf.readfile(path)
        assert not document.audit().has_errors
        space = document.modelspace()
        (frame,) = space.query('LWPOLYLINE[layer=="axes"]')
        corners = np.array(frame.get_points("xy"))
        # The frame reaches from A to A', and past the lowest and the highest line.
        assert corners[:, 0].tolist() == [0.0, 0.12, 0.12, 0.0]
        # Two letters beyond, each way.
        assert corners[:, 1].min() == pytest.approx(-1.508)
        assert corners[:, 1].max() == pytest.approx(-1.392)
        texts = {t.dxf.text: t for t in space.query('TEXT[layer=="axes"]')}
        # Letters of 2 mm on paper at 1:2.
        assert {t.dxf.height for t in texts.values()} == {0.004}
        assert texts["A'"].dxf.insert.x == pytest.approx(0.12)
        assert texts["A"].dxf.insert.y > corners[:, 1].max()
        ticks = [line.dxf.start.x for line in space.query('LINE[layer=="axes"]')]
        for name in ("0.04", "0.1"):
            assert texts[name].dxf.insert.x == pytest.approx(float(name))
            assert min(abs(np.array(ticks) - float(name))) < 1e-12
        assert {"along [m]", "nearer [m]", "-1.46"} <= set(texts)
        (block,) = space.query("INSERT")
        assert block.dxf.name == "TITLE_BLOCK"
        # Fields without a text are there, for a CAD program to fill.
        blank = "OBJECT", "SHEET", "AUTHOR", "INSTITUTION", "DATE", "VIEW"
        assert {a.dxf.tag: a.dxf.text for a in block.attribs} == {
            "PROJECT": "Harbour",
            "FIND_NUMBER": "HB 17",
            "SCALE": "1:2",
            **dict.fromkeys(blank, ""),
        }

    def test_nothing_to_draw_is_refused(self, tmp_path):
        pytest.importorskip("ezdxf")
        with pytest.raises(FormatError, match="no line"):
            write_dxf(Drawing(title="", lines=(), axes=("a", "b")), tmp_path / "x.dxf")


def test_a_table_is_read_with_its_header(tmp_path):
    path = tmp_path / "t.csv"
    write_table(
        {"piece": [0, 1], "along [m]": [0.1234567, np.nan], "sure": [True, False]},
        path,
        statements=["a note,\nin two lines"],
    )
    lines = path.read_text().splitlines()
    assert lines[0] == "# a note, in two lines"
    rows = list(csv.reader(lines[1:]))
    assert rows == [
        ["piece", "along [m]", "sure"],
        ["0", "0.1234567", "1"],
        ["1", "", "0"],
    ]


def test_a_picture_knows_its_size_on_paper(tmp_path):
    path = tmp_path / "p.png"
    pixels = np.random.default_rng(1).integers(0, 256, (5, 7, 4)).astype(np.uint8)
    write_picture(
        pixels, path, dots_per_metre=300 / 0.0254, texts={"Title": "µm at 1:20"}
    )
    with Image.open(path) as found:
        found.load()
        np.testing.assert_array_equal(np.array(found), pixels)
        assert found.info["dpi"] == pytest.approx((300, 300), abs=0.02)
        assert found.text["Title"] == "µm at 1:20"
