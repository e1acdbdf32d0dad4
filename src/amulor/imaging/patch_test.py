"""Patch test: mounting of the instrument on a vehicle, from overlapping lines.

Points of all lines in a small cell lie on one patch of the surface. Lever arm,
boresight, clock and slow errors of the trajectory are those for which the patches fit
the ranges best. Patches are estimated together with them, so that the noise of normals
causes no error of the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import solve_triangular
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from amulor import cube as cubes
from amulor.errors import CubeError
from amulor.imaging.moving import moving_frame, surveyed_mounting
from amulor.imaging.observation import geometry_of
from amulor.platform import InstrumentPoses, Mounting, Poses, Trajectory
from amulor.platform.mounting import changed, deviations, with_covariance

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]

#: Estimated quantities, in the order of the covariance.
QUANTITIES = (
    "lever arm right", "lever arm down", "lever arm forward",
    "boresight about right", "boresight about down", "boresight about forward",
    "clock offset", "clock drift",
)  # fmt: skip
#: Standard uncertainty of the start values if the mounting states none [m, rad, s].
_START = np.array([*[0.1] * 3, *[np.radians(3.0)] * 3, 0.2, 0.0])
#: Mean number of points of a line in a cell.
_FILLED = 24
#: Size of the cells in each iteration, in sizes of the last ones.
_SIZES = (4.0, 2.0, 1.0, 1.0)
#: Fewest points of a line in a cell, fewest points of a cell, and fewest cells.
_FEWEST, _FEWEST_IN_CELL, _FEWEST_CELLS = 6, 24, 8
#: Powers of both coordinates in the terms of a patch.
_POWERS = [(i, j) for i in range(4) for j in range(4 - i)]
_TERMS = len(_POWERS)
#: Smallest cosine of the angle of incidence [1].
_GRAZING = 0.25
#: Number of intervals of the slow errors of a line's trajectory.
_INTERVALS = 32
#: Bounds of the random walks of position and attitude [m, rad per root second].
_WALKS = ((1e-6, 1e-2), (1e-7, 1e-2))
#: Largest number of points of a line; with more, a patch test takes long.
_MOST = 30_000
#: Share of the start uncertainty above which a quantity counts as undetermined.
_UNDETERMINED = 0.5
#: Oscillation of a suggested line: amplitude [rad] and period [s].
_ROCKING, _PERIOD = np.radians(10.0), 4.0


@dataclass(frozen=True, kw_only=True)
class Undetermined:
    """Quantity that the lines do not determine, and the line that would help most."""

    quantity: str
    """Name of the quantity, such as "lever arm down"."""
    uncertainty: float
    """Standard uncertainty by the lines and the start value [m, rad, s or 1]."""
    start_uncertainty: float
    """Standard uncertainty of the start value [m, rad, s or 1]."""
    line: str
    """Additional line that reduces the uncertainty most; empty if none helps."""
    with_line: float
    """Standard uncertainty with this line [m, rad, s or 1]."""


@dataclass(frozen=True, kw_only=True)
class PatchTest:
    """Mounting of an instrument, estimated from overlapping lines.

    Its eight quantities are the lever arm (right, down, forward), the boresight (about
    right, down, forward), the clock offset and the clock drift.
    """

    mounting: Mounting
    """Estimate with uncertainties and correlation."""
    start: Mounting
    """Mounting before the test."""
    change: Floats
    """Estimate minus start, shape (8,) [m, rad, s, 1]."""
    covariance: Floats
    """Covariance of the estimate, shape (8, 8) [m, rad, s, 1]."""
    start_uncertainty: Floats
    """Standard uncertainty of the start values, stated or assumed, shape (8,)."""
    undetermined: tuple[Undetermined, ...]
    """Quantities that the lines do not determine."""
    points: int
    """Number of compared points."""
    misfit: float
    """Scatter of the ranges about the patches over their stated noise; at least 1."""
    position_walk: float
    """Random walk of the trajectory's position [m per root second]."""
    attitude_walk: float
    """Random walk of the trajectory's attitude [rad per root second]."""
    before: tuple[Floats, Floats]
    """Patches with the start values: centers (east, north, up), shape (n, 3), and rms
    distance of the lines from each, shape (n,) [m]."""
    after: tuple[Floats, Floats]
    """Patches with the estimate, as `before`."""

    @property
    def uncertainty(self) -> Floats:
        """Standard uncertainties, shape (8,) [m, rad, s, 1]."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def patch_test(
    images: Sequence[xr.Dataset],
    *,
    trajectories: Sequence[Trajectory],
    mounting: Mounting | None = None,
    suggest: bool = True,
) -> PatchTest:
    r"""Estimate lever arm, boresight and clock from overlapping lines of a vehicle.

    Parameters
    ----------
    images : sequence of xarray.Dataset
        Range image of each line.
    trajectories : sequence of Trajectory
        Trajectory of each line, or one for all lines.
    mounting : Mounting, optional
        Start values, by default from the survey of the first image. Their stated
        uncertainties count as measurements. A clock drift is estimated only if
        `clock_drift_uncertainty` is above 0.
    suggest : bool
        Whether an additional line is searched for each quantity that the lines do not
        determine.

    Returns
    -------
    PatchTest
        The mounting with its covariance, and the quantities that the lines do not
        determine.

    Raises
    ------
    CubeError
        If there are less than two lines, or too few places that two lines cover.

    Notes
    -----
    The range of a point is :math:`\rho_i = \hat\rho_i(\theta, \eta, c) + \epsilon_i`:
    the distance to a cubic patch with coefficients c, from a pose that depends on
    the mounting :math:`\theta` and on errors of the trajectory :math:`\eta`. The
    patches are eliminated from the normal equations. The errors of the trajectory are a
    constant shift of each line with the stated uncertainty of its positions, and random
    walks of position and attitude. The size of the walks is estimated from the lines
    (restricted maximum likelihood). An error of attitude that all lines share is part
    of the boresight.

    Start values without a stated uncertainty have 10 cm, 3 degrees and 0.2 s.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> from amulor.errors import CubeError
    >>> from amulor.platform import Mounting, Trajectory
    >>> image = imaging.range_image(rejection.cross_polarized(samples.cube("ladder")))
    >>> track = Trajectory.of_angles(
    ...     time=[0.0, 60.0], position=[[0, 0, -8], [0, 6, -8]], heading=0.0
    ... )
    >>> try:
    ...     imaging.patch_test([image], trajectories=[track], mounting=Mounting())
    ... except CubeError as error:
    ...     print(str(error).partition(";")[0])
    1 lines and 1 trajectories
    """
    tracks = list(trajectories) * (len(images) if len(trajectories) == 1 else 1)
    if len(images) < 2 or len(tracks) != len(images):
        raise CubeError(
            f"{len(images)} lines and {len(tracks)} trajectories; needed are two or "
            "more lines that overlap, and one trajectory for all or one for each"
        )
    start = mounting or surveyed_mounting(images[0])
    lines = [
        _Line.of(image, track, number)
        for number, (image, track) in enumerate(zip(images, tracks, strict=True))
    ]
    return _Estimate(lines, start).result(suggest=suggest)


@dataclass(frozen=True)
class _Line:
    """Usable pixels of one line, in instrument axes."""

    image: xr.Dataset
    track: Trajectory
    pixel: tuple[Numbers, Numbers]
    begin: Floats
    direction: Floats
    distance: Floats
    sigma: Floats
    common: Floats

    @classmethod
    def of(cls, image: xr.Dataset, track: Trajectory, number: int) -> _Line:
        """Select the pixels without flags, thinned if there are many."""
        image = cubes.checked(image, "range_image")
        distance = image["slant_range"].values
        total = image["slant_range_uncertainty"].values
        name = "slant_range_common_uncertainty"
        common = image[name].values if name in image else np.zeros_like(total)
        noise = np.sqrt(np.maximum(total**2 - common**2, 1e-12))
        good = (image["quality_flag"].values == 0) & np.isfinite(distance * noise)
        row, column = np.nonzero(good)
        if len(row) < _FEWEST_IN_CELL:
            raise CubeError(
                f"line {number + 1} has {len(row)} points without a quality flag; "
                "leave it out, or measure it again"
            )
        every = -(-len(row) // _MOST)
        row, column = row[::every], column[::every]
        geometry = geometry_of(image)
        beam = np.broadcast_to(geometry.beam.direction, (*distance.shape, 3))
        ahead, reach = beam[row, column], distance[row, column]
        here = geometry.position(distance)[row, column]
        return cls(
            image=image,
            track=track,
            pixel=(row, column),
            begin=here - reach[:, None] * ahead,
            direction=ahead,
            distance=reach,
            sigma=noise[row, column],
            common=common[row, column],
        )


@dataclass(frozen=True)
class _Points:
    """Points of all lines in the site, corrected by the current estimate."""

    line: Numbers
    knot: Numbers
    share: Floats
    place: Floats
    beam: Floats
    sigma: Floats
    common: Floats
    poses: InstrumentPoses

    def part(self, index: Numbers) -> _Points:
        """Return selected points."""
        arrays = {
            name: value.part(index) if name == "poses" else value[index]
            for name, value in vars(self).items()
        }
        return _Points(**arrays)


@dataclass(frozen=True)
class _Patches:
    """Cubic patches of the surface, and their points sorted by cell."""

    points: _Points
    cell: Numbers
    begin: Numbers
    center: Floats
    #: Coefficients' derivatives of the ranges over their noise, shape (n, 10) [1/m].
    rows: Floats
    #: Gradient of the height above the patch, in site axes, shape (n, 3) [1].
    gradient: Floats
    #: Derivative of this height along the beam, below 0, shape (n,) [1].
    along: Floats
    #: Range minus that of the patch, shape (n,) [m].
    residual: Floats
    #: Standard uncertainty of the range, with the misfit of the cell, shape (n,) [m].
    noise: Floats

    @classmethod
    def of(cls, points: _Points, size: float) -> _Patches:
        """Fit a patch to each cell that two lines or more have points in."""
        _, cell = np.unique(
            np.floor(points.place / size).astype(np.int64), axis=0, return_inverse=True
        )
        lines = int(points.line.max()) + 1
        counts = np.bincount(cell * lines + points.line)
        counts = np.pad(counts, (0, -len(counts) % lines)).reshape(-1, lines)
        counts = np.where(counts >= _FEWEST, counts, 0)
        covered = ((counts > 0).sum(axis=1) >= 2) & (
            counts.sum(axis=1) >= _FEWEST_IN_CELL
        )
        used = covered[cell] & (counts[cell, points.line] > 0)
        return cls._fitted(points, cell, used, size)

    @classmethod
    def _fitted(
        cls, points: _Points, cell: Numbers, used: NDArray[np.bool_], size: float
    ) -> _Patches:
        """Fit patches to the points used; leave out cells without a surface."""
        for attempt in range(2):
            index = np.flatnonzero(used)
            index = index[np.argsort(cell[index], kind="stable")]
            _, begin, number = np.unique(
                cell[index], return_index=True, return_inverse=True
            )
            if len(begin) < _FEWEST_CELLS:
                raise CubeError(
                    f"the lines overlap in {len(begin)} places; needed are at least "
                    f"{_FEWEST_CELLS}. Check mounting and trajectories, or measure "
                    "lines over the same place"
                )
            chosen = points.part(index)
            center, axes, flat = _axes(chosen, begin, number)
            patches, sound = cls._iterated(chosen, number, begin, center, axes, size)
            # Points that are on no smooth surface, or far from it.
            sound &= flat[number]
            if attempt == 0:
                used = np.zeros_like(used)
                used[index[sound]] = True
                counts = np.bincount(cell, weights=used)
                used &= counts[cell] >= _FEWEST_IN_CELL
        return patches

    @classmethod
    def _iterated(
        cls,
        points: _Points,
        cell: Numbers,
        begin: Numbers,
        center: Floats,
        axes: Floats,
        size: float,
    ) -> tuple[_Patches, NDArray[np.bool_]]:
        """Fit coefficients; return patches and the mask of points near them."""
        coefficients = np.zeros((len(begin), _TERMS))
        turn = axes[cell]
        local = np.einsum("nij,nj->ni", turn, points.place - center[cell]) / size
        beam = np.einsum("nij,nj->ni", turn, points.beam)
        noise = points.sigma
        degrees = np.maximum(np.bincount(cell) - _TERMS, 1)
        for number in range(3):
            back = np.zeros(len(cell))
            for _ in range(2):
                at = local - back[:, None] * beam / size
                terms, slopes = _terms(at[:, 0], at[:, 1])
                height = np.einsum("nk,nk->n", terms, coefficients[cell])
                slope = np.einsum("ank,nk->na", slopes, coefficients[cell]) / size
                along = beam[:, 2] - np.einsum("na,na->n", slope, beam[:, :2])
                along = np.minimum(along, -_GRAZING / 2)
                back = back + (at[:, 2] * size - height) / along
            rows = terms / (along * noise)[:, None]
            gram = np.add.reduceat(rows[:, :, None] * rows[:, None, :], begin)
            right = np.add.reduceat(rows * (back / noise)[:, None], begin)
            gram += (
                1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(_TERMS)
            )
            step = np.linalg.solve(gram, right[:, :, None])[:, :, 0]
            remainder = back - noise * np.einsum("nk,nk->n", rows, step[cell])
            coefficients = coefficients + step
            if number == 1:
                square = (
                    np.bincount(cell, weights=(remainder / points.sigma) ** 2) / degrees
                )
                beyond = square > 1 + 4 * np.sqrt(2 / degrees)
                noise = points.sigma * np.sqrt(np.where(beyond, square, 1.0))[cell]
        gradient = np.column_stack([-slope, np.ones(len(cell))])
        gradient = np.einsum("nji,nj->ni", turn, gradient)
        facing = -along / np.linalg.norm(gradient, axis=1)
        sound = (np.abs(remainder) < 5 * noise) & (facing > _GRAZING)
        patches = cls(
            points, cell, begin, center, rows, gradient, along, remainder, noise
        )
        return patches, sound

    def apart(self) -> tuple[Floats, Floats]:
        """Return centers, and rms distances of the lines from each patch [m]."""
        count = len(self.begin)
        lines = int(self.points.line.max()) + 1
        key = self.cell * lines + self.points.line
        height = self.residual * self.along
        height = height / np.linalg.norm(self.gradient, axis=1)
        number = np.bincount(key, minlength=count * lines).reshape(count, lines)
        total = np.bincount(key, weights=height, minlength=count * lines)
        mean = total.reshape(count, lines) / np.maximum(number, 1)
        there = (number > 0).sum(axis=1)
        return self.center, np.sqrt((mean**2).sum(axis=1) / there)


def _axes(
    points: _Points, begin: Numbers, cell: Numbers
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return centers and axes of cells, normal last, and the mask of flat cells."""
    number = np.diff([*begin, len(cell)])[:, None]
    center = np.add.reduceat(points.place, begin) / number
    away = points.place - center[cell]
    spread = np.add.reduceat(away[:, :, None] * away[:, None, :], begin)
    values, vectors = np.linalg.eigh(spread)
    axes = np.swapaxes(vectors, 1, 2)[:, ::-1]
    beam = np.add.reduceat(points.beam, begin)
    # The normal points against the beams.
    axes = (
        axes
        * np.where(np.einsum("ci,ci->c", axes[:, 2], beam) > 0, -1, 1)[:, None, None]
    )
    flat = (values[:, 0] < 0.2 * values[:, 1]) & (values[:, 1] > 0.02 * values[:, 2])
    return center, axes, flat


def _terms(u: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Return the terms of a patch, (n, 10), and their derivatives, (2, n, 10)."""
    powers = [np.ones_like(u), u, u**2, u**3], [np.ones_like(v), v, v**2, v**3]

    def term(i: int, j: int) -> Floats:
        return np.asarray(powers[0][max(i, 0)] * powers[1][max(j, 0)])

    terms = [term(i, j) for i, j in _POWERS]
    slopes = [
        [i * term(i - 1, j) for i, j in _POWERS],
        [j * term(i, j - 1) for i, j in _POWERS],
    ]
    return np.stack(terms, axis=1), np.stack(slopes).swapaxes(1, 2)


@dataclass(frozen=True)
class _Rows:
    """Linearized ranges: derivatives by patches and by the unknowns."""

    cell: Numbers
    by_patch: Floats
    unknown: sparse.csr_matrix
    residual: Floats

    @classmethod
    def of(
        cls,
        patches: _Patches,
        derivatives: Floats,
        away: Floats,
        line: Numbers,
        size: int,
    ) -> _Rows:
        """Differentiate the ranges; `away` is the way from the vehicle to the point."""
        points, noise = patches.points, patches.noise
        factor = -patches.gradient / (patches.along * noise)[:, None]
        pose = np.hstack([factor, np.cross(away, factor)])
        count = len(noise)
        shared = np.column_stack([
            np.einsum("kni,ni->nk", derivatives, factor), -points.common / noise,
        ])  # fmt: skip
        first = shared.shape[1] + 6 * (line * (_INTERVALS + 1) + points.knot)
        columns = np.hstack([
            np.broadcast_to(np.arange(shared.shape[1]), shared.shape),
            first[:, None] + np.arange(12),
        ])  # fmt: skip
        share = points.share[:, None]
        values = np.hstack([shared, (1 - share) * pose, share * pose])
        starts = np.arange(count + 1) * columns.shape[1]
        unknown = sparse.csr_matrix(
            (values.ravel(), columns.ravel(), starts), shape=(count, size)
        )
        return cls(patches.cell, patches.rows, unknown, patches.residual / noise)

    def reduced(self) -> tuple[Floats, Floats, float]:
        """Return normal matrix, right side and square sum without the patches."""
        count = int(self.cell.max()) + 1
        rows = np.arange(len(self.cell))
        sums = sparse.csr_matrix((np.ones(len(rows)), (self.cell, rows)))
        square = self.by_patch[:, :, None] * self.by_patch[:, None]
        gram = (sums @ square.reshape(-1, _TERMS**2)).reshape(count, _TERMS, _TERMS)
        gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(_TERMS)
        inverse = np.linalg.inv(np.linalg.cholesky(gram))
        white = np.einsum("nij,nj->ni", inverse[self.cell], self.by_patch)
        columns = _TERMS * self.cell[:, None] + np.arange(_TERMS)
        starts = np.arange(len(white) + 1) * _TERMS
        patch = sparse.csr_matrix(
            (white.ravel(), columns.ravel(), starts), shape=(len(white), _TERMS * count)
        )
        mixed = (patch.T @ self.unknown).tocsr()
        fitted = patch.T @ self.residual
        normal = (self.unknown.T @ self.unknown - mixed.T @ mixed).toarray()
        right = self.unknown.T @ self.residual - mixed.T @ fitted
        scatter = float(self.residual @ self.residual - fitted @ fitted)
        return normal, right, scatter


class _Estimate:
    """Gauss-Newton iterations for mounting, trajectory errors and patches.

    Unknowns: the eight quantities, the shared error of the ranges, and three shifts and
    three rotations at each knot of each line.
    """

    def __init__(self, lines: list[_Line], start: Mounting) -> None:
        self.lines, self.start, self.mounting = lines, start, start
        stated = deviations(start)
        self.prior = np.where(np.isnan(stated), _START, stated)
        poses = [self._poses(line) for line in lines]
        self.knots = np.zeros((len(lines), _INTERVALS + 1))
        self.shift = np.ones((len(lines), 3))
        for number, placed in enumerate(poses):
            there = placed.known
            if int(there.sum()) < _FEWEST_IN_CELL:
                raise CubeError(
                    f"line {number + 1}: its trajectory has no poses at the times of "
                    "its pixels; check clock_offset and the order of the files"
                )
            time = placed.vehicle.time[there]
            self.knots[number] = np.linspace(time.min(), time.max(), _INTERVALS + 1)
            variance = np.einsum("nii->ni", placed.vehicle.covariance[there])
            middle = np.median(variance[:, :3], axis=0)
            # Positions of unknown uncertainty may be wrong by a metre.
            self.shift[number] = np.sqrt(np.where(np.isfinite(middle), middle, 1.0))
        self.shift = np.maximum(self.shift, 1e-6)
        self.errors = np.zeros(1 + 6 * self.knots.size)
        self.walks = np.array([3e-4, 1e-4])
        self.misfit = 1.0

    @property
    def free(self) -> NDArray[np.bool_]:
        """Mask of the unknowns that are estimated."""
        return np.concatenate([self.prior > 0, np.ones(self.errors.size, dtype=bool)])

    def result(self, *, suggest: bool) -> PatchTest:
        """Iterate with smaller and smaller cells, and describe the result."""
        points = self.points()
        size = _cell_size(points)
        before = _Patches.of(points, size).apart()
        for number, factor in enumerate(_SIZES):
            coarse = points.part(np.arange(0, len(points.line), int(factor)))
            try:
                patches = _Patches.of(coarse, factor * size)
            except CubeError:
                if factor == 1:
                    raise
                # A small overlap has few large cells.
                continue
            normal, right, scatter = self._rows(patches).reduced()
            degrees = len(patches.cell) - _TERMS * len(patches.begin)
            self.misfit = max(1.0, np.sqrt(scatter / degrees)) * self.misfit
            if number >= len(_SIZES) - 1:
                self._fit_walks(normal, right)
            self._step(normal, right)
            points = self.points()
            # Larger cells are curved more than a cubic.
            if number + 1 < len(_SIZES) and _SIZES[number + 1] > 1:
                self.misfit = 1.0
        patches = _Patches.of(points, size)
        rows = self._rows(patches)
        normal, _, _ = rows.reduced()
        covariance = self._covariance(normal, self._penalty(self.walks))
        return PatchTest(
            mounting=with_covariance(self.mounting, covariance),
            start=self.start,
            change=-self._to_start()[: len(QUANTITIES)],
            covariance=covariance,
            start_uncertainty=self.prior,
            undetermined=self._undetermined(patches, rows, covariance, suggest),
            points=len(patches.cell),
            misfit=self.misfit,
            position_walk=float(self.walks[0]),
            attitude_walk=float(self.walks[1]),
            before=before,
            after=patches.apart(),
        )

    def _poses(self, line: _Line) -> InstrumentPoses:
        frame = moving_frame(line.image, trajectory=line.track, mounting=self.mounting)
        return frame.at(*line.pixel)

    def points(self) -> _Points:
        """Place the points of all lines with the current estimate."""
        parts = []
        shared, errors = self.errors[0], self.errors[1:].reshape(*self.knots.shape, 6)
        for number, line in enumerate(self.lines):
            poses = self._poses(line)
            index = np.flatnonzero(poses.known)
            poses = poses.part(index)
            knots = self.knots[number]
            at = np.clip(poses.vehicle.time, knots[0], knots[-1])
            at = (at - knots[0]) / (knots[1] - knots[0])
            low = np.minimum(at.astype(np.intp), _INTERVALS - 1)
            share = at - low
            error = errors[number, low] * (1 - share)[:, None]
            error += errors[number, low + 1] * share[:, None]
            reach = line.distance[index] + shared * line.common[index]
            place = poses.place(
                line.begin[index] + reach[:, None] * line.direction[index]
            )
            beam = poses.turn(line.direction[index])
            away = place - poses.vehicle.position
            parts.append(
                _Points(
                    line=np.full(len(index), number),
                    knot=low,
                    share=share,
                    place=place + error[:, :3] + np.cross(error[:, 3:], away),
                    beam=beam + np.cross(error[:, 3:], beam),
                    sigma=self.misfit * line.sigma[index],
                    common=line.common[index],
                    poses=poses,
                )
            )
        arrays = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in vars(parts[0])
            if name != "poses"
        }
        vehicle = {
            name: np.concatenate([getattr(part.poses.vehicle, name) for part in parts])
            for name in Poses.__dataclass_fields__
        }
        poses = replace(parts[0].poses, vehicle=Poses(**vehicle))
        return _Points(**arrays, poses=poses)

    def _rows(self, patches: _Patches) -> _Rows:
        points = patches.points
        # Derivatives at the patch, which do not have the noise of the range.
        spot = points.place - patches.residual[:, None] * points.beam
        size = len(QUANTITIES) + self.errors.size
        away = spot - points.poses.vehicle.position
        derivatives = points.poses.derivatives(spot)
        return _Rows.of(patches, derivatives, away, points.line, size)

    def _to_start(self) -> Floats:
        """Return the start values minus the current ones, for all unknowns."""
        now, start = self.mounting, self.start
        back = Rotation.from_rotvec(now.boresight).inv()
        turn = (back * Rotation.from_rotvec(start.boresight)).as_rotvec()
        return np.array([
            *(np.array(start.lever_arm) - now.lever_arm), *turn,
            start.clock_offset - now.clock_offset, start.clock_drift - now.clock_drift,
            *-self.errors,
        ])  # fmt: skip

    def _penalty(self, walks: Floats, *, repeated: int | None = None) -> Floats:
        """Return the inverse covariance of the unknowns before the test.

        `repeated` is the number of a line that is measured once more.
        """
        numbers = [*range(len(self.lines)), *([] if repeated is None else [repeated])]
        blocks = []
        for number in numbers:
            step = np.diff(self.knots[number])
            for axis in range(6):
                walk = walks[axis // 3]
                first = walk**2 * step.sum()
                first += self.shift[number, axis] ** 2 if axis < 3 else 0.0
                change = np.eye(_INTERVALS + 1) - np.eye(_INTERVALS + 1, k=-1)
                variance = np.array([first, *(walk**2 * step)])
                blocks.append((change.T / variance) @ change)
        prior = 1 / np.where(self.prior > 0, self.prior, 1.0) ** 2
        head = np.diag([*prior, 1.0])
        size = len(head) + 6 * (_INTERVALS + 1) * len(numbers)
        result = np.zeros((size, size))
        result[: len(head), : len(head)] = head
        for number, block in enumerate(blocks):
            line, axis = divmod(number, 6)
            begin = len(head) + 6 * line * (_INTERVALS + 1) + axis
            columns = begin + 6 * np.arange(_INTERVALS + 1)
            result[np.ix_(columns, columns)] = block
        return result

    def _log_prior(self, walks: Floats) -> float:
        """Return the logarithm of the determinant of the penalty of the walks."""
        total = 0.0
        for knots, shift in zip(self.knots, self.shift, strict=True):
            step = np.diff(knots)
            for axis in range(6):
                walk = walks[axis // 3] ** 2
                first = walk * step.sum() + (shift[axis] ** 2 if axis < 3 else 0.0)
                total -= float(np.log(first) + np.log(walk * step).sum())
        return total

    def _step(self, normal: Floats, right: Floats) -> None:
        """Solve the normal equations, and change the estimate."""
        free, penalty = self.free, self._penalty(self.walks)
        right = right + penalty @ self._to_start()
        step = np.zeros(free.size)
        matrix = (normal + penalty)[np.ix_(free, free)]
        step[free] = np.linalg.solve(matrix, right[free])
        self.mounting = changed(self.mounting, step[: len(QUANTITIES)])
        self.errors = self.errors + step[len(QUANTITIES) :]

    def _fit_walks(self, normal: Floats, right: Floats) -> None:
        """Estimate the random walks of the trajectories by restricted likelihood."""
        free, away = self.free, self._to_start()
        inside = np.ix_(free, free)
        low, high = np.log(np.array(_WALKS)).T

        def cost(logarithms: Floats) -> float:
            walks = np.exp(np.clip(logarithms, low, high))
            penalty = self._penalty(walks)[inside]
            matrix = normal[inside] + penalty
            total = right[free] + penalty @ away[free]
            root = np.linalg.cholesky(matrix)
            fitted = float(np.square(solve_triangular(root, total, lower=True)).sum())
            before = float(away[free] @ penalty @ away[free])
            size = 2 * np.log(np.diag(root)).sum() - self._log_prior(walks)
            # A prior that is 0 at a walk of 0, where the likelihood may be largest.
            return float(size + before - fitted - logarithms.sum())

        best = minimize(
            cost, np.log(self.walks), method="Nelder-Mead",
            options={"xatol": 0.05, "fatol": 0.01, "maxfev": 50},
        )  # fmt: skip
        self.walks = np.exp(np.clip(best.x, low, high))

    def _covariance(self, normal: Floats, penalty: Floats) -> Floats:
        """Return the covariance of the eight quantities, 0 where not estimated."""
        free = np.ones(len(normal), dtype=bool)
        free[: len(QUANTITIES)] = self.prior > 0
        inverse = np.linalg.inv((normal + penalty)[np.ix_(free, free)])
        result = np.zeros(normal.shape)
        result[np.ix_(free, free)] = inverse
        return result[: len(QUANTITIES), : len(QUANTITIES)]

    def _undetermined(
        self, patches: _Patches, rows: _Rows, covariance: Floats, suggest: bool
    ) -> tuple[Undetermined, ...]:
        """Find undetermined quantities, and the additional line that helps most."""
        sigma = np.sqrt(np.diag(covariance))
        (loose,) = np.nonzero(sigma > _UNDETERMINED * self.prior)
        if not loose.size:
            return ()
        number = int(np.argmax(np.bincount(patches.points.line)))
        better = {
            text: np.sqrt(np.diag(self._with_line(patches, rows, number, kind)))
            for kind, text in _SUGGESTIONS.items()
            if suggest
        }
        quantities = []
        for k in loose:
            text = min(better, key=lambda text: better[text][k], default="")
            helps = bool(text) and better[text][k] < 0.7 * sigma[k]
            quantities.append(
                Undetermined(
                    quantity=QUANTITIES[k],
                    uncertainty=float(sigma[k]),
                    start_uncertainty=float(self.prior[k]),
                    line=text.format(number=number + 1) if helps else "",
                    with_line=float(better[text][k] if helps else sigma[k]),
                )
            )
        return tuple(quantities)

    def _with_line(
        self, patches: _Patches, rows: _Rows, number: int, kind: str
    ) -> Floats:
        """Predict the covariance with a line more, which repeats one differently."""
        chosen = np.flatnonzero(patches.points.line == number)
        points = patches.points.part(chosen)
        poses, count = points.poses, len(chosen)
        spot = points.place - patches.residual[chosen, None] * points.beam
        derivatives = poses.derivatives(spot)
        turn, spin = np.zeros((count, 3)), np.zeros((count, 3))
        phase = 2 * np.pi * poses.vehicle.time / _PERIOD
        if kind in ("opposite", "across"):
            turn[:, 2] = np.pi if kind == "opposite" else np.pi / 2
        elif kind in ("roll", "pitch"):
            axis = poses.vehicle.rotation[:, :, 2 if kind == "roll" else 0]
            turn = _ROCKING * np.sin(phase)[:, None] * axis
            spin = 2 * np.pi / _PERIOD * _ROCKING * np.cos(phase)[:, None] * axis
        else:
            derivatives[6] += poses.vehicle.velocity
        # The vehicle, turned about the point that it measures.
        turned = Rotation.from_rotvec(turn)
        away = turned.apply(spot - poses.vehicle.position)
        derivatives = np.stack([turned.apply(part) for part in derivatives])
        derivatives[6] += np.cross(spin, away)
        derivatives[7] = derivatives[6] * poses.since_reference[:, None]
        along = np.einsum(
            "ni,ni->n", patches.gradient[chosen], turned.apply(points.beam)
        )
        size = np.linalg.norm(patches.gradient[chosen], axis=1)
        seen = along < -_GRAZING * size
        repeated = replace(
            patches,
            points=points,
            cell=patches.cell[chosen],
            rows=patches.rows[chosen]
            * (patches.along[chosen] / np.where(seen, along, -1.0))[:, None],
            gradient=patches.gradient[chosen],
            along=np.where(seen, along, -1.0),
            residual=patches.residual[chosen],
            noise=np.where(seen, patches.noise[chosen], 1e6),
        )
        line = np.full(count, len(self.lines))
        width = rows.unknown.shape[1] + 6 * (_INTERVALS + 1)
        more = _Rows.of(repeated, derivatives, away, line, width)
        wider = sparse.csr_matrix(rows.unknown)
        wider.resize(wider.shape[0], width)
        both = _Rows(
            np.concatenate([rows.cell, more.cell]),
            np.concatenate([rows.by_patch, more.by_patch]),
            sparse.vstack([wider, more.unknown]).tocsr(),
            np.concatenate([rows.residual, more.residual]),
        )
        penalty = self._penalty(self.walks, repeated=number)
        return self._covariance(both.reduced()[0], penalty)


#: Additional lines that are tried, and their descriptions.
_SUGGESTIONS = {
    "opposite": "line {number} in the opposite direction",
    "across": "a line across line {number}",
    "fast": "line {number} at twice the speed",
    "roll": "line {number} while the vehicle rolls by 10 degrees every 4 s",
    "pitch": "line {number} while the vehicle pitches by 10 degrees every 4 s",
}


def _cell_size(points: _Points) -> float:
    """Return the size of cells with a mean number of points of each line [m]."""
    size = 0.1
    for _ in range(4):
        place = np.floor(points.place / size).astype(np.int64)
        key = np.column_stack([points.line, place])
        filled = len(points.line) / len(np.unique(key, axis=0))
        size *= float(np.clip(np.sqrt(_FILLED / filled), 0.2, 5.0))
    return size
