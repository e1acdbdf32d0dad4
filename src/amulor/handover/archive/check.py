"""Check of an archive folder by its files alone."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from amulor.errors import FormatError
from amulor.handover.archive import project as layout

#: Pattern of names that every file system and archive accepts.
_PORTABLE = re.compile(r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
#: First bytes of registered clouds, by format.
_SIGNATURES = {".laz": b"LASF", ".las": b"LASF", ".e57": b"ASTM-E57"}


def missing_of(folder: Path) -> list[str]:
    """Return the problems of an archive folder, one line of text per problem.

    The check covers: tables with all their fields; for each scan the raw files, the
    registered clouds with the stated number of points, and a matrix of rotation and
    translation; a checksum for every file; file names that all file systems accept.
    """
    if not folder.is_dir():
        raise FormatError(f"{folder} is no folder; name an archive")
    problems: list[str] = []
    if not (folder / layout.README).is_file():
        problems.append(f"{layout.README} is missing: what the folder holds, in words")
    project = _field_table(folder, layout.PROJECT, layout.PROJECT_FIELDS, problems)
    registration = _field_table(
        folder, layout.REGISTRATION, layout.REGISTRATION_FIELDS, problems
    )
    scans = _scan_table(folder, problems)
    for field, table in (("project", project), ("registration", registration)):
        count = table.get("number of scans", "")
        if scans and count and count != str(len(scans)):
            problems.append(
                f"{field}.csv: states {count} scans, but {layout.SCANS} has "
                f"{len(scans)}"
            )
    for scan in scans:
        problems += _scan_problems(folder, scan)
    problems += _file_problems(folder)
    return problems


def _field_table(
    folder: Path, name: str, fields: Sequence[str], problems: list[str]
) -> dict[str, str]:
    """Read a table of fields and values; report missing and empty fields."""
    rows = _rows(folder, name, problems)
    values = {row.get("field") or "": (row.get("value") or "").strip() for row in rows}
    if rows:
        problems += [
            f"{name}: the field '{field}' is "
            f"{'empty' if field in values else 'missing'}"
            for field in fields
            if not values.get(field)
        ]
    return values


def _scan_table(folder: Path, problems: list[str]) -> list[Mapping[str, str]]:
    rows = _rows(folder, layout.SCANS, problems)
    for number, row in enumerate(rows):
        name = row.get("scan") or f"number {number + 1}"
        problems += [
            f"{layout.SCANS}: scan {name}: the field '{field}' is "
            f"{'empty' if field in row else 'missing'}"
            for field in layout.SCAN_FIELDS
            if not (row.get(field) or "").strip()
        ]
    return rows


def _rows(folder: Path, name: str, problems: list[str]) -> list[Mapping[str, str]]:
    path = folder / name
    if not path.is_file():
        problems.append(f"{name} is missing")
        return []
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows: list[Mapping[str, str]] = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        problems.append(f"{name} cannot be read: {error}")
        return []
    if not rows:
        problems.append(f"{name} has no line")
    return rows


def _scan_problems(folder: Path, scan: Mapping[str, str]) -> list[str]:
    name = scan.get("scan") or "?"
    problems = []
    for field, label in (
        ("raw files", "raw"),
        ("registered cloud", "registered cloud"),
    ):
        for text in (part.strip() for part in (scan.get(field) or "").split(";")):
            if text and not _inside(folder, text):
                problems.append(f"scan {name}: {label} {text} is not in the archive")
    trajectory = (scan.get("trajectory") or "").strip()
    if trajectory and not _inside(folder, trajectory):
        problems.append(
            f"scan {name}: its trajectory {trajectory} is not in the archive"
        )
    matrix = (scan.get("matrix") or "").strip()
    if matrix and not _inside(folder, matrix):
        problems.append(f"scan {name}: its matrix {matrix} is not in the archive")
    elif matrix:
        problems += [f"scan {name}: {problem}" for problem in _matrix(folder / matrix)]
    for text in (
        part.strip() for part in (scan.get("registered cloud") or "").split(";")
    ):
        if text and _inside(folder, text):
            problems += [
                f"scan {name}: {problem}"
                for problem in _cloud(folder / text, text, scan.get("points") or "")
            ]
    return problems


def _matrix(path: Path) -> list[str]:
    try:
        matrix = np.loadtxt(path)
    except (OSError, ValueError, UnicodeDecodeError):
        return [f"the matrix {path.name} is no table of numbers"]
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        return [f"the matrix {path.name} is not of 4 x 4 finite numbers"]
    turn = matrix[:3, :3]
    is_rotation = np.allclose(turn @ turn.T, np.eye(3), atol=1e-6)
    if (
        not is_rotation
        or np.linalg.det(turn) < 0
        or not np.allclose(matrix[3], [0, 0, 0, 1])
    ):
        return [
            f"the matrix {path.name} is no turn and shift: it scales, mirrors or shears"
        ]
    return []


def _cloud(path: Path, name: str, points: str) -> list[str]:
    ending = path.suffix.lower()
    if ending in _SIGNATURES:
        with path.open("rb") as file:
            start = file.read(8)
        if not start.startswith(_SIGNATURES[ending]):
            return [f"{name} is no {ending.removeprefix('.').upper()} file"]
        return []
    if ending != ".xyz":
        return []
    with path.open("rb") as file:
        count = sum(1 for line in file if line.strip() and not line.startswith(b"#"))
    if points.isdigit() and count != int(points):
        return [f"{name} has {count} points, {layout.SCANS} says {points}"]
    return []


def _file_problems(folder: Path) -> list[str]:
    """Return the problems with file names and checksums of an archive."""
    present = {
        path.relative_to(folder).as_posix(): path
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    problems = [
        f"{name}: the name is not portable; use letters, digits, point, - and _"
        for name in present
        if not all(_PORTABLE.match(part) for part in PurePosixPath(name).parts)
    ]
    manifest = present.pop(layout.MANIFEST, None)
    if manifest is None:
        return [*problems, f"{layout.MANIFEST} is missing: the checksums of all files"]
    listed: dict[str, str] = {}
    for line in manifest.read_text(encoding="utf-8", errors="replace").splitlines():
        digest, _, name = line.partition("  ")
        if not re.fullmatch(r"[0-9a-f]{64}", digest) or not name:
            problems.append(f"{layout.MANIFEST}: a line is no checksum: {line[:60]!r}")
            continue
        listed[name] = digest
    problems += [
        f"{name} is missing, the manifest lists it"
        for name in listed
        if name not in present
    ]
    problems += [
        f"{name} has no checksum in the manifest"
        for name in present
        if name not in listed
    ]
    problems += [
        f"{name} is damaged or changed: its checksum differs"
        for name, path in present.items()
        if name in listed and layout.digest_of(path) != listed[name]
    ]
    return problems


def _inside(folder: Path, name: str) -> bool:
    """Return whether a path in a table is a file or folder within the archive."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts:
        return False
    return (folder / path).exists()
