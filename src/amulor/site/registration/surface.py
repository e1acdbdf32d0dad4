"""The surface that a scan saw, as smooth patches, and what its noise does to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from amulor.cube import UNUSABLE, QualityFlag
from amulor.errors import CubeError
from amulor.imaging.common import own_variance
from amulor.imaging.geometry import beams_of
from amulor.site.registration.shared import Shared

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Numbers = NDArray[np.intp]

#: A window is no smooth surface if its chi-square is so many times that of most [1].
_ROUGH = 3.0
#: Degree of a patch: with less, bends of a sea bed exceed the noise of patches [1].
_DEGREE = 4
#: Fewer patches than these place nothing [1].
_FEWEST = 50


@dataclass(frozen=True, kw_only=True)
class ScanSurface:
    """A scan in its own axes (right, down, forward), on its grid of pixels."""

    name: str
    """Of the scan."""
    usable: Flags
    """Pixels whose range is relied on, shape (row, column)."""
    smooth: Flags
    """Pixels whose whole window lies on one smooth surface."""
    origin: Floats
    """Where each slant range begins, shape (row, column, 3) [m]."""
    direction: Floats
    """Of the beams, shape (row, column, 3) [1]."""
    steps: Floats
    """How origin and direction change by a row and by a column, shape (2, 2, row,
    column, 3) [m, 1]."""
    distance: Floats
    """Slant range, not a number where there is none [m]."""
    own: Floats
    """Standard uncertainty that no other pixel shares [m]."""
    shared: Shared
    """What pixels share."""
    patch: Floats
    """Polynomial of inverse range in each window, shape (term, row, column), of the
    terms of `powers` [1/m]."""
    powers: Numbers
    """Powers of row and column in each term of a patch, shape (term, 2) [1]."""
    apart: Floats
    """Where the neighbours of a pixel in its window put it, shape (row, column, 3)
    [m]."""
    kernels: Floats
    """What makes patches of the pixels of a window, shape (term, window, window)
    [1]."""
    slope: float
    """Noise of a slope that makes the normals, over that of a pixel [1]."""
    normal: Floats
    """Towards the instrument, not a number where not smooth, (row, column, 3) [1]."""
    attributes: dict[str, object]
    """Those of the range image."""

    @property
    def position(self) -> Floats:
        """Points, shape (row, column, 3) [m]."""
        return np.asarray(self.origin + self.distance[..., None] * self.direction)

    @property
    def spacing(self) -> float:
        """Median distance of neighbouring points of smooth patches [m]."""
        step = np.linalg.norm(np.diff(self.position, axis=1), axis=-1)
        kept = step[self.smooth[:, 1:] & self.smooth[:, :-1]]
        return float(np.median(kept)) if kept.size else float("nan")


def scan_surface(
    image: xr.Dataset, *, name: str, shared: Shared, window: int = 7
) -> ScanSurface:
    r"""Return the surface of a range image.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`. Mixed pixels and outliers are left out.
    name : str
        What messages call the scan.
    shared : Shared
        What its pixels share.
    window : int
        Pixels across a patch, odd [1].

    Returns
    -------
    ScanSurface
        With a polynomial of fourth degree through the inverse ranges of each window,
        of second if it is three pixels wide.

    Raises
    ------
    CubeError
        If hardly any window is smooth.

    Notes
    -----
    The inverse range of a plane is linear in the direction of the beam, so patches have
    no error by the angle of incidence. Those of second degree (Savitzky and Golay)
    leave out how a bend changes, which neighbours share: 0.03 mm, a third of the noise
    of a pixel, put scans five standard errors off. Of fourth degree they have twice the
    noise, a sixth of that of the point compared with them. Normals are of second
    degree: their noise counts, and a small error that all share does not; the noise of
    one scan is independent of that of another: see `pair`.
    """
    beam = beams_of(image)
    distance = image["slant_range"].values
    flag = image["quality_flag"].values.astype(np.int64)
    hanging = int(UNUSABLE | QualityFlag.MIXED | QualityFlag.OUTLIER)
    usable = ((flag & hanging) == 0) & np.isfinite(distance) & (distance > 0)
    direction = np.broadcast_to(beam.direction, (*distance.shape, 3))
    before = np.broadcast_to(beam.length_before, distance.shape)
    origin = beam.entry - before[..., None] * direction
    own = np.sqrt(own_variance(image))
    powers = _powers(_DEGREE if window > _DEGREE else 2)
    kernels, plain = _kernels(window, powers), _kernels(window, _powers(2))
    inverse = np.where(usable, 1 / np.where(usable, distance, 1.0), 0.0)
    patch, low = (
        np.array([ndimage.correlate(inverse, k, mode="nearest") for k in each])
        for each in (kernels, plain[:3])
    )
    whole = ndimage.minimum_filter(
        usable.astype(np.uint8), size=window, mode="constant", cval=0
    )
    smooth = (whole == 1) & _is_smooth(
        inverse, patch, powers, own / distance**2, whole, window
    )
    if int(smooth.sum()) < _FEWEST:
        raise CubeError(
            f"scan {name!r}: {int(smooth.sum())} of {smooth.size} pixels lie on a "
            f"smooth surface {window} pixels wide, at least {_FEWEST} are needed to "
            "place it; scan finer, or set registration.window lower"
        )
    # The fit without the pixel in the middle; its slopes are the same.
    middle = plain[0, window // 2, window // 2]
    without = (low[0] - middle * inverse) / (1 - middle)
    # No neighbour has a range where the inverse is 0.
    reach = np.where(without > 0, 1 / np.where(without > 0, without, 1.0), np.nan)
    steps = np.array(
        [[_steps(grid, axis) for axis in (0, 1)] for grid in (origin, direction)]
    )
    return ScanSurface(
        name=name,
        usable=usable,
        smooth=smooth,
        origin=np.asarray(origin),
        direction=np.asarray(direction),
        steps=steps,
        distance=distance,
        own=own,
        shared=shared,
        patch=patch,
        apart=np.asarray(origin + reach[..., None] * direction),
        powers=powers,
        kernels=kernels,
        slope=float(np.sqrt((plain[1] ** 2).sum())),
        normal=_normals(steps, direction, low, reach, smooth),
        attributes={str(key): value for key, value in image.attrs.items()},
    )


def _powers(degree: int) -> Numbers:
    """Return the powers of row and column in a polynomial, lowest first."""
    return np.array([(n - j, j) for n in range(degree + 1) for j in range(n + 1)])


def _kernels(window: int, powers: Numbers) -> Floats:
    """Return the weights of a fit of a polynomial in a square window."""
    half = window // 2
    row, column = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
    design = np.stack([(row**i * column**j).ravel() for i, j in powers], axis=1)
    return np.asarray(np.linalg.pinv(design).reshape(-1, window, window))


def _is_smooth(
    inverse: Floats,
    patch: Floats,
    powers: Numbers,
    sigma: Floats,
    whole: NDArray[np.uint8],
    window: int,
) -> Flags:
    """Return which windows are as smooth as noise lets them, or as most are."""
    count = window**2
    half = window // 2
    place = np.arange(-half, half + 1).astype(float)
    bare = [np.outer(place**i, place**j) for i, j in powers]
    # Squares left over: those of the data less those of the fit, about the middle.
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
    there = (whole == 1) & np.isfinite(score)
    usual = max(float(np.median(score[there])), 1.0) if there.any() else 1.0
    limit = 1 + 5 * np.sqrt(2 / freedom)
    most = limit * usual if usual < _ROUGH else _ROUGH * usual
    return np.asarray(there & (score < most))


def _normals(
    steps: Floats, direction: Floats, patch: Floats, reach: Floats, smooth: Flags
) -> Floats:
    """Return unit normals of the patches, towards the instrument."""
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
    """Return how a grid changes from pixel to pixel."""
    if values.shape[axis] < 2:
        return np.zeros_like(values)
    return np.asarray(np.gradient(values, axis=axis))
