"""A tally comes back from its file bit by bit, merges and goes on, or is refused."""

from __future__ import annotations

import dataclasses

import netCDF4
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as drawn

from amulor.errors import AmulorError, FormatError
from amulor.io import read_cube, read_tally, write_cube, write_tally
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.transport import (
    DiscReceiver,
    Medium,
    PathRecord,
    ScatteringMatrix,
    Source,
    Tally,
    simulate,
)

DISC = DiscReceiver(radius=0.05, acceptance_angle=0.1, position=(0.07, 0.0, 0.0))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.nc"


def run(seed=3, function=None, **others):
    water = Medium.homogeneous(
        absorption=0.2,
        scattering=0.8,
        phase_function=function or henyey_greenstein_function(asymmetry=0.9),
        group_index=1.33,
    )
    return simulate(
        water, Source(), DISC, [90e6, 0.0, 90e6], histories=4000, seed=seed, **others
    )


@pytest.fixture(scope="module")
def tally():
    return run()


@pytest.fixture
def content(tally, path):
    """Bytes of a file, which is itself gone."""
    write_tally(tally, path)
    content = path.read_bytes()
    path.unlink()
    return content


def assert_identical(one, other):
    """Compare every field, arrays by their bytes."""
    assert type(one) is type(other)
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            assert (a.dtype, a.shape) == (b.dtype, b.shape), field.name
            assert a.tobytes() == b.tobytes(), field.name
        elif dataclasses.is_dataclass(a):
            assert_identical(a, b)
        else:
            assert a == b, field.name
            assert type(a) is type(b), field.name


def test_a_tally_comes_back_bit_by_bit(tally, path):
    write_tally(tally, path)
    assert_identical(read_tally(path), tally)


def test_stokes_vectors_and_a_record_come_back(path):
    kept = run(function=ScatteringMatrix.rayleigh(), keep_record=True, seed=2**80)
    assert kept.polarized
    assert kept.record.water.shape[1] == 4
    write_tally(kept, path)
    found = read_tally(path)
    assert_identical(found, kept)
    np.testing.assert_array_equal(found.detected("H")[1], kept.detected("H")[1])


def test_derivatives_come_back(path):
    kept = run(derivatives=("scattering", "absorption"))
    write_tally(kept, path)
    assert_identical(read_tally(path), kept)


numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)


@settings(max_examples=10)  # each is written through to the disk
@given(st.data(), st.sampled_from([1, 4]), st.integers(1, 3), st.integers(1, 4))
def test_any_numbers_come_back(tmp_path_factory, data, components, parts, frequencies):
    count = data.draw(st.integers(1, 5))
    shape = (count, parts, components, frequencies)
    batches = np.empty(shape, dtype=complex)
    batches.real = data.draw(drawn.arrays(float, shape, elements=numbers))
    batches.imag = data.draw(drawn.arrays(float, shape, elements=numbers))
    record = PathRecord(
        length=np.arange(3.0),
        water=data.draw(drawn.arrays(float, (3, components), elements=numbers)),
        target=np.zeros((3, components)),
        beyond=data.draw(numbers),
    )
    tally = Tally(
        modulation_frequency=data.draw(
            drawn.arrays(float, frequencies, elements=st.floats(0, 1e12))
        ),
        parts=tuple(f"part {k}" for k in range(parts)),
        batches=batches,
        histories_of=data.draw(
            drawn.arrays(np.int64, count, elements=st.integers(1, 2**60))
        ),
        groups=data.draw(st.integers(0, 2**60)),
        contribution=(data.draw(numbers), data.draw(numbers), data.draw(numbers)),
        seed=data.draw(st.integers(0, 2**128)),
        next_batch=data.draw(st.integers(-1, 2**60)),
        batch_size=data.draw(st.integers(1, 2**40)),
        problem=data.draw(st.text("0123456789abcdef ", max_size=64)),
        seconds=data.draw(numbers),
        interrupted=data.draw(st.booleans()),
        record=data.draw(st.sampled_from([None, record])),
        merged_seeds=tuple(data.draw(st.lists(st.integers(0, 2**70), max_size=3))),
        contributions=data.draw(
            drawn.arrays(float, (3, 7 if components == 4 else 1, 3), elements=numbers)
        ),
        unseen=data.draw(numbers),
        phase_function_integral=tuple(data.draw(st.lists(numbers, max_size=3))),
    )
    path = tmp_path_factory.mktemp("tally") / "run.nc"
    write_tally(tally, path)
    assert_identical(read_tally(path), tally)


def test_a_run_goes_on_after_reading_as_if_it_had_not_stopped(tally, path):
    def stop(progress):
        if progress.histories >= 1500:
            raise KeyboardInterrupt

    part = run(progress=stop)
    assert part.interrupted
    write_tally(part, path)
    rest = run(resume=read_tally(path))
    for name in ("batches", "histories_of"):
        assert getattr(rest, name).tobytes() == getattr(tally, name).tobytes()
    assert rest.contribution == tally.contribution
    assert rest.contributions.tobytes() == tally.contributions.tobytes()
    assert (rest.groups, rest.next_batch) == (tally.groups, tally.next_batch)


def test_runs_are_merged_after_reading(tally, path, tmp_path):
    other = run(seed=4)
    write_tally(tally, path)
    write_tally(other, tmp_path / "other.nc")
    merged = read_tally(path).merged(read_tally(tmp_path / "other.nc"))
    assert_identical(merged, tally.merged(other))
    write_tally(merged, tmp_path / "merged.nc")
    again = read_tally(tmp_path / "merged.nc")
    assert_identical(again, merged)
    with pytest.raises(ValueError, match="the seed 4,"):
        again.merged(other)


def test_others_can_read_what_it_means(tally, path):
    write_tally(tally, path)
    with xr.open_dataset(path, engine="netcdf4") as found:
        part = found.sel(part="water, order 2")
        mean = (part["in_phase"] * part["histories"]).sum("batch")
        mean = mean / part["histories"].sum()
        expected = tally.part("water, order 2")[0].real
        np.testing.assert_allclose(mean, expected, rtol=1e-12)
        assert found["modulation_frequency"].attrs["units"] == "Hz"
        assert list(found["component"].values) == ["I"]


def test_an_existing_file_is_kept_unless_overwritten(tally, path):
    write_tally(tally, path)
    other = dataclasses.replace(tally, seed=77)
    with pytest.raises(FormatError, match="--overwrite"):
        write_tally(other, path)
    assert read_tally(path).seed == tally.seed
    write_tally(other, path, overwrite=True)
    assert read_tally(path).seed == 77
    assert [file.name for file in path.parent.iterdir()] == ["run.nc"]


def test_a_full_disk_leaves_nothing(tally, path, small_disk):
    rng = np.random.default_rng(1)
    large = dataclasses.replace(
        tally,
        batches=rng.normal(size=(*tally.batches.shape[:3], 20)) + 1j,
        modulation_frequency=np.arange(20.0),
    )
    with small_disk(), pytest.raises(FormatError, match=r"run\.nc"):
        write_tally(large, path)
    assert list(path.parent.iterdir()) == []


def refused(path):
    """Return the line that refuses a file, and check that it names the file."""
    with pytest.raises(AmulorError) as info:
        read_tally(path)
    assert isinstance(info.value, FormatError)
    assert str(path) in str(info.value)
    assert str(info.value).isprintable()
    return str(info.value)


@pytest.mark.parametrize("part", [0.001, 0.3, 0.9, 0.999])
def test_a_truncated_file_is_refused(content, path, part, capfd):
    path.write_bytes(content[: int(part * len(content))])
    line = refused(path)
    assert "copy it again" in line or "no netCDF-4 file" in line
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("seed", range(3))
def test_no_flipped_byte_changes_a_number_unnoticed(content, tally, path, seed):
    rng = np.random.default_rng(seed)
    refusals = 0
    for position in rng.integers(0, len(content), 8):
        damaged = bytearray(content)
        damaged[position] ^= rng.integers(1, 256)
        path.write_bytes(damaged)
        try:
            found = read_tally(path)
        except FormatError:
            refusals += 1
        else:  # the byte is in what marks the digest
            assert_identical(found, tally)
    assert refusals > 0


def test_foreign_files_are_refused_with_what_they_are(path, samples, tally):
    assert "does not exist" in refused(path)
    path.write_text("in_phase,quadrature\n1,2\n")
    assert "no netCDF-4 file" in refused(path)
    write_cube(samples, path, overwrite=True)
    assert "is no tally of amulor" in refused(path)
    write_tally(tally, path, overwrite=True)
    with pytest.raises(FormatError, match="is no cube of amulor"):
        read_cube(path)


def edited(tally, path, edit):
    write_tally(tally, path, overwrite=True)
    with netCDF4.Dataset(path, "a") as file:
        edit(file)
    return refused(path)


def test_a_file_that_others_made_wrong_is_refused_with_what_is_wrong(tally, path):
    def version(file):
        file.amulor_tally_version = "99"

    def histories(file):
        file["histories"][0] = 0

    def hole(file):
        file["in_phase"][0, 0, 0, 0] = np.nan

    def missing(file):
        file.renameVariable("quadrature", "imaginary")

    def problem(file):
        file.delncattr("problem")

    def seeds(file):
        file.seeds = "three"

    for edit, words in (
        (version, "'amulor_tally_version' '99'"),
        (histories, "a batch without histories"),
        (hole, "'in_phase' holds numbers that are not finite"),
        (missing, "cannot be read as a tally"),
        (problem, "cannot be read as a tally"),
        (seeds, "cannot be read as a tally"),
    ):
        assert words in edited(tally, path, edit)
