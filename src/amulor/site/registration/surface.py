"""Surface of a scan: smooth patches, normals, and range errors that pixels share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from amulor.cube import UNUSABLE, QualityFlag
from amulor.cube.schema import ALIKE_TERMS, RANGE_PREFIX, WATER_TERMS
from amulor.errors import CubeError
from amulor.imaging.common import own_variance
from amulor.imaging.observation import geometry_of
from amulor.optics import ranging
from amulor.site.registration.line import Motion

Floats = NDArray[np.float64]

#: Shapes kept for the errors of one scan's reference and water; the rest is below ...
_MOST_SHAPES = 24
#: ... this part of the variance of all [1].
_LEFT_OUT = 1e-9
#: Power of the range in the error terms that grow with it.
_POWER = {"group_index": 1.0, "late_echo": 2.0}


@dataclass(frozen=True, kw_only=True)
class Shared:
    """Range errors common to many pixels: error shapes, each times a random factor."""

    keys: tuple[str, ...]
    """Name of each shape's factor; scans with an equal key share the factor."""
    shapes: Floats
    """Effect of one standard deviation on each range, shape (k, row, column); 0 where
    there is no range [m]."""
    growth: Floats
    """Derivatives of the shapes by the slant range of their pixel [1]."""


def shared_errors(
    image: xr.Dataset,
    *,
    scan: str,
    instrument: str,
    water: str,
    drift: float = 0.0,
    course: Floats | None = None,
) -> Shared:
    r"""Return the range errors that the pixels of a scan have in common.

    Since :math:`\cos(a - b) = \cos a \cos b + \sin a \sin b`, correlations by reference
    and water are sums of products of shapes: terms of the reference polynomial times
    cosine and sine of the phase at each frequency. Few principal components of these
    suffice. `course` is the share of the scan at each pixel, by default of its row.
    Scans with one instrument share its delay and geometry, scans in one water its group
    index and late echoes. Other terms differ from scan to scan.
    """
    distance = image["slant_range"].values
    measured = np.isfinite(distance)
    reach = np.where(measured & (distance > 0), distance, 1.0)
    keys: list[str] = []
    shapes: list[Floats] = []
    growth: list[Floats] = []
    of = {"delay": instrument, "geometry": instrument}
    of |= {"group_index": water, "late_echo": water}
    explained = np.zeros(distance.shape)
    for name in ALIKE_TERMS:
        if f"{RANGE_PREFIX}{name}" in image:
            term = _filled(image[f"{RANGE_PREFIX}{name}"].values, measured)
            explained += term**2
            if term.any():
                keys.append(f"{name}: {of.get(name, scan)}")
                shapes.append(term)
                growth.append(_POWER.get(name, 0.0) * term / reach)
    if drift > 0:
        if course is None:
            course = np.linspace(0.0, 1.0, distance.shape[0])[:, None]
        keys.append(f"drift: {scan}")
        change = drift * np.nan_to_num(2 * course - 1)
        shapes.append(np.where(measured, change, 0.0))
        growth.append(np.zeros(distance.shape))
    components: list[tuple[Floats, Floats]] = []
    turns = _turns(image, reach)
    for name in WATER_TERMS:
        if f"{RANGE_PREFIX}{name}" in image:
            term = _filled(image[f"{RANGE_PREFIX}{name}"].values, measured)
            explained += term**2
            components += [(term * turn, term * change) for turn, change in turns]
    if "slant_range_common_uncertainty" in image:
        common = _filled(image["slant_range_common_uncertainty"].values, measured) ** 2
        rest = np.sqrt(np.maximum(common - explained, 0.0))
        for basis in _basis(image):
            part = rest * basis
            components += [(part * turn, part * change) for turn, change in turns]
    for number, (shape, change) in enumerate(_principal(components)):
        keys.append(f"shape {number + 1}: {scan}")
        shapes.append(shape)
        growth.append(change)
    full_shape = (len(keys), *distance.shape)
    return Shared(
        keys=tuple(keys),
        shapes=np.array(shapes).reshape(full_shape),
        growth=np.array(growth).reshape(full_shape),
    )


def _filled(values: Floats, measured: NDArray[np.bool_]) -> Floats:
    return np.where(measured & np.isfinite(values), values, 0.0)


def _turns(image: xr.Dataset, distance: Floats) -> list[tuple[Floats, Floats]]:
    """Return cosine and sine of the phase at each frequency, and their derivatives.

    The squares of all cosines and sines add up to 1.
    """
    group_index = float(image["geometry"].attrs["group_index"])
    frequency = np.atleast_1d(image.attrs["modulation_frequencies"])
    parts: list[tuple[Floats, Floats]] = []
    size = 1 / np.sqrt(len(frequency))
    for modulation in frequency:
        factor = float(ranging.phase_per_range(modulation, group_index=group_index))
        cosine, sine = np.cos(factor * distance), np.sin(factor * distance)
        parts += [
            (size * cosine, -size * factor * sine),
            (size * sine, size * factor * cosine),
        ]
    return parts


def _basis(image: xr.Dataset) -> list[Floats]:
    """Return basis functions of the open-water fit; their squares add up to 1."""
    shape = image["slant_range"].shape
    if "open_water_degree" not in image.attrs:
        return [np.ones(shape)]
    degree = int(np.max(image.attrs["open_water_degree"]))
    axes = []
    for name in ("azimuth", "elevation"):
        values = image[name].values
        span = np.ptp(values)
        axes.append((values - values.mean()) * (2 / span if span > 0 else 0.0))
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    columns = np.stack([(axes[0] ** i * axes[1] ** j).ravel() for i, j in powers], 1)
    basis, singular, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, singular > 1e-9 * singular[0]]
    basis /= np.linalg.norm(basis, axis=1, keepdims=True)
    return [part.reshape(shape) for part in basis.T]


def _principal(
    shapes: list[tuple[Floats, Floats]],
) -> list[tuple[Floats, Floats]]:
    """Return principal components of error shapes and their slopes, strongest first."""
    if not shapes:
        return []
    flat, slopes = (
        np.array([pair[part].ravel() for pair in shapes]) for part in (0, 1)
    )
    energy, axes = np.linalg.eigh(flat @ flat.T)
    strongest = np.flatnonzero(energy > _LEFT_OUT * max(float(energy.sum()), 1e-300))
    strongest = strongest[::-1][:_MOST_SHAPES]
    size = shapes[0][0].shape
    return [
        ((axes[:, at] @ flat).reshape(size), (axes[:, at] @ slopes).reshape(size))
        for at in strongest
    ]


Flags = NDArray[np.bool_]
Numbers = NDArray[np.intp]

#: Largest chi-square of a smooth window, over that of most [1].
_ROUGH = 3.0
#: Degree of a patch: with a lower degree, the curvature of a sea bed exceeds the noise
#: [1].
_DEGREE = 4
#: Smallest number of patches that place a scan [1].
_FEWEST = 50


@dataclass(frozen=True, kw_only=True)
class ScanSurface:
    """Surface of a scan, pixel by pixel, in instrument axes: right, down, forward."""

    name: str
    """Name of the scan."""
    usable: Flags
    """Mask of pixels with a good range, shape (row, column)."""
    smooth: Flags
    """Mask of pixels whose whole window lies on one smooth surface."""
    origin: Floats
    """Origins of the beams, shape (row, column, 3) [m]."""
    direction: Floats
    """Directions of the beams, shape (row, column, 3) [1]."""
    distance: Floats
    """Slant ranges; NaN without a range [m]."""
    own: Floats
    """Standard uncertainty of the range that is independent of other pixels [m]."""
    shared: Shared
    """Errors of the range that pixels share."""
    patch: Floats
    """Polynomial of inverse range in the window of each pixel, with the terms of
    `powers`, shape (term, row, column) [1/m]."""
    powers: Numbers
    """Powers of row and column in each term of a patch, shape (term, 2) [1]."""
    apart: Floats
    """Position of each pixel, estimated from its neighbors in the window, shape (row,
    column, 3) [m]."""
    kernels: Floats
    """Weights of the least-squares fit of patches, shape (term, window, window) [1]."""
    slope: float
    """Noise of a patch's slope, relative to the noise of a pixel's range [1]."""
    normal: Floats
    """Unit normals towards the instrument, NaN if not smooth, shape (row, column, 3)
    [1]."""
    attributes: dict[str, object]
    """Attributes of the range image, and its group index."""
    motion: Motion | None = None
    """Motion of the instrument during a line; None for a fixed instrument."""

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of all errors that pixels share: of ranges, then of the poses."""
        return (*self.shared.keys, *(() if self.motion is None else self.motion.keys))

    def moved(self, pixel: Numbers, points: Floats) -> Floats:
        """Return shifts of points by the errors of a moving instrument, (k, n, 3)."""
        if self.motion is None:
            return np.zeros((0, len(pixel), 3))
        return self.motion.shifts(pixel, points)

    @property
    def position(self) -> Floats:
        """Points in instrument axes, shape (row, column, 3) [m]."""
        return np.asarray(self.origin + self.distance[..., None] * self.direction)

    @cached_property
    def spacing(self) -> float:
        """Median distance between neighboring points of smooth patches [m]."""
        step = np.linalg.norm(np.diff(self.position, axis=1), axis=-1)
        lengths = step[self.smooth[:, 1:] & self.smooth[:, :-1]]
        return float(np.median(lengths)) if lengths.size else float("nan")

    def points(self, pixel: Numbers) -> Floats:
        """Return the points of given pixel numbers, in instrument axes, (n, 3) [m]."""
        start, ahead = (v.reshape(-1, 3)[pixel] for v in (self.origin, self.direction))
        return np.asarray(start + self.distance.ravel()[pixel, None] * ahead)

    def steps(self, pixel: Numbers) -> Floats:
        """Return changes of beam origin and direction per row, and per column.

        The shape is (2, 2, n, 3) [m, 1].
        """
        shape = self.distance.shape
        places = np.divmod(pixel, shape[1])
        differences = []
        for axis, width in enumerate((shape[1], 1)):
            before = (places[axis] > 0).astype(np.intp)
            after = (places[axis] < shape[axis] - 1).astype(np.intp)
            span = np.maximum(before + after, 1)[:, None]
            ends = pixel + width * after, pixel - width * before
            differences.append(
                [
                    (grid[ends[0]] - grid[ends[1]]) / span
                    for grid in (
                        self.origin.reshape(-1, 3),
                        self.direction.reshape(-1, 3),
                    )
                ]
            )
        return np.asarray(differences).swapaxes(0, 1)


def range_correction(surface: ScanSurface, errors: Mapping[str, float]) -> Floats:
    """Return the effect of estimated shared errors on the ranges of a scan [m]."""
    estimates = np.array([errors.get(key, 0.0) for key in surface.shared.keys])
    return np.asarray(np.tensordot(estimates, surface.shared.shapes, axes=1))


def corrected(surface: ScanSurface, errors: Mapping[str, float]) -> Floats:
    """Return the points of a scan, corrected by its estimated shared errors."""
    distance = surface.distance - range_correction(surface, errors)
    points = np.asarray(surface.origin + distance[..., None] * surface.direction)
    if surface.motion is not None:
        pixel = np.flatnonzero(surface.usable)
        by_poses = np.array([errors.get(key, 0.0) for key in surface.motion.keys])
        flat = points.reshape(-1, 3)
        flat[pixel] -= surface.motion.shift(pixel, flat[pixel], by_poses)
    return points


def usable_pixels(image: xr.Dataset) -> Flags:
    """Return the mask of pixels with a good range on one surface."""
    distance = image["slant_range"].values
    flag = image["quality_flag"].values.astype(np.int64)
    hanging = int(UNUSABLE | QualityFlag.MIXED | QualityFlag.OUTLIER)
    return np.asarray(((flag & hanging) == 0) & np.isfinite(distance) & (distance > 0))


def scan_surface(
    image: xr.Dataset,
    *,
    name: str,
    shared: Shared,
    window: int = 7,
    motion: Motion | None = None,
) -> ScanSurface:
    r"""Compute the surface of a range image: patches, normals and shared errors.

    The inverse range of a plane is linear in the direction of the beam. Patches, which
    are polynomials in inverse range, thus have no error by the angle of incidence.
    Patches of second degree (Savitzky and Golay) neglect changes of curvature, an error
    that neighbors share: 0.03 mm, a third of the pixel noise, moved poses by five
    standard errors. Patches of fourth degree have twice the noise, a sixth of that of
    the compared point. Normals have the second degree, because their noise matters more
    than a small common error. Noise of different scans is independent; see `pair`.
    """
    beam = geometry_of(image).beam
    distance = image["slant_range"].values
    usable = usable_pixels(image)
    direction = np.broadcast_to(beam.direction, (*distance.shape, 3))
    before = np.broadcast_to(beam.length_before, distance.shape)
    origin = beam.entry - before[..., None] * direction
    noise = np.sqrt(own_variance(image))
    if motion is not None:
        noise = np.hypot(noise, motion.own)
    powers = _powers(_DEGREE if window > _DEGREE else 2)
    kernels, plain = _kernels(window, powers), _kernels(window, _powers(2))
    inverse, patch = _patches(distance, usable, kernels)
    complete = ndimage.minimum_filter(
        usable.astype(np.uint8), size=window, mode="constant", cval=0
    )
    smooth = (complete == 1) & _is_smooth(
        inverse, patch, powers, noise / distance**2, complete, window
    )
    if int(smooth.sum()) < _FEWEST:
        raise CubeError(
            f"scan {name!r}: {int(smooth.sum())} of {smooth.size} pixels lie on a "
            f"smooth surface {window} pixels wide, at least {_FEWEST} are needed to "
            "place it; scan finer, or set registration.window lower"
        )
    apart, normal = _tangents(origin, direction, inverse, smooth, window)
    return ScanSurface(
        name=name,
        usable=usable,
        smooth=smooth,
        origin=np.asarray(origin),
        direction=np.asarray(direction),
        distance=distance,
        own=noise,
        shared=shared,
        patch=patch,
        apart=apart,
        powers=powers,
        kernels=kernels,
        slope=float(np.sqrt((plain[1] ** 2).sum())),
        normal=normal,
        attributes={str(key): value for key, value in image.attrs.items()}
        | {"group_index": float(image["geometry"].attrs["group_index"])},
        motion=motion,
    )


def with_correction(surface: ScanSurface, change: Floats) -> ScanSurface:
    """Return a surface with a correction of its ranges subtracted, and new patches."""
    distance = surface.distance - change
    inverse, patch = _patches(distance, surface.usable, surface.kernels)
    apart, normal = _tangents(
        surface.origin, surface.direction, inverse, surface.smooth,
        surface.kernels.shape[1],
    )  # fmt: skip
    return replace(surface, distance=distance, patch=patch, apart=apart, normal=normal)


def _patches(distance: Floats, usable: Flags, kernels: Floats) -> tuple[Floats, Floats]:
    """Return inverse ranges, 0 without a range, and polynomials in their windows."""
    inverse = np.where(usable, 1 / np.where(usable, distance, 1.0), 0.0)
    patch = [ndimage.correlate(inverse, kernel, mode="nearest") for kernel in kernels]
    return inverse, np.array(patch)


def _tangents(
    origin: Floats, direction: Floats, inverse: Floats, smooth: Flags, window: int
) -> tuple[Floats, Floats]:
    """Return positions estimated from neighboring pixels, and normals of a surface."""
    plain = _kernels(window, _powers(2))
    low = np.array(
        [ndimage.correlate(inverse, kernel, mode="nearest") for kernel in plain[:3]]
    )
    # Fit without the central pixel; its slopes are equal.
    middle = plain[0, window // 2, window // 2]
    without = (low[0] - middle * inverse) / (1 - middle)
    # No neighbor has a range where the inverse is 0.
    reach = np.where(without > 0, 1 / np.where(without > 0, without, 1.0), np.nan)
    steps = np.array(
        [[_steps(grid, axis) for axis in (0, 1)] for grid in (origin, direction)]
    )
    apart = np.asarray(origin + reach[..., None] * direction)
    return apart, _normals(steps, direction, low, reach, smooth)


def _powers(degree: int) -> Numbers:
    """Return the powers of row and column in a polynomial, lowest degree first."""
    return np.array([(n - j, j) for n in range(degree + 1) for j in range(n + 1)])


def _kernels(window: int, powers: Numbers) -> Floats:
    """Return the weights of a least-squares polynomial fit in a square window."""
    half = window // 2
    row, column = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
    design = np.stack([(row**i * column**j).ravel() for i, j in powers], axis=1)
    return np.asarray(np.linalg.pinv(design).reshape(-1, window, window))


def _is_smooth(
    inverse: Floats,
    patch: Floats,
    powers: Numbers,
    sigma: Floats,
    complete: NDArray[np.uint8],
    window: int,
) -> Flags:
    """Return a mask of pixels whose window a polynomial fits within the noise."""
    count = window**2
    half = window // 2
    place = np.arange(-half, half + 1).astype(float)
    bare = [np.outer(place**i, place**j) for i, j in powers]
    # Residual sum of squares: squares of the data minus squares of the fit, about the
    # mean.
    middle = inverse.mean()
    shifted = inverse - middle
    square = count * ndimage.uniform_filter(shifted**2, window, mode="nearest")
    fitted = patch.copy()
    fitted[0] -= middle
    sums = [ndimage.correlate(shifted, kernel, mode="nearest") for kernel in bare]
    square -= np.sum([c * s for c, s in zip(fitted, sums, strict=True)], axis=0)
    freedom = count - len(powers)
    expected = ndimage.uniform_filter(
        np.where(np.isfinite(sigma), sigma, 0.0) ** 2, window, mode="nearest"
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        score = square / (freedom * expected)
    valid = (complete == 1) & np.isfinite(score)
    usual = max(float(np.median(score[valid])), 1.0) if valid.any() else 1.0
    limit = 1 + 5 * np.sqrt(2 / freedom)
    most = limit * usual if usual < _ROUGH else _ROUGH * usual
    return np.asarray(valid & (score < most))


def _normals(
    steps: Floats, direction: Floats, patch: Floats, reach: Floats, smooth: Flags
) -> Floats:
    """Return the unit normals of the surface patches, towards the instrument."""
    ahead, turn = steps
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = [-patch[1] * reach**2, -patch[2] * reach**2]
        tangent = [
            o + s[..., None] * direction + reach[..., None] * t
            for o, s, t in zip(ahead, slopes, turn, strict=True)
        ]
        normal = np.cross(tangent[0], tangent[1])
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    facing = np.einsum("ijk,ijk->ij", normal, direction)
    normal = np.where(facing[..., None] > 0, -normal, normal)
    return np.where(smooth[..., None], normal, np.nan)


def _steps(values: Floats, axis: int) -> Floats:
    """Return the derivative of gridded values along an axis, per pixel."""
    if values.shape[axis] < 2:
        return np.zeros_like(values)
    return np.asarray(np.gradient(values, axis=axis))
