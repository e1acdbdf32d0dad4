"""Comparisons with a reference: tables, maps and sentences of deviations."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from amulor import imaging, io
from amulor.cube import QualityFlag
from amulor.errors import CubeError, FormatError
from amulor.handover import Order, drawings, hand_over, order, products, references
from amulor.imaging import frame_of
from amulor.imaging import products as made
from amulor.imaging.moving import MovingFrame
from amulor.survey import Pose

WALL = scenes.plane((0.0, 0.0, 1.0), 1.5, rows=4, columns=6, own=2e-4)
SURFACE = made.surface(WALL)
SAID: tuple[str, list[str]] = ("Wall", ["made"])


def deviation_of(**changes: Any) -> made.Deviation:
    """Return deviations of the 24 pixels of a wall, most of them unknown."""
    value = np.full(24, np.nan)
    value[[1, 8, 9, 23]] = [1e-3, -2e-3, 4e-3, 3e-3]
    fields: dict[str, Any] = {
        "value": value, "uncertainty": np.full(24, 5e-4), "own": np.full(24, 3e-4),
        "significant": np.isin(np.arange(24), [8, 9, 23]), "surface": SURFACE,
        "mean": 1.5e-3, "mean_uncertainty": 2.5e-4, "spread": 2.29e-3,
    }  # fmt: skip
    return made.Deviation(**(fields | changes))


def test_a_comparison_is_summed_up_in_a_sentence() -> None:
    """Three of four compared pixels are significant; unknown errors are so called."""
    assert references.summary_of(deviation_of()) == (
        "4 pixels compared: mean +1.5 mm, standard uncertainty 0.25 mm; spread 2.29 "
        "mm; 75.0% significant"
    )
    unknown = references.summary_of(deviation_of(mean=-1e-3, mean_uncertainty=np.nan))
    assert unknown.startswith(
        "4 pixels compared: mean -1 mm, standard uncertainty not known; spread"
    )


def test_a_comparison_states_direction_chance_and_place() -> None:
    """The statements of the scan follow those of the comparison."""
    title, statements = references.described(deviation_of(), SAID, "m.ply", "place")
    assert title == "Wall: deviation"
    assert statements == [
        "Deviation along the normal of m.ply, positive towards the instrument",
        f"{references.summary_of(deviation_of())}; of the significant pixels 5 % are "
        "so by chance (Benjamini and Hochberg)",
        "place",
        "made",
    ]


def test_a_table_of_deviations_has_the_compared_pixels(monkeypatch) -> None:
    """Pixels are counted row by row, six in a row."""
    written: list[Any] = []
    monkeypatch.setattr(
        references.formats,
        "write_table",
        lambda *words, **more: written.append((words, more)),
    )
    references._write_table(deviation_of(), Path("d.csv"), ["said"], overwrite=True)
    (((table, path), more),) = written
    assert (path, more) == (Path("d.csv"), {"statements": ["said"], "overwrite": True})
    assert {name: np.asarray(values).tolist() for name, values in table.items()} == {
        "row": [0, 1, 1, 3],
        "column": [1, 2, 3, 5],
        "x [m]": pytest.approx(SURFACE.position[[1, 8, 9, 23], 0].tolist()),
        "y [m]": pytest.approx(SURFACE.position[[1, 8, 9, 23], 1].tolist()),
        "z [m]": pytest.approx([1.5] * 4),
        "deviation [m]": [1e-3, -2e-3, 4e-3, 3e-3],
        "standard_uncertainty [m]": [5e-4] * 4,
        "own_part [m]": [3e-4] * 4,
        "significant": [False, True, True, True],
    }


@pytest.mark.parametrize(
    ("cell", "fine", "scale", "expected"),
    [
        # A quarter of a millimeter of paper at 1:8, or a rounded pixel of 24 mm.
        (None, True, 8.0, 2e-3),
        (None, False, 8.0, 0.02),
        (None, True, 200.0, 0.02),
        (0.01, True, 8.0, 0.01),
    ],
)
def test_maps_of_deviations_have_fine_cells_on_paper(
    monkeypatch, cell: float | None, fine: bool, scale: float, expected: float
) -> None:
    """Pixels that are not compared have no significance."""
    monkeypatch.setattr(made, "raster", lambda *words, **more: (words, more))
    chosen = Order(product="deviation", scale=scale, cell=cell)
    raster: Any
    raster, found = references._raster(deviation_of(), chosen, fine=fine)
    (surface, plane), more = raster
    assert (surface, plane.side, found) == (SURFACE, "front", scale)
    assert more["cell"] == pytest.approx(expected)
    layers = more["layers"]
    assert_allclose(layers["value"], deviation_of().value)
    assert_allclose(layers["sigma"], 5e-4)
    assert_allclose(layers["sure"][[0, 1, 8, 9, 23]], [np.nan, 0, 1, 1, 1])


@pytest.mark.parametrize(
    ("sure", "shown", "note"),
    [
        ([0.49, 0.5, 1.0, np.nan], [np.nan, 2.0, 3.0, np.nan],
         "Colored where the deviation is significant, gray elsewhere"),
        ([0.49, 0.0, 0.0, np.nan], [1.0, 2.0, 3.0, 4.0],
         "No deviation is significant: what is shown is chance"),
    ],
)  # fmt: skip
def test_a_sheet_of_deviations_colors_what_is_significant(
    monkeypatch, sure: list[float], shown: list[float], note: str
) -> None:
    """Cells count of which half the pixels are significant."""
    drawn: list[Any] = []
    layers = {"value": np.array([1.0, 2.0, 3.0, 4.0]), "sure": np.array(sure)}
    plane = made.plane_of(SURFACE.frame)
    raster = SimpleNamespace(layers=layers, plane=plane)
    monkeypatch.setattr(references, "_raster", lambda *_, fine: (raster, 5.0 + fine))
    monkeypatch.setattr(
        references,
        "sheet",
        lambda *words, **more: drawn.append((words, more)) or Figure(),
    )
    chosen = Order(product="deviation", fields={"author": "D"})
    _, block = references.deviation_sheet(deviation_of(), chosen, SAID)
    (((first, second), more),) = drawn
    assert (first, second) == (raster, block)
    assert_allclose(more.pop("values"), shown)
    assert more == {"scale": 6.0, "show": "deviation"}
    assert (block.title, block.statements) == ("Wall", (note, "made"))
    assert block.fields == {"author": "D", "view": "front elevation"}


def test_a_mesh_of_deviations_has_them_at_its_vertices(monkeypatch) -> None:
    """The significance is a number, and all have names and units."""
    written: dict[str, Any] = {}
    monkeypatch.setattr(references, "compare", lambda *_: deviation_of())
    monkeypatch.setattr(
        references, "write_mesh", lambda *_, **more: written.update(more)
    )
    chosen = Order(product="deviation", against=Path("x/m.ply"))
    said = references.write_deviation(
        WALL, Path("d.PLY"), chosen, SURFACE, SAID, overwrite=True
    )
    assert said == references.summary_of(deviation_of())
    assert written.pop("overwrite") is True
    scalars = written["scalars"]
    assert {name: text for name, (_, text) in scalars.items()} == {
        "scalar_deviation": "deviation [m]",
        "scalar_deviation_uncertainty": "its standard uncertainty [m]",
        "scalar_significant": "1 where it is significant [1]",
    }
    assert_allclose(scalars["scalar_deviation"][0], deviation_of().value)
    assert_allclose(scalars["scalar_deviation_uncertainty"][0], 5e-4)
    assert scalars["scalar_significant"][0].dtype == float
    assert scalars["scalar_significant"][0].sum() == 3.0


@pytest.mark.parametrize(("ending", "to"), [("csv", "table"), ("png", "map")])
def test_deviations_are_written_by_the_ending_of_the_file(
    monkeypatch, ending: str, to: str
) -> None:
    """A table begins with the title of the comparison; the reference has its name."""
    written: list[Any] = []
    monkeypatch.setattr(references, "compare", lambda *_: deviation_of())
    for name in ("table", "map"):
        monkeypatch.setattr(
            references,
            f"_write_{name}",
            lambda *words, name=name, overwrite: written.append((name, words[-1])),
        )
    chosen = Order(product="deviation", against=Path("x/m.ply"))
    references.write_deviation(
        WALL, Path(f"d.{ending}"), chosen, SURFACE, SAID, overwrite=False
    )
    title, statements = references.described(
        deviation_of(), SAID, "m.ply", references.PLACE_KNOWN
    )
    expected = [title, *statements] if to == "table" else (title, statements)
    assert written == [(to, expected)]


def test_a_page_compares_each_image_with_one_reading_of_the_mesh(tmp_path) -> None:
    """A wall in millimeters, 5 mm behind the scan, is 5 mm off."""
    trimesh = pytest.importorskip("trimesh")
    corners = [[-90, -90, 1505], [90, -90, 1505], [-90, 90, 1505], [90, 90, 1505]]
    path = tmp_path / "wall.stl"
    trimesh.Trimesh(corners, [[0, 1, 2], [1, 3, 2]]).export(path)
    compared = references.comparison(path, unit="mm")
    path.unlink()
    deviation, words = compared(WALL)
    assert deviation.mean == pytest.approx(5e-3, abs=1e-6)
    assert deviation.compared == 24
    assert words == (
        "Deviation along the normal of wall.stl, positive towards the instrument. "
        f"{references.summary_of(deviation)}; of the significant pixels 5 % are so by "
        "chance (Benjamini and Hochberg)"
    )


def test_two_scans_are_compared_in_the_frame_of_their_poses(monkeypatch) -> None:
    """An image without a pose, or a mesh, is compared in axes of the instrument."""
    asked: list[str] = []

    def frame(image: Any, *, axes: str = "instrument", pose: Any = None) -> Any:
        asked.append(axes)
        if axes == "pose" and image is None and pose is None:
            raise CubeError("no pose")
        return axes, pose

    monkeypatch.setattr(references.imaging, "frame_of", frame)
    nothing: Any = None
    image: Any = "posed"
    assert references._posed(nothing, Path("a.nc")) == ("instrument", None)
    assert references._posed(image, Path("a.NC")) == ("pose", None)
    assert references._posed(image, Path("a.ply")) == ("instrument", None)
    assert asked == ["pose", "instrument", "pose", "instrument"]
    pose = Pose()
    with_pose: Any = SimpleNamespace(name="pose", pose=pose)
    # An earlier scan without a pose stands where this scan does.
    assert references._frame_of(nothing, with_pose) == ("pose", pose)
    assert references._frame_of(image, with_pose) == ("pose", None)


def test_an_earlier_scan_brings_its_own_errors(tmp_path) -> None:
    """A scan 1 mm behind an earlier one; both have noise and a shared error."""
    earlier = scenes.plane((0.0, 0.0, 1.0), 1.5, rows=8, columns=12, own=3e-4)
    io.write_cube(earlier, tmp_path / "earlier.nc")
    later = scenes.plane((0.0, 0.0, 1.0), 1.501, rows=4, columns=6, own=4e-4)
    chosen = Order(product="deviation", against=tmp_path / "earlier.nc")
    deviation = references.compare(made.surface(later), chosen)
    inside = np.isfinite(deviation.value)
    assert_allclose(deviation.value[inside], -1e-3, atol=1e-9)
    # Means of three vertices of the earlier scan have less noise, but some.
    assert np.all(deviation.own[inside] > 4.2e-4)
    assert np.all(deviation.own[inside] <= 5.001e-4)
    near = replace(chosen, farthest=5e-4)
    with pytest.raises(CubeError):
        references.compare(made.surface(later), near)


def test_a_reference_is_a_mesh_of_finite_triangles(tmp_path) -> None:
    """Units are those of the order; other files have a line that says why not."""
    pytest.importorskip("trimesh")
    path = tmp_path / "model.off"
    path.write_text("OFF\n4 2 0\n0 0 0\n2 0 0\n0 3 0\n0 0 4\n3 0 1 2\n3 0 1 3\n")
    vertices, faces = references.read_mesh(path, unit=1e-3)
    assert_allclose(vertices, [[0, 0, 0], [2e-3, 0, 0], [0, 3e-3, 0], [0, 0, 4e-3]])
    assert faces.tolist() == [[0, 1, 2], [0, 1, 3]]
    path.write_text("OFF\n3 1 0\n0 0 0\n2 0 0\n0 nan 0\n3 0 1 2\n")
    with pytest.raises(FormatError, match="has triangles with corners that are not f"):
        references.read_mesh(path, unit=1.0)
    with pytest.raises(FormatError, match=r"none\.off does not exist; check the name"):
        references.read_mesh(tmp_path / "none.off", unit=1.0)
    with pytest.raises(FormatError, match=r"is a mesh \(\.ply, \.stl, \.obj, \.off, "):
        references.read_mesh(tmp_path / "none.txt", unit=1.0)


def test_a_file_states_axes_errors_index_and_origin() -> None:
    """All statements of a scan, in order; an uncertainty of the beams is never in."""
    image = scenes.plane((0.0, 0.0, 1.0), 1.5, rows=3, columns=3, own=4e-4, shared=3e-4)
    frame = frame_of(image, axes="pose", pose=Pose(position=(1.5, 2.0, -3.0)))
    image.attrs.update(simulated=1, history="first\n2026-05-01 last")
    assert order.statements_of(image, frame) == [
        "Axes: right-handed: x east, y north, z up, in the local frame of the pose [m]",
        "Instrument at (1.5, 2, -3) m; pose as stated",
        "Uncertainties are standard uncertainties (GUM, k = 1); about 95 of 100 errors "
        "lie within twice as much. Slant range: median 0.5 mm, of which all pixels "
        "share 0.3 mm",
        "Not in them: position of the pose, heading of the pose, level of the pose, "
        "directions of the beams, which count as known",
        "Meters of water range by the group index 1.3800",
        "Simulated data; nothing here was measured",
        "Last step: 2026-05-01 last",
    ]


def test_a_file_of_unknown_errors_states_why_and_no_interval() -> None:
    """The reason takes the place of the uncertainties."""
    image = scenes.plane((0.0, 0.0, 1.0), 1.5, rows=3, columns=3, own=np.nan)
    image["quality_flag"].values |= np.int16(QualityFlag.NO_OPEN_WATER)
    assert order.statements_of(image, frame_of(image)) == [
        "Axes: right-handed: x right, y down, z forward, in the instrument's axes [m]",
        "Water not removed: error unknown, expect centimeters",
        "Meters of water range by the group index 1.3800",
    ]


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ([1e-3, 2e-3, 9e-3], "2 mm (median)"),
        ([np.nan, 1.25e-3], "1.2 mm (median)"),
        ([np.nan, np.inf], "not known"),
        ([], "not known"),
    ],
)
def test_an_uncertainty_is_a_median_in_millimeters(values, text) -> None:
    """Values that are not finite are not known."""
    assert order.in_millimetres(values) == text


@pytest.mark.parametrize(
    ("path", "options", "product"),
    [
        ("a.csv", {}, "cloud"), ("a.LAZ", {}, "cloud"), ("a.nc", {}, "cloud"),
        ("a.ply", {"contours": 1}, "cloud"), ("a.csv", {"contours": 1}, "contours"),
        ("a.dxf", {}, "contours"), ("a.tif", {}, "dem"), ("a.TIFF", {}, "dem"),
        ("a.png", {}, "orthoimage"), ("a.pdf", {"contours": 1}, "orthoimage"),
        ("a.svg", {"line": 1}, "section"), ("a.csv", {"line": 1}, "section"),
        ("a.csv", {"against": 1}, "deviation"),
        ("a.csv", {"line": 1, "against": 1}, "section"),
    ],
)  # fmt: skip
def test_ending_and_options_tell_the_product(path, options, product) -> None:
    """A section line goes before a reference, both before the ending."""
    assert order.product_of(Path(path), **options) == product


def test_an_unknown_ending_is_refused_with_all_known_ones() -> None:
    """Each ending is named once."""
    with pytest.raises(FormatError) as refused:
        order.product_of(Path("a.docx"))
    words, _, endings = str(refused.value).partition("use one of ")
    assert words == "a.docx: the ending says the format; "
    names = endings.split(", ")
    assert len(set(names)) == len(names)
    assert {".laz", ".nc", ".ply", ".png", ".tif", ".dxf", ".csv", ".pdf"} <= set(names)


def test_a_raster_of_heights_is_described_in_a_line(monkeypatch, tmp_path) -> None:
    """Columns come before rows; a warning follows with a small letter."""
    pytest.importorskip("tifffile")
    monkeypatch.setattr(drawings, "grazing_warning", lambda *_: ["Warning: x"])
    chosen = Order(product="dem", cell=0.02, scale=4.0)
    said = hand_over(WALL, tmp_path / "d.tif", chosen)
    # 0.12 m wide and 0.08 m high in cells of 20 mm, with a cell all around.
    words = r"8 x 6 cells of 20 mm, 1:4, standard uncertainty of heights 0\.\d+ mm"
    assert re.fullmatch(words + r" \(median\); warning: x", said)


def test_a_picture_states_its_dots_and_colors(monkeypatch) -> None:
    """At 1:4 and 20 mm cells there are 200 dots in a meter of paper."""
    written: list[Any] = []
    monkeypatch.setattr(
        products.formats,
        "write_picture",
        lambda *words, **more: written.append((words, more)),
    )
    colours = ("pixels", (-1234.5678, 2.0), "mm")
    monkeypatch.setattr(products, "colours_of", lambda raster, show: colours)
    chosen = Order(product="orthoimage", cell=0.02, scale=4.0, show="height", title="T")
    hand_over(WALL, Path("d.png"), chosen, overwrite=True)
    (((pixels, path), more),) = written
    assert (pixels, path) == ("pixels", Path("d.png"))
    assert more["dots_per_metre"] == pytest.approx(200.0)
    assert more["overwrite"] is True
    assert more["texts"]["Title"] == "T, 1:4"
    lines = more["texts"]["Description"].split("\n")
    assert lines[0] == "height from -1235 to 2 mm"
    assert lines[1].startswith("Seen from the front; ")
    assert lines[2].startswith("Axes: ")


@pytest.mark.parametrize(
    ("settings", "shown", "first"),
    [
        ({"product": "dem"}, "height", "Seen from the front; "),
        ({"product": "dem", "show": "amplitude"}, "height", "Seen from the front; "),
        ({"product": "orthoimage"}, "amplitude", "Seen from the front; "),
        ({"product": "orthoimage", "show": "relief"}, "relief", "Light from the upper"),
    ],
)
def test_a_sheet_shows_what_is_ordered(
    monkeypatch, settings: Any, shown: str, first: str
) -> None:
    """Heights for a map of heights; a relief states its light."""
    drawn: list[Any] = []
    monkeypatch.setattr(
        products, "sheet", lambda *words, **more: drawn.append((words, more))
    )
    monkeypatch.setattr(drawings, "save_sheet", lambda *_, **__: None)
    chosen = Order(cell=0.02, scale=4.0, **settings)
    hand_over(WALL, Path("d.svg"), chosen)
    ((_, block), more) = drawn[0]
    assert more == {"scale": 4.0, "show": shown, "contours": ()}
    assert block.statements[0].startswith(first)
    assert block.title == "scene"


def test_a_cloud_counts_its_points_and_doubts(tmp_path) -> None:
    """Doubtful points are counted; the reason for unknown errors is stated."""
    image = scenes.plane((0.0, 0.0, 1.0), 1.5, rows=4, columns=6, own=2e-4)
    chosen = Order(product="cloud")
    path = tmp_path / "c.xyz"
    assert hand_over(image, path, chosen) == "24 points"
    image["quality_flag"].values[0, :3] = [64, 128, 64]
    image["quality_flag"].values[1, 0] = 4
    said = hand_over(image, path, chosen, overwrite=True)
    assert said == "23 points, 3 of them doubtful"
    image["quality_flag"].values[:] = int(QualityFlag.NO_OPEN_WATER)
    image["slant_range_uncertainty"].values[:] = np.nan
    said = hand_over(image, tmp_path / "c.nc", chosen)
    reason = "water not removed: error unknown, expect centimeters"
    assert said == f"24 points, 24 of them doubtful: {reason}"
    assert io.read_cube(tmp_path / "c.nc").sizes["point"] == 24


@pytest.mark.parametrize(
    ("unposed", "unknown", "words"),
    [
        (2, (), "; 2 without a pose left out"),
        (0, ("position", "heading"), "; not in the uncertainties: position, heading"),
        (0, (), ""),
    ],
)
def test_a_cloud_of_a_moving_scan_counts_pixels_without_a_pose(
    monkeypatch, tmp_path, unposed: int, unknown: tuple[str, ...], words: str
) -> None:
    """Pixels without a range need no pose; only MCAP files have all covariances."""

    class Moving(MovingFrame):
        def __init__(self) -> None:
            pass

    Moving.known = np.arange(24).reshape(4, 6) >= unposed + 1  # type: ignore[assignment]
    Moving.unknown = unknown  # type: ignore[assignment,misc]
    image = scenes.plane((0.0, 0.0, 1.0), 1.5, rows=4, columns=6)
    image["quality_flag"].values[0, 0] = 4
    cloud = imaging.point_cloud(image)
    full: list[bool] = []
    monkeypatch.setattr(
        imaging,
        "point_cloud",
        lambda image, frame, covariance: full.append(covariance) or cloud,
    )
    written: list[Any] = []
    monkeypatch.setattr(io, "write_cloud", lambda *_, **more: written.append(more))
    chosen = Order(product="cloud", slim=True)
    for name in ("c.MCAP", "c.laz"):
        said = hand_over(image, tmp_path / name, chosen, frame=Moving(), overwrite=True)
        assert said == f"23 points{words}"
    assert full == [True, False]
    assert written == [{"slim": True, "overwrite": True}] * 2
    message = "a scan from a vehicle becomes a cloud, but no mesh so far"
    with pytest.raises(CubeError, match=message):
        hand_over(image, tmp_path / "m.ply", Order(product="mesh"), frame=Moving())


def test_a_mesh_counts_vertices_and_triangles(tmp_path) -> None:
    """A wall of 4 by 6 pixels has 3 by 5 squares of two triangles."""
    said = hand_over(WALL, tmp_path / "m.ply", Order(product="mesh"))
    assert said == "24 vertices, 30 triangles"
    with pytest.raises(FormatError, match=r"m\.ply exists already"):
        hand_over(WALL, tmp_path / "m.ply", Order(product="mesh"))
