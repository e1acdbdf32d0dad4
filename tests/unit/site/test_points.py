"""Points of merged scans: derivatives, covariances, weights, and what is seen."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from amulor.site.merging import cloud
from amulor.site.merging.cloud import (
    by_unknowns,
    covariances,
    derivatives,
    seen_by_others,
    unknowns_of,
)
from amulor.site.registration.pose import ScanPose

POSE = ScanPose(Rotation.from_rotvec([0.4, -0.3, 0.8]).as_matrix(), np.arange(3.0))


def test_derivatives_of_points_are_those_of_finite_steps() -> None:
    rng = np.random.default_rng(1)
    local = rng.normal([0, 0, 3.0], 0.5, (6, 3))
    beam = local / np.linalg.norm(local, axis=1, keepdims=True)
    shapes = rng.normal(size=(2, 6))
    moved = rng.normal(size=(1, 6, 3))
    found = derivatives(POSE, POSE.place(local), POSE.turn(beam), shapes, moved)
    assert found.shape == (6, 3, 9)
    step = 1e-6
    for number in range(6):
        change = np.zeros(6)
        change[number] = step
        off = POSE.changed(change).place(local) - POSE.place(local)
        assert_allclose(found[:, :, number], off / step, atol=1e-5)
    for number in range(2):
        # A range that is measured too long by an error is corrected by less.
        nearer = POSE.place(local - step * shapes[number][:, None] * beam)
        off = (nearer - POSE.place(local)) / step
        assert_allclose(found[:, :, 6 + number], off, atol=1e-8)
    off = POSE.place(local - step * moved[0]) - POSE.place(local)
    assert_allclose(found[:, :, 8], off / step, atol=1e-8)


def test_a_covariance_is_that_of_drawn_unknowns_and_noise() -> None:
    rng = np.random.default_rng(2)
    slope = rng.normal(size=(2, 3, 4))
    root = rng.normal(size=(4, 4))
    beam = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
    sigma = np.array([0.5, 2.0])
    found = covariances(slope, root @ root.T, sigma, beam)
    draws = 40_000
    unknowns = rng.normal(size=(draws, 4)) @ root.T
    noise = sigma * rng.normal(size=(draws, 2))
    points = np.einsum("nij,dj->dni", slope, unknowns) + noise[..., None] * beam
    for number in range(2):
        drawn = np.cov(points[:, number].T)
        scale = np.sqrt(np.outer(drawn.diagonal(), drawn.diagonal()))
        # Correlations of so many draws have an error of 0.005.
        assert_allclose(found[number] / scale, drawn / scale, atol=0.03)


def pixels(rows: int = 12, columns: int = 16, distance: float = 2.0) -> Any:
    """Return a scan of a wall across its middle beam, from a place off its origin."""
    x, y = np.meshgrid(
        0.01 * (np.arange(columns) - columns // 2), 0.01 * (np.arange(rows) - rows // 2)
    )
    ahead = np.stack([x, y, 1 + 0 * x], axis=-1)
    reach = np.linalg.norm(ahead, axis=-1)
    usable = np.ones((rows, columns), dtype=bool)
    return SimpleNamespace(
        usable=usable, origin=np.broadcast_to([0.2, -0.1, 0.3], ahead.shape),
        direction=ahead / reach[..., None], distance=distance * reach,
        own=np.full((rows, columns), 1e-3), spacing=0.01 * distance, motion=None,
        normal=np.tile([0.0, 0.0, -1.0], (rows, columns, 1)), keys=("delay",),
        shared=SimpleNamespace(
            keys=("delay",), shapes=2e-3 * np.ones((1, rows, columns))
        ),
        moved=lambda pixel, points: np.zeros((0, len(pixel), 3)),
    )  # fmt: skip


def test_derivatives_of_pixels_have_their_beams_and_errors() -> None:
    scan = pixels()
    number = np.array([5, 100])
    points = (scan.origin + scan.distance[..., None] * scan.direction).reshape(-1, 3)
    found = by_unknowns(scan, POSE, POSE.place(points[number]), number)
    beam = POSE.turn(scan.direction.reshape(-1, 3)[number])
    assert_allclose(found[:, :, 6], -2e-3 * beam)
    assert_allclose(found[:, :, :3], np.broadcast_to(np.eye(3), (2, 3, 3)))
    assert unknowns_of("s", scan) == ("pose s", "error delay")


def test_the_nearest_beam_is_that_through_a_point() -> None:
    scan = pixels()
    number = np.array([3, 40, 150, 191])
    chosen = np.flatnonzero(scan.usable.ravel() & (np.arange(192) % 3 != 0))
    beams = scan.direction.reshape(-1, 3)[number]
    points = scan.origin.reshape(-1, 3)[number] + 1.7 * beams
    near, place = cloud._nearest_beams(scan, points, np.arange(192))
    assert_allclose(near, 0.0, atol=1e-12)
    assert_array_equal(place, number)
    near, place = cloud._nearest_beams(scan, points, chosen)
    # Pixels left out have the next one beside them.
    assert_array_equal(near > 5e-3, number % 3 == 0)
    # ... or the next one above or below.
    assert set(np.abs(chosen[place] - number)) <= {0, 1, 15, 16, 17}


@pytest.mark.parametrize(("pixels_off", "is_near"), [(5.8, True), (6.2, False)])
def test_beams_further_than_six_pixels_are_none(
    pixels_off: float, is_near: bool
) -> None:
    scan = pixels()
    last = scan.direction[6, -1].copy()
    away = last / last[2] + np.array([0.01 * pixels_off, 0.0, 0.0])
    point = scan.origin[0, 0] + 1.9 * away
    near, _ = cloud._nearest_beams(scan, point[None], np.arange(192))
    assert np.isfinite(near[0]) == is_near


@pytest.mark.parametrize(
    ("off", "sigma", "own", "confirms", "sees_through"),
    [
        # Four errors, 4 (3, 4) = 20 mm, confirm a point on either side.
        (19e-3, 3e-3, 4e-3, True, False),
        (-19e-3, 3e-3, 4e-3, True, False),
        (21e-3, 3e-3, 4e-3, False, False),
        # Nearer by six errors and three spacings of 20 mm, a beam went through it.
        (-61e-3, 3e-3, 4e-3, False, True),
        (-59e-3, 3e-3, 4e-3, False, False),
        (-74e-3, 1e-2, 8e-3, False, False),
        (-79e-3, 1e-2, 8e-3, False, True),
        (90e-3, 3e-3, 4e-3, False, False),
    ],
)
def test_points_are_confirmed_or_seen_through_by_their_errors(
    monkeypatch: pytest.MonkeyPatch,
    off: float, sigma: float, own: float, confirms: bool, sees_through: bool,
) -> None:  # fmt: skip
    scan = pixels()
    scan.own = np.full((12, 16), own)
    facing = 1.0

    def on_grid(surface: Any, local: np.ndarray, number: np.ndarray) -> Any:
        direction = np.tile([0.0, 0.0, 1.0], (len(local), 1))
        return SimpleNamespace(
            pixel=number, direction=direction, distance=np.full(len(local), off),
            inside=np.array([True, False]),
        )  # fmt: skip

    monkeypatch.setattr(cloud, "on_grid", on_grid)
    beams = scan.direction.reshape(-1, 3)[[100, 101]]
    points = POSE.place(scan.origin.reshape(-1, 3)[:2] + (2 + off) * beams)
    confirmed, through = seen_by_others(
        "a", {"a": scan, "b": scan}, {"b": POSE}, points, np.full(2, sigma * facing)
    )
    # The second one is not on the grid of the other scan.
    assert_array_equal(confirmed, [confirms, False])
    assert_array_equal(through, [sees_through, False])


@pytest.mark.parametrize(("facing", "counts"), [(0.16, 1), (0.14, 0)])
def test_a_grazing_beam_confirms_nothing(
    monkeypatch: pytest.MonkeyPatch, facing: float, counts: int
) -> None:
    scan = pixels()
    scan.normal[...] = [(1 - facing**2) ** 0.5, 0.0, -facing]

    def on_grid(surface: Any, local: np.ndarray, number: np.ndarray) -> Any:
        direction = np.tile([0.0, 0.0, 1.0], (len(local), 1))
        return SimpleNamespace(
            pixel=number, direction=direction, inside=np.ones(len(local), dtype=bool),
            # On a slant an error across the surface is longer along the beam.
            distance=np.full(len(local), 3.9 * 1e-3 / 0.16),
        )  # fmt: skip

    monkeypatch.setattr(cloud, "on_grid", on_grid)
    point = POSE.place(scan.origin[0, :1] + 2 * scan.direction[5, :1])
    confirmed, _ = seen_by_others(
        "a", {"b": scan}, {"b": POSE}, point, np.array([1e-3])
    )
    assert confirmed[0] == counts


def site_of(*epochs: str) -> Any:
    names = dict.fromkeys(epochs)
    return SimpleNamespace(
        epoch=[SimpleNamespace(name=name) for name in names],
        scan=[SimpleNamespace(epoch=name) for name in epochs],
    )


def grid(side: int, *shift: float) -> np.ndarray:
    x, y = np.meshgrid(0.1 * np.arange(side), 0.1 * np.arange(side))
    return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1) + np.array(shift)


def test_weights_are_by_precision_among_the_scans_of_a_visit() -> None:
    # Scans 0 and 1 of one visit, beside each other by half of a spacing, and 2 of
    # another; a corner of scan 1 is far from scan 0.
    parts = [grid(6, 0, 0, 0), grid(6, 0.05, 0.0, 0.0), grid(6, 0, 0, 0)]
    parts[1][0] = [0.0, 0.0, 5.0]
    position = np.concatenate(parts)
    scan = np.repeat([0, 1, 2], 36)
    sigma = np.repeat([1e-3, 2e-3, 1e-3], 36)
    moving = np.zeros(108, dtype=bool)
    moving[7] = True
    share = cloud._shares(site_of("one", "one", "two"), position, scan, sigma, moving)
    # Precisions of 4 and 1; points that move have no part in it.
    assert_allclose(share[[1, 8, 20]], 0.8)
    assert share[7] == 1.0
    assert share[36] == 1.0
    assert_allclose(share[38:72].min(), 0.2)
    assert_allclose(share[72:], 1.0)


@pytest.mark.parametrize(("off", "expected"), [(0.149, 0.5), (0.151, 1.0)])
def test_points_within_one_and_a_half_spacings_are_at_one_place(
    off: float, expected: float
) -> None:
    position = np.concatenate([grid(6, 0, 0, 0), grid(6, 0, 0, off)])
    scan, sigma = np.repeat([0, 1], 36), np.full(72, 1e-3)
    none = np.zeros(72, dtype=bool)
    share = cloud._shares(site_of("one", "one"), position, scan, sigma, none)
    assert_allclose(share, expected)
