"""Merged points and change: their errors are those that come of drawn scans."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.testing import assert_allclose
from site_scenes import scanning, shapes

from amulor.errors import FormatError
from amulor.imaging import flag_mixed, flag_outliers
from amulor.site import Site
from amulor.site.change import distances
from amulor.site.change.distances import (
    Change,
    _corrected,
    _in_cylinders,
    change,
    region_of,
    regions,
    write_change,
)
from amulor.site.change.moved import _best_place
from amulor.site.description import Comparison
from amulor.site.merging.cloud import merge
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.register import register, surface_of
from amulor.site.registration.result import (
    Contradiction,
    Registration,
    Weakness,
    read_registration,
    write_registration,
)

ERRORS = scanning.Errors(own=1e-3, delay=1e-3, index=3e-4, reference=5e-4)
PLACES = {
    "a": ((-1.2, -1.2, 1.6), "one"),
    "b": ((1.3, -1.0, 1.7), "one"),
    "c": ((-1.0, -1.4, 1.7), "two"),
    "d": ((1.4, -0.8, 1.6), "two"),
}


def flat_change(values: np.ndarray, own: float, shared: float) -> Change:
    """Return a comparison on a square grid of 10 mm, all points significant."""
    side = round(np.sqrt(len(values)))
    x, y = np.meshgrid(np.arange(side) * 0.01, np.arange(side) * 0.01)
    count = len(values)
    return Change(
        epochs=("one", "two"),
        position=np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1),
        normal=np.tile([0.0, 0.0, 1.0], (count, 1)),
        value=values,
        uncertainty=np.full(count, np.hypot(own, shared)),
        own=np.full(count, own),
        shape=np.zeros(count),
        shared=np.full((count, 1), shared),
        significant=np.ones(count, dtype=bool),
        chance=np.zeros(count),
        area=np.full(count, 1e-4),
        spacing=0.01,
        radius=0.004,
        false_alarms=0.05,
    )


def test_a_volume_has_the_error_of_noise_and_of_what_all_share() -> None:
    found = flat_change(np.full(100, 5e-3), own=1e-3, shared=2e-3)
    (region,) = regions(found)
    # 10 x 10 cells of 1 cm2, raised by 5 mm; noise goes with the root of the cells.
    assert_allclose(region.volume, 100 * 1e-4 * 5e-3)
    noise, common = 10 * 1e-4 * 1e-3, 100 * 1e-4 * 2e-3
    assert_allclose(region.volume_uncertainty, np.hypot(noise, common))
    assert_allclose(region.mean, 5e-3)


def heap(rng: np.random.Generator | None, *, own: float = 4e-4) -> Change:
    """Return a Gaussian heap of 2 mm on a grid of 41 x 41 places, with noise."""
    axis = (np.arange(41) - 20) * 0.01
    x, y = np.meshgrid(axis, axis)
    values = 2e-3 * np.exp(-(x**2 + y**2) / (2 * 0.05**2)).ravel()
    if rng is not None:
        values = values + own * rng.normal(size=values.size)
    found = flat_change(values, own=own, shared=0.0)
    return replace(found, radius=0.005, significant=values > 3 * own)


#: Volume of the heap: its height times 2 pi times the square of its width [m^3].
HEAP = 2e-3 * 2 * np.pi * 0.05**2


def test_a_volume_includes_tails_below_the_significance() -> None:
    (region,) = regions(heap(None))
    # Of the heap, 60 % lie above the limit of 1.2 mm, so 40 % in the tails.
    inside = heap(None).significant
    assert (heap(None).area * heap(None).value)[inside].sum() < 0.5 * HEAP
    assert region.volume == pytest.approx(HEAP, rel=0.02)


def test_volumes_of_heaps_have_the_stated_error() -> None:
    rng = np.random.default_rng(11)
    scores = []
    for _ in range(60):
        region = regions(heap(rng))[0]
        scores.append((region.volume - HEAP) / region.volume_uncertainty)
    # The mean of 60 draws has the error 0.13, their scatter 0.09.
    assert abs(np.mean(scores)) < 0.5
    assert np.std(scores) == pytest.approx(1, abs=0.3)


@pytest.mark.parametrize(("size", "expected"), [(5.0, 4.0909), (20.0, 6.6667)])
def test_errors_beyond_the_weak_prior_have_the_stated_one(
    size: float, expected: float
) -> None:
    # The squares of the derivatives add up to 0.5: an error of 5 is estimated as 5
    # times 0.5 / (0.5 + 1 / 3**2), and one of 20, beyond the prior, as 20 / (1 + 2).
    slope = np.sqrt(0.5 / 100)
    found = flat_change(np.full(100, size * slope), own=1.0, shared=slope)
    corrected = _corrected(found, np.ones(100, dtype=bool))
    assert_allclose(found.value - corrected.value, expected * slope, rtol=1e-4)


@pytest.mark.parametrize("radius", [0.015, 0.02, 0.03])
def test_cylinders_that_overlap_repeat_their_noise(radius: float) -> None:
    # Heights of second-degree fits on the grid, by the pseudo-inverse at each axis.
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.04, 0.13, (9000, 2))
    found = flat_change(np.full(100, 5e-3), own=1.0, shared=0.0)
    of_points, single = np.zeros(len(points)), []
    for axis in found.position[:, :2]:
        at = np.flatnonzero(np.hypot(*(points - axis).T) < radius)
        x, y = (points[at] - axis).T / radius
        terms = np.stack([np.ones_like(x), x, y, x**2, x * y, y**2], axis=1)
        weights = np.linalg.pinv(terms)[0]
        of_points[at] += weights
        single.append(float(weights @ weights))
    expected = 1e-4 * np.sqrt(float(of_points @ of_points) / np.mean(single))
    wide = region_of(replace(found, radius=radius), np.arange(100))
    assert wide.volume_uncertainty == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize("reach", [0.02, 0.05, 0.2])
def test_points_in_cylinders_are_those_of_all_pairs(reach: float) -> None:
    rng = np.random.default_rng(3)
    place = rng.uniform(-0.2, 0.2, (3000, 3))
    facing = np.tile([0.0, 0.0, 1.0], (3000, 1))
    facing[::3], facing[1::3] = np.nan, [0.0, 0.0, -1.0]
    core = rng.uniform(-0.2, 0.2, (40, 3))
    axis = rng.normal((0.0, 0.0, 1.0), 0.3, (40, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    cloud: Any = SimpleNamespace(position=place, normal=facing)
    at = np.arange(0, 3000, 2)
    owner, index, off, along = _in_cylinders(cloud, at, core, axis, 0.05, reach)
    every = place[at] - core[:, None]
    height = np.einsum("nij,nj->ni", every, axis)
    aside = np.linalg.norm(every - height[..., None] * axis[:, None], axis=2)
    toward = axis @ facing[at].T
    inside = (aside <= 0.05) & (np.abs(height) <= reach) & ~(toward < 0.6)
    assert_allclose(np.array([owner, index]), np.array(np.nonzero(inside)))
    assert_allclose(off, every[inside])
    assert_allclose(along, height[inside], atol=1e-15)


def test_errors_by_shape_are_part_of_the_errors_of_mean_and_volume() -> None:
    found = flat_change(np.full(100, 5e-3), own=2e-3, shared=0.0)
    sharp = replace(found, shape=np.full(100, 2e-3))
    plain, bent = (region_of(each, np.arange(100)) for each in (found, sharp))
    # All of the error is by shape: it does not go with the root of the places.
    assert bent.volume_uncertainty == pytest.approx(0.14 * 100 * 1e-4 * 2e-3)
    assert bent.mean_uncertainty > plain.mean_uncertainty
    assert plain.area_uncertainty == pytest.approx(0.5 * 0.01 * np.sqrt(plain.area))


def test_places_not_compared_are_interpolated_in_a_volume() -> None:
    x = np.arange(100) % 10
    found = flat_change(5e-3 + 1e-4 * x, own=1e-3, shared=0.0)
    blind = found.value.copy()
    blind[[44, 45, 54, 55]] = np.nan
    whole = region_of(found, np.arange(100))
    some = region_of(
        replace(found, value=blind, radius=0.03), np.flatnonzero(np.isfinite(blind))
    )
    assert some.lost == pytest.approx(4e-4)
    assert some.volume == pytest.approx(whole.volume, rel=1e-3)
    assert some.area_uncertainty == pytest.approx(
        np.hypot(0.5 * 0.01 * np.sqrt(some.area), 0.7 * some.lost)
    )


def test_the_area_contains_changes_below_a_larger_error() -> None:
    # A body moved along x: its flanks rise and fall by 4 mm, where every second place
    # has too large an error, and 1 mm remains on its top.
    x, y = np.arange(144) % 12, np.arange(144) // 12
    values = np.where(x < 4, 4e-3, np.where(x > 7, -4e-3, 1e-3))
    found = flat_change(values, own=1e-3, shared=0.0)
    significant = (np.abs(values) > 2e-3) & ((x + y) % 2 == 0)
    values = np.where(significant, values, 1.25 * values)
    found = replace(found, value=values)
    region = region_of(replace(found, radius=0.02), np.flatnonzero(significant))
    # 8 of 12 columns of 12 cells of 1 cm2.
    assert region.area == pytest.approx(96e-4)
    # Of a heap alone, only places of the same sign.
    heap = np.flatnonzero(significant & (values > 0))
    assert region_of(replace(found, radius=0.02), heap).area == pytest.approx(48e-4)


def test_the_rim_of_a_region_ends_at_the_middle_to_the_next_region() -> None:
    values = np.where(np.arange(100) % 10 < 5, 5e-3, -5e-3)
    found = flat_change(values, own=1e-3, shared=0.0)
    left, right = (np.flatnonzero(found.value > 0), np.flatnonzero(found.value < 0))
    wide = replace(found, radius=0.02)
    alone = region_of(wide, left)
    beside = region_of(wide, left, others=right)
    assert alone.volume < beside.volume
    assert beside.volume == pytest.approx(50 * 1e-4 * 5e-3)


def test_the_rim_of_a_region_ends_before_an_opposite_change() -> None:
    # A body moved by five columns, and only the places where it now lies are a region.
    column = np.arange(400) % 20
    values = np.select([column < 5, column < 10], [5e-3, -5e-3], 0.0)
    found = replace(flat_change(values, own=1e-3, shared=0.0), radius=0.01)
    region = region_of(found, np.flatnonzero(column < 5))
    # One and a half radii contain one further column.
    assert region.volume == pytest.approx((100 - 20) * 1e-4 * 5e-3)
    # One ring of 1 cm of the opposite change may be part of it.
    assert region.volume_uncertainty > 20 * 1e-4 * 5e-3


def test_a_shared_error_is_estimated_where_nothing_changed() -> None:
    # All distances are 0.4 mm too small, four times what is stated; a quarter changed.
    rng = np.random.default_rng(5)
    values = rng.normal(scale=5e-4, size=400) - 4e-4
    values[:100] += 5e-3
    found = flat_change(values, own=5e-4, shared=1e-4)
    unchanged = np.arange(400) >= 140
    mended = _corrected(found, unchanged)
    off = mended.value[unchanged].mean()
    assert abs(off) < 3 * 5e-4 / np.sqrt(260)
    # The estimate is better than the statement, and changes are no part of it.
    assert np.all(np.abs(mended.shared) < 1e-4)
    assert mended.value[:100].mean() == pytest.approx(5e-3, abs=2e-4)


def test_coordinates_in_the_table_keep_millimetres_far_from_the_origin(
    tmp_path: Path,
) -> None:
    found = flat_change(np.full(9, 5e-3), own=1e-3, shared=2e-3)
    away = np.array([500_123.4567, 5_212_345.6789, -38.0123])
    far = Change(**{**vars(found), "position": found.position + away})
    write_change(far, tmp_path / "change.csv")
    rows = np.genfromtxt(tmp_path / "change.csv", delimiter=",", names=True)
    for axis, name in enumerate(("x_m", "y_m", "z_m")):
        assert_allclose(rows[name], far.position[:, axis], rtol=0, atol=1e-6)
    assert_allclose(rows["change_m"], 5e-3)


def test_the_shift_of_a_turning_body_is_known_best_on_its_axis() -> None:
    # A body that turns by 50 mrad about an axis 0.1 m below the place looked at.
    axis, arm = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -0.1])
    slope = np.concatenate([np.cross(axis, -arm), axis])
    spread = np.diag([1e-8] * 3 + [1e-6] * 3) + 0.05**2 * np.outer(slope, slope)
    place = _best_place(spread)
    assert_allclose(place, arm, atol=2e-3)


def site() -> Site:
    """Return a site of two visits with two scans each."""
    return Site.model_validate(
        {
            "name": "still",
            "epoch": [{"name": "one"}, {"name": "two"}],
            "scan": [
                {"name": name, "file": f"{name}.nc", "epoch": epoch, "water": epoch}
                for name, (_, epoch) in PLACES.items()
            ],
            "registration": {"window": 5},
        }
    )


@pytest.mark.slow
def test_points_and_change_of_a_still_site_have_the_errors_stated() -> None:
    rows = 44
    bed = shapes.sea_bed(relief=0.12)
    beams = scanning.grid(rows, rows * 4 // 3, 0.35)
    poses = {
        name: ScanPose(*scanning.looking(place, (0.0, 0.05, 0.1)))
        for name, (place, _) in PLACES.items()
    }
    true = {
        name: scanning.ranges(bed, pose.rotation, pose.position, beams[2])
        for name, pose in poses.items()
    }
    rng = np.random.default_rng(9)
    described = site()
    points, scores, widened, alarms, compared = [], [], [], 0, 0
    draws = 5
    for _ in range(draws):
        draw = scanning.Draw(rng)
        images, surfaces = {}, {}
        for scan in described.scan:
            image = scanning.image(
                true[scan.name], *beams[:2], errors=ERRORS, draw=draw, scan=scan.name,
                instrument=scan.epoch, water=scan.epoch,
            )  # fmt: skip
            images[scan.name] = flag_outliers(flag_mixed(image))
            surfaces[scan.name] = surface_of(described, scan, images[scan.name])
        found = register(
            with_starts(described, poses, rng), surfaces=surfaces, images=images
        )
        cloud = merge(described, found, surfaces, images)
        for number, scan in enumerate(described.scan):
            mine = np.flatnonzero(cloud.scan == number)[::97]
            pixel = cloud.pixel[mine]
            place = poses[scan.name].place(
                true[scan.name].ravel()[pixel, None] * beams[2].reshape(-1, 3)[pixel]
            )
            off = cloud.position[mine] - place
            solved = np.linalg.solve(cloud.covariance[mine], off[..., None])[..., 0]
            points.append(np.einsum("ni,ni->n", off, solved))
        assert cloud.moving.mean() < 1e-3
        result = change(described, found, surfaces, cloud)
        known = np.isfinite(result.value)
        # What pixels have by themselves, and what they share, is all there is.
        assert_allclose(
            result.uncertainty[known],
            np.linalg.norm(np.column_stack([result.own, result.shared]), axis=1)[known],
        )
        # A suspected error, here by chance, widens the errors of poses.
        suspected = max(abs(test.score) for test in found.patterns) > 2.5
        score = (result.value / result.uncertainty)[known]
        (widened if suspected else scores).append(score)
        alarms += int(result.significant.any())
        compared += int(known.sum())
    # Chi-square of three degrees of freedom; points of one draw share its pose.
    assert np.mean(np.concatenate(points)) == pytest.approx(3, abs=1.5)
    assert compared > 500 * draws
    assert len(scores) >= 3
    assert np.concatenate(scores).std() == pytest.approx(1, abs=0.12)
    assert np.concatenate(scores + widened).std() < 1.12
    # Something is called changed in 5 of 100 still sites.
    assert alarms <= 3


def with_starts(
    described: Site, poses: dict[str, ScanPose], rng: np.random.Generator
) -> Site:
    """Return a site with start poses that are off as they say."""
    scans = []
    for scan in described.scan:
        forward = poses[scan.name].rotation[:, 2]
        off = rng.normal(size=6)
        start = {
            "position": tuple(poses[scan.name].position + 0.02 * off[:3]),
            "heading": float(np.arctan2(forward[0], forward[1]) + 0.01 * off[3]),
            "pitch": float(np.arcsin(forward[2]) + 0.01 * off[4]),
            "roll": float(0.01 * off[5]),
            "position_uncertainty": 0.02,
            "heading_uncertainty": 0.01,
            "level_uncertainty": 0.01,
        }
        scans.append(scan.model_copy(update={"start": start}))
    return described.model_copy(update={"scan": tuple(scans)})


def test_a_registration_is_read_as_it_was_written(tmp_path: Path) -> None:
    spread = np.diag(np.arange(1.0, 8.0))
    stated = Registration(
        site="s",
        poses={
            "a": ScanPose(np.eye(3), np.zeros(3)),
            "b": ScanPose(np.eye(3), np.array([1.0, 2.0, 3.0])),
        },
        points={},
        errors={"delay: i": 0.5},
        places={"pose b": (0, 6), "error delay: i": (6, 7)},
        covariance=spread,
        pairs=(),
        disagreements=(),
        weaknesses=(Weakness(scan="b", shift=(1.0, 0.0, 0.0), turn=(0.0, 0.0, 0.1)),),
        contradictions=(
            Contradiction(
                scan="b",
                error="",
                shift=0.5,
                turn=0.1,
                stated_shift=0.05,
                stated_turn=0.05,
                score=104.0,
            ),
        ),
        remarks=("visit 'two' meets no other",),
        settled=True,
        fixed="a",
    )
    write_registration(stated, tmp_path / "poses.json")
    found = read_registration(tmp_path / "poses.json")
    assert found.weaknesses == stated.weaknesses
    assert found.contradictions == stated.contradictions
    assert_allclose(found.poses["b"].matrix, stated.poses["b"].matrix)
    # What is fixed has no error.
    both = found.covariance_of("pose a", "error delay: i", "pose b")
    assert_allclose(both.diagonal(), [0] * 6 + [7, 1, 2, 3, 4, 5, 6])
    text = (tmp_path / "poses.json").read_text()
    # A pose that was moved by hand, a row of the covariance that is gone.
    for damaged in (
        text.replace("0.5", "0.6", 1),
        text.replace('"fixed": "a"', '"f": 1'),
    ):
        assert damaged != text
        (tmp_path / "damaged.json").write_text(damaged)
        with pytest.raises(FormatError, match="is damaged or was edited"):
            read_registration(tmp_path / "damaged.json")
    (tmp_path / "other.json").write_text('{"kind": "something"}')
    with pytest.raises(FormatError, match="amulor site register makes one"):
        read_registration(tmp_path / "other.json")


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        # Twice the coarsest pixels of 10 mm, and one and a half times this.
        ({}, (0.02, 0.03)),
        ({"spacing": "5 cm"}, (0.05, 0.075)),
        ({"radius": "4 cm"}, (0.02, 0.04)),
        ({"spacing": "5 cm", "radius": "4 cm"}, (0.05, 0.04)),
    ],
)
def test_a_comparison_has_a_spacing_and_a_radius(
    stated: dict[str, str], expected: tuple[float, float], monkeypatch
) -> None:
    taken: list[float] = []

    def cores(_: object, __: object, *lengths: float) -> None:
        taken.extend(lengths)
        raise StopIteration

    monkeypatch.setattr("amulor.site.change.distances._cores", cores)
    site: Any = SimpleNamespace(
        epoch=[SimpleNamespace(name=name) for name in ("one", "two")],
        scan=[SimpleNamespace(name=name) for name in "ab"],
        comparison=Comparison(**stated),
    )
    cloud: Any = SimpleNamespace(
        of_epoch=lambda _: np.ones(4, dtype=bool),
        moving=np.zeros(4, dtype=bool),
        normal=np.ones((4, 3)),
    )
    surfaces: Any = {
        "a": SimpleNamespace(spacing=0.01),
        "b": SimpleNamespace(spacing=0.004),
    }
    with pytest.raises(StopIteration):
        change(site, cast(Any, None), surfaces, cloud)
    assert taken == pytest.approx(expected)


def test_points_near_a_region_of_four_points_are_not_unchanged(monkeypatch) -> None:
    count = 40
    position = np.zeros((count, 3))
    position[:, 0] = 0.01 * np.arange(count)
    still = SimpleNamespace(
        value=np.where(np.arange(count) == 39, np.nan, 0.0), position=position,
        significant=np.zeros(count, dtype=bool), radius=0.02,
    )  # fmt: skip
    groups = [np.arange(4), np.arange(20, 23)]
    monkeypatch.setattr(distances, "_groups", lambda _: groups)
    # Within two radii of the first region: its points and four more. Three points are
    # no region, and a point without a value is not known to be unchanged.
    expected = (np.arange(count) > 7) & (np.arange(count) < 39)
    found = distances._unchanged(still)
    assert (
        found[np.arange(count) != 7].tolist()
        == expected[np.arange(count) != 7].tolist()
    )
