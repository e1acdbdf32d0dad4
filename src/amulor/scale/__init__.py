"""The same steps on files larger than memory: row tile by row tile."""

from amulor.scale.files import Summary, image_file, is_large, reject_file, run_file
from amulor.scale.steps import image_step, reject_step
from amulor.scale.tiled import TiledStep, run_step

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
