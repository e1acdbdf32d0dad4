"""A site file is read strictly, each mistake gets one line, and its files are seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from exact_scenes import plane

from amulor import cli, io
from amulor.errors import CubeError, SurveyError
from amulor.site import Site
from amulor.site.check import check
from amulor.site.load import range_image_of
from amulor.survey import Survey

SITE = """
name = "Two looks at a plate"
[[epoch]]
name = "spring"
date = 2026-04-02
[[scan]]
name = "left"
file = "left.nc"
epoch = "spring"
[scan.start]
position = ["0 m", "0 m", "1 m"]
heading = "90 deg"
position_uncertainty = "5 cm"
heading_uncertainty = "2 deg"
level_uncertainty = "1 deg"
[[scan]]
name = "right"
file = "right.nc"
epoch = "spring"
start = "unknown"
[[target]]
kind = "sphere"
name = "A"
radius = "50 mm"
radius_uncertainty = "0.1 mm"
places = [{scan = "left", row = 4, column = 5}, {scan = "right", row = 6, column = 7}]
[[target]]
kind = "checkerboard"
name = "B"
width = "20 cm"
places = [{scan = "left", row = 9, column = 5}, {scan = "right", row = 6, column = 17}]
[[target]]
kind = "point"
name = "C"
picking_uncertainty = "3 mm"
places = [{scan = "left", row = 9, column = 25}, {scan = "right", row = 16, column = 9}]
[[target]]
kind = "scale-bar"
name = "bar"
ends = ["A", "B"]
length = "1.0002 m"
length_uncertainty = "0.1 mm"
[[control]]
target = "A"
position = ["0 m", "0 m", "0 m"]
uncertainty = "2 mm"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with the scans of the site."""
    for name in ("left", "right"):
        io.write_cube(plane((0.0, 0.0, 1.0), 1.5), tmp_path / f"{name}.nc")
    (tmp_path / "site.toml").write_text(SITE)
    return tmp_path


def test_a_site_file_is_read_in_si_units_with_whole_paths(folder: Path) -> None:
    site = Site.from_toml(folder / "site.toml")
    first, second = site.scan
    assert first.file == folder / "left.nc"
    assert first.start is not None
    assert first.start.heading == pytest.approx(np.pi / 2)
    assert first.start.as_pose().level_uncertainty == pytest.approx(np.radians(1))
    assert second.start is None
    assert [one.name for one in site.scans_of("spring")] == ["left", "right"]


MISTAKES = [
    # what is replaced, by what, words of the only line
    ('"50 mm"', '"-50 mm"', "target.0.radius", "above 0"),
    ('kind = "sphere"', 'kind = "ball"', "target.0", "sphere, disc, checkerboard"),
    ('heading = "90 deg"', "", "scan.0.start.heading", "is missing"),
    ('heading = "90 deg"', "heading = 90", "scan.0.start.heading", "without a unit"),
    ('"2 deg"', '"0 deg"', "heading_uncertainty", "above 0"),
    ('name = "right"', 'name = "left"', "site", "2 scans are called 'left'"),
    ('epoch = "spring"\n[scan', 'epoch = "autumn"\n[scan', "site", "are 'spring'"),
    ('ends = ["A", "B"]', 'ends = ["A", "Z"]', "site", "'Z' is no target"),
    ('ends = ["A", "B"]', 'ends = ["A", "A"]', "ends", "name two"),
    ('target = "A"\npos', 'target = "bar"\npos', "site", "'bar' is no target"),
    ('{scan = "right", row = 6, column = 7}', '{scan = "up", row = 6, column = 7}',
     "site", "'up' is no scan"),
    ('{scan = "right", row = 6, column = 7}', '{scan = "left", row = 6, column = 7}',
     "site", "2 places"),
    ('"left.nc"', '"lost.nc"', "scan.0.file", "no such file"),
    ('"2 mm"\n', '"2 mm"\n[register]\nwindow = 7\n', "register", "'registration'"),
    ('"2 mm"\n', '"2 mm"\n[registration]\nwindow = 8\n', "registration", "odd"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "field", "words"), MISTAKES)
def test_a_mistake_gets_one_line_with_file_field_and_remedy(
    folder: Path, old: str, new: str, field: str, words: str
) -> None:
    assert old in SITE
    text = SITE.replace(old, new, 1)
    with pytest.raises(SurveyError) as caught:
        Site.from_text(text, name="site.toml", folder=folder)
    (line,) = str(caught.value).splitlines()
    assert line.startswith("site.toml: ")
    assert field in line
    assert words in line


def test_places_outside_and_scans_that_nothing_ties_are_named(folder: Path) -> None:
    text = SITE.replace("row = 16, column = 9", "row = 160, column = 9")
    text = text.replace('{scan = "right", row = 6, column = 17}', "").replace(
        ",  ]", "]"
    )
    found = check(Site.from_text(text.replace(", ]", "]"), folder=folder))
    assert len(found.mistakes) == 2
    assert "'C' in scan 'right'" in found.mistakes[0]
    assert "outside of its 20 rows and 30 columns" in found.mistakes[0]
    assert "shares 2 targets" in found.mistakes[1]
    assert found.shapes == {"left": (20, 30), "right": (20, 30)}


def test_a_good_site_has_no_mistake_and_a_simulated_one_needs_no_file(
    folder: Path,
) -> None:
    assert check(Site.from_toml(folder / "site.toml")).mistakes == ()
    (folder / "left.nc").unlink()
    (folder / "plate.toml").write_text("")
    text = SITE.replace(
        'file = "left.nc"', 'file = "left.nc"\nsimulated_from = "plate.toml"'
    )
    found = check(Site.from_text(text, folder=folder))
    assert found.mistakes == ()
    assert any("amulor run simulates it" in line for line in found.remarks)


def test_a_cube_that_is_no_image_needs_to_be_told_how(folder: Path) -> None:
    cube = io.read_cube(folder / "left.nc")
    # A cloud has no pixels to go by.
    from amulor import imaging

    io.write_cube(imaging.point_cloud(cube), folder / "left.nc", overwrite=True)
    found = check(Site.from_toml(folder / "site.toml"))
    assert any("'point_cloud'" in line for line in found.mistakes)


def test_a_scan_from_a_vehicle_needs_its_trajectory(folder: Path) -> None:
    example = Path(__file__).parents[3] / "examples" / "vehicle" / "amphora.toml"
    survey = Survey.from_toml(example).to_toml()
    image = io.read_cube(folder / "left.nc").assign_attrs(survey=survey)
    io.write_cube(image, folder / "left.nc", overwrite=True)
    site = Site.from_toml(folder / "site.toml")
    (mistake,) = check(site).mistakes
    assert "'left'" in mistake
    assert "[scan.trajectory]" in mistake
    with pytest.raises(CubeError, match=r"section \[platform\]"):
        range_image_of(site.scan[0])


def test_the_command_prints_a_line_or_says_what_is_wrong(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(folder / "site.toml")
    assert cli.main(["site", "check", path]) == 0
    assert "2 scans of 1 epochs, 4 targets, 1 control points" in capsys.readouterr().out
    (folder / "site.toml").write_text(SITE.replace("row = 16,", "row = 60,"))
    assert cli.main(["site", "check", path]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"amulor: {path}: target 'C' in scan 'right'")


@pytest.mark.parametrize("name", ["A", "B"])
def test_a_target_that_is_set_up_anew_has_no_control_point(
    folder: Path, name: str
) -> None:
    text = SITE.replace('name = "A"\n', 'name = "A"\nmoved = true\n', 1)
    text = text.replace('[[control]]\ntarget = "A"', f'[[control]]\ntarget = "{name}"')
    if name == "A":
        with pytest.raises(SurveyError, match="'A' is set up anew at each epoch"):
            Site.from_text(text, folder=folder)
    else:
        found = Site.from_text(text, folder=folder)
        assert [control.target for control in found.control] == ["B"]
