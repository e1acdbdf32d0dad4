"""Start poses that cannot be right: swapped axes, radians called degrees, heights."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.spatial import cKDTree

from amulor.site.description import Site, StartPose
from amulor.site.registration.pose import start_pose

Floats = NDArray[np.float64]

#: Points of a scan that are placed [1].
_SOME = 1500
#: A point meets another scan within three standard errors of the start pose, but within
#: these bounds [m].
_LEAST, _MOST = 0.05, 0.3
#: Scans that meet others with a smaller part of their points meet none [1].
_NONE = 0.02
#: Another reading of the start poses is named if it brings so much more of the points
#: onto other scans [1].
_BETTER = 0.25
#: Cells of the plan whose heights are compared [m], and how many there must be [1].
_CELL, _CELLS = 0.25, 6


@dataclass(frozen=True, kw_only=True)
class StartFindings:
    """Findings about the start poses of a site."""

    mistakes: tuple[str, ...]
    """Start poses that another reading explains better."""
    remarks: tuple[str, ...]
    """Visits and scans that meet no other."""


def _swapped_up(start: StartPose) -> dict[str, object]:
    east, north, up = start.position
    return {"position": (east, north, -up)}


def _swapped_all_up(start: StartPose) -> dict[str, object]:
    return {**_swapped_up(start), "pitch": -start.pitch}


def _swapped_pitch(start: StartPose) -> dict[str, object]:
    return {"pitch": -start.pitch}


def _swapped_plan(start: StartPose) -> dict[str, object]:
    east, north, up = start.position
    return {"position": (north, east, up)}


def _from_east(start: StartPose) -> dict[str, object]:
    return {"heading": math.remainder(math.pi / 2 - start.heading, 2 * math.pi)}


def _in_radians(start: StartPose) -> dict[str, object]:
    factor = 180 / math.pi
    return {
        name: math.remainder(getattr(start, name) * factor, 2 * math.pi)
        for name in ("heading", "pitch", "roll")
    }


_READINGS: tuple[tuple[str, Callable[[StartPose], dict[str, object]]], ...] = (
    (
        "their third coordinate counts downwards; state it as up, the negative of a "
        "depth",
        _swapped_up,
    ),
    (
        "their third coordinate and their pitch count downwards; state both as up",
        _swapped_all_up,
    ),
    (
        "their pitch counts downwards; state how far the forward axis points upwards",
        _swapped_pitch,
    ),
    ("their east and north are swapped; state east first", _swapped_plan),
    (
        "their heading counts from east, counterclockwise; state it clockwise from "
        "grid north",
        _from_east,
    ),
    ('their angles are radians called "deg"; state them as "rad"', _in_radians),
)


def start_findings(site: Site, clouds: Mapping[str, Floats]) -> StartFindings:
    """Compare how start poses, and other readings of them, bring scans together."""
    starts = {
        scan.name: scan.start
        for scan in site.scan
        if scan.start is not None and scan.name in clouds and len(clouds[scan.name])
    }
    visits = {
        epoch.name: [
            one.name for one in site.scans_of(epoch.name) if one.name in starts
        ]
        for epoch in site.epoch
    }
    visits = {name: scans for name, scans in visits.items() if scans}
    mistakes: list[str] = []
    remarks: list[str] = []
    if len(starts) < 2:
        return StartFindings(mistakes=(), remarks=())
    some = {
        name: clouds[name][:: max(len(clouds[name]) // _SOME, 1)] for name in starts
    }
    placed = {name: _placed(starts[name], some[name]) for name in starts}
    gates = {name: _gate(starts[name], some[name]) for name in starts}
    # Of two visits that contradict each other the one that is known worse is named.
    worse = sorted(
        visits,
        key=lambda name: -min(starts[one].position_uncertainty for one in visits[name]),
    )
    groups = {f"visit {name!r}": visits[name] for name in worse}
    if len(visits) > 1:
        groups = {"all visits": list(starts)} | groups
    named: set[str] = set()
    for group, scans in groups.items():
        if named:
            break
        stated = _agreement(visits, scans, placed, gates)
        best, words = stated + _BETTER, ""
        for reading, changed in _READINGS:
            try:
                moved = {
                    name: _placed(starts[name], some[name], changed(starts[name]))
                    for name in scans
                }
            except ValidationError:  # such as a pitch beyond upright
                continue
            found = _agreement(visits, scans, placed | moved, gates)
            if found > best:
                best, words = found, reading
        if words:
            named |= set(scans)
            mistakes.append(
                f"{group}: start poses of {', '.join(scans)} bring {stated:.0%} of "
                f"their points onto other scans, and {best:.0%} if {words}"
            )
    for name in worse[:1] if len(visits) == 2 else worse:
        scans = visits[name]
        others = [one for one in starts if one not in scans]
        if named or not others:
            continue
        share = max(_share(one, others, placed, gates) for one in scans)
        if share < _NONE:
            remarks.append(
                f"visit {name!r} meets no scan of another visit at its start poses"
                + _above(scans, others, placed)
            )
    for name in starts:
        others = [one for one in starts if one != name]
        if not named and _share(name, others, placed, gates) < _NONE:
            remarks.append(
                f"scan {name!r} meets no other scan at its start pose; check "
                "[scan.start]"
            )
    return StartFindings(mistakes=tuple(mistakes), remarks=tuple(remarks))


def _placed(
    start: StartPose, cloud: Floats, changed: Mapping[str, object] | None = None
) -> cKDTree:
    """Return points of a scan in the site by its start pose, to be looked up."""
    pose = start_pose(start.model_copy(update=dict(changed or {})))
    return cKDTree(pose.place(cloud))


def _gate(start: StartPose, cloud: Floats) -> float:
    """Return how far points may be off by the stated errors of a start pose [m]."""
    away = float(np.median(np.linalg.norm(cloud, axis=1)))
    turn = max(start.heading_uncertainty, start.level_uncertainty)
    size = 3 * math.hypot(start.position_uncertainty, away * turn)
    apart = float(np.median(cKDTree(cloud).query(cloud, k=2)[0][:, 1]))
    return max(min(max(size, _LEAST), _MOST), 2 * apart)


def _agreement(
    visits: Mapping[str, list[str]],
    scans: list[str],
    placed: Mapping[str, cKDTree],
    gates: Mapping[str, float],
) -> float:
    """Return how much of scans meets others: of other visits, and of their own."""
    found = []
    for own in visits.values():
        outside = [one for one in placed if one not in own]
        for name in own:
            if name in scans:
                among = [one for one in own if one != name]
                shares = [
                    _share(name, others, placed, gates)
                    for others in (outside, among)
                    if others
                ]
                found.append(min(shares))
    return float(np.mean(found))


def _share(
    name: str,
    others: list[str],
    placed: Mapping[str, cKDTree],
    gates: Mapping[str, float],
) -> float:
    """Return the part of a scan's points that stand near points of others [1]."""
    points = placed[name].data
    met = np.zeros(len(points), dtype=bool)
    for other in others:
        gate = max(gates[name], gates[other])
        away = placed[other].query(points, distance_upper_bound=gate)[0]
        met |= np.isfinite(away)
    return float(met.mean())


def _above(scans: list[str], others: list[str], placed: Mapping[str, cKDTree]) -> str:
    """Return how far scans lie above others in the same cells of the plan, if so."""
    heights = []
    for names in (scans, others):
        points = np.concatenate([placed[name].data for name in names])
        cells, group = np.unique(
            np.floor(points[:, :2] / _CELL).astype(int), axis=0, return_inverse=True
        )
        group = group.ravel()
        heights.append(
            {
                tuple(cell): float(np.median(points[group == number, 2]))
                for number, cell in enumerate(cells)
                if int((group == number).sum()) >= 5
            }
        )
    common = heights[0].keys() & heights[1].keys()
    off = np.array([heights[0][cell] - heights[1][cell] for cell in common])
    if len(off) < _CELLS:
        return "; check [scan.start], or scan what both visits see"
    middle = float(np.median(off))
    if float(np.median(np.abs(off - middle))) > 0.2 * abs(middle):
        return "; check [scan.start], or scan what both visits see"
    where = "above" if middle > 0 else "below"
    return (
        f": it lies {abs(middle):.2f} m {where} the others in {len(off)} common cells "
        "of the plan; state all heights in one datum"
    )
