"""Test of lines of sight: pairs of scans that look through each other's surface.

Water reaches up to the surface that a scan measures. A point of another scan in front
of that surface passed by in between, like a fish, or one of both scans is at a wrong
pose. At a wrong pose each scan looks through points of the other one. Where a surface
repeats, as struts along a wall, no misfit shows such a pose.
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


@dataclass(frozen=True)
class _Look:
    """Points of a scan compared along the beams of another scan of the same visit."""

    compared: Flags
    front: Flags
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


def pairs_seen_through(
    result: Registration, surfaces: Mapping[str, ScanSurface], scans: Sequence[str]
) -> tuple[Sight, ...]:
    """Return the pairs of scans of one visit that look through each other's surface.

    A passing object, such as a fish, is in front of the surfaces of all other scans. A
    scan with a wrong pose sees through points of the others, but these points are not
    in front of a third scan.

    Scans that the fit connects must agree wherever both see the surface, even if the
    pose of one is uncertain. A scan with wrong ranges agrees in a few places only.
    """
    if len(scans) < 2:
        return ()
    looks: dict[tuple[str, str], _Look] = {}
    connected: dict[tuple[str, str], _Look] = {}
    tied = {frozenset((pair["source"], pair["target"])) for pair in result.pairs}
    for target in scans:
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
    found = {
        sight.scans: sight
        for sight in (
            *_seen_through(connected, scans, _wrong_if_connected),
            *_seen_through(looks, scans, _wrong),
        )
    }
    return tuple(found.values())


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
        far = distance > np.maximum(_THROUGH * limit, _RELIEF * other.spacing)
        return _Look(compared=met, front=met & far, distance=distance, error=error)

    return look(error), look(noise)
