"""Rays and triangles: the hierarchy against all triangles, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulor.optics.phase_functions.models import isotropic
from amulor.transport import (
    DiscReceiver,
    Medium,
    MeshTarget,
    PlaneTarget,
    Source,
    simulate,
)
from amulor.transport._kernels import mesh as _hierarchy_kernels
from amulor.transport._kernels import mesh as _mesh_kernels
from amulor.transport.mesh import distance_to_triangles
from amulor.transport.ray_caster import RayCaster, hierarchy

CUBE = np.array(
    [[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
)
SIDES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 5, 1], [0, 4, 5],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def hit_by_volumes(corner, origin, direction):
    """Return distance along a ray to each triangle, by signed volumes; inf if none.

    The line goes through a triangle if it passes the three edges on one side.
    """
    a, b, c = (corner[:, k] - origin for k in range(3))
    volumes = np.stack(
        [np.cross(p, q) @ direction for p, q in ((b, c), (c, a), (a, b))], axis=1
    )
    whole = volumes.sum(axis=1)
    through = np.all(volumes > 0, axis=1) | np.all(volumes < 0, axis=1)
    point = np.einsum("ij,ijk->ik", volumes, np.stack([a, b, c], axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = point @ direction / whole / (direction @ direction)
    return np.where(through & (distance > 0), distance, np.inf)


def soup(rng, count):
    """Return corners of triangles of all sizes at random places."""
    size = 10.0 ** rng.uniform(-2, 0.3, size=(count, 1, 1))
    centre = rng.uniform(-2, 2, size=(count, 1, 3))
    return centre + size * rng.normal(size=(count, 3, 3))


@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 3, 5, 40, 300]))
def test_the_hierarchy_finds_what_all_triangles_give(seed, count):
    rng = np.random.default_rng(seed)
    corner = soup(rng, count)
    mesh, _ = hierarchy(corner)
    for _ in range(8):
        origin, direction = rng.uniform(-3, 3, size=(2, 3))
        if rng.uniform() < 0.3:  # along an axis, where one component is zero
            direction = np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
        all_of_them = hit_by_volumes(corner, origin, direction)
        expected = all_of_them.min()
        distance, number = _mesh_kernels.first_hit(
            tuple(origin), tuple(direction), np.inf, 0.0, -1.0, mesh
        )
        # Triangles are larger by 1e-9, which no drawn ray tells from not.
        assert distance == pytest.approx(expected, rel=1e-9)
        assert (number >= 0) == np.isfinite(expected)
        if number >= 0:
            found = mesh.triangle[int(number), :3]
            assert np.array_equal(found, corner[np.argmin(all_of_them), 0])
            # Starting on that triangle the next one is met, and from afar none.
            point = origin + distance * direction
            others = np.delete(corner, np.argmin(all_of_them), axis=0)
            second = hit_by_volumes(others, point, direction).min(initial=np.inf)
            following, _ = _mesh_kernels.first_hit(
                tuple(point), tuple(direction), np.inf, 0.0, number, mesh
            )
            assert following == pytest.approx(second, rel=1e-6, abs=1e-9)
            short, none = _mesh_kernels.first_hit(
                tuple(origin), tuple(direction), 0.999 * distance, 0.0, -1.0, mesh
            )
            assert (short, none) == (0.999 * distance, -1.0)
        end = origin + direction
        assert _mesh_kernels.blocked(tuple(origin), tuple(end), -1.0, mesh) == (
            expected < 1
        )
        assert _mesh_kernels.blocked(tuple(end), tuple(origin), -1.0, mesh) == (
            expected < 1
        )


@given(st.integers(0, 2**32 - 1), st.sampled_from([0, 1, 4, 5, 300]))
def test_the_caster_names_the_triangle_that_all_triangles_give(seed, count):
    rng = np.random.default_rng(seed)
    corner = soup(rng, count)
    caster = RayCaster(corner)
    start, direction = rng.uniform(-3, 3, size=(2, 8, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    distance = np.array(
        [hit_by_volumes(corner, *ray) for ray in zip(start, direction, strict=True)]
    ).reshape(8, count)
    met = caster.first(start, direction)
    none = np.all(np.isinf(distance), axis=1)
    assert np.array_equal(met < 0, none)
    nearest = [int(np.argmin(each)) for each in distance[~none]]
    assert met[~none].tolist() == nearest
    # From that triangle on, seen from points on both sides of the next one.
    for ray, number in zip(np.flatnonzero(~none), met[~none], strict=True):
        point = start[ray] + distance[ray, number] * direction[ray]
        others = np.delete(corner, number, axis=0)
        following = hit_by_volumes(others, point, direction[ray]).min(initial=np.inf)
        for length in (0.5 * min(following, 9.0), 1.5 * min(following, 9.0)):
            free = caster.free(
                point[None], (point + length * direction[ray])[None], met[ray : ray + 1]
            )
            assert free[0] == (length < following)


def test_a_triangle_without_an_area_is_not_met_and_disturbs_no_other():
    corner = np.array(
        [[[0, 0, 2], [1, 1, 2], [2, 2, 2]], [[0, 0, 3], [1, 0, 3], [0, 1, 3]]]
    )
    start = np.array([[0.3, 0.3, 0.0]])
    assert RayCaster(corner).first(start, np.array([[0.0, 0.0, 1.0]])).tolist() == [1]


def test_each_triangle_is_in_one_box_and_each_box_around_what_is_in_it():
    rng = np.random.default_rng(7)
    # Many centers at the same place along each axis, which no split can separate.
    corner = soup(rng, 500).round(0)
    mesh, number = hierarchy(corner)
    assert sorted(number) == list(range(500))
    first, count = mesh.link[:, 1], mesh.link[:, 2]
    assert np.array_equal(
        np.concatenate(
            [np.arange(f, f + n) for f, n in zip(first, count, strict=True)]
        ),
        np.arange(500),
    )
    assert count.max() <= 4
    for box, (after, *_) in enumerate(mesh.link):
        held = [k for f, n in mesh.link[box:after, 1:] for k in range(f, f + n)]
        inside = corner[number[held]].reshape(-1, 3)
        assert np.all(mesh.box[box, :3] <= inside.min(axis=0))
        assert np.all(mesh.box[box, 3:] >= inside.max(axis=0))


def test_compiled_and_plain_builds_are_the_same():
    centre = np.random.default_rng(5).normal(size=(90, 3))
    results = []
    for split in (_hierarchy_kernels.split, _hierarchy_kernels.split.py_func):
        number, link = np.arange(90), np.zeros((91, 3), dtype=np.int64)
        sibling = np.zeros(91, dtype=np.int64)
        count = split(centre, number, link, sibling)
        results.append([number, link[:count], sibling[:count]])
    for compiled, plain in zip(*results, strict=True):
        assert np.array_equal(compiled, plain)


def test_compiled_and_plain_walks_are_the_same():
    rng = np.random.default_rng(3)
    mesh, _ = hierarchy(soup(rng, 60))
    for _ in range(50):
        ray = (tuple(rng.uniform(-3, 3, size=3)), tuple(rng.normal(size=3)))
        compiled = _mesh_kernels.first_hit(*ray, np.inf, 0.0, -1.0, mesh)
        plain = _mesh_kernels.first_hit.py_func(*ray, np.inf, 0.0, -1.0, mesh)
        assert compiled == pytest.approx(plain, rel=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_no_ray_leaves_a_closed_box_through_an_edge(seed):
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    corner = ((CUBE * rng.uniform(0.1, 3, size=3)) @ turn + rng.normal(size=3))[SIDES]
    mesh, _ = hierarchy(corner)
    centre = corner.mean(axis=(0, 1))
    origin = centre + 0.5 * (corner[rng.integers(12), 0] - centre)
    for first, second in rng.permutation(np.indices((12, 3)).reshape(2, -1).T)[:12]:
        # Aimed at a point of an edge, or at its end.
        fraction = rng.choice([0.0, rng.uniform()])
        aim = (
            corner[first, second] * (1 - fraction)
            + corner[first, second - 1] * fraction
        )
        direction = aim - origin
        distance, number = _mesh_kernels.first_hit(
            tuple(origin), tuple(direction), np.inf, 0.0, -1.0, mesh
        )
        assert distance == pytest.approx(1.0, rel=1e-6)
        normal = np.array(_mesh_kernels.facing_normal(number, tuple(direction), mesh))
        assert normal @ direction < 0
        assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_the_distance_to_a_triangle_is_the_least_one_over_its_points(seed):
    rng = np.random.default_rng(seed)
    corner, point = rng.normal(size=(1, 3, 3)), rng.normal(size=3) * 2
    u, v = np.meshgrid(np.linspace(0, 1, 201), np.linspace(0, 1, 201))
    inside = u + v <= 1 + 1e-12
    grid = (
        corner[0, 0]
        + u[inside, None] * (corner[0, 1] - corner[0, 0])
        + v[inside, None] * (corner[0, 2] - corner[0, 0])
    )
    sampled = np.linalg.norm(grid - point, axis=1).min()
    found = distance_to_triangles(point, corner)
    longest = np.linalg.norm(corner[0] - np.roll(corner[0], 1, axis=0), axis=1).max()
    # The grid misses the nearest point by a step at most.
    assert found <= sampled + 1e-12
    assert found >= sampled - longest / 200


def cube(**changes):
    """Return a cube of 2 m with its middle 3 m ahead."""
    given = {
        "vertices": CUBE + np.array([0, 0, 3.0]),
        "faces": SIDES,
        "reflectance": 0.5,
    }
    return MeshTarget(**(given | changes))


def run(target, *, receiver=(0.3, 0, 0), source=(0, 0, 0), radius=0.05):
    """Simulate a few histories."""
    water = Medium.homogeneous(
        absorption=0.2, scattering=0.1, phase_function=isotropic(), group_index=1.33
    )
    disc = DiscReceiver(radius=radius, acceptance_angle=0.1, position=receiver)
    return simulate(
        water, Source(position=source), disc, [0.0], histories=64, seed=1,
        target=target, threads=1,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"faces": np.empty((0, 3), int)}, "at least one triangle, got none"),
        ({"faces": [[0, 1, 3], [0, 1, 8]]}, r"from 0 to 7, got \[0, 1, 8\] in face 1"),
        ({"faces": [[0, 1, -1]]}, r"from 0 to 7, got \[0, 1, -1\] in face 0"),
        ({"faces": [[0.0, 1.0, 3.0]]}, "whole numbers of vertices"),
        ({"faces": [0, 1, 3]}, r"shape \(faces, 3\), got \(3,\)"),
        ({"faces": [[0, 1, 3], [2, 2, 3]]}, r"got 0 m2 .* 2 m in face 1 \(1 such"),
        ({"faces": [[0, 1, 3], [3, 0, 1]]}, "faces 0 and 1 are the same triangle"),
        ({"vertices": np.zeros((8, 2))}, r"shape \(vertices, 3\).*got \(8, 2\)"),
        ({"vertices": np.full((8, 3), np.nan)}, "must be finite"),
        ({"reflectance": 1.1}, "from 0 to 1, got 1.1"),
        ({"mueller": np.diag([1.0, 2, 0, 0])}, "mueller cannot exist"),
    ],
)
def test_a_mesh_that_cannot_be_is_refused_with_numbers(changes, message):
    with pytest.raises(ValueError, match=message):
        cube(**changes)


def test_a_receiver_inside_of_a_closed_mesh_is_refused_by_how_much():
    with pytest.raises(ValueError, match=r"centre of the receiver .* one 0\.75 m"):
        run(cube(), receiver=(0.25, 0, 3.0))
    with pytest.raises(ValueError, match=r"the source .* one 0\.5 m under"):
        run(cube(), source=(0, 0, 2.5))
    # Orders of corners and vertices that are not shared do not matter.
    torn = cube(vertices=cube().corners[:, ::-1].reshape(-1, 3),
                faces=np.arange(36).reshape(12, 3))  # fmt: skip
    with pytest.raises(ValueError, match=r"one 0\.75 m under its surface"):
        run(torn, receiver=(0.25, 0, 3.0))
    # Without its side towards the source the same box is open, and stands.
    opened = cube(faces=SIDES[~np.all(CUBE[SIDES][..., 2] == -1, axis=1)])
    assert run(opened, receiver=(0.25, 0, 2.5)).histories >= 64


def test_a_face_that_a_triangle_cuts_is_refused_by_how_much():
    plate = {"faces": [[0, 1, 2]], "reflectance": 0.5}
    across = MeshTarget(vertices=[[0.28, -1, -1], [0.28, 1, -1], [0.28, 0, 2]], **plate)
    with pytest.raises(ValueError, match=r"0\.03 m inside of its rim"):
        run(across)
    assert run(across, radius=0.019).histories >= 64
    level = MeshTarget(vertices=[[0.32, -1, 0], [0.32, 1, 0], [2, 0, 0]], **plate)
    with pytest.raises(ValueError, match=r"0\.03 m inside of its rim"):
        run(level)
    with pytest.raises(ValueError, match="source must not lie on the target"):
        run(MeshTarget(vertices=[[-1, -1, 0], [-1, 1, 0], [0.1, 0, 0]], **plate))


@pytest.mark.parametrize("turn", range(3))
def test_a_leaning_triangle_reaches_into_a_disc_where_it_meets_its_plane(turn):
    # Two thirds down from 0.5 m at the height 2 m to 0.2 m at -1 m: at 0.3 m.
    corners = np.roll([[0.5, 0, 2.0], [0.2, -1, -1], [0.2, 1, -1]], turn, axis=0)
    plate = MeshTarget(vertices=corners, faces=[[0, 1, 2]], reflectance=0.5)
    for radius, expected in ((0.4, 0.1), (0.301, 0.001), (0.299, 0.0)):
        found = plate.reach_into(np.zeros(3), np.array([0.0, 0, 1]), radius)
        assert found == pytest.approx(expected, abs=1e-12)


def test_runs_of_different_meshes_are_told_apart():
    digests = {
        run(target).problem
        for target in (
            None,
            PlaneTarget(position=(0, 0, 3.0), reflectance=0.5),
            cube(),
            cube(vertices=CUBE + np.array([0, 0, 3.001])),
        )
    }
    assert len(digests) == 4


@pytest.mark.parametrize(
    ("texture", "message"),
    [
        ([1.0, 0.5], r"texture must have one number for each of the 12 faces.*\(2,\)"),
        (np.full(12, 1.5), r"texture must be from 0 to 1, got 1\.5"),
        (np.full(12, np.nan), r"texture must be from 0 to 1, got nan"),
    ],
)
def test_a_texture_has_a_fraction_for_each_triangle(texture, message):
    with pytest.raises(ValueError, match=message):
        MeshTarget(vertices=CUBE, faces=SIDES, reflectance=0.5, texture=texture)
