"""Columns that differ in the view of the receiver only are worked out together."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.optics.small_angle._columns import VIEW, Column, _views

PHASES = np.array([0.1, 0.2, 0.4])


def columns(**changes: np.ndarray) -> dict[str, np.ndarray]:
    return {name: np.asarray(0.5) for name in Column._fields} | changes


@pytest.mark.parametrize("shape", [(3, 1), (3, 1, 1)])
def test_equal_views_are_worked_out_once(shape: tuple[int, ...]) -> None:
    baseline = np.array([0.0, 0.1, 0.1, 0.2])
    if len(shape) == 3:
        baseline = baseline[:, None]
    found = _views(PHASES.reshape(shape), columns(baseline=baseline), 2)
    assert found is not None
    views, column, scatter = found
    assert_allclose(views[:, 0], [0.0, 0.1, 0.2])
    assert_allclose(views[:, 1:], 0.5)
    assert column.standoff == 0.5
    assert {getattr(column, name) for name in VIEW} == {0.0}
    # One result for each view and frequency, for all pixels, frequencies first.
    out = scatter(np.arange(9).reshape(3, 3) + 0j).reshape(3, 4)
    assert_array_equal(out.real, [[0, 3, 3, 6], [1, 4, 4, 7], [2, 5, 5, 8]])


def test_frequencies_without_an_axis_of_their_own_are_worked_out_by_column() -> None:
    baseline = np.array([0.0, 0.1, 0.2])
    assert _views(PHASES, columns(baseline=baseline), 2) is None
    assert _views(PHASES[:1], columns(baseline=baseline), 2) is not None
    assert _views(PHASES, columns(baseline=baseline[:1]), 1) is not None


def test_few_columns_and_those_of_several_waters_share_nothing() -> None:
    baseline = np.array([0.0, 0.1, 0.2])
    phases = PHASES[:, None]
    assert _views(phases, columns(baseline=baseline), 3) is not None
    assert _views(phases, columns(baseline=baseline), 4) is None
    absorption = next(name for name in Column._fields if name not in VIEW)
    other = {"baseline": baseline, absorption: np.array([0.5, 0.5, 0.6])}
    assert _views(phases, columns(**other), 2) is None
    other[absorption] = np.full(3, 0.5)
    assert _views(phases, columns(**other), 2) is not None
