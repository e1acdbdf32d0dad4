"""The check of an archive reads its files alone, and names each problem in a line."""

from __future__ import annotations

import csv
import hashlib
from pathlib import Path

import numpy as np
import pytest

from amulor.errors import FormatError
from amulor.handover.archive import check, missing_of
from amulor.handover.archive import project as layout


def turned(degrees: float, **changes: float) -> np.ndarray:
    """Return a turn about z and a shift, with some elements changed."""
    angle = np.radians(degrees)
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    matrix[:3, 3] = [10.0, 20.0, -5.0]
    for place, value in changes.items():
        matrix[int(place[1]), int(place[2])] += value
    return matrix


NO_TURN = "the matrix m.txt is no turn and shift: it scales, mirrors or shears"
NOT_FINITE = "the matrix m.txt is not of 4 x 4 finite numbers"


@pytest.mark.parametrize(
    ("matrix", "problems"),
    [
        (turned(0.0), []),
        (turned(30.0), []),
        # An error of some 1e-8 is one of rounding in the file.
        (turned(30.0, m22=1e-8), []),
        (turned(30.0, m22=1e-5), [NO_TURN]),
        (turned(30.0, m01=0.1), [NO_TURN]),
        (np.diag([2.0, 0.5, 1.0, 1.0]), [NO_TURN]),
        # Mirrored once; mirrored twice is a half turn.
        (np.diag([1.0, 1.0, -1.0, 1.0]), [NO_TURN]),
        (np.diag([1.0, -1.0, -1.0, 1.0]), []),
        (turned(30.0, m30=0.1), [NO_TURN]),
        (turned(30.0, m32=0.1), [NO_TURN]),
        (turned(30.0, m33=1.0), [NO_TURN]),
        (turned(30.0)[:3], [NOT_FINITE]),
        (turned(30.0)[:, :3], [NOT_FINITE]),
        (turned(30.0, m03=np.inf), [NOT_FINITE]),
        (turned(30.0, m10=np.nan), [NOT_FINITE]),
    ],
)
def test_a_matrix_of_an_archive_turns_and_shifts(tmp_path, matrix, problems) -> None:
    """Scales, mirrors, shears, and numbers that are not finite are problems."""
    np.savetxt(tmp_path / "m.txt", matrix, fmt="%.12f")
    assert check._matrix(tmp_path / "m.txt") == problems


@pytest.mark.parametrize("content", [b"one two\n", b"\xff\xfe\x81", b"1 2\n1 2 3\n"])
def test_a_matrix_of_words_is_no_table_of_numbers(tmp_path, content) -> None:
    """A file without columns of numbers gives one line, not an error."""
    (tmp_path / "m.txt").write_bytes(content)
    assert check._matrix(tmp_path / "m.txt") == [
        "the matrix m.txt is no table of numbers"
    ]


@pytest.mark.parametrize(
    ("name", "content", "points", "problems"),
    [
        ("a.laz", b"LASF", "7", []),
        ("a.LAZ", b"LASF and more", "7", []),
        ("a.las", b"LASF", "7", []),
        ("a.e57", b"ASTM-E57", "7", []),
        ("a.laz", b"ASTM-E57", "7", ["registered/a.laz is no LAZ file"]),
        ("a.las", b" LASF", "7", ["registered/a.las is no LAS file"]),
        ("a.e57", b"ASTM-E5", "7", ["registered/a.e57 is no E57 file"]),
        ("a.csv", b"1\n", "7", []),
        ("a.xyz", b"# x y z\n1 2 3\n\n 4 5 6\n", "2", []),
        (
            "a.xyz", b"# x y z\n1 2 3\n\n4 5 6\n", "3",
            ["registered/a.xyz has 2 points, metadata/scans.csv says 3"],
        ),
        (
            "a.xyz", b"# x y z\n", "1",
            ["registered/a.xyz has 0 points, metadata/scans.csv says 1"],
        ),
        # Missing numbers are problems of the table.
        ("a.xyz", b"1 2 3\n", "", []),
        ("a.xyz", b"1 2 3\n", "many", []),
    ],
)  # fmt: skip
def test_a_registered_cloud_has_its_format_and_its_points(
    tmp_path, name, content, points, problems
) -> None:
    """Signatures of LAS and E57 files are checked, and points of texts are counted."""
    (tmp_path / name).write_bytes(content)
    assert check._cloud(tmp_path / name, f"registered/{name}", points) == problems


def test_paths_of_a_table_stay_inside_of_the_archive(tmp_path) -> None:
    """Files and folders of the archive count, others do not, whether they exist."""
    folder = tmp_path / "archive"
    (folder / "raw").mkdir(parents=True)
    (folder / "raw" / "a.nc").touch()
    (tmp_path / "b.nc").touch()
    assert check._inside(folder, "raw")
    assert check._inside(folder, "raw/a.nc")
    assert not check._inside(folder, "raw/b.nc")
    assert not check._inside(folder, "../b.nc")
    assert not check._inside(folder, "raw/../raw/a.nc")
    assert not check._inside(folder, str(tmp_path / "b.nc"))
    assert not check._inside(folder, str(folder / "raw" / "a.nc"))


@pytest.mark.parametrize(
    ("content", "rows", "problems"),
    [
        (None, [], ["t.csv is missing"]),
        (b"", [], ["t.csv has no line"]),
        (b"a,b\n", [], ["t.csv has no line"]),
        (b"a,b\n1,2\n", [{"a": "1", "b": "2"}], []),
        (
            b"a,b\n1,\xff\n", [],
            ["t.csv cannot be read: 'utf-8' codec can't decode byte 0xff in position 6:"
             " invalid start byte"],
        ),
    ],
)  # fmt: skip
def test_a_table_is_there_with_a_line_at_least(
    tmp_path, content, rows, problems
) -> None:
    """Missing, empty and unreadable tables are problems."""
    if content is not None:
        (tmp_path / "t.csv").write_bytes(content)
    found: list[str] = []
    assert check._rows(tmp_path, "t.csv", found) == rows
    assert found == problems


def test_the_files_that_a_scan_names_are_in_the_archive(tmp_path) -> None:
    """Raw files, clouds, matrix and trajectory of a scan are looked for by name."""
    for name in ("raw", "registered", "registration"):
        (tmp_path / name).mkdir()
    (tmp_path / "raw" / "a.nc").touch()
    (tmp_path / "registered" / "a.laz").write_bytes(b"none")
    np.savetxt(tmp_path / "registration" / "m.txt", 2 * np.eye(4))
    scan = {
        "scan": "one",
        "raw files": "raw/a.nc; raw/b.nc ;",
        "registered cloud": "registered/a.laz;registered/a.e57",
        "trajectory": " processed/t.csv ",
        "matrix": "registration/m.txt",
        "points": "5",
    }
    assert check._scan_problems(tmp_path, scan) == [
        "scan one: raw raw/b.nc is not in the archive",
        "scan one: registered cloud registered/a.e57 is not in the archive",
        "scan one: its trajectory processed/t.csv is not in the archive",
        f"scan one: {NO_TURN}",
        "scan one: registered/a.laz is no LAZ file",
    ]
    gone = {"matrix": "registration/n.txt"}
    assert check._scan_problems(tmp_path, gone) == [
        "scan ?: its matrix registration/n.txt is not in the archive"
    ]
    # Fields that are missing are problems of the table.
    assert check._scan_problems(tmp_path, {"scan": "one"}) == []


def archive_of(folder: Path, *, scans: int, stated: tuple[str, str]) -> None:
    """Write an archive of tables alone, with numbers of scans as stated."""
    (folder / "metadata").mkdir()
    (folder / "README.txt").write_text("words")
    for name, fields, count in (
        (layout.PROJECT, layout.PROJECT_FIELDS, stated[0]),
        (layout.REGISTRATION, layout.REGISTRATION_FIELDS, stated[1]),
    ):
        values = dict.fromkeys(fields, "x") | {"number of scans": count}
        with (folder / name).open("w", newline="") as file:
            csv.writer(file).writerows([("field", "value"), *values.items()])
    free = {"raw files", "registered cloud", "matrix"}
    row = {name: ";" if name in free else "x" for name in layout.SCAN_FIELDS}
    np.savetxt(folder / "m.txt", np.eye(4))
    with (folder / layout.SCANS).open("w", newline="") as file:
        table = csv.DictWriter(file, layout.SCAN_FIELDS)
        table.writeheader()
        table.writerows([row | {"matrix": "m.txt"}] * scans)
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder)}\n"
        for path in folder.rglob("*")
        if path.is_file()
    ]
    (folder / layout.MANIFEST).write_text("".join(lines))


@pytest.mark.parametrize(
    ("scans", "stated", "problems"),
    [
        (2, ("2", "2"), []),
        (2, ("3", "2"),
         ["project.csv: states 3 scans, but metadata/scans.csv has 2"]),
        (1, ("1", "2"),
         ["registration.csv: states 2 scans, but metadata/scans.csv has 1"]),
        (1, ("", "1"),
         ["metadata/project.csv: the field 'number of scans' is empty"]),
        (0, ("1", "1"), ["metadata/scans.csv has no line"]),
    ],
)  # fmt: skip
def test_all_tables_of_an_archive_state_the_same_scans(
    tmp_path, scans, stated, problems
) -> None:
    """Numbers of scans in the tables of project and registration are those listed."""
    archive_of(tmp_path, scans=scans, stated=stated)
    assert missing_of(tmp_path) == problems


def test_an_archive_is_a_folder_with_a_file_of_words(tmp_path) -> None:
    """A file is no archive, and a README is missed in a line of its own."""
    with pytest.raises(FormatError, match=r"x is no folder; name an archive$"):
        missing_of(tmp_path / "x")
    archive_of(tmp_path, scans=1, stated=("1", "1"))
    (tmp_path / "README.txt").unlink()
    assert missing_of(tmp_path) == [
        "README.txt is missing: what the folder holds, in words",
        "README.txt is missing, the manifest lists it",
    ]


def test_a_scan_without_a_name_goes_by_its_number(tmp_path) -> None:
    """The numbers of lines in messages begin with 1."""
    archive_of(tmp_path, scans=2, stated=("2", "2"))
    path = tmp_path / layout.SCANS
    first, second, third = path.read_text().splitlines()
    path.write_text("\n".join([first, second, third.replace("x", "", 1)]))
    problems: list[str] = []
    assert len(check._scan_table(tmp_path, problems)) == 2
    assert problems == ["metadata/scans.csv: scan number 2: the field 'scan' is empty"]


def test_checksums_are_64_digits_and_a_name_for_each_file(tmp_path) -> None:
    """Lines without checksum or name, and files beside the manifest, are problems."""
    (tmp_path / "deep").mkdir()
    for name in ("a.txt", "deep/b.txt", "c d.txt", "deep/-e.txt"):
        (tmp_path / name).write_text(name)
    digest = hashlib.sha256(b"a.txt").hexdigest()
    other = hashlib.sha256(b"other").hexdigest()
    named = f"{other[:63]}  a.txt", f"{other}  ", other.upper() + "  c d.txt"
    lines = [f"{digest}  a.txt", f"{other}  deep/b.txt", f"{digest}  gone.txt", *named]
    (tmp_path / layout.MANIFEST).write_text("\n".join(lines))
    what = f"{layout.MANIFEST}: a line is no checksum: "
    assert check._file_problems(tmp_path) == [
        *(
            f"{name}: the name is not portable; use letters, digits, point, - and _"
            for name in ("c d.txt", "deep/-e.txt")
        ),
        *(f"{what}{line[:60]!r}" for line in named),
        "gone.txt is missing, the manifest lists it",
        "c d.txt has no checksum in the manifest",
        "deep/-e.txt has no checksum in the manifest",
        "deep/b.txt is damaged or changed: its checksum differs",
    ]
    (tmp_path / layout.MANIFEST).unlink()
    assert check._file_problems(tmp_path)[2:] == [
        "manifest-sha256.txt is missing: the checksums of all files"
    ]
