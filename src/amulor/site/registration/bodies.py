"""Motions that surfaces constrain, and points of objects that moved between scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.stats import chi2

Floats = NDArray[np.float64]

#: Signal-to-noise ratio of a constrained direction [1].
HELD = 6.0


def mean_lever(lever: Floats, weight: Floats) -> float:
    """Return the root mean square distance of points from a pivot [m]."""
    return float(np.sqrt(np.average((lever**2).sum(axis=1), weights=weight + 1e-300)))


def held_directions(
    matrix: Floats, *, unsure: float, length: float
) -> tuple[Floats, tuple[Floats, ...]]:
    """Return the projector onto motions that surfaces determine, and free motions.

    Noise of the normals in both scans gives products with a mean of zero. A direction
    is determined if its sum is significant against their scatter.
    """
    scale = np.array([1.0, 1.0, 1.0, length, length, length])
    scaled = matrix / np.outer(scale, scale)
    values, axes = np.linalg.eigh((scaled + scaled.T) / 2)
    projection = np.eye(6)
    loose = []
    for value, axis in zip(values, axes.T, strict=True):
        if value < HELD * unsure:
            projection -= np.outer(axis, axis)
            loose.append(of_size_one(axis / scale, length))
    # Back from scaled to plain coordinates; rows are multiplied from the right.
    return np.diag(1 / scale) @ projection @ np.diag(scale), tuple(loose)


def of_size_one(motion: Floats, length: float) -> Floats:
    """Scale a motion to a translation of 1 m, or a rotation of 1 rad if that is more.

    Rotations are compared with translations at the distance `length` from the center.
    """
    shift, turn = np.linalg.norm(motion[:3]), np.linalg.norm(motion[3:])
    return motion / float(turn if turn * length > shift else shift)


Flags = NDArray[np.bool_]
Numbers = NDArray[np.intp]

#: False-alarm probability of the test for a moved body [1].
_CHANCE = 1e-5
#: A body has moved if more than this fraction of its points are displaced [1].
_MUCH = 0.3
#: Smallest number of points of a body [1].
_FEWEST = 10


@dataclass(frozen=True, kw_only=True)
class Points:
    """Points of one scan, with their distances from surface patches of another."""

    smooth: Flags
    """Pixels of the source on smooth surfaces, shape (row, column)."""
    pixel: Numbers
    """Numbers of the points' pixels in the source scan, shape (n,)."""
    lever: Floats
    """Positions of the points relative to the pivot, shape (n, 3) [m]."""
    distance: Floats
    """Distances from the patches, including estimated shared errors, shape (n,) [m]."""
    corrected: Floats
    """Part of the distance that the shared errors contribute, shape (n,) [m]."""
    variance: Floats
    """Variance of the distance by noise of source and target, shape (2, n) [m^2]."""
    by_target: Floats
    """Derivatives of the distance, computed with the target's normals, shape (n, 6 +
    k)."""
    by_source: Floats
    """Derivatives of the distance, computed with the source's normals, shape (n, 6 +
    k)."""
    noise: Floats
    """Noise of a distance from noise of the source's pixel, shape (n,) [m]."""
    window: sparse.csr_matrix
    """Noise of a distance from noise of the target's pixels, shape (n, pixels) [m]."""
    tilt: Floats
    """Squared noise of the derivatives from noise of surface normals, shape (n,)."""
    together: float
    """Number of neighboring points with the same noise of surface normals [1]."""

    def unsure(self, weight: Floats) -> float:
        """Return the error of the normal matrix due to noise of surface normals."""
        return float(np.sqrt(self.together * ((self.tilt * weight) ** 2).sum()))


def moved_bodies(
    points: Points, weight: Floats, near: Flags, *, misfit: float
) -> Flags:
    r"""Return a mask of the points on objects that moved relative to the scene.

    The least displaced part of a body looks like noise, pulls the scans along, and
    hides the motion; a body is therefore tested as a whole. It moved if many of its
    points are displaced, or else if a test is significant. With the sums :math:`g = Z^T
    W e` and :math:`N = Z^T W X` of the body (b) and of all other points (r), :math:`g_b
    - N_b N_r^{-1} g_r` has a mean of zero for any poses if the body did not move. Its
    variance is that of pixels, patches and shared errors. Directions that the other
    points do not determine are omitted. Chi-square selects bodies, the most significant
    first.
    """
    labels, _ = ndimage.label(points.smooth)
    body = labels.ravel()[points.pixel]
    size = np.bincount(body[weight > 0])
    order = [int(number) for number in np.flatnonzero(size >= _FEWEST)]
    if len(order) < 2:
        return np.zeros(len(body), dtype=bool)
    order.remove(int(np.argmax(size)))
    off = np.bincount(body[(weight > 0) & ~near], minlength=len(size))
    moved = [number for number in order if off[number] > _MUCH * size[number]]
    order = [number for number in order if number not in moved]
    while order:
        remaining = near & ~np.isin(body, moved)
        total = _sum(points, weight, remaining)
        chances = [
            _chance(
                points, weight, total, remaining, remaining & (body == number), misfit
            )
            for number in order
        ]
        surest = int(np.argmin(chances))
        if chances[surest] > _CHANCE:
            break
        moved.append(order.pop(surest))
    return np.asarray(np.isin(body, moved))


@dataclass(frozen=True)
class _Sum:
    """Normal equations summed over selected points, with their noise."""

    matrix: Floats
    gradient: Floats
    shared: Floats
    own: Floats
    patches: Floats


def _sum(
    points: Points, weight: Floats, at: Flags, columns: Numbers | None = None
) -> _Sum:
    """Return the normal equations summed over selected points, with their noise."""
    z = points.by_source[at, :6] * weight[at, None]
    window = points.window[at]
    if columns is not None:
        window = window[:, columns]
    noise = z * points.noise[at, None]
    return _Sum(
        matrix=z.T @ points.by_target[at, :6],
        gradient=z.T @ (points.distance - points.corrected)[at],
        shared=z.T @ points.by_target[at, 6:],
        own=noise.T @ noise,
        patches=np.asarray(window.T @ z),
    )


def _chance(
    points: Points,
    weight: Floats,
    total: _Sum,
    remaining: Flags,
    body: Flags,
    misfit: float,
) -> float:
    """Return the probability that noise alone causes the offset of a body."""
    rest = remaining & ~body
    if int(body.sum()) < _FEWEST or int(rest.sum()) < 2 * _FEWEST:
        return 1.0
    columns = np.unique(points.window[body].indices)
    part = _sum(points, weight, body, columns)
    matrix = total.matrix - part.matrix
    held, loose = held_directions(
        matrix,
        unsure=points.unsure(np.where(rest, weight, 0.0)),
        length=mean_lever(points.lever[rest], weight[rest]),
    )
    carry = part.matrix @ held @ np.linalg.pinv(held.T @ matrix @ held) @ held.T
    off = part.gradient - carry @ (total.gradient - part.gradient)
    shared = part.shared - carry @ (total.shared - part.shared)
    # Patches of the body and of the other points share pixels at its rim.
    near = total.patches[columns]
    cross = part.patches.T @ (near - part.patches)
    patches = total.patches.T @ total.patches - near.T @ near
    patches += (near - part.patches).T @ (near - part.patches)
    noise = part.own + carry @ (total.own - part.own) @ carry.T
    noise += part.patches.T @ part.patches + carry @ patches @ carry.T
    noise -= cross @ carry.T + carry @ cross.T
    variance = misfit**2 * noise + shared @ shared.T
    scale = np.sqrt(variance.diagonal())
    off, variance = off / scale, variance / np.outer(scale, scale)
    if loose:
        # Directions that the other points do not constrain have no known offset.
        free = part.matrix @ np.stack(loose, axis=1) / scale[:, None]
        basis, sizes, _ = np.linalg.svd(free)
        basis = basis[:, int((sizes > 1e-9 * sizes[0]).sum()) :]
        off, variance = basis.T @ off, basis.T @ variance @ basis
    values, axes = np.linalg.eigh(variance)
    significant = values > 1e-6 * values[-1]
    score = float(((axes.T @ off)[significant] ** 2 / values[significant]).sum())
    return float(chi2.sf(score, int(significant.sum())))


#: Distance in standard errors beyond which a point belongs to another surface [1].
_FAR = 4.0
#: Displacement in standard errors of the mean of neighbors that moved together [1].
_MOVED = 5.0


@dataclass(frozen=True, kw_only=True)
class Counted:
    """Weights of compared points, and pixels on moved objects."""

    weight: Floats
    """Inverse variance of the distance, 0 for discarded points, shape (n,) [1/m^2]."""
    misfit: float
    """Scatter of the distances over their stated noise; at least 1 [1]."""
    moved: Numbers
    """Numbers of the source's pixels on moved bodies."""


def counted(points: Points, good: Flags, gate: float | None) -> Counted:
    """Weight points by their noise, discard other surfaces, and find moved objects."""
    sigma = np.sqrt(points.variance.sum(axis=0))
    score = points.distance / sigma
    middle = np.median(score[good])
    scatter = 1.4826 * np.median(np.abs(score[good] - middle))
    # A sample of n has a scatter of 1 +- 1.17 / sqrt(n) by chance; neighbors share
    # a fifth of their noise.
    sure = 1 + 3 * 1.17 / np.sqrt(max(int(good.sum()) / 2, 1.0))
    misfit = float(scatter) if scatter > sure else 1.0
    moved = np.zeros(len(score), dtype=bool)
    full_weight = 1 / (sigma * misfit) ** 2
    if gate is None:
        moved = good & _offset_together(points, score, good, misfit)
        near = good & ~moved & (np.abs(score) < _FAR * misfit)
        bodies = moved_bodies(
            points, np.where(good, full_weight, 0.0), near, misfit=misfit
        )
        moved |= good & bodies
        good = near & ~bodies
    weight = np.where(good, full_weight, 0.0)
    return Counted(weight=weight, misfit=misfit, moved=points.pixel[moved])


def _offset_together(
    points: Points, score: Floats, good: Flags, misfit: float
) -> Flags:
    """Return a mask of points that are displaced along with their neighbors."""
    variance = points.variance
    row, column = np.divmod(points.pixel, points.smooth.shape[1])
    steps = [
        max(int(np.min(np.diff(np.unique(values)), initial=99)), 1)
        for values in (row, column)
    ]
    grid = (row // steps[0], column // steps[1])
    size = tuple(int(values.max()) + 1 for values in grid)
    total, count, patches = (np.zeros(size) for _ in range(3))
    clipped = np.clip(score, -20, 20)
    total[grid] = np.where(good, clipped, 0.0)
    count[grid] = good
    patches[grid] = np.where(good, variance[1] / variance.sum(axis=0), 0.0)
    total, count, patches = (
        25 * ndimage.uniform_filter(values, 5, mode="constant")
        for values in (total, count, patches)
    )
    number = np.maximum(count, 1.0)
    # The noise of patches is equal in neighbors in the worst case.
    error = misfit * np.sqrt(1 / number + patches / number)
    off = (np.abs(total / number) > _MOVED * error) & (count >= 5)
    off = ndimage.binary_dilation(off, iterations=2)
    return np.asarray(off[grid])
