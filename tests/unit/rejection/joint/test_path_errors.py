"""Errors of paths by shared parameters and by rates: derivatives, dense algebra."""

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
from amulor.rejection.joint import motion
from amulor.rejection.joint.normal import Fitted, modelled, path_derivatives, water_at
from amulor.rejection.joint.priors import Shared, layout_of
from amulor.rejection.joint.samples import Pixels, weight
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
        "table": table_of(vector[2:5]),
        "strength": np.array([0.5, 0.2]) + vector[:2],
        "departure": 0.02 + 0.01j + water[0] + 1j * water[1],
        "echo": np.array([0.01, 0.02j, -0.01, 0.0]) + echo[0] + 1j * echo[1],
        "covariance": np.zeros((29, 29)),
        "parametric": np.zeros((5, 5)),
    }
    return shared_state(2, 4, **values | changed)


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


def moving(seed: int = 7) -> Pixels:
    """Return the samples with paths that change from reading to reading."""
    rng = np.random.default_rng(seed)
    size = rng.uniform(-2e-3, 2e-3, (3, 2, 4, 2))
    usable = PIXELS.usable.copy()
    usable[0, 1, 2] = False
    signal = np.where(usable, PIXELS.signal, 0.0)
    return replace(PIXELS, motion=size, usable=usable, signal=signal)


def square_of(errors: Covariance, index: tuple[int, ...]) -> np.ndarray:
    xx, yy, xy = (part[index] for part in vars(errors).values())
    return np.array([[xx, xy], [xy, yy]])


@pytest.mark.parametrize("known", [False, True])
def test_readings_are_those_of_the_instant_of_the_path(known: bool) -> None:
    state, pixels = state_of(NOTHING), moving()
    path = np.array([PATHS[0], PATHS[1], np.nan])
    rate = np.array([0.5, -2.0, 1.0])
    found = motion.at_instant(pixels, path, rate if known else None, state, RATE)
    end = np.where(np.isfinite(path), path, np.inf)
    _, water, _ = water_at(pixels, end, state.table, RATE)
    level = pixels.interpolation @ state.table.basis @ state.table.level
    front = level[:, None] * np.exp(1j * pixels.offset[:, None] * RATE)
    light = state.water_signal(water, front)
    assert pixels.motion is not None
    for n, c, f in np.ndindex(3, 2, 4):
        steady, bend = pixels.motion[n, c, f]
        if not known:
            # Without a rate its deviation is an error, beside that of its change.
            bend = np.hypot(steady, bend)
        back = np.exp(-1j * RATE[f] * steady * (rate[n] if known else 0.0))
        echo = (pixels.signal[n, c, f] - light[n, c, f]) * back
        if not pixels.usable[n, c, f]:
            assert found.signal[n, c, f] == 0
            continue
        assert found.signal[n, c, f] == pytest.approx(echo + light[n, c, f])
        turn = np.array([[back.real, -back.imag], [back.imag, back.real]])
        along = min(10 * abs(steady), 0.1) * np.array([echo.real, echo.imag])
        across = min(RATE[f] * abs(bend), 0.1) * np.array([-echo.imag, echo.real])
        expected = turn @ square_of(pixels.covariance, (n, c, f)) @ turn.T
        expected += np.outer(along, along)
        expected += np.outer(across, across)
        assert_allclose(square_of(found.covariance, (n, c, f)), expected, rtol=1e-6)
    assert motion.at_instant(PIXELS, path, rate, state, RATE) is PIXELS


def test_a_change_of_the_echo_is_a_tenth_of_it_at_most() -> None:
    state = state_of(NOTHING)
    pixels = replace(moving(), motion=np.full((3, 2, 4, 2), 0.5))
    found = motion.at_instant(pixels, PATHS, np.zeros(3), state, RATE)
    trace = found.covariance.in_phase + found.covariance.quadrature
    trace = trace - pixels.covariance.in_phase - pixels.covariance.quadrature
    _, water, _ = water_at(pixels, PATHS, state.table, RATE)
    level = pixels.interpolation @ state.table.basis @ state.table.level
    front = level[:, None] * np.exp(1j * pixels.offset[:, None] * RATE)
    echo = np.where(pixels.usable, pixels.signal - state.water_signal(water, front), 0)
    across = np.minimum(0.5 * RATE, 0.1)
    assert_allclose(trace, (0.1**2 + across**2) * np.abs(echo) ** 2, rtol=1e-6)


@pytest.mark.parametrize("fluctuation", [0.0, 0.05])
def test_equations_of_path_and_rate_are_those_of_dense_algebra(
    fluctuation: float,
) -> None:
    state = state_of(NOTHING, fluctuation=fluctuation, noise_scale=1.2)
    pixels = moving()
    rng = np.random.default_rng(8)
    parts = rng.standard_normal((2, 3, 2, 4))
    signal = pixels.signal + 1e-3 * (parts[0] + 1j * parts[1])
    pixels = replace(pixels, signal=np.where(pixels.usable, signal, 0.0))
    found = solved().estimates
    # The second channel of the second pixel has no echo.
    amplitude = np.array([[0.3, 0.2], [0.3, 0.0], [0.0, 0.0]])
    found = replace(found, amplitude=amplitude, path=np.append(PATHS[:2], np.nan))
    equations = motion._equations(
        pixels, found, state, transfer=TRANSFER, phase_per_path=RATE
    )
    end = np.append(PATHS[:2], np.inf)
    fitted = Fitted(pixels, end, amplitude)
    model = modelled(state, fitted, transfer=TRANSFER, phase_per_path=RATE)
    by_path = path_derivatives(state, fitted, model, RATE)
    deviation = state.fluctuation * model.water_signal if fluctuation else None
    inverse = weight(pixels, deviation, 1.2)
    assert pixels.motion is not None
    for n in range(2):
        rows, rest, blocks = [], [], []
        for c, f in np.ndindex(2, 4):
            echo = model.echo[n, f] * (1 + state.echo[f])
            row = np.zeros(4, dtype=complex)
            row[c] = echo * (amplitude[n, c] > 0)
            row[2] = by_path[n, c, f]
            row[3] = pixels.motion[n, c, f, 0] * by_path[n, c, f]
            rows.append(np.stack([row.real, row.imag]))
            xx, xy, yy = inverse[n, c, :, f]
            blocks.append(np.array([[xx, xy], [xy, yy]]))
            left = model.residual[n, c, f]
            rest.append([left.real, left.imag])
        jacobian, right = np.concatenate(rows), np.concatenate(rest)
        whole = np.zeros((16, 16))
        for k, block in enumerate(blocks):
            whole[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block
        own, others = jacobian[:, :2], jacobian[:, 2:]
        away = whole - whole @ own @ np.linalg.pinv(own.T @ whole @ own) @ own.T @ whole
        normal = others.T @ away @ others
        assert equations.path[n] == pytest.approx(normal[0, 0], rel=1e-6)
        assert equations.mixed[n] == pytest.approx(normal[0, 1], rel=1e-6)
        assert equations.rate[n] == pytest.approx(normal[1, 1], rel=1e-6)
        pull = away @ others[:, 1]
        assert equations.downhill[n] == pytest.approx(pull @ right, rel=1e-6)
        complex_pull = (pull[::2] + 1j * pull[1::2]).reshape(2, 4)
        assert_allclose(equations.pull[n], complex_pull, rtol=1e-6, atol=1e-6)
        # A step of the rate, with the path that follows it and a prior of one.
        left = normal[1, 1] - normal[0, 1] ** 2 / normal[0, 0]
        step = (pull @ right - 0.7) / (1 + left)
        assert equations.step(np.full(3, 0.7))[n] == pytest.approx(step, rel=1e-6)


def test_rates_widen_the_path_by_their_prior() -> None:
    found = solved().estimates
    equations = motion._Equations(
        path=found.information,
        mixed=np.array([900.0, -400.0, 0.0]),
        rate=np.array([20.0, 5.0, 0.0]),
        downhill=np.zeros(3),
        pull=np.random.default_rng(9).standard_normal((3, 2, 4)).astype(np.complex128),
    )
    drawn = np.random.default_rng(10).standard_normal((3, 2, 4))
    influence = drawn.astype(np.complex128)
    found = replace(found, influence=influence)
    rate = np.array([0.5, -1.0, 0.0])
    wide = motion._with_rate_errors(found, rate, equations)
    for n in range(2):
        mixed = equations.mixed[n]
        normal = np.array(
            [[found.information[n], mixed], [mixed, 1 + equations.rate[n]]]
        )
        inverse = np.linalg.inv(normal)
        assert wide.information[n] == pytest.approx(1 / inverse[0, 0])
        factor = np.sqrt(inverse[0, 0] * found.information[n])
        assert factor > 1
        assert wide.lower[n] == pytest.approx(factor * found.lower[n])
        assert wide.upper[n] == pytest.approx(factor * found.upper[n])
        # The path follows the samples directly, and by the rate.
        direct = found.information[n] * influence[n]
        expected = inverse[0, 0] * direct + inverse[0, 1] * equations.pull[n]
        assert_allclose(wide.influence[n], expected, rtol=1e-9)
    assert_allclose(wide.cost, found.cost + rate**2)
    assert_allclose(wide.rate, rate)
    assert wide.information[2] == found.information[2]


def test_moving_pixels_find_their_path_and_rate() -> None:
    state, pixels = state_of(NOTHING), moving()
    rate = np.array([1.5, -0.8, 0.0])
    assert pixels.motion is not None
    turn = np.exp(1j * RATE * pixels.motion[..., 0] * rate[:, None, None])
    _, water, _ = water_at(pixels, np.append(PATHS[:2], np.inf), state.table, RATE)
    level = pixels.interpolation @ state.table.basis @ state.table.level
    front = level[:, None] * np.exp(1j * pixels.offset[:, None] * RATE)
    light = state.water_signal(water, front)
    echo = (pixels.signal - light) * turn
    pixels = replace(
        pixels,
        signal=np.where(pixels.usable, echo + light, 0.0),
        motion=pixels.motion * [1.0, 0.0],
        covariance=pixels.covariance.scaled(1e-6),
    )
    words: dict[str, Any] = {"transfer": TRANSFER, "phase_per_path": RATE}
    near = np.append(PATHS[:2] + 1e-3, 7.3)
    found = motion.estimates_of(pixels, state, start=near, **words)
    assert_allclose(found.path[:2], PATHS[:2], atol=2e-5)
    assert_allclose(found.rate[:2], rate[:2], rtol=0.1)
    still = motion.estimates_of(pixels, state, start=near, still=True, **words)
    assert_allclose(still.rate, 0)
