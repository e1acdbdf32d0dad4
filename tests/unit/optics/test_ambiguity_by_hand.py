"""Choice of the ambiguity interval for single pixels, with all figures by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light

from amulor.optics import ambiguity
from amulor.optics.ambiguity import Choices, Path, fit, optical_path


def solved(
    readings: Any,
    sigma: Any,
    wavelength: Any,
    *,
    limits: tuple[float, float] = (0.0, 12.0),
    **options: Any,
) -> Path:
    """Return the path of one pixel from readings and errors as lengths [m]."""
    wave = np.asarray(wavelength, float)
    turn = 2 * np.pi / wave
    return optical_path(
        (np.asarray(readings) * turn)[:, None],
        (np.asarray(sigma) * turn)[:, None],
        modulation_frequency=speed_of_light / wave,
        shortest=np.array([limits[0]]),
        longest=np.array([limits[1]]),
        **options,
    )


@pytest.mark.parametrize(("longest", "count"), [(4.0, 1), (6.5, 2), (11.5, 3)])
def test_equal_intervals_are_each_as_probable(longest: float, count: int) -> None:
    found = solved([1.2], [0.01], [5.0], limits=(0.0, longest))
    assert_allclose(found.length, 1.2)
    assert_allclose(found.uncertainty, 0.01)
    assert_allclose(found.wrong, 1 - 1 / count, rtol=1e-9)
    assert_array_equal(found.settled, [count == 1])
    assert_array_equal(found.weight, [[1.0]])
    assert_allclose(found.residual, 0, atol=1e-12)
    assert_array_equal(found.left_out, [[False]])
    assert_allclose(found.strain, 0, atol=1e-12)


def test_readings_are_weighed_by_their_errors_as_lengths() -> None:
    found = solved([3.0, 3.05], [0.1, 0.2], [5.0, 7.0])
    weight = np.array([0.8, 0.2])
    assert_allclose(found.weight[:, 0], weight)
    assert_allclose(found.length, 3.01)
    assert_allclose(found.uncertainty, 125**-0.5)
    assert_allclose(found.residual[:, 0], [-0.01, 0.04])
    # Two readings differ by 5 cm of an expected 22.
    assert_allclose(found.strain, 0.05**2 / 0.05)
    assert found.settled.all()


@pytest.mark.parametrize(("square", "settled"), [(15.0, True), (15.3, False)])
def test_readings_may_differ_by_a_chance_of_one_in_ten_thousand(
    square: float, settled: bool
) -> None:
    # Chi-square of one degree of freedom: 15.137.
    apart = np.sqrt(square * 2) * 0.01
    found = solved([3.0, 3.0 + apart], [0.01, 0.01], [5.0, 7.0])
    assert_allclose(found.strain, square, rtol=1e-9)
    assert found.settled.item() is settled
    # Doubt of the phases excuses a difference, and does not settle less.
    turn = 2 * np.pi / np.array([[5.0], [7.0]])
    excused = solved([3.0, 3.0 + apart], [0.01, 0.01], [5.0, 7.0], doubt=0.01 * turn)
    assert_allclose(excused.strain, square / 2, rtol=1e-9)
    assert excused.settled.all()
    assert_allclose(excused.length, found.length)


@pytest.mark.parametrize(("excess", "settled"), [(15.8, False), (16.2, True)])
def test_the_next_interval_must_fit_worse_by_16(excess: float, settled: bool) -> None:
    # One interval of 15 m on, the other reading is 4 m off.
    spread = np.sqrt(16 / excess - 0.5**2)
    found = solved([2.0, 2.0], [0.5, spread], [15.0, 11.0], limits=(0.0, 20.0))
    assert_allclose(found.length, 2.0)
    assert found.settled.item() is settled
    chance = np.exp(-excess / 2)
    assert_allclose(found.wrong, chance / (1 + chance), rtol=1e-6)


def test_frequencies_are_ordered_by_their_error_as_a_length() -> None:
    frequency = speed_of_light / np.array([10.0, 2.0, 5.0])
    uncertainty = np.array([[1.0, 1.0, np.nan], [3.0, 9.0, 3.0], [1.0, 1.0, 1.0]])
    assert ambiguity._by_error(uncertainty, frequency) == (2, 1, 0)
    _, choices = fit(
        np.zeros((3, 3)),
        uncertainty,
        modulation_frequency=frequency,
        shortest=np.zeros(3),
        longest=np.full(3, 4.0),
    )
    assert choices.order == (2, 1, 0)


def test_a_frequency_that_was_not_measured_is_left_out() -> None:
    found = solved([3.0, 1.0, 3.02], [0.1, np.inf, 0.1], [5.0, 6.0, 7.0])
    assert_allclose(found.length, 3.01)
    assert_array_equal(found.left_out[:, 0], [False, True, False])
    assert_array_equal(found.weight[:, 0], [0.5, 0.0, 0.5])
    assert found.residual[1, 0] == 0.0
    # Nor is it the one whose intervals are counted.
    first = solved(
        [3.0, 3.0], [np.inf, 0.1], [5.0, 6.0], limits=(0.0, 4.0),
        choices=Choices(order=(0, 1)),
    )  # fmt: skip
    assert_allclose(first.length, 3.0)
    assert first.settled.all()


WAVES = [5.0, 6.0, 7.0, 8.0, 9.0, 11.0]


@pytest.mark.parametrize("wrong", [[1], [4], [0, 3], [2, 5]])
def test_phases_that_contradict_all_others_are_left_out(wrong: list[int]) -> None:
    readings = np.full(6, 3.0)
    readings[wrong] += [1.0, -1.3][: len(wrong)]
    sigma = np.array([0.01, 0.02, 0.01, 0.02, 0.01, 0.02])
    found = solved(readings, sigma, WAVES)
    expected = np.isin(np.arange(6), wrong)
    assert_array_equal(found.left_out[:, 0], expected)
    assert_allclose(found.length, 3.0)
    assert found.settled.all()
    weight = np.where(expected, 0, sigma**-2.0)
    assert_allclose(found.weight[:, 0], weight / weight.sum(), atol=1e-15)
    assert_allclose(found.uncertainty, weight.sum() ** -0.5)
    assert_allclose(found.strain, 0, atol=1e-9)
    kept = solved(
        readings, sigma, WAVES,
        choices=Choices(order=tuple(range(6)), outliers_left_out=False),
    )  # fmt: skip
    assert not kept.settled.any()
    assert not kept.left_out.any()


def test_three_of_six_wrong_phases_are_too_many() -> None:
    readings = [3.0, 4.0, 3.0, 2.0, 3.0, 4.6]
    found = solved(readings, [0.01] * 6, WAVES)
    assert not found.settled.any()
    assert not found.left_out.any()


def test_an_interval_of_too_many_periods_is_named() -> None:
    text = (
        r"^the interval holds 1\.2e\+04 ambiguity intervals of 29\.9792 MHz; narrow it$"
    )
    with pytest.raises(ValueError, match=text):
        solved([3.0], [0.1], [10.0], limits=(0.0, 1.2e5))
    solved([3.0], [0.1], [10.0], limits=(0.0, 9e4))


def test_limits_of_chi_square_are_those_of_tables() -> None:
    found = ambiguity._chi_square_limits(4)
    assert found.shape == (4,)
    assert_allclose(found[1:], [15.1367, 18.4207, 21.1075], rtol=1e-5)


def test_phases_without_error_still_have_weights() -> None:
    found = solved([3.0, 3.0], [0.0, 0.0], [5.0, 10.0])
    # Both count with 1e-9 rad.
    assert_allclose(found.weight[:, 0], [0.8, 0.2])
    assert_allclose(found.length, 3.0)


def test_a_reading_that_was_taken_in_motion_may_lie_farther_outside() -> None:
    # The limit is two errors: of the reading, and of the way until it was taken.
    for motion, settled in ((0.0, False), (0.1, True)):
        found = solved(
            [4.15], [0.05], [10.0], limits=(0.0, 4.0), motion=np.array([[motion]])
        )
        assert_allclose(found.length, 4.15)
        assert found.settled.item() is settled
