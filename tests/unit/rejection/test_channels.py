"""Least squares over channels: exact cases, limits, true errors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.rejection import channels
from amulor.rejection.covariance import Covariance


def _flat(variance: float, count: int = 1) -> Covariance:
    same = np.full(count, variance)
    return Covariance(same, same, np.zeros(count))


def test_two_channels_without_prior_are_the_closed_form() -> None:
    target, water = np.array([1 + 2j]), np.array([-0.5 + 0.3j])
    a, b = target + water, 0.24 * target + 0.1 * water
    found = channels.unmix(
        [a, b],
        [_flat(1e-4), _flat(4e-4)],
        target_weights=[1.0, 0.24],
        water_weights=[1.0, 0.1],
        water_prior=None,
    )
    assert_allclose(found.target, target, rtol=1e-12)
    # T = (b - 0.1 a) / 0.14: variances 4e-4 / 0.14^2 + 1e-4 * (0.1 / 0.14)^2.
    expected = (4e-4 + 1e-4 * 0.01) / 0.14**2
    assert_allclose(found.independent.in_phase, expected, rtol=1e-9)
    assert_allclose(found.independent.cross, 0, atol=1e-12)


def test_without_water_the_channels_are_weighted_by_their_variances() -> None:
    found = channels.unmix(
        [np.array([1.0 + 0j]), np.array([2.0 + 0j])],
        [_flat(1.0), _flat(0.25)],
        target_weights=[1.0, 1.0],
        water_weights=[1.0, 1.0],
        water_prior=_flat(0.0),
    )
    # Weights 1 and 4: (1 + 8) / 5, variance 1 / 5.
    assert_allclose(found.target, 1.8)
    assert_allclose(found.independent.quadrature, 0.2)


@given(st.floats(0.05, 0.95), st.floats(0.0, 0.9), st.floats(0.1, 3.0))
def test_a_wide_prior_is_no_prior(target: float, water: float, noise: float) -> None:
    if abs(target - water) < 0.05:
        return
    rng = np.random.default_rng(1)
    signals = [rng.standard_normal(3) + 1j * rng.standard_normal(3) for _ in range(2)]
    errors = [_flat(1.0, 3), _flat(noise, 3)]
    weights = {"target_weights": [1.0, target], "water_weights": [1.0, water]}
    free = channels.unmix(signals, errors, **weights, water_prior=None)
    wide = channels.unmix(signals, errors, **weights, water_prior=_flat(1e6, 3))
    assert_allclose(wide.target, free.target, rtol=1e-2, atol=1e-2)


@given(st.floats(0, 2 * np.pi), st.floats(0.1, 10))
def test_turning_and_scaling_the_outputs_does_the_same_to_the_target(
    turn: float, size: float
) -> None:
    rng = np.random.default_rng(2)
    signals = [rng.standard_normal(4) + 1j * rng.standard_normal(4) for _ in range(3)]
    factor = size * np.exp(1j * turn)

    def solve(factor: complex) -> np.ndarray:
        return channels.unmix(
            [signal * factor for signal in signals],
            [_flat(v * abs(factor) ** 2, 4) for v in (1.0, 2.0, 0.5)],
            target_weights=[1.0, 0.3, 0.6],
            water_weights=[1.0, 0.1, -0.4],
            water_prior=_flat(0.1 * abs(factor) ** 2, 4),
        ).target

    assert_allclose(solve(factor), solve(1.0) * factor, rtol=1e-9, atol=1e-12)


def test_the_stated_covariance_is_the_scatter() -> None:
    rng = np.random.default_rng(3)
    count = 40_000
    stated = [
        Covariance(*(np.full(count, v) for v in (1.0, 4.0, 1.2))),
        Covariance(*(np.full(count, v) for v in (2.0, 0.5, -0.6))),
    ]
    signals = []
    for each, share in zip(stated, (1.0, 0.3), strict=True):
        matrix = np.array(
            [[each.in_phase[0], each.cross[0]], [each.cross[0], each.quadrature[0]]]
        )
        error = rng.multivariate_normal([0, 0], matrix, count)
        signals.append(share * (3 - 1j) + error[:, 0] + 1j * error[:, 1])
    water = rng.standard_normal(count) + 1j * rng.standard_normal(count)
    signals = [s + w * water for s, w in zip(signals, (1.0, 0.1), strict=True)]
    found = channels.unmix(
        signals,
        stated,
        target_weights=[1.0, 0.3],
        water_weights=[1.0, 0.1],
        water_prior=_flat(1.0, count),
    )
    error = found.target - (3 - 1j)
    scatter = np.cov(error.real, error.imag)
    # 40,000 draws: a variance to 0.7 %; five of them, against the larger variance.
    size = np.sqrt(found.independent.in_phase[0] * found.independent.quadrature[0])
    assert_allclose(scatter[0, 0], found.independent.in_phase[0], rtol=0.035)
    assert_allclose(scatter[1, 1], found.independent.quadrature[0], rtol=0.035)
    assert abs(scatter[0, 1] - found.independent.cross[0]) < 0.035 * size


def test_further_errors_and_changes_follow_the_gain() -> None:
    rng = np.random.default_rng(4)
    signals = [rng.standard_normal(2) + 1j * rng.standard_normal(2) for _ in range(2)]
    arguments = {
        "target_weights": [1.0, 0.3],
        "water_weights": [1.0, 0.1],
        "water_prior": _flat(0.5, 2),
    }
    errors = [_flat(1.0, 2), _flat(0.2, 2)]
    base = channels.unmix(signals, errors, **arguments)
    change = [np.array([0.1 + 0.2j, -0.3j]), np.array([0.5 + 0j, 0.1 - 0.1j])]
    moved = channels.unmix(
        [s + c for s, c in zip(signals, change, strict=True)], errors, **arguments
    )
    assert_allclose(base.shift_by(change), moved.target - base.target, rtol=1e-9)
    # The errors the estimate knows, carried through the gain, are its covariance, but
    # for the water's share.
    carried = base.error_of(errors)
    assert (carried.in_phase < base.independent.in_phase).all()


def test_a_channel_that_is_missing_leaves_no_number() -> None:
    found = channels.unmix(
        [np.array([1.0 + 0j, np.nan]), np.array([0.3 + 0j, 0.3])],
        [_flat(1.0, 2), _flat(1.0, 2)],
        target_weights=[1.0, 0.3],
        water_weights=[1.0, 0.1],
        water_prior=None,
    )
    assert np.isfinite(found.target[0])
    assert np.isnan(found.target[1])


def test_errors_of_zero_are_no_trouble() -> None:
    found = channels.unmix(
        [np.array([1.0 + 1j]), np.array([0.3 + 0.3j])],
        [_flat(0.0), _flat(0.0)],
        target_weights=[1.0, 0.3],
        water_weights=[1.0, 0.1],
        water_prior=_flat(0.0),
    )
    assert found.target[0] == pytest.approx(1 + 1j)
