"""Poses of scans: closed forms, and what changes and departures mean."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from amulor.site.description import StartPose
from amulor.site.registration.pose import (
    ScanPose,
    aligned,
    best_pose,
    departure,
    start_covariance,
    start_pose,
)

#: A quarter turn about the third axis, at (1, 2, 3).
QUARTER = ScanPose(
    np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    np.array([1.0, 2.0, 3.0]),
)


def test_points_are_turned_and_shifted_and_directions_turned_only() -> None:
    point = [[0.5, 0.25, -1.0]]
    assert_allclose(QUARTER.place(point), [[0.75, 2.5, 2.0]])
    assert_allclose(QUARTER.turn(point), [[-0.25, 0.5, -1.0]])
    assert_allclose(QUARTER.back(QUARTER.place(point)), point)
    assert_allclose(QUARTER.matrix @ [*point[0], 1.0], [0.75, 2.5, 2.0, 1.0])


def test_a_change_turns_about_the_instrument_and_departs_by_itself() -> None:
    step = np.array([0.1, -0.2, 0.3, 0.0, 0.0, np.pi / 2])
    changed = QUARTER.changed(step)
    # Two quarter turns are half of one; the origin moves by the translation alone.
    assert_allclose(changed.rotation, np.diag([-1.0, -1.0, 1.0]), atol=1e-12)
    assert_allclose(changed.position, [1.1, 1.8, 3.3])
    assert_allclose(departure(changed, QUARTER), step, atol=1e-12)


def test_the_best_pose_maps_points_far_from_the_origin_onto_each_other() -> None:
    rng = np.random.default_rng(3)
    points = rng.normal([5.0, -3.0, 8.0], 1.0, (20, 3))
    turn = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix()
    found = best_pose(points, points @ turn.T + [4.0, 7.0, -2.0])
    assert_allclose(found.rotation, turn, atol=1e-12)
    assert_allclose(found.position, [4.0, 7.0, -2.0], atol=1e-11)


def start(**changes: float) -> StartPose:
    stated = {
        "position": ("1 m", "2 m", "3 m"), "heading": "90 deg",
        "position_uncertainty": "20 mm", "heading_uncertainty": "30 mrad",
        "level_uncertainty": "10 mrad",
    }  # fmt: skip
    return StartPose.model_validate(stated | changes)


def test_a_start_pose_looks_along_its_heading() -> None:
    pose = start_pose(start())
    # Right is south, down is down, forward is east.
    assert_allclose(
        pose.turn(np.eye(3)), [[0, -1, 0], [0, 0, -1], [1, 0, 0]], atol=1e-9
    )
    assert_allclose(pose.position, [1, 2, 3])


def test_the_covariance_of_a_start_pose_is_that_of_its_axes() -> None:
    # Heading turns about the vertical, pitch about the right axis, roll about forward.
    covariance = start_covariance(start(), start_pose(start()))
    least = 0.25 * 0.01**2
    assert_allclose(
        covariance,
        np.diag([4e-4] * 3 + [1e-4 + least, 1e-4 + least, 9e-4 + least]),
        atol=1e-12,
    )


def test_no_direction_counts_as_known_where_the_instrument_looks_straight_down() -> (
    None
):
    steep = start(pitch="-90 deg")
    covariance = start_covariance(steep, start_pose(steep))
    # Heading and roll turn about the vertical; the smaller error, halved, is left.
    assert np.linalg.eigvalsh(covariance[3:, 3:])[0] == pytest.approx(0.005**2)


def test_alignment_goes_from_coarse_to_fine(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[dict[str, Any]] = []

    def align(others: Any, points: Any, **how: Any) -> Any:
        calls.append(how)
        return SimpleNamespace(T_target_source=how["init_T_target_source"])

    monkeypatch.setattr("small_gicp.align", align)
    cloud = np.zeros((5, 3))
    aligned(cloud, cloud, QUARTER, voxel=0.05, reach=0.5)
    assert_allclose(
        [call["downsampling_resolution"] for call in calls], [0.15, 0.1, 0.05, 0.05]
    )
    # Points match within the reach, a half, a quarter and a tenth of it, but always
    # within two voxels.
    assert_allclose(
        [call["max_correspondence_distance"] for call in calls], [0.5, 0.25, 0.125, 0.1]
    )
    # A step of less than a micrometer ends it; several threads add in any order.
    assert {call["translation_epsilon"] for call in calls} == {1e-6}
    assert {call["rotation_epsilon"] for call in calls} == {1e-7}
    assert {call["num_threads"] for call in calls} == {1}


def relief(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return points of a bed with bumps of some decimeters."""
    x, y = rng.uniform(-1.5, 1.5, (2, count))
    z = 0.2 * np.sin(3 * x) * np.cos(2 * y) + 0.1 * np.sin(5 * y + x)
    return np.stack([x, y, z], axis=1)


@pytest.mark.parametrize("away", [0.0, 40.0])
def test_points_of_one_bed_are_aligned_within_their_noise(away: float) -> None:
    rng = np.random.default_rng(7)
    turn = Rotation.from_rotvec([0.4, -0.2, 0.6]).as_matrix()
    true = ScanPose(turn, np.array([away + 0.3, -away, 2.0]))
    middle = np.array([away, -away, 0.0])
    points = true.back(relief(rng, 6000) + middle)
    others = relief(rng, 6000) + middle
    first = true.changed(np.array([0.05, -0.04, 0.03, 0.02, -0.02, 0.03]))
    found = aligned(points, others, first, voxel=0.05, reach=0.25)
    off = departure(found, true)
    # Rotation and position by 6000 points on others; the middle stays within 2 mm.
    assert np.abs(off[3:]).max() < 2e-3
    inside = points.mean(axis=0)
    assert np.linalg.norm(found.place(inside) - true.place(inside)) < 3e-3
    assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-12)
