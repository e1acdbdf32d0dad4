"""Sample data are whole, small, and go through the commands they name."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scripts import script

from amulor import io, samples
from amulor.cli import main
from amulor.errors import FormatError

ROOT = Path(__file__).parents[3]
#: All of them together stay below five million bytes, which a wheel can carry.
LIMIT = 5_000_000


def test_all_data_are_listed_and_small() -> None:
    folder = ROOT / "src" / "amulor" / "samples" / "data"
    listed = {
        (one.folder, name) for one in samples.samples().values() for name in one.files
    }
    beside = {"samples.toml", "README.md", "LICENSE.txt"}
    found = {
        ("" if path.parent == folder else path.parent.name, path.name)
        for path in folder.rglob("*")
        if path.is_file() and path.name not in beside
    }
    assert listed == found
    assert sum(one.size for one in samples.samples().values()) < LIMIT


def test_a_copy_is_the_same_bytes_and_replaces_nothing_unasked(tmp_path: Path) -> None:
    paths = samples.copy("foam-slabs", tmp_path / "new")
    assert [path.name for path in paths] == list(samples.sample("foam-slabs").files)
    for path in paths:
        assert path.read_bytes() == samples.sample("foam-slabs").read(path.name)
    paths[0].unlink()
    paths[1].write_text("mine")
    with pytest.raises(FormatError, match="is there already"):
        samples.copy("foam-slabs", tmp_path / "new")
    assert not paths[0].exists()
    assert paths[1].read_text() == "mine"
    samples.copy("foam-slabs", tmp_path / "new", overwrite=True)
    assert paths[1].read_text() != "mine"


def test_a_cube_is_read_once_and_each_caller_has_its_own(tmp_path: Path) -> None:
    [path] = samples.copy("sweep", tmp_path)
    first = samples.cube("sweep")
    xr.testing.assert_identical(first, io.read_cube(path))
    first["in_phase"][:] = 0
    assert float(abs(samples.cube("sweep")["in_phase"]).max()) > 0
    with pytest.raises(ValueError, match="not a cube but slab_transmission"):
        samples.cube("foam-slabs")


def test_wrong_names_list_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="there are ladder, sweep, amphora"):
        samples.sample("foam")
    with pytest.raises(ValueError, match=r"has no file '\.\./samples\.toml'"):
        samples.sample("ladder").read("../samples.toml")
    assert main(["samples", "ladders"]) == 2
    assert capsys.readouterr().err.startswith("amulor: there are no sample data")


def test_the_command_lists_and_writes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["samples"]) == 0
    text = capsys.readouterr().out
    assert all(one.title in text for one in samples.samples().values())
    assert main(["samples", "ladder", "-o", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "ladder": [str(tmp_path / "ladder.nc")]
    }
    cube = io.read_cube(tmp_path / "ladder.nc")
    assert cube.attrs["level"] == "samples"
    assert cube.attrs["simulated"] == 1
    assert main(["samples", "ladder", "-o", str(tmp_path)]) == 1


def test_the_acquired_cube_has_no_truth(tmp_path: Path) -> None:
    [path] = samples.copy("amphora", tmp_path)
    cube = io.read_cube(path)
    assert "acqui" in cube.attrs["source"]
    assert not [name for name in cube.variables if "truth" in str(name)]


def test_no_cube_needs_a_file_beside_it() -> None:
    for name in ("ladder", "sweep", "amphora"):
        text = str(samples.cube(name).attrs["survey"])
        assert "file = " not in text
        assert "/tmp" not in text


def test_the_pages_name_all_of_them() -> None:
    text = (ROOT / "docs" / "reference" / "samples.md").read_text("utf-8")
    for name, one in samples.samples().items():
        assert f"`{name}`" in text
        assert one.title in text


@pytest.mark.slow
@pytest.mark.parametrize("name", list(samples.samples()))
def test_the_commands_it_names_do_what_they_promise(
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    samples.copy(name, tmp_path)
    monkeypatch.chdir(tmp_path)
    for command in samples.sample(name).commands:
        program, *words = shlex.split(command)
        assert program == "amulor"
        if words[0] == "view":
            words += ["--save", "page.html"]
        assert main(words) == 0, (command, capsys.readouterr().err)
    image = tmp_path / "range.nc"
    if image.exists():
        assert int(io.read_cube(image)["slant_range"].notnull().sum()) > 50


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ladder", "sweep"])
def test_the_cubes_are_what_the_tool_makes_today(name: str) -> None:
    tool = script("tools/make_samples.py")
    made = tool.CUBES[name]()
    kept = io.read_cube(ROOT / "src" / "amulor" / "samples" / "data" / f"{name}.nc")
    for key in ("in_phase", "quadrature"):
        one, two = made[key], kept[key]
        assert isinstance(two, xr.DataArray)
        scale = float(np.abs(two).max())
        np.testing.assert_allclose(one, two, rtol=1e-6, atol=1e-9 * scale)
