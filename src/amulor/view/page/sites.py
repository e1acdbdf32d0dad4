"""Scans and visits of a site in one view of the browser page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from amulor.io.shapes import Shape, spread, thinned
from amulor.site.change.distances import Change
from amulor.site.merging.cloud import Merged
from amulor.site.registration.result import Registration, relative_covariance
from amulor.view.page.space import MOST_POINTS, Space
from amulor.view.style import COLOURS

Floats = NDArray[np.float64]

#: Colors of scans: black would vanish in the dark theme.
_INKS = tuple(colour for colour in COLOURS if colour != "#000000")
#: Number of regions in the notes; `amulor site compare` lists all [1].
_MOST_REGIONS = 10


def site_space(
    cloud: Merged,
    registration: Registration,
    *,
    change: Change | None = None,
    regions: Sequence[str] = (),
) -> Space:
    """Page content of a site: points of all scans, poses, and change of two visits.

    The notes contain a sentence for each of the first regions of change.
    """
    site = cloud.site
    sigma = cloud.sigma
    scalars = {
        "uncertainty": np.sqrt((sigma**2).sum(axis=1)),
        **{f"sigma_{axis}": sigma[:, n] for n, axis in enumerate("xyz")},
        "amplitude": cloud.intensity,
        "overlap": 1.0 + cloud.confirmed,
        "flags": cloud.flag.astype(float),
        "scan": cloud.scan.astype(float),
    }
    if change is not None:
        scalars |= _of_points(cloud, change)
    colours = [_bytes(_INKS[n % len(_INKS)]) for n in range(len(site.scan))]
    shape = Shape(
        position=cloud.position,
        scalars=scalars,
        colour=np.array(colours, dtype=np.uint8)[cloud.scan],
        statements=[
            f"title: {site.name}",
            *_statements(registration, change),
            *(_noted(text) for text in regions[:_MOST_REGIONS]),
        ],
    )
    if len(shape.position) > MOST_POINTS:
        shape = thinned(shape, spread(len(shape.position), MOST_POINTS))
    scans = _scans(cloud, registration, colours)
    return Space(site.name, shape, scans=scans, pairs=_residuals(registration))


def _noted(sentence: str) -> str:
    """Sentence on a region of change as one line of the notes."""
    return f"change {' '.join(sentence.split())}".replace("+-", "±")


def _bytes(colour: str) -> list[int]:
    """Red, green and blue of a color such as "#0072B2"."""
    return list(bytes.fromhex(colour[1:]))


def _of_points(cloud: Merged, change: Change) -> dict[str, Floats]:
    """Change at the nearest place of comparison of each point of both visits [m]."""
    compared = np.flatnonzero(np.isfinite(change.value))
    tree = cKDTree(change.position[compared])
    away, near = tree.query(cloud.position, distance_upper_bound=change.radius)
    valid = np.isfinite(away) & ~cloud.moving
    valid &= cloud.of_epoch(change.epochs[0]) | cloud.of_epoch(change.epochs[1])
    at = compared[near[valid]]
    values = {
        "change": change.value,
        "change_significant": np.where(change.significant, change.value, np.nan),
        "change_uncertainty": change.uncertainty,
    }
    columns = {}
    for name, of_places in values.items():
        columns[name] = np.full(len(cloud.position), np.nan)
        columns[name][valid] = of_places[at]
    return columns


def _scans(
    cloud: Merged, registration: Registration, colours: list[list[int]]
) -> list[dict[str, Any]]:
    """Name, visit, color, points and uncertainty of the pose of each scan."""
    scans = cloud.site.scan
    counts = np.bincount(cloud.scan, minlength=len(scans))
    entries = []
    for scan, colour, count in zip(scans, colours, counts, strict=True):
        spread_of = relative_covariance(registration, scan.name, scans[0].name)
        variance = np.maximum(np.diag(spread_of), 0.0)
        entries.append(
            {
                "name": scan.name,
                "visit": scan.epoch,
                "colour": colour,
                "points": int(count),
                "position": registration.poses[scan.name].position.tolist(),
                "position_uncertainty": float(np.sqrt(variance[:3].sum())),
                "attitude_uncertainty": float(np.sqrt(variance[3:].sum())),
            }
        )
    return entries


def _residuals(registration: Registration) -> list[dict[str, Any]]:
    """Residuals of each pair of overlapping scans, the largest misfit first."""
    return [
        {
            "source": pair["source"],
            "target": pair["target"],
            "points": int(pair["points"]),
            "distance": float(pair["median_distance_m"]),
            "misfit": _misfit(pair),
            "moved": int(pair["moved_points"]),
            "directions": 6 - len(pair["loose"]),
            "trust": float(pair["trust"]),
        }
        for pair in sorted(registration.pairs, key=_misfit, reverse=True)
    ]


def _statements(registration: Registration, change: Change | None) -> list[str]:
    """Results of registration and comparison, for the notes of the page."""
    lines = []
    if registration.pairs:
        widest = max(registration.pairs, key=_misfit)
        away = max(abs(pair["median_distance_m"]) for pair in registration.pairs)
        lines.append(
            f"registration: {len(registration.pairs)} pairs of scans overlap; their "
            f"surfaces differ by up to {away * 1e3:.2g} mm (median of a pair). The "
            f"scatter is up to {_misfit(widest):.2f} times the stated noise "
            f"({widest['source']} on {widest['target']})"
        )
    lines += [f"registration: {remark}" for remark in registration.remarks]
    if change is not None:
        compared = int(np.isfinite(change.value).sum())
        lines.append(
            f"change: from visit {change.epochs[0]} to {change.epochs[1]}, along the "
            f"normal; {int(change.significant.sum()):,} of {compared:,} places changed "
            f"significantly, of these at most {change.false_alarms:.0%} by chance"
        )
    return lines


def _misfit(pair: dict[str, Any]) -> float:
    return float(pair["misfit"])
