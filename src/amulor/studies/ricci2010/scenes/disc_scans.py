"""Scan of a bent disc in Maalox water, and its outlines in the intensity image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from amulor import imaging, rejection
from amulor.imaging import metrics
from amulor.simulation import DiffusionModel, simulate
from amulor.studies.ricci2010.scenes.scan_surveys import (
    ScanField,
    around,
    images,
    survey_of,
    water_of,
)
from amulor.studies.ricci2010.study import Study
from amulor.survey import Survey
from amulor.units import write

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Width of the scan over the diameter of the disc [1].
_ROOM = 1.2
#: Variance of the number of points of a square lattice within a smooth outline, over
#: the outline's length in units of the lattice, for lattices placed by chance.
_LATTICE = 0.0728
#: The middle of the scan is that of the disc: eight equal sectors err alike.
_SECTORS = 8


@dataclass(frozen=True)
class Outline:
    """Outline in the intensity image, with its equivalent diameter."""

    diameter: float
    """Diameter of a circle of equal area [m]."""
    uncertainty: float
    """Standard uncertainty, from pixels cut by the outline [m]."""


@dataclass(frozen=True)
class Outlines:
    """Outlines of the disc in an intensity image."""

    rim: Outline | None
    """Outer rim of the disc; None without bright pixels."""
    central_hole: Outline | None
    """Outline of the largest hole."""
    small_holes: tuple[Outline, ...]
    """Outlines of the other holes, largest first."""


@dataclass(frozen=True, kw_only=True)
class DiscScan:
    """Scan of the disc, before and after water subtraction."""

    survey: Survey
    """Simulated survey."""
    pitch: float
    """Spacing of neighboring pixels on the disc [m]."""
    truth: Floats
    """True slant range, NaN outside the disc, shape (row, column) [m]."""
    inside: Mask
    """Mask of pixels on the disc, edges excluded."""
    outside: Mask
    """Mask of pixels beside the disc and in its holes, edges excluded."""
    raw: dict[str, xr.Dataset]
    """Range image before water subtraction, by channel."""
    subtracted: dict[str, xr.Dataset]
    """Range image after water subtraction, by channel."""

    def contrast(self, image: xr.Dataset) -> metrics.Contrast:
        """Return the intensity contrast between the disc and its surroundings."""
        return metrics.contrast(image, self.inside, self.outside)

    def error(self, image: xr.Dataset) -> tuple[float, float]:
        """Return RMS and standard deviation of the range error on the disc [m]."""
        error = (image["slant_range"].values - self.truth)[self.inside]
        error = error[np.isfinite(error)]
        if error.size < 2:
            return math.nan, math.nan
        return float(np.sqrt(np.mean(error**2))), float(error.std(ddof=1))

    def moved(self, image: xr.Dataset) -> float:
        """Return the median range error of the disc, positive if too near [m]."""
        error = (self.truth - image["slant_range"].values)[self.inside]
        return float(np.nanmedian(error))


def bent_disc(study: Study) -> DiscScan:
    """Simulate the scan of the bent disc with holes, cross- and co-polarized."""
    distance = study["short_distance"]
    # As fine as the scan of the ladder.
    ladder = 2 * distance * math.tan(study["scan_width"] / 2)
    pitch = ladder / round(study["scan_columns"])
    width = _ROOM * study["disc_diameter"]
    count = math.ceil(width / pitch) + 1
    span = 2 * math.atan((count - 1) * pitch / 2 / distance)
    survey = survey_of(
        study,
        name="Bent disc in Maalox water",
        water=water_of(study, "maalox"),
        field=ScanField(
            distance=distance,
            baseline=study["short_baseline"],
            columns=count,
            rows=count,
            width=span,
            height=span,
        ),
        target=f"""
kind = "disc"
diameter = "{write(study["disc_diameter"], "length")}"
central_hole = "{write(study["disc_central_hole"], "length")}"
hole_count = 4
hole_diameter = "{write(study["disc_holes"], "length")}"
hole_circle = "{write(study["disc_hole_circle"], "length")}"
curvature_radius = "{write(study["disc_bend"], "length")}"
""",
        polarizations=["VH", "VV"],
    )
    interval = around(distance)
    # The paper's form of the water, whatever the default is.
    cube = simulate(survey, rng=study.rng("disc"), model=DiffusionModel())
    truth = cube.amulor.truth["slant_range"].values
    met = np.isfinite(truth)

    return DiscScan(
        survey=survey,
        pitch=pitch,
        truth=truth,
        inside=ndimage.binary_erosion(met),
        outside=ndimage.binary_erosion(~met, border_value=1),
        raw=images(rejection.keep_water(cube), interval=interval),
        subtracted=images(
            rejection.open_water(cube, interval=interval), interval=interval
        ),
    )


def bright(image: xr.Dataset) -> Mask:
    """Return the mask of bright pixels, above the mid-level of the intensity image."""
    intensity = image["intensity"].values
    over: Mask = intensity > _halfway(intensity)
    return over


def outlines(image: xr.Dataset, *, distance: float) -> Outlines:
    """Measure the outlines of the disc in an intensity image."""
    lit = bright(image)
    patches, count = ndimage.label(lit)
    if count == 0:
        return Outlines(None, None, ())
    sizes = ndimage.sum_labels(lit, patches, np.arange(1, count + 1))
    disc = patches == 1 + int(np.argmax(sizes))
    filled = ndimage.binary_fill_holes(disc)
    area = _pixel_areas(image, disc, distance=distance)
    step = math.sqrt(float(np.mean(area[filled])))
    # A hole has no corners in common with the surroundings of the disc.
    holes, number = ndimage.label(filled & ~disc)
    areas = [float(area[holes == i].sum()) for i in range(1, number + 1)]
    result = [_circle(size, step) for size in sorted(areas, reverse=True)]
    return Outlines(
        rim=_circle(float(area[filled].sum()), step),
        central_hole=result[0] if result else None,
        small_holes=tuple(result[1:]),
    )


def _circle(area: float, step: float) -> Outline:
    """Return the equivalent diameter of an area of pixels, with its uncertainty."""
    diameter = math.sqrt(4 * area / math.pi)
    count = math.sqrt(_SECTORS * _LATTICE * math.pi * diameter / step)
    return Outline(diameter, 2 * count * step**2 / (math.pi * diameter))


def _halfway(values: Floats) -> float:
    """Return the mid-level between the means of bright and dark pixels."""
    level = float(values.mean())
    for _ in range(_ROUNDS):
        dark, light = values[values <= level], values[values > level]
        if dark.size == 0 or light.size == 0:
            break
        level = float(dark.mean() + light.mean()) / 2
    return level


#: Iterations of the mid-level, which converges after about five.
_ROUNDS = 30


def _pixel_areas(image: xr.Dataset, disc: Mask, *, distance: float) -> Floats:
    """Return the area of each pixel in the plane perpendicular to the middle beam.

    A smooth surface through the ranges of the disc, of the second degree in the
    direction, gives its holes a distance, too.
    """
    across, upwards = np.tan(image["azimuth"].values), np.tan(image["elevation"].values)
    ones = np.ones_like(across)
    terms = np.stack(
        [ones, across, upwards, across**2, across * upwards, upwards**2], axis=-1
    )
    cloud = imaging.point_cloud(image)
    row, column = cloud["row"].values, cloud["column"].values
    on = disc[row, column]
    forward = distance * ones
    if on.sum() > terms.shape[-1]:
        design = terms[row[on], column[on]]
        fitted, *_ = np.linalg.lstsq(design, cloud["z"].values[on], rcond=None)
        forward = terms @ fitted
    right, up = forward * across, forward * upwards
    right_by_row, right_by_column = np.gradient(right)
    up_by_row, up_by_column = np.gradient(up)
    areas: Floats = np.abs(right_by_row * up_by_column - right_by_column * up_by_row)
    return areas
