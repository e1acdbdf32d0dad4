"""Normal equations of the whole fit: gradients and curvatures of chi-square."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from joint_states import shared_state
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor.rejection.covariance import Covariance
from amulor.rejection.joint.normal import Normal, water_at
from amulor.rejection.joint.priors import NONE, Shared, cost_of, layout_of
from amulor.rejection.joint.problem import Problem
from amulor.rejection.joint.samples import Pixels, weight
from amulor.rejection.joint.tables import Changes, Table

RATE = 2 * np.pi * np.array([12e6, 31e6, 57e6, 83e6]) / speed_of_light
FRAME: Any = SimpleNamespace(phase_per_path=RATE)
DEPTH = 0.01 * np.arange(400)
TRANSFER = np.array([1.0, 0.9 + 0.1j, 0.8, 0.7 - 0.2j])
#: Strengths, shape, drift, water, echo, shots: departures and strength.
SIZES = (2, 3, 3, 16, 8, 17)
SIZE = sum(SIZES)


def profile(rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Return water up to each depth with its slope; the last node is all of it."""
    decay = -rate + 2j * RATE * 1.38
    slope = np.exp(decay * DEPTH[:, None])
    value = np.append((slope - 1) / decay, -1 / decay[None], axis=0)
    return value, np.append(slope, np.zeros((1, RATE.size)), axis=0)


def state_of(vector: np.ndarray, **changed: Any) -> Shared:
    """Return shared parameters moved by a vector in the order of the layout."""
    strength, shape, trend, water, echo, shots = np.split(vector, np.cumsum(SIZES)[:-1])
    base, others = profile(0.9), [profile(rate) for rate in (0.5, 1.4, 2.2)]
    changes = np.stack([one[0][None] for one in others])
    slopes = np.stack([one[1][None] for one in others])
    basis = np.ones((1, 1))
    table = Table(
        step=0.01,
        value=base[0][None] + np.tensordot(shape, changes, 1),
        slope=base[1][None] + np.tensordot(shape, slopes, 1),
        basis=basis,
        level=np.ones(1),
        strength=1.0,
        differentiated=lambda: Changes(changes, basis),
    )
    water, echo = water.reshape(2, 2, 4), echo.reshape(2, 4)
    of_shots = shots[:-1].reshape(2, 2, 4)
    values: dict[str, Any] = {
        "table": table,
        "strength": np.array([0.5, 0.2]) + strength,
        "departure": 0.02 + water[0] + 1j * water[1],
        "echo": np.array([0.01, 0.02j, -0.01, 0.0]) + echo[0] + 1j * echo[1],
        "shot_change": shots[-1],
        "shot_departure": of_shots[0] + 1j * of_shots[1],
        "trend": np.array([0.02, -0.01, 0.01]) + trend,
    }
    return shared_state(2, 4, **values | changed)


PATHS = np.array([5.0, 5.6, 6.1, 6.7, np.inf])


def pixels_of(paths: np.ndarray, seed: int) -> Pixels:
    """Return samples at paths, infinite for open water, with noise."""
    rng = np.random.default_rng(seed)
    count = len(paths)
    variance = rng.uniform(1e-6, 4e-6, (2, count, 2, 4))
    cross = 0.4 * np.sqrt(variance.prod(axis=0))
    shortest = np.full(count, 2.0)
    place = np.linspace(0, 1, 33) ** 2
    pixels = Pixels(
        signal=np.zeros((count, 2, 4), dtype=complex),
        covariance=Covariance(variance[0], variance[1], cross),
        usable=rng.random((count, 2, 4)) > 0.05,
        interpolation=np.ones((count, 1)),
        offset=rng.uniform(0.0, 0.3, count),
        shortest=shortest,
        longest=np.full(count, 9.0),
        depths=np.maximum((shortest[:, None] + 7 * place - 0.3) / 2.76, 0),
        trends=rng.uniform(-1, 1, (count, 3)),
    )
    state = state_of(np.zeros(SIZE))
    _, water, _ = water_at(pixels, paths, state.table, RATE)
    front = np.exp(1j * pixels.offset[:, None] * RATE)
    light = state.water_signal(water, front)
    draws = rng.standard_normal((2, count, 2, 4))
    signal = light + 1e-3 * (draws[0] + 1j * draws[1])
    for n in np.flatnonzero(np.isfinite(paths)):
        turn = np.exp(1j * RATE * paths[n]) * TRANSFER * (1 + state.echo)
        signal[n] += np.array([[0.3], [0.2]]) * turn
    return replace(pixels, signal=np.where(pixels.usable, signal, 0.0))


WHOLE = Problem(
    FRAME, pixels_of(PATHS, 1), pixels_of(np.full(4, np.inf), 2), TRANSFER, 3.0
)


def normal_at(vector: np.ndarray, **changed: Any) -> Normal:
    """Return the normal equations at parameters, with paths and amplitudes fitted."""
    state = state_of(vector, **changed)
    layout = layout_of(state)
    estimates = WHOLE.local(state, np.where(np.isfinite(PATHS), PATHS, 3.0))
    return WHOLE.normal(state, estimates, layout, layout.size)


@pytest.mark.parametrize("seed", range(6))
def test_the_gradient_is_that_of_chi_square(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = 3e-4 * rng.standard_normal(SIZE)
    along = np.zeros(SIZE)
    # One group after the other.
    edges = np.concatenate([[0], np.cumsum(SIZES)])
    part = slice(edges[seed], edges[seed + 1])
    along[part] = rng.standard_normal(SIZES[seed])
    step = 1e-5
    up, down = (normal_at(start + sign * step * along) for sign in (1, -1))
    middle = normal_at(start)
    assert layout_of(state_of(start)).size == SIZE
    # The vector is minus half of the gradient: paths and amplitudes are at their best.
    # The column of the drift leaves out the departure of the water, 2 % here.
    slope = -(up.square - down.square) / (2 * step) / 2
    close = 0.02 if seed == 2 else 1e-3
    assert middle.vector @ along == pytest.approx(slope, rel=close)
    assert abs(slope) > 10
    bend = (up.square + down.square - 2 * middle.square) / step**2 / 2
    # Gauss and Newton: without the curvature of the model.
    assert along @ middle.matrix @ along == pytest.approx(bend, rel=0.05)
    usable = sum(int(p.usable.sum()) for p in (WHOLE.targets, WHOLE.shots) if p)
    # A path and two amplitudes of four targets.
    assert middle.freedom == 2 * usable - 4 * 3
    assert_allclose(middle.matrix, middle.matrix.T, rtol=1e-6, atol=1e-6)


def test_costs_contain_the_errors_of_a_fluctuation() -> None:
    widths = (1e-3, 0.01, 0.01, 0.01, 0.01)
    for fluctuation, scale in ((0.0, 1.0), (0.05, 1.3)):
        state = state_of(
            np.zeros(SIZE), widths=widths, fluctuation=fluctuation, noise_scale=scale
        )
        layout = layout_of(state)
        estimates = WHOLE.local(state, None)
        normal = WHOLE.normal(state, estimates, layout, layout.size)
        expected = normal.square + cost_of(
            normal.matrix, normal.vector, state, layout, widths
        )
        for group in WHOLE.groups(state, estimates):
            deviation = WHOLE.deviation(state, group.pixels, group.path)
            assert (deviation is None) == (fluctuation == 0)
            if deviation is not None:
                _, water, _ = water_at(group.pixels, group.path, state.table, RATE)
                front = np.exp(1j * group.pixels.offset[:, None] * RATE)
                # The weights of the direction contain the drift.
                front = front * group.pixels.interpolation
                light = 0.05 * state.water_signal(water, front)
                assert_allclose(deviation, light)
            inverse = weight(group.pixels, deviation, scale)
            for n, c, f in zip(*np.nonzero(group.pixels.usable), strict=True):
                xx, xy, yy = inverse[n, c, :, f]
                expected -= np.log(xx * yy - xy**2)
        assert WHOLE.cost(state) == pytest.approx(expected, rel=1e-6)


def test_groups_are_targets_and_shots() -> None:
    state = state_of(np.zeros(SIZE))
    estimates = WHOLE.local(state, None)
    targets, shots = WHOLE.groups(state, estimates)
    assert not targets.is_shot
    assert shots.is_shot
    assert np.isinf(shots.path).all()
    assert_allclose(shots.amplitude, np.zeros((4, 2)))
    assert np.isinf(targets.path[4])
    assert_allclose(targets.path[:4], PATHS[:4], atol=0.02)
    assert_allclose(targets.amplitude[4], 0)
    assert_allclose(targets.amplitude[:4], [[0.3, 0.2]] * 4, atol=0.02)
    alone = Problem(FRAME, WHOLE.targets, None, TRANSFER, 3.0)
    assert len(alone.groups(state, estimates)) == 1


def test_a_fit_descends_to_the_parameters_of_the_samples(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    layout = layout_of(state_of(np.zeros(SIZE)))
    start = np.zeros(SIZE)
    start[:2] = 0.02, -0.01

    def moved(self: Problem, state: Shared, step: np.ndarray, layout: Any) -> Shared:
        # Strengths alone.
        return replace(state, strength=state.strength + step[:2])

    monkeypatch.setattr(Problem, "moved", moved)
    state, paths = WHOLE.descend(state_of(start), 8, free=False)
    # The water of the samples, but for what its shape would explain.
    assert_allclose(state.strength, [0.5, 0.2], rtol=0.02)
    assert_allclose(paths[:4], PATHS[:4], atol=0.02)
    normal = WHOLE.normal(state, WHOLE.local(state, paths), layout, layout.rigid)
    assert state.misfit == pytest.approx(normal.square / normal.freedom, rel=1e-3)
    basic = layout.parametric
    expected = np.linalg.inv(normal.matrix[basic, basic])
    assert_allclose(state.parametric, expected, rtol=0.02, atol=1e-9)
    assert state.widths == NONE
