"""Line drawings hold the numbers, the labels and the statements of what they show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.handover import Order, drawings
from amulor.imaging import products
from amulor.imaging.measure import Fit, Revolution

#: Wall whose right side is nearer, 0.12 m wide and 0.06 m high, 1.57 m ahead.
WALL = scenes.plane((0.3, 0.0, 0.954), 1.5, rows=9, columns=17, own=2e-4)
SURFACE = products.surface(WALL)
FRONT = products.plane_of(SURFACE.frame)


def test_a_section_has_its_places_along_the_line_and_in_the_view() -> None:
    """The heights are those of the plane 0.3 right - 0.954 nearer = 1.5."""
    order = Order(product="section", line=(-0.03, -0.02, 0.03, 0.025))
    drawn = drawings.section(SURFACE, FRONT, order, ("Wall", ["made"]))
    table = {name: np.asarray(column) for name, column in drawn.table.items()}
    assert list(table) == [
        "piece", "along [m]", "nearer [m]", "standard_uncertainty [m]", "own_part [m]",
        "right [m]", "up [m]",
    ]  # fmt: skip
    along, right, up = (table[f"{name} [m]"] for name in ("along", "right", "up"))
    # 6 cm to the right and 4.5 cm up: 7.5 cm.
    assert along[[0, -1]] == pytest.approx([0.0, 0.075])
    assert_allclose(right, -0.03 + 0.8 * along)
    assert_allclose(up, -0.02 + 0.6 * along)
    assert_allclose(table["nearer [m]"], -(1.5 - 0.3 * right) / 0.954, atol=1e-9)
    assert set(table["piece"]) == {0}
    drawing = drawn.drawing
    (line,) = drawing.lines
    assert_allclose(line.points, np.stack([along, table["nearer [m]"]], axis=1))
    assert_allclose(line.band, table["standard_uncertainty [m]"])
    assert line.layer == "section"
    assert drawing.title == "Wall: section"
    assert drawing.axes == ("along", "nearer")
    assert [(round(place, 9), name) for place, name in drawing.marks] == [
        (0.0, "A"), (0.075, "A'")
    ]  # fmt: skip
    assert drawing.fields == {"view": "section A-A', front elevation"}
    assert drawing.statements == (
        "Section between the places (-0.03, -0.02, 0.03, 0.025) m, right and up, of "
        "the drawing seen from the front: distance along it, and height (nearer) "
        "towards the viewer from the origin of the axes",
        drawing.statements[1],
        "made",
    )
    said = "Standard uncertainty across the profile: "
    median, _, band = drawing.statements[1].removeprefix(said).partition("; ")
    assert band == "the band is two of them wide to either side"
    assert drawn.summary == (
        f"section of 0.075 m in 1 piece, standard uncertainty {median}"
    )
    assert (drawn.scale, drawn.heights) == (1.0, 1.0)
    assert drawn.key is not None
    assert_allclose(drawn.key[1], [[-0.03, -0.02], [0.03, 0.025]])


def test_exaggerated_heights_of_a_section_make_a_smaller_scale() -> None:
    """At 1:1 the 0.03 m of height are 165 mm on paper at a factor of 5.5."""
    flat = Order(product="section", line=(-0.05, 0.0, 0.05, 0.0))
    high = replace(flat, exaggeration=8.0)
    # 0.1 m to the right are 0.1 * 0.3 / 0.954 = 31.4 mm of height; A4 has 165 mm.
    said: Any = ("", [])
    assert drawings.section(SURFACE, FRONT, flat, said).scale == 1.0
    drawn = drawings.section(SURFACE, FRONT, high, said)
    assert (drawn.scale, drawn.heights) == (2.0, 8.0)
    stated = replace(high, scale=7.0)
    assert drawings.section(SURFACE, FRONT, stated, said).scale == 7.0


def test_a_section_with_an_unknown_error_has_no_band() -> None:
    """One unknown range error makes the band of all pieces unknown."""
    own = SURFACE.own.copy()
    own[len(own) // 2] = np.nan
    order = Order(product="section", line=(-0.05, 0.0, 0.05, 0.0))
    surface = replace(SURFACE, own=own)
    drawn = drawings.section(surface, FRONT, order, ("", []))
    assert drawn.drawing.lines[0].band is None
    assert "the band" not in " ".join(drawn.drawing.statements)


def revolution(**changes: Any) -> Revolution:
    """Return a body with an upright axis through (0.1, 0, 2), 0.8 m high."""
    values = dict(zip(
        ("axis_x", "axis_y", "axis_z", "point_x", "point_y", "point_z"),
        (0.0, -1.0, 0.0, 0.1, 0.0, 2.0),
        strict=True,
    ))  # fmt: skip
    fit = Fit(
        kind="revolution", values=values, residual=4e-4, misfit=1.0, pixels=321,
        uncertainties={"axis_x": 3e-3, "axis_y": 0.0, "axis_z": 4e-3},
        doubt=changes.pop("doubt", ""),
    )  # fmt: skip
    fields: dict[str, Any] = {
        "fit": fit,
        "height": np.array([-0.3, 0.1, 0.5]),
        "radius": np.array([0.1, 0.3, 0.2]),
        "uncertainty": np.array([1e-3, 2e-3, 3e-3]),
        "left_out": 12,
    }
    return Revolution(**(fields | changes))


DIAMETERS = "upper end 400.0 ± 6 mm; widest place 600.0 ± 4 mm; lower end 200.0 ± 2 mm"


def profile(
    monkeypatch: pytest.MonkeyPatch, body: Revolution, **settings: Any
) -> tuple[drawings.LineProduct, list[Any]]:
    """Return the half-profile of a body, and the place that its picture is seen at."""
    seen: list[Any] = []
    monkeypatch.setattr(products, "surface", lambda image: image)
    monkeypatch.setattr(drawings, "_seen_along", lambda *words: seen.extend(words))
    order = Order(product="profile", fields={"author": "D"}, **settings)
    image: Any = "image"
    return drawings.profile(image, order, ("Vase", ["made"]), body=body), seen


def test_a_half_profile_states_diameters_scatter_and_axis(monkeypatch) -> None:
    """Diameters are twice the radii, and their errors twice those of the radii."""
    drawn, seen = profile(monkeypatch, revolution())
    assert drawn.drawing.statements == (
        f"Diameters with standard uncertainty: {DIAMETERS}",
        "Surface of revolution through 321 pixels; 12 others lie off it, such as "
        "handles. Scatter 0.4 mm (rms), direction of the axis within 5 mrad",
        "Only the outside was measured; the thickness of the wall is unknown",
        "made",
    )
    assert drawn.summary == f"half-profile of 800 mm; diameters: {DIAMETERS}"
    assert {name: list(column) for name, column in drawn.table.items()} == {
        "height [m]": pytest.approx([0.0, 0.4, 0.8]),
        "radius [m]": [0.1, 0.3, 0.2],
        "standard_uncertainty [m]": [1e-3, 2e-3, 3e-3],
    }
    # 0.6 m wide and 0.8 m high; A4 has 168 by 165 mm, or 255 by 78 mm.
    assert drawn.scale == 5.0
    image, axis, base, cell = seen
    assert image == "image"
    assert_allclose(axis, [0.0, -1.0, 0.0])
    # The lower end is 0.3 m below the point of the axis; y points downwards.
    assert_allclose(base, [0.1, 0.3, 2.0])
    # Eight cells for each millimeter of paper.
    assert cell == pytest.approx(5.0 / 8 * 1e-3)


def test_a_half_profile_of_a_low_wide_body_fits_its_width(monkeypatch) -> None:
    """The width on paper is the largest diameter, at every height."""
    low = revolution(height=np.array([0.1, 0.11, 0.12]))
    # 600 mm on the 168 or 255 mm of A4.
    assert profile(monkeypatch, low)[0].scale == 5.0
    small = revolution(height=np.array([0.1, 0.11, 0.12]), radius=np.full(3, 0.12))
    assert profile(monkeypatch, small)[0].scale == 1.0
    assert profile(monkeypatch, small, scale=3.0)[0].scale == 3.0


def test_a_doubtful_half_profile_says_so(monkeypatch) -> None:
    """The doubt is a statement and a part of the summary."""
    drawn, _ = profile(monkeypatch, revolution(doubt="not round"))
    assert drawn.drawing.statements[-2:] == ("Doubtful: not round", "made")
    assert drawn.summary.endswith("lower end 200.0 ± 2 mm; doubtful: not round")


def test_a_half_profile_without_known_errors_states_no_axis_error(monkeypatch) -> None:
    """An unknown direction is left out, not printed as nan."""
    body = revolution(uncertainty=np.full(3, np.nan))
    body.fit.uncertainties["axis_z"] = np.nan
    drawn, _ = profile(monkeypatch, body)
    assert drawn.drawing.statements[1].endswith("Scatter 0.4 mm (rms)")
    assert "nan" not in " ".join(drawn.drawing.statements)
    assert drawn.drawing.lines[0].band is None


def test_the_drawing_of_a_half_profile_has_its_texts(monkeypatch) -> None:
    """The band belongs to the profile, and a label to each diameter."""
    drawing = profile(monkeypatch, revolution())[0].drawing
    assert drawing.title == "Vase: half-profile"
    assert drawing.axes == ("from the axis", "height")
    assert drawing.fields == {"author": "D", "view": "half-profile and elevation"}
    assert [line.layer for line in drawing.lines] == [
        "profile", "outline", "axis", *["diameters"] * 3
    ]  # fmt: skip
    assert_allclose(drawing.lines[0].band, [1e-3, 2e-3, 3e-3])
    assert [line.band for line in drawing.lines[1:]] == [None] * 5
    labels = {
        line.label: line.points.tolist()
        for line in drawing.lines
        if line.layer == "diameters"
    }
    assert labels == {
        "Ø 400.0 ± 6 mm": [[-0.2, pytest.approx(0.8)], [0.0, pytest.approx(0.8)]],
        "Ø 200.0 ± 2 mm": [[-0.1, 0.0], [0.0, 0.0]],
        "Ø 600.0 ± 4 mm": [[-0.3, pytest.approx(0.4)], [0.0, pytest.approx(0.4)]],
    }


def test_a_body_widest_at_an_end_has_two_diameters(monkeypatch) -> None:
    """The widest place is no third line where it is an end."""
    drawn, _ = profile(monkeypatch, revolution(radius=np.array([0.1, 0.2, 0.3])))
    labels = [line.label for line in drawn.drawing.lines if line.label]
    assert labels == ["Ø 600.0 ± 6 mm", "Ø 200.0 ± 2 mm"]


def contour(level: float, length: float, error: float = 1e-4) -> products.Contour:
    """Return a contour line of three points that goes up more than to the right."""
    points = np.array([[0.0, 0.0], [0.1 * length, 0.4 * length], [0.0, length]])
    return products.Contour(level=level, points=points, uncertainty=error)


def raster_of(**changes: Any) -> Any:
    """Return a stand-in of a raster with what drawings read of it."""
    fields: dict[str, Any] = {
        "uncertainty": np.array([[1e-3, 3e-3], [np.nan, 2e-3]]),
        "own": np.array([[1e-3, np.nan], [1e-3, 1e-3]]),
        "cell": 1e-3, "plane": FRONT, "surface": SURFACE,
    }  # fmt: skip
    return SimpleNamespace(**(fields | changes))


def test_contours_have_their_heights_in_table_and_drawing() -> None:
    """Lines of more than 15 mm on paper have their height beside them."""
    lines = [contour(-1.25, 0.016, 2e-4), contour(-1.2, 0.014), contour(-1.2, 0.1)]
    order = Order(product="contours", scale=1.0, fields={"author": "D"})
    drawn = drawings.contour_product(
        raster_of(), lines, 0.05, order, ("Wall", ["made"])
    )
    assert [line.label for line in drawn.drawing.lines] == ["-1.25", "", "-1.2"]
    assert [line.elevation for line in drawn.drawing.lines] == [-1.25, -1.2, -1.2]
    assert {line.layer for line in drawn.drawing.lines} == {"contours"}
    table = {name: np.asarray(column) for name, column in drawn.table.items()}
    assert list(table) == [
        "line", "level [m]", "right [m]", "up [m]", "standard_uncertainty_of_level [m]"
    ]  # fmt: skip
    assert table["line"].tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert table["level [m]"].tolist() == [-1.25] * 3 + [-1.2] * 6
    assert table["right [m]"][[1, 7]] == pytest.approx([1.6e-3, 0.01])
    assert table["up [m]"][[2, 8]] == pytest.approx([0.016, 0.1])
    errors = table["standard_uncertainty_of_level [m]"]
    assert errors.tolist() == [2e-4] * 3 + [1e-4] * 6
    assert drawn.summary == "3 contour lines at 2 levels"
    assert drawn.drawing.statements == ("Contours every 50 mm", "made")
    assert drawn.drawing.title == "Wall: contours"
    assert drawn.drawing.axes == ("right", "up")
    assert drawn.drawing.fields == {
        "author": "D", "view": "contours, front elevation"
    }  # fmt: skip
    assert drawn.scale == 1.0


@pytest.mark.parametrize(("interval", "doubtful"), [(7.9e-3, True), (8.1e-3, False)])
def test_contours_nearer_than_four_errors_are_doubted(interval, doubtful) -> None:
    """The median of the known uncertainties is 2 mm."""
    order = Order(product="contours", scale=1.0)
    lines = [contour(-1.25, 0.1)]
    drawn = drawings.contour_product(raster_of(), lines, interval, order, ("", []))
    words = (
        "noise draws them, too: the interval is less than four standard uncertainties "
        "(2 mm), take larger cells (--cell)"
    )
    assert drawn.drawing.statements[1:] == ((words.capitalize(),) if doubtful else ())
    assert drawn.summary == (
        f"1 contour lines at 1 levels{'; ' + words if doubtful else ''}"
    )


def test_contours_of_unknown_errors_are_not_doubted() -> None:
    """Cells without an uncertainty have no limit to compare with."""
    raster = raster_of(uncertainty=np.full((2, 2), np.nan))
    order = Order(product="contours", scale=1.0)
    drawn = drawings.contour_product(raster, [contour(1.0, 0.1)], 1e-3, order, ("", []))
    assert drawn.drawing.statements == ("Contours every 1 mm",)
    with pytest.raises(CubeError, match="no contour line every 25 mm stands out"):
        drawings.contour_product(raster, [], 0.025, order, ("", []))


@pytest.mark.parametrize(("degrees", "warned"), [(64.5, False), (65.5, True)])
def test_views_at_more_than_65_degrees_to_the_beams_are_warned_of(
    degrees: float, warned: bool
) -> None:
    """The other view is recommended, whichever side beams come from."""
    angle = np.radians(degrees)
    beams = np.array([[0.0, np.sin(angle), sign * np.cos(angle)] for sign in (1, -1)])
    surface: Any = SimpleNamespace(direction=beams)
    for side, better in (
        ("front", "plan (--seen-from top)"), ("top", "elevation (--seen-from front)")
    ):  # fmt: skip
        plane: Any = SimpleNamespace(side=side, axes=np.eye(3))
        expected = [
            f"Warning: the beams meet this view at {degrees:.0f} degrees, so it shows "
            f"surfaces edge-on, with large errors; the {better} shows what was scanned"
        ]
        found = drawings.grazing_warning(surface, plane)
        assert found == (expected if warned else [])


@pytest.mark.parametrize(
    ("cell", "degrees"),
    # 1 mm of noise times the root of 2, over 2 mm of pixels or 4 mm of cells.
    [(1e-3, "35.3"), (4e-3, "19.5")],
)
def test_the_tilt_by_noise_is_that_between_neighbors(cell, degrees) -> None:
    """Neighbors are pixels of the scan, or cells where these are larger."""
    raster = raster_of(cell=cell, surface=SimpleNamespace(spacing=2e-3))
    assert drawings.relief_statement(raster) == (
        "Light from the upper left, 40 degrees high, on means of 3 x 3 cells; noise "
        f"alone tilts neighboring pixels by {degrees} degrees (standard uncertainty): "
        "flatter relief is no tool mark"
    )


def test_a_raster_states_its_view_cells_and_error() -> None:
    """The median of the known uncertainties is 2 mm."""
    raster = raster_of(surface=SimpleNamespace(spacing=2.5e-3))
    assert drawings.raster_statement(raster) == (
        "Seen from the front; heights (nearer) count towards the viewer from the "
        "origin of the axes; standard uncertainty: 2 mm (median). Cells 1 mm, pixels "
        "of the scan 2.5 mm"
    )


def test_bands_are_heights_with_errors_and_light() -> None:
    """An orthoimage begins with the light, other rasters with the heights."""
    raster = raster_of(height="h", uncertainty="u", own="o", amplitude="a")
    found = [
        (band.name, band.unit, band.values)
        for band in drawings.bands_of(raster, first="dem")
    ]
    assert found == [
        ("height towards the viewer", "m", "h"),
        ("combined standard uncertainty of the height", "m", "u"),
        ("part of it that is noise of the pixels", "m", "o"),
        ("amplitude of the target signal", "V", "a"),
    ]
    ortho = [b.values for b in drawings.bands_of(raster, first="orthoimage")]
    assert ortho == ["a", "h", "u", "o"]


@pytest.mark.parametrize(
    ("side", "crs", "offset"), [("top", "EPSG:1", (3.0, 4.0)), ("front", "", (0, 0))]
)
def test_only_a_plan_has_a_reference_system(monkeypatch, side, crs, offset) -> None:
    """An elevation has no east and north."""
    written: dict[str, Any] = {}
    monkeypatch.setattr(
        drawings.formats,
        "write_geotiff",
        lambda bands, path, **words: written.update(words, bands=bands, path=path),
    )
    frame = SimpleNamespace(crs="EPSG:1", crs_offset=(3.0, 4.0, 5.0))
    raster: Any = SimpleNamespace(
        plane=SimpleNamespace(side=side), cell=0.5, left=1.0, top=2.0,
        surface=SimpleNamespace(frame=frame),
    )  # fmt: skip
    drawings.write_bands(raster, [], Path("a.tif"), ["said"], overwrite=True)
    assert written == {
        "bands": [], "path": Path("a.tif"), "cell": 0.5, "left": 1.0, "top": 2.0,
        "crs": crs, "offset": offset, "statements": ["said"], "overwrite": True,
    }  # fmt: skip


def test_the_share_of_doubtful_pixels_is_a_layer() -> None:
    """Pixels that a flag makes doubtful count 1, good ones 0, those between a part."""
    image = WALL.copy(deep=True)
    image["quality_flag"].values[:, :8] |= QualityFlag.MIXED
    order = Order(product="dem", cell=2e-3)
    raster = drawings.flagged_raster(image, SURFACE, FRONT, order, 1.0)
    doubtful = raster.layers["doubtful"]
    assert raster.cell == 2e-3
    left, right = (
        doubtful[:, raster.columns < -0.01],
        doubtful[:, raster.columns > 0.01],
    )
    assert np.all(left[np.isfinite(left)] == 1.0)
    assert np.all(right[np.isfinite(right)] == 0.0)
    assert np.isfinite(left).any()
    assert np.isfinite(right).any()


def test_the_size_of_a_surface_is_that_of_its_triangles() -> None:
    """Vertices without a triangle do not count."""
    points = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.1, 5], [9, 9, 9.0]])
    surface = replace(
        SURFACE, position=points, triangles=np.array([[0, 1, 2]], dtype=np.int32)
    )
    assert drawings._size(surface, FRONT) == pytest.approx((0.3, 0.1))
    order = Order(product="dem")
    # 0.3 m on the 168 mm of A4.
    assert drawings.scale_of(order, surface, FRONT) == 2.0
    assert drawings.scale_of(replace(order, scale=0.5), surface, FRONT) == 0.5


@pytest.mark.parametrize(("spacing", "cell"), [(1e-3, 2e-3), (4e-3, 4e-3)])
def test_a_key_plan_has_150_cells_of_a_pixel_at_least(
    monkeypatch, spacing: float, cell: float
) -> None:
    """The larger side of 0.3 m has 150 cells."""
    surface: Any = SimpleNamespace(spacing=spacing)
    monkeypatch.setattr(drawings, "_size", lambda *_: (0.2, 0.3))
    monkeypatch.setattr(products, "raster", lambda *words, cell: (*words, cell))
    assert drawings._thumbnail(surface, FRONT) == (surface, FRONT, pytest.approx(cell))


def test_a_line_product_is_written_by_its_ending(monkeypatch, tmp_path) -> None:
    """A table begins with title and statements; a drawing has its scale."""
    written: list[Any] = []
    drawing: Any = SimpleNamespace(title="t", statements=("s",))
    product = drawings.LineProduct(
        drawing=drawing, table={"a": [1]}, summary="sum", scale=4.0, heights=2.0,
        key=None, picture=None, colours={"a": "b"},
    )  # fmt: skip
    for name in ("write_table", "write_dxf"):
        monkeypatch.setattr(
            drawings.formats,
            name,
            lambda *w, name=name, **m: written.append((name, w, m)),
        )
    monkeypatch.setattr(drawings, "line_sheet", lambda *w, **m: ("sheet", w, m))
    monkeypatch.setattr(drawings, "save_sheet", lambda *w, **m: written.append((w, m)))
    for ending in ("CSV", "dxf", "svg"):
        assert product.write(Path(f"a.{ending}"), overwrite=True) == "sum"
    more = {"overwrite": True}
    sheet = ("sheet", (drawing,), {
        "scale": 4.0, "heights": 2.0, "key": None, "picture": None,
        "colours": {"a": "b"},
    })  # fmt: skip
    table = {"statements": ["t", "s"]} | more
    assert written == [
        ("write_table", ({"a": [1]}, Path("a.CSV")), table),
        ("write_dxf", (drawing, Path("a.dxf")), {"scale": 4.0} | more),
        ((sheet, Path("a.svg"), drawing), more),
    ]
