"""An E57 file holds a structured scan without loss, as pye57 reads it."""

import sys

import numpy as np
import pytest

from amulor.errors import CubeError, FormatError, MissingExtraError
from amulor.io import write_e57

pye57 = pytest.importorskip("pye57")

ROWS, COLUMNS = SHAPE = (7, 9)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "cloud.e57"


def read_all(path):
    with pye57.E57(str(path)) as file:
        assert file.scan_count == 1
        return file.read_scan_raw(0)


def order_in_scan(cloud):
    return cloud["row"].values * COLUMNS + cloud["column"].values


def test_each_pixel_of_the_scan_has_a_record_row_by_row(point_cloud, path):
    write_e57(point_cloud, path, shape=SHAPE)
    found = read_all(path)
    rows, columns = np.divmod(np.arange(ROWS * COLUMNS), COLUMNS)
    np.testing.assert_array_equal(found["rowIndex"], rows)
    np.testing.assert_array_equal(found["columnIndex"], columns)


def test_points_stand_bit_by_bit_in_their_pixels(point_cloud, path):
    write_e57(point_cloud, path, shape=SHAPE)
    found = read_all(path)
    pixels = order_in_scan(point_cloud)
    for axis in "xyz":
        record = found[f"cartesian{axis.upper()}"]
        np.testing.assert_array_equal(record[pixels], point_cloud[axis])
    # pye57 gives intensities in single precision.
    np.testing.assert_array_equal(
        found["intensity"][pixels], point_cloud["intensity"].values.astype(np.float32)
    )


def test_pixels_without_a_point_are_invalid_and_zero(point_cloud, path):
    write_e57(point_cloud, path, shape=SHAPE)
    found = read_all(path)
    expected = np.full(ROWS * COLUMNS, 2)
    # 16, 64 and 128 are doubts of a single range: its direction is still right.
    doubt = (point_cloud["quality_flag"].values & (16 | 32 | 64 | 128 | 256)) != 0
    assert 0 < doubt.sum() < doubt.size
    expected[order_in_scan(point_cloud)] = doubt
    np.testing.assert_array_equal(found["cartesianInvalidState"], expected)
    for name in ("cartesianX", "cartesianY", "cartesianZ", "intensity"):
        assert set(found[name][expected == 2]) == {0}


def test_a_common_reader_gets_the_valid_points_only(point_cloud, path):
    doubt = (point_cloud["quality_flag"].values & (16 | 32 | 64 | 128 | 256)) != 0
    write_e57(point_cloud, path, shape=SHAPE)
    with pye57.E57(str(path)) as file:
        found = file.read_scan(0, intensity=True, row_column=True)
    point_cloud = point_cloud.isel(point=~doubt)
    order = np.argsort(order_in_scan(point_cloud))
    for axis in "xyz":
        np.testing.assert_array_equal(
            found[f"cartesian{axis.upper()}"], point_cloud[axis].values[order]
        )
    np.testing.assert_array_equal(found["rowIndex"], point_cloud["row"][order])
    np.testing.assert_array_equal(found["columnIndex"], point_cloud["column"][order])


def test_a_pose_is_the_formats_own_and_readers_apply_it(point_cloud, path):
    # A quarter turn about x and a shift; written by hand, row by row.
    matrix = np.array([[1, 0, 0, 5.0], [0, 0, 1, 6.0], [0, -1, 0, 7.0], [0, 0, 0, 1]])
    own = np.stack([point_cloud[axis].values for axis in "xyz"], axis=1)
    placed = own @ matrix[:3, :3].T + matrix[:3, 3]
    cloud = point_cloud.drop_vars("quality_flag").assign(
        {
            axis: point_cloud[axis].copy(data=placed[:, i])
            for i, axis in enumerate("xyz")
        }
    )
    cloud = cloud.assign_attrs(
        frame="z-up", frame_axes="x right, y forward, z up", frame_matrix=matrix.ravel()
    )
    write_e57(cloud, path, shape=SHAPE)
    order = np.argsort(order_in_scan(point_cloud))
    with pye57.E57(str(path)) as file:
        raw = file.read_scan(0, transform=False)
        found = file.read_scan(0, transform=True)
        np.testing.assert_allclose(file.get_header(0).translation, [5, 6, 7])
    for number, axis in enumerate("XYZ"):
        name = f"cartesian{axis}"
        np.testing.assert_allclose(raw[name], own[order, number], atol=1e-12)
        np.testing.assert_allclose(found[name], placed[order, number], atol=1e-12)


def test_a_full_scan_has_no_invalid_pixel(make, rng, path):
    cloud = make.point_cloud(rng, points=ROWS * COLUMNS, quality=False)
    write_e57(cloud, path, shape=SHAPE)
    assert set(read_all(path)["cartesianInvalidState"]) == {0}


def test_a_scan_of_one_pixel_is_written(make, rng, path):
    cloud = make.point_cloud(rng, rows=1, columns=1, points=1)
    write_e57(cloud, path, shape=(1, 1))
    found = read_all(path)
    assert found["cartesianZ"].tolist() == cloud["z"].values.tolist()
    assert found["rowIndex"].tolist() == found["columnIndex"].tolist() == [0]


def test_a_scan_of_many_columns_keeps_its_indices(make, rng, path):
    cloud = make.point_cloud(rng, rows=2, columns=40_000, points=100)
    write_e57(cloud, path, shape=(2, 40_000))
    found = read_all(path)
    columns = np.tile(np.arange(40_000), 2)
    np.testing.assert_array_equal(found["columnIndex"], columns)


def test_the_header_bounds_the_valid_points(point_cloud, path):
    write_e57(point_cloud, path, shape=SHAPE)
    with pye57.E57(str(path)) as file:
        head = file.get_header(0)
        assert head.point_count == ROWS * COLUMNS
        assert (head.rowMinimum, head.rowMaximum) == (0, ROWS - 1)
        assert (head.columnMinimum, head.columnMaximum) == (0, COLUMNS - 1)
        assert head.zMinimum == point_cloud["z"].min()
        assert head.zMaximum == point_cloud["z"].max()
        assert head.intensityMaximum == point_cloud["intensity"].max()


def test_name_and_description_tell_what_it_is(point_cloud, path):
    write_e57(point_cloud.assign_attrs(title="Größe <&> µm"), path, shape=SHAPE)
    with pye57.E57(str(path)) as file:
        head = file.get_header(0)
        assert head["name"].value() == "Größe <&> µm"
        description = head["description"].value()
    assert "x right, y down, z forward" in description
    assert "simulate plate.toml" in description


def test_the_same_cloud_gives_the_same_file(point_cloud, tmp_path):
    first, second = tmp_path / "first.e57", tmp_path / "second.e57"
    write_e57(point_cloud, first, shape=SHAPE)
    write_e57(point_cloud, second, shape=SHAPE)
    assert first.read_bytes() == second.read_bytes()


def test_a_point_outside_the_scan_is_refused(point_cloud, path):
    with pytest.raises(CubeError, match="the scan has 7 rows and 8 columns"):
        write_e57(point_cloud, path, shape=(7, 8))
    assert list(path.parent.iterdir()) == []


def test_two_points_in_one_pixel_are_refused(point_cloud, path):
    for name in ("row", "column"):
        point_cloud[name].values[1] = point_cloud[name].values[0]
    with pytest.raises(CubeError, match="two points"):
        write_e57(point_cloud, path, shape=SHAPE)


def test_without_the_package_the_remedy_is_named(point_cloud, path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pye57", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'amulor\[e57\]'"):
        write_e57(point_cloud, path, shape=SHAPE)


def test_a_full_disk_leaves_nothing(make, rng, path, small_disk):
    cloud = make.point_cloud(rng, rows=100, columns=100, points=9000)
    with (
        small_disk(),
        pytest.raises(FormatError, match=r"cloud\.e57 cannot be") as info,
    ):
        write_e57(cloud, path, shape=(100, 100))
    assert str(info.value).isprintable()
    del info
    assert list(path.parent.iterdir()) == []
    write_e57(cloud, path, shape=(100, 100))
    assert len(read_all(path)["cartesianX"]) == 10_000
