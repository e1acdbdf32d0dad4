"""Cubes read and written by rows: what the whole file holds, and nothing by half."""

from __future__ import annotations

import itertools
import subprocess
import sys
import time
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from amulor import io
from amulor._hdf5 import check_heaps, check_heaps_of, check_size, check_small
from amulor.cube import tiles
from amulor.errors import AmulorError, CubeError, FormatError
from amulor.io import netcdf


@pytest.fixture
def path(tmp_path):
    return tmp_path / "cube.nc"


@pytest.mark.parametrize(
    "rows", [2, *(pytest.param(later, marks=pytest.mark.slow) for later in (1, 100))]
)
@pytest.mark.parametrize("level", ["samples", "target_signal", "range_image"])
def test_rows_of_a_file_are_those_of_the_whole(make, rng, path, tmp_path, level, rows):
    cube = getattr(make, level)(rng)
    cube["user_seen"] = (("row", "column"), rng.random(cube["azimuth"].shape) > 0.5)
    io.write_cube(cube, path)
    whole = io.read_cube(path)
    copy = tmp_path / "copy.nc"
    with netcdf.open_rows(path) as source:
        assert (source.rows, source.columns) == whole["azimuth"].shape
        assert not any("row" in v.dims for v in source.head.variables.values())
        with netcdf.row_writer(copy, source.rows) as writer:
            for begin, end in tiles.bands(source, rows):
                tile = source.tile(begin, end)
                xr.testing.assert_identical(tile, whole.isel(row=slice(begin, end)))
                writer.put(tile, begin)
    xr.testing.assert_identical(io.read_cube(copy), whole)
    with h5py.File(path) as one, h5py.File(copy) as other:
        assert one["slant_range" if level == "range_image" else "in_phase"].chunks == (
            other["slant_range" if level == "range_image" else "in_phase"].chunks
        )


def test_a_damaged_file_is_refused_before_its_rows_are_read(samples, path):
    io.write_cube(samples, path)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    with (
        pytest.raises(FormatError, match="damaged"),
        netcdf.open_rows(path),
    ):
        pass


def test_rows_that_are_damaged_since_the_file_was_opened_are_named(samples, path):
    class Broken:
        def __getitem__(self, name):
            raise OSError("a  checksum is wrong")

    io.write_cube(samples, path)
    with netcdf.open_rows(path) as source:
        source._storage = Broken()
        with pytest.raises(FormatError) as refused:
            source.tile(0, 2)
    assert str(refused.value) == (
        f"rows 0 to 1 of {path} cannot be read: a checksum is wrong; the file is "
        "damaged: copy it again, or make it again"
    )


def test_a_file_without_rows_is_refused(make, rng, path):
    io.write_cube(make.point_cloud(rng), path)
    with (
        pytest.raises(CubeError, match="no rows and columns; name samples"),
        netcdf.open_rows(path),
    ):
        pass


def test_a_file_that_is_not_written_to_its_end_is_not_there(samples, path):
    rows = samples.sizes["row"]
    with (
        pytest.raises(CubeError, match="are written"),
        netcdf.row_writer(path, rows) as writer,
    ):
        writer.put(samples.isel(row=slice(0, 1)), 0)
    assert list(path.parent.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda tile: (tile, 2), "do not follow row 0"),
        (lambda tile: (tile.assign(user_more=tile["in_phase"]), 1), "user_more"),
        (lambda tile: (tile.drop_vars("in_phase"), 1), "in_phase.*missing"),
    ],
)
def test_tiles_that_do_not_fit_are_refused(samples, path, change, words):
    tile, begin = change(samples.isel(row=slice(1, 2)))

    def write():
        with netcdf.row_writer(path, samples.sizes["row"]) as writer:
            writer.put(samples.isel(row=slice(0, 1)), 0)
            writer.put(tile, begin)

    with pytest.raises(CubeError, match=words):
        write()
    assert not path.exists()


def test_large_files_are_told_by_their_samples(samples, path, monkeypatch):
    io.write_cube(samples, path)
    size = samples["in_phase"].nbytes
    monkeypatch.setenv("AMULOR_LARGE", f"{size}")
    assert not netcdf.is_large(path)
    monkeypatch.setenv("AMULOR_LARGE", f"{size - 1}")
    assert netcdf.is_large(path)
    assert not netcdf.is_large(path, variables=["slant_range"])
    monkeypatch.setenv("AMULOR_LARGE", "64 MB")
    with pytest.raises(AmulorError, match=r"AMULOR_LARGE is '64 MB'.*such as 64e6"):
        netcdf.is_large(path)
    monkeypatch.delenv("AMULOR_LARGE")
    path.write_bytes(b"something else")
    assert not netcdf.is_large(path)
    assert not netcdf.is_large(path.with_name("nothing.nc"))


def test_the_digest_is_that_of_the_whole_writer(samples, path, monkeypatch):
    # Read in pieces that do not divide the file.
    monkeypatch.setattr(netcdf, "_PIECE", 1000)
    io.write_cube(samples, path)
    with netcdf.open_rows(path) as source:
        assert np.isfinite(source.tile(0, 1)["azimuth"]).all()


@pytest.mark.parametrize(
    ("columns", "rows", "frequencies"),
    [
        (100, 300, 16),
        pytest.param(500, 300, 4, marks=pytest.mark.slow),
        pytest.param(7000, 20, 4, marks=pytest.mark.slow),
    ],
)
def test_tiles_are_whole_blocks_of_the_file(
    make, rng, path, columns, rows, frequencies
):
    # A block of which a tile is a part would be compressed once for each of them.
    made = make.samples(
        rng,
        rows=rows,
        columns=columns,
        frequencies=tuple(1e7 * (1 + np.arange(frequencies))),
        polarizations=("VV",),
    )
    io.write_cube(made, path)
    with netcdf.open_rows(path) as source:
        tile = netcdf.tile_rows(source)
    with h5py.File(path) as file:
        block = file["in_phase"].chunks
    assert block[:2] == (1, 1)
    assert tile < rows
    assert tile % block[2] == 0


@pytest.mark.parametrize(
    "coding",
    [
        {"_FillValue": -999.0},
        {"missing_value": -999.0, "_FillValue": None},
        {"scale_factor": 2.0, "add_offset": 1.0, "_FillValue": np.nan},
        {"dtype": "float32", "_FillValue": np.nan},
    ],
)
def test_rows_of_another_program_are_decoded(samples, path, coding):
    # As xarray and others code numbers; amulor writes them as they are.
    cube = samples.copy(deep=True)
    cube["in_phase"].values[0, 0, 1, 2] = np.nan
    cube.to_netcdf(path, engine="h5netcdf", encoding={"in_phase": coding})
    with h5py.File(path) as file:
        stored = file["in_phase"][...]
    whole = io.read_cube(path)["in_phase"].values
    assert not np.array_equal(stored, whole, equal_nan=True) or "dtype" in coding
    with netcdf.open_rows(path) as source:
        found = source.tile(0, 3)["in_phase"].values
    np.testing.assert_array_equal(found, whole)
    assert np.isnan(found[0, 0, 1, 2])


def declared(path, count, *, width=100_000):
    """Write a file with variables of many pixels, of which none is stored."""
    with h5py.File(path, "w") as file:
        file.attrs["amulor_schema_version"] = 2
        file.attrs["amulor_tally_version"] = 1
        for number in range(count):
            file.create_dataset(
                f"in_phase{number}", (width, 100), "f8", chunks=(100, 100)
            )


@pytest.mark.parametrize("read", [io.read_cube, io.read_tally])
def test_a_small_file_that_declares_many_pixels_is_refused_at_once(path, read):
    declared(path, 1, width=100_000_000)
    assert path.stat().st_size < 80_000
    began = time.process_time()
    with pytest.raises(FormatError, match=r"'in_phase0' has the shape .* 0 bytes"):
        read(path)
    with (
        pytest.raises(FormatError, match=r"'in_phase0' has the shape .* 0 bytes"),
        netcdf.open_rows(path),
    ):
        pass
    assert time.process_time() - began < 1


def test_many_variables_that_are_not_stored_are_refused_by_their_sum(path):
    # 80 MB each; 26 are 2.1 GB, 27 are above 2^31 bytes.
    declared(path, 26)
    check_small(path)
    declared(path, 27)
    with pytest.raises(FormatError, match="in_phase9"):
        check_small(path)


def test_commands_refuse_such_a_file_before_slow_imports(path):
    declared(path, 1, width=100_000_000)
    lines = [
        "reject cube.nc --method open-water -o target.nc", "image cube.nc -o image.nc",
        "export cube.nc -o cloud.ply", "report cube.nc -o page.html",
        "view cube.nc --save page.html", "info cube.nc",
    ]  # fmt: skip
    code = (
        "import sys; from amulor.cli import main\n"
        f"assert [main(line.split()) for line in {lines}] == [1] * {len(lines)}\n"
        "assert 'xarray' not in sys.modules, 'xarray was imported'"
    )
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, cwd=path.parent)
    assert done.returncode == 0, done.stderr
    refusals = done.stderr.splitlines()
    assert len(refusals) == len(lines)
    assert all("'in_phase0' has the shape" in line for line in refusals)


def test_content_of_other_files_is_refused(path, tmp_path):
    (tmp_path / "other").write_bytes(bytes(80))
    with h5py.File(path, "w") as file:
        file.attrs["amulor_schema_version"] = 2
        file.create_dataset("in_phase", (10,), "f8", external=[("other", 0, 80)])
    with pytest.raises(FormatError, match="'in_phase' refers to the content of other"):
        io.read_cube(path)


def test_content_that_another_file_lends_is_refused(path):
    layout = h5py.VirtualLayout((10,), "f8")
    layout[:] = h5py.VirtualSource("other.nc", "in_phase", (10,))
    with h5py.File(path, "w") as file:
        file.attrs["amulor_schema_version"] = 2
        file.create_virtual_dataset("in_phase", layout)
    with pytest.raises(FormatError, match="'in_phase' refers to the content of other"):
        io.read_cube(path)


@pytest.mark.parametrize("content", [b"", b"\x89HDF\r\n\x1a\n", b"no HDF5" * 30])
def test_other_damage_is_left_to_the_reader(path, content):
    path.write_bytes(content)
    check_small(path)
    with pytest.raises(FormatError):
        io.read_cube(path)


def heap_of(sizes, free=16, lost=0):
    """Return a global heap as the format of HDF5 states it, with free space at its end.

    Each object has an index, references and its size, and content up to a multiple of 8
    bytes. `lost` bytes are missing in the size of the heap.
    """
    parts = [
        number.to_bytes(2, "little") + bytes(6) + size.to_bytes(8, "little")
        + b"x" * (size + -size % 8)
        for number, size in enumerate(sizes, 1)
    ]  # fmt: skip
    content = b"".join(parts)
    if free:
        content += bytes(8) + free.to_bytes(8, "little") + bytes(free - 16)
    size = 16 + len(content) - lost
    return b"GCOL" + bytes([1, 0, 0, 0]) + size.to_bytes(8, "little") + content


SIZES = st.lists(st.integers(0, 70), min_size=1, max_size=6)


@given(SIZES, SIZES, st.integers(0, 5))
def test_heaps_that_their_objects_fill_are_accepted(tmp_path_factory, one, two, free):
    path = tmp_path_factory.mktemp("heap") / "heap"
    content = b"before" + heap_of(one, 16 + 8 * free) + b"between" + heap_of(two, 0)
    check_heaps(content, path)
    path.write_bytes(content)
    check_heaps_of(path)
    # Less than the head of an object may be left at the end of a heap.
    check_heaps(heap_of(one) + bytes(9), path)


@given(SIZES, SIZES, st.integers(1, 7))
def test_a_heap_that_its_objects_do_not_fill_is_refused(
    tmp_path_factory, one, two, lost
):
    path = tmp_path_factory.mktemp("heap") / "heap"
    content = heap_of(one) + heap_of([*two, 100], 0, lost=8 * lost)
    with pytest.raises(FormatError, match=f"at byte {len(heap_of(one))} is not filled"):
        check_heaps(content, path)
    path.write_bytes(content)
    with pytest.raises(FormatError, match="is not filled by its objects"):
        check_heaps_of(path)


def test_free_space_without_size_is_refused(path):
    content = bytearray(heap_of([8], 32))
    content[-24] = 0
    with pytest.raises(FormatError, match="at byte 0 is not filled"):
        check_heaps(bytes(content), path)


def test_variables_in_other_files_are_refused(path):
    with h5py.File(path, "w") as storage:
        storage.create_dataset("a", (4,), "f8", external=[("b.bin", 0, 32)])
        with pytest.raises(FormatError, match="'a' refers to the content of other"):
            check_size(storage, path)
    with h5py.File(path, "w") as storage:
        layout = h5py.VirtualLayout((4,), "f8")
        layout[:] = h5py.VirtualSource("b.h5", "x", (4,))
        storage.create_virtual_dataset("c", layout)
        with pytest.raises(FormatError, match="'c' refers to the content of other"):
            check_size(storage, path)


def test_what_is_declared_and_not_stored_has_a_largest_size(path):
    most, total = 2**28, 2**31
    with h5py.File(path, "w") as storage:
        for number in range(total // most):
            storage.create_dataset(f"v{number}", (most,), "u1", chunks=(2**20,))
        check_size(storage, path)
        # A variable that is stored needs no room among them.
        storage["stored"] = np.zeros(10)
        check_size(storage, path)
        storage.create_dataset("more", (1,), "u1", chunks=(1,))
        with pytest.raises(FormatError, match="of which the file holds 0 bytes"):
            check_size(storage, path)
    with h5py.File(path, "w") as storage:
        storage.create_dataset("large", (most + 1,), "u1", chunks=(2**20,))
        with pytest.raises(FormatError, match=f"'large' has the shape .{most + 1},"):
            check_size(storage, path)


def test_a_tile_has_the_rows_of_a_quarter_of_a_million_samples():
    head = xr.Dataset(coords={"modulation_frequency": [1.0, 2.0], "polarization": [0]})
    for columns, rows in ((2**10, 128), (2**16, 2), (2**20, 1)):
        source = SimpleNamespace(head=head, rows=300, columns=columns)
        assert tiles.samples_of_row(source) == 2 * columns
        expected = [(k, min(k + rows, 300)) for k in range(0, 300, rows)]
        assert list(tiles.bands(source)) == expected
        assert list(tiles.bands(source, 299)) == [(0, 299), (299, 300)]


@given(st.integers(1, 4000), st.integers(1, 600))
def test_bands_are_spread_from_end_to_end(size, count):
    index, bands, gaps = tiles._spread_bands(size, count)
    inside = [n for begin, end in bands for n in range(begin, end)]
    assert inside == sorted(set(inside))
    assert inside[0] == 0
    # One separator stands between two bands, which are at least two apart.
    assert len(gaps) == len(bands) - 1
    assert np.delete(index, gaps).tolist() == inside
    assert all(after[0] > one[1] + 1 for one, after in itertools.pairwise(bands))
    if count >= size:
        assert bands == [(0, size)]
    else:
        # A row between two bands comes along if it is the only one there.
        assert len(inside) < count + max(count // 8, 1)
        # Bands have 8 rows or more; a single one is at the begin.
        assert inside[-1] == size - 1 or count < 16


def test_bands_that_touch_or_are_a_row_apart_are_one():
    # Two bands of 8 rows, from end to end.
    for size, bands in ((17, [(0, 17)]), (18, [(0, 8), (10, 18)])):
        assert tiles._spread_bands(size, 16)[1] == bands
