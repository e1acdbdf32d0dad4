"""Points of stated looks that count: shares, passing objects, and agreement."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.site.registration import sight
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.sight import (
    Looks,
    _Look,
    absent_points,
    pairs_seen_through,
)


def look(
    front: int | list[int], *, count: int = 1000, distance: float = 0.1,
    closely: list[int] | None = None,
) -> _Look:  # fmt: skip
    """Return points of which the first ones, or those named, are in front."""
    flags, close = (np.zeros(count, dtype=bool) for _ in range(2))
    flags[range(front) if isinstance(front, int) else front] = True
    close[flags if closely is None else closely] = True
    place = np.zeros((count, 3))
    place[:, 0] = np.arange(count)
    return _Look(
        place=place, compared=np.ones(count, dtype=bool), front=flags, closely=close,
        distance=np.where(flags | close, distance, 0.0), error=np.full(count, 0.01),
    )  # fmt: skip


def looks(of: dict[tuple[str, str], _Look], *, connected: bool = False) -> Looks:
    names = tuple(dict.fromkeys(name for pair in of for name in pair))
    none = {key: look(0) for key in of}
    return Looks(names, none if connected else of, of if connected else {})


@pytest.mark.parametrize(("count", "share"), [(9, 0.0), (10, 0.01), (200, 0.2)])
def test_a_share_needs_ten_points(count: int, share: float) -> None:
    assert look(count).share == share


def test_a_share_is_of_the_points_that_were_compared() -> None:
    some = look(40)
    some.compared[500:] = False
    assert some.share == pytest.approx(0.08)
    chosen = np.arange(1000) < 15
    assert some.share_of(chosen) == pytest.approx(0.03)
    some.compared[:] = False
    assert some.share == 40.0


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    # More than a fiftieth in both directions.
    [(21, 21, 1), (21, 20, 0), (20, 21, 0), (500, 0, 0)],
)
def test_scans_look_through_each_other_in_both_directions(
    first: int, second: int, expected: int
) -> None:
    sights = pairs_seen_through(
        looks({("a", "b"): look(first), ("b", "a"): look(second, distance=0.3)})
    )
    assert len(sights) == expected
    if expected:
        assert sights[0].scans == ("a", "b")
        assert sights[0].shares == (0.021, 0.021)
        # The median of 21 points at 0.1 m and as many at 0.3 m.
        assert sights[0].distance == pytest.approx(0.2)
        assert sights[0].uncertainty == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("first", "second", "expected"), [(99, 0, 0), (101, 0, 1), (51, 50, 1), (50, 50, 0)]
)
def test_connected_scans_have_a_tenth_in_front_in_both_directions_together(
    first: int, second: int, expected: int
) -> None:
    pair = {("a", "b"): look(first), ("b", "a"): look(second)}
    assert len(pairs_seen_through(looks(pair, connected=True))) == expected


def test_a_passing_object_is_in_front_of_all_scans() -> None:
    fish = {(one, two): look(0) for one in "abc" for two in "abc" if one != two}
    # The same points of "a" are in front of both others; those of "b" of "a" alone.
    fish |= {("a", "b"): look(100), ("a", "c"): look(100), ("b", "a"): look(100)}
    assert len(pairs_seen_through(looks(fish))) == 1
    fish["b", "c"] = look(100)
    assert pairs_seen_through(looks(fish)) == ()
    # Other points of the scan with a wrong pose are in front of one scan each.
    fish["a", "c"] = look(list(range(100, 200)))
    (wrong,) = pairs_seen_through(looks(fish))
    assert wrong.scans == ("a", "b")


def surfaces(spacing: float = 1.0) -> Any:
    nothing = SimpleNamespace(
        spacing=spacing, usable=np.ones((1, 1000), dtype=bool), motion=None,
        origin=np.zeros((1, 1000, 3)), distance=np.arange(1000.0)[None],
        direction=np.tile([1.0, 0.0, 0.0], (1, 1000, 1)),
        shared=SimpleNamespace(keys=(), shapes=np.zeros((0, 1, 1000))),
    )  # fmt: skip
    return dict.fromkeys("abc", nothing)


REGISTERED: Any = SimpleNamespace(
    poses=dict.fromkeys("abc", ScanPose(np.eye(3), np.zeros(3))), errors={}
)


@pytest.mark.parametrize(
    ("points", "expected"),
    # Of 2,000 points on which "a" and "b" agree, at least ten and 0.4 % in both.
    [(4, 0), (5, 1), (100, 1)],
)
def test_points_that_two_scans_confirm_are_absent_in_a_third(
    points: int, expected: int
) -> None:
    of = {(one, two): look(0) for one in "abc" for two in "abc" if one != two}
    for name in "ab":
        of[name, "c"] = look(0, closely=list(range(points)), distance=0.2)
    connected = {key: of[key] for key in (("a", "b"), ("b", "a"))}
    found = list(
        absent_points(Looks(("a", "b", "c"), of, connected), surfaces(), REGISTERED)
    )
    assert len(found) == expected
    if expected:
        (absence,) = found
        assert (absence.scan, absence.peers) == ("c", ("a", "b"))
        assert absence.count == 2 * points
        assert absence.share == pytest.approx(2 * points / 2000)
        assert absence.distance == pytest.approx(0.2)
        assert absence.uncertainty == pytest.approx(0.01)


def test_a_few_of_very_many_points_are_no_absence() -> None:
    # 11 of 3,000 are 0.37 %, and 13 are 0.43 %.
    for points, expected in ((11, 0), (13, 1)):
        of = {(one, two): look(0) for one in "ab" for two in "abc" if one != two}
        of |= {("c", "a"): look(0), ("c", "b"): look(0)}
        of["a", "c"] = look(0, closely=list(range(points)), count=3000)
        connected = {("a", "b"): look(0, count=3000)}
        large = {**surfaces(), "b": wide(3000)}
        found = list(
            absent_points(Looks(("a", "b", "c"), of, connected), large, REGISTERED)
        )
        assert len(found) == expected


def wide(count: int) -> Any:
    surface = SimpleNamespace(**vars(surfaces()["a"]))
    surface.usable = np.ones((1, count), dtype=bool)
    surface.origin = np.zeros((1, count, 3))
    surface.distance = np.arange(float(count))[None]
    surface.direction = np.tile([1.0, 0.0, 0.0], (1, count, 1))
    surface.shared = SimpleNamespace(keys=(), shapes=np.zeros((0, 1, count)))
    return surface


@pytest.mark.parametrize(("off", "agree"), [(0.69, 1000), (0.71, 0)])
def test_points_agree_within_seven_tenths_of_the_wider_spacing(
    off: float, agree: int
) -> None:
    one = look(0)
    moved = _Look(
        one.place + np.array([0.0, off, 0.0]), one.compared, one.front, one.closely,
        one.distance, one.error,
    )  # fmt: skip
    wide_and_fine = surfaces()
    wide_and_fine["a"] = SimpleNamespace(**{**vars(wide_and_fine["a"]), "spacing": 0.1})
    masks = sight._agreeing(
        Looks(("a", "b"), {}, {("a", "b"): moved}), wide_and_fine, REGISTERED
    )
    assert int(masks["a", "b"].sum()) == agree


#: Where the beams of a scan begin, in its own axes [m].
BEAMS = np.array([0.3, -0.2, 0.1])


def ranged(distance: np.ndarray, own: float = 1e-3) -> Any:
    """Return a scan with an angle of 10 mrad from pixel to pixel, from `BEAMS`."""
    rows, columns = distance.shape
    x, y = np.meshgrid(
        0.01 * (np.arange(columns) - columns // 2), 0.01 * (np.arange(rows) - rows // 2)
    )
    direction = np.stack([x, y, 1 + 0 * x], axis=-1)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return SimpleNamespace(
        usable=np.isfinite(distance), origin=np.zeros_like(direction) + BEAMS,
        direction=direction, distance=distance, own=np.full(distance.shape, own),
        spacing=0.02, motion=None,
        shared=SimpleNamespace(keys=(), shapes=np.zeros((0, rows, columns))),
    )  # fmt: skip


def test_the_nearest_range_is_of_a_pixel_and_its_neighbors_and_ends_at_gaps() -> None:
    distance = np.full((7, 9), 2.0)
    distance[1, 1], distance[5, 7] = 1.5, np.nan
    none: Any = SimpleNamespace(errors={})
    found = sight._nearest_range(ranged(distance), none).reshape(7, 9)
    expected = np.full((7, 9), -np.inf)
    expected[1:-1, 1:-1] = 2.0
    expected[1:3, 1:3] = 1.5
    expected[4:6, 6:8] = -np.inf
    assert_allclose(found, expected)


@pytest.mark.parametrize(
    ("nearer", "own", "spread", "front", "closely"),
    [
        # Three spacings of 20 mm, or one for points that another scan confirms.
        (0.061, 1e-3, 0.0, True, True),
        (0.059, 1e-3, 0.0, False, True),
        (0.019, 1e-3, 0.0, False, False),
        # Six standard errors: noise of both scans, 1.41 times 10 mm, is 85 mm.
        (0.086, 1e-2, 0.0, True, True),
        (0.084, 1e-2, 0.0, False, False),
        # Of a pose of 15 mm, with the noise: 90.4 mm.
        (0.092, 1e-3, 0.015, True, True),
        (0.089, 1e-3, 0.015, False, False),
    ],
)
def test_a_point_is_in_front_beyond_errors_and_spacings(
    monkeypatch: pytest.MonkeyPatch,
    nearer: float, own: float, spread: float, front: bool, closely: bool,
) -> None:  # fmt: skip
    flat = np.full((9, 9), 2.0)
    of = {"a": ranged(flat - nearer, own), "b": ranged(flat, own)}
    covariance = np.zeros((6, 6))
    covariance[2, 2] = spread**2
    monkeypatch.setattr(sight, "relative_covariance", lambda *_: covariance)
    result: Any = SimpleNamespace(
        poses=dict.fromkeys("ab", ScanPose(np.eye(3), np.zeros(3))),
        errors={}, pairs=({"source": "b", "target": "a"},),
    )  # fmt: skip
    found = sight.looks_of(result, of, ["a", "b"])
    middle = found.looks["a", "b"]
    # Pixels of the rim have no range around them.
    assert int(middle.compared.sum()) == 49
    assert int(middle.front.sum()) == (49 if front else 0)
    assert int(middle.closely.sum()) == (49 if closely else 0)
    assert_allclose(middle.distance[middle.compared], nearer, atol=1e-9)
    error = np.sqrt(2 * own**2 + spread**2)
    assert_allclose(middle.error[middle.compared], error, rtol=1e-9)
    # Behind the surface is not in front of it.
    assert not found.looks["b", "a"].front.any()
    # By noise alone, for scans that the fit connects in whichever order.
    assert found.connected["a", "b"].front.any() == (nearer > max(0.06, 6 * error) or (
        spread > 0
    ))  # fmt: skip
    assert sight.looks_of(result, of, ["a"]).looks == {}
    apart: Any = SimpleNamespace(poses=result.poses, errors={}, pairs=())
    assert sight.looks_of(apart, of, ["a", "b"]).connected == {}
