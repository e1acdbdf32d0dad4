"""The folder that heritage archives ask for: written whole, and checked."""

from amulor.handover.archive.check import missing_of
from amulor.handover.archive.project import Project, read_project
from amulor.handover.archive.write import write_archive

__all__ = ["Project", "missing_of", "read_project", "write_archive"]


def __dir__() -> list[str]:
    """List the public names, not the modules that they come from."""
    return sorted(__all__)
