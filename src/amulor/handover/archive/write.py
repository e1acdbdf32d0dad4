"""Writing of a project's archive folder, complete or not at all."""

from __future__ import annotations

import csv
import math
import os
import secrets
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from amulor import cube as cubes
from amulor import imaging, io
from amulor._progress import tell
from amulor.cube import DOUBTFUL
from amulor.errors import CubeError, FormatError, SurveyError
from amulor.handover.archive import project as layout
from amulor.handover.archive.check import missing_of
from amulor.handover.archive.project import Project, ScanFiles
from amulor.imaging import products
from amulor.imaging.observation import readable_survey
from amulor.io.files import synchronise_folder
from amulor.io.trajectories import read_trajectory
from amulor.platform import read_mounting

Row = dict[str, str]

_FORMATS = {
    ".nc": "netCDF 4 (CF)",
    ".laz": "LAZ 1.4",
    ".e57": "ASTM E57",
    ".csv": "text, comma-separated, UTF-8",
    ".xyz": "text, space-separated, UTF-8",
    ".txt": "text, UTF-8",
    ".toml": "TOML text, UTF-8",
    ".sqlite": "SQLite 3",
}


def write_archive(project: Project, folder: Path) -> dict[str, int]:
    """Write the folder of a project for a heritage archive.

    The folder follows the ADS / Digital Antiquity Guides to Good Practice for laser
    scanning. It has raw scans as recorded; the registered cloud of each scan as text,
    LAZ and E57; tables on project, scans and registration; a matrix for each scan; and
    SHA-256 checksums of all files. All is written to a hidden folder first, which is
    renamed at the end.
    """
    folder = Path(os.path.abspath(folder))
    if os.path.lexists(folder):
        raise FormatError(f"{folder} exists already; choose another name")
    if not folder.parent.is_dir():
        raise FormatError(f"there is no folder {folder.parent}; make it first")
    hidden = folder.with_name(f".amulor-{secrets.token_hex(8)}")
    try:
        hidden.mkdir()
        counts = _fill(project, hidden)
        tell("checksums", 0.9)
        _manifest(hidden)
        counts["files"] = sum(path.is_file() for path in hidden.rglob("*"))
        lacking = missing_of(hidden)
        if lacking:
            raise FormatError(
                "\n".join(f"the archive would not be whole: {line}" for line in lacking)
            )
        os.rename(hidden, folder)
        synchronise_folder(folder.parent)
    except OSError as error:
        raise FormatError(
            f"{folder} cannot be written: {error.strerror or error}; free some space "
            "or choose another place"
        ) from error
    finally:
        shutil.rmtree(hidden, ignore_errors=True)
    return counts


def _fill(project: Project, hidden: Path) -> dict[str, int]:
    name = project.project.name
    for part in ("raw", "processed", "registered", "registration", "metadata"):
        (hidden / part).mkdir()
    rows: list[Row] = []
    tell("reading", 0.0)
    frames = _frames(project)
    for number, scan in enumerate(project.scans):
        share = number / len(project.scans)
        tell(f"copying {scan.name}", 0.9 * share)
        raw = _copy_raw(scan, hidden)
        tell(f"clouds of {scan.name}", 0.9 * (share + 0.3 / len(project.scans)))
        image = io.read_cube(scan.image)
        try:
            rows.append(_scan(name, scan, image, hidden, raw, frames[number]))
        except CubeError as error:
            raise CubeError(f"scan {scan.name}: {error}") from None
    _table(hidden / layout.SCANS, layout.SCAN_FIELDS, rows)
    points = sum(int(row["points"]) for row in rows)
    _fields(
        hidden / layout.PROJECT,
        _project_fields(project, rows, points),
    )
    _fields(hidden / layout.REGISTRATION, _registration_fields(project, frames))
    (hidden / layout.README).write_text(_readme(project, rows), encoding="utf-8")
    _file_list(hidden)
    return {"scans": len(rows), "points": points}


AnyFrame = imaging.Frame | imaging.MovingFrame


def _frames(project: Project) -> list[AnyFrame]:
    """Return the frame of each scan; raise if reference systems or offsets differ."""
    frames: list[AnyFrame] = []
    for scan in project.scans:
        image = io.read_cube(scan.image)
        cubes.check(image, "range_image", name=str(scan.image))
        survey = readable_survey(image)
        pose = scan.pose or (None if survey is None else survey.pose)
        if pose is None and scan.trajectory is None and len(project.scans) > 1:
            raise CubeError(
                f"scan {scan.name}: neither the project nor its survey states its pose,"
                " so its points are in no frame with those of other scans; add "
                "[scans.pose], or archive it alone"
            )
        axes: imaging.Axes = "z-up" if pose is None else "pose"
        mounting = None if scan.mounting is None else read_mounting(scan.mounting)
        frames.append(
            imaging.frame_of(image, axes=axes, pose=pose)
            if scan.trajectory is None
            else imaging.moving_frame(
                image,
                trajectory=read_trajectory(scan.trajectory),
                mounting=mounting,
            )
        )
        if (frames[-1].crs, frames[-1].crs_offset) != (
            frames[0].crs,
            frames[0].crs_offset,
        ):
            raise CubeError(
                f"scan {scan.name}: its pose is in another reference system or has "
                f"another offset than that of {project.scans[0].name}; state all poses "
                "in one"
            )
    return frames


def _copy_raw(scan: ScanFiles, hidden: Path) -> list[str]:
    """Copy the raw files of a scan, and return their paths in the archive."""
    place = hidden / layout.raw_folder(scan.name)
    place.mkdir()
    copied = []
    for source in scan.raw:
        target = place / source.name
        if target.exists():
            raise SurveyError(
                f"scan {scan.name}: two raw files are called {source.name}; rename one"
            )
        if source.is_dir():
            shutil.copytree(
                source, target, ignore=shutil.ignore_patterns("writer.lock")
            )
        else:
            shutil.copyfile(source, target)
        copied.append(target.relative_to(hidden).as_posix())
    return copied


def _scan(
    name: str,
    scan: ScanFiles,
    image: xr.Dataset,
    hidden: Path,
    raw: list[str],
    frame: AnyFrame,
) -> Row:
    """Write cloud and matrix of a scan, and return its row in the archive's tables."""
    survey = readable_survey(image)
    cloud = imaging.point_cloud(image, frame=frame)
    stem = layout.cloud_name(name, scan.name)
    for ending in (".xyz", ".laz", ".e57"):
        io.write_cloud(cloud, hidden / f"{stem}{ending}")
    shutil.copyfile(scan.image, hidden / "processed" / f"{name}_{scan.name}.nc")
    trajectory = ""
    if scan.trajectory is not None:
        trajectory = layout.trajectory_name(name, scan.name)
        shutil.copyfile(scan.trajectory, hidden / trajectory)
    if scan.mounting is not None:
        shutil.copyfile(scan.mounting, hidden / layout.mounting_name(name, scan.name))
    matrix = layout.matrix_name(name, scan.name)
    np.savetxt(hidden / matrix, frame.matrix, fmt="%.12f")
    budget = imaging.error_budget(image)
    flags = cloud["quality_flag"].values
    unknown = [term.name.replace("_", " ") for term in budget.unknown]
    unknown += [f"{part} of the pose" for part in frame.unknown]
    rows, columns = image["slant_range"].shape
    return {
        "scan": scan.name,
        "raw files": "; ".join(raw),
        "registered cloud": f"{stem}.xyz; {stem}.laz; {stem}.e57",
        "matrix": matrix,
        "matrix applied to registered cloud": (
            "no: it is the pose in the middle of the scan; the trajectory has all poses"
            if trajectory
            else "yes"
        ),
        "date": _day(image),
        "rows": str(rows),
        "columns": str(columns),
        "points": str(cloud.sizes["point"]),
        "doubtful points": str(int(((flags & int(DOUBTFUL)) != 0).sum())),
        "point spacing [m]": f"{_spacing(image):.4g}",
        "wavelength [m]": (
            "not known" if survey is None else f"{survey.instrument.wavelength:.6g}"
        ),
        "modulation frequencies [Hz]": " ".join(
            f"{f:.9g}" for f in np.atleast_1d(image.attrs["modulation_frequencies"])
        ),
        "polarization": str(image.attrs.get("polarization") or "none"),
        "group index": f"{float(image['geometry'].attrs['group_index']):.6g}",
        "standard uncertainty of range, median [m]": (
            f"{budget.combined:.4g}"
            if math.isfinite(budget.combined)
            else budget.error_unknown or "not known"
        ),
        "part that all points share, median [m]": (
            f"{budget.common:.4g}" if math.isfinite(budget.common) else "not known"
        ),
        "uncertainties not known": ", ".join(unknown) or "none",
        "history": " | ".join(str(image.attrs.get("history", "none")).splitlines()),
        "trajectory": trajectory,
        "material": scan.material,
        "simulated": "yes" if image.attrs.get("simulated") else "no",
        "notes": scan.notes,
    }


def _project_fields(project: Project, rows: list[Row], points: int) -> Row:
    about = project.project
    return {
        "project name": about.name,
        "title": about.title,
        "monument and number": about.monument,
        "place": about.place,
        "first day of survey": about.first_day.isoformat(),
        "last day of survey": about.last_day.isoformat(),
        "survey conditions": about.conditions,
        "scanner make and model": about.scanner,
        "scanner serial number": about.serial_number,
        "operator": about.operator,
        "control data": about.control_data,
        "purpose": about.purpose,
        "copyright and licence": about.copyright,
        "number of scans": str(len(rows)),
        "point spacing [m]": f"{min(float(r['point spacing [m]']) for r in rows):.4g}",
        "total number of points": str(points),
        "software": f"amulor {cubes.provenance.software_versions()['amulor']}",
        "find number": about.find_number,
        "author": about.author,
        "institution": about.institution,
        "notes": about.notes,
    }


def _registration_fields(project: Project, frames: Sequence[AnyFrame]) -> Row:
    registration = project.registration
    error = registration.rms_error
    return {
        "method": registration.method,
        "georeferenced": "yes" if frames[0].crs else "no",
        "reference system": frames[0].crs or "local frame",
        "number of scans": str(len(project.scans)),
        "control points": str(registration.points),
        "global RMS error [m]": "single scan" if error is None else f"{error:.4g}",
        "frame of registered clouds": frames[0].axes,
        "add to coordinates [m]": ", ".join(f"{v:.12g}" for v in frames[0].crs_offset),
        "software": registration.software,
        "notes": registration.notes,
    }


def _readme(project: Project, rows: list[Row]) -> str:
    about = project.project
    names = "\n".join(f"  {row['scan']}: {row['points']} points" for row in rows)
    return f"""{about.title}
{about.monument}; {about.place}; {about.first_day} to {about.last_day}

Laser scans, arranged after the Guides to Good Practice (Archaeology Data Service and
Digital Antiquity) for laser scanning.

{names}

raw/            what was recorded, as it was recorded
processed/      the range image of each scan, with its error budget and history; for a
                scan from a vehicle, also the trajectory and the mounting, if stated
registered/     the points of each scan in the frame of the project: the same points as
                text (.xyz), LAZ and E57
registration/   one matrix a scan, 4 x 4 row by row: it turns the instrument's axes
                (x right, y down, z forward, meters) into those of the registered
                points; for a scan from a vehicle, in the middle of the scan
metadata/       project.csv, scans.csv, registration.csv, files.csv
manifest-sha256.txt   checksums; sha256sum --check reads it

Uncertainties are standard uncertainties (GUM, k = 1); about 95 of 100 errors lie within
twice as much. Columns sigma_x, sigma_y, sigma_z of the points hold them for each point;
scans.csv says which sources of error nobody stated. Points with a quality_flag that is
not 0 are doubtful; the first lines of each .xyz say why.

{about.copyright}
"""


def _file_list(hidden: Path) -> None:
    """Write the table of all files in the archive."""
    about = {
        "raw": "recorded data",
        "processed": "range image made of recorded data",
        "registered": "points in the frame of the project",
        "registration": "transformation of a scan",
        "metadata": "table on project, scans, registration or files",
    }
    rows = []
    for path in sorted(p for p in hidden.rglob("*") if p.is_file()):
        place = path.relative_to(hidden)
        kind = about.get(place.parts[0], "what this folder is")
        rows.append(
            {
                "file": place.as_posix(),
                "format": _FORMATS.get(path.suffix.lower(), "binary"),
                "bytes": str(path.stat().st_size),
                "what it is": kind,
            }
        )
    _table(hidden / layout.FILES, layout.FILE_FIELDS, rows)


def _manifest(hidden: Path) -> None:
    """Write the checksums of all files, in the format of sha256sum."""
    lines = [
        f"{layout.digest_of(path)}  {path.relative_to(hidden).as_posix()}"
        for path in sorted(p for p in hidden.rglob("*") if p.is_file())
    ]
    text = "\n".join(lines) + "\n"
    (hidden / layout.MANIFEST).write_text(text, encoding="utf-8")


def _fields(path: Path, values: Mapping[str, str]) -> None:
    rows = [{"field": field, "value": value} for field, value in values.items()]
    _table(path, ("field", "value"), rows)


def _table(
    path: Path, fields: Sequence[str], rows: Sequence[Mapping[str, str]]
) -> None:
    names = list(fields) + [
        name for name in (rows[0] if rows else {}) if name not in fields
    ]
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, names, lineterminator="\n")
        table.writeheader()
        table.writerows(
            {name: " ".join(text.split()) for name, text in row.items()} for row in rows
        )


def _day(image: xr.Dataset) -> str:
    """Return the date of a scan from the first line of its processing history."""
    lines = str(image.attrs.get("history", "")).splitlines()
    day = lines[0][:10] if lines else ""
    return day if day[:4].isdigit() else "not known"


def _spacing(image: xr.Dataset) -> float:
    """Return the median distance between neighboring points of a scan [m]."""
    return products.surface(image).spacing
