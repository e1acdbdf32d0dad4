"""Targets as triangles, and where beams meet them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.errors import SurveyError
from amulor.simulation.scene import Scene, aperture_points, barycentric, triangles
from amulor.survey import Disc, Mesh, Plate, Staircase

FORWARD = np.array([[0.0, 0.0, 1.0]])


def _plate(**changes: object) -> Plate:
    content = {
        "kind": "plate",
        "position": (0.0, 0.0, 1.5),
        "width": 0.4,
        "height": 0.2,
        "reflectance": 0.5,
    }
    return Plate.model_validate(content | changes)


def _area(corners: np.ndarray) -> float:
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(across, axis=1).sum() / 2)


@given(st.floats(-0.19, 0.19), st.floats(-0.09, 0.09), st.floats(-0.8, 0.8))
def test_a_turned_plate_is_met_where_trigonometry_says(
    x: float, y: float, turn: float
) -> None:
    scene = Scene((_plate(rotation=(0.0, turn, 0.0), width=4.0),))
    hits = scene.cast(np.array([[x, y, 0.0]]), FORWARD)
    # Turned about the axis down by a positive angle, right goes backwards.
    assert_allclose(hits.distance, 1.5 - x * np.tan(turn), rtol=1e-12)
    assert_allclose(hits.normal[0], [-np.sin(turn), 0, -np.cos(turn)], atol=1e-12)
    assert hits.target[0] == 0


def test_beside_the_plate_there_is_nothing() -> None:
    hits = Scene((_plate(),)).cast(np.array([[0.21, 0.0, 0.0]]), FORWARD)
    assert hits.target[0] == -1
    assert np.isinf(hits.distance[0])


def test_no_targets_is_open_water() -> None:
    assert Scene(()).cast(np.zeros((3, 3)), np.repeat(FORWARD, 3, 0)).target.max() == -1


def test_the_staircase_rises_towards_the_instrument_from_left_to_right() -> None:
    stairs = Staircase(
        kind="staircase",
        position=(0.0, 0.0, 1.5),
        tread_width=0.02,
        step_heights=(0.04, 0.01),
        height=0.1,
        reflectance=0.1,
    )
    start = np.array([[x, 0.0, 0.0] for x in (-0.02, 0.0, 0.02)])
    hits = Scene((stairs,)).cast(start, np.repeat(FORWARD, 3, axis=0))
    assert_allclose(hits.distance, [1.5, 1.46, 1.45], rtol=1e-12)


def _disc(**changes: object) -> Disc:
    content = {
        "kind": "disc",
        "position": (0.0, 0.0, 1.5),
        "diameter": 0.075,
        "central_hole": 0.033,
        "hole_count": 4,
        "hole_diameter": 0.004,
        "hole_circle": 0.054,
        "reflectance": 0.1,
    }
    return Disc.model_validate(content | changes)


def test_the_disc_has_the_area_of_its_circles() -> None:
    expected = np.pi / 4 * (0.075**2 - 0.033**2 - 4 * 0.004**2)
    # Polygons of 48 corners and more instead of circles: 1 - sinc(2 pi / 48) = 0.3 %.
    assert _area(triangles(_disc())) == pytest.approx(expected, rel=3e-3)


def test_light_passes_through_the_holes_of_the_disc() -> None:
    places = {
        "middle": (0.0, 0.0, False),
        "inside the rim of the central hole": (0.0162, 0.0, False),
        "outside it": (0.0168, 0.0, True),
        "small hole": (0.027, 0.0, False),
        "edge of the small hole": (0.0, 0.0287, False),
        "between small holes": (0.019, 0.019, True),
        "rim": (0.0373, 0.0, True),
        "beyond the rim": (0.0376, 0.0, False),
    }
    start = np.array([[x, y, 0.0] for x, y, _ in places.values()])
    hits = Scene((_disc(),)).cast(start, np.repeat(FORWARD, len(start), 0))
    for name, target, (_, _, solid) in zip(
        places, hits.target, places.values(), strict=True
    ):
        assert (target >= 0) == solid, name


def test_the_bent_disc_lies_on_its_cylinder() -> None:
    start = np.array([[x, 0.02, 0.0] for x in (-0.03, -0.02, 0.02, 0.03)])
    scene = Scene((_disc(curvature_radius=0.1),))
    hits = scene.cast(start, np.repeat(FORWARD, 4, 0))
    sagitta = 0.1 - np.sqrt(0.1**2 - start[:, 0] ** 2)
    # A net of 0.5 mm spans arcs of that length: its own sagitta is below 0.4 um.
    assert_allclose(hits.distance, 1.5 + sagitta, rtol=0, atol=5e-7)


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj", "glb"])
def test_mesh_files_are_placed_and_scaled(tmp_path, suffix: str) -> None:
    path = tmp_path / f"box.{suffix}"
    # GLB is in meters by its format, the others in what the survey says.
    unit = "m" if suffix == "glb" else "mm"
    size = np.array((200, 100, 40)) / (1000 if unit == "m" else 1)
    trimesh.creation.box(size).export(path)
    target = Mesh(
        kind="mesh",
        file=path,
        unit=unit,
        position=(0.0, 0.0, 1.5),
        reflectance=0.3,
    )
    corners = triangles(target)
    assert_allclose(corners.reshape(-1, 3).min(0), [-0.1, -0.05, 1.48], atol=1e-6)
    assert_allclose(corners.reshape(-1, 3).max(0), [0.1, 0.05, 1.52], atol=1e-6)
    hits = Scene((target,)).cast(np.zeros((1, 3)), FORWARD)
    assert_allclose(hits.distance, 1.48, atol=1e-6)


@pytest.mark.parametrize("content", [b"", b"solid nothing\n", b"\x00" * 100, b"v 1 2"])
@pytest.mark.parametrize("suffix", ["stl", "ply", "obj", "glb"])
def test_a_broken_mesh_file_is_named(tmp_path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"wreck.{suffix}"
    path.write_bytes(content)
    target = Mesh(kind="mesh", file=path, position=(0.0, 0.0, 1.0), reflectance=0.3)
    with pytest.raises(SurveyError, match=f"wreck.{suffix}"):
        triangles(target)


def test_a_mesh_without_area_is_named(tmp_path) -> None:
    path = tmp_path / "flat.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n"
        "property float y\nproperty float z\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n"
    )
    target = Mesh(kind="mesh", file=path, position=(0.0, 0.0, 1.0), reflectance=0.3)
    with pytest.raises(SurveyError, match=r"flat.ply: .*none with an area"):
        triangles(target)


def test_a_mesh_too_large_for_metres_needs_its_unit(tmp_path) -> None:
    path = tmp_path / "pot.obj"
    path.write_text("v -200 0 0\nv 200 0 0\nv 0 300 0\nf 1 2 3\n")
    known = {"kind": "mesh", "file": path, "position": (0, 0, 1), "reflectance": 0.3}
    with pytest.raises(SurveyError, match=r"pot.obj: is 400 m across .* state unit"):
        triangles(Mesh(**known))
    for unit, width in (("mm", 0.4), ("m", 400.0)):
        corners = triangles(Mesh(unit=unit, **known))
        assert np.ptp(corners[..., 0]) == pytest.approx(width)


def test_a_glb_file_takes_no_unit() -> None:
    known = {"kind": "mesh", "file": "a.glb", "position": (0, 0, 1), "reflectance": 0.3}
    assert Mesh(**known).unit == "m"
    with pytest.raises(ValueError, match="meters by definition"):
        Mesh(unit="mm", **known)


def test_a_screen_hides_the_echo_from_a_part_of_the_receiver() -> None:
    wall = _plate(width=2.0, height=2.0)
    # A screen at 1 m whose edge stands on the line from the hit to the receiver.
    screen = _plate(position=(0.5 + 0.07 / 3, 0.0, 1.0), width=1.0, height=2.0)
    scene = Scene((wall, screen))
    hits = scene.cast(np.zeros((1, 3)), FORWARD)
    points, weights = aperture_points(np.array([0.07, 0.0, 0.0]), radius=0.02)
    share = scene.visible_fraction(hits, points - [1e-6, 0, 0], weights)
    # Half of the aperture looks past the edge: the centre and two of three pairs.
    assert share[0] == pytest.approx(0.5 + 4 / 12 - 0.0, abs=1 / 6)
    far = scene.visible_fraction(hits, points - [0.2, 0, 0], weights)
    assert far[0] == pytest.approx(1)
    none = scene.visible_fraction(hits, points + np.array([0.2, 0, 0]), weights)
    assert none[0] == 0


def test_the_aperture_points_have_the_moments_of_the_gaussian() -> None:
    radius = 0.02
    points, weights = aperture_points(np.zeros(3), radius=radius)
    assert weights.sum() == pytest.approx(1)
    # exp(-r^2 / R^2) has <x^2> = R^2 / 2 and <x^4> = 3 R^4 / 4.
    assert weights @ points[:, 0] ** 2 == pytest.approx(radius**2 / 2)
    assert weights @ points[:, 0] ** 4 == pytest.approx(3 * radius**4 / 4)
    assert weights @ (points[:, 0] * points[:, 1]) == pytest.approx(0, abs=1e-18)


def test_a_point_is_the_sum_of_corners_by_their_shares() -> None:
    rng = np.random.default_rng(5)
    corners = rng.standard_normal((20, 3, 3))
    share = rng.dirichlet([1, 1, 1], 20)
    point = np.einsum("nc,nck->nk", share, corners)
    assert_allclose(barycentric(corners, point), share, atol=1e-9)
    # Off the plane nothing changes; outside of an edge a share is 0, and the sum is 1.
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert_allclose(barycentric(corners, point + 0.1 * normal), share, atol=1e-9)
    right = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    assert_allclose(
        barycentric(right, np.array([[0.5, -0.2, 0]])), [[7 / 12, 5 / 12, 0]]
    )
