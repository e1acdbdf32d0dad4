"""Rough alignment of scans one by one, from their start poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import chi2

from amulor._progress import tell
from amulor.errors import CubeError
from amulor.site.registration.network import KnownPose, Ties
from amulor.site.registration.pose import ScanPose, aligned, departure
from amulor.site.registration.surface import ScanSurface

Floats = NDArray[np.float64]

#: Largest distances of matched points; beyond, other objects of one shape match [m].
_REACHES = (0.25, 0.1, 0.05)
#: Offset of further guesses, in standard deviations of heading and of position across
#: the site [1].
_ASIDE = 1.0
#: Probability of a distance from the start pose below which a pose is used only if no
#: nearer pose fits [1].
_UNLIKELY = 1e-4
#: Largest number of points of a scan, and of all others, in rough alignment [1].
_MOST_ROUGH, _MOST_OTHERS = 20_000, 120_000
#: Number of points that rank rough poses [1].
_JUDGES = 1500


def rough_poses(
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
