"""Priors of the shared parameters: places, precisions, evidence by dense algebra."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from joint_states import shared_state
from numpy.testing import assert_allclose

from amulor.rejection.joint import priors
from amulor.rejection.joint.overlap import Shape
from amulor.rejection.joint.priors import (
    NONE,
    Instrument,
    Layout,
    Shared,
    Widths,
    cost_of,
    inverse_of,
    layout_of,
    prior_of,
    whitened,
    whitened_columns,
    widths_of,
)

CHANNELS, FREQUENCIES, KNOTS, TURNS, TRENDS = 2, 3, 4, 2, 3


def state_of(
    seed: int = 0, *, doubts: bool = True, trends: int = TRENDS, **changed: Any
) -> Shared:
    """Return shared parameters with any values; no table is read."""
    rng = np.random.default_rng(seed)

    def drawn(*shape: int) -> Any:
        parts = rng.standard_normal((2, *shape))
        return 0.01 * (parts[0] + 1j * parts[1])

    values: dict[str, Any] = {
        "shape": Shape(
            0.3, 0.05, 0.7, 0.1 * rng.standard_normal(KNOTS), np.arange(1.0, 1 + KNOTS),
            0.01 * rng.standard_normal(TURNS),
        ),
        "departure": drawn(CHANNELS, FREQUENCIES),
        "echo": drawn(FREQUENCIES),
        "shot_change": 0.04,
        "shot_departure": drawn(CHANNELS if doubts else 0, FREQUENCIES),
        "trend": 0.01 * np.arange(1.0, 1 + trends),
        "fluctuation": 0.02,
        "turn_width": 0.02,
    }  # fmt: skip
    return shared_state(CHANNELS, FREQUENCIES, **values | changed)


@pytest.mark.parametrize("doubts", [False, True])
@pytest.mark.parametrize("trends", [0, 3])
def test_parameters_follow_each_other_without_gaps(doubts: bool, trends: int) -> None:
    state = state_of(doubts=doubts, trends=trends)
    found = layout_of(state)
    # Strengths, three coefficients, axis, knots, drift, water, echo, shots.
    parts = [
        found.strength,
        slice(2, 5),
        found.turn,
        found.blocks[0],
        found.trend,
        found.blocks[1],
        found.blocks[2],
        found.doubt,
    ]
    sizes = [2, 3, 2, 4, trends, 2 * 2 * 3, 2 * 3, 13 if doubts else 0]
    begin = 0
    for part, size in zip(parts, sizes, strict=True):
        assert (part.start, part.stop) == (begin, begin + size)
        begin += size
    assert found.size == begin
    assert found.rigid == 7
    assert found.parametric == slice(0, 5)
    assert found.shape == slice(2, 11 + trends)


def test_a_shape_moves_by_factors_and_by_sums() -> None:
    shape = state_of().shape
    assert shape.size == 3 + TURNS + KNOTS
    moved = shape.moved(np.log([2.0, 3.0, 5.0, *np.exp(np.arange(1.0, 7.0))]))
    assert moved.reduced_attenuation == pytest.approx(0.6)
    assert moved.spread == pytest.approx(0.15)
    assert moved.forward_scattering == pytest.approx(3.5)
    assert_allclose(moved.turn, shape.turn + np.array([1, 2]))
    assert_allclose(moved.correction, shape.correction + np.arange(3, 7))
    assert moved.knots is shape.knots


WIDTHS: Widths = (0.1, 0.01, 0.03, 0.3, 0.05)


def test_each_parameter_has_the_precision_of_its_width() -> None:
    state = state_of()
    layout = layout_of(state)
    precision, origin = prior_of(state, layout, WIDTHS)
    water, echo, shots = state.departure, state.echo, state.shot_departure
    expected = [
        *[(0.0, 0.0)] * 2,
        # Natural waters within a factor of seven.
        (1 / 4, np.log(0.3 / 0.4)),
        (1 / 4, np.log(0.05 / 0.02)),
        (1 / 4, np.log(0.7 / 1.0)),
        *[(1 / 0.02**2, turn) for turn in state.shape.turn],
        *[(100.0, value) for value in state.shape.correction],
        *[(400.0, value) for value in state.trend],
        *[(1e4, value) for value in (*water.real.ravel(), *water.imag.ravel())],
        *[(1 / 0.03**2, value) for value in (*echo.real, *echo.imag)],
        *[(1 / 0.09, value) for value in (*shots.real.ravel(), *shots.imag.ravel())],
        # The strength may be off by thirty times more.
        (1 / 81.0, 0.04),
    ]
    assert_allclose(precision, [one for one, _ in expected])
    assert_allclose(origin, [value for _, value in expected])


def test_widths_of_zero_are_no_prior() -> None:
    state = state_of(turn_width=0.0)
    precision, origin = prior_of(state, layout_of(state), NONE)
    assert np.count_nonzero(precision) == 3 + TURNS
    # An axis that counts as exact does not move.
    assert_allclose(precision[5:7], 1e18)
    assert np.count_nonzero(origin) > 20
    plain = state_of(doubts=False, trends=0)
    precision, _ = prior_of(plain, layout_of(plain), WIDTHS)
    assert len(precision) == layout_of(plain).size


def _normal(size: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((3 * size, size)) * 10 ** rng.uniform(-1, 2, size)
    matrix = root.T @ root
    return matrix, matrix @ (0.05 * rng.standard_normal(size))


def test_the_evidence_is_that_of_dense_algebra() -> None:
    state = state_of()
    layout = layout_of(state)
    matrix, vector = _normal(layout.size)

    def exact(widths: Widths) -> float:
        precision, origin = prior_of(state, layout, widths)
        posterior = matrix + np.diag(precision)
        downhill = vector - precision * origin
        determinant = np.linalg.slogdet(posterior)[1]
        has_width = precision > 0
        return float(
            precision @ origin**2
            - downhill @ np.linalg.solve(posterior, downhill)
            + determinant
            - np.sum(np.log(precision[has_width]))
        )

    for widths in (WIDTHS, (0.3, 1e-3, 0.01, 0.1, 0.1)):
        assert cost_of(matrix, vector, state, layout, widths) == pytest.approx(
            exact(widths), rel=1e-6
        )


def test_widths_have_the_highest_evidence_of_all_that_are_tried() -> None:
    tried = (
        (1e-3, 0.01, 0.03, 0.1, 0.3, 1.0),
        (1e-6, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1),
        (1e-6, 3e-4, 1e-3, 3e-3, 0.01, 0.03),
        (1e-6, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 1.0),
        (1e-6, 3e-3, 0.01, 0.03, 0.1, 0.3),
    )
    state = state_of()
    layout = layout_of(state)
    matrix, vector = _normal(layout.size, seed=2)
    widths, evidence = widths_of(matrix, vector, state, layout)

    def cost(widths: tuple[float, ...]) -> float:
        a, b, c, d, e = widths
        return cost_of(matrix, vector, state, layout, (a, b, c, d, e))

    best = cost(widths)
    for place, sizes in enumerate(tried):
        assert widths[place] in sizes
        others = [(*widths[:place], size, *widths[place + 1 :]) for size in sizes]
        assert best <= min(cost(one) for one in others) + 1e-9
    # A right model leaves water and echo alone, at any drift, correction and shots.
    plain = min(
        cost((a, 1e-6, 1e-6, d, e))
        for a in tried[0]
        for d in tried[3]
        for e in tried[4]
    )
    assert evidence == pytest.approx(plain - best, abs=1e-6)
    assert evidence > 10


def test_data_that_agree_with_the_model_have_the_least_widths() -> None:
    state = state_of(
        departure=np.zeros((2, 3), dtype=complex),
        echo=np.zeros(3, dtype=complex),
        shot_departure=np.zeros((2, 3), dtype=complex),
        shot_change=0.0,
        trend=np.zeros(3),
    )
    layout = layout_of(state)
    widths, evidence = widths_of(
        1e8 * np.eye(layout.size), np.zeros(layout.size), state, layout
    )
    assert widths[1:] == (1e-6, 1e-6, 1e-6, 1e-6)
    assert evidence == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "place", "least"),
    [("water_departs", 0, 1e-3), ("water_departs", 1, 1e-6), ("echo_departs", 2, 1e-6),
     ("water_drifts", 4, 1e-6)],
)  # fmt: skip
def test_a_departure_is_a_width_beyond_the_least(
    name: str, place: int, least: float
) -> None:
    plain = (1e-3, 1e-6, 1e-6, 1e-6, 1e-6)
    for width, departs in ((least, False), (1.01 * least, True)):
        widths: Any = (*plain[:place], width, *plain[place + 1 :])
        state = state_of(widths=widths)
        assert getattr(state, name) is departs
        others = {"water_departs", "echo_departs", "water_drifts"} - {name}
        assert not any(getattr(state, other) for other in others)


def test_signals_of_water_and_shots_are_those_of_their_parameters() -> None:
    state = state_of(3)
    rng = np.random.default_rng(4)
    parts = rng.standard_normal((4, 5, FREQUENCIES))
    water, front = parts[0] + 1j * parts[1], parts[2] + 1j * parts[3]
    found = state.water_signal(water, front)
    shots = state.shot_signal(found, front)
    for n, c, f in np.ndindex(found.shape):
        s, d = state.strength[c], state.departure[c, f]
        expected = s * (water[n, f] + d * front[n, f])
        assert found[n, c, f] == pytest.approx(expected)
        changed = np.exp(0.04) * expected + s * state.shot_departure[c, f] * front[n, f]
        assert shots[n, c, f] == pytest.approx(changed)
    assert state.shot_factor == pytest.approx(np.exp(0.04))
    assert_allclose(state.gain, np.array([[0.5] * 3, [0.2] * 3]))
    exact = state_of(3, doubts=False)
    assert_allclose(exact.shot_signal(found, front), np.exp(0.04) * found)


def test_whitened_values_have_the_inner_product_of_the_weights() -> None:
    rng = np.random.default_rng(5)
    root = rng.standard_normal((4, 2, FREQUENCIES, 2, 2))
    square = root @ root.swapaxes(-1, -2)
    square[0, 0, 0] = 0.0
    weights = np.stack([square[..., 0, 0], square[..., 0, 1], square[..., 1, 1]], 2)
    parts = rng.standard_normal((2, 4, 2, FREQUENCIES, 3))
    columns = parts[0] + 1j * parts[1]
    found = whitened_columns(weights, columns)
    assert found.shape == (4, 12, 3)
    for n in range(4):
        expected = np.zeros((3, 3))
        for c, f in np.ndindex(2, FREQUENCIES):
            pair = np.stack([columns[n, c, f].real, columns[n, c, f].imag])
            expected += pair.T @ square[n, c, f] @ pair
        assert_allclose(found[n].T @ found[n], expected, atol=1e-9)
    alone = whitened(weights, columns[..., 0])
    assert alone.shape == (4, 2, 6)
    assert_allclose(alone.reshape(4, 12), found[..., 0])


def test_a_matrix_of_any_scale_is_inverted() -> None:
    matrix, _ = _normal(6, seed=6)
    scale = 10.0 ** np.array([-40, -3, 0, 3, 30, 60])
    wide = matrix * np.outer(scale, scale)
    assert_allclose(
        inverse_of(wide) * np.outer(scale, scale), np.linalg.inv(matrix), rtol=1e-6
    )
    # Of two parameters with one effect only the sum is known.
    both = inverse_of(np.ones((2, 2)))
    assert np.ones(2) @ np.linalg.pinv(both) @ np.ones(2) == pytest.approx(4, rel=1e-3)
    assert both[0, 0] > 1e11


def test_uncertainties_of_an_instrument_are_checked_by_name() -> None:
    words = {
        "delay": "delay_uncertainty",
        "group_index": "group_index_uncertainty",
        "position": "receiver_position_uncertainty",
        "direction": "receiver_direction_uncertainty",
        "late_echo": "late_echo_uncertainty",
    }
    right = {name: 0.1 * k for k, name in enumerate(words)}
    assert vars(Instrument.checked(**right)) == right
    for name, said in words.items():
        for wrong in (-1e-300, np.inf, np.nan):
            with pytest.raises(ValueError, match=f"{said} must be a finite number"):
                Instrument.checked(**right | {name: wrong})
    assert np.degrees(priors.DIRECTION) == pytest.approx(1.0)
    assert priors.LATE_ECHO == 0.5
    assert Layout(1, 1, 0).size == 8
