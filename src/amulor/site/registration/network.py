"""Poses, targets and shared errors of a site at once: Gauss-Newton and covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from amulor.site.registration.pair import Pair
from amulor.site.registration.pose import ScanPose, cross_matrix, departure
from amulor.site.registration.surface import ScanSurface

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Centre:
    """A target as one scan saw it."""

    target: str
    """Name of the target."""
    scan: str
    """Name of the scan."""
    position: Floats
    """Its centre in the axes of the instrument, shape (3,) [m]."""
    covariance: Floats
    """Of its noise, shape (3, 3) [m^2]."""
    shared: dict[str, Floats]
    """How one standard deviation of each shared error moves it, shape (3,) [m]."""


@dataclass(frozen=True, kw_only=True)
class KnownPose:
    """What was known of a pose beforehand."""

    pose: ScanPose
    """About where it stands."""
    covariance: Floats
    """Of shift and turn, shape (6, 6)."""


@dataclass(frozen=True, kw_only=True)
class KnownPoint:
    """A target whose place is known."""

    position: Floats
    """In the site, shape (3,) [m]."""
    sigma: Floats
    """Standard uncertainty of each coordinate, shape (3,) [m]."""


@dataclass(frozen=True, kw_only=True)
class KnownDistance:
    """A scale bar."""

    ends: tuple[str, str]
    """Names of two targets."""
    length: float
    """Their distance [m]."""
    sigma: float
    """Its standard uncertainty [m]."""


@dataclass(frozen=True, kw_only=True)
class Ties:
    """All that holds scans but their surfaces."""

    start: Mapping[str, KnownPose]
    """By scan."""
    centres: Sequence[Centre] = ()
    """Targets in scans."""
    control: Mapping[str, KnownPoint] = field(default_factory=dict)
    """By target."""
    bars: Sequence[KnownDistance] = ()
    """Known distances."""
    fixed: str | None = None
    """Scan whose axes are those of the site, if nothing ties it to the world."""


@dataclass
class State:
    """Estimates so far."""

    poses: dict[str, ScanPose]
    """By scan."""
    points: dict[str, Floats]
    """By target, in the site [m]."""
    errors: dict[str, float]
    """Shared errors by key, in standard deviations [1]."""


class Layout:
    """Which unknown stands where."""

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
        """Return the places of some unknowns, -1 for what is fixed."""
        found = [
            np.arange(self.at[kind, name].start, self.at[kind, name].stop)
            if (kind, name) in self.at
            else np.full(width, -1)
            for name in names
        ]
        return np.concatenate(found) if found else np.zeros(0, dtype=np.intp)


class _System:
    """Normal equations as they are added up."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.rows: list[Numbers] = []
        self.columns: list[Numbers] = []
        self.values: list[Floats] = []
        self.gradient = np.zeros(size)
        # Variance of the gradient by what is no noise of pixels.
        self.scatter = np.zeros((size, size))

    def add(self, at: Numbers, matrix: Floats, gradient: Floats) -> None:
        kept = at >= 0
        at, matrix = at[kept], matrix[np.ix_(kept, kept)]
        self.rows.append(np.repeat(at, len(at)))
        self.columns.append(np.tile(at, len(at)))
        self.values.append(matrix.ravel())
        np.add.at(self.gradient, at, gradient[kept])

    def add_known(self, at: Numbers, matrix: Floats, gradient: Floats) -> None:
        """Add what has the information matrix as the variance of its gradient."""
        self.add(at, matrix, gradient)
        kept = at >= 0
        self.scatter[np.ix_(at[kept], at[kept])] += matrix[np.ix_(kept, kept)]

    def factor(self) -> object:
        matrix = sparse.csc_matrix(
            (
                np.concatenate(self.values),
                (np.concatenate(self.rows), np.concatenate(self.columns)),
            ),
            shape=(self.size, self.size),
        )
        return splu(matrix)


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step of Gauss and Newton."""

    state: State
    """After it."""
    largest: float
    """Largest shift of a scan [m], or turn times one metre."""


def step(
    state: State,
    pairs: Sequence[Pair],
    ties: Ties,
    trust: Sequence[float],
    *,
    steady: bool = False,
) -> Step:
    """Return better estimates."""
    layout = Layout(state, ties.fixed)
    system = _system(state, pairs, ties, trust, layout, steady=steady)
    change = -np.asarray(system.factor().solve(system.gradient))  # type: ignore[attr-defined]
    largest = 0.0
    poses = {}
    for name, pose in state.poses.items():
        if ("pose", name) in layout.at:
            part = change[layout.at["pose", name]]
            largest = max(largest, float(np.abs(part).max()))
            pose = pose.changed(part)
        poses[name] = pose
    points = {
        name: point + change[layout.at["point", name]]
        for name, point in state.points.items()
    }
    errors = {
        key: value + float(change[layout.at["error", key]][0])
        for key, value in state.errors.items()
    }
    return Step(state=State(poses, points, errors), largest=largest)


def covariance(
    state: State,
    pairs: Sequence[Pair],
    ties: Ties,
    trust: Sequence[float],
    surfaces: Mapping[str, ScanSurface],
) -> tuple[Floats, Layout]:
    r"""Return the covariance of all estimates.

    :math:`A^{-1} B A^{-T}` with the derivative A of the gradient and its variance B.
    The noise of each pixel is followed into the gradient, through every point, patch
    and pair that it takes part in, so that what neighbours share is not averaged away.
    """
    layout = Layout(state, ties.fixed)
    system = _system(state, pairs, ties, trust, layout)
    variance = system.scatter
    for name, surface in surfaces.items():
        variance += _of_noise(name, surface, state, pairs, trust, layout)
    factor = system.factor()
    half = np.asarray(factor.solve(variance))  # type: ignore[attr-defined]
    whole = np.asarray(factor.solve(np.ascontiguousarray(half.T)))  # type: ignore[attr-defined]
    return (whole + whole.T) / 2, layout


def _system(
    state: State,
    pairs: Sequence[Pair],
    ties: Ties,
    trust: Sequence[float],
    layout: Layout,
    *,
    steady: bool = False,
) -> _System:
    system = _System(layout.size)
    for pair, weight in zip(pairs, trust, strict=True):
        at, spread = _into(pair, state, layout)
        x = pair.by_target @ spread
        z = x if steady else pair.by_source @ spread
        weighted = z * (weight * pair.weight)[:, None]
        system.add(at, weighted.T @ x, weighted.T @ pair.distance)
    for key, value in state.errors.items():
        at = layout.columns("error", [key], 1)
        system.add_known(at, np.eye(1), np.array([value]))
    for name, known in ties.start.items():
        pose = state.poses[name]
        off = departure(pose, known.pose)
        matrix = np.asarray(np.linalg.inv(known.covariance), dtype=float)
        system.add_known(layout.columns("pose", [name], 6), matrix, matrix @ off)
    for centre in ties.centres:
        _add_centre(system, centre, state, layout)
    for name, point in ties.control.items():
        matrix = np.asarray(np.diag(1 / point.sigma**2), dtype=float)
        off = state.points[name] - point.position
        system.add_known(layout.columns("point", [name], 3), matrix, matrix @ off)
    for bar in ties.bars:
        one, other = (state.points[end] for end in bar.ends)
        length = float(np.linalg.norm(one - other))
        unit = (one - other) / max(length, 1e-9)
        row = np.concatenate([unit, -unit])[None]
        at = layout.columns("point", bar.ends, 3)
        off = np.array([length - bar.length])
        system.add_known(at, row.T @ row / bar.sigma**2, row.T @ off / bar.sigma**2)
    return system


def _into(pair: Pair, state: State, layout: Layout) -> tuple[Numbers, Floats]:
    """Return the unknowns of a pair, and how its six numbers follow from them."""
    poses = [state.poses[name] for name in (pair.source, pair.target)]
    relative = np.zeros((6, 12))
    for number, (pose, sign) in enumerate(zip(poses, (1.0, -1.0), strict=True)):
        block = np.eye(6)
        block[:3, 3:] = -cross_matrix(pair.pivot - pose.position)
        relative[:, 6 * number : 6 * number + 6] = sign * block
    keys = len(pair.keys)
    spread = np.zeros((6 + keys, 12 + keys))
    spread[:6, :12] = pair.held @ relative
    spread[6:, 12:] = np.eye(keys)
    at = np.concatenate(
        [
            layout.columns("pose", [pair.source, pair.target], 6),
            layout.columns("error", pair.keys, 1),
        ]
    )
    return at, spread


def _add_centre(system: _System, centre: Centre, state: State, layout: Layout) -> None:
    """Add a target as one scan saw it."""
    pose = state.poses[centre.scan]
    arm = pose.turn(centre.position)
    moved = [pose.turn(shift) for shift in centre.shared.values()]
    known = [state.errors[key] for key in centre.shared]
    off = arm + pose.position - state.points[centre.target]
    for shift, value in zip(moved, known, strict=True):
        off = off - value * shift
    row = np.hstack(
        [
            np.eye(3),
            -cross_matrix(arm),
            -np.eye(3),
            -np.array(moved).T.reshape(3, len(moved)),
        ]
    )
    at = np.concatenate(
        [
            layout.columns("pose", [centre.scan], 6),
            layout.columns("point", [centre.target], 3),
            layout.columns("error", list(centre.shared), 1),
        ]
    )
    turned = pose.rotation @ centre.covariance @ pose.rotation.T
    weight = np.linalg.inv(turned)
    system.add_known(at, row.T @ weight @ row, row.T @ weight @ off)


def _of_noise(
    name: str,
    surface: ScanSurface,
    state: State,
    pairs: Sequence[Pair],
    trust: Sequence[float],
    layout: Layout,
) -> Floats:
    """Return the variance of the gradient by the noise of the pixels of one scan."""
    parts: list[tuple[Pair, float]] = [
        (pair, weight)
        for pair, weight in zip(pairs, trust, strict=True)
        if name in (pair.source, pair.target)
    ]
    variance = np.zeros((layout.size, layout.size))
    if not parts:
        return variance
    columns = np.unique(
        np.concatenate([_into(pair, state, layout)[0] for pair, _ in parts])
    )
    columns = columns[columns >= 0]
    place = np.full(layout.size, -1)
    place[columns] = np.arange(len(columns))
    of_pixel = np.zeros((surface.own.size, len(columns)))
    for pair, weight in parts:
        at, spread = _into(pair, state, layout)
        kept = at >= 0
        factor = np.sqrt(weight) * pair.misfit * pair.weight
        rows = (pair.by_source @ spread[:, kept]) * factor[:, None]
        local = place[at[kept]]
        if name == pair.source:
            of_pixel[np.ix_(pair.source_pixel, local)] += rows * pair.along[:, None]
        else:
            of_pixel[:, local] += pair.window.T @ rows
    own = np.nan_to_num(surface.own.ravel())
    used = of_pixel.any(axis=1)
    noise = of_pixel[used] * own[used, None]
    variance[np.ix_(columns, columns)] = noise.T @ noise
    return variance


def innovation(
    pair: Pair, state: State, surfaces: Mapping[str, ScanSurface]
) -> tuple[Floats, Floats]:
    """Return by how much a pair by itself would move its source, and the covariance."""
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
