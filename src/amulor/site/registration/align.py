"""Alignment of scans: rough poses one by one, then a joint fit with covariance."""

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
from amulor.site.registration.pair import MOST_POINTS, Pair, compared, tree_of
from amulor.site.registration.patterns import PatternTest, Undetected, pattern_tests
from amulor.site.registration.pose import ScanPose, aligned, departure
from amulor.site.registration.surface import ScanSurface

Floats = NDArray[np.float64]

#: Number of steps with a wide gate that narrows, then of steps with the gate of the
#: noise [1].
_WIDE_STEPS, _FINE_STEPS = 3, 20
#: After this many fine steps an excluded point stays excluded, and no further direction
#: is determined: near a limit they would alternate forever [1].
_FREE_STEPS = 5
#: After this many fine steps only half steps are used: whole steps may oscillate,
#: because points change the pixel that they are compared with [1].
_HALF_STEPS = 8
#: Chi-square of a step that ends the iteration, and of a settled step: a fifth of the
#: stated uncertainty, for all unknowns [1].
_DONE, _SETTLED = 4e-4, 0.04
#: Chance of calling a good pair a disagreement [1].
_CHANCE = 1e-4
#: Largest distances of matched points; beyond, other objects of one shape match [m].
_REACHES = (0.25, 0.1, 0.05)
#: Offset of further guesses, in standard deviations of heading and of position across
#: the site [1].
_ASIDE = 1.0
#: Probability of a distance from the start pose below which a pose is used only if no
#: nearer pose fits [1].
_UNLIKELY = 1e-4
#: Largest number of compared points in all pairs of a site [1].
_MOST_COMPARED = 600_000
#: Largest number of points of a scan, and of all others, in rough alignment [1].
_MOST_ROUGH, _MOST_OTHERS = 20_000, 120_000
#: Number of points that rank rough poses [1].
_JUDGES = 1500
#: Prior standard uncertainty of a pose without a start [m, rad].
_ANYWHERE, _ANYHOW = 100.0, 1.0


@dataclass(frozen=True, kw_only=True)
class Disagreement:
    """Pair of scans whose comparison contradicts all other observations."""

    scans: tuple[str, str]
    """Names of the scans."""
    shift: float
    """Translation of one scan that the pair alone would cause [m]."""
    turn: float
    """Rotation of one scan that the pair alone would cause [rad]."""
    score: float
    """Chi-square over its degrees of freedom; about 1 by chance [1]."""
    trust: float
    """Reduced weight of the pair in the fit [1]."""


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """Poses of all scans from a joint fit, with their joint covariance."""

    state: State
    """Estimated poses, target positions and shared errors."""
    covariance: Floats
    """Covariance of all unknowns, in the order of `layout`."""
    inverse: Floats
    """Inverse of the normal matrix, in the same order."""
    layout: Layout
    """Positions of the unknowns in the covariance."""
    pairs: tuple[Pair, ...]
    """Compared pairs of scans."""
    trust: tuple[float, ...]
    """Weight of each pair, 1 unless it disagrees [1]."""
    disagreements: tuple[Disagreement, ...]
    """Pairs of scans that contradict all other observations."""
    steps: int
    """Number of iterations; the largest allowed number if the fit did not converge
    [1]."""
    settled: bool
    """Whether the fit converged: its last step was small."""
    patterns: tuple[PatternTest, ...]
    """Tests for systematic errors over rows, columns, range and angle of incidence."""
    undetected: dict[str, Undetected]
    """Largest change of each pose by a systematic error that no test detects."""
    suspected: Floats
    """Covariance of all unknowns by large but not significant systematic errors."""


def align(
    surfaces: Mapping[str, ScanSurface],
    ties: Ties,
    *,
    overlap: float = 0.1,
    voxel: float | None = None,
    guess: Mapping[str, ScanPose] | None = None,
    visits: Mapping[str, str] | None = None,
) -> Alignment:
    """Align all scans of a site, and test them for systematic range errors."""
    poses = _rough_poses(surfaces, ties, voxel=voxel, guess=guess or {})
    names = list(surfaces)
    start = dict(ties.start)
    for name in names:
        if name != ties.fixed and name not in start:
            loose = np.diag([_ANYWHERE**2] * 3 + [_ANYHOW**2] * 3)
            start[name] = KnownPose(pose=poses[name], covariance=loose)
    ties = replace(ties, start={k: v for k, v in start.items() if k != ties.fixed})
    keys = dict.fromkeys(key for surface in surfaces.values() for key in surface.keys)
    keys |= dict.fromkeys(key for centre in ties.centres for key in centre.shared)
    points = _first_positions(ties, poses)
    state = State(poses, points, dict.fromkeys(keys, 0.0))
    trees = {name: tree_of(surface) for name, surface in surfaces.items()}
    overlaps = _neighbours(surfaces, poses, trees, overlap)
    _refuse_islands(names, overlaps, ties)
    most = min(MOST_POINTS, _MOST_COMPARED // max(len(overlaps), 1))
    gates: list[float | None] = []
    if overlaps:
        largest = 6 * max(surface.spacing for surface in surfaces.values())
        gates += [float(g) for g in np.geomspace(largest, largest / 8, _WIDE_STEPS)]
    gates += [None] * _FINE_STEPS
    pairs: list[Pair] = []
    trust: list[float] = []
    settled, steps, free = False, 0, 0
    for number, gate in enumerate(gates):
        tell("fitting all scans to each other", 0.3 + 0.5 * number / len(gates))
        late = number >= _WIDE_STEPS + _FREE_STEPS
        pairs = _pairs(
            surfaces, overlaps, state, trees, gate, pairs if late else (), most
        )
        trust = [1.0] * len(pairs)
        steps = number + 1
        outcome = network.step(
            state,
            pairs,
            ties,
            trust,
            steady=gate is not None,
            free=free,
            part=0.5 if number >= _WIDE_STEPS + _HALF_STEPS else 1.0,
        )
        state = outcome.state
        free = outcome.free if late else 0
        settled = gate is None and outcome.score < _SETTLED
        if gate is None and outcome.score < _DONE:
            break
    disagreements: tuple[Disagreement, ...] = ()
    if len(pairs) > 1:
        trust, disagreements = _pair_weights(pairs, state, surfaces)
        for _ in range(4 if disagreements else 0):
            pairs = _pairs(surfaces, overlaps, state, trees, None, pairs, most)
            trust, disagreements = _pair_weights(pairs, state, surfaces)
            state = network.step(state, pairs, ties, trust, free=free).state
    tell("covariance of all poses", 0.85)
    # Between visits the surface may have changed.
    same = [
        visits is None or visits[pair.source] == visits[pair.target] for pair in pairs
    ]
    patterns, undetected, suspected = pattern_tests(
        state,
        [pair for pair, alike in zip(pairs, same, strict=True) if alike],
        ties,
        [weight for weight, alike in zip(trust, same, strict=True) if alike],
        surfaces,
        free=free if all(same) else 0,
    )
    covariance, inverse, layout = network.covariance(
        state, pairs, ties, trust, surfaces, free=free
    )
    return Alignment(
        state=state,
        covariance=covariance,
        inverse=inverse,
        layout=layout,
        pairs=tuple(pairs),
        trust=tuple(trust),
        disagreements=disagreements,
        steps=steps,
        settled=settled,
        patterns=patterns,
        undetected=undetected,
        suspected=suspected,
    )


def _rough_poses(
    surfaces: Mapping[str, ScanSurface],
    ties: Ties,
    *,
    voxel: float | None,
    guess: Mapping[str, ScanPose],
) -> dict[str, ScanPose]:
    """Align all scans one by one, and return their rough poses."""
    starts = {name: start.pose for name, start in ties.start.items()} | dict(guess)
    if ties.fixed is not None:
        starts.setdefault(ties.fixed, ScanPose(np.eye(3), np.zeros(3)))
    lost = [name for name in surfaces if name not in starts]
    if lost:
        raise CubeError(
            f"scan {lost[0]!r}: nothing tells about where it stood; state [scan.start] "
            "with uncertainties, or three targets that other scans see, too"
        )
    first = ties.fixed or _best_started(ties, guess, list(surfaces))
    placed = {first: starts[first]}
    waiting = [name for name in surfaces if name != first]
    clouds, spacings = {}, []
    for name, surface in surfaces.items():
        clouds[name], step = _thinned(surface)
        spacings.append(step * surface.spacing)
    spacing = max(spacings)
    while waiting:
        tell("aligning roughly", 0.3 * len(placed) / len(surfaces))
        others = np.concatenate([placed[n].place(clouds[n]) for n in placed])
        others = others[:: -(-len(others) // _MOST_OTHERS)]
        tree = cKDTree(others)
        shares = {}
        for name in waiting:
            sample = starts[name].place(
                clouds[name][:: max(len(clouds[name]) // 2000, 1)]
            )
            shares[name] = np.isfinite(
                tree.query(sample, distance_upper_bound=_REACHES[0])[0]
            ).mean()
        name = max(waiting, key=lambda surface: float(shares[surface]))
        waiting.remove(name)
        if shares[name] < 0.02:
            placed[name] = starts[name]
            continue
        placed[name] = _rough_pose(
            clouds[name],
            others,
            tree,
            starts[name],
            ties.start.get(name),
            voxel=voxel or 2 * spacing,
            spacing=spacing,
        )
    return {name: placed[name] for name in surfaces}


def _thinned(surface: ScanSurface) -> tuple[Floats, int]:
    """Return usable points of a scan, sampled if many, and the step in pixels."""
    step = int(np.ceil(np.sqrt(surface.usable.sum() / _MOST_ROUGH)))
    usable = surface.usable
    if step > 1:
        usable = np.zeros_like(usable)
        usable[::step, ::step] = surface.usable[::step, ::step]
    return surface.position[usable], step


def _rough_pose(
    cloud: Floats,
    others: Floats,
    tree: cKDTree,
    first_guess: ScanPose,
    start: KnownPose | None,
    *,
    voxel: float,
    spacing: float,
) -> ScanPose:
    """Return the best of several attempts to align a scan with the others.

    Alignment may end at another object of the same shape. Attempts differ in initial
    pose and in matching distance. The best attempt has the smallest distances in the
    overlap, among poses that agree with the start pose.
    """
    sample = cloud[:: max(len(cloud) // _JUDGES, 1)]
    attempts = [first_guess]
    attempts += [
        aligned(cloud, others, first_guess, voxel=voxel, reach=attempt)
        for attempt in _REACHES
    ]
    if start is not None:
        attempts += [
            aligned(cloud, others, attempt, voxel=voxel, reach=_REACHES[0])
            for attempt in _further_guesses(start, 3 * spacing, sample)
        ]
    misfit = np.array(
        [_misfit(attempt.place(sample), others, tree, spacing) for attempt in attempts]
    )
    if start is not None:
        far = np.array([squared_pull(attempt, start) for attempt in attempts])
        likely = far <= float(chi2.isf(_UNLIKELY, 6))
        # Unless all near poses fit as badly as no alignment.
        if (misfit[likely] < min(0.5, 2 * misfit.min())).any():
            misfit = np.where(likely, misfit, np.inf)
    return attempts[int(np.argmin(misfit))]


def _further_guesses(start: KnownPose, least: float, cloud: Floats) -> list[ScanPose]:
    """Return initial poses around an uncertain start pose."""
    away = float(np.linalg.norm(cloud.mean(axis=0)))
    starts = []
    turn = float(np.sqrt(start.covariance[5, 5]))
    if turn * away > least:
        for sign in (-_ASIDE, _ASIDE):
            step = np.array([0, 0, 0, 0, 0, sign * turn])
            starts.append(start.pose.changed(step))
    for axis in (0, 1):
        shift = float(np.sqrt(start.covariance[axis, axis]))
        if shift > least:
            for sign in (-_ASIDE, _ASIDE):
                step = np.zeros(6)
                step[axis] = sign * shift
                starts.append(start.pose.changed(step))
    return starts


def _misfit(placed: Floats, others: Floats, tree: cKDTree, spacing: float) -> float:
    """Return the misfit of points to planes of other points: 0 aligned, 1 far [1]."""
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


def squared_pull(pose: ScanPose, start: KnownPose) -> float:
    """Return the chi-square of a pose's departure from its start pose [1]."""
    off = departure(pose, start.pose)
    return float(off @ np.linalg.solve(start.covariance, off))


def _best_started(
    ties: Ties, guess: Mapping[str, ScanPose], names: Sequence[str]
) -> str:
    """Return the scan to place first: surest start pose, else guessed, else first."""
    started = [name for name in names if name in ties.start]
    if not started:
        return next(iter(guess), names[0])
    return min(
        started, key=lambda scan_name: float(np.trace(ties.start[scan_name].covariance))
    )


def _first_positions(ties: Ties, poses: Mapping[str, ScanPose]) -> dict[str, Floats]:
    """Return initial positions of the targets in the frame of the site [m]."""
    points: dict[str, Floats] = {}
    for centre in ties.centres:
        place = poses[centre.scan].place(centre.position)
        points.setdefault(centre.target, place)
    for name, control in ties.control.items():
        points.setdefault(name, control.position)
    return points


def _neighbours(
    surfaces: Mapping[str, ScanSurface],
    poses: Mapping[str, ScanPose],
    trees: Mapping[str, cKDTree],
    overlap: float,
) -> list[tuple[str, str]]:
    """Return pairs of overlapping scans, the one with the wider point spacing first."""
    names = list(surfaces)
    overlaps = []
    for number, first in enumerate(names):
        for second in names[number + 1 :]:
            source, target = (
                (first, second)
                if surfaces[first].spacing >= surfaces[second].spacing
                else (second, first)
            )
            cloud = surfaces[source].position[surfaces[source].smooth]
            sample = cloud[:: max(len(cloud) // 3000, 1)]
            local = poses[target].back(poses[source].place(sample))
            away, _ = trees[target].query(
                local, distance_upper_bound=3 * surfaces[target].spacing
            )
            if np.isfinite(away).mean() >= overlap:
                overlaps.append((source, target))
    return overlaps


def _refuse_islands(
    names: Sequence[str], overlaps: Sequence[tuple[str, str]], ties: Ties
) -> None:
    """Raise `CubeError` if a scan has no start pose, overlap or connecting target."""
    scans_of: dict[str, set[str]] = {}
    for centre in ties.centres:
        scans_of.setdefault(centre.target, set()).add(centre.scan)
    tied = {name for pair in overlaps for name in pair} | set(ties.start)
    tied |= {n for name, scans in scans_of.items() if len(scans) > 1 for n in scans}
    tied |= {
        n for name, scans in scans_of.items() if name in ties.control for n in scans
    }
    alone = [name for name in names if name not in tied and name != ties.fixed]
    if alone and len(names) > 1:
        raise CubeError(
            f"scan {alone[0]!r}: overlaps no other scan and shares no target with one; "
            "add a scan between them, targets, or lower registration.overlap"
        )


def _pairs(
    surfaces: Mapping[str, ScanSurface],
    overlaps: Sequence[tuple[str, str]],
    state: State,
    trees: Mapping[str, cKDTree],
    gate: float | None,
    before: Sequence[Pair],
    most: int,
) -> list[Pair]:
    """Compare overlapping scans, at the points of their earlier comparison if any."""
    among = {(p.source, p.target): p.source_pixel[p.weight > 0] for p in before}
    comparisons = (
        compared(
            surfaces[source],
            surfaces[target],
            (state.poses[source], state.poses[target]),
            gate=gate,
            errors=state.errors,
            tree=trees[target],
            among=among.get((source, target)),
            most=most,
        )
        for source, target in overlaps
    )
    return [pair for pair in comparisons if pair is not None and pair.used >= 20]


def _pair_weights(
    pairs: Sequence[Pair], state: State, surfaces: Mapping[str, ScanSurface]
) -> tuple[list[float], tuple[Disagreement, ...]]:
    """Return the weight of each scan pair, and pairs that contradict the others."""
    trust, against = [], []
    for pair in pairs:
        change, spread = network.innovation(pair, state, surfaces)
        freedom = round(float(np.trace(pair.held)))
        score = float(change @ np.linalg.pinv(spread, rcond=1e-12) @ change)
        limit = float(chi2.isf(_CHANCE, max(freedom, 1)))
        # Huber weights: an outlier has no more effect than a point at the limit.
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
