"""Covariances of two outputs against products of 2 x 2 matrices."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.rejection import covariance
from amulor.rejection.covariance import Covariance


def _drawn(seed: int, count: int = 6) -> tuple[np.ndarray, Covariance]:
    root = np.random.default_rng(seed).standard_normal((count, 2, 2))
    matrix = root @ root.transpose(0, 2, 1)
    return matrix, Covariance(matrix[:, 0, 0], matrix[:, 1, 1], matrix[:, 0, 1])


def _matrix(errors: Covariance) -> np.ndarray:
    rows = [[errors.in_phase, errors.cross], [errors.cross, errors.quadrature]]
    return np.moveaxis(np.array(rows), -1, 0)


def _complex(seed: int, count: int = 6) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal(count) + 1j * rng.standard_normal(count)


def test_sums_multiples_and_products_with_complex_factors() -> None:
    (first, one), (second, other) = _drawn(1), _drawn(2)
    assert_allclose(_matrix(one + other), first + second)
    assert_allclose(_matrix(one.scaled(3.0)), 3 * first)
    factor = _complex(3)
    rows = [[factor.real, -factor.imag], [factor.imag, factor.real]]
    turn = np.moveaxis(np.array(rows), -1, 0)
    assert_allclose(_matrix(one.turned(factor)), turn @ first @ turn.transpose(0, 2, 1))
    assert_allclose(_matrix(one.part(slice(2, 4))), first[2:4])


def test_a_difference_has_no_variance_below_zero() -> None:
    _, one = _drawn(1)
    _, other = _drawn(2)
    assert_allclose(_matrix((one + other).without(other)), _matrix(one))
    less = one.without(one.scaled(2.0))
    assert np.all(less.in_phase == 0)
    assert np.all(less.quadrature == 0)


def test_the_distance_from_zero_is_that_of_the_inverse_matrix() -> None:
    matrix, errors = _drawn(4)
    signal = _complex(5)
    pair = np.stack([signal.real, signal.imag], axis=1)[..., None]
    expected = (pair.transpose(0, 2, 1) @ np.linalg.solve(matrix, pair)).ravel()
    assert_allclose(errors.mahalanobis(signal), expected)
    none = Covariance(np.zeros(3), np.zeros(3), np.zeros(3))
    distance = none.mahalanobis(np.array([1j, 0, np.nan]))
    assert_allclose(distance, [np.inf, 0, np.nan])


def test_errors_along_a_signal_leave_its_phase() -> None:
    signal = _complex(6)
    errors = covariance.along(signal, 0.2)
    # In the direction of the signal 0.2 of its size, across it nothing.
    straight = errors.turned(np.exp(-1j * np.angle(signal)))
    assert_allclose(straight.in_phase, (0.2 * np.abs(signal)) ** 2)
    assert_allclose(straight.quadrature, 0, atol=1e-15)
    assert_allclose(straight.cross, 0, atol=1e-15)
    even = covariance.isotropic(np.abs(signal))
    assert_allclose(even.in_phase + even.quadrature, np.abs(signal) ** 2)
    assert_allclose(even.in_phase, even.quadrature)
    assert np.all(even.cross == 0)


def test_phase_errors_are_those_across_the_signal() -> None:
    matrix, errors = _drawn(7)
    signal = _complex(8)
    across = (
        np.stack([-signal.imag, signal.real], axis=1) / np.abs(signal)[:, None] ** 2
    )
    expected = np.sqrt(np.einsum("ni,nij,nj->n", across, matrix, across))
    found = covariance.phase_uncertainties(
        signal.reshape(2, 3),
        {
            "all": Covariance(*(part.reshape(2, 3) for part in vars(errors).values())),
            "one": Covariance(*(part[:3] for part in vars(errors).values())),
        },
    )
    assert_allclose(found["all"], expected.reshape(2, 3), rtol=1e-6)
    # An error that rows share.
    assert_allclose(found["one"][0], expected[:3], rtol=1e-6)


@pytest.mark.parametrize("count", [1, 63, 64, 65, 200])
def test_a_product_by_rows_is_the_product(count: int) -> None:
    rng = np.random.default_rng(9)
    rows, matrix = rng.standard_normal((count, 7)), rng.standard_normal((7, 5))
    whole = covariance.times(rows, matrix)
    assert_allclose(whole, np.einsum("ij,jk->ik", rows, matrix), rtol=1e-12)
    # The same to the last bit for a part of the rows.
    assert np.array_equal(
        covariance.times(rows[: count // 2 + 1], matrix), whole[: count // 2 + 1]
    )


def test_covariances_of_channels_are_stacked_by_frequency() -> None:
    parts = [Covariance(*np.full((3, 2), k + 0.1)) for k in range(6)]
    stacked = covariance.stacked(parts, (3, 2, 2))
    assert_allclose(stacked.cross[:, :, 0], np.arange(6).reshape(3, 2) + 0.1)
