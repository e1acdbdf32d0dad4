"""Two paths of a pixel: chi-square and its derivatives, and damped steps to it."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.rejection.covariance import Covariance
from amulor.rejection.joint import search as module
from amulor.rejection.joint.samples import Pixels, weight

RATE = np.array([0.7, 1.5, 2.4, 3.1])
STRENGTH = np.array([0.3, 0.2])
TRANSFER: Any = np.array([1.0, 0.9j, 0.8, 0.7 - 0.2j])


def water(path: np.ndarray) -> tuple[Any, Any]:
    """Return a water signal that ends at a path, and its derivative."""
    value = 1 - np.exp((-0.2 + 1j * RATE) * path[:, None])
    slope = -(-0.2 + 1j * RATE) * np.exp((-0.2 + 1j * RATE) * path[:, None])
    return value, slope


@pytest.fixture(autouse=True)
def given_water(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        module, "water_at", lambda pixels, path, table, rate: (path, *water(path))
    )


SHARED: Any = SimpleNamespace(
    table="table",
    strength=STRENGTH,
    water_signal=lambda value, front: STRENGTH[:, None] * value[:, None],
    fluctuation=0.0,
    noise_scale=1.0,
)


def pixels_of(count: int, seed: int = 1) -> Pixels:
    rng = np.random.default_rng(seed)
    shape = count, 2, 4
    variance = rng.uniform(1e-4, 2e-4, (2, *shape))
    signal = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    nothing = np.zeros(count)
    return Pixels(
        signal=signal,
        covariance=Covariance(
            variance[0], variance[1], rng.uniform(-5e-5, 5e-5, shape)
        ),
        usable=rng.random(shape) > 0.1,
        interpolation=np.ones((count, 1)),
        offset=nothing,
        shortest=nothing + 1.0,
        longest=nothing + 9.0,
        depths=np.zeros((count, 3)),
        trends=np.zeros((count, 0)),
    )


def dense(part: Pixels, n: int, ends: np.ndarray) -> tuple[float, list[np.ndarray]]:
    """Return chi-square with the best amplitudes from zero on, and its residuals."""
    value, _ = water(np.array([ends.min()]))
    total, residuals = 0.0, []
    for c in range(2):
        columns, outputs = [], []
        for f in range(4):
            if not part.usable[n, c, f]:
                continue
            xx, yy, xy = (v[n, c, f] for v in vars(part.covariance).values())
            root = np.linalg.cholesky(np.linalg.inv(np.array([[xx, xy], [xy, yy]]))).T
            rest = part.signal[n, c, f] - STRENGTH[c] * value[0, f]
            outputs.append(root @ [rest.real, rest.imag])
            echo = np.exp(1j * ends * RATE[f]) * TRANSFER[f]
            columns.append(root @ np.stack([echo.real, echo.imag]))
        matrix, values = np.concatenate(columns), np.concatenate(outputs)
        # The best of all sets of amplitudes above zero.
        best = values
        for free in ([], [0], [1], [0, 1]):
            part_of = matrix[:, free]
            size = np.linalg.lstsq(part_of, values)[0]
            left = values - part_of @ size
            if (size > 0).all() and left @ left < best @ best:
                best = left
        total += float(best @ best)
        residuals.append(best)
    return total, residuals


def test_chi_square_has_the_best_amplitudes_from_zero_on() -> None:
    part = pixels_of(6)
    ends = np.random.default_rng(2).uniform(2, 8, (6, 2))
    cost, step = module._linearised(
        part, ends, weight(part), np.zeros((6, 4)), SHARED, TRANSFER, RATE
    )
    h = 1e-5
    for n in range(6):
        assert cost[n] == pytest.approx(dense(part, n, ends[n])[0], rel=1e-6)
        for k in range(2):
            up, down = ends[n].copy(), ends[n].copy()
            up[k] += h
            down[k] -= h
            slope = (dense(part, n, up)[0] - dense(part, n, down)[0]) / (2 * h)
            # Half of the gradient, downhill.
            assert -2 * step.vector[n, k] == pytest.approx(slope, rel=1e-3, abs=1.0)
    assert_allclose(step.matrix, step.matrix.swapaxes(1, 2), rtol=1e-9)
    assert (np.linalg.eigvalsh(step.matrix) > -1e-6 * np.abs(step.matrix).max()).all()


def test_information_is_that_of_exact_samples() -> None:
    # Without noise chi-square rises by the information matrix.
    part = pixels_of(3)
    ends = np.array([[3.0, 5.0], [6.5, 2.0], [4.0, 4.7]])
    value, _ = water(ends.min(axis=1))
    echo = np.exp(1j * ends[:, None, :] * RATE[:, None]) * TRANSFER[:, None]
    sizes = np.array([[0.8, 0.5], [0.6, 0.9]])
    signal = STRENGTH[:, None] * value[:, None] + np.einsum("nfk,ck->ncf", echo, sizes)
    part = Pixels(**vars(part) | {"signal": np.where(part.usable, signal, 0)})
    cost, step = module._linearised(
        part, ends, weight(part), np.zeros((3, 4)), SHARED, TRANSFER, RATE
    )
    assert_allclose(cost, 0.0, atol=1e-4)
    h = 1e-4
    for n in range(3):
        for first, second in ((0, 0), (0, 1), (1, 1)):
            move = np.zeros((2, 2))
            move[0, first] = move[1, second] = h
            corners = [
                dense(part, n, ends[n] + a * move[0] + b * move[1])[0]
                for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))
            ]
            bend = (corners[0] - corners[1] - corners[2] + corners[3]) / (4 * h**2)
            assert step.matrix[n, first, second] == pytest.approx(bend / 2, rel=0.01)


def test_a_step_is_damped_by_its_diagonal() -> None:
    rng = np.random.default_rng(3)
    root = rng.standard_normal((4, 2, 2))
    matrix, vector = root @ root.swapaxes(1, 2), rng.standard_normal((4, 2))
    step = module._Step(matrix, vector)
    damping = np.array([0.0, 0.1, 1.0, 10.0])
    for n, found in enumerate(step(damping)):
        damped = matrix[n] + damping[n] * np.diag(np.diag(matrix[n]))
        assert_allclose(found, np.linalg.solve(damped, vector[n]))
    other = module._Step(2 * matrix, 3 * vector)
    use = np.array([True, False, True, False])
    merged = step.select(use, other)
    assert_array_equal(merged.matrix, np.where(use[:, None, None], 1, 2) * matrix)
    assert_array_equal(merged.vector, np.where(use[:, None], 1, 3) * vector)


def test_steps_are_short_and_stay_among_possible_paths(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[np.ndarray] = []
    best = np.array([[3.0, 5.0], [0.5, 9.5], [4.01, 5.0]])

    def linearised(pixels: Any, ends: Any, *_: Any) -> Any:
        tried.append(ends)
        rest = best - ends
        matrix = np.broadcast_to(np.eye(2), (3, 2, 2))
        return (rest**2).sum(axis=1), module._Step(matrix, rest)

    monkeypatch.setattr(module, "_linearised", linearised)
    part = pixels_of(3)
    start = np.array([[4.0, 5.0], [1.1, 8.95], [4.0, 5.0]])
    cost, ends = module._descend(part, start, None, None, SHARED, TRANSFER, RATE)
    # Half a radian of the highest frequency at a time, from 1 to 9 m.
    farthest = 0.5 / RATE.max()
    assert all(
        np.abs(b - a).max() <= farthest + 1e-12 for a, b in itertools.pairwise(tried)
    )
    assert tried[1][0, 0] == pytest.approx(4.0 - farthest)
    assert_allclose(ends[1], [1.0, 9.0])
    assert_allclose(ends[2], [4.01, 5.0], atol=1e-6)
    assert_allclose(cost, ((best - ends) ** 2).sum(axis=1))


def test_a_step_that_does_not_help_is_not_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[float] = []

    def linearised(pixels: Any, ends: Any, *_: Any) -> Any:
        class Step:
            def __call__(self, damping: np.ndarray) -> np.ndarray:
                given.append(float(damping[0]))
                return np.full((1, 2), 0.1)

            def select(self, selected: Any, others: Any) -> Any:
                return self if selected.all() else others

        # The first two steps help, the others lead uphill.
        return np.maximum(8.2 - ends.sum(axis=1), ends.sum(axis=1) - 8.6), Step()

    monkeypatch.setattr(module, "_linearised", linearised)
    _, ends = module._descend(
        pixels_of(1), np.array([[4.0, 4.0]]), None, None, SHARED, TRANSFER, RATE
    )
    assert_allclose(ends, [[4.2, 4.2]])
    ratios = np.array(given[1:]) / np.array(given[:-1])
    # Ten times less after a step that helps, and ten times more after another.
    assert_allclose(ratios[:2], 0.1)
    assert_allclose(ratios[2:4], 10.0)
