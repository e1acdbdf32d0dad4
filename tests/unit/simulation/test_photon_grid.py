"""Fit of the ratio of photon-transport to small-angle light over beams."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.simulation.photons import basis_of, chosen_beams, fitted_ratio

LEAST = np.array([0.1, 0.1, 0.1])
MOST = np.array([1, 2, 3])


def scan(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 3, (count, 3))


@given(seed=st.integers(0, 1000))
def test_polynomials_up_to_the_degree_are_fitted_exactly(seed):
    rng = np.random.default_rng(seed)
    points = scan(300, seed)
    basis, fitted = basis_of(points, smallest=LEAST, degree=MOST)
    # Monomials of a total degree of at most 3, below the degree of each axis.
    powers = [p for p in itertools.product(range(2), range(3), range(4)) if sum(p) <= 3]
    assert fitted == len(powers)
    factors = rng.normal(size=len(powers)) + 1j * rng.normal(size=len(powers))
    values = np.stack([np.prod(points**p, axis=1) for p in powers], axis=1) @ factors
    beams = list(
        itertools.islice(chosen_beams(basis, rng), basis.shape[1] + len(powers))
    )
    value, error = fitted_ratio(basis, fitted, beams, values[beams][:, None])
    assert_allclose(value[0], values, rtol=1e-7, atol=1e-7 * abs(values).max())
    assert np.all(error < 1e-6 * abs(values).max())


def test_polynomials_are_orthonormal_over_the_beams():
    points = scan(200, 3)
    basis, _ = basis_of(points, smallest=LEAST, degree=MOST)
    assert_allclose(basis.T @ basis / 200, np.eye(basis.shape[1]), atol=1e-9)


def test_beams_that_differ_little_have_one_coefficient():
    points = np.array([[1.0, 0.0, 3.0], [1.05, 0.02, 3.02], [1.02, 0.09, 3.01]])
    basis, fitted = basis_of(points, smallest=LEAST, degree=MOST)
    assert (fitted, basis.shape[1]) == (1, 1)
    assert_allclose(basis[:, 0], basis[0, 0])


def test_errors_of_noisy_beams_are_those_of_the_fit():
    points = scan(400, 1)
    basis, fitted = basis_of(points, smallest=LEAST, degree=MOST)
    truth = 1 + 0.1 * points[:, 0] - 0.05 * points[:, 2] ** 2
    rng = np.random.default_rng(5)
    beams = list(itertools.islice(chosen_beams(basis, rng), 150))
    square = []
    for _ in range(60):
        # The noise grows along one axis, as the light of a farther target does.
        size = 0.02 * (1 + points[beams, 2])
        noise = size * (rng.normal(size=150) + 1j * rng.normal(size=150)) / np.sqrt(2)
        value, error = fitted_ratio(
            basis, fitted, beams, (truth[beams] + noise)[:, None]
        )
        square.append(abs(value[0] - truth) ** 2 / error[0] ** 2)
    # The squared modulus over its mean; the test of the fit adds a little to errors.
    per_beam = np.mean(square, axis=0)
    assert 0.7 < np.mean(per_beam) < 1.1
    assert np.quantile(per_beam, 0.95) < 1.5


def test_a_function_of_a_higher_degree_enlarges_the_error():
    points = scan(400, 2)
    basis, fitted = basis_of(points, smallest=LEAST, degree=np.array([1, 1, 1]))
    truth = 1 + 0.3 * (points[:, 1] - 1.5) ** 2
    rng = np.random.default_rng(5)
    beams = list(itertools.islice(chosen_beams(basis, rng), 80))
    noise = 0.002 * (rng.normal(size=80) + 1j * rng.normal(size=80))
    value, error = fitted_ratio(basis, fitted, beams, (truth[beams] + noise)[:, None])
    miss = np.sqrt(np.mean(abs(value[0] - truth) ** 2))
    assert miss > 0.1
    assert np.sqrt(np.mean(error**2)) == pytest.approx(miss, rel=0.25)


def test_chosen_beams_keep_the_largest_variance_near_the_least_possible():
    points = scan(500, 4)
    basis, fitted = basis_of(points, smallest=LEAST, degree=MOST)
    rng = np.random.default_rng(0)
    beams = list(itertools.islice(chosen_beams(basis, rng), 200))
    functions = basis[:, :fitted]
    inverse = np.linalg.inv(functions[beams].T @ functions[beams])
    variance = np.sum(functions @ inverse * functions, axis=1)
    # The least possible largest variance of p coefficients from N runs is p / N
    # (Kiefer and Wolfowitz); beams drawn at random reach four times as much.
    assert variance.max() < 2.5 * fitted / 200


def test_beams_are_the_least_certain_and_a_random_one_in_turn():
    # One beam stands out; of the other direction nothing is known without the third.
    basis = np.array([[1.0, 0.0], [4.0, 0.0], [0.0, 2.0], [0.5, 0.1]])
    for seed in range(10):
        rng = np.random.default_rng(seed)
        first, second, third = itertools.islice(chosen_beams(basis, rng), 3)
        assert first == 1
        assert 2 in (second, third)
