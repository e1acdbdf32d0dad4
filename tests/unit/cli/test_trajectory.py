"""`amulor import trajectory` and clouds of a moving scan, as a user calls them."""

import json
from pathlib import Path

import laspy
import numpy as np
import pytest

from amulor import imaging, io, rejection, samples
from amulor.cli import main

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "examples" / "vehicle"
MAP = ("--columns", str(EXAMPLE / "columns.toml"))


@pytest.fixture
def log(tmp_path, monkeypatch):
    """The example's log in the folder of the user."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "rov.csv"
    path.write_bytes((EXAMPLE / "rov.csv").read_bytes())
    return path


def _refused(capsys, *words):
    assert main([str(word) for word in words]) in (1, 2)
    return capsys.readouterr().err


def test_the_output_is_that_of_the_page(log, capsys):
    main(["import", "trajectory", "rov.csv", *MAP, "-o", "track.csv"])
    page = (ROOT / "docs/how-to/vehicle.md").read_text()
    for line in capsys.readouterr().out.splitlines():
        assert line in page
    assert Path("track.png").read_bytes()[:4] == b"\x89PNG"


def test_the_summary_as_json(log, capsys):
    main(["import", "trajectory", "rov.csv", *MAP, "-o", "track.csv", "--json"])
    summary = json.loads(capsys.readouterr().out)
    rows = np.loadtxt(log, delimiter=",", skiprows=1)
    assert summary["poses"] == len(rows)
    assert summary["duration_s"] == pytest.approx(np.ptp(rows[:, 0]))
    ((begin, end),) = summary["gaps_s"]
    assert (begin, end) == (59.6, 65.8)
    assert summary["position_uncertainty_m"] == pytest.approx(0.02, rel=0.02)


def test_a_moving_scan_becomes_a_cloud_in_site_axes(log, capsys):
    main(["import", "trajectory", "rov.csv", *MAP, "-o", "track.csv"])
    image = imaging.range_image(rejection.cross_polarized(samples.cube("ladder")))
    image["time"].values[:] = np.linspace(50.0, 70.0, image["time"].size).reshape(
        image["time"].shape
    )
    io.write_cube(image, "range.nc")
    mounting = ("--trajectory", "track.csv", "--mounting", EXAMPLE / "rov.toml")
    main([str(word) for word in ("export", "range.nc", *mounting, "-o", "cloud.csv")])
    said = capsys.readouterr().out
    assert "without a pose left out" in said
    height = np.genfromtxt("cloud.csv", delimiter=",", comments="#")[1:, 2]
    # The instrument is 8.3 m deep and looks down; the ladder is 0.7 to 1.5 m away.
    assert -10.1 < height.min() < height.max() < -8.9
    header = [line for line in Path("cloud.csv").read_text().splitlines()[:40]
              if line.startswith("#")]  # fmt: skip
    assert any("x east, y north, z up" in line for line in header)


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("rov.csv", "-o", "track.csv"), "--columns is missing: a table needs"),
        (("rov.csv", *MAP, "-o", "track.txt"), "--output"),
        (
            ("rov.csv", *MAP, "--topic", "/odom", "-o", "t.csv"),
            "--topic belongs to a bag",
        ),
        (("nowhere.csv", *MAP, "-o", "track.csv"), "nowhere.csv does not exist"),
        (("rov.nmea", "-o", "track.csv"), "--crs is missing"),
        (
            ("rov.nmea", "--crs", "EPSG:32632", "--crs-offset", "1 m", "-o", "t.csv"),
            "--crs-offset '1 m': state three values, lengths",
        ),
    ],
)
def test_wrong_options_are_named(words, part, log, capsys):
    Path("rov.nmea").write_text("$GPHDT,1.0,T*3F\n")
    assert part in _refused(capsys, "import", "trajectory", *words)
    assert not Path("track.csv").exists()


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("--mounting", "rov.csv"), "--mounting needs --trajectory"),
        (("--slim",), "--slim and --line-number need a .laz or .las file"),
        (
            ("--trajectory", "rov.csv", "--mounting", "rov.csv", "--tile-rows", "4"),
            "--trajectory excludes --pose and --tile-rows",
        ),
    ],
)
def test_a_moving_scan_needs_its_trajectory_and_is_read_as_a_whole(
    words, part, log, capsys
):
    image = imaging.range_image(rejection.cross_polarized(samples.cube("ladder")))
    io.write_cube(image, "range.nc")
    assert part in _refused(capsys, "export", "range.nc", *words, "-o", "cloud.ply")
    line = ("--line-number", "3", "-o", "cloud.laz")
    assert "needs --trajectory" in _refused(capsys, "export", "range.nc", *line)


def test_no_mesh_is_made_of_a_moving_scan(log, capsys):
    main(["import", "trajectory", "rov.csv", *MAP, "-o", "track.csv"])
    image = imaging.range_image(rejection.cross_polarized(samples.cube("ladder")))
    io.write_cube(image, "range.nc")
    mounting = ("--trajectory", "track.csv", "--mounting", EXAMPLE / "rov.toml")
    said = _refused(
        capsys, "export", "range.nc", *mounting, "--product", "mesh", "-o", "mesh.ply"
    )
    assert "a scan from a vehicle becomes a cloud, but no mesh" in said
    assert not Path("mesh.ply").exists()


def _run(*words):
    assert not main([*words])


PASS = """
[platform]
readings = "at-once"
[platform.course]
kind = "line"
start = ["3 m", "2 m", "-8 m"]
heading = "40 deg"
speed = "0.2 m/s"
[platform.navigation]
position_uncertainty = "2 cm"
[platform.mounting]
lever_arm = ["0 m", "10 cm", "0 m"]
lever_arm_uncertainty = "1 mm"
boresight_uncertainty = "0.02 deg"
clock_uncertainty = "1 ms"
"""


def test_a_survey_from_a_vehicle_becomes_a_cloud_with_the_mounting_of_the_survey(
    plate, capsys, tmp_path, monkeypatch
):
    """From the survey to points on the plate, ahead of a vehicle that looks at it."""
    monkeypatch.chdir(tmp_path)
    small = plate.with_(
        {
            "scan.columns": 6, "scan.rows": 4, "scan.dwell": "50 ms",
            "pose": {"position": ["3 m", "2 m", "-8 m"], "heading": "40 deg"},
        }
    )  # fmt: skip
    Path("pass.toml").write_text(small.to_toml() + PASS)
    _run("survey", "check", "pass.toml")
    printed = capsys.readouterr().out
    # 0.2 m/s for 6 pixels of 50 ms in a row; the platform reads both channels at once.
    assert "60 mm between rows" in printed
    _run("simulate", "pass.toml", "-o", "samples.nc", "--model", "closure")
    assert "samples.trajectory.csv" in capsys.readouterr().out
    _run("reject", "samples.nc", "--method", "open-water", "-o", "target.nc")
    limits = "--nearest", "0.5 m", "--farthest", "4 m"
    _run("image", "target.nc", "-o", "range.nc", "--polarization", "VH", *limits)
    track = "samples.trajectory.csv"
    _run("export", "range.nc", "--trajectory", track, "-o", "cloud.nc")
    assert "mm of track" in capsys.readouterr().out
    laz = "--line-number", "3", "--slim", "-o", "cloud.laz"
    _run("export", "range.nc", "--trajectory", track, *laz)
    points = laspy.read("cloud.laz")
    assert set(points["point_source_id"]) == {3}
    cloud = io.read_cube("cloud.nc")
    np.testing.assert_allclose(points["gps_time"], cloud["time"], atol=1e-9)
    # 24 pixels of 50 ms; the clock of the vehicle is off by milliseconds.
    assert 1.0 < np.ptp(points["gps_time"]) < 1.2
    # The plate is 1.5 m ahead of the pose, and faces it.
    ahead = (cloud["x"] - 3) * np.sin(np.radians(40))
    ahead = ahead + (cloud["y"] - 2) * np.cos(np.radians(40))
    distance = float(small.targets[0].position[2])
    error = float(np.hypot(cloud["x_uncertainty"], cloud["y_uncertainty"]).max())
    assert abs(float(ahead.mean()) - distance) < 4 * error
    assert error < 0.1
