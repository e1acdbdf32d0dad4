"""Comparison of two scans: distances of points of one from patches of the other.

Normals are noisy, and noise in both factors of a sum of squares adds up: a flat sea
bed would look as if it held a scan sideways, and a site would shrink, since a smaller
one has smaller residuals. So distances are multiplied with derivatives whose noise is
independent of theirs: normals of the other scan, places by neighbors (instrumental
variables).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from amulor.platform.attitude import cross_matrix
from amulor.site.registration.bodies import Points, counted, held_directions, mean_lever
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.surface import ScanSurface

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]

#: Smallest cosine of the angle of incidence [1].
_GRAZING = 0.2
#: Smallest cosine of the angle between the normals of one surface [1].
_ALIKE = 0.7
#: Largest number of compared points; with more, shared errors dominate.
MOST_POINTS = 20_000


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Comparison of two scans, linearized in their poses and shared errors."""

    source: str
    """Scan whose points are compared."""
    target: str
    """Scan whose surface patches the points are compared with."""
    keys: tuple[str, ...]
    """Keys of the shared errors of both scans."""
    pivot: Floats
    """Center of the points in the site's frame, shape (3,) [m]."""
    place: Floats
    """Points in the site's frame, shape (n, 3) [m]."""
    distance: Floats
    """Distances of points from patches along the target's beams, shape (n,) [m]."""
    weight: Floats
    """Inverse variance of the distance, 0 for discarded points, shape (n,) [1/m^2]."""
    by_target: Floats
    """Derivatives of the distance, computed with the target's normals: by translation
    of the source at the pivot, rotation about it, and shared errors, shape (n, 6 +
    k)."""
    by_source: Floats
    """Derivatives of the distance, computed with the source's normals, shape (n, 6 +
    k)."""
    along: Floats
    """Derivative of the distance by the slant range of the source's pixel, shape
    (n,)."""
    source_pixel: Numbers
    """Numbers of the source's pixels, shape (n,)."""
    target_pixel: Numbers
    """Numbers of the target's pixels, shape (n,)."""
    along_apart: Floats
    """Derivative of the distance by the slant range of the source's pixel, computed
    with the source's normals, shape (n,)."""
    target_pixel_apart: Numbers
    """Numbers of the target's pixels for points located from the neighbors of their
    pixels, independent of the pixels' own noise, shape (n,)."""
    patches: ScanSurface
    """Surface of the target."""
    off: Floats
    """Offsets of the points from the target's pixels, in pixels, shape (n, 2) [1]."""
    misfit: float
    """Scatter of the distances over their stated noise; at least 1 [1]."""
    held: Floats
    """Projector onto the motions that the surfaces constrain, shape (6, 6)."""
    loose: tuple[Floats, ...]
    """Motions (translation [m], rotation [rad]) that the surfaces do not constrain."""
    unsure: float
    """Scatter of the normal matrix by noise of surface normals, with rotations scaled
    by the mean distance from the pivot [1/m^2]."""
    moved: Numbers
    """Pixels of the source on another or a moved object."""

    @property
    def window(self) -> sparse.csr_matrix:
        """Derivatives of distances with respect to ranges of the target scan.

        The shape is (n, pixels). They need more memory than all other arrays.
        """
        return -_window(self.patches, self.target_pixel, self.off)

    @property
    def mean_square(self) -> Floats:
        """Matrix of the mean square displacement of points by a motion, (6, 6)."""
        lever = self.place - self.pivot
        rows = np.zeros((len(lever), 3, 6))
        rows[..., :3], rows[..., 3:] = np.eye(3), -cross_matrix(lever)
        total = max(float(self.weight.sum()), 1e-300)
        share = self.weight / total
        return np.asarray(np.einsum("n,nij,nik->jk", share, rows, rows))

    @property
    def used(self) -> int:
        """Number of points with a weight above 0."""
        return int((self.weight > 0).sum())


def compared(
    source: ScanSurface,
    target: ScanSurface,
    poses: tuple[ScanPose, ScanPose],
    *,
    gate: float | None,
    errors: dict[str, float],
    tree: cKDTree | None = None,
    among: Numbers | None = None,
    most: int = MOST_POINTS,
) -> Pair | None:
    r"""Compare points of one scan with surface patches of another; None if few meet.

    A point p of the source lies on a beam between pixels of the target. The patch has
    the range :math:`\hat\rho` there, and the distance is :math:`e = \rho_p - \hat\rho`,
    with the gradient :math:`n / (n \cdot d)`. Its noise is that of the source pixel and
    of the pixels in the patch; neighboring points share patches. Only source pixels in
    `among` have a weight.
    """
    pixel = _chosen(source, most)
    point = source.points(pixel)
    placed = poses[0].place(point - _moved_by(source, pixel, point, errors))
    local = poses[1].back(placed)
    tree = tree or tree_of(target)
    reach = max(4 * target.spacing, 0.0 if gate is None else 2 * gate)
    away, nearest = tree.query(local, distance_upper_bound=reach)
    met = np.isfinite(away)
    numbers = np.flatnonzero(target.smooth)[nearest[met]]
    pixel, placed, local = pixel[met], placed[met], local[met]
    # Where the target, with its errors, measured this point.
    local = local + _moved_by(target, numbers, local, errors)
    at = on_grid(target, local, numbers)
    inside = at.inside
    if int(inside.sum()) < 20:
        return None
    pixel, placed, local, at = (
        pixel[inside],
        placed[inside],
        local[inside],
        at.of(inside),
    )
    ahead = poses[1].turn(at.direction)
    normals = [
        poses[1].turn(target.normal.reshape(-1, 3)[at.pixel]),
        poses[0].turn(source.normal.reshape(-1, 3)[pixel]),
    ]
    beam = poses[0].turn(source.direction.reshape(-1, 3)[pixel])
    facing = [_dot(n, ahead) for n in normals]
    facing_source = -_dot(normals[1], beam)
    good = (
        (-facing[0] > _GRAZING) & (-facing[1] > _GRAZING) & (facing_source > _GRAZING)
    )
    good &= _dot(normals[0], normals[1]) > _ALIKE
    if gate is not None:
        good &= np.abs(at.distance) < gate
    if int(good.sum()) < 20:
        return None
    pivot = placed[good].mean(axis=0)
    keys = tuple(dict.fromkeys((*source.keys, *target.keys)))
    window = _window(target, at.pixel, at.off)
    noises = [one.own.ravel() for one in (source, target)]
    # Derivatives must be independent of the noise of the distances, also through the
    # position: points are placed from neighbors of their pixels.
    apart = source.apart.reshape(-1, 3)[pixel]
    guessed = poses[0].place(apart - _moved_by(source, pixel, apart, errors))
    beside = poses[1].back(guessed)
    beside = beside + _moved_by(target, at.pixel, beside, errors)
    at_guess = on_grid(target, beside, at.pixel)
    motions = [
        keys.index(key)
        for scan in (source, target)
        if scan.motion is not None
        for key in scan.motion.keys
    ]
    rows, alongs = [], []
    for normal, spot, on in (
        (normals[0], placed, at),
        (normals[1], guessed, at_guess),
    ):
        sight = poses[1].turn(on.direction)
        gradient = normal / _dot(normal, sight)[:, None]
        along = _dot(gradient, beam)
        by_errors = np.zeros((len(pixel), len(keys)))
        for scan, pose, number, factor, sign in (
            (source, poses[0], pixel, -along, -1.0),
            (target, poses[1], on.pixel, np.ones(len(pixel)), 1.0),
        ):
            of_ranges = _shapes_at(scan, number, pose.back(spot)) * factor
            moved = scan.moved(number, pose.back(spot)) @ pose.rotation.T
            of_poses = sign * np.einsum("kni,ni->kn", moved, gradient)
            shapes = np.concatenate([of_ranges, of_poses])
            for key, shape in zip(scan.keys, shapes, strict=True):
                by_errors[:, keys.index(key)] += shape
        rows.append(np.hstack([gradient, np.cross(spot - pivot, gradient), by_errors]))
        alongs.append(along)
    noise = alongs[0] * noises[0][pixel]
    patches = window @ sparse.diags(np.nan_to_num(noises[1]))
    estimates = np.array([errors.get(key, 0.0) for key in keys])
    estimates[motions] = 0.0  # Places of the points include them.
    corrected = rows[0][:, 6:] @ estimates
    distance = at.distance + corrected
    points = Points(
        smooth=source.smooth,
        pixel=pixel,
        lever=placed - pivot,
        distance=distance,
        corrected=corrected,
        variance=np.array([noise**2, np.asarray(patches.power(2).sum(axis=1)).ravel()]),
        by_target=rows[0],
        by_source=rows[1],
        noise=noise,
        window=patches.tocsr(),
        tilt=_tilt(target, at, normals[0]),
        together=target.kernels.shape[1] ** 2 / 2,
    )
    outcome = counted(points, good, gate)
    weight = outcome.weight
    if among is not None:
        weight = np.where(np.isin(pixel, among), weight, 0.0)
    unsure = points.unsure(weight)
    held, loose = held_directions(
        rows[1][:, :6].T @ (weight[:, None] * rows[0][:, :6]),
        unsure=unsure,
        length=mean_lever(placed - pivot, weight),
    )
    return Pair(
        source=source.name,
        target=target.name,
        keys=keys,
        pivot=pivot,
        place=placed,
        distance=distance,
        weight=weight,
        by_target=rows[0],
        by_source=rows[1],
        along=alongs[0],
        source_pixel=pixel,
        target_pixel=at.pixel,
        along_apart=alongs[1],
        target_pixel_apart=at_guess.pixel,
        patches=target,
        off=at.off,
        misfit=outcome.misfit,
        held=held,
        loose=loose,
        unsure=unsure,
        moved=outcome.moved,
    )


def tree_of(surface: ScanSurface) -> cKDTree:
    """Return a search tree of the points on smooth surfaces of a scan."""
    return cKDTree(surface.position[surface.smooth])


def _chosen(source: ScanSurface, most: int) -> Numbers:
    """Return the pixels on smooth surfaces, evenly thinned if they are many."""
    row, column = np.nonzero(source.smooth)
    step = int(np.ceil(np.sqrt(len(row) / most)))
    if step > 1:
        coarse = (row % step == 0) & (column % step == 0)
        row, column = row[coarse], column[coarse]
    return np.asarray(row * source.smooth.shape[1] + column)


@dataclass(frozen=True)
class OnGrid:
    """Points located on the pixel grid of another scan."""

    pixel: Numbers
    off: Floats
    direction: Floats
    distance: Floats
    inside: NDArray[np.bool_]

    def of(self, selected: NDArray[np.bool_]) -> OnGrid:
        """Return a selection of the points."""
        return OnGrid(
            self.pixel[selected],
            self.off[selected],
            self.direction[selected],
            self.distance[selected],
            self.inside[selected],
        )


def on_grid(target: ScanSurface, point: Floats, pixel: Numbers) -> OnGrid:
    """Locate points on the grid of a scan: pixel, offset, and distance from patch."""
    shape = target.smooth.shape
    origin, direction = target.origin.reshape(-1, 3), target.direction.reshape(-1, 3)
    row, column = np.divmod(pixel, shape[1])
    off = np.zeros((len(point), 2))
    for _ in range(4):
        pixel = row * shape[1] + column
        start, ahead = origin[pixel], direction[pixel]
        slopes = target.steps(pixel)
        off = _pixels_off(point - start, ahead, slopes)
        jump = np.clip(np.rint(off), -8, 8).astype(np.intp)
        row = np.clip(row + jump[:, 0], 0, shape[0] - 1)
        column = np.clip(column + jump[:, 1], 0, shape[1] - 1)
        if not jump.any():
            break
    inside = (np.abs(off) <= 0.6).all(axis=1) & target.smooth.ravel()[pixel]
    start = start + off[:, :1] * slopes[0][0] + off[:, 1:] * slopes[0][1]
    ahead = ahead + off[:, :1] * slopes[1][0] + off[:, 1:] * slopes[1][1]
    # Rows of beams are curved away from the horizon: by 5 um of range on a grazing
    # plane, with the sign of the elevation. Poses absorb most of such a pattern, so the
    # remainder matters.
    ahead += _bend(direction, shape, pixel, off)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    more = _pixels_off(point - start, ahead, slopes)
    start = start + np.einsum("ni,ink->nk", more, slopes[0])
    ahead = ahead + np.einsum("ni,ink->nk", more, slopes[1])
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    off = off + more
    patch = target.patch.reshape(len(target.powers), -1)[:, pixel]
    inverse = np.einsum("ki,ki->i", patch, _terms(target, off))
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = _dot(point - start, ahead) - 1 / inverse
    return OnGrid(pixel, off, ahead, distance, inside & np.isfinite(distance))


def _pixels_off(away: Floats, ahead: Floats, slopes: Floats) -> Floats:
    """Offsets in rows and columns from given pixels to the beams through points."""
    reach = _dot(away, ahead)[:, None]
    miss = away - reach * ahead
    a, b = slopes[0] + reach * slopes[1]
    aa, bb, ab = _dot(a, a), _dot(b, b), _dot(a, b)
    ma, mb = _dot(miss, a), _dot(miss, b)
    below = aa * bb - ab**2
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.stack([bb * ma - ab * mb, aa * mb - ab * ma], 1) / below[:, None]
    return np.asarray(np.nan_to_num(off, nan=9.0, posinf=9.0, neginf=-9.0))


def _bend(
    direction: Floats, shape: tuple[int, ...], pixel: Numbers, off: Floats
) -> Floats:
    """Second-order term of beam directions between pixels, from neighboring pixels."""
    row, column = np.divmod(pixel, shape[1])
    row = np.clip(row, 1, max(shape[0] - 2, 1))
    column = np.clip(column, 1, max(shape[1] - 2, 1))

    def at(rows: int, columns: int) -> Floats:
        number = np.minimum(row + rows, shape[0] - 1) * shape[1]
        number = number + np.minimum(column + columns, shape[1] - 1)
        return np.asarray(direction[number])

    along, across = off[:, :1], off[:, 1:]
    middle = at(0, 0)
    mixed = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / 4
    return np.asarray(
        along**2 / 2 * (at(1, 0) - 2 * middle + at(-1, 0))
        + across**2 / 2 * (at(0, 1) - 2 * middle + at(0, -1))
        + along * across * mixed
    )


def _terms(target: ScanSurface, off: Floats) -> Floats:
    """Return the polynomial terms of a patch at pixel offsets, shape (term, n)."""
    row, column = off.T
    return np.array([row**i * column**j for i, j in target.powers])


def _window(target: ScanSurface, pixel: Numbers, off: Floats) -> sparse.csr_matrix:
    """Return derivatives of fitted ranges with respect to ranges in their windows."""
    size = target.kernels.shape[1]
    half = size // 2
    shape = target.smooth.shape
    kernels = target.kernels.reshape(len(target.powers), -1)
    weight = np.einsum("ki,kj->ij", _terms(target, off), kernels)
    row, column = np.divmod(pixel, shape[1])
    away = np.arange(-half, half + 1)
    rows = (row[:, None, None] + away[:, None]).repeat(size, axis=2)
    columns = (column[:, None, None] + away).repeat(size, axis=1)
    index = (rows * shape[1] + columns).reshape(len(row), -1)
    distance = target.distance.ravel()
    with np.errstate(invalid="ignore"):
        weight = weight * (distance[pixel][:, None] / distance[index]) ** 2
    starts = np.arange(len(row) + 1) * size**2
    return sparse.csr_matrix(
        (weight.ravel(), index.ravel(), starts), shape=(len(row), distance.size)
    )


def _shapes_at(scan: ScanSurface, pixel: Numbers, point: Floats) -> Floats:
    """Return the effect of a scan's shared errors at points, shape (k, n) [m].

    They are computed for the range of the point, without the noise of the pixel.
    """
    count = len(scan.shared.keys)
    shapes, growth = (
        values.reshape(count, scan.distance.size)[:, pixel]
        for values in (scan.shared.shapes, scan.shared.growth)
    )
    start, ahead = (
        values.reshape(-1, 3)[pixel] for values in (scan.origin, scan.direction)
    )
    off = _dot(point - start, ahead) - scan.distance.ravel()[pixel]
    return np.asarray(shapes + growth * off)


def _moved_by(
    scan: ScanSurface, pixel: Numbers, points: Floats, errors: dict[str, float]
) -> Floats:
    """Return shifts of points by the estimated errors of a moving instrument [m]."""
    if scan.motion is None:
        return np.zeros(points.shape)
    estimates = np.array([errors.get(key, 0.0) for key in scan.motion.keys])
    if not estimates.any():
        return np.zeros(points.shape)
    return scan.motion.shift(pixel, points, estimates)


def _tilt(target: ScanSurface, at: OnGrid, normal: Floats) -> Floats:
    """Return the variance of distance derivatives due to noise of surface normals."""
    # Noise of a patch's slope per pixel, as an angle of the surface.
    angle = target.slope * target.own.ravel()[at.pixel] / target.spacing
    along = np.abs(_dot(normal, at.direction))
    return np.asarray(angle**2 / np.maximum(along, _GRAZING) ** 2)


def _dot(left: Floats, right: Floats) -> Floats:
    return np.asarray(np.einsum("ij,ij->i", left, right))
