"""Input of a registration: water of scans, start poses, control points, centers."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.site import Site
from amulor.site.registration import register
from amulor.site.registration.network import Ties
from amulor.site.registration.pose import ScanPose


@pytest.mark.parametrize(
    ("text", "water"),
    [
        ("", None),
        ("[scan]\nrows = 1\n", None),
        ("[water]\nabsorption = 1", "[water]\nabsorption = 1"),
        ("[scan]\nrows = 1\n[water]\na = 1\n[targets]\n", "[water]\na = 1"),
        ("[water]\n[scan]\n", "[water]"),
    ],
)
def test_equal_water_has_an_equal_digest(text: str, water: str | None) -> None:
    image = xr.Dataset(attrs={"survey": text})
    expected = ""
    if water is not None:
        expected = "water " + sha256(water.encode()).hexdigest()[:8]
    assert register._water_in(image) == expected
    assert register._water_in(xr.Dataset()) == ""


START = {
    "position": (1.0, 2.0, 3.0), "heading": 0.5, "position_uncertainty": 0.1,
    "heading_uncertainty": 0.02, "level_uncertainty": 0.01,
}  # fmt: skip
PLACES = [{"scan": "a", "row": 8, "column": 5}, {"scan": "b", "row": 3, "column": 11}]
TARGETS = [
    {"kind": "sphere", "name": "S", "radius": 0.1, "radius_uncertainty": 0.0,
     "places": PLACES},
    {"kind": "point", "name": "P", "picking_uncertainty": 0.01, "places": PLACES[:1],
     "moved": True},
    {"kind": "scale-bar", "name": "B", "ends": ("S", "P"), "length": 1.5,
     "length_uncertainty": 0.001},
]  # fmt: skip


def _site(*, started: bool = True, controlled: int = 0) -> Site:
    first: dict[str, Any] = {"name": "a", "file": "a.nc", "epoch": "one"}
    points = [
        {"kind": "point", "name": f"Q{k}", "picking_uncertainty": 0.01,
         "places": PLACES[:1]}
        for k in range(controlled)
    ]  # fmt: skip
    return Site.model_validate(
        {
            "name": "s", "epoch": [{"name": "one"}, {"name": "two"}],
            "scan": [
                {**first, "start": START} if started else first,
                {"name": "b", "file": "b.nc", "epoch": "two", "drift": 0.004},
            ],
            "target": [*TARGETS, *points],
            "control": [
                {"target": f"Q{k}", "position": (k, 0.0, 1.0),
                 "uncertainty": 0.02 if k else (0.01, 0.02, 0.03)}
                for k in range(controlled)
            ],
            "registration": {"overlap": 0.2, "voxel": 0.05, "window": 5,
                             "drift": 0.002},
        }
    )  # fmt: skip


def _registered(
    monkeypatch: pytest.MonkeyPatch, site: Site, motion: Any = None
) -> tuple[Ties, dict[str, Any]]:
    """Observations and options with which a site is aligned."""
    surfaces: Any = {
        "a": SimpleNamespace(motion=None),
        "b": SimpleNamespace(motion=motion),
    }
    taken: dict[str, Any] = {}

    def align(surfaces: Any, ties: Ties, **options: Any) -> str:
        taken.update(ties=ties, options=options)
        return "alignment"

    def guessed(site: Any, *given: Any) -> dict[str, ScanPose]:
        taken["fixed"] = given[3]
        return {}

    monkeypatch.setattr(register, "_centres", lambda *_: (("centre",), surfaces))
    monkeypatch.setattr(register, "_guessed", guessed)
    monkeypatch.setattr(register, "align", align)
    monkeypatch.setattr(register, "_result", lambda *given: given)
    result: Any = register._registered(site, surfaces, {}, ("remark",))
    assert result == (site, "alignment", taken["ties"], ("remark",), surfaces)
    assert taken["ties"].fixed == taken["fixed"]
    return taken["ties"], taken["options"]


def test_start_poses_bars_and_options_reach_the_adjustment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ties, options = _registered(monkeypatch, _site())
    assert list(ties.start) == ["a"]
    assert_allclose(ties.start["a"].pose.position, [1.0, 2.0, 3.0])
    assert_allclose(np.diag(ties.start["a"].covariance)[:3], 0.01)
    (bar,) = ties.bars
    assert (bar.ends, bar.length, bar.sigma) == (("S", "P"), 1.5, 0.001)
    assert ties.centres == ("centre",)
    assert ties.fixed is None
    assert ties.control == {}
    assert options == {
        "overlap": 0.2, "voxel": 0.05, "guess": {}, "visits": {"a": "one", "b": "two"},
    }  # fmt: skip


def test_a_line_starts_with_the_pose_of_its_trajectory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pose = ScanPose(np.eye(3), np.array([9.0, 8.0, 7.0]))
    motion = SimpleNamespace(start=pose, covariance=4.0 * np.eye(6))
    ties, _ = _registered(monkeypatch, _site(), motion)
    assert list(ties.start) == ["a", "b"]
    assert ties.start["b"].pose is pose
    assert_array_equal(ties.start["b"].covariance, 4.0 * np.eye(6))


@pytest.mark.parametrize(("controlled", "fixed"), [(0, "a"), (2, "a"), (3, None)])
def test_three_control_points_define_the_frame_without_start_poses(
    monkeypatch: pytest.MonkeyPatch, controlled: int, fixed: str | None
) -> None:
    ties, _ = _registered(monkeypatch, _site(started=False, controlled=controlled))
    assert ties.fixed == fixed
    assert len(ties.control) == controlled
    if controlled:
        first, last = ties.control["Q0"], ties.control[f"Q{controlled - 1}"]
        assert_array_equal(first.position, [0.0, 0.0, 1.0])
        assert_array_equal(first.sigma, [0.01, 0.02, 0.03])
        assert_array_equal(last.sigma, [0.02, 0.02, 0.02])


@dataclass(frozen=True)
class _Surface:
    """Smooth pixels of a scan."""

    smooth: np.ndarray


@dataclass(frozen=True)
class _Centre:
    """Center that a stub has found."""

    target: str
    place: tuple[int, int]


def test_pixels_of_targets_are_no_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    def centre_of(
        target: Any, surface: Any, image: Any, row: int, column: int
    ) -> tuple[_Centre, np.ndarray]:
        pixels = np.zeros((10, 12), dtype=bool)
        pixels[row, column] = True
        return _Centre(target.name, (row, column)), pixels

    monkeypatch.setattr(register, "centre_of", centre_of)
    monkeypatch.setattr(
        register, "block_of", lambda image, row, column: (row - 1, column - 2)
    )
    full = np.ones((10, 12), dtype=bool)
    surfaces: Any = {"a": _Surface(full), "b": _Surface(full)}
    images: Any = {"a": None, "b": None}
    centres, remaining = register._centres(_site(), surfaces, images)
    assert [(item.target, item.place) for item in centres] == [  # type: ignore
        ("S", (7, 3)), ("S", (2, 9)), ("P in one", (7, 3)),
    ]  # fmt: skip
    assert np.argwhere(~remaining["a"].smooth).tolist() == [[7, 3]]
    assert np.argwhere(~remaining["b"].smooth).tolist() == [[2, 9]]
    assert surfaces["a"].smooth.all()


@pytest.mark.parametrize(
    ("scan", "water", "drift"),
    [
        ({"water": None, "drift": None}, "water", 0.002),
        ({"water": "w.toml", "drift": 0.005}, "w.toml", 0.005),
    ],
)
def test_errors_of_a_surface_are_shared_by_instrument_and_water(
    monkeypatch: pytest.MonkeyPatch,
    scan: dict[str, Any],
    water: str,
    drift: float,
) -> None:
    taken: dict[str, Any] = {}
    motion = SimpleNamespace(course="course")
    for moving in (None, motion):
        monkeypatch.setattr(register, "motion_of", lambda *_, m=moving: m)
        monkeypatch.setattr(
            register, "shared_errors", lambda image, **options: taken.update(options)
        )
        monkeypatch.setattr(
            register, "scan_surface", lambda image, **options: (image, options)
        )
        monkeypatch.setattr(register, "straightened", lambda image, _: "straight")
        described: Any = SimpleNamespace(
            name="a", epoch="one", instrument="lidar", **scan
        )
        image = xr.Dataset()
        made: Any = register.surface_of(_site(), described, image)
        assert taken == {
            "scan": "a", "instrument": "lidar, one", "water": f"{water}, one",
            "drift": drift, "course": None if moving is None else "course",
        }  # fmt: skip
        assert (made[0] is image) is (moving is None)
        assert made[1] == {"name": "a", "shared": None, "window": 5, "motion": moving}
