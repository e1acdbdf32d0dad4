"""Planes that fit the corners of a site, and relief that two scans have in common."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from amulor.site.registration.landmarks import _planes, _score, common_relief
from amulor.site.registration.pose import ScanPose

#: Normals and distances of five planes, the first with most points.
NORMALS = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [0.6, 0, 0.8], [0, 0.6, 0.8]])
COUNTS = (90, 80, 70, 60, 50)
NOISE = 1e-3
FLOOR = (np.zeros(3), np.array([0.0, 0.0, 1.0]))
WALL = (np.zeros(3), np.array([1.0, 0.0, 0.0]))


def on_planes(
    counts: tuple[int, ...], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    parts, normals = [], []
    for number, count in enumerate(counts):
        normal = NORMALS[number]
        across = np.linalg.svd(normal[None])[2][1:]
        inside = rng.uniform(-1, 1, (count, 2)) @ across
        parts.append(inside + (3 + number) * normal)
        normals.append(np.tile(normal, (count, 1)))
    return np.concatenate(parts), np.concatenate(normals)


def test_the_three_planes_with_most_points_are_found() -> None:
    found = _planes(*on_planes(COUNTS, np.random.default_rng(3)), 1e-6)
    assert len(found) == 3
    for (center, normal), true, distance in zip(
        found, NORMALS, (3, 4, 5), strict=False
    ):
        assert abs(abs(normal @ true) - 1) < 1e-9
        assert abs(center @ true - distance) < 1e-9


@pytest.mark.parametrize(
    ("counts", "planes"), [((40, 30), 2), ((40, 29), 1), ((29,), 0)]
)
def test_a_plane_has_thirty_points(counts: tuple[int, ...], planes: int) -> None:
    assert len(_planes(*on_planes(counts, np.random.default_rng(4)), 1e-6)) == planes


def test_points_without_a_normal_belong_to_a_plane_that_others_found() -> None:
    points, normals = on_planes((60,), np.random.default_rng(5))
    normals[::2] = np.nan
    ((center, normal),) = _planes(points, normals, 1e-6)
    assert abs(normal @ NORMALS[0]) == pytest.approx(1)
    # All 60 points, not those with a normal alone.
    np.testing.assert_allclose(center, points.mean(axis=0))
    assert _planes(points, np.full_like(normals, np.nan), 1e-6) == []


def test_a_plane_is_fitted_again_to_the_points_near_it() -> None:
    rng = np.random.default_rng(6)
    points, normals = on_planes((400,), rng)
    points = points + 0.01 * rng.normal(size=(400, 1)) * NORMALS[0]
    # Each normal alone is off by 3 degrees.
    normals = normals + 0.05 * rng.normal(size=(400, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ((_, normal),) = _planes(points, normals, 0.04)
    # The slope of 400 points with 10 mm over 1 m: 1 mrad.
    assert np.arccos(min(abs(normal @ NORMALS[0]), 1.0)) < 4e-3


def relief(*heights: float, count: int = 40) -> np.ndarray:
    """Return points over the floor, far from the wall, at heights in noise."""
    points = np.tile([5.0, 0.0, 0.0], (count, 1))
    points[:, 2] = NOISE * np.resize(heights, count)
    return points


def test_equal_relief_scores_the_root_of_its_points() -> None:
    same = relief(1.0, -1.0)
    assert _score(same, same, [FLOOR], NOISE) == pytest.approx(40**0.5)
    opposite = relief(-1.0, 1.0)
    assert _score(same, opposite, [FLOOR], NOISE) == pytest.approx(-(40**0.5))
    assert _score(same, relief(1, 1, -1, -1), [FLOOR], NOISE) == pytest.approx(0)


def test_an_offset_of_a_whole_plane_is_no_relief() -> None:
    same = relief(1.0, -1.0, 0.5, -0.5)
    raised = same + np.array([0.0, 0.0, 1.5 * NOISE])
    assert _score(same, raised, [FLOOR], NOISE) == pytest.approx(40**0.5)


def test_distances_beyond_four_standard_errors_count_as_four() -> None:
    here, there = (relief(0.0, 1.0, 0.0, -1.0) for _ in range(2))
    here[0, 2], there[0, 2] = 100 * NOISE, -100 * NOISE
    # 20 products of 1 and one of -16, over 20 squares of 1 and one of 16.
    expected = (20 - 16) / (20 + 16) * 40**0.5
    assert _score(here, there, [FLOOR], NOISE) == pytest.approx(expected)


def test_points_nearest_to_different_planes_are_not_compared() -> None:
    same = relief(1.0, -1.0, count=60)
    other = same.copy()
    # Half of the points of the other scan lie on the wall.
    other[::4, 0], other[1::4, 0] = 0.0, 0.0
    other[::4, 2], other[1::4, 2] = 3.0, 3.0
    assert _score(same, other, [FLOOR, WALL], NOISE) == pytest.approx(30**0.5)
    other[2, 0], other[2, 2] = 0.0, 3.0
    # 29 are too few.
    assert _score(same, other, [FLOOR, WALL], NOISE) == 0.0


@pytest.mark.parametrize("count", [29, 30])
def test_a_score_needs_thirty_points_and_a_plane(count: int) -> None:
    same = relief(1.0, -1.0, count=count)
    expected = 30**0.5 if count == 30 else 0.0
    assert _score(same, same, [FLOOR], NOISE) == pytest.approx(expected, rel=1e-3)
    assert _score(same, same, [], NOISE) == 0.0
    flat = relief(0.0, count=count)
    assert _score(flat, flat, [FLOOR], NOISE) == 0.0


def scan_at(
    place: np.ndarray, rng: np.random.Generator, bumps: float
) -> tuple[Any, ScanPose]:
    """Return a scan of a floor with bumps, 3 m below an instrument."""
    pose = ScanPose(np.diag([1.0, -1.0, -1.0]), place)
    x, y = np.meshgrid(np.linspace(-1, 1, 60), np.linspace(-1, 1, 60))
    x, y = x + place[0], y + place[1]
    z = bumps * np.sin(9 * x) * np.cos(8 * y) + NOISE * rng.normal(size=x.shape)
    local = pose.back(np.stack([x, y, z], axis=-1).reshape(-1, 3)).reshape(60, 60, 3)
    distance = np.linalg.norm(local, axis=-1)
    normal = np.broadcast_to([0.0, 0.0, -1.0], local.shape)
    surface = SimpleNamespace(
        usable=np.ones((60, 60), dtype=bool), origin=np.zeros_like(local),
        direction=local / distance[..., None], distance=distance, normal=normal,
        own=np.full((60, 60), NOISE), spacing=2 / 59, motion=None,
        shared=SimpleNamespace(keys=(), shapes=np.zeros((0, 60, 60))),
    )  # fmt: skip
    return surface, pose


def registered(shift: float, bumps: float) -> tuple[float, ...]:
    rng = np.random.default_rng(9)
    scans = {
        "a": scan_at(np.array([0.0, 0.0, 3.0]), rng, bumps),
        "b": scan_at(np.array([0.3, 0.2, 3.0]), rng, bumps),
    }
    poses = {name: pose for name, (_, pose) in scans.items()}
    poses["b"] = poses["b"].changed(np.array([shift, 0, 0, 0, 0, 0]))
    result: Any = SimpleNamespace(
        pairs=({"source": "a", "target": "b"},), poses=poses, errors={}
    )
    surfaces: Any = {name: surface for name, (surface, _) in scans.items()}
    return common_relief(result, surfaces)


def test_two_scans_of_one_relief_have_a_high_score() -> None:
    (score,) = registered(0.0, 3e-3)
    # 1.7 m x 1.8 m of 2 m x 2 m are common: 0.77 of 3600 points, with a correlation of
    # 2.25 of 3.25, as bumps have the variance 2.25 and noise has 1.
    assert score == pytest.approx(2770**0.5 * 2.25 / 3.25, rel=0.2)
    (of_noise,) = registered(0.0, 0.0)
    assert abs(of_noise) < 4
    # Bumps have a length of 0.7 m; half of it aside, heights are opposite.
    (aside,) = registered(0.35, 3e-3)
    assert aside < -10


def test_surfaces_further_apart_than_four_spacings_have_no_score() -> None:
    # A spacing is 34 mm.
    assert registered(5.0, 5e-3) == (0.0,)
