"""The water signal between the open-water shots, and how well it is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.rejection.covariance import Covariance
from amulor.rejection.reference import shots as reference

X, Y = (axis.ravel() for axis in np.meshgrid(np.linspace(-1, 1, 7), [-0.4, 0.0, 0.4]))
PLACES = np.stack([X, Y], axis=1) * 0.03


def _shots(
    rng: np.random.Generator,
    *,
    repeats: int,
    noise: float = 0.01,
    stray: float = 0.0,
) -> tuple[np.ndarray, Covariance, np.ndarray, np.ndarray]:
    """Return shots of a curved water signal, errors, places and what is expected."""
    truth = (1 + 0.4 * X + 0.1 * X**2) * np.exp(1j * (0.8 + 0.2 * X - 0.1 * Y))
    expected = np.repeat(truth, repeats)
    count = expected.size
    change = 1 + stray * rng.standard_normal(count)
    error = noise * (rng.standard_normal(count) + 1j * rng.standard_normal(count))
    flat = np.full(count, noise**2)
    stated = Covariance(flat, flat, np.zeros(count))
    return expected * change + error, stated, np.repeat(PLACES, repeats, 0), truth


def test_a_smooth_signal_is_followed_between_the_shots() -> None:
    shots, stated, places, truth = _shots(np.random.default_rng(1), repeats=400)
    found = reference.fit_channel(shots, stated, places, PLACES)
    assert found.degree >= 2
    error = found.signal - truth
    distance = found.common.mahalanobis(error)
    # Two degrees of freedom each; places share coefficients, so the mean is loose.
    assert distance.mean() < 6
    assert abs(error).max() < 5e-3


@pytest.mark.parametrize("stray", [0.0, 0.05])
def test_the_stated_error_of_the_reference_is_true(stray: float) -> None:
    rng = np.random.default_rng(2)
    z = []
    for _ in range(150):
        shots, stated, places, truth = _shots(rng, repeats=6, stray=stray)
        found = reference.fit_channel(shots, stated, places, PLACES)
        z.append(found.common.mahalanobis(found.signal - truth) / 2)
    # The mean of 150 chi-squares of 2 over 2 has standard error 0.08 at one place. A
    # degree that is chosen from the data adds a little misfit that no covariance knows.
    assert 0.85 < np.mean(z) < 1.15
    assert np.mean(z, axis=0).max() < 1.35


@given(st.floats(0, 2 * np.pi), st.floats(0.1, 10))
def test_turning_and_scaling_the_shots_turns_and_scales_the_reference(
    turn: float, size: float
) -> None:
    shots, stated, places, _ = _shots(np.random.default_rng(3), repeats=5, stray=0.05)
    factor = size * np.exp(1j * turn)
    plain = reference.fit_channel(shots, stated, places, PLACES)
    moved = reference.fit_channel(
        shots * factor, stated.scaled(size**2), places, PLACES
    )
    assert_allclose(moved.signal, plain.signal * factor, rtol=1e-6)
    # Radial and tangential strays per unit of signal are the same.
    assert_allclose(moved.relative, plain.relative, rtol=1e-5, atol=1e-9)


def test_the_fluctuation_is_found_and_points_along_the_signal() -> None:
    shots, stated, places, truth = _shots(
        np.random.default_rng(4), repeats=300, stray=0.05
    )
    found = reference.fit_channel(shots, stated, places, PLACES)
    strays = reference.fluctuation(found.relative, truth)
    size = strays.in_phase + strays.quadrature
    # 6300 shots: the variance is known to sqrt(2 / 6300) = 1.8 %; three of them.
    assert_allclose(size, 0.05**2 * abs(truth) ** 2, rtol=0.06)
    # A change of strength alone leaves the phase: no variance across the signal.
    turn = truth / abs(truth)
    across = (
        turn.imag**2 * strays.in_phase
        + turn.real**2 * strays.quadrature
        - 2 * turn.real * turn.imag * strays.cross
    )
    assert (across < 0.02 * size).all()


def test_quiet_water_has_no_fluctuation_beyond_chance() -> None:
    shots, stated, places, _ = _shots(np.random.default_rng(5), repeats=300)
    found = reference.fit_channel(shots, stated, places, PLACES)
    # 1 % of noise on 6300 shots hides a fluctuation of 1 % * (2 / 6300)^(1/4) = 0.13 %.
    assert np.sqrt(np.trace(found.relative)) < 0.004


def test_shots_in_one_direction_make_a_constant() -> None:
    rng = np.random.default_rng(6)
    shots = 1 + 0.01 * (rng.standard_normal(50) + 1j * rng.standard_normal(50))
    flat = np.full(50, 1e-4)
    found = reference.fit_channel(
        shots, Covariance(flat, flat, 0 * flat), np.zeros((50, 2)), PLACES
    )
    assert found.degree == 0
    assert_allclose(found.signal, np.mean(shots))
    assert_allclose(found.common.in_phase, 1e-4 / 50, rtol=0.3)


def test_the_mahalanobis_distance_is_that_of_the_inverse_matrix() -> None:
    covariance = Covariance(np.array([4.0]), np.array([2.0]), np.array([-1.0]))
    matrix = np.array([[4.0, -1.0], [-1.0, 2.0]])
    vector = np.array([1.5, -0.5])
    expected = vector @ np.linalg.inv(matrix) @ vector
    assert_allclose(covariance.mahalanobis(np.array([1.5 - 0.5j])), expected)


def test_a_degree_leaves_shots_enough_to_judge_the_scatter() -> None:
    rng = np.random.default_rng(7)
    places = np.stack([np.linspace(-1, 1, 8), np.zeros(8)], axis=1)
    z = []
    for _ in range(600):
        shots = 1 + 0.1 * rng.standard_normal(8)
        quiet = np.full(8, 1e-8)
        stated = Covariance(quiet, quiet, 0 * quiet)
        found = reference.fit_channel(shots + 0j, stated, places, places)
        assert found.degree <= 3
        # How far a further sample lies from the reference, in what is stated.
        sample = 1 + 0.1 * rng.standard_normal(8)
        total = found.common + reference.fluctuation(found.relative, found.signal)
        z.append((sample - found.signal.real) / np.sqrt(total.in_phase))
    # Four degrees of freedom make heavy tails; the bulk must hold.
    assert np.mean(np.abs(z) < 1) > 0.6


def test_too_few_shots_are_refused() -> None:
    flat = np.ones(4)
    with pytest.raises(ValueError, match="needs 5 shots, got 4"):
        reference.fit_channel(
            flat + 0j, Covariance(flat, flat, 0 * flat), np.zeros((4, 2)), PLACES
        )


def test_a_certain_signal_is_infinitely_far_off_zero() -> None:
    nothing = Covariance(np.zeros(3), np.zeros(3), np.zeros(3))
    found = nothing.mahalanobis(np.array([1j, 0.0, np.nan]))
    assert found[0] == np.inf
    assert found[1] == 0
    assert np.isnan(found[2])


def test_a_drift_is_told_from_a_change_over_the_directions() -> None:
    rng = np.random.default_rng(8)
    shots, stated, places, _ = _shots(rng, repeats=2)
    # First all directions, then all again: the second time 10 % more water.
    order = np.concatenate([np.arange(0, 42, 2), np.arange(1, 42, 2)])
    shots, places = shots[order], places[order]
    changed = shots * np.repeat([1.0, 1.1], 21)
    found = reference.fit_channel(changed, stated, places, PLACES).drift
    # Half of the scan lies between the two visits of a direction: 10 % there are 20 %
    # from the first shot to the last, relative to a level that lies between.
    assert found.change.real == pytest.approx(0.19, abs=4 * found.uncertainty.real)
    assert found.chance < 1e-6
    steady = reference.fit_channel(shots, stated, places, PLACES).drift
    assert abs(steady.change.real) < 4 * steady.uncertainty.real


def test_single_shots_across_the_scan_tell_no_drift() -> None:
    shots, stated, places, _ = _shots(np.random.default_rng(9), repeats=1)
    # A kink that no polynomial of the fit follows, in the order of the shots.
    bent = shots * np.where(np.arange(21) > 15, 2.0, 1.0)
    found = reference.fit_channel(bent, stated, places, PLACES).drift
    assert found.chance == 1.0
    assert found.uncertainty.real == np.inf
