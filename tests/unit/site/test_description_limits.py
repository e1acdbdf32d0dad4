"""Limits and defaults of the values of a site file, at both sides."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pydantic import ValidationError

from amulor.site import description

START = {
    "position": (0.0, 0.0, 0.0), "heading": 0.0, "position_uncertainty": 0.1,
    "heading_uncertainty": 0.1, "level_uncertainty": 0.1,
}  # fmt: skip
PLACE = {"scan": "a", "row": 0, "column": 0}
SCAN = {"name": "a", "file": "a.nc", "epoch": "one"}
TRAJECTORY = {"file": "a.csv"}
SPHERE = {"kind": "sphere", "name": "S", "radius": 0.1, "radius_uncertainty": 0.0,
          "places": [PLACE]}  # fmt: skip
DISC = {"kind": "disc", "name": "D", "diameter": 0.1, "diameter_uncertainty": 0.0,
        "places": [PLACE]}  # fmt: skip
BOARD = {"kind": "checkerboard", "name": "C", "width": 0.1, "places": [PLACE]}
POINT = {"kind": "point", "name": "P", "picking_uncertainty": 0.1, "places": [PLACE]}
BAR = {"kind": "scale-bar", "name": "B", "ends": ("S", "D"), "length": 1.0,
       "length_uncertainty": 0.1}  # fmt: skip
CONTROL = {"target": "S", "position": (0.0, 0.0, 0.0), "uncertainty": 0.1}
PROCESSING = {"method": "open-water"}
TINY = 1e-9


@pytest.mark.parametrize(
    ("model", "values", "field", "allowed", "refused"),
    [
        ("StartPose", START, "heading", (-2 * math.pi, 2 * math.pi), (-6.3, 6.3)),
        ("StartPose", START, "pitch", (-math.pi / 2, math.pi / 2), (-1.58, 1.58)),
        ("StartPose", START, "roll", (-math.pi, math.pi), (-3.15, 3.15)),
        ("StartPose", START, "position_uncertainty", (TINY, 1000.0), (0.0, 1000.1)),
        ("StartPose", START, "heading_uncertainty", (TINY, 1.0), (0.0, 1.01)),
        ("StartPose", START, "level_uncertainty", (TINY, 1.0), (0.0, 1.01)),
        ("SiteTrajectory", TRAJECTORY, "position_drift", (0.0, 10.0), (-TINY, 10.1)),
        ("SiteTrajectory", TRAJECTORY, "attitude_drift", (0.0, 0.5), (-TINY, 0.51)),
        ("SiteScan", SCAN, "drift", (0.0,), (-TINY,)),
        ("SiteScan", SCAN, "seed", (0,), (-1,)),
        ("Place", PLACE, "row", (0,), (-1,)),
        ("Place", PLACE, "column", (0,), (-1,)),
        ("SphereTarget", SPHERE, "radius", (TINY, 10.0), (0.0, 10.1)),
        ("SphereTarget", SPHERE, "radius_uncertainty", (0.0, 1.0), (-TINY, 1.01)),
        ("SphereTarget", SPHERE, "places", ([PLACE],), ([],)),
        ("DiscTarget", DISC, "diameter", (TINY, 10.0), (0.0, 10.1)),
        ("DiscTarget", DISC, "diameter_uncertainty", (0.0, 1.0), (-TINY, 1.01)),
        ("CheckerboardTarget", BOARD, "width", (TINY, 10.0), (0.0, 10.1)),
        ("PointTarget", POINT, "picking_uncertainty", (TINY, 1000.0), (0.0, 1000.1)),
        ("ScaleBar", BAR, "length", (TINY, 1000.0), (0.0, 1000.1)),
        ("ScaleBar", BAR, "length_uncertainty", (TINY,), (0.0,)),
        ("ScaleBar", BAR, "ends", (("S", "D"),), (("S", "S"),)),
        ("Control", CONTROL, "uncertainty", (TINY, (TINY, 1.0, 2.0)), (0.0, (0, 1, 1))),
        ("Registration", {}, "overlap", (TINY, 1.0), (0.0, 1.01)),
        ("Registration", {}, "voxel", (TINY, 1.0), (0.0, 1.01)),
        ("Registration", {}, "window", (3, 7, 21), (1, 2, 8, 22, 23)),
        ("Registration", {}, "drift", (0.0,), (-TINY,)),
        ("Comparison", {}, "spacing", (TINY, 10.0), (0.0, 10.1)),
        ("Comparison", {}, "radius", (TINY, 10.0), (0.0, 10.1)),
        ("Comparison", {}, "reach", (TINY, 10.0), (0.0, 10.1)),
        ("Comparison", {}, "false_alarms", (TINY, 0.4999), (0.0, 0.5)),
        ("Processing", PROCESSING, "method", ("open-water",), ("no such method",)),
    ],
)
def test_values_have_limits(
    model: str,
    values: dict[str, Any],
    field: str,
    allowed: tuple[Any, ...],
    refused: tuple[Any, ...],
) -> None:
    kind = getattr(description, model)
    for value in allowed:
        assert kind(**{**values, field: value}) is not None
    for value in refused:
        with pytest.raises(ValidationError):
            kind(**{**values, field: value})


@pytest.mark.parametrize(
    ("model", "values", "defaults"),
    [
        ("SiteFrame", {}, {"crs": "", "crs_offset": (0.0, 0.0, 0.0)}),
        ("Epoch", {"name": "one"}, {"date": None}),
        ("StartPose", START, {"pitch": 0.0, "roll": 0.0}),
        ("Processing", PROCESSING,
         {"polarization": None, "nearest": None, "farthest": None}),
        ("SiteTrajectory", TRAJECTORY,
         {"mounting": None, "position_drift": None, "attitude_drift": None}),
        ("SiteScan", SCAN,
         {"start": None, "trajectory": None, "trusted": False, "water": None,
          "instrument": "instrument", "drift": None, "processing": None,
          "simulated_from": None, "seed": 1}),
        ("PointTarget", POINT, {"moved": False}),
        ("Registration", {},
         {"overlap": 0.1, "voxel": None, "window": 7, "drift": 0.0}),
        ("Comparison", {},
         {"spacing": None, "radius": None, "reach": 0.2, "false_alarms": 0.05}),
        ("Site", {"name": "s", "epoch": [{"name": "one"}], "scan": [SCAN]},
         {"target": (), "control": (), "frame": description.SiteFrame(),
          "registration": description.Registration(),
          "comparison": description.Comparison()}),
    ],
)  # fmt: skip
def test_values_that_are_not_stated_have_defaults(
    model: str, values: dict[str, Any], defaults: dict[str, Any]
) -> None:
    made = getattr(description, model)(**values)
    assert {name: getattr(made, name) for name in defaults} == defaults


@pytest.mark.parametrize(
    ("near", "far", "words"),
    [
        (1.0, None, "nearest and farthest must be stated together"),
        (None, 1.0, "nearest and farthest must be stated together"),
        (1.0, 1.0, "nearest (1 m) must be below farthest (1 m)"),
        (2.0, 1.5, "nearest (2 m) must be below farthest (1.5 m)"),
        (0.0, 1.5, ""),
        (None, None, ""),
    ],
)
def test_an_interval_has_two_ends(
    near: float | None, far: float | None, words: str
) -> None:
    values = {**PROCESSING, "nearest": near, "farthest": far}
    if not words:
        assert description.Processing(**values).farthest == far
        return
    with pytest.raises(ValidationError) as caught:
        description.Processing(**values)
    assert words in str(caught.value)


def _site(**changes: Any) -> dict[str, Any]:
    return {
        "name": "s", "epoch": [{"name": "one"}], "scan": [SCAN], "target": [SPHERE],
        **changes,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"scan": [SCAN, SCAN]}, "2 scans are called 'a'; give each its own name"),
        (
            {"target": [SPHERE, SPHERE]},
            "2 targets are called 'S'; give each its own name",
        ),
        (
            {"epoch": [{"name": "one"}] * 2},
            "2 epochs are called 'one'; give each its own name",
        ),
        (
            {"scan": [{**SCAN, "epoch": "two"}]},
            "scan 'a': epoch 'two' is no epoch of this file; there are 'one'",
        ),
        (
            {"scan": [{**SCAN, "trajectory": TRAJECTORY, "start": START}]},
            "scan 'a': has a trajectory and a start pose; remove [scan.start], because "
            "the trajectory states the poses",
        ),
        (
            {"scan": [{**SCAN, "trajectory": TRAJECTORY, "simulated_from": "a.toml"}]},
            "scan 'a': amulor run does not simulate lines; simulate it with amulor "
            "simulate, which writes the trajectory, and remove simulated_from",
        ),
        (
            {"target": [SPHERE, BAR]},
            "target 'B': end 'D' is no target of this file; there are 'S'",
        ),
        (
            {"target": [{**SPHERE, "places": [{**PLACE, "scan": "b"}]}]},
            "target 'S': scan 'b' is no scan of this file; there are 'a'",
        ),
        (
            {"target": [{**SPHERE, "places": [PLACE, PLACE]}]},
            "target 'S': scan 'a' has 2 places; one target is in one place of a scan",
        ),
        (
            {"target": [], "control": [CONTROL]},
            "control: target 'S' is no target of this file; there are none",
        ),
        (
            {"control": [CONTROL, CONTROL]},
            "control: target 'S' has 2 positions; state one",
        ),
        (
            {"target": [{**SPHERE, "moved": True}], "control": [CONTROL]},
            "control: target 'S' is set up anew at each epoch (moved = true), so that "
            "it has no one position",
        ),
    ],
)
def test_names_of_a_site_agree(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError) as caught:
        description.Site.model_validate(_site(**changes))
    message = caught.value.errors()[0]["msg"]
    assert message == f"Value error, {words}"


def test_a_scan_may_have_an_unknown_start() -> None:
    scan = description.SiteScan.model_validate({**SCAN, "start": "unknown"})
    assert scan.start is None
    with pytest.raises(ValidationError):
        description.SiteScan.model_validate({**SCAN, "start": "somewhere"})
    assert description.StartPose(**START).as_pose().heading == 0.0
    site = description.Site.model_validate(
        _site(scan=[SCAN, {**SCAN, "name": "b", "epoch": "two"}],
              epoch=[{"name": "one"}, {"name": "two"}])
    )  # fmt: skip
    assert [scan.name for scan in site.scans_of("two")] == ["b"]
    assert description.json_schema()["title"] == "amulor site"
