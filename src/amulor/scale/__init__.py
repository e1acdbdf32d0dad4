"""Processing of files larger than memory, in tiles of rows."""

from amulor.io.netcdf import is_large
from amulor.pipeline import (
    Summary,
    TiledStep,
    image_file,
    image_step,
    reject_file,
    reject_step,
    run_file,
    run_step,
)

__all__ = [
    "Summary",
    "TiledStep",
    "image_file",
    "image_step",
    "is_large",
    "reject_file",
    "reject_step",
    "run_file",
    "run_step",
]
