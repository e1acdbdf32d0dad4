"""The one format that measured and simulated data share."""

from amulor.cube.accessor import (
    CubeAccessor,
    attach,
    flag_counts,
    group,
    without_groups,
)
from amulor.cube.build import build, open_water
from amulor.cube.check import check
from amulor.cube.provenance import attributes, digest, note
from amulor.cube.schema import LEVELS, SCHEMA_VERSION, UNUSABLE, QualityFlag

__all__ = [
    "LEVELS",
    "SCHEMA_VERSION",
    "UNUSABLE",
    "CubeAccessor",
    "QualityFlag",
    "attach",
    "attributes",
    "build",
    "check",
    "digest",
    "flag_counts",
    "group",
    "note",
    "open_water",
    "without_groups",
]
