"""A LAS or LAZ file holds the cloud to a micrometre, as laspy reads it."""

import struct
import subprocess
import sys
import time

import laspy
import numpy as np
import pytest

from amulor._las import check_counts
from amulor.errors import CubeError, FormatError, MissingExtraError
from amulor.io import write_laz
from amulor.io.laz import SCALE, read_laz, write_laz_parts


@pytest.fixture
def path(tmp_path):
    return tmp_path / "cloud.laz"


def error(found, expected):
    return np.max(np.abs(np.asarray(found) - expected.values))


@pytest.mark.parametrize("suffix", ["laz", "las"])
def test_coordinates_come_back_to_half_a_step(point_cloud, tmp_path, suffix):
    path = tmp_path / f"cloud.{suffix}"
    write_laz(point_cloud, path)
    found = laspy.read(path)
    assert SCALE <= 1e-5
    for axis in "xyz":
        # Half a step, and the rounding of a few metres in double precision.
        assert error(found[axis], point_cloud[axis]) <= SCALE / 2 + 1e-14
    assert found.header.version == "1.4"
    assert found.header.point_format.id == 6
    assert found.header.are_points_compressed == (suffix == "laz")


def test_attributes_come_back_in_order_and_bit_by_bit(point_cloud, path):
    write_laz(point_cloud, path)
    found = laspy.read(path)
    np.testing.assert_array_equal(found["amplitude"], point_cloud["intensity"])
    for name in ("slant_range_uncertainty", "quality_flag", "row", "column"):
        np.testing.assert_array_equal(found[name], point_cloud[name])
    assert set(found["return_number"]) == set(found["number_of_returns"]) == {1}


def test_intensity_is_the_amplitude_in_parts_of_the_largest(point_cloud, path):
    write_laz(point_cloud, path)
    found = np.asarray(laspy.read(path).intensity, dtype=float)
    amplitude = point_cloud["intensity"].values
    assert found.max() == 65535
    # Half a step of the 16 bits.
    np.testing.assert_allclose(found / 65535, amplitude / amplitude.max(), atol=7.7e-6)


def test_the_largest_amplitude_of_a_cloud_in_parts_is_that_of_any_part(
    point_cloud, path
):
    number = point_cloud.sizes["point"]
    point_cloud["intensity"].values[:] = 1.0
    point_cloud["intensity"].values[1] = 4.0
    half = number // 2
    parts = [
        point_cloud.isel(point=slice(0, half)),
        point_cloud.isel(point=slice(half, None)),
    ]
    write_laz_parts(lambda: parts, number, path)
    found = laspy.read(path).intensity
    assert found[1] == 65535
    assert set(np.delete(found, 1)) <= {16383, 16384}


def test_a_cloud_without_any_light_is_black(point_cloud, path):
    point_cloud["intensity"].values[:] = 0
    write_laz(point_cloud, path)
    assert set(laspy.read(path).intensity) == {0}


def test_doubtful_points_are_withheld(point_cloud, path):
    write_laz(point_cloud, path)
    # Water residual, mixed, outlying; water not removed; whole intervals open.
    expected = (point_cloud["quality_flag"].values & (16 | 64 | 128 | 32 | 256)) != 0
    assert 0 < expected.sum() < expected.size
    np.testing.assert_array_equal(laspy.read(path).withheld, expected)


def test_uncertainties_of_the_coordinates_are_extra_dimensions(point_cloud, rng, path):
    sigmas = {
        f"{axis}_uncertainty": (
            "point",
            rng.uniform(1e-5, 1e-2, 40),
            {"units": "m", "long_name": f"drawn errors of {axis}"},
        )
        for axis in "xyz"
    }
    write_laz(point_cloud.assign(sigmas), path)
    found = laspy.read(path)
    units = {
        item.name: item.description for item in found.point_format.extra_dimensions
    }
    for axis in "xyz":
        np.testing.assert_array_equal(
            found[f"sigma_{axis}"], sigmas[f"{axis}_uncertainty"][1]
        )
        assert units[f"sigma_{axis}"] == f"standard uncertainty of {axis} [m]"


def test_descriptions_carry_the_units(point_cloud, path):
    write_laz(point_cloud, path)
    extra = laspy.read(path).point_format.extra_dimensions
    units = {item.name: item.description.partition("[")[2] for item in extra}
    assert units == {
        "amplitude": "V]",
        "slant_range_uncertainty": "m]",
        "quality_flag": "1]",
        "row": "1]",
        "column": "1]",
    }


def test_provenance_of_any_length_is_in_the_file(point_cloud, path):
    history = "\n".join(f"step {number} of the Größe" for number in range(6000))
    write_laz(point_cloud.assign_attrs(history=history), path)
    record = laspy.read(path).evlrs[0]
    assert (record.user_id, record.description) == ("amulor", "provenance")
    text = record.record_data.decode()
    assert "x right, y down, z forward" in text
    assert "step 5999 of the Größe" in text


def test_a_cloud_without_flags_has_none_in_the_file(make, rng, path):
    write_laz(make.point_cloud(rng, quality=False), path)
    names = laspy.read(path).point_format.extra_dimension_names
    assert list(names) == ["amplitude", "slant_range_uncertainty", "row", "column"]


def test_a_cloud_far_from_the_origin_keeps_its_precision(point_cloud, path):
    point_cloud["z"].values[:] += 1e6
    write_laz(point_cloud, path)
    # Doubles at 1e6 m are 1.2e-10 m apart.
    assert error(laspy.read(path).z, point_cloud["z"]) <= SCALE / 2 + 1e-9


def test_the_widest_cloud_fits_and_a_wider_one_is_refused(point_cloud, path):
    point_cloud["x"].values[:2] = [-2147.0, 2147.0]
    write_laz(point_cloud, path)
    assert error(laspy.read(path).x, point_cloud["x"]) <= SCALE / 2 + 1e-12
    point_cloud["x"].values[:2] = [-2148.0, 2148.0]
    with pytest.raises(FormatError, match=r"'x' goes from -2148 m to 2148 m.*4295 m"):
        write_laz(point_cloud, path, overwrite=True)


def test_a_negative_amplitude_is_refused(point_cloud, path):
    point_cloud["intensity"].values[5] = -0.25
    with pytest.raises(CubeError, match=r"found -0\.25 V"):
        write_laz(point_cloud, path)


@pytest.mark.parametrize("package", ["laspy", "lazrs"])
def test_without_the_package_the_remedy_is_named(
    point_cloud, path, monkeypatch, package
):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=r"pip install 'amulor\[export\]'"):
        write_laz(point_cloud, path)
    assert list(path.parent.iterdir()) == []


def test_a_full_disk_leaves_nothing(make, rng, path, small_disk):
    cloud = make.point_cloud(rng, rows=100, columns=100, points=9000)
    with small_disk(), pytest.raises(FormatError, match=r"cloud\.laz cannot be"):
        write_laz(cloud, path)
    assert list(path.parent.iterdir()) == []


@pytest.mark.parametrize(
    ("suffix", "place", "form", "declared"),
    [
        ("laz", 100, "<I", r"2147483648 records"),
        ("las", 100, "<I", r"2147483648 records"),
        ("laz", 243, "<I", r"2147483648 extended records"),
        ("las", 247, "<Q", r"2147483648 points"),
    ],
)
def test_a_header_that_declares_more_than_fits_is_refused_at_once(
    point_cloud, tmp_path, suffix, place, form, declared
):
    path = tmp_path / f"cloud.{suffix}"
    write_laz(point_cloud, path)
    assert read_laz(path, most=10).total == point_cloud.sizes["point"]
    with path.open("r+b") as file:
        file.seek(place)
        file.write(struct.pack(form, 2**31))
    begin = time.monotonic()
    with pytest.raises(FormatError, match=rf"{path.name} declares {declared} .* bytes"):
        read_laz(path, most=10)
    assert time.monotonic() - begin < 1  # without the check: up to 25 s


class PanicException(BaseException):
    """Error of a Rust library, which is no `Exception`."""


@pytest.mark.parametrize(
    ("raised", "expected"),
    [
        (PanicException("index 96"), FormatError),
        (KeyboardInterrupt(), KeyboardInterrupt),
    ],
)
def test_a_panic_of_the_decoder_is_a_refusal_and_ctrl_c_is_not(
    point_cloud, path, monkeypatch, raised, expected
):
    def fail(*_):
        raise raised

    write_laz(point_cloud, path)
    monkeypatch.setattr(laspy.LasReader, "chunk_iterator", fail)
    with pytest.raises(expected) as refusal:
        read_laz(path, most=10)
    if expected is FormatError:
        assert "cloud.laz cannot be read as LAS or LAZ: index 96" in str(refusal.value)


@pytest.mark.parametrize("excess", [0, 1, 2**32 - 2000])
def test_layers_longer_than_their_chunk_take_no_memory(point_cloud, path, excess):
    write_laz(point_cloud, path)
    content = bytearray(path.read_bytes())
    (points,) = struct.unpack_from("<I", content, 96)
    (length,) = struct.unpack_from("<H", content, 105)
    # Start of the table, first point, number of points; then a size for each layer.
    place = points + 8 + length + 4
    (size,) = struct.unpack_from("<I", content, place)
    struct.pack_into("<I", content, place, size + excess)
    path.write_bytes(content)
    if not excess:
        assert read_laz(path, most=10).total == point_cloud.sizes["point"]
        return
    resource = pytest.importorskip("resource")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(FormatError, match=rf"{path.name} declares \d+ bytes of layers"):
        read_laz(path, most=10)
    # Linux counts kilobytes; without the check it is 4 GB.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000


def test_the_page_refuses_such_a_file_before_slow_imports(tmp_path):
    head = bytearray(300)
    head[:4], head[94:104] = b"LASF", struct.pack("<HII", 227, 227, 2**31)
    (tmp_path / "cloud.laz").write_bytes(head)
    code = (
        "import sys; from amulor.cli import main\n"
        "assert main(['view', 'cloud.laz', '--save', 'page.html']) == 1\n"
        "assert 'numpy' not in sys.modules, 'numpy was imported'"
    )
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "cloud.laz declares 2147483648 records" in done.stderr


def test_the_header_of_an_old_version_ends_before_the_extended_records(tmp_path):
    path = tmp_path / "old.las"
    old = laspy.LasData(laspy.LasHeader(version="1.2", point_format=0))
    old.x, old.y, old.z = np.array([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]])
    old.write(path)
    assert read_laz(path, most=10).total == 2
    # Without points, all of the file is a header of 227 bytes.
    header = bytearray(path.read_bytes()[:227])
    header[100:104] = struct.pack("<I", 2**31)
    path.write_bytes(header)
    with pytest.raises(FormatError, match="2147483648 records"):
        read_laz(path, most=10)


def _dated(cloud, clock, time):
    """The cloud as from a vehicle, with a time of each point."""
    times = np.full(cloud.sizes["point"], time)
    dated = cloud.assign(
        time=("point", times, {"units": "s", "long_name": "time of the readings"})
    )
    return dated.assign_attrs(trajectory_clock=clock, line_number=7)


@pytest.mark.parametrize(
    ("unix", "gps"),
    [
        # 2011-09-14 01:46:25 UTC was 1,000,000,000 s of GPS time, 15 s ahead of UTC.
        (1_315_964_785.0, 0.0),
        # 2026-11-26 00:00:00 UTC: 17,126 days after 1980-01-06, and 18 leap seconds.
        (1_795_651_200.0, 17_126 * 86_400 + 18 - 1e9),
    ],
)
def test_times_of_a_dated_trajectory_are_adjusted_gps_times(
    point_cloud, path, unix, gps
):
    write_laz(_dated(point_cloud, "unix", unix), path)
    found = laspy.read(path)
    assert found.header.global_encoding.gps_time_type == 1
    np.testing.assert_allclose(found["gps_time"], gps, rtol=0, atol=1e-6)
    assert set(found["point_source_id"]) == {7}


def test_times_of_a_clock_without_origin_stay_as_they_are(point_cloud, path):
    write_laz(_dated(point_cloud, "relative", 12.5), path)
    found = laspy.read(path)
    assert found.header.global_encoding.gps_time_type == 0
    assert set(found["gps_time"]) == {12.5}


def test_a_slim_file_has_fewer_than_24_extra_bytes(point_cloud, path):
    cloud = point_cloud
    for axis in "xyz":
        sigma = np.linspace(1e-3, 2e-3, cloud.sizes["point"])
        cloud = cloud.assign({f"{axis}_uncertainty": ("point", sigma, {
            "units": "m", "long_name": "standard uncertainty"})})  # fmt: skip
    write_laz(cloud, path, slim=True)
    found = laspy.read(path)
    extra = list(found.point_format.extra_dimension_names)
    assert found.point_format.num_extra_bytes < 24
    assert len(extra) < 8
    for axis in "xyz":
        # Single precision has 24 bits.
        np.testing.assert_allclose(
            found[f"sigma_{axis}"], cloud[f"{axis}_uncertainty"], rtol=2**-23
        )
        assert error(found[axis], cloud[axis]) <= SCALE / 2 + 1e-14


def las_of(size, *, minor, records=0, count=0, extended=0, packed=False):
    """Return the bytes of a LAS file of `size` bytes with counts of its header.

    One record of 54 bytes lies before the points. Points have 28 bytes. The extended
    records begin 60 bytes before the end of the file.
    """
    content = bytearray(size)
    content[:4], content[25] = b"LASF", minor
    form = 6 | 0x80 * packed
    struct.pack_into("<HIIBHI", content, 94, 375, 375 + 54, records, form, 28, count)
    if minor >= 4:
        struct.pack_into("<QIQ", content, 235, size - 60, extended, count)
    return bytes(content)


@pytest.mark.parametrize("minor", [3, 4])
@pytest.mark.parametrize(
    ("most", "noun"), [("records", "records"), ("count", "points")]
)
def test_a_header_may_declare_what_there_is_room_for(tmp_path, minor, most, noun):
    path = tmp_path / "a.las"
    fits = {"records": 1, "count": 3}
    for size in (375 + 54 + 3 * 28, 375 + 54 + 4 * 28 - 1):
        path.write_bytes(las_of(size, minor=minor, **fits))
        check_counts(path)
        more = fits | {most: fits[most] + 1}
        path.write_bytes(las_of(size, minor=minor, **more))
        with pytest.raises(FormatError, match=f"declares {more[most]} {noun} of at"):
            check_counts(path)


def test_extended_records_exist_from_version_1_4_on(tmp_path):
    path = tmp_path / "a.las"
    path.write_bytes(las_of(800, minor=4, extended=1))
    check_counts(path)
    path.write_bytes(las_of(800, minor=4, extended=2))
    with pytest.raises(FormatError, match="2 extended records of at least 60 bytes"):
        check_counts(path)
    path.write_bytes(las_of(800, minor=3, extended=2))
    check_counts(path)


def test_compressed_points_and_other_files_are_not_counted(tmp_path):
    path = tmp_path / "a.laz"
    path.write_bytes(las_of(800, minor=4, count=10**6, packed=True))
    check_counts(path)
    path.write_bytes(b"ply\n" + las_of(800, minor=4, count=10**6)[4:])
    check_counts(path)
