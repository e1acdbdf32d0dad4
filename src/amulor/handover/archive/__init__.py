"""The archive folder of heritage archives: writing and checking."""

from amulor.handover.archive.check import missing_of
from amulor.handover.archive.project import Project, read_project, read_title_fields
from amulor.handover.archive.write import write_archive

__all__ = [
    "Project",
    "missing_of",
    "read_project",
    "read_title_fields",
    "write_archive",
]


def __dir__() -> list[str]:
    """Return the public names of the package only."""
    return sorted(__all__)
