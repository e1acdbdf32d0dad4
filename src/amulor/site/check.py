"""Check of a site file: files, pixels of targets, connections between scans."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import io
from amulor._progress import tell
from amulor.cube import UNUSABLE, error_unknown
from amulor.errors import AmulorError
from amulor.imaging.observation import geometry_of
from amulor.site.description import ScaleBar, Site, SiteScan
from amulor.site.load import WHAT_TO_DO, check_level, refuse_vehicle
from amulor.site.registration.line import motion_of
from amulor.site.registration.starts import start_findings
from amulor.survey import Survey

#: Number of targets, not on a line, that place a scan without a start pose [1].
_ENOUGH = 3
#: Pixels around the pixel of a target; at least one must have a range.
_NEAR = 2


@dataclass(frozen=True, kw_only=True)
class Findings:
    """Errors and notes that the check of a site file reports."""

    mistakes: tuple[str, ...]
    """Errors that must be corrected, one line each."""
    remarks: tuple[str, ...]
    """Notes that need no correction."""
    shapes: dict[str, tuple[int, int]]
    """Rows and columns of each scan that could be read."""
    levels: dict[str, str]
    """Processing level of each scan that could be read."""


def check(site: Site) -> Findings:
    """Check the files, targets and connections of a site for mistakes."""
    mistakes: list[str] = []
    remarks: list[str] = []
    shapes: dict[str, tuple[int, int]] = {}
    levels: dict[str, str] = {}
    clouds: dict[str, NDArray[np.float64]] = {}
    for number, scan in enumerate(site.scan):
        tell(f"reading {scan.name}", number / len(site.scan))
        if scan.simulated_from is not None and not scan.file.is_file():
            remarks.append(
                f"scan {scan.name!r}: {scan.file.name} is not there yet; amulor run "
                "simulates it"
            )
            continue
        try:
            cube = io.read_cube(scan.file)
        except AmulorError as error:
            mistakes.append(f"scan {scan.name!r}: {error}")
            continue
        levels[scan.name] = str(cube.attrs.get("level", ""))
        shapes[scan.name] = (cube.sizes.get("row", 0), cube.sizes.get("column", 0))
        errors, notes = _scan_findings(site, scan, cube)
        mistakes += errors
        remarks += notes
        mistakes += _places_without_range(site, scan, cube)
        if levels[scan.name] == "range_image" and scan.trajectory is None:
            clouds[scan.name] = _points(cube)
    starts = start_findings(site, clouds)
    mistakes += starts.mistakes
    remarks += starts.remarks
    mistakes += _untied_scans(site)
    remarks += _without_use(site)
    return Findings(
        mistakes=tuple(mistakes), remarks=tuple(remarks), shapes=shapes, levels=levels
    )


def _scan_findings(
    site: Site, scan: SiteScan, cube: xr.Dataset
) -> tuple[list[str], list[str]]:
    """Return errors and notes about a single scan."""
    errors: list[str] = []
    notes: list[str] = []
    level = str(cube.attrs.get("level", ""))
    try:
        check_level(level, processed=scan.processing is not None, name=scan.name)
        if scan.trajectory is None:
            refuse_vehicle(cube, name=scan.name)
        elif level == "range_image":
            motion_of(site, scan, cube)
    except AmulorError as error:
        errors.append(str(error))
    if scan.water is not None:
        try:
            Survey.from_toml(scan.water)
        except AmulorError as error:
            errors.append(f"scan {scan.name!r}: water: {str(error).splitlines()[0]}")
    if level != "range_image":
        return errors, notes
    flags = cube["quality_flag"].values
    usable = int(((flags & UNUSABLE) == 0).sum())
    if usable < 100:
        errors.append(
            f"scan {scan.name!r}: {usable} of {flags.size} pixels have a range, too "
            "few to be placed; look at its quality flags with amulor info"
        )
    words = error_unknown(cube)
    if words:
        errors.append(f"scan {scan.name!r}: {words}; {WHAT_TO_DO}")
    unknown = str(cube.attrs.get("uncertainty_unknown", "")).split()
    if unknown:
        notes.append(
            f"scan {scan.name!r}: nobody states the error by {', '.join(unknown)}; "
            "stated covariances do not hold it (section [calibration] of its survey)"
        )
    return errors, notes


def _points(image: xr.Dataset) -> NDArray[np.float64]:
    """Return the usable points of a range image in instrument axes [m]."""
    beam = geometry_of(image).beam
    distance = image["slant_range"].values
    valid = ((image["quality_flag"].values & UNUSABLE) == 0) & (distance > 0)
    before = np.broadcast_to(beam.length_before, distance.shape)
    away = (distance - before)[..., None] * beam.direction
    return np.asarray((beam.entry + away)[valid])


def _places_without_range(
    site: Site, scan: SiteScan, cube: xr.Dataset
) -> Iterator[str]:
    """Yield a message for each target pixel outside its scan or without a range."""
    rows, columns = cube.sizes.get("row", 0), cube.sizes.get("column", 0)
    for target in site.target:
        if isinstance(target, ScaleBar):
            continue
        for place in target.places:
            if place.scan != scan.name:
                continue
            where = f"target {target.name!r} in scan {scan.name!r}"
            if place.row >= rows or place.column >= columns:
                yield (
                    f"{where}: pixel ({place.row}, {place.column}) is outside of its "
                    f"{rows} rows and {columns} columns, counted from 0"
                )
                continue
            if "slant_range" not in cube:
                continue
            near = cube["slant_range"].values[
                max(place.row - _NEAR, 0) : place.row + _NEAR + 1,
                max(place.column - _NEAR, 0) : place.column + _NEAR + 1,
            ]
            if not np.isfinite(near).any():
                yield (
                    f"{where}: no pixel near ({place.row}, {place.column}) has a "
                    "range; pick one on the target, for example with amulor view"
                )


def _untied_scans(site: Site) -> Iterator[str]:
    """Yield a message for each scan that neither a start pose nor targets can place."""
    placed = {
        scan.name
        for scan in site.scan
        if scan.start is not None or scan.trajectory is not None
    }
    controlled = {scan.target for scan in site.control}
    if not placed and len(controlled) < _ENOUGH:
        placed = {site.scan[0].name}  # then the first scan defines the frame
    located = set(controlled)
    waiting = [scan for scan in site.scan if scan.name not in placed]
    targets = {scan.name: _targets_in(site, scan) for scan in site.scan}
    for scan in site.scan:
        if scan.name in placed:
            located |= targets[scan.name]
    while True:
        more = [
            scan for scan in waiting if len(targets[scan.name] & located) >= _ENOUGH
        ]
        if not more:
            break
        for scan in more:
            located |= targets[scan.name]
        waiting = [scan for scan in waiting if scan not in more]
    for scan in waiting:
        shared = sorted(targets[scan.name] & located)
        yield (
            f"scan {scan.name!r}: its start pose is unknown, and it shares "
            f"{len(shared)} targets with scans whose pose is known "
            f"({', '.join(shared) or 'none'}); state [scan.start] with uncertainties, "
            f"or the places of {_ENOUGH} targets that are not on a line"
        )


def _targets_in(site: Site, scan: SiteScan) -> set[str]:
    """Return the names of a scan's targets, those of moved targets with the visit."""
    names = set()
    for target in site.target:
        if isinstance(target, ScaleBar):
            continue
        if any(place.scan == scan.name for place in target.places):
            name = f"{target.name} in {scan.epoch}" if target.moved else target.name
            names.add(name)
    return names


def _without_use(site: Site) -> Iterator[str]:
    """Yield a message for each unconnected target and each visit without scans."""
    controlled = {item.target for item in site.control}
    barred = {
        end for item in site.target if isinstance(item, ScaleBar) for end in item.ends
    }
    for target in site.target:
        if isinstance(target, ScaleBar):
            continue
        alone = len(target.places) == 1
        if alone and target.name not in controlled | barred:
            yield (
                f"target {target.name!r}: one scan sees it, and it is no control point "
                "and no end of a scale bar, so it tells nothing"
            )
    for epoch in site.epoch:
        if not site.scans_of(epoch.name):
            yield f"epoch {epoch.name!r}: no scan belongs to it"
