"""`--tile-rows`: the files that the commands make without it, in bounded memory."""

from __future__ import annotations

import json

import pytest
import xarray as xr

from amulor import io, pipeline
from amulor.cli import main
from amulor.simulation import simulate
from amulor.survey import Survey


def run(*words, expected=0):
    """Run a command and check how it ends."""
    assert main([str(word) for word in words]) == expected


def content(path):
    """Return a cube without the line that says when."""
    return io.read_cube(path).assign_attrs(history="")


@pytest.fixture
def cube(plate_text, tmp_path):
    path = tmp_path / "samples.nc"
    io.write_cube(simulate(Survey.from_text(plate_text), rng=5), path)
    return path


@pytest.mark.slow
def test_commands_work_by_rows(cube, tmp_path, capsys):
    ends = ("--nearest", "0.8 m", "--farthest", "3 m")
    one, other = tmp_path / "one.nc", tmp_path / "other.nc"
    run("reject", cube, "--method", "co-polarized", "-o", one, "--json")
    whole = json.loads(capsys.readouterr().out)
    words = ("--tile-rows", 4)
    run("reject", cube, "--method", "co-polarized", "-o", other, "--json", *words)
    rows = json.loads(capsys.readouterr().out)
    assert rows | {"output": ""} == whole | {"output": ""}
    xr.testing.assert_identical(content(one), content(other))
    images = tmp_path / "image.nc", tmp_path / "image_rows.nc"
    run("image", one, "-o", images[0], *ends)
    run("image", other, "-o", images[1], *ends, "--tile-rows", 1)
    said = [
        line.split(": ")[1]
        for line in capsys.readouterr().out.splitlines()
        if ": range image" in line
    ]
    assert said[0].startswith(said[1])
    xr.testing.assert_identical(*map(content, images))


@pytest.mark.study
def test_auto_by_rows_prints_and_writes_what_it_does_with_the_whole(
    cube, tmp_path, capsys
):
    said, made = [], []
    for number, words in enumerate(([], ["--tile-rows", 4])):
        output = tmp_path / f"{number}.nc"
        run("reject", cube, "--method", "auto", "-o", output, "--json", *words)
        said.append(json.loads(capsys.readouterr().out) | {"output": ""})
        made.append(content(output))
    assert said[0] == said[1]
    xr.testing.assert_identical(*made)


def test_large_files_are_worked_on_by_rows_unasked(cube, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("AMULOR_LARGE", "1")
    seen = []
    by_rows = pipeline.open_rows
    monkeypatch.setattr(
        pipeline, "open_rows", lambda path: seen.append(path) or by_rows(path)
    )
    output = tmp_path / "target.nc"
    run("reject", cube, "--method", "none", "-o", output)
    assert seen == [cube]
    assert "target signal" in capsys.readouterr().out
    assert io.read_cube(output).attrs["level"] == "target_signal"


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--method", "none", "--tile-rows", "0"), 2, "must be 1 or more"),
    ],
)
def test_what_does_not_go_by_rows_is_refused(cube, tmp_path, capsys, words, code, said):
    output = tmp_path / "target.nc"
    named = [cube if word == "CUBE" else word for word in words]
    if "--tile-rows" not in named:
        named += ["--tile-rows", "4"]
    run("reject", cube, "-o", output, *named, expected=code)
    assert said in " ".join(capsys.readouterr().err.split())
    assert not output.exists()
