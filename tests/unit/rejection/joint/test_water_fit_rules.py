"""Derived quantities of a fitted water, by light of closed forms."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from joint_states import shared_state
from numpy.testing import assert_allclose

from amulor.rejection.joint import water_fit as module
from amulor.rejection.joint.overlap import Shape
from amulor.rejection.joint.water_fit import split_scattering

INDEX = 1.38
#: Decrease of the light over depth [1/m].
LOSS = 1.5


def frame_of(light: Any, *, far: float = 12.0, end: float = np.inf) -> Any:
    """Return a frame whose light is a function of depth and shape."""
    return SimpleNamespace(
        nothing_left=lambda shape: far,
        end=end,
        middle=light,
        medium=SimpleNamespace(group_index=INDEX),
    )


def decay(depth: np.ndarray, shape: Shape) -> np.ndarray:
    return np.exp(-shape.reduced_attenuation * depth)


def shape_of(loss: float = LOSS, spread: float = 0.05, forward: float = 0.7) -> Shape:
    return Shape(loss, spread, forward, np.zeros(0), np.zeros(0))


def test_light_that_decays_has_the_response_of_a_low_pass() -> None:
    frame, shape = frame_of(decay), shape_of()
    frequency = np.array([0.0, 10e6, 40e6])
    found = module._responses(frame, shape, frequency)
    rate = 4 * np.pi * frequency * INDEX / 299792458.0
    expected = LOSS / np.hypot(LOSS, rate)
    assert_allclose(found / found[0], expected, rtol=1e-4)
    assert module._level(frame, shape, 40e6) == pytest.approx(expected[2], rel=1e-4)
    # Half of the power is left where the rate is that of the decay.
    corner = LOSS * 299792458.0 / (4 * np.pi * INDEX)
    assert module._cut_off(frame, shape) == pytest.approx(corner, rel=1e-3)


def test_a_bottom_ends_the_light() -> None:
    # Even light down to 2 m has the response of a box.
    def even(depth: np.ndarray, shape: Shape) -> np.ndarray:
        return np.ones(len(depth))

    frame = frame_of(even, end=2.0)
    turn = 4 * np.pi * 20e6 * INDEX / 299792458.0 * 2.0
    expected = abs(np.sinc(turn / (2 * np.pi)))
    assert module._level(frame, shape_of(), 20e6) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("deepest", "end"), [(0.8, np.inf), (0.8, 1.0)])
def test_the_depth_of_most_light_is_found_between_the_nodes(
    deepest: float, end: float
) -> None:
    def hump(depth: np.ndarray, shape: Shape) -> np.ndarray:
        return depth * np.exp(-depth / deepest)

    found = module._depth_of_maximum(frame_of(hump, end=end), shape_of())
    assert found == pytest.approx(deepest, rel=5e-5)


def test_light_that_only_decays_is_largest_in_front() -> None:
    found = module._depth_of_maximum(frame_of(decay), shape_of())
    assert abs(found) < 12.0 / 1000
    # Light that is even everywhere has no maximum: the first node inside.
    flat = frame_of(lambda depth, shape: np.ones(len(depth)))
    assert module._depth_of_maximum(flat, shape_of()) == pytest.approx(12 / 1999)


def test_errors_of_the_shape_are_propagated_with_their_correlations() -> None:
    rng = np.random.default_rng(1)
    root = 0.01 * rng.standard_normal((7, 7))
    shape = Shape(LOSS, 0.05, 0.7, np.array([0.3, -0.1]), np.array([1.0, 2.0]))
    state = shared_state(shape=shape, covariance=root @ root.T)

    def function(shape: Shape) -> float:
        return float(
            2 * np.log(shape.reduced_attenuation)
            - 3 * np.log(shape.spread)
            + 0.5 * np.log(shape.forward_scattering)
            + 4 * shape.correction[0]
            - shape.correction[1]
        )

    value, error = module._propagated(state, function)
    assert value == pytest.approx(function(shape))
    # Two strengths come first; three logarithms and two corrections follow.
    slope = np.array([0, 0, 2, -3, 0.5, 4, -1])
    expected = np.sqrt(slope @ (root @ root.T) @ slope)
    assert error == pytest.approx(expected, rel=1e-6)


def fitted(errors: np.ndarray, forward: float = 0.7) -> Any:
    """Return the result for independent relative errors of strengths and shape."""
    shape = shape_of(forward=forward)
    strength = np.array([0.5, 0.2])
    absolute = errors * np.append(strength, np.ones(3))
    parametric = np.diag([0.25, 0.04, 0.01, 0.09, 0.16]) * np.outer(
        np.append(strength, np.ones(3)), np.append(strength, np.ones(3))
    )
    state = shared_state(
        shape=shape,
        strength=strength,
        covariance=np.diag(absolute**2),
        parametric=parametric,
        fluctuation=0.03,
        misfit=1.2,
        evidence=7.0,
    )

    def hump(depth: np.ndarray, shape: Shape) -> np.ndarray:
        return depth * np.exp(-shape.reduced_attenuation * depth)

    return module._result(frame_of(hump), state, ["VV", "VH"])


def test_a_result_states_all_quantities_with_their_errors() -> None:
    found = fitted(np.array([0.01, 0.02, 0.03, 0.04, 0.06]))
    assert found.strength == (0.5, 0.2)
    assert found.strength_uncertainty == pytest.approx((0.005, 0.004))
    assert found.reduced_attenuation == LOSS
    assert found.reduced_attenuation_uncertainty == pytest.approx(0.03 * LOSS)
    assert found.spread == 0.05
    assert found.spread_uncertainty == pytest.approx(0.04 * 0.05)
    assert found.forward_scattering == 0.7
    assert found.forward_scattering_uncertainty == pytest.approx(0.06 * 0.7)
    # z exp(-k z) is largest at 1 / k, with the relative error of k.
    assert found.depth_of_maximum == pytest.approx(1 / LOSS, rel=1e-4)
    assert found.depth_of_maximum_uncertainty == pytest.approx(0.03 / LOSS, rel=3e-3)
    # Its response is that of a low-pass twice: half of the power at sqrt(sqrt 2 - 1).
    corner = LOSS * np.sqrt(np.sqrt(2) - 1) * 299792458.0 / (4 * np.pi * INDEX)
    assert found.cut_off == pytest.approx(corner, rel=1e-3)
    assert found.cut_off_uncertainty == pytest.approx(0.03 * corner, rel=5e-3)
    assert (found.fluctuation, found.misfit) == (0.03, 1.2)
    assert found.departure_evidence == 7.0
    assert found.names == (
        "strength VV", "strength VH", "reduced_attenuation", "spread",
        "forward_scattering",
    )  # fmt: skip
    expected = np.diag(np.array([0.01, 0.02, 0.03, 0.04, 0.06]) ** 2)
    assert_allclose(found.covariance, expected, atol=1e-15)
    # The best determined combination first.
    assert_allclose(found.direction_uncertainty, [0.1, 0.2, 0.3, 0.4, 0.5])
    assert_allclose(np.abs(found.direction).argmax(axis=0), [2, 1, 3, 4, 0])


@pytest.mark.parametrize(
    ("error", "forward", "known"),
    [
        (0.49, 0.7, True),
        (0.51, 0.7, False),
        # One percent is left unscattered down to 1 / k and back.
        (0.1, 0.99 * np.log(100) * LOSS / 2, True),
        (0.1, 1.01 * np.log(100) * LOSS / 2, False),
    ],
)
def test_forward_scattering_is_known_by_unscattered_light(
    error: float, forward: float, known: bool
) -> None:
    errors = np.array([0.49, 0.51, 0.49, 0.51, error])
    found = fitted(errors, forward)
    assert found.identified == (True, False, True, False, known)


def test_absorption_is_what_diffuse_scattering_leaves() -> None:
    fit: Any = SimpleNamespace(
        reduced_attenuation=0.4,
        spread=0.03,
        names=("strength VV", "reduced_attenuation", "spread"),
        covariance=np.array([[9.0, 0, 0], [0, 0.01, 0.002], [0, 0.002, 0.04]]),
    )
    found = split_scattering(fit, second_moment=0.06, forward_fraction=0.8)
    assert found.scattering == pytest.approx(0.625)
    assert found.scattering_uncertainty == pytest.approx(0.625 * 0.2)
    assert found.absorption == pytest.approx(0.4 - 0.125)
    slope = np.array([0.4, -0.125])
    error = np.sqrt(slope @ fit.covariance[1:, 1:] @ slope)
    assert found.absorption_uncertainty == pytest.approx(error)
    whole = split_scattering(fit, second_moment=0.06, forward_fraction=1.0)
    assert whole.absorption == 0.4
    for wrong, words in (
        ((-0.1, 0.5), "second_moment must be above 0 rad^2, got -0.1"),
        ((0.0, 0.5), "second_moment must be above 0 rad^2, got 0"),
        ((0.1, 0.0), "forward_fraction must be above 0 and at most 1, got 0"),
        ((0.1, 1.01), "forward_fraction must be above 0 and at most 1, got 1.01"),
    ):
        with pytest.raises(ValueError) as refusal:  # noqa: PT011
            split_scattering(fit, second_moment=wrong[0], forward_fraction=wrong[1])
        assert str(refusal.value) == words
