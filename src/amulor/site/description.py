"""Description of a site in its file: scans, visits, targets and control points."""

from __future__ import annotations

import datetime
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from amulor import _plugins
from amulor.errors import SurveyError
from amulor.survey import toml_file
from amulor.survey.quantity import (
    Angle,
    Count,
    Description,
    Fraction,
    Length,
    Position,
)
from amulor.survey.scan import Pose, ReferenceSystem

Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[\w .+-]+$")]
_Sigma = Annotated[Length, Field(gt=0, le=1000)]


class SiteFrame(Description):
    """Local frame of all scans: x east, y north, z up."""

    crs: ReferenceSystem = ""
    """Reference system of the local frame: a projected system in meters, such as
    "EPSG:32632", or a name; none by default."""
    crs_offset: Position = (0.0, 0.0, 0.0)
    """Offset from the local frame to the reference system (east, north, up), common to
    all scans, tiles and epochs [m]."""


class Epoch(Description):
    """Visit to the site."""

    name: Name
    """Name of the visit, used by scans."""
    date: datetime.date | None = None
    """Day of the visit; unknown by default."""


class StartPose(Description):
    """Approximate pose of an instrument, from which registration starts."""

    position: Position
    """Origin of the instrument's axes (east, north, up), in the frame of the site
    [m]."""
    heading: Annotated[Angle, Field(ge=-2 * math.pi, le=2 * math.pi)]
    """Direction of the forward axis, clockwise from grid north [rad]."""
    pitch: Annotated[Angle, Field(ge=-math.pi / 2, le=math.pi / 2)] = 0.0
    """Elevation of the forward axis above the horizon [rad]."""
    roll: Annotated[Angle, Field(ge=-math.pi, le=math.pi)] = 0.0
    """Rotation about the forward axis, right side down [rad]."""
    position_uncertainty: _Sigma
    """Standard uncertainty of each coordinate of the position [m]."""
    heading_uncertainty: Annotated[Angle, Field(gt=0, le=1)]
    """Standard uncertainty of the heading [rad]."""
    level_uncertainty: Annotated[Angle, Field(gt=0, le=1)]
    """Standard uncertainty of pitch and of roll [rad]."""

    def as_pose(self) -> Pose:
        """Return the start pose in the format of survey files."""
        return Pose.model_validate(self.model_dump())


def _installed(method: str) -> str:
    """Return the name of a rejection method; raise ValueError if not installed."""
    installed = _plugins.names(_plugins.REJECTION)
    if method not in installed:
        raise ValueError(
            f"there is no rejection method {method!r}; installed are "
            f"{', '.join(installed)}"
        )
    return method


def _list_methods(schema: dict[str, Any]) -> None:
    schema["enum"] = list(_plugins.names(_plugins.REJECTION))


class Processing(Description):
    """Settings for processing a cube to a range image."""

    method: Annotated[
        str, AfterValidator(_installed), Field(json_schema_extra=_list_methods)
    ]
    """Rejection method, named as in `amulor reject --method`."""
    polarization: str | None = None
    """Polarization channel to use, such as "VV"; needed if there are several."""
    nearest: Annotated[Length, Field(ge=0)] | None = None
    """Nearest possible slant range; needs `farthest` [m]."""
    farthest: Annotated[Length, Field(gt=0)] | None = None
    """Farthest possible slant range; needs `nearest` [m]."""

    @model_validator(mode="after")
    def _both_ends(self) -> Self:
        if (self.nearest is None) != (self.farthest is None):
            raise ValueError("nearest and farthest must be stated together")
        near, far = self.nearest, self.farthest
        if near is not None and far is not None and near >= far:
            raise ValueError(f"nearest ({near:g} m) must be below farthest ({far:g} m)")
        return self


def _unknown_as_none(value: Any) -> Any:
    """Return None for the text "unknown", which stands for an omitted start pose."""
    return None if value == "unknown" else value


class SiteTrajectory(Description):
    """Trajectory of the vehicle that carried the instrument during a scan."""

    file: Path
    """Trajectory of `amulor import trajectory`, `acquire` or `simulate`; relative to
    the site file."""
    mounting: Path | None = None
    """File with the mounting of the instrument; by default from the survey of the
    scan."""
    position_drift: Annotated[Length, Field(ge=0, le=10)] | None = None
    """Standard uncertainty of half the change of the position errors from the first to
    the last row. By default their random walk has the change of the stated uncertainty
    along the line; if it does not change, the stated uncertainty [m]."""
    attitude_drift: Annotated[Angle, Field(ge=0, le=0.5)] | None = None
    """Standard uncertainty of half the change of the attitude errors about each axis;
    by default as for the position [rad]."""


class SiteScan(Description):
    """Scan of the site, with its file, visit and start pose."""

    name: Name
    """Unique name of the scan, used by targets and results."""
    file: Path
    """Range image (netCDF), or a cube of samples or of the target signal with
    `processing`; relative to the site file."""
    epoch: Name
    """Name of the visit in which the scan was made."""
    start: Annotated[StartPose | None, BeforeValidator(_unknown_as_none)] = None
    """Approximate pose of the instrument, with uncertainties; "unknown" if targets in
    other scans or control points determine it."""
    trajectory: SiteTrajectory | None = None
    """Trajectory of the vehicle of a moving scan (line), in place of a start pose."""
    trusted: bool = False
    """Whether the scan is merged and compared although no other data check its pose,
    for example because its start pose is surveyed."""
    water: Path | None = None
    """Survey file that states the water; by default the survey of the scan. Scans of a
    visit with equal water, or without any statement, share the error of its group
    index."""
    instrument: Name = "instrument"
    """Name of the instrument; scans of one instrument and one epoch share the errors of
    its delay and its geometry."""
    drift: Annotated[Length, Field(ge=0)] | None = None
    """Standard uncertainty of a slow drift of the ranges: half of the change from the
    first to the last row; by default that of `[registration]` [m]."""
    processing: Processing | None = None
    """Processing of a cube into a range image; not needed for a range image."""
    simulated_from: Path | None = None
    """Survey from which `amulor run` simulates the file, for rehearsals; the file need
    not exist then."""
    seed: Annotated[Count, Field(ge=0)] = 1
    """Seed of that simulation [1]."""


class Place(Description):
    """Pixel at which a target appears in a scan."""

    scan: Name
    """Name of the scan."""
    row: Annotated[Count, Field(ge=0)]
    """Row of a pixel on the target, near its center, counted from 0 [1]."""
    column: Annotated[Count, Field(ge=0)]
    """Column of the pixel, counted from 0 [1]."""


class _Seen(Description):
    name: Name
    """Unique name of the target, used by control points, scale bars and results."""
    places: Annotated[tuple[Place, ...], Field(min_length=1)]
    """Pixels of the target in the scans that show it."""
    moved: bool = False
    """Whether the target was set up anew at each visit, so that it connects only the
    scans of one visit."""


class SphereTarget(_Seen):
    """Sphere, which connects scans by its center."""

    kind: Literal["sphere"]
    """Kind of the target."""
    radius: Annotated[Length, Field(gt=0, le=10)]
    """Radius [m]."""
    radius_uncertainty: Annotated[Length, Field(ge=0, le=1)]
    """Standard uncertainty of the radius [m]."""


class DiscTarget(_Seen):
    """Flat round disc with no surface close behind it; its center connects scans."""

    kind: Literal["disc"]
    """Kind of the target."""
    diameter: Annotated[Length, Field(gt=0, le=10)]
    """Diameter [m]."""
    diameter_uncertainty: Annotated[Length, Field(ge=0, le=1)]
    """Standard uncertainty of the diameter [m]."""


class CheckerboardTarget(_Seen):
    """Checkerboard of four fields, which connects scans by its central corner."""

    kind: Literal["checkerboard"]
    """Kind of the target."""
    width: Annotated[Length, Field(gt=0, le=10)]
    """Side length of the whole board [m]."""


class PointTarget(_Seen):
    """Point that is recognized in several scans, such as a corner of a stone."""

    kind: Literal["point"]
    """Kind of the target."""
    picking_uncertainty: _Sigma
    """Standard uncertainty of the picked point across the beam [m]."""


class ScaleBar(Description):
    """Scale bar: known distance between the centers of two targets."""

    kind: Literal["scale-bar"]
    """Kind of the target."""
    name: Name
    """Unique name of the scale bar, used by results."""
    ends: tuple[Name, Name]
    """Names of the targets at both ends."""
    length: Annotated[Length, Field(gt=0, le=1000)]
    """Distance between the targets' centers [m]."""
    length_uncertainty: _Sigma
    """Standard uncertainty of the length [m]."""

    @model_validator(mode="after")
    def _two_ends(self) -> Self:
        if self.ends[0] == self.ends[1]:
            raise ValueError(f"ends: both are {self.ends[0]!r}; name two targets")
        return self


SiteTarget = Annotated[
    SphereTarget | DiscTarget | CheckerboardTarget | PointTarget | ScaleBar,
    Field(discriminator="kind"),
]


class Control(Description):
    """Control point: target at a known position, from another survey."""

    target: Name
    """Name of the target."""
    position: Position
    """Position of the target's center (east, north, up) in the frame of the site
    [m]."""
    uncertainty: tuple[_Sigma, _Sigma, _Sigma] | _Sigma
    """Standard uncertainty of the coordinates: one number for all, or one number for
    each [m]."""


class Registration(Description):
    """Settings for the registration of all scans."""

    overlap: Annotated[Fraction, Field(gt=0, le=1)] = 0.1
    """Least fraction of a scan's pixels that must lie on another scan, for a comparison
    of the two [1]."""
    voxel: Annotated[Length, Field(gt=0, le=1)] | None = None
    """Spacing of points in the first, rough alignment; by default twice the spacing of
    the pixels [m]."""
    window: Annotated[Count, Field(ge=3, le=21)] = 7
    """Width in pixels of the window in which a surface must be smooth; odd [1]."""
    drift: Annotated[Length, Field(ge=0)] = 0.0
    """Standard uncertainty of a slow drift in each scan that states none: half of the
    change of the ranges from the first to the last row [m]."""

    @model_validator(mode="after")
    def _odd(self) -> Self:
        if self.window % 2 == 0:
            raise ValueError(f"window must be odd, found {self.window}")
        return self


class Comparison(Description):
    """Settings for the comparison of visits."""

    spacing: Annotated[Length, Field(gt=0, le=10)] | None = None
    """Distance between neighboring points at which change is tested; by default twice
    the spacing of the pixels [m]."""
    radius: Annotated[Length, Field(gt=0, le=10)] | None = None
    """Radius of the cylinder whose points are averaged; by default one and a half times
    `spacing` [m]."""
    reach: Annotated[Length, Field(gt=0, le=10)] = 0.2
    """Largest change that is detected, along the normal [m]."""
    false_alarms: Annotated[Fraction, Field(gt=0, lt=0.5)] = 0.05
    """Largest expected fraction of false alarms among the significant points [1]."""


class Site(Description):
    """Scans of a site, with the targets and poses that connect them."""

    name: Annotated[str, Field(min_length=1, max_length=200)]
    """Name of the site, used as the title of all results."""
    frame: SiteFrame = SiteFrame()
    """Frame of all scans."""
    epoch: Annotated[tuple[Epoch, ...], Field(min_length=1)]
    """Visits in chronological order."""
    scan: Annotated[tuple[SiteScan, ...], Field(min_length=1)]
    """Scans of all visits."""
    target: tuple[SiteTarget, ...] = ()
    """Targets that were set up, and points that are recognized."""
    control: tuple[Control, ...] = ()
    """Control points: targets with known positions."""
    registration: Registration = Registration()
    """Settings of the registration."""
    comparison: Comparison = Comparison()
    """Settings of the comparison of visits."""

    @model_validator(mode="after")
    def _names_hold(self) -> Self:
        found = list(_contradictions(self))
        if found:
            raise ValueError("; ".join(found))
        return self

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a site file."""
        path = Path(path)
        text = toml_file.text_of(path, error=SurveyError)
        return cls.from_text(text, name=str(path), folder=path.parent)

    @classmethod
    def from_text(
        cls, text: str, *, name: str = "site", folder: Path | None = None
    ) -> Self:
        """Read a site from the text of its file."""
        site = toml_file.described(
            text, cls, name=name, what="a site", error=SurveyError
        )
        return site._with_paths(folder or Path(), where=name)

    def scans_of(self, epoch: str) -> tuple[SiteScan, ...]:
        """Return the scans of one visit, in the order of the file."""
        return tuple(scan for scan in self.scan if scan.epoch == epoch)

    def _with_paths(self, folder: Path, *, where: str) -> Self:
        """Return the site with absolute file paths; raise if files are missing."""
        lacking = []
        scans = []
        for number, scan in enumerate(self.scan):
            paths: dict[str, Any] = {}
            for field in ("file", "water", "simulated_from"):
                path = getattr(scan, field)
                if path is None:
                    continue
                paths[field] = (folder / path).resolve()
                made_later = field == "file" and scan.simulated_from is not None
                if not paths[field].is_file() and not made_later:
                    lacking.append(
                        f"{where}: scan.{number}.{field}: found {str(path)!r}, but "
                        f"there is no such file in {folder.resolve()}"
                    )
            if scan.trajectory is not None:
                line: dict[str, Any] = {}
                for field in ("file", "mounting"):
                    path = getattr(scan.trajectory, field)
                    if path is None:
                        continue
                    line[field] = (folder / path).resolve()
                    if not line[field].is_file():
                        lacking.append(
                            f"{where}: scan.{number}.trajectory.{field}: found "
                            f"{str(path)!r}, but there is no such file in "
                            f"{folder.resolve()}"
                        )
                paths["trajectory"] = scan.trajectory.model_copy(update=line)
            scans.append(scan.model_copy(update=paths))
        if lacking:
            raise SurveyError("\n".join(lacking))
        return self.model_copy(update={"scan": tuple(scans)})


def _contradictions(site: Site) -> Iterator[str]:
    """Yield a message for each inconsistent name or number in a site file."""
    scans = [item.name for item in site.scan]
    targets = [item.name for item in site.target]
    epochs = [item.name for item in site.epoch]
    for kind, names in (("scan", scans), ("target", targets), ("epoch", epochs)):
        for name, count in Counter(names).items():
            if count > 1:
                yield f"{count} {kind}s are called {name!r}; give each its own name"
    for item in site.scan:
        if item.epoch not in epochs:
            yield f"scan {item.name!r}: epoch {_unknown(item.epoch, epochs, 'epoch')}"
        if item.trajectory is None:
            continue
        if item.start is not None:
            yield (
                f"scan {item.name!r}: has a trajectory and a start pose; remove "
                "[scan.start], because the trajectory states the poses"
            )
        if item.simulated_from is not None:
            yield (
                f"scan {item.name!r}: amulor run does not simulate lines; simulate it "
                "with amulor simulate, which writes the trajectory, and remove "
                "simulated_from"
            )
    points = [item.name for item in site.target if not isinstance(item, ScaleBar)]
    for target in site.target:
        if isinstance(target, ScaleBar):
            for end in target.ends:
                if end not in points:
                    words = _unknown(end, points, "target")
                    yield f"target {target.name!r}: end {words}"
            continue
        places = Counter(place.scan for place in target.places)
        for name, count in places.items():
            if name not in scans:
                yield f"target {target.name!r}: scan {_unknown(name, scans, 'scan')}"
            if count > 1:
                yield (
                    f"target {target.name!r}: scan {name!r} has {count} places; one "
                    "target is in one place of a scan"
                )
    for name, count in Counter(item.target for item in site.control).items():
        if name not in points:
            yield f"control: target {_unknown(name, points, 'target')}"
        if count > 1:
            yield f"control: target {name!r} has {count} positions; state one"
    for control in site.control:
        of = next((item for item in site.target if item.name == control.target), None)
        if of is not None and not isinstance(of, ScaleBar) and of.moved:
            yield (
                f"control: target {control.target!r} is set up anew at each epoch "
                "(moved = true), so that it has no one position"
            )


def _unknown(name: str, allowed: Sequence[str], kind: str) -> str:
    listed = ", ".join(repr(choice) for choice in allowed) or "none"
    return f"{name!r} is no {kind} of this file; there are {listed}"


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of site files, for editors that check while typing."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **Site.model_json_schema(),
        "title": "amulor site",
    }
