"""Registration of a site: from range images to poses with covariance."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from amulor._progress import part, tell
from amulor.errors import CubeError
from amulor.io.trajectories import read_trajectory
from amulor.platform import Mounting, Trajectory
from amulor.site.blocks import averaged, block_of, block_size, pixels_of_scan
from amulor.site.description import ScaleBar, Site, SiteScan
from amulor.site.load import range_image_of
from amulor.site.registration.absolute import scale_tests, water_indices
from amulor.site.registration.align import Alignment, align
from amulor.site.registration.centres import centre_of
from amulor.site.registration.landmarks import common_relief
from amulor.site.registration.line import (
    motion_of,
    refined,
    straightened,
    track_in_frame,
)
from amulor.site.registration.network import (
    Centre,
    KnownDistance,
    KnownPoint,
    KnownPose,
    Ties,
)
from amulor.site.registration.patterns import (
    contradicted,
    patterns_alike,
    unfit_scan,
)
from amulor.site.registration.pose import (
    ScanPose,
    best_pose,
    departure,
    start_covariance,
    start_pose,
)
from amulor.site.registration.reliability import Reliability, reliabilities
from amulor.site.registration.result import (
    Contradiction,
    Registration,
    Unchecked,
    Weakness,
    relative_covariance,
)
from amulor.site.registration.rough import squared_pull
from amulor.site.registration.sight import (
    Sight,
    absent_points,
    looks_of,
    pairs_seen_through,
)
from amulor.site.registration.starts import (
    height_above,
    part_met,
    start_findings,
)
from amulor.site.registration.surface import ScanSurface, scan_surface, shared_errors

Floats = NDArray[np.float64]

#: Chance of contradicting a start pose or shared error that is as good as stated [1].
_CHANCE = 1e-5
#: Largest gain by the data, posterior over prior, of a direction called weak [1].
_NO_BETTER = 0.5
#: A start pose alone suffices if points are displaced by less than this fraction of
#: their spacing [1].
_ENOUGH = 0.5
#: Least part of points that meet other scans at another height, for another datum [1].
_DATUM = 0.5
#: Number of points of a scan that test its height [1].
_SOME = 3000
#: Differences of heights below this distance are not tested [m].
_LEAST_HEIGHT = 0.02
#: Least score of the relief by which two scans are known to be of one place [1].
_RELIEF = 4.0
#: Part of absent points that contradicts a scan although it shares relief with others:
#: more than a moved object has [1].
_MANY_ABSENT = 0.02


def surfaces_of(
    site: Site, *, images_of: Container[str] | None = None
) -> tuple[dict[str, ScanSurface], dict[str, xr.Dataset]]:
    """Return the surfaces of all scans of a site, and range images of selected scans.

    Scans of many pixels are averaged over blocks of pixels. `images_of` names the scans
    whose images are needed; by default all.
    """
    surfaces, images = {}, {}
    for number, scan in enumerate(site.scan):
        tell(f"reading {scan.name}", number / len(site.scan))
        image = range_image_of(scan)
        image = averaged(image, block_size(site, scan.name, image))
        surface = surface_of(site, scan, image)
        if images_of is None or scan.name in images_of:
            motion = surface.motion
            images[scan.name] = image if motion is None else straightened(image, motion)
        surfaces[scan.name] = surface
    return surfaces, images


def surface_of(site: Site, scan: SiteScan, image: xr.Dataset) -> ScanSurface:
    """Return the surface of one scan of a site."""
    # Without a statement all scans of a visit are in one water.
    water = str(scan.water or _water_in(image) or "water")
    motion = motion_of(site, scan, image)
    shared = shared_errors(
        image,
        scan=scan.name,
        instrument=f"{scan.instrument}, {scan.epoch}",
        water=f"{water}, {scan.epoch}",
        drift=site.registration.drift if scan.drift is None else scan.drift,
        course=None if motion is None else motion.course,
    )
    return scan_surface(
        image if motion is None else straightened(image, motion),
        name=scan.name,
        shared=shared,
        window=site.registration.window,
        motion=motion,
    )


def _water_in(image: xr.Dataset) -> str:
    """Return a digest of an image's water settings; equal water gives equal digests."""
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
    """Register all scans of a site in one frame."""
    if surfaces is None or images is None:
        with part(0.0, 0.3):
            surfaces, images = surfaces_of(site, images_of=_with_targets(site))
    findings = start_findings(
        site, {name: item.position[item.usable] for name, item in surfaces.items()}
    )
    if not findings.mistakes:
        return _registered(site, surfaces, images, findings.remarks)
    corrected = site.model_copy(
        update={
            "scan": tuple(
                scan.model_copy(
                    update={"start": findings.corrected.get(scan.name, scan.start)}
                )
                for scan in site.scan
            )
        }
    )
    # By chance more points of wrong start poses may meet under another convention. Only
    # a registration shows whether these start poses are then as good as stated.
    if _fits(corrected, surfaces, images) and not _fits(site, surfaces, images):
        raise CubeError("\n".join(findings.mistakes))
    return _registered(site, surfaces, images, (*findings.poor, *findings.remarks))


def refined_lines(
    site: Site, result: Registration
) -> Iterator[tuple[str, Trajectory, Mounting]]:
    """Yield name, corrected trajectory and mounting of each line of a site."""
    for scan in site.scan:
        if scan.trajectory is None:
            continue
        image = range_image_of(scan)
        image = averaged(image, block_size(site, scan.name, image))
        motion = motion_of(site, scan, image)
        assert motion is not None
        errors = np.array([result.errors[key] for key in motion.keys])
        spread = result.covariance_of(
            f"pose {scan.name}", *(f"error {key}" for key in motion.keys)
        )
        track = track_in_frame(read_trajectory(scan.trajectory.file), site)
        pose = result.poses[scan.name]
        yield (scan.name, *refined(track, motion, pose, errors, spread))


def _with_targets(site: Site) -> set[str]:
    """Return the names of the scans that contain targets."""
    return {
        place.scan
        for target in site.target
        if not isinstance(target, ScaleBar)
        for place in target.places
    }


def _fits(
    site: Site, surfaces: Mapping[str, ScanSurface], images: Mapping[str, xr.Dataset]
) -> bool:
    """Whether all scans of a site register together without a contradiction."""
    try:
        result = _registered(site, surfaces, images, ())
    except CubeError:
        return False
    return not (result.contradictions or result.remarks or result.unchecked)


def _registered(
    site: Site,
    surfaces: Mapping[str, ScanSurface],
    images: Mapping[str, xr.Dataset],
    remarks: tuple[str, ...],
) -> Registration:
    """Register all scans of a site, with start poses as stated in the site file."""
    centres, surfaces = _centres(site, surfaces, images)
    start = {}
    for scan in site.scan:
        if scan.start is not None:
            pose = start_pose(scan.start)
            start[scan.name] = KnownPose(
                pose=pose, covariance=start_covariance(scan.start, pose)
            )
        motion = surfaces[scan.name].motion
        if motion is not None:
            start[scan.name] = KnownPose(
                pose=motion.start, covariance=motion.covariance
            )
    control = {}
    for item in site.control:
        sigma = np.broadcast_to(np.asarray(item.uncertainty, dtype=float), (3,)).copy()
        control[item.target] = KnownPoint(position=np.array(item.position), sigma=sigma)
    bars = tuple(
        KnownDistance(ends=item.ends, length=item.length, sigma=item.length_uncertainty)
        for item in site.target
        if isinstance(item, ScaleBar)
    )
    fixed = None
    if not start and len(control) < 3:
        fixed = site.scan[0].name
    guess = _guessed(site, centres, start, control, fixed)
    ties = Ties(start=start, centres=centres, control=control, bars=bars, fixed=fixed)
    with part(0.3, 1.0):
        alignment = align(
            surfaces,
            ties,
            overlap=site.registration.overlap,
            voxel=site.registration.voxel,
            guess=guess,
            visits={scan.name: scan.epoch for scan in site.scan},
        )
    return _result(site, alignment, ties, remarks, surfaces)


def _centres(
    site: Site, surfaces: Mapping[str, ScanSurface], images: Mapping[str, xr.Dataset]
) -> tuple[tuple[Centre, ...], dict[str, ScanSurface]]:
    """Return the measured target centers, and the surfaces without target pixels."""
    centres = []
    remaining = dict(surfaces)
    for target in site.target:
        if isinstance(target, ScaleBar):
            continue
        for place in target.places:
            scan = next(
                candidate for candidate in site.scan if candidate.name == place.scan
            )
            row, column = block_of(images[scan.name], place.row, place.column)
            centre, pixels = centre_of(
                target, surfaces[scan.name], images[scan.name], row, column
            )
            if target.moved:
                centre = replace(centre, target=f"{target.name} in {scan.epoch}")
            centres.append(centre)
            # The pixels of a target do not count a second time as a surface.
            smooth = remaining[scan.name].smooth & ~pixels
            remaining[scan.name] = replace(remaining[scan.name], smooth=smooth)
    return tuple(centres), remaining


def _guessed(
    site: Site,
    centres: tuple[Centre, ...],
    start: Mapping[str, KnownPose],
    control: Mapping[str, KnownPoint],
    fixed: str | None,
) -> dict[str, ScanPose]:
    """Compute initial poses from targets, for scans without start poses."""
    places = {name: item.position for name, item in control.items()}
    poses = {name: item.pose for name, item in start.items()}
    if fixed is not None:
        poses[fixed] = ScanPose(np.eye(3), np.zeros(3))
    guess: dict[str, ScanPose] = {}
    while True:
        for centre in centres:
            if centre.scan in poses:
                places.setdefault(
                    centre.target, poses[centre.scan].place(centre.position)
                )
        ready = [
            (
                item.name,
                [c for c in centres if c.scan == item.name and c.target in places],
            )
            for item in site.scan
            if item.name not in poses
        ]
        ready = [(name, visible) for name, visible in ready if len(visible) >= 3]
        if not ready:
            return guess
        name, visible = max(ready, key=lambda item: len(item[1]))
        local = np.array([item.position for item in visible])
        in_site = np.array([places[item.target] for item in visible])
        spread = np.linalg.svd(local - local.mean(axis=0))[1]
        if spread[1] < 0.02 * spread[0]:
            raise CubeError(
                f"scan {name!r}: its {len(visible)} targets stand on a line, about "
                "which it may turn; add one beside the line, or state [scan.start]"
            )
        guess[name] = poses[name] = best_pose(local, in_site)


def _result(
    site: Site,
    alignment: Alignment,
    ties: Ties,
    remarks: tuple[str, ...],
    surfaces: Mapping[str, ScanSurface],
) -> Registration:
    places = {
        f"{kind} {name}": (at.start, at.stop)
        for (kind, name), at in alignment.layout.at.items()
    }
    pairs = []
    for pair, trust in zip(alignment.pairs, alignment.trust, strict=True):
        moved = pixels_of_scan(surfaces[pair.source], pair.moved)
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
                "moved_pixels": moved.tolist(),
            }
        )
    targets = _common_targets(ties)
    tied = [*((pair.source, pair.target) for pair in alignment.pairs), *targets]
    groups = _groups(site, tied, ties, surfaces)
    reliability = reliabilities(
        alignment.state, alignment.covariance, alignment.layout, ties,
        inverse=alignment.inverse,
    )  # fmt: skip
    result = Registration(
        site=site.name,
        poses=alignment.state.poses,
        points=alignment.state.points,
        errors=alignment.state.errors,
        places=places,
        covariance=alignment.covariance + alignment.suspected,
        pairs=tuple(pairs),
        disagreements=tuple(
            {**vars(pair_record), "scans": list(pair_record.scans)}
            for pair_record in alignment.disagreements
        ),
        weaknesses=(),
        contradictions=_contradictions(site, alignment, ties, reliability),
        remarks=(*remarks, *_untied(site, tied, groups)),
        settled=alignment.settled,
        fixed=ties.fixed or "",
        patterns=alignment.patterns,
        undetected=alignment.undetected,
        reliability=reliability,
        scale=scale_tests(
            alignment.state, alignment.covariance, alignment.layout, ties,
            water_indices(surfaces), inverse=alignment.inverse,
        ),
    )  # fmt: skip
    result = replace(
        result,
        pairs=tuple(
            {**pair, "relief": score}
            for pair, score in zip(
                result.pairs, common_relief(result, surfaces), strict=True
            )
        ),
    )
    along_beams = tuple(_sight_contradictions(site, result, ties, surfaces))
    result = replace(
        result,
        # Suspected errors do not make a direction weak.
        weaknesses=_weak_directions(
            replace(result, covariance=alignment.covariance), ties, surfaces
        ),
        contradictions=_worst_first(
            (
                *result.contradictions,
                *along_beams,
                *_other_datums(groups, result, ties, surfaces),
            )
        ),
    )
    unchecked = _unchecked(site, groups, targets, result, ties, surfaces)
    return replace(result, unchecked=tuple(unchecked))


def _contradictions(
    site: Site,
    alignment: Alignment,
    ties: Ties,
    reliability: tuple[Reliability, ...],
) -> tuple[Contradiction, ...]:
    """Return the contradictions of all kinds except lines of sight and datums."""
    contradicting = []
    for name, start in ties.start.items():
        pose = alignment.state.poses.get(name)
        if pose is None or name == ties.fixed:
            continue
        off = departure(pose, start.pose)
        score = squared_pull(pose, start)
        if score > float(chi2.isf(_CHANCE, 6)):
            variances = [
                np.trace(start.covariance[k : k + 3, k : k + 3]) for k in (0, 3)
            ]
            contradicting.append(
                Contradiction(
                    scan=name,
                    error="",
                    shift=float(np.linalg.norm(off[:3])),
                    turn=float(np.linalg.norm(off[3:])),
                    stated_shift=math.sqrt(variances[0]),
                    stated_turn=math.sqrt(variances[1]),
                    score=score / 6,
                )
            )
    for key, value in alignment.state.errors.items():
        at = alignment.layout.at["error", key].start
        # The estimate of an honest error has the variance 1, minus what the prior draws
        # it to zero, plus that of the fit. The fit of lines from a vehicle adds more.
        by_fit = alignment.covariance[at, at] - 2 * alignment.inverse[at, at]
        score = value**2 / (1 + max(by_fit, 0.0))
        if score > float(chi2.isf(_CHANCE, 1)):
            contradicting.append(
                Contradiction(
                    scan="", error=key, shift=0.0, turn=0.0, stated_shift=0.0,
                    stated_turn=0.0, score=score,
                )
            )  # fmt: skip
    for line in reliability:
        kind = line.observation.partition(" ")[0]
        if kind in ("control", "bar") and abs(line.score) > norm.isf(_CHANCE / 2):
            contradicting.append(
                Contradiction(
                    scan="", error=f"{line.observation}, {line.part}",
                    shift=line.residual, turn=0.0, stated_shift=line.uncertainty,
                    stated_turn=0.0, score=line.score**2,
                )
            )  # fmt: skip
    pattern = contradicted(alignment.patterns)
    if pattern is not None:
        contradicting.append(
            Contradiction(
                scan=pattern.scan, error=pattern.pattern, shift=pattern.size, turn=0.0,
                stated_shift=pattern.uncertainty, stated_turn=0.0,
                score=pattern.score**2,
                alike=patterns_alike(alignment.patterns, pattern),
            )
        )  # fmt: skip
    visit = {scan.name: scan.epoch for scan in site.scan}
    unfit = unfit_scan(
        [pair for pair in alignment.pairs if visit[pair.source] == visit[pair.target]],
        list(visit),
    )
    if unfit is not None:
        contradicting.append(
            Contradiction(
                scan=unfit[0], error="surface", shift=0.0, turn=0.0, stated_shift=0.0,
                stated_turn=0.0, score=unfit[1] ** 2,
            )
        )  # fmt: skip
    return tuple(contradicting)


def _worst_first(contradictions: Iterable[Contradiction]) -> tuple[Contradiction, ...]:
    return tuple(sorted(contradictions, key=lambda line: -line.score))


def _sight_contradictions(
    site: Site,
    result: Registration,
    ties: Ties,
    surfaces: Mapping[str, ScanSurface],
) -> Iterator[Contradiction]:
    """Yield a contradiction for each scan that looks through surfaces of its visit."""
    pairs: list[Sight] = []
    for epoch in site.epoch:
        # The beams of a line come from many places.
        scans = [
            scan.name
            for scan in site.scans_of(epoch.name)
            if surfaces[scan.name].motion is None
        ]
        looks = looks_of(result, surfaces, scans)
        pairs += pairs_seen_through(looks)
        for absence in absent_points(looks, surfaces, result):
            others = [_relief(name, result) for name in absence.peers]
            alike = _relief(absence.scan, result) > max(_RELIEF, np.median(others) / 2)
            if not alike or absence.share > _MANY_ABSENT:
                yield Contradiction(
                    scan=absence.scan, error="absent", shift=absence.distance, turn=0.0,
                    stated_shift=absence.uncertainty, stated_turn=0.0,
                    score=(absence.distance / absence.uncertainty) ** 2,
                    peers=absence.peers, share=absence.share,
                )  # fmt: skip
    yield from _seen_through(pairs, result, ties)


def _relief(name: str, result: Registration) -> float:
    """Return the largest score of relief that a scan shares with another [1]."""
    return max(
        (
            pair["relief"]
            for pair in result.pairs
            if name in (pair["source"], pair["target"])
        ),
        default=0.0,
    )


def _seen_through(
    pairs: list[Sight], result: Registration, ties: Ties
) -> Iterator[Contradiction]:
    """Yield a contradiction for each scan that looks through surfaces of others.

    Of the two scans in a pair, the one with more such pairs is named; if equal, the one
    farther from its start pose.
    """
    pulls = {
        name: squared_pull(result.poses[name], start)
        for name, start in ties.start.items()
    }
    while pairs:
        names = [name for pair in pairs for name in pair.scans]
        worst = max(names, key=lambda name: (names.count(name), pulls.get(name, 0.0)))
        through = [pair for pair in pairs if worst in pair.scans]
        pairs = [pair for pair in pairs if worst not in pair.scans]
        strongest = max(through, key=lambda pair: max(pair.shares))
        yield Contradiction(
            scan=worst, error="sight", shift=strongest.distance, turn=0.0,
            stated_shift=strongest.uncertainty, stated_turn=0.0,
            score=(strongest.distance / strongest.uncertainty) ** 2,
            peers=tuple(
                name for pair in through for name in pair.scans if name != worst
            ),
            share=max(strongest.shares),
        )  # fmt: skip


def _other_datums(
    groups: list[list[str]],
    result: Registration,
    ties: Ties,
    surfaces: Mapping[str, ScanSurface],
) -> Iterator[Contradiction]:
    """Yield a contradiction for scan groups that fit the rest only with a height shift.

    Nothing ties them to the others, and the difference is beyond what is stated.
    """
    main = groups[0]
    for group in groups[1:]:
        points, others = (
            np.concatenate([_some_placed(result, surfaces[name]) for name in names])
            for names in (group, main)
        )
        height = height_above(points, others)
        if height is None:
            continue
        off = height[0]
        share = part_met(points - np.array([0.0, 0.0, off]), others)
        sigma = math.hypot(
            _group_error(group, ties, surfaces), _group_error(main, ties, surfaces)
        )
        score = off / max(sigma, _LEAST_HEIGHT)
        if share > _DATUM and abs(score) > norm.isf(_CHANCE / 2):
            yield Contradiction(
                scan=group[0], error="datum", shift=off, turn=0.0, stated_shift=sigma,
                stated_turn=0.0, score=score**2, peers=tuple(group[1:]), share=share,
            )  # fmt: skip


def _group_error(
    names: list[str], ties: Ties, surfaces: Mapping[str, ScanSurface]
) -> float:
    """Return the height uncertainty of a scan group, from its best start pose [m].

    Without start poses, only the group itself defines its height.
    """
    errors = []
    for name in names:
        if name in ties.start:
            covariance = ties.start[name].covariance
            away = float(np.nanmedian(surfaces[name].distance))
            tilt = max(covariance[3, 3], covariance[4, 4])
            errors.append(math.sqrt(covariance[2, 2] + away**2 * tilt))
    return min(errors, default=0.0)


def _some_placed(result: Registration, surface: ScanSurface) -> Floats:
    """Return evenly thinned points of a scan in the frame of the site [m]."""
    points = surface.position[surface.usable]
    step = max(len(points) // _SOME, 1)
    return result.poses[surface.name].place(points[::step])


def _common_targets(ties: Ties) -> list[tuple[str, str]]:
    """Return the pairs of scans with a common target."""
    return [
        (first.scan, second.scan)
        for first in ties.centres
        for second in ties.centres
        if first.target == second.target
    ]


def _untied(
    site: Site, tied: list[tuple[str, str]], groups: list[list[str]]
) -> Iterator[str]:
    """Yield a message for each visit or group of scans not connected to the others."""
    visit = {scan.name: scan.epoch for scan in site.scan}
    met = {visit[a] for a, b in tied if visit[a] != visit[b]}
    met |= {visit[b] for a, b in tied if visit[a] != visit[b]}
    for epoch in site.epoch if len(site.epoch) > 1 else ():
        if epoch.name not in met and site.scans_of(epoch.name):
            yield (
                f"visit {epoch.name!r}: no surface and no target ties its scans to "
                "another visit; only start poses and control points do, and change is "
                "compared no better than these are known"
            )
    trusted = {scan.name for scan in site.scan if scan.trusted}
    if met or len(site.epoch) == 1:
        for group in groups[1:]:
            if not trusted.isdisjoint(group):
                yield (
                    f"{', '.join(group)}: no surface and no target ties them to the "
                    "other scans; only start poses and control points do, which "
                    "nothing checks"
                )


def _unchecked(
    site: Site,
    groups: list[list[str]],
    targets: list[tuple[str, str]],
    result: Registration,
    ties: Ties,
    surfaces: Mapping[str, ScanSurface],
) -> Iterator[Unchecked]:
    """Yield the scans whose poses no other data check.

    Nothing connects them to the others, or only three planes do. The scan with the most
    certain start pose defines where the site is.
    """
    main = groups[0]
    controlled = {
        centre.scan for centre in ties.centres if centre.target in ties.control
    }
    first = ties.fixed or min(
        main, key=lambda name: _group_error([name], ties, surfaces)
    )
    exempt = {scan.name for scan in site.scan if scan.trusted} | {first}
    alike = [
        (pair["source"], pair["target"])
        for pair in result.pairs
        if pair["relief"] > _RELIEF
    ]
    recognized = next(
        group
        for group in _groups(site, [*targets, *alike], ties, surfaces)
        if first in group
    )
    weak = {weakness.scan for weakness in result.weaknesses}
    for group in groups:
        placed = group is main or not controlled.isdisjoint(group)
        for name in group:
            if name in exempt:
                continue
            if not placed:
                yield Unchecked(
                    scan=name,
                    reason=(
                        "no surface and no target ties it to the other scans, so only "
                        "start poses place it"
                    ),
                )
            elif (
                group is main
                and name not in {*recognized, *weak, *controlled}
                and not _surveyed(name, ties, surfaces)
            ):
                yield Unchecked(
                    scan=name,
                    reason=(
                        "the overlap is too symmetrical: three planes fit any other "
                        "corner, and no relief beside them is common to two scans"
                    ),
                )


def _surveyed(name: str, ties: Ties, surfaces: Mapping[str, ScanSurface]) -> bool:
    """Whether a start pose places points to a fraction of their spacing."""
    if name not in ties.start:
        return False
    variance = np.diag(ties.start[name].covariance)
    away = float(np.nanmedian(surfaces[name].distance))
    off = math.sqrt(variance[:3].max()) + away * math.sqrt(variance[3:].max())
    return off < _ENOUGH * surfaces[name].spacing


def _groups(
    site: Site,
    tied: list[tuple[str, str]],
    ties: Ties,
    surfaces: Mapping[str, ScanSurface],
) -> list[list[str]]:
    """Return the connected groups of scans, the largest and most accurate first."""
    names = [scan.name for scan in site.scan]
    number = {name: at for at, name in enumerate(names)}
    for _ in names:
        for pair in tied:
            least = min(number[name] for name in pair)
            number |= dict.fromkeys(pair, least)
    groups = [
        [name for name in names if number[name] == at]
        for at in sorted(set(number.values()))
    ]
    return sorted(
        groups, key=lambda names: (-len(names), _group_error(names, ties, surfaces))
    )


def _weak_directions(
    result: Registration, ties: Ties, surfaces: Mapping[str, ScanSurface]
) -> tuple[Weakness, ...]:
    """Return pose directions that only the start poses determine.

    A start pose that is accurate to a fraction of a pixel, as of a surveyed station,
    suffices.

    The error of a pose is relative to the nearest scan, because all scans share the
    error of the whole site.
    """
    weaknesses = []
    tied = {spread.scan for spread in ties.centres}
    for pair in result.pairs:
        tied |= {pair["source"], pair["target"]}
    for name, start in ties.start.items():
        if name not in result.poses or f"pose {name}" not in result.places:
            continue
        partners = {
            pair["source"] if pair["target"] == name else pair["target"]
            for pair in result.pairs
            if name in (pair["source"], pair["target"])
        }
        options = [
            relative_covariance(result, name, neighbor) for neighbor in sorted(partners)
        ]
        options.append(result.covariance_of(f"pose {name}"))
        best = min(
            options,
            key=lambda spread: float(
                np.trace(_relative_to_prior(spread, start.covariance))
            ),
        )
        values, axes = np.linalg.eigh(_relative_to_prior(best, start.covariance))
        root = np.linalg.cholesky(start.covariance)
        others = [_relative_to_prior(spread, start.covariance) for spread in options]
        for value, axis in zip(values, axes.T, strict=True):
            # Two start poses alone have a mean; a neighbor may be more certain.
            if min(float(axis @ spread @ axis) for spread in others) > _NO_BETTER**2:
                step = root @ axis * math.sqrt(value)
                surface = surfaces[name]
                away = float(np.nanmedian(surface.distance))
                off = np.linalg.norm(step[:3]) + away * np.linalg.norm(step[3:])
                if off < _ENOUGH * surface.spacing:
                    continue
                weaknesses.append(
                    Weakness(
                        scan=name,
                        shift=(float(step[0]), float(step[1]), float(step[2])),
                        turn=(float(step[3]), float(step[4]), float(step[5])),
                    )
                )
    return tuple(weaknesses)


def _relative_to_prior(covariance: Floats, prior: Floats) -> Floats:
    """Return a covariance in units of the prior standard uncertainties [1]."""
    inverse = np.linalg.inv(np.linalg.cholesky(prior))
    return np.asarray(inverse @ covariance @ inverse.T)
