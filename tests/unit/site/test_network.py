"""Normal equations of scan pairs, against sums over single observations."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

from amulor.site.registration import network
from amulor.site.registration.network import State, Ties
from amulor.site.registration.pose import ScanPose

COUNT, PIXELS = 9, 12
NAMES = ("a", "b", "c")


@pytest.fixture
def state() -> State:
    rng = np.random.default_rng(2)
    poses = {name: ScanPose(np.eye(3), rng.normal(size=3)) for name in NAMES}
    return State(poses, {}, {"delay": 0.3, "index": -0.2})


def made_pair(source: str, target: str, seed: int) -> Any:
    """Return observations of a scan on another with numbers at random."""
    rng = np.random.default_rng(seed)
    window = rng.normal(size=(COUNT, PIXELS)) * (rng.random((COUNT, PIXELS)) < 0.4)
    return SimpleNamespace(
        source=source,
        target=target,
        pivot=rng.normal(size=3),
        keys=("index",),
        by_target=rng.normal(size=(COUNT, 7)),
        by_source=rng.normal(size=(COUNT, 7)),
        weight=rng.uniform(0.5, 2.0, COUNT),
        distance=rng.normal(size=COUNT),
        misfit=float(rng.uniform(0.5, 2.0)),
        along=rng.normal(size=COUNT),
        source_pixel=rng.permutation(PIXELS)[:COUNT],
        window=sparse.csr_array(window),
        held=np.eye(6),
    )


def made_surfaces() -> dict[str, Any]:
    rng = np.random.default_rng(4)
    return {
        name: SimpleNamespace(
            own=rng.uniform(1e-3, 3e-3, (3, PIXELS // 3)), motion=None
        )
        for name in NAMES
    }


def unknowns(pair: Any, state: State, at: dict[tuple[str, str], slice]) -> np.ndarray:
    """Return derivatives of the seven numbers of a pair by the unknowns."""
    size = max(place.stop for place in at.values())
    result = np.zeros((7, size))
    for sign, name in ((1, pair.source), (-1, pair.target)):
        arm = pair.pivot - state.poses[name].position
        for part, unit in enumerate(np.eye(3)):
            first = at["pose", name].start
            result[:3, first + part] = sign * unit
            result[:3, first + 3 + part] = sign * np.cross(unit, arm)
            result[3:6, first + 3 + part] = sign * unit
    result[6, at["error", "index"]] = 1.0
    return result


@pytest.mark.parametrize("steady", [False, True])
def test_pairs_add_their_observations_with_weight_and_trust(
    state: State, steady: bool
) -> None:
    pairs = [made_pair("a", "b", 5), made_pair("c", "b", 6)]
    trust = [0.7, 1.0]
    layout = network.Layout(state, None)
    assert layout.size == 3 * 6 + 2
    system = network.system_of(
        state, pairs, Ties(start={}), trust, layout, np.eye(layout.size), steady=steady
    )
    matrix, gradient = np.zeros((20, 20)), np.zeros(20)
    for pair, share in zip(pairs, trust, strict=True):
        moved = unknowns(pair, state, layout.at)
        for number in range(COUNT):
            front = pair.by_target[number] @ moved
            back = front if steady else pair.by_source[number] @ moved
            weight = share * pair.weight[number]
            matrix += weight * np.outer(back, front)
            gradient += weight * back * pair.distance[number]
    # Each shared error is 0 with the standard deviation 1.
    for key in ("delay", "index"):
        place = layout.at["error", key].start
        matrix[place, place] += 1.0
        gradient[place] += state.errors[key]
    assert_allclose(system.matrix, matrix)
    assert_allclose(system.gradient, gradient)
    assert_allclose(np.diag(system.scatter), [0.0] * 18 + [1.0] * 2)


def test_noise_alone_does_not_determine_an_unknown() -> None:
    """The mean square of a value that only noise multiplies stays its variance."""
    rng = np.random.default_rng(11)
    estimates: dict[str, list[np.ndarray]] = {"plain": [], "combined": []}
    for _ in range(400):
        truth = rng.normal(0, 1, 2)
        seen = np.stack([np.full(300, 0.3), np.zeros(300)], axis=1)
        x, z = (seen + rng.normal(0, [0.0, 0.3], seen.shape) for _ in range(2))
        distance = -seen @ truth + rng.normal(0, 1, 300)
        for kind, values in estimates.items():
            system = network.System(2)
            system.add(np.arange(2), z.T @ x, z.T @ distance)
            if kind == "combined":
                system.combine(z.T @ z)
            system.add_prior(np.arange(2), np.eye(2), np.zeros(2))
            change = -np.linalg.solve(system.matrix, system.gradient)
            values.append(change - truth)
    plain, combined = (
        np.mean(np.square(errors), axis=0) for errors in estimates.values()
    )
    # 300 values of 0.3 with a noise of 1 give 27 + 1; nothing is known of the second.
    assert combined[0] == pytest.approx(1 / 28, rel=0.25)
    assert combined[1] == pytest.approx(1.0, rel=0.25)
    assert plain[1] > 3


def test_equal_derivatives_and_noise_change_nothing() -> None:
    rng = np.random.default_rng(12)
    rows = rng.normal(size=(30, 4)) * [1.0, 1e3, 1e-3, 1.0]
    rows[:, 3] = 0.0
    system = network.System(4)
    system.add(np.arange(4), rows.T @ rows, rows.T @ rng.normal(size=30))
    matrix, gradient = system.matrix.copy(), system.gradient.copy()
    system.combine(rows.T @ rows)
    assert_allclose(system.matrix, matrix, rtol=1e-9, atol=1e-9)
    assert_allclose(system.gradient, gradient, rtol=1e-9, atol=1e-9)


def test_a_fixed_scan_has_no_unknowns(state: State) -> None:
    pairs = [made_pair("a", "b", 5)]
    free, fixed = network.Layout(state, None), network.Layout(state, "a")
    assert fixed.size == free.size - 6
    whole, part = (
        network.system_of(
            state, pairs, Ties(start={}), [1.0], layout, np.eye(layout.size)
        )
        for layout in (free, fixed)
    )
    rest = np.arange(6, free.size)
    assert_allclose(part.matrix, whole.matrix[np.ix_(rest, rest)])
    assert_allclose(part.gradient, whole.gradient[rest])


def distance_noise(pair: Any, name: str, surfaces: dict[str, Any]) -> np.ndarray:
    """Return derivatives of the distances of a pair by the noise of pixels."""
    own = surfaces[name].own.ravel()
    added = np.zeros((COUNT, PIXELS))
    for number in range(COUNT):
        if name == pair.source:
            pixel = pair.source_pixel[number]
            added[number, pixel] += pair.along[number] * own[pixel]
        if name == pair.target:
            added[number] += pair.window.toarray()[number] * own
    return pair.misfit * added


def test_noise_of_a_pixel_counts_through_all_pairs(state: State) -> None:
    pairs = [made_pair("a", "b", 5), made_pair("c", "b", 6)]
    trust, surfaces = [0.6, 1.0], made_surfaces()
    layout = network.Layout(state, None)
    for name in NAMES:
        gradient = np.zeros((layout.size, PIXELS))
        for pair, share in zip(pairs, trust, strict=True):
            noise = distance_noise(pair, name, surfaces)
            moved = pair.by_source @ unknowns(pair, state, layout.at)
            gradient += moved.T @ (np.sqrt(share) * pair.weight[:, None] * noise)
        found = network._noise_variance(
            name, surfaces[name], state, pairs, trust, layout
        )
        assert_allclose(found, gradient @ gradient.T, atol=1e-18)


def test_a_pair_alone_moves_by_its_distances_with_their_noise(state: State) -> None:
    pair, surfaces = made_pair("a", "b", 5), made_surfaces()
    move, spread = network.innovation(pair, state, surfaces)
    # Instruments by source, least squares of the others: (z' W x) m = -z' W d.
    front, back = pair.by_target[:, :6], pair.by_source[:, :6]
    left = back.T @ (pair.weight[:, None] * front)
    assert_allclose(left @ move, -back.T @ (pair.weight * pair.distance))
    solved = np.linalg.solve(left, back.T * pair.weight)
    noise = np.hstack([distance_noise(pair, name, surfaces) for name in "ab"])
    assert_allclose(spread, solved @ noise @ noise.T @ solved.T, atol=1e-18)
