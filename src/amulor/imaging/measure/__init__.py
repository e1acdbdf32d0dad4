"""Lengths, angles, areas and fitted shapes in range images, with uncertainty."""

from amulor.imaging.measure.figures import (
    Check,
    Checked,
    Measurement,
    angle,
    area,
    compared,
    distance,
    height,
    read_checks,
)
from amulor.imaging.measure.fits import Fit, circle, cylinder, plane, sphere
from amulor.imaging.measure.points import Points, points_of, reference_basis
from amulor.imaging.measure.round_objects import Revolution, revolution
from amulor.imaging.measure.volumes import volume

__all__ = [
    "Check",
    "Checked",
    "Fit",
    "Measurement",
    "Points",
    "Revolution",
    "angle",
    "area",
    "circle",
    "compared",
    "cylinder",
    "distance",
    "height",
    "plane",
    "points_of",
    "read_checks",
    "reference_basis",
    "revolution",
    "sphere",
    "volume",
]


def __dir__() -> list[str]:
    """List the public names without the modules that define them."""
    return sorted(__all__)
