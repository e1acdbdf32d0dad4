"""Parts of the joint fit: which scans overlap, what is corrected, what disagrees."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import cKDTree

from amulor.errors import CubeError
from amulor.site.registration import align, network
from amulor.site.registration.network import Centre, KnownPoint, State, Ties
from amulor.site.registration.pose import ScanPose

AT_HOME = ScanPose(np.eye(3), np.zeros(3))


def at(*position: float) -> ScanPose:
    return ScanPose(np.eye(3), np.array(position))


def centre(target: str, scan: str) -> Centre:
    return Centre(
        target=target, scan=scan, position=np.array([0.0, 0.0, 2.0]),
        covariance=np.eye(3), shared={},
    )  # fmt: skip


def test_a_target_begins_where_the_first_scan_sees_it_or_at_its_control_point() -> None:
    ties = Ties(
        start={},
        centres=[centre("A", "s"), centre("A", "t"), centre("B", "t")],
        control={
            name: KnownPoint(position=np.array([9.0, 9.0, 9.0]), sigma=np.ones(3))
            for name in ("B", "C")
        },
    )
    found = align._first_positions(ties, {"s": at(1, 0, 0), "t": at(0, 1, 0)})
    assert {name: place.tolist() for name, place in found.items()} == {
        "A": [1, 0, 2], "B": [0, 1, 2], "C": [9, 9, 9]
    }  # fmt: skip


def flat(step: float, count: int = 40) -> Any:
    """Return a scan of a flat square of points, all smooth."""
    x, y = np.meshgrid(np.arange(count) * step, np.arange(count) * step)
    position = np.stack([x, y, 0 * x + 2.0], axis=-1)
    smooth = np.ones(x.shape, dtype=bool)
    return SimpleNamespace(position=position, smooth=smooth, spacing=step)


def neighbours(
    surfaces: dict[str, Any], poses: dict[str, ScanPose], overlap: float = 0.1
) -> list[tuple[str, str]]:
    trees = {
        name: cKDTree(surface.position.reshape(-1, 3))
        for name, surface in surfaces.items()
    }
    return align._neighbours(surfaces, poses, trees, overlap)


@pytest.mark.parametrize(
    ("shift", "expected"),
    # Of 40 columns 4 are a tenth; three spacings of the other scan count as on it.
    [(33.01, 1), (39.01, 0), (38.95, 1), (60.0, 0)],
)
def test_scans_overlap_by_the_part_of_points_near_others(
    shift: float, expected: int
) -> None:
    surfaces = {"a": flat(0.1), "b": flat(0.1)}
    poses = {"a": AT_HOME, "b": at(0.1 * shift, 0, 0)}
    assert len(neighbours(surfaces, poses)) == expected


def test_the_scan_with_the_wider_spacing_is_compared_with_the_other() -> None:
    surfaces = {"fine": flat(0.05, 80), "wide": flat(0.1), "same": flat(0.1)}
    poses = dict.fromkeys(surfaces, AT_HOME)
    assert neighbours(surfaces, poses) == [
        ("wide", "fine"), ("same", "fine"), ("wide", "same")
    ]  # fmt: skip


def test_poses_and_not_the_axes_of_instruments_decide_on_the_overlap() -> None:
    surfaces = {"a": flat(0.1), "b": flat(0.1)}
    there = ScanPose(np.diag([-1.0, -1.0, 1.0]), np.array([53.9, 23.9, 1.0]))
    # The second scan is turned by half a turn about the middle of the square.
    assert neighbours(surfaces, {"a": at(50, 20, 1), "b": there}, 0.99)
    assert not neighbours(surfaces, {"a": at(50, 20, 1), "b": at(53.9, 23.9, 1)}, 0.1)
    assert not neighbours(surfaces, {"a": at(50, 20, 1.31), "b": there}, 0.01)
    assert neighbours(surfaces, {"a": at(50, 20, 1.29), "b": there}, 0.99)


@pytest.mark.parametrize(
    ("overlaps", "ties", "alone"),
    [
        ([("a", "b")], Ties(start={}), "c"),
        ([("a", "b"), ("c", "b")], Ties(start={}), None),
        ([("a", "b")], Ties(start={}, fixed="c"), None),
        ([], Ties(start=dict.fromkeys("abc", None)), None),  # type: ignore[arg-type]
        ([("a", "b")], Ties(start={}, centres=[centre("T", "c")]), "c"),
        (
            [("a", "b")],
            Ties(start={}, centres=[centre("T", "c"), centre("T", "a")]),
            None,
        ),
        (
            [("a", "b")],
            Ties(
                start={},
                centres=[centre("T", "c")],
                control={"T": KnownPoint(position=np.ones(3), sigma=np.ones(3))},
            ),
            None,
        ),
    ],
)
def test_a_scan_without_overlap_start_or_common_target_is_refused(
    overlaps: list[tuple[str, str]], ties: Ties, alone: str | None
) -> None:
    if alone is None:
        align._refuse_islands("abc", overlaps, ties)
    else:
        with pytest.raises(CubeError, match=f"scan '{alone}': overlaps no other scan"):
            align._refuse_islands("abc", overlaps, ties)


def test_one_scan_alone_is_no_island() -> None:
    align._refuse_islands("a", [], Ties(start={}))


def ranged(*shapes: list[float]) -> Any:
    """Return a scan with ranges of 2 m and 4 m, and one that cannot be used."""
    keys = tuple(f"key {number}" for number in range(len(shapes)))
    return SimpleNamespace(
        usable=np.array([True, True, False]), distance=np.array([2.0, 4.0, 1.0]),
        shared=SimpleNamespace(keys=keys, shapes=np.array(shapes)),
    )  # fmt: skip


def test_the_largest_effect_of_an_error_is_a_part_of_a_usable_range() -> None:
    surface = ranged([2e-3, -8e-3, 9.0], [-4e-3, 4e-3, 0.0])
    assert_allclose(align._largest_parts(surface), [2e-3, 2e-3])


@pytest.mark.parametrize(
    ("estimate", "removed", "expected"),
    # One standard deviation is 1 mm of 2 m; a thousandth of the range is 2 mm.
    [(2.1, 0.0, True), (-2.1, 0.0, True), (1.9, 0.0, False), (1.9, -0.2, True),
     (4.0, 2.1, False), (4.2, 2.0, True)],
)  # fmt: skip
def test_errors_above_a_thousandth_of_a_range_are_corrected(
    estimate: float, removed: float, expected: bool
) -> None:
    surface = ranged([1e-3, 1e-3, 0.0])
    state = State({}, {}, {"key 0": estimate})
    bounds = {"a": align._largest_parts(surface)}
    found = align._much_to_correct({"a": surface}, state, {"key 0": removed}, bounds)
    assert found is expected


def test_errors_that_compensate_each_other_are_not_corrected() -> None:
    surface = ranged([2e-3, 2e-3, 0.0], [2e-3, 2e-3, 0.0])
    for second, expected in ((-2.0, False), (2.0, True)):
        state = State({}, {}, {"key 0": 2.0, "key 1": second})
        none = {"key 0": 0.0, "key 1": 0.0}
        bounds = {"a": align._largest_parts(surface)}
        found = align._much_to_correct({"a": surface}, state, none, bounds)
        assert found is expected


def test_pairs_are_compared_at_earlier_points_with_what_is_left_of_the_errors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[dict[str, Any]] = []

    def compared(source: Any, target: Any, poses: Any, **how: Any) -> Any:
        given.append({"ends": (source.name, target.name), "poses": poses, **how})
        used = {"a": 20, "b": 19}.get(source.name)
        return None if used is None else SimpleNamespace(used=used)

    monkeypatch.setattr(align, "compared", compared)
    surfaces: Any = {
        name: SimpleNamespace(name=name, shared=SimpleNamespace(keys=("range",)))
        for name in "abcd"
    }
    poses = {name: at(number, 0, 0) for number, name in enumerate("abcd")}
    state = State(poses, {}, {"range": 0.5, "turn": 0.7})
    before: Any = [
        SimpleNamespace(
            source="a", target="d", source_pixel=np.array([4, 5, 6]),
            weight=np.array([0.0, 1.0, 2.0]),
        )
    ]  # fmt: skip
    pairs = align._pairs(
        surfaces, [("a", "d"), ("b", "d"), ("c", "d")], state,
        {"range": 0.2, "turn": 0.0}, dict.fromkeys("abcd", "tree"),  # type: ignore[arg-type]
        0.3, before, 70,
    )  # fmt: skip
    # Of the others one has too few points, and one has none.
    assert [pair.used for pair in pairs] == [20]
    assert [one["ends"] for one in given] == [("a", "d"), ("b", "d"), ("c", "d")]
    assert given[1]["poses"] == (poses["b"], poses["d"])
    assert given[0]["errors"] == pytest.approx({"range": 0.3, "turn": 0.7})
    assert given[0]["among"].tolist() == [5, 6]
    assert given[1]["among"] is None
    assert {(one["gate"], one["most"], one["tree"]) for one in given} == {
        (0.3, 70, "tree")
    }


@pytest.mark.parametrize(
    ("held", "size", "limit"),
    # One chi-square of 10,000 is above 15.137 with one number, 27.856 with six.
    [(1, 1.0, 15.1367), (6, 2.0, 27.8563)],
)
def test_a_pair_beyond_one_chance_of_ten_thousand_has_less_weight(
    monkeypatch: pytest.MonkeyPatch, held: int, size: float, limit: float
) -> None:
    pair: Any = SimpleNamespace(
        source="a", target="b", held=np.diag([1.0] * held + [0.0] * (6 - held))
    )
    spread = np.diag([size**2] + [0.0] * 5)
    for score in (0.999 * limit, 1.001 * limit, 4 * limit):
        change = np.array([size * np.sqrt(score), 0.0, 0.0, 0.0, 0.0, 0.0])
        monkeypatch.setattr(network, "innovation", lambda *_, c=change: (c, spread))
        state: Any = None
        (weight,), against = align._pair_weights([pair], state, {})
        assert weight == pytest.approx(min(1.0, np.sqrt(limit / score)), rel=1e-4)
        assert len(against) == (score > limit)
    (worst,) = against
    assert worst.scans == ("a", "b")
    assert worst.trust == weight
    assert worst.shift == pytest.approx(size * np.sqrt(4 * limit))
    assert worst.turn == 0.0
    assert worst.score == pytest.approx(4 * limit / held)


def test_shift_and_turn_of_a_disagreement_are_lengths_of_vectors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    change = np.array([3.0, 0.0, 4.0, 0.0, 1.2, 0.5])
    monkeypatch.setattr(network, "innovation", lambda *_: (change, 1e-4 * np.eye(6)))
    pair: Any = SimpleNamespace(source="a", target="b", held=np.eye(6))
    state: Any = None
    _, (worst,) = align._pair_weights([pair], state, {})
    assert worst.shift == pytest.approx(5.0)
    assert worst.turn == pytest.approx(1.3)
