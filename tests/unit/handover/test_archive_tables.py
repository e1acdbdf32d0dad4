"""The tables of an archive state what its scans, files and project are."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr
from project_files import project_text

from amulor import io
from amulor.errors import CubeError, FormatError, SurveyError
from amulor.handover.archive import read_project, read_title_fields, write_archive
from amulor.handover.archive import write as writing
from amulor.handover.archive.project import ScanFiles

pytest.importorskip("pye57")

PLACE = 'position = ["10 m", "20 m", "-5 m"]\ncrs = "EPSG:32632"'
POSE = f'{PLACE}\ncrs_offset = ["5e5 m", "4.9e6 m", "0 m"]'
HISTORY = "2026-05-01T10:00:00Z amulor: acquire\n2026-05-02T10:00:00Z amulor:  image"


def wall(size: int, **errors: float) -> xr.Dataset:
    """Return a wall 1.5 m ahead with as many rows as columns, over 0.12 m."""
    return scenes.plane((0.0, 0.0, 1.0), 1.5, rows=size, columns=size, **errors)


def table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def fields(path: Path) -> dict[str, str]:
    """Return the values of a table of fields."""
    return {row["field"]: row["value"] for row in table(path)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two scans and their project."""
    folder = tmp_path_factory.mktemp("scans")
    first = wall(5, own=2e-4, shared=1e-4)
    first["quality_flag"].values[1, 2:4] = [64, 512]
    io.write_cube(first, folder / "first.nc")
    second = wall(9, own=3e-4).assign_attrs(
        history=HISTORY, simulated=1, polarization="VH",
        modulation_frequencies=np.array([39e6, 40.5e6]),
    )  # fmt: skip
    second["slant_range"].values[0, :3] = np.nan
    second["quality_flag"].values[0, :3] = 4
    io.write_cube(second, folder / "second.nc")
    for name in ("raw.nc", "raw.txt", "raw.bin"):
        (folder / name).write_bytes(name.encode())
    text = project_text(
        {
            "a": ("first.nc", '["raw.nc", "raw.bin"]', POSE),
            "b": ("second.nc", '["raw.txt"]', f'heading = "90 deg"\n{POSE}'),
        },
        rms_error="1.25 mm",
        author="C. Drawer",
        notes="a  note",
    )
    text = text.replace("points = 4", 'points = 4\nsoftware = "other"\nnotes = "r"')
    text = text.replace('image = "second.nc"', 'image = "second.nc"\nmaterial = "oak"')
    text = text.replace('image = "first.nc"', 'image = "first.nc"\nnotes = "low"')
    (folder / "project.toml").write_text(text)
    return folder


@pytest.fixture(scope="module")
def archive(folder: Path) -> tuple[Path, dict[str, int]]:
    """Return an archive and its counts."""
    project = read_project(folder / "project.toml")
    counts = write_archive(project, folder / "archive")
    return folder / "archive", counts


def test_counts_of_an_archive_are_those_of_its_files(archive) -> None:
    """Two scans of 25 and 78 points; the manifest is a file, too."""
    folder, counts = archive
    files = [path for path in folder.rglob("*") if path.is_file()]
    assert counts == {"scans": 2, "points": 25 + 81 - 3, "files": len(files)}
    # 1 README, 4 tables, 1 manifest; 3 clouds, matrix and image of each scan; 3 raw.
    assert len(files) == 6 + 2 * 5 + 3


def test_the_row_of_a_scan_states_its_files_and_errors(archive) -> None:
    """All fields of both scans, one of them without history and survey."""
    first, second = table(archive[0] / "metadata" / "scans.csv")
    # 0.12 m in 4 and 8 steps.
    for row, spacing in ((first, 0.03), (second, 0.015)):
        assert float(row.pop("point spacing [m]")) == pytest.approx(spacing, rel=2e-3)
    unknown = "position of the pose, heading of the pose, level of the pose"
    assert first == {
        "scan": "a",
        "raw files": "raw/a/raw.nc; raw/a/raw.bin",
        "registered cloud":
            "registered/Ladder_a.xyz; registered/Ladder_a.laz; registered/Ladder_a.e57",
        "matrix": "registration/Ladder_GRmatrices_a.txt",
        "matrix applied to registered cloud": "yes",
        "date": "not known",
        "rows": "5", "columns": "5", "points": "25", "doubtful points": "2",
        "wavelength [m]": "not known",
        "modulation frequencies [Hz]": "39000000",
        "polarization": "none",
        "group index": "1.38",
        "standard uncertainty of range, median [m]": "0.0002236",
        "part that all points share, median [m]": "0.0001",
        "uncertainties not known": unknown,
        "history": "none",
        "trajectory": "", "material": "", "simulated": "no", "notes": "low",
    }  # fmt: skip
    assert second == first | {
        "scan": "b",
        "raw files": "raw/b/raw.txt",
        "registered cloud": first["registered cloud"].replace("_a.", "_b."),
        "matrix": "registration/Ladder_GRmatrices_b.txt",
        "date": "2026-05-01",
        "rows": "9", "columns": "9", "points": "78", "doubtful points": "0",
        "modulation frequencies [Hz]": "39000000 40500000",
        "polarization": "VH",
        "standard uncertainty of range, median [m]": "0.0003",
        "part that all points share, median [m]": "0",
        # Spaces and line breaks are single spaces in a table.
        "history": "2026-05-01T10:00:00Z amulor: acquire | "
        "2026-05-02T10:00:00Z amulor: image",
        "material": "oak", "simulated": "yes", "notes": "",
    }  # fmt: skip


def test_the_table_of_the_project_has_its_texts_and_totals(archive) -> None:
    """The point spacing is that of the finest scan."""
    found = fields(archive[0] / "metadata" / "project.csv")
    assert float(found.pop("point spacing [m]")) == pytest.approx(0.015, rel=2e-3)
    assert found.pop("software").startswith("amulor ")
    assert found == {
        "project name": "Ladder",
        "title": "Ladder of the demo",
        "monument and number": "Ladder, no. 12",
        "place": "Tank 3, 52.1 N 4.3 E",
        "first day of survey": "2026-05-01",
        "last day of survey": "2026-05-02",
        "survey conditions": "0.5 m deep, visibility 6 m, 12 degC, dark",
        "scanner make and model": "amulor bench, model 1",
        "scanner serial number": "B-001",
        "operator": "A. Diver, Institute",
        "control data": "none",
        "purpose": "test",
        "copyright and licence": "CC BY 4.0, Institute",
        "number of scans": "2",
        "total number of points": "103",
        "find number": "",
        "author": "C. Drawer",
        "institution": "",
        "notes": "a note",
    }


def test_the_table_of_the_registration_states_frame_and_error(archive) -> None:
    """The reference system of the poses makes the clouds georeferenced."""
    assert fields(archive[0] / "metadata" / "registration.csv") == {
        "method": "targets",
        "georeferenced": "yes",
        "reference system": "EPSG:32632",
        "number of scans": "2",
        "control points": "4",
        "global RMS error [m]": "0.00125",
        "frame of registered clouds":
            "right-handed: x east, y north, z up, in the local frame of the pose [m]",
        "add to coordinates [m]": "500000, 4900000, 0",
        "software": "other",
        "notes": "r",
    }  # fmt: skip


def test_the_list_of_files_has_the_format_of_each(archive) -> None:
    """The list is written before itself and the manifest."""
    folder = archive[0]
    rows = {row["file"]: row for row in table(folder / "metadata" / "files.csv")}
    found = {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file()
    }
    assert set(rows) == found - {"metadata/files.csv", "manifest-sha256.txt"}
    assert list(rows) == sorted(rows)
    for name, row in rows.items():
        assert int(row["bytes"]) == (folder / name).stat().st_size
    kinds = {name: (row["format"], row["what it is"]) for name, row in rows.items()}
    points = "points in the frame of the project"
    expected = {
        "README.txt": ("text, UTF-8", "what this folder is"),
        "raw/a/raw.nc": ("netCDF 4 (CF)", "recorded data"),
        "raw/a/raw.bin": ("binary", "recorded data"),
        "processed/Ladder_a.nc": (
            "netCDF 4 (CF)", "range image made of recorded data"
        ),
        "registered/Ladder_a.xyz": ("text, space-separated, UTF-8", points),
        "registered/Ladder_a.laz": ("LAZ 1.4", points),
        "registered/Ladder_a.e57": ("ASTM E57", points),
        "registration/Ladder_GRmatrices_a.txt": (
            "text, UTF-8", "transformation of a scan"
        ),
        "metadata/scans.csv": (
            "text, comma-separated, UTF-8",
            "table on project, scans, registration or files",
        ),
    }  # fmt: skip
    assert {name: kinds[name] for name in expected} == expected


def test_the_first_lines_of_an_archive_are_title_place_and_days(archive) -> None:
    """Each scan has a line with its number of points."""
    lines = (archive[0] / "README.txt").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "Ladder of the demo"
    assert lines[1] == (
        "Ladder, no. 12; Tank 3, 52.1 N 4.3 E; 2026-05-01 to 2026-05-02"
    )
    assert lines[6:8] == ["  a: 25 points", "  b: 78 points"]
    assert lines[-1] == "CC BY 4.0, Institute"


def test_matrices_have_12_decimals(archive) -> None:
    """Seen to the east, forward is x, right is minus y, down is minus z."""
    path = archive[0] / "registration" / "Ladder_GRmatrices_b.txt"
    expected = [[0, 0, 1, 10], [-1, 0, 0, 20], [0, -1, 0, -5], [0, 0, 0, 1]]
    np.testing.assert_allclose(np.loadtxt(path), expected, atol=1e-12)
    assert path.read_text().split()[3] == "10.000000000000"


def project_of(folder: Path, old: str, new: str) -> Path:
    """Return the file of a project with a text replaced."""
    text = (folder / "project.toml").read_text()
    assert old in text
    path = folder / "other.toml"
    path.write_text(text.replace(old, new, 1))
    return path


def test_the_poses_of_an_archive_are_in_one_reference_system(folder) -> None:
    """Another offset of the second scan is refused, whatever the system is."""
    old = 'heading = "90 deg"\n' + POSE
    project = read_project(project_of(folder, old, old.replace('"0 m"', '"1 m"')))
    with pytest.raises(CubeError, match="scan b: its pose is in another reference"):
        writing._frames(project)
    project = read_project(project_of(folder, old, old.replace("32632", "32633")))
    with pytest.raises(CubeError, match="than that of a; state all poses in one"):
        writing._frames(project)


def test_several_scans_need_poses(folder) -> None:
    """The first scan without a pose is named."""
    project = read_project(project_of(folder, f"[scans.pose]\n{POSE}\n", ""))
    with pytest.raises(CubeError, match="scan a: neither the project nor its survey"):
        writing._frames(project)


def test_an_archive_has_a_folder_to_lie_in(folder, tmp_path) -> None:
    """Nothing is made for a name in a folder that is missing."""
    project = read_project(folder / "project.toml")
    with pytest.raises(FormatError, match=r"there is no folder .*no; make it first$"):
        write_archive(project, tmp_path / "no" / "archive")
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    with pytest.raises(FormatError, match="link exists already; choose another name"):
        write_archive(project, tmp_path / "link")
    assert [path.name for path in tmp_path.iterdir()] == ["link"]


def test_raw_files_of_one_name_are_refused(tmp_path) -> None:
    """Folders are copied with all of their files but the lock of a writer."""
    hidden = tmp_path / "hidden"
    (hidden / "raw").mkdir(parents=True)
    run = tmp_path / "run"
    (run / "deep").mkdir(parents=True)
    for name in ("journal", "writer.lock", "deep/more"):
        (run / name).write_text(name)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "run").write_text("file")
    scan = ScanFiles(name="s", image=run, raw=(run,))
    assert writing._copy_raw(scan, hidden) == ["raw/s/run"]
    copied = {path.name for path in (hidden / "raw" / "s" / "run").rglob("*")}
    assert copied == {"journal", "deep", "more"}
    twice = ScanFiles(name="t", image=run, raw=(run, tmp_path / "other" / "run"))
    message = "^scan t: two raw files are called run; rename one$"
    with pytest.raises(SurveyError, match=message):
        writing._copy_raw(twice, hidden)


@pytest.mark.parametrize(
    ("history", "day"),
    [
        ("2026-05-01T10:00:00Z amulor: acquire\n2026-06-01 later", "2026-05-01"),
        ("amulor 1.0: acquire", "not known"),
        ("202X-05-01", "not known"),
        ("", "not known"),
    ],
)
def test_the_day_of_a_scan_is_that_of_its_first_step(history: str, day: str) -> None:
    """Histories of other programs may begin with other words."""
    assert writing._day(xr.Dataset(attrs={"history": history})) == day


def test_a_table_has_the_listed_fields_first(tmp_path) -> None:
    """Fields that are not listed come behind; an empty table has its first line."""
    path = tmp_path / "t.csv"
    writing._table(path, ("b", "a"), [{"a": "1\n 2", "b": "3", "c": "4"}])
    assert path.read_text() == "b,a,c\n3,1 2,4\n"
    writing._table(path, ("b", "a"), [])
    assert path.read_text() == "b,a\n"


def test_title_blocks_have_the_texts_of_the_project(folder) -> None:
    """Equal days are one; without an author the operator draws."""
    found = read_title_fields(folder / "project.toml")
    assert found == {
        "project": "Ladder of the demo",
        "object": "Ladder, no. 12",
        "find number": "",
        "author": "C. Drawer",
        "institution": "",
        "date": "2026-05-01 to 2026-05-02",
    }
    path = project_of(folder, 'author = "C. Drawer"\n', "")
    text = path.read_text().replace("last_day = 2026-05-02", "last_day = 2026-05-01")
    path.write_text(text)
    assert read_title_fields(path) == found | {
        "author": "A. Diver, Institute", "date": "2026-05-01",
    }  # fmt: skip


def test_files_of_a_project_lie_beside_it(folder) -> None:
    """Paths begin at the project file; each missing file has a line."""
    project = read_project(folder / "project.toml")
    assert project.scans[0].image == folder / "first.nc"
    assert project.scans[0].raw == (folder / "raw.nc", folder / "raw.bin")
    assert project.scans[1].raw == (folder / "raw.txt",)
    assert project.scans[1].trajectory is None
    text = project_text({"a": ("run", '["no", "raw.nc", "run"]', "")})
    path = folder / "missing.toml"
    path.write_text(text + 'trajectory = "run"\nmounting = "m.toml"\n')
    (folder / "run").mkdir(exist_ok=True)
    with pytest.raises(SurveyError) as refused:
        read_project(path)
    # A folder is raw data of a scan, but no image and no trajectory.
    assert str(refused.value).splitlines() == [
        f"{path}: scans[0].{field}: {folder / file} does not exist; check the name"
        for field, file in (
            ("image", "run"), ("raw[0]", "no"), ("trajectory", "run"),
            ("mounting", "m.toml"),
        )
    ]  # fmt: skip
    text = project_text({"a": ("first.nc", '["raw.nc"]', "")})
    path.write_text(text + 'trajectory = "raw.txt"\nmounting = "raw.bin"\n')
    (scan,) = read_project(path).scans
    assert scan.trajectory == folder / "raw.txt"
    assert scan.mounting == folder / "raw.bin"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"trajectory": "t.csv", "pose": {"heading": "1 deg"}},
         "pose and trajectory are both stated; state one"),
        ({"mounting": "m.toml"}, "mounting needs trajectory, the poses of the vehicle"),
    ],
)  # fmt: skip
def test_a_scan_has_one_kind_of_pose(changes: dict[str, Any], message: str) -> None:
    """A mounting is that of an instrument on a vehicle."""
    stated = {"name": "a", "image": "a.nc", "raw": ["b.nc"]}
    ScanFiles.model_validate(stated)
    ScanFiles.model_validate(stated | {"trajectory": "t.csv", "mounting": "m.toml"})
    with pytest.raises(ValueError, match=message):
        ScanFiles.model_validate(stated | changes)
