"""Triangles of the targets, hits of rays, and what hides them, on a few numbers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from amulor.errors import SurveyError
from amulor.simulation import scene as scenes
from amulor.simulation.scene import Scene, aperture_points, solid, triangles
from amulor.survey import Disc, Mesh, Plate, Staircase

FORWARD = np.array([0.0, 0.0, 1.0])


def plate(**changes: Any) -> Plate:
    content = {
        "kind": "plate", "position": (0.0, 0.0, 1.5), "width": 0.4, "height": 0.2,
        "reflectance": 0.5,
    }  # fmt: skip
    return Plate.model_validate(content | changes)


def disc(**changes: Any) -> Disc:
    content = {
        "kind": "disc", "position": (0.0, 0.0, 0.0), "diameter": 0.08,
        "central_hole": 0.03, "hole_count": 4, "hole_diameter": 0.006,
        "hole_circle": 0.05, "reflectance": 0.1,
    }  # fmt: skip
    return Disc.model_validate(content | changes)


def corners_of(*rectangle: tuple[float, float, float]) -> set[tuple[float, ...]]:
    return {tuple(np.round(corner, 12) + 0.0) for corner in rectangle}


def corner_set(corners: np.ndarray) -> set[tuple[float, ...]]:
    return corners_of(*corners.reshape(-1, 3))


def area(corners: np.ndarray) -> np.ndarray:
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(np.linalg.norm(across, axis=1) / 2)


def test_a_plate_is_two_triangles_about_its_place() -> None:
    found = triangles(plate(position=(1.0, 2.0, 3.0)))
    assert found.shape == (2, 3, 3)
    assert corner_set(found) == corners_of(
        (0.8, 1.9, 3), (1.2, 1.9, 3), (1.2, 2.1, 3), (0.8, 2.1, 3)
    )
    assert_allclose(area(found), 0.04)


def test_a_target_is_turned_about_right_then_down_then_forward() -> None:
    angles = (0.3, -0.4, 0.7)
    found = triangles(plate(rotation=angles))
    flat = triangles(plate()) - [0, 0, 1.5]
    turn = np.eye(3)
    for axis, angle in enumerate(angles):
        turn = Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix() @ turn
    assert_allclose(found, flat @ turn.T + [0, 0, 1.5], atol=1e-12)


def test_a_staircase_has_treads_and_risers() -> None:
    stairs = Staircase(
        kind="staircase", position=(0.0, 0.0, 0.0), tread_width=0.02,
        step_heights=(0.04, 0.01), height=0.1, reflectance=0.1,
    )  # fmt: skip
    found = triangles(stairs).reshape(-1, 2, 3, 3)
    expected = [
        ((-0.03, 0.0), (-0.01, 0.0)), ((-0.01, -0.04), (0.01, -0.04)),
        ((0.01, -0.05), (0.03, -0.05)), ((-0.01, 0.0), (-0.01, -0.04)),
        ((0.01, -0.04), (0.01, -0.05)),
    ]  # fmt: skip
    assert len(found) == 5
    for rectangle, ((left, near), (right, far)) in zip(found, expected, strict=True):
        assert corner_set(rectangle) == corners_of(
            (left, -0.05, near), (right, -0.05, far), (right, 0.05, far),
            (left, 0.05, near),
        )  # fmt: skip


@pytest.mark.parametrize(
    ("radius", "count"), [(0.001, 48), (0.0076, 48), (0.008, 51), (1.0, 6284)]
)
def test_a_circle_has_48_corners_or_more(radius: float, count: int) -> None:
    found = scenes._circle(2.0, 3.0, radius, 1e-3)
    assert len(found) == count
    assert_allclose(np.hypot(*(found - [2, 3]).T), radius)
    assert_allclose(found[0], [2 + radius, 3])
    assert_allclose(found[1, 1] - 3, radius * math.sin(2 * math.pi / count))


def test_a_disc_is_the_polygon_of_its_rims() -> None:
    found = triangles(disc())

    def polygon(radius: float) -> float:
        corners = max(48, math.ceil(2 * math.pi * radius / (0.08 / 150)))
        return corners / 2 * radius**2 * math.sin(2 * math.pi / corners)

    whole = polygon(0.04) - polygon(0.015) - 4 * polygon(0.003)
    assert area(found).sum() == pytest.approx(whole, rel=2e-4)
    assert not found[..., 2].any()
    place = found.reshape(-1, 3)[:, :2]
    assert np.hypot(*place.T).max() == pytest.approx(0.04)
    assert np.hypot(*place.T).min() == pytest.approx(0.015)
    for turn in range(4):
        middle = 0.025 * np.array(
            [math.cos(turn * math.pi / 2), math.sin(turn * math.pi / 2)]
        )
        assert np.hypot(*(place - middle).T).min() == pytest.approx(0.003, rel=1e-6)
    # No slivers: points of the net keep half a step away from the rims.
    assert area(found).min() > 0.01 * (0.08 / 150) ** 2


def test_a_disc_without_holes_is_whole() -> None:
    found = triangles(disc(central_hole=0.0, hole_count=0))
    corners = 472
    whole = corners / 2 * 0.04**2 * math.sin(2 * math.pi / corners)
    assert area(found).sum() == pytest.approx(whole, rel=1e-6)


def test_a_bent_disc_has_the_sagitta_of_its_radius() -> None:
    found = triangles(disc(curvature_radius=0.1)).reshape(-1, 3)
    assert_allclose(found[:, 2], 0.1 - np.sqrt(0.01 - found[:, 0] ** 2), atol=1e-12)


def test_hits_have_target_point_and_normal() -> None:
    scene = Scene((plate(), plate(position=(1.0, 0.0, 2.0), rotation=(0.0, 0.3, 0.0))))
    start = np.array([[0.1, 0.05, 0.0], [1.1, 0, 0], [5.0, 0, 0], [0.1, 0.05, 3.0]])
    way = np.array([FORWARD, FORWARD, FORWARD, -FORWARD])
    hits = scene.cast(start, way)
    assert hits.target.tolist() == [0, 1, -1, 0]
    far = 2 - 0.1 * math.tan(0.3)
    assert_allclose(hits.distance, [1.5, far, np.inf, 1.5])
    assert_allclose(hits.point[:2], [[0.1, 0.05, 1.5], [1.1, 0, far]])
    assert np.isnan(hits.point[2]).all()
    assert np.isnan(hits.normal[2]).all()
    assert_allclose(hits.normal[0], [0, 0, -1], atol=1e-12)
    assert_allclose(hits.normal[1], [-math.sin(0.3), 0, -math.cos(0.3)], atol=1e-12)
    assert_allclose(hits.normal[3], [0, 0, 1], atol=1e-12)
    assert hits.triangle[2] == -1
    assert set(hits.triangle[[0, 3]]) <= {0, 1}
    assert hits.triangle[1] in (2, 3)
    assert scene.texture(hits).tolist() == [1, 1, 1, 1]


def test_rays_are_cast_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene((plate(),))
    start = np.stack([np.linspace(-0.3, 0.3, 9), np.zeros(9), np.zeros(9)], axis=1)
    way = np.tile(FORWARD, (9, 1))
    whole = scene.cast(start, way)
    assert whole.target.tolist() == [-1, -1, 0, 0, 0, 0, 0, -1, -1]
    monkeypatch.setattr(scenes, "_RAYS_AT_ONCE", 4)
    parts = scene.cast(start, way)
    for name in ("target", "distance", "point", "normal", "triangle"):
        assert_array_equal(getattr(parts, name), getattr(whole, name))


def test_an_aperture_has_its_center_and_six_points() -> None:
    points, weights = aperture_points(np.array([0.1, 0.2, 0.3]), radius=0.02)
    assert_allclose(weights, [1 / 2, *[1 / 12] * 6])
    assert_allclose(points[0], [0.1, 0.2, 0.3])
    away = points[1:] - [0.1, 0.2, 0.3]
    assert_allclose(np.linalg.norm(away, axis=1), math.sqrt(2) * 0.02)
    assert not away[:, 2].any()
    assert_allclose(
        np.arctan2(away[:, 1], away[:, 0])[:3], [0, math.pi / 3, 2 * math.pi / 3]
    )


@pytest.mark.parametrize(
    ("edge", "share"),
    [
        # In units of sqrt(2) radii, points lie at 1, 1/2, -1/2, -1, -1/2, 1/2, and 0.
        (-1.1, 0.0), (-0.9, 1 / 12), (-0.4, 3 / 12), (0.1, 3 / 12 + 1 / 2),
        (0.6, 5 / 12 + 1 / 2), (1.1, 1.0),
    ],
)  # fmt: skip
def test_a_screen_hides_the_points_of_the_aperture_behind_it(
    edge: float, share: float
) -> None:
    radius = 0.02
    place = math.sqrt(2) * radius * edge
    # Close to the receiver, from its edge on to the right.
    screen = plate(position=(place + 1.0, 0.0, 1e-4), width=2.0, height=2.0)
    scene = Scene((plate(width=3.0, height=3.0), screen))
    wall = Scene((plate(width=3.0, height=3.0),)).cast(
        np.array([[0.0, 0, 1e-3]]), FORWARD[None]
    )
    points, weights = aperture_points(np.zeros(3), radius=radius)
    assert scene.visible_fraction(wall, points, weights)[0] == pytest.approx(share)


def test_each_hit_may_have_an_aperture_of_its_own() -> None:
    scene = Scene((plate(width=3.0, height=3.0),))
    start = np.array([[0.0, 0, 0], [0.5, 0, 0], [9.0, 0, 0]])
    hits = scene.cast(start, np.tile(FORWARD, (3, 1)))
    points = np.stack([start, start + 9 * FORWARD])
    # From behind nothing is seen.
    found = scene.visible_fraction(hits, points, np.array([0.7, 0.3]))
    assert_allclose(found, [0.7, 0.7, 0])


def test_triangles_without_an_area_are_left_out() -> None:
    corners = np.array(
        [
            [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [1, 1, 1], [2, 2, 2]],
            [[0, 0, 0], [0, 0, 0], [1, 0, 0]], [[0, 0, 0], [0, 0, 1], [1, 0, 0]],
        ],
        dtype=float,
    )  # fmt: skip
    assert solid(corners).tolist() == [True, False, False, True]


def write(path: Path, size: float) -> Path:
    """Write a square of two triangles and one without an area, with its extent."""
    path.write_text(
        f"v 0 0 0\nv {size} 0 0\nv {size} {size} 0\nv 0 {size} 0\n"
        "f 1 2 3\nf 1 3 4\nf 1 1 2\n"
    )
    return path


@pytest.mark.parametrize(("size", "doubtful"), [(50.0, False), (50.1, True)])
def test_a_mesh_without_a_unit_is_taken_up_to_50_meters(
    tmp_path: Path, size: float, doubtful: bool
) -> None:
    values = {
        "kind": "mesh", "file": write(tmp_path / "wall.obj", size),
        "position": (0, 0, 1), "reflectance": 0.3,
    }  # fmt: skip
    if doubtful:
        with pytest.raises(SurveyError, match=r"wall\.obj: is 50\.1 m across"):
            triangles(Mesh(**values))
    else:
        assert len(triangles(Mesh(**values))) == 2
    stated = triangles(Mesh(unit="cm", **values))
    assert np.ptp(stated[..., 0]) == pytest.approx(size / 100)


def test_a_missing_mesh_is_named(tmp_path: Path) -> None:
    gone = Mesh(
        kind="mesh", file=tmp_path / "gone.ply", position=(0, 0, 1), reflectance=0.3
    )
    with pytest.raises(SurveyError, match=r"gone\.ply: there is no such file; a mesh"):
        scenes.load(gone)
    points = tmp_path / "points.ply"
    points.write_text(
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
        "property float z\nend_header\n0 0 0\n1 1 1\n"
    )
    bare = Mesh(kind="mesh", file=points, position=(0, 0, 1), reflectance=0.3)
    with pytest.raises(SurveyError, match=r"points\.ply: (holds|cannot be read)"):
        scenes.load(bare)
