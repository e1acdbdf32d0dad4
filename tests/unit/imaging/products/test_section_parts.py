"""Parts of a section by independent formulas: ends, pieces, gains and pose errors."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.testing import assert_allclose

from amulor.imaging.products.section import _gain, _pieces, _pose_errors, _with_ends


def test_a_section_begins_and_ends_at_the_ends_of_its_line() -> None:
    # Distance, height and one more value of five points along a chain.
    values = np.array([[-1.0, 1, 3, 5, 9], [0.0, 2, 4, 6, 10], [5.0, 5, 5, 5, 1]])
    chain = np.array([[0, 1], [1, 2], [3, 2], [3, 4]])
    points, joints = _with_ends(values, chain, 6.0)
    assert_allclose(points[:, :5], values)
    assert_allclose(points[:, 5], [0, 1, 5])
    assert_allclose(points[:, 6], [6, 7, 4])
    # Each end takes the place of the point beyond.
    assert joints.tolist() == [[5, 1], [1, 2], [3, 2], [3, 6]]
    back, joined = _with_ends(values, chain[:, ::-1], 6.0)
    assert_allclose(back[:, 5:], points[:, 5:])
    assert joined.tolist() == joints[:, ::-1].tolist()


def test_a_line_within_one_triangle_has_two_points() -> None:
    points, joints = _with_ends(np.array([[9.0, -1.0]]), np.array([[0, 1]]), 6.0)
    assert_allclose(points, [[9, -1, 0, 6]])
    assert joints.tolist() == [[3, 2]]


def test_an_end_on_an_edge_is_the_point_of_that_edge() -> None:
    values = np.array([[-1.0, 0, 2, 6, 7]])
    chain = np.array([[0, 1], [1, 2], [2, 3], [3, 4]])
    points, joints = _with_ends(values, chain, 6.0)
    assert points.tolist() == values.tolist()
    inside = (values[0] >= 0) & (values[0] <= 6)
    order, piece = _pieces(joints, inside, values[0])
    assert order.tolist() == [1, 2, 3]
    assert piece.tolist() == [0, 0, 0]


def test_pieces_are_in_the_order_of_their_distance_and_closed_where_they_meet() -> None:
    # An open chain of 4, 0, 2; a ring of 1, 3, 5; and a chain that leaves the line.
    distance = np.array([6.0, 1.0, 7.0, 1.5, 5.0, 2.0, 8.0, 9.0])
    joints = np.array([[0, 2], [4, 0], [1, 3], [3, 5], [5, 1], [2, 6], [6, 7]])
    inside = np.array([True] * 6 + [False, True])
    order, piece = _pieces(joints, inside, distance)
    ring, chain = order[piece == 0].tolist(), order[piece == 1].tolist()
    assert ring in ([1, 3, 5, 1], [1, 5, 3, 1])
    assert chain == [4, 0, 2]
    assert piece.tolist() == [0] * 4 + [1] * 3


def test_an_error_of_range_moves_a_profile_by_its_slope() -> None:
    # Unit normals and beams; the section plane is that of x and z.
    tilt = np.array([0.0, 0.5, 1.2])
    normal = np.stack([np.sin(tilt), 0 * tilt, -np.cos(tilt)], axis=1)
    aside = np.array([[np.sin(0.3), np.sin(0.4) * np.cos(0.3), 0]])
    aside[:, 2] = -np.sqrt(1 - (aside**2).sum())
    grazing = np.array([[0.0, 1.0, 0.0]])
    normals = np.concatenate([normal, aside, grazing])
    beam = np.tile([0.0, 0.0, 1.0], (5, 1))
    surface: Any = SimpleNamespace(normal=normals, direction=beam)
    found = _gain(surface, np.array([0.0, 1.0, 0.0]))
    expected = [-np.cos(angle) for angle in tilt]
    # The profile's own normal is shorter where the surface leans out of the plane.
    in_plane = np.hypot(aside[0, 0], aside[0, 2])
    assert_allclose(found[:4], [*expected, aside[0, 2] / in_plane], rtol=1e-12)
    assert found[4] == 1.0
    # Nearly in the plane of the section, the gain is limited.
    steep = np.array([[0.0, 1 - 1e-9, -1e-1]])
    leaning: Any = SimpleNamespace(normal=steep, direction=beam[:1])
    assert _gain(leaning, np.array([0.0, 1.0, 0.0]))[0] == -20.0


def test_pose_errors_count_along_the_line_and_out_of_its_plane() -> None:
    rng = np.random.default_rng(6)
    shifts = rng.normal(size=(4, 7, 3))
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    along = np.array([0.6, 0.8])
    surface: Any = SimpleNamespace(
        frame=SimpleNamespace(shared_errors=lambda points: shifts)
    )
    plane: Any = SimpleNamespace(axes=axes)
    found = _pose_errors(surface, np.zeros((7, 3)), plane, along)
    line, height = along[0] * axes[0] + along[1] * axes[1], axes[2]
    expected = [
        sum((s @ line) ** 2 + (s @ height) ** 2 for s in shifts[:, k]) for k in range(7)
    ]
    assert_allclose(found, expected, rtol=1e-12)
