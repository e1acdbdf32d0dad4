"""A drawing set has all sheets of an object, at one scale, in three formats."""

from __future__ import annotations

import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import exact_scenes as scenes
import ezdxf
import numpy as np
import pytest
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from pdf_archive import archive_faults
from pdf_files import letter_sizes, pages_of, streams_of
from project_files import project_text

from amulor import imaging, io
from amulor.cli import main
from amulor.handover import drawings
from amulor.handover.drawing_set import contour_interval, from_body, middle_line
from amulor.imaging import products


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Return a folder with the drawing set of a cone."""
    folder = tmp_path_factory.mktemp("set")
    io.write_cube(scenes.cone(own=1e-5), folder / "cone.nc")
    text = project_text({"a": ("cone.nc", '["raw.nc"]', "")}, author="A. Drawer")
    (folder / "project.toml").write_text(text)
    words = ["--product", "drawings", "--project", str(folder / "project.toml")]
    image, output = str(folder / "cone.nc"), str(folder / "cone.pdf")
    assert main(["export", image, "-o", output, *words]) == 0
    return folder


def test_each_sheet_is_a_page_and_a_file(folder) -> None:
    names = "elevation", "section", "profile", "deviation"
    assert pages_of(folder / "cone.pdf") == len(names)
    scales = set()
    for number, name in enumerate(names):
        root = ET.parse(folder / f"cone_{name}.svg").getroot()
        texts = {t.text for t in root.iter("{http://www.w3.org/2000/svg}text")}
        assert f"{number + 1} of {len(names)}" in texts, name
        assert "A. Drawer" in texts
        scales |= {text for text in texts if text and re.match(r"1:\d+ on A\d", text)}
    # 180 mm wide and high: at 1:1 that is too wide for upright A4.
    assert {scale.split()[0] for scale in scales} == {"1:2"}


def test_lines_of_the_set_open_in_a_cad_program(folder) -> None:
    assert not (folder / "cone_deviation.dxf").exists()
    layers = {}
    for name in ("elevation", "section", "profile"):
        document = ezdxf.readfile(folder / f"cone_{name}.dxf")
        assert not document.audit().errors
        layers[name] = {entity.dxf.layer for entity in document.modelspace()}
    assert "contours" in layers["elevation"]
    assert {"section", "uncertainty", "axes", "notes"} <= layers["section"]
    assert {"profile", "axis", "diameters"} <= layers["profile"]


def test_letters_of_a_set_have_seven_points_and_more(folder) -> None:
    assert min(letter_sizes(folder / "cone.pdf")) >= 7


def test_a_pdf_states_its_metadata_twice_alike(folder) -> None:
    content = (folder / "cone.pdf").read_bytes()
    (packet,) = [s for s in streams_of(folder / "cone.pdf") if b"xpacket" in s]
    root = ET.fromstring(packet)
    spaces = {
        "rdf": "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
        "pdfa": "http://www.aiim.org/pdfa/ns/id/",
        "dc": "http://purl.org/dc/elements/1.1/",
    }
    assert root.findtext(".//pdfa:part", namespaces=spaces) == "2"
    assert root.findtext(".//pdfa:conformance", namespaces=spaces) == "B"
    assert root.findtext(".//dc:creator//rdf:li", namespaces=spaces) == "A. Drawer"
    assert b"/Author (A. Drawer)" in content
    assert root.findtext(".//dc:title//rdf:li", namespaces=spaces) == "scene"
    assert b"/Title (scene)" in content


def test_a_pdf_has_colors_fonts_and_identifier_of_an_archive(folder) -> None:
    content = (folder / "cone.pdf").read_bytes()
    trailer = content.rpartition(b"trailer")[2]
    assert re.search(rb"/ID \[<[0-9a-f]{32}> <[0-9a-f]{32}>\]", trailer)
    # ICC.1: the signature stands at byte 36, the color space at byte 16.
    profiles = [s for s in streams_of(folder / "cone.pdf") if s[36:40] == b"acsp"]
    assert [profile[16:20] for profile in profiles] == [b"RGB "]
    assert b"/OutputIntents" in content
    fonts = content.count(b"/Subtype /CIDFontType2")
    assert fonts == content.count(b"/FontFile2") > 0
    for forbidden in (b"/Type3", b"/Encrypt", b"/JavaScript", b"/LZWDecode"):
        assert forbidden not in content


def test_a_set_violates_no_clause_of_the_archive_standard(folder) -> None:
    assert archive_faults(folder / "cone.pdf") == []


@pytest.mark.parametrize(
    ("old", "new", "clause"),
    [
        (b"\xac\xdc\xa0", b"\xac\xdc ", "6.1.2:"),
        (b"/ID [", b"/IX [", "6.1.3: no file identifier"),
        (b"\nendstream", b" endstream", "6.1.7.1:"),
        (b"endobj\n2 0 obj", b"endobj 2 0 obj", "6.1.9:"),
        (b"/OutputIntents", b"/OutputIntentz", "6.2.3: no output intent"),
        (b"mntrRGB", b"mntrGRA", "6.2.3: color profile"),
        (b"/Indexed /DeviceRGB", b"/Indexed/DeviceCMYK", "6.2.4.3:"),
        (b"/ca 1 ", b"/BM/A ", "6.2.10:"),
        (b"/FontFile2", b"/FontFile4", "6.2.11.4.1:"),
        (b"[ 636 636", b"[ 656 636", "6.2.11.5:"),
        (b"/Metadata ", b"/Metadatb ", "6.6.2.1:"),
        (b"<pdfaid:part>2", b"<pdfaid:part>1", "6.6.4:"),
    ],
)
def test_the_reader_finds_each_violation(folder, tmp_path, old, new, clause) -> None:
    content = (folder / "cone.pdf").read_bytes()
    assert old in content
    (tmp_path / "o.pdf").write_bytes(content.replace(old, new))
    assert len(content.replace(old, new)) == len(content)
    assert any(fault.startswith(clause) for fault in archive_faults(tmp_path / "o.pdf"))


def test_the_reader_finds_appended_data(folder, tmp_path) -> None:
    content = (folder / "cone.pdf").read_bytes()
    (tmp_path / "o.pdf").write_bytes(content + b"more\n")
    assert archive_faults(tmp_path / "o.pdf") == [
        "6.1.3: data after the end of the file"
    ]


def test_the_reader_finds_that_a_plain_file_is_none_for_archives(tmp_path) -> None:
    figure = Figure()
    figure.text(0.5, 0.5, "text")
    with PdfPages(tmp_path / "o.pdf") as pages:
        pages.savefig(figure)
    faults = " ".join(archive_faults(tmp_path / "o.pdf"))
    # By default matplotlib embeds Type 3 fonts, and states no colors and no metadata.
    assert "Type3 in place of TrueType" in faults
    assert "no output intent" in faults
    assert "no XMP metadata" in faults


@pytest.mark.skipif(shutil.which("pdfinfo") is None, reason="needs poppler")
def test_poppler_reads_the_appended_objects(folder) -> None:
    words = ["pdfinfo", "-meta", str(folder / "cone.pdf")]
    said = subprocess.run(words, capture_output=True, text=True, check=True)
    assert "<pdfaid:part>2</pdfaid:part>" in said.stdout
    assert said.stderr == ""


def test_equal_drawings_are_equal_files(folder, tmp_path) -> None:
    words = ["export", str(folder / "cone.nc"), "-o"]
    for name in ("a.pdf", "b.pdf"):
        assert main([*words, str(tmp_path / name)]) == 0
    first, second = ((tmp_path / name).read_bytes() for name in ("a.pdf", "b.pdf"))
    assert first == second


def test_a_step_on_a_cone_is_a_deviation_from_its_body() -> None:
    image = scenes.cone(own=2e-5)
    image["slant_range"].values[18:23, 17:23] -= 1e-3
    body = drawings.turned_body(image)
    deviation = from_body(image, body)
    value = np.full(image["slant_range"].size, np.nan)
    value[deviation.surface.pixel] = deviation.value
    value = value.reshape(image["slant_range"].shape)
    # Seen from its front, the normal of the cone is atan(1/5) off the beam.
    expected = 1e-3 / np.sqrt(1.04)
    assert np.median(value[19:22, 18:22]) == pytest.approx(expected, abs=5e-5)
    marked = np.zeros(value.size, dtype=bool)
    marked[deviation.surface.pixel] = deviation.significant
    assert marked.reshape(value.shape)[19:22, 18:22].all()
    away = value[5:12, 15:25]
    assert np.abs(away).max() < 1.5e-4


def test_a_ladder_has_no_half_profile_and_says_so(
    ladder_file, tmp_path, capsys
) -> None:
    words = ["export", str(ladder_file), "-o", str(tmp_path / "l.pdf")]
    assert main([*words, "--product", "drawings"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"no half-profile: not round: \d+% of the pixels", said)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {
        "l.pdf", "l_elevation.svg", "l_elevation.dxf", "l_section.svg", "l_section.dxf",
    }  # fmt: skip
    assert pages_of(tmp_path / "l.pdf") == 2


def test_no_sheet_replaces_a_file(ladder_file, tmp_path, capsys) -> None:
    (tmp_path / "l_section.dxf").write_text("mine")
    words = ["export", str(ladder_file), "-o", str(tmp_path / "l.pdf")]
    assert main([*words, "--product", "drawings"]) == 1
    assert "l_section.dxf exists already" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["l_section.dxf"]


def test_the_section_runs_along_the_longer_side(ladder) -> None:
    surface = products.surface(ladder)
    plane = products.plane_of(surface.frame)
    left, low, right, high = middle_line(surface, plane)
    # Five treads of 20 mm; the line ends beyond the outermost pixels.
    assert 0.095 < right - left < 0.105
    assert low == high == pytest.approx(0, abs=2e-3)


@pytest.mark.parametrize(
    ("slope", "own", "interval"),
    # 0.12 m wide: heights of 38 mm give 5 mm; large errors give four of them.
    [((0.3, 0.0, 0.954), 1e-4, 0.005), ((0.3, 0.0, 0.954), 4e-3, 0.02)],
)
def test_contours_are_round_numbers_above_the_noise(slope, own, interval) -> None:
    surface = products.surface(scenes.plane(slope, 1.5, own=own))
    plane = products.plane_of(surface.frame)
    raster = products.raster(surface, plane, cell=surface.spacing)
    assert contour_interval(raster) == pytest.approx(interval)


def test_the_frame_of_a_set_is_that_of_its_axes(ladder_file, tmp_path) -> None:
    words = ["export", str(ladder_file), "-o", str(tmp_path / "l.pdf")]
    assert main([*words, "--product", "drawings", "--axes", "z-up"]) == 0
    frame = imaging.frame_of(io.read_cube(ladder_file), axes="z-up")
    assert frame.axes in (tmp_path / "l_section.svg").read_text()


def test_the_elevation_of_a_turned_body_is_seen_from_the_instrument(monkeypatch):
    # Beams go forward and a little down; the body stands upright, x is right, y is up.
    beams = np.array([[0.1, -0.3, 1.0], [-0.1, -0.3, 1.0]])
    surface = products.surface(scenes.cone())
    surface = replace(surface, direction=beams, position=np.ones((2, 3)))
    monkeypatch.setattr(products, "raster", lambda *words, **cells: (*words, cells))
    axis, base = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.5, 0.0])
    shifted, plane, cells = drawings._seen_along(surface, axis, base, 2e-3)
    np.testing.assert_allclose(plane.axes, [[-1, 0, 0], [0, 1, 0], [0, 0, -1]])
    np.testing.assert_allclose(shifted.position, [[0, 0.5, 1.0]] * 2)
    assert cells == {"cell": 2e-3}
