"""From a site file to the poses of its scans."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from amulor._progress import part, tell
from amulor.errors import CubeError
from amulor.site.description import ScaleBar, Site, SiteScan
from amulor.site.load import range_image_of
from amulor.site.registration.align import Alignment, align, squared_pull
from amulor.site.registration.centres import centre_of
from amulor.site.registration.network import (
    Centre,
    KnownDistance,
    KnownPoint,
    KnownPose,
    Ties,
)
from amulor.site.registration.patterns import contradicted
from amulor.site.registration.pose import (
    ScanPose,
    best_pose,
    departure,
    start_covariance,
    start_pose,
)
from amulor.site.registration.reliability import reliabilities
from amulor.site.registration.result import (
    Contradiction,
    Registration,
    Weakness,
    relative_covariance,
)
from amulor.site.registration.starts import start_findings
from amulor.site.registration.surface import ScanSurface, scan_surface, shared_errors

Floats = NDArray[np.float64]

#: Start poses and shared errors as good as stated are contradicted so often [1].
_CHANCE = 1e-5
#: A pose is held by its start pose if it is hardly known better afterwards [1].
_NO_BETTER = 0.5
#: A start pose is good enough by itself if points are off by less than so many of the
#: distances of neighbouring points [1].
_ENOUGH = 0.5


def surfaces_of(site: Site) -> tuple[dict[str, ScanSurface], dict[str, xr.Dataset]]:
    """Return the surfaces and the range images of all scans of a site."""
    surfaces, images = {}, {}
    for number, scan in enumerate(site.scan):
        tell(f"reading {scan.name}", number / len(site.scan))
        images[scan.name] = range_image_of(scan)
        surfaces[scan.name] = surface_of(site, scan, images[scan.name])
    return surfaces, images


def surface_of(site: Site, scan: SiteScan, image: xr.Dataset) -> ScanSurface:
    """Return the surface of one scan of a site."""
    water = str(scan.water or _water_in(image) or scan.name)
    shared = shared_errors(
        image,
        scan=scan.name,
        instrument=f"{scan.instrument}, {scan.epoch}",
        water=f"{water}, {scan.epoch}",
        drift=scan.drift,
    )
    return scan_surface(
        image, name=scan.name, shared=shared, window=site.registration.window
    )


def _water_in(image: xr.Dataset) -> str:
    """Return what stands for the water of an image: its name, or that of the survey."""
    attributes = image.attrs
    text = str(attributes.get("survey", ""))
    at = text.find("[water]")
    if at < 0:
        return ""
    from hashlib import sha256

    end = text.find("\n[", at + 1)
    return (
        "water " + sha256(text[at : end if end > 0 else None].encode()).hexdigest()[:8]
    )


def register(
    site: Site,
    *,
    surfaces: Mapping[str, ScanSurface] | None = None,
    images: Mapping[str, xr.Dataset] | None = None,
) -> Registration:
    """Bring all scans of a site into one frame."""
    if surfaces is None or images is None:
        with part(0.0, 0.3):
            surfaces, images = surfaces_of(site)
    seen = start_findings(
        site, {name: one.position[one.usable] for name, one in surfaces.items()}
    )
    if seen.mistakes:
        raise CubeError("\n".join(seen.mistakes))
    centres, surfaces = _centres(site, surfaces, images)
    start = {}
    for scan in site.scan:
        if scan.start is not None:
            pose = start_pose(scan.start)
            start[scan.name] = KnownPose(
                pose=pose, covariance=start_covariance(scan.start, pose)
            )
    control = {}
    for one in site.control:
        sigma = np.broadcast_to(np.asarray(one.uncertainty, dtype=float), (3,)).copy()
        control[one.target] = KnownPoint(position=np.array(one.position), sigma=sigma)
    bars = tuple(
        KnownDistance(ends=one.ends, length=one.length, sigma=one.length_uncertainty)
        for one in site.target
        if isinstance(one, ScaleBar)
    )
    fixed = None
    if not start and len(control) < 3:
        fixed = site.scan[0].name
    guess = _guessed(site, centres, start, control, fixed)
    ties = Ties(start=start, centres=centres, control=control, bars=bars, fixed=fixed)
    with part(0.3, 1.0):
        found = align(
            surfaces,
            ties,
            overlap=site.registration.overlap,
            voxel=site.registration.voxel,
            guess=guess,
        )
    return _result(site, found, ties, seen.remarks, surfaces)


def _centres(
    site: Site, surfaces: Mapping[str, ScanSurface], images: Mapping[str, xr.Dataset]
) -> tuple[tuple[Centre, ...], dict[str, ScanSurface]]:
    """Return targets in scans, and the scans without the pixels of targets."""
    found = []
    left = dict(surfaces)
    for target in site.target:
        if isinstance(target, ScaleBar):
            continue
        for place in target.places:
            scan = next(one for one in site.scan if one.name == place.scan)
            centre, pixels = centre_of(
                target, surfaces[scan.name], images[scan.name], place.row, place.column
            )
            if target.moved:
                centre = replace(centre, target=f"{target.name} in {scan.epoch}")
            found.append(centre)
            # What holds a target does not count a second time as a surface.
            smooth = left[scan.name].smooth & ~pixels
            left[scan.name] = replace(left[scan.name], smooth=smooth)
    return tuple(found), left


def _guessed(
    site: Site,
    centres: tuple[Centre, ...],
    start: Mapping[str, KnownPose],
    control: Mapping[str, KnownPoint],
    fixed: str | None,
) -> dict[str, ScanPose]:
    """Return poses from targets for scans without a start pose."""
    known = {name: one.position for name, one in control.items()}
    poses = {name: one.pose for name, one in start.items()}
    if fixed is not None:
        poses[fixed] = ScanPose(np.eye(3), np.zeros(3))
    guess: dict[str, ScanPose] = {}
    while True:
        for centre in centres:
            if centre.scan in poses:
                known.setdefault(
                    centre.target, poses[centre.scan].place(centre.position)
                )
        ready = [
            (one.name, [c for c in centres if c.scan == one.name and c.target in known])
            for one in site.scan
            if one.name not in poses
        ]
        ready = [(name, seen) for name, seen in ready if len(seen) >= 3]
        if not ready:
            return guess
        name, seen = max(ready, key=lambda one: len(one[1]))
        here = np.array([one.position for one in seen])
        there = np.array([known[one.target] for one in seen])
        spread = np.linalg.svd(here - here.mean(axis=0))[1]
        if spread[1] < 0.02 * spread[0]:
            raise CubeError(
                f"scan {name!r}: its {len(seen)} targets stand on a line, about which "
                "it may turn; add one beside the line, or state [scan.start]"
            )
        guess[name] = poses[name] = best_pose(here, there)


def _result(
    site: Site,
    found: Alignment,
    ties: Ties,
    remarks: tuple[str, ...],
    surfaces: Mapping[str, ScanSurface],
) -> Registration:
    places = {
        f"{kind} {name}": (at.start, at.stop)
        for (kind, name), at in found.layout.at.items()
    }
    pairs = []
    for pair, trust in zip(found.pairs, found.trust, strict=True):
        pairs.append(
            {
                "source": pair.source,
                "target": pair.target,
                "points": pair.used,
                "moved_points": len(pair.moved),
                "misfit": pair.misfit,
                "median_distance_m": float(np.median(np.abs(pair.distance))),
                "trust": trust,
                "loose": [axis.tolist() for axis in pair.loose],
                "moved_pixels": pair.moved.tolist(),
            }
        )
    result = Registration(
        site=site.name,
        poses=found.state.poses,
        points=found.state.points,
        errors=found.state.errors,
        places=places,
        covariance=found.covariance,
        pairs=tuple(pairs),
        disagreements=tuple(
            {**vars(one), "scans": list(one.scans)} for one in found.disagreements
        ),
        weaknesses=(),
        contradictions=_contradictions(found, ties),
        remarks=(*remarks, *_apart(site, found, ties)),
        settled=found.settled,
        fixed=ties.fixed or "",
        patterns=found.patterns,
        reliability=reliabilities(found.state, found.covariance, found.layout, ties),
    )
    return replace(result, weaknesses=_weak(result, ties, surfaces))


def _contradictions(found: Alignment, ties: Ties) -> tuple[Contradiction, ...]:
    """Return start poses and shared errors that the poses contradict, worst first."""
    contradicting = []
    for name, known in ties.start.items():
        pose = found.state.poses.get(name)
        if pose is None or name == ties.fixed:
            continue
        off = departure(pose, known.pose)
        score = squared_pull(pose, known)
        if score > float(chi2.isf(_CHANCE, 6)):
            stated = [np.trace(known.covariance[k : k + 3, k : k + 3]) for k in (0, 3)]
            contradicting.append(
                Contradiction(
                    scan=name,
                    error="",
                    shift=float(np.linalg.norm(off[:3])),
                    turn=float(np.linalg.norm(off[3:])),
                    stated_shift=math.sqrt(stated[0]),
                    stated_turn=math.sqrt(stated[1]),
                    score=score / 6,
                )
            )
    for key, value in found.state.errors.items():
        if value**2 > float(chi2.isf(_CHANCE, 1)):
            contradicting.append(
                Contradiction(
                    scan="", error=key, shift=0.0, turn=0.0, stated_shift=0.0,
                    stated_turn=0.0, score=value**2,
                )
            )  # fmt: skip
    for line in reliabilities(found.state, found.covariance, found.layout, ties):
        kind = line.observation.partition(" ")[0]
        if kind in ("control", "bar") and abs(line.score) > norm.isf(_CHANCE / 2):
            contradicting.append(
                Contradiction(
                    scan="", error=f"{line.observation}, {line.part}",
                    shift=line.residual, turn=0.0, stated_shift=line.uncertainty,
                    stated_turn=0.0, score=line.score**2,
                )
            )  # fmt: skip
    pattern = contradicted(found.patterns)
    if pattern is not None:
        contradicting.append(
            Contradiction(
                scan=pattern.scan, error=pattern.pattern, shift=pattern.size, turn=0.0,
                stated_shift=pattern.uncertainty, stated_turn=0.0,
                score=pattern.score**2,
            )
        )  # fmt: skip
    return tuple(sorted(contradicting, key=lambda one: -one.score))


def _apart(site: Site, found: Alignment, ties: Ties) -> Iterator[str]:
    """Yield visits that neither surfaces nor targets tie to another one."""
    visit = {scan.name: scan.epoch for scan in site.scan}
    tied = [(pair.source, pair.target) for pair in found.pairs]
    tied += [
        (one.scan, other.scan)
        for one in ties.centres
        for other in ties.centres
        if one.target == other.target
    ]
    met = {visit[a] for a, b in tied if visit[a] != visit[b]}
    met |= {visit[b] for a, b in tied if visit[a] != visit[b]}
    for epoch in site.epoch if len(site.epoch) > 1 else ():
        if epoch.name not in met and site.scans_of(epoch.name):
            yield (
                f"visit {epoch.name!r}: no surface and no target ties its scans to "
                "another visit; only start poses and control points do, and change is "
                "compared no better than these are known"
            )
    if met or len(site.epoch) == 1:
        groups = _groups([scan.name for scan in site.scan], tied)
        for group in groups[1:]:
            yield (
                f"{', '.join(group)}: no surface and no target ties them to the other "
                "scans; only start poses and control points do, which nothing checks"
            )


def _groups(names: list[str], tied: list[tuple[str, str]]) -> list[list[str]]:
    """Return the groups of scans that ties connect, the largest first."""
    number = {name: at for at, name in enumerate(names)}
    for _ in names:
        for pair in tied:
            least = min(number[name] for name in pair)
            number |= dict.fromkeys(pair, least)
    groups = [
        [name for name in names if number[name] == at]
        for at in sorted(set(number.values()))
    ]
    return sorted(groups, key=len, reverse=True)


def _weak(
    result: Registration, ties: Ties, surfaces: Mapping[str, ScanSurface]
) -> tuple[Weakness, ...]:
    """Return what the data hold no better than the start poses do.

    A start pose that is good to a part of a pixel, as of a surveyed station, is enough.

    The error of a pose against the nearest neighbour counts, not that of the whole
    site, which all scans have alike.
    """
    found = []
    tied = {one.scan for one in ties.centres}
    for pair in result.pairs:
        tied |= {pair["source"], pair["target"]}
    for name, known in ties.start.items():
        if name not in result.poses or f"pose {name}" not in result.places:
            continue
        partners = {
            pair["source"] if pair["target"] == name else pair["target"]
            for pair in result.pairs
            if name in (pair["source"], pair["target"])
        }
        options = [
            relative_covariance(result, name, other) for other in sorted(partners)
        ]
        options.append(result.covariance_of(f"pose {name}"))
        best = min(
            options, key=lambda one: float(np.trace(_over(one, known.covariance)))
        )
        values, axes = np.linalg.eigh(_over(best, known.covariance))
        root = np.linalg.cholesky(known.covariance)
        others = [_over(one, known.covariance) for one in options]
        for value, axis in zip(values, axes.T, strict=True):
            # Two start poses by themselves make a mean; a neighbour may know better.
            if min(float(axis @ one @ axis) for one in others) > _NO_BETTER**2:
                step = root @ axis * math.sqrt(value)
                surface = surfaces[name]
                away = float(np.nanmedian(surface.distance))
                off = np.linalg.norm(step[:3]) + away * np.linalg.norm(step[3:])
                if off < _ENOUGH * surface.spacing:
                    continue
                found.append(
                    Weakness(
                        scan=name,
                        shift=(float(step[0]), float(step[1]), float(step[2])),
                        turn=(float(step[3]), float(step[4]), float(step[5])),
                    )
                )
    return tuple(found)


def _over(covariance: Floats, prior: Floats) -> Floats:
    """Return a covariance in units of what was known before."""
    inverse = np.linalg.inv(np.linalg.cholesky(prior))
    return np.asarray(inverse @ covariance @ inverse.T)
