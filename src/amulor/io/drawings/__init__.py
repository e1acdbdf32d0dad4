"""Writes drawings in the formats of surveyors: GeoTIFF, DXF, SVG, tables."""

from amulor.io.drawings.dxf import write_dxf
from amulor.io.drawings.geotiff import Band, write_geotiff
from amulor.io.drawings.lines import Drawing, Line
from amulor.io.drawings.picture import write_picture
from amulor.io.drawings.svg import write_svg
from amulor.io.drawings.table import write_table

__all__ = [
    "Band",
    "Drawing",
    "Line",
    "write_dxf",
    "write_geotiff",
    "write_picture",
    "write_svg",
    "write_table",
]


def __dir__() -> list[str]:
    """List the public names, not the modules that they come from."""
    return sorted(__all__)
