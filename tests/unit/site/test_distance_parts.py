"""Parts of the comparison of two visits, against sums on paper."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import norm

from amulor.site.change import distances
from amulor.site.change.distances import (
    Change,
    _cores,
    _corrected,
    _extent,
    _groups,
    _interpolated,
    _means,
    _patches,
    _sum_of,
    _tested,
    _unchanged,
    region_of,
    regions,
    write_change,
)
from amulor.site.registration.pose import ScanPose


def _grid(side: int, pitch: float = 0.01) -> np.ndarray:
    x, y = np.meshgrid(np.arange(side) * pitch, np.arange(side) * pitch)
    return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)


def _change(values: np.ndarray, **changes: Any) -> Change:
    """Comparison on a square grid of 10 mm; cylinders do not overlap."""
    count = len(values)
    fields: dict[str, Any] = {
        "epochs": ("one", "two"),
        "position": _grid(round(np.sqrt(count))),
        "normal": np.tile([0.0, 0.0, 1.0], (count, 1)),
        "value": np.asarray(values, dtype=float),
        "uncertainty": np.full(count, 1e-3),
        "own": np.full(count, 1e-3),
        "shape": np.zeros(count),
        "shared": np.zeros((count, 1)),
        "significant": np.ones(count, dtype=bool),
        "chance": np.zeros(count),
        "area": np.full(count, 1e-4),
        "spacing": 0.01,
        "radius": 0.004,
        "false_alarms": 0.05,
    }
    return Change(**{**fields, **changes})


def test_the_uncertainty_contains_noise_and_each_shared_error() -> None:
    change = _change(
        np.array([8e-3, -8e-3, 1e-3, np.nan]),
        shared=np.array([[2e-3, 2e-3], [0, 0], [0, 0], [0, 0]]),
    )
    tested = _tested(change)
    assert_allclose(tested.uncertainty, [3e-3, 1e-3, 1e-3, 1e-3])
    expected = 2 * norm.sf([8 / 3, 8, 1])
    assert_allclose(tested.chance[:3], expected)
    assert np.isnan(tested.chance[3])
    assert_array_equal(tested.significant, [True, True, False, False])
    # One false alarm in a thousand: the first, by 0.8 %, may be chance.
    strict = _tested(replace(change, false_alarms=1e-3))
    assert_array_equal(strict.significant, [False, True, False, False])


def test_places_belong_to_a_region_up_to_three_spacings_from_each_other() -> None:
    position = np.zeros((8, 3))
    position[:, 0] = [0.0, 0.029, 0.058, 0.089, 0.2, 0.21, 0.5, 0.6]
    significant = np.array([True] * 5 + [False, True, True])
    change = _change(np.zeros(8), position=position, significant=significant)
    groups = sorted(group.tolist() for group in _groups(change))
    assert groups == [[0, 1, 2], [3], [4], [6], [7]]
    assert _groups(replace(change, significant=np.zeros(8, dtype=bool))) == []


def test_regions_have_four_places_and_are_sorted_by_area() -> None:
    values = np.zeros(400)
    column, row = np.arange(400) % 20, np.arange(400) // 20
    small = (row < 2) & (column < 2)
    three = (row == 0) & (column > 16)
    large = (row > 14) & (column > 14)
    values[small | three] = 5e-3
    values[large] = -6e-3
    change = _change(values, significant=values != 0)
    found = regions(change)
    assert [len(region.members) for region in found] == [25, 4]
    first, second = found
    assert_allclose(first.centre, [0.17, 0.17, 0.0])
    assert first.reach == pytest.approx(0.02 * 2**0.5)
    assert (first.mean, first.largest) == pytest.approx((-6e-3, -6e-3))
    assert first.area == pytest.approx(25e-4)
    assert first.volume == pytest.approx(-25e-4 * 6e-3)
    assert first.lost == 0
    assert_allclose(second.centre, [0.005, 0.005, 0.0])
    assert second.volume == pytest.approx(4e-4 * 5e-3)


def test_a_mean_has_errors_of_noise_shape_and_width() -> None:
    area = np.full(100, 1e-4)
    area[0] = 5e-4
    values = np.full(100, 4e-3)
    values[0] = 9e-3
    own, shape = np.full(100, 1.3e-3), np.full(100, 0.5e-3)
    change = _change(values, area=area, own=own, shape=shape)
    region = region_of(change, np.arange(100))
    total = 104e-4
    mean = (99 * 1e-4 * 4e-3 + 5e-4 * 9e-3) / total
    assert region.mean == pytest.approx(mean)
    noise = 1.2e-3 * math.sqrt(99 * 1e-8 + 25e-8) / total
    parts = [noise, 0.42 * 0.5e-3, 0.25 * mean / 10]
    assert region.mean_uncertainty == pytest.approx(math.hypot(*parts))
    centre = (99 * 1e-4 * 0.045 + 0.0) / total
    middle = (1e-4 * change.position[1:].sum(axis=0)) / total
    assert_allclose(region.centre, middle)
    assert centre != pytest.approx(middle[0])
    away = np.linalg.norm(change.position - middle, axis=1).max()
    assert region.reach == pytest.approx(away)
    assert region.largest == 9e-3
    volume = [noise * total, 0.14 * 0.5e-3 * total]
    assert region.volume_uncertainty == pytest.approx(math.hypot(*volume))


def test_sums_have_noise_without_shape_and_correlated_cylinders() -> None:
    change = _change(np.array([1e-3, 2e-3, 3e-3, -1e-3]), radius=0.01)
    change.shared[:, 0] = [1e-4, 2e-4, 3e-4, 4e-4]
    change.own[:], change.shape[:] = 5e-4, 3e-4
    members = np.array([0, 1, 3])
    total, sigma, shape = _sum_of(change, members)
    assert total == pytest.approx(1e-4 * 2e-3)
    assert shape == pytest.approx(3 * 1e-4 * 3e-4)
    # Neighbors are one radius apart, and the diagonal 1.41: interpolated.
    diagonal = np.interp(
        2**0.5, [1.4, 1.5], [distances._CORRELATION[14], distances._CORRELATION[15]]
    )
    # Pairs 0-1 and 1-3 are neighbors, 0-3 lie on the diagonal.
    variance = (1e-4 * 4e-4) ** 2 * (3 + 2 * (2 * 0.011 + diagonal))
    shared = 1e-4 * (1e-4 + 2e-4 + 4e-4)
    assert sigma == pytest.approx(math.hypot(variance**0.5, shared), rel=1e-6)
    alone = _sum_of(replace(change, radius=0.0049), members)[1]
    plain = math.hypot(1e-4 * 4e-4 * 3**0.5, shared)
    assert alone == pytest.approx(plain, rel=1e-9)


def test_lost_places_have_the_mean_of_six_neighbors_by_distance() -> None:
    position = np.zeros((8, 3))
    position[:, 0] = [0.0, 1.0, -2.0, 3.0, -4.0, 5.0, -6.0, 7.0]
    values = np.array([np.nan, 1.0, 2.0, 4.0, 3.0, 5.0, 6.0, 99.0])
    change = _change(values, position=position)
    mean, error = _interpolated(change, np.array([0]))
    weight = 1 / np.arange(1.0, 7.0) ** 2
    expected = weight @ np.array([1, 2, 4, 3, 5, 6]) / weight.sum()
    assert_allclose(mean, [expected])
    assert_allclose(error, [0.75 * np.std([1, 2, 4, 3, 5, 6])])
    two = _change(np.array([np.nan, 1.0, 2.0]), position=position[:3])
    mean, _ = _interpolated(two, np.array([0]))
    assert_allclose(mean, [(1 + 2 / 4) / (1 + 1 / 4)])


def _row(values: np.ndarray, **changes: Any) -> Change:
    """Comparison in a row of places 10 mm apart, with a radius of 10 mm."""
    position = np.zeros((len(values), 3))
    position[:, 0] = 0.01 * np.arange(len(values))
    return _change(values, position=position, radius=0.01, **changes)


def test_a_rim_grows_by_rings_until_one_is_not_significant() -> None:
    values = np.zeros(40)
    values[:10] = 8e-3
    values[10:14] = 2e-3
    near, beyond = _extent(_row(values), np.arange(5), None)
    # 15 mm reach one place; rings of 10 mm go on, and end with the first of zero.
    assert near.tolist() == list(range(15))
    assert beyond == pytest.approx(1e-4 * 1e-3)
    short, _ = _extent(_row(values * (np.arange(40) < 5)), np.arange(5), None)
    assert short.tolist() == list(range(7))
    endless, _ = _extent(_row(np.full(40, 8e-3)), np.arange(5), None)
    # Twelve rings at most.
    assert endless.tolist() == list(range(5 + 1 + 12))


def test_a_rim_ends_before_others_turned_places_and_opposite_change() -> None:
    change = _row(np.full(40, 8e-3))
    near, _ = _extent(change, np.arange(5), np.array([13, 14]))
    # Up to the middle between 4 and 13.
    assert near.tolist() == list(range(9))
    normal = change.normal.copy()
    normal[5] = [0.0, 0.81, 0.59]
    normal[6] = [0.0, 0.79, 0.61]
    near, _ = _extent(replace(change, normal=normal), np.arange(5), None)
    assert near.tolist() == [number for number in range(18) if number != 5]
    values = np.full(40, 8e-3)
    values[7:] = -8e-3
    near, beyond = _extent(_row(values), np.arange(5), None)
    assert near.tolist() == list(range(7))
    # The ring of one place beyond.
    assert beyond == pytest.approx(1e-4 * math.hypot(8e-3, 1e-3))


def test_unchanged_places_are_two_radii_from_any_region() -> None:
    values = np.zeros(40)
    values[:5] = 8e-3
    values[20:23] = 8e-3
    values[30] = np.nan
    change = replace(_row(values), significant=np.nan_to_num(values) > 0, radius=0.011)
    expected = [7 <= n < 20 or n >= 23 for n in range(40)]
    expected[30] = False
    assert_array_equal(_unchanged(change), expected)


def test_shared_errors_are_fitted_to_unchanged_places() -> None:
    """Two errors with known derivatives, and a change that is left out."""
    count = 100
    rng = np.random.default_rng(2)
    shared = rng.normal(scale=1e-3, size=(count, 2))
    errors = np.array([1.5, -0.8])
    values = shared @ errors
    values[:5] += 0.05
    change = _change(values, shared=shared, own=np.full(count, 1e-4), radius=0.02)
    corrected = _corrected(change, np.arange(count) < 90)
    rows = shared[5:90] / 1e-4
    matrix = rows.T @ rows
    weak = np.eye(2) / 9
    inverse = np.linalg.inv(matrix + weak)
    found = inverse @ rows.T @ (values[5:90] / 1e-4)
    assert_allclose(corrected.value, values - shared @ found, atol=1e-12)
    # Cylinders of 20 mm every 10 mm repeat their noise pi times; the tails double it.
    spread = inverse @ (2 * np.pi * matrix + weak @ weak) @ inverse
    expected = np.einsum("ij,jk,ik->i", shared, spread, shared)
    assert_allclose((corrected.shared**2).sum(axis=1), expected)
    narrow = _corrected(replace(change, radius=0.01), np.arange(count) < 90)
    spread = inverse @ (2 * matrix + weak @ weak) @ inverse
    expected = np.einsum("ij,jk,ik->i", shared, spread, shared)
    assert_allclose((narrow.shared**2).sum(axis=1), expected)


def _cloud(position: np.ndarray, normal: np.ndarray, **fields: Any) -> Any:
    return SimpleNamespace(position=position, normal=normal, **fields)


def test_one_place_stands_for_each_cell_of_a_surface() -> None:
    # A floor of 5 x 5 points every 10 mm from 2 mm on; cells of 20 mm.
    floor = _grid(5) + 0.002
    normal = np.tile([0.0, 0.6, 0.8], (25, 1))
    core, axes, area = _cores(_cloud(floor, normal), np.arange(25), 0.02, 0.015)
    # The last cell has one point of its own, too few; those at the rim have two.
    assert len(core) == 8
    order = np.lexsort((core[:, 0], core[:, 1]))
    assert_allclose(core[order[0]], [0.007, 0.007, 0.002])
    assert_allclose(core[order[2]], [0.042, 0.007, 0.002])
    assert_allclose(axes, np.tile([0.0, 0.6, 0.8], (8, 1)))
    assert_allclose(area, 4e-4 / 0.8)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_cells_lie_across_the_axis_nearest_to_the_normal(axis: int) -> None:
    floor = _grid(4) + 0.002
    plate = np.roll(floor, axis + 1, axis=1)
    normal = np.zeros((16, 3))
    normal[:, axis] = -1.0
    core, axes, area = _cores(_cloud(plate, normal), np.arange(16), 0.02, 0.015)
    assert len(core) == 4
    assert_allclose(axes, normal[:4])
    assert_allclose(area, 4e-4)
    assert_allclose(core[:, axis], 0.002)


def test_layers_of_a_cell_are_separate_surfaces() -> None:
    # Two floors 41 mm from each other, and a third 39 mm above the second.
    floor = _grid(4) + 0.002
    above, top = floor + np.array([0, 0, 0.041]), floor + np.array([0, 0, 0.080])
    place = np.concatenate([floor, above, top])
    core, _, _ = _cores(
        _cloud(place, np.tile([0.0, 0.0, 1.0], (48, 1))), np.arange(48), 0.02, 0.03
    )
    heights = np.unique(core[:, 2].round(6))
    assert_allclose(heights, [0.002, 0.0625])


def test_points_without_a_normal_have_that_of_the_nearest() -> None:
    floor = _grid(4) + 0.002
    normal = np.tile([0.0, 0.0, 1.0], (16, 1))
    normal[[0, 5, 10]] = np.nan
    core, axes, _ = _cores(_cloud(floor, normal), np.arange(16), 0.02, 0.015)
    assert len(core) == 4
    assert_allclose(axes, np.tile([0.0, 0.0, 1.0], (4, 1)))


@pytest.mark.parametrize(("turn", "good"), [(70.0, True), (76.0, False)])
def test_an_edge_is_no_surface(turn: float, good: bool) -> None:
    # Half of the normals to either side: their mean is the cosine of half the turn.
    floor = _grid(4) + 0.002
    half = np.radians(turn / 2)
    sign = np.where(np.arange(16) % 2, 1.0, -1.0)
    normal = np.stack(
        [sign * np.sin(half), 0 * sign, np.full(16, np.cos(half))], axis=1
    )
    core, axes, _ = _cores(_cloud(floor, normal), np.arange(16), 0.02, 0.1)
    assert (len(core) > 0) is good
    if good:
        assert_allclose(axes, np.tile([0.0, 0.0, 1.0], (4, 1)), atol=1e-9)


def _disk(rng: np.random.Generator, count: int, radius: float) -> np.ndarray:
    away = radius * np.sqrt(rng.random(count))
    angle = rng.uniform(0, 2 * np.pi, count)
    return np.stack([away * np.cos(angle), away * np.sin(angle)], axis=1)


def test_patches_follow_bends_and_have_the_error_of_a_fit() -> None:
    rng = np.random.default_rng(4)
    flat = [_disk(rng, count, 0.05) for count in (80, 120)]
    owner = np.repeat([0, 1], [80, 120])
    normal = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    x, y = np.concatenate(flat).T
    height = 3e-3 + 0.1 * x - 0.2 * y + 2 * x**2 - x * y + 3 * y**2
    first = np.stack([x, y, height], axis=1)
    second = np.stack([height, x, y], axis=1)
    off = np.where(owner[:, None] == 0, first, second)
    weight = rng.uniform(0.5, 2.0, 200) * 1e6
    found = _patches(owner, height, off, normal, weight, 0.05)
    assert_allclose(found.height, 3e-3, atol=1e-9)
    assert found.good.all()
    assert_array_equal(found.shape, [0.0, 0.0])
    terms = np.stack([np.ones(200), x, y, x**2, x * y, y**2], axis=1)
    for number in (0, 1):
        at = owner == number
        rows = terms[at]
        solve = np.linalg.inv(rows.T @ (weight[at, None] * rows))
        gain = solve[0] @ (rows.T * weight[at])
        assert found.own[number] == pytest.approx(math.sqrt(solve[0, 0]), rel=1e-4)
        assert_allclose(found.share[at], gain, rtol=1e-3, atol=1e-5)


def test_points_that_scatter_more_than_their_noise_have_an_error_by_shape() -> None:
    rng = np.random.default_rng(5)
    x, y = _disk(rng, 400, 0.05).T
    noise = 3e-3 * rng.standard_normal(400)
    off = np.stack([x, y, noise], axis=1)
    axis = np.array([[0.0, 0.0, 1.0]])
    owner = np.zeros(400, dtype=np.intp)
    rough = _patches(owner, noise, off, axis, np.full(400, 1e6), 0.05)
    # Three times the noise of 1 mm: the shape has the root of 8.
    assert rough.shape[0] == pytest.approx(0.75 * 8**0.5 * 1e-3, rel=0.1)
    assert rough.good[0]
    stated = _patches(owner, noise, off, axis, np.full(400, 1e6 / 9), 0.05)
    assert stated.shape[0] == 0
    assert rough.own[0] == pytest.approx(
        math.hypot(stated.own[0], rough.shape[0]), rel=0.05
    )
    # More than 0.3 of the radius is no surface.
    steep = _patches(owner, 6 * noise, off, axis, np.full(400, 1e6), 0.05)
    assert not steep.good[0]
    less = _patches(owner, 4.5 * noise, off, axis, np.full(400, 1e6), 0.05)
    assert less.good[0]


def test_points_far_off_a_patch_are_left_out() -> None:
    rng = np.random.default_rng(6)
    x, y = _disk(rng, 200, 0.05).T
    height = 1e-3 * rng.standard_normal(200).clip(-2, 2)
    height[:4] = 0.05
    off = np.stack([x, y, height], axis=1)
    axis, owner = np.array([[0.0, 0.0, 1.0]]), np.zeros(200, dtype=np.intp)
    found = _patches(owner, height, off, axis, np.full(200, 1e6), 0.05)
    assert abs(found.height[0]) < 1e-3
    assert found.shape[0] == 0
    assert_array_equal(found.share[:4], np.zeros(4))


@pytest.mark.parametrize(("count", "good"), [(11, False), (12, True)])
def test_a_patch_needs_twelve_points(count: int, good: bool) -> None:
    rng = np.random.default_rng(7)
    flat = np.concatenate([[[0.0, 0.0]], _disk(rng, count - 1, 0.05)])
    off = np.column_stack([flat, np.zeros(count)])
    axis, owner = np.array([[0.0, 0.0, 1.0]]), np.zeros(count, dtype=np.intp)
    found = _patches(owner, off[:, 2], off, axis, np.full(count, 1e6), 0.05)
    assert bool(found.good[0]) is good
    # Points to one side do not tell the height in the middle.
    aside = off + np.array([0.2, 0.0, 0.0])
    far = _patches(owner, off[:, 2], aside, axis, np.full(count, 1e6), 0.05)
    assert not far.good[0]


def test_means_have_derivatives_by_the_poses_and_errors_of_their_scans(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Points of two scans on one floor, and two places to compare."""
    monkeypatch.setattr(distances, "_PIECE", 1)
    rng = np.random.default_rng(8)
    flat = _disk(rng, 240, 0.05)
    flat[120:, 0] += 0.2
    height = np.where(np.arange(240) < 120, 2e-3, 7e-3)
    place = np.column_stack([flat, height])
    scan = np.arange(240) % 2
    cloud: Any = _cloud(
        place, np.tile([0.0, 0.0, 1.0], (240, 1)),
        beam=np.tile([0.0, 0.6, -0.8], (240, 1)), own=np.full(240, 5e-4),
        scan=scan, pixel=np.arange(240),
        site=SimpleNamespace(scan=[SimpleNamespace(name=name) for name in "ab"]),
    )  # fmt: skip

    def by_unknowns(
        surface: Any, pose: Any, points: np.ndarray, pixel: np.ndarray
    ) -> np.ndarray:
        assert_array_equal(points, place[pixel])
        rows = np.zeros((len(points), 3, 7))
        rows[:, :, :3] = np.eye(3)
        rows[:, 2, 6] = 0.5 if surface == "A" else 0.25
        return rows

    monkeypatch.setattr(distances, "by_unknowns", by_unknowns)
    monkeypatch.setattr(
        distances, "unknowns_of", lambda name, _: [f"pose {name}", "error delay"]
    )
    registration: Any = SimpleNamespace(
        poses={name: ScanPose(np.eye(3), np.zeros(3)) for name in "ab"}
    )
    core = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [5.0, 0.0, 0.0]])
    means = _means(
        cloud, np.arange(240), core, np.tile([0.0, 0.0, 1.0], (3, 1)), 0.05, 0.1,
        {"a": "A", "b": "B"}, registration, ["pose a", "error delay", "pose b"],
    )  # fmt: skip
    assert_allclose(means.value, [2e-3, 7e-3, np.nan], atol=1e-9)
    assert means.slope.shape == (3, 13)
    # Both scans have half of the points, and their shares add up to 1.
    by_up = means.slope[:2, 2] + means.slope[:2, 7 + 2]
    assert_allclose(by_up, 1.0, atol=1e-6)
    by_delay = 0.5 * means.slope[:2, 2] + 0.25 * means.slope[:2, 7 + 2]
    assert_allclose(means.slope[:2, 6], by_delay)
    assert_allclose(means.slope[:, [0, 1, 3, 4, 5]], 0.0)
    assert (means.slope[2] == 0).all()
    # 120 points of 0.8 times 0.5 mm, of which six are of the fit.
    assert_allclose(means.own[:2], 0.8 * 5e-4 * 3 / 120**0.5, rtol=0.6)
    fewer = means.own[0] / (0.8 * 5e-4)
    twice = replace_own(cloud, 1e-3)
    again = _means(
        twice, np.arange(240), core, np.tile([0.0, 0.0, 1.0], (3, 1)), 0.05, 0.1,
        {"a": "A", "b": "B"}, registration, ["pose a", "error delay", "pose b"],
    )  # fmt: skip
    assert again.own[0] == pytest.approx(fewer * 0.8 * 1e-3)


def replace_own(cloud: Any, own: float) -> Any:
    """The same points with another noise."""
    return SimpleNamespace(**{**vars(cloud), "own": np.full(240, own)})


def test_the_table_has_all_columns_with_their_units(tmp_path: Path) -> None:
    change = _change(
        np.array([1.23456789e-3, np.nan, -2e-3, 3e-3]),
        uncertainty=np.array([2e-3, 1, 3e-3, 4e-3]),
        own=np.array([1e-3, 1, 1.5e-3, 2e-3]),
        chance=np.array([0.5, np.nan, 0.25, 1e-9]),
        significant=np.array([False, False, False, True]),
        area=np.array([1e-4, 1e-4, 1.5e-4, 2e-4]),
        normal=np.tile([0.6, 0.0, 0.8], (4, 1)),
    )
    path = tmp_path / "change.csv"
    write_change(change, path)
    assert path.read_text().splitlines() == [
        "x_m,y_m,z_m,normal_x,normal_y,normal_z,change_m,standard_uncertainty_m,"
        "own_part_m,chance,significant,area_m2",
        "0.000000,0.000000,0.000000,0.6,0,0.8,0.00123457,0.002,0.001,0.5,0,0.0001",
        "0.000000,0.010000,0.000000,0.6,0,0.8,-0.002,0.003,0.0015,0.25,0,0.00015",
        "0.010000,0.010000,0.000000,0.6,0,0.8,0.003,0.004,0.002,1e-09,1,0.0002",
    ]
    assert path.read_text().endswith("0002\n")
    with pytest.raises(Exception, match=r"change.csv"):
        write_change(change, path)
    write_change(change, path, overwrite=True)
