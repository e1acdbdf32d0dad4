"""A cube comes back from its file as it was, or the file is refused in one line."""

import importlib.abc
import io
import os
import sys

import h5py
import netCDF4
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as drawn

from amulor import cube as cubes
from amulor._hdf5 import check_small
from amulor.cube.schema import FORMER_NAMES
from amulor.errors import AmulorError, CubeError, FormatError
from amulor.io import netcdf, read_cube, write_cube

LEVELS = ["samples", "target_signal", "range_image", "point_cloud"]
ENGINES = ["netcdf4", "h5netcdf"]
SEAL = 80  # bytes behind the HDF5 file: a mark, "sha256:", 64 digits, a line end


@pytest.fixture
def path(tmp_path):
    return tmp_path / "cube.nc"


@pytest.fixture
def content(samples, path):
    """Bytes of a file of samples, which is itself gone."""
    write_cube(samples, path)
    content = path.read_bytes()
    path.unlink()
    return content


def one_line(info):
    text = str(info.value)
    assert text.isprintable()
    return text


@pytest.mark.parametrize("level", LEVELS)
def test_a_cube_comes_back_identical(make, rng, path, level):
    cube = getattr(make, level)(rng)
    write_cube(cube, path)
    found = read_cube(path)
    xr.testing.assert_identical(found, cube)
    assert {key: found[key].dtype for key in found.variables} == {
        key: cube[key].dtype for key in cube.variables
    }
    assert not any(found[key].encoding for key in found.variables)


def test_a_file_with_former_names_is_read_under_the_present_ones(make, rng, path):
    present = make.target_signal(rng)
    level = cubes.LEVELS["target_signal"].variables
    maps = {}
    for name in FORMER_NAMES.values():
        spec = level[name]
        values = rng.random([present.sizes[key] for key in spec.dimensions])
        text = {"units": spec.units, "long_name": spec.long_name}
        maps[name] = xr.Variable(spec.dimensions, values, text)
    present = present.assign(maps)
    back = {new: old for old, new in FORMER_NAMES.items()}
    former = present.rename_vars(back).assign(user_joint_notes=present["joint_misfit"])
    write_cube(former, path)
    with h5py.File(path) as file:
        assert "user_joint_slant_range" in file
        assert "joint_slant_range" not in file
    found = read_cube(path)
    # A user's own variable keeps its name.
    xr.testing.assert_identical(found.drop_vars("user_joint_notes"), present)
    assert "user_joint_notes" in found
    # Where a file holds both, none of them is lost.
    write_cube(
        former.assign(joint_misfit=present["joint_misfit"]), path, overwrite=True
    )
    assert {"joint_misfit", "user_joint_misfit"} <= set(read_cube(path).data_vars)


# Signals: whatever a file can hold that a detector can give, and NaN.
numbers = st.one_of(st.floats(-1e9, 1e9), st.just(float("nan")))
text = st.text(
    st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=40
)


@st.composite
def variations(draw):
    frequencies = draw(
        st.lists(st.floats(1e3, 1e9), min_size=1, max_size=2, unique=True).map(sorted)
    )
    polarizations = draw(
        st.lists(
            st.sampled_from(["none", "VV", "VH", "RL"]),
            min_size=1,
            max_size=2,
            unique=True,
        )
    )
    rows, columns = draw(st.tuples(st.integers(1, 3), st.integers(1, 3)))
    shape = (len(frequencies), len(polarizations), rows, columns)
    in_phase = draw(drawn.arrays(float, shape, elements=numbers | st.just(np.nan)))
    return frequencies, polarizations, in_phase, draw(text), draw(numbers)


@settings(max_examples=15, deadline=None)
@given(variations())
def test_any_cube_comes_back_identical(make, tmp_path_factory, variation):
    frequencies, polarizations, in_phase, title, number = variation
    cube = make.samples(
        np.random.default_rng(1),
        frequencies=frequencies,
        polarizations=polarizations,
        rows=in_phase.shape[2],
        columns=in_phase.shape[3],
    )
    cube["in_phase"].values[:] = in_phase
    cube = cube.assign_attrs(title=title, number=number, several=[1.0, number])
    path = tmp_path_factory.mktemp("drawn") / "cube.nc"
    write_cube(cube, path)
    xr.testing.assert_identical(read_cube(path), cube)


def test_flags_truth_values_and_single_precision_keep_their_types(make, rng, path):
    cube = make.samples(rng)
    saturated = rng.random(cube["in_phase"].shape) > 0.5
    described = {"units": "1", "long_name": "1 where the detector was overloaded"}
    cube["saturated"] = (cube["in_phase"].dims, saturated, described)
    cube["user_coarse"] = ("row", np.float32([1.5, np.nan, 3]))
    cube["user_day"] = ("row", [1.0, 2, 3], {"units": "days since 2026-01-01"})
    cube["user_label"] = ("row", np.array(["a", "", "Tiefe µm"], dtype=object))
    write_cube(cube, path)
    found = read_cube(path)
    xr.testing.assert_identical(found, cube)
    assert found["saturated"].dtype == bool
    assert found["user_coarse"].dtype == np.float32
    image = make.range_image(rng)
    write_cube(image, path, overwrite=True)
    flags = read_cube(path)["quality_flag"]
    assert flags.dtype == np.int16
    assert flags.attrs["flag_masks"].dtype == np.int16
    assert flags.attrs["flag_values"].dtype == np.int16
    assert flags.attrs["flag_meanings"] == image["quality_flag"].attrs["flag_meanings"]


def test_the_geometry_keeps_its_numbers(samples, path):
    write_cube(samples, path)
    geometry = read_cube(path).amulor.geometry
    assert geometry["group_index"] == 1.3823
    np.testing.assert_array_equal(geometry["receiver_position"], [0.35, 0, 0])


def test_long_and_foreign_text_comes_back(samples, path):
    # 64 kB is where HDF5 moves an attribute out of the header of its file.
    texts = {"survey": "μ = 0.3 # 1/m\n" * 8000, "history": "", "comment": "x"}
    write_cube(samples.assign_attrs(texts), path)
    assert read_cube(path).attrs | texts == read_cube(path).attrs


VALUES = {
    f"note_{number}": value
    for number, value in enumerate(
        [
            *(7, 0.5, np.float32(0.5), np.int16(3), np.str_("x"), "°C"),
            *([1, 2], (0.5, np.nan), np.arange(3, dtype=np.uint8)),
            *(["a", "µ"], ("a", ""), np.array(["a", "b"])),
        ]
    )
}


def test_attributes_of_any_kind_come_back(samples, path):
    write_cube(samples.assign_attrs(VALUES), path)
    attributes = read_cube(path).attrs
    with netCDF4.Dataset(path) as file:
        for name, value in VALUES.items():
            np.testing.assert_array_equal(attributes[name], value, err_msg=name)
            np.testing.assert_array_equal(file.getncattr(name), value, err_msg=name)


@pytest.mark.parametrize("engine", ENGINES)
def test_any_reader_sees_exactly_the_schema_in_the_root(samples, path, engine):
    write_cube(samples, path)
    with xr.open_dataset(path, engine=engine) as found:
        assert set(found.data_vars) == {
            "in_phase",
            "quadrature",
            "in_phase_uncertainty",
            "quadrature_uncertainty",
        }
        assert set(found.coords) == set(samples.coords)
        assert found.attrs["Conventions"] == samples.attrs["Conventions"]
        expected = cubes.without_groups(samples)
        xr.testing.assert_equal(found, expected)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_group_opens_alone_with_its_coordinates(samples, path, engine):
    write_cube(samples, path)
    with xr.open_dataset(path, engine=engine, group="open_water") as shots:
        assert set(shots.coords) == {"modulation_frequency", "polarization"}
        np.testing.assert_array_equal(shots["in_phase"], samples["open_water_in_phase"])
        np.testing.assert_array_equal(shots["modulation_frequency"], [30e6, 60e6])
        assert list(shots["polarization"].values) == ["VV", "VH"]
        assert shots["azimuth"].dims == ("shot",)
    with xr.open_dataset(path, engine=engine, group="truth") as truth:
        assert set(truth.data_vars) == {"slant_range"}
        np.testing.assert_array_equal(
            truth["slant_range"], samples["truth_slant_range"]
        )


def test_the_file_is_compressed_checked_and_plain_netcdf(make, rng, path):
    write_cube(make.target_signal(rng), path)
    with netCDF4.Dataset(path) as file:
        assert file.data_model == "NETCDF4"
        for key in ("in_phase", "water_quadrature", "quality_flag", "azimuth"):
            filters = file[key].filters()
            assert filters["zlib"]
            assert filters["complevel"] == 4
            assert filters["shuffle"]
            assert filters["fletcher32"]
        filled = {key for key in file.variables if "_FillValue" in file[key].ncattrs()}
        assert filled == {
            *("in_phase", "quadrature", "in_phase_uncertainty"),
            *("quadrature_uncertainty", "water_in_phase", "water_quadrature", "time"),
        }
        assert file["polarization"].dtype is str
        assert file["quality_flag"].dtype == np.int16
        assert file["geometry"].shape == ()
        assert set(file["in_phase"].coordinates.split()) == {
            *("azimuth", "elevation", "time", "geometry")
        }


def test_large_arrays_are_cut_into_chunks_of_128_KiB(make, rng, path):
    cube = make.samples(rng, rows=300, columns=500)
    write_cube(cube, path)
    with netCDF4.Dataset(path) as file:
        chunks = file["in_phase"].chunking()
    assert chunks == [1, 1, 32, 500]  # 32 rows of 500 are 128 kB
    xr.testing.assert_identical(read_cube(path), cube)


def test_a_part_of_what_was_read_can_be_written_again(samples, path, tmp_path):
    write_cube(samples, path)
    part = read_cube(path).isel(modulation_frequency=[1], row=slice(1, 3))
    write_cube(part, tmp_path / "part.nc")
    xr.testing.assert_identical(read_cube(tmp_path / "part.nc"), part)


def test_a_file_that_others_edit_or_rewrite_is_still_read(samples, path, tmp_path):
    write_cube(samples, path)
    assert b"sha256:" in path.read_bytes()[-SEAL:]
    with netCDF4.Dataset(path, "a") as file:
        file.setncattr("comment", "looked at")
        file["in_phase"][0, 0, 0, 0] = 42.0
    found = read_cube(path)
    assert found.attrs["comment"] == "looked at"
    assert found["in_phase"].values[0, 0, 0, 0] == 42
    with xr.open_dataset(path) as opened:
        opened.to_netcdf(tmp_path / "again.nc", engine="netcdf4")
    again = read_cube(tmp_path / "again.nc")
    xr.testing.assert_identical(again, cubes.without_groups(found))


def test_an_existing_cube_is_kept_unless_overwritten(samples, path):
    write_cube(samples, path)
    other = samples.assign_attrs(title="another")
    with pytest.raises(FormatError, match="--overwrite"):
        write_cube(other, path)
    assert read_cube(path).attrs["title"] == samples.attrs["title"]
    write_cube(other, path, overwrite=True)
    assert read_cube(path).attrs["title"] == "another"


def test_a_full_disk_leaves_nothing(make, rng, path, small_disk):
    cube = make.samples(rng, rows=50, columns=50)
    with small_disk(), pytest.raises(FormatError, match=r"cube\.nc") as info:
        write_cube(cube, path)
    one_line(info)
    assert list(path.parent.iterdir()) == []
    write_cube(cube, path)  # and nothing of the first try is left open
    xr.testing.assert_identical(read_cube(path), cube)


unwritable = {
    "a missing variable": lambda c: c.drop_vars("quadrature"),
    "units": lambda c: c.assign(quadrature=c["quadrature"].assign_attrs(units="mV")),
    "complex128": lambda c: c.assign(truth_signal=c["in_phase"] * 1j),
    "datetime64": lambda c: c.assign(user_day=np.datetime64("2026-01-01")),
    "object": lambda c: c.assign(user_thing=((), {"a": 1})),
    "float16": lambda c: c.assign(user_half=np.float16(1)),
    "is None": lambda c: c.assign_attrs(note=None),
    "is True": lambda c: c.assign_attrs(simulated=True),
    "'a': 1": lambda c: c.assign_attrs(note={"a": 1}),
    "[1, [2, 3]]": lambda c: c.assign_attrs(note=[1, [2, 3]]),
    "['a', 1]": lambda c: c.assign_attrs(note=["a", 1]),
    "array([[1., 1.]])": lambda c: c.assign_attrs(note=np.ones((1, 2))),
    r"\udc80": lambda c: c.assign_attrs(note="a\udc80"),
    r"\x00": lambda c: c.assign_attrs(note="a\0b"),
    "is []": lambda c: c.assign_attrs(note=[]),
    "[True]": lambda c: c.assign_attrs(note=[True]),
    "'user_a/b'": lambda c: c.assign({"user_a/b": 1.0}),
    "'scale_factor'": lambda c: c.assign(
        in_phase=c["in_phase"].assign_attrs(scale_factor=2.0)
    ),
    "'truth_row'": lambda c: c.assign(truth_row=("row", np.arange(3.0))),
}


@pytest.mark.parametrize("words", unwritable)
def test_what_a_file_cannot_hold_is_refused_before_writing(samples, path, words):
    cube = unwritable[words](samples)
    with pytest.raises(CubeError) as info:
        write_cube(cube, path)
    assert str(path) in one_line(info)
    assert words == "a missing variable" or words in one_line(info)
    assert list(path.parent.iterdir()) == []


def refused(path):
    """Return the line that refuses a file, and check that it names the file."""
    with pytest.raises(AmulorError) as info:
        read_cube(path)
    assert str(path) in one_line(info)
    return one_line(info)


def netcdf_of_another(path):
    with netCDF4.Dataset(path, "w") as file:
        file.createDimension("time", None)
        file.createVariable("time", float, ("time",))[:] = [0.0, 1.0]
        file["time"].units = "days since 2000-01-01"


def classic(path):
    with netCDF4.Dataset(path, "w", format="NETCDF3_CLASSIC") as file:
        file.createDimension("x", 2)


def hdf5_of_another(path):
    with h5py.File(path, "w") as file:
        file["x"] = np.arange(3)


def hdf5_that_claims_to_be_a_cube(path):
    with h5py.File(path, "w") as file:
        file["x"] = np.arange(3)
        file.attrs["amulor_schema_version"] = "1"


foreign = {
    "does not exist": lambda path: None,
    "is a folder": lambda path: path.mkdir(),
    "is empty": lambda path: path.touch(),
    "no netCDF-4 file": lambda path: path.write_text("in_phase,quadrature\n1,2\n"),
    "PNG": lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100)),
    "nccopy": classic,
    "'amulor_schema_version'": netcdf_of_another,
    "is no cube": hdf5_of_another,
    "cannot be read": hdf5_that_claims_to_be_a_cube,
}


@pytest.mark.parametrize("words", foreign)
def test_a_foreign_file_is_refused_with_what_it_is(path, words, capfd):
    foreign[words](path)
    assert words in refused(path)
    assert capfd.readouterr() == ("", "")  # HDF5 does not print its own errors


MISMATCH = "numpy.dtype size changed, may indicate binary incompatibility"


@pytest.mark.parametrize("kind", [ImportError, ValueError, AttributeError])
def test_a_library_that_does_not_run_is_no_damaged_file(
    samples, path, monkeypatch, kind
):
    write_cube(samples, path)

    class Broken(importlib.abc.MetaPathFinder):
        def find_spec(self, name, *_):
            if name == "h5py":
                raise kind(MISMATCH)

    monkeypatch.delitem(sys.modules, "h5py")
    monkeypatch.setattr(sys, "meta_path", [Broken(), *sys.meta_path])
    for use in (
        lambda: read_cube(path),
        lambda: write_cube(samples, path, overwrite=True),
        lambda: netcdf.is_large(path),
    ):
        with pytest.raises(FormatError) as error:
            use()
        said = str(error.value)
        assert MISMATCH in said
        assert np.__version__ in said
        assert "pip install" in said
        assert "damaged" not in said
        assert "copy it" not in said


@pytest.mark.parametrize("part", [0.001, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0])
def test_a_truncated_file_is_refused(content, path, part, capfd):
    path.write_bytes(content[: min(int(part * len(content)), len(content) - 1)])
    assert "copy it again" in refused(path) or "no netCDF-4 file" in refused(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 1.0])
def test_a_truncated_file_of_another_program_is_refused(content, path, part, capfd):
    unsealed = content[:-SEAL]
    path.write_bytes(unsealed[: int(part * (len(unsealed) - 1))])
    assert "copy it again" in refused(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("seed", range(4))
def test_no_flipped_byte_changes_a_number_unnoticed(
    content, samples, path, seed, capfd
):
    rng = np.random.default_rng(seed)
    lines = []
    for position in rng.integers(0, len(content), 12):
        damaged = bytearray(content)
        damaged[position] ^= rng.integers(1, 256)
        path.write_bytes(damaged)
        try:
            found = read_cube(path)
        except AmulorError as error:
            lines.append(str(error))
        else:  # the byte is in what marks the digest
            xr.testing.assert_identical(found, samples)
    assert lines
    assert all(str(path) in line and line.isprintable() for line in lines)
    assert capfd.readouterr() == ("", "")


def test_the_structure_of_the_file_is_one_that_has_checksums(content):
    # Byte 8 is the version of the superblock: 3 came with HDF5 1.10, and with it the
    # indices of chunks that are checked when read.
    assert content[8] == 3


def test_damage_that_hdf5_does_not_return_from_is_refused(content, path):
    # The size of an object in the heap that holds the lists of dimensions.
    damaged = bytearray(content)
    damaged[content.index(b"GCOL") + 25] ^= 4
    path.write_bytes(damaged)
    assert "is damaged" in refused(path)


def test_every_stored_array_is_under_a_checksum_of_its_own(content, path):
    content = content[:-SEAL]
    places = {}

    def collect(name, item):
        if isinstance(item, h5py.Dataset) and item.chunks:
            chunk = item.id.get_chunk_info(0)
            places[name] = chunk.byte_offset + chunk.size // 2

    with h5py.File(io.BytesIO(content)) as file:
        file.visititems(collect)
    assert {"in_phase", "azimuth", "open_water/quadrature", "truth/slant_range"} <= {
        *places
    }
    for position in places.values():
        damaged = bytearray(content)
        damaged[position] ^= 1
        path.write_bytes(damaged)
        assert "copy it again" in refused(path)


@pytest.mark.parametrize("sought", [b"absorption = 0.31", b"group_index", b"VH"])
def test_text_and_geometry_are_under_the_digest(samples, path, sought):
    # HDF5 has no checksum for a text beyond 4 kB or of variable length.
    survey = "# water\n" * 1000 + "absorption = 0.31"
    write_cube(samples.assign_attrs(survey=survey), path)
    content = path.read_bytes()
    for position in (content.index(sought), content.index(sought) + len(sought) + 8):
        damaged = bytearray(content)
        damaged[position] ^= 1
        path.write_bytes(damaged)
        assert "is damaged" in refused(path)


def edited(samples, path, edit):
    write_cube(samples, path)
    with netCDF4.Dataset(path, "a") as file:
        edit(file)
    return refused(path)


def test_a_cube_that_is_not_one_is_refused_with_what_is_wrong(samples, path):
    def level(file):
        file.level = "range_image"

    def units(file):
        file["in_phase"].units = "mV"

    def name(file):
        file.renameVariable("quadrature", "user_quadrature")

    def version(file):
        file.amulor_schema_version = "0"

    def frequency(file):
        file["open_water/modulation_frequency"][:] = [30e6, 61e6]

    def geometry(file):
        file["geometry"].group_index = "water"

    for edit, words in [
        (level, "'in_phase' has no place in a range_image"),
        (units, "'in_phase' has units 'mV', needed is 'V'"),
        (name, "'quadrature' is missing"),
        (version, "'amulor_schema_version' is '0'"),
        (frequency, "'open_water' has 'modulation_frequency' [30000000.0, 61000000.0]"),
        (geometry, "lacks the attribute 'group_index' or holds something else"),
    ]:
        assert words in edited(samples, path, edit)
        path.unlink()


def test_reading_leaves_no_file_open(samples, path):
    write_cube(samples, path)
    handles = "/proc/self/fd"
    if not os.path.isdir(handles):
        pytest.skip("this system does not list open files")
    before = len(os.listdir(handles))
    read_cube(path)
    path.write_bytes(path.read_bytes()[:5000])
    refused(path)
    assert len(os.listdir(handles)) == before


def test_names_and_attributes_are_left_as_they_were(samples, path):
    before = samples.copy(deep=True)
    write_cube(samples, path)
    xr.testing.assert_identical(samples, before)


@pytest.mark.parametrize(
    ("place", "change"),
    [(0, bytes(16)), (8, b"\xff\xff")],
    ids=["an object of no size", "an object beyond the end"],
)
def test_a_damaged_heap_is_refused_before_hdf5_reads_it(content, path, place, change):
    # HDF5 2.0 does not return from an object of index 0 and size 0.
    unsealed = bytearray(content[:-SEAL])
    path.write_bytes(unsealed)
    read_cube(path)
    first = unsealed.index(b"GCOL") + 16
    unsealed[first + place : first + place + len(change)] = change
    path.write_bytes(unsealed)
    for read in (read_cube, _head, check_small):
        with pytest.raises(FormatError, match=r"global heap at byte \d+ is not filled"):
            read(path)


def _head(path):
    with netcdf.open_rows(path) as rows:
        return rows.head
