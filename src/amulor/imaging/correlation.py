"""Uncertainty of mean ranges and range differences, with correlated pixel errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from amulor import cube as cubes
from amulor.cube.schema import ALIKE_TERMS, RANGE_PREFIX, WATER_TERMS
from amulor.errors import CubeError
from amulor.imaging.common import own_variance, phase_cosines

Floats = NDArray[np.float64]

#: A matrix over more pixels would not fit into memory beside others.
_MOST_PIXELS = 4096


@dataclass(frozen=True)
class RangeFigure:
    """Mean slant range, or difference of two means, with its uncertainty.

    Examples
    --------
    Shared errors add to what noise leaves, in quadrature:

    >>> from amulor.imaging.correlation import RangeFigure
    >>> figure = RangeFigure(value=1.5, uncertainty=5e-4, random=3e-4)
    >>> shared = (figure.uncertainty**2 - figure.random**2) ** 0.5
    >>> print(f"{1e3 * shared:.1f} mm")
    0.4 mm
    """

    value: float
    """Mean, or difference of means [m]."""
    uncertainty: float
    """Standard uncertainty, shared errors included [m]."""
    random: float
    """Part of the uncertainty from noise [m]."""


def covariance(image: xr.Dataset, pixels: ArrayLike) -> Floats:
    r"""Covariance matrix of the slant ranges of selected pixels.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    pixels : array_like of bool, shape (row, column)
        Selected pixels; unusable pixels are omitted.

    Returns
    -------
    ndarray, shape (n, n)
        Covariance, with pixels in the order of the rows of the image [m^2].

    Raises
    ------
    CubeError
        If the shapes differ, or there are no pixels or too many.

    Notes
    -----
    Noise is independent from pixel to pixel, except for ranges from phasor lines, whose
    windows overlap. The reference is a polynomial over the
    scan, of the degree that the image states: its errors at two pixels correlate like
    :math:`\phi_i^T (\Phi^T \Phi)^{-1} \phi_j` with the monomials :math:`\phi`, for
    shots that cover the scan evenly. An error of the water signal shifts the phase by
    its component across the target's phasor, whose direction changes with the range.
    Pixels at different ranges are therefore less correlated, by the cosine of their
    phase difference, averaged over the frequencies. Without a stated degree, all pixels
    are correlated alike. The drift of the water and the column behind the target are
    common to all pixels, apart from that cosine. Late light, delay, group index and
    geometry shift all pixels alike.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.polarization(
    ...     samples.cube("ladder"),
    ...     target_ratio=0.242, water_ratio=0.099, water_fluctuation=0.137,
    ... )
    >>> image = imaging.range_image(target)
    >>> from amulor.imaging.correlation import covariance
    >>> pixels = np.zeros(image["slant_range"].shape, dtype=bool)
    >>> pixels[20, 10:13] = True
    >>> matrix = covariance(image, pixels)
    >>> print((1e6 * matrix).round(1))  # [mm^2]
    [[51.   0.   0. ]
     [ 0.  50.7  0. ]
     [ 0.   0.  55. ]]
    """
    image = cubes.checked(image, "range_image")
    which = _usable(image, pixels)
    count = int(which.sum())
    if count > _MOST_PIXELS:
        raise CubeError(
            f"{count} pixels are too many for a covariance matrix, at most "
            f"{_MOST_PIXELS} fit; take a smaller region"
        )
    total = image["slant_range_uncertainty"].values[which] ** 2
    if "slant_range_common_uncertainty" not in image:
        return _of_noise(image, which, total)
    alike, of_water = (
        [
            image[f"{RANGE_PREFIX}{name}"].values[which]
            for name in names
            if f"{RANGE_PREFIX}{name}" in image
        ]
        for names in (ALIKE_TERMS, WATER_TERMS)
    )
    squares = image["slant_range_common_uncertainty"].values[which] ** 2
    explained = sum(term**2 for term in alike + of_water)
    shared = np.sqrt(np.maximum(squares - explained, 0.0))
    turn = phase_cosines(image, image["slant_range"].values[which])
    matrix = np.outer(shared, shared) * _along_the_scan(image, which) * turn
    matrix += sum(np.outer(term, term) for term in of_water) * turn
    matrix += sum(np.outer(term, term) for term in alike)
    matrix += _of_noise(image, which, np.maximum(total - squares, 0.0))
    matrix[np.diag_indices(count)] = total
    return matrix


def _of_noise(image: xr.Dataset, which: NDArray[np.bool_], variance: Floats) -> Floats:
    """Covariance of the noise, independent except in windows of phasor lines."""
    matrix = np.diag(variance)
    if "phasor_line_window" not in image.attrs:
        return matrix
    width = float(image.attrs["phasor_line_window"])
    matrix = np.sqrt(np.outer(variance, variance))
    for place in np.nonzero(which):
        matrix *= np.clip(1 - np.abs(place[:, None] - place) / width, 0, 1)
    return matrix


def mean_range(image: xr.Dataset, region: ArrayLike) -> RangeFigure:
    """Mean slant range of a region.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    region : array_like of bool, shape (row, column)
        Pixels to use; unusable pixels are omitted.

    Returns
    -------
    RangeFigure
        Mean with its uncertainty.

    Raises
    ------
    CubeError
        As `covariance`.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> image["slant_range"] = image["truth_slant_range"]  # no water, no noise
    >>> from amulor.imaging.correlation import mean_range
    >>> tread = np.zeros(image["slant_range"].shape, dtype=bool)
    >>> tread[5:35, 3:15] = True
    >>> figure = mean_range(image, tread)
    >>> print(f"{figure.value:.3f} m")
    1.501 m
    """
    image = cubes.checked(image, "range_image")
    which = _usable(image, region)
    weight = np.full(int(which.sum()), 1 / which.sum())
    return _figure(image, which, weight)


def range_difference(
    image: xr.Dataset, first: ArrayLike, second: ArrayLike
) -> RangeFigure:
    """Difference of the mean slant ranges of two regions.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    first, second : array_like of bool, shape (row, column)
        Pixels of each region, without common pixels.

    Returns
    -------
    RangeFigure
        Mean of the second less mean of the first; common errors cancel.

    Raises
    ------
    CubeError
        As `covariance`, or if the regions overlap.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> image["slant_range"] = image["truth_slant_range"]  # no water, no noise
    >>> from amulor.imaging.correlation import range_difference
    >>> first = np.zeros(image["slant_range"].shape, dtype=bool)
    >>> second = first.copy()
    >>> first[5:35, 25:35], second[5:35, 3:15] = True, True
    >>> step = range_difference(image, first, second)
    >>> print(f"{1e3 * step.value:.1f} mm")  # the ladder's first step
    40.4 mm
    """
    image = cubes.checked(image, "range_image")
    near, far = _usable(image, first), _usable(image, second)
    if np.any(near & far):
        raise CubeError(
            f"the regions share {int(np.sum(near & far))} pixels; choose regions "
            "apart from each other"
        )
    union = near | far
    weight = np.where(far[union], 1 / far.sum(), -1 / near.sum())
    return _figure(image, union, weight)


def _figure(image: xr.Dataset, which: NDArray[np.bool_], weight: Floats) -> RangeFigure:
    matrix = covariance(image, which)
    noise = own_variance(image)[which]
    variance = float(weight @ matrix @ weight)
    random = float(weight**2 @ noise)
    return RangeFigure(
        value=float(weight @ image["slant_range"].values[which]),
        uncertainty=max(variance, 0.0) ** 0.5,
        random=max(random, 0.0) ** 0.5,
    )


def _usable(image: xr.Dataset, pixels: ArrayLike) -> NDArray[np.bool_]:
    mask = np.asarray(pixels, dtype=bool)
    if mask.shape != image["slant_range"].shape:
        raise CubeError(
            f"the region has the shape {mask.shape}, the image "
            f"{image['slant_range'].shape}; they must agree"
        )
    which: NDArray[np.bool_] = mask & np.isfinite(image["slant_range"].values)
    if not which.any():
        raise CubeError("the region has no usable pixel; enlarge it")
    return which


def _along_the_scan(image: xr.Dataset, which: NDArray[np.bool_]) -> Floats:
    """Correlation of open-water reference errors between pixels, shape (n, n)."""
    if "open_water_degree" not in image.attrs:
        return np.ones((int(which.sum()), int(which.sum())))
    degree = int(np.max(image.attrs["open_water_degree"]))
    axes = []
    for name in ("azimuth", "elevation"):
        values = image[name].values
        span = np.ptp(values)
        axes.append((values - values.mean()) * (2 / span if span > 0 else 0.0))
    columns = np.stack(
        [
            (axes[0] ** i * axes[1] ** j).ravel()
            for i in range(degree + 1)
            for j in range(degree + 1 - i)
        ],
        axis=1,
    )
    basis, singular, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, singular > 1e-9 * singular[0]]
    vectors = basis[which.ravel()]
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors @ vectors.T)
