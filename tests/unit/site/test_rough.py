"""Rough alignment: which guesses are tried, and which of them is taken."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from amulor.errors import CubeError
from amulor.site.registration import rough
from amulor.site.registration.network import KnownPose, Ties
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.rough import rough_poses, squared_pull

AT_HOME = ScanPose(np.eye(3), np.zeros(3))


def known(
    pose: ScanPose = AT_HOME, *, place: float = 0.1, turn: float = 0.02
) -> KnownPose:
    covariance = np.diag([place**2] * 3 + [turn**2] * 3)
    return KnownPose(pose=pose, covariance=covariance)


def steps_of(guesses: list[ScanPose]) -> list[list[float]]:
    """Return translations and turns, in order."""
    turns = [Rotation.from_matrix(guess.rotation).as_rotvec() for guess in guesses]
    return [[*one.position, *turn] for one, turn in zip(guesses, turns, strict=True)]


def test_further_guesses_are_one_standard_deviation_aside() -> None:
    cloud = np.tile([0.0, 0.0, 4.0], (5, 1))
    guesses = rough._further_guesses(known(), 0.05, cloud)
    expected = [
        [0, 0, 0, 0, 0, -0.02], [0, 0, 0, 0, 0, 0.02], [-0.1, 0, 0, 0, 0, 0],
        [0.1, 0, 0, 0, 0, 0], [0, -0.1, 0, 0, 0, 0], [0, 0.1, 0, 0, 0, 0],
    ]  # fmt: skip
    assert_allclose(steps_of(guesses), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("least", "count"),
    # At 4 m a turn of 20 mrad is 80 mm; the position has 100 mm.
    [(0.079, 6), (0.081, 4), (0.099, 4), (0.101, 0)],
)
def test_a_guess_within_the_spacing_is_none(least: float, count: int) -> None:
    cloud = np.tile([0.0, 0.0, 4.0], (5, 1))
    assert len(rough._further_guesses(known(), least, cloud)) == count


def test_the_pull_is_the_chi_square_of_the_departure() -> None:
    moved = AT_HOME.changed(np.array([0.2, 0.0, -0.1, 0.0, 0.06, 0.0]))
    assert squared_pull(moved, known()) == pytest.approx(2**2 + 1**2 + 3**2)


def grid(side: int, *middle: float) -> np.ndarray:
    """Return a flat grid of steps of 0.1 m."""
    x, y = np.meshgrid(np.arange(side) * 0.1, np.arange(side) * 0.1)
    return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1) + np.array(middle)


@pytest.mark.parametrize(
    ("height", "expected"),
    [(0.0, 0.0), (0.025, 0.25), (0.08, 0.8), (0.15, 1.0), (1.0, 1.0)],
)
def test_the_misfit_is_the_distance_from_planes_in_spacings(
    height: float, expected: float
) -> None:
    others = grid(31, 0.0, 0.0, 0.0)
    placed = grid(11, 1.02, 1.03, height)
    # The same on a slope, far from the origin.
    turn = Rotation.from_rotvec([0.5, -0.3, 0.0]).as_matrix()
    for pose in (AT_HOME, ScanPose(turn, np.array([4.0, 7.0, -5.0]))):
        there = pose.place(others)
        found = rough._misfit(pose.place(placed), there, cKDTree(there), 0.1)
        assert found == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("count", "away", "expected"), [(8, 0.39, 0.0), (7, 0.39, 1.0), (8, 0.41, 1.0)]
)
def test_a_plane_needs_eight_points_within_four_spacings(
    count: int, away: float, expected: float
) -> None:
    angle = 2 * np.pi * np.arange(count) / count
    others = away * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    found = rough._misfit(np.zeros((1, 3)), others, cKDTree(others), 0.1)
    assert found == pytest.approx(expected, abs=1e-9)


def test_points_without_neighbors_count_as_far() -> None:
    others = grid(31, 0.0, 0.0, 0.0)
    placed = np.concatenate([grid(10, 1.02, 1.03, 0.05), grid(5, 90.0, 0.0, 0.0)])
    found = rough._misfit(placed, others, cKDTree(others), 0.1)
    # 25 of 125 points are far, the others half a spacing away.
    assert found == pytest.approx(0.2 + 0.8 * 0.5)


def bed(rng: np.random.Generator, count: int) -> np.ndarray:
    x, y = rng.uniform(-1.5, 1.5, (2, count))
    return np.stack([x, y, 0.2 * np.sin(3 * x) * np.cos(2 * y) + 0.1 * y], axis=1)


def surface(points: np.ndarray, **more: Any) -> Any:
    position = points[None]
    return SimpleNamespace(
        position=position, usable=np.ones(position.shape[:2], dtype=bool),
        spacing=0.04, **more,
    )  # fmt: skip


def test_a_large_scan_is_thinned_by_rows_and_columns() -> None:
    position = np.zeros((300, 400, 3))
    position[..., 0], position[..., 1] = np.mgrid[:300, :400]
    usable = np.ones((300, 400), dtype=bool)
    usable[0, 0] = False
    points, step = rough._thinned(SimpleNamespace(position=position, usable=usable))
    # 120,000 points, of which 20,000 are used: each third row and column.
    assert step == 3
    assert len(points) == 100 * 134 - 1
    assert np.all(points[:, :2] % 3 == 0)
    few, step = rough._thinned(
        SimpleNamespace(position=position[:100, :200], usable=usable[:100, :200])
    )
    assert (len(few), step) == (100 * 200 - 1, 1)
    half, step = rough._thinned(
        SimpleNamespace(position=position[:200, :200], usable=usable[:200, :200])
    )
    assert (len(half), step) == (100 * 100 - 1, 2)


def test_scans_are_placed_by_their_overlap_and_others_stay() -> None:
    rng = np.random.default_rng(11)
    at = {
        "a": ScanPose(np.eye(3), np.array([0.0, 0.0, 2.0])),
        "b": ScanPose(
            Rotation.from_rotvec([0, 0, 0.3]).as_matrix(), np.array([0.4, 0.2, 2.1])
        ),
        "far": ScanPose(np.eye(3), np.array([50.0, 0.0, 2.0])),
    }
    clouds = {name: bed(rng, 5000) for name in at}
    clouds["far"] = clouds["far"] + [50.0, 0.0, 0.0]
    surfaces: Any = {name: surface(at[name].back(clouds[name])) for name in at}
    off = np.array([0.05, -0.04, 0.02, 0.01, -0.01, 0.03])
    ties = Ties(
        start={
            "a": known(at["a"], place=1e-3),
            "b": known(at["b"].changed(off)),
            "far": known(at["far"].changed(off)),
        }
    )
    found = rough_poses(surfaces, ties, voxel=None, guess={})
    assert list(found) == ["a", "b", "far"]
    assert_allclose(found["a"].position, at["a"].position)
    # Of 45 mm and 30 mrad, some millimeters are left.
    assert np.linalg.norm(found["b"].position - at["b"].position) < 0.01
    assert_allclose(found["b"].rotation, at["b"].rotation, atol=4e-3)
    # Nothing is near the third scan: it stays where it was stated.
    assert_allclose(found["far"].position, at["far"].changed(off).position)


def test_a_guess_replaces_a_start_pose_and_a_fixed_scan_is_the_origin() -> None:
    rng = np.random.default_rng(12)
    surfaces: Any = {name: surface(bed(rng, 3000)) for name in ("a", "b")}
    ties = Ties(start={"b": known(AT_HOME.changed(np.full(6, 9.0)))}, fixed="a")
    found = rough_poses(surfaces, ties, voxel=0.08, guess={"b": AT_HOME})
    assert_allclose(found["a"].matrix, np.eye(4))
    assert np.linalg.norm(found["b"].position) < 0.02


def test_a_scan_that_nothing_places_is_named() -> None:
    surfaces: Any = dict.fromkeys("ab", None)
    with pytest.raises(CubeError, match="scan 'b': nothing tells about where it stood"):
        rough_poses(surfaces, Ties(start={"a": known()}), voxel=None, guess={})


class Calls:
    """Stands in place of the alignment of one scan, and keeps what it is given."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.given: list[dict[str, Any]] = []
        monkeypatch.setattr(rough, "_rough_pose", self)

    def __call__(self, cloud: Any, others: Any, *more: Any, **how: float) -> ScanPose:
        self.given.append({"cloud": len(cloud), "others": len(others), **how})
        return AT_HOME


def half(side: int) -> np.ndarray:
    """Return which points of a small scan are near: each second, without the first."""
    return np.arange(side) % 2 == 1


@pytest.mark.parametrize(
    ("near", "height", "is_aligned"),
    [
        # Of 1,000 points, 21 or 19 are within 0.25 m of others.
        (np.arange(1000) < 21, 0.0, True),
        (np.arange(1000) < 19, 0.0, False),
        (half(1000), 0.24, True),
        (half(1000), 0.26, False),
        # Of a large scan some points are looked at, and not the first ones alone.
        (np.arange(9000) > 3000, 0.0, True),
    ],
)
def test_a_scan_is_aligned_if_a_fiftieth_of_it_is_near_others(
    monkeypatch: pytest.MonkeyPatch, near: np.ndarray, height: float, is_aligned: bool
) -> None:
    calls = Calls(monkeypatch)
    points = np.zeros((len(near), 3))
    points[:, 2] = np.where(near, height, 99.0)
    surfaces: Any = {"a": surface(np.zeros((50, 3))), "b": surface(points)}
    start = AT_HOME.changed(np.array([1e-3, 0, 0, 0, 0, 0]))
    ties = Ties(start={"a": known(place=0.01), "b": known(start)})
    found = rough_poses(surfaces, ties, voxel=None, guess={})
    assert found["b"].position[0] == (0.0 if is_aligned else 1e-3)
    assert len(calls.given) == is_aligned
    if is_aligned:
        # Voxels are two spacings wide.
        assert calls.given[0] == {
            "cloud": len(near), "others": 50, "voxel": 0.08, "spacing": 0.04
        }  # fmt: skip


def test_each_second_point_near_others_is_half_of_a_scan(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Scan "b" is near by its even points, "c" by 30 %: "b" is placed before "c".
    calls = Calls(monkeypatch)
    shapes = {"a": np.ones(10), "b": half(1000), "c": np.arange(1001) % 10 < 3}
    surfaces: Any = {
        name: surface(np.outer(np.where(near, 0.0, 99.0), [0.0, 0.0, 1.0]))
        for name, near in shapes.items()
    }
    ties = Ties(start={"a": known(place=0.01), "b": known(), "c": known()})
    rough_poses(surfaces, ties, voxel=0.5, guess={})
    assert [given["cloud"] for given in calls.given] == [1000, 1001]
    assert [given["others"] for given in calls.given] == [10, 1010]
    assert {given["voxel"] for given in calls.given} == {0.5}


class Attempts:
    """Poses in place of alignments, with misfits that are stated."""

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        misfits: list[float],
        pulls: tuple[float, ...] = (2.0, 4.0, 6.0),
    ) -> None:
        self.misfits, self.pulls = misfits, list(pulls)
        self.reaches: list[float] = []
        self.judges: list[int] = []
        monkeypatch.setattr(rough, "aligned", self.aligned)
        monkeypatch.setattr(rough, "_misfit", self.misfit)

    def aligned(self, *_: Any, reach: float, voxel: float) -> ScanPose:
        self.reaches.append(reach)
        return AT_HOME.changed(np.array([0.1 * self.pulls.pop(0), 0, 0, 0, 0, 0]))

    def misfit(self, placed: np.ndarray, *_: Any) -> float:
        self.judges.append(len(placed))
        return self.misfits.pop(0)

    def found(self, count: int, start: KnownPose | None, spacing: float) -> ScanPose:
        cloud, nothing = np.zeros((count, 3)), None
        return rough._rough_pose(
            cloud, cloud, nothing, AT_HOME, start, voxel=0.1, spacing=spacing
        )  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("misfits", "last", "expected"),
    [
        # Guess, then the attempts; the last one is an unlikely place, as 6^2 is 36 and
        # 1e-4 of chi-squares of 6 numbers are above 27.86.
        ([0.9, 0.3, 0.2, 0.25], 6.0, 0.4),
        ([0.9, 0.3, 0.2, 0.11], 6.0, 0.4),
        ([0.9, 0.3, 0.2, 0.11], 5.29, 0.4),
        ([0.9, 0.3, 0.2, 0.11], 5.27, 0.527),
        # All likely ones are twice as far as the unlikely one, or far themselves.
        ([0.9, 0.3, 0.25, 0.11], 6.0, 0.6),
        ([0.9, 0.8, 0.7, 0.45], 6.0, 0.6),
        ([0.9, 0.8, 0.52, 0.45], 6.0, 0.6),
        ([0.9, 0.8, 0.49, 0.45], 6.0, 0.4),
        ([0.1, 0.8, 0.49, 0.45], 6.0, 0.0),
    ],
)
def test_an_unlikely_pose_is_taken_only_if_no_likely_one_fits(
    monkeypatch: pytest.MonkeyPatch, misfits: list[float], last: float, expected: float
) -> None:
    attempts = Attempts(monkeypatch, misfits, (2.0, 4.0, last))
    # No guess is further than three spacings of 50 mm.
    found = attempts.found(10, known(), 0.05)
    assert found.position[0] == pytest.approx(expected)
    assert attempts.judges == [10] * 4


def test_guesses_beside_an_uncertain_start_are_tried_with_the_largest_reach(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    attempts = Attempts(monkeypatch, [0.9] * 7 + [0.1], tuple(range(7)))
    # 100 mm of two coordinates are more than three spacings.
    found = attempts.found(10, known(), 0.03)
    assert attempts.reaches == [0.25, 0.1, 0.05, 0.25, 0.25, 0.25, 0.25]
    # The last one is unlikely, and four times as good as any other one.
    assert found.position[0] == pytest.approx(0.6)


def test_points_that_rank_poses_are_some_of_each_part(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    attempts = Attempts(monkeypatch, [0.5, 0.4, 0.3, 0.35])
    found = attempts.found(7400, None, 0.1)
    # Each fourth point: at least 1,500. Without a start pose, the best one is taken.
    assert attempts.judges == [1850] * 4
    assert attempts.reaches == [0.25, 0.1, 0.05]
    assert found.position[0] == pytest.approx(0.4)
