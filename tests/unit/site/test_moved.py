"""What scans of a moved body tell together of its motion, and what they do not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import underwater_sites as oracle
from drawn_sites import known_registration, two_visits

from amulor.cli.site import _region, region_sentence
from amulor.site.change import moved
from amulor.site.change.distances import Region
from amulor.site.change.moved import motion_of
from amulor.site.registration.bodies import held_directions, of_size_one
from amulor.site.registration.pair import Pair
from amulor.site.registration.pose import ScanPose

RADIUS, LENGTH = 0.1, 0.4
MIDDLE = np.array([1.0, 2.0, 3.0])


def pair_of(first: float, last: float, **changes: Any) -> Pair:
    """Return what two scans tell of a tube along x that they see from a side [rad]."""
    along, around = np.meshgrid(
        np.linspace(-LENGTH / 2, LENGTH / 2, 9), np.linspace(first, last, 12)
    )
    normal = np.stack([0 * around, np.cos(around), np.sin(around)], axis=-1)
    place = RADIUS * normal + along[..., None] * [1.0, 0.0, 0.0]
    place, normal = place.reshape(-1, 3) + MIDDLE, normal.reshape(-1, 3)
    pivot = place.mean(axis=0)
    rows = np.hstack([normal, np.cross(place - pivot, normal)])
    size = len(rows)
    fields = {
        "source": "b", "target": "a", "keys": (), "pivot": pivot, "place": place,
        "distance": np.zeros(size), "weight": np.full(size, 1e6), "by_target": rows,
        "by_source": rows, "along": np.ones(size), "source_pixel": np.arange(size),
        "target_pixel": np.zeros(size, dtype=int), "along_apart": np.ones(size),
        "target_pixel_apart": np.zeros(size, dtype=int),
        "patches": None, "off": np.zeros((size, 2)), "misfit": 1.0, "held": np.eye(6),
        "loose": (), "unsure": 1e-3, "moved": np.zeros(0, dtype=int),
    }  # fmt: skip
    return Pair(**{**fields, **changes})


@pytest.mark.parametrize("sides", [[(0.2, 1.0), (1.4, 2.4)], [(0.0, 3.0)]])
def test_a_tube_tells_neither_its_slide_nor_its_turn_about_its_axis(
    sides: list[tuple[float, float]],
) -> None:
    held, loose = moved._held([pair_of(*side) for side in sides], MIDDLE)
    # Both lie in what was found: a slide along x, a turn about x through the middle.
    assert len(loose) == 2
    for motion in ([1.0, 0, 0, 0, 0, 0], [0, 0, 0, 1.0, 0, 0]):
        np.testing.assert_allclose(held @ motion, 0.0, atol=1e-9)
        share = np.linalg.lstsq(np.stack(loose, axis=1), motion, rcond=None)[1]
        np.testing.assert_allclose(share, 0.0, atol=1e-12)
    # All else is held as it is.
    for motion in np.eye(6)[[1, 2, 4, 5]]:
        np.testing.assert_allclose(held @ motion, motion, atol=1e-9)


def test_what_single_pairs_do_not_hold_is_no_matter_where_others_do() -> None:
    sides = [(0.2, 1.0), (1.4, 2.4)]
    # Each by itself would leave out other directions; together they are not asked.
    spoiled = [np.diag([0.0, 0, 1, 1, 1, 1]), np.diag([0.0, 1, 0, 1, 1, 1])]
    pairs = [pair_of(*side) for side in sides]
    other = [pair_of(*side, held=one) for side, one in zip(sides, spoiled, strict=True)]
    for whole, one in zip(
        moved._sums(pairs, MIDDLE, np.eye(6), steady=False),
        moved._sums(other, MIDDLE, np.eye(6), steady=False),
        strict=True,
    ):
        np.testing.assert_array_equal(whole, one)


def test_errors_of_pairs_that_hold_a_motion_add_in_squares(monkeypatch) -> None:
    stated: list[float] = []

    def noted(matrix: Any, *, unsure: float, length: float) -> Any:
        stated.append(unsure)
        return held_directions(matrix, unsure=unsure, length=length)

    monkeypatch.setattr(moved, "held_directions", noted)
    pairs = [pair_of(0.2, 1.0, unsure=3e-3), pair_of(1.4, 2.4, unsure=4e-3)]
    moved._held(pairs, MIDDLE)
    assert stated == [pytest.approx(5e-3, rel=1e-12)]


@pytest.mark.parametrize("length", [0.05, 0.4, 3.0])
def test_free_motions_have_the_length_1_at_the_larger_part(length: float) -> None:
    # Rows of translation and rotation that an information matrix leaves free: a turn
    # about x, a shift along y, and screws along z whose turn moves the surface by 0.3
    # and 2 times the shift.
    turn = np.array([0.0, 0, 0, 1, 0, 0])
    shift = np.array([0.0, 1, 0, 0, 0, 0])
    slow = np.array([0.0, 0, 1, 0, 0, 0.3 / length])
    fast = np.array([0.0, 0, length / 2, 0, 0, 1.0])
    for motion in (turn, shift, slow, fast):
        # Any matrix whose null space is the motion constrains all others.
        rest = np.linalg.svd(motion[None])[2][1:]
        held, loose = held_directions(1e6 * rest.T @ rest, unsure=1e-3, length=length)
        assert len(loose) == 1
        np.testing.assert_allclose(
            loose[0] * np.sign(loose[0] @ motion), motion, atol=1e-9
        )
        np.testing.assert_allclose(held @ motion, 0.0, atol=1e-6)


def test_a_free_motion_has_the_variance_of_a_motion_as_large_as_the_fitted() -> None:
    # A turn about x at a distance of 0.2 m counts like a shift of 0.2 m per radian.
    turn = of_size_one(np.array([0.0, 0, 0, 5.0, 0, 0]), 0.2)
    slide = of_size_one(np.array([0.0, 3.0, 0, 0.1, 0, 0]), 0.2)
    np.testing.assert_allclose(turn, [0, 0, 0, 1, 0, 0])
    np.testing.assert_allclose(slide, [0, 1, 0, 0.1 / 3, 0, 0])
    # 3 mm, and 20 mrad at 0.2 m are 4 mm: together 5 mm, or 25 mrad.
    spread = moved._free(
        (turn,), np.array([0.003, 0, 0]), np.array([0, 0, 0.02]), length=0.2
    )
    np.testing.assert_allclose(spread, np.diag([0, 0, 0, 0.025**2, 0, 0]), atol=1e-18)


def test_components_along_a_free_axis_are_named_as_not_known() -> None:
    axis = np.array([0.6, 0.8, 0.0])
    motion = moved.Motion(
        centre=np.zeros(3), shift=np.array([0.01, 0, 0]), turn=np.array([0, 0, 0.1]),
        covariance=np.diag([1e-8] * 3 + [1e-6] * 3),
        loose=(np.concatenate([np.zeros(3), axis]),), points=100, misfit=1.0,
    )  # fmt: skip
    assert list(motion.undetermined) == [False, False, False, True, True, False]
    assert moved.free_motions(motion) == "turn about (+0.60, +0.80, +0.00)"
    region = Region(
        members=np.arange(4), centre=np.zeros(3), reach=0.1, area=0.01,
        area_uncertainty=0.0, mean=0.0, mean_uncertainty=1.0, largest=0.0, volume=0.0,
        volume_uncertainty=1.0, lost=0.0,
    )  # fmt: skip
    content = _region(region, 0, {0: motion})["motion"]
    assert content["uncertainty"] == pytest.approx([1e-4] * 3 + [None, None, 1e-3])
    sentence = region_sentence(0, region, {0: motion})
    assert sentence.endswith("not known: turn about (+0.60, +0.80, +0.00)")


def test_regions_without_a_motion_state_why() -> None:
    rng = np.random.default_rng(2)
    flat = oracle.Scene((oracle.Bed(),))
    drawn = two_visits(flat, flat, rng, rows=24)
    reason = motion_of(
        drawn.site, known_registration(drawn), drawn.surfaces,
        epochs=("one", "two"), centre=np.zeros(3), reach=0.2,
    )  # fmt: skip
    # On a plane nothing is 20 mm above the ground; the first visit is looked at first.
    assert reason == (
        "no scan of one has 20 pixels of an object at least 20 mm above the ground "
        "around it"
    )
    region = Region(
        members=np.arange(4), centre=np.zeros(3), reach=0.1, area=0.01,
        area_uncertainty=0.0, mean=0.0, mean_uncertainty=1.0, largest=0.0, volume=0.0,
        volume_uncertainty=1.0, lost=0.0,
    )  # fmt: skip
    assert _region(region, 0, {0: reason})["no_motion"] == reason
    sentence = region_sentence(0, region, {0: reason})
    assert sentence.endswith(f"no motion of an object: {reason}")


@pytest.mark.slow
def test_all_components_of_a_rolled_amphora_have_the_errors_stated() -> None:
    rng = np.random.default_rng([9, 5])
    ground = oracle.Bed((), (0.02, 0.03))
    heading = oracle.rotation((0, 0, 1), rng.uniform(0, 6))
    body = oracle.Amphora((0.0, 0.0, 0.12), heading, 0.4)
    # A body of revolution does not show its roll.
    shift, turn = np.array([0.01, -0.012, 0.003]), np.radians([3.0, 4.0, 3.0])
    drawn = two_visits(
        oracle.Scene((ground, body)),
        oracle.Scene((ground, body.moved(shift, turn))),
        rng,
        rows=90,
        noise=oracle.Noise(own=1e-3, delay=1e-5, index=1e-6, reference=1e-5),
    )
    motion = motion_of(
        drawn.site,
        known_registration(drawn),
        drawn.surfaces,
        epochs=("one", "two"),
        centre=np.array(body.place),
        reach=0.45,
    )
    assert isinstance(motion, moved.Motion)
    assert motion.undetermined[3:].any()
    angle = float(np.linalg.norm(turn))
    spin = oracle.rotation(tuple(turn / angle), angle) - np.eye(3)
    true = np.concatenate([shift + spin @ (motion.centre - body.place), turn])
    off = np.concatenate([motion.shift, motion.turn]) - true
    assert np.all(np.abs(off) < 4 * np.sqrt(motion.covariance.diagonal()))


@pytest.mark.slow
def test_shift_and_turn_of_an_amphora_hold_at_the_point_that_is_named() -> None:
    rng = np.random.default_rng(3)
    ground = oracle.Bed((), (0.02, 0.03))
    body = oracle.Amphora((0.0, 0.0, 0.12), oracle.rotation((0, 0, 1), 0.5), 0.4)
    shift, turn = np.array([0.024, -0.018, 0.0]), np.array([0.0, 0.0, np.radians(5)])
    later = body.moved(shift, turn)
    drawn = two_visits(
        oracle.Scene((ground, body)),
        oracle.Scene((ground, later)),
        rng,
        rows=90,
        noise=oracle.Noise(own=1e-3, delay=1e-5, index=1e-6, reference=1e-5),
    )
    known = known_registration(drawn)
    motion = motion_of(
        drawn.site,
        known,
        drawn.surfaces,
        epochs=("one", "two"),
        centre=np.array(body.place),
        reach=0.45,
    )
    assert isinstance(motion, moved.Motion)
    # The point is in the object, and the motion is that of this point.
    assert np.linalg.norm(motion.centre - body.place) < 0.15
    spin = oracle.rotation((0, 0, 1), np.radians(5)) - np.eye(3)
    true = np.concatenate([shift + spin @ (motion.centre - body.place), turn])
    off = np.concatenate([motion.shift, motion.turn]) - true
    sigma = np.sqrt(motion.covariance.diagonal())
    told = (
        np.linalg.norm(
            np.array([one / np.linalg.norm(one) for one in motion.loose]).reshape(
                -1, 6
            ),
            axis=0,
        )
        < 0.1
    )
    assert np.all(np.abs(off[told]) < 4 * sigma[told] + 1e-6)
    assert (
        abs(motion.distance - np.linalg.norm(true[:3]))
        < 4 * motion.distance_uncertainty
    )
    assert abs(motion.angle - np.radians(5)) < 4 * motion.angle_uncertainty
    assert motion.angle_uncertainty < np.radians(0.5)


def test_a_hollow_and_a_heap_side_by_side_are_one_body() -> None:
    def region(east: float, reach: float, area: float) -> Region:
        return Region(
            members=np.arange(4), centre=np.array([east, 0.0, 0.0]), reach=reach,
            area=area, area_uncertainty=0.0, mean=0.0, mean_uncertainty=1.0,
            largest=0.0, volume=0.0,
            volume_uncertainty=1.0, lost=0.0,
        )  # fmt: skip

    places = [region(0.0, 0.1, 0.03), region(1.0, 0.1, 0.02), region(0.15, 0.1, 0.01)]
    assert moved.bodies(places) == ((0, 2), (1,))
    middle, reach = moved.around([places[0], places[2]])
    np.testing.assert_allclose(middle, [0.15 / 4, 0, 0])
    assert reach == pytest.approx(0.15 * 3 / 4 + 0.1)


def test_an_object_stands_on_ground_that_is_rough_and_has_holes() -> None:
    rng = np.random.default_rng(6)
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 51), np.linspace(-0.5, 0.5, 51))
    away = np.hypot(x, y)
    # A slope with 3 mm of noise, a block of 10 cm, another beside it, and a hole.
    ground = 0.1 * x + 3e-3 * rng.standard_normal(x.shape)
    height = np.where(away < 0.1, 0.1, 0.0) + np.where(
        np.abs(x - 0.28) < 0.03, 0.2, 0.0
    )
    height -= np.where(np.abs(y + 0.28) < 0.02, 0.3, 0.0)
    points = np.stack([x, y, ground + height - 2.0], axis=-1)
    surface = SimpleNamespace(
        distance=np.ones(x.shape), origin=points, direction=np.zeros((51, 51, 3)),
        usable=np.ones(x.shape, dtype=bool), motion=None,
    )  # fmt: skip
    place = SimpleNamespace(
        poses={"a": ScanPose(rotation=np.eye(3), position=np.zeros(3))}, errors={}
    )
    found = _object(surface, place, np.array([0.0, 0.0, -2.0]), 0.2)
    assert found is not None
    # All of the block, and no more than some pixels of the rough ground.
    assert found[away < 0.1].all()
    assert not found[away > 0.23].any()
    assert found[(away > 0.1) & (away < 0.2)].mean() < 0.01
    surface.usable = away > 1.0
    assert _object(surface, place, np.array([0.0, 0.0, -2.0]), 0.2) is None


def _object(surface, place, centre, reach):
    # A scan without shared errors has no range corrections.
    shapes = np.zeros((0, *surface.usable.shape))
    surface.shared = SimpleNamespace(keys=(), shapes=shapes)
    return moved._object(surface, place, "a", centre, reach)


@pytest.mark.parametrize(("count", "is_ground"), [(27, False), (28, True)])
def test_the_ground_around_an_object_has_thirty_points(
    count: int, is_ground: bool
) -> None:
    angle = 2 * np.pi * np.arange(count) / count
    ring = np.stack([0.3 * np.cos(angle), 0.3 * np.sin(angle), 0 * angle], axis=1)
    # One point stands 21 mm above it, one 19 mm; two are beyond the reach of 0.2 m,
    # and among those around it.
    body = [[0.0, 0.0, 0.021], [0.01, 0.0, 0.019], [0.21, 0.0, 0.1], [0.23, 0.0, 0.1]]
    points = np.concatenate([ring, body])[None]
    surface = SimpleNamespace(
        distance=np.ones(points.shape[:2]), origin=points,
        direction=np.zeros(points.shape), motion=None,
        usable=np.ones(points.shape[:2], dtype=bool),
    )  # fmt: skip
    place = SimpleNamespace(
        poses={"a": ScanPose(rotation=np.eye(3), position=np.zeros(3))}, errors={}
    )
    found = _object(surface, place, np.zeros(3), 0.2)
    if is_ground:
        # Its reach is 1.1 times 0.2 m.
        assert found[0, count:].tolist() == [True, False, True, False]
        assert not found[0, :count].any()
    else:
        assert found is None


@pytest.mark.parametrize("axis", range(6))
def test_a_turn_counts_as_the_shift_of_points_at_the_stated_distance(axis: int) -> None:
    length, unsure = 0.4, 2.0
    # Six times what is unsure, in m^-2, or per square of a turn of 1 m at the distance.
    limit = 6 * unsure * (1.0 if axis < 3 else length**2)
    for factor, free in ((0.999, 1), (1.001, 0)):
        matrix = np.diag(np.full(6, 1e6))
        matrix[axis, axis] = factor * limit
        assert len(held_directions(matrix, unsure=unsure, length=length)[1]) == free
