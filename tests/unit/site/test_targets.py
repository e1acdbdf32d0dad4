"""Discs, checkerboards, picked points and control points have the errors stated."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation
from scipy.special import erf
from site_scenes import scanning

from amulor.errors import CubeError
from amulor.site.description import (
    CheckerboardTarget,
    DiscTarget,
    PointTarget,
)
from amulor.site.registration import network
from amulor.site.registration.centres import centre_of
from amulor.site.registration.network import (
    Centre,
    KnownDistance,
    KnownPoint,
    KnownPose,
    State,
    Ties,
)
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.reliability import reliabilities
from amulor.site.registration.surface import scan_surface, shared_errors

ERRORS = scanning.Errors(own=5e-4, delay=1e-3, index=2e-4, reference=5e-4)
ROWS, COLUMNS = 60, 78
#: Reflectances of the fields of a board and of what stands behind [1].
DARK, BRIGHT = 0.004, 0.01


class Board:
    """A plane piece in front of a wall, seen from the origin, somewhere and somehow."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.azimuth, self.elevation, unit = scanning.grid(ROWS, COLUMNS, 0.09)
        self.centre = np.array([0.02, -0.02, 2.0]) + rng.uniform(-0.01, 0.01, 3)
        tilt = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3))
        self.axes = tilt.as_matrix()
        normal = self.axes[2]
        self.plane = (self.centre @ normal) / (unit @ normal)
        self.wall = 2.6 / unit[..., 2]
        # Where each beam meets the plane, in its own axes.
        self.flat = (self.plane[..., None] * unit - self.centre) @ self.axes[:2].T
        at = np.argmin(np.linalg.norm(self.flat, axis=-1))
        self.row, self.column = (int(n) for n in np.unravel_index(at, (ROWS, COLUMNS)))

    def image(
        self, rng: np.random.Generator, inside: np.ndarray, bright: np.ndarray | float
    ) -> xr.Dataset:
        true = np.where(inside, self.plane, self.wall)
        draw = scanning.Draw(rng)
        image = scanning.image(
            true, self.azimuth, self.elevation, errors=ERRORS, draw=draw, scan="a"
        )
        level = np.where(inside, bright, DARK)
        level = level * (1 + 0.02 * rng.normal(size=true.shape))
        return image.assign(intensity=image["intensity"].copy(data=level))

    def found(self, target: Any, image: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
        """Return how far the centre is off, and the covariance stated."""
        shared = shared_errors(image, scan="a", instrument="i", water="w")
        surface = scan_surface(image, name="a", shared=shared)
        centre, _ = centre_of(target, surface, image, self.row, self.column)
        spread = centre.covariance + sum(
            np.outer(shift, shift) for shift in centre.shared.values()
        )
        return centre.position - self.centre, spread


def held(scores: list[float], freedom: int, *, least: float = 0.5) -> None:
    """Assert that chi-squares have the mean of their degrees of freedom."""
    error = np.sqrt(2 * freedom / len(scores))
    mean = float(np.mean(scores))
    assert least * freedom < mean < freedom + 4 * error
    # One in 10,000 draws is so large.
    assert max(scores) < freedom + 8 * np.sqrt(2 * freedom)


def disc(diameter: float) -> DiscTarget:
    return DiscTarget.model_validate(
        {
            "kind": "disc", "name": "D", "diameter": diameter,
            "diameter_uncertainty": 1e-3,
            "places": [{"scan": "a", "row": 30, "column": 39}],
        }
    )  # fmt: skip


def board(width: float) -> CheckerboardTarget:
    return CheckerboardTarget.model_validate(
        {
            "kind": "checkerboard", "name": "C", "width": width,
            "places": [{"scan": "a", "row": 30, "column": 39}],
        }
    )  # fmt: skip


@pytest.mark.parametrize("shared", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_middle_of_a_disc_has_the_error_that_is_stated(
    monkeypatch: pytest.MonkeyPatch, shared: bool
) -> None:
    if not shared:
        monkeypatch.setitem(
            globals(), "ERRORS", scanning.Errors(5e-4, 1e-9, 1e-9, 1e-9)
        )
    rng = np.random.default_rng(21)
    scores = []
    for _ in range(25):
        scene = Board(rng)
        inside = np.linalg.norm(scene.flat, axis=-1) < 0.08
        off, spread = scene.found(disc(0.16), scene.image(rng, inside, BRIGHT))
        scores.append(float(off @ np.linalg.solve(spread, off)))
        # Rims are settled to a part of a pixel.
        assert np.sqrt(np.linalg.eigvalsh(spread)[:2]).max() < 1e-3
    held(scores, 3)


# Beams as wide as their distance (4.6 mm from pixel to pixel), and far narrower ones.
@pytest.mark.parametrize(
    ("blur", "least"),
    [
        pytest.param(3.5e-3, 0.5, marks=pytest.mark.slow),
        pytest.param(0.1e-3, 0.1, marks=pytest.mark.slow),
    ],
)
def test_the_middle_of_a_checkerboard_has_the_error_that_is_stated(
    blur: float, least: float
) -> None:
    rng = np.random.default_rng(22)
    scores = []
    for _ in range(20):
        scene = Board(rng)
        inside = (np.abs(scene.flat) < 0.1).all(axis=-1)
        edges = erf(scene.flat / (np.sqrt(2) * blur)).prod(axis=-1)
        bright = (BRIGHT + DARK) / 2 + (BRIGHT - DARK) / 2 * edges
        off, spread = scene.found(board(0.2), scene.image(rng, inside, bright))
        scores.append(float(off @ np.linalg.solve(spread, off)))
    # Fields sharper than pixels may have an edge between two rows of them, or not.
    held(scores, 3, least=least)


def test_a_disc_of_another_size_and_a_board_without_fields_are_refused() -> None:
    rng = np.random.default_rng(23)
    scene = Board(rng)
    inside = np.linalg.norm(scene.flat, axis=-1) < 0.08
    image = scene.image(rng, inside, BRIGHT)
    with pytest.raises(CubeError, match=r"16\d mm wide, stated are 200 mm|15\d mm"):
        scene.found(disc(0.2), image)
    with pytest.raises(CubeError, match="no dark and bright fields"):
        scene.found(board(0.1), image)


def test_a_picked_point_has_the_error_of_the_picking() -> None:
    rng = np.random.default_rng(24)
    scores = []
    picking = 0.012  # two to three pixels
    target = PointTarget.model_validate(
        {
            "kind": "point", "name": "P", "picking_uncertainty": picking,
            "places": [{"scan": "a", "row": 30, "column": 39}],
        }
    )  # fmt: skip
    for _ in range(60):
        scene = Board(rng)
        # A board that fills the view: the point is seen on a slant.
        image = scene.image(rng, np.ones(scene.plane.shape, dtype=bool), BRIGHT)
        pitch = 0.18 / (COLUMNS - 1) * np.linalg.norm(scene.centre)
        steps = np.rint(picking / pitch * rng.normal(size=2)).astype(int)
        scene.row += steps[0]
        scene.column += steps[1]
        off, spread = scene.found(target, image)
        scores.append(float(off @ np.linalg.solve(spread, off)))
    held(scores, 3)


def test_control_points_and_a_scale_bar_place_a_scan_within_what_is_stated() -> None:
    rng = np.random.default_rng(25)
    places = {
        "A": np.array([-1.0, 0.2, 2.5]), "B": np.array([0.9, -0.4, 2.2]),
        "C": np.array([0.1, 0.8, 3.1]), "D": np.array([0.3, -0.7, 1.8]),
    }  # fmt: skip
    pose = ScanPose(*scanning.looking((1.0, 2.0, 3.0), (0.0, 0.0, 0.0)))
    world = {name: pose.place(point[None])[0] for name, point in places.items()}
    index, scores, scales, residuals = 2e-3, [], [], []
    start = KnownPose(pose=pose, covariance=np.diag([1.0] * 3 + [0.1] * 3))
    noise = np.diag([1e-3, 2e-3, 5e-4]) ** 2
    sigma = np.array([2e-3, 2e-3, 4e-3])
    length = float(np.linalg.norm(world["A"] - world["B"]))
    for _ in range(100):
        scale = rng.normal()
        centres = [
            Centre(
                target=name, scan="s", covariance=noise,
                shared={"index": index * point},
                position=point * (1 + index * scale)
                + np.sqrt(noise.diagonal()) * rng.normal(size=3),
            )
            for name, point in places.items()
        ]  # fmt: skip
        control = {
            name: KnownPoint(position=point + sigma * rng.normal(size=3), sigma=sigma)
            for name, point in world.items()
            if name != "D"
        }
        bar = KnownDistance(
            ends=("A", "B"), length=length + 1e-3 * rng.normal(), sigma=1e-3
        )
        ties = Ties(start={"s": start}, centres=centres, control=control, bars=[bar])
        state = State({"s": pose}, dict(world), {"index": 0.0})
        for _ in range(4):
            state = network.step(state, [], ties, []).state
        spread, _, layout = network.covariance(state, [], ties, [], {})
        lines = reliabilities(state, spread, layout, ties)
        residuals.append([line.score for line in lines])
        # 6 of the start, 1 of the index, 12 of targets, 9 of control, 1 of the bar,
        # less 6, 12 and 1 unknowns.
        assert sum(line.redundancy for line in lines) == pytest.approx(10, abs=0.01)
        placed = state.poses["s"]
        turn = Rotation.from_matrix(placed.rotation @ pose.rotation.T).as_rotvec()
        wrong = np.zeros(layout.size)
        wrong[layout.at["pose", "s"]] = np.concatenate(
            [placed.position - pose.position, turn]
        )
        for name, point in world.items():
            wrong[layout.at["point", name]] = state.points[name] - point
        wrong[layout.at["error", "index"]] = state.errors["index"] - scale
        scores.append(float(wrong @ np.linalg.solve(spread, wrong)))
        scales.append(float(spread[layout.at["error", "index"]][0, -1]))
    # Six of the pose, twelve of the targets, one of the index.
    held(scores, 19, least=0.9)
    # Standardized residuals have the variance 1: 100 draws know it to 0.14 each.
    checked = np.array([line.detectable is not None for line in lines])
    # The start was not drawn.
    checked[:6] = False
    spreads = np.sqrt(np.mean(np.square(residuals), axis=0))[checked]
    assert np.abs(spreads - 1).max() < 0.35
    # Without any other error one of the minimal detectable size has the standardized
    # residual 3.2905 + 0.8416: the quantiles of 1e-3, both sides, and of 80 percent.
    (line,) = (x for x in lines if (x.observation, x.part) == ("control B", "north"))
    assert line.detectable is not None
    exact = {
        name: KnownPoint(position=world[name] + 0.0, sigma=sigma) for name in control
    }
    exact["B"].position[1] += line.detectable
    plain = [
        replace(centre, position=places[centre.target].copy()) for centre in centres
    ]
    bar = KnownDistance(ends=("A", "B"), length=length, sigma=1e-3)
    ties = Ties(start={"s": start}, centres=plain, control=exact, bars=[bar])
    state = State({"s": pose}, dict(world), {"index": 0.0})
    for _ in range(6):
        state = network.step(state, [], ties, []).state
    spread, _, layout = network.covariance(state, [], ties, [], {})
    by_name = {
        (x.observation, x.part): x for x in reliabilities(state, spread, layout, ties)
    }
    # The size is that of a draw, whose targets lay some millimetres elsewhere.
    assert abs(by_name["control B", "north"].score) == pytest.approx(4.132, rel=0.06)
    assert by_name["control B", "north"].residual < 0
    # All other values are exact, so what the error changes of the pose is its shift.
    assert line.external_scan == "s"
    assert line.external == pytest.approx(
        np.linalg.norm(state.poses["s"].position - pose.position), rel=0.06
    )
    # The bar tells the index better than it was known.
    assert max(scales) < 0.3


def test_a_pivot_moves_as_both_poses_carry_it() -> None:
    rng = np.random.default_rng(3)
    place, turn = rng.normal(size=(2, 3)), rng.normal(size=(2, 3))
    shift, pivot = rng.normal(size=(2, 3)), rng.normal(size=3)
    poses = {
        name: ScanPose(np.eye(3), position)
        for name, position in zip("ab", place, strict=True)
    }
    state = State(poses, {}, {"delay": 0.0})
    layout = network.Layout(state, None)
    pair = SimpleNamespace(source="a", target="b", pivot=pivot, keys=("delay",))
    at, spread = network.pair_unknowns(pair, state, layout)
    change = np.zeros(layout.size)
    for name, move, rotation in zip("ab", shift, turn, strict=True):
        change[layout.at["pose", name]] = [*move, *rotation]
    change[layout.at["error", "delay"]] = 0.7
    first, second = shift + np.cross(turn, pivot - place)
    expected = [*(first - second), *(turn[0] - turn[1]), 0.7]
    np.testing.assert_allclose(spread @ change[at], expected)
