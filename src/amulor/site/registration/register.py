"""`register`: from a site file to poses, and the file that holds them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor._progress import part, tell
from amulor.cube import provenance
from amulor.errors import CubeError, FormatError
from amulor.io.files import atomic_output
from amulor.site.description.parts import ScaleBar, SiteScan
from amulor.site.description.site_file import Site
from amulor.site.load import range_image_of
from amulor.site.registration.align import Alignment, align
from amulor.site.registration.centres import centre_of
from amulor.site.registration.network import (
    Centre,
    KnownDistance,
    KnownPoint,
    KnownPose,
    Ties,
)
from amulor.site.registration.pose import (
    ScanPose,
    cross_matrix,
    kabsch,
    start_covariance,
    start_pose,
)
from amulor.site.registration.shared import shared_errors
from amulor.site.registration.surface import ScanSurface, scan_surface

Floats = NDArray[np.float64]

#: What the file of a registration says it is.
KIND = "amulor site registration 1"
#: A pose is held by its start pose if it is hardly known better afterwards [1].
_NO_BETTER = 0.5


@dataclass(frozen=True, kw_only=True)
class Weakness:
    """A direction in which nothing but the start pose holds a scan."""

    scan: str
    """Name of the scan."""
    shift: tuple[float, float, float]
    """East, north, up of the direction, for one standard deviation [m]."""
    turn: tuple[float, float, float]
    """About these axes [rad]."""


@dataclass(frozen=True, kw_only=True)
class Registration:
    """Poses of all scans of a site."""

    site: str
    """Name of the site."""
    poses: dict[str, ScanPose]
    """By scan."""
    points: dict[str, Floats]
    """Targets in the site, by name [m]."""
    errors: dict[str, float]
    """Shared errors as they are estimated, in standard deviations [1]."""
    places: dict[str, tuple[int, int]]
    """First and last place, exclusive, of each unknown in the covariance, by "pose
    NAME", "point NAME" and "error KEY"."""
    covariance: Floats
    """Of all unknowns."""
    pairs: tuple[dict[str, Any], ...]
    """Which scans were compared, and what came of it."""
    disagreements: tuple[dict[str, Any], ...]
    """Pairs of scans that all others contradict."""
    weaknesses: tuple[Weakness, ...]
    """Directions that only start poses hold."""
    settled: bool
    """Whether the last step was small."""
    fixed: str = ""
    """Scan whose axes are those of the site, where nothing ties it to the world."""

    def covariance_of(self, *names: str) -> Floats:
        """Return the covariance of some unknowns, as named in `places`.

        Parameters
        ----------
        *names : str
            Such as "pose left" or "error delay: instrument"; what is fixed has zeros.

        Returns
        -------
        ndarray
            Six rows for a pose, three for a point, one for an error.
        """
        width = {"pose": 6, "point": 3, "error": 1}
        at = np.concatenate(
            [
                np.arange(*self.places[name])
                if name in self.places
                else np.full(width[name.partition(" ")[0]], -1)
                for name in names
            ]
        )
        kept = at >= 0
        found = np.zeros((len(at), len(at)))
        found[np.ix_(kept, kept)] = self.covariance[np.ix_(at[kept], at[kept])]
        return found


def surfaces_of(site: Site) -> tuple[dict[str, ScanSurface], dict[str, xr.Dataset]]:
    """Return the surfaces and the range images of all scans of a site.

    Parameters
    ----------
    site : Site
        With whole paths of files.

    Returns
    -------
    surfaces : dict of str to ScanSurface
        By scan.
    images : dict of str to xarray.Dataset
        By scan.
    """
    surfaces, images = {}, {}
    for number, scan in enumerate(site.scan):
        tell(f"reading {scan.name}", number / len(site.scan))
        images[scan.name] = range_image_of(scan)
        surfaces[scan.name] = surface_of(site, scan, images[scan.name])
    return surfaces, images


def surface_of(site: Site, scan: SiteScan, image: xr.Dataset) -> ScanSurface:
    """Return the surface of one scan of a site.

    Parameters
    ----------
    site : Site
        Its settings count.
    scan : SiteScan
        The scan.
    image : xarray.Dataset
        Its range image.

    Returns
    -------
    ScanSurface
        With the errors that it shares with others.
    """
    water = str(scan.water or _water_in(image) or scan.name)
    shared = shared_errors(
        image,
        scan=scan.name,
        instrument=f"{scan.instrument}, {scan.epoch}",
        water=f"{water}, {scan.epoch}",
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
    """Bring all scans of a site into one frame.

    Parameters
    ----------
    site : Site
        With whole paths of files.
    surfaces, images : mapping, optional
        As of `surfaces_of`, to read files once.

    Returns
    -------
    Registration
        Poses with the covariance of all, and what disagrees or is weak.

    Raises
    ------
    CubeError
        If a scan cannot be placed, or a target is not found.
    """
    if surfaces is None or images is None:
        with part(0.0, 0.3):
            surfaces, images = surfaces_of(site)
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
    return _result(site, found, ties)


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
        guess[name] = poses[name] = kabsch(here, there)


def _result(site: Site, found: Alignment, ties: Ties) -> Registration:
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
        settled=found.settled,
        fixed=ties.fixed or "",
    )
    return replace(result, weaknesses=_weak(result, ties))


def _weak(result: Registration, ties: Ties) -> tuple[Weakness, ...]:
    """Return what the data hold no better than the start poses do.

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
        for value, axis in zip(values, axes.T, strict=True):
            if value > _NO_BETTER**2:
                step = root @ axis * math.sqrt(value)
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


def relative_covariance(result: Registration, name: str, other: str) -> Floats:
    """Return the covariance of a pose against that of another scan.

    Parameters
    ----------
    result : Registration
        Poses of both.
    name, other : str
        The scan, and the one that counts as known.

    Returns
    -------
    ndarray, shape (6, 6)
        Of shift and turn, without what both have in common.
    """
    both = result.covariance_of(f"pose {name}", f"pose {other}")
    arm = result.poses[name].position - result.poses[other].position
    carried = np.eye(6)
    carried[:3, 3:] = -cross_matrix(arm)
    rows = np.hstack([np.eye(6), -carried])
    return np.asarray(rows @ both @ rows.T)


def write_registration(
    result: Registration, path: str | Path, *, overwrite: bool = False
) -> None:
    """Write a registration as JSON.

    Parameters
    ----------
    result : Registration
        What `register` returned.
    path : str or pathlib.Path
        File to make.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    FormatError
        If the file exists and `overwrite` is not set, or cannot be written.
    """
    content = {
        "kind": KIND,
        "software": f"amulor {provenance.software_versions()['amulor']}",
        "site": result.site,
        "axes": "x east, y north, z up [m]; pose: from right, down, forward",
        "order": (
            "of each pose in the covariance: shift east, north, up [m], turn about "
            "east, north, up at the instrument [rad]"
        ),
        "settled": result.settled,
        "fixed": result.fixed,
        "poses": {
            name: {
                "matrix": pose.matrix.tolist(),
                "standard_uncertainty": np.sqrt(
                    np.diag(result.covariance_of(f"pose {name}"))
                ).tolist(),
            }
            for name, pose in result.poses.items()
        },
        "targets": {name: point.tolist() for name, point in result.points.items()},
        "shared_errors": result.errors,
        "pairs": list(result.pairs),
        "disagreements": list(result.disagreements),
        "weaknesses": [vars(one) for one in result.weaknesses],
        "places": result.places,
        "covariance": result.covariance.tolist(),
    }
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        temporary.write_text(json.dumps(content, indent=1, allow_nan=False))


def read_registration(path: str | Path) -> Registration:
    """Read the registration of a site.

    Parameters
    ----------
    path : str or pathlib.Path
        A file of `write_registration`.

    Returns
    -------
    Registration
        The same.

    Raises
    ------
    FormatError
        If it is none.
    """
    try:
        content = json.loads(Path(path).read_text("utf-8"))
    except OSError as error:
        raise FormatError(
            f"{path}: cannot be read ({error.strerror}); amulor site register makes it"
        ) from None
    except ValueError:
        content = None
    if not isinstance(content, dict) or content.get("kind") != KIND:
        raise FormatError(
            f"{path}: is no registration of a site; amulor site register makes one"
        )
    poses = {}
    for name, one in content["poses"].items():
        matrix = np.array(one["matrix"], dtype=float)
        poses[name] = ScanPose(matrix[:3, :3], matrix[:3, 3])
    return Registration(
        site=content["site"],
        poses=poses,
        points={k: np.array(v, dtype=float) for k, v in content["targets"].items()},
        errors=content["shared_errors"],
        places={k: (int(v[0]), int(v[1])) for k, v in content["places"].items()},
        covariance=np.array(content["covariance"], dtype=float),
        pairs=tuple(content["pairs"]),
        disagreements=tuple(content["disagreements"]),
        weaknesses=tuple(
            Weakness(scan=w["scan"], shift=tuple(w["shift"]), turn=tuple(w["turn"]))
            for w in content["weaknesses"]
        ),
        settled=bool(content["settled"]),
        fixed=content["fixed"],
    )
