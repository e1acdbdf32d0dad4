"""From start poses to poses with a covariance: rough, then pairs, then all at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import chi2

from amulor._progress import tell
from amulor.errors import CubeError
from amulor.site.registration import network
from amulor.site.registration.network import KnownPose, Layout, State, Ties
from amulor.site.registration.pair import Pair, compared, tree_of
from amulor.site.registration.patterns import PatternTest, pattern_tests
from amulor.site.registration.pose import ScanPose, aligned, departure
from amulor.site.registration.surface import ScanSurface

Floats = NDArray[np.float64]

#: Steps with a wide gate, narrowing, then with that of the noise [1].
_WIDE_STEPS, _FINE_STEPS = 3, 20
#: After so many fine steps a point that was left out stays out, and no direction is
#: constrained again: at a limit they would come and go for ever [1].
_FREE_STEPS = 5
#: After so many fine steps only half a step is taken: where points change the pixel
#: that they are compared with, whole steps may go to and fro [1].
_HALF_STEPS = 8
#: Chi-square of a step that ends the work, and of one that has settled: a fifth of the
#: stated uncertainty, all unknowns together [1].
_DONE, _SETTLED = 4e-4, 0.04
#: Pairs that disagree with all others less often than this by chance [1].
_CHANCE = 1e-4
#: Points are matched with others no farther than this at first: farther, other
#: objects of the same shape come into reach [m].
_REACHES = (0.25, 0.1, 0.05)
#: Starts beside the stated one, in standard deviations of its heading or of its place
#: across the site; only where that is worse than a few pixels [1].
_ASIDE = 1.0
#: A pose farther from its start than this is taken if no nearer one fits at all:
#: chance of so large a distance [1].
_UNLIKELY = 1e-4
#: Points of a scan by which rough poses are judged [1].
_JUDGES = 1500
#: Nobody knows a pose worse than this [m, rad].
_ANYWHERE, _ANYHOW = 100.0, 1.0


@dataclass(frozen=True, kw_only=True)
class Disagreement:
    """A pair of scans that all others contradict."""

    scans: tuple[str, str]
    """Their names."""
    shift: float
    """How far the pair by itself would move one of them [m]."""
    turn: float
    """How far it would turn it [rad]."""
    score: float
    """Chi-square over its degrees of freedom; about 1 by chance [1]."""
    trust: float
    """Weight that it keeps [1]."""


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """Poses of scans with the covariance of all."""

    state: State
    """Poses, targets and shared errors."""
    covariance: Floats
    """Of all unknowns, in the order of `layout`."""
    layout: Layout
    """Which unknown stands where."""
    pairs: tuple[Pair, ...]
    """Comparisons of scans."""
    trust: tuple[float, ...]
    """Weight of each of them, 1 unless it disagrees."""
    disagreements: tuple[Disagreement, ...]
    """Pairs that do."""
    steps: int
    """How many steps it took; as many as are allowed if it did not settle."""
    settled: bool
    """Whether the last step was small."""
    patterns: tuple[PatternTest, ...]
    """Tests of errors over rows, columns, range and angle."""


def align(
    surfaces: Mapping[str, ScanSurface],
    ties: Ties,
    *,
    overlap: float = 0.1,
    voxel: float | None = None,
    guess: Mapping[str, ScanPose] | None = None,
) -> Alignment:
    """Align all scans of a site."""
    poses = _begin(surfaces, ties, voxel=voxel, guess=guess or {})
    names = list(surfaces)
    start = dict(ties.start)
    for name in names:
        if name != ties.fixed and name not in start:
            loose = np.diag([_ANYWHERE**2] * 3 + [_ANYHOW**2] * 3)
            start[name] = KnownPose(pose=poses[name], covariance=loose)
    ties = replace(ties, start={k: v for k, v in start.items() if k != ties.fixed})
    keys = dict.fromkeys(
        key for surface in surfaces.values() for key in surface.shared.keys
    )
    keys |= dict.fromkeys(key for centre in ties.centres for key in centre.shared)
    points = _first_points(ties, poses)
    state = State(poses, points, dict.fromkeys(keys, 0.0))
    trees = {name: tree_of(surface) for name, surface in surfaces.items()}
    who = _neighbours(surfaces, poses, trees, overlap)
    _refuse_islands(names, who, ties)
    gates: list[float | None] = []
    if who:
        largest = 6 * max(one.spacing for one in surfaces.values())
        gates += [float(g) for g in np.geomspace(largest, largest / 8, _WIDE_STEPS)]
    gates += [None] * _FINE_STEPS
    pairs: list[Pair] = []
    trust: list[float] = []
    settled, taken, free = False, 0, 0
    for number, gate in enumerate(gates):
        tell("fitting all scans to each other", 0.3 + 0.5 * number / len(gates))
        late = number >= _WIDE_STEPS + _FREE_STEPS
        pairs = _pairs(surfaces, who, state, trees, gate, pairs if late else ())
        trust = [1.0] * len(pairs)
        taken = number + 1
        found = network.step(
            state,
            pairs,
            ties,
            trust,
            steady=gate is not None,
            free=free,
            part=0.5 if number >= _WIDE_STEPS + _HALF_STEPS else 1.0,
        )
        state = found.state
        free = found.free if late else 0
        settled = gate is None and found.score < _SETTLED
        if gate is None and found.score < _DONE:
            break
    disagreements: tuple[Disagreement, ...] = ()
    if len(pairs) > 1:
        trust, disagreements = _judged(pairs, state, surfaces)
        for _ in range(4 if disagreements else 0):
            pairs = _pairs(surfaces, who, state, trees, None, pairs)
            trust, disagreements = _judged(pairs, state, surfaces)
            state = network.step(state, pairs, ties, trust, free=free).state
    tell("covariance of all poses", 0.85)
    covariance, layout = network.covariance(
        state, pairs, ties, trust, surfaces, free=free
    )
    return Alignment(
        state=state,
        covariance=covariance,
        layout=layout,
        pairs=tuple(pairs),
        trust=tuple(trust),
        disagreements=disagreements,
        steps=taken,
        settled=settled,
        patterns=pattern_tests(state, pairs, ties, trust, surfaces, free=free),
    )


def _begin(
    surfaces: Mapping[str, ScanSurface],
    ties: Ties,
    *,
    voxel: float | None,
    guess: Mapping[str, ScanPose],
) -> dict[str, ScanPose]:
    """Return poses good to a part of a pixel's spacing, one scan after the other."""
    stated = {name: known.pose for name, known in ties.start.items()} | dict(guess)
    if ties.fixed is not None:
        stated.setdefault(ties.fixed, ScanPose(np.eye(3), np.zeros(3)))
    lost = [name for name in surfaces if name not in stated]
    if lost:
        raise CubeError(
            f"scan {lost[0]!r}: nothing tells about where it stood; state [scan.start] "
            "with uncertainties, or three targets that other scans see, too"
        )
    first = ties.fixed or _first(ties, guess, list(surfaces))
    placed = {first: stated[first]}
    waiting = [name for name in surfaces if name != first]
    clouds = {name: one.position[one.usable] for name, one in surfaces.items()}
    while waiting:
        tell("aligning roughly", 0.3 * len(placed) / len(surfaces))
        others = np.concatenate([placed[n].place(clouds[n]) for n in placed])
        tree = cKDTree(others)
        shares = {}
        for name in waiting:
            some = stated[name].place(
                clouds[name][:: max(len(clouds[name]) // 2000, 1)]
            )
            shares[name] = np.isfinite(
                tree.query(some, distance_upper_bound=_REACHES[0])[0]
            ).mean()
        name = max(waiting, key=lambda one: float(shares[one]))
        waiting.remove(name)
        if shares[name] < 0.02:
            placed[name] = stated[name]
            continue
        spacing = max(one.spacing for one in surfaces.values())
        placed[name] = _rough(
            clouds[name],
            others,
            tree,
            stated[name],
            ties.start.get(name),
            voxel=voxel or 2 * spacing,
            spacing=spacing,
        )
    return {name: placed[name] for name in surfaces}


def _rough(
    cloud: Floats,
    others: Floats,
    tree: cKDTree,
    stated: ScanPose,
    known: KnownPose | None,
    *,
    voxel: float,
    spacing: float,
) -> ScanPose:
    """Return the pose that brings a scan onto others, the best of several attempts.

    Alignment may end at another object of the same shape. Attempts differ in their
    start and in how far points are matched; the best leaves the least distance in the
    overlap, and lies where the start pose may be.
    """
    some = cloud[:: max(len(cloud) // _JUDGES, 1)]
    attempts = [stated]
    attempts += [
        aligned(cloud, others, stated, voxel=voxel, reach=one) for one in _REACHES
    ]
    if known is not None:
        attempts += [
            aligned(cloud, others, one, voxel=voxel, reach=_REACHES[0])
            for one in _beside(known, 3 * spacing, some)
        ]
    misfit = np.array(
        [_misfit(one.place(some), others, tree, spacing) for one in attempts]
    )
    if known is not None:
        far = np.array([squared_pull(one, known) for one in attempts])
        likely = far <= float(chi2.isf(_UNLIKELY, 6))
        # Unless all that is near fits as badly as no alignment at all.
        if (misfit[likely] < min(0.5, 2 * misfit.min())).any():
            misfit = np.where(likely, misfit, np.inf)
    return attempts[int(np.argmin(misfit))]


def _beside(known: KnownPose, least: float, cloud: Floats) -> list[ScanPose]:
    """Return starts beside one that is known worse than to a few pixels."""
    away = float(np.linalg.norm(cloud.mean(axis=0)))
    found = []
    turn = float(np.sqrt(known.covariance[5, 5]))
    if turn * away > least:
        for sign in (-_ASIDE, _ASIDE):
            step = np.array([0, 0, 0, 0, 0, sign * turn])
            found.append(known.pose.changed(step))
    for axis in (0, 1):
        shift = float(np.sqrt(known.covariance[axis, axis]))
        if shift > least:
            for sign in (-_ASIDE, _ASIDE):
                step = np.zeros(6)
                step[axis] = sign * shift
                found.append(known.pose.changed(step))
    return found


def _misfit(placed: Floats, others: Floats, tree: cKDTree, spacing: float) -> float:
    """Return the distance of points from planes of others: 0 on them, 1 apart [1]."""
    away, near = tree.query(placed, k=8, distance_upper_bound=4 * spacing)
    met = np.isfinite(away).all(axis=1)
    if not met.any():
        return 1.0
    patch = others[near[met]]
    middle = patch.mean(axis=1)
    off = patch - middle[:, None]
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", off, off))
    distance = np.abs(np.einsum("ni,ni->n", placed[met] - middle, axes[:, :, 0]))
    return float(1 - met.mean() + met.mean() * np.minimum(distance / spacing, 1).mean())


def squared_pull(pose: ScanPose, known: KnownPose) -> float:
    """Return the chi-square of a pose against its start pose, of six numbers."""
    off = departure(pose, known.pose)
    return float(off @ np.linalg.solve(known.covariance, off))


def _first(ties: Ties, guess: Mapping[str, ScanPose], names: Sequence[str]) -> str:
    """Return the scan whose pose is known best."""
    known = [name for name in names if name in ties.start]
    if not known:
        return next(iter(guess), names[0])
    return min(known, key=lambda one: float(np.trace(ties.start[one].covariance)))


def _first_points(ties: Ties, poses: Mapping[str, ScanPose]) -> dict[str, Floats]:
    """Return about where targets stand."""
    points: dict[str, Floats] = {}
    for centre in ties.centres:
        seen = poses[centre.scan].place(centre.position)
        points.setdefault(centre.target, seen)
    for name, known in ties.control.items():
        points.setdefault(name, known.position)
    return points


def _neighbours(
    surfaces: Mapping[str, ScanSurface],
    poses: Mapping[str, ScanPose],
    trees: Mapping[str, cKDTree],
    overlap: float,
) -> list[tuple[str, str]]:
    """Return the pairs of scans that see the same surface, the finer one second."""
    names = list(surfaces)
    found = []
    for number, one in enumerate(names):
        for other in names[number + 1 :]:
            source, target = (
                (one, other)
                if surfaces[one].spacing >= surfaces[other].spacing
                else (other, one)
            )
            cloud = surfaces[source].position[surfaces[source].smooth]
            some = cloud[:: max(len(cloud) // 3000, 1)]
            local = poses[target].back(poses[source].place(some))
            away, _ = trees[target].query(
                local, distance_upper_bound=3 * surfaces[target].spacing
            )
            if np.isfinite(away).mean() >= overlap:
                found.append((source, target))
    return found


def _refuse_islands(
    names: Sequence[str], who: Sequence[tuple[str, str]], ties: Ties
) -> None:
    """Raise if a scan is tied to nothing."""
    seen: dict[str, set[str]] = {}
    for centre in ties.centres:
        seen.setdefault(centre.target, set()).add(centre.scan)
    tied = {name for pair in who for name in pair} | set(ties.start)
    tied |= {n for name, scans in seen.items() if len(scans) > 1 for n in scans}
    tied |= {n for name, scans in seen.items() if name in ties.control for n in scans}
    alone = [name for name in names if name not in tied and name != ties.fixed]
    if alone and len(names) > 1:
        raise CubeError(
            f"scan {alone[0]!r}: overlaps no other scan and shares no target with one; "
            "add a scan between them, targets, or lower registration.overlap"
        )


def _pairs(
    surfaces: Mapping[str, ScanSurface],
    who: Sequence[tuple[str, str]],
    state: State,
    trees: Mapping[str, cKDTree],
    gate: float | None,
    before: Sequence[Pair],
) -> list[Pair]:
    """Return the comparisons of scans, only with points that counted before, if any."""
    among = {(p.source, p.target): p.source_pixel[p.weight > 0] for p in before}
    found = (
        compared(
            surfaces[source],
            surfaces[target],
            (state.poses[source], state.poses[target]),
            gate=gate,
            errors=state.errors,
            tree=trees[target],
            among=among.get((source, target)),
        )
        for source, target in who
    )
    return [pair for pair in found if pair is not None and pair.used >= 20]


def _judged(
    pairs: Sequence[Pair], state: State, surfaces: Mapping[str, ScanSurface]
) -> tuple[list[float], tuple[Disagreement, ...]]:
    """Return how far each pair is trusted, and those that all others contradict."""
    trust, against = [], []
    for pair in pairs:
        change, spread = network.innovation(pair, state, surfaces)
        freedom = round(float(np.trace(pair.held)))
        score = float(change @ np.linalg.pinv(spread, rcond=1e-12) @ change)
        limit = float(chi2.isf(_CHANCE, max(freedom, 1)))
        # As of Huber: what is farther off pulls no more for it.
        weight = 1.0 if score <= limit else float(np.sqrt(limit / score))
        trust.append(weight)
        if score > limit:
            against.append(
                Disagreement(
                    scans=(pair.source, pair.target),
                    shift=float(np.linalg.norm(change[:3])),
                    turn=float(np.linalg.norm(change[3:])),
                    score=score / max(freedom, 1),
                    trust=weight,
                )
            )
    return trust, tuple(against)
