"""Distances, insides and rims of triangle meshes, against plain geometry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from amulor.transport import MeshTarget
from amulor.transport.mesh import _crossings, _to_segments, distance_to_triangles
from amulor.transport.ray_caster import RayCaster, hierarchy

#: Half sizes of a box, and its twelve triangles with vertices of their own.
HALF = np.array([1.0, 0.5, 2.0])
SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
SIDES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 5, 1], [0, 4, 5],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip
#: A triangle of 4 m by 3 m at the height 1 m.
FLAT = np.array([[[0.0, 0, 1], [4, 0, 1], [0, 3, 1]]])


def box(half=HALF, centre=(0, 0, 0), sides=SIDES):
    return (SIGNS * half + np.asarray(centre))[sides]


def target(*parts, **others):
    corner = np.concatenate(parts)
    values = {"reflectance": 0.5} | others
    return MeshTarget(
        vertices=corner.reshape(-1, 3), faces=np.arange(3 * len(corner)).reshape(-1, 3),
        **values,
    )  # fmt: skip


PLACE = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array)


@given(PLACE)
def test_a_point_in_a_box_is_as_deep_as_its_nearest_side(point):
    to_sides = HALF - np.abs(point)
    expected = max(0.0, to_sides.min())
    found = target(box()).depth_inside(point)
    assert found == pytest.approx(expected, abs=1e-9)


@given(PLACE)
def test_a_point_beside_a_box_has_the_distance_of_the_box(point):
    beyond = np.abs(point) - HALF
    outside = np.linalg.norm(np.maximum(beyond, 0))
    expected = outside if outside > 0 else -beyond.max()
    assert distance_to_triangles(point, box()) == pytest.approx(expected, abs=1e-9)


def test_a_point_is_in_the_closed_parts_of_a_mesh_only():
    far = box(np.full(3, 1.0), (5, 0, 0))
    opened = box(np.full(3, 1.0), (-5, 0, 0), SIDES[2:])
    both = target(box(), opened, far)
    assert both.depth_inside(np.array([5.0, 0, 0.25])) == pytest.approx(0.75)
    assert both.depth_inside(np.array([0.0, 0, 0])) == pytest.approx(0.5)
    assert both.depth_inside(np.array([-5.0, 0, 0])) == 0
    assert both.depth_inside(np.array([2.5, 0, 0])) == 0
    parts = both._closed_parts
    assert [len(part) for part in parts] == [12, 12]
    assert_allclose(parts[0], box())
    assert_allclose(parts[1], far)
    assert target(FLAT).depth_inside(np.array([1.0, 1, 1])) == 0


def test_in_two_parts_the_greater_depth_counts():
    small = box(np.full(3, 0.3), (0.1, 0, 0))
    for parts in ((small, box()), (box(), small)):
        assert target(*parts).depth_inside(np.zeros(3)) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("start", "way", "count"),
    [
        ((1, 1, 0), (0, 0, 1), 1),
        ((1, 1, 2), (0, 0, -1), 1),
        ((1, 1, 0), (0, 0, -1), 0),  # behind
        ((1, 1, 2), (0, 0, 1), 0),
        ((-0.1, 1, 0), (0, 0, 1), 0),  # beside each edge
        ((1, -0.1, 0), (0, 0, 1), 0),
        ((2.1, 1.5, 0), (0, 0, 1), 0),
        ((1.9, 1.5, 0), (0, 0, 1), 1),
        ((3.9, 0.01, 0), (0, 0, 1), 1),
        ((0.01, 2.9, 0), (0, 0, 1), 1),
        ((-2, 1, 1), (1, 0, 0), 0),  # along it
        ((0, 1, 0), (1, 0, 1), 1),
        ((1, 0, 0), (0, 1, 1), 1),
        ((4, 4, 0), (-3, -3, 1), 1),
    ],
)
def test_a_ray_crosses_a_triangle_within_its_three_edges(start, way, count):
    way = np.array(way, dtype=float)
    assert _crossings(FLAT, np.array(start, dtype=float), way) == count
    # The other side of it, and an edge as the first one, are the same.
    for corners in (FLAT[:, ::-1], FLAT[:, [1, 2, 0]], np.concatenate([FLAT, FLAT])):
        found = _crossings(corners, np.array(start, dtype=float), 2 * way)
        assert found == count * len(corners)


def test_a_segment_is_nearest_at_an_end_or_between():
    start = np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 0], [2, 0, 0]])
    end = np.array([[10.0, 0, 0], [2, 0, 0], [-4, 0, 0], [2, 0, 0]])
    found = _to_segments(np.array([5.0, 4, 3]), start, end)
    root = np.sqrt
    assert_allclose(found, [5, root(9 + 25), root(25 + 25), root(9 + 25)])


def test_the_nearest_of_several_triangles_counts():
    higher = FLAT + np.array([0, 0, 5.0])
    both = np.concatenate([higher, FLAT])
    assert distance_to_triangles(np.array([1.0, 1, 3]), both) == 2
    assert distance_to_triangles(np.array([1.0, 1, 5]), both) == 1
    assert distance_to_triangles(np.array([-3.0, 1, 5]), both) == pytest.approx(10**0.5)


def rim(corners, radius=1.0):
    """Return how far a triangle reaches into a disc about the origin, in any pose."""
    corners = np.array(corners, dtype=float)
    found = []
    for seed in range(3):
        turn = Rotation.random(rng=seed).as_matrix() if seed else np.eye(3)
        shift = np.array([0.3, -0.7, 1.1]) * seed
        moved = MeshTarget(
            vertices=corners @ turn.T + shift, faces=[[0, 1, 2]], reflectance=0.5
        )
        if seed == 0 or not np.any(corners[:, 2] == 0):
            found.append(moved.reach_into(shift, turn[:, 2], radius))
    assert_allclose(found, found[0], atol=1e-12)
    return found[0]


@pytest.mark.parametrize(
    ("corners", "reach"),
    [
        # Upright, 0.6 m beside the axis.
        ([[0.6, -1, -1], [0.6, 1, -1], [0.6, 0, 2]], 0.4),
        ([[0.6, -1, 1], [0.6, 1, 1], [0.6, 0, -2]], 0.4),
        # Its cut through the plane is from y = 0.8 to 1.6.
        ([[0, 0, 1], [0, 2.4, 1], [0, 1.6, -1]], 0.2),
        # Above the plane, and below.
        ([[0.1, 0, 1], [0.2, 1, 1], [0.3, 0, 2]], 0.0),
        ([[0.1, 0, -1], [0.2, 1, -1], [0.3, 0, -2]], 0.0),
        # One corner in the plane, the others on both sides.
        ([[0.5, 0, 0], [3.5, 0, 1], [3.5, 0.5, -1]], 0.5),
        ([[3.5, 0.5, -1], [0.5, 0, 0], [3.5, 0, 1]], 0.5),
        # In the plane: in the disc with all of it, and with an edge.
        ([[-2, -1, 0], [2, -1, 0], [0, 3, 0]], 1.0),
        ([[0.7, -1, 0], [0.7, 1, 0], [4, 0, 0]], 0.3),
        # Beside the disc.
        ([[1.1, -1, -1], [1.1, 1, -1], [1.1, 0, 2]], 0.0),
    ],
)
def test_a_triangle_reaches_into_a_disc_with_its_cut_through_the_plane(corners, reach):
    assert rim(corners) == pytest.approx(reach, abs=1e-12)


def test_of_several_triangles_the_one_that_reaches_furthest_counts():
    upright = np.array([[0.6, -1, -1], [0.6, 1, -1], [0.6, 0, 2]])
    level = np.array([[0.7, -1, 0], [0.7, 1, 0], [4, 0, 0]])
    nearer = np.array([[-0.2, -1, 0], [-0.2, 1, 0], [-4, 0, 0]])
    axis = np.array([0.0, 0, 1])
    for parts, reach in (((upright, level), 0.4), ((upright, level, nearer), 0.8)):
        found = target(np.stack(parts)).reach_into(np.zeros(3), axis, 1.0)
        assert found == pytest.approx(reach)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vertices": np.zeros(9)}, r"vertices must have the shape .*got \(9,\)"),
        ({"faces": [[0, 1, 2, 3]]}, r"shape \(faces, 3\), got \(1, 4\)"),
        ({"faces": [[0, 1, 2], [0, 1, 4], [0, 1, 5]]},
         r"from 0 to 3, got \[0, 1, 4\] in face 1 \(2 such faces\)"),
        ({"vertices": [[0, 0, 0], [0, 0, np.nan], [1, 1, np.inf], [1, 1, 1]]},
         r"finite, got \[ 0.  0. nan\] at 1"),
        ({"faces": [[0, 1, 2], [1, 2, 3], [3, 2, 1], [2, 1, 0]]},
         r"faces 1 and 2 are the same triangle \(2 such pairs\)"),
        ({"texture": [1.0, -0.25]}, "texture must be from 0 to 1, got -0.25"),
        ({"texture": [1.5, -0.25]}, "texture must be from 0 to 1, got 1.5"),
        ({"texture": [[1.0, 1.0]]}, r"2 faces, got the shape \(1, 2\)"),
        ({"gloss": 0.2}, "rms_slope of a glossy target"),
        ({"vertices": [[0, 0, 0], [3, 0, 0], [7, 0, 0], [3, 1, 0]]},
         r"got 0 m2 with an edge of 7 m in face 0 \(1 such faces\)"),
    ],
)  # fmt: skip
def test_a_mesh_is_refused_with_its_first_fault(change, message):
    values = {
        "vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]],
        "faces": [[0, 1, 2], [1, 2, 3]],
        "reflectance": 0.5,
    }
    with pytest.raises(ValueError, match=message):
        MeshTarget(**(values | change))


def test_a_narrow_triangle_is_one_down_to_a_billionth_of_its_edge_squared():
    def made(height):
        return MeshTarget(
            vertices=[[0, 0, 0], [4, 0, 0], [1, height, 0]], faces=[[0, 1, 2]],
            reflectance=0.5, texture=[0.0],
        )  # fmt: skip

    # Half of 4 m times the height against 16e-9 m2.
    assert made(8.5e-9).corners.shape == (1, 3, 3)
    with pytest.raises(ValueError, match=r"area above 1e-09 .*got 1\.5e-08 m2"):
        made(7.5e-9)


def test_boxes_lie_around_their_triangles_with_a_billionth_of_the_scene():
    corner = np.array([[[1.0, 2, 3], [2, 2, 3], [1, 4, -8]]])
    mesh, number = hierarchy(corner)
    assert mesh.least == pytest.approx(8e-9)
    assert_allclose(mesh.box[0], [1, 2, -8, 2, 4, 3], atol=1e-7)
    assert mesh.box[0, 0] < 1
    assert mesh.box[0, 5] > 3
    assert number.tolist() == [0]
    assert_allclose(mesh.triangle[0, :9], [1, 2, 3, 1, 0, 0, 0, 2, -11])
    # The normal of (1, 0, 0) and (0, 2, -11).
    assert_allclose(mesh.triangle[0, 9:], np.array([0, 11, 2]) / np.sqrt(125))
    assert mesh.texture.tolist() == [1]
    assert RayCaster(corner).gap == mesh.least


def test_boxes_are_split_at_the_median_of_middles():
    # Of eight triangles along the axis to the right, the four lowest middles first.
    x = np.array([3.0, -1, 2, -3, 0.5, 7, -6, 5])
    size = np.array([1, 0.1, 0.3, 2, 0.2, 0.6, 0.05, 1.2])
    corner = np.zeros((8, 3, 3))
    corner[:, :, 0] = x[:, None] + size[:, None] * [0, 1, 0]
    corner[:, :, 1] = size[:, None] * [0, 0, 1]
    mesh, number = hierarchy(corner)
    assert set(number[:4]) == {6, 3, 1, 4}
    assert_allclose(mesh.box[1, [0, 3]], [-6, 0.7], atol=1e-7)
    assert_allclose(mesh.box[2, [0, 3]], [2, 7.6], atol=1e-7)


def test_without_triangles_no_ray_meets_any():
    mesh, number = hierarchy(np.empty((0, 3, 3)))
    assert [part.shape for part in mesh[:4]] == [(0, 6), (0, 3), (0, 12), (0,)]
    assert mesh.least == 0
    assert number.size == 0
    caster = RayCaster(np.empty((0, 3, 3)))
    one = np.zeros((1, 3))
    assert caster.first(one, one + 1).tolist() == [-1]


def test_rays_name_triangles_in_the_order_in_which_they_were_given():
    x = np.array([3.0, -1, 2, -3, 0.5])
    corner = np.zeros((5, 3, 3))
    corner[:, :, 0] = x[:, None] + [0, 0.4, 0]
    corner[:, :, 1] = [0, 0, 0.4]
    corner[:, :, 2] = 1.0
    caster = RayCaster(corner)
    start = np.stack([x + 0.1, np.full(5, 0.1), np.zeros(5)], axis=-1)
    forward = np.tile([0.0, 0, 1], (5, 1))
    assert caster.first(start, forward).tolist() == [0, 1, 2, 3, 4]
    assert caster.first(start, -forward).tolist() == [-1] * 5
    on = start + forward
    # A line that ends on its own triangle is free; on the way to another one it is not.
    assert caster.free(start, on, np.arange(5)).all()
    beyond = start + 2 * forward
    assert not caster.free(start, beyond, np.roll(np.arange(5), 1)).any()
