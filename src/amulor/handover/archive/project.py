"""Project description for an archive, and the paths of the archive's files."""

from __future__ import annotations

import datetime
import hashlib
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from amulor.errors import SurveyError
from amulor.survey import Pose, toml_file
from amulor.survey.quantity import Description, Length

#: Files of every archive.
README, MANIFEST = "README.txt", "manifest-sha256.txt"
PROJECT = "metadata/project.csv"
SCANS = "metadata/scans.csv"
REGISTRATION = "metadata/registration.csv"
FILES = "metadata/files.csv"

#: Fields of the three tables that must not be empty.
PROJECT_FIELDS = (
    "project name",
    "title",
    "monument and number",
    "place",
    "first day of survey",
    "last day of survey",
    "survey conditions",
    "scanner make and model",
    "scanner serial number",
    "operator",
    "control data",
    "purpose",
    "copyright and licence",
    "number of scans",
    "point spacing [m]",
    "total number of points",
    "software",
)
SCAN_FIELDS = (
    "scan",
    "raw files",
    "registered cloud",
    "matrix",
    "matrix applied to registered cloud",
    "date",
    "rows",
    "columns",
    "points",
    "doubtful points",
    "point spacing [m]",
    "wavelength [m]",
    "modulation frequencies [Hz]",
    "polarization",
    "group index",
    "standard uncertainty of range, median [m]",
    "part that all points share, median [m]",
    "uncertainties not known",
    "history",
)
REGISTRATION_FIELDS = (
    "method",
    "georeferenced",
    "reference system",
    "number of scans",
    "control points",
    "global RMS error [m]",
    "frame of registered clouds",
)
FILE_FIELDS = ("file", "format", "bytes", "what it is")


def matrix_name(project: str, scan: str) -> str:
    """Return the path of a scan's registration matrix in the archive."""
    return f"registration/{project}_GRmatrices_{scan}.txt"


def cloud_name(project: str, scan: str) -> str:
    """Return the path of a scan's point cloud in the archive, without ending."""
    return f"registered/{project}_{scan}"


def trajectory_name(project: str, scan: str) -> str:
    """Return the path of a scan's trajectory in the archive."""
    return f"processed/{project}_{scan}_trajectory.csv"


def mounting_name(project: str, scan: str) -> str:
    """Return the path of the mounting of a scan's instrument in the archive."""
    return f"processed/{project}_{scan}_mounting.toml"


def raw_folder(scan: str) -> str:
    """Return the path of the folder with a scan's raw files."""
    return f"raw/{scan}"


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file of any size."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


_Text = Annotated[str, Field(min_length=1, max_length=2000)]
#: Pattern of names that every file system and archive accepts.
_Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,59}$")]


class About(Description):
    """Subject, place, time, persons and instrument of a surveying project."""

    name: _Name
    """Name of the project, the start of file names: letters, digits, - and _."""
    title: _Text
    """Title, in one line."""
    monument: _Text
    """Name of the monument or object, and its number in a register."""
    place: _Text
    """Place, with coordinates or a grid reference."""
    first_day: datetime.date
    """First day of the survey."""
    last_day: datetime.date
    """Last day of the survey."""
    conditions: _Text
    """Conditions: depth, visibility, temperature, light, currents."""
    scanner: _Text
    """Make and model of the instrument."""
    serial_number: _Text
    """Serial number of the instrument."""
    operator: _Text
    """Operator: person and organization."""
    control_data: _Text
    """Control measurements: points, scale bars, or "none"."""
    purpose: _Text
    """Purpose of the survey."""
    copyright: _Text
    """Holder of the rights, and license."""
    find_number: str = ""
    """Number of the find, for title blocks of drawings."""
    author: str = ""
    """Author of the drawings."""
    institution: str = ""
    """Institution of the author."""
    notes: str = ""
    """Further notes."""

    @model_validator(mode="after")
    def _days_in_order(self) -> Self:
        if self.last_day < self.first_day:
            raise ValueError(
                f"last_day ({self.last_day}) lies before first_day ({self.first_day})"
            )
        return self


class ScanFiles(Description):
    """Files of one scan in the project."""

    name: _Name
    """Name of the scan: letters, digits, - and _."""
    image: Path
    """Range image (netCDF); a relative path starts at the project file."""
    raw: Annotated[tuple[Path, ...], Field(min_length=1)]
    """Raw data: samples (netCDF), or the folder of a scan with its journal."""
    pose: Pose | None = None
    """Pose of the instrument; by default the pose in the survey of the scan."""
    trajectory: Path | None = None
    """Trajectory of the vehicle that carried the instrument (CSV), instead of a
    pose."""
    mounting: Path | None = None
    """File with the mounting of the instrument on the vehicle; by default the mounting
    in the survey of the scan."""
    material: str = ""
    """Material of the scanned surface."""
    notes: str = ""
    """Further notes."""

    @model_validator(mode="after")
    def _has_one_kind_of_pose(self) -> Self:
        if self.trajectory is not None and self.pose is not None:
            raise ValueError("pose and trajectory are both stated; state one")
        if self.mounting is not None and self.trajectory is None:
            raise ValueError("mounting needs trajectory, the poses of the vehicle")
        return self


class Registration(Description):
    """Method and accuracy of the registration of all scans in one frame."""

    method: _Text
    """Method, such as "targets", "cloud to cloud", or "single scan, not registered"."""
    rms_error: Annotated[Length, Field(ge=0)] | None = None
    """Global root mean square error; needed for more than one scan [m]."""
    points: Annotated[int, Field(ge=0, le=10**9)] = 0
    """Number of control points or targets [1]."""
    software: str = ""
    """Registration software."""
    notes: str = ""
    """Further notes."""


class Project(Description):
    """Description of a project for its archive."""

    project: About
    """Description of the survey."""
    registration: Registration
    """Registration of the scans in a common frame."""
    scans: Annotated[tuple[ScanFiles, ...], Field(min_length=1, max_length=999)]
    """Scans, in order."""

    @model_validator(mode="after")
    def _scans_have_names_of_their_own(self) -> Self:
        names = [scan.name.lower() for scan in self.scans]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"scans have the same name: {', '.join(twice)}")
        return self

    @model_validator(mode="after")
    def _registration_states_its_error(self) -> Self:
        if len(self.scans) > 1 and self.registration.rms_error is None:
            raise ValueError(
                "registration.rms_error is missing, the global root mean square error "
                'of more than one scan; state it, such as "2 mm"'
            )
        return self


def read_title_fields(path: Path) -> dict[str, str]:
    """Read the texts of a drawing's title block from the description of a project."""
    about = _described(path).project
    days = dict.fromkeys(f"{day}" for day in (about.first_day, about.last_day))
    return {
        "project": about.title,
        "object": about.monument,
        "find number": about.find_number,
        "author": about.author or about.operator,
        "institution": about.institution,
        "date": " to ".join(days),
    }


def _described(path: Path) -> Project:
    return toml_file.read(path, Project, what="a project", error=SurveyError)


def read_project(path: Path) -> Project:
    """Read the description of a project, and check that its files exist."""
    project = _described(path)
    scans, wrong = [], []
    for number, scan in enumerate(project.scans):
        files = {"image": path.parent / scan.image}
        files |= {f"raw[{n}]": path.parent / raw for n, raw in enumerate(scan.raw)}
        parts = {"trajectory": scan.trajectory, "mounting": scan.mounting}
        beside = {field: path.parent / file for field, file in parts.items() if file}
        wrong += [
            f"{path}: scans[{number}].{field}: {file} does not exist; check the name"
            for field, file in (files | beside).items()
            if not (file.exists() if field.startswith("raw") else file.is_file())
        ]
        image, *raw = files.values()
        update = {"image": image, "raw": tuple(raw), **beside}
        scans.append(scan.model_copy(update=update))
    if wrong:
        raise SurveyError("\n".join(wrong))
    return project.model_copy(update={"scans": tuple(scans)})
