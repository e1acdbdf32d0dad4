"""Comparison of two scans of one plane: distances, derivatives, selection of points."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from amulor.site.registration import pair as module
from amulor.site.registration.pair import Pair, compared, on_grid, tree_of
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.surface import ScanSurface, scan_surface, shared_errors

ROWS, COLUMNS = 22, 26
AZIMUTH, ELEVATION, UNIT = scenes.directions(ROWS, COLUMNS, half=0.05)
#: A plane in the site, N . p = 1.5, and the poses of both scans.
NORMAL = np.array([0.25, -0.15, 0.95])
POSES = {
    "a": ScanPose(
        Rotation.from_rotvec([0.01, -0.02, 0.05]).as_matrix(),
        np.array([0.02, 0.01, -0.03]),
    ),
    "b": ScanPose(
        Rotation.from_rotvec([-0.015, 0.03, -0.04]).as_matrix(),
        np.array([-0.03, 0.0, 0.05]),
    ),
}
DELAY = 2e-3
OWN = {"a": 1e-4, "b": 3e-4}


def _ranges(pose: ScanPose) -> np.ndarray:
    """Ranges of the plane."""
    return (1.5 - NORMAL @ pose.position) / (pose.turn(UNIT) @ NORMAL)


def _scan(name: str, change: np.ndarray | float = 0.0) -> ScanSurface:
    """Surface of a scan, with a change of its ranges."""
    image = scenes.image_of(
        _ranges(POSES[name]) + change, AZIMUTH, ELEVATION, own=OWN[name], shared=DELAY
    )
    delay = xr.full_like(image["slant_range"], DELAY)
    image = image.assign(slant_range_uncertainty_delay=delay)
    shared = shared_errors(image, scan=name, instrument=name, water="w")
    return scan_surface(image, name=name, shared=shared)


@pytest.fixture(scope="module")
def scans() -> dict[str, ScanSurface]:
    return {name: _scan(name) for name in "ab"}


def _compared(
    scans: dict[str, ScanSurface],
    *,
    poses: dict[str, ScanPose] | None = None,
    gate: float | None = None,
    errors: dict[str, float] | None = None,
    **options: Any,
) -> Pair:
    used = POSES if poses is None else poses
    pair = compared(
        scans["a"], scans["b"], (used["a"], used["b"]),
        gate=gate, errors=errors or {}, **options,
    )  # fmt: skip
    assert pair is not None
    return pair


@pytest.fixture(scope="module")
def pair(scans: dict[str, ScanSurface]) -> Pair:
    return _compared(scans)


def test_points_of_one_surface_have_no_distance(
    pair: Pair, scans: dict[str, ScanSurface]
) -> None:
    assert (pair.source, pair.target) == ("a", "b")
    assert pair.keys == ("delay: a", "delay: b")
    assert len(pair.distance) > 100
    assert_allclose(pair.distance, 0.0, atol=1e-8)
    assert_allclose(pair.place @ NORMAL, 1.5, atol=1e-9)
    assert_allclose(pair.pivot, pair.place.mean(axis=0))
    points = POSES["a"].place(scans["a"].points(pair.source_pixel))
    assert_allclose(pair.place, points)
    # The pixel of the target is the nearest beam.
    local = POSES["b"].back(pair.place)
    along = UNIT.reshape(-1, 3) @ (local / np.linalg.norm(local, axis=1)[:, None]).T
    assert_array_equal(pair.target_pixel, along.argmax(axis=0))
    assert (np.abs(pair.off) <= 0.6).all()
    assert pair.misfit == 1.0
    assert pair.moved.size == 0
    assert pair.patches is scans["b"]


def test_weights_are_inverse_variances_by_points_and_patches(
    pair: Pair, scans: dict[str, ScanSurface]
) -> None:
    window = pair.window.toarray()
    # Both change a distance as seen along the beams of the target.
    sight = POSES["b"].turn(UNIT.reshape(-1, 3)[pair.target_pixel])
    beam = POSES["a"].turn(UNIT.reshape(-1, 3)[pair.source_pixel])
    along = (beam @ NORMAL) / (sight @ NORMAL)
    assert_allclose(pair.along, along, rtol=2e-3)
    assert_allclose(pair.along_apart, along, rtol=2e-3)
    variance = (pair.along * 1e-4) ** 2 + ((3e-4 * window) ** 2).sum(axis=1)
    assert_allclose(pair.weight, 1 / variance)
    assert pair.used == len(pair.weight)
    # A patch keeps a change of all its ranges.
    assert_allclose(window.sum(axis=1), -1.0, atol=0.02)


@pytest.mark.parametrize("axis", range(6))
def test_a_motion_of_the_source_changes_distances_by_its_derivatives(
    pair: Pair, scans: dict[str, ScanSurface], axis: int
) -> None:
    step = 1e-6
    moved = POSES["a"]
    if axis < 3:
        moved = replace(moved, position=moved.position + step * np.eye(3)[axis])
    else:
        turn = Rotation.from_rotvec(step * np.eye(3)[axis - 3]).as_matrix()
        moved = ScanPose(
            turn @ moved.rotation, pair.pivot + turn @ (moved.position - pair.pivot)
        )
    other = _compared(scans, poses={**POSES, "a": moved})
    both, first, second = np.intersect1d(
        pair.source_pixel, other.source_pixel, return_indices=True
    )
    assert len(both) > 100
    change = (other.distance[second] - pair.distance[first]) / step
    for derivatives in (pair.by_target, pair.by_source):
        assert_allclose(derivatives[first, axis], change, atol=2e-3)


@pytest.mark.parametrize(("key", "number"), [("delay: a", 0), ("delay: b", 1)])
def test_estimated_errors_correct_the_distances(
    pair: Pair, scans: dict[str, ScanSurface], key: str, number: int
) -> None:
    name = "ab"[number]
    late = {**scans, name: _scan(name, DELAY)}
    off = _compared(late)
    sign = 1.0 if name == "a" else -1.0
    assert_allclose(off.distance, sign * DELAY, rtol=0.02)
    right = _compared(late, errors={key: 1.0, "of others": 9.0})
    assert_allclose(right.distance, 0.0, atol=2e-5)
    column = right.by_target[:, 6 + number]
    assert_allclose(column, -sign * DELAY, rtol=0.02)
    assert_allclose(right.by_source[:, 6 + number], column, rtol=1e-3)
    assert_allclose(right.distance - off.distance, column, atol=1e-9)


def test_a_change_of_one_pixel_moves_its_point_or_the_patches_around(
    pair: Pair, scans: dict[str, ScanSurface]
) -> None:
    number = len(pair.distance) // 2
    change = np.zeros((ROWS, COLUMNS))
    change.ravel()[pair.source_pixel[number]] = 1e-6
    other = _compared({**scans, "a": _scan("a", change)})
    moved = other.distance - pair.distance
    assert moved[number] == pytest.approx(1e-6 * pair.along[number], rel=1e-3)
    assert_allclose(np.delete(moved, number), 0.0, atol=1e-12)
    change = np.zeros((ROWS, COLUMNS))
    place = pair.target_pixel[number] + 1 - COLUMNS
    change.ravel()[place] = 1e-6
    other = _compared({**scans, "b": _scan("b", change)})
    expected = 1e-6 * pair.window.toarray()[:, place]
    assert_allclose(other.distance - pair.distance, expected, atol=2e-9)
    assert np.abs(expected).max() > 5e-8


def test_a_gate_leaves_out_points_far_off(scans: dict[str, ScanSurface]) -> None:
    off = {**scans, "a": _scan("a", 5e-3)}
    assert (
        compared(off["a"], off["b"], (POSES["a"], POSES["b"]), gate=4.9e-3, errors={})
        is None
    )
    near = _compared(off, gate=5.2e-3)
    assert near.used == len(near.distance)


def test_points_out_of_reach_are_not_compared(scans: dict[str, ScanSurface]) -> None:
    spacing = scans["b"].spacing
    for share, gate, met in (
        (3.9, None, True), (4.1, None, False), (4.1, 2.2 * spacing, False),
        (4.1, 4.3 * spacing, True), (8.9, 4.3 * spacing, False),
    ):  # fmt: skip
        away = POSES["a"].position - share * spacing * NORMAL / np.linalg.norm(NORMAL)
        poses = (replace(POSES["a"], position=away), POSES["b"])
        found = compared(scans["a"], scans["b"], poses, gate=gate, errors={})
        assert (found is not None) is met, (share, gate)


def test_only_chosen_pixels_have_a_weight(
    pair: Pair, scans: dict[str, ScanSurface]
) -> None:
    among = pair.source_pixel[::2]
    half = _compared(scans, among=among)
    chosen = np.isin(half.source_pixel, among)
    assert_allclose(half.weight, np.where(chosen, pair.weight, 0.0))
    assert half.used == len(among)
    tree = _compared(scans, tree=tree_of(scans["b"]))
    assert_array_equal(tree.source_pixel, pair.source_pixel)


@pytest.mark.parametrize(("most", "step"), [(320, 1), (319, 2), (80, 2), (79, 3)])
def test_many_points_are_thinned_evenly(
    scans: dict[str, ScanSurface], most: int, step: int
) -> None:
    smooth = scans["a"].smooth
    assert smooth.sum() == 16 * 20
    row, column = np.divmod(module._chosen(scans["a"], most), COLUMNS)
    assert np.all(row % step == 0)
    assert np.all(column % step == 0)
    expected = smooth.copy()
    expected[np.arange(ROWS) % step > 0] = False
    expected[:, np.arange(COLUMNS) % step > 0] = False
    assert len(row) == expected.sum()


def test_few_points_are_no_comparison(scans: dict[str, ScanSurface]) -> None:
    for count, found in ((19, False), (20, True), (21, True)):
        smooth = np.zeros((ROWS, COLUMNS), dtype=bool)
        inner = np.argwhere(scans["a"].smooth)
        middle = inner[np.abs(inner - [11, 13]).max(axis=1) < 4][:count]
        smooth[tuple(middle.T)] = True
        few = replace(scans["a"], smooth=smooth)
        pair = compared(few, scans["b"], (POSES["a"], POSES["b"]), gate=None, errors={})
        assert (pair is not None) is found
        gated = compared(few, scans["b"], (POSES["a"], POSES["b"]), gate=0.1, errors={})
        assert (gated is not None) is found


@pytest.mark.parametrize(
    ("name", "angle", "met"),
    # Cosines of 45.6 degrees between both normals: 0.7.
    [("a", 44.0, True), ("a", 47.0, False), ("b", 44.0, True), ("b", 47.0, False)],
)
def test_surfaces_that_face_elsewhere_are_not_compared(
    scans: dict[str, ScanSurface], name: str, angle: float, met: bool
) -> None:
    own = POSES[name].back(NORMAL + POSES[name].position)
    turn = Rotation.from_rotvec(
        np.radians(angle)
        * np.cross(own, [0, 1, 0])
        / np.linalg.norm(np.cross(own, [0, 1, 0]))
    )
    turned = scans[name].normal @ turn.as_matrix().T
    pair = compared(
        **{
            "source": replace(scans["a"], normal=turned) if name == "a" else scans["a"],
            "target": replace(scans["b"], normal=turned) if name == "b" else scans["b"],
        },
        poses=(POSES["a"], POSES["b"]), gate=None, errors={},
    )  # fmt: skip
    assert (pair is not None) is met


def test_mean_squares_are_those_of_displaced_points(pair: Pair) -> None:
    motion = np.array([1e-3, -2e-3, 3e-3, 0.1, -0.2, 0.05])
    moved = motion[:3] + np.cross(motion[3:], pair.place - pair.pivot)
    share = pair.weight / pair.weight.sum()
    expected = share @ (moved**2).sum(axis=1)
    assert motion @ pair.mean_square @ motion == pytest.approx(expected)
    nothing = replace(pair, weight=0 * pair.weight)
    assert nothing.used == 0
    assert_array_equal(nothing.mean_square, np.zeros((6, 6)))


def test_a_plane_determines_three_motions(pair: Pair) -> None:
    assert len(pair.loose) == 3
    unit = NORMAL / np.linalg.norm(NORMAL)
    for motion in pair.loose:
        # Along the plane, or about its normal.
        assert abs(motion[:3] @ unit) < 0.05
        assert np.linalg.norm(np.cross(motion[3:], unit)) < 0.05
        assert_allclose(pair.held @ motion, 0.0, atol=1e-6)
    across = np.array([*unit, 0.0, 0.0, 0.0])
    assert_allclose(pair.held @ across, across, atol=0.05)


@pytest.mark.parametrize("begin", [0, 1, -1, COLUMNS, 4 - 3 * COLUMNS])
def test_points_are_located_between_the_beams_of_a_grid(
    scans: dict[str, ScanSurface], begin: int
) -> None:
    row, column = np.array([10.3, 11.0, 9.55]), np.array([12.8, 13.0, 14.4])
    azimuth = -0.05 + 0.1 / (COLUMNS - 1) * column
    top = 0.05 * ROWS / COLUMNS
    elevation = top - 2 * top / (ROWS - 1) * row
    ahead = np.stack(
        [
            np.sin(azimuth) * np.cos(elevation),
            -np.sin(elevation),
            np.cos(azimuth) * np.cos(elevation),
        ],
        axis=-1,
    )
    pose = POSES["b"]
    plane = (1.5 - NORMAL @ pose.position) / (pose.turn(ahead) @ NORMAL)
    point = (plane + np.array([0.0, 1e-3, -2e-3]))[:, None] * ahead
    pixel = np.array([10 * COLUMNS + 13, 11 * COLUMNS + 13, 10 * COLUMNS + 14])
    found = on_grid(scans["b"], point, pixel + begin)
    assert_array_equal(found.pixel, pixel)
    assert_allclose(found.off, [[0.3, -0.2], [0.0, 0.0], [-0.45, 0.4]], atol=1e-5)
    assert_allclose(found.direction, ahead, atol=1e-9)
    assert_allclose(found.distance, [0.0, 1e-3, -2e-3], atol=1e-8)
    assert found.inside.all()
    part = found.of(np.array([False, True, True]))
    assert_array_equal(part.pixel, pixel[1:])
    assert_allclose(part.distance, [1e-3, -2e-3], atol=1e-8)
    assert part.inside.shape == (2,)
    assert part.off.shape == (2, 2)
    assert part.direction.shape == (2, 3)


def test_points_beside_the_smooth_pixels_are_outside(
    scans: dict[str, ScanSurface],
) -> None:
    point = np.array([scans["b"].position[10, 0], scans["b"].position[10, 13]])
    found = on_grid(scans["b"], point, np.array([10 * COLUMNS, 10 * COLUMNS + 13]))
    assert_array_equal(found.inside, [False, True])
    # Beyond the last row: the pixel stays there, and is too far away.
    edge = scans["b"].position[-1, 13] + 3 * (
        scans["b"].position[-1, 13] - scans["b"].position[-2, 13]
    )
    smooth = np.ones((ROWS, COLUMNS), dtype=bool)
    whole = replace(scans["b"], smooth=smooth)
    last = np.array([(ROWS - 1) * COLUMNS + 13])
    found = on_grid(whole, edge[None], last)
    assert found.pixel[0] == last[0]
    assert not found.inside[0]
    for share, inside in ((0.58, True), (0.62, False)):
        near = whole.position[-1, 13] + share * (edge - whole.position[-1, 13]) / 3
        assert on_grid(whole, near[None], last).inside[0] == inside


def test_offsets_solve_for_beams_that_are_no_right_angle() -> None:
    away, ahead = np.array([[0.3, 0.5, 2.0]]), np.array([[0.0, 0.0, 1.0]])
    slopes = np.array(
        [[[[0.0, 0.01, 0.0]], [[0.02, 0.01, 0.0]]],
         [[[0.0, 0.1, 0.0]], [[0.1, 0.05, 0.0]]]]
    )  # fmt: skip
    # At 2 m the steps are (0, 0.21) and (0.22, 0.11).
    off = module._pixels_off(away, ahead, slopes)
    columns = 0.3 / 0.22
    assert_allclose(off, [[(0.5 - 0.11 * columns) / 0.21, columns]])
    nothing = module._pixels_off(away, ahead, 0 * slopes)
    assert_array_equal(np.abs(nothing), [[9.0, 9.0]])


def test_beams_bend_by_their_second_differences() -> None:
    row, column = np.mgrid[0:4, 0:5].astype(float)
    values = np.stack(
        [row**2 + 2 * column, 3 * column**2, row * column + 0.5 * column**2], axis=-1
    )
    flat, shape = values.reshape(-1, 3), (4, 5)
    off = np.array([[0.4, -0.3]])
    for pixel in (7, 0, 19):  # inside, and at two corners of the grid
        bend = module._bend(flat, shape, np.array([pixel]), off)
        expected = [0.4**2, 3 * 0.3**2, -0.12 + 0.5 * 0.3**2]
        assert_allclose(bend, [expected], atol=1e-12)
    line = module._bend(flat[:5], (1, 5), np.array([2]), off)
    assert np.isfinite(line).all()
