"""Shares of the water behind a target: the table against the integral."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.rejection.reference import column
from amulor.survey import Survey


def _places(count: int, *, width: float, near: float, far: float) -> np.ndarray:
    rng = np.random.default_rng(3)
    return np.stack(
        [
            rng.uniform(-width, width, count),
            rng.uniform(-width / 2, width / 2, count),
            rng.uniform(near, far, count),
        ]
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("width", "near", "far", "tabulated"),
    [
        (0.03, 1.4, 1.6, True),
        (0.03, 0.3, 3.0, True),
        # So wide and near, a table needs as many nodes as there are pixels.
        (0.08, 0.5, 3.0, False),
    ],
)
def test_the_table_keeps_its_error_bound(
    plate: Survey, width: float, near: float, far: float, tabulated: bool
) -> None:
    places = _places(12_000, width=width, near=near, far=far)
    frequency = np.array([39e6, 146e6])
    found = column.fractions(plate, *places, modulation_frequency=frequency)
    exact = column.integrated(plate, places, frequency)
    assert np.abs(found - exact).max() < column.LARGEST_ERROR
    # And it is a table: agreement to the last digit would be the integral itself.
    assert (np.abs(found - exact).max() > 1e-14) == tabulated


def test_many_pixels_close_together_share_a_table(plate: Survey) -> None:
    places = _places(2_500, width=0.01, near=1.45, far=1.5)
    frequency = np.array([39e6])
    found = column.fractions(plate, *places, modulation_frequency=frequency)
    error = np.abs(found - column.integrated(plate, places, frequency)).max()
    assert 1e-14 < error < column.LARGEST_ERROR


def test_where_no_table_holds_every_pixel_is_integrated(plate: Survey) -> None:
    # 2 GHz over 6 m turn by 100 periods: no table of 65 depths follows from the start.
    places = _places(200, width=0.3, near=0.0, far=6.0)
    frequency = np.array([2e9])
    found = column.fractions(plate, *places, modulation_frequency=frequency)
    assert_allclose(
        found, column.integrated(plate, places, frequency), rtol=0, atol=1e-15
    )


def test_at_the_surface_all_water_is_behind_and_far_away_none(plate: Survey) -> None:
    fractions = column.fractions(
        plate,
        np.zeros(2),
        np.zeros(2),
        np.array([0.0, 60.0]),
        modulation_frequency=np.array([39e6]),
    )
    # 2 k' z = 0.51 * 60: exp(-30.6) is 5e-14.
    assert_allclose(fractions[0], [1, 0], rtol=0, atol=1e-12)


def test_behind_the_wall_of_a_tank_there_is_nothing(plate_text: str) -> None:
    text = plate_text.replace("[water]", '[water]\ncolumn_end = "2 m"')
    depth = np.array([1.0, 2.0, 2.5])
    fractions = column.fractions(
        Survey.from_text(text),
        np.zeros(3),
        np.zeros(3),
        depth,
        modulation_frequency=np.array([39e6]),
    )
    assert abs(fractions[0, 0]) > 0.01
    assert_allclose(fractions[0, 1:], 0, rtol=0, atol=1e-15)


def test_no_pixel_needs_no_share(plate: Survey) -> None:
    nothing = np.empty(0)
    found = column.fractions(
        plate, nothing, nothing, nothing, modulation_frequency=np.array([39e6, 50e6])
    )
    assert found.shape == (2, 0)


@settings(max_examples=15)
@given(depth=st.floats(0.3, 3.0), step=st.floats(0.01, 1.0))
def test_the_mean_share_shrinks_with_depth(
    plate: Survey, depth: float, step: float
) -> None:
    # At 1 kHz the delay is nothing: fractions of the mean light, all positive.
    fractions = column.fractions(
        plate,
        np.zeros(2),
        np.zeros(2),
        np.array([depth, depth + step]),
        modulation_frequency=np.array([1e3]),
    )[0]
    assert 0 < fractions[1].real < fractions[0].real < 1
    assert abs(fractions.imag).max() < 1e-3


@pytest.mark.parametrize(
    ("count", "part", "expected"),
    [
        # A tenth of 1 V; doubled and shared where several frequencies turn together.
        (1, 0.5, 0.1**2 / 2),
        (2, 0.5, 4 * 0.1**2 / 2),
        (3, 0.5, 6 * 0.1**2 / 2),
        # At most all of the part behind the target.
        (1, 0.05, 0.05**2 / 2),
        (2, 0.05, 4 * 0.05**2 / 2),
    ],
)
def test_the_model_error_is_a_share_of_the_whole_column(
    count: int, part: float, expected: float
) -> None:
    water = np.ones((count, 1, 1), dtype=complex)
    found = column.hidden_error(water, part * water, part * water, misfit=0.1)
    assert_allclose(found.in_phase, expected, rtol=1e-12)
    assert_allclose(found.quadrature, expected, rtol=1e-12)
    assert_allclose(found.cross, 0, atol=1e-15)


def test_an_error_of_turbidity_moves_the_column_along_itself() -> None:
    # 0.05 V at 2 frequencies, along the in-phase output and then along both.
    water = np.array([1.0, 1.0])[:, None, None] + 0j
    turn = np.array([1.0, np.exp(0.25j * np.pi)])[:, None, None]
    none = np.zeros(water.shape, dtype=complex)
    found = column.hidden_error(water * turn, none, none + 0.05, misfit=0.1)
    size = 2 * 0.05**2
    assert_allclose(found.in_phase.ravel(), [size, size / 2], atol=1e-12)
    assert_allclose(found.quadrature.ravel(), [0, size / 2], atol=1e-12)
    assert_allclose(found.cross.ravel(), [0, size / 2], atol=1e-12)
