"""Test of start poses for usual mistakes: swapped axes, signs, unit of angles."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.spatial import cKDTree

from amulor.site.description import Site, StartPose
from amulor.site.registration.pose import start_pose

Floats = NDArray[np.float64]

#: Number of points of a scan that test its start [1].
_SOME = 1500
#: Bounds of the distance within which points meet another scan [m].
_LEAST, _MOST = 0.05, 0.3
#: Smallest part of points that meet others, for a scan with an overlap [1].
_NONE = 0.02
#: Gain of overlap for which another convention of start poses is named [1].
_BETTER = 0.25
#: Conventions with so little less overlap than the best are named with it [1].
_ALIKE = 0.1
#: Number of draws of start poses within their stated uncertainties [1].
_DRAWS = 20
#: Size of the cells in plan whose heights are compared [m], and their least number [1].
_CELL, _CELLS = 0.25, 6


@dataclass(frozen=True, kw_only=True)
class StartFindings:
    """Errors and notes that the test of start poses reports."""

    mistakes: tuple[str, ...]
    """Start poses that give a larger overlap under another convention."""
    remarks: tuple[str, ...]
    """Visits and scans that do not overlap with any other."""
    poor: tuple[str, ...] = ()
    """Notes on the start poses of `mistakes` that name no convention."""
    corrected: dict[str, StartPose] = field(default_factory=dict)
    """Start poses by scan under the convention that `mistakes` names first."""


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


def _in_radians(
    start: StartPose, names: Iterable[str] = ("heading", "pitch", "roll")
) -> dict[str, object]:
    factor = 180 / math.pi
    return {
        name: math.remainder(getattr(start, name) * factor, 2 * math.pi)
        for name in names
    }


def _heading_in_radians(start: StartPose) -> dict[str, object]:
    return _in_radians(start, ["heading"])


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
    (
        'their headings are radians called "deg"; state them as "rad"',
        _heading_in_radians,
    ),
)


def start_findings(site: Site, clouds: Mapping[str, Floats]) -> StartFindings:
    """Test whether correction of usual start-pose mistakes improves the overlap."""
    starts = {
        scan.name: scan.start
        for scan in site.scan
        if scan.start is not None and scan.name in clouds and len(clouds[scan.name])
    }
    visits = {
        epoch.name: [
            scan_name.name
            for scan_name in site.scans_of(epoch.name)
            if scan_name.name in starts
        ]
        for epoch in site.epoch
    }
    visits = {name: scans for name, scans in visits.items() if scans}
    mistakes: list[str] = []
    poor: list[str] = []
    remarks: list[str] = []
    if len(starts) < 2:
        return StartFindings(mistakes=(), remarks=())
    samples = {
        name: clouds[name][:: max(len(clouds[name]) // _SOME, 1)] for name in starts
    }
    placed = {name: _placed(starts[name], samples[name]) for name in starts}
    gates = {name: _gate(starts[name], samples[name]) for name in starts}
    # Of two contradicting visits, the less certain or else the later one is named.
    order = list(visits)
    worse = sorted(
        visits,
        key=lambda name: (
            min(starts[scan_name].position_uncertainty for scan_name in visits[name]),
            order.index(name),
        ),
        reverse=True,
    )
    groups = {f"visit {name!r}": visits[name] for name in worse}
    if len(visits) > 1:
        groups = {"all visits": list(starts)} | groups
    named: set[str] = set()
    corrected: dict[str, StartPose] = {}
    for group, scans in groups.items():
        if named:
            break
        agreement = _agreement(visits, scans, placed, gates)
        gains: dict[str, float] = {}
        for text, changed in _READINGS:
            try:
                moved = {
                    name: _placed(starts[name], samples[name], changed(starts[name]))
                    for name in scans
                }
            except ValidationError:  # such as a pitch beyond upright
                continue
            gains[text] = _agreement(visits, scans, placed | moved, gates)
        best = max(gains.values(), default=0.0)
        if best <= agreement + _BETTER:
            continue
        # With uncertain start poses, a random draw may gain as much overlap.
        chance = max(
            _agreement(visits, scans, placed | drawn, gates)
            for drawn in _draws({name: starts[name] for name in scans}, samples)
        )
        if best <= chance + _BETTER:
            remarks.append(
                f"{group}: start poses bring {agreement:.0%} of the points onto other "
                f"scans, and up to {chance:.0%} within their stated uncertainties; "
                "they may be too uncertain to start from; measure them better, or add "
                "three targets to each scan"
            )
        else:
            words = sorted(
                (text for text, gain in gains.items() if gain > best - _ALIKE),
                key=lambda text: -gains[text],
            )
            named |= set(scans)
            reading = dict(_READINGS)[words[0]]
            corrected |= {
                name: starts[name].model_copy(update=reading(starts[name]))
                for name in scans
            }
            share = (
                f"{group}: start poses of {', '.join(scans)} bring {agreement:.0%} of "
                "their points onto other scans"
            )
            remedy = "state the uncertainty of these start poses as large as it is"
            mistakes.append(
                f"{share}, and {best:.0%} if "
                + " (or: ".join(words)
                + ")" * (len(words) - 1)
                + f"; or {remedy}"
            )
            poor.append(f"{share}; check [scan.start], or {remedy}")
    for name in worse[:1] if len(visits) == 2 else worse:
        scans = visits[name]
        others = [scan_name for scan_name in starts if scan_name not in scans]
        if named or not others:
            continue
        met = max(_share(scan_name, others, placed, gates) for scan_name in scans)
        if met < _NONE:
            remarks.append(
                f"visit {name!r} meets no scan of another visit at its start poses"
                + _height_in_words(scans, others, placed)
            )
    for name in starts:
        others = [scan_name for scan_name in starts if scan_name != name]
        if not named and _share(name, others, placed, gates) < _NONE:
            remarks.append(
                f"scan {name!r} meets no other scan at its start pose; check "
                "[scan.start]"
            )
    return StartFindings(
        mistakes=tuple(mistakes),
        remarks=tuple(remarks),
        poor=tuple(poor),
        corrected=corrected,
    )


def _placed(
    start: StartPose, cloud: Floats, changed: Mapping[str, object] | None = None
) -> cKDTree:
    """Return a search tree of a scan's points, placed by its start pose."""
    pose = start_pose(start.model_copy(update=dict(changed or {})))
    return cKDTree(pose.place(cloud))


def _draws(
    starts: Mapping[str, StartPose], samples: Mapping[str, Floats]
) -> Iterator[dict[str, cKDTree]]:
    """Yield search trees of scans at random start poses within their uncertainties."""
    rng = np.random.default_rng(0)  # the same findings each time
    upright = math.pi / 2 - 1e-9
    for _ in range(_DRAWS):
        drawn = {}
        for name, start in starts.items():
            shift = rng.normal(scale=start.position_uncertainty, size=3)
            turn = rng.normal(scale=start.heading_uncertainty)
            pitch, roll = rng.normal(scale=start.level_uncertainty, size=2)
            changed = {
                "position": tuple(np.add(start.position, shift)),
                "heading": math.remainder(start.heading + turn, 2 * math.pi),
                "pitch": min(max(start.pitch + pitch, -upright), upright),
                "roll": math.remainder(start.roll + roll, 2 * math.pi),
            }
            drawn[name] = _placed(start, samples[name], changed)
        yield drawn


def _gate(start: StartPose, cloud: Floats) -> float:
    """Return the largest likely displacement of points by a start pose's error [m]."""
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
    """Return the mean over scans of the smaller overlap: with own or other visits."""
    shares_met = []
    for visit_scans in visits.values():
        outside = [peer for peer in placed if peer not in visit_scans]
        for name in visit_scans:
            if name in scans:
                among = [peer for peer in visit_scans if peer != name]
                shares = [
                    _share(name, others, placed, gates)
                    for others in (outside, among)
                    if others
                ]
                shares_met.append(min(shares))
    return float(np.mean(shares_met))


def _share(
    name: str,
    others: list[str],
    placed: Mapping[str, cKDTree],
    gates: Mapping[str, float],
) -> float:
    """Return the fraction of a scan's points that lie near those of other scans [1]."""
    points = placed[name].data
    met = np.zeros(len(points), dtype=bool)
    for peer in others:
        gate = max(gates[name], gates[peer])
        away = placed[peer].query(points, distance_upper_bound=gate)[0]
        met |= np.isfinite(away)
    return float(met.mean())


def _height_in_words(
    scans: list[str], others: list[str], placed: Mapping[str, cKDTree]
) -> str:
    """Return text on the height of scans above others, or on what to check."""
    height = height_above(
        *(
            np.concatenate([placed[name].data for name in names])
            for names in (scans, others)
        )
    )
    if height is None:
        return "; check [scan.start], or scan what both visits see"
    middle, cells = height
    where = "above" if middle > 0 else "below"
    return (
        f": it lies {abs(middle):.2f} m {where} the others in {cells} common cells "
        "of the plan; state all heights in one datum"
    )


def height_above(points: Floats, others: Floats) -> tuple[float, int] | None:
    """Return height above other points [m] and number of plan cells; None if unclear.

    None if too few cells of the plan are common, or the height is not uniform.
    """
    heights = []
    for part in (points, others):
        cells, group = np.unique(
            np.floor(part[:, :2] / _CELL).astype(int), axis=0, return_inverse=True
        )
        group = group.ravel()
        heights.append(
            {
                tuple(cell): float(np.median(part[group == number, 2]))
                for number, cell in enumerate(cells)
                if int((group == number).sum()) >= 5
            }
        )
    common = heights[0].keys() & heights[1].keys()
    off = np.array([heights[0][cell] - heights[1][cell] for cell in common])
    if len(off) < _CELLS:
        return None
    middle = float(np.median(off))
    if float(np.median(np.abs(off - middle))) > 0.2 * abs(middle):
        return None
    return middle, len(off)


def part_met(points: Floats, others: Floats) -> float:
    """Return the fraction of points that lie near other points [1]."""
    away = cKDTree(others).query(points, distance_upper_bound=_MOST)[0]
    return float(np.isfinite(away).mean())
