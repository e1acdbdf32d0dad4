"""Beams between the nodes of a grid."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from amulor.view.page.pictures import Nodes, interpolated


def test_beams_between_nodes_are_interpolated_along_rows_and_columns() -> None:
    rows, columns = np.array([0, 4, 8, 9]), np.array([0, 3, 5])

    def beams(row: np.ndarray, column: np.ndarray) -> np.ndarray:
        # Linear along each axis, and twisted.
        values = 1 + 2 * row[:, None] - 3 * column + 0.5 * row[:, None] * column
        return np.stack([values, -values], axis=-1)

    nodes = Nodes(rows, columns, beams(rows, columns).astype(np.float32))
    every = np.arange(10), np.arange(6)
    assert_allclose(interpolated(nodes, *every), beams(*every), rtol=1e-6, atol=1e-6)
