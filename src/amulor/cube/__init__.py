"""The measurement cube, the common format of measured and simulated data."""

from amulor.cube.accessor import (
    CubeAccessor,
    attach,
    flag_counts,
    group,
    without_groups,
)
from amulor.cube.check import check, checked
from amulor.cube.error import (
    WATER_NOT_REMOVED,
    error_unknown,
    without_unknown_errors,
)
from amulor.cube.provenance import attributes, build, digest, note, open_water
from amulor.cube.schema import (
    DOUBTFUL,
    ERROR_UNKNOWN,
    LEVELS,
    SCHEMA_VERSION,
    UNUSABLE,
    QualityFlag,
    WaterResidualCause,
)
from amulor.cube.values import restore_dimensions

__all__ = [
    "DOUBTFUL",
    "ERROR_UNKNOWN",
    "LEVELS",
    "SCHEMA_VERSION",
    "UNUSABLE",
    "WATER_NOT_REMOVED",
    "CubeAccessor",
    "QualityFlag",
    "WaterResidualCause",
    "attach",
    "attributes",
    "build",
    "check",
    "checked",
    "digest",
    "error_unknown",
    "flag_counts",
    "group",
    "note",
    "open_water",
    "restore_dimensions",
    "without_groups",
    "without_unknown_errors",
]


def __dir__() -> list[str]:
    """Return the public names of the package only."""
    return sorted(__all__)
