"""Products of a range image: rasters, contours, sections, deviations.

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
    """List the public names without the modules that define them."""
    return sorted(__all__)
