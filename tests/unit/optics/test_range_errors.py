"""Errors of slant ranges from errors of phases: slopes, shifts, weights."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.optics import interference, ranging

frequencies = st.floats(1e5, 1e10)
indices = st.floats(1.0, 2.0)
phasors = st.builds(
    lambda size, phase: size * np.exp(1j * phase),
    st.floats(1e-3, 1e3),
    st.floats(-3.0, 3.0),
)


@given(frequencies, indices, st.floats(1e-3, 1e2))
def test_the_slopes_are_those_of_phase_and_range(
    frequency: float, index: float, distance: float
) -> None:
    medium = {"modulation_frequency": frequency, "group_index": index}
    phase = ranging.phase(distance, **medium)
    # Both are proportional, so the slope is the quotient.
    assert_allclose(
        ranging.phase_per_range(frequency, group_index=index),
        phase / distance,
        rtol=1e-14,
    )
    assert_allclose(
        ranging.range_per_phase(frequency, group_index=index) * phase,
        ranging.slant_range(phase, **medium),
        rtol=1e-14,
    )


@given(phasors, phasors)
def test_the_shift_is_the_phase_error_that_the_residual_makes(
    target: complex, residual: complex
) -> None:
    total = target + residual
    if abs(total) < 1e-3 * abs(target):
        return  # The two cancel: no phase is left to compare.
    turned = ranging.phase_shift(total, residual=residual)
    expected = interference.phase_error(target, residual)
    # Compared on the circle, where -pi and pi are one; the subtraction loses digits
    # where the residual is far the larger.
    lost = 1e-15 * (1 + abs(residual) / abs(target)) * 1e2
    assert abs(np.exp(1j * turned) - np.exp(1j * expected)) < 1e-12 + lost


def test_without_a_residual_or_without_numbers_there_is_no_shift() -> None:
    signal = np.array([3 - 4j, 1 + 1j, np.nan, 0.0])
    residual = np.array([0.0, np.nan, 0.1j, 0.0])
    shift = ranging.phase_shift(signal, residual=residual)
    assert abs(shift[0]) < 1e-15
    assert np.isnan(shift[1:]).all()


@given(st.lists(st.floats(1e-6, 1e3), min_size=1, max_size=6))
def test_weights_add_up_and_make_the_smallest_uncertainty(sigma: list[float]) -> None:
    deviation = np.array(sigma)
    weight, combined = ranging.weights_and_uncertainty(deviation)
    assert weight.sum() == pytest.approx(1.0, rel=1e-12)
    # The uncertainty of the mean with these weights, and no other weights do better.
    assert combined == pytest.approx(np.sqrt(np.sum((weight * deviation) ** 2)))
    equal = np.sqrt(np.sum(deviation**2)) / deviation.size
    assert combined <= equal * (1 + 1e-12)


def test_a_range_without_any_error_takes_all_the_weight() -> None:
    weight, combined = ranging.weights_and_uncertainty([[0.0, np.inf], [1.0, 2.0]])
    assert_allclose(weight, [[1, 0], [0, 1]], atol=1e-100)
    assert_allclose(combined, [0, 2], atol=1e-100)


@pytest.mark.parametrize(
    "slope", [ranging.phase_per_range, ranging.range_per_phase], ids=["phase", "range"]
)
def test_slopes_refuse_what_has_none(slope) -> None:
    with pytest.raises(ValueError, match=r"above 0 \[Hz\], got 0 at index"):
        slope([0.0, 1e6], group_index=1.38)
    with pytest.raises(ValueError, match=r"at least 1, got 0\.5"):
        slope(1e6, group_index=0.5)
