"""Probability and size of an error of a scan, after its test."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.stats import norm

from amulor.site.registration.patterns import PatternTest, _suspected, mean_square


@pytest.mark.parametrize("score", [0.0, -1.0, 2.5, 4.0])
def test_the_mean_square_of_an_error_is_that_of_bayes_theorem(score: float) -> None:
    # One scan of a hundred has the error, of a size of 5 standard errors of the test.
    prior, size = 0.01, 5.0

    def with_error(value: float) -> float:
        return prior * norm.pdf(value, scale=size) * norm.pdf(score, loc=value)

    limits = (score - 12, score + 12)
    square = quad(lambda value: value**2 * with_error(value), *limits, epsabs=1e-15)[0]
    total = quad(with_error, *limits, epsabs=1e-15)[0] + (1 - prior) * norm.pdf(score)
    assert_allclose(mean_square(score), square / total, rtol=1e-6)


def test_an_error_beyond_doubt_has_its_estimated_size() -> None:
    # The prior of 5 standard errors shrinks it by 1 / 26.
    assert_allclose(mean_square(60.0), (60 * 25 / 26) ** 2 + 25 / 26, rtol=1e-9)


def test_suspected_errors_change_the_unknowns_by_their_external_reliability() -> None:
    test = PatternTest(
        scan="a", pattern="rows", size=6e-3, uncertainty=2e-3, detectable=9e-3,
        score=3.0,
    )  # fmt: skip
    # An error of the detectable size shifts a pose by 18 mm, so one of 2 mm by 4 mm.
    spread = _suspected([test], [np.array([0.018, 0.0])], np.zeros((2, 2)))
    assert_allclose(spread, [[mean_square(3.0) * 0.004**2, 0], [0, 0]], rtol=1e-12)


@pytest.mark.parametrize("score", [0.5, 2.4])
def test_a_test_that_determines_nothing_adds_no_more_than_start_poses_allow(
    score: float,
) -> None:
    # The test is uncertain by 1.5 m, and the pose is known within 1 cm.
    test = PatternTest(
        scan="a", pattern="constant", size=1.5 * score, uncertainty=1.5,
        detectable=6.75, score=score,
    )  # fmt: skip
    spread = _suspected([test], [np.array([6.75])], np.array([[1e4]]))
    # Three standard errors of the pose, by the probability of the error.
    odds = np.log(0.01 / 0.99) - np.log(26) / 2 + 25 / 26 * score**2 / 2
    assert_allclose(spread, [[0.03**2 / (1 + np.exp(-odds))]], rtol=1e-6)
