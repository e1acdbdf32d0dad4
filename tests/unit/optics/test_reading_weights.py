"""Means of readings of a point that moves, against generalized least squares."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.optics._reading_weights import ReadingWeights

PRECISION = np.array([4.0, 1.0, 9.0, 2.0])
MOTION = np.array([-0.3, 0.0, 0.7, 1.1])
ERROR = np.array([0.2, -0.5, 0.1, 0.4])


def covariance_of(precision: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return the covariance of readings with a rate of variance 1."""
    return np.diag(1 / precision) + np.outer(motion, motion)


def column(values: np.ndarray) -> np.ndarray:
    """Return readings of two equal pixels."""
    return np.stack([values, values], axis=1)


def rated() -> ReadingWeights:
    return ReadingWeights.of(column(PRECISION), column(MOTION))


def test_weights_and_information_are_those_of_generalized_least_squares() -> None:
    inverse = np.linalg.inv(covariance_of(PRECISION, MOTION))
    found = rated()
    assert_allclose(found.information, np.full(2, inverse.sum()), rtol=1e-12)
    expected = inverse.sum(axis=0) / inverse.sum()
    assert_allclose(found.weight, column(expected), rtol=1e-12)


def test_square_of_errors_is_that_of_their_covariance() -> None:
    inverse = np.linalg.inv(covariance_of(PRECISION, MOTION))
    found = rated().square(column(ERROR))
    assert_allclose(found, np.full(2, ERROR @ inverse @ ERROR), rtol=1e-12)


def test_the_rate_that_the_readings_show_is_subtracted() -> None:
    inverse = np.linalg.inv(covariance_of(PRECISION, MOTION))
    mean = inverse.sum(axis=0) @ ERROR / inverse.sum()
    rate = MOTION @ inverse @ (ERROR - mean)
    found = rated().without_rate(column(ERROR))
    assert_allclose(found, column(ERROR - MOTION * rate), rtol=1e-12)


@pytest.mark.parametrize("moves", [True, False])
def test_scatter_of_the_residuals_is_that_of_independent_errors(moves: bool) -> None:
    motion = MOTION if moves else np.zeros(4)
    found = ReadingWeights.of(column(PRECISION), column(MOTION) if moves else None)
    inverse = np.linalg.inv(covariance_of(PRECISION, motion))
    mean = inverse.sum(axis=0) / inverse.sum()
    rate = motion @ inverse @ (np.eye(4) - np.outer(np.ones(4), mean))
    rest = np.eye(4) - np.outer(np.ones(4), mean) - np.outer(motion, rate)
    sigma = np.array([0.3, 0.8, 0.5, 0.2])
    expected = np.diag(rest @ np.diag(sigma**2) @ rest.T)
    assert_allclose(found.scatter(column(sigma)), column(expected), rtol=1e-12)


def test_readings_of_a_point_at_rest_are_weighed_by_their_precision() -> None:
    found = ReadingWeights.of(column(PRECISION), None)
    assert found.motion is None
    assert_allclose(found.weight, column(PRECISION / 16))
    assert_allclose(found.information, 16)
    assert_allclose(found.square(column(ERROR)), np.sum(ERROR**2 * PRECISION))
    assert_array_equal(found.without_rate(column(ERROR)), column(ERROR))
    assert_array_equal(found.rate_weight, [0.0])


def test_readings_that_are_missing_count_for_nothing() -> None:
    precision, error = PRECISION.copy(), ERROR.copy()
    precision[1], error[1] = 0.0, np.nan
    used = [0, 2, 3]
    found = ReadingWeights.of(column(precision), column(MOTION))
    alone = ReadingWeights.of(column(PRECISION[used]), column(MOTION[used]))
    assert_allclose(found.information, alone.information, rtol=1e-12)
    assert_allclose(found.weight[used], alone.weight, rtol=1e-12)
    assert_array_equal(found.weight[1], 0.0)
    left = found.without_rate(column(error))
    assert_allclose(left[used], alone.without_rate(column(ERROR[used])), rtol=1e-12)
    scatter = found.scatter(column(error))
    assert_allclose(scatter[used], alone.scatter(column(ERROR[used])), rtol=1e-12)
    # Without any reading there is no mean, and no warning either.
    nothing = ReadingWeights.of(np.zeros((4, 2)), column(MOTION))
    assert_array_equal(nothing.information, 0.0)
    assert np.isnan(nothing.weight).all()
    assert np.isnan(ReadingWeights.of(np.zeros((4, 2)), None).weight).all()


def test_a_fast_common_motion_leaves_the_differences_alone() -> None:
    # The length is lost in the rate, up to the small differences of the motion.
    motion = 1e7 + np.array([0.0, 1.0])
    found = ReadingWeights.of(np.ones((2, 1)), motion[:, None])
    expected = (2 + 1) / (1 + np.sum(motion**2))
    assert_allclose(found.information, expected, rtol=1e-12)
