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
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.rough import rough_poses
from amulor.site.registration.surface import (
    ScanSurface,
    range_correction,
    with_correction,
)

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
#: Ranges are corrected by their estimated errors, and patches are fitted again, if the
#: correction changes by more than this fraction of the range [1].
_CORRECTED = 1e-3
#: Largest number of compared points in all pairs of a site [1].
_MOST_COMPARED = 600_000
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
    poses = rough_poses(surfaces, ties, voxel=voxel, guess=guess or {})
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
    waiting = list(gates)
    pairs: list[Pair] = []
    trust: list[float] = []
    settled, steps, free = False, 0, 0
    # Shared errors by which the ranges of `surfaces` are corrected.
    measured, removed = surfaces, dict.fromkeys(state.errors, 0.0)
    bounds = {name: _largest_parts(surface) for name, surface in measured.items()}
    while waiting:
        fine = _FINE_STEPS - len(waiting)
        tell("fitting all scans to each other", 0.8 - 0.5 * len(waiting) / len(gates))
        first = surfaces is measured
        # In the first wide steps, estimates may be far off.
        if not (first and fine < 0) and _much_to_correct(
            measured, state, removed, bounds
        ):
            removed = dict(state.errors)
            surfaces = {
                name: with_correction(surface, range_correction(surface, removed))
                for name, surface in measured.items()
            }
            trees = {name: tree_of(surface) for name, surface in surfaces.items()}
            if first:
                # Scans may now meet others that they missed by the errors of ranges.
                overlaps = _neighbours(surfaces, state.poses, trees, overlap)
                waiting = list(gates)
                continue
        gate = waiting.pop(0)
        late = fine >= _FREE_STEPS
        pairs = _pairs(
            surfaces, overlaps, state, removed, trees, gate, pairs if late else (), most
        )
        trust = [1.0] * len(pairs)
        steps += 1
        outcome = network.step(
            state,
            pairs,
            ties,
            trust,
            steady=gate is not None,
            free=free,
            part=0.5 if fine >= _HALF_STEPS else 1.0,
            surfaces=surfaces,
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
            pairs = _pairs(surfaces, overlaps, state, removed, trees, None, pairs, most)
            trust, disagreements = _pair_weights(pairs, state, surfaces)
            state = network.step(
                state, pairs, ties, trust, free=free, surfaces=surfaces
            ).state
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


def _largest_parts(surface: ScanSurface) -> Floats:
    """Largest effect of each shared error on the ranges, over the range, (k,) [1]."""
    reach = np.where(surface.usable, surface.distance, np.inf)
    return np.array(
        [float((abs(shape) / reach).max()) for shape in surface.shared.shapes]
    )


def _much_to_correct(
    measured: Mapping[str, ScanSurface],
    state: State,
    removed: Mapping[str, float],
    bounds: Mapping[str, Floats],
) -> bool:
    """Whether estimated errors are too large for derivatives at the measured ranges.

    The sum of the largest effects, `bounds`, needs no ranges.
    """
    change = {key: value - removed[key] for key, value in state.errors.items()}
    for name, surface in measured.items():
        sizes = np.array([abs(change[key]) for key in surface.shared.keys])
        if sizes @ bounds[name] <= _CORRECTED:
            continue
        correction = abs(range_correction(surface, change))
        if (correction > _CORRECTED * surface.distance).any():
            return True
    return False


def _pairs(
    surfaces: Mapping[str, ScanSurface],
    overlaps: Sequence[tuple[str, str]],
    state: State,
    removed: Mapping[str, float],
    trees: Mapping[str, cKDTree],
    gate: float | None,
    before: Sequence[Pair],
    most: int,
) -> list[Pair]:
    """Compare overlapping scans, at the points of their earlier comparison if any.

    The ranges of the surfaces are corrected by the errors `removed`.
    """
    among = {(p.source, p.target): p.source_pixel[p.weight > 0] for p in before}
    ranging = {key for surface in surfaces.values() for key in surface.shared.keys}
    remaining = {
        key: value - removed[key] if key in ranging else value
        for key, value in state.errors.items()
    }
    comparisons = (
        compared(
            surfaces[source],
            surfaces[target],
            (state.poses[source], state.poses[target]),
            gate=gate,
            errors=remaining,
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
