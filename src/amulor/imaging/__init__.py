"""Range images and point clouds from the target signal, and their quality."""

from __future__ import annotations

from typing import TYPE_CHECKING

from amulor import _lazy
from amulor.imaging import correlation, metrics
from amulor.imaging.budget import ErrorBudget, error_budget
from amulor.imaging.edges import flag_mixed, mixed_pixels
from amulor.imaging.frame import Axes, Frame, frame_of
from amulor.imaging.moving import MovingFrame, moving_frame
from amulor.imaging.outliers import flag_outliers, outlying_pixels
from amulor.imaging.patch_test import patch_test
from amulor.imaging.point_cloud import point_cloud
from amulor.imaging.range_image import range_image
from amulor.imaging.selection import leave_out
from amulor.imaging.unwrap import unwrapped_range_image

if TYPE_CHECKING:
    from amulor.imaging import measure, products

__all__ = [
    "Axes",
    "ErrorBudget",
    "Frame",
    "MovingFrame",
    "correlation",
    "error_budget",
    "flag_mixed",
    "flag_outliers",
    "frame_of",
    "leave_out",
    "measure",
    "metrics",
    "mixed_pixels",
    "moving_frame",
    "outlying_pixels",
    "patch_test",
    "point_cloud",
    "products",
    "range_image",
    "unwrapped_range_image",
]

if not TYPE_CHECKING:
    __getattr__ = _lazy.attach(__name__, __all__)[0]


def __dir__() -> list[str]:
    """List the public names without the modules that define them."""
    return sorted(__all__)
