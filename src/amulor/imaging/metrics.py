"""Quality metrics of a range image: flatness, step heights, contrast."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from amulor import cube as cubes
from amulor.cube import UNUSABLE
from amulor.cube.schema import ALIKE_TERMS, RANGE_PREFIX, WATER_TERMS
from amulor.errors import CubeError
from amulor.imaging.common import own_variance, phase_cosines
from amulor.imaging.point_cloud import point_cloud

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PlaneFit:
    """Deviation of a region of a range image from a plane.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> image["slant_range"] = image["truth_slant_range"]  # no water, no noise
    >>> tread = np.zeros(image["slant_range"].shape, dtype=bool)
    >>> tread[5:35, 3:15] = True
    >>> fit = imaging.metrics.plane_residual(image, tread)
    >>> print(fit.points, f"normal towards the instrument: {fit.normal[2]:.2f}")
    360 normal towards the instrument: -1.00
    """

    residual: float
    """Root mean square distance of the points from their plane [m]."""
    expected: float
    """Residual expected from the stated uncertainties [m]."""
    normal: tuple[float, float, float]
    """Unit normal, towards the instrument [1]."""
    points: int
    """Number of fitted points [1]."""


@dataclass(frozen=True)
class StepHeight:
    """Height of one step between two parallel planes.

    Examples
    --------
    >>> from amulor.imaging.metrics import StepHeight
    >>> step = StepHeight(height=0.0102, uncertainty=0.0004, random=0.0003)
    >>> print(f"off by {(step.height - 0.01) / step.uncertainty:.1f} uncertainties")
    off by 0.5 uncertainties
    """

    height: float
    """Distance of the second plane from the first, towards the instrument [m]."""
    uncertainty: float
    """Standard uncertainty from noise, shared open-water reference and residual bias;
    NaN if the range errors are unknown."""
    random: float
    """Part of the uncertainty from noise [m]."""


@dataclass(frozen=True)
class Contrast:
    """Amplitude contrast of the target with its surroundings.

    Examples
    --------
    A target three times as bright as what is around it: (3 - 1) / (3 + 1).

    >>> from amulor.imaging.metrics import Contrast
    >>> Contrast(value=(3 - 1) / (3 + 1), uncertainty=0.01).value
    0.5
    """

    value: float
    """Contrast (target - surround) / (target + surround) of mean amplitudes [1]."""
    uncertainty: float
    """Standard uncertainty, from the scatter of the pixels [1]."""


def plane_residual(image: xr.Dataset, region: ArrayLike | None = None) -> PlaneFit:
    """Fit a plane to a region of a range image.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    region : array_like of bool, shape (row, column), optional
        Pixels to use; unusable pixels are always omitted.

    Returns
    -------
    PlaneFit
        Scatter about the plane, and the scatter expected from the uncertainties.

    Raises
    ------
    CubeError
        If there are fewer than four usable pixels, or all lie on a line.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> image["slant_range"] = image["truth_slant_range"]  # no water, no noise
    >>> tread = np.zeros(image["slant_range"].shape, dtype=bool)
    >>> tread[5:35, 3:15] = True
    >>> fit = imaging.metrics.plane_residual(image, tread)
    >>> print(f"{1e3 * fit.residual:.2f} mm from flat")
    0.00 mm from flat
    """
    image = cubes.checked(image, "range_image")
    shape = image["quality_flag"].shape
    label = np.ones(shape, int) if region is None else np.asarray(region).astype(int)
    points, number, sigma, _ = _regions(image, label, [1])
    if len(number) < 4:
        raise CubeError(
            f"a plane needs at least 4 usable pixels, the region has {len(number)}; "
            "choose a larger one"
        )
    centre = points.mean(axis=0)
    _refuse_a_line(points[:, :2])
    _, singular, axes = np.linalg.svd(points - centre, full_matrices=False)
    normal = axes[2] * (-1.0 if axes[2, 2] > 0 else 1.0)
    freedom = len(points) - 3
    # Uncertainties are along the beam, distances along the normal.
    beam = points / np.linalg.norm(points, axis=1, keepdims=True)
    cosine = np.abs(beam @ normal)
    return PlaneFit(
        residual=float(singular[2] / np.sqrt(freedom)),
        expected=float(np.sqrt(np.mean((sigma * cosine) ** 2))),
        normal=(float(normal[0]), float(normal[1]), float(normal[2])),
        points=len(points),
    )


def step_heights(image: xr.Dataset, regions: ArrayLike) -> list[StepHeight]:
    """Measure the steps between parallel planes, such as the treads of a ladder.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    regions : array_like of int, shape (row, column)
        Number of the plane of each pixel, 1, 2, ...; 0 for none. Exclude pixels at
        edges, where a beam meets two planes.

    Returns
    -------
    list of StepHeight
        Steps from plane 1 to 2, 2 to 3 and so on, positive towards the instrument.

    Raises
    ------
    CubeError
        If a plane has fewer than three usable pixels, or all pixels lie in one line.

    Notes
    -----
    One least-squares fit of z = z_i + a x + b y with slopes common to all planes,
    weighted by the stated uncertainties. If the scatter is larger than stated, the
    errors are enlarged in proportion. The error common to all pixels is added in full,
    and so is the difference between the bias estimates of the two planes, both in
    quadrature. This is an upper limit, since neighbors share most of these errors. Late
    light, delay, group index and geometry shift all pixels alike; only their difference
    between the two planes is added. The same applies to drift and column, which depend
    on the phase of the target.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> image["slant_range"] = image["truth_slant_range"]  # no water, no noise
    >>> planes = np.zeros(image["slant_range"].shape, dtype=int)
    >>> planes[5:35, 3:15], planes[5:35, 25:35] = 1, 2
    >>> (step,) = imaging.metrics.step_heights(image, planes)
    >>> print(f"{1e3 * step.height:.1f} mm")
    40.0 mm
    """
    image = cubes.checked(image, "range_image")
    label = np.asarray(regions)
    numbers = list(range(1, int(label.max(initial=0)) + 1))
    points, number, sigma, pixel = _regions(image, label, numbers)
    for plane in numbers:
        count = int(np.sum(number == plane))
        if count < 3:
            raise CubeError(
                f"plane {plane} has {count} usable pixels, needed are at least 3; "
                "enlarge its region"
            )
    _refuse_a_line(points[:, :2])
    design = np.concatenate(
        [number[:, None] == np.array(numbers), points[:, :2] - points[:, :2].mean(0)],
        axis=1,
    ).astype(float)
    root = 1 / sigma
    solution, *_ = np.linalg.lstsq(
        design * root[:, None], points[:, 2] * root, rcond=None
    )
    residual = (points[:, 2] - design @ solution) * root
    scatter = max(float(residual @ residual) / (len(residual) - design.shape[1]), 1.0)
    inverse = np.linalg.inv((design * root[:, None]).T @ (design * root[:, None]))
    covariance = inverse * scatter
    lean = np.hypot(1.0, np.hypot(*solution[-2:]))
    common = _mean_of(image, "slant_range_common_uncertainty", number, pixel, numbers)
    alike, of_water = (
        [
            _mean_of(image, f"{RANGE_PREFIX}{name}", number, pixel, numbers)
            for name in names
        ]
        for names in (ALIKE_TERMS, WATER_TERMS)
    )
    explained = sum(term**2 for term in alike + of_water)
    shared = np.sqrt(np.maximum(common**2 - explained, 0.0))
    uncertainty = _mean_of(image, "slant_range_uncertainty", number, pixel, numbers)
    distance = _mean_of(image, "slant_range", number, pixel, numbers)
    # Images that do not say their frequencies have no such terms either.
    has_frequencies = "modulation_frequencies" in image.attrs
    cosines = (
        phase_cosines(image, distance) if has_frequencies else np.eye(len(numbers))
    )
    bias = _mean_of(image, "slant_range_bias", number, pixel, numbers)
    steps = []
    for i in range(len(numbers) - 1):
        random = np.sqrt(
            covariance[i, i] + covariance[i + 1, i + 1] - 2 * covariance[i, i + 1]
        )
        total = np.sqrt(
            random**2
            + shared[i] ** 2
            + shared[i + 1] ** 2
            + (bias[i + 1] - bias[i]) ** 2
            + sum((term[i + 1] - term[i]) ** 2 for term in alike)
            + sum(
                term[i] ** 2
                + term[i + 1] ** 2
                - 2 * term[i] * term[i + 1] * cosines[i, i + 1]
                for term in of_water
            )
        )
        known_error = np.isfinite(uncertainty[i] + uncertainty[i + 1])
        steps.append(
            StepHeight(
                height=float((solution[i] - solution[i + 1]) / lean),
                uncertainty=float(total / lean) if known_error else math.nan,
                random=float(random / lean),
            )
        )
    return steps


def _refuse_a_line(places: Floats) -> None:
    """Raise if the points do not constrain the slope of a plane."""
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    if spread[1] < 1e-6 * spread[0]:
        raise CubeError(
            "the points lie on a line, which leaves the lean of a plane open; take "
            "more than one row and one column"
        )


def contrast(image: xr.Dataset, target: ArrayLike, surround: ArrayLike) -> Contrast:
    """Amplitude contrast of a target with its surroundings.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`; the amplitude is used wherever it was measured.
    target, surround : array_like of bool, shape (row, column)
        Pixels of each.

    Returns
    -------
    Contrast
        1 if the surroundings are dark, 0 if they are as bright as the target.

    Raises
    ------
    CubeError
        If one of the two has fewer than two pixels.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> from amulor.imaging.metrics import contrast
    >>> image["intensity"][:] = 1.0
    >>> target = np.zeros(image["intensity"].shape, dtype=bool)
    >>> target[10:30, 40:60] = True
    >>> image["intensity"].values[target] = 3.0
    >>> contrast(image, target, ~target).value
    0.5
    """
    image = cubes.checked(image, "range_image")
    means, errors = [], []
    for name, region in (("target", target), ("surround", surround)):
        values = image["intensity"].values[np.asarray(region, dtype=bool)]
        values = values[np.isfinite(values)]
        if len(values) < 2:
            raise CubeError(f"the {name} has {len(values)} pixels, needed are 2")
        means.append(values.mean())
        errors.append(values.std(ddof=1) / np.sqrt(len(values)))
    (a, b), (da, db) = means, errors
    slope = 2 / (a + b) ** 2
    return Contrast(
        value=float((a - b) / (a + b)),
        uncertainty=float(slope * np.hypot(b * da, a * db)),
    )


def _regions(
    image: xr.Dataset, label: NDArray[np.intp], numbers: list[int]
) -> tuple[Floats, NDArray[np.intp], Floats, tuple[NDArray[np.intp], ...]]:
    """Return positions, region numbers, noise, and indices of usable labeled pixels."""
    if label.shape != image["quality_flag"].shape:
        raise CubeError(
            f"the regions have the shape {label.shape}, the image "
            f"{image['quality_flag'].shape}; they must agree"
        )
    cloud = point_cloud(image)
    row, column = cloud["row"].values, cloud["column"].values
    keep = np.isin(label[row, column], numbers)
    points = np.stack([cloud[axis].values for axis in "xyz"], axis=1)[keep]
    row, column = row[keep], column[keep]
    variance = cloud["slant_range_uncertainty"].values[keep] ** 2
    # If the errors are unknown, planes are weighted by the noise of the pixels.
    unknown = np.isnan(variance)
    variance = np.where(unknown, own_variance(image)[row, column], variance)
    for name in (*ALIKE_TERMS, *WATER_TERMS):
        if f"{RANGE_PREFIX}{name}" in image:
            term = image[f"{RANGE_PREFIX}{name}"].values[row, column]
            variance -= np.where(unknown, 0.0, term**2)
    sigma = np.sqrt(np.maximum(variance, np.finfo(float).tiny))
    assert not np.any(image["quality_flag"].values[row, column] & UNUSABLE)
    return points, label[row, column], sigma, (row, column)


def _mean_of(
    image: xr.Dataset,
    variable: str,
    number: NDArray[np.intp],
    pixel: tuple[NDArray[np.intp], ...],
    numbers: list[int],
) -> Floats:
    if variable not in image:
        return np.zeros(len(numbers))
    values = image[variable].values[pixel]
    return np.array([np.mean(values[number == plane]) for plane in numbers])
