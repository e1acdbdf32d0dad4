"""Sample data: where files lie, how they are read, and what is not replaced."""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path

import pytest
import xarray as xr

from amulor import samples
from amulor.errors import FormatError
from amulor.samples import listing

DATA = resources.files("amulor.samples").joinpath("data")


def test_all_that_is_listed_of_a_sample_is_told() -> None:
    listed = tomllib.loads(DATA.joinpath("samples.toml").read_text("utf-8"))
    found = samples.samples()
    assert list(found) == list(listed)
    for name, entry in listed.items():
        one = found[name]
        assert one.name == name
        for key in ("title", "origin", "licence", "shows"):
            assert getattr(one, key) == entry[key]
        assert one.files == tuple(entry["files"])
        assert one.commands == tuple(entry["commands"])
        assert one.folder == entry.get("folder", "")


@pytest.mark.parametrize("name", list(samples.samples()))
def test_the_size_of_a_sample_is_that_of_its_files(name: str) -> None:
    one = samples.sample(name)
    place = DATA.joinpath(one.folder) if one.folder else DATA
    contents = [place.joinpath(file).read_bytes() for file in one.files]
    assert one.size == sum(map(len, contents)) > 0
    assert [one.read(file) for file in one.files] == contents


def test_unknown_names_are_answered_with_all_that_there_are() -> None:
    names = ", ".join(samples.samples())
    with pytest.raises(ValueError, match=r".") as caught:
        samples.sample("foam")
    assert str(caught.value) == f"there are no sample data 'foam'; there are {names}"
    slabs = samples.sample("foam-slabs")
    with pytest.raises(ValueError, match=r".") as caught:
        slabs.read("a.nc")
    assert str(caught.value) == (
        f"sample 'foam-slabs' has no file 'a.nc'; it has {', '.join(slabs.files)}"
    )
    with pytest.raises(ValueError, match=r".") as caught:
        samples.cube("foam-slabs")
    assert str(caught.value) == (
        f"sample data 'foam-slabs' are not a cube but {', '.join(slabs.files)}; write "
        "them by amulor.samples.copy and import them as their commands say"
    )


def test_a_cube_is_a_copy_of_what_was_read(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = xr.Dataset({"in_phase": ("row", [1.0, 2.0])})
    monkeypatch.setattr(listing, "_read", lambda one: kept)
    found = samples.cube("ladder")
    xr.testing.assert_identical(found, kept)
    found["in_phase"][0] = 5.0
    assert kept["in_phase"].values.tolist() == [1, 2]


def test_files_that_are_there_are_named_and_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # Into the present folder, unless another one is named.
    paths = samples.copy("foam-slabs")
    assert [path.parent for path in paths] == [Path()] * len(paths)
    for path in paths[1:]:
        path.unlink()
    with pytest.raises(FormatError) as caught:
        samples.copy("foam-slabs")
    assert str(caught.value) == (
        f"{paths[0]} is there already; choose another folder, or allow to overwrite it"
    )
    assert [path.exists() for path in paths] == [True] + [False] * (len(paths) - 1)
    assert samples.copy("foam-slabs", overwrite=True) == paths
    assert all(path.exists() for path in paths)
