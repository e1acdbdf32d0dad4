"""An archive is whole or not there, and its checker names what is taken away."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
from pathlib import Path

import exact_scenes as scenes
import laspy
import numpy as np
import pytest
from project_files import project_text

from amulor import io
from amulor.cli import main
from amulor.handover.archive import missing_of
from amulor.io.trajectories import write_trajectory
from amulor.platform import Trajectory

pye57 = pytest.importorskip("pye57")

PLACE = 'position = ["10 m", "20 m", "-5 m"]'
PROJECT = project_text(
    {
        "scan1": ("one.nc", '["raw_one.nc", "run"]', PLACE),
        "scan2": ("two.nc", '["raw_two.nc"]', f'heading = "90 deg"\n{PLACE}'),
    },
    rms_error="1.5 mm",
)


@pytest.fixture(scope="module")
def source(tmp_path_factory, plate_text) -> Path:
    """Return a folder with two scans and the description of their project."""
    folder = tmp_path_factory.mktemp("source")
    for name, seed in (("one", 1), ("two", 2)):
        rng = np.random.default_rng(seed)
        image = scenes.drawn(scenes.ladder(rows=8, columns=30, own=2e-4), rng, 2e-4)
        image["quality_flag"].values[2, 3] |= 64
        io.write_cube(
            image.assign_attrs(
                survey=plate_text, history="2026-05-01T10:00:00Z amulor: acquire"
            ),
            folder / f"{name}.nc",
        )
        (folder / f"raw_{name}.nc").write_bytes(rng.bytes(1000))
    (folder / "run").mkdir()
    (folder / "run" / "journal.sqlite").write_bytes(b"SQLite format 3\0")
    (folder / "run" / "writer.lock").write_bytes(b"")
    (folder / "project.toml").write_text(PROJECT)
    return folder


@pytest.fixture(scope="module")
def made(source, tmp_path_factory) -> tuple[Path, list[tuple[str, float]]]:
    """Return an archive, and the steps that its making reported."""
    folder = tmp_path_factory.mktemp("archives") / "Ladder"
    steps: list[tuple[str, float]] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "amulor.handover.archive.write.tell",
            lambda step, share: steps.append((step, share)),
        )
        assert main(["archive", str(source / "project.toml"), "-o", str(folder)]) == 0
    return folder, steps


@pytest.fixture(scope="module")
def whole(made) -> Path:
    return made[0]


def test_each_step_of_an_archive_is_reported(made) -> None:
    assert made[1] == [
        ("reading", 0.0),
        ("copying scan1", 0.0),
        ("clouds of scan1", pytest.approx(0.135)),
        ("copying scan2", pytest.approx(0.45)),
        ("clouds of scan2", pytest.approx(0.585)),
        ("checksums", 0.9),
    ]


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_raw_data_are_there_bit_by_bit(source, whole) -> None:
    for scan, name in (("scan1", "raw_one.nc"), ("scan2", "raw_two.nc")):
        found = whole / "raw" / scan / name
        assert found.read_bytes() == (source / name).read_bytes()
    run = whole / "raw" / "scan1" / "run"
    assert [path.name for path in run.iterdir()] == ["journal.sqlite"]


def test_clouds_of_all_formats_are_the_same_points_in_one_frame(whole) -> None:
    stem = whole / "registered" / "Ladder_scan2"
    text = np.loadtxt(f"{stem}.xyz")[:, :3]
    laz = laspy.read(f"{stem}.laz")
    np.testing.assert_allclose(laz.xyz, text, atol=1.1e-6)
    with pye57.E57(f"{stem}.e57") as file:
        e57 = file.read_scan(0, transform=True)
    # Seen to the east from (10, 20, -5), the treads stand 1.43 to 1.5 m east of it.
    assert e57["cartesianX"].min() == pytest.approx(11.43, abs=2e-3)
    assert text[:, 0].max() == pytest.approx(11.5, abs=2e-3)
    first = np.loadtxt(whole / "registered" / "Ladder_scan1.xyz")
    # Without a heading, forward is north.
    assert first[:, 1].max() == pytest.approx(21.5, abs=2e-3)


def test_matrices_turn_the_instruments_axes_into_the_clouds(source, whole) -> None:
    matrix = np.loadtxt(whole / "registration" / "Ladder_GRmatrices_scan2.txt")
    # Looking east: forward is x, right is minus y, down is minus z.
    np.testing.assert_allclose(matrix @ [0, 0, 1.5, 1], [11.5, 20, -5, 1], atol=1e-9)
    np.testing.assert_allclose(matrix @ [1, 0, 0, 1], [10, 19, -5, 1], atol=1e-9)


def test_metadata_say_what_the_guides_ask_for(whole) -> None:
    project = {r["field"]: r["value"] for r in table(whole / "metadata/project.csv")}
    assert project["scanner serial number"] == "B-001"
    assert project["first day of survey"] == "2026-05-01"
    assert project["number of scans"] == "2"
    scans = table(whole / "metadata/scans.csv")
    assert [row["scan"] for row in scans] == ["scan1", "scan2"]
    count = len(np.loadtxt(whole / "registered/Ladder_scan1.xyz"))
    assert int(scans[0]["points"]) == count
    assert scans[0]["date"] == "2026-05-01"
    assert scans[0]["doubtful points"] == "1"
    assert float(scans[0]["wavelength [m]"]) == 405e-9
    # Own noise of 0.2 mm, and nothing shared.
    assert float(scans[0]["standard uncertainty of range, median [m]"]) == 2e-4
    assert "heading of the pose" in scans[1]["uncertainties not known"]
    registration = {
        r["field"]: r["value"] for r in table(whole / "metadata/registration.csv")
    }
    assert float(registration["global RMS error [m]"]) == 1.5e-3
    assert registration["georeferenced"] == "no"


def test_checksums_are_those_of_another_program(whole) -> None:
    if shutil.which("sha256sum") is None:
        pytest.skip("no sha256sum")
    done = subprocess.run(
        ["sha256sum", "--check", "--quiet", "manifest-sha256.txt"],
        cwd=whole,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, "")


def test_a_whole_archive_passes(whole, capsys) -> None:
    assert missing_of(whole) == []
    assert main(["archive", "--check", str(whole)]) == 0
    assert "complete" in capsys.readouterr().out


def edited(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("harm", "line"),
    [
        (lambda f: (f / "README.txt").unlink(), "README.txt is missing"),
        (
            lambda f: (f / "metadata/scans.csv").unlink(),
            "metadata/scans.csv is missing",
        ),
        (
            lambda f: edited(f / "metadata/project.csv", "B-001", ""),
            "the field 'scanner serial number' is empty",
        ),
        (
            lambda f: edited(f / "metadata/project.csv", "operator,", "someone,"),
            "the field 'operator' is missing",
        ),
        (
            lambda f: (f / "registration/Ladder_GRmatrices_scan1.txt").unlink(),
            "scan scan1: its matrix",
        ),
        (
            lambda f: np.savetxt(
                f / "registration/Ladder_GRmatrices_scan1.txt", np.diag([2, 1, 1, 1])
            ),
            "scales, mirrors or shears",
        ),
        (lambda f: (f / "raw/scan2/raw_two.nc").unlink(), "scan scan2: raw raw/scan2"),
        (
            lambda f: (f / "registered/Ladder_scan2.e57").unlink(),
            "scan scan2: registered cloud registered/Ladder_scan2.e57 is not in",
        ),
        (
            lambda f: (f / "registered/Ladder_scan2.laz").write_bytes(b"no"),
            "Ladder_scan2.laz is no LAZ file",
        ),
        (
            lambda f: edited(f / "registered/Ladder_scan1.xyz", "\n10.", "\n# 10."),
            "points, metadata/scans.csv says",
        ),
        (
            lambda f: (f / "raw/scan1/raw_one.nc").write_bytes(b"other"),
            "raw/scan1/raw_one.nc is damaged or changed",
        ),
        (lambda f: (f / "more.txt").write_text("x"), "more.txt has no checksum"),
        (lambda f: (f / "a name.txt").write_text("x"), "not portable"),
        (
            lambda f: (f / "manifest-sha256.txt").unlink(),
            "manifest-sha256.txt is missing",
        ),
        (
            lambda f: edited(f / "metadata/scans.csv", "raw/scan1/", "../scan1/"),
            "is not in the archive",
        ),
    ],
)
def test_what_is_taken_away_is_named(whole, tmp_path, harm, line, capsys) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(whole, folder)
    harm(folder)
    assert any(line in found for found in missing_of(folder))
    assert main(["archive", "--check", str(folder)]) == 1
    message = capsys.readouterr().err
    assert all(text.startswith("amulor: ") for text in message.splitlines())
    assert line in message


def test_the_result_of_a_check_can_be_read_by_programs(whole, tmp_path, capsys) -> None:
    assert main(["archive", "--check", str(whole), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["complete"] is True
    folder = tmp_path / "copy"
    shutil.copytree(whole, folder)
    (folder / "README.txt").unlink()
    assert main(["archive", "--check", str(folder), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["complete"] is False
    assert any("README" in line for line in found["missing"])


def test_a_folder_that_is_there_is_kept(source, whole, capsys) -> None:
    before = sorted(path.name for path in whole.iterdir())
    assert main(["archive", str(source / "project.toml"), "-o", str(whole)]) == 1
    assert "exists already" in capsys.readouterr().err
    assert sorted(path.name for path in whole.iterdir()) == before
    assert [path.name for path in whole.parent.iterdir()] == ["Ladder"]


@pytest.mark.parametrize("step", ["cloud", "interrupt", "matrix"])
def test_nothing_is_left_after_a_failure(source, tmp_path, monkeypatch, step) -> None:
    def fail(*_: object, **__: object) -> None:
        if step == "interrupt":
            raise KeyboardInterrupt
        raise OSError(28, "No space left on device")

    name = "numpy.savetxt" if step == "matrix" else "amulor.io.write_cloud"
    monkeypatch.setattr(name, fail)
    out = tmp_path / "archive"
    code = main(["archive", str(source / "project.toml"), "-o", str(out)])
    assert code == (130 if step == "interrupt" else 1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('rms_error = "1.5 mm"\n', "", "rms_error is missing"),
        ('serial_number = "B-001"\n', "", "serial_number"),
        ('name = "scan2"', 'name = "Scan1"', "the same name"),
        ('image = "two.nc"', 'image = "none.nc"', "scans[1].image"),
        ('raw = ["raw_two.nc"]', 'raw = ["gone.nc"]', "scans[1].raw[0]"),
        ('name = "Ladder"', 'name = "La dder/.."', "name"),
        ("last_day = 2026-05-02", "last_day = 2026-04-02", "lies before first_day"),
        ('image = "one.nc"', 'image = "raw_one.nc"', "raw_one.nc"),
        ("[scans.pose]\nheading", "[scans.other]\nheading", "scans.1.other"),
        (
            '[scans.pose]\nheading = "90 deg"\nposition = ["10 m", "20 m", "-5 m"]\n',
            "",
            "scan scan2: neither the project nor its survey states its pose",
        ),
        (
            'heading = "90 deg"',
            'heading = "90 deg"\ncrs = "EPSG:32632"',
            "another reference system",
        ),
    ],
)
def test_a_description_that_lacks_something_is_one_line(
    source, tmp_path, old, new, text, capsys
) -> None:
    assert old in PROJECT
    path = source / "other.toml"
    path.write_text(PROJECT.replace(old, new))
    assert main(["archive", str(path), "-o", str(tmp_path / "archive")]) == 1
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert text in message
    assert list(tmp_path.iterdir()) == []


def test_a_single_scan_needs_no_pose_and_has_z_up(source, tmp_path) -> None:
    path = source / "single.toml"
    path.write_text(
        PROJECT.split("[[scans]]")[0].replace('rms_error = "1.5 mm"\n', "")
        + '[[scans]]\nname = "only"\nimage = "one.nc"\nraw = ["raw_one.nc"]\n'
    )
    folder = tmp_path / "single"
    assert main(["archive", str(path), "-o", str(folder)]) == 0
    points = np.loadtxt(folder / "registered" / "Ladder_only.xyz")
    assert points[:, 1].max() == pytest.approx(1.5, abs=2e-3)
    registration = (folder / "metadata" / "registration.csv").read_text()
    assert "global RMS error [m],single scan" in registration


def test_a_scan_from_a_vehicle_is_archived_with_its_trajectory(
    source, tmp_path, capsys
) -> None:
    """A vehicle at 0.1 m/s to the east."""
    image = io.read_cube(source / "one.nc")
    time = np.linspace(0.0, 24.0, image["slant_range"].size)
    time = time.reshape(image["slant_range"].shape)
    image = image.assign_coords(time=(("row", "column"), time, {"units": "s"}))
    image["time"].attrs["long_name"] = "time since the start of the scan"
    io.write_cube(image, tmp_path / "one.nc")
    (tmp_path / "raw_one.nc").write_bytes(b"raw")
    stamps = np.arange(-5.0, 30.0)
    track = Trajectory.of_angles(
        time=stamps,
        position=stamps[:, None] * [0.1, 0.0, 0.0] + [10.0, 20.0, -5.0],
        heading=0.0,
    )
    write_trajectory(track, tmp_path / "track.csv")
    arm = 'lever_arm = ["0 m", "0 m", "1 m"]'
    (tmp_path / "rov.toml").write_text(f"[mounting]\n{arm}\n")
    text = project_text({"scan1": ("one.nc", '["raw_one.nc"]', "")})
    moved = 'trajectory = "track.csv"\nmounting = "rov.toml"\n'
    (tmp_path / "project.toml").write_text(text + moved)
    folder = tmp_path / "Moved"
    assert main(["archive", str(tmp_path / "project.toml"), "-o", str(folder)]) == 0
    assert main(["archive", "--check", str(folder)]) == 0
    (row,) = table(folder / "metadata" / "scans.csv")
    copied = (folder / row["trajectory"]).read_bytes()
    assert copied == (tmp_path / "track.csv").read_bytes()
    assert row["matrix applied to registered cloud"].startswith("no")
    matrix = np.loadtxt(folder / row["matrix"])
    # Half way, one metre north of the vehicle's reference point.
    np.testing.assert_allclose(matrix[:3, 3], [11.2, 21.0, -5.0], atol=0.02)
    (folder / row["trajectory"]).unlink()
    assert main(["archive", "--check", str(folder)]) == 1
    assert "its trajectory" in capsys.readouterr().err
