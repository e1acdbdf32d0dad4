"""Range images of a site's scans: read from files, or computed from cubes."""

from __future__ import annotations

from typing import Any

import xarray as xr

from amulor import cube as cubes
from amulor import io, pipeline
from amulor.errors import CubeError
from amulor.imaging.observation import readable_survey
from amulor.site.description import Processing, SiteScan
from amulor.site.registration.line import by_direction

#: Remedy for a scan whose error is unknown.
WHAT_TO_DO = (
    "scans are placed and merged by their errors: remove the water with amulor reject, "
    "and state the nearest and farthest range with amulor image --nearest --farthest"
)


def range_image_of(scan: SiteScan) -> xr.Dataset:
    """Return the range image of a scan, with mixed pixels and outliers flagged.

    A line has its rows sorted by the direction of the beam.
    """
    cube = io.read_cube(scan.file)
    if scan.trajectory is None:
        refuse_vehicle(cube, name=scan.name)
    image = as_image(cube, processing=scan.processing, name=scan.name)
    return image if scan.trajectory is None else by_direction(image)


def check_level(level: str, *, processed: bool, name: str) -> None:
    """Raise unless a file is a range image, or can be processed to a range image."""
    if level == "range_image":
        return
    if level not in ("samples", "target_signal"):
        raise CubeError(
            f"scan {name!r}: the file holds {level or 'no level'!r}; a site takes "
            "range images, target signals or samples"
        )
    if not processed:
        raise CubeError(
            f"scan {name!r}: the file holds {level}, not a range image; make one with "
            "amulor reject and amulor image, or state [scan.processing] with a method"
        )


def refuse_vehicle(cube: xr.Dataset, *, name: str) -> None:
    """Raise for a scan from a vehicle, whose pixels have different poses."""
    survey = readable_survey(cube)
    if survey is not None and survey.platform is not None:
        raise CubeError(
            f"scan {name!r}: its survey has a section [platform], so each pixel has a "
            "pose of its own; state the file of its trajectory in [scan.trajectory]"
        )


def options_of(processing: Processing | None) -> dict[str, Any]:
    """Return method, channel and range interval from the settings of a scan."""
    if processing is None:
        return {"method": None, "polarization": None, "interval": None}
    near, far = processing.nearest, processing.farthest
    return {
        "method": processing.method,
        "polarization": processing.polarization,
        "interval": None if near is None or far is None else (near, far),
    }


def as_image(
    cube: xr.Dataset, *, processing: Processing | None, name: str
) -> xr.Dataset:
    """Process a scan's cube to a range image; raise if its range errors are unknown."""
    level = str(cube.attrs.get("level", ""))
    check_level(level, processed=processing is not None, name=name)
    try:
        image = pipeline.run(cube, **options_of(processing))
    except ValueError as error:
        raise CubeError(f"scan {name!r}: {error}") from None
    words = cubes.error_unknown(image)
    if words:
        raise CubeError(f"scan {name!r}: {words}; {WHAT_TO_DO}")
    return image
