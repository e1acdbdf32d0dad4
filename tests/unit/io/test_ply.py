"""A PLY file holds the cloud without loss, as an independent reader finds it."""

import numpy as np
import pytest
import trimesh

from amulor.errors import FormatError
from amulor.io import write_ply
from amulor.io.ply import read_ply
from amulor.io.shapes import scalars_of


@pytest.fixture
def path(tmp_path):
    return tmp_path / "cloud.ply"


def vertices(path):
    return trimesh.load(path).metadata["_ply_raw"]["vertex"]["data"]


def header(path):
    return path.read_bytes().partition(b"end_header\n")[0].decode("ascii").splitlines()


def test_every_value_comes_back_in_order_and_bit_by_bit(point_cloud, path):
    write_ply(point_cloud, path)
    found = vertices(path)
    assert found.dtype.names == (
        *("x", "y", "z", "scalar_intensity", "scalar_slant_range_uncertainty"),
        *("scalar_quality_flag", "scalar_row", "scalar_column"),
    )
    for name in found.dtype.names:
        variable = name.removeprefix("scalar_")
        np.testing.assert_array_equal(found[name], point_cloud[variable].values)
    assert found["x"].dtype == np.float64


def test_a_reader_of_geometry_sees_the_points(point_cloud, path):
    write_ply(point_cloud, path)
    loaded = trimesh.load(path)
    assert isinstance(loaded, trimesh.PointCloud)
    expected = np.column_stack([point_cloud[axis] for axis in "xyz"])
    np.testing.assert_array_equal(loaded.vertices, expected)


def test_a_cloud_without_flags_has_none_in_the_file(make, rng, path):
    write_ply(make.point_cloud(rng, quality=False), path)
    assert "scalar_quality_flag" not in vertices(path).dtype.names


def test_an_unknown_uncertainty_stays_unknown(point_cloud, path):
    point_cloud["slant_range_uncertainty"].values[3] = np.nan
    write_ply(point_cloud, path)
    found = vertices(path)["scalar_slant_range_uncertainty"]
    assert np.flatnonzero(np.isnan(found)).tolist() == [3]


def test_the_header_tells_units_axes_flags_and_provenance(point_cloud, path):
    write_ply(point_cloud.assign_attrs(simulated=1), path)
    lines = header(path)
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    joined = "\n".join(lines)
    assert "x right, y down, z forward" in joined
    assert "comment z: position forwards [m]" in lines
    assert "comment title: plate in turbid water" in lines
    assert "1 missing, 2 saturated, 4 no_target" in joined
    assert "simulate plate.toml" in joined
    assert "simulation" in joined


def test_no_text_can_break_the_header(point_cloud, path):
    history = "first\nend_header\nelement face 3\r\n" + "long " * 1000
    cloud = point_cloud.assign_attrs(title="Größe µm", history=history)
    write_ply(cloud, path)
    np.testing.assert_array_equal(vertices(path)["x"], cloud["x"].values)
    lines = header(path)
    assert max(map(len, lines)) < 256
    known = ("ply", "format ", "comment ", "property ", "element vertex ")
    assert all(line.startswith(known) for line in lines)
    assert "comment title: Gr\\xf6\\xdfe \\xb5m" in lines


def test_a_full_disk_leaves_nothing(make, rng, path, small_disk):
    cloud = make.point_cloud(rng, rows=100, columns=100, points=9000)
    with small_disk(), pytest.raises(FormatError, match=r"cloud\.ply cannot be"):
        write_ply(cloud, path)
    assert list(path.parent.iterdir()) == []


@pytest.mark.parametrize("written", [72, 71])
def test_a_text_file_has_the_points_that_it_promises(path, written):
    places = [f"{k} {2 * k} 1.5\n" for k in range(written)]
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 72\n"
        "property float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        f"{''.join(places)}3 0 1 2\n"
    )
    if written == 72:
        shape = read_ply(path, unit=1.0)
        assert shape.position[71].tolist() == [71, 142, 1.5]
        assert shape.faces.tolist() == [[0, 1, 2]]
        return
    # Without a check the line of the triangle would be read as the last point.
    with pytest.raises(FormatError, match=r"cloud\.ply .* 73 lines.* has 72 lines;"):
        read_ply(path, unit=1.0)


@pytest.mark.parametrize("start", ["plx\n", "ply2\n", "\nply\n", ""])
def test_a_file_that_does_not_begin_as_ply_is_none(path, start):
    path.write_text(text_file(71).replace("ply\n", start, 1))
    with pytest.raises(FormatError, match=r"cloud\.ply is no PLY file: it does not be"):
        read_ply(path, unit=1.0)


def text_file(lines):
    return (
        "ply\nformat ascii 1.0\nelement vertex 71\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
        + "".join(f"{k} {2 * k} 1.5\n" for k in range(lines))
    )


def test_white_space_may_follow_the_last_element_of_a_text_file(path):
    path.write_text(text_file(71) + "\n  \n\t\n")
    assert read_ply(path, unit=1.0).position[70].tolist() == [70, 140, 1.5]


def test_a_header_of_any_length_is_read(path):
    comments = "comment a\n" * 2100
    path.write_text(text_file(71).replace("element", f"{comments}element", 1))
    assert len(read_ply(path, unit=1.0).position) == 71


@pytest.mark.parametrize("text", [text_file(72), text_file(71) + "x"])
def test_text_after_the_last_element_is_refused(path, text):
    path.write_text(text)
    with pytest.raises(
        FormatError, match=r"declares 71 .* 71 lines, and has 72 lines;"
    ):
        read_ply(path, unit=1.0)


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("surplus", [0, 1, -13])
def test_a_binary_file_has_the_bytes_that_it_declares(path, order, surplus):
    sign = {"little": "<", "big": ">"}[order]
    points = np.arange(12, dtype=f"{sign}f4").tobytes()
    # Three corners as one byte, then three indices of four bytes: 13 bytes.
    triangle = b"\3" + np.array([0, 1, 2], dtype=f"{sign}i4").tobytes()
    head = (
        f"ply\nformat binary_{order}_endian 1.0\nelement vertex 4\n"
        "property float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    content = points + triangle
    content = content[:surplus] if surplus < 0 else content + bytes(surplus)
    path.write_bytes(head + content)
    if surplus == 0:
        shape = read_ply(path, unit=1.0)
        assert shape.position[3].tolist() == [9, 10, 11]
        assert shape.faces.tolist() == [[0, 1, 2]]
        return
    # With no byte of its triangle, a mesh would be read as a cloud without faces.
    declared = 49 if surplus < 0 else 61
    with pytest.raises(
        FormatError, match=rf"4 \+ 1 .* {declared} bytes, and has {61 + surplus} bytes;"
    ):
        read_ply(path, unit=1.0)


@pytest.mark.parametrize("count", [10**15, 10**30])
def test_a_count_beyond_any_file_gives_one_line(path, count):
    path.write_text(
        f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
        "property float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    with pytest.raises(FormatError, match=r"cloud\.ply") as caught:
        read_ply(path, unit=1.0)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        (("amplitude", "intensity"), {"amplitude": 0.0}),
        (("scalar_Intensity",), {"intensity": 0.0}),
        (("uncertainty",), {"uncertainty": 0.0}),
        (("uncertainty", "sigma_range"), {"uncertainty": 0.0, "sigma_range": 1.0}),
        (("i", "intensity"), {"intensity": 0.0, "intensity 2": 1.0}),
        (("a/b", "height"), {"a_b": 0.0, "height 2": 1.0}),
        (tuple(f"c{n}" for n in range(8)), {f"c{n}": float(n) for n in range(8)}),
        (tuple(f"c{n}" for n in range(9)), {f"c{n}": float(n) for n in range(8)}),
    ],
)
def test_columns_become_scalars_by_their_names(columns, expected) -> None:
    numbered = {name: np.array([float(n)]) for n, name in enumerate(columns)}
    scalars, omitted = scalars_of(numbered)
    assert {name: value[0] for name, value in scalars.items()} == expected
    assert omitted == list(columns[8:])
