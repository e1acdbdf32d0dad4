"""Columns, limits and checks of point clouds and meshes of any format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.cube import QualityFlag
from amulor.errors import CubeError, FormatError
from amulor.io import laz, shapes, text_cloud
from amulor.io.shapes import Shape


def shape_of(*points: tuple[float, ...], **fields: Any) -> Shape:
    return Shape(position=np.array(points, dtype=float), **fields)


def test_at_most_eight_other_columns_are_shown() -> None:
    columns = {f"c{n}": np.full(2, n) for n in range(10)}
    columns["sigma_range"] = np.array([7, 8])
    scalars, unused = shapes.scalars_of(columns)
    assert list(scalars) == ["uncertainty", *(f"c{n}" for n in range(8))]
    assert unused == ["c8", "c9"]
    assert scalars["uncertainty"].dtype == float


def test_names_of_columns_become_plain_and_stay_apart() -> None:
    long = "n" * 50
    values = np.zeros(1)
    names = [
        "scalar_Amplitude [V]",
        "amplitude",
        "intensity",
        "height",
        "a/b",
        long,
        "[x]",
    ]
    scalars, unused = shapes.scalars_of(dict.fromkeys(names, values))
    # The intensity of a LAS file repeats the amplitude.
    assert list(scalars) == [
        "amplitude", "amplitude 2", "height 2", "a_b", "n" * 40, "unnamed",
    ]  # fmt: skip
    assert unused == []
    alone, _ = shapes.scalars_of({"Reflectance": values})
    assert list(alone) == ["intensity"]


@pytest.mark.parametrize(
    ("lines", "up"), [([], "y"), (["axes: x right, y down"], "-y"),
                      (["title: y down", "axes: z up"], "z"), (["y down"], "y")],
)  # fmt: skip
def test_the_axes_of_a_header_say_what_is_up(lines, up) -> None:
    assert shapes.up_of(lines, "y") == up
    assert shapes.up_of([]) == "z"


def test_points_without_a_place_and_empty_columns_are_left_out() -> None:
    values = {"a": np.array([1.0, 2, 3]), "b": np.full(3, np.nan)}
    colour = np.arange(9, dtype=np.uint8).reshape(3, 3)
    cloud = shape_of((0, 0, 0), (1, np.inf, 1), (2, 2, 2), scalars=values,
                     colour=colour, up="y", statements=("s",), total=7)  # fmt: skip
    found = shapes.checked(cloud, "f")
    assert found.position.tolist() == [[0, 0, 0], [2, 2, 2]]
    assert {name: v.tolist() for name, v in found.scalars.items()} == {"a": [1, 3]}
    assert found.colour.tolist() == [[0, 1, 2], [6, 7, 8]]
    assert (found.up, found.statements, found.total) == ("y", ("s",), 7)
    whole = shapes.checked(shape_of((0, 0, 0), (1, 1, 1)), "f")
    assert (len(whole.position), whole.total, whole.faces) == (2, 0, None)
    assert shapes.thinned(whole, np.array([1])).total == 2


@pytest.mark.parametrize(
    ("place", "refused"), [(1e9, None), (1.1e9, "coordinate of 1.1e+09 m"),
                           (np.nan, "no point with a finite place")],
)  # fmt: skip
def test_coordinates_are_below_a_million_kilometers(place, refused) -> None:
    cloud = shape_of((0, -place, 0))
    if refused is None:
        assert shapes.checked(cloud, "f") is not None
        return
    with pytest.raises(FormatError, match=rf"^f h.*{refused}".replace("+", r"\+")):
        shapes.checked(cloud, "f")


def test_triangles_of_a_mesh_have_known_corners() -> None:
    points = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (np.nan, 0, 5))
    faces = np.array([[0, 1, 2], [1, 2, 3]])
    found = shapes.checked(shape_of(*points, faces=faces), "f")
    assert found.faces.tolist() == [[0, 1, 2]]
    # No coordinate is left of a vertex without a place.
    assert np.isnan(found.position[3]).all()
    for wrong in ([[0, 1, 4]], [[-1, 0, 1]]):
        with pytest.raises(FormatError, match=r"^f has a triangle with corner "):
            shapes.checked(shape_of(*points, faces=np.array(wrong)), "f")
    none = shapes.checked(shape_of(*points[:3], faces=np.zeros((0, 3), int)), "f")
    assert none.faces is None


@pytest.mark.parametrize(
    ("total", "most", "step"), [(10, 10, 1), (11, 10, 2), (100, 10, 10), (101, 10, 11)]
)
def test_a_subset_has_one_point_of_each_step(total, most, step) -> None:
    found = shapes.spread(total, most)
    assert len(found) == -(-total // step) <= most
    assert_array_equal(found // step, np.arange(len(found)))
    assert found[-1] < total
    assert_array_equal(found, shapes.spread(total, most))
    if step > 1:
        assert len(set(found % step)) > 1


def test_blocks_have_equal_sizes_but_for_the_last() -> None:
    arrays = [np.arange(3), np.arange(3, 4), np.arange(4, 11)]
    blocks = [block.tolist() for block in shapes.in_blocks(arrays, 4)]
    assert blocks == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10]]
    assert [b.tolist() for b in shapes.in_blocks([np.arange(4)], 2)] == [[0, 1], [2, 3]]
    assert list(shapes.in_blocks([], 2)) == []


def test_parts_have_the_points_that_were_counted(point_cloud) -> None:
    count = point_cloud.sizes["point"]
    halves = [point_cloud.isel(point=slice(0, 7)), point_cloud.isel(point=slice(0, 0)),
              point_cloud.isel(point=slice(7, None))]  # fmt: skip
    found = list(shapes.checked_parts(halves, count, name="n"))
    assert [part.sizes["point"] for part in found] == [7, count - 7]
    with pytest.raises(CubeError) as refused:
        list(shapes.checked_parts(halves[:1], count, name="n"))
    assert str(refused.value) == (
        f"n: 7 points came, {count} were counted before; the range image changed "
        "meanwhile: run it again"
    )
    with pytest.raises(CubeError, match=r"^n: there is no point in it"):
        list(shapes.checked_parts(halves[1:2], 0, name="n"))


@pytest.mark.parametrize(
    ("name", "value", "refused"),
    [("row", 2**31 - 1, False), ("row", -1, True), ("row", 0.5, True),
     ("column", 2**31, True), ("quality_flag", 2**15, True)],
)  # fmt: skip
def test_whole_numbers_of_a_cloud_fit_their_formats(
    point_cloud, monkeypatch, name, value, refused
) -> None:
    cloud = point_cloud.copy(deep=True)
    kind = float if value == 0.5 else np.int64
    cloud[name] = cloud[name].astype(kind)
    cloud[name].values[3] = value
    monkeypatch.setattr(shapes.cubes, "checked", lambda cloud, **_: cloud)
    if not refused:
        assert shapes.checked_cloud(cloud, name="n") is cloud
        return
    with pytest.raises(
        CubeError, match=rf"^n: '{name}' must hold whole numbers from 0 "
    ):
        shapes.checked_cloud(cloud, name="n")


def test_points_without_a_number_are_counted(point_cloud) -> None:
    cloud = point_cloud.copy(deep=True)
    cloud["x"].values[[1, 4]] = np.nan
    with pytest.raises(CubeError, match=r"^n: 'x' of 2 points is not finite"):
        shapes.checked_cloud(cloud, name="n")


def test_doubtful_points_have_one_of_the_flags() -> None:
    flags = [0, QualityFlag.MIXED, QualityFlag.NO_OPEN_WATER, QualityFlag.MISSING]
    cloud = xr.Dataset({"quality_flag": ("point", np.array(flags))},
                       coords={"point": range(4)})  # fmt: skip
    assert shapes.doubtful(cloud).tolist() == [False, True, True, False]
    none = shapes.doubtful(cloud.drop_vars("quality_flag"))
    assert none.tolist() == [False] * 4


def test_lines_of_the_frame_say_what_is_known() -> None:
    matrix = np.arange(16.0)
    lines = shapes.frame_lines(
        {"frame_axes": "east, north, up", "frame": "site", "frame_matrix": matrix,
         "crs": "EPSG:1", "crs_offset": (1.5, 2.0, 0.0), "reading_spread": 0.0123,
         "pose_unknown": "heading"}
    )  # fmt: skip
    assert lines == [
        "axes: east, north, up",
        "from the instrument's axes, 4 x 4 row by row: "
        + " ".join(str(n) for n in range(16)),
        "reference system: EPSG:1; add (1.5, 2, 0) m",
        "readings of a point: taken along 12.3 mm of the track",
        "uncertainty of the pose not known: heading",
    ]
    plain = [
        "axes: right-handed: x right, y down, z forward, in the instrument's axes [m]"
    ]
    assert shapes.frame_lines({}) == plain
    assert shapes.frame_lines({"frame": "trajectory"}) == plain


def test_meshes_are_read_in_their_unit(tmp_path: Path) -> None:
    path = tmp_path / "m.off"
    path.write_text("OFF\n3 1 0\n0 0 0\n2 0 0\n0 4 6\n3 0 1 2\n")
    found = shapes.read_mesh(path, unit=1e-3)
    assert_allclose(found.position, [[0, 0, 0], [2e-3, 0, 0], [0, 4e-3, 6e-3]])
    assert found.faces.tolist() == [[0, 1, 2]]
    assert (found.up, found.total) == ("z", 3)
    path.write_text("OFF\nx\n")
    with pytest.raises(FormatError, match=r"^m.off cannot be read as a mesh: "):
        shapes.read_mesh(path, unit=1.0)


@pytest.mark.parametrize(
    ("brightest", "color"), [(255, [255, 10, 0]), (256, [1, 0, 0]), (0, None)]
)
def test_colors_of_8_or_16_bits_become_bytes(brightest, color) -> None:
    columns = {axis: np.zeros(1) for axis in "xyz"}
    dark = 10 if brightest else 0
    columns |= {"red": np.array([brightest], np.uint16),
                "green": np.array([dark], np.uint16),
                "blue": np.zeros(1, np.uint16)}  # fmt: skip
    columns |= {"classification": np.zeros(1), "extra": np.ones(1)}
    found = laz._shape_of(columns, ("axes: y down",))
    assert (None if found.colour is None else found.colour[0].tolist()) == color
    # A column that says nothing is left out, if the format demands it.
    assert list(found.scalars) == ["extra"]
    assert found.up == "-y"


def test_columns_that_are_not_shown_are_named() -> None:
    columns = {axis: np.zeros(2) for axis in "xyz"}
    columns |= {f"c{n}": np.arange(2.0) for n in range(10)}
    found = laz._shape_of(columns | {"intensity": np.arange(2.0)}, [])
    assert found.statements == ["not shown: c8, c9"]
    assert "intensity" in found.scalars


@pytest.mark.parametrize(
    ("width", "names"),
    [(3, []), (4, ["intensity"]), (5, ["column 4", "column 5"]),
     (6, ["red", "green", "blue"]), (7, ["intensity", "red", "green", "blue"]),
     (8, [f"column {n}" for n in range(4, 9)])],
)  # fmt: skip
def test_columns_of_text_have_usual_names(width, names) -> None:
    assert text_cloud._named(None, width, "f") == ["x", "y", "z", *names]
    given = ["x", "y", "z", "a", "a"]
    assert text_cloud._named(given, 5, "f") == ["x", "y", "z", "a", "a 5"]
    assert text_cloud._named(["x", "y", "z"], 4, "f")[3] == "intensity"
    assert len(text_cloud._named(None, 64, "f")) == 64
    with pytest.raises(FormatError, match=r"^f has 65 columns; no point cloud has so"):
        text_cloud._named(None, 65, "f")


@pytest.mark.parametrize(
    ("lines", "colored"), [("0 0 0 2 3 4\n", True), ("0 0 0 1 1 1\n", False),
                           ("0 0 0 255 0 0\n", True), ("0 0 0 256 0 0\n", False),
                           ("0 0 0 9 -1 0\n", False)],
)  # fmt: skip
def test_columns_of_0_to_255_are_colors(tmp_path: Path, lines, colored) -> None:
    path = tmp_path / "c.xyz"
    path.write_text(lines)
    found = text_cloud.read_text(path, unit=1.0)
    assert (found.colour is not None) == colored
    assert ("red" in found.scalars) != colored


def test_a_cloud_of_text_may_begin_with_its_size(tmp_path: Path) -> None:
    path = tmp_path / "c.xyz"
    path.write_text("// notes\n2\n\n1;2;3\n4;5;6\n")
    found = text_cloud.read_text(path, unit=0.1)
    assert_allclose(found.position, [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    assert found.total == 2
    path.write_text("a b c\nd e f\n1 2 3\n")
    with pytest.raises(FormatError, match=r"^c\.xyz, line 2: 'd e f' are no coord"):
        text_cloud.read_text(path, unit=1.0)
    path.write_text("# only\n")
    with pytest.raises(FormatError, match="has no line with x, y and z in it"):
        text_cloud.read_text(path, unit=1.0)
