"""What is made of a range image and handed over: rasters, contours, sections, changes.

Each carries the standard uncertainty of its numbers and the frame of its coordinates.
"""

from amulor.imaging.products.deviation import Deviation, deviation
from amulor.imaging.products.raster import Contour, Raster, contours, raster
from amulor.imaging.products.section import Section, section
from amulor.imaging.products.surface import Plane, Surface, plane_of, surface

__all__ = [
    "Contour",
    "Deviation",
    "Plane",
    "Raster",
    "Section",
    "Surface",
    "contours",
    "deviation",
    "plane_of",
    "raster",
    "section",
    "surface",
]


def __dir__() -> list[str]:
    """List the public names, not the modules that they come from."""
    return sorted(__all__)
