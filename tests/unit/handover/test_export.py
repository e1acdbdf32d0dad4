"""`amulor export` writes each product; other readers find the ladder in it."""

from __future__ import annotations

import csv
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import laspy
import numpy as np
import pytest
import trimesh
from PIL import Image

from amulor import io
from amulor.cli import main
from amulor.handover import ENDINGS, Order, drawings, hand_over, product_of, references

pye57 = pytest.importorskip("pye57")

#: Depths of the treads, by the survey of the demo [m].
DEPTHS = np.array([1.5, 1.46, 1.45, 1.44, 1.43])


def run(*words: object) -> None:
    assert main(["export", *map(str, words)]) == 0


def read_csv(path: Path) -> list[dict[str, str]]:
    lines = [x for x in path.read_text().splitlines() if not x.startswith("#")]
    return list(csv.DictReader(lines))


def levels(heights: np.ndarray) -> np.ndarray:
    """Return the distinct heights, to a micrometre."""
    return np.unique(np.round(heights[np.isfinite(heights)], 6))


def test_a_section_shows_steps_of_forty_and_ten_millimetres(
    ladder_file, tmp_path, capsys
) -> None:
    path = tmp_path / "s.csv"
    run(ladder_file, "-o", path, "--line=-6cm,0m,6cm,0m")
    rows = read_csv(path)
    height = np.array([float(row["nearer [m]"]) for row in rows])
    np.testing.assert_allclose(levels(height), -DEPTHS, atol=1e-6)
    np.testing.assert_allclose(np.diff(levels(height)), [0.04, 0.01, 0.01, 0.01])
    sigma = np.array([float(row["standard_uncertainty [m]"]) for row in rows])
    # Between one pixel's and that of the mean of two, with 0.1 mm that all share.
    assert sigma.max() <= np.hypot(2e-4, 1e-4) * 1.001
    assert sigma.min() >= np.hypot(2e-4 / 2**0.5, 1e-4) * 0.999
    assert "standard uncertainties (GUM, k = 1)" in path.read_text()
    assert re.search(r"section of 0.120 m in 5 pieces", capsys.readouterr().out)


def test_a_slanting_section_is_as_long_as_pythagoras_says(
    ladder_file, tmp_path, capsys
) -> None:
    path = tmp_path / "s.csv"
    run(ladder_file, "-o", path, "--line=-2cm,-1cm,1cm,3cm")
    assert re.search(r"section of 0.050 m in", capsys.readouterr().out)
    rows = read_csv(path)
    along, right, up = (
        np.array([float(row[f"{name} [m]"]) for row in rows])
        for name in ("along", "right", "up")
    )
    np.testing.assert_allclose(right, -0.02 + 0.6 * along, atol=2e-6)
    np.testing.assert_allclose(up, -0.01 + 0.8 * along, atol=2e-6)


def test_a_section_in_dxf_has_a_piece_for_each_tread(ladder_file, tmp_path) -> None:
    ezdxf = pytest.importorskip("ezdxf")
    path = tmp_path / "s.dxf"
    run(ladder_file, "-o", path, "--line=-6cm,0m,6cm,0m")
    lines = ezdxf.readfile(path).modelspace().query('LWPOLYLINE[layer=="section"]')
    found = sorted(np.mean([y for _, y in line.get_points("xy")]) for line in lines)
    np.testing.assert_allclose(found, -DEPTHS, atol=1e-9)


def test_heights_are_a_geotiff_with_their_uncertainty(ladder_file, tmp_path) -> None:
    tifffile = pytest.importorskip("tifffile")
    path = tmp_path / "dem.tif"
    run(ladder_file, "-o", path)
    with tifffile.TiffFile(path) as file:
        height, sigma, own, _ = file.asarray()
        description = file.pages[0].description
    np.testing.assert_allclose(levels(height), -DEPTHS, atol=2e-6)
    there = np.isfinite(height)
    assert np.all(sigma[there] >= own[there])
    np.testing.assert_allclose(sigma[there] ** 2 - own[there] ** 2, 1e-8, rtol=2e-3)
    assert "standard uncertainties" in description
    assert "right-handed" in description


def test_contours_of_a_slope_lie_where_it_has_their_height(tmp_path, capsys) -> None:
    ezdxf = pytest.importorskip("ezdxf")
    slope = scenes.plane((0.3, 0.0, 0.954), 1.5, own=2e-4)
    order = Order(product="contours", contours=0.01)
    hand_over(slope, tmp_path / "c.dxf", order)
    lines = ezdxf.readfile(tmp_path / "c.dxf").modelspace()
    lines = lines.query('LWPOLYLINE[layer=="contours"]')
    assert len(lines) == 4  # 0.12 m of width, sloping by 0.3 / 0.954
    for line in lines:
        level = line.dxf.elevation
        assert level * 100 == pytest.approx(round(level * 100), abs=1e-9)
        right = np.array([x for x, _ in line.get_points("xy")])
        np.testing.assert_allclose(right, (1.5 + 0.954 * level) / 0.3, atol=1e-6)
    hand_over(slope, tmp_path / "c.csv", order)
    rows = read_csv(tmp_path / "c.csv")
    sigma = {float(row["standard_uncertainty_of_level [m]"]) for row in rows}
    assert 5e-5 < min(sigma) <= max(sigma) < 2.1e-4
    hand_over(slope, tmp_path / "c.svg", order)
    found = ET.parse(tmp_path / "c.svg").getroot()
    assert len(found.findall(".//*[@id='contours']/*")) == 4


def test_a_flat_wall_has_no_contours_and_the_command_says_so(tmp_path, capsys) -> None:
    rng = np.random.default_rng(2)
    wall = scenes.drawn(scenes.plane((0, 0, 1), 1.5, own=2e-4), rng, 2e-4)
    io.write_cube(wall, tmp_path / "wall.nc")
    words = ["-o", str(tmp_path / "c.csv"), "--contours", "10mm"]
    assert main(["export", str(tmp_path / "wall.nc"), *words]) == 1
    assert "stands out of the noise" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["wall.nc"]


@pytest.mark.parametrize(
    "ending", ["png", "svg", pytest.param("pdf", marks=pytest.mark.slow)]
)
def test_an_orthoimage_is_true_to_scale(ladder_file, tmp_path, ending) -> None:
    path = tmp_path / f"o.{ending}"
    run(ladder_file, "-o", path, "--scale", "1:2", "--dpi", "300", "--show", "height")
    if ending == "png":
        with Image.open(path) as found:
            dots = np.array(found)
            size = found.info["dpi"][0]
        assert size == pytest.approx(300, abs=0.1)
        there = np.flatnonzero(dots[..., 3].any(axis=0))
        # Beams reach 33 mrad to either side at 1.43 and 1.5 m: 96.7 mm.
        width = np.ptp(there) / size * 25.4 * 2
        assert width == pytest.approx(1.5 * np.tan(0.033) * 1e3 + 1.43 * 33.0, abs=4)
    elif ending == "svg":
        root = ET.parse(path).getroot()
        width = float(root.get("width").removesuffix("pt")) / 72 * 25.4
        assert width == pytest.approx(297, abs=0.1)
    else:
        content = path.read_bytes()
        box = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+)", content)
        size = [float(v) / 72 * 25.4 for v in box.groups()]
        assert size == pytest.approx([297, 210], abs=0.1)


def test_a_mesh_has_the_uncertainty_of_each_vertex(ladder_file, tmp_path) -> None:
    path = tmp_path / "m.ply"
    run(ladder_file, "-o", path, "--product", "mesh", "--axes", "z-up")
    mesh = trimesh.load(path, process=False)
    assert isinstance(mesh, trimesh.Trimesh)
    raw = mesh.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_allclose(levels(mesh.vertices[:, 1]), DEPTHS[::-1], atol=1e-6)
    np.testing.assert_allclose(
        raw["scalar_slant_range_uncertainty"], np.hypot(2e-4, 1e-4)
    )
    # Nearly all of a range's error is along the forward axis, now y.
    assert raw["scalar_sigma_y"].min() > 0.999 * np.hypot(2e-4, 1e-4)
    assert raw["scalar_sigma_x"].max() < 0.04 * np.hypot(2e-4, 1e-4)
    # Five treads, none joined to another, all facing the instrument.
    assert mesh.body_count == 5
    assert np.all(mesh.face_normals[:, 1] < -0.99)


def test_a_cloud_in_laz_has_sigmas_and_z_up(ladder_file, tmp_path) -> None:
    path = tmp_path / "c.laz"
    run(ladder_file, "-o", path, "--axes", "z-up")
    found = laspy.read(path)
    np.testing.assert_allclose(levels(np.asarray(found.y)), DEPTHS[::-1], atol=2e-6)
    assert np.asarray(found["sigma_y"]).mean() == pytest.approx(2.236e-4, rel=1e-3)
    assert b"x right, y forward, z up" in found.evlrs[0].record_data


def test_a_pose_places_the_cloud(ladder_file, tmp_path) -> None:
    pose = tmp_path / "pose.toml"
    pose.write_text(
        '[pose]\nheading = "90 deg"\nposition = ["100 m", "50 m", "-7 m"]\n'
        'crs = "EPSG:32632"\ncrs_offset = ["5e5 m", "4.9e6 m", "0 m"]\n'
    )
    path = tmp_path / "c.e57"
    run(ladder_file, "-o", path, "--pose", pose)
    with pye57.E57(str(path)) as file:
        found = file.read_scan(0, transform=True)
        text = file.get_header(0)["description"].value()
    # Looking east, the treads stand so far east of the instrument.
    np.testing.assert_allclose(
        levels(found["cartesianX"]), 100 + DEPTHS[::-1], atol=1e-6
    )
    assert "add (500000, 4900000, 0) m" in text
    assert "not known: position, heading, level" in text


def test_a_deviation_from_the_model_is_its_offset(
    ladder_file, tmp_path, capsys
) -> None:
    model = tmp_path / "wall.stl"
    # A wall at 1.5 m in millimetres: the treads stand before it by their heights.
    corners = [[-90, -90, 1500], [90, -90, 1500], [-90, 90, 1500], [90, 90, 1500]]
    trimesh.Trimesh(corners, [[0, 1, 2], [1, 3, 2]]).export(model)
    table = tmp_path / "d.csv"
    words = ["--against", model, "--unit", "mm"]
    run(ladder_file, "-o", table, *words)
    assert "significant" in capsys.readouterr().out
    rows = read_csv(table)
    found = np.array([float(row["deviation [m]"]) for row in rows])
    np.testing.assert_allclose(levels(found), 1.5 - DEPTHS, atol=2e-6)
    significant = np.array([int(row["significant"]) for row in rows])
    np.testing.assert_array_equal(significant == 1, found > 1e-3)


@pytest.mark.slow
def test_deviations_have_maps_and_meshes_too(ladder_file, tmp_path) -> None:
    model = tmp_path / "wall.obj"
    corners = [[-90, -90, 1500], [90, -90, 1500], [-90, 90, 1500], [90, 90, 1500]]
    trimesh.Trimesh(corners, [[0, 1, 2], [1, 3, 2]]).export(model)
    words = ["--against", model, "--unit", "mm"]
    run(ladder_file, "-o", tmp_path / "d.csv", *words)
    rows = read_csv(tmp_path / "d.csv")
    run(ladder_file, "-o", tmp_path / "near.csv", *words, "--farthest", "25mm")
    assert len(read_csv(tmp_path / "near.csv")) < len(rows) / 3
    for ending in ("png", "ply"):
        run(ladder_file, "-o", tmp_path / f"d.{ending}", *words)
    raw = trimesh.load(tmp_path / "d.ply", process=False).metadata["_ply_raw"]
    values = raw["vertex"]["data"]["scalar_deviation"]
    np.testing.assert_allclose(levels(values), 1.5 - DEPTHS, atol=2e-6)


@pytest.mark.slow
def test_a_scan_against_itself_deviates_by_nothing(
    ladder_file, tmp_path, capsys
) -> None:
    run(ladder_file, "-o", tmp_path / "d.csv", "--against", ladder_file)
    assert "0.0% significant" in capsys.readouterr().out


def test_points_are_left_out_on_request(ladder, tmp_path, capsys) -> None:
    image = ladder.copy(deep=True)
    image["quality_flag"].values[3, 4:7] = 64
    image["slant_range_uncertainty"].values[5, :] = 3e-3
    path = tmp_path / "i.nc"
    io.write_cube(image, path)
    counts = []
    for words in (
        [],
        ["--without-mixed"],
        ["--good-only", "--largest-uncertainty=1mm"],
    ):
        run(path, "-o", tmp_path / "c.xyz", "--overwrite", *words)
        counts.append(len(np.loadtxt(tmp_path / "c.xyz")))
        assert "doubtful" in capsys.readouterr().out if not words else True
    usable = int(np.isfinite(ladder["slant_range"]).sum())
    row = int(np.isfinite(ladder["slant_range"][5]).sum())
    assert counts == [usable, usable - 3, usable - 3 - row]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["-o", "x.tif", "--product", "mesh"], "use one of .ply"),
        (["-o", "x.dxf"], "needs --contours"),
        (["-o", "x.svg", "--product", "section"], "needs --line"),
        (["-o", "x.png", "--product", "deviation"], "needs --against"),
        (["-o", "x.png", "--scale", "20"], "such as 1:20"),
        (["-o", "x.png", "--scale", "1:0"], "such as 1:20"),
        (["-o", "x.csv", "--line=1m,2m"], "four lengths"),
        (["-o", "x.csv", "--line=1m,2m,1m,2m"], "the same"),
        (["-o", "x.tif", "--line=0m,0m,1m,0m"], "--output x.tif: the ending"),
        (["-o", "x.tif", "--cell=-1mm"], "above 0 m"),
        (["-o", "x.ply", "--largest-uncertainty", "0 m"], "above 0 m"),
        (["-o", "x.png", "--dpi", "1"], "dpi"),
        (["-o", "x.laz", "--axes", "up"], "axes"),
    ],
)
def test_wrong_orders_are_refused_before_the_work(
    ladder_file, words, text, tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["export", str(ladder_file), *words]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert text in message.lower() or text in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["-o", "x.laz", "--axes", "pose"], "states no pose"),
        (["-o", "x.laz", "--pose", "none.toml"], "none.toml"),
        (["-o", "x.csv", "--against", "none.stl"], "does not exist"),
        (["-o", "x.csv", "--against", "none.txt"], "a mesh"),
        (["-o", "x.pdf", "--scale", "1:0.01"], "smaller scale"),
        (["-o", "x.csv", "--line=5m,0m,6m,0m"], "meets no surface"),
        (["-o", "no/x.ply"], "no folder"),
    ],
)
def test_what_cannot_be_is_one_line_and_leaves_nothing(
    ladder_file, words, text, tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["export", str(ladder_file), *words]) == 1
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert text in message
    assert list(tmp_path.iterdir()) == []


def test_a_mesh_that_is_none_is_one_line(ladder_file, tmp_path, capsys) -> None:
    bad = tmp_path / "bad.ply"
    bad.write_bytes(b"ply\nnonsense")
    words = [str(ladder_file), "-o", str(tmp_path / "x.csv"), "--against", str(bad)]
    assert main(["export", *words]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_every_ending_of_every_product_is_taken() -> None:
    for product, endings in ENDINGS.items():
        for ending in endings:
            path = Path(f"x{ending}")
            stated = {
                "section": {"line": (0, 0, 1, 1)},
                "deviation": {"against": path},
                "contours": {"contours": 0.01},
            }.get(product, {})
            found = product_of(path, **stated)
            assert ending in ENDINGS[found]
            if product in ("cloud", "section", "deviation"):
                assert found == product


def test_the_library_refuses_a_wrong_ending_itself(ladder, tmp_path) -> None:
    from amulor.errors import FormatError

    with pytest.raises(FormatError, match=r"mesh is written to \.ply"):
        hand_over(ladder, tmp_path / "x.obj", Order(product="mesh"))


@pytest.mark.parametrize(
    ("stated", "title", "written"),
    [("Deck", "Hull", "Deck"), ("", "Hull", "Hull"), ("", "", "scan")],
)
def test_a_picture_has_the_stated_title_or_that_of_the_image(
    ladder, tmp_path, stated: str, title: str, written: str
) -> None:
    from PIL import Image

    path = tmp_path / "x.png"
    order = Order(product="orthoimage", title=stated, dots_per_inch=30)
    hand_over(ladder.assign_attrs(title=title), path, order)
    with Image.open(path) as picture:
        assert picture.text["Title"] == f"{written}, 1:1"


@pytest.mark.parametrize("ending", [".tif", ".TIFF", ".svg"])
def test_deviations_are_bands_of_a_geotiff_or_a_sheet(monkeypatch, ending) -> None:
    layers = {"value": 1.0, "sigma": 2.0, "sure": 3.0}
    raster = SimpleNamespace(layers=layers)
    written: list[object] = []
    monkeypatch.setattr(references, "_raster", lambda *_: (raster, None))
    monkeypatch.setattr(references, "deviation_sheet", lambda *_: ("figure", "block"))
    monkeypatch.setattr(
        drawings, "write_bands", lambda _, bands, *rest, **words: written.extend(bands)
    )
    monkeypatch.setattr(
        drawings, "save_sheet", lambda figure, *_, **words: written.append(figure)
    )
    nothing: Any = None
    references._write_map(
        nothing, Path(f"a{ending}"), nothing, ("title", ("statement",)), overwrite=False
    )
    if ending == ".svg":
        assert written == ["figure"]
        return
    assert [(band.values, band.unit) for band in written] == [
        (1.0, "m"), (2.0, "m"), (3.0, "1"),
    ]  # fmt: skip
