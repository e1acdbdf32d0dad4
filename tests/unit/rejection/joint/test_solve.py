"""Errors of the water signal that all pixels share, against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.rejection.joint._kernels.bundles import Covariances, WaterModel
from amulor.rejection.joint._kernels.normal import common
from amulor.rejection.joint.priors import _replaced, inverse_of


def test_the_common_covariance_is_that_of_dense_algebra() -> None:
    rng = np.random.default_rng(3)
    pixels, channels, frequencies, shapes = 4, 2, 3, 2

    def drawn(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    strength = rng.random(channels)
    gain, departure = drawn(channels, frequencies), drawn(channels, frequencies)
    foreground, water = drawn(pixels, frequencies), drawn(pixels, frequencies)
    changes = drawn(pixels, shapes, frequencies)
    root = rng.standard_normal((channels, frequencies, shapes + 3, shapes + 3))
    matrix = root @ np.swapaxes(root, -1, -2)
    out = Covariances(*(np.empty((pixels, channels, frequencies)) for _ in range(3)))
    model = WaterModel(
        strength=strength,
        gain=gain,
        departure=departure,
        foreground=foreground,
        water=water,
        changes=changes,
        covariance=matrix,
    )
    common(0, pixels, model, out)
    for n, c, f in np.ndindex(pixels, channels, frequencies):
        # Derivatives of s W + s d N by strength, shape, real and imaginary d.
        slope = np.array(
            [
                water[n, f] + departure[c, f] * foreground[n, f],
                *(gain[c, f] * changes[n, :, f]),
                strength[c] * foreground[n, f],
                1j * strength[c] * foreground[n, f],
            ]
        )
        columns = np.stack([slope.real, slope.imag])
        dense = columns @ matrix[c, f] @ columns.T
        xx, yy, xy = (values[n, c, f] for values in out)
        assert_allclose(
            [[xx, xy], [xy, yy]], dense, rtol=1e-12, atol=1e-12 * abs(dense).max()
        )


def test_a_parameter_that_nothing_depends_on_is_not_known() -> None:
    rng = np.random.default_rng(4)
    root = rng.standard_normal((3, 3))
    known = root @ root.T
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = known
    inverse = inverse_of(matrix)
    assert_allclose(inverse[:3, :3], np.linalg.inv(known), rtol=1e-9)
    # Far more than any other, and finite.
    assert 1e9 < inverse[3, 3] < np.inf
    assert_allclose(inverse[3, :3], 0, atol=1e-9)


@pytest.mark.parametrize("place", range(5))
def test_one_width_is_replaced_and_the_others_stay(place: int) -> None:
    widths = 1.0, 2.0, 3.0, 4.0, 5.0
    expected = [9.0 if k == place else width for k, width in enumerate(widths)]
    assert [*_replaced(widths, place, 9.0)] == expected
