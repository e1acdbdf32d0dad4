"""Shapes of the range errors that are tested: linear, bent, by range and by angle."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from numpy.testing import assert_allclose

from amulor.site.registration.patterns import PATTERNS, pattern_values


def test_each_pattern_is_the_function_that_it_is_named_after() -> None:
    rows, columns = 21, 31
    row, column = np.meshgrid(
        np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij"
    )
    # From perpendicular to grazing, beyond which an angle counts as one of 0.1.
    facing = np.linspace(1.0, 0.05, rows * columns).reshape(rows, columns)
    normal = np.stack([np.sqrt(1 - facing**2), 0 * facing, -facing], axis=-1)
    smooth = np.ones((rows, columns), dtype=bool)
    smooth[0, :3] = False
    surface = SimpleNamespace(
        distance=2.0 + column, normal=normal, smooth=smooth, motion=None,
        direction=np.broadcast_to([0.0, 0.0, 1.0], normal.shape),
    )  # fmt: skip
    values = pattern_values(surface)
    assert len(values) == len(PATTERNS) == 7
    assert_allclose(values[0], 1)
    assert_allclose(values[1], row)
    assert_allclose(values[2], 1 - 2 * row**2)
    assert_allclose(values[3], column)
    assert_allclose(values[4], 1 - 2 * column**2)
    # By distance: rising with it, from -1 to 1, without the noise of single pixels.
    inner = values[5][smooth]
    assert (inner.min(), inner.max()) == (-1.0, 1.0)
    assert np.all(np.diff(values[5][10]) >= -1e-9)
    slant = 1 / np.maximum(facing, 0.1)
    low, high = slant[smooth].min(), slant[smooth].max()
    expected = 2 * (slant - low) / (high - low) - 1
    assert_allclose(values[6][smooth], expected[smooth], atol=1e-9)
    flat = pattern_values(
        SimpleNamespace(**{**vars(surface), "distance": np.full(row.shape, 2.0)})
    )
    assert_allclose(flat[5], 0)
