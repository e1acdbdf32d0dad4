"""Test of lines of sight: scans that look through surfaces of other scans.

Water reaches up to the surface that a scan measures. A point of another scan in front
of that surface passed by in between, like a fish, or one of both scans is at a wrong
pose. At a wrong pose each scan looks through points of the other one. Where a surface
repeats, as struts along a wall, no misfit shows such a pose.

A point on which two scans agree is no passing object. A scan that looks through it is
at a wrong pose or of another place, or an object moved.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from amulor.platform.attitude import cross_matrix
from amulor.site.registration.result import Registration, relative_covariance
from amulor.site.registration.surface import ScanSurface, corrected

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: A point is in front of a surface beyond this many standard errors, and this many
#: point spacings [1].
_THROUGH, _RELIEF = 6.0, 3.0
#: Least part and least number of points in front, in both directions; scans at correct
#: poses have none [1].
_SHARE, _FEWEST = 0.02, 10
#: Least part of points in front beyond the noise, mean of both directions, of two scans
#: that the fit connects; the uncertainty of poses is no excuse there [1].
_SHARE_CONNECTED = 0.05
#: Largest number of points of a scan that are tested [1].
_MOST = 5000
#: Relief in front of which a point counts if another scan confirms it, and the distance
#: within which a point confirms another one, in point spacings [1].
_RELIEF_CONFIRMED, _CONFIRMED = 1.0, 0.7
#: Least part of confirmed points in front of a scan's surface [1].
_SHARE_CONFIRMED = 0.004


@dataclass(frozen=True, kw_only=True)
class Sight:
    """Pair of scans that look through each other's surface."""

    scans: tuple[str, str]
    """Names of the scans."""
    shares: tuple[float, float]
    """Fraction of the compared points of each scan in front of the other's surface
    [1]."""
    distance: float
    """Median distance of these points in front of the surface [m]."""
    uncertainty: float
    """Median standard error of these distances [m]."""


@dataclass(frozen=True, kw_only=True)
class Absence:
    """Points on which other scans agree, in front of the surface of a scan."""

    scan: str
    """Name of the scan that looks through these points."""
    peers: tuple[str, ...]
    """Names of the scans of these points."""
    count: int
    """Number of these points [1]."""
    share: float
    """Fraction of all compared points on which other scans agree [1]."""
    distance: float
    """Median distance of these points in front of the surface [m]."""
    uncertainty: float
    """Median standard error of these distances [m]."""


@dataclass(frozen=True)
class _Look:
    """Points of a scan compared along the beams of another scan of the same visit."""

    place: Floats
    compared: Flags
    front: Flags
    closely: Flags
    distance: Floats
    error: Floats

    @property
    def share(self) -> float:
        """Fraction of the compared points in front of the surface; 0 if few [1]."""
        return self.share_of(self.front)

    def share_of(self, points: Flags) -> float:
        """Fraction of compared points that are selected and in front; 0 if few [1]."""
        count = int((self.front & points).sum())
        return count / max(int(self.compared.sum()), 1) if count >= _FEWEST else 0.0


@dataclass(frozen=True)
class Looks:
    """Comparisons along beams of all pairs of scans of one visit."""

    scans: tuple[str, ...]
    """Names of the scans."""
    looks: dict[tuple[str, str], _Look]
    """Comparison of the points of the first scan with the surface of the second."""
    connected: dict[tuple[str, str], _Look]
    """Comparisons of scans that the fit connects, without the errors of poses."""


def looks_of(
    result: Registration, surfaces: Mapping[str, ScanSurface], scans: Sequence[str]
) -> Looks:
    """Compare the points of scans of one visit along the beams of the others."""
    looks: dict[tuple[str, str], _Look] = {}
    connected: dict[tuple[str, str], _Look] = {}
    tied = {frozenset((pair["source"], pair["target"])) for pair in result.pairs}
    for target in scans if len(scans) > 1 else ():
        depth = _nearest_range(surfaces[target], result)
        tree = cKDTree(surfaces[target].direction.reshape(-1, 3))
        for source in scans:
            if source != target:
                key = (source, target)
                looks[key], by_noise = _looks(
                    result, surfaces, source, target, tree, depth
                )
                if frozenset(key) in tied:
                    connected[key] = by_noise
    return Looks(tuple(scans), looks, connected)


def pairs_seen_through(compared: Looks) -> tuple[Sight, ...]:
    """Return the pairs of scans of one visit that look through each other's surface.

    A passing object, such as a fish, is in front of the surfaces of all other scans. A
    scan with a wrong pose sees through points of the others, but these points are not
    in front of a third scan.

    Scans that the fit connects must agree wherever both see the surface, even if the
    pose of one is uncertain. A scan with wrong ranges agrees in a few places only.
    """
    sights = {
        sight.scans: sight
        for sight in (
            *_seen_through(compared.connected, compared.scans, _wrong_if_connected),
            *_seen_through(compared.looks, compared.scans, _wrong),
        )
    }
    return tuple(sights.values())


def absent_points(
    compared: Looks, surfaces: Mapping[str, ScanSurface], result: Registration
) -> Iterator[Absence]:
    """Yield the scans that look through points on which two other scans agree."""
    agreeing = _agreeing(compared, surfaces, result)
    for target in compared.scans:
        counts, total, off, error = {}, 0, [], []
        for source in compared.scans:
            key = (source, target)
            if source == target:
                continue
            look = compared.connected.get(key, compared.looks[key])
            agreed = np.zeros(len(look.place), dtype=bool)
            for peer in compared.scans:
                if peer != target and (source, peer) in agreeing:
                    agreed |= agreeing[source, peer]
            absent = look.closely & agreed
            counts[source] = int(absent.sum())
            total += int((look.compared & agreed).sum())
            off.append(look.distance[absent])
            error.append(look.error[absent])
        count = sum(counts.values())
        if count >= _FEWEST and count > _SHARE_CONFIRMED * total:
            yield Absence(
                scan=target,
                peers=tuple(name for name, number in counts.items() if number),
                count=count,
                share=count / total,
                distance=float(np.median(np.concatenate(off))),
                uncertainty=float(np.median(np.concatenate(error))),
            )


def _agreeing(
    compared: Looks, surfaces: Mapping[str, ScanSurface], result: Registration
) -> dict[tuple[str, str], Flags]:
    """Return masks of the points of a scan that lie near points of a connected scan."""
    trees = {}
    for name in compared.scans:
        surface = surfaces[name]
        points = corrected(surface, result.errors)[surface.usable]
        trees[name] = cKDTree(result.poses[name].place(points))
    masks = {}
    for source, peer in compared.connected:
        near = _CONFIRMED * max(surfaces[source].spacing, surfaces[peer].spacing)
        away = trees[peer].query(
            compared.connected[source, peer].place, distance_upper_bound=near
        )[0]
        masks[source, peer] = np.isfinite(away)
    return masks


def _wrong(share: tuple[float, float], alone: tuple[float, float]) -> bool:
    """Whether two scans look through each other's surface, in both directions."""
    return min(share) > _SHARE and max(alone) > _SHARE


def _wrong_if_connected(share: tuple[float, float], alone: tuple[float, float]) -> bool:
    """Whether surfaces disagree although the fit connects them."""
    return sum(alone) > 2 * _SHARE_CONNECTED


def _seen_through(
    looks: Mapping[tuple[str, str], _Look],
    scans: Sequence[str],
    wrong: Callable[[tuple[float, float], tuple[float, float]], bool],
) -> Iterator[Sight]:
    """Yield the pairs with many points in front of each other's surface."""
    fronts = {
        name: np.sum([look.front for (of, _), look in looks.items() if of == name], 0)
        for name in scans
    }
    for first, second in itertools.combinations(scans, 2):
        if (first, second) not in looks:
            continue
        both = (looks[first, second], looks[second, first])
        share = (both[0].share, both[1].share)
        # Points of a passing object are in front of all other scans.
        alone = (
            both[0].share_of(fronts[first] == 1),
            both[1].share_of(fronts[second] == 1),
        )
        if wrong(share, alone):
            off, error = (
                np.concatenate([getattr(look, key)[look.front] for look in both])
                for key in ("distance", "error")
            )
            yield Sight(
                scans=(first, second),
                shares=share,
                distance=float(np.median(off)),
                uncertainty=float(np.median(error)),
            )


def _middle(surface: ScanSurface) -> Floats:
    return np.asarray(surface.origin[surface.usable].mean(axis=0))


def _nearest_range(surface: ScanSurface, result: Registration) -> Floats:
    """Smallest range of each pixel and its neighbors [m]; -infinity beside gaps."""
    away = corrected(surface, result.errors) - _middle(surface)
    reach = np.where(surface.usable, np.linalg.norm(away, axis=-1), -np.inf)
    return np.asarray(
        ndimage.minimum_filter(reach, 3, mode="constant", cval=-np.inf).ravel()
    )


def _looks(
    result: Registration,
    surfaces: Mapping[str, ScanSurface],
    source: str,
    target: str,
    tree: cKDTree,
    depth: Floats,
) -> tuple[_Look, _Look]:
    """Compare a scan with nearby ranges of another: by total error, and by noise alone.

    Points of the first result are in front beyond all errors, of the second beyond the
    noise.
    """
    surface, other = surfaces[source], surfaces[target]
    pixel = np.flatnonzero(surface.usable)
    pixel = pixel[:: max(len(pixel) // _MOST, 1)]
    pose = result.poses[source]
    place = pose.place(corrected(surface, result.errors).reshape(-1, 3)[pixel])
    rows = np.zeros((len(pixel), 3, 6))
    rows[..., :3], rows[..., 3:] = np.eye(3), -cross_matrix(place - pose.position)
    spread = rows @ relative_covariance(result, source, target) @ rows.swapaxes(1, 2)
    away = result.poses[target].back(place) - _middle(other)
    reach = np.linalg.norm(away, axis=1)
    step = other.spacing / float(np.nanmedian(other.distance))
    off, number = tree.query(
        away / np.maximum(reach, 1e-9)[:, None], distance_upper_bound=step
    )
    met = np.isfinite(off)
    number = np.where(met, number, 0)
    met &= np.isfinite(depth[number])
    distance = np.where(met, depth[number] - reach, 0.0)
    noise = np.nan_to_num(other.own.ravel())[number]
    variance = np.linalg.eigvalsh(spread)[:, -1]
    noise = np.hypot(noise, surface.own.ravel()[pixel])
    error = np.sqrt(variance + noise**2)

    def look(limit: Floats) -> _Look:
        closely, far = (
            met & (distance > np.maximum(_THROUGH * limit, relief * other.spacing))
            for relief in (_RELIEF_CONFIRMED, _RELIEF)
        )
        return _Look(place, met, far, closely, distance, error)

    return look(error), look(noise)
