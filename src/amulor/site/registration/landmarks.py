"""Test for landmarks: relief beyond three planes that two scans have in common.

A floor and two walls determine a pose completely, but fit the corner of any other dock.
Only relief beyond three planes shows that two scans are of one place. The test
correlates the distances of both scans from the three largest planes of one scan. Noise
of the two scans is independent, so without common relief the score is about 1.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from amulor.site.registration.result import Registration
from amulor.site.registration.surface import ScanSurface, corrected

Floats = NDArray[np.float64]

#: Number of planes that fit a corner, of points that test them, and of points for each
#: plane [1].
_PLANES, _MOST, _FEWEST = 3, 5000, 30
#: Number of pixels whose tangent planes are tried [1].
_TRIALS = 60
#: Largest distance from a plane, in standard errors of a pixel [1]; larger ones count
#: as this, so that a few points of a chance meeting do not decide.
_OFF = 4.0
#: Largest distance of points of two scans that are compared, in point spacings [1].
_NEAR = 4.0


def common_relief(
    result: Registration, surfaces: Mapping[str, ScanSurface]
) -> tuple[float, ...]:
    """Return the score of the relief that the scans of each compared pair share.

    The score is a correlation times the root of the number of points, of the scan with
    the larger one [1].
    """
    partners: dict[str, list[str]] = {}
    for pair in result.pairs:
        partners.setdefault(pair["source"], []).append(pair["target"])
        partners.setdefault(pair["target"], []).append(pair["source"])
    places = {
        name: result.poses[name].place(
            corrected(surfaces[name], result.errors)[surfaces[name].usable]
        )
        for name in partners
    }
    trees = {
        name: cKDTree(surfaces[name].direction[surfaces[name].usable])
        for name in partners
    }
    scores: dict[tuple[str, str], float] = {}
    for name, peers in partners.items():
        surface = surfaces[name]
        step = max(len(places[name]) // _MOST, 1)
        points = places[name][::step]
        normals = result.poses[name].turn(surface.normal[surface.usable][::step])
        noise = float(np.median(surface.own[surface.usable]))
        meetings = {}
        for peer in peers:
            other = surfaces[peer]
            # The neighbor is that along the beam, whatever its range: the nearest point
            # would be the one with the most similar noise.
            away = result.poses[peer].back(points)
            away -= other.origin[other.usable].mean(axis=0)
            away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
            near = places[peer][trees[peer].query(away)[1]]
            reach = _NEAR * max(surface.spacing, other.spacing)
            meetings[peer] = (np.linalg.norm(near - points, axis=1) < reach, near)
        met = np.any([flags for flags, _ in meetings.values()], axis=0)
        planes = _planes(points[met], normals[met], _OFF * noise)
        for peer, (flags, near) in meetings.items():
            scores[name, peer] = _score(points[flags], near[flags], planes, noise)
    return tuple(
        max(scores[ends], scores[ends[::-1]])
        for ends in ((pair["source"], pair["target"]) for pair in result.pairs)
    )


def _planes(
    points: Floats, normals: Floats, within: float
) -> list[tuple[Floats, Floats]]:
    """Return center and normal of the planes with most points, the largest first."""
    planes: list[tuple[Floats, Floats]] = []
    while len(planes) < _PLANES and len(points) >= _FEWEST:
        smooth = np.flatnonzero(np.isfinite(normals).all(axis=1))
        if not len(smooth):
            break
        best = np.zeros(len(points), dtype=bool)
        for at in smooth[:: max(len(smooth) // _TRIALS, 1)]:
            near = np.abs((points - points[at]) @ normals[at]) < within
            best = near if near.sum() > best.sum() else best
        if best.sum() < _FEWEST:
            break
        for _ in range(3):
            center = points[best].mean(axis=0)
            _, axes = np.linalg.eigh(np.cov((points[best] - center).T))
            near = np.abs((points - center) @ axes[:, 0]) < within
            best = near if near.sum() >= _FEWEST else best
        planes.append((center, axes[:, 0]))
        points, normals = points[~best], normals[~best]
    return planes


def _score(
    points: Floats,
    near: Floats,
    planes: list[tuple[Floats, Floats]],
    noise: float,
) -> float:
    """Return the correlation of two scans' distances from planes, as a score [1]."""
    if not planes or len(points) < _FEWEST:
        return 0.0
    off = np.array(
        [
            [(scan - center) @ normal for center, normal in planes]
            for scan in (points, near)
        ]
    )
    number = np.abs(off).argmin(axis=1)
    distance = np.clip(
        np.take_along_axis(off, number[:, None], axis=1)[:, 0] / noise, -_OFF, _OFF
    )
    same = number[0] == number[1]
    distance, number = distance[:, same], number[0][same]
    for plane in range(len(planes)):
        on = number == plane
        if on.any():
            distance[:, on] -= np.median(distance[:, on], axis=1, keepdims=True)
    size = float(np.sqrt((distance**2).sum(axis=1).prod()))
    if size == 0 or distance.shape[1] < _FEWEST:
        return 0.0
    correlation = float((distance[0] * distance[1]).sum()) / size
    return correlation * float(np.sqrt(distance.shape[1]))
