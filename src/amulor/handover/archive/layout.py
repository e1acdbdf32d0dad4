"""Where things lie in an archive, and which fields its metadata must have."""

from __future__ import annotations

import hashlib
from pathlib import Path

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
    """Return where the matrix of a scan lies.

    Parameters
    ----------
    project, scan : str
        Their names.

    Returns
    -------
    str
        Path in the archive.
    """
    return f"registration/{project}_GRmatrices_{scan}.txt"


def cloud_name(project: str, scan: str) -> str:
    """Return where the registered cloud of a scan lies, without its ending.

    Parameters
    ----------
    project, scan : str
        Their names.

    Returns
    -------
    str
        Path in the archive.
    """
    return f"registered/{project}_{scan}"


def raw_folder(scan: str) -> str:
    """Return where the raw files of a scan lie.

    Parameters
    ----------
    scan : str
        Its name.

    Returns
    -------
    str
        Path in the archive.
    """
    return f"raw/{scan}"


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file of any size.

    Parameters
    ----------
    path : pathlib.Path
        The file.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
