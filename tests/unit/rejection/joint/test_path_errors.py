"""Errors of paths by shared parameters: derivatives of the estimate itself."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor.rejection.covariance import Covariance
from amulor.rejection.joint.normal import water_at
from amulor.rejection.joint.overlap import Shape
from amulor.rejection.joint.priors import NONE, Shared, layout_of
from amulor.rejection.joint.samples import Pixels
from amulor.rejection.joint.solve import Result, solve
from amulor.rejection.joint.tables import Changes, Table

FREQUENCY = np.array([12e6, 31e6, 57e6, 83e6])
RATE = 2 * np.pi * FREQUENCY / speed_of_light
STEP, NODES = 0.02, 200
DEPTH = STEP * np.arange(NODES)
FRAME: Any = SimpleNamespace(phase_per_path=RATE)
TRANSFER = np.array([1.0, 0.9 + 0.1j, 0.8, 0.7 - 0.2j])
PATHS = np.array([5.0, 6.1, 7.3])


def profile(rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Return water up to a depth, and its derivative: an exponential with its delay.

    The last node is all of the water.
    """
    decay = -rate + 2j * RATE * 1.38
    slope = np.exp(decay * DEPTH[:, None])
    value = np.append((slope - 1) / decay, -1 / decay[None], axis=0)
    return value, np.append(slope, np.zeros((1, RATE.size)), axis=0)


def table_of(step: np.ndarray) -> Table:
    """Return a table of two components that depends on three parameters."""
    value, slope = profile(0.9)
    others = [profile(rate) for rate in (0.5, 1.4, 2.2)]
    values = np.stack([value, 0.3 * others[0][0]])
    slopes = np.stack([slope, 0.3 * others[0][1]])
    changes = np.stack([[one[0], -0.2 * one[0]] for one in others])
    of_slopes = np.stack([[one[1], -0.2 * one[1]] for one in others])
    basis = np.array([[1.0, 0.2], [0.8, 0.5]])
    return Table(
        step=STEP,
        value=values + np.tensordot(step, changes, 1),
        slope=slopes + np.tensordot(step, of_slopes, 1),
        basis=basis,
        level=np.array([1.0, 0.4]),
        strength=1.0,
        differentiated=lambda: Changes(changes, basis),
    )


def state_of(vector: np.ndarray, **changed: Any) -> Shared:
    """Return shared parameters moved by a vector in the order of the layout."""
    water = vector[5:21].reshape(2, 2, 4)
    echo = vector[21:29].reshape(2, 4)
    values: dict[str, Any] = {
        "shape": Shape(0.3, 0.05, 0.7, np.zeros(0), np.zeros(0)),
        "table": table_of(vector[2:5]),
        "strength": np.array([0.5, 0.2]) + vector[:2],
        "departure": 0.02 + 0.01j + water[0] + 1j * water[1],
        "echo": np.array([0.01, 0.02j, -0.01, 0.0]) + echo[0] + 1j * echo[1],
        "shot_change": 0.0,
        "shot_departure": np.zeros((0, 4), dtype=complex),
        "trend": np.zeros(0),
        "fluctuation": 0.0,
        "noise_scale": 1.0,
        "judged": np.ones((2, 4), dtype=bool),
        "turn_width": 0.0,
        "covariance": np.zeros((29, 29)),
        "parametric": np.zeros((5, 5)),
        "widths": NONE,
        "evidence": 0.0,
        "misfit": 1.0,
    }
    return Shared(**values | changed)


def pixels_of(state: Shared) -> Pixels:
    """Return samples of three pixels without noise; the last one is open water."""
    count = len(PATHS)
    rng = np.random.default_rng(1)
    variance = rng.uniform(1e-6, 4e-6, (2, count, 2, 4))
    cross = 0.4 * np.sqrt(variance.prod(axis=0))
    shortest = np.full(count, 2.0)
    longest = np.full(count, 9.0)
    place = np.linspace(0, 1, 33) ** 2
    pixels = Pixels(
        signal=np.zeros((count, 2, 4), dtype=complex),
        covariance=Covariance(variance[0], variance[1], cross),
        usable=np.ones((count, 2, 4), dtype=bool),
        interpolation=np.array([[1.0, 0.0], [0.4, 0.6], [0.1, 0.9]]),
        offset=np.array([0.3, 0.2, 0.1]),
        shortest=shortest,
        longest=longest,
        # The depth is half of the path before it, over the index.
        depths=np.maximum((shortest[:, None] + 7 * place - 0.3) / 2.76, 0),
        trends=np.zeros((count, 0)),
    )
    path = np.where(np.arange(count) < 2, PATHS, np.inf)
    _, water, _ = water_at(pixels, path, state.table, RATE)
    level = pixels.interpolation @ state.table.basis @ state.table.level
    front = level[:, None] * np.exp(1j * pixels.offset[:, None] * RATE)
    signal = np.zeros((count, 2, 4), dtype=complex)
    for n, c in np.ndindex(count, 2):
        signal[n, c] = state.strength[c] * (water[n] + state.departure[c] * front[n])
        if n < 2:
            turn = np.exp(1j * RATE * PATHS[n]) * TRANSFER * (1 + state.echo)
            signal[n, c] += (0.3, 0.2)[c] * turn
    return replace(pixels, signal=signal)


NOTHING = np.zeros(29)
PIXELS = pixels_of(state_of(NOTHING))


def solved(vector: np.ndarray = NOTHING, **changed: Any) -> Result:
    return solve(FRAME, PIXELS, state_of(vector, **changed), TRANSFER)


def derivative(along: np.ndarray) -> np.ndarray:
    """Return the change of the estimated paths by a change of the parameters."""
    step = 1e-5
    up, down = (solved(sign * step * along).estimates.path[:2] for sign in (1, -1))
    return np.asarray((up - down) / (2 * step))


def test_samples_of_the_model_give_their_paths() -> None:
    found = solved()
    assert found.detected.tolist() == [True, True, False]
    assert_allclose(found.estimates.path[:2], PATHS[:2], atol=1e-6)
    assert_allclose(found.estimates.amplitude[:2], [[0.3, 0.2]] * 2, rtol=1e-5)
    assert_allclose(found.estimates.cost[:2], 0, atol=1e-3)
    assert np.isinf(found.depth[2]) or found.depth[2] > 3
    assert_allclose(found.depth[:2], (PATHS[:2] - 0.3) / 2.76, rtol=1e-2)
    assert not found.left_out.any()
    assert found.deviation is None
    assert found.enough.all()
    assert layout_of(state_of(NOTHING)).size == 29


#: Strengths, shape, water and echo, and all of them.
GROUPS = {"strength": (0, 2), "shape": (2, 5), "water": (5, 21), "echo": (21, 29),
          "all": (0, 29)}  # fmt: skip


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("seed", [1, 2])
def test_path_variances_are_those_of_derivatives_of_the_estimate(
    group: str, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    along = np.zeros(29)
    part = slice(*GROUPS[group])
    along[part] = rng.standard_normal(part.stop - part.start)
    found = solved(covariance=np.outer(along, along))
    expected = derivative(along)
    assert np.abs(expected).min() > 1e-3
    assert_allclose(np.sqrt(found.shared_variance[:2]), np.abs(expected), rtol=2e-3)


def test_a_bound_has_the_errors_of_strengths_and_shape_alone() -> None:
    rng = np.random.default_rng(3)
    along = np.zeros(29)
    along[:5] = rng.standard_normal(5)
    found = solved(parametric=np.outer(along[:5], along[:5]), covariance=np.eye(29))
    own = 1 / found.estimates.information[:2]
    assert_allclose(found.bound[:2], own + derivative(along) ** 2, rtol=4e-3)
    # Open water has no path, and no bound.
    assert np.isnan(found.bound[2]) or not found.detected[2]


def test_departures_shift_a_path_by_their_size_and_uncertainty() -> None:
    state = state_of(NOTHING)
    now = np.zeros(29)
    parts = (state.departure.real, state.departure.imag, state.echo.real,
             state.echo.imag)  # fmt: skip
    now[5:] = np.concatenate([part.ravel() for part in parts])
    moved = derivative(now)
    assert_allclose(solved().departure[:2], np.abs(moved), rtol=4e-3)
    along = np.zeros(29)
    along[5:] = np.random.default_rng(4).standard_normal(24)
    unsure = solved(covariance=np.outer(along, along)).departure[:2]
    assert_allclose(unsure, np.hypot(moved, derivative(along)), rtol=4e-3)


@pytest.mark.parametrize("seed", [5, 6])
def test_common_errors_are_those_of_derivatives_of_the_water(seed: int) -> None:
    along = 0.1 * np.random.default_rng(seed).standard_normal(29)
    # The echo is no part of the water, and depths stay.
    along[21:] = 0.0
    found = solved(covariance=np.outer(along, along))
    path = np.where(found.detected, found.estimates.path, np.inf)
    table = state_of(NOTHING).table
    level = PIXELS.interpolation @ table.basis @ table.level
    front = level[:, None] * np.exp(1j * PIXELS.offset[:, None] * RATE)

    def water(sign: float) -> np.ndarray:
        state = state_of(sign * 1e-6 * along)
        _, part, _ = water_at(PIXELS, path, state.table, RATE)
        return np.asarray(state.water_signal(part, front))

    assert_allclose(found.water_signal, water(0.0), rtol=1e-9)
    slope = (water(1.0) - water(-1.0)) / 2e-6
    # The changes are interpolated between depths on a straight line.
    close: Any = {"rtol": 5e-3, "atol": 1e-6}
    assert_allclose(found.common.in_phase, slope.real**2, **close)
    assert_allclose(found.common.quadrature, slope.imag**2, **close)
    assert_allclose(found.common.cross, slope.real * slope.imag, **close)


def test_a_fluctuation_is_a_part_of_the_water() -> None:
    found = solved(fluctuation=0.03)
    assert found.deviation is not None
    assert_allclose(found.deviation, 0.03 * found.water_signal)
