"""An image with the water left in states no accuracy: on every surface."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import laspy
import numpy as np
import pye57
import pytest
import xarray as xr
from project_files import project_text

from amulor import cube as cubes
from amulor import imaging, io, rejection
from amulor.cli import main
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.handover.order import statements_of
from amulor.imaging import measure
from amulor.simulation import simulate
from amulor.site.description import Processing
from amulor.site.load import as_image
from amulor.survey import Survey
from amulor.view import page
from amulor.view.page.measuring import measured

#: What everything says in place of an interval.
WORDS = "water not removed: error unknown, expect centimeters"
#: Words that only a statement of accuracy has.
INTERVALS = ("k = 2", "about 95", "U = ", "median uncertainty")


@pytest.fixture(scope="module")
def folder(plate: Survey, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the target signal and the image, water left in."""
    made = tmp_path_factory.mktemp("raw")
    raw = rejection.keep_water(simulate(plate, rng=1))
    io.write_cube(raw, made / "raw.nc")
    image = imaging.range_image(raw, polarization="VV")
    io.write_cube(imaging.flag_outliers(imaging.flag_mixed(image)), made / "before.nc")
    return made


@pytest.fixture(scope="module")
def image(folder: Path) -> xr.Dataset:
    return io.read_cube(folder / "before.nc")


def said(capsys: pytest.CaptureFixture[str], *command: str | Path) -> str:
    """Return what a command prints, on one line."""
    assert main([str(part) for part in command]) == 0
    return " ".join(capsys.readouterr().out.split())


def no_interval(text: str) -> bool:
    return not any(words in text for words in INTERVALS)


def test_the_image_holds_ranges_and_no_uncertainty(image: xr.Dataset) -> None:
    seen = image["slant_range"].notnull().values
    # The simulated truth: the water pulls the plate by more than a centimetre.
    off = image["slant_range"].values - image["truth_slant_range"].values
    assert abs(off[seen].mean()) > 0.01
    assert np.isnan(image["slant_range_uncertainty"].values).all()
    assert image.attrs["error_unknown"] == WORDS
    # The noise of the pixels stays known, and edges are found by it.
    noise = image["slant_range_uncertainty_counting"].values[seen]
    assert (noise > 0).all()


def test_ranges_off_by_whole_intervals_state_no_uncertainty(plate: Survey) -> None:
    far = plate.with_({"targets.0.position": [0.0, 0.0, 9.0]})
    cube = rejection.keep_water(simulate(plate, rng=1))
    cube.attrs["survey"] = far.to_toml()
    cube["quality_flag"] = cube["quality_flag"] & ~np.int16(QualityFlag.NO_OPEN_WATER)
    del cube.attrs["error_unknown"]
    image = imaging.range_image(cube, polarization="VV")
    assert (image["quality_flag"].values & QualityFlag.RELATIVE).all()
    assert np.isnan(image["slant_range_uncertainty"].values).all()
    assert "off by whole intervals" in cubes.error_unknown(image)
    assert np.isnan(imaging.error_budget(image).expanded)


def test_a_file_of_before_is_read_without_its_uncertainty(
    image: xr.Dataset, tmp_path: Path
) -> None:
    old = image.copy(deep=True)
    old["slant_range_uncertainty"][:] = 0.0005
    del old.attrs["error_unknown"]
    io.write_cube(old, tmp_path / "old.nc")
    found = io.read_cube(tmp_path / "old.nc")
    assert np.isnan(found["slant_range_uncertainty"].values).all()
    assert cubes.error_unknown(found) == WORDS


def test_an_estimated_bias_is_stated_with_it(image: xr.Dataset) -> None:
    bias = xr.full_like(image["slant_range"], -0.0219)
    bias.attrs["long_name"] = "estimated error by water signal left in"
    words = cubes.error_unknown(image.assign(slant_range_bias=bias))
    assert words == f"{WORDS} (median of the estimated bias -21.9 mm)"


def test_info_states_no_interval(folder: Path, capsys) -> None:
    text = said(capsys, "info", folder / "before.nc")
    assert WORDS in text
    assert no_interval(text)
    budget = json.loads(said(capsys, "info", folder / "before.nc", "--json"))
    assert budget["uncertainty"]["expanded_m"] is None
    assert budget["uncertainty"]["error_unknown"] == WORDS
    assert not budget["uncertainty"]["terms"]


@pytest.mark.parametrize("rows", [[], ["--tile-rows", "2"]], ids=["whole", "by rows"])
def test_image_states_no_interval(folder: Path, tmp_path, capsys, rows) -> None:
    output = tmp_path / "before.nc"
    command = ("image", folder / "raw.nc", "-o", output, "--polarization", "VV")
    text = said(capsys, *command, *rows)
    assert WORDS in text
    assert no_interval(text)
    assert np.isnan(io.read_cube(output)["slant_range_uncertainty"].values).all()


def test_an_unsettled_interval_hides_no_water(
    plate: Survey, folder: Path, tmp_path, capsys
) -> None:
    raw = io.read_cube(folder / "raw.nc")
    far = plate.with_({"targets.0.position": [0.0, 0.0, 9.0]})
    io.write_cube(raw.assign_attrs(survey=far.to_toml()), tmp_path / "far.nc")
    command = ("image", tmp_path / "far.nc", "-o", tmp_path / "far_range.nc")
    text = said(capsys, *command, "--polarization", "VV")
    assert "unknown number of intervals" in text
    assert WORDS in text


def test_a_report_states_no_interval(folder: Path, tmp_path, capsys) -> None:
    said(capsys, "report", folder / "before.nc", "-o", tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text().partition("<iframe")[0]
    assert f"before: {WORDS}." in text
    assert no_interval(text)
    assert "Where the uncertainty comes from" not in text


ENDINGS = ("ply", "laz", "e57", "csv", "xyz", "nc")


@pytest.mark.parametrize(
    "rows",
    [
        pytest.param([], id="whole"),
        pytest.param(["--tile-rows", "2"], id="by rows", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("ending", ENDINGS)
def test_clouds_state_no_interval(
    folder: Path, tmp_path, capsys, ending: str, rows
) -> None:
    path = tmp_path / f"cloud.{ending}"
    text = said(capsys, "export", folder / "before.nc", "-o", path, *rows)
    count = int(np.isfinite(io.read_cube(folder / "before.nc")["slant_range"]).sum())
    assert f"{count} points, {count} of them doubtful: {WORDS}" in text
    if ending == "nc":
        cloud = io.read_cube(path)
        assert cloud.attrs["error_unknown"] == WORDS
        for name in ("slant_range_uncertainty", "x_uncertainty", "z_uncertainty"):
            assert np.isnan(cloud[name].values).all()
    elif ending == "laz":
        points = laspy.read(path)
        assert np.asarray(points.withheld).all()
        for name in ("slant_range_uncertainty", "sigma_x", "sigma_z"):
            assert np.isnan(points[name]).all()
        assert WORDS in points.evlrs[0].record_data.decode()
    elif ending == "e57":
        with pye57.E57(str(path)) as file:
            header = file.get_header(0)
            assert WORDS in header["description"].value()
            states = file.read_scan_raw(0)["cartesianInvalidState"]
        assert (states[states != 2] == 1).all()
    else:
        head = path.read_bytes().decode("ascii", "replace")
        assert f"uncertainty: {WORDS}" in head
        assert "GUM" not in head
    if ending in ("csv", "xyz"):
        lines = path.read_text().splitlines()
        columns = next(one for one in lines if "sigma_range" in one).lstrip("# ")
        mark = "," if ending == "csv" else " "
        place = [n for n, c in enumerate(columns.split(mark)) if "sigma" in c]
        assert {lines[-1].split(mark)[n] for n in place} == {"nan"}


PRODUCTS = {
    "sheet.pdf": [],
    "picture.png": [],
    "heights.tif": [],
    "lines.dxf": ["--contours", "3 mm"],
    "cut.svg": ["--line=-4cm,0m,4cm,0m"],
    "cut.csv": ["--line=-4cm,0m,4cm,0m"],
    "mesh.ply": ["--product", "mesh"],
}


@pytest.mark.parametrize("name", PRODUCTS)
def test_drawings_and_meshes_state_no_interval(
    folder: Path, tmp_path, capsys, name: str
) -> None:
    path = tmp_path / name
    text = said(capsys, "export", folder / "before.nc", "-o", path, *PRODUCTS[name])
    assert "nan" not in text
    content = path.read_bytes()
    assert b"95 of 100" not in content
    if name not in ("sheet.pdf", "picture.png"):  # whose text is drawn or packed
        assert WORDS.encode() in content.replace(b"W", b"w")


def test_statements_of_a_drawing_state_no_interval(image: xr.Dataset) -> None:
    statements = " | ".join(statements_of(image, imaging.frame_of(image)))
    assert "Water not removed: error unknown, expect centimeters" in statements
    assert "GUM" not in statements
    assert "nan" not in statements


def test_an_orthoimage_of_an_unknown_uncertainty_is_refused(
    folder: Path, tmp_path, capsys
) -> None:
    command = ["export", str(folder / "before.nc"), "-o", str(tmp_path / "one.png")]
    assert main([*command, "--show", "uncertainty"]) == 1
    assert "the uncertainty of no cell is known" in capsys.readouterr().err


def test_the_page_states_no_interval(image: xr.Dataset) -> None:
    shown = page.recording_of(image, name="before")
    described = shown.describe()
    names = {layer["name"] for layer in described["layers"]}
    assert not {name for name in names if name.startswith(("uncert", "common", "term"))}
    assert described["error_unknown"] == WORDS
    assert described["notes"][0] == f"{WORDS.capitalize()}."
    request = {"kind": "distance", "pixels": [[2, 2], [2, 9]]}
    found = measured(shown, request)
    assert found["lines"][0]["uncertainty"] is None
    assert found["error_unknown"] == WORDS
    area = {"kind": "area", "pixels": [[1, 2], [4, 2], [4, 9], [1, 9]]}
    assert measured(shown, area)["lines"][0]["uncertainty"] is None
    mask = np.zeros(image["slant_range"].shape, dtype=bool)
    mask[1:4, 1:4] = True
    fit = measure.plane(image, mask)
    assert np.isfinite(fit.values["offset"])
    assert np.isnan(fit.uncertainties["offset"])


def test_a_cloud_on_the_page_states_no_interval(image: xr.Dataset, tmp_path) -> None:
    from amulor.view.page.space import opened

    cloud = imaging.point_cloud(image)
    for ending in ("ply", "nc"):
        path = tmp_path / f"cloud.{ending}"
        io.write_cube(cloud, path) if ending == "nc" else io.write_cloud(cloud, path)
        shown = opened(path).describe()
        names = {layer["name"] for layer in shown["layers"]}
        assert not {"uncertainty", "sigma_x", "common"} & names
        assert any(WORDS in line for line in shown["notes"])


def test_an_archive_states_no_interval(folder: Path, tmp_path, capsys) -> None:
    text = project_text({"one": ("before.nc", '["raw.nc"]', "")}, name="Tank")
    (tmp_path / "project.toml").write_text(text)
    for name in ("raw.nc", "before.nc"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    said(capsys, "archive", tmp_path / "project.toml", "-o", tmp_path / "made")
    with (tmp_path / "made/metadata/scans.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["standard uncertainty of range, median [m]"] == WORDS
    assert row["part that all points share, median [m]"] == "not known"
    assert row["doubtful points"] == row["points"]


def test_a_site_refuses_such_a_scan(folder: Path, image: xr.Dataset) -> None:
    with pytest.raises(CubeError, match=WORDS):
        as_image(image, processing=None, name="one")
    stated = Processing(method="open-water", polarization="VV")
    with pytest.raises(CubeError, match=WORDS):
        as_image(io.read_cube(folder / "raw.nc"), processing=stated, name="one")


def test_check_distances_are_undecided(image: xr.Dataset) -> None:
    check = measure.Check(name="bar", first=(2, 2), second=(2, 9), expected="50 mm")
    found = measure.compared(image, check)
    assert np.isnan(found.expanded)
    assert found.verdict == "undecided"


def test_steps_have_a_height_without_an_uncertainty(image: xr.Dataset) -> None:
    label = np.zeros(image["slant_range"].shape, dtype=int)
    label[:, 1:5], label[:, 7:11] = 1, 2
    (step,) = imaging.metrics.step_heights(image, label)
    assert np.isfinite(step.height)
    assert step.random > 0
    assert np.isnan(step.uncertainty)


def test_the_corrected_image_states_its_interval(plate: Survey, tmp_path) -> None:
    target = rejection.open_water(simulate(plate, rng=1))
    image = imaging.range_image(target, polarization="VV")
    assert cubes.error_unknown(image) == ""
    budget = imaging.error_budget(image)
    off = (image["slant_range"] - image["truth_slant_range"]).values
    assert np.mean(np.abs(off) < 2 * image["slant_range_uncertainty"].values) > 0.9
    assert budget.expanded > 0
