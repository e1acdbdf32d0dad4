"""Range images of a site's scans, made from cubes where these are no images yet."""

from __future__ import annotations

import xarray as xr

from amulor import cube as cubes
from amulor import imaging, io, rejection
from amulor.errors import CubeError
from amulor.site.description import Processing, SiteScan

#: Remedy for a scan whose error is not known.
WHAT_TO_DO = (
    "scans are placed and merged by their errors: remove the water with amulor reject, "
    "and state the nearest and farthest range with amulor image --nearest --farthest"
)


def range_image_of(scan: SiteScan) -> xr.Dataset:
    """Return the range image of a scan, edges and outliers marked."""
    return as_image(io.read_cube(scan.file), processing=scan.processing, name=scan.name)


def as_image(
    cube: xr.Dataset, *, processing: Processing | None, name: str
) -> xr.Dataset:
    """Return the range image of a cube of any level before it, or of one."""
    level = str(cube.attrs.get("level", ""))
    if level == "range_image":
        return _with_errors(cubes.checked(cube, "range_image"), name)
    if level not in ("samples", "target_signal"):
        raise CubeError(
            f"scan {name!r}: the file holds {level or 'no level'!r}; a site takes "
            "range images, target signals or samples"
        )
    if processing is None:
        raise CubeError(
            f"scan {name!r}: the file holds {level}, not a range image; make one with "
            "amulor reject and amulor image, or state [scan.processing] with a method"
        )
    interval = None
    if processing.nearest is not None and processing.farthest is not None:
        interval = (processing.nearest, processing.farthest)
    try:
        if level == "samples":
            cube = rejection.reject(cube, method=processing.method, interval=interval)
        image = imaging.range_image(
            cube, polarization=processing.polarization, interval=interval
        )
    except ValueError as error:
        raise CubeError(f"scan {name!r}: {error}") from None
    return imaging.flag_outliers(imaging.flag_mixed(_with_errors(image, name)))


def _with_errors(image: xr.Dataset, name: str) -> xr.Dataset:
    """Return an image whose ranges state their errors, or raise."""
    words = cubes.error_unknown(image)
    if words:
        raise CubeError(f"scan {name!r}: {words}; {WHAT_TO_DO}")
    return image
