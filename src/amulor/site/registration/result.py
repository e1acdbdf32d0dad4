"""Result of a registration: poses with covariance, written and read as JSON."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.cube import provenance
from amulor.errors import FormatError
from amulor.io.files import atomic_output
from amulor.platform.attitude import cross_matrix
from amulor.site.registration.absolute import ScaleTest
from amulor.site.registration.patterns import PATTERNS, PatternTest, Undetected
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.reliability import Reliability, observation_groups

Floats = NDArray[np.float64]

#: Kind of file of a registration.
KIND = "amulor site registration 1"


@dataclass(frozen=True, kw_only=True)
class Weakness:
    """Pose direction that only the start pose determines."""

    scan: str
    """Name of the scan."""
    shift: tuple[float, float, float]
    """Translation (east, north, up) along the direction, for one standard deviation
    [m]."""
    turn: tuple[float, float, float]
    """Rotation about the axes east, north, up [rad]."""


@dataclass(frozen=True, kw_only=True)
class Unchecked:
    """Scan whose pose no other data check, so it is not merged or compared."""

    scan: str
    """Name of the scan."""
    reason: str
    """Missing check, in words."""

    @property
    def sentence(self) -> str:
        """Message that names the scan, the missing check and the remedies."""
        return (
            f"{self.scan}: {self.reason}; it is left out of clouds, comparisons and "
            "reports; add a target or a scan between, or state trusted = true in its "
            "[[scan]] if its start pose is surveyed"
        )


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """Pose, error or surface that the observations contradict, and its discrepancy."""

    scan: str
    """Name of the scan; empty for an error that several share."""
    error: str
    """Key of the shared error, of a pattern of a scan, or of a control point or scale
    bar; "surface" if a scan fits no other; "sight" if scans look through each other's
    surface; "absent" if a scan looks through points on which others agree; "datum" if
    scans fit the others at another height; empty for a start pose."""
    shift: float
    """Distance of the adjusted position from the start pose, size of a pattern,
    distance of points in front of a surface, or height above other scans [m]."""
    turn: float
    """Angle of the adjusted attitude from the start pose [rad]."""
    stated_shift: float
    """Stated uncertainty of the start position, root sum of squares of three axes; of a
    pattern, the standard uncertainty of its size [m]."""
    stated_turn: float
    """Stated uncertainty of the start attitude, root sum of squares of three axes
    [rad]."""
    score: float
    """Chi-square against the stated uncertainty, over its degrees of freedom [1]."""
    peers: tuple[str, ...] = ()
    """Other scans of the contradicting pairs, for "sight"; scans of the points, for
    "absent"; further scans with the same datum, for "datum"."""
    share: float = 0.0
    """Largest part of points in front of another scan's surface, for "sight"; part of
    the points on which other scans agree, for "absent"; part of points that meet other
    scans at their height, for "datum" [1]."""

    alike: tuple[str, ...] = ()
    """Further patterns that explain the ranges of the scan nearly as well."""

    @property
    def sentence(self) -> str:
        """Message with scan or error, size of the contradiction, and a remedy."""
        if self.error == "surface":
            return (
                f"scan {self.scan!r}: its surface fits none of its neighbors; in each "
                f"pair points scatter at least {np.sqrt(self.score):.1f} times as much "
                "as stated, and more than those of other pairs; look whether its start "
                "pose is right, the instrument moved or drifted, or its delay changed"
            )
        if self.error == "sight":
            return (
                f"scan {self.scan!r}: looks through the surface of "
                f"{', '.join(self.peers)}, and the other way round; up to "
                f"{self.share:.0%} of the points are in front of the other's surface, "
                f"by {self.shift * 1e3:.0f} mm in the median; its pose or its ranges "
                "are wrong, or something moved between the scans; check [scan.start], "
                "delay and water of this scan first, add targets, or leave it out"
            )
        if self.error == "absent":
            return (
                f"scan {self.scan!r}: looks through {self.share:.1%} of the points on "
                f"which other scans ({', '.join(self.peers)}) agree; they are in front "
                f"of its surface by {self.shift * 1e3:.0f} mm in the median; it may be "
                "a scan of another place, its pose may be wrong, or an object moved "
                "between the scans; check the file and [scan.start] of this scan, or "
                "leave it out"
            )
        if self.error == "datum":
            where, change = (
                ("above", "lower") if self.shift > 0 else ("below", "higher")
            )
            return (
                f"scan {', '.join((repr(self.scan), *map(repr, self.peers)))}: "
                f"{abs(self.shift):.2f} m {where} the other scans, stated to "
                f"{self.stated_shift:.3f} m, and tied to them by no surface; "
                f"{self.share:.0%} of the points meet the others if {change} by that; "
                "check the heights and angles of [scan.start] and their datum, or tie "
                "both surfaces by targets"
            )
        if self.error and self.scan:
            shapes = " or ".join(PATTERNS[name] for name in (self.error, *self.alike))
            return (
                f"scan {self.scan!r}: its ranges change {shapes}, by "
                f"{abs(self.shift) * 1e3:.1f} +- {self.stated_shift * 1e3:.1f} mm "
                f"({np.sqrt(self.score):.1f} standard uncertainties) beside those of "
                "its neighbors, which no pose and no stated error explains; look "
                "whether the instrument drifted, or its delay or water changed, state "
                "the drift of this scan, or leave it out"
            )
        if self.error.startswith(("control ", "bar ")):
            return (
                f"{self.error}: the scans put it {self.shift * 1e3:+.1f} mm off, which "
                f"is stated to {self.stated_shift * 1e3:.1f} mm (standardized residual "
                f"{np.sqrt(self.score):.1f}); check its value, the pixel of its "
                "target, and for a length the index of the water"
            )
        if self.error:
            return (
                f"{self.error}: the scans put this error at {np.sqrt(self.score):.1f} "
                "standard uncertainties of what is stated; look whether the "
                "calibration still holds, or state the uncertainty as large as it is"
            )
        return (
            f"scan {self.scan!r} stands {self.shift * 1e3:.0f} mm and "
            f"{self.turn * 1e3:.0f} mrad off its start pose, which is stated to "
            f"{self.stated_shift * 1e3:.1f} mm and {self.stated_turn * 1e3:.1f} mrad "
            f"(chi-square {self.score:.0f} per degree of freedom); check [scan.start] "
            "of this scan and of its neighbors, or state the uncertainty as large as "
            "it is"
        )


@dataclass(frozen=True, kw_only=True)
class Registration:
    """Registration of a site: poses of all scans with their covariance."""

    site: str
    """Name of the site."""
    poses: dict[str, ScanPose]
    """Poses by scan."""
    points: dict[str, Floats]
    """Positions of targets in the site, by name [m]."""
    errors: dict[str, float]
    """Estimated shared errors by key, in units of their standard deviation [1]."""
    places: dict[str, tuple[int, int]]
    """Index range, end excluded, of each unknown in the covariance, by "pose NAME",
    "point NAME" and "error KEY"."""
    covariance: Floats
    """Joint covariance of all unknowns."""
    pairs: tuple[dict[str, Any], ...]
    """Compared pairs of scans, with the statistics of each comparison."""
    disagreements: tuple[dict[str, Any], ...]
    """Pairs of scans that contradict all other observations."""
    weaknesses: tuple[Weakness, ...]
    """Directions of poses that only the start poses constrain."""
    contradictions: tuple[Contradiction, ...]
    """Contradicted start poses, shared errors, ties and patterns; if there are any, the
    poses are not valid."""
    remarks: tuple[str, ...]
    """Visits and scans that nothing connects to the others."""
    unchecked: tuple[Unchecked, ...] = ()
    """Scans whose poses no other data check."""
    settled: bool
    """Whether the fit converged: its last step was small."""
    fixed: str = ""
    """Scan whose axes define the axes of the site, if neither start poses nor control
    points define them."""
    patterns: tuple[PatternTest, ...] = ()
    """Tests for systematic errors of each scan over rows, columns, range and angle."""
    undetected: dict[str, Undetected] = field(default_factory=dict)
    """Largest change of each pose by a systematic error of a scan that no test detects;
    it is not in the covariance."""
    reliability: tuple[Reliability, ...] = ()
    """Redundancy and minimal detectable error of start poses, targets, control points
    and scale bars."""
    scale: tuple[ScaleTest, ...] = ()
    """Scale of the site and group index of its water, tested by each scale bar."""

    def covariance_of(self, *names: str) -> Floats:
        """Return the joint covariance of named unknowns; zero for fixed unknowns."""
        width = {"pose": 6, "point": 3, "error": 1}
        at = np.concatenate(
            [
                np.arange(*self.places[name])
                if name in self.places
                else np.full(width[name.partition(" ")[0]], -1)
                for name in names
            ]
        )
        free = at >= 0
        spread = np.zeros((len(at), len(at)))
        spread[np.ix_(free, free)] = self.covariance[np.ix_(at[free], at[free])]
        return spread


def relative_covariance(result: Registration, name: str, reference: str) -> Floats:
    """Return the covariance of a pose relative to that of another scan."""
    both = result.covariance_of(f"pose {name}", f"pose {reference}")
    arm = result.poses[name].position - result.poses[reference].position
    carried = np.eye(6)
    carried[:3, 3:] = -cross_matrix(arm)
    rows = np.hstack([np.eye(6), -carried])
    return np.asarray(rows @ both @ rows.T)


def plan_ellipse(covariance: Floats) -> dict[str, float]:
    """Return the standard error ellipse of a position in plan: semi-axes and azimuth.

    The azimuth is that of the long axis, clockwise from north.
    """
    values, axes = np.linalg.eigh(covariance[:2, :2])
    east, north = axes[:, 1]
    return {
        "long_m": float(np.sqrt(max(values[1], 0.0))),
        "short_m": float(np.sqrt(max(values[0], 0.0))),
        "azimuth_rad": float(np.arctan2(east, north) % np.pi),
    }


def profile_ellipse(covariance: Floats) -> dict[str, float]:
    """Return the standard error ellipse of a position in the plane of east and up.

    The elevation is that of the long axis, from east upwards.
    """
    values, axes = np.linalg.eigh(covariance[np.ix_((0, 2), (0, 2))])
    east, up = axes[:, 1]
    return {
        "long_m": float(np.sqrt(max(values[1], 0.0))),
        "short_m": float(np.sqrt(max(values[0], 0.0))),
        "elevation_rad": float(np.arctan2(up, east) % np.pi),
    }


def write_registration(
    result: Registration, path: str | Path, *, overwrite: bool = False
) -> None:
    """Write the result of a registration as JSON."""
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
                "plan_ellipse": plan_ellipse(result.covariance_of(f"pose {name}")),
                "profile_ellipse": profile_ellipse(
                    result.covariance_of(f"pose {name}")
                ),
            }
            for name, pose in result.poses.items()
        },
        "targets": {name: point.tolist() for name, point in result.points.items()},
        "shared_errors": result.errors,
        "pairs": list(result.pairs),
        "disagreements": list(result.disagreements),
        "weaknesses": [vars(item) for item in result.weaknesses],
        "remarks": list(result.remarks),
        "unchecked": [vars(item) for item in result.unchecked],
        "good": not result.contradictions,
        "contradictions": [vars(item) for item in result.contradictions],
        "undetected": {name: vars(item) for name, item in result.undetected.items()},
        "patterns": [vars(test) for test in result.patterns],
        "reliability": [vars(line) for line in result.reliability],
        "network": [vars(group) for group in observation_groups(result.reliability)],
        "scale": [vars(test) for test in result.scale],
        "places": result.places,
        "covariance": result.covariance.tolist(),
    }
    content["digest"] = _digest_of(content)
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        temporary.write_text(json.dumps(content, indent=1, allow_nan=False))


def read_registration(path: str | Path) -> Registration:
    """Read the result of a registration from JSON."""
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
    if content.pop("digest", None) != _digest_of(content):
        raise FormatError(
            f"{path} is damaged or was edited: its numbers are not those that amulor "
            "wrote; run amulor site register again"
        )
    try:
        return _registration_of(content)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise FormatError(
            f"{path}: is no registration of this version ({error}); run amulor site "
            "register again"
        ) from None


def _digest_of(content: dict[str, Any]) -> str:
    """Return a digest of a file's content; order and white space have no effect."""
    return provenance.digest(json.dumps(content, sort_keys=True).encode())


def _registration_of(content: dict[str, Any]) -> Registration:
    poses = {}
    for name, item in content["poses"].items():
        matrix = np.array(item["matrix"], dtype=float)
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
        contradictions=tuple(
            Contradiction(
                **{
                    **item,
                    "peers": tuple(item.get("peers", ())),
                    "alike": tuple(item.get("alike", ())),
                }
            )
            for item in content["contradictions"]
        ),
        remarks=tuple(content["remarks"]),
        unchecked=tuple(Unchecked(**item) for item in content.get("unchecked", ())),
        settled=bool(content["settled"]),
        fixed=content["fixed"],
        undetected={
            name: Undetected(**item)
            for name, item in content.get("undetected", {}).items()
        },
        patterns=tuple(PatternTest(**test) for test in content["patterns"]),
        reliability=tuple(Reliability(**line) for line in content["reliability"]),
        scale=tuple(ScaleTest(**test) for test in content.get("scale", ())),
    )
