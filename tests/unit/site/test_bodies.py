"""What moved against the rest of a pair of scans, and what did not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import sparse
from scipy.special import ndtri

from amulor.site.registration import bodies
from amulor.site.registration.bodies import Points, moved_bodies

#: Pixels of the source: a scene of 20 x 30 and, a column away, a body of 20 x 5.
SHAPE = (20, 36)
OWN, PATCH = 1e-3, 0.4e-3


def scene(seed: int, *, flat: bool = False) -> tuple[Points, np.ndarray]:
    """Return points with normals of all directions, and their noise [m]."""
    rng = np.random.default_rng(seed)
    smooth = np.ones(SHAPE, dtype=bool)
    smooth[:, 30] = False
    pixel = np.flatnonzero(smooth)
    count = len(pixel)
    place = np.column_stack([rng.uniform(-1, 1, (count, 2)), np.zeros(count)])
    normal = np.column_stack([np.zeros((count, 2)), np.ones(count)])
    if not flat:
        normal[:, :2] = rng.uniform(-0.8, 0.8, (count, 2))
        place[:, 2] = rng.uniform(-0.3, 0.3, count)
    shared = np.column_stack([0.5e-3 * np.cos(3 * place[:, 0]), np.full(count, 1e-3)])
    rows = np.hstack([normal, np.cross(place, normal), shared])
    # Patches share pixels, also those of the body and of what is around it.
    at = rng.integers(0, 250, (count, 6))
    starts = np.arange(count + 1) * 6
    window = sparse.csr_matrix(
        (rng.uniform(0.5, 1.5, count * 6) * PATCH / 6**0.5, at.ravel(), starts),
        shape=(count, 250),
    )
    window.sum_duplicates()
    noise = np.full(count, OWN)
    drawn = noise * rng.normal(size=count) + window @ rng.normal(size=250)
    drawn = drawn + shared @ rng.normal(size=2)
    points = Points(
        smooth=smooth, pixel=pixel, lever=place, distance=drawn,
        corrected=np.zeros(count),
        variance=np.array([noise**2, np.asarray(window.power(2).sum(axis=1)).ravel()]),
        by_target=rows, by_source=rows, noise=noise, window=window,
        tilt=np.full(count, 1e-6), together=12.0,
    )  # fmt: skip
    return points, drawn


def found(points: Points, distance: np.ndarray) -> np.ndarray:
    weight = 1 / points.variance.sum(axis=0)
    kept = np.ones(len(distance), dtype=bool)
    seen = Points(**{**vars(points), "distance": distance})
    return moved_bodies(seen, weight, kept, misfit=1.0)


def is_body(points: Points) -> np.ndarray:
    return np.asarray(points.pixel % SHAPE[1] > 30)


@pytest.mark.parametrize("seed", range(4))
def test_a_body_whose_points_all_pass_for_noise_is_found_whole(seed: int) -> None:
    points, distance = scene(seed)
    body = is_body(points)
    # By 2.2 mm sideways: no point is off by two standard errors because of it.
    moved = distance + 2.2e-3 * np.where(body, points.by_target[:, 0], 0.0)
    np.testing.assert_array_equal(found(points, moved), body)
    assert not found(points, distance).any()


@pytest.mark.parametrize("seed", range(3))
def test_where_the_scans_stand_has_no_part_in_it(seed: int) -> None:
    points, distance = scene(seed)
    pose = np.array([4e-3, -3e-3, 2e-3, 2e-3, -1e-3, 3e-3])
    away = distance + points.by_target[:, :6] @ pose
    assert not found(points, away).any()
    moved = away + 2.5e-3 * np.where(is_body(points), points.by_target[:, 1], 0.0)
    np.testing.assert_array_equal(found(points, moved), is_body(points))


def test_what_stayed_is_called_moved_as_often_as_chance_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Patches and shared errors that body and scene have in common count, too.
    monkeypatch.setattr(bodies, "_CHANCE", 0.1)
    share = np.mean([found(*scene(seed)).any() for seed in range(100, 400)])
    assert share == pytest.approx(0.1, abs=4 * np.sqrt(0.1 * 0.9 / 300))


@pytest.mark.parametrize("slide", [0.01, 0.3])
def test_scans_may_slide_where_nothing_but_the_body_holds_them(slide: float) -> None:
    # A flat bed: that the body stands aside may as well be where the scans stand.
    points, _ = scene(1, flat=True)
    rng = np.random.default_rng(5)
    body = is_body(points)
    rows = points.by_target.copy()
    normal = rows[:, :3]
    normal[body, :2] = rng.uniform(-0.8, 0.8, (int(body.sum()), 2))
    rows[:, 3:6] = np.cross(points.lever, normal)
    bent = Points(**{**vars(points), "by_target": rows, "by_source": rows})
    aside = points.distance + slide * rows[:, 0]
    assert not found(bent, aside).any()
    # But not that it stands higher.
    higher = aside + np.where(body, 1.5e-3, 0.0)
    np.testing.assert_array_equal(found(bent, higher), body)


def test_the_largest_body_is_the_scene() -> None:
    points, distance = scene(2)
    moved = distance + np.where(is_body(points), 0.0, 3e-3 * points.by_target[:, 0])
    np.testing.assert_array_equal(found(points, moved), is_body(points))


def test_a_body_of_which_much_stands_off_has_moved_and_one_with_an_edge_has_not() -> (
    None
):
    points, _ = scene(3)
    body = is_body(points)
    for share, moved in ((0.1, False), (0.5, True)):
        kept = np.ones(len(body), dtype=bool)
        kept[np.flatnonzero(body)[: int(share * body.sum())]] = False
        weight = 1 / points.variance.sum(axis=0)
        # What was left out does not count, however far it stands off.
        seen = Points(**{**vars(points), "distance": points.distance + 0.5 * ~kept})
        got = moved_bodies(seen, weight, kept, misfit=1.0)
        np.testing.assert_array_equal(got, body & moved)


@pytest.mark.parametrize(
    ("count", "scatter", "misfit"),
    # By chance 20 points scatter by up to 1 + 3 x 1.17 / sqrt(10) = 2.1.
    [(20, 1.8, 1.0), (20, 2.5, 2.5), (20_000, 1.0, 1.0), (20_000, 1.1, 1.1)],
)
def test_more_scatter_than_by_chance_is_a_misfit(count, scatter, misfit) -> None:
    # Quantiles of a normal distribution: their scatter is the stated one.
    score = ndtri((np.arange(count) + 0.5) / count)
    score /= 1.4826 * np.median(np.abs(score))
    variance = np.array([np.full(count, 3e-6), np.full(count, 1e-6)])
    points: Any = SimpleNamespace(
        variance=variance, distance=2e-3 * scatter * score + 1e-3,
        pixel=np.arange(count),
    )  # fmt: skip
    good = np.arange(count) != 3
    found = bodies.counted(points, good, 1.0)
    assert found.misfit == pytest.approx(misfit, rel=0.1 if count < 100 else 0.01)
    assert found.weight[3] == 0
    np.testing.assert_allclose(found.weight[good], 1 / (2e-3 * found.misfit) ** 2)
    assert found.moved.size == 0


@pytest.mark.parametrize("steps", [(1, 1), (2, 3), (3, 1)])
@pytest.mark.parametrize(("shift", "is_moved"), [(1.2, True), (0.9, False)])
def test_points_that_are_displaced_with_their_neighbors_have_moved(
    steps: tuple[int, int], shift: float, is_moved: bool
) -> None:
    # Each second or third pixel is compared; 25 neighbors have a fifth of the noise of
    # one, so that 5 standard errors are one.
    rows, columns = (step * np.arange(30) for step in steps)
    row, column = (grid.ravel() for grid in np.meshgrid(rows, columns, indexing="ij"))
    smooth = np.ones((steps[0] * 30, steps[1] * 30), dtype=bool)
    points: Any = SimpleNamespace(
        variance=np.array([np.full(900, 1e-6), np.full(900, 1e-14)]), smooth=smooth,
        pixel=row * smooth.shape[1] + column,
    )  # fmt: skip
    inside = (np.abs(row / steps[0] - 15) < 4) & (np.abs(column / steps[1] - 12) < 4)
    score = np.where(inside, shift, 0.0)
    good = np.ones(900, dtype=bool)
    found = bodies._offset_together(points, score, good, 1.0)
    assert found[inside].any() == is_moved
    # Two more on each side may go with it.
    near = (np.abs(row / steps[0] - 15) < 7) & (np.abs(column / steps[1] - 12) < 7)
    assert not found[~near].any()
    # With twice the scatter, it is noise.
    assert not bodies._offset_together(points, score, good, 2.0).any()
