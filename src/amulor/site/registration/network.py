"""Joint adjustment of poses, targets and shared errors: iterations, covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from amulor.platform.attitude import cross_matrix
from amulor.site.registration.bodies import HELD
from amulor.site.registration.line import Motion
from amulor.site.registration.pair import Pair
from amulor.site.registration.pose import ScanPose, departure
from amulor.site.registration.surface import ScanSurface

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]

#: Smallest relative variance of a gradient that is more than rounding [1].
_SINGULAR = 1e-10


@dataclass(frozen=True, kw_only=True)
class Centre:
    """Measured center of a target in one scan."""

    target: str
    """Name of the target."""
    scan: str
    """Name of the scan."""
    position: Floats
    """Center in instrument axes, shape (3,) [m]."""
    covariance: Floats
    """Covariance of the center by noise of its pixels, shape (3, 3) [m^2]."""
    shared: dict[str, Floats]
    """Displacement by one standard deviation of each shared error, shape (3,) [m]."""


@dataclass(frozen=True, kw_only=True)
class KnownPose:
    """Start pose of a scan with its covariance."""

    pose: ScanPose
    """Start pose."""
    covariance: Floats
    """Covariance of translation and rotation, shape (6, 6)."""


@dataclass(frozen=True, kw_only=True)
class KnownPoint:
    """Control point: target at a known position."""

    position: Floats
    """Position in the site, shape (3,) [m]."""
    sigma: Floats
    """Standard uncertainty of each coordinate, shape (3,) [m]."""


@dataclass(frozen=True, kw_only=True)
class KnownDistance:
    """Scale bar: known distance between two targets."""

    ends: tuple[str, str]
    """Names of the two targets."""
    length: float
    """Distance between the targets [m]."""
    sigma: float
    """Standard uncertainty of the distance [m]."""


@dataclass(frozen=True, kw_only=True)
class Ties:
    """Observations except surfaces: start poses, targets, control points, bars."""

    start: Mapping[str, KnownPose]
    """Start poses by scan."""
    centres: Sequence[Centre] = ()
    """Measured centers of targets."""
    control: Mapping[str, KnownPoint] = field(default_factory=dict)
    """Control points by target."""
    bars: Sequence[KnownDistance] = ()
    """Scale bars between targets."""
    fixed: str | None = None
    """Scan whose axes define the axes of the site; None if start poses or control
    points define them."""


@dataclass
class State:
    """Current estimates of all unknowns: poses, target positions and shared errors."""

    poses: dict[str, ScanPose]
    """Poses by scan."""
    points: dict[str, Floats]
    """Positions of targets in the site's frame, by name [m]."""
    errors: dict[str, float]
    """Shared errors by key, in units of their standard deviation [1]."""


class Layout:
    """Indices of the unknowns in the vector of the adjustment."""

    def __init__(self, state: State, fixed: str | None) -> None:
        self.at: dict[tuple[str, str], slice] = {}
        size = 0
        groups = [
            ("pose", [name for name in state.poses if name != fixed], 6),
            ("point", list(state.points), 3),
            ("error", list(state.errors), 1),
        ]
        for kind, names, width in groups:
            for name in names:
                self.at[kind, name] = slice(size, size + width)
                size += width
        self.size = size

    def columns(self, kind: str, names: Sequence[str], width: int) -> Numbers:
        """Return the vector indices of named unknowns; -1 for fixed unknowns."""
        places = [
            np.arange(self.at[kind, name].start, self.at[kind, name].stop)
            if (kind, name) in self.at
            else np.full(width, -1)
            for name in names
        ]
        return np.concatenate(places) if places else np.zeros(0, dtype=np.intp)


class System:
    """Normal equations of the adjustment, summed over the observations."""

    def __init__(self, size: int) -> None:
        self.matrix = np.zeros((size, size))
        self.gradient = np.zeros(size)
        # Variance of the gradient, without noise of pixels.
        self.scatter = np.zeros((size, size))
        # Weights of the gradients of the surfaces in each equation.
        self.combined = np.eye(size)

    def add(self, at: Numbers, matrix: Floats, gradient: Floats) -> None:
        """Add matrix and gradient of an observation; index -1 marks fixed unknowns."""
        free = at >= 0
        at = at[free]
        self.matrix[np.ix_(at, at)] += matrix[np.ix_(free, free)]
        np.add.at(self.gradient, at, gradient[free])

    def add_prior(self, at: Numbers, matrix: Floats, gradient: Floats) -> None:
        """Add an observation with independent noise, such as a start pose."""
        self.add(at, matrix, gradient)
        free = at >= 0
        self.scatter[np.ix_(at[free], at[free])] += matrix[np.ix_(free, free)]

    def project(self, projection: Floats) -> None:
        """Remove undetermined directions from the normal equations by a projection."""
        self.matrix = projection.T @ self.matrix @ projection
        self.gradient = projection.T @ self.gradient

    def combine(self, noise: Floats) -> None:
        r"""Combine the gradients of the surfaces by their noise.

        With the derivative A of the gradient g and its variance B, the equations are
        :math:`A^T B^{-1} g = 0` (two-stage least squares).
        """
        scale = np.sqrt(noise.diagonal())
        scale = np.where(scale > 0, scale, 1.0)
        inverse = np.linalg.pinv(
            noise / np.outer(scale, scale), rcond=_SINGULAR, hermitian=True
        )
        self.combined = self.matrix.T @ (inverse / np.outer(scale, scale))
        self.matrix = self.combined @ self.matrix
        self.gradient = self.combined @ self.gradient


@dataclass(frozen=True, kw_only=True)
class Step:
    """Result of a Gauss-Newton iteration."""

    state: State
    """Estimates after the iteration."""
    score: float
    """Chi-square of the full step with respect to the information matrix [1]."""
    free: int
    """Number of directions that the surfaces do not constrain [1]."""


def step(
    state: State,
    pairs: Sequence[Pair],
    ties: Ties,
    trust: Sequence[float],
    *,
    steady: bool = False,
    free: int = 0,
    part: float = 1.0,
    surfaces: Mapping[str, ScanSurface] | None = None,
) -> Step:
    """Update all unknowns by a Gauss-Newton step, or by a part of one."""
    layout = Layout(state, ties.fixed)
    projection, free = projector(state, pairs, trust, layout, free)
    system = system_of(
        state, pairs, ties, trust, layout, projection,
        steady=steady, surfaces=surfaces,
    )  # fmt: skip
    change = -np.asarray(np.linalg.solve(system.matrix, system.gradient), dtype=float)
    score = abs(float(change @ system.gradient))
    change = part * change
    poses = {}
    for name, pose in state.poses.items():
        if ("pose", name) in layout.at:
            pose = pose.changed(change[layout.at["pose", name]])
        poses[name] = pose
    points = {
        name: point + change[layout.at["point", name]]
        for name, point in state.points.items()
    }
    errors = {
        key: value + float(change[layout.at["error", key]][0])
        for key, value in state.errors.items()
    }
    return Step(state=State(poses, points, errors), score=score, free=free)


def covariance(
    state: State,
    pairs: Sequence[Pair],
    ties: Ties,
    trust: Sequence[float],
    surfaces: Mapping[str, ScanSurface],
    *,
    free: int = 0,
) -> tuple[Floats, Floats, Layout]:
    r"""Return the covariance of all estimates, the inverse normal matrix, the layout.

    The covariance is :math:`A^{-1} B A^{-T}`, with the derivative A of the gradient and
    its variance B. B contains the effect of each pixel's noise through every point,
    patch and pair that uses the pixel. Noise shared by neighbors is thus not averaged
    out.
    """
    layout = Layout(state, ties.fixed)
    projection, _ = projector(state, pairs, trust, layout, free)
    system = system_of(state, pairs, ties, trust, layout, projection, surfaces=surfaces)
    noise = np.zeros((layout.size, layout.size))
    for name, surface in surfaces.items():
        noise += _noise_variance(name, surface, state, pairs, trust, layout)
    for name, motion in _lines(surfaces).items():
        noise += _drift_variance(name, motion, state, pairs, trust, layout)
    carried = system.combined @ projection.T
    variance = system.scatter + carried @ noise @ carried.T
    inverse = np.asarray(np.linalg.inv(system.matrix), dtype=float)
    spread = inverse @ variance @ inverse.T
    return (spread + spread.T) / 2, inverse, layout


def system_of(
    state: State,
    pairs: Sequence[Pair],
    ties: Ties,
    trust: Sequence[float],
    layout: Layout,
    projection: Floats,
    *,
    steady: bool = False,
    surfaces: Mapping[str, ScanSurface] | None = None,
) -> System:
    """Return the normal equations of all observations.

    With lines among the `surfaces`, normals hardly determine some errors. Noise of the
    normals must not determine them, so gradients are combined by their noise.
    """
    system = System(layout.size)
    lines = {} if steady else _lines(surfaces or {})
    noise = np.zeros((layout.size, layout.size))
    for pair, weight in zip(pairs, trust, strict=True):
        at, spread = pair_unknowns(pair, state, layout)
        x = pair.by_target @ spread
        z = x if steady else pair.by_source @ spread
        weighted = z * (weight * pair.weight)[:, None]
        system.add(at, weighted.T @ x, weighted.T @ pair.distance)
        if lines:
            known = at >= 0
            noise[np.ix_(at[known], at[known])] += (weighted.T @ z)[
                np.ix_(known, known)
            ]
    system.project(projection)
    if lines:
        for name, motion in lines.items():
            noise += _drift_variance(name, motion, state, pairs, trust, layout)
        system.combine(projection.T @ noise @ projection)
    for key, value in state.errors.items():
        at = layout.columns("error", [key], 1)
        system.add_prior(at, np.eye(1), np.array([value]))
    for name, start in ties.start.items():
        pose = state.poses[name]
        off = departure(pose, start.pose)
        matrix = np.asarray(np.linalg.inv(start.covariance), dtype=float)
        system.add_prior(layout.columns("pose", [name], 6), matrix, matrix @ off)
    for centre in ties.centres:
        _add_centre(system, centre, state, layout)
    for name, point in ties.control.items():
        matrix = np.asarray(np.diag(1 / point.sigma**2), dtype=float)
        off = state.points[name] - point.position
        system.add_prior(layout.columns("point", [name], 3), matrix, matrix @ off)
    for bar in ties.bars:
        first, second = (state.points[end] for end in bar.ends)
        length = float(np.linalg.norm(first - second))
        unit = (first - second) / max(length, 1e-9)
        row = np.concatenate([unit, -unit])[None]
        at = layout.columns("point", bar.ends, 3)
        off = np.array([length - bar.length])
        system.add_prior(at, row.T @ row / bar.sigma**2, row.T @ off / bar.sigma**2)
    return system


def pair_unknowns(pair: Pair, state: State, layout: Layout) -> tuple[Numbers, Floats]:
    """Return indices of a scan pair's unknowns, and Jacobian of the relative motion."""
    poses = [state.poses[name] for name in (pair.source, pair.target)]
    relative = np.zeros((6, 12))
    for number, (pose, sign) in enumerate(zip(poses, (1.0, -1.0), strict=True)):
        block = np.eye(6)
        block[:3, 3:] = -cross_matrix(pair.pivot - pose.position)
        relative[:, 6 * number : 6 * number + 6] = sign * block
    keys = len(pair.keys)
    spread = np.zeros((6 + keys, 12 + keys))
    spread[:6, :12] = relative
    spread[6:, 12:] = np.eye(keys)
    at = np.concatenate(
        [
            layout.columns("pose", [pair.source, pair.target], 6),
            layout.columns("error", pair.keys, 1),
        ]
    )
    return at, spread


def projector(
    state: State,
    pairs: Sequence[Pair],
    trust: Sequence[float],
    layout: Layout,
    least: int,
) -> tuple[Floats, int]:
    """Return the projector onto determined directions, and the number of free ones.

    Directions are those of all poses together, because one pair may determine a
    direction that another pair does not.
    """
    size = layout.size
    information, extent = np.zeros((size, size)), np.zeros((size, size))
    parts = []
    for pair, weight in zip(pairs, trust, strict=True):
        at, spread = pair_unknowns(pair, state, layout)
        poses = at[:12] >= 0
        at, spread = at[:12][poses], spread[:6, :12][:, poses]
        weighted = pair.by_source[:, :6] * (weight * pair.weight)[:, None]
        sums = spread.T @ (weighted.T @ pair.by_target[:, :6]) @ spread
        moved = spread.T @ pair.mean_square @ spread * (weight * pair.unsure)
        place = np.ix_(at, at)
        information[place] += (sums + sums.T) / 2
        extent[place] += moved
        parts.append((at, moved))
    values, axes = np.linalg.eigh(extent)
    # A common motion of all scans, and unknowns other than poses, do not change
    # distances.
    relative = values > 1e-10 * max(float(values[-1]), 1e-300)
    modes = axes[:, relative] / np.sqrt(values[relative])
    sums, turned = np.linalg.eigh(modes.T @ information @ modes)
    modes = modes @ turned
    noise = np.zeros(len(sums))
    for at, moved in parts:
        noise += np.einsum("ij,ik,kj->j", modes[at], moved, modes[at]) ** 2
    ratio = sums / np.sqrt(np.maximum(noise, 1e-300))
    count = min(max(int((ratio < HELD).sum()), least), len(ratio))
    free = modes[:, np.argsort(ratio)[:count]]
    return np.asarray(np.eye(size) - free @ free.T @ extent), count


def _add_centre(system: System, centre: Centre, state: State, layout: Layout) -> None:
    """Add the observed center of a target to the normal equations."""
    off, row, at = centre_derivatives(centre, state, layout)
    rotation = state.poses[centre.scan].rotation
    weight = np.linalg.inv(rotation @ centre.covariance @ rotation.T)
    system.add_prior(at, row.T @ weight @ row, row.T @ weight @ off)


def centre_derivatives(
    centre: Centre, state: State, layout: Layout
) -> tuple[Floats, Floats, Numbers]:
    """Return residual, derivatives and vector indices of an observed target center."""
    pose = state.poses[centre.scan]
    arm = pose.turn(centre.position)
    shifts = [pose.turn(shift) for shift in centre.shared.values()]
    off = arm + pose.position - state.points[centre.target]
    for shift, key in zip(shifts, centre.shared, strict=True):
        off = off - state.errors[key] * shift
    row = np.hstack(
        [
            np.eye(3),
            -cross_matrix(arm),
            -np.eye(3),
            -np.array(shifts).T.reshape(3, len(shifts)),
        ]
    )
    at = np.concatenate(
        [
            layout.columns("pose", [centre.scan], 6),
            layout.columns("point", [centre.target], 3),
            layout.columns("error", list(centre.shared), 1),
        ]
    )
    return off, row, at


def _noise_variance(
    name: str,
    surface: ScanSurface,
    state: State,
    pairs: Sequence[Pair],
    trust: Sequence[float],
    layout: Layout,
) -> Floats:
    """Return the gradient covariance that the noise of one scan's pixels causes."""
    parts: list[tuple[Pair, float]] = [
        (pair, weight)
        for pair, weight in zip(pairs, trust, strict=True)
        if name in (pair.source, pair.target)
    ]
    variance = np.zeros((layout.size, layout.size))
    if not parts:
        return variance
    columns = np.unique(
        np.concatenate([pair_unknowns(pair, state, layout)[0] for pair, _ in parts])
    )
    columns = columns[columns >= 0]
    place = np.full(layout.size, -1)
    place[columns] = np.arange(len(columns))
    of_pixel = np.zeros((surface.own.size, len(columns)))
    for pair, weight in parts:
        at, spread = pair_unknowns(pair, state, layout)
        free = at >= 0
        factor = np.sqrt(weight) * pair.misfit * pair.weight
        rows = (pair.by_source @ spread[:, free]) * factor[:, None]
        local = place[at[free]]
        if name == pair.source:
            of_pixel[np.ix_(pair.source_pixel, local)] += rows * pair.along[:, None]
        else:
            of_pixel[:, local] += pair.window.T @ rows
    of_pixel *= np.nan_to_num(surface.own.ravel())[:, None]
    variance[np.ix_(columns, columns)] = of_pixel.T @ of_pixel
    return variance


def _lines(surfaces: Mapping[str, ScanSurface]) -> dict[str, Motion]:
    """Return the motions of the scans from a moving instrument."""
    return {
        name: surface.motion
        for name, surface in surfaces.items()
        if surface.motion is not None
    }


def _drift_variance(
    name: str,
    motion: Motion,
    state: State,
    pairs: Sequence[Pair],
    trust: Sequence[float],
    layout: Layout,
) -> Floats:
    """Return the gradient covariance by drifts of one line that are no unknowns."""
    effect: Floats | None = None
    for pair, weight in zip(pairs, trust, strict=True):
        if name not in (pair.source, pair.target):
            continue
        at, spread = pair_unknowns(pair, state, layout)
        known = at >= 0
        rows = pair.by_source @ spread[:, known]
        rows *= (np.sqrt(weight) * pair.weight)[:, None]
        sums = drift_effect(name, motion, pair, rows)
        if effect is None:
            effect = np.zeros((len(sums), layout.size))
        effect[:, at[known]] += sums
    if effect is None:
        return np.zeros((layout.size, layout.size))
    return np.asarray(effect.T @ effect)


def drift_effect(name: str, motion: Motion, pair: Pair, rows: Floats) -> Floats:
    """Return the effects of a line's drifts on weighted sums of a pair's distances.

    `rows` are the weights of the points, (n, sums). The shape is (drift, sums); only
    drifts that are no unknowns count, each by one sigma.
    """
    pixel, sign = pair.target_pixel, -1.0
    if name == pair.source:
        pixel, sign = pair.source_pixel, 1.0
    shift, turn = pair.by_target[:, :3], pair.by_target[:, 3:6]
    vehicle = np.nan_to_num(motion.poses.part(pixel).vehicle.position)
    # Attitudes turn points about the vehicle, not about the pivot of the pair.
    turn = turn + np.cross(pair.pivot - vehicle, shift)
    return sign * np.concatenate(
        [
            forms @ (by_axis[:, None] * rows)
            for forms, vectors in zip(motion.rests(pixel), (shift, turn), strict=True)
            for by_axis in vectors.T
        ]
    )


def innovation(
    pair: Pair, state: State, surfaces: Mapping[str, ScanSurface]
) -> tuple[Floats, Floats]:
    """Return the pose change estimated from one scan pair alone, and its covariance."""
    x, z = (rows[:, :6] @ pair.held for rows in (pair.by_target, pair.by_source))
    weighted = z * pair.weight[:, None]
    back = np.linalg.pinv(weighted.T @ x, rcond=1e-10)
    noisy = pair.misfit * weighted
    source = (
        noisy
        * (pair.along * surfaces[pair.source].own.ravel()[pair.source_pixel])[:, None]
    )
    target = np.asarray(pair.window.T @ noisy)
    target *= np.nan_to_num(surfaces[pair.target].own.ravel())[:, None]
    variance = source.T @ source + target.T @ target
    return -back @ (weighted.T @ pair.distance), back @ variance @ back.T
